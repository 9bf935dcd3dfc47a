//! Resistance and back-EMF constant of the motor in a run, and whether two runs are of one motor.
//!
//! Only the armature circuit is simulated: its current from the voltage and the *measured* speed, exactly between
//! samples; `R`, `L`, `Ke` are fitted (Gauss-Newton), so that no load, friction or missing torque biases the
//! estimate, at any sampling period. A warm winding raises `R` by up to 40 %, a magnet changes `Ke` by 0.2 %/K at
//! most: two runs are judged by `Ke`, and by `R` only beyond what warmth explains.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::least_squares;
use drivebench_model::plant::{Input, Model, MotorKey, Scenario};

/// Settings of the fit of the armature circuit, and thresholds of the comparison.
struct Settings {
    /// Most samples that are used: enough for any motor, at a bounded cost.
    most_samples: usize,
    /// Samples below which nothing is fitted.
    fewest_samples: usize,
    /// Steps of Gauss-Newton at most.
    iterations: usize,
    /// Relative step of the differences.
    step: f64,
    /// Relative step of the fit below which it has converged.
    converged: f64,
    /// Largest move of a logarithm in one iteration.
    longest_move: f64,
    /// Relative standard deviation above which a value is not determined.
    largest_std_share: f64,
    /// Standard deviations that a difference must exceed.
    clear_sigmas: f64,
    /// Relative difference of `Ke` from which on two motors are doubtful: a magnet 15 K warmer.
    doubtful_back_emf_share: f64,
    /// The same from which on they are two: 30 K.
    other_back_emf_share: f64,
    /// Ratio of the resistances that warmth does not explain.
    other_resistance_ratio: f64,
}

const SETTINGS: Settings = Settings {
    most_samples: 60_000,
    fewest_samples: 100,
    iterations: 12,
    step: 1e-4,
    converged: 1e-5,
    longest_move: 0.7,
    largest_std_share: 0.1,
    clear_sigmas: 4.0,
    doubtful_back_emf_share: 0.03,
    other_back_emf_share: 0.06,
    other_resistance_ratio: 1.5,
};

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
    if scenario.input != Input::Voltage {
        return None;
    }
    let value = |key| start.motor.get(key).filter(|v: &f64| *v > 0.0);
    let mut x = [
        value(MotorKey::Resistance)?.ln(),
        value(MotorKey::Inductance)?.ln(),
        value(MotorKey::BackEmf)?.ln(),
    ];
    let (currents, speeds) = (&scenario.current_a, &scenario.speed_rad_s);
    let is_known = |row: &usize| currents[*row].is_finite() && speeds[*row].is_finite();
    let rows = (0..scenario.samples().min(SETTINGS.most_samples)).filter(is_known);
    let rows: Vec<usize> = rows.collect();
    if rows.len() < SETTINGS.fewest_samples {
        return None;
    }
    let begin_s = scenario.sample_time_s[rows[0]];
    let block_s = scenario.scales.block_s();
    let block = |row: &usize| whole((scenario.sample_time_s[*row] - begin_s) / block_s);
    let blocks: Vec<usize> = rows.iter().map(block).collect();
    let mut covariance = DMatrix::zeros(3, 3);
    for iteration in 0..SETTINGS.iterations {
        let here = simulated(scenario, &rows, x);
        let mut jacobian = DMatrix::zeros(rows.len(), 3);
        for column in 0..3 {
            let mut moved = x;
            moved[column] += SETTINGS.step;
            for (row, there) in simulated(scenario, &rows, moved).iter().enumerate() {
                jacobian[(row, column)] = (there - here[row]) / SETTINGS.step;
            }
        }
        let left = rows.iter().zip(&here).map(|(row, i)| currents[*row] - i);
        let residual = DVector::from_iterator(rows.len(), left);
        let solution = least_squares::solve(&jacobian, &residual, &blocks)?;
        let mut largest = 0.0_f64;
        for (value, step) in x.iter_mut().zip(solution.x.iter()) {
            let step = step.clamp(-SETTINGS.longest_move, SETTINGS.longest_move);
            if !step.is_finite() {
                return None;
            }
            *value += step;
            largest = largest.max(step.abs());
        }
        covariance = solution.covariance;
        if largest < SETTINGS.converged {
            break;
        }
        if iteration + 1 == SETTINGS.iterations && largest > SETTINGS.largest_std_share {
            return None;
        }
    }
    // The inductance is a nuisance parameter: at coarse sampling it is the least certain.
    let of = |index: usize| {
        let value = x[index].exp();
        // Not a number where the run leaves it undetermined.
        let std = value * covariance[(index, index)].sqrt();
        (std < SETTINGS.largest_std_share * value).then_some(Value { value, std })
    };
    Some(Fingerprint { resistance_ohm: of(0)?, back_emf_v_s_per_rad: of(2)? })
}

/// Current at the rows, from the first row's measurement: exact under a held voltage and the speed of the middle of each
/// interval. `x` holds the logarithms of R, L and Ke.
fn simulated(scenario: &Scenario, rows: &[usize], x: [f64; 3]) -> Vec<f64> {
    let [resistance, inductance, back_emf] = x.map(f64::exp);
    let (times, events) = (&scenario.sample_time_s, &scenario.events);
    let rate = resistance / inductance;
    let mut current = scenario.current_a[rows[0]];
    let mut out = Vec::with_capacity(rows.len());
    out.push(current);
    let mut event = events.partition_point(|event| event.0 <= times[rows[0]]).max(1) - 1;
    // Equal steps share their exponential.
    let (mut last_step, mut last_decay) = (f64::NAN, 1.0);
    for pair in rows.windows(2) {
        let (begin_s, end_s) = (times[pair[0]], times[pair[1]]);
        let (from, to) = (scenario.speed_rad_s[pair[0]], scenario.speed_rad_s[pair[1]]);
        let mut now_s = begin_s;
        while now_s < end_s {
            while event + 1 < events.len() && events[event + 1].0 <= now_s {
                event += 1;
            }
            let next = events.get(event + 1);
            let next_s = next.map_or(end_s, |next| next.0.min(end_s));
            let step = next_s - now_s;
            #[expect(clippy::float_cmp, reason = "the very same step")]
            if step != last_step {
                (last_step, last_decay) = (step, (-rate * step).exp());
            }
            let share = (0.5 * (now_s + next_s) - begin_s) / (end_s - begin_s);
            let speed = from + share * (to - from);
            let settled = (events[event].1 - back_emf * speed) / resistance;
            current = settled + (current - settled) * last_decay;
            now_s = next_s;
        }
        out.push(current);
    }
    out
}

/// Whether two runs are of one motor.
pub fn matches(first: Fingerprint, second: Fingerprint) -> MotorMatch {
    let difference =
        |a: Value, b: Value| ((b.value - a.value) / a.value, b.std.hypot(a.std) / a.value);
    let (back_emf, back_emf_std) =
        difference(first.back_emf_v_s_per_rad, second.back_emf_v_s_per_rad);
    let (resistance, resistance_std) = difference(first.resistance_ohm, second.resistance_ohm);
    let clear = back_emf.abs() > SETTINGS.clear_sigmas * back_emf_std;
    let ratio = 1.0 + resistance;
    let not_warmth = !(1.0 / SETTINGS.other_resistance_ratio..=SETTINGS.other_resistance_ratio)
        .contains(&ratio)
        && resistance.abs() > SETTINGS.clear_sigmas * resistance_std;
    let kinship = if (clear && back_emf.abs() > SETTINGS.other_back_emf_share) || not_warmth {
        Kinship::Other
    } else if clear && back_emf.abs() > SETTINGS.doubtful_back_emf_share {
        Kinship::Doubtful
    } else {
        Kinship::Same
    };
    MotorMatch {
        first,
        second,
        kinship,
        back_emf_difference: back_emf,
        resistance_difference: resistance,
    }
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
            let found = fingerprint(&nameplate(), &run).unwrap();
            let (r, ke) = (found.resistance_ohm, found.back_emf_v_s_per_rad);
            assert!((r.value / 1.5 - 1.0).abs() < 0.02, "{found:?}");
            assert!((ke.value / 0.30 - 1.0).abs() < 0.003, "{found:?}");
            assert!(r.std < 0.02 && ke.std < 0.002, "{found:?}");
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
