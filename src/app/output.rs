//! The only place that writes results to stdout and messages to stderr.

use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use rustix::fs::{FileType, fstat};
use rustix::io::Errno;
use serde::Serialize;

use super::failure::{Failure, INTERNAL, USAGE};
use super::{progress, signals};

/// Prints a result as one JSON document, or as the text that `text` makes of it.
pub(crate) fn result<T: Serialize>(
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
pub(crate) fn line(text: &str) -> Result<(), Failure> {
    let _whole = signals::writing();
    let mut stdout = std::io::stdout().lock();
    match writeln!(stdout, "{text}").and_then(|()| stdout.flush()) {
        Err(error) if !is_gone(&error) => Err(Failure::new(
            INTERNAL,
            format!("cannot write the result: {error}"),
        )),
        _ => Ok(()),
    }
}

/// Whether the reader has gone: of a pipe, or of a terminal that was closed.
fn is_gone(error: &std::io::Error) -> bool {
    let of_terminal = || {
        // A terminal that was hung up is none any more, but still a device of characters.
        fstat(std::io::stdout())
            .is_ok_and(|found| FileType::from_raw_mode(found.st_mode) == FileType::CharacterDevice)
    };
    error.kind() == std::io::ErrorKind::BrokenPipe
        || error.raw_os_error() == Some(Errno::IO.raw_os_error()) && of_terminal()
}

/// Results are never overwritten; to be asked before the work, with the option that named the file.
pub(crate) fn refuse_existing(path: &Path, option: &str) -> Result<(), Failure> {
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
pub(crate) fn file(path: &Path, text: &str) -> Result<(), Failure> {
    let _whole = signals::writing();
    let written = File::create_new(path).and_then(|mut file| file.write_all(text.as_bytes()));
    written.map_err(|error| {
        Failure::with_help(
            USAGE,
            format!("{}: cannot write: {error}", path.display()),
            "name a file that does not exist yet, in a folder that does",
        )
    })
}

/// Messages that wait until the screen is left; `None` where there is no screen.
static HELD: Mutex<Option<Vec<String>>> = Mutex::new(None);

fn held() -> MutexGuard<'static, Option<Vec<String>>> {
    HELD.lock().unwrap_or_else(PoisonError::into_inner)
}

/// While it lives messages wait; then they are printed.
pub(crate) struct Held(());

/// From here on a screen has the terminal.
pub(crate) fn hold() -> Held {
    held().get_or_insert_default();
    Held(())
}

impl Drop for Held {
    fn drop(&mut self) {
        let waiting = held().take();
        for text in waiting.into_iter().flatten() {
            message(&text);
        }
    }
}

/// A message for the person at the terminal, above the progress line.
pub(crate) fn message(text: &str) {
    if let Some(waiting) = held().as_mut() {
        return waiting.push(text.to_owned());
    }
    progress::above(|| {
        let _ = writeln!(std::io::stderr().lock(), "{text}");
    });
}

pub(crate) fn warn(warnings: &[String]) {
    for warning in warnings {
        message(&format!("warning: {warning}"));
    }
}
