//! Identification of the electrical circuit from a burst: resistance, inductance, voltage effects.
//!
//! The exchanges of a run sample at 10 ms and more, when the current has settled (L/R). A burst shows the whole transient.

use std::fmt::Write as _;

use serde::Serialize;

use super::keyed::with_keys;
use drivebench_diagnose::{Diagnosis, Evidence, Status, diagnose};
use drivebench_identify::output_error::FitError;
use drivebench_identify::{start, weak_form};
use drivebench_model::plant::{Balance, Effect, Model, MotorKey, Scenario, effect};
use drivebench_model::sample::{ParameterEstimate, Reason};
use drivebench_model::text::number::{fixed, with_std};

#[derive(Clone, Debug, Default, Serialize)]
pub struct BurstResult {
    /// The capture, a run like any other.
    pub capture: String,
    pub rows: usize,
    pub rate_hz: f64,
    /// Resistance and inductance, with the effects in the circuit.
    #[serde(serialize_with = "with_keys")]
    pub parameters: Vec<ParameterEstimate>,
    pub effects: Vec<&'static str>,
    /// Each of those with one that the burst alone, which has one direction, does not distinguish from it.
    #[serde(skip)]
    confusable: Vec<[&'static str; 2]>,
    /// The residual of the voltage equation, or why it was not fitted; then the comparison with the diagnosis.
    pub sentence: String,
}

impl BurstResult {
    /// Fits the circuit to a burst alone. An inductance that is not observable in it has no value in the result.
    pub fn of(nameplate: &Model, burst: &Scenario, capture: String) -> Self {
        let found = circuit(nameplate, burst).unwrap_or_else(|error| Self {
            sentence: format!("no result: {error}"),
            ..Self::default()
        });
        Self { capture, rows: burst.samples(), rate_hz: rate_hz(burst), ..found }
    }

    pub fn value(&self, key: MotorKey) -> Option<f64> {
        self.parameters.iter().find(|own| own.key == key.key())?.value
    }

    /// The start of the fits to the runs, with the inductance of the burst unless it is negative (not physical).
    pub fn improve(&self, mut model: Model) -> Model {
        if let Some(inductance_h) = self.value(MotorKey::Inductance).filter(|value| *value > 0.0) {
            model.motor.set(MotorKey::Inductance, inductance_h);
        }
        model
    }

    /// Compares with the diagnosis of the runs, which decides: the burst is short and of the circuit alone. Of two effects that
    /// the burst does not distinguish, the one that the runs name is kept.
    #[must_use]
    pub fn with_diagnosis(mut self, diagnosis: &Diagnosis) -> Self {
        let names = |id: &str| diagnosis.effects.contains(&id);
        for id in &mut self.effects {
            let mut pairs = self.confusable.iter().filter(|pair| pair[0] == *id);
            if let Some([_, rival]) = pairs.find(|pair| !names(id) && names(pair[1])) {
                *id = *rival;
            }
        }
        for id in &self.effects {
            let named = diagnosis.effects.contains(id);
            let judged = diagnosis.candidates.iter().find(|c| c.effect == *id);
            let text = match judged.map(|candidate| candidate.status) {
                _ if named => "the runs show it too",
                Some(Status::NotExcited) | None => "the runs would not show it",
                Some(Status::Supported | Status::Possible) => "the runs leave it open",
                Some(Status::RuledOut) => "the runs rule it out",
            };
            let _ = write!(self.sentence, "; {id}: {text}");
        }
        self.sentence.push_str("; the diagnosis of all runs decides");
        self
    }

    /// The result of the burst for the end of the commissioning.
    pub fn text(&self) -> String {
        let figure = |own: &ParameterEstimate| {
            let text = with_std(own.value?, own.std?);
            Some(format!("{} {text} {}; ", own.key, own.unit))
        };
        let figures: String = self.parameters.iter().filter_map(figure).collect();
        format!(
            "{} samples at {} Hz in {}\n  {figures}{}",
            self.rows,
            fixed(self.rate_hz, 0),
            self.capture,
            self.sentence
        )
    }
}

/// Error of the voltage equation in units of its noise up to which it holds.
const HOLDS_TIMES_NOISE: f64 = 1.15;

/// The voltage equation alone, with the measured speed in it: just after a standstill the shaft sticks, slips and twists,
/// and in a free run the load would bias the inductance.
fn circuit(nameplate: &Model, burst: &Scenario) -> Result<BurstResult, FitError> {
    let model = start::complete(nameplate, burst)?;
    let plain = VoltageBalance::of(&model, burst);
    if let Some(reason) = plain.missing_reason() {
        return Ok(plain.result(None, format!("no result: {reason}")));
    }
    let residual = format!("the residual of its voltage equation is {}", plain.level());
    if plain.over_noise.is_some_and(|over| over <= HOLDS_TIMES_NOISE) {
        return Ok(plain.result(None, residual));
    }
    let diagnosis = diagnose(&model, Evidence::new(burst.clone(), None, None))?;
    let mut with = diagnosis.model.model;
    let of_circuit = |effect: &dyn Effect| effect.card().enters.includes(Balance::Voltage);
    with.effects.retain(|active| of_circuit(active.effect));
    let mut confusable = diagnosis.confusable;
    if with.effects.is_empty() {
        // What the record does not distinguish from an effect elsewhere stands for it, with all its rivals.
        let is_of_circuit = |pair: &&[&str; 2]| effect::find(pair[1]).is_some_and(of_circuit);
        if let Some([elsewhere, chosen]) = confusable.iter().find(is_of_circuit).copied() {
            with = with.with_effect(chosen)?;
            for pair in confusable.iter_mut().filter(|pair| pair[0] == elsewhere) {
                *pair = [chosen, if pair[1] == chosen { elsewhere } else { pair[1] }];
            }
        }
    }
    let better = VoltageBalance::of(&with, burst);
    let is_significant = |id: &&str| better.is_significant(id);
    let found: Vec<&'static str> = with.effect_ids().into_iter().filter(is_significant).collect();
    // Effects that leave more than 0.7 of the error explain too little of it.
    if found.is_empty() || better.rms_v > 0.7 * plain.rms_v {
        return Ok(plain.result(None, residual));
    }
    confusable.retain(|pair| found.contains(&pair[0]));
    let either = |id: &&'static str| {
        let rivals = confusable.iter().filter(|pair| pair[0] == *id);
        std::iter::once(*id).chain(rivals.map(|pair| pair[1])).collect::<Vec<&str>>().join(" or ")
    };
    let names = found.iter().map(either).collect::<Vec<_>>().join(" and ");
    let sentence = format!("{residual}, and with {names} {}", better.level());
    Ok(BurstResult { effects: found, confusable, ..better.result(Some(&names), sentence) })
}

struct VoltageBalance {
    parameters: Vec<ParameterEstimate>,
    rms_v: f64,
    /// The same over what noise alone would leave; none where the noise is not known.
    over_noise: Option<f64>,
}

impl VoltageBalance {
    fn of(model: &Model, burst: &Scenario) -> Self {
        let mut balances = weak_form::fit(model, burst).into_iter();
        let found = balances.find(|balanced| balanced.equation == Balance::Voltage);
        let Some(found) = found else {
            return Self { parameters: Vec::new(), rms_v: 0.0, over_noise: None };
        };
        let squares = found.residual.iter().map(|residual| residual.powi(2));
        let rms_v = (squares.sum::<f64>() / found.residual.len().max(1) as f64).sqrt();
        Self {
            rms_v,
            over_noise: found.noise_floor.map(|floor| rms_v / floor),
            parameters: found.parameters,
        }
    }

    fn missing_reason(&self) -> Option<String> {
        let resistance = self.parameters.first()?;
        resistance.reason.clone().filter(|_| resistance.value.is_none())
    }

    fn level(&self) -> String {
        self.over_noise.map_or_else(
            || format!("{:.2e} V (its noise is not known)", self.rms_v),
            |over| format!("{} times its noise", fixed(over, 2)),
        )
    }

    /// Whether the size of this effect differs from zero.
    fn is_significant(&self, id: &str) -> bool {
        let prefix = format!("{id}.");
        let is_certain = |p: &ParameterEstimate| {
            p.value.zip(p.std).is_some_and(|(value, std)| value.abs() > 3.0 * std)
        };
        self.parameters.iter().filter(|p| p.key.starts_with(&prefix)).any(is_certain)
    }

    /// Resistance and inductance; not settled where the residual exceeds the noise, or does so without effects: the range of
    /// the current in which a voltage drop builds up is not in its equation, and biases both.
    fn result(self, effects: Option<&str>, sentence: String) -> BurstResult {
        let electrical = [MotorKey::Resistance, MotorKey::Inductance].map(MotorKey::key);
        let doubt = match self.over_noise.filter(|over| *over > HOLDS_TIMES_NOISE) {
            Some(over) => Some((
                Reason::ModelMisses,
                format!(
                    "the residual of the voltage equation of the burst is {} times its noise: an effect is missing",
                    fixed(over, 2)
                ),
            )),
            None => effects.map(|effects| {
                (Reason::DependsOnAnother, format!("it depends on the form of {effects}"))
            }),
        };
        let mut parameters = self.parameters;
        parameters.retain(|estimate| electrical.contains(&estimate.key.as_str()));
        for estimate in &mut parameters {
            if let Some((code, reason)) = &doubt {
                estimate.unsettle(*code, reason.as_str());
            }
        }
        BurstResult { parameters, sentence, ..BurstResult::default() }
    }
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
    use drivebench_identify::noise::NoiseFloor;
    use drivebench_identify::output_error;
    use drivebench_model::plant::{Motor, testing};
    use drivebench_model::sample::{Channel, Origin, Run, Verdict};

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
        let volts = |time_s: f64| if time_s >= 0.01 - 1e-9 { 5.0 } else { 0.0 };
        let columns: [(Channel, &dyn Fn(f64) -> f64); 3] =
            [(Channel::Voltage, &volts), (Channel::Current, &current), (Channel::Speed, &|_| 0.0)];
        for (channel, of) in columns {
            let cells = (0..rows).map(|k| of(at(k))).collect();
            run.set_column(channel, cells, Origin::Measured).unwrap();
        }
        Scenario::from_run(&run).unwrap()
    }

    fn nameplate() -> Model {
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
        let result = BurstResult::of(&nameplate(), &burst(0.0099), "capture-01.csv".to_owned());
        let inductance_h = result.value(MotorKey::Inductance).unwrap();
        assert!((inductance_h / 0.0099 - 1.0).abs() < 0.01, "{result:?}");
        assert!((result.rate_hz - RATE_HZ).abs() < 1.0);
        assert_eq!(result.improve(nameplate()).motor.get(MotorKey::Inductance), Some(inductance_h));
        assert!(result.text().starts_with("1000 samples at 10000 Hz"));
    }

    #[test]
    fn a_negative_inductance_of_a_burst_improves_nothing() {
        let mut result = BurstResult::of(&nameplate(), &burst(0.0099), "c".to_owned());
        for own in &mut result.parameters {
            own.value = Some(-0.001);
        }
        assert_eq!(result.improve(nameplate()).motor, nameplate().motor);
    }

    #[test]
    fn friction_at_breakaway_is_no_part_of_the_inductance() {
        let mut truth = Model::baseline(Motor::zk_22fc()).with_effect("stribeck_friction").unwrap();
        truth.effects[0].values = vec![Some(0.16), Some(10.0)];
        // Steps of 1 V each 10 ms after a moment at rest, as the commands rise to the first level.
        let climb = (1..30).map(|step| (0.01 * f64::from(step), f64::from(step)));
        let events = std::iter::once((0.0, 0.0)).chain(climb).collect();
        let burst = testing::record(&truth, events, 1e-4, 0.3, 4);
        let result = BurstResult::of(&nameplate(), &burst, "c".to_owned());
        let inductance = result.parameters.iter().find(|p| p.key == "inductance_h");
        let estimate = inductance.unwrap();
        let (value, std) = (estimate.value.unwrap(), estimate.std.unwrap());
        assert!((value - 0.0099).abs() < 2.5 * std && std < 0.01 * value, "{value} +- {std}");
        assert!(result.effects.is_empty(), "{result:?}");
        let sentence = &result.sentence;
        assert!(sentence.contains("times its noise"), "{sentence}");
        assert!(!sentence.contains("nothing"), "{sentence}");
        // The free run of the five parameters puts the stiction into the inductance.
        let noise = NoiseFloor::from_standstill(&burst).unwrap();
        let free = output_error::fit(&[Model::baseline(Motor::zk_22fc())], &burst, &noise).unwrap();
        let free = free.model.motor.get(MotorKey::Inductance).unwrap();
        assert!((free / 0.0099 - 1.0).abs() > 3.0 * (value / 0.0099 - 1.0).abs(), "{free}");
    }

    #[test]
    fn a_value_that_depends_on_the_form_of_an_effect_is_not_settled() {
        let balance = || VoltageBalance::of(&nameplate(), &burst(0.0099));
        let settled = |result: BurstResult| {
            result.parameters.iter().any(|p: &ParameterEstimate| p.verdict == Verdict::Settled)
        };
        assert!(settled(balance().result(None, String::new())));
        assert!(!settled(balance().result(Some("voltage_drop"), String::new())));
    }

    #[test]
    fn a_burst_at_standstill_changes_nothing() {
        let mut run = Run::new("burst", (0..50).map(|k| f64::from(k) / RATE_HZ).collect()).unwrap();
        for channel in [Channel::Voltage, Channel::Current, Channel::Speed] {
            run.set_column(channel, vec![0.0; 50], Origin::Measured).unwrap();
        }
        let still = Scenario::from_run(&run).unwrap();
        let result = BurstResult::of(&nameplate(), &still, "c".to_owned());
        assert_eq!(result.value(MotorKey::Inductance), None, "{result:?}");
        assert_eq!(result.improve(nameplate()).motor, nameplate().motor);
    }
}
