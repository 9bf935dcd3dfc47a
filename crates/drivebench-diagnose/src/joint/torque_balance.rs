//! Balance of torques along a measured motion, where a torque or a current drives a run: its unbalanced torque takes the place of
//! the free run's prediction errors.
//!
//! ```text
//! Kt i - J dw/dt - friction - effects  =  disturbance + noise of the torque - J (n_k - n_(k-1)) / dt
//! ```
//!
//! One row for each interval between two measured speeds, with `n` their noise. A free run would integrate the noise of a measured
//! torque as if it moved the shaft (errors in variables: Soderstrom, Automatica 43, 2007): on a geared joint whose torque has a
//! noise of a tenth of its friction the inertia came out twenty times too large, and lags and ripples were fitted to the difference.

use super::kalman::{
    Covariance, Dynamics, FOLLOWED_COST, FilterGains, FilteredRun, Noise, Transition, Update,
    predicted_covariance, stationary, updated_covariance,
};
use super::process_noise::{FORM_SHARE, FormErrors, combined};
use crate::mechanical::SETTINGS;
use drivebench_model::numerics::statistics::{largest, median};
use drivebench_model::plant::{
    Instant, Model, MotorKey, REVERSAL_SHARE, Scenario, ShaftAngle, State, Sums,
};
use drivebench_model::signal;

/// Intervals, in usual ones, beyond which neither a held torque nor the mean of two speeds is a measurement.
const LONGEST_INTERVALS: f64 = 5.0;
/// Largest share of a torque that becomes friction again: beyond, a transmission is nearly self-locking.
const MOST_SLOPE: f64 = 0.9;

/// Motion over the interval that ends at a sample.
struct Row {
    interval_s: f64,
    /// Direction of motion; zero where the row is not used.
    direction: f64,
    /// Mean rate of the speed, rad/s2.
    rate: f64,
    /// Mean of the driving torque, N.m.
    drive_n_m: f64,
    /// Middle of the interval; its current is that which the model transmits.
    at: Instant,
}

/// Rows of a run.
fn rows(scenario: &Scenario, forms: &FormErrors) -> Vec<Row> {
    let (times, speeds) = (&scenario.sample_time_s, &scenario.speed_rad_s);
    let slow_rad_s = REVERSAL_SHARE * largest(speeds);
    let gaps = |times: Vec<f64>| -> Vec<f64> { times.windows(2).map(|t| t[1] - t[0]).collect() };
    let longest_s = LONGEST_INTERVALS * median(&gaps(times.clone()));
    let held_s: Vec<f64> = scenario.events.iter().map(|event| event.0).collect();
    let longest_hold_s = LONGEST_INTERVALS * median(&gaps(held_s.clone())).max(0.0);
    let angles = scenario.shaft_angle();
    let row = |sample: usize| {
        let (time_s, speed) = (times[sample], speeds[sample]);
        let last = sample.saturating_sub(1);
        let (last_s, last_speed) = (times[last], speeds[last]);
        let interval_s = time_s - last_s;
        let middle_s = 0.5 * (last_s + time_s);
        let speed_rad_s = 0.5 * (last_speed + speed);
        // The last value that drives in this interval may have been held for too long.
        let next = held_s.partition_point(|at_s| *at_s <= time_s);
        let since_s = next.checked_sub(1).map_or(f64::INFINITY, |k| time_s - held_s[k]);
        let is_used = interval_s > 0.0
            && interval_s <= longest_s
            && (since_s <= longest_hold_s || held_s.len() < 2)
            && speed.abs().min(last_speed.abs()) > slow_rad_s
            && speed * last_speed > 0.0;
        let drive = signal::mean(&scenario.events, last_s, time_s);
        let state = State::at(0.0, speed_rad_s);
        let time_of_row_s = middle_s - scenario.begin_s();
        let angle = ShaftAngle::at(signal::line_with_ends(&angles, middle_s));
        let at = Instant { angle, ..forms.instant(time_of_row_s, 0.0, &state) };
        let is_used = is_used && drive.is_finite();
        Row {
            interval_s,
            direction: if is_used { speed_rad_s.signum() } else { 0.0 },
            rate: if is_used { (speed - last_speed) / interval_s } else { 0.0 },
            drive_n_m: if is_used { at.torque_n_m_per_a * drive } else { 0.0 },
            at,
        }
    };
    (0..times.len()).map(row).collect()
}

/// Torque that the model transmits in a row, N.m, and its change per unit of another torque: friction under load adds to both.
#[derive(Clone, Copy)]
struct Transmitted {
    torque_n_m: f64,
    gain: f64,
}

fn transmitted(model: &Model, forms: &FormErrors, rows: &[Row]) -> Option<Vec<Transmitted>> {
    let value = |key| model.motor.get(key);
    let inertia = value(MotorKey::Inertia)?;
    let coulomb = value(MotorKey::LoadTorque).unwrap_or(0.0);
    let mut own: Vec<Vec<f64>> =
        forms.terms.iter().map(|terms| vec![0.0; terms.states()]).collect();
    let mut last_n_m = 0.0;
    let torque = |row: &Row| {
        let driven =
            |torque_n_m: f64| Instant { current_a: torque_n_m / row.at.torque_n_m_per_a, ..row.at };
        let mut sums_at = |at: &Instant, half_s: f64| {
            let each = forms.terms.iter().zip(&mut own);
            each.fold(Sums::default(), |sum, (terms, own)| {
                terms.advance(at, own, half_s);
                combined(&sum, &terms.sums(at, own), |sum, own| sum + own)
            })
        };
        let total = |sums: &Sums| {
            let friction = row.direction * (coulomb + sums.friction_n_m).max(0.0);
            inertia * (1.0 + sums.inertia_gain) * row.rate + friction + sums.torque_n_m
        };
        let mut torque_n_m = total(&sums_at(&driven(last_n_m), 0.5 * row.interval_s));
        for _ in 0..SETTINGS.passes_of_transmission {
            let next = total(&sums_at(&driven(torque_n_m), 0.0));
            let change = (next - torque_n_m).abs();
            torque_n_m = next;
            if change <= SETTINGS.proportional * torque_n_m.abs() {
                break;
            }
        }
        let step_n_m = 1e-3 * torque_n_m;
        let moved = total(&sums_at(&driven(torque_n_m + step_n_m), 0.0));
        let slope = if step_n_m == 0.0 { 0.0 } else { (moved - torque_n_m) / step_n_m };
        sums_at(&driven(torque_n_m), 0.5 * row.interval_s);
        last_n_m = torque_n_m;
        Transmitted { torque_n_m, gain: 1.0 / (1.0 - slope.min(MOST_SLOPE)) }
    };
    Some(rows.iter().map(torque).collect())
}

/// Whitened unbalanced torques with given gains.
struct Whitening {
    disturbance_n_m: f64,
    /// Noise of the last speed, rad/s.
    speed_rad_s: f64,
}

impl Whitening {
    fn next(
        &mut self,
        unbalanced_n_m: f64,
        decay: f64,
        transition: &Transition,
        update: &Update,
    ) -> f64 {
        self.disturbance_n_m *= decay;
        let [on_speed, on_load] = transition.propagator.gamma[1];
        let predicted_n_m = on_load * self.disturbance_n_m - on_speed * self.speed_rad_s;
        let reading = unbalanced_n_m - predicted_n_m;
        let error = if update.speed[4] > 0.0 { -reading } else { 0.0 };
        self.disturbance_n_m += update.speed[2] * error;
        self.speed_rad_s = update.speed[3] * error;
        error * update.speed[4]
    }
}

/// Filters `scenario` with `model`, computing the gains.
pub(super) fn filter_balance(
    model: &Model,
    scenario: &Scenario,
    noise: &Noise,
) -> Option<(FilterGains, FilteredRun)> {
    let forms = FormErrors::of(model, scenario);
    let dynamics = Dynamics::of(model, scenario)?;
    let rows = rows(scenario, &forms);
    let torques = transmitted(model, &forms, &rows)?;
    let mut gains =
        FilterGains { work: FOLLOWED_COST * rows.len() as u64, ..FilterGains::default() };
    let mut out = FilteredRun {
        stamp_variance: vec![[0.0; 2]; rows.len()],
        rates: vec![[0.0; 2]; rows.len()],
        ..FilteredRun::default()
    };
    let mut p = stationary(noise);
    let mut whitening = Whitening { disturbance_n_m: 0.0, speed_rad_s: 0.0 };
    for (sample, (row, Transmitted { torque_n_m, gain })) in rows.iter().zip(torques).enumerate() {
        let transmits_a = torque_n_m / row.at.torque_n_m_per_a;
        let state = State::at(transmits_a, row.at.speed_rad_s);
        let at = Instant { current_a: transmits_a, ..row.at };
        let (squares, _) = forms.at(&at, &state, row.rate, 0.0, 0.0);
        let mut propagator = dynamics.over(row.interval_s, row.direction == 0.0);
        propagator.gamma[1] = propagator.gamma[1].map(|on| gain * on);
        let transition = Transition {
            propagator,
            interval_s: row.interval_s,
            direction: row.direction,
            form: [0.0, FORM_SHARE * FORM_SHARE * squares[1], 0.0],
            input_share: 1.0,
            ..Transition::default()
        };
        let decay = (-row.interval_s / noise.correlation_s).exp();
        p = predicted_covariance(&p, &transition, &dynamics, noise, decay);
        let update = if row.direction == 0.0 { Update::default() } else { updated(&mut p, noise) };
        let unbalanced_n_m = row.direction.abs() * (row.drive_n_m - torque_n_m);
        let white = whitening.next(unbalanced_n_m, decay, &transition, &update);
        gains.rows += usize::from(row.direction != 0.0);
        gains.updates.push(update);
        gains.decays.push(decay);
        gains.transitions.push(transition);
        // The grid takes the means of both ends of an interval.
        let to = [transmits_a, scenario.speed_rad_s[sample]];
        if let Some(last) = out.after.last_mut() {
            last[0] = transmits_a;
        }
        out.before.push(to);
        out.after.push(to);
        out.white.push([0.0, white]);
        out.direction.push(row.direction);
    }
    Some((gains, out))
}

/// Gains of a row, which the covariance takes in.
fn updated(p: &mut Covariance, noise: &Noise) -> Update {
    let s = p[1][1] + noise.input.powi(2);
    let k = [0, 1, 2, 3].map(|state| p[state][1] / s);
    *p = updated_covariance(p, &k, 1);
    Update { speed: [k[0], k[1], k[2], k[3], 1.0 / s.sqrt()], ..Update::default() }
}

/// Whitened unbalanced torques of another model with these gains, and what that cost.
pub(super) fn unbalanced_with(
    gains: &FilterGains,
    model: &Model,
    scenario: &Scenario,
    out: &mut Vec<[f64; 2]>,
) -> Option<u64> {
    let forms = FormErrors::of(model, scenario);
    let rows = rows(scenario, &forms);
    let torques = transmitted(model, &forms, &rows)?;
    let mut whitening = Whitening { disturbance_n_m: 0.0, speed_rad_s: 0.0 };
    out.clear();
    for (sample, (row, Transmitted { torque_n_m, .. })) in rows.iter().zip(torques).enumerate() {
        let unbalanced_n_m = row.direction.abs() * (row.drive_n_m - torque_n_m);
        let (decay, update) = (gains.decays[sample], &gains.updates[sample]);
        let white = whitening.next(unbalanced_n_m, decay, &gains.transitions[sample], update);
        out.push([0.0, white]);
    }
    let is_finite = out.iter().all(|white| white[1].is_finite());
    is_finite.then_some(FOLLOWED_COST * rows.len() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joint::eligible::prepared;
    use crate::joint::free_run::unpredicted;
    use crate::joint::run::LinearisedRun;
    use crate::joint::tangent::Tangent;
    use crate::kit::with;
    use drivebench_model::plant::{Input, Motor};
    use drivebench_model::sample::Channel;

    const INERTIA_KG_M2: f64 = 2e-3;

    /// With friction under load of this ratio.
    fn machine(ratio: f64) -> Model {
        let motor = Motor::new("geared")
            .with(MotorKey::Inertia, INERTIA_KG_M2)
            .with(MotorKey::LoadTorque, 0.05);
        with(
            Model::baseline(motor),
            &[("viscous_friction", &[1e-3]), ("load_dependent_friction", &[ratio])],
        )
    }

    /// A shaft under `30 + 20 sin 3t`, its torque and speed with noise of these standard deviations.
    fn record(ratio: f64, torque_n_m: f64, speed_rad_s: f64) -> Scenario {
        let times: Vec<f64> = (0..4000).map(|k| 5e-3 * f64::from(k)).collect();
        let mut state = 7_u64;
        let mut normal = || {
            let uniform = |state: &mut u64| {
                *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (*state >> 11) as f64 / (1_u64 << 53) as f64
            };
            (0..12).map(|_| uniform(&mut state)).sum::<f64>() - 6.0
        };
        let torque = |middle_s: f64| {
            let (rate, speed) =
                (60.0 * (3.0 * middle_s).cos(), 30.0 + 20.0 * (3.0 * middle_s).sin());
            let sum = INERTIA_KG_M2 * rate + 0.05 + 1e-3 * speed;
            sum / (1.0 - ratio * sum.signum())
        };
        let events =
            times.iter().map(|t| (*t, torque(t + 2.5e-3) + torque_n_m * normal())).collect();
        let speed = times.iter().map(|t| 30.0 + 20.0 * (3.0 * t).sin() + speed_rad_s * normal());
        let speed_rad_s = speed.collect();
        let current_a = vec![f64::NAN; times.len()];
        let mut run = Scenario::planned("geared", Input::Torque, Channel::Torque, events, times);
        (run.current_a, run.speed_rad_s) = (current_a, speed_rad_s);
        run.find_scales();
        run
    }

    fn noise(torque_n_m: f64, speed_rad_s: f64) -> Noise {
        Noise {
            current_a: f64::INFINITY,
            speed_rad_s,
            disturbance_n_m: 1e-6,
            correlation_s: 1.0,
            input: torque_n_m,
            sensors: 2.0,
            stamps: 1.0,
            rounding: [0.0; 2],
        }
    }

    #[test]
    fn the_right_model_leaves_white_noise_of_torque_and_speed() {
        for (torque_n_m, speed_rad_s) in [(0.02, 1e-6), (1e-6, 0.05), (0.01, 0.02)] {
            let run = record(0.0, torque_n_m, speed_rad_s);
            let mut noise = noise(torque_n_m, speed_rad_s);
            // No error of a form.
            noise.correlation_s = 1e6;
            let (gains, out) = filter_balance(&machine(0.0), &run, &noise).unwrap();
            let white: Vec<f64> = out.white.iter().map(|white| white[1]).skip(1).collect();
            let n = white.len() as f64;
            assert_eq!(gains.rows, run.samples() - 1);
            for lag in 0..4 {
                let rho = white.iter().zip(&white[lag..]).map(|(a, b)| a * b).sum::<f64>() / n;
                let expected = f64::from(u8::from(lag == 0));
                assert!((rho - expected).abs() < 0.1, "{torque_n_m} {speed_rad_s} {lag}: {rho}");
            }
        }
    }

    #[test]
    fn noise_of_the_speeds_is_no_error_by_lost_rows() {
        let (model, run) = (machine(0.0), record(0.0, 0.01, 0.1));
        let balanced =
            LinearisedRun::new(&model, &run, State::default(), noise(0.01, 0.1)).unwrap();
        let unpredicted = unpredicted(&balanced);
        assert_eq!([unpredicted.lost_rows, unpredicted.stamps], [[0.0; 2]; 2]);
    }

    #[test]
    fn rows_are_apart_until_the_noise_of_the_speeds_is_a_small_part_of_their_rate() {
        let apart = |speed_rad_s: f64| {
            let run = record(0.0, 0.01, speed_rad_s);
            let prepared = prepared(&run, true);
            run.samples() as f64 / prepared.samples() as f64
        };
        assert!((apart(1e-6) - 1.0).abs() < 0.01);
        // A rate of 42 rad/s2: its square is a hundred times 2 (.1/dt)^2 from 34 ms on, which is seven periods.
        assert!((apart(0.1) - 8.0).abs() < 0.1, "{}", apart(0.1));
    }

    #[test]
    fn tangents_are_differences_of_two_balances() {
        let (model, run) = (machine(0.2), record(0.2, 0.01, 0.01));
        let balanced =
            LinearisedRun::new(&model, &run, State::default(), noise(0.01, 0.01)).unwrap();
        for (key, step) in [(MotorKey::Inertia, 1e-3 * INERTIA_KG_M2), (MotorKey::LoadTorque, 1e-5)]
        {
            let mut moved = model.clone();
            moved.motor.set(key, model.motor.get(key).unwrap() + step);
            let difference = balanced.difference(&moved, &run, step);
            let tangent = &balanced.tangent_columns(&[&Tangent::Motor(key, 1.0)])[0];
            let square = |values: &[f32]| values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
            let apart: Vec<f32> = difference.iter().zip(tangent).map(|(a, b)| a - b).collect();
            let off = (square(&apart) / square(&difference)).sqrt();
            assert!(off < 0.03, "{}: {off}", key.key());
        }
    }

    #[test]
    fn rows_about_a_reversal_and_over_a_gap_are_not_used() {
        let mut run = record(0.0, 1e-6, 1e-6);
        let times =
            run.sample_time_s.iter_mut().chain(run.events.iter_mut().map(|event| &mut event.0));
        times.for_each(|time_s| *time_s += if *time_s > 10.0 { 1.0 } else { 0.0 });
        run.speed_rad_s.iter_mut().for_each(|speed| *speed -= 30.0);
        let (gains, out) = filter_balance(&machine(0.0), &run, &noise(0.01, 0.01)).unwrap();
        let slow = |k: usize| run.speed_rad_s[k - 1..=k].iter().any(|w| w.abs() <= 0.3);
        let long = |k: usize| run.sample_time_s[k] - run.sample_time_s[k - 1] > 0.5;
        for k in 1..run.samples() {
            let reverses = run.speed_rad_s[k] * run.speed_rad_s[k - 1] <= 0.0;
            assert_eq!(out.direction[k] == 0.0, slow(k) || long(k) || reverses, "{k}");
        }
        assert!(gains.rows > 3000);
    }
}
