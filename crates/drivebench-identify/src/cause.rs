//! Cause of a parameter without a value: the Cramer-Rao bound of the run, at a motor that can have made it, shows whether the
//! run excites it. Else the cause is the fit, or what the model leaves beside the noise.

use nalgebra::DMatrix;

use super::misfit::Misfit;
use super::noise::{FloorSource, NoiseFloor, roughness};
use super::output_error::{Fit, FreeRun};
use super::verdict::NOT_OBSERVABLE;
use super::{physical, start};
use drivebench_model::numerics::least_squares::inverse_where_determined;
use drivebench_model::numerics::levenberg_marquardt::{Problem as _, jacobian_at};
use drivebench_model::plant::{Model, MotorKey, Scenario, Slot};
use drivebench_model::sample::{ParameterEstimate, Verdict};

/// Gives each free parameter of the motor without a value the reason. `given`: the model as the user gave it.
pub(super) fn explain(
    parameters: &mut [ParameterEstimate],
    fit: &Fit,
    misfit: &Misfit,
    given: &Model,
    scenario: &Scenario,
) {
    let is_open = |own: &&mut ParameterEstimate| {
        // The reason of an inductance names the period already.
        let key = MotorKey::from_key(&own.key).filter(|key| *key != MotorKey::Inductance);
        own.verdict == Verdict::NotObservable && key.is_some()
    };
    if !parameters.iter_mut().any(|own| is_open(&own)) {
        return;
    }
    let Some(carried) = Carried::by(fit, given, scenario) else {
        return;
    };
    for parameter in parameters.iter_mut().filter(is_open) {
        if let Some(reason) = carried.why_not(&parameter.key, fit, misfit, scenario) {
            parameter.reason = Some(reason);
        }
    }
}

/// What the run carries of each free parameter: the least relative deviation, where it is determined at all.
struct Carried {
    motor: Model,
    free: Vec<Slot>,
    least: Vec<Option<f64>>,
}

impl Carried {
    /// `None` where the run is a steady state, or cannot be simulated.
    fn by(fit: &Fit, given: &Model, scenario: &Scenario) -> Option<Self> {
        let motor = if physical::allows(&fit.model.motor, scenario) {
            fit.model.clone()
        } else {
            start::complete(given, scenario).ok()?
        };
        let noise = or_roughness(fit.noise, scenario);
        let problem = FreeRun::new(&motor, scenario, noise).ok()?;
        if problem.why_still(&fit.minimum.residual).is_some() {
            return None;
        }
        let x = problem.start();
        let mut residual = vec![0.0; problem.residual_len()];
        let is_known = problem.residual(&x, &mut residual);
        let jacobian: DMatrix<f64> = is_known.then(|| jacobian_at(&problem, &x, &residual))?;
        let (bread, determined) = inverse_where_determined(&jacobian);
        let free = problem.free_slots().to_vec();
        let slopes = problem.slopes(&x);
        let least = |place: usize| {
            let value = motor.get(&free[place])?.abs();
            let std = slopes[place].abs() * bread[(place, place)].sqrt();
            determined[place].then_some(std / value)
        };
        Some(Self { least: (0..free.len()).map(least).collect(), motor, free })
    }

    fn why_not(
        &self,
        key: &str,
        fit: &Fit,
        misfit: &Misfit,
        scenario: &Scenario,
    ) -> Option<String> {
        let place = self.free.iter().position(|slot| slot.key() == key)?;
        let Some(least) = self.least[place] else {
            return Some(self.only_together(place));
        };
        if least > NOT_OBSERVABLE {
            return self.too_slow(key, scenario);
        }
        let carries = format!("the run carries it to {:.1} % at best", 100.0 * least.max(1e-3));
        Some(if !fit.minimum.converged {
            format!("{carries}, and the fit had not converged: give starting values with --model")
        } else if let Some(left) = misfit.worst_text() {
            format!(
                "{carries}, but the model leaves {left}: an effect that it lacks, or a fault of a signal, hides it; see \
                 drivebench diagnose"
            )
        } else {
            format!("{carries}, and the fit ended elsewhere: give starting values with --model")
        })
    }

    /// Of parameters that the run leaves open together.
    fn only_together(&self, place: usize) -> String {
        let others: Vec<String> = self
            .free
            .iter()
            .zip(&self.least)
            .enumerate()
            .filter(|(other, (_, least))| *other != place && least.is_none())
            .map(|(_, (slot, _))| slot.key())
            .collect();
        if others.is_empty() {
            return "the fit ends where nothing of it shows: the run does not excite it, or there is next to none of it"
                .to_owned();
        }
        format!(
            "the run shows it only together with {}: it takes several levels of voltage, in both directions",
            others.join(", ")
        )
    }

    /// Where a transient that carries a parameter is over between two samples; `None` where that is no reason.
    fn too_slow(&self, key: &str, scenario: &Scenario) -> Option<String> {
        let motor = &self.motor.motor;
        let [r, j, ke] = [MotorKey::Resistance, MotorKey::Inertia, MotorKey::BackEmf];
        let mechanical_s =
            motor.get(r)? * motor.get(j)? / motor.get(ke)? / motor.torque_constant()?;
        let period_s = scenario.mean_period_s();
        (key == MotorKey::Inertia.key() && period_s > mechanical_s).then(|| {
            format!(
                "R J/Ke^2 is some {:.1} ms, which is over between two samples {:.1} ms apart: sample faster",
                1e3 * mechanical_s,
                1e3 * period_s
            )
        })
    }
}

/// The noise of a record without a rest is at most its roughness.
fn or_roughness(noise: NoiseFloor, scenario: &Scenario) -> NoiseFloor {
    if noise.source != FloorSource::None {
        return noise;
    }
    let level = |values: &[f64], otherwise: f64| {
        let level = roughness(values);
        let is_known = level > 0.0 && otherwise.is_finite();
        if is_known { level } else { otherwise }
    };
    NoiseFloor {
        current_a: level(&scenario.current_a, noise.current_a),
        speed_rad_s: level(&scenario.speed_rad_s, noise.speed_rad_s),
        ..noise
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;
    use drivebench_model::sample::{Channel, Run};

    /// L/R 0.5 ms, R J/Ke^2 19 ms.
    const BRUSHED: Truth = [1.2, 6e-4, 0.05, 4e-5, 0.012];

    fn brushed(events: Vec<(f64, f64)>, period_s: f64, seconds: f64) -> Run {
        let model = Model::baseline(motor(&BRUSHED));
        recorded(&record(&model, events, period_s, seconds, 2))
    }

    fn found(run: &Run) -> Vec<ParameterEstimate> {
        identify("output-error", run, &unknown()).unwrap().parameters
    }

    #[test]
    fn plateaus_at_20_hz_give_resistance_and_back_emf() {
        let found = found(&brushed(steps(1.0, 30.0, 12.0 / 70.0, 0.5), 0.05, 30.0));
        for (key, truth) in [("resistance_ohm", 1.2), ("back_emf_v_s_per_rad", 0.05)] {
            assert_covers(of(&found, key), truth, 0.1, 3.0);
        }
        let inductance = judged(&found, "inductance_h", Verdict::NotObservable);
        assert_says(inductance, &["at a period of 50.0 ms"]);
    }

    #[test]
    fn a_run_of_one_level_leaves_parameters_open_together() {
        let mut run = brushed(vec![(0.0, 0.0), (0.5, 8.0)], 0.002, 2.0);
        put(&mut run, Channel::Current, vec![f64::NAN; 1000]);
        let mut model = Model::baseline(motor(&BRUSHED));
        for key in [MotorKey::Resistance, MotorKey::Inductance] {
            model.fixed.push(key.key().to_owned());
        }
        let found = identify("output-error", &run, &model).unwrap().parameters;
        let back_emf = judged(&found, "back_emf_v_s_per_rad", Verdict::NotObservable);
        assert_says(back_emf, &["together with", "load_torque_n_m", "several levels"]);
    }

    #[test]
    fn a_fault_of_a_signal_is_not_called_a_lack_of_excitation() {
        let run = brushed(steps(0.3, 4.0, 12.0 / 70.0, 0.2), 0.002, 4.0);
        // A speed that is another one half of the time.
        let wild = |row: usize, speed: f64| [1.0, -0.7][row / 37 % 2] * speed;
        let found = found(&changed(&run, Channel::Speed, wild));
        let open = found.iter().filter(|own| own.value.is_none());
        for own in open {
            let reason = own.reason.as_deref().unwrap();
            assert!(!reason.contains("does not excite"), "{own:?}");
        }
    }
}
