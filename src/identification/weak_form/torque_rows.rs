//! Windows of the torque balance with room for any term.
//!
//! Definition: windows of 60 ms that overlap by half, test function `(1 - s^2)^4`, quadrature by the trapezoid rule on the
//! true stamps; windows that touch a speed within the dead zone are left out. A given torque is held from one stamp to the
//! next, as the simulation holds it: each sample counts with its mean over half a period either side, else the trapezoid
//! rule sees it half a sample late (DISCOVERY.md 2.9). On the EMPS axis, at 1 kHz, that half millisecond is the difference
//! between a relative error of 3.40 % (2.04 % with friction that differs by direction) and one of 3.17 % (1.63 %).

use super::noise_share::{Noise, largest};
use super::window::{Window, held_mean};
use super::{FEWEST_HALF, TORQUE_HALF_S};
use crate::identification::torque_rows::{Method, TorqueRows, between, median_gap_s};
use crate::numerics::count::whole;
use crate::plant::{Input, Instant, Model, Scenario, ShaftAngle};

/// Periods without a measured torque across which it is not interpolated.
const LONGEST_GAP: f64 = 5.0;
/// Share of the largest speed below which friction is not yet developed: a reversal runs through presliding first.
const REVERSAL: f64 = 0.015;
/// Multiple of its nominal length beyond which a window spans a hole in the data.
const LONGEST_WINDOW: f64 = 2.0;

/// The torque balance of the scored part of `scenario`. `None` where no
/// window is left: the run has no torque (or no torque constant turns its current into one), or the shaft hardly moves.
pub fn torque_rows(model: &Model, scenario: &Scenario) -> Option<TorqueRows> {
    let noise = Noise::of(scenario);
    let (at, left) = samples(model, scenario);
    let times: Vec<f64> = at.iter().map(|at| at.time_s + scenario.begin_s()).collect();
    if times.len() < 2 * FEWEST_HALF {
        return None;
    }
    let period_s = median_gap_s(times.iter().copied());
    let half = whole((TORQUE_HALF_S / period_s).round()).max(FEWEST_HALF);
    let nominal_s = 2.0 * half as f64 * period_s;
    let scored_from_s = scenario.sample_time_s.get(scenario.scored.start)?;
    let scored_to_s = scenario
        .sample_time_s
        .get(scenario.scored.end.checked_sub(1)?)?;
    // Windows are laid on the samples that have a speed; the quadrature runs in true time.
    let mut grid = scenario.clone();
    grid.sample_time_s.clone_from(&times);
    let speeds: Vec<f64> = at.iter().map(|at| at.speed_rad_s).collect();
    let currents: Vec<f64> = at.iter().map(|at| at.current_a).collect();
    let dead_zone_rad_s = noise.dead_zone_rad_s.max(REVERSAL * largest(&speeds));
    let (mut windows, mut inertia, mut lefts) = (Vec::new(), Vec::new(), Vec::new());
    let (mut gain, mut rate_gain) = (0.0, 0.0);
    for begin in (0..times.len().saturating_sub(2 * half)).step_by(half) {
        let end = begin + 2 * half;
        let resting = speeds[begin..=end]
            .iter()
            .any(|speed| speed.abs() <= dead_zone_rad_s);
        let whole_window = times[end] - times[begin] <= LONGEST_WINDOW * nominal_s;
        let scored = times[begin] >= *scored_from_s && times[end] <= *scored_to_s;
        if resting || !whole_window || !scored {
            continue;
        }
        let window = Window::new(&grid, begin, end);
        let (rate, mean) = (window.mean_rate(&speeds), window.mean(&left));
        if !(rate.is_finite() && mean.is_finite()) {
            continue;
        }
        let norm = |weights: &[f64]| weights.iter().map(|w| w * w).sum::<f64>().sqrt();
        (gain, rate_gain) = (norm(&window.weights), norm(&window.rates));
        inertia.push(rate);
        lefts.push(mean);
        windows.push(window);
    }
    if windows.is_empty() {
        return None;
    }
    let averaged =
        |values: &[f64]| -> Vec<f64> { windows.iter().map(|window| window.mean(values)).collect() };
    Some(TorqueRows {
        method: Method::WeakForm,
        sentence: format!(
            "weak form: windows of {:.0} ms with the test function (1 - s^2)^4, nothing differentiated; windows that \
             touch speeds below {dead_zone_rad_s:.3} rad/s left out",
            1e3 * nominal_s,
        ),
        begin_s: scenario.begin_s(),
        time_s: windows.iter().map(|window| window.middle_s).collect(),
        speed_rad_s: averaged(&speeds),
        current_a: averaged(&currents),
        left: lefts,
        inertia,
        gain,
        rate_gain,
        span_s: nominal_s,
        at,
        averaging: Box::new(move |values| {
            windows.iter().map(|window| window.mean(values)).collect()
        }),
    })
}

/// Where the machine was at every sample that has a speed, and the motor's torque there.
fn samples(model: &Model, scenario: &Scenario) -> (Vec<Instant>, Vec<f64>) {
    let angles = scenario.shaft_angle();
    let events = &scenario.events;
    let longest_gap_s = LONGEST_GAP * median_gap_s(events.iter().map(|event| event.0));
    let kt = model.motor.torque_constant().unwrap_or(f64::NAN);
    let constants = Instant::of(&model.motor);
    let (mut at, mut left) = (Vec::new(), Vec::new());
    for (sample, &time_s) in scenario.sample_time_s.iter().enumerate() {
        let speed_rad_s = scenario.speed_rad_s[sample];
        if !speed_rad_s.is_finite() {
            continue;
        }
        let (current_a, torque_n_m, torque_n_m_per_a) = if scenario.input == Input::Torque {
            let torque = held_torque(scenario, sample, longest_gap_s);
            (torque, torque, 1.0)
        } else {
            let current = scenario.current_a[sample];
            (current, kt * current, kt)
        };
        at.push(Instant {
            time_s: time_s - scenario.begin_s(),
            voltage_v: f64::NAN,
            current_a,
            speed_rad_s,
            // Where the angle is not known at the very ends, its nearest value.
            angle: ShaftAngle::at(clamped(&angles, time_s)),
            torque_n_m_per_a,
            ..constants
        });
        left.push(torque_n_m);
    }
    (at, left)
}

/// Mean of the held torque about the sample; not a number beside a hole in its column.
fn held_torque(scenario: &Scenario, sample: usize, longest_gap_s: f64) -> f64 {
    let events = &scenario.events;
    let time_s = scenario.sample_time_s[sample];
    // Where the torque has a hole it is not known what was held.
    if between(events, time_s, longest_gap_s).is_finite() {
        held_mean(scenario, sample)
    } else {
        f64::NAN
    }
}

fn clamped(angles: &[(f64, f64)], time_s: f64) -> f64 {
    let (Some(first), Some(last)) = (angles.first(), angles.last()) else {
        return f64::NAN;
    };
    between(angles, time_s.clamp(first.0, last.0), f64::INFINITY)
}
