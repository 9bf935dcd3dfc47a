//! What each event does in each state. Pure: it returns what the loop must do.

use std::sync::Arc;

use crossterm::event::KeyEvent;

use super::keys::{self, Press};
use super::model::{Leaving, Model, Screen, ZOOM_S};
use super::show::Exit;
use super::worker::WorkerState;
use crate::bench::{Intent, Snapshot};
use crate::sample::DriveState;
use crate::workflow::Progress;

/// This many Ctrl-C leave a worker that does not come back; the drive's watchdog is behind that.
const FORCE: u8 = 3;

#[derive(Clone, Debug)]
pub(super) enum Event {
    Key(KeyEvent),
    Snapshot(Arc<Snapshot>),
    Workflow(Arc<Progress>),
    Worker(WorkerState),
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Effect {
    Send(Intent),
    /// Nothing more is to be started, also between two runs, where nobody reads intents.
    RequestStop,
    Leave(Exit),
}

impl Model {
    pub(super) fn update(&mut self, event: Event) -> Vec<Effect> {
        match event {
            Event::Key(key) => keys::press(key).map_or_else(Vec::new, |press| self.press(press)),
            Event::Snapshot(snapshot) => {
                self.snapshot = snapshot;
                if !self.waits_for_start() {
                    self.confirm_start = false;
                }
                Vec::new()
            }
            Event::Workflow(view) => {
                let had_report = self.shows_report();
                if !view.report.is_empty() && !had_report {
                    // The answer that everything was done for.
                    self.screen = Screen::Steps;
                    self.scroll = view.steps.len();
                }
                self.workflow = Some(view);
                Vec::new()
            }
            Event::Worker(state) => self.worker_is(state),
        }
    }

    fn worker_is(&mut self, state: WorkerState) -> Vec<Effect> {
        self.worker = state;
        match (state, self.leaving) {
            // What it came to, a failed check for instance, is told where the screen was.
            (WorkerState::Finished, None) if self.has_shown_nothing() => {
                vec![Effect::Leave(Exit::Finished)]
            }
            (WorkerState::Working, _) | (WorkerState::Finished, None) => Vec::new(),
            (_, Some(Leaving::Quit)) => vec![Effect::Leave(Exit::Quit)],
            (_, Some(Leaving::Interrupted)) => vec![Effect::Leave(Exit::Interrupted)],
            (WorkerState::Leave, None) => vec![Effect::Leave(Exit::Finished)],
        }
    }

    fn press(&mut self, press: Press) -> Vec<Effect> {
        self.message = None;
        let confirming = std::mem::take(&mut self.confirm_start);
        match press {
            Press::Stop => return self.stop(),
            Press::Interrupt => return self.interrupt(),
            Press::Scroll(rows) if self.help => {
                let rows = isize::try_from(rows).unwrap_or(0);
                self.help_row = self.help_row.saturating_add_signed(rows);
            }
            _ if self.help => self.help = false,
            Press::Yes if confirming && self.waits_for_start() => return vec![start()],
            _ if confirming => self.say("not started"),
            Press::Quit => return self.quit(),
            Press::Start => return self.start(),
            Press::ResetFault => return self.reset_fault(),
            Press::Mark => return self.mark(),
            Press::Diagnose if self.has_report() => return vec![Effect::Leave(Exit::Diagnosis)],
            Press::Diagnose => self.say("not yet: the diagnosis begins where the report ends"),
            Press::Help => (self.help, self.help_row) = (true, 0),
            Press::Freeze => self.freeze(),
            Press::Zoom => self.zoom = (self.zoom + 1) % ZOOM_S.len(),
            Press::NextScreen => self.turn_to_neighbour(1),
            Press::PreviousScreen => self.turn_to_neighbour(self.screens().len() - 1),
            Press::Screen(index) => {
                if let Some(screen) = self.screens().get(index) {
                    self.screen = *screen;
                }
            }
            Press::Scroll(lines) => {
                self.scroll = self
                    .scroll
                    .saturating_add_signed(isize::try_from(lines).unwrap_or(0));
            }
            Press::Yes | Press::Other => {}
        }
        Vec::new()
    }

    fn say(&mut self, text: impl Into<String>) {
        self.message = Some(text.into());
    }

    fn stop(&mut self) -> Vec<Effect> {
        self.say(if self.is_finished() {
            "already over: nothing is energised, q = quit"
        } else {
            "STOP sent"
        });
        vec![Effect::Send(Intent::Stop), Effect::RequestStop]
    }

    fn interrupt(&mut self) -> Vec<Effect> {
        self.interrupts = self.interrupts.saturating_add(1);
        if self.is_finished() {
            return vec![Effect::Leave(Exit::Interrupted)];
        }
        self.leaving = Some(Leaving::Interrupted);
        self.say("stopping, then quit");
        let mut effects = vec![Effect::Send(Intent::Quit), Effect::RequestStop];
        if self.interrupts >= FORCE {
            effects.push(Effect::Leave(Exit::Forced));
        }
        effects
    }

    fn quit(&mut self) -> Vec<Effect> {
        if self.is_finished() {
            return vec![Effect::Leave(Exit::Finished)];
        }
        if self.is_energised() {
            self.say("stop first: Space");
            return Vec::new();
        }
        if self.leaving.is_some() {
            return vec![Effect::Leave(Exit::Quit)];
        }
        // An intent to start may be under way: the worker must have seen this one before the screen goes.
        self.leaving = Some(Leaving::Quit);
        self.say("quitting as soon as the work in hand is put down; q again: now");
        vec![Effect::Send(Intent::Quit), Effect::RequestStop]
    }

    fn start(&mut self) -> Vec<Effect> {
        if !self.waits_for_start() {
            self.say("nothing waits for a start");
            return Vec::new();
        }
        if self.is_hardware() {
            self.confirm_start = true;
            return Vec::new();
        }
        vec![start()]
    }

    fn reset_fault(&mut self) -> Vec<Effect> {
        if self.is_energised() {
            self.say("stop first: Space");
            Vec::new()
        } else if self.snapshot.drive_state == Some(DriveState::Fault) {
            vec![Effect::Send(Intent::ResetFault)]
        } else {
            self.say("the drive reports no fault");
            Vec::new()
        }
    }

    fn mark(&mut self) -> Vec<Effect> {
        if self.is_finished() {
            self.say("nothing is recorded any more");
            return Vec::new();
        }
        self.marks += 1;
        let text = format!("mark {}", self.marks);
        self.say(format!("{text} set"));
        vec![Effect::Send(Intent::Mark(text))]
    }

    fn freeze(&mut self) {
        self.frozen = if self.frozen.is_some() {
            None
        } else {
            Some(Arc::clone(&self.snapshot))
        };
    }

    fn turn_to_neighbour(&mut self, by: usize) {
        let screens = self.screens();
        let here = screens.iter().position(|screen| *screen == self.screen);
        self.screen = screens[(here.unwrap_or(0) + by) % screens.len()];
    }
}

const fn start() -> Effect {
    Effect::Send(Intent::Start)
}
