//! Scheme 1 over a recorded run, in its three forms.

use super::{Data, Identified, IdentifyError, Scheme, motor_alone};
use crate::noise::NoiseFloor;
use crate::recursive::Direction;
use crate::scheme_1::{
    Claim, Coefficients, Doubt, Dynamics, Form, Instrumental, InstrumentalError, Noise, Scheme1,
    Series, all_unknown, estimates, instrumental_variables, noise_free,
};
use crate::verdict::unknown;
use drivebench_model::numerics::statistics::{largest, median, robust_deviation};
use drivebench_model::plant::{Input, Model, MotorKey, Scenario};
use drivebench_model::sample::{ParameterEstimate, Reason};
use drivebench_model::signal;

/// Paper A's scheme 1 as printed, eq. (17).
pub(super) const PRINTED: Scheme = Scheme {
    id: "1",
    summary: "voltage and speed as paper A prints it: time constants, Ke, J, Mc (resistance known; T far below L/R)",
    identify: |id, data| least_squares(id, Form::Printed, data),
};

/// Scheme 1 with both voltage coefficients free and the poles taken exactly, eq. (13).
pub(super) const EXACT: Scheme = Scheme {
    id: "1-exact",
    summary: "as 1 without its assumption on the period: exact poles, needs a clean speed",
    identify: |id, data| least_squares(id, Form::Exact, data),
};

/// Scheme 1 by instrumental variables: free of the bias of sensor noise.
pub(super) const WITH_INSTRUMENTS: Scheme = Scheme {
    id: "1-iv",
    summary: "as 1-exact by instrumental variables: no bias from sensor noise, over a whole run",
    identify: instruments,
};

fn instruments(id: &'static str, data: &Data<'_>) -> Result<Identified, IdentifyError> {
    let grid = Grid::of(id, data)?;
    let note = format!(
        "instrumental variables over {} samples at {:.3} ms: free of the bias of sensor noise over a whole run in batch; over a memory of some tens of samples they scatter by tens of per cent",
        grid.speed_rad_s.len(),
        1e3 * grid.period_s
    );
    let parameters = match grid.instruments(data.model) {
        Ok(found) => {
            let covariance = Some(found.covariance);
            let mut parameters =
                estimates(&grid.claim(data.model, found.dynamics, covariance, None));
            if !found.converged {
                for parameter in &mut parameters {
                    parameter.unsettle(Reason::NotConverged, format!(
                            "not converged after {} rounds, or the model lacks an effect: its free run misses the speed by {:.3} rad/s, its equations by {:.3}",
                            found.rounds, found.free_run_rad_s, found.residual_rad_s
                        ));
                }
            }
            parameters
        }
        Err(error) => all_unknown(&error.to_string()),
    };
    Ok(finish(id, data.model, parameters).with_note(note))
}

fn least_squares(
    id: &'static str,
    form: Form,
    data: &Data<'_>,
) -> Result<Identified, IdentifyError> {
    let grid = Grid::of(id, data)?;
    let mut scheme = Scheme1::new(form, grid.period_s, 1.0);
    for k in 0..grid.speed_rad_s.len() {
        scheme.push(grid.voltage_v[k], grid.speed_rad_s[k], grid.direction[k]);
    }
    let parameters = match scheme.dynamics() {
        Ok(dynamics) => {
            let doubt = grid.doubt(form, data.model);
            let claim = grid.claim(data.model, dynamics, scheme.dynamics_covariance(), doubt);
            let mut parameters = estimates(&claim);
            if claim.doubt.is_none() {
                for parameter in &mut parameters {
                    parameter.unsettle(
                        Reason::MethodBiased,
                        "noise of the speed biases least squares, and by how much is not known: 1-iv finds no motor in this run",
                    );
                }
            }
            parameters
        }
        Err(rejection) => all_unknown(&format!("{rejection}; {}", rejection.help())),
    };
    let found = finish(id, data.model, parameters).with_note(
        "least squares on a measured speed: noise of the sensor biases it, the more the faster the sampling, and the standard deviations do not show that; each value is held against 1-iv on the same run",
    );
    Ok(if form == Form::Printed {
        found.with_note(
            "the printed form holds for T << Ta and T << TM: 5 % off at T = Ta/10, 20 to 100 % at T = Ta; 1-exact has no such limit",
        )
    } else {
        found
    })
}

/// Adds what was given, and takes the model's fixed values over.
fn finish(id: &'static str, model: &Model, mut parameters: Vec<ParameterEstimate>) -> Identified {
    let fixed = |key: MotorKey, value: f64| ParameterEstimate::fixed(key.key(), key.unit(), value);
    parameters.push(match model.motor.get(MotorKey::Resistance) {
        Some(value) => fixed(MotorKey::Resistance, value),
        None => unknown(
            MotorKey::Resistance,
            Reason::SignalMissing,
            "voltage and speed alone do not show it: give it in the model file",
        ),
    });
    let given = model.motor.get(MotorKey::TorqueConstant);
    parameters.extend(given.map(|value| fixed(MotorKey::TorqueConstant, value)));
    for parameter in &mut parameters {
        if let Some(key) = MotorKey::from_key(&parameter.key)
            && model.fixed.contains(&parameter.key)
            && let Some(value) = model.motor.get(key)
        {
            *parameter = fixed(key, value);
        }
    }
    Identified::new(id, model, parameters).leaving_out(model, motor_alone)
}

/// A run on an equidistant grid.
struct Grid {
    period_s: f64,
    /// Mean voltage over the period that ends at each sample.
    voltage_v: Vec<f64>,
    /// NaN where missing.
    speed_rad_s: Vec<f64>,
    /// Sign of the motion by a dead zone.
    direction: Vec<i8>,
    /// Noise of the speed at standstill, rad/s.
    noise_rad_s: Option<f64>,
}

impl Grid {
    fn of(scheme: &'static str, data: &Data<'_>) -> Result<Self, IdentifyError> {
        let refuse = |reason: String, help| data.refused(scheme, reason, help);
        let scenario = data.scenario;
        if scenario.input != Input::Voltage {
            return Err(refuse(
                "it has no voltage".to_owned(),
                "map one with --map voltage_v=HEADER; without a voltage use --scheme 2 or weak-form",
            ));
        }
        if scenario.speed_rad_s.iter().all(|speed| speed.is_nan()) {
            let help = "map one with --map speed_rad_s=HEADER (or angle_rad=HEADER)";
            return Err(refuse("it has no speed".to_owned(), help));
        }
        let first = scenario.events[0].1;
        let mut volts = scenario.events.iter().map(|event| event.1);
        if volts.all(|volts| (volts - first).abs() <= 1e-9 * first.abs()) {
            return Err(refuse(
                format!(
                    "the voltage is {first} V throughout, which shows neither the back-EMF constant nor the load apart"
                ),
                "excite with several levels of voltage",
            ));
        }
        let times = &scenario.sample_time_s;
        let steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let typical_s = median(&steps);
        let counts: Vec<f64> = steps.iter().map(|step| (step / typical_s).round()).collect();
        let period_s = (times[times.len() - 1] - times[0]) / counts.iter().sum::<f64>();
        let pairs = steps.iter().zip(&counts);
        let squares: f64 = pairs.map(|(step, count)| (step / period_s - count).powi(2)).sum();
        let jitter = (squares / steps.len() as f64).sqrt();
        // Not below for NaN either.
        let most_jitter = 0.02;
        let is_even = jitter < most_jitter;
        if !is_even {
            return Err(refuse(
                format!(
                    "scheme 1 needs equidistant samples, and here the step between samples deviates by {:.1} % of the period of {:.3} ms (at most {:.0} % is allowed)",
                    100.0 * jitter,
                    1e3 * period_s,
                    100.0 * most_jitter
                ),
                "use --scheme output-error, which takes every sample at its own stamp",
            ));
        }
        Ok(Self::fill(scenario, period_s, &counts))
    }

    fn fill(scenario: &Scenario, period_s: f64, counts: &[f64]) -> Self {
        let (mut voltage_v, mut speed_rad_s) = (vec![f64::NAN], vec![scenario.speed_rad_s[0]]);
        let times = &scenario.sample_time_s;
        for (index, count) in counts.iter().enumerate() {
            let (from_s, to_s) = (times[index], times[index + 1]);
            let length_s = (to_s - from_s) / count;
            let mut part = 1.0;
            while part <= *count {
                let end_s = from_s + part * length_s;
                voltage_v.push(signal::mean(&scenario.events, end_s - length_s, end_s));
                let measured = Some(scenario.speed_rad_s[index + 1]).filter(|_| part >= *count);
                speed_rad_s.push(measured.unwrap_or(f64::NAN));
                part += 1.0;
            }
        }
        voltage_v[0] = voltage_v.get(1).copied().unwrap_or(0.0);
        let noise_rad_s = NoiseFloor::from_standstill(scenario)
            .map(|floor| floor.speed_rad_s)
            .filter(|noise| noise.is_finite());
        // Noise guessed from the speed itself is at most 2 % of the largest speed.
        let guess = || roughness(&speed_rad_s).min(0.02 * largest(&speed_rad_s));
        let mut zone = Direction::with_noise(noise_rad_s.unwrap_or_else(guess));
        let direction = speed_rad_s.iter().map(|speed| zone.of(*speed)).collect();
        Self { period_s, voltage_v, speed_rad_s, direction, noise_rad_s }
    }

    const fn series(&self) -> Series<'_> {
        Series {
            period_s: self.period_s,
            voltage_v: self.voltage_v.as_slice(),
            speed_rad_s: self.speed_rad_s.as_slice(),
        }
    }

    fn instruments(&self, model: &Model) -> Result<Instrumental, InstrumentalError> {
        let motor = &model.motor;
        let start = (|| {
            let kt = motor.torque_constant()?;
            Some(Dynamics {
                ta_s: motor.electrical_time_constant_s()?,
                tm_s: motor.mechanical_time_constant_s()?,
                ke: motor.get(MotorKey::BackEmf)?,
                load_v: motor.get(MotorKey::LoadTorque)? * motor.get(MotorKey::Resistance)? / kt,
            })
        })();
        instrumental_variables(&self.series(), &self.direction, start)
    }

    fn claim(
        &self,
        model: &Model,
        dynamics: Dynamics,
        covariance: Option<[[f64; 4]; 4]>,
        doubt: Option<Doubt>,
    ) -> Claim {
        Claim {
            dynamics,
            covariance,
            period_s: self.period_s,
            resistance_ohm: model.motor.get(MotorKey::Resistance),
            torque_n_m_per_a: model.motor.get(MotorKey::TorqueConstant),
            doubt,
        }
    }

    /// What a least-squares estimate is held against: the instrumental variables; where they fail, the share of the noise.
    fn doubt(&self, form: Form, model: &Model) -> Option<Doubt> {
        let mut doubt = match self.instruments(model) {
            Ok(found) => Doubt {
                better: found.dynamics,
                covariance: Some(found.covariance),
                cause: format!(
                    "noise of the speed ({:.3} rad/s) biases least squares",
                    found.residual_rad_s
                ),
                systematic: None,
                source: "by 1-iv on the same run",
            },
            Err(_) => self.without_noise()?,
        };
        if form == Form::Printed {
            let there = Coefficients::of_motor(&doubt.better, self.period_s);
            let made = Dynamics::from_coefficients(Form::Printed, &there, self.period_s);
            let ratio = self.period_s / doubt.better.ta_s;
            doubt.systematic = made.ok().map(|made| {
                let cause = format!(
                    "T/Ta = {ratio:.2}: the printed form assumes T << Ta; use 1-exact or 1-iv"
                );
                (made, cause)
            });
        }
        Some(doubt)
    }

    fn without_noise(&self) -> Option<Doubt> {
        let noise = self.noise_rad_s.map_or(Noise::FromResidual, Noise::Known);
        let (better, sigma) = noise_free(&self.series(), &self.direction, noise)?;
        let known = if self.noise_rad_s.is_some() {
            "as at standstill"
        } else {
            "if all of the residual is that"
        };
        Some(Doubt {
            better,
            covariance: None,
            cause: format!("noise of the speed ({sigma:.3} rad/s, {known}) biases least squares"),
            systematic: None,
            source: "with its share taken out",
        })
    }
}

/// Standard deviation of white noise that would make the third differences as large as they are.
fn roughness(speed_rad_s: &[f64]) -> f64 {
    let third = speed_rad_s.windows(4).map(|w| w[3] - 3.0 * w[2] + 3.0 * w[1] - w[0]);
    let third: Vec<f64> = third.filter(|difference| difference.is_finite()).collect();
    let noise = robust_deviation(&third) / 20f64.sqrt();
    if noise.is_finite() { noise } else { 0.0 }
}
