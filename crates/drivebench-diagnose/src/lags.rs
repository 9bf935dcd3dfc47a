//! Lags of the command and of the readings that a record does not distinguish.
//!
//! The linear solution compares lags about one of them: of a command that is late by half a period, where the current settles between
//! two samples, it refutes the true one. So each named lag is exchanged for every other and the model is fitted anew. One whose
//! deviance is no larger than by chance is as good (likelihood ratio of models that are not nested: Vuong, Econometrica 57, 1989), and
//! the motor's values are as uncertain as they differ between the two (model averaging: Draper, J. R. Stat. Soc. B 57, 1995).

use drivebench_identify::output_error::{self, FitError};
use drivebench_identify::verdict::settled_below;
use drivebench_model::numerics::levenberg_marquardt::Options;
use drivebench_model::plant::effect::Enters;
use drivebench_model::plant::{ActiveEffect, Effect, Model, Scenario, effect};
use drivebench_model::sample::Reason;

use super::joint::answer::Inference;
use super::ladder::{Bench, Standing, affordable};
use super::score::{Fitted, Score};

/// Shares the probability of each named lag with those that serve as well in its place, and widens the deviations of `last`, the model
/// with all named effects, by the differences of the values.
pub(super) fn share_among_lags(bench: &Bench, inference: &mut Inference, last: &mut Standing) {
    if bench.fits_at_once() || inference.is_cut() {
        return;
    }
    for id in inference.named.clone() {
        let Some(named) = effect::find(id).filter(|own| is_lag(*own)) else {
            continue;
        };
        let Some(own) = Errors::of(bench, &last.fit.model, false) else {
            return;
        };
        let eligible = |own: &&dyn Effect| {
            let other = own.card().id;
            is_lag(*own)
                && other != id
                && inference.is_eligible(other)
                && !last.fit.model.has(other)
        };
        let others: Vec<&dyn Effect> = effect::CATALOGUE.iter().copied().filter(eligible).collect();
        for other in others {
            let model = exchanged(&last.fit.model, named, other);
            if let Some(fit) = as_good(bench, &model, false, own) {
                inference.share_with_limit([id, other.card().id]);
                widen(&mut last.fit, &fit);
            }
        }
        // A current that is the mean since the row before is late by half a period, and no filter of the first order.
        let is_of_current = path_of(named, 1.0).current_filter_s > 0.0;
        if is_of_current
            && !bench.evidence.training.sensors.averages_current
            && let Ok(model) = last.fit.model.without_effect(id)
            && let Some(fit) = as_good(bench, &model, true, own)
        {
            widen(&mut last.fit, &fit);
        }
    }
}

fn path_of(effect: &dyn Effect, lag_s: f64) -> effect::Path {
    effect.terms(&[lag_s]).path()
}

/// Whether an effect is a lag of all commands or of a reading, with its time as its only parameter.
fn is_lag(effect: &dyn Effect) -> bool {
    let card = effect.card();
    let is_always = || {
        let path = path_of(effect, 1.0);
        path.start_delay_s == 0.0 && path.restart_delay_s == 0.0
    };
    let is_of_time = card.parameters.len() == 1 && card.parameters[0].unit == "s";
    card.enters == Enters::Path && is_of_time && is_always()
}

/// The model with a lag of the same time in the place of another.
fn exchanged(model: &Model, named: &dyn Effect, other: &'static dyn Effect) -> Model {
    let mut model = model.clone();
    let own = model.effects.iter_mut().find(|active| active.id() == named.card().id);
    if let Some(own) = own {
        *own = ActiveEffect::with(other, &own.values_or_guess());
    }
    model
}

/// Squares of the errors on the fitted and the held-out run in units of the noise, and their number.
#[derive(Clone, Copy)]
struct Errors {
    deviance: f64,
    samples: f64,
}

impl Errors {
    fn of(bench: &Bench, model: &Model, averages: bool) -> Option<Self> {
        let evidence = &bench.evidence;
        let mut all = Self { deviance: 0.0, samples: 0.0 };
        for run in [&evidence.training, &evidence.holdout] {
            let score = Score::of(model, &measured(run, averages), &evidence.noise).ok()?;
            all.deviance += score.deviance(&evidence.noise);
            all.samples += 2.0 * score.samples() as f64;
        }
        all.deviance.is_finite().then_some(all)
    }
}

/// The run with means of the current since the row before.
fn measured(run: &Scenario, averages: bool) -> Scenario {
    let mut run = run.clone();
    run.sensors.averages_current |= averages;
    run
}

/// The fit of another model, if it is as good as one with the errors `own`.
fn as_good(bench: &Bench, model: &Model, averages: bool, own: Errors) -> Option<Fitted> {
    let run = measured(&bench.evidence.training, averages);
    let options = Options::default();
    let most_iterations = affordable(model, &run, options.most_iterations);
    let options = Options { most_iterations, ..options };
    let fit: Result<_, FitError> =
        output_error::fit_with(std::slice::from_ref(model), &run, &bench.evidence.noise, options);
    let fit: Fitted = fit.ok()?.into();
    let other = Errors::of(bench, &fit.model, averages)?;
    // Where an error is left its samples are no independent ones.
    let excess = (own.deviance / own.samples.max(1.0)).max(1.0);
    // Three nats, as between effects of the linear solution.
    (other.deviance - own.deviance < 6.0 * excess).then_some(fit)
}

/// Adds the differences of the values to the deviations; a value that is wider than a settled one is not settled.
fn widen(own: &mut Fitted, other: &Fitted) {
    for parameter in &mut own.parameters {
        let same = other.parameters.iter().find(|other| other.key == parameter.key);
        let values = parameter.value.zip(same.and_then(|same| same.value));
        if let (Some((value, another)), Some(std)) = (values, &mut parameter.std) {
            *std = std.hypot(another - value);
            if *std > settled_below(&parameter.key) * value.abs() {
                let reason = "another lag that serves as well gives another value";
                parameter.unsettle(Reason::Ambiguous, reason);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{nameplate, with};
    use crate::{DiagnosisVerdict, Evidence, diagnose};
    use drivebench_model::plant::MotorKey;
    use drivebench_model::plant::testing::record;

    #[test]
    fn a_late_command_and_a_late_speed_are_one_of_two_where_the_current_settles_between_samples() {
        // A heavy wheel at 20 Hz, whose winding settles within a hundredth of the period.
        let mut wheel = nameplate();
        let inertia_kg_m2 = wheel.motor.get(MotorKey::Inertia).unwrap();
        wheel.motor.set(MotorKey::Inertia, 30.0 * inertia_kg_m2);
        wheel.motor.set(MotorKey::Inductance, 5e-4);
        let run = |shift: usize| {
            let levels_v = [0.0, 40.0, -60.0, 0.0, 80.0, -30.0, 50.0, 0.0, -70.0, 30.0];
            let level_v = |k: usize| levels_v[if k == 0 { 0 } else { (k + shift) % 10 }];
            let events = (0..20).map(|k| (2.0 * k as f64, level_v(k)));
            let late = with(wheel.clone(), &[("command_delay", &[0.018])]);
            record(&late, events.collect(), 0.05, 40.0, 7)
        };
        let found = diagnose(&wheel, Evidence::new(run(0), Some(run(3)), None)).unwrap();
        assert_eq!(found.verdict, DiagnosisVerdict::Ambiguous, "{:?}", found.effects);
        let pairs = &found.confusable;
        let is_there = pairs.iter().any(|pair| pair.contains(&"command_delay"));
        assert!(is_there, "{pairs:?}");
        for key in [MotorKey::Resistance, MotorKey::BackEmf, MotorKey::Inertia] {
            let own = found.parameters.iter().find(|own| own.key == key.key()).unwrap();
            let (value, std, truth) =
                (own.value.unwrap(), own.std.unwrap(), wheel.motor.get(key).unwrap());
            assert!((value - truth).abs() < 3.0 * std, "{key:?}: {value} {std} {truth}");
        }
    }

    #[test]
    fn lags_are_the_delays_and_filters_that_are_always_there() {
        let lags = effect::CATALOGUE.iter().copied().filter(|own| is_lag(*own));
        let ids: Vec<&str> = lags.map(|own| own.card().id).collect();
        let expected = ["command_delay", "speed_delay", "speed_filter", "current_filter"];
        assert_eq!(ids.len(), expected.len(), "{ids:?}");
        assert!(expected.iter().all(|id| ids.contains(id)), "{ids:?}");
    }
}
