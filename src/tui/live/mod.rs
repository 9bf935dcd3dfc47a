//! The screen of a run: motion, estimated parameters, and the steps of the workflow.
//!
//! ```text
//! LiveSources (cells of the worker) --> LiveScreen::poll --> model (what is shown) --update--> Effect --> the worker
//! +-----------------------------------------------+
//! | target, phase, drive, rate, lost      Space = STOP
//! | progress of the run; the step of the workflow |   view
//! | a trip, the end, a question                   |
//! | voltage, current, speed | parameters, link    |   scope | parameters   (or one of the other pages)
//! | notices; keys                                 |
//! +-----------------------------------------------+
//! ```

mod model;
mod scope;
mod view;

#[cfg(test)]
pub(super) mod tests;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;

use ratatui::Frame;
use ratatui::layout::{Position, Rect};

use super::application::{Effect, Exit, Screen};
use super::keys::Press;
use crate::workflow::{ProgressCell, RankingCell};
use drivebench_bench::{Intent, SnapshotCell};
use model::{Event, Model};

pub(super) use view::name as parameter_name;

/// Inputs of the screen; the worker holds the other ends of the channels.
#[derive(Debug)]
pub struct LiveSources {
    pub snapshots: SnapshotCell,
    pub ranking: RankingCell,
    pub workflow: Option<ProgressCell>,
    /// What follows `q` after a completed run, where the program continues: "back to the steps".
    pub followed_by: Option<&'static str>,
    pub intents: Sender<Intent>,
    pub worker: WorkerCell,
    /// Set with every stop: nothing more is to be started, also between two runs, where no intent is read.
    pub stop_requested: Arc<AtomicBool>,
    /// Set by signals (SIGTERM, SIGHUP): the screen closes by itself as soon as the worker has finished.
    pub hang_up: Arc<AtomicBool>,
}

pub struct LiveScreen {
    model: Model,
    sources: LiveSources,
}

impl LiveScreen {
    pub fn new(sources: LiveSources) -> Self {
        let mut model = Model::new(sources.workflow.as_ref().map(ProgressCell::latest));
        model.followed_by = sources.followed_by;
        Self { model, sources }
    }

    fn act(&mut self, event: Event) -> Option<Exit> {
        let mut exit = None;
        for effect in self.model.update(event) {
            match effect {
                // Between two runs no intent is read; `stop_requested` covers that.
                Effect::Send(intent) => drop(self.sources.intents.send(intent)),
                Effect::RequestStop => self.sources.stop_requested.store(true, Ordering::Release),
                Effect::Leave(reason) => exit = Some(reason),
                Effect::Order(_) => {}
            }
        }
        exit
    }

    fn changes(&self) -> Vec<Event> {
        let (model, sources) = (&self.model, &self.sources);
        let mut events = Vec::new();
        // The worker publishes before it finishes: read in the other order, the last snapshot cannot be missed.
        let worker = sources.worker.state(sources.hang_up.load(Ordering::Acquire));
        let snapshot = sources.snapshots.latest();
        if !Arc::ptr_eq(&snapshot, &model.snapshot) {
            events.push(Event::Snapshot(snapshot));
        }
        let ranking = sources.ranking.latest();
        if !Arc::ptr_eq(&ranking, &model.ranking) {
            events.push(Event::Ranking(ranking));
        }
        if let Some(latest) = sources.workflow.as_ref().map(ProgressCell::latest) {
            let shown = model.workflow.as_ref();
            if !shown.is_some_and(|shown| Arc::ptr_eq(shown, &latest)) {
                events.push(Event::Workflow(latest));
            }
        }
        if worker != model.worker {
            events.push(Event::Worker(worker));
        }
        events
    }
}

impl Screen for LiveScreen {
    fn poll(&mut self) -> (bool, Option<Exit>) {
        let changes = self.changes();
        let is_changed = !changes.is_empty() || self.model.message_expires();
        (is_changed, changes.into_iter().find_map(|event| self.act(event)))
    }

    fn press(&mut self, press: Press) -> Option<Exit> {
        self.act(Event::Press(press))
    }

    fn click(&mut self, at: Position, _: Rect) {
        // A click never closes the screen.
        let _ = self.act(Event::Press(Press::Click(at)));
    }

    fn notify(&mut self, text: &str) {
        self.model.notify(text);
    }

    fn may_suspend(&mut self) -> bool {
        self.model.may_suspend()
    }

    fn ends_with_a_panic(&self) -> bool {
        self.model.is_finished()
    }

    fn draw(&self, frame: &mut Frame<'_>) {
        view::view(&self.model, frame);
    }
}

/// Whether the thread that does the work still works.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum WorkerState {
    #[default]
    Working,
    /// Nothing more will happen; the screen stays until it is closed.
    Finished,
    /// Nothing more will happen, and after SIGTERM or SIGHUP no key may come: the screen closes.
    Leave,
}

/// Set by the worker at its end.
#[derive(Clone, Debug, Default)]
pub struct WorkerCell(Arc<AtomicBool>);

impl WorkerCell {
    /// The work counts as over when what is returned is dropped: held by the worker, it covers every return and a panic.
    #[must_use = "the work counts as finished as soon as this is dropped"]
    pub fn finish_on_drop(&self) -> FinishOnDrop {
        FinishOnDrop(self.clone())
    }

    pub fn is_finished(&self) -> bool {
        self.state(false) != WorkerState::Working
    }

    fn state(&self, hang_up: bool) -> WorkerState {
        match (self.0.load(Ordering::Acquire), hang_up) {
            (false, _) => WorkerState::Working,
            (true, false) => WorkerState::Finished,
            (true, true) => WorkerState::Leave,
        }
    }
}

#[derive(Debug)]
pub struct FinishOnDrop(WorkerCell);

impl Drop for FinishOnDrop {
    fn drop(&mut self) {
        self.0.0.store(true, Ordering::Release);
    }
}
