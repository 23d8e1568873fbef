//! A progress bar with the time left, on standard error, for people only: silent when standard error is not a terminal.

use std::io::IsTerminal;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use lumel::bake::{Progress, Stage};

/// How often the spinner turns while nothing is reported, as when a large mesh is being unwrapped.
const TICK: Duration = Duration::from_millis(120);

/// What the user sees of a running command. Clones show the same bar.
#[derive(Clone)]
pub(crate) struct Display {
    bar: ProgressBar,
    /// The stage shown and the most that was reported of it; reports of several threads may overtake each other.
    shown: Arc<Mutex<Option<(Stage, u64)>>>,
}

impl Display {
    /// Shows "reading" at once. Draws nothing unless `wanted` and standard error is a terminal.
    pub(crate) fn new(wanted: bool) -> Self {
        let target = if wanted && std::io::stderr().is_terminal() {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::hidden()
        };
        let bar = ProgressBar::with_draw_target(None, target);
        bar.set_style(spinner());
        bar.set_message("reading");
        if !bar.is_hidden() {
            bar.enable_steady_tick(TICK);
        }
        Self {
            bar,
            shown: Arc::default(),
        }
    }

    /// Shows how far it is; for `Execution::progress`.
    pub(crate) fn update(&self, progress: Progress) {
        if self.bar.is_hidden() {
            return;
        }
        let Ok(mut shown) = self.shown.lock() else {
            return;
        };
        match shown.as_mut() {
            Some((stage, most)) if *stage == progress.stage => *most = progress.done.max(*most),
            _ => {
                *shown = Some((progress.stage, progress.done));
                self.begin(progress);
            }
        }
        if let Some((_, most)) = *shown {
            self.bar.set_position(most);
        }
    }

    /// Shows how many of `total` directions a sky has.
    pub(crate) fn directions(&self, done: usize, total: usize) {
        if self.bar.is_hidden() {
            return;
        }
        if self.bar.length() != Some(total as u64) {
            self.bar.set_message("placing");
            self.bar.set_length(total as u64);
            self.bar
                .set_style(with_bar("{msg:12} [{bar:32}] {pos}/{len} directions"));
        }
        self.bar.set_position(done as u64);
    }

    /// Says something above the bar; nothing where there is no bar.
    pub(crate) fn say(&self, message: &str) {
        self.bar.println(message);
    }

    /// Takes the bar away, before anything else is printed.
    pub(crate) fn finish(&self) {
        self.bar.finish_and_clear();
    }

    fn begin(&self, progress: Progress) {
        self.bar.set_message(name(progress.stage));
        if progress.total == 0 {
            self.bar.unset_length();
            self.bar.set_style(spinner());
        } else {
            self.bar.set_length(progress.total);
            self.bar
                .set_style(if matches!(progress.stage, Stage::Light) {
                    with_bar("{msg:12} [{bar:32}] {percent:>3} %  {human_pos}/{human_len} texels  {eta} left")
                } else {
                    with_bar("{msg:12} [{bar:32}] {percent:>3} %")
                });
        }
        self.bar.reset_eta();
    }
}

fn name(stage: Stage) -> &'static str {
    match stage {
        Stage::Atlas => "laying out",
        Stage::Prepare => "preparing",
        Stage::Light => "lighting",
        Stage::Write => "writing",
    }
}

fn spinner() -> ProgressStyle {
    style("{spinner} {msg}")
}

fn with_bar(template: &str) -> ProgressStyle {
    style(template).progress_chars("=> ")
}

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}
