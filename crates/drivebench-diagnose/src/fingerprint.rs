//! Resistance and back-EMF constant of the motor in a run, and whether two runs are of one motor.
//!
//! Prediction errors with a disturbance torque as large as that of the largest current: no load, friction or missing torque biases
//! the estimate, at any sampling period. A warm winding raises `R` by up to 40 %, a magnet changes `Ke` by 0.2 %/K at most: two
//! runs are judged by `Ke`, and by `R` only beyond what warmth explains.

use serde::Serialize;

use super::joint::motor_constants;
use drivebench_model::plant::{Input, Model, MotorKey, Scenario};

/// Samples below which nothing is fitted.
const FEWEST_SAMPLES: usize = 100;
/// Relative standard deviation above which a value is not determined.
const LARGEST_STD_SHARE: f64 = 0.1;
/// Standard deviations that a difference must exceed.
const CLEAR_SIGMAS: f64 = 4.0;
/// Relative differences of `Ke` from which on two motors are doubtful, and are two: a magnet 15 K and 30 K warmer.
const DOUBTFUL_BACK_EMF_SHARE: f64 = 0.03;
const OTHER_BACK_EMF_SHARE: f64 = 0.06;
/// Ratio of the resistances that warmth does not explain.
const OTHER_RESISTANCE_RATIO: f64 = 1.5;

/// A value with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Value {
    pub value: f64,
    pub std: f64,
}

/// Estimates of the motor from one run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Fingerprint {
    pub resistance_ohm: Value,
    pub back_emf_v_s_per_rad: Value,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kinship {
    Same,
    /// More than one motor changes within a day, but possible with a hot magnet.
    Doubtful,
    Other,
}

/// Comparison of the motors of two runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MotorMatch {
    pub first: Fingerprint,
    pub second: Fingerprint,
    pub kinship: Kinship,
    /// Difference over the first run's value.
    pub back_emf_difference: f64,
    pub resistance_difference: f64,
}

/// Fits `R`, `L` and `Ke` to a run from the values of `start`; `None` where the run has no voltage, current or speed, or
/// does not determine them (`Ke` is not observable at rest).
pub fn fingerprint(start: &Model, scenario: &Scenario) -> Option<Fingerprint> {
    let rows = scenario.current_a.iter().zip(&scenario.speed_rad_s);
    let known = rows.filter(|row| row.0.is_finite() && row.1.is_finite()).count();
    if scenario.input != Input::Voltage || known < FEWEST_SAMPLES {
        return None;
    }
    let found = motor_constants(&start.motor, scenario)?;
    let of = |key: MotorKey| {
        let (_, value, std) = *found.iter().find(|own| own.0 == key)?;
        (std < LARGEST_STD_SHARE * value).then_some(Value { value, std })
    };
    Some(Fingerprint {
        resistance_ohm: of(MotorKey::Resistance)?,
        back_emf_v_s_per_rad: of(MotorKey::BackEmf)?,
    })
}

/// Whether two runs are of one motor.
pub fn matches(first: Fingerprint, second: Fingerprint) -> MotorMatch {
    let difference =
        |a: Value, b: Value| ((b.value - a.value) / a.value, b.std.hypot(a.std) / a.value);
    let (back_emf_difference, back_emf_std) =
        difference(first.back_emf_v_s_per_rad, second.back_emf_v_s_per_rad);
    let (resistance_difference, resistance_std) =
        difference(first.resistance_ohm, second.resistance_ohm);
    let is_clear = back_emf_difference.abs() > CLEAR_SIGMAS * back_emf_std;
    let is_beyond = |share: f64| is_clear && back_emf_difference.abs() > share;
    let warmth = 1.0 / OTHER_RESISTANCE_RATIO..=OTHER_RESISTANCE_RATIO;
    let is_not_warmth = !warmth.contains(&(1.0 + resistance_difference))
        && resistance_difference.abs() > CLEAR_SIGMAS * resistance_std;
    let kinship = if is_beyond(OTHER_BACK_EMF_SHARE) || is_not_warmth {
        Kinship::Other
    } else if is_beyond(DOUBTFUL_BACK_EMF_SHARE) {
        Kinship::Doubtful
    } else {
        Kinship::Same
    };
    MotorMatch { first, second, kinship, back_emf_difference, resistance_difference }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::nameplate;
    use drivebench_model::plant::testing;

    fn motor(resistance: f64, back_emf: f64) -> Model {
        let mut model = nameplate();
        model.motor.set(MotorKey::Resistance, resistance);
        model.motor.set(MotorKey::BackEmf, back_emf);
        model
    }

    fn run(model: &Model, period_s: f64, seed: u64) -> Scenario {
        let levels = [0.0, 40.0, 70.0, -50.0, 20.0, -80.0, 60.0];
        let events = levels.iter().enumerate().flat_map(|(k, level)| {
            let at_s = 0.6 * k as f64;
            [(at_s, *level), (at_s + 0.3, level * 1.1)]
        });
        testing::record(model, events.collect(), period_s, 4.2, seed)
    }

    #[test]
    fn the_values_are_those_of_the_motor_at_either_rate() {
        for (period_s, seed) in [(0.001, 1), (0.01, 2)] {
            let run = run(&motor(1.5, 0.30), period_s, seed);
            // Whatever inertia and friction the nameplate has.
            for (inertia_ratio, load_n_m) in [(1.0, 0.455), (5.0, 0.0), (0.2, 2.0)] {
                let mut start = nameplate();
                start.motor.set(MotorKey::Inertia, 0.0045 * inertia_ratio);
                start.motor.set(MotorKey::LoadTorque, load_n_m);
                let found = fingerprint(&start, &run).unwrap();
                let (r, ke) = (found.resistance_ohm, found.back_emf_v_s_per_rad);
                assert!((r.value / 1.5 - 1.0).abs() < 0.02, "{inertia_ratio} {found:?}");
                assert!((ke.value / 0.30 - 1.0).abs() < 0.003, "{inertia_ratio} {found:?}");
                assert!(r.std < 0.02 && ke.std < 0.002, "{inertia_ratio} {found:?}");
            }
        }
    }

    #[test]
    fn a_warm_winding_is_the_same_motor_and_another_magnet_is_not() {
        for (period_s, seed) in [(0.001, 3), (0.01, 4)] {
            let of = |model: &Model, seed| {
                fingerprint(&nameplate(), &run(model, period_s, seed)).unwrap()
            };
            let cold = of(&motor(1.1, 0.3538), seed);
            for (resistance, back_emf, kinship, why) in [
                (1.1, 0.3538, Kinship::Same, "the same"),
                (1.5, 0.3538, Kinship::Same, "40 % warmer copper"),
                (1.1, 0.3538 * 0.96, Kinship::Doubtful, "a hot magnet"),
                (1.1, 0.3538 * 1.1, Kinship::Other, "another magnet"),
                (2.2, 0.3538, Kinship::Other, "warmth does not double it"),
            ] {
                let other = of(&motor(resistance, back_emf), seed + 50);
                assert_eq!(matches(cold, other).kinship, kinship, "{why}");
            }
        }
    }

    #[test]
    fn a_run_without_excitation_gives_no_fingerprint() {
        let start = nameplate();
        let mut still = run(&start, 0.001, 5);
        still.events = vec![(0.0, 0.0)];
        still.speed_rad_s.fill(0.0);
        assert_eq!(fingerprint(&start, &still), None);
        let mut no_current = run(&start, 0.001, 6);
        no_current.current_a.fill(f64::NAN);
        assert_eq!(fingerprint(&start, &no_current), None);
    }
}
