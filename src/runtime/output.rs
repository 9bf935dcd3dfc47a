//! The only place that writes results to stdout and messages to stderr.

use std::cell::RefCell;
use std::fmt::{Display, Write as _};
use std::fs::File;
use std::io::{BufRead as _, IsTerminal, Write};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use rustix::fs::{FileType, fstat};
use rustix::io::Errno;
use serde::Serialize;

use crate::report::Document;
use crate::report::terminal::{COLUMNS, Row};
use crate::runtime::failure::{Failure, INTERNAL};
use crate::runtime::{progress, signals};
use drivebench_model::text::lines::{folded, wrapped};

pub(crate) use drivebench_model::text::shell::{quoted, quoted_word};

/// Narrower than any terminal that shows a table.
const FEWEST_COLUMNS: usize = 40;

/// Prints a result as one JSON document, or as the text that `text` makes of it, in rows that fit.
pub fn result<T: Serialize>(
    value: &T,
    json: bool,
    text: impl FnOnce(&T) -> String,
) -> Result<(), Failure> {
    unfolded(value, json, |value| folded(&text(value), columns()).join("\n"))
}

/// The same with the lines of the text as they are: what is read by a program, or is fitted already.
pub(crate) fn unfolded<T: Serialize>(
    value: &T,
    json: bool,
    text: impl FnOnce(&T) -> String,
) -> Result<(), Failure> {
    if json {
        let document = serde_json::to_string_pretty(value)
            .map_err(|error| Failure::internal(format!("the result has no JSON form: {error}")))?;
        line(&document)
    } else {
        line(text(value).trim_end())
    }
}

/// Prints a result in rows that fit.
pub(crate) fn text(text: &str) -> Result<(), Failure> {
    line(&folded(text.trim_end(), columns()).join("\n"))
}

/// Prints a result as one JSON object, or its document: all of it, or the card that fits a screenful.
pub(crate) fn document<T: Serialize>(
    value: &T,
    json: bool,
    full: bool,
    document: &Document,
) -> Result<(), Failure> {
    unfolded(value, json, |_| {
        if full {
            let rows = document.full(columns());
            rows.iter().map(Row::to_string).collect::<Vec<_>>().join("\n")
        } else {
            document.card(columns())
        }
    })
}

/// The lines of a text in rows that fit.
pub(crate) fn fitted(text: &str) -> Vec<String> {
    wrapped(text, columns())
}

/// Columns that a result may have.
pub(crate) fn columns() -> usize {
    columns_of(&std::io::stdout())
}

fn columns_of(stream: &impl IsTerminal) -> usize {
    let own = stream.is_terminal().then(crossterm::terminal::size);
    let own = own.and_then(Result::ok).map(|(columns, _)| usize::from(columns));
    own.map_or(COLUMNS, |own| own.clamp(FEWEST_COLUMNS, COLUMNS))
}

/// Appends each item as a line of its own, with these words before it.
pub(crate) fn lines<T: Display>(text: &mut String, lead: &str, items: impl IntoIterator<Item = T>) {
    for item in items {
        let _ = writeln!(text, "{lead}{item}");
    }
}

/// One line (or block) on stdout, flushed. A reader that went away is not an error of ours.
pub(crate) fn line(text: &str) -> Result<(), Failure> {
    let _whole = signals::writing();
    let mut stdout = std::io::stdout().lock();
    match writeln!(stdout, "{text}").and_then(|()| stdout.flush()) {
        Err(error) if !is_gone(&error) => {
            let headline = format!("cannot write the result: {error}");
            let help = "make room where standard output goes, or send it elsewhere";
            Err(Failure::with_help(INTERNAL, headline, help))
        }
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

/// One question to a person at a terminal; none where there is nobody to ask. A terminal that is gone gives no answer.
pub(crate) fn ask(question: &str) -> Option<String> {
    let (stdin, mut stderr) = (std::io::stdin(), std::io::stderr());
    if !stdin.is_terminal() || !stderr.is_terminal() {
        return None;
    }
    let mut line = String::new();
    let asked = write!(stderr, "{question}").and_then(|()| stderr.flush());
    let heard = asked.and_then(|()| stdin.lock().read_line(&mut line));
    Some(heard.map_or_else(|_| String::new(), |_| line))
}

/// Results are never overwritten; to be asked before the work, with the option that named the file.
pub(crate) fn refuse_existing(path: &Path, option: &str) -> Result<(), Failure> {
    if path.exists() {
        let headline = format!("{}: exists already, and nothing is overwritten", path.display());
        let help = format!("give another name to {option}, or move this one away");
        return Err(Failure::usage(headline, help));
    }
    Ok(())
}

/// A new file, whole or not at all as far as a signal is concerned.
pub(crate) fn file(path: &Path, content: &(impl AsRef<[u8]> + ?Sized)) -> Result<(), Failure> {
    let _whole = signals::writing();
    let written = File::create_new(path).and_then(|mut file| file.write_all(content.as_ref()));
    written.map_err(|error| cannot_write(path, &error))
}

pub(crate) fn cannot_write(path: &Path, error: &std::io::Error) -> Failure {
    let headline = format!("{}: cannot write: {error}", path.display());
    let help = "name a file that does not exist yet, in a folder that does";
    Failure::usage(headline, help)
}

/// Messages that wait until the screen is left; `None` where there is no screen.
static HELD: Mutex<Option<Vec<String>>> = Mutex::new(None);

fn held() -> MutexGuard<'static, Option<Vec<String>>> {
    HELD.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Whether a screen has the terminal.
pub(crate) fn is_held() -> bool {
    held().is_some()
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

thread_local! {
    /// What this thread's messages go to instead of the terminal, where they belong to a row of a table.
    static ASIDE: RefCell<Option<Vec<String>>> = const { RefCell::new(None) };
}

/// Does something of which the messages are not printed but handed back; nor does it move the progress line.
pub(crate) fn aside<T>(work: impl FnOnce() -> T) -> (T, Vec<String>) {
    ASIDE.with_borrow_mut(|aside| *aside = Some(Vec::new()));
    let done = work();
    let said = ASIDE.take().unwrap_or_default();
    (done, said)
}

/// Whether this thread's messages are handed back.
pub(crate) fn is_aside() -> bool {
    ASIDE.with_borrow(Option::is_some)
}

/// A message for the person at the terminal, above the progress line.
pub fn message(text: &str) {
    let is_taken = ASIDE
        .with_borrow_mut(|aside| aside.as_mut().map(|said| said.push(text.to_owned())).is_some());
    if is_taken {
        return;
    }
    if let Some(waiting) = held().as_mut() {
        return waiting.push(text.to_owned());
    }
    progress::above(|| said(text));
}

/// Rows on stderr that fit; where it is gone there is nobody left to tell.
pub(crate) fn said(text: &str) {
    let mut stderr = std::io::stderr().lock();
    for row in folded(text, columns_of(&stderr)) {
        let _ = writeln!(stderr, "{row}");
    }
}

pub(crate) fn warn(warnings: &[String]) {
    for warning in warnings {
        message(&format!("warning: {warning}"));
    }
}
