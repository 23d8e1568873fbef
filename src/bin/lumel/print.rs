//! Everything that is printed. Results go to standard output, messages to standard error.

use std::fmt::Write as _;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use lumel::bake::{Report, Stage};
use lumel::transport::Counters;
use lumel::{Error, Result};
use serde_json::{Map, Value, json};

use super::args::Manner;

/// Prints a result. A reader that went away (`| head`) has what it wanted.
pub(crate) fn out(text: &str) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    match stdout
        .write_all(text.as_bytes())
        .and_then(|()| stdout.flush())
    {
        Err(source) if source.kind() != ErrorKind::BrokenPipe => Err(Error::Io {
            path: PathBuf::from("standard output"),
            source,
        }),
        _ => Ok(()),
    }
}

/// Prints a message. Nobody is left to tell when this fails.
pub(crate) fn note(message: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{message}");
}

pub(crate) fn error(message: &str) {
    note(&format!("error: {message}"));
}

pub(crate) fn warning(message: &str) {
    note(&format!("warning: {message}"));
}

/// Prints one line per kind of warning; with `--verbose` also the first places.
///
/// `warnings` is what [`lumel::error::Warnings`] serialises to.
pub(crate) fn warnings(warnings: &Value, manner: &Manner) {
    if manner.quiet {
        return;
    }
    for kind in warnings.as_array().into_iter().flatten() {
        let mut line = text(&kind["what"]).to_owned();
        let count = kind["count"].as_u64().unwrap_or(1);
        if count > 1 {
            line += &format!(" ({} times)", grouped(count));
        }
        let places: Vec<&str> = kind["places"]
            .as_array()
            .into_iter()
            .flatten()
            .map(text)
            .collect();
        if manner.verbose && !places.is_empty() {
            line += &format!(": {}", places.join(", "));
            if count > places.len() as u64 {
                line += ", …";
            }
        }
        warning(&line);
    }
}

/// What a bake says with `--json`.
pub(crate) fn bake_json(report: &Report, directory: &Path, seconds: f64) -> Value {
    let mut steps: Map<String, Value> = report
        .seconds
        .iter()
        .map(|&(stage, seconds)| (stage_name(stage).to_owned(), json!(seconds)))
        .collect();
    steps.insert("total".to_owned(), json!(seconds));
    json!({
        "directory": directory.display().to_string(),
        "files": report.files,
        "seconds": steps,
        "shortfalls": report.shortfalls,
        "manifest": report.manifest,
    })
}

/// What a bake says to a person.
pub(crate) fn bake_summary(report: &Report, directory: &Path, seconds: f64) -> String {
    let manifest = &report.manifest;
    let counters = &manifest["counters"];
    let light = &counters["light"];
    let mut lines = Lines::new(&directory.display().to_string());
    lines.add(
        "texels",
        &format!(
            "{} on {}",
            number(&counters["texels"]),
            pages(
                manifest["pages"]
                    .as_array()
                    .into_iter()
                    .flatten()
                    .map(|page| [&page["width"], &page["height"]])
            )
        ),
    );
    let (evaluated, texels) = (
        real(&counters["evaluatedTexels"]),
        real(&counters["texels"]),
    );
    if evaluated < texels {
        lines.add(
            "evaluated",
            &format!(
                "{} texels, {:.3} evaluations per texel; the others are interpolated",
                number(&counters["evaluatedTexels"]),
                evaluated / texels
            ),
        );
    }
    lines.add("lights", &number(&counters["lights"]));
    let count = |name: &str| light[name].as_u64().unwrap_or(0);
    lines.add(
        "rays",
        &format!(
            "{}; {} of {} pairs of tile and light needed none",
            number(&light["shadow_rays"]),
            grouped(
                count("pairs")
                    - count("pairs_sampled")
                    - count("pairs_traced")
                    - count("pairs_vedel")
                    - count("pairs_hard")
                    - count("pairs_minor")
            ),
            number(&light["pairs"]),
        ),
    );
    let figures = &manifest["error"];
    lines.add(
        "error",
        &format!(
            "of E, estimated, relative to the page's largest: mean {:.2e}, 99 % below {:.2e} (asked: {})",
            real(&figures["mean"]),
            real(&figures["p99"]),
            figures["tolerance"],
        ),
    );
    for decision in left_out(&manifest["plan"]) {
        lines.add("left out", &decision);
    }
    let steps: Vec<String> = report
        .seconds
        .iter()
        .map(|&(stage, seconds)| format!("{} {seconds:.1}", stage_name(stage)))
        .collect();
    lines.add("time", &format!("{seconds:.1} s ({})", steps.join(", ")));
    for file in &report.files {
        lines.add("files", file);
    }
    lines.text
}

/// What `probe` says to a person.
pub(crate) fn probe_summary(n_points: usize, n_unknown: usize, counters: &Counters) -> String {
    let mut text = format!(
        "points: {}, shadow rays: {}",
        grouped(n_points as u64),
        grouped(counters.shadow_rays)
    );
    if n_unknown > 0 {
        text += &format!(
            ", without derivative (nan) because something may hide a light: {}",
            grouped(n_unknown as u64)
        );
    }
    text
}

/// What `sky` says to a person.
pub(crate) fn sky_summary(summary: &Value) -> String {
    let mut lines = Lines::new(text(&summary["file"]));
    let mut rule = format!("{} directions", number(&summary["directions"]));
    if summary["sets"] != 1 {
        rule = format!("{} interleaved sets of {rule}", number(&summary["sets"]));
    }
    if summary["reused"] == true {
        rule += ", there already";
    }
    lines.add("rule", &rule);
    lines.add(
        "largest",
        &format!(
            "{:.3} % of the light in one direction, {:.2} times an even share",
            100.0 * real(&summary["largestShare"]),
            real(&summary["largestShare"]) * real(&summary["directions"]),
        ),
    );
    lines.add(
        "centred",
        &format!("to {:.4} rad", real(&summary["decentration"])),
    );
    for region in summary["regions"].as_array().into_iter().flatten() {
        lines.add(
            "split off",
            &format!(
                "{:.1} % of the light in {:.2e} sr",
                100.0 * real(&region["share"]),
                real(&region["solidAngle"])
            ),
        );
    }
    lines.add("time", &format!("{:.1} s", real(&summary["seconds"])));
    lines.text
}

/// What `inspect` says to a person.
pub(crate) fn inspection(inspection: &Value, path: &Path) -> String {
    let mut lines = Lines::new(&path.display().to_string());
    let scene = &inspection["scene"];
    lines.add(
        "scene",
        &format!(
            "{} triangles, {} meshes in {} instances, {} materials, {} of them normal-mapped",
            number(&scene["triangles"]),
            number(&scene["meshes"]),
            number(&scene["instances"]),
            number(&scene["materials"]),
            number(&scene["normalMapped"]),
        ),
    );
    let bounds = &scene["bounds"];
    if !bounds.is_null() {
        let side = |axis: usize| real(&bounds["max"][axis]) - real(&bounds["min"][axis]);
        lines.add(
            "size",
            &format!(
                "{:.2} × {:.2} × {:.2} m, {:.2} m² of surface",
                side(0),
                side(1),
                side(2),
                real(&scene["area"])
            ),
        );
    }
    let lights = &inspection["lights"];
    lines.add(
        "lights",
        &format!(
            "{} polygons of {} triangles, {:.2} m², {:.0} lm; {} punctual",
            number(&lights["polygons"]),
            number(&lights["triangles"]),
            real(&lights["area"]),
            real(&lights["luminousFlux"]),
            number(&lights["punctual"]),
        ),
    );
    let atlas = &inspection["atlas"];
    lines.add(
        "atlas",
        &format!(
            "{} charts in {} layouts ({} authored), {} placements on {}, {:.0} % used",
            number(&atlas["charts"]),
            number(&atlas["unwraps"]),
            number(&atlas["authored"]),
            number(&atlas["placements"]),
            pages(
                atlas["pages"]
                    .as_array()
                    .into_iter()
                    .flatten()
                    .map(|page| [&page[0], &page[1]])
            ),
            100.0 * real(&atlas["rectanglesOverPages"]),
        ),
    );
    let plan = &inspection["plan"]["decisions"];
    for decision in decisions(plan, true) {
        lines.add("does", &decision);
    }
    for decision in left_out(plan) {
        lines.add("leaves out", &decision);
    }
    let memory = &inspection["memory"];
    lines.add(
        "memory",
        &format!(
            "about {} MB: geometry {}, largest page {}",
            number(&memory["totalMegabytes"]),
            number(&memory["geometryMegabytes"]),
            number(&memory["pageMegabytes"]),
        ),
    );
    lines.text
}

/// A title and indented lines below it; a label is printed once for all lines in a row that bear it.
struct Lines {
    text: String,
    last_label: String,
}

impl Lines {
    fn new(title: &str) -> Self {
        Self {
            text: format!("{title}\n"),
            last_label: String::new(),
        }
    }

    fn add(&mut self, label: &str, content: &str) {
        let shown = if label == self.last_label { "" } else { label };
        writeln!(self.text, "  {shown:<11} {content}").expect("a string takes any text");
        label.clone_into(&mut self.last_label);
    }
}

fn left_out(plan: &Value) -> Vec<String> {
    decisions(plan, false)
}

/// The decisions of a plan that are `done`, or those that are not, with their reasons.
fn decisions(plan: &Value, done: bool) -> Vec<String> {
    plan.as_array()
        .into_iter()
        .flatten()
        .filter(|decision| decision["done"] == done)
        .map(|decision| format!("{}: {}", text(&decision["what"]), text(&decision["reason"])))
        .collect()
}

fn pages<'a>(sizes: impl Iterator<Item = [&'a Value; 2]>) -> String {
    let sizes: Vec<String> = sizes
        .map(|[width, height]| format!("{width} × {height}"))
        .collect();
    match sizes.len() {
        0 => "no page".to_owned(),
        1 => format!("1 page ({})", sizes[0]),
        n => format!("{n} pages ({})", sizes.join(", ")),
    }
}

fn stage_name(stage: Stage) -> &'static str {
    match stage {
        Stage::Atlas => "atlas",
        Stage::Prepare => "prepare",
        Stage::Light => "light",
        Stage::Write => "write",
    }
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}

fn real(value: &Value) -> f64 {
    value.as_f64().unwrap_or_default()
}

/// A count from a document, grouped by thousands; megabytes are stored as whole floats.
fn number(value: &Value) -> String {
    grouped(
        value
            .as_u64()
            .unwrap_or_else(|| real(value).max(0.0) as u64),
    )
}

/// 1234567 as "1,234,567".
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_grouped_by_thousands() {
        for (number, text) in [
            (0, "0"),
            (999, "999"),
            (1000, "1,000"),
            (1_234_567, "1,234,567"),
        ] {
            assert_eq!(grouped(number), text);
        }
    }
}
