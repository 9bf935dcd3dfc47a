//! One line at the foot of the terminal while a command works: what it does, how far it is, how long it will take.
//!
//! ```text
//! begin(command) .. stage(text, of) .. one_done() .. drop
//!      '-> a thread that draws the line from the second second on, again and again, and wipes it at the end
//! ```
//!
//! Where stderr is no terminal it is a line of its own, a few times a minute: a log that is silent for long looks dead.
//! Beside a screen nothing is written at all. Messages go above the line (`output::message`).

use std::fmt::Write as _;
use std::io::{IsTerminal as _, Write as _};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::runtime::output;
use drivebench_diagnose::{Event, Stage};
use drivebench_model::text::number::significant;

/// What is over sooner needs no progress.
const AFTER: Duration = Duration::from_secs(1);
const REDRAW: Duration = Duration::from_millis(200);
/// From line to line where there is no terminal.
const LOGGED: Duration = Duration::from_secs(15);
const FALLBACK_COLUMNS: u16 = 80;
/// Back to the first column, and nothing to the right of it.
const WIPE: &str = "\r\x1b[K";

static LINE: Mutex<Line> = Mutex::new(Line { work: None, is_drawn: false });
static ENDED: Condvar = Condvar::new();

/// The line of the process.
struct Line {
    work: Option<Work>,
    is_drawn: bool,
}

/// What is being done, and since when.
struct Work {
    command: &'static str,
    begun: Instant,
    stage: String,
    stage_begun: Instant,
    done: usize,
    /// Zero where nothing is counted.
    of: usize,
    on_terminal: bool,
    /// When it was told last, where there is no terminal.
    logged: Instant,
}

fn lock() -> MutexGuard<'static, Line> {
    // A line that a panicking thread has left half drawn is wiped like any other.
    LINE.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Line {
    fn wipe(&mut self) {
        if self.is_drawn {
            let _ = write!(std::io::stderr(), "{WIPE}");
            self.is_drawn = false;
        }
    }

    fn draw(&mut self, now: Instant) {
        let Some(work) = &mut self.work else { return };
        if output::is_held() || now.duration_since(work.begun) < AFTER {
            return;
        }
        if !work.on_terminal {
            if now.duration_since(work.logged) >= LOGGED {
                work.logged = now;
                let _ = writeln!(std::io::stderr(), "{}", work.text(now));
            }
            return;
        }
        let columns = crossterm::terminal::size().map_or(FALLBACK_COLUMNS, |size| size.0);
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
        if let Some(left_s) = left_s(stage_s, self.done, self.of) {
            let rate = significant(self.done as f64 / stage_s, 2);
            let _ = write!(text, ", {rate} a second, about {left_s:.0} s left in this step");
        }
        text
    }
}

/// Seconds that the rest of a stage will take if it goes on as it went; none before anything is done.
fn left_s(stage_s: f64, done: usize, of: usize) -> Option<f64> {
    let left = of.saturating_sub(done);
    if done == 0 || left == 0 {
        return None;
    }
    // What each thread has in hand is half done on average.
    let in_hand = left.min(rayon::current_num_threads()) as f64;
    Some((left as f64 - 0.5 * in_hand).max(0.0) * stage_s / (done as f64 + 0.5 * in_hand))
}

/// The progress of one command; the line goes when it is dropped.
pub struct Shown(Option<JoinHandle<()>>);

/// Shows the progress of `command` from now on.
#[expect(
    clippy::disallowed_methods,
    reason = "the clock of the progress line: nothing that is computed depends on it"
)]
pub fn begin(command: &'static str) -> Shown {
    let now = Instant::now();
    lock().work = Some(Work {
        command,
        begun: now,
        stage: "begins".to_owned(),
        stage_begun: now,
        done: 0,
        of: 0,
        on_terminal: std::io::stderr().is_terminal(),
        logged: now,
    });
    let ticker = || {
        let mut line = lock();
        while line.work.is_some() {
            line = ENDED.wait_timeout(line, REDRAW).unwrap_or_else(PoisonError::into_inner).0;
            line.draw(Instant::now());
        }
        line.wipe();
    };
    let thread = std::thread::Builder::new().name("progress".to_owned());
    // Without the thread there is no line, and nothing else is lost.
    Shown(thread.spawn(ticker).ok())
}

impl Drop for Shown {
    fn drop(&mut self) {
        lock().work = None;
        ENDED.notify_all();
        if let Some(thread) = self.0.take() {
            let _ = thread.join();
        }
    }
}

/// The next part of the work, of which `of` pieces will be counted; zero where there is nothing to count.
#[expect(
    clippy::disallowed_methods,
    reason = "the clock of the progress line: nothing that is computed depends on it"
)]
pub fn stage(text: &str, of: usize) {
    if output::is_aside() {
        return;
    }
    if let Some(work) = &mut lock().work {
        text.clone_into(&mut work.stage);
        work.stage_begun = Instant::now();
        (work.done, work.of) = (0, of);
    }
}

/// `done` pieces of the part are done.
pub fn at(done: usize) {
    if let Some(work) = &mut lock().work {
        work.done = done;
    }
}

/// What a diagnosis tells.
pub(crate) fn diagnosis(event: Event) {
    let (text, of) = match event {
        Event::Begun { stage, of } => match stage {
            Stage::Baseline => ("fits the model as it is", of),
            Stage::Screen => ("screens the effects", of),
            Stage::Refit => ("adds the effects one by one", of),
            Stage::Check => ("fits sets of effects together", of),
        },
        Event::Screened { .. } | Event::Refitted { .. } => {
            if let Some(work) = &mut lock().work {
                work.done = (work.done + 1).min(work.of);
            }
            return;
        }
        Event::Accepted { .. } => return,
    };
    stage(text, of);
}

/// Does something to stderr with the line out of the way.
pub(crate) fn above<T>(write: impl FnOnce() -> T) -> T {
    let mut line = lock();
    line.wipe();
    write()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[expect(clippy::disallowed_methods, reason = "any instant serves")]
    fn the_line_says_how_far_how_fast_and_how_long() {
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
    }

    #[test]
    fn the_rest_of_a_stage_is_told_once_something_is_done() {
        assert_eq!(left_s(3.0, 0, 20), None);
        assert_eq!(left_s(3.0, 20, 20), None);
        assert_eq!(left_s(3.0, 0, 0), None);
        let half = left_s(10.0, 10, 20).unwrap();
        assert!(half > 5.0 && half <= 10.0, "{half}");
        assert!(left_s(19.0, 19, 20).unwrap() <= 1.0);
    }
}
