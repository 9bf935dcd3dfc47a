//! Model of the live screen, and what each event does to it. Pure: an update returns what the program is to do.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::sync::Arc;

use super::WorkerState;
use crate::tui::application::{Effect, Exit};
use crate::tui::frame::{Help, scrolled};
use crate::tui::keys::Press;
use crate::workflow::{Progress, ProvisionalRanking, Step};
use drivebench_bench::{Intent, Phase, Snapshot, Target};
use drivebench_model::sample::{DriveState, ParameterEstimate, Verdict};

/// Lengths of the time axis that the zoom key goes through, s.
pub(super) const ZOOM_S: [f64; 5] = [10.0, 5.0, 2.0, 1.0, 0.5];

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
    Ranking(Arc<ProvisionalRanking>),
}

/// What scope and parameters show while the view is frozen.
#[derive(Clone, Debug)]
pub(super) struct Frozen {
    snapshot: Arc<Snapshot>,
    parameters: Vec<ParameterEstimate>,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Model {
    pub(super) snapshot: Arc<Snapshot>,
    /// Bars, notices and trips stay live.
    pub(super) frozen: Option<Frozen>,
    pub(super) workflow: Option<Arc<Progress>>,
    pub(super) worker: WorkerState,
    pub(super) ranking: Arc<ProvisionalRanking>,
    pub(super) page: Page,
    pub(super) help: Help,
    /// On hardware a start is confirmed.
    pub(super) confirm_start: bool,
    pub(super) zoom: usize,
    pub(super) scroll: usize,
    /// Lines that did not fit when the page was drawn: the limit of scrolling.
    pub(super) hidden: Cell<usize>,
    /// Whether needs, results and command of every step are shown, not only of the active one.
    pub(super) explains: bool,
    pub(super) marks: u32,
    /// Message of the last key, and the number of updates for which it remains.
    pub(super) message: Option<String>,
    message_updates: u16,
    /// What follows `q` after a completed run, where the program continues.
    pub(super) followed_by: Option<&'static str>,
    /// The latest value of each parameter, with its time in the run, s: an estimator may have none for a while.
    pub(super) last_values: BTreeMap<String, (ParameterEstimate, f64)>,
    /// Leaves, and why, as soon as the worker has finished.
    pub(super) leaving: Option<Exit>,
    pub(super) interrupts: u8,
}

impl Model {
    pub(super) fn new(workflow: Option<Arc<Progress>>) -> Self {
        let is_over = workflow.as_ref().is_some_and(|own| own.report.is_some());
        Self { page: if is_over { Page::Steps } else { Page::Live }, workflow, ..Self::default() }
    }

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
            let last_values = self.last_values.get(&estimate.key);
            let last_values = last_values.filter(|_| estimate.value.is_none());
            let Some((last, at_s)) = last_values.filter(|(_, at_s)| *at_s <= viewed.elapsed_s)
            else {
                return estimate.clone();
            };
            let age_s = viewed.elapsed_s - at_s;
            let now = estimate.reason.as_deref().unwrap_or("none now");
            ParameterEstimate {
                // Its former verdict does not hold now.
                verdict: Verdict::Searching,
                reason: Some(format!("value of {age_s:.1} s ago; {now}")),
                code: estimate.code,
                ..last.clone()
            }
        });
        shown.collect()
    }

    pub(super) fn shows_report(&self) -> bool {
        let workflow = self.workflow.as_ref();
        workflow.is_some_and(|workflow| workflow.report.is_some())
    }

    /// Whether a commissioning or a single run is complete, and can be diagnosed by hand.
    pub(super) fn can_diagnose(&self) -> bool {
        let has_run = self.workflow.is_none() && self.snapshot.outcome == Some("done");
        self.is_finished() && (self.shows_report() || has_run)
    }

    /// Whether the drive's output may be on by the last snapshot.
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
            Event::Ranking(ranking) => self.ranking = ranking,
            Event::Snapshot(snapshot) => {
                self.keep_values(&snapshot);
                self.snapshot = snapshot;
                self.confirm_start &= self.waits_for_start();
            }
            Event::Workflow(workflow) => {
                if workflow.report.is_some() && !self.shows_report() {
                    // The report is shown as soon as it is there.
                    self.page = Page::Steps;
                    self.scroll = 0;
                }
                self.workflow = Some(workflow);
            }
        }
        Vec::new()
    }

    /// Keeps the present values that physics allows. Values of another run are dropped; after the run only its last ones are
    /// shown.
    fn keep_values(&mut self, snapshot: &Snapshot) {
        let is_over = !snapshot.phase.is_some_and(Phase::is_recorded);
        if is_over || snapshot.name != self.snapshot.name {
            self.last_values.clear();
        }
        if is_over {
            return;
        }
        for estimate in snapshot.estimates.iter() {
            if estimate.verdict == Verdict::Invalid {
                self.last_values.remove(&estimate.key);
            } else if estimate.value.is_some() {
                let last_values = (estimate.clone(), snapshot.elapsed_s);
                self.last_values.insert(estimate.key.clone(), last_values);
            }
        }
    }

    /// One update has passed; whether the message of the last key has expired with it.
    pub(super) fn message_expires(&mut self) -> bool {
        self.message_updates = self.message_updates.saturating_sub(1);
        self.message_updates == 0 && self.message.take().is_some()
    }

    pub(super) fn quit_label(&self) -> &'static str {
        // Without a confirmed stop no step follows.
        let is_sure = self.snapshot.stop_error.is_none();
        let is_done = self.is_finished() && is_sure && self.snapshot.outcome == Some("done");
        self.followed_by.filter(|_| is_done).unwrap_or("quit")
    }

    fn worker_is(&mut self, state: WorkerState) -> Vec<Effect> {
        self.worker = state;
        // The reason, for instance a failed check, is printed after the screen.
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
            _ if self.help.press(press) => {}
            Press::Yes if confirming && self.waits_for_start() => {
                return vec![Effect::Send(Intent::Start)];
            }
            _ if confirming => self.notify("not started"),
            Press::Quit => return self.quit(),
            Press::Start if !self.waits_for_start() => self.notify("nothing waits for a start"),
            Press::Start if self.is_hardware() => self.confirm_start = true,
            Press::Start => return vec![Effect::Send(Intent::Start)],
            Press::ResetFault if self.is_energised() => self.notify("stop first: Space"),
            Press::ResetFault if self.snapshot.drive_state == Some(DriveState::Fault) => {
                return vec![Effect::Send(Intent::ResetFault)];
            }
            Press::ResetFault => self.notify("the drive reports no fault"),
            Press::Mark if self.is_finished() => self.notify("nothing is recorded any more"),
            Press::Mark => {
                self.marks += 1;
                let text = format!("mark {}", self.marks);
                self.notify(format!("{text} set"));
                return vec![Effect::Send(Intent::Mark(text))];
            }
            Press::Diagnose if self.can_diagnose() => return vec![Effect::Leave(Exit::Diagnosis)],
            Press::Traces if self.can_diagnose() => return vec![Effect::Leave(Exit::Traces)],
            Press::Diagnose | Press::Traces => {
                self.notify("not yet: the diagnosis begins after a completed run");
            }
            Press::Experiment => return self.follow(Step::Experiment, Exit::Experiment),
            Press::SpeedLoop => return self.follow(Step::SpeedLoop, Exit::SpeedLoop),
            Press::Open if self.page != Page::Steps => {
                self.notify("Enter explains the steps of a commissioning: 3 shows them");
            }
            Press::Open => {
                self.explains = !self.explains;
                if self.explains && self.shows_report() {
                    self.notify("each step is explained, below the result: Down");
                }
            }
            Press::Help => self.help.first = Some(0),
            Press::Freeze => {
                let shown = self.frozen.is_none().then(|| Frozen {
                    snapshot: Arc::clone(&self.snapshot),
                    parameters: self.parameters(),
                });
                self.frozen = shown;
                if self.page != Page::Live {
                    self.notify(match self.frozen {
                        Some(_) => "scope and parameters are frozen: f continues",
                        None => "scope and parameters are live again",
                    });
                }
            }
            Press::Zoom if self.page != Page::Live => {
                self.notify("z zooms the scope, which 1 shows");
            }
            Press::Zoom => self.zoom = (self.zoom + 1) % ZOOM_S.len(),
            Press::NextScreen => self.page = self.neighbour(1),
            Press::PreviousScreen => self.page = self.neighbour(self.pages().len() - 1),
            Press::Page(index) => match self.pages().get(index) {
                Some(page) => self.page = *page,
                None => self.notify("a plain run has two pages: a commissioning has its steps"),
            },
            Press::Wheel(rows) if self.page == Page::Live => {
                let zoom = self.zoom.saturating_add_signed(-rows.signum() as isize);
                self.zoom = zoom.min(ZOOM_S.len() - 1);
            }
            Press::Move(_) | Press::Wheel(_) if self.page != Page::Steps => {
                self.notify(match self.workflow {
                    Some(_) => "this page does not scroll: 3 shows the steps, which do",
                    None => "this page does not scroll",
                });
            }
            Press::Move(rows) | Press::Wheel(rows) => {
                self.scroll = scrolled(self.scroll, rows, self.hidden.get());
            }
            other => self.notify(why_nothing(other)),
        }
        Vec::new()
    }

    /// Whether the program may be halted now; else the message has the reason. While the bench is at work every cycle of it counts,
    /// and between two runs the next one may begin at any moment.
    pub(super) fn may_suspend(&mut self) -> bool {
        if !self.is_finished() {
            self.notify("Ctrl-Z: not while the bench is at work: Space stops it first");
        }
        self.is_finished()
    }

    pub(super) fn notify(&mut self, text: impl Into<String>) {
        self.message = Some(text.into());
        self.message_updates = 200;
    }

    /// Leaves for a step that can follow the report; else shows why it cannot.
    fn follow(&mut self, step: Step, exit: Exit) -> Vec<Effect> {
        let Some(workflow) = self.workflow.clone() else {
            self.notify("only a commissioning has further steps");
            return Vec::new();
        };
        match workflow.is_offered(step) {
            Ok(()) if self.is_finished() && self.shows_report() => {
                return vec![Effect::Leave(exit)];
            }
            Ok(()) => self.notify("not yet: it follows the report"),
            Err(reason) => self.notify(format!("{}: {reason}", step.title())),
        }
        Vec::new()
    }

    fn stop(&mut self) -> Vec<Effect> {
        self.notify(match (self.is_finished(), &self.snapshot.stop_error) {
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
        self.notify("stopping, then quit");
        let mut effects = vec![Effect::Send(Intent::Quit), Effect::RequestStop];
        if self.interrupts >= 3 {
            effects.push(Effect::Leave(Exit::Forced));
        }
        effects
    }

    fn quit(&mut self) -> Vec<Effect> {
        if self.is_finished() {
            return vec![Effect::Leave(Exit::Finished)];
        }
        if self.is_energised() {
            self.notify("stop first: Space");
            return Vec::new();
        }
        if self.leaving.is_some() {
            return vec![Effect::Leave(Exit::Quit)];
        }
        // An intent to start may be on its way: the worker must have received this one before the screen closes.
        self.leaving = Some(Exit::Quit);
        self.notify("quitting as soon as the present step ends; q again: now");
        vec![Effect::Send(Intent::Quit), Effect::RequestStop]
    }
}

/// Why a key of another screen does nothing here.
const fn why_nothing(press: Press) -> &'static str {
    match press {
        Press::Yes => "there is no question to answer",
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
