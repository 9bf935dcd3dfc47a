//! The only place that writes results to stdout and messages to stderr.

use std::io::Write;

use serde::Serialize;

use super::failure::{Failure, INTERNAL};

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
    let mut stdout = std::io::stdout().lock();
    match writeln!(stdout, "{text}").and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(Failure::new(
            INTERNAL,
            format!("cannot write the result: {error}"),
        )),
        _ => Ok(()),
    }
}

/// A message for the person at the terminal.
pub(super) fn message(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

pub(super) fn warn(warnings: &[String]) {
    for warning in warnings {
        message(&format!("warning: {warning}"));
    }
}
