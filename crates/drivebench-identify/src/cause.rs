//! Reason why a parameter has no value, by the Cramer-Rao bound of the run at a motor that is compatible with it (Ljung 1999,
//! section 7.4): a large bound is a lack of excitation, a small one a fit that failed or an error of the model.

use super::misfit::Misfit;
use super::noise::{FloorSource, NoiseFloor, roughness};
use super::output_error::{Fit, FreeRun};
use super::verdict::NOT_OBSERVABLE;
use super::{physical, start};
use drivebench_model::numerics::least_squares::inverse_where_determined;
use drivebench_model::numerics::levenberg_marquardt::jacobian_at;
use drivebench_model::plant::{Model, MotorKey, Scenario, Slot};
use drivebench_model::sample::{ParameterEstimate, Reason, Verdict};

/// Sets the reason of each free parameter of the motor without a value. `given`: the model of the user.
pub(super) fn explain(
    parameters: &mut [ParameterEstimate],
    fit: &Fit,
    misfit: &Misfit,
    given: &Model,
    scenario: &Scenario,
) {
    let is_open = |parameter: &&mut ParameterEstimate| {
        // The reason of an inductance names the period already.
        let key = MotorKey::from_key(&parameter.key).filter(|key| *key != MotorKey::Inductance);
        parameter.verdict == Verdict::NotObservable && key.is_some()
    };
    if !parameters.iter_mut().any(|parameter| is_open(&parameter)) {
        return;
    }
    let Some(bound) = CramerRaoBound::of(fit, given, scenario) else { return };
    for parameter in parameters.iter_mut().filter(is_open) {
        if let Some((code, reason)) = bound.reason(&parameter.key, fit, misfit, scenario) {
            parameter.set(Verdict::NotObservable, code, reason);
        }
    }
}

/// Smallest relative standard deviation of each free parameter; `None` for one that is not determined.
struct CramerRaoBound {
    motor: Model,
    free: Vec<Slot>,
    least: Vec<Option<f64>>,
}

impl CramerRaoBound {
    /// `None` where the run is a steady state, or cannot be simulated.
    fn of(fit: &Fit, given: &Model, scenario: &Scenario) -> Option<Self> {
        let motor = if physical::allows(&fit.model.motor, scenario) {
            fit.model.clone()
        } else {
            start::complete(given, scenario).ok()?
        };
        let problem = FreeRun::new(&motor, scenario, or_roughness(fit.noise, scenario)).ok()?;
        if problem.why_still(&fit.minimum.residual).is_some() {
            return None;
        }
        let x = problem.start();
        let jacobian = jacobian_at(&problem, &x, &problem.residuals(&x).ok()?);
        let (bread, determined) = inverse_where_determined(&jacobian);
        let free = problem.free_slots().to_vec();
        let slopes = problem.slopes(&x);
        let least = |index: usize| {
            let value = motor.get(&free[index])?.abs();
            let std = slopes[index].abs() * bread[(index, index)].sqrt();
            determined[index].then_some(std / value)
        };
        Some(Self { least: (0..free.len()).map(least).collect(), motor, free })
    }

    fn reason(
        &self,
        key: &str,
        fit: &Fit,
        misfit: &Misfit,
        scenario: &Scenario,
    ) -> Option<(Reason, String)> {
        let index = self.free.iter().position(|slot| slot.key() == key)?;
        let Some(least) = self.least[index] else {
            return Some((Reason::OnlyTogether, self.collinear(index)));
        };
        if least > NOT_OBSERVABLE {
            let reason = self.too_slow(key, scenario)?;
            return Some((Reason::SampledTooSlowly, reason));
        }
        let bound = format!("the run determines it to {:.1} % at best", 100.0 * least.max(1e-3));
        let start = "give starting values with --model";
        let (code, why) = match misfit.worst_text() {
            _ if !fit.minimum.converged => {
                (Reason::NotConverged, format!("and the fit had not converged: {start}"))
            }
            Some(misfit) => (
                Reason::ModelMisses,
                format!(
                    "but the residual of the model is {misfit}: a missing effect or a fault of a signal hides it; see \
                 drivebench diagnose"
                ),
            ),
            None => (Reason::NotConverged, format!("and the fit ended elsewhere: {start}")),
        };
        Some((code, format!("{bound}, {why}")))
    }

    /// Of a parameter whose column is a linear combination of others.
    fn collinear(&self, index: usize) -> String {
        let others = self.free.iter().zip(&self.least).enumerate();
        let others = others.filter(|(other, (_, least))| *other != index && least.is_none());
        let others: Vec<String> = others.map(|(_, (slot, _))| slot.key()).collect();
        if others.is_empty() {
            return "the fit ends where it has no influence: the run does not excite it, or it is nearly zero"
                .to_owned();
        }
        format!(
            "the run determines it only together with {}: use several levels of voltage, in both directions",
            others.join(", ")
        )
    }

    /// Where the transient that determines a parameter is shorter than the sampling period; `None` where it is not.
    fn too_slow(&self, key: &str, scenario: &Scenario) -> Option<String> {
        let motor = &self.motor.motor;
        let [r, j, ke] = [MotorKey::Resistance, MotorKey::Inertia, MotorKey::BackEmf];
        let mechanical_s =
            motor.get(r)? * motor.get(j)? / motor.get(ke)? / motor.torque_constant()?;
        let period_s = scenario.mean_period_s();
        (key == MotorKey::Inertia.key() && period_s > mechanical_s).then(|| {
            format!(
                "R J/Ke^2 is about {:.1} ms, less than the sampling period of {:.1} ms: sample faster",
                1e3 * mechanical_s,
                1e3 * period_s
            )
        })
    }
}

/// Without a standstill: the roughness of the signals, an upper bound of their noise.
fn or_roughness(noise: NoiseFloor, scenario: &Scenario) -> NoiseFloor {
    if noise.source != FloorSource::None {
        return noise;
    }
    let level = |values: &[f64], otherwise: f64| {
        let roughness = roughness(values);
        if roughness > 0.0 && otherwise.is_finite() { roughness } else { otherwise }
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

    fn run_of_brushed(events: Vec<(f64, f64)>, period_s: f64, seconds: f64) -> Run {
        recorded(&record(&brushed(), events, period_s, seconds, 2))
    }

    fn found(run: &Run) -> Vec<ParameterEstimate> {
        identify("output-error", run, &unknown()).unwrap().parameters
    }

    #[test]
    fn plateaus_at_20_hz_give_resistance_and_back_emf() {
        let found = found(&run_of_brushed(steps(1.0, 30.0, 12.0 / 70.0, 0.5), 0.05, 30.0));
        for (key, truth) in [("resistance_ohm", 1.2), ("back_emf_v_s_per_rad", 0.05)] {
            assert_covers(of(&found, key), truth, 0.1, 3.0);
        }
        let inductance = judged(&found, "inductance_h", Verdict::NotObservable);
        assert_says(inductance, &["at a period of 50.0 ms"]);
    }

    #[test]
    fn a_run_of_one_level_determines_only_combinations() {
        let mut run = run_of_brushed(vec![(0.0, 0.0), (0.5, 8.0)], 0.002, 2.0);
        put(&mut run, Channel::Current, vec![f64::NAN; 1000]);
        let mut model = brushed();
        for key in [MotorKey::Resistance, MotorKey::Inductance] {
            model.fixed.push(key.key().to_owned());
        }
        let found = identify("output-error", &run, &model).unwrap().parameters;
        let back_emf = judged(&found, "back_emf_v_s_per_rad", Verdict::NotObservable);
        assert_says(back_emf, &["together with", "load_torque_n_m", "several levels"]);
    }

    #[test]
    fn a_fault_of_a_signal_is_not_called_a_lack_of_excitation() {
        let run = run_of_brushed(steps(0.3, 4.0, 12.0 / 70.0, 0.2), 0.002, 4.0);
        // A speed that is wrong half of the time.
        let wild = |row: usize, speed: f64| [1.0, -0.7][row / 37 % 2] * speed;
        let found = found(&changed(&run, Channel::Speed, wild));
        for open in found.iter().filter(|parameter| parameter.value.is_none()) {
            assert!(!open.reason.as_deref().unwrap().contains("does not excite"), "{open:?}");
        }
    }
}
