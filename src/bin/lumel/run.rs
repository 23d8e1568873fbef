//! The subcommands: each opens the scene, calls the library, and prints what came of it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use lumel::bake::{self, Execution};
use lumel::scene::Scene;
use lumel::{Error, Result};
use serde_json::json;

use super::args::{Bake, Command, General, Inspect, Manner, Probe};
use super::progress::Display;
use super::{INTERRUPTED, points, print, samples, sky, view};

/// How a command ended that did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    Done,
    /// Done, but less than was asked; the message is printed.
    Shortfall,
}

/// Set by Ctrl-C.
static CANCELLED: AtomicBool = AtomicBool::new(false);

/// Runs `command` to its end.
pub(crate) fn run(command: &Command) -> Result<Outcome> {
    let is_quiet = |manner: &Manner| manner.quiet || manner.json;
    let display = Display::new(!command.manner().is_some_and(is_quiet));
    // A viewer has nothing to clean up: Ctrl-C may end it at once.
    if !matches!(command, Command::View(_)) {
        listen_for_interrupts(&display);
    }
    match command {
        Command::Bake(args) => run_bake(args, &display),
        Command::Probe(args) => run_probe(args, &display),
        Command::Inspect(args) => run_inspect(args, &display),
        Command::Sky(args) => sky::run(args, &display, &CANCELLED),
        Command::View(args) => view::run(args),
    }
}

/// The first Ctrl-C asks the library to stop, the second one stops.
fn listen_for_interrupts(display: &Display) {
    /// Signals closer together than this are one wish to stop: `timeout` signals the process and then its group. Much longer, and a
    /// user who presses twice would be ignored.
    const ONE_PRESS: Duration = Duration::from_millis(300);
    let display = display.clone();
    let mut first: Option<Instant> = None;
    let handler = move || match first {
        Some(first) if first.elapsed() > ONE_PRESS => {
            std::process::exit(i32::from(INTERRUPTED));
        }
        Some(_) => {}
        None => {
            first = Some(Instant::now());
            CANCELLED.store(true, Ordering::Relaxed);
            display.say("stopping; Ctrl-C again stops at once");
        }
    };
    if let Err(error) = ctrlc::set_handler(handler) {
        print::warning(&format!("Ctrl-C will stop at once: {error}"));
    }
}

fn run_bake(args: &Bake, display: &Display) -> Result<Outcome> {
    let started = Instant::now();
    let general = &args.general;
    let directory = args
        .directory
        .clone()
        .unwrap_or_else(|| general.path.with_extension("lumel"));
    let report = work(general, display, |scene, execution| {
        bake::bake(&scene, &directory, &args.options(), execution)
    })?;

    let warnings = &report.manifest["warnings"];
    print::warnings(warnings, &general.manner);
    for shortfall in &report.shortfalls {
        print::warning(&format!("shortfall: {shortfall}"));
    }
    let seconds = started.elapsed().as_secs_f64();
    if general.manner.json {
        let object = print::bake_json(&report, &directory, seconds);
        print::out(&format!("{object:#}\n"))?;
    } else if !general.manner.quiet {
        print::out(&print::bake_summary(&report, &directory, seconds))?;
    }
    Ok(if report.shortfalls.is_empty() {
        Outcome::Done
    } else {
        Outcome::Shortfall
    })
}

fn run_probe(args: &Probe, display: &Display) -> Result<Outcome> {
    let general = &args.general;
    // What cannot be written is found out before anything is evaluated.
    let destination = args
        .output
        .as_ref()
        .map(samples::Destination::create)
        .transpose()?;
    let receivers = points::read(&args.points)?;
    let ((evaluated, counters), warnings) = work(general, display, |scene, execution| {
        let result = bake::probe(&scene, &receivers, &args.options(), execution)?;
        Ok((result, json!(scene.warnings)))
    })?;

    print::warnings(&warnings, &general.manner);
    let n_unknown = evaluated
        .iter()
        .filter(|sample| !sample.has_gradient)
        .count();
    match destination {
        Some(destination) => destination.write(&receivers, &evaluated)?,
        None => print::out(&samples::to_csv(&receivers, &evaluated))?,
    }
    if general.manner.json {
        let object = json!({
            "points": receivers.len(),
            "pointsWithoutDerivative": n_unknown,
            "counters": counters,
            "warnings": warnings,
            "file": args.output.as_ref().map(|table| table.path.display().to_string()),
        });
        print::out(&format!("{object:#}\n"))?;
    } else if !general.manner.quiet {
        print::note(&print::probe_summary(receivers.len(), n_unknown, &counters));
    }
    Ok(Outcome::Done)
}

fn run_inspect(args: &Inspect, display: &Display) -> Result<Outcome> {
    let general = &args.general;
    let inspection = work(general, display, |scene, execution| {
        bake::inspect(&scene, &args.options(), execution)
    })?;
    print::warnings(&inspection["warnings"], &general.manner);
    if general.manner.json {
        print::out(&format!("{inspection:#}\n"))?;
    } else if !general.manner.quiet {
        print::out(&print::inspection(&inspection, &general.path))?;
    }
    Ok(Outcome::Done)
}

/// Reads the scene and does `work` on it; `display` shows how far it is.
fn work<R>(
    general: &General,
    display: &Display,
    work: impl FnOnce(Scene, &Execution<'_>) -> Result<R>,
) -> Result<R> {
    let progress = |progress| display.update(progress);
    let execution = Execution {
        threads: general.manner.threads(),
        cancelled: &CANCELLED,
        progress: &progress,
    };
    let result = Scene::open(&general.path, &general.scene_options()).and_then(|mut scene| {
        scene.sky = general.environment.sky()?;
        if CANCELLED.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        work(scene, &execution)
    });
    display.finish();
    result
}
