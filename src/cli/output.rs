//! The only place that writes results to stdout and messages to stderr.

use std::fs::File;
use std::io::Write;
use std::path::Path;

use serde::Serialize;

use super::failure::{Failure, INTERNAL, USAGE};
use super::{interrupt, progress};

/// Prints a result as one JSON document, or as the text that `text` makes of it.
pub(super) fn result<T: Serialize>(
    value: &T,
    json: bool,
    text: impl FnOnce(&T) -> String,
) -> Result<(), Failure> {
    if json {
        let document = serde_json::to_string_pretty(value).map_err(|error| {
            Failure::new(INTERNAL, format!("the result has no JSON form: {error}"))
        })?;
        line(&document)
    } else {
        line(text(value).trim_end())
    }
}

/// One line (or block) on stdout, flushed. A reader that went away is not an error of ours.
pub(super) fn line(text: &str) -> Result<(), Failure> {
    let _whole = interrupt::writing();
    let mut stdout = std::io::stdout().lock();
    match writeln!(stdout, "{text}").and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(Failure::new(
            INTERNAL,
            format!("cannot write the result: {error}"),
        )),
        _ => Ok(()),
    }
}

/// Results are never overwritten; to be asked before the work, with the option that named the file.
pub(super) fn refuse_existing(path: &Path, option: &str) -> Result<(), Failure> {
    if path.exists() {
        let headline = format!(
            "{}: exists already, and nothing is overwritten",
            path.display()
        );
        let help = format!("give another name to {option}, or move this one away");
        return Err(Failure::with_help(USAGE, headline, help));
    }
    Ok(())
}

/// A new file, whole or not at all as far as a signal is concerned.
pub(super) fn file(path: &Path, text: &str) -> Result<(), Failure> {
    let _whole = interrupt::writing();
    let written = File::create_new(path).and_then(|mut file| file.write_all(text.as_bytes()));
    written.map_err(|error| {
        Failure::with_help(
            USAGE,
            format!("{}: cannot write: {error}", path.display()),
            "name a file that does not exist yet, in a folder that does",
        )
    })
}

/// A message for the person at the terminal, above the progress line.
pub(super) fn message(text: &str) {
    progress::above(|| {
        let _ = writeln!(std::io::stderr().lock(), "{text}");
    });
}

pub(super) fn warn(warnings: &[String]) {
    for warning in warnings {
        message(&format!("warning: {warning}"));
    }
}
