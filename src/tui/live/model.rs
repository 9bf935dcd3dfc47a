//! Model of the live screen, and what each event does to it. Pure: an update returns what the program is to do.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::sync::Arc;

use super::WorkerState;
use crate::tui::application::{Effect, Exit};
use crate::tui::frame::scrolled;
use crate::tui::keys::Press;
use crate::workflow::{Progress, Provisional, Step};
use drivebench_bench::{Intent, Phase, Snapshot, Target};
use drivebench_model::sample::{DriveState, ParameterEstimate, Verdict};

/// Lengths of the time axis that the zoom key goes through, s.
pub(super) const ZOOM_S: [f64; 5] = [10.0, 5.0, 2.0, 1.0, 0.5];
/// Looks at the cells, 25 a second, for which an answer to a key stands where no other key takes it away: then the keys are
/// shown again.
const ANSWER_LOOKS: u16 = 200;
/// This many Ctrl-C leave a worker that does not come back; the drive's watchdog is behind that.
const FORCE: u8 = 3;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Page {
    #[default]
    Live,
    Parameters,
    Steps,
}

impl Page {
    pub(super) const ALL: [Self; 3] = [Self::Live, Self::Parameters, Self::Steps];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Live => "live",
            Self::Parameters => "parameters",
            Self::Steps => "steps",
        }
    }
}

#[derive(Clone, Debug)]
pub(super) enum Event {
    Press(Press),
    Snapshot(Arc<Snapshot>),
    Workflow(Arc<Progress>),
    Worker(WorkerState),
    Leaning(Arc<Provisional>),
}

/// What scope and parameters show while the view is frozen.
#[derive(Clone, Debug)]
pub(super) struct Frozen {
    snapshot: Arc<Snapshot>,
    parameters: Vec<ParameterEstimate>,
}

/// The state of the screen.
#[derive(Clone, Debug, Default)]
pub(super) struct Model {
    pub(super) snapshot: Arc<Snapshot>,
    /// Bars, notices and trips stay live.
    pub(super) frozen: Option<Frozen>,
    pub(super) workflow: Option<Arc<Progress>>,
    pub(super) worker: WorkerState,
    /// What the residual leans on so far.
    pub(super) leaning: Arc<Provisional>,
    pub(super) page: Page,
    /// First row of the help, where it is shown.
    pub(super) help: Option<usize>,
    /// On hardware a start is asked for twice.
    pub(super) confirm_start: bool,
    /// Index into [`ZOOM_S`].
    pub(super) zoom: usize,
    /// First line shown of the steps.
    pub(super) scroll: usize,
    /// Lines for which what scrolls had no room when it was drawn: the keys go no further.
    pub(super) hidden: Cell<usize>,
    /// What each step needs, unlocks and is called, also of those that are not under way.
    pub(super) explains: bool,
    pub(super) marks: u32,
    /// Answer to the last key, and for how many looks it still stands.
    pub(super) message: Option<String>,
    answer_looks: u16,
    /// Where `q` leads when the run has gone to its end, where the program goes on.
    pub(super) leads: Option<&'static str>,
    /// The latest value that each parameter had, with the second of the run: between two of them an estimator may have none.
    pub(super) held: BTreeMap<String, (ParameterEstimate, f64)>,
    /// Leaves, and why, as soon as the worker has finished.
    pub(super) leaving: Option<Exit>,
    pub(super) interrupts: u8,
}

impl Model {
    pub(super) fn new(workflow: Option<Arc<Progress>>) -> Self {
        let is_over = workflow.as_ref().is_some_and(|own| own.report.is_some());
        Self { page: if is_over { Page::Steps } else { Page::Live }, workflow, ..Self::default() }
    }

    /// The snapshot of the scope and the parameters.
    pub(super) fn viewed(&self) -> &Snapshot {
        let frozen = self.frozen.as_ref();
        frozen.map_or(&self.snapshot, |frozen| &frozen.snapshot)
    }

    pub(super) fn is_finished(&self) -> bool {
        self.worker != WorkerState::Working
    }

    /// The parameters as they are shown: where one has no value now, the last that it had in this run, with its age.
    pub(super) fn parameters(&self) -> Vec<ParameterEstimate> {
        if let Some(frozen) = &self.frozen {
            return frozen.parameters.clone();
        }
        let viewed = &self.snapshot;
        let shown = viewed.estimates.iter().map(|estimate| {
            let held = self.held.get(&estimate.key);
            let held = held.filter(|_| estimate.value.is_none());
            let Some((last, at_s)) = held.filter(|(_, at_s)| *at_s <= viewed.elapsed_s) else {
                return estimate.clone();
            };
            let age_s = viewed.elapsed_s - at_s;
            let now = estimate.reason.as_deref().unwrap_or("none now");
            ParameterEstimate {
                // Whatever it was then: now it is not settled.
                verdict: Verdict::Searching,
                reason: Some(format!("value of {age_s:.1} s ago; {now}")),
                ..last.clone()
            }
        });
        shown.collect()
    }

    pub(super) fn shows_report(&self) -> bool {
        let workflow = self.workflow.as_ref();
        workflow.is_some_and(|workflow| workflow.report.is_some())
    }

    /// Whether the whole loop is over, or a run without one went to its end: that can be diagnosed by hand.
    pub(super) fn can_diagnose(&self) -> bool {
        let has_run = self.workflow.is_none() && self.snapshot.outcome == Some("done");
        self.is_finished() && (self.shows_report() || has_run)
    }

    /// Whether the drive's output may be on, as far as the screen knows.
    pub(super) fn is_energised(&self) -> bool {
        let phase = self.snapshot.phase;
        if self.is_finished() || phase.is_some_and(Phase::is_final) {
            return false;
        }
        phase.is_some_and(Phase::is_recorded)
            || self.snapshot.drive_state == Some(DriveState::Running)
    }

    pub(super) fn waits_for_start(&self) -> bool {
        !self.is_finished() && matches!(self.snapshot.phase, Some(Phase::Safe | Phase::Armed))
    }

    pub(super) fn is_hardware(&self) -> bool {
        self.snapshot.target == Target::Hardware
    }

    /// The pages that there are, in the order of the Tab key.
    pub(super) fn pages(&self) -> &'static [Page] {
        let last = if self.workflow.is_some() { 3 } else { 2 };
        &Page::ALL[..last]
    }

    /// The page so many places after the one that is shown.
    pub(super) fn neighbour(&self, by: usize) -> Page {
        let pages = self.pages();
        pages[(pages.iter().position(|page| *page == self.page).unwrap_or(0) + by) % pages.len()]
    }

    pub(super) const fn window_s(&self) -> f64 {
        ZOOM_S[self.zoom]
    }

    pub(super) fn update(&mut self, event: Event) -> Vec<Effect> {
        match event {
            Event::Press(press) => return self.press(press),
            Event::Worker(state) => return self.worker_is(state),
            Event::Leaning(leaning) => self.leaning = leaning,
            Event::Snapshot(snapshot) => {
                self.hold(&snapshot);
                self.snapshot = snapshot;
                self.confirm_start &= self.waits_for_start();
            }
            Event::Workflow(workflow) => {
                if workflow.report.is_some() && !self.shows_report() {
                    // The answer that everything was done for.
                    self.page = Page::Steps;
                    self.scroll = 0;
                }
                self.workflow = Some(workflow);
            }
        }
        Vec::new()
    }

    /// Keeps the values that there are and that physics allows. Those of another run are not those of this one, and when it
    /// is over there are none but the last.
    fn hold(&mut self, snapshot: &Snapshot) {
        let is_over = !snapshot.phase.is_some_and(Phase::is_recorded);
        if is_over || snapshot.name != self.snapshot.name {
            self.held.clear();
        }
        if is_over {
            return;
        }
        for estimate in snapshot.estimates.iter() {
            if estimate.verdict == Verdict::Invalid {
                self.held.remove(&estimate.key);
            } else if estimate.value.is_some() {
                let held = (estimate.clone(), snapshot.elapsed_s);
                self.held.insert(estimate.key.clone(), held);
            }
        }
    }

    /// One look has passed; whether the answer to the last key has stood long enough.
    pub(super) fn forgets(&mut self) -> bool {
        self.answer_looks = self.answer_looks.saturating_sub(1);
        self.answer_looks == 0 && self.message.take().is_some()
    }

    /// Where `q` leads now.
    pub(super) fn quits(&self) -> &'static str {
        // Without a confirmed stop the program goes on to nothing.
        let is_sure = self.snapshot.stop_error.is_none();
        let is_done = self.is_finished() && is_sure && self.snapshot.outcome == Some("done");
        self.leads.filter(|_| is_done).unwrap_or("quit")
    }

    fn worker_is(&mut self, state: WorkerState) -> Vec<Effect> {
        self.worker = state;
        // What it came to, a failed check for instance, is told where the screen was.
        let has_shown_nothing = self.snapshot.phase.is_none() && !self.shows_report();
        let exit = match (state, self.leaving) {
            (WorkerState::Working, _) => None,
            (WorkerState::Finished, None) => has_shown_nothing.then_some(Exit::Finished),
            (WorkerState::Leave, None) => Some(Exit::Finished),
            (_, leaving) => leaving,
        };
        exit.map(Effect::Leave).into_iter().collect()
    }

    fn press(&mut self, press: Press) -> Vec<Effect> {
        self.message = None;
        let confirming = std::mem::take(&mut self.confirm_start);
        match press {
            Press::Stop => return self.stop(),
            Press::Interrupt => return self.interrupt(),
            Press::Move(rows) | Press::Wheel(rows) if self.help.is_some() => {
                let hidden = self.hidden.get();
                self.help = self.help.map(|row| scrolled(row, rows, hidden));
            }
            _ if self.help.is_some() => self.help = None,
            Press::Yes if confirming && self.waits_for_start() => {
                return vec![Effect::Send(Intent::Start)];
            }
            _ if confirming => self.say("not started"),
            Press::Quit => return self.quit(),
            Press::Start if !self.waits_for_start() => self.say("nothing waits for a start"),
            Press::Start if self.is_hardware() => self.confirm_start = true,
            Press::Start => return vec![Effect::Send(Intent::Start)],
            Press::ResetFault if self.is_energised() => self.say("stop first: Space"),
            Press::ResetFault if self.snapshot.drive_state == Some(DriveState::Fault) => {
                return vec![Effect::Send(Intent::ResetFault)];
            }
            Press::ResetFault => self.say("the drive reports no fault"),
            Press::Mark if self.is_finished() => self.say("nothing is recorded any more"),
            Press::Mark => {
                self.marks += 1;
                let text = format!("mark {}", self.marks);
                self.say(format!("{text} set"));
                return vec![Effect::Send(Intent::Mark(text))];
            }
            Press::Diagnose if self.can_diagnose() => return vec![Effect::Leave(Exit::Diagnosis)],
            Press::Traces if self.can_diagnose() => return vec![Effect::Leave(Exit::Traces)],
            Press::Diagnose | Press::Traces => {
                self.say("not yet: the diagnosis begins where a run has gone to its end");
            }
            Press::Experiment => return self.follow(Step::Experiment, Exit::Experiment),
            Press::SpeedLoop => return self.follow(Step::SpeedLoop, Exit::SpeedLoop),
            Press::Open if self.page != Page::Steps => {
                self.say("Enter explains the steps of a commissioning: 3 shows them");
            }
            Press::Open => {
                self.explains = !self.explains;
                if self.explains && self.shows_report() {
                    self.say("each step is explained, below the result: Down");
                }
            }
            Press::Help => self.help = Some(0),
            Press::Freeze => {
                let shown = self.frozen.is_none().then(|| Frozen {
                    snapshot: Arc::clone(&self.snapshot),
                    parameters: self.parameters(),
                });
                self.frozen = shown;
                if self.page != Page::Live {
                    self.say(match self.frozen {
                        Some(_) => "scope and parameters are frozen: f goes on",
                        None => "scope and parameters go on",
                    });
                }
            }
            Press::Zoom if self.page != Page::Live => {
                self.say("z zooms the scope, which 1 shows");
            }
            Press::Zoom => self.zoom = (self.zoom + 1) % ZOOM_S.len(),
            Press::NextScreen => self.page = self.neighbour(1),
            Press::PreviousScreen => self.page = self.neighbour(self.pages().len() - 1),
            Press::Page(index) => match self.pages().get(index) {
                Some(page) => self.page = *page,
                None => self.say("a plain run has two pages: a commissioning has its steps"),
            },
            Press::Wheel(rows) if self.page == Page::Live => {
                let zoom = self.zoom.saturating_add_signed(-rows.signum() as isize);
                self.zoom = zoom.min(ZOOM_S.len() - 1);
            }
            Press::Move(_) | Press::Wheel(_) if self.page != Page::Steps => {
                self.say(match self.workflow {
                    Some(_) => "this page does not scroll: 3 shows the steps, which do",
                    None => "this page does not scroll",
                });
            }
            Press::Move(rows) | Press::Wheel(rows) => {
                self.scroll = scrolled(self.scroll, rows, self.hidden.get());
            }
            other => self.say(why_nothing(other)),
        }
        Vec::new()
    }

    /// Whether the program may be halted now; else it is said why not. While the bench is at work every cycle of it counts,
    /// and between two runs the next one may begin at any moment.
    pub(super) fn may_suspend(&mut self) -> bool {
        if !self.is_finished() {
            self.say("Ctrl-Z: not while the bench is at work: Space stops it first");
        }
        self.is_finished()
    }

    pub(super) fn say(&mut self, text: impl Into<String>) {
        self.message = Some(text.into());
        self.answer_looks = ANSWER_LOOKS;
    }

    /// Leaves for a step that can follow the report; else says why it cannot.
    fn follow(&mut self, step: Step, exit: Exit) -> Vec<Effect> {
        let Some(workflow) = self.workflow.clone() else {
            self.say("only a commissioning goes on from here");
            return Vec::new();
        };
        match workflow.is_offered(step) {
            Ok(()) if self.is_finished() && self.shows_report() => {
                return vec![Effect::Leave(exit)];
            }
            Ok(()) => self.say("not yet: it follows the report"),
            Err(reason) => self.say(format!("{}: {reason}", step.title())),
        }
        Vec::new()
    }

    fn stop(&mut self) -> Vec<Effect> {
        self.say(match (self.is_finished(), &self.snapshot.stop_error) {
            (true, None) => "already over: nothing is energised, q = quit",
            (true, Some(_)) => {
                "already over, its stop NOT confirmed: see that the shaft stands still"
            }
            (false, _) => "STOP sent",
        });
        vec![Effect::Send(Intent::Stop), Effect::RequestStop]
    }

    fn interrupt(&mut self) -> Vec<Effect> {
        self.interrupts = self.interrupts.saturating_add(1);
        if self.is_finished() {
            return vec![Effect::Leave(Exit::Interrupted)];
        }
        self.leaving = Some(Exit::Interrupted);
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
        self.leaving = Some(Exit::Quit);
        self.say("quitting as soon as the work in hand is put down; q again: now");
        vec![Effect::Send(Intent::Quit), Effect::RequestStop]
    }
}

/// Why a key that the program knows does nothing here.
const fn why_nothing(press: Press) -> &'static str {
    match press {
        Press::Yes => "nothing was asked",
        Press::Click(_) => {
            "there is nothing to select here: the wheel zooms the scope and scrolls pages"
        }
        Press::Zoomed(_) | Press::Pan(_) | Press::Cursor(_) | Press::Signals | Press::Worst => {
            "that belongs to the traces after a run: v shows them; z zooms here"
        }
        Press::Other => "that key does nothing here: ? lists those that do",
        _ => "that belongs to the diagnosis, which follows the run: d",
    }
}
