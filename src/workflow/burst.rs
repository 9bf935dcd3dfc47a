//! What a burst tells that the loop is too slow to see: resistance, inductance, and effects of the voltage.
//!
//! The loop samples at 10 ms and more, and the current has settled within L/R. A burst shows the whole transient.

use serde::Serialize;

use super::named_estimate::NamedEstimate;
use crate::diagnosis::{Evidence, diagnose};
use crate::identification::output_error::FitError;
use crate::identification::start;
use crate::numerics::count::whole;
use crate::plant::{Model, MotorKey, Scenario};
use crate::sample::ParameterEstimate;

/// What one burst said.
#[derive(Clone, Debug, Serialize)]
pub struct BurstResult {
    /// The capture, a run like any other.
    pub capture: String,
    pub rows: usize,
    pub rate_hz: f64,
    /// Resistance and inductance, with what the burst misses in the model.
    pub parameters: Vec<NamedEstimate>,
    /// What the burst itself shows to be missing, or why it could not be asked.
    pub effects: Vec<&'static str>,
    pub sentence: String,
}

impl BurstResult {
    /// Fits and diagnoses a burst by itself. Where the burst tells no inductance there is none in the result.
    pub fn of(nameplate: &Model, burst: &Scenario, capture: String) -> Self {
        let (rows, rate_hz) = (burst.samples(), rate_hz(burst));
        match told(nameplate, burst) {
            Ok((estimates, effects, sentence)) => Self {
                capture,
                rows,
                rate_hz,
                parameters: NamedEstimate::list(&estimates),
                effects,
                sentence,
            },
            Err(error) => Self {
                capture,
                rows,
                rate_hz,
                parameters: Vec::new(),
                effects: Vec::new(),
                sentence: format!("it tells nothing: {error}"),
            },
        }
    }

    pub fn value(&self, key: MotorKey) -> Option<f64> {
        self.parameters
            .iter()
            .find(|named| named.key == key.key())
            .and_then(|named| named.estimate.value)
    }

    /// The model from which the loop's own runs are fitted: what they cannot tell stays as the burst has it.
    pub fn improve(&self, mut model: Model) -> Model {
        if let Some(inductance_h) = self.value(MotorKey::Inductance) {
            model.motor.set(MotorKey::Inductance, inductance_h);
        }
        model
    }

    /// What the burst told, for the end of the loop.
    pub fn text(&self) -> String {
        let figures: Vec<String> = self
            .parameters
            .iter()
            .filter_map(|named| {
                let (value, std) = (named.estimate.value?, named.estimate.std?);
                // Two digits of the uncertainty.
                let digits = whole((1.0 - std.log10()).ceil().clamp(0.0, 9.0));
                Some(format!(
                    "{} {value:.digits$} +- {std:.digits$} {}; ",
                    named.key, named.estimate.unit
                ))
            })
            .collect();
        format!(
            "{} samples at {:.0} Hz in {}\n  {}{}",
            self.rows,
            self.rate_hz,
            self.capture,
            figures.concat(),
            self.sentence
        )
    }
}

type Told = (Vec<ParameterEstimate>, Vec<&'static str>, String);

fn told(nameplate: &Model, burst: &Scenario) -> Result<Told, FitError> {
    let model = start::complete(nameplate, burst)?;
    let diagnosis = diagnose(&model, Evidence::new(burst.clone(), None, None), false)?;
    let electrical = [MotorKey::Resistance, MotorKey::Inductance].map(MotorKey::key);
    let estimates = diagnosis
        .model
        .parameters
        .iter()
        .filter(|estimate| electrical.contains(&estimate.key.as_str()))
        .cloned()
        .collect();
    Ok((estimates, diagnosis.effects, diagnosis.sentence))
}

fn rate_hz(burst: &Scenario) -> f64 {
    match (burst.sample_time_s.first(), burst.sample_time_s.last()) {
        (Some(first), Some(last)) if last > first => (burst.samples() - 1) as f64 / (last - first),
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::Motor;
    use crate::sample::{Channel, Origin, Run};

    const RATE_HZ: f64 = 10_000.0;

    /// A locked shaft behind a step of 5 V, in closed form.
    fn burst(inductance_h: f64) -> Scenario {
        let at = |k: usize| k as f64 / RATE_HZ;
        let current = |time_s: f64| {
            let noise = 1e-3 * (time_s * 7919.0).sin();
            noise + 5.0 / 1.1 * (1.0 - (-(time_s - 0.01).max(0.0) * 1.1 / inductance_h).exp())
        };
        let rows = 1000;
        let mut run = Run::new("burst", (0..rows).map(at).collect()).unwrap();
        let column = |of: &dyn Fn(f64) -> f64| (0..rows).map(|k| of(at(k))).collect::<Vec<_>>();
        let volts = column(&|time_s| if time_s >= 0.01 - 1e-9 { 5.0 } else { 0.0 });
        run.set_column(Channel::Voltage, volts, Origin::Measured)
            .unwrap();
        run.set_column(Channel::Current, column(&current), Origin::Measured)
            .unwrap();
        run.set_column(Channel::Speed, column(&|_| 0.0), Origin::Measured)
            .unwrap();
        Scenario::from_run(&run).unwrap()
    }

    fn plate() -> Model {
        let motor = Motor::new("locked")
            .with(MotorKey::Resistance, 1.0)
            .with(MotorKey::Inductance, 0.02)
            .with(MotorKey::BackEmf, 0.35)
            .with(MotorKey::Inertia, 0.0045)
            .with(MotorKey::LoadTorque, 3.0);
        Model::baseline(motor)
    }

    #[test]
    fn the_inductance_of_a_burst_is_that_of_its_transient() {
        let result = BurstResult::of(&plate(), &burst(0.0099), "capture-01.csv".to_owned());
        let inductance_h = result.value(MotorKey::Inductance).unwrap();
        assert!((inductance_h / 0.0099 - 1.0).abs() < 0.01, "{result:?}");
        assert!((result.rate_hz - RATE_HZ).abs() < 1.0);
        let improved = result.improve(plate());
        assert_eq!(improved.motor.get(MotorKey::Inductance), Some(inductance_h));
        assert!(result.text().starts_with("1000 samples at 10000 Hz"));
    }

    #[test]
    fn a_burst_that_tells_nothing_says_so_and_changes_nothing() {
        let mut run = Run::new("burst", (0..50).map(|k| f64::from(k) / RATE_HZ).collect()).unwrap();
        for channel in [Channel::Voltage, Channel::Current, Channel::Speed] {
            run.set_column(channel, vec![0.0; 50], Origin::Measured)
                .unwrap();
        }
        let still = Scenario::from_run(&run).unwrap();
        let result = BurstResult::of(&plate(), &still, "c".to_owned());
        assert_eq!(result.value(MotorKey::Inductance), None, "{result:?}");
        assert_eq!(result.improve(plate()).motor, plate().motor);
    }
}
