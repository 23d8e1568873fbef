//! `sky`: a picture becomes a rule, which is stored beside it.

use std::io::Write as _;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use lumel::lights::sky::{self, Options, Rule, Sky};
use lumel::scene::{Environment, environment};
use lumel::{Error, Result};
use serde_json::{Value, json};

use super::args;
use super::print;
use super::progress::Display;
use super::run::Outcome;

/// Runs the subcommand to its end; `cancelled` stops it.
pub(crate) fn run(args: &args::Sky, display: &Display, cancelled: &AtomicBool) -> Result<Outcome> {
    let started = Instant::now();
    let options = args.options();
    // Wrong use is found out before a large picture is read.
    options.validate()?;
    let target = args
        .output
        .clone()
        .unwrap_or_else(|| environment::rule_path(&args.path));
    let made = pool(args.manner.threads())?.install(|| {
        let image = Environment::open(&args.path)?;
        if cancelled.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        let stored = std::fs::read_to_string(&target).unwrap_or_default();
        let found = sky::load_if_fits(&stored, image.hash(), &options);
        let is_found = found.is_some();
        let sky = match found {
            Some(sky) => sky,
            None => build(&image, &options, display, cancelled)?,
        };
        Ok((image.warnings, sky, is_found))
    });
    display.finish();
    let (warnings, sky, is_found) = made?;
    print::warnings(&json!(warnings), &args.manner);
    if !is_found {
        write(&target, &sky::to_json(&sky))?;
    }
    let summary = json!({
        "file": target.display().to_string(),
        "reused": is_found,
        "hash": format!("{:016x}", sky.hash),
        "directions": sky.sets[0].cells.len(),
        "sets": sky.sets.len(),
        "fluence": (sky.sets[0].fluence() + regions_fluence(&sky)).to_array(),
        "largestShare": largest_share(&sky.sets),
        "decentration": sky.sets.iter().map(|rule| rule.decentration).fold(0.0, f64::max),
        "regions": regions(&sky),
        "warnings": warnings,
        "seconds": started.elapsed().as_secs_f64(),
    });
    if args.manner.json {
        print::out(&format!("{summary:#}\n"))?;
    } else if !args.manner.quiet {
        print::out(&print::sky_summary(&summary))?;
    }
    Ok(Outcome::Done)
}

fn build(
    image: &Environment,
    options: &Options,
    display: &Display,
    cancelled: &AtomicBool,
) -> Result<Sky> {
    sky::build(image, options, &|n_placed| {
        display.directions(n_placed.min(options.directions), options.directions);
        !cancelled.load(Ordering::Relaxed)
    })
}

/// Worker threads of a number of their own, or one per core.
fn pool(threads: Option<usize>) -> Result<rayon::ThreadPool> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.unwrap_or(0))
        .build()
        .map_err(|error| Error::InvalidOption {
            option: "threads",
            reason: error.to_string(),
        })
}

/// The largest ‖B‖ as a part of all light of a set; 0 for a black picture.
fn largest_share(sets: &[Rule]) -> f64 {
    sets.iter()
        .map(|rule| rule.largest() / rule.fluence().element_sum())
        .filter(|share| share.is_finite())
        .fold(0.0, f64::max)
}

fn regions_fluence(sky: &Sky) -> glam::DVec3 {
    sky.regions.iter().map(|region| region.cell.fluence).sum()
}

fn regions(sky: &Sky) -> Vec<Value> {
    let total = (sky.sets[0].fluence() + regions_fluence(sky)).element_sum();
    sky.regions
        .iter()
        .map(|region| {
            json!({
                "direction": region.cell.direction.to_array(),
                "share": region.cell.norm() / total,
                "solidAngle": region.cell.solid_angle,
                "radiance": region.radiance.to_array(),
            })
        })
        .collect()
}

/// Writes `text` to a temporary file beside `target` and renames it.
fn write(target: &Path, text: &str) -> Result<()> {
    let io = |source| Error::Io {
        path: target.to_owned(),
        source,
    };
    let folder = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    // As any new file, not as a private one; the system still takes the umask away.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.prefix(".lumel-").tempfile_in(folder).map_err(io)?;
    file.write_all(text.as_bytes()).map_err(io)?;
    file.persist(target).map_err(|error| io(error.error))?;
    Ok(())
}
