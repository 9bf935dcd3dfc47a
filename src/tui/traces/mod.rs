//! The page of traces: measured and model over time, the residual with its noise band beneath, on one axis.
//!
//! ```text
//! Traces (of the model now, of the one before) --> TracesPage: which run, which signals, window, cursor, worst places
//! keys ------------------------------------------>      '-> view: one panel for each signal chosen, one time axis
//! ```
//!
//! A page of other screens: it takes its own keys and leaves the rest to them. After a change of the model the new
//! traces are drawn over the old ones from left to right, so that every dot is that of one of the two models.

mod view;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use ratatui::layout::Rect;

use super::keys::Press;
use super::plot::LABELS;
use drivebench_diagnose::{Quantity, RunTraces, SignalTrace, Traces};
use drivebench_model::sample::Channel;

pub(super) use view::{strip, view};

/// Frames over which a change of the model is drawn.
pub(super) const FRAMES: u8 = 20;
/// Stretches of a run among which the worst are looked for, and those that a key goes through.
const WORST_PLACES: usize = 8;
/// Share of the window that a pan moves by, and cells that the cursor does: one column in a hundred.
const PAN_SHARE: f64 = 0.5;

/// What a panel shows of a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shows {
    /// Measured, and the model where it gives the signal.
    Both,
    Residual,
}

/// One panel: a signal of the run by its index, and what of it.
pub(super) type Panel = (usize, Shows);

/// Where a run that did not go to its end was stopped, and how in a few words.
#[derive(Clone, Debug, PartialEq)]
pub struct StoppedAt {
    pub run: String,
    pub at_s: f64,
    /// What it was stopped for, where that is not the speed: its panel comes first.
    pub shows: Option<Channel>,
    pub text: String,
}

#[derive(Clone, Debug, Default)]
pub(super) struct TracesPage {
    /// Where the page opens; the whole of the first run where there is none.
    pub(super) opens_at: Option<StoppedAt>,
    traces: Option<Arc<Traces>>,
    /// Of the model before the last change.
    before: Option<Arc<Traces>>,
    /// The two are swapped: the traces of the model before the change are shown.
    is_before: bool,
    run: usize,
    /// Panels that the user chose; `None`: those that fit.
    chosen: Option<Vec<Panel>>,
    /// Shown part of the run, s; `None`: the whole of it.
    window_s: Option<(f64, f64)>,
    cursor_s: Option<f64>,
    /// Which of the worst places the key goes to next.
    worst: usize,
    /// The selected row of the list of signals, where it is open.
    choosing: Option<usize>,
    /// Frames until the change is drawn.
    frames: u8,
}

impl TracesPage {
    /// Takes new traces; those of another model are drawn over the old ones.
    pub(super) fn take(&mut self, traces: Traces) {
        self.set_before(false);
        let traces = Arc::new(traces);
        let old = self.traces.replace(Arc::clone(&traces));
        if let Some(old) = old.filter(|old| old.effects != traces.effects) {
            self.before = Some(old);
            self.frames = FRAMES;
        }
        self.run = self.run.min(traces.runs.len().saturating_sub(1));
        let Some(stop) = self.opens_at.take() else {
            return;
        };
        if let Some(run) = traces.runs.iter().position(|own| own.run == stop.run) {
            self.run = run;
            let to_s = traces.runs[run].span_s().1.min(stop.at_s + 1.0);
            // Two seconds before the stop and one after it.
            let from_s = stop.at_s - 2.0;
            self.cursor_s = Some(stop.at_s.min(to_s));
            self.set_window(f64::midpoint(from_s, to_s), to_s - from_s);
            let panels = self.panels();
            let is_first = |(index, _): &Panel| {
                let quantity = traces.runs[run].signals[*index].quantity;
                stop.shows.is_some_and(|channel| quantity == Quantity::Channel(channel))
            };
            let rest = first_panels(&panels).into_iter().filter(|panel| !is_first(panel));
            let first: Vec<Panel> =
                panels.iter().filter(|panel| is_first(panel)).copied().collect();
            if !first.is_empty() {
                self.chosen = Some(first.into_iter().chain(rest).collect());
            }
        }
    }

    /// Shows the model before the last change, with the one after it as the other; or back.
    pub(super) fn set_before(&mut self, before: bool) {
        if before != self.is_before && self.before.is_some() {
            std::mem::swap(&mut self.traces, &mut self.before);
            self.is_before = before;
            self.frames = 0;
        }
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.traces.is_none()
    }

    pub(super) const fn is_choosing(&self) -> bool {
        self.choosing.is_some()
    }

    pub(super) const fn is_moving(&self) -> bool {
        self.frames > 0
    }

    pub(super) const fn frame(&mut self) {
        self.frames = self.frames.saturating_sub(1);
    }

    pub(super) fn drawn_share(&self) -> f64 {
        1.0 - f64::from(self.frames) / f64::from(FRAMES)
    }

    fn run(&self) -> Option<&RunTraces> {
        self.traces.as_ref()?.runs.get(self.run)
    }

    /// The same signal of the model before the last change.
    fn signal_before(&self, signal: &SignalTrace) -> Option<&SignalTrace> {
        let mut signals = self.before.as_ref()?.runs.get(self.run)?.signals.iter();
        signals.find(|own: &&SignalTrace| own.quantity == signal.quantity && own.has_model())
    }

    /// All panels of the run, in the order of its signals.
    fn panels(&self) -> Vec<Panel> {
        let signals = self.run().map_or(&[][..], |run| &run.signals);
        let of = |(index, signal): (usize, &SignalTrace)| {
            let residual = signal.has_model().then_some((index, Shows::Residual));
            std::iter::once((index, Shows::Both)).chain(residual)
        };
        signals.iter().enumerate().flat_map(of).collect()
    }

    fn window_s(&self) -> (f64, f64) {
        self.window_s.unwrap_or_else(|| self.run().map_or((0.0, 1.0), RunTraces::span_s))
    }

    pub(super) fn press(&mut self, press: Press) -> bool {
        if self.is_empty() {
            return false;
        }
        match press {
            Press::Move(by) if self.choosing.is_some() => {
                let last = self.panels().len().saturating_sub(1);
                let move_on = |at: usize| at.saturating_add_signed(by as isize).min(last);
                self.choosing = self.choosing.map(move_on);
            }
            Press::Open if self.choosing.is_some() => self.toggle(),
            Press::Stop | Press::Signals if self.choosing.is_some() => self.choosing = None,
            Press::Signals => self.choosing = Some(0),
            Press::NextScreen | Press::PreviousScreen => self.next_run(),
            Press::Zoomed(closer) => self.zoom(closer),
            Press::Pan(way) => self.pan(f64::from(way) * PAN_SHARE),
            Press::Cursor(way) => self.move_cursor(way),
            Press::Worst => self.worst(),
            _ => return false,
        }
        true
    }

    fn toggle(&mut self) {
        let panels = self.panels();
        let Some(panel) = self.choosing.and_then(|at| panels.get(at)) else {
            return;
        };
        let mut chosen = self.chosen.take().unwrap_or_else(|| first_panels(&panels));
        if chosen.contains(panel) {
            chosen.retain(|own| own != panel);
        } else {
            chosen.push(*panel);
            chosen.sort_by_key(|own| panels.iter().position(|panel| panel == own));
        }
        self.chosen = Some(chosen);
    }

    /// Sets the cursor where the charts were clicked; whether that was within them.
    pub(super) fn click(&mut self, column: u16, area: Rect) -> bool {
        let (from_s, to_s) = self.window_s();
        let left = area.x + LABELS;
        if self.is_empty() || self.choosing.is_some() || column < left || column >= area.right() {
            return false;
        }
        let share = (f64::from(column - left) + 0.5) / f64::from(area.right() - left);
        self.cursor_s = Some(from_s + share * (to_s - from_s));
        true
    }

    fn next_run(&mut self) {
        let runs = self.traces.as_ref().map_or(1, |traces| traces.runs.len());
        self.run = (self.run + 1) % runs.max(1);
        // Signals, time and places are those of another run.
        (self.chosen, self.choosing) = (None, None);
        (self.window_s, self.cursor_s, self.worst) = (None, None, 0);
    }

    /// The window held within the run, and no closer than a few samples.
    fn set_window(&mut self, middle_s: f64, length_s: f64) {
        let Some(run) = self.run() else { return };
        let (first_s, last_s) = run.span_s();
        let most = run.signals.iter().map(|signal| signal.time_s.len()).max();
        let sample_s = (last_s - first_s) / most.unwrap_or(1).max(1) as f64;
        let whole_s = last_s - first_s;
        let length_s = length_s.max((8.0 * sample_s).min(whole_s));
        if length_s >= whole_s {
            self.window_s = None;
            return;
        }
        let from_s = (middle_s - 0.5 * length_s).clamp(first_s, last_s - length_s);
        self.window_s = Some((from_s, from_s + length_s));
    }

    fn zoom(&mut self, closer: bool) {
        let (from_s, to_s) = self.window_s();
        let middle_s = self.cursor_s.unwrap_or(f64::midpoint(from_s, to_s));
        let factor = if closer { 0.5 } else { 2.0 };
        self.set_window(middle_s, factor * (to_s - from_s));
    }

    fn pan(&mut self, share: f64) {
        let (from_s, to_s) = self.window_s();
        self.set_window(f64::midpoint(from_s, to_s) + share * (to_s - from_s), to_s - from_s);
        // The cursor stays in sight.
        let (from_s, to_s) = self.window_s();
        self.cursor_s = self.cursor_s.map(|at_s| at_s.clamp(from_s, to_s));
    }

    fn move_cursor(&mut self, way: i32) {
        let (from_s, to_s) = self.window_s();
        let middle_s = f64::midpoint(from_s, to_s);
        let moved_s = f64::from(way) * 0.01 * (to_s - from_s);
        let at_s = self.cursor_s.map_or(middle_s, |at_s| at_s + moved_s);
        if at_s < from_s || at_s > to_s {
            self.pan(f64::from(way.signum()) * PAN_SHARE);
        }
        let (first_s, last_s) = self.run().map_or((from_s, to_s), RunTraces::span_s);
        self.cursor_s = Some(at_s.clamp(first_s, last_s));
    }

    /// Goes to the next of the largest errors of the first signal with a model.
    fn worst(&mut self) {
        let places = self.run().and_then(|run| {
            Some(run.signals.iter().find(|signal| signal.has_model())?.worst_places(60))
        });
        let places = places.unwrap_or_default();
        let known = places.len().min(WORST_PLACES);
        if let Some(place) = places.get(self.worst % known.max(1)) {
            self.worst = (self.worst + 1) % known;
            self.cursor_s = Some(place.at_s);
            self.set_window(place.at_s, 4.0 * (place.to_s - place.from_s));
        }
    }

    pub(super) const KEYS: &'static str =
        "j worst place|+ - zoom|, . pan|Left Right cursor|o signals|Tab other run";
}

/// The panels before a choice: all signals of the model, with their residuals.
fn first_panels(panels: &[Panel]) -> Vec<Panel> {
    let has_residual = |index: usize| panels.contains(&(index, Shows::Residual));
    let of_the_model: Vec<Panel> =
        panels.iter().filter(|(index, _)| has_residual(*index)).copied().collect();
    if of_the_model.is_empty() { panels.to_vec() } else { of_the_model }
}
