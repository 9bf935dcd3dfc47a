//! The temperature of the resistance, and the resistance at 20 C.

use super::balance::scored_s;
use super::scheme::Identified;
use drivebench_model::numerics::statistics;
use drivebench_model::plant::{MotorKey, Scenario};
use drivebench_model::sample::{Channel, ParameterEstimate, Reason, Run, Verdict};

/// Temperature coefficient of copper's resistance at 20 C, 1/K (IEC 60028: 1/254.45 K).
pub const COPPER_PER_K: f64 = 0.003_93;
/// Key of the resistance at 20 C.
pub const KEY: &str = "resistance_at_20_c_ohm";

/// `R20 = R/(1 + alpha (T - 20))` for a copper winding of `resistance_ohm` at `temperature_c`.
fn resistance_at_20_c(resistance_ohm: f64, temperature_c: f64) -> f64 {
    resistance_ohm / (1.0 + COPPER_PER_K * (temperature_c - 20.0))
}

/// Adds the resistance at 20 C and a note on the temperature to the result of a scheme that has a resistance.
#[must_use]
pub fn complete(mut found: Identified, run: &Run, scenario: &Scenario) -> Identified {
    let key = MotorKey::Resistance.key();
    if let Some(resistance) = ParameterEstimate::find(&found.parameters, key) {
        let (at_20, note) = at_20_c(resistance, run, scenario);
        found.parameters.push(at_20);
        found.notes.extend(note);
    }
    found
}

/// The resistance at 20 C from that of the run, and a note on the temperature.
fn at_20_c(
    resistance: &ParameterEstimate,
    run: &Run,
    scenario: &Scenario,
) -> (ParameterEstimate, Option<String>) {
    let unit = MotorKey::Resistance.unit();
    let no =
        |code: Reason, reason: String| ParameterEstimate::not_observable(KEY, unit, code, reason);
    let Some(value) = resistance.value else {
        let reason = resistance.reason.as_deref().unwrap_or("no reason given");
        let code = resistance.code.unwrap_or(Reason::DependsOnAnother);
        return (no(code, format!("no resistance was found: {reason}")), None);
    };
    let readings = readings(run, scenario);
    if readings.is_empty() {
        let reason = "the winding's temperature is not known: the run has no temperature_c; \
                      resistance_ohm is that at the temperature of the run (copper: 0.39 % per K)";
        return (no(Reason::TemperatureUnknown, reason.to_owned()), None);
    }
    let mean_c = statistics::mean(&readings);
    let (least_c, most_c) = statistics::extent(&readings);
    // No winding is colder or hotter.
    if least_c < -60.0 || most_c > 300.0 {
        let reason = format!(
            "temperature_c is {mean_c:.1} C on average, with readings outside -60 to 300 C: a sensor fault, or another unit"
        );
        return (no(Reason::FaultyData, reason), None);
    }
    // Uniform distribution over the temperatures of the run.
    let spread_k = (most_c - least_c) / 12f64.sqrt();
    let factor = resistance_at_20_c(1.0, mean_c);
    let std =
        resistance.std.map(|std| factor * std.hypot(value * factor * COPPER_PER_K * spread_k));
    let note = format!(
        "resistance_ohm is that at {mean_c:.1} C (mean of temperature_c over the rows used, {least_c:.1} to {most_c:.1} \
         C); at 20 C by copper's 0.00393 per K, if that is the winding's temperature"
    );
    let verdict = match resistance.verdict {
        // Given, but converted by a measured temperature.
        Verdict::Fixed => Verdict::Settled,
        verdict => verdict,
    };
    let at_20 = ParameterEstimate {
        key: KEY.to_owned(),
        value: Some(factor * value),
        std,
        unit,
        verdict,
        reason: resistance.reason.clone(),
        code: resistance.code,
    };
    (at_20, Some(note))
}

fn readings(run: &Run, scenario: &Scenario) -> Vec<f64> {
    let Some((first_s, last_s)) = scored_s(scenario) else { return Vec::new() };
    let points = run.points(Channel::Temperature);
    points.filter(|point| point.0 >= first_s && point.0 <= last_s).map(|point| point.1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{every, paper, put, run_of};
    use crate::verdict;

    fn run(temperature: Option<fn(f64) -> f64>) -> (Run, Scenario) {
        let times = every(0.1, 10.0);
        let columns = [Channel::Voltage, Channel::Current, Channel::Speed];
        let mut run = run_of(times.clone(), columns.map(|channel| (channel, times.clone())));
        if let Some(temperature) = temperature {
            put(&mut run, Channel::Temperature, times.iter().map(|t| temperature(*t)).collect());
        }
        let scenario = Scenario::from_run(&run).unwrap();
        (run, scenario)
    }

    fn resistance(verdict: Verdict) -> ParameterEstimate {
        ParameterEstimate {
            verdict,
            ..ParameterEstimate::found("resistance_ohm", "ohm", 1.3, 0.01, None)
        }
    }

    #[test]
    fn the_mean_temperature_of_the_scored_rows_counts() {
        assert!((resistance_at_20_c(1.393, 120.0) - 1.0).abs() < 1e-12);
        assert!((resistance_at_20_c(1.1, 20.0) - 1.1).abs() < 1e-15);
        // The range of the temperature widens the interval.
        let (run, mut scenario) = run(Some(|t| if t < 5.0 { 20.0 } else { 80.0 + 2.0 * t }));
        scenario.scored = 50..100;
        let (at_20, note) = at_20_c(&resistance(Verdict::Settled), &run, &scenario);
        let mean_c = 80.0 + 2.0 * 7.45;
        let expected = 1.3 / (1.0 + 0.003_93 * (mean_c - 20.0));
        assert!((at_20.value.unwrap() - expected).abs() < 1e-9, "{at_20:?}");
        let noise_alone = 0.01 * expected / 1.3;
        assert!(at_20.std.unwrap() > 1.3 * noise_alone, "{at_20:?}");
        assert_eq!(at_20.verdict, Verdict::Settled);
        assert!(note.unwrap().contains("94.9 C"));
    }

    #[test]
    fn without_a_temperature_or_a_resistance_there_is_no_value() {
        let (cold, scenario) = run(None);
        let (at_20, note) = at_20_c(&resistance(Verdict::Settled), &cold, &scenario);
        assert_eq!((at_20.value, at_20.std, note), (None, None, None));
        assert_eq!(at_20.verdict, Verdict::NotObservable);
        assert!(at_20.reason.unwrap().contains("not known"));
        let (warm, scenario) = run(Some(|_| 40.0));
        let none = verdict::unknown(MotorKey::Resistance, Reason::SignalMissing, "no current");
        let (at_20, _) = at_20_c(&none, &warm, &scenario);
        assert!(at_20.value.is_none() && at_20.reason.unwrap().contains("no current"));
        let (broken, scenario) = run(Some(|_| 6553.5));
        let (at_20, _) = at_20_c(&resistance(Verdict::Searching), &broken, &scenario);
        assert!(at_20.value.is_none() && at_20.reason.unwrap().contains("another unit"));
    }

    #[test]
    fn it_stands_beside_the_resistance_and_nowhere_else() {
        let (warm, scenario) = run(Some(|_| 45.0));
        let model = paper();
        let with = Identified::new("3", &model, vec![resistance(Verdict::Settled)]);
        let with = complete(with, &warm, &scenario);
        assert_eq!(with.parameters[1].key, KEY);
        assert_eq!(with.notes.len(), 1);
        let without = complete(Identified::new("2", &model, vec![]), &warm, &scenario);
        assert!(without.parameters.is_empty() && without.notes.is_empty());
    }
}
