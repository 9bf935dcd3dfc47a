//! State of the diagnosis screen, and what each event does to it. Pure: an update returns what the program is to do.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::sync::Arc;

use super::Opens;
use super::list::{Judged, Row};
use crate::tui::application::{Effect, Exit};
use crate::tui::frame::{Help, scrolled};
use crate::tui::keys::Press;
use crate::tui::response::ResponsePage;
use crate::tui::traces::{FRAMES, StoppedAt, TracesPage};
use crate::workflow::{News, Order};
use drivebench_diagnose::{
    AddResult, AxisMap, Candidate, Comparison, Diagnosis, EffectCurve, ErrorOf, Event as Found,
    NextExperiment,
};
use drivebench_identify::noise::{FloorSource, NoiseFloor};
use drivebench_model::plant::effect::Axis;

const LEAVING: &str =
    "leaves when the model is written; Esc stays, Ctrl-C leaves at once without it";

#[derive(Clone, Debug)]
pub(super) enum Event {
    Press(Press),
    News(News),
    /// The worker has ended and carries out no more orders.
    WorkerEnded,
    /// One frame of a change that is being drawn.
    Frame,
}

/// One model of the ladder, with the change that led to it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Step {
    pub(super) name: String,
    /// Held-out error in units of the noise.
    pub(super) error: f64,
    /// Not significantly above the estimated noise floor.
    pub(super) at_floor: bool,
}

impl Step {
    pub(super) fn new(name: String, error: f64, noise: &NoiseFloor) -> Self {
        Self { name, error, at_floor: noise.is_at_the_floor(error) }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Over {
    #[default]
    Nothing,
    /// The card of the selected effect, from this line on.
    Card(usize),
    /// The map of the worse equation, or of the other one.
    Map(usize),
    /// Open questions and the recommended run, from this line on.
    Next(usize),
    /// This one of [`State::drawn`], the cursor on this point, where it is on one.
    Curve(usize, Option<usize>),
    Traces,
    Response,
}

#[derive(Clone, Debug, Default)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "independent facts, each set and cleared by its own event"
)]
pub(super) struct State {
    pub(super) title: String,
    /// How the run was stopped, in a few words, where it did not go to its end.
    pub(super) stopped: Option<String>,
    /// What the screen opened with, until another order.
    pub(super) opens: Opens,
    pub(super) working: Option<String>,
    pub(super) comparison: Option<Arc<Comparison>>,
    pub(super) judged: BTreeMap<&'static str, Judged>,
    /// Effects that the search has accepted so far, with the held-out error then.
    pub(super) accepted: Vec<(&'static str, f64)>,
    /// None while the search is under way.
    pub(super) diagnosis: Option<Arc<Diagnosis>>,
    pub(super) next: Option<Arc<NextExperiment>>,
    /// It is still being computed.
    pub(super) next_pending: bool,
    pub(super) traces: TracesPage,
    pub(super) response: ResponsePage,
    /// It is being estimated, or waits for the analysis to be idle.
    pub(super) response_pending: bool,
    /// The error alone, and the effects that can be drawn through it.
    pub(super) curves: Vec<Arc<EffectCurve>>,
    /// Frames until the fall of the error is drawn.
    pub(super) falling: u8,
    pub(super) present: Vec<&'static str>,
    pub(super) ladder: Vec<Step>,
    /// Result of the last effect that was added or removed.
    pub(super) change: Option<(bool, Arc<AddResult>)>,
    /// The model before that change is shown.
    pub(super) before: bool,
    /// The selected row; none before the first move.
    pub(super) selected: Option<&'static str>,
    pub(super) over: Over,
    pub(super) help: Help,
    /// Rows that did not fit when the page was drawn: the limit of scrolling.
    pub(super) hidden: Cell<usize>,
    /// The model is being written.
    pub(super) writing: bool,
    /// The screen closes as soon as it is written.
    pub(super) leaving: bool,
    pub(super) message: Option<String>,
    pub(super) failure: Option<String>,
}

impl State {
    pub(super) fn new(title: String) -> Self {
        Self { title, working: Some("fitting the model".to_owned()), ..Self::default() }
    }

    /// The run was stopped there: the traces open at that place.
    pub(super) fn stops_at(&mut self, stop: Option<StoppedAt>) {
        self.stopped = stop.as_ref().map(|stop| stop.text.clone());
        self.traces.opens_at = stop;
    }

    /// The screen of a comparison alone: nothing is searched before `d`.
    pub(super) fn of_a_comparison(title: String, error_of: ErrorOf) -> Self {
        Self {
            opens: Opens::Comparison(error_of),
            working: Some("comparing".to_owned()),
            ..Self::new(title)
        }
    }

    pub(super) const fn is_a_comparison(&self) -> bool {
        matches!(self.opens, Opens::Comparison(_))
    }

    /// Whether there is a comparison and no search was ordered.
    pub(super) fn only_compares(&self) -> bool {
        self.is_a_comparison() && self.working.is_none() && self.comparison.is_some()
    }

    /// Whether the traces are shown: opened by their key, or as the page of a comparison.
    pub(super) fn shows_traces(&self) -> bool {
        match self.over {
            Over::Traces => true,
            Over::Nothing => self.only_compares(),
            _ => false,
        }
    }

    /// Whether something is being drawn frame by frame; it ends by itself.
    pub(super) const fn is_moving(&self) -> bool {
        self.falling > 0 || self.traces.is_moving()
    }

    /// Share of the fall of the error that is drawn.
    pub(super) fn fallen_share(&self) -> f64 {
        1.0 - f64::from(self.falling) / f64::from(FRAMES)
    }

    /// The curves of the curve page: that of the selected effect, where it has one, else the error alone; then the axis maps of
    /// an unexplained error, each with its index in the diagnosis.
    pub(super) fn drawn(&self) -> Vec<(Arc<EffectCurve>, Option<usize>)> {
        let selected = self.row().and_then(|row| row.effect()).map(|effect| effect.card().id);
        let of = |id: Option<&str>| self.curves.iter().find(|curve| curve.effect == id);
        let own = selected.and_then(|id| of(Some(id))).or_else(|| of(None));
        let mut drawn: Vec<_> = own.map(|own| (Arc::clone(own), None)).into_iter().collect();
        let maps = self.curves().into_iter();
        drawn.extend(maps.map(|(index, map)| (Arc::new(EffectCurve::from(map)), Some(index))));
        drawn
    }

    /// The axis maps of the unexplained error that a table can represent, each with its index in the diagnosis; the clearest
    /// first.
    pub(super) fn curves(&self) -> Vec<(usize, &AxisMap)> {
        let maps = self.diagnosis.iter().flat_map(|found| &found.axis_map);
        maps.enumerate()
            .filter(|(_, map)| map.is_followed() && Axis::from_key(map.axis).is_some())
            .collect()
    }

    pub(super) fn is_floor_known(&self) -> bool {
        let answered = self.diagnosis.as_ref().map(|found| found.noise_floor_from);
        let compared = || self.comparison.as_ref().map(|found| found.noise_floor_from);
        let from = answered.or_else(compared);
        from.is_some_and(|from| from != FloorSource::None)
    }

    pub(super) fn candidate(&self, id: &str) -> Option<&Candidate> {
        self.diagnosis.as_ref()?.candidates.iter().find(|candidate| candidate.effect == id)
    }

    pub(super) fn update(&mut self, event: Event) -> Option<Effect> {
        match event {
            Event::Press(press) => return self.press(press),
            Event::News(news) => self.receive(news),
            Event::Frame => {
                self.falling = self.falling.saturating_sub(1);
                self.traces.frame();
            }
            Event::WorkerEnded => {
                let without_result =
                    self.working.take().is_some() | std::mem::take(&mut self.response_pending);
                if std::mem::take(&mut self.writing) {
                    self.leaving = false;
                    self.fail("the analysis has ended: the model is NOT WRITTEN");
                } else if without_result {
                    self.fail("the analysis has ended without a result");
                }
            }
        }
        (self.leaving && !self.writing).then(|| Effect::Leave(self.exit()))
    }

    fn receive(&mut self, news: News) {
        match news {
            News::Progress(found) => self.found(found),
            News::Compared(comparison) => {
                self.comparison = Some(Arc::from(comparison));
                self.set_before(false);
            }
            News::Diagnosed(diagnosis) => self.diagnosed(*diagnosis),
            News::Traced(traces) => {
                self.traces.take(*traces);
                if self.opens == Opens::Traces {
                    (self.opens, self.over) = (Opens::Search, Over::Traces);
                }
            }
            News::Responded(found) => {
                self.response_pending = false;
                match found {
                    Ok(compared) => {
                        self.response.take(*compared);
                        self.over = Over::Response;
                        self.message = None;
                    }
                    Err(reason) => self.notify(reason),
                }
            }
            News::Curves(curves) => {
                self.curves = curves.into_iter().map(Arc::new).collect();
                if self.is_a_comparison() {
                    // The last news of a comparison.
                    self.working = None;
                }
            }
            News::Recommended(next) => {
                (self.next, self.next_pending) = (next.map(Arc::from), false);
            }
            News::Added(result) => self.changed(true, *result),
            News::Removed(result) => self.changed(false, *result),
            News::Undone { effect, present } => {
                self.ladder.pop();
                (self.present, self.change) = (present, None);
                self.search_begins(effect);
                self.notify(format!("undone: {effect}"));
            }
            News::Written(text) => {
                self.writing = false;
                self.message = Some(text);
            }
            News::NotWritten(reason) => {
                // Leaving would lose the model without its reason.
                (self.writing, self.leaving) = (false, false);
                self.message = Some(format!("NOT WRITTEN: {reason}"));
            }
            News::Failed(reason) => {
                (self.working, self.next_pending) = (None, false);
                self.failure = Some(reason);
            }
        }
    }

    fn found(&mut self, found: Found) {
        match found {
            Found::Begun { .. } => {}
            Found::Screened { effect, share } => {
                self.judged.entry(effect).or_default().share = Some(share);
                self.working = Some("screening: one simulation for each effect".to_owned());
            }
            Found::Refitted { effect, error } => {
                self.judged.entry(effect).or_default().error = Some(error);
                self.working = Some("refitting with each promising effect".to_owned());
            }
            Found::Accepted { effect, holdout } => {
                self.accepted.push((effect, holdout));
                // The next round judges them with the enlarged model.
                self.judged.clear();
                self.working = Some("searching for more".to_owned());
            }
        }
    }

    fn diagnosed(&mut self, diagnosis: Diagnosis) {
        (self.working, self.next_pending) = (None, true);
        self.present = diagnosis.baseline.model.effect_ids();
        if self.ladder.is_empty() {
            let name = match self.present.as_slice() {
                [] => "baseline".to_owned(),
                effects => effects.join(" + "),
            };
            let (error, noise) = (diagnosis.holdout_before, &diagnosis.baseline.noise);
            self.ladder.push(Step::new(name, error, noise));
        }
        self.diagnosis = Some(Arc::new(diagnosis));
    }

    fn changed(&mut self, added: bool, result: AddResult) {
        self.working = None;
        if result.accepted {
            let sign = if added { '+' } else { '-' };
            let name = format!("{sign} {}", result.effect);
            let last = result.ladder.last();
            let step = last.map(|rung| Step::new(name, rung.holdout_rmse, &result.fit.noise));
            self.ladder.extend(step);
            self.falling = FRAMES;
            self.present = result.fit.model.effect_ids();
            self.comparison = Some(Arc::new(result.after.clone()));
            // The search begins anew.
            self.search_begins(result.effect);
        } else if added {
            self.notify(format!("refused: a again adds {} nevertheless", result.effect));
        } else {
            self.notify("refused; u undoes the last change");
        }
        self.set_before(false);
        self.change = Some((added, Arc::new(result)));
    }

    /// Begins a new search, with the cursor on the changed effect.
    fn search_begins(&mut self, changed: &'static str) {
        self.diagnosis = None;
        (self.next, self.next_pending) = (None, false);
        self.curves.clear();
        self.judged.clear();
        self.accepted.clear();
        self.selected = Some(changed);
        self.working = Some("searching for missing effects".to_owned());
    }

    fn press(&mut self, press: Press) -> Option<Effect> {
        self.message = None;
        match press {
            Press::Interrupt => return Some(Effect::Leave(Exit::Interrupted)),
            Press::Stop if self.leaving => self.leaving = false,
            _ if self.leaving => self.notify(LEAVING),
            _ if self.help.press(press) => {}
            Press::Help => self.help.first = Some(0),
            Press::Move(_) | Press::Stop if self.shows_traces() && self.traces.press(press) => {}
            Press::Quit if self.over != Over::Nothing => self.over = Over::Nothing,
            Press::Quit if self.writing => {
                self.leaving = true;
                self.notify(LEAVING);
            }
            Press::Quit => return Some(Effect::Leave(self.exit())),
            Press::Wheel(rows) if self.shows_traces() => {
                self.traces.press(Press::Zoomed(rows < 0));
            }
            Press::Move(rows) | Press::Wheel(rows) => self.go(rows),
            Press::Traces => self.show_traces(),
            Press::Response if self.over == Over::Response => self.over = Over::Nothing,
            _ if self.over == Over::Response && self.response.press(press) => {}
            _ if self.shows_traces() && self.traces.press(press) => {}
            Press::Cursor(way) => self.move_cursor(way),
            // The key opens the page too.
            Press::Worst => {
                self.show_traces();
                self.traces.press(press);
            }
            Press::Open => self.open(),
            Press::Before => self.toggle_before(),
            Press::Map => self.map(),
            Press::Next => self.next(),
            Press::Curve => self.curve(),
            Press::Stop => self.over = Over::Nothing,
            Press::Table if self.is_before_answer() => self.curve(),
            other => match self.order(other) {
                Ok(order) => return Some(Effect::Order(order)),
                Err(reason) => self.notify(reason),
            },
        }
        None
    }

    /// The order of a key; the reason where it gives none.
    fn order(&mut self, press: Press) -> Result<Order, String> {
        match press {
            Press::Diagnose => self.search(),
            Press::Response => self.respond(),
            Press::Add => self.add(),
            Press::Remove => self.remove(),
            Press::Undo => self.undo(),
            Press::Table => self.table(),
            Press::Write => self.write(),
            other => Err(why_nothing(other).to_owned()),
        }
    }

    fn is_before_answer(&self) -> bool {
        let has_curve = matches!(self.over, Over::Curve(..));
        self.diagnosis.is_none() && self.working.is_none() && !has_curve
    }

    const fn exit(&self) -> Exit {
        match self.working {
            Some(_) => Exit::Quit,
            None => Exit::Finished,
        }
    }

    fn notify(&mut self, text: impl Into<String>) {
        self.message = Some(text.into());
    }

    fn fail(&mut self, reason: &str) {
        self.failure = Some(reason.to_owned());
    }

    fn go(&mut self, by: i32) {
        if let Over::Card(line) | Over::Next(line) = &mut self.over {
            *line = scrolled(*line, by, self.hidden.get());
        } else if let Over::Traces | Over::Map(_) | Over::Response = self.over {
            self.notify("this page does not scroll");
        } else if self.only_compares() {
            self.notify(self.why_none());
        } else {
            self.select_by(by);
            if self.row().is_none() {
                self.notify(self.why_none());
            }
        }
    }

    fn open(&mut self) {
        if let Over::Card(_) = self.over {
            self.over = Over::Nothing;
            return;
        }
        match self.row().map(|row| row.key()) {
            Some(key) => {
                // The list may be put in another order while the card is read.
                self.selected = Some(key);
                self.over = Over::Card(0);
            }
            None => self.notify(self.why_none()),
        }
    }

    fn why_none(&self) -> &'static str {
        if self.only_compares() {
            "there is no list of effects yet: d searches for missing effects"
        } else if self.working.is_none() {
            "no effect has been judged"
        } else {
            "not yet: no effect has been judged"
        }
    }

    fn search(&mut self) -> Result<Order, String> {
        if self.only_compares() {
            self.opens = Opens::Search;
            self.begin("fitting the model".to_owned());
            return Ok(Order::Diagnose);
        }
        Err(match &self.working {
            Some(work) => format!("at work already: {work}"),
            None if self.diagnosis.is_some() => {
                "the search is complete: the list shows its result".to_owned()
            }
            None => "the analysis has failed: the search is not complete".to_owned(),
        })
    }

    fn why_empty(&self, none: &str) -> String {
        match (&self.working, &self.failure) {
            (Some(work), _) => format!("not yet: {work}"),
            (None, Some(_)) => format!("{none}: the analysis has failed"),
            (None, None) => format!("{none} of these runs"),
        }
    }

    /// Why nothing can be ordered while the worker is at work.
    fn busy(&self) -> Result<(), String> {
        self.working.as_ref().map_or(Ok(()), |work| Err(format!("not yet: {work}")))
    }

    /// The effect of `a` and `r`, with whether it is in the model; the reason where there is none.
    fn chosen(&self) -> Result<(&'static str, bool), String> {
        self.busy()?;
        match self.row() {
            Some(Row::Present(id)) => Ok((id, true)),
            Some(Row::Candidate(candidate)) => Ok((candidate.effect, false)),
            _ => Err(self.why_none().to_owned()),
        }
    }

    fn begin(&mut self, work: String) {
        self.over = Over::Nothing;
        self.failure = None;
        self.working = Some(work);
    }

    fn add(&mut self) -> Result<Order, String> {
        let (id, is_present) = self.chosen()?;
        if is_present {
            return Err(format!("{id} is in the model already: r removes it"));
        }
        // Where the last change was to add this effect and it was refused, it is forced.
        let was_refused = self
            .change
            .as_ref()
            .is_some_and(|(added, result)| *added && !result.accepted && result.effect == id);
        self.begin(format!("refitting with {id}"));
        Ok(if was_refused { Order::Force(id) } else { Order::Add(id) })
    }

    fn remove(&mut self) -> Result<Order, String> {
        let (id, is_present) = self.chosen()?;
        if !is_present {
            return Err(if self.present.is_empty() {
                "the model has no effect yet".to_owned()
            } else {
                format!("{id} is not in the model: a adds it")
            });
        }
        self.begin(format!("refitting without {id}"));
        Ok(Order::Remove(id))
    }

    fn undo(&mut self) -> Result<Order, String> {
        self.busy()?;
        if self.ladder.len() < 2 {
            return Err("there is no change by hand to undo".to_owned());
        }
        self.begin("undoing the last change".to_owned());
        Ok(Order::Undo)
    }

    /// The comparison that is shown: before the last change, or of the present model.
    pub(super) fn compared(&self) -> Option<&Comparison> {
        let before = self.change.as_ref().filter(|_| self.before).map(|(_, result)| &result.before);
        before.or(self.comparison.as_deref())
    }

    fn toggle_before(&mut self) {
        let change = self.change.as_ref();
        let Some((_, result)) = change.filter(|(_, result)| result.accepted) else {
            self.notify("there is no change to compare with");
            return;
        };
        let text = if self.before {
            format!("after the change of {}: the present model", result.effect)
        } else {
            format!("BEFORE the change of {}; b shows the present model", result.effect)
        };
        self.set_before(!self.before);
        self.notify(text);
    }

    /// Comparison and traces of the model before the last change, or of the present one.
    fn set_before(&mut self, before: bool) {
        self.before = before;
        self.traces.set_before(before);
    }

    pub(super) fn has_map(&self) -> bool {
        self.compared().is_some_and(|found| found.map.is_some())
    }

    fn map(&mut self) {
        self.over = match self.over {
            over if self.compared().is_none() => {
                self.notify(self.why_empty("there is no map"));
                over
            }
            _ if !self.has_map() => {
                self.notify("there is no map: speed or current did not vary, or was not measured");
                Over::Nothing
            }
            Over::Map(0) => Over::Map(1),
            Over::Map(_) => Over::Nothing,
            _ => Over::Map(0),
        };
    }

    fn next(&mut self) {
        self.over = match self.over {
            Over::Next(_) => Over::Nothing,
            _ if self.diagnosis.is_none() => {
                self.notify("not yet: the diagnosis is not done");
                self.over
            }
            _ => Over::Next(0),
        };
    }

    fn show_traces(&mut self) {
        self.over = match self.over {
            Over::Traces => Over::Nothing,
            over if self.traces.is_empty() => {
                self.notify(self.why_empty("there are no traces"));
                over
            }
            _ => Over::Traces,
        };
    }

    /// Estimated anew each time: the model may have changed.
    fn respond(&mut self) -> Result<Order, String> {
        if self.response_pending {
            let text = "not yet: the frequency response comes when the analysis is idle";
            return Err(text.to_owned());
        }
        self.response_pending = true;
        self.notify("estimating the frequency response");
        Ok(Order::Respond)
    }

    /// From point to point of the shown curve.
    fn move_cursor(&mut self, way: i32) {
        let Over::Curve(index, at) = self.over else {
            self.notify(why_nothing(Press::Cursor(way)));
            return;
        };
        let points = self.drawn().get(index).map_or(0, |(curve, _)| curve.points.len());
        let first = if way > 0 { 0 } else { points.saturating_sub(1) };
        let next = at.map_or(first, |at| at.saturating_add_signed(way as isize));
        self.over = Over::Curve(index, (points > 0).then(|| next.min(points - 1)));
    }

    /// Goes through the curves: of the selected effect, then those that an unexplained error follows.
    fn curve(&mut self) {
        let curves = self.drawn().len();
        self.over = match self.over {
            over if curves == 0 && (self.working.is_some() || self.comparison.is_none()) => {
                self.notify(self.why_empty("there is no curve"));
                over
            }
            _ if curves == 0 => {
                self.notify(
                    "there is no curve: these runs have too few windows with speed and current",
                );
                Over::Nothing
            }
            Over::Curve(index, _) if index + 1 < curves => Over::Curve(index + 1, None),
            Over::Curve(..) => Over::Nothing,
            _ => Over::Curve(0, None),
        };
    }

    /// Adds the shown curve, else the clearest.
    fn table(&mut self) -> Result<Order, String> {
        self.busy()?;
        let shown = match self.over {
            Over::Curve(index, _) => self.drawn().get(index).map(|(_, index)| *index),
            _ => None,
        };
        if shown == Some(None) {
            let text = "this curve is no table to add: a adds the effect, c shows the next curve";
            return Err(text.to_owned());
        }
        let wanted = |(index, _): &(usize, &AxisMap)| shown.is_none_or(|own| own == Some(*index));
        let Some((index, map)) = self.curves().into_iter().find(wanted) else {
            let text = "there is no curve to add: the error is explained, or follows no axis";
            return Err(text.to_owned());
        };
        let (equation, axis) = (map.equation, map.axis);
        self.begin(format!("fitting the curve of the {equation} error over {axis}"));
        Ok(Order::AddCurve(index))
    }

    fn write(&mut self) -> Result<Order, String> {
        if self.writing {
            return Err("not yet: the model is being written".to_owned());
        }
        self.busy()?;
        if self.ladder.is_empty() {
            return Err("there is no fitted model to write".to_owned());
        }
        // The worker may still plan the next run: the file comes after that.
        self.writing = true;
        self.notify("the model will be written as soon as the analysis is idle");
        Ok(Order::Write)
    }
}

/// Why a key of another screen does nothing here.
fn why_nothing(press: Press) -> &'static str {
    match press {
        Press::Start | Press::Freeze | Press::Mark | Press::ResetFault => {
            "nothing runs here: that key is for the screen of a run"
        }
        Press::Experiment | Press::SpeedLoop => "that key is for the steps page of a commissioning",
        Press::Zoom | Press::Zoomed(_) | Press::Pan(_) | Press::Signals => {
            "zoom, pan and signals belong to the traces: v shows them"
        }
        Press::Cursor(_) => "the cursor belongs to traces and curves: v or c shows them",
        Press::NextScreen | Press::PreviousScreen | Press::Page(_) => {
            "there is one page here: ? lists the keys that show others over it"
        }
        Press::Yes => "there is no question to answer",
        _ => "that key does nothing here: ? lists those that do",
    }
}
