//! The screen on which a person finds the missing effect: how good the model is, where it fails, what would improve it.
//!
//! ```text
//! News of the analysis --> DiagnosisScreen::poll --> State::update --> Effect --> Order to the analysis, leave
//! +-------------------------------------------+
//! | title                       working, done |
//! | verdict in one sentence                   |
//! | where it fails: figures, lights, places   |  view
//! | candidates: bars while they are judged,   |
//! |   then status, size, interval             |
//! | ladder: held-out error and noise floor    |
//! | keys                                      |
//! +-------------------------------------------+   over it: pages (card, traces, map, curve, response, next run)
//! ```

mod charts;
mod list;
mod state;
mod view;

#[cfg(test)]
pub(super) mod tests;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError};

use ratatui::Frame;
use ratatui::layout::{Position, Rect};

use super::application::{Effect, Exit, Screen};
use super::keys::Press;
use super::traces::StoppedAt;
use crate::workflow::{News, Order};
use drivebench_diagnose::ErrorOf;
use state::{Event, State};

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Opens {
    /// The search for missing effects begins at once.
    #[default]
    Search,
    /// The same, with the traces shown as soon as they are ready.
    Traces,
    Comparison(ErrorOf),
}

impl Opens {
    /// What the screen opens with after this exit of another screen; `None` where that does not lead here.
    pub const fn after(exit: Exit) -> Option<Self> {
        match exit {
            Exit::Diagnosis => Some(Self::Search),
            Exit::Traces => Some(Self::Traces),
            _ => None,
        }
    }
}

/// Inputs of the screen; the worker holds the other ends of the channels.
#[derive(Debug)]
pub struct DiagnosisSources {
    pub title: String,
    pub opens: Opens,
    /// Where the run was stopped, if it was: the traces open there.
    pub stopped_at: Option<StoppedAt>,
    pub news: Receiver<News>,
    pub orders: Sender<Order>,
    /// Set by signals (SIGTERM, SIGHUP): the screen closes by itself.
    pub hang_up: Arc<AtomicBool>,
}

pub struct DiagnosisScreen {
    state: State,
    sources: DiagnosisSources,
}

impl DiagnosisScreen {
    /// Sends the first order to the worker.
    pub fn new(sources: DiagnosisSources) -> Self {
        // A worker that has ended is noticed by its closed channel.
        let title = sources.title.clone();
        let (order, mut state) = match sources.opens {
            Opens::Comparison(error_of) => {
                (Order::Compare(error_of), State::of_a_comparison(title, error_of))
            }
            _ => (Order::Diagnose, State::new(title)),
        };
        state.opens = sources.opens;
        state.stops_at(sources.stopped_at.clone());
        let _ = sources.orders.send(order);
        Self { state, sources }
    }

    fn act(&mut self, event: Event) -> Option<Exit> {
        match self.state.update(event)? {
            Effect::Leave(exit) => return Some(exit),
            Effect::Order(order) => drop(self.sources.orders.send(order)),
            Effect::Send(_) | Effect::RequestStop => {}
        }
        None
    }
}

impl Screen for DiagnosisScreen {
    fn poll(&mut self) -> (bool, Option<Exit>) {
        let mut is_changed = false;
        loop {
            let waits =
                self.state.working.is_some() || self.state.writing || self.state.response_pending;
            let event = match self.sources.news.try_recv() {
                Ok(news) => Event::News(news),
                Err(TryRecvError::Disconnected) if waits => Event::WorkerEnded,
                Err(_) => break,
            };
            is_changed = true;
            if let Some(exit) = self.act(event) {
                return (true, Some(exit));
            }
        }
        if self.state.is_moving() {
            is_changed = true;
            // A frame has no effect.
            let _ = self.state.update(Event::Frame);
        }
        (is_changed, self.sources.hang_up.load(Ordering::Acquire).then_some(Exit::Interrupted))
    }

    fn press(&mut self, press: Press) -> Option<Exit> {
        self.act(Event::Press(press))
    }

    fn click(&mut self, at: Position, area: Rect) {
        view::click(&mut self.state, at, area);
    }

    fn notify(&mut self, text: &str) {
        self.state.message = Some(text.to_owned());
    }

    fn draw(&self, frame: &mut Frame<'_>) {
        view::view(&self.state, frame);
    }
}
