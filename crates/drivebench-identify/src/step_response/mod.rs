//! Readings from one step of voltage out of rest: the off-line methods that paper A's introduction cites, as a
//! baseline for the other schemes.
//!
//! ```text
//! Scenario --(levels: the largest step out of rest that settles)--> Step
//!          --(reading: 73 % time, half-time height, areas; current's start, peak and end)--> TM, Ta, Ke, R, L, J, Mc
//! ```
//!
//! The speed after a step is `1/(Ta TM s^2 + TM s + 1)` of paper A's eq. (1). Graphical reading by Harriott (Process
//! Control, 1964): every such curve passes 73 % near `t = 1.3 TM`, and its height at `TM/2` gives the ratio of the time
//! constants; the chart is replaced by the closed form, which holds for oscillating responses as well. Analytic reading
//! by areas: `int (1 - y) dt = TM`, `int t (1 - y) dt = TM^2 - Ta TM`. Where the two disagree, the curve is not that of
//! the model, and the disagreement is the uncertainty.

mod reading;

pub use reading::{Reading, Step, read};

use crate::verdict::NOT_OBSERVABLE;
use drivebench_model::plant::{Model, MotorKey, Scenario};
use drivebench_model::sample::{ParameterEstimate, Reason, Verdict};

use crate::belief::KEYS;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Read {
    pub value: f64,
    pub std: f64,
}

impl Read {
    fn relative(self) -> f64 {
        self.std / self.value.abs().max(f64::MIN_POSITIVE)
    }

    /// A product or quotient of values: relative variances add.
    fn product(value: f64, factors: &[Self]) -> Self {
        let squares: f64 = factors.iter().map(|factor| factor.relative().powi(2)).sum();
        Self { value, std: value.abs() * squares.sqrt() }
    }
}

pub fn estimates(model: &Model, scenario: &Scenario) -> (Vec<ParameterEstimate>, Vec<String>) {
    let given = |key: MotorKey| {
        let is_fixed = model.fixed.iter().any(|fixed| fixed == key.key());
        model.motor.get(key).filter(|_| is_fixed)
    };
    let (values, notes) = match read(scenario) {
        Ok(reading) => (derived(model, &reading, &given), vec![reading.sentence()]),
        Err(reason) => (std::array::from_fn(|_| Err(reason.clone())), Vec::new()),
    };
    let [r, l, ke, j, mc, ta, tm] = values;
    let motor = KEYS.into_iter().zip([r, l, ke, j, mc]);
    let motor = motor.map(|(key, value)| match given(key) {
        Some(value) => ParameterEstimate::fixed(key.key(), key.unit(), value),
        None => judged(key.key(), key.unit(), value),
    });
    let times = [
        judged("electrical_time_constant_s", "s", ta),
        judged("mechanical_time_constant_s", "s", tm),
    ];
    (motor.chain(times).collect(), notes)
}

type Found = Result<Read, String>;

/// The parameters in the order of [`estimates`].
fn derived(
    model: &Model,
    reading: &Reading,
    given: &dyn Fn(MotorKey) -> Option<f64>,
) -> [Found; 7] {
    let or = |given: Option<f64>, found: &dyn Fn() -> Found| {
        given.map_or_else(found, |value| Ok(Read { value, std: 0.0 }))
    };
    let resistance = or(given(MotorKey::Resistance), &|| reading.resistance_ohm.clone());
    let voltage = reading.step.voltage_v;
    let (speed, current) = (reading.final_speed_rad_s, reading.final_current_a);
    let back_emf = or(given(MotorKey::BackEmf), &|| {
        let resistance = resistance.clone()?;
        let current = current.ok_or_else(|| {
            format!(
                "at most {:.5} V.s/rad (voltage over steady speed): without a current the drop R i is not known",
                voltage / speed.value
            )
        })?;
        let drop = Read::product(resistance.value * current.value, &[resistance, current]);
        let emf = Read { value: voltage - drop.value, std: drop.std };
        Ok(Read::product(emf.value / speed.value, &[emf, speed]))
    });
    let torque_constant = or(model.motor.get(MotorKey::TorqueConstant), &|| back_emf.clone());
    let mechanical = reading.mechanical_time_constant_s;
    let needed =
        |what: &str, found: &Found| found.clone().map_err(|why| format!("needs {what}: {why}"));
    let inertia = || -> Found {
        let resistance = needed("the resistance", &resistance)?;
        let back_emf = needed("the back-EMF constant", &back_emf)?;
        let kt = needed("the torque constant", &torque_constant)?;
        let value = mechanical.value * back_emf.value * kt.value / resistance.value;
        Ok(Read::product(value, &[mechanical, back_emf, kt, resistance]))
    };
    let load = || -> Found {
        let current = current.ok_or("the run has no current")?;
        let kt = needed("the torque constant", &torque_constant)?;
        Ok(Read::product(kt.value * current.value.abs(), &[kt, current]))
    };
    let inductance = reading.inductance_h.clone().or_else(|why| {
        // From the shape of the speed, where the current is missing or sampled too slowly.
        let (Ok(ta), Ok(resistance)) = (&reading.electrical_time_constant_s, &resistance) else {
            return Err(why);
        };
        Ok(Read::product(ta.value * resistance.value, &[*ta, *resistance]))
    });
    let (inertia, load) = (inertia(), load());
    [
        resistance,
        inductance,
        back_emf,
        inertia,
        load,
        reading.electrical_time_constant_s.clone(),
        Ok(mechanical),
    ]
}

fn judged(key: &str, unit: &'static str, found: Found) -> ParameterEstimate {
    let read = match found {
        Ok(read) => read,
        Err(reason) => {
            return ParameterEstimate::not_observable(key, unit, Reason::NoStep, reason);
        }
    };
    let per_cent = 100.0 * read.relative();
    if !(read.value.is_finite() && read.relative() <= NOT_OBSERVABLE) {
        let reason =
            format!("read with an uncertainty of {per_cent:.0} %: the step does not show it");
        return ParameterEstimate::not_observable(key, unit, Reason::NotExcited, reason);
    }
    // One reading of one curve is never settled: nothing repeats it.
    let reason = format!("read from one step, uncertainty {per_cent:.1} %");
    let doubt = Some((Reason::ReadOnce, reason));
    let mut judged = ParameterEstimate::found(key, unit, read.value, read.std, doubt);
    if read.value <= 0.0 {
        let reason = "not positive: check the signs of voltage, current and speed";
        judged.set(Verdict::Invalid, Reason::Impossible, reason);
    }
    judged
}

#[cfg(test)]
mod tests;
