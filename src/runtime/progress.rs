//! One line at the foot of the terminal while a command works: what it does, how far it is, how long it will take.
//!
//! ```text
//! progress(command) .. stage(text, of) .. at(done) .. drop
//!      '-> a thread that redraws the line, after the first second, and wipes it at the end
//! ```
//!
//! Where stderr is no terminal it is a line of its own, a few times a minute: a silent log looks like a hang.

use std::fmt::Write as _;
use std::io::{IsTerminal as _, Write as _};
use std::sync::PoisonError;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::runtime::output::{Destination, Messages, Terminal, WIPE};
use drivebench_diagnose::{Event, Stage};
use drivebench_model::text::number::significant;

/// The work of a command, and when it began.
#[derive(Debug)]
pub(super) struct Work {
    command: &'static str,
    begun: Instant,
    stage: String,
    stage_begun: Instant,
    done: usize,
    /// Zero where nothing is counted.
    of: usize,
    on_terminal: bool,
    /// When a line was written last, where there is no terminal.
    logged: Instant,
}

impl Messages {
    fn draw(&mut self, now: Instant) {
        let Some(work) = &mut self.work else { return };
        let is_shown = matches!(self.destination, Destination::Stderr);
        // What is over within a second needs no progress.
        if !is_shown || now.duration_since(work.begun) < Duration::from_secs(1) {
            return;
        }
        if !work.on_terminal {
            if now.duration_since(work.logged) >= Duration::from_secs(15) {
                work.logged = now;
                let _ = writeln!(std::io::stderr(), "{}", work.text(now));
            }
            return;
        }
        let columns = crossterm::terminal::size().map_or(80, |size| size.0);
        // A line that reaches the last column would be broken in two, of which only one could be wiped.
        let room = usize::from(columns.saturating_sub(1));
        let text: String = work.text(now).chars().take(room).collect();
        let mut stderr = std::io::stderr().lock();
        let _ = write!(stderr, "{WIPE}{text}").and_then(|()| stderr.flush());
        self.is_drawn = true;
    }
}

impl Work {
    fn text(&self, now: Instant) -> String {
        let elapsed_s = now.duration_since(self.begun).as_secs_f64();
        let mut text = format!("{}: {}", self.command, self.stage);
        if self.of > 0 {
            let _ = write!(text, ", {} of {}", self.done, self.of);
        }
        let _ = write!(text, ", {elapsed_s:.0} s");
        let stage_s = now.duration_since(self.stage_begun).as_secs_f64();
        if let Some(remaining_s) = remaining_s(stage_s, self.done, self.of) {
            let rate = significant(self.done as f64 / stage_s, 2);
            let _ = write!(text, ", {rate} a second, about {remaining_s:.0} s left in this step");
        }
        text
    }
}

/// Seconds that the rest of a stage takes at the rate so far; none before anything is done.
fn remaining_s(stage_s: f64, done: usize, of: usize) -> Option<f64> {
    let remaining = of.saturating_sub(done);
    if done == 0 || remaining == 0 {
        return None;
    }
    // The pieces that the threads work on are half done on average.
    let in_work = remaining.min(rayon::current_num_threads()) as f64;
    Some((remaining as f64 - 0.5 * in_work).max(0.0) * stage_s / (done as f64 + 0.5 * in_work))
}

/// The progress line of one command; dropping it wipes the line.
pub struct ProgressLine {
    terminal: Terminal,
    thread: Option<JoinHandle<()>>,
}

impl Drop for ProgressLine {
    fn drop(&mut self) {
        self.terminal.messages().work = None;
        self.terminal.progress_ended().notify_all();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[expect(
    clippy::disallowed_methods,
    reason = "the clock of the progress line: nothing that is computed depends on it"
)]
impl Terminal {
    pub fn progress(&self, command: &'static str) -> ProgressLine {
        let now = Instant::now();
        self.messages().work = Some(Work {
            command,
            begun: now,
            stage: "begins".to_owned(),
            stage_begun: now,
            done: 0,
            of: 0,
            on_terminal: std::io::stderr().is_terminal(),
            logged: now,
        });
        let terminal = self.clone();
        let redraw = move || {
            let mut messages = terminal.messages();
            while messages.work.is_some() {
                let waited = terminal.progress_ended();
                let waited = waited.wait_timeout(messages, Duration::from_millis(200));
                messages = waited.unwrap_or_else(PoisonError::into_inner).0;
                messages.draw(Instant::now());
            }
            messages.wipe();
        };
        let thread = std::thread::Builder::new().name("progress".to_owned());
        // Without the thread there is no line, and nothing else is lost.
        ProgressLine { terminal: self.clone(), thread: thread.spawn(redraw).ok() }
    }

    /// The next part of the work, of which `of` pieces will be counted; zero where nothing is.
    pub fn stage(&self, text: &str, of: usize) {
        if let Some(work) = &mut self.messages().work {
            text.clone_into(&mut work.stage);
            work.stage_begun = Instant::now();
            (work.done, work.of) = (0, of);
        }
    }

    /// `done` pieces of the part are done.
    pub fn at(&self, done: usize) {
        if let Some(work) = &mut self.messages().work {
            work.done = done;
        }
    }

    pub(crate) fn diagnosis(&self, event: Event) {
        let (text, of) = match event {
            Event::Begun { stage, of } => match stage {
                Stage::Baseline => ("fits the given model", of),
                Stage::Screen => ("screens the effects", of),
                Stage::Refit => ("adds the effects one by one", of),
                Stage::Check => ("fits sets of effects together", of),
            },
            Event::Screened { .. } | Event::Refitted { .. } => {
                if let Some(work) = &mut self.messages().work {
                    work.done = (work.done + 1).min(work.of);
                }
                return;
            }
            Event::Accepted { .. } => return,
        };
        self.stage(text, of);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[expect(clippy::disallowed_methods, reason = "any instant serves")]
    fn the_line_shows_count_rate_and_remaining_time() {
        let begun = Instant::now();
        let mut work = Work {
            command: "analyse",
            begun,
            stage: "excites".to_owned(),
            stage_begun: begun + Duration::from_secs(10),
            done: 0,
            of: 0,
            on_terminal: false,
            logged: begun,
        };
        let now = begun + Duration::from_secs(30);
        assert_eq!(work.text(now), "analyse: excites, 30 s");
        (work.done, work.of) = (50, 5000);
        let text = work.text(now);
        let begins = "analyse: excites, 50 of 5000, 30 s, 2.5 a second, about ";
        assert!(text.starts_with(begins) && text.ends_with(" s left in this step"), "{text}");
        for (done, of) in [(0, 20), (20, 20), (0, 0)] {
            assert_eq!(remaining_s(3.0, done, of), None, "{done} of {of}");
        }
        let half = remaining_s(10.0, 10, 20).unwrap();
        assert!(half > 5.0 && half <= 10.0, "{half}");
        assert!(remaining_s(19.0, 19, 20).unwrap() <= 1.0);
    }
}
