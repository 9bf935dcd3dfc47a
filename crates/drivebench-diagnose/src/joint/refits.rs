//! Likelihood-ratio tests by nonlinear refits of the best set of the linear solution (Ljung, *System Identification*, §16.4): an
//! effect that a refit refutes is excluded, and a simpler effect replaces a richer one, or two, that fit no better.

use rayon::prelude::*;

use super::events::Hypothesis;
use super::prediction_error::{Refit, fit};
use super::regression::{Candidate, Linear};
use super::run::LinearisedRun;
use super::select::{Posterior, Reduced, Set, without};
use super::solution::{present, with_event_times};
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::effect::{Axis, CATALOGUE};
use drivebench_model::plant::{
    ActiveEffect, Effect, Input, Model, MotorKey, Scenario, effect, typical_size,
};

/// Prior log odds of an effect that a refit has refuted: practically zero probability. Its negative is added to the log odds of
/// an effect without which a refit is worse.
const BARRED_LOG_ODDS: f64 = -30.0;
/// Gain of the log likelihood from which on a richer or a second effect is preferred: the odds of 300 to 1.
const WORTH_A_SECOND_NATS: f64 = 5.7;

/// Verdict of a refit on the linear solution.
#[derive(PartialEq)]
pub(super) enum RefitVerdict {
    /// The effect is refuted; `probability` is the posterior probability that remains.
    Barred { id: &'static str, probability: f64 },
    /// The effect is confirmed.
    Kept { id: &'static str },
}

/// Applies the verdicts to the prior odds, and excludes the pairs of effects that `one` replaces.
pub(super) fn bar(linear: &mut Linear, verdicts: &[RefitVerdict], one: Option<&'static str>) {
    let one = one.and_then(effect::find);
    for pair in one.map_or(&[][..], |one| one.card().stands_for) {
        let indices = pair.map(|id| linear.candidates.iter().position(|own| own.id == id));
        if let [Some(a), Some(b)] = indices {
            linear.candidates[a].excludes.push(b);
            linear.candidates[b].excludes.push(a);
        }
    }
    for candidate in &mut linear.candidates {
        let log_odds = candidate.log_odds;
        for verdict in verdicts {
            match verdict {
                RefitVerdict::Barred { id, .. } if *id == candidate.id => {
                    candidate.log_odds = BARRED_LOG_ODDS;
                }
                RefitVerdict::Kept { id } if *id == candidate.id => {
                    candidate.log_odds = log_odds - BARRED_LOG_ODDS;
                }
                _ => {}
            }
        }
    }
}

/// Effects of `hypothesis` that the linear solution removed although the refit `next` without them is clearly worse: the linear
/// solution is wrong for effects that are not proportional to their size, for example a delay that shifts impacts.
pub(super) fn needed(
    hypothesis: &Hypothesis,
    next: &Refit,
    runs: &[LinearisedRun<'_>],
) -> Vec<RefitVerdict> {
    let mut removed = hypothesis.model.effect_ids();
    removed.retain(|id| !next.hypothesis.model.has(id));
    let worth_nats = WORTH_A_SECOND_NATS * removed.len() as f64;
    let is_worse = |now: Refit| 0.5 * (next.deviance - now.deviance) > worth_nats;
    if removed.is_empty() || !fit(hypothesis, runs).is_some_and(is_worse) {
        return Vec::new();
    }
    let kept = removed.into_iter().map(|id| RefitVerdict::Kept { id });
    kept.collect()
}

/// Sets the probability of refuted effects to the one that the refit left them, if that is larger.
pub(super) fn keep_doubts(verdicts: &[RefitVerdict], linear: &Linear, posterior: &mut Posterior) {
    for (candidate, p) in linear.candidates.iter().zip(&mut posterior.probability) {
        for verdict in verdicts {
            if let RefitVerdict::Barred { id, probability } = verdict
                && *id == candidate.id
            {
                *p = probability.max(*p);
            }
        }
    }
}

/// Each effect with those that it may replace: first one effect for two that equal it to first order, then the simpler effect
/// that is the limit of a richer one.
fn substitutes() -> impl Iterator<Item = (&'static str, Vec<&'static str>)> {
    let cards = || CATALOGUE.iter().map(|effect| effect.card());
    let for_two =
        cards().flat_map(|card| card.stands_for.iter().map(|two| (card.id, two.to_vec())));
    let at_limit = cards().filter_map(|card| Some((card.limit?.simpler, vec![card.id])));
    for_two.chain(at_limit)
}

/// Least share of the rows in motion with a current between a quarter and three quarters of a boundary: the steps of a voltage pass
/// it in fewer, and a drop and a resistance up to that boundary then have the same values in nearly all rows.
const LEAST_SHARE_INSIDE: f64 = 0.02;

/// Multiple of its limit below which a parameter is at it, by the rounding of a fit.
const AT_LIMIT: f64 = 1.02;
/// Multiple of its limit up to which a parameter may be that of the simpler effect in another form, as the corner of a voltage drop
/// that builds up softly: it lies at 1.3 times the width of a tanh (least squares).
const NEAR_LIMIT: f64 = 1.5;

/// The simpler effect and the richer one of the model whose fitted parameter is below this multiple of its limit. The stall current
/// is that of the model: the scale of the run has the resistance of a fit without the effect.
fn below_limit(model: &Model, scenario: &Scenario, multiple: f64) -> Option<[&'static str; 2]> {
    let largest_input = largest(scenario.events.iter().map(|event| event.1));
    let resistance_ohm = model.motor.get(MotorKey::Resistance);
    let resistance_ohm = resistance_ohm.filter(|_| scenario.input == Input::Voltage);
    model.effects.iter().find_map(|active| {
        let limit = active.effect.card().limit?;
        let resistance_ohm = resistance_ohm.filter(|_| is_over_current(active.effect));
        let factor = resistance_ohm
            .map_or(1.0, |own| (largest_input / own / scenario.scales.current_a).max(1.0));
        let value = active.values_or_guess()[limit.parameter];
        let is_below = value < multiple * factor * limit.least_in(active.effect, scenario);
        is_below.then(|| [limit.simpler, active.id()])
    })
}

fn is_over_current(effect: &dyn Effect) -> bool {
    matches!(effect.card().curve, Some((_, Axis::Current)))
}

/// The simpler effect and the richer one of the model that a run does not distinguish: near the limit where both are equal, or with
/// hardly any row inside the boundary of a current, so that the record has the simpler effect as well.
pub(super) fn not_distinguished(model: &Model, scenario: &Scenario) -> Option<[&'static str; 2]> {
    let outside = model.effects.iter().find_map(|active| {
        let limit = active.effect.card().limit.filter(|_| is_over_current(active.effect))?;
        let share = share_inside(active.values_or_guess()[limit.parameter], scenario);
        (share < LEAST_SHARE_INSIDE).then(|| [limit.simpler, active.id()])
    });
    outside.or_else(|| below_limit(model, scenario, NEAR_LIMIT))
}

/// Share of the rows in motion that have a current of a quarter to three quarters of `boundary_a`.
fn share_inside(boundary_a: f64, scenario: &Scenario) -> f64 {
    let rows = scenario.current_a.iter().zip(&scenario.speed_rad_s);
    let moving: Vec<f64> = rows.filter(|row| row.1.abs() > 0.0).map(|row| row.0.abs()).collect();
    let is_inside = |current_a: &&f64| (0.25..0.75).contains(&(**current_a / boundary_a));
    moving.iter().filter(is_inside).count() as f64 / moving.len().max(1) as f64
}

/// Posterior of the linear solution.
pub(super) struct Weighed<'a> {
    pub(super) hypothesis: &'a Hypothesis,
    pub(super) reduced: &'a Reduced,
    pub(super) posterior: &'a Posterior,
    pub(super) runs: &'a [LinearisedRun<'a>],
}

impl Weighed<'_> {
    /// The effect of the best set, except those `given`, that a refit refutes most clearly, and the model without it. The linear
    /// solution is wrong for effects whose columns depend on their size, for example a large delay.
    pub(super) fn doubtful(&self, given: &[&'static str]) -> Option<(RefitVerdict, Hypothesis)> {
        let best = &self.posterior.best;
        let likelihood = |set: &Set| self.reduced.log_likelihood(&self.reduced.columns(set));
        let of_best = likelihood(best);
        let is_eligible = |(k, candidate): &(usize, &Candidate)| {
            best[*k].is_some() && !candidate.is_unknown() && !given.contains(&candidate.id)
        };
        let candidates = self.reduced.linear.candidates.iter().enumerate();
        let eligible: Vec<(usize, &Candidate)> = candidates.filter(is_eligible).collect();
        if eligible.is_empty() {
            return None;
        }
        // Refit without an effect that the model has, or with one that it lacks.
        let refitted = |(k, candidate): &(usize, &Candidate)| {
            if candidate.in_model {
                return fit(&self.hypothesis.without(candidate.id), self.runs).map(Some);
            }
            let mut with = present(&self.reduced.linear);
            with[*k] = best[*k];
            let start = with_event_times(self.hypothesis, self.reduced, &with, self.runs)?;
            Some(fit(&start, self.runs))
        };
        let (base, refitted) = rayon::join(
            || fit(self.hypothesis, self.runs),
            || {
                let each = eligible.par_iter().with_max_len(1).map(refitted);
                each.collect::<Option<Vec<Option<Refit>>>>()
            },
        );
        let base = base?;
        let removals = eligible.iter().zip(refitted?).map(|((k, candidate), refit)| {
            let promised = of_best - likelihood(&without(best, *k));
            let change = refit.as_ref().map_or(0.0, |refit| 0.5 * (refit.deviance - base.deviance));
            let gained = if candidate.in_model { change } else { -change };
            let left = refit
                .filter(|_| candidate.in_model)
                .map_or_else(|| self.hypothesis.clone(), |left| left.hypothesis);
            let is_kept = candidate.log_odds > 0.0;
            let raised = if is_kept { -BARRED_LOG_ODDS } else { 0.0 };
            let odds = self.posterior.log_factor[*k] - raised - (promised - gained).max(0.0);
            (odds, candidate.id, left)
        });
        let refuted = removals.filter(|own| own.0 < 0.0);
        let (odds, id, left) = refuted.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let probability = 1.0 / (1.0 + (-odds).exp());
        Some((RefitVerdict::Barred { id, probability }, left))
    }

    /// A simpler effect, and the model with it instead of a richer one or of two others that fit no better.
    pub(super) fn simpler(&self, given: &[&'static str]) -> Option<(&'static str, Hypothesis)> {
        let there = &self.hypothesis.model;
        substitutes().find_map(|(simple, others)| {
            let is_open = |id: &&str| there.has(id) && !given.contains(id);
            if there.has(simple) || !others.iter().all(is_open) {
                return None;
            }
            let effect = effect::find(simple)?;
            let unit = effect.parameters()[0].unit;
            let is_one = |active: &&ActiveEffect| others.contains(&active.id());
            let sizes: Vec<f64> = (there.effects.iter().filter(is_one))
                .filter(|active| active.effect.parameters()[0].unit == unit)
                .map(|active| active.values_or_guess()[0])
                .collect();
            let begin = if sizes.is_empty() {
                typical_size(effect, 0, there, self.runs[0].scenario)
            } else {
                sizes.iter().sum::<f64>() / sizes.len() as f64
            };
            let mut start = self.hypothesis.clone();
            start.model.effects.retain(|active| !is_one(&active));
            start.model.effects.push(ActiveEffect::with(effect, &[begin]));
            // The process noise of its form is proportional to the size used for filtering: the second fit uses the fitted size.
            let left = fit(&fit(&start, self.runs)?.hypothesis, self.runs)?;
            let rich = fit(self.hypothesis, self.runs)?;
            // Squares that are 5 % larger: the form differs from that at the limit.
            let limit = below_limit(there, self.runs[0].scenario, AT_LIMIT);
            let is_limit = limit.is_some_and(|[limit, rich]| limit == simple && others == [rich])
                && left.squares < 1.05 * rich.squares;
            let serves = 0.5 * (left.deviance - rich.deviance) < WORTH_A_SECOND_NATS;
            (is_limit || serves).then_some((simple, left.hypothesis))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joint::columns::linearise;
    use crate::joint::kalman::{Noise, QUIET};
    use crate::joint::select::select;
    use crate::kit::{nameplate, record, truth, with};
    use drivebench_model::plant::State;

    const DELAYS: [&str; 3] = ["command_delay", "speed_delay", "current_filter"];

    fn gaps(extra_ohm: f64, boundary_a: f64) -> Model {
        truth("discontinuous_conduction", &[extra_ohm, boundary_a])
    }

    fn linearised<'a>(model: &Model, run: &'a Scenario) -> [LinearisedRun<'a>; 1] {
        let noise = Noise { disturbance_n_m: 1e-4, input: 1e-3, ..QUIET };
        [LinearisedRun::new(model, run, State::default(), noise).unwrap()]
    }

    /// `about` of the posterior of a run of `machine`, linearised about `model` and changed by `change`.
    fn weighed<T>(
        [machine, model]: [&Model; 2],
        eligible: &[&'static str],
        change: impl FnOnce(&mut Linear),
        about: impl FnOnce(&Weighed<'_>) -> T,
    ) -> T {
        let run = record(machine, 0, 7);
        let eligible: Vec<&'static dyn Effect> =
            eligible.iter().map(|id| effect::find(id).unwrap()).collect();
        let (hypothesis, runs) = (Hypothesis::of(model), linearised(model, &run));
        let mut linear = linearise(&hypothesis, &eligible, &runs, false).unwrap();
        change(&mut linear);
        let there = present(&linear);
        let reduced = Reduced::new(linear, 1.0, true).unwrap();
        let posterior = select(&reduced, &[there]);
        about(&Weighed {
            hypothesis: &hypothesis,
            reduced: &reduced,
            posterior: &posterior,
            runs: &runs,
        })
    }

    #[test]
    fn gaps_below_any_converter_are_a_drop_of_brushes() {
        // The least boundary of discontinuous conduction, A.
        let least_boundary_a = 0.9;
        let brushes = ["voltage_drop", "discontinuous_conduction"];
        let run = record(&nameplate(), 0, 1);
        assert_eq!(not_distinguished(&gaps(1.4, least_boundary_a), &run), Some(brushes));
        assert_eq!(not_distinguished(&gaps(1.4, 1.6 * least_boundary_a), &run), None);
        assert_eq!(not_distinguished(&truth("voltage_drop", &[0.9]), &run), None);
        // No row has a current inside the boundary.
        let mut beyond = run;
        beyond.current_a.iter_mut().for_each(|current_a| *current_a = 3f64.copysign(*current_a));
        assert_eq!(not_distinguished(&gaps(1.4, 2.5), &beyond), Some(brushes));
        // A small drop hardly shows, whatever its form; of a large one the form does.
        for (extra_ohm, stands) in [(0.05, true), (4.0, false)] {
            let machine = gaps(extra_ohm, least_boundary_a);
            let simpler = weighed([&machine; 2], &brushes, |_| {}, |own| own.simpler(&[]));
            assert_eq!(simpler.is_some(), stands, "{extra_ohm} ohm");
        }
    }

    #[test]
    fn a_late_command_stands_for_two_late_sensors() {
        let late = truth("command_delay", &[6e-4]);
        let two = |of_speed: &[f64], of_current: &[f64]| {
            let effects = [("speed_delay", of_speed), ("current_filter", of_current)];
            with(nameplate(), &effects)
        };
        let apart = two(&[4e-3], &[5e-4]);
        for (machine, model, stands) in
            [(&late, two(&[6e-4], &[6e-4]), Some("command_delay")), (&apart, apart.clone(), None)]
        {
            let simpler = |given: &[&'static str]| {
                weighed([machine, &model], &DELAYS, |_| {}, |own| own.simpler(given))
            };
            let found = simpler(&[]);
            assert_eq!(found.as_ref().map(|own| own.0), stands);
            if let Some((_, hypothesis)) = found {
                let delay_s = hypothesis.model.effects[0].values[0].unwrap();
                assert!((delay_s / 6e-4 - 1.0).abs() < 0.2, "{delay_s}");
            }
            // What was given stays.
            assert!(simpler(&["speed_delay"]).is_none());
        }
        // Two that one stands for exclude each other.
        for (one, expected) in
            [(None, false), (Some("current_offset"), false), (Some("command_delay"), true)]
        {
            let model = nameplate();
            let excluded = weighed(
                [&model; 2],
                &DELAYS,
                |linear| bar(linear, &[], one),
                |own| {
                    let candidates = &own.reduced.linear.candidates;
                    let place = |id| candidates.iter().position(|own| own.id == id).unwrap();
                    candidates[place("current_filter")].excludes.contains(&place("speed_delay"))
                },
            );
            assert_eq!(excluded, expected, "{one:?}");
        }
    }

    #[test]
    fn a_refit_refutes_what_only_the_linear_solution_has() {
        let (model, drag) = (nameplate(), "viscous_friction");
        for more in [0.3, 0.0] {
            let change = |linear: &mut Linear| {
                let own = linear.candidates.iter().find(|own| own.id == drag).unwrap();
                let column = own.variants[0].columns[0].at;
                linear.right[column] += more * linear.gram[(column, column)];
            };
            let found = weighed([&model; 2], &[drag], change, |own| own.doubtful(&[]));
            assert_eq!(found.is_some(), more > 0.0);
            if let Some((RefitVerdict::Barred { id, probability }, _)) = found {
                assert!(id == drag && probability < 0.1, "{id} {probability}");
            }
        }
    }

    #[test]
    fn an_effect_that_a_refit_needs_is_kept() {
        let id = "viscous_friction";
        let drag = truth(id, &[4e-4]);
        for (machine, expected) in [(&drag, &[RefitVerdict::Kept { id }][..]), (&nameplate(), &[])]
        {
            let run = record(machine, 0, 7);
            let runs = linearised(&drag, &run);
            let next = fit(&Hypothesis::of(&nameplate()), &runs).unwrap();
            assert!(needed(&Hypothesis::of(&drag), &next, &runs) == expected);
        }
    }
}
