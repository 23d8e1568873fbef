//! The command `lumel`: reads arguments, calls the library, prints. The only place that prints.

mod args;
mod environment;
mod points;
mod print;
mod progress;
mod run;
mod samples;
mod sky;
mod view;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::sync::Once;

use clap::Parser;
use lumel::Error;

/// The scene or a file is bad.
const BAD_INPUT: u8 = 1;
/// The command was used wrongly; clap exits with the same code.
const WRONG_USE: u8 = 2;
/// Done, but less than was asked.
const SHORTFALL: u8 = 3;
/// 128 + SIGINT, what shells report for a program that Ctrl-C ended.
const INTERRUPTED: u8 = 130;

fn main() -> ExitCode {
    let args = args::Args::parse();
    std::panic::set_hook(Box::new(|panic| {
        // Workers may fail together; one report is enough.
        static FIRST: Once = Once::new();
        FIRST.call_once(|| {
            print::error(&format!(
                "internal: {panic}; please report it together with the scene"
            ));
        });
    }));
    // Unwinding instead of exiting in the hook, so that temporary files are removed.
    let outcome = catch_unwind(AssertUnwindSafe(|| run::run(&args.command)));
    ExitCode::from(match outcome {
        Ok(Ok(run::Outcome::Done)) => 0,
        Ok(Ok(run::Outcome::Shortfall)) => SHORTFALL,
        Ok(Err(Error::Interrupted)) => {
            print::note(args.command.interrupted());
            INTERRUPTED
        }
        Ok(Err(error)) => {
            print::error(&error.to_string());
            match error {
                Error::InvalidOption { .. } => WRONG_USE,
                _ => BAD_INPUT,
            }
        }
        Err(_) => BAD_INPUT,
    })
}
