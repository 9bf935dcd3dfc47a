//! The turning motor: five parameters by the output-error fit, and what follows from them for the next stage.

use super::{RestWinding, relative};
use crate::identification::noise::NoiseFloor;
use crate::identification::output_error;
use crate::identification::start;
use crate::plant::{Model, Motor, MotorKey, Scenario};
use crate::sample::{ParameterEstimate, Verdict};
use crate::text::number::with_std;

/// A motor as one round of turning shows it.
#[derive(Clone, Debug)]
pub(super) struct Turned {
    motor: Motor,
    parameters: Vec<ParameterEstimate>,
    period_s: f64,
}

/// Keys without which nothing can be planned.
const NEEDED: [MotorKey; 2] = [MotorKey::Resistance, MotorKey::BackEmf];
/// Mechanical time constant, in periods, below which the inertia leaves no trace between two samples.
const LEAST_PERIODS: f64 = 1.0;

pub(super) fn turned(scenario: &Scenario, rest: Option<RestWinding>) -> Result<Turned, String> {
    let noise =
        NoiseFloor::from_standstill(scenario).unwrap_or_else(|| NoiseFloor::from_spread(scenario));
    let unknown = Model::baseline(Motor::new("unknown"));
    let mut starts = vec![start::complete(&unknown, scenario).map_err(|error| error.to_string())?];
    if let Some(rest) = rest {
        let mut motor = Motor::new("unknown").with(MotorKey::Resistance, rest.resistance_ohm);
        motor.set(
            MotorKey::Inductance,
            rest.resistance_ohm * rest.time_constant_s,
        );
        let partial = Model::baseline(motor);
        starts.extend(start::complete(&partial, scenario));
    }
    let fit = output_error::fit(&starts, scenario, &noise).map_err(|error| error.to_string())?;
    let times = &scenario.sample_time_s;
    Ok(Turned {
        motor: fit.model.motor,
        parameters: fit.parameters,
        period_s: (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64,
    })
}

impl Turned {
    pub(super) fn parameters(&self) -> &[ParameterEstimate] {
        &self.parameters
    }

    /// The fitted motor. An inductance or inertia that the data do not carry has the value of the fit, which the data
    /// do not contradict; its verdict says so.
    pub(super) fn motor(&self) -> Motor {
        self.motor.clone()
    }

    /// Whether R and Ke, and J where it leaves a trace, are known to this relative standard deviation.
    pub(super) fn is_within(&self, most: f64) -> bool {
        self.worst() <= most
    }

    /// Largest relative standard deviation of R and Ke, and of J where it leaves a trace; infinite where one is not told.
    pub(super) fn worst(&self) -> f64 {
        let inertia_shows = self
            .mechanical_s()
            .is_none_or(|constant_s| constant_s > LEAST_PERIODS * self.period_s);
        NEEDED
            .into_iter()
            .chain(inertia_shows.then_some(MotorKey::Inertia))
            .map(|key| relative(&self.parameters, key).unwrap_or(f64::INFINITY))
            .fold(0.0, f64::max)
    }

    pub(super) fn mechanical_s(&self) -> Option<f64> {
        self.motor
            .mechanical_time_constant_s()
            .filter(|constant_s| constant_s.is_finite())
    }

    /// Friction as the current that overcomes it, A.
    pub(super) fn friction_a(&self) -> Option<f64> {
        let friction = self.motor.get(MotorKey::LoadTorque)?;
        let share = relative(&self.parameters, MotorKey::LoadTorque)?;
        (share < 0.5).then_some(friction / self.motor.torque_constant()?)
    }

    /// The resistance as the turning motor shows it; `None` where it is hardly known.
    pub(super) fn resistance(&self) -> Option<RestWinding> {
        let share = relative(&self.parameters, MotorKey::Resistance)?;
        let resistance_ohm = self.motor.get(MotorKey::Resistance)?;
        (share < super::KNOWN).then_some(RestWinding {
            resistance_ohm,
            std_ohm: share * resistance_ohm,
            time_constant_s: self.motor.electrical_time_constant_s()?,
        })
    }

    /// Voltage that turns the unloaded shaft at this speed, V, with the back-EMF at its lower bound.
    pub(super) fn voltage_at(&self, speed_rad_s: f64) -> Option<f64> {
        let share = relative(&self.parameters, MotorKey::BackEmf)?;
        let value = self.motor.get(MotorKey::BackEmf)?;
        let resistance = self.motor.get(MotorKey::Resistance)?;
        let friction_v = self.friction_a().unwrap_or(0.0) * resistance;
        (share < 0.3).then_some(value * (1.0 - 3.0 * share).max(0.5) * speed_rad_s + friction_v)
    }

    pub(super) fn text(&self) -> String {
        let of = |key: MotorKey| {
            let found = self.parameters.iter().find(|p| p.key == key.key());
            match found.and_then(|p| Some((p.value?, p.std?))) {
                Some((value, std)) => format!("{} {}", with_std(value, std), key.unit()),
                None => "not told".to_owned(),
            }
        };
        format!(
            "R {}, L {}, Ke {}, J {}, Mc {}",
            of(MotorKey::Resistance),
            of(MotorKey::Inductance),
            of(MotorKey::BackEmf),
            of(MotorKey::Inertia),
            of(MotorKey::LoadTorque)
        )
    }

    /// The parameter that is known worst, in a sentence.
    pub(super) fn worst_text(&self) -> String {
        let worst = self
            .parameters
            .iter()
            .filter(|p| {
                MotorKey::from_key(&p.key)
                    .is_some_and(|key| NEEDED.contains(&key) || key == MotorKey::Inertia)
            })
            .find(|p| p.verdict != Verdict::Settled);
        worst.map_or_else(
            || "the estimates did not settle".to_owned(),
            |p| {
                format!(
                    "{}: {}",
                    p.key,
                    p.reason.as_deref().unwrap_or("not settled")
                )
            },
        )
    }
}
