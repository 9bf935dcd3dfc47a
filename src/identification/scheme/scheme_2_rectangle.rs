//! Paper A's scheme 2 as printed: the left rectangle on every pair of samples.

use super::left_out::motor_alone;
use super::{Data, Identified, IdentifyError, Scheme};
use crate::identification::noise::NoiseFloor;
use crate::identification::recursive::{CurrentIntegral, Scheme2};
use crate::sample::{Channel, ParameterEstimate, Verdict};

pub(super) struct Rectangle;

impl Scheme for Rectangle {
    fn id(&self) -> &'static str {
        "2-rectangle"
    }

    fn summary(&self) -> &'static str {
        "scheme 2 as paper A prints it: left rectangle on every pair of samples (torque constant known)"
    }

    fn identify(&self, data: &Data<'_>) -> Result<Identified, IdentifyError> {
        let motor = &data.model.motor;
        let Some(torque_constant) = motor.torque_constant() else {
            return Err(IdentifyError::Unusable {
                scheme: self.id(),
                run: data.run.name.clone(),
                reason: "the torque constant is not known".to_owned(),
                help: "give torque_n_m_per_a or back_emf_v_s_per_rad in the model file",
            });
        };
        // No forgetting over a recorded run: every row counts alike.
        let mut rectangle = Scheme2::new(CurrentIntegral::Rectangle, 1.0, 0.0);
        let mut trapezoid = Scheme2::new(CurrentIntegral::Trapezoid, 1.0, 0.0);
        if let Some(floor) = NoiseFloor::from_standstill(data.scenario)
            && floor.speed_rad_s.is_finite()
        {
            rectangle.set_speed_noise(floor.speed_rad_s);
            trapezoid.set_speed_noise(floor.speed_rad_s);
        }
        for sample in data.run.samples() {
            if let (Some(current), Some(speed)) =
                (sample.get(Channel::Current), sample.get(Channel::Speed))
            {
                rectangle.push(sample.time_s, current, speed);
                trapezoid.push(sample.time_s, current, speed);
            }
        }
        let known = Some((torque_constant, 0.0));
        let mut parameters = rectangle.estimates(known);
        for (parameter, better) in parameters.iter_mut().zip(trapezoid.estimates(known)) {
            doubt(parameter, &better);
        }
        let found = Identified::new(self.id(), data.model, parameters).with_note(
            "left rectangle as printed: it lags the current by half a period; scheme 2 takes the trapezoid",
        );
        Ok(found.leaving_out(data.model, motor_alone))
    }
}

/// Difference from the trapezoid beyond which the rectangle's value is not called settled.
const VISIBLE: f64 = 0.02;

fn doubt(parameter: &mut ParameterEstimate, better: &ParameterEstimate) {
    let (Some(value), Some(other)) = (parameter.value, better.value) else {
        return;
    };
    let off = value / other - 1.0;
    if off.abs() <= VISIBLE {
        return;
    }
    let off = format!(
        "the left rectangle is {:+.1} % off the trapezoid ({other:.4e} {}) on the same rows",
        100.0 * off,
        parameter.unit
    );
    if parameter.verdict == Verdict::Settled {
        parameter.verdict = Verdict::Searching;
    }
    parameter.reason = Some(match parameter.reason.take() {
        Some(reason) => format!("{off}; {reason}"),
        None => off,
    });
}
