//! The terminal of the process: results go to stdout, messages and the progress line to stderr. Nothing else writes there.

use std::collections::BTreeSet;
use std::fmt::{Display, Write as _};
use std::fs::File;
use std::io::{BufRead as _, IsTerminal, Write};
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};

use rustix::fs::{FileType, fstat};
use rustix::io::Errno;
use serde::Serialize;

use crate::report::Document;
use crate::report::terminal::{COLUMNS, Row};
use crate::runtime::failure::{Failure, INTERNAL};
use crate::runtime::progress::Work;
use crate::runtime::signals::Interrupts;
use crate::tui::Appearance;
use drivebench_model::text::lines::{folded, wrapped};

pub(crate) use drivebench_model::text::shell::{quoted, quoted_word};

/// Back to the first column, and nothing to the right of it.
pub(super) const WIPE: &str = "\r\x1b[K";

/// The standard streams, made in `main` and handed down. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct Terminal(Arc<Streams>);

#[derive(Debug, Default)]
struct Streams {
    messages: Mutex<Messages>,
    progress_ended: Condvar,
    interrupts: Interrupts,
    /// Set once, from the arguments of the program.
    appearance: OnceLock<Appearance>,
}

/// How a command prints its result.
#[derive(clap::Args, Clone, Copy, Debug)]
pub(crate) struct Form {
    /// Print the whole result; without it at most 100 columns and 30 lines
    #[arg(long)]
    pub(crate) full: bool,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

impl Form {
    /// All of a result that has no card.
    pub(crate) const fn full(json: bool) -> Self {
        Self { full: true, json }
    }
}

/// The messages on stderr, those that wait, and the progress line.
#[derive(Debug, Default)]
pub(super) struct Messages {
    pub(super) destination: Destination,
    pub(super) work: Option<Work>,
    /// The progress line is drawn in the last row of the terminal.
    pub(super) is_drawn: bool,
    printed_once: BTreeSet<&'static str>,
}

#[derive(Debug, Default)]
pub(super) enum Destination {
    #[default]
    Stderr,
    /// A screen uses the terminal: messages are printed when it is left.
    Screen(Vec<String>),
    /// The caller uses the messages, as a row of a table.
    Collected(Vec<String>),
}

impl Messages {
    pub(super) fn wipe(&mut self) {
        if self.is_drawn {
            let _ = write!(std::io::stderr(), "{WIPE}");
            self.is_drawn = false;
        }
    }

    /// What is collected has no `lead`.
    fn message(&mut self, lead: &str, text: &str) {
        match &mut self.destination {
            Destination::Collected(texts) => texts.push(text.to_owned()),
            Destination::Screen(texts) => texts.push(format!("{lead}{text}")),
            Destination::Stderr => {
                self.wipe();
                print_rows(&format!("{lead}{text}"));
            }
        }
    }
}

/// Rows on stderr that fit; a closed stderr is ignored.
fn print_rows(text: &str) {
    let mut stderr = std::io::stderr().lock();
    for row in folded(text, columns_of(&stderr)) {
        let _ = writeln!(stderr, "{row}");
    }
}

/// While it exists a screen uses the terminal; then the messages of that time are printed.
pub(crate) struct ScreenGuard(Terminal);

impl Drop for ScreenGuard {
    fn drop(&mut self) {
        let mut messages = self.0.messages();
        let held = std::mem::take(&mut messages.destination);
        if let Destination::Screen(texts) = held {
            for text in &texts {
                messages.message("", text);
            }
        }
    }
}

impl Terminal {
    /// How screens are shown; before any command is carried out.
    pub(crate) fn set_appearance(&self, appearance: Appearance) {
        let _ = self.0.appearance.set(appearance);
    }

    pub(crate) fn appearance(&self) -> Appearance {
        self.0.appearance.get().copied().unwrap_or_default()
    }

    /// Messages are collected and not printed, and there is no progress line.
    pub(crate) fn collecting() -> Self {
        let terminal = Self::default();
        terminal.messages().destination = Destination::Collected(Vec::new());
        terminal
    }

    /// The messages since then.
    pub(crate) fn collected(&self) -> Vec<String> {
        match &mut self.messages().destination {
            Destination::Collected(texts) => std::mem::take(texts),
            Destination::Stderr | Destination::Screen(_) => Vec::new(),
        }
    }

    pub(super) fn messages(&self) -> MutexGuard<'_, Messages> {
        // A line that a panicking thread has half drawn is wiped like any other.
        self.0.messages.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn progress_ended(&self) -> &Condvar {
        &self.0.progress_ended
    }

    pub(super) fn interrupts(&self) -> &Interrupts {
        &self.0.interrupts
    }

    /// A message for the person at the terminal, above the progress line.
    pub fn message(&self, text: &str) {
        self.messages().message("", text);
    }

    /// The same for what would be repeated run after run; `topic` is what is printed once.
    pub(crate) fn message_once(&self, topic: &'static str, text: &str) {
        let mut messages = self.messages();
        if messages.printed_once.insert(topic) {
            messages.message("", text);
        }
    }

    pub(crate) fn warn(&self, warnings: &[String]) {
        for warning in warnings {
            self.messages().message("warning: ", warning);
        }
    }

    /// From here on a screen uses the terminal.
    pub(crate) fn hold(&self) -> ScreenGuard {
        self.messages().destination = Destination::Screen(Vec::new());
        ScreenGuard(self.clone())
    }

    /// Two paragraphs on stderr, and with `--json` one line for programs before them.
    pub(crate) fn failure(&self, failure: &Failure) {
        let mut messages = self.messages();
        messages.wipe();
        if std::env::args_os().any(|argument| argument == "--json") {
            let _ = writeln!(std::io::stderr(), "{}", failure.json());
        }
        print_rows(&format!("error: {}", failure.headline()));
        print_rows(&format!("help: {}", failure.help()));
    }

    /// Prints a result as one JSON document, or as the text that `text` makes of it, in rows that fit.
    pub fn result<T: Serialize>(
        &self,
        value: &T,
        json: bool,
        text: impl FnOnce(&T) -> String,
    ) -> Result<(), Failure> {
        if json { self.json(value) } else { self.text(&text(value)) }
    }

    pub(crate) fn json<T: Serialize>(&self, value: &T) -> Result<(), Failure> {
        self.line(&serde_json::to_string_pretty(value)?)
    }

    /// Prints a result in rows that fit.
    pub(crate) fn text(&self, text: &str) -> Result<(), Failure> {
        self.line(&folded(text.trim_end(), columns()).join("\n"))
    }

    /// Prints a result as one JSON object, or its document: all of it, or the card that fits a screenful.
    pub(crate) fn document<T: Serialize>(
        &self,
        value: &T,
        form: Form,
        document: &Document,
    ) -> Result<(), Failure> {
        if form.json {
            return self.json(value);
        }
        let text = if form.full {
            document.full(columns()).iter().map(Row::to_string).collect::<Vec<_>>().join("\n")
        } else {
            document.card(columns())
        };
        self.line(text.trim_end())
    }

    /// One line (or block) on stdout, flushed. A reader that closed its end is no error.
    pub(crate) fn line(&self, text: &str) -> Result<(), Failure> {
        let _whole = self.writing();
        let mut stdout = std::io::stdout().lock();
        match writeln!(stdout, "{text}").and_then(|()| stdout.flush()) {
            Err(error) if !is_closed(&error) => Err(Failure::with_help(
                INTERNAL,
                format!("cannot write the result: {error}"),
                "free space at the destination of standard output, or redirect it",
            )),
            _ => Ok(()),
        }
    }

    /// Writes a new file; a signal does not end the program during the write.
    pub(crate) fn file(
        &self,
        path: &Path,
        content: &(impl AsRef<[u8]> + ?Sized),
    ) -> Result<(), Failure> {
        let _whole = self.writing();
        File::create_new(path)
            .and_then(|mut file| file.write_all(content.as_ref()))
            .map_err(|error| cannot_write(path, &error))
    }
}

/// Whether the reader of standard output, a pipe or a terminal, has closed its end.
fn is_closed(error: &std::io::Error) -> bool {
    let of_terminal = || {
        // A terminal that was hung up is no terminal any more, but still a character device.
        fstat(std::io::stdout())
            .is_ok_and(|found| FileType::from_raw_mode(found.st_mode) == FileType::CharacterDevice)
    };
    error.kind() == std::io::ErrorKind::BrokenPipe
        || error.raw_os_error() == Some(Errno::IO.raw_os_error()) && of_terminal()
}

/// The lines of a text in rows that fit.
pub(crate) fn fitted(text: &str) -> Vec<String> {
    wrapped(text, columns())
}

fn columns() -> usize {
    columns_of(&std::io::stdout())
}

/// A terminal narrower than 40 columns counts as one of 40.
fn columns_of(stream: &impl IsTerminal) -> usize {
    let size = stream.is_terminal().then(crossterm::terminal::size).and_then(Result::ok);
    size.map_or(COLUMNS, |(columns, _)| usize::from(columns).clamp(40, COLUMNS))
}

/// Appends each item as a line of its own, with `lead` before it.
pub(crate) fn lines<T: Display>(text: &mut String, lead: &str, items: impl IntoIterator<Item = T>) {
    for item in items {
        let _ = writeln!(text, "{lead}{item}");
    }
}

/// The answer of a person at a terminal; `None` without one. A terminal that is closed gives an empty answer.
pub(crate) fn ask(question: &str) -> Option<String> {
    let (stdin, mut stderr) = (std::io::stdin(), std::io::stderr());
    if !stdin.is_terminal() || !stderr.is_terminal() {
        return None;
    }
    let mut line = String::new();
    let read = write!(stderr, "{question}")
        .and_then(|()| stderr.flush())
        .and_then(|()| stdin.lock().read_line(&mut line));
    Some(read.map_or_else(|_| String::new(), |_| line))
}

/// Results are never overwritten: checked before the work, with the option that named the file.
pub(crate) fn refuse_existing<P: AsRef<Path>>(
    paths: impl IntoIterator<Item = P>,
    option: &str,
) -> Result<(), Failure> {
    let mut paths = paths.into_iter();
    if let Some(path) = paths.find(|path| path.as_ref().exists()) {
        let path = path.as_ref();
        let headline = format!("{}: exists already, and nothing is overwritten", path.display());
        let help = format!("give another name to {option}, or move this one away");
        return Err(Failure::usage(headline, help));
    }
    Ok(())
}

pub(crate) fn cannot_read(path: &Path, error: &std::io::Error) -> Failure {
    Failure::usage(format!("{}: cannot read: {error}", path.display()), "check the path")
}

pub(crate) fn cannot_write(path: &Path, error: &std::io::Error) -> Failure {
    let headline = format!("{}: cannot write: {error}", path.display());
    Failure::usage(headline, "name a file that does not exist yet, in a folder that does")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clones_collect_messages_in_order_and_each_topic_once() {
        let terminal = Terminal::collecting();
        let clone = terminal.clone();
        terminal.message("first");
        clone.warn(&["second".to_owned()]);
        for text in ["third", "not printed"] {
            clone.message_once("topic", text);
        }
        assert_eq!(terminal.collected(), ["first", "second", "third"]);
        assert!(clone.collected().is_empty());
    }
}
