//! What the weighing of the runs in hand, and of one that is still to be made, would show: the same linear problem as that of
//! the answer, with a record as the model expects it.

use super::asked::{prepared, starts};
use super::columns::{Around, Linear, linearise};
use super::events::Hypothesis;
use super::follow::Noise;
use super::select::{Reduced, Set};
use super::shown::{SAYS_NOTHING_SLABS, spread_slabs};
use super::solution::{around, present};
use crate::diagnosis::evidence::Evidence;
use crate::identification::noise::FloorSource;
use crate::plant::{Effect, Model, Scenario, State};

/// What a diagnosis found to be random in its runs: what the next one has to see through.
#[derive(Clone, Copy, Debug)]
pub struct Grounds {
    noise: Noise,
    excess: f64,
    /// What the run that is fitted first begins with.
    start: State,
}

impl Grounds {
    pub(in crate::diagnosis) const fn new(noise: Noise, excess: f64, start: State) -> Self {
        Self {
            noise,
            excess,
            start,
        }
    }
}

/// Squared size of a slab, in standard deviations, from which on an effect shows.
pub(in crate::diagnosis) const SHOWS: f64 = 1.0 / (SAYS_NOTHING_SLABS * SAYS_NOTHING_SLABS);

/// The runs in hand around a model.
pub(in crate::diagnosis) struct Foresight {
    hypothesis: Hypothesis,
    asked: Vec<&'static dyn Effect>,
    runs: Vec<Scenario>,
    starts: Vec<State>,
    grounds: Grounds,
}

impl Foresight {
    /// Of `asked`, beside everything that `model` has.
    pub(in crate::diagnosis) fn new(
        model: &Model,
        asked: &[&'static dyn Effect],
        evidence: &Evidence,
        grounds: Grounds,
    ) -> Self {
        let known = evidence.noise.source != FloorSource::None;
        let (speaking, held_out) = evidence.speaking();
        let runs: Vec<Scenario> = speaking.iter().map(|run| prepared(run, known)).collect();
        let own = model.effects.iter().map(|active| active.effect);
        let missing = asked.iter().copied();
        let missing = missing.filter(|effect| !model.has(effect.card().id));
        Self {
            hypothesis: Hypothesis::of(model),
            asked: own.chain(missing).collect(),
            starts: starts(&runs, held_out, grounds.start),
            runs,
            grounds,
        }
    }

    /// For each effect that can be asked for the squared size of a slab in standard deviations, with `new` behind the runs in
    /// hand, of which a row stands for so many; none where the model cannot be followed.
    pub(in crate::diagnosis) fn shown_with(
        &self,
        new: &Scenario,
        stands_for: f64,
    ) -> Option<Vec<(&'static str, f64)>> {
        let scenarios: Vec<&Scenario> = self.runs.iter().collect();
        let noise = self.grounds.noise;
        let mut runs = around(&self.hypothesis, &scenarios, &self.starts, noise, None)?;
        let finer = Noise {
            current_a: noise.current_a / stands_for.sqrt(),
            speed_rad_s: noise.speed_rad_s / stands_for.sqrt(),
            ..noise
        };
        let model = &self.hypothesis.model;
        runs.push(Around::new(model, new, State::default(), finer)?);
        let linear = linearise(&self.hypothesis, &self.asked, &runs, false)?;
        let set = present(&linear);
        let reduced = Reduced::new(linear, self.grounds.excess, true)?;
        Some(shown(&reduced, &set, self.grounds.excess))
    }
}

/// Fall of the log odds within which a form may turn out to be the likeliest once the run is made.
const MAY_BE_LIKELIEST_NATS: f64 = 3.0;

/// Of each effect beside a set, in the form that shows least of those that may be the likeliest.
fn shown(reduced: &Reduced, set: &Set, excess: f64) -> Vec<(&'static str, f64)> {
    let linear: &Linear = &reduced.linear;
    let mut all: Vec<(&'static str, f64)> = Vec::new();
    for (k, candidate) in linear.candidates.iter().enumerate() {
        if candidate.in_model || candidate.is_unknown() {
            continue;
        }
        let others = reduced.columns(&reduced.cleared(set, k));
        let logs = reduced.conditional(&others, k);
        let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let forms = logs.iter().enumerate();
        let least = most - MAY_BE_LIKELIEST_NATS;
        let forms = forms.filter(|(_, log)| log.total_cmp(&least).is_ge());
        let squares = forms.map(|(form, _)| {
            let spread = spread_slabs(reduced, set, excess, [k, form]);
            spread.map_or(0.0, |spread| spread.powi(-2))
        });
        let square = squares.fold(f64::INFINITY, f64::min);
        match all.iter_mut().find(|own| own.0 == candidate.id) {
            Some(own) => own.1 = own.1.max(square),
            None => all.push((candidate.id, square)),
        }
    }
    all
}
