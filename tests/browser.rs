//! A browser without a window: opens a page of ours and gives back what it says of itself.

#![expect(clippy::print_stdout, reason = "a test that cannot run here says why")]

use std::ffi::OsString;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// Names under which Chromium is installed.
const NAMES: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];

/// Milliseconds that the page believes to have. They pass at once while it waits for nothing, so a page that waits for work in another
/// thread keeps a timer running; this many of them last a minute then.
const BUDGET: u32 = 10_000_000;

/// Chromium; `None`, with a message, when it is not installed. `LUMEL_REQUIRE_READERS=1` makes that a failure.
pub(crate) fn find() -> Option<&'static str> {
    let runs = |name: &&str| Command::new(name).arg("--version").output().is_ok();
    let found = NAMES.into_iter().find(runs);
    if found.is_none() {
        let missing = "no Chromium; run .ci/install";
        assert!(
            std::env::var("LUMEL_REQUIRE_READERS").as_deref() != Ok("1"),
            "{missing}"
        );
        println!("skipped: {missing}");
    }
    found
}

/// Opens `page` with `fragment` behind the `#` and returns the JSON that it writes into `<pre id="result">`.
pub(crate) fn result(browser: &str, page: &Path, fragment: &str) -> Value {
    // On a busy machine the process that draws may be given up; the page then never comes to its end. What it says is never asked twice.
    for _ in 0..2 {
        let text = dump(browser, page, fragment);
        if !text.is_empty() {
            return serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text}"));
        }
    }
    panic!("{} says nothing", page.display());
}

/// What the page says in the end; nothing when it did not get there.
fn dump(browser: &str, page: &Path, fragment: &str) -> String {
    let profile = tempfile::tempdir().expect("temporary folder");
    let mut profile_option = OsString::from("--user-data-dir=");
    profile_option.push(profile.path());
    let output = Command::new(browser)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            // Draws on the processor.
            "--enable-unsafe-swiftshader",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--window-size=640,480",
            "--dump-dom",
        ])
        .arg(format!("--virtual-time-budget={BUDGET}"))
        .arg(profile_option)
        .arg(format!("file://{}#{fragment}", page.display()))
        .output()
        .expect("the browser runs");
    let dom = String::from_utf8_lossy(&output.stdout);
    dom.split_once("<pre id=\"result\"")
        .and_then(|(_, rest)| rest.split_once('>'))
        .and_then(|(_, rest)| rest.split_once("</pre>"))
        .map(|(text, _)| text.replace("&quot;", "\"").replace("&amp;", "&"))
        .unwrap_or_default()
}
