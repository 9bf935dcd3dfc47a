//! A voltage drop that does not depend on the size of a current which the drive controls: it is in no torque, so that the voltage
//! balance between the steps of the current names it, by least squares on one run and the error on another.

use serde::Serialize;

use super::diagnose::CONFIRMED_SIGMAS;
use super::evidence::Evidence;
use super::ladder::AS_GOOD;
use drivebench_identify::verdict::judge;
use drivebench_identify::winding_balance;
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::effect::TermKind;
use drivebench_model::plant::{ActiveEffect, Model, Scenario, Slot};
use drivebench_model::sample::ParameterEstimate;

/// The effect.
pub(super) const ID: &str = TermKind::VoltageDrop.id();
/// Least drop as a share of the largest voltage: below, gain errors of the sensors decide.
const LEAST_SHARE: f64 = 5e-3;

/// The drop, and what it does on other runs.
#[derive(Clone, Debug, Serialize)]
pub struct WindingDrop {
    pub drop_v: f64,
    pub std_v: f64,
    /// Root mean square errors of the held-out voltage without the drop and with it, V.
    pub holdout_before_v: f64,
    pub holdout_after_v: f64,
    /// Its value on the confirming run, in standard deviations; null without such a run.
    pub confirm_z: Option<f64>,
    /// Posterior probability: the prior odds of the effect, and the Bayes factor of a value so many deviations from zero on the run
    /// that shows it less, for a prior with the information of one step of the current (Schwarz, Annals of Statistics 6, 1978).
    pub probability: f64,
}

impl WindingDrop {
    /// `None` where the model has it, the runs have no voltage with a controlled current, or one of two runs does not show it.
    pub(super) fn find(model: &Model, evidence: &Evidence) -> Option<Self> {
        let of = |run: &Scenario| winding_balance::fit(&Model::default(), run);
        let sigmas = |run: &Scenario| of(run).map(|found| found.drop_v.0 / found.drop_v.1);
        let held_out_z = sigmas(&evidence.holdout)?;
        let fitted = of(&evidence.training).filter(|_| !model.has(ID))?;
        let (drop_v, std_v) = fitted.drop_v;
        let [before_v, after_v] = fitted.errors_v(&evidence.holdout)?;
        let least_v = LEAST_SHARE * largest(&evidence.training.voltage_v);
        let is_there = drop_v > least_v
            && drop_v > CONFIRMED_SIGMAS * std_v
            && before_v > AS_GOOD * after_v
            && held_out_z > CONFIRMED_SIGMAS;
        let prior = TermKind::VoltageDrop.effect().card().share_beforehand;
        let steps = evidence.training.current_steps_s.len().max(1) as f64;
        let z = held_out_z.min(drop_v / std_v);
        let log_odds = (prior / (1.0 - prior)).ln() + 0.5 * (z * z - steps.ln());
        is_there.then(|| Self {
            drop_v,
            std_v,
            holdout_before_v: before_v,
            holdout_after_v: after_v,
            confirm_z: evidence.confirm.as_ref().and_then(sigmas),
            probability: 1.0 / (1.0 + (-log_odds).exp()),
        })
    }

    /// Adds it to a model; the estimates of its parameter.
    pub(super) fn add_to(&self, model: &mut Model) -> Vec<ParameterEstimate> {
        let effect = TermKind::VoltageDrop.effect();
        model.effects.push(ActiveEffect::with(effect, &[self.drop_v]));
        let is_own =
            |slot: &Slot| matches!(slot, Slot::Effect { .. }) && slot.key().starts_with(ID);
        let slots = model.slots().into_iter().filter(is_own);
        slots.map(|slot| judge(&slot, self.drop_v, Some(self.std_v), 0.0)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_model::plant::Motor;
    use drivebench_model::plant::testing::run_of;
    use drivebench_model::sample::{Channel, Origin};

    /// Currents of two sizes that alternate each second, a triangle of speed, and the voltage of `R` 1.1 ohm, `Ke` 0.35 V.s/rad and a
    /// drop.
    fn run(drop_v: f64) -> Scenario {
        let times: Vec<f64> = (0..2000).map(|row| 0.01 * f64::from(row)).collect();
        let amperes = |time_s: f64| {
            let way: f64 = if time_s.rem_euclid(2.0) < 1.0 { 1.0 } else { -1.0 };
            if time_s < 1.0 { 0.0 } else { way * if time_s % 4.0 < 2.0 { 2.0 } else { 5.0 } }
        };
        let speed = |time_s: f64| 100.0 - 200.0 * (time_s.rem_euclid(2.0) - 1.0).abs();
        // Of 0.05 V.
        let noise = |time_s: f64| 0.05 * (1e4 * time_s).sin();
        let volts = |time_s: f64| {
            let drop = drop_v * amperes(time_s).signum();
            1.1 * amperes(time_s) + 0.35 * speed(time_s) + drop + noise(time_s)
        };
        let column = |of: &dyn Fn(f64) -> f64| times.iter().map(|time_s| of(*time_s)).collect();
        let columns = [
            (Channel::CurrentCmd, column(&amperes), Origin::Commanded),
            (Channel::Voltage, column(&volts), Origin::Measured),
            (Channel::Speed, column(&speed), Origin::Measured),
        ];
        Scenario::from_run(&run_of("r", times.clone(), columns)).unwrap()
    }

    #[test]
    fn a_drop_is_named_where_two_runs_have_it() {
        let mut model = Model::baseline(Motor::new("bldc"));
        let find = |model: &Model, drops_v: [f64; 3]| {
            let [fitted, held_out, confirming] = drops_v.map(run);
            WindingDrop::find(model, &Evidence::new(fitted, Some(held_out), Some(confirming)))
        };
        let found = find(&model, [0.8; 3]).unwrap();
        assert!((found.drop_v - 0.8).abs() < 0.02, "{found:?}");
        assert!(found.holdout_after_v < 0.1 && found.holdout_before_v > 0.2, "{found:?}");
        assert!(found.confirm_z.unwrap() > CONFIRMED_SIGMAS && found.probability > 0.99);
        for drops_v in [[0.0; 3], [0.8, 0.0, 0.8], [-0.8; 3], [0.1; 3]] {
            assert!(find(&model, drops_v).is_none(), "{drops_v:?}");
        }
        let parameters = found.add_to(&mut model);
        assert_eq!(parameters[0].value, Some(found.drop_v));
        assert!(model.has(ID) && find(&model, [0.8; 3]).is_none());
    }
}
