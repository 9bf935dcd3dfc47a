//! Refits against the linear solution: what they refute of its best set is barred, and where a simpler effect serves as well by
//! their likelihood ratio it stands for a richer one or for two.

use rayon::prelude::*;

use super::columns::{Candidate, Linear, LinearisedRun};
use super::events::Hypothesis;
use super::prediction_error::{Refit, fit};
use super::select::{Posterior, Reduced, Set};
use super::solution::{placed, present};
use drivebench_model::plant::effect::CATALOGUE;
use drivebench_model::plant::{ActiveEffect, Model, effect, typical_size};

/// Log of the odds beforehand of an effect that a refit has refuted, and what is added to that of one without which a refit
/// is worse.
const BARRED_LOG_ODDS: f64 = -30.0;
const KEPT_LOG_ODDS: f64 = 30.0;
/// Growth of the log likelihood that a richer effect, or a second one, must bring to stand for one that serves as well.
const WORTH_A_SECOND_NATS: f64 = 5.7;

/// Verdict of a refit on the linear solution.
#[derive(PartialEq)]
pub(super) enum RefitVerdict {
    /// An effect that is not there, and what is left of its probability.
    Barred { id: &'static str, probability: f64 },
    /// One that is there.
    Kept { id: &'static str },
}

/// Keeps effects out of the sets, or in them, as refits found, and out pairs for which `one` was found to stand as well.
pub(super) fn bar(linear: &mut Linear, verdicts: &[RefitVerdict], one: Option<&'static str>) {
    let one = one.and_then(effect::find);
    for pair in one.map_or(&[][..], |one| one.card().stands_for) {
        let places = pair.map(|id| linear.candidates.iter().position(|own| own.id == id));
        if let [Some(a), Some(b)] = places {
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
                    candidate.log_odds = log_odds + KEPT_LOG_ODDS;
                }
                _ => {}
            }
        }
    }
}

/// Keeps what rings, and is not in the model, out of the sets.
pub(super) fn bar_what_rings(linear: &mut Linear) {
    let candidates = linear.candidates.iter_mut();
    for candidate in candidates.filter(|own| own.is_whole() && !own.in_model) {
        candidate.log_odds = BARRED_LOG_ODDS;
    }
}

/// The effects of `hypothesis` that the linear solution took out where `next`, refitted, is clearly worse without them: it is
/// wrong where what an effect does is not in proportion to its size, as impacts' times to a delay.
pub(super) fn needed(
    hypothesis: &Hypothesis,
    next: &Refit,
    runs: &[LinearisedRun<'_>],
) -> Vec<RefitVerdict> {
    let ids = hypothesis.model.effect_ids().into_iter();
    let removed: Vec<&'static str> = ids.filter(|id| !next.hypothesis.model.has(id)).collect();
    let is_worse = |now: Refit| {
        0.5 * (next.deviance - now.deviance) > WORTH_A_SECOND_NATS * removed.len() as f64
    };
    if removed.is_empty() || !fit(hypothesis, runs).is_some_and(is_worse) {
        return Vec::new();
    }
    removed
        .into_iter()
        .map(|id| RefitVerdict::Kept { id })
        .collect()
}

/// Gives effects that were barred what the refit left of their probability.
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

/// Each effect with those that it may stand for: with the two that are this one to first order, then the simpler ones of a
/// limit with the richer one. Each fits what the other does to some degree.
fn substitutes() -> impl Iterator<Item = (&'static str, Vec<&'static str>)> {
    let cards = || CATALOGUE.iter().map(|effect| effect.card());
    let for_two =
        cards().flat_map(|card| card.stands_for.iter().map(|two| (card.id, two.to_vec())));
    let at_limit = cards().filter_map(|card| Some((card.limit?.simpler, vec![card.id])));
    for_two.chain(at_limit)
}

/// The effect of a model that was fitted down to its limit, behind the simpler one that it is there: the gaps of a current that
/// end below the least boundary of a converter are a drop of brushes, however softly it builds up.
pub(super) fn at_limit(model: &Model) -> Option<[&'static str; 2]> {
    model.effects.iter().find_map(|active| {
        let limit = active.effect.card().limit?;
        let value = active.values_or_guess()[limit.parameter];
        (value < AT_THE_LIMIT_RATIO * limit.least).then(|| [limit.simpler, active.id()])
    })
}

/// How many times the least value of a shape one that was fitted down to it may be.
const AT_THE_LIMIT_RATIO: f64 = 1.02;

/// Growth of the squares up to which a drop stands for gaps that end where it would: with more its form is another.
const SOFTLY: f64 = 1.05;

/// Sets as the linear solution weighs them.
pub(super) struct Weighed<'a> {
    pub(super) hypothesis: &'a Hypothesis,
    pub(super) reduced: &'a Reduced,
    pub(super) posterior: &'a Posterior,
    pub(super) runs: &'a [LinearisedRun<'a>],
}

impl Weighed<'_> {
    /// The effect of the best set, none of `given`, that a refit refutes most clearly, and the model without it. A linear
    /// solution is wrong where an effect's own size bends what it does, as that of a large delay.
    pub(super) fn doubtful(&self, given: &[&'static str]) -> Option<(RefitVerdict, Hypothesis)> {
        let best = &self.posterior.best;
        let likelihood = |set: &Set| self.reduced.log_likelihood(&self.reduced.columns(set));
        let whole = likelihood(best);
        let eligible = |(k, candidate): &(usize, &Candidate)| {
            let named = best[*k].is_some() && !candidate.is_unknown();
            named && !given.contains(&candidate.id)
        };
        let candidates = self.reduced.linear.candidates.iter().enumerate();
        let eligible: Vec<(usize, &Candidate)> = candidates.filter(eligible).collect();
        if eligible.is_empty() {
            return None;
        }
        // What is left where it goes, or its deviance where it joins.
        let refitted = |(k, candidate): &(usize, &Candidate)| {
            if candidate.in_model {
                return fit(&self.hypothesis.without(candidate.id), self.runs).map(Some);
            }
            let mut with = present(&self.reduced.linear);
            with[*k] = best[*k];
            let start = placed(self.hypothesis, self.reduced, &with, self.runs)?;
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
        let removals = eligible
            .iter()
            .zip(refitted?)
            .map(|((k, candidate), refit)| {
                let mut without = best.clone();
                without[*k] = None;
                let promised = whole - likelihood(&without);
                let change = refit.as_ref();
                let change = change.map_or(0.0, |refit| 0.5 * (refit.deviance - base.deviance));
                let gained = if candidate.in_model { change } else { -change };
                let left = refit.filter(|_| candidate.in_model);
                let left = left.map_or_else(|| self.hypothesis.clone(), |left| left.hypothesis);
                let raised = if candidate.log_odds > 0.0 {
                    KEPT_LOG_ODDS
                } else {
                    0.0
                };
                let odds = self.posterior.log_factor[*k] - raised - (promised - gained).max(0.0);
                (odds, candidate.id, left)
            });
        let refuted = removals.filter(|own| own.0 < 0.0);
        let worst = refuted.min_by(|a, b| a.0.total_cmp(&b.0));
        let (odds, id, left) = worst?;
        let probability = 1.0 / (1.0 + (-odds).exp());
        Some((RefitVerdict::Barred { id, probability }, left))
    }

    /// A simple effect, and the model with it in the place of a richer one, or of two that it is alike to, where those are not
    /// clearly better.
    pub(super) fn simpler(&self, given: &[&'static str]) -> Option<(&'static str, Hypothesis)> {
        let there = &self.hypothesis.model;
        substitutes().find_map(|(simple, others)| {
            let open = |id: &&str| there.has(id) && !given.contains(id);
            if there.has(simple) || !others.iter().all(open) {
                return None;
            }
            let effect = effect::find(simple)?;
            let unit = effect.parameters()[0].unit;
            let size = |active: &ActiveEffect| {
                let is_one = others.contains(&active.id());
                let alike = is_one && active.effect.parameters()[0].unit == unit;
                alike.then(|| active.values_or_guess()[0])
            };
            let sizes: Vec<f64> = there.effects.iter().filter_map(size).collect();
            let begin = if sizes.is_empty() {
                typical_size(effect, 0, there, self.runs[0].scenario)
            } else {
                sizes.iter().sum::<f64>() / sizes.len() as f64
            };
            let mut start = self.hypothesis.clone();
            let kept = |active: &ActiveEffect| !others.contains(&active.id());
            start.model.effects.retain(kept);
            start
                .model
                .effects
                .push(ActiveEffect::with(effect, &[begin]));
            // What is not known goes with the size that it was followed with: the second time that is its own.
            let left = fit(&fit(&start, self.runs)?.hypothesis, self.runs)?;
            let rich = fit(self.hypothesis, self.runs)?;
            let limit = at_limit(there);
            let is_one = limit.is_some_and(|[limit, rich]| limit == simple && others == [rich])
                && left.squares < SOFTLY * rich.squares;
            let serves = 0.5 * (left.deviance - rich.deviance) < WORTH_A_SECOND_NATS;
            (is_one || serves).then_some((simple, left.hypothesis))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joint::columns::linearise;
    use crate::joint::follow::{Noise, QUIET};
    use crate::joint::select::select;
    use crate::kit::{nameplate, record, truth, with};
    use drivebench_model::plant::{Effect, Scenario, State};

    /// The least boundary of the gaps of a converter, A.
    const LEAST_BOUNDARY_A: f64 = 0.9;

    fn led<'a>(model: &Model, run: &'a Scenario) -> [LinearisedRun<'a>; 1] {
        let noise = Noise {
            disturbance_n_m: 1e-4,
            input: 1e-3,
            ..QUIET
        };
        [LinearisedRun::new(model, run, State::default(), noise).unwrap()]
    }

    /// What `about` makes of the sets as they are weighed from `model` on.
    fn weighed<T>(
        model: &Model,
        run: &Scenario,
        eligible: &[&'static str],
        pretend: impl FnOnce(&mut Linear),
        about: impl FnOnce(&Weighed<'_>) -> T,
    ) -> T {
        let eligible: Vec<&'static dyn Effect> = eligible
            .iter()
            .map(|id| effect::find(id).unwrap())
            .collect();
        let (hypothesis, runs) = (Hypothesis::of(model), led(model, run));
        let mut linear = linearise(&hypothesis, &eligible, &runs, false).unwrap();
        pretend(&mut linear);
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
    fn gaps_that_end_where_no_converters_do_are_a_drop_of_brushes() {
        let gaps = |boundary_a: f64| truth("discontinuous_conduction", &[1.4, boundary_a]);
        let brushes = ["voltage_drop", "discontinuous_conduction"];
        assert_eq!(at_limit(&gaps(LEAST_BOUNDARY_A)), Some(brushes));
        assert_eq!(at_limit(&gaps(1.5 * LEAST_BOUNDARY_A)), None);
        assert_eq!(at_limit(&truth("voltage_drop", &[0.9])), None);
    }

    #[test]
    fn a_sharp_drop_stands_for_gaps_that_end_early_only_where_it_leaves_hardly_more() {
        let gaps =
            |extra_ohm: f64| truth("discontinuous_conduction", &[extra_ohm, LEAST_BOUNDARY_A]);
        let eligible = ["voltage_drop", "discontinuous_conduction"];
        // A small drop hardly shows, whatever its form; of a large one the form is.
        for (extra_ohm, stands) in [(0.05, true), (4.0, false)] {
            let machine = gaps(extra_ohm);
            let run = record(&machine, 0, 7);
            let simpler = weighed(&machine, &run, &eligible, |_| {}, |own| own.simpler(&[]));
            assert_eq!(simpler.is_some(), stands, "{extra_ohm} ohm");
        }
    }

    #[test]
    fn what_rings_is_kept_out_unless_the_model_has_it() {
        let coupled = nameplate().with_effect("elastic_coupling").unwrap();
        for (model, is_barred) in [(nameplate(), true), (coupled, false)] {
            let run = record(&model, 0, 7);
            let odds = |linear: &mut Linear| {
                bar_what_rings(linear);
                let mut rings = linear.candidates.iter().filter(|own| own.is_whole());
                let coupling = rings.find(|own| own.id == "elastic_coupling");
                let found = coupling.is_some_and(|own| own.log_odds <= BARRED_LOG_ODDS);
                assert_eq!(found, is_barred);
            };
            weighed(&model, &run, &["elastic_coupling"], odds, |_| {});
        }
    }

    #[test]
    fn a_late_command_stands_for_two_late_sensors_unless_these_are_there() {
        let late = truth("command_delay", &[6e-4]);
        let two = |of_speed: &[f64], of_current: &[f64]| {
            let effects = [("speed_delay", of_speed), ("current_filter", of_current)];
            with(nameplate(), &effects)
        };
        let apart = two(&[4e-3], &[5e-4]);
        let eligible = ["command_delay", "speed_delay", "current_filter"];
        for (machine, model, stands) in [
            (&late, two(&[6e-4], &[6e-4]), Some("command_delay")),
            (&apart, apart.clone(), None),
        ] {
            let run = record(machine, 0, 7);
            let simpler = |given: &[&'static str]| {
                weighed(&model, &run, &eligible, |_| {}, |own| own.simpler(given))
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
    }

    #[test]
    fn two_that_one_stands_for_are_not_both_asked_for_again() {
        let run = record(&nameplate(), 0, 7);
        let eligible = ["command_delay", "speed_delay", "current_filter"];
        let excluded = |one| {
            let pretend = |linear: &mut Linear| bar(linear, &[], one);
            weighed(&nameplate(), &run, &eligible, pretend, |own| {
                let candidates = own.reduced.linear.candidates.iter();
                let filter = candidates.clone().find(|own| own.id == "current_filter");
                let delay = candidates.clone().position(|c| c.id == "speed_delay");
                filter.unwrap().excludes.contains(&delay.unwrap())
            })
        };
        assert!(!excluded(None));
        assert!(!excluded(Some("current_offset")));
        assert!(excluded(Some("command_delay")));
    }

    #[test]
    fn what_only_the_linear_solution_asks_for_is_refuted_by_a_refit() {
        let run = record(&nameplate(), 0, 7);
        let drag = "viscous_friction";
        for more in [0.3, 0.0] {
            let pretend = |linear: &mut Linear| {
                let own = linear.candidates.iter().find(|own| own.id == drag).unwrap();
                let column = own.variants[0].columns[0].at;
                linear.right[column] += more * linear.gram[(column, column)];
            };
            let found = weighed(&nameplate(), &run, &[drag], pretend, |own| {
                own.doubtful(&[])
            });
            assert_eq!(found.is_some(), more > 0.0);
            if let Some((RefitVerdict::Barred { id, probability }, _)) = found {
                assert!(id == drag && probability < 0.1, "{id} {probability}");
            }
        }
    }

    #[test]
    fn what_a_refit_needs_is_kept_and_what_it_does_not_is_not() {
        let id = "viscous_friction";
        let drag = truth(id, &[4e-4]);
        for (machine, expected) in [
            (&drag, &[RefitVerdict::Kept { id }][..]),
            (&nameplate(), &[]),
        ] {
            let run = record(machine, 0, 7);
            let runs = led(&drag, &run);
            let next = fit(&Hypothesis::of(&nameplate()), &runs).unwrap();
            assert!(needed(&Hypothesis::of(&drag), &next, &runs) == expected);
        }
    }
}
