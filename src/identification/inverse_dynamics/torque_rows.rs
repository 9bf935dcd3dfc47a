//! Rows of the reference processing with room for any term.
//!
//! Definition, as Janot, Gautier and Brunot (2019) process their axis: the position through a zero-phase Butterworth low
//! pass of order 4 at a tenth of the rate; speed and acceleration as central differences; terms formed from these; then
//! both sides of the balance through the low pass of a decimation, at half of that cut-off, so that one row in ten holds
//! all of it. Published figures are of those rows: on the EMPS axis a relative error of 4.08 %, and 3.11 % with friction
//! that differs by direction. Every row is taken here instead of one in ten, which after that filter says the same
//! (4.03 to 4.11 % over the ten offsets, 4.07 % over all rows). Without it the figure is 4.30 %, and of one row in ten
//! anything between 3.97 and 4.60 %: this axis turns round every 3.12 s exactly, always at the same offset, and what the
//! filter rings with there is caught or missed.

use super::columns::moving;
use super::grid::{self, Motion};
use super::processing::{Processing, filter, rate, spanned};
use crate::identification::speed_from_angle;
use crate::identification::torque_rows::{Method, TorqueRows};
use crate::numerics::filter::Butterworth;
use crate::plant::{Input, Instant, Model, Scenario, ShaftAngle};
use crate::sample::{Channel, Origin, Run};

/// One part of the run without gaps.
struct Stretch {
    /// The one of the decimation.
    filter: Butterworth,
    /// Its samples among all.
    from: usize,
    to: usize,
    /// Rows that the balance holds in, counted from `from`.
    valid: Vec<usize>,
}

impl Stretch {
    /// Both sides go through the filter of the decimation; beside a central difference everything is averaged over its span.
    fn averaged(&self, values: &[f64]) -> Vec<f64> {
        let filtered = self
            .filter
            .zero_phase(&spanned(&values[self.from..self.to]));
        self.valid.iter().map(|row| filtered[*row]).collect()
    }
}

/// Where the shaft moves, away from the ends of the part, which the filter does not know.
fn moving_inside(speed: &[f64], dead_zone_rad_s: f64, reach: usize) -> Vec<bool> {
    let mut valid = moving(speed, dead_zone_rad_s, reach);
    let ends = reach.min(valid.len());
    let tail = valid.len() - ends;
    valid[..ends].fill(false);
    valid[tail..].fill(false);
    valid
}

/// Angle at the first point not before `time_s`, the last one beyond; not a number where there is none.
fn nearest_after(angles: &[(f64, f64)], time_s: f64) -> f64 {
    let after = angles.partition_point(|point| point.0 < time_s);
    angles
        .get(after.min(angles.len().saturating_sub(1)))
        .map_or(f64::NAN, |point| point.1)
}

/// The torque balance of the scored part of `scenario`; every row, none left out by decimation. `None`
/// where nothing can be processed.
pub fn torque_rows(model: &Model, scenario: &Scenario) -> Option<TorqueRows> {
    let run = as_run(scenario)?;
    let gridded = grid::gridded(&run, scenario)?;
    let processing = Processing::choose(&gridded);
    let scored_from_s = *scenario.sample_time_s.get(scenario.scored.start)?;
    let scored_to_s = *scenario
        .sample_time_s
        .get(scenario.scored.end.checked_sub(1)?)?;
    let decimating = processing.at_half_cut_off();
    let kt = model.motor.torque_constant().unwrap_or(f64::NAN);
    let constants = Instant::of(&model.motor);
    let angles = scenario.shaft_angle();
    let (mut at, mut stretches) = (Vec::new(), Vec::new());
    let (mut time_s, mut left, mut inertia) = (Vec::new(), Vec::new(), Vec::new());
    for part in &gridded.parts {
        let filters = [&processing, &decimating]
            .map(|processing| filter(processing.cut_off_hz, part.period_s));
        let [Some(filter), Some(both_sides)] = filters else {
            continue;
        };
        let angular = processing.motion == Motion::Angle;
        let beside = |values: Vec<f64>| if angular { spanned(&values) } else { values };
        let filtered = filter.zero_phase(&part.motion);
        let speed = if angular {
            rate(&filtered, part.period_s)
        } else {
            filtered
        };
        let by_torque = scenario.input == Input::Torque;
        let driving = beside(filter.zero_phase(if by_torque {
            &part.torque_n_m
        } else {
            &part.current_a
        }));
        let per_unit = if by_torque { 1.0 } else { kt };
        let reach = decimating.reach(part.period_s);
        let valid = moving_inside(&speed, processing.dead_zone_rad_s, reach);
        let within = |k: usize| (scored_from_s..=scored_to_s).contains(&part.time_s(k));
        let one = Stretch {
            filter: both_sides,
            from: at.len(),
            to: at.len() + speed.len(),
            valid: (0..speed.len())
                .filter(|k| valid[*k] && within(*k))
                .collect(),
        };
        for (k, (&speed_rad_s, &drives)) in speed.iter().zip(&driving).enumerate() {
            let measured = Some(part.angle_rad[k]).filter(|angle| angle.is_finite());
            let angle_rad = measured.unwrap_or_else(|| nearest_after(&angles, part.time_s(k)));
            at.push(Instant {
                time_s: part.time_s(k) - scenario.begin_s(),
                voltage_v: f64::NAN,
                current_a: drives,
                speed_rad_s,
                angle: ShaftAngle::at(angle_rad),
                torque_n_m_per_a: per_unit,
                ..constants
            });
        }
        let kept = |values: &[f64]| -> Vec<f64> {
            let filtered = one.filter.zero_phase(values);
            one.valid.iter().map(|row| filtered[*row]).collect()
        };
        let torque: Vec<f64> = driving.iter().map(|value| per_unit * value).collect();
        left.extend(kept(&spanned(&torque)));
        inertia.extend(kept(&rate(&speed, part.period_s)));
        time_s.extend(one.valid.iter().map(|row| part.time_s(*row)));
        stretches.push(one);
    }
    if left.is_empty() || left.iter().chain(&inertia).any(|cell| !cell.is_finite()) {
        return None;
    }
    let averaging = move |values: &[f64]| -> Vec<f64> {
        stretches
            .iter()
            .flat_map(|stretch| stretch.averaged(values))
            .collect()
    };
    let speeds: Vec<f64> = at.iter().map(|at| at.speed_rad_s).collect();
    let currents: Vec<f64> = at.iter().map(|at| at.current_a).collect();
    Some(TorqueRows {
        method: Method::InverseDynamics,
        sentence: processing.sentence_with(&format!(
            "then at {:.3} Hz, as for one row in {}; every row in motion",
            decimating.cut_off_hz, decimating.decimation
        )),
        speed_rad_s: averaging(&speeds),
        current_a: averaging(&currents),
        at,
        begin_s: scenario.begin_s(),
        time_s,
        left,
        inertia,
        gain: f64::NAN,
        rate_gain: f64::NAN,
        span_s: 1.0 / decimating.cut_off_hz,
        averaging: Box::new(averaging),
    })
}

/// The scenario as a recorded run: the processing filters the angle before it differentiates it, so it has to know
/// whether the speed was measured or derived from the angle.
fn as_run(scenario: &Scenario) -> Option<Run> {
    let driving = if scenario.input == Input::Torque {
        scenario.events.clone()
    } else {
        let samples = scenario.sample_time_s.iter().copied();
        samples
            .zip(scenario.current_a.iter().copied())
            .filter(|point| point.1.is_finite())
            .collect()
    };
    let speed: Vec<(f64, f64)> = scenario
        .sample_time_s
        .iter()
        .copied()
        .zip(scenario.speed_rad_s.iter().copied())
        .filter(|point| point.1.is_finite())
        .collect();
    let mut times: Vec<f64> = [&driving, &speed, &scenario.angle]
        .into_iter()
        .flat_map(|points| points.iter().map(|point| point.0))
        .collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let spread = |points: &[(f64, f64)]| -> Vec<f64> {
        let mut next = points.iter().peekable();
        times
            .iter()
            .map(|time_s| {
                next.next_if(|point| point.0 <= *time_s)
                    .map_or(f64::NAN, |point| point.1)
            })
            .collect()
    };
    let mut run = Run::new(scenario.name.clone(), times.clone()).ok()?;
    if !scenario.angle.is_empty() {
        let angle = spread(&scenario.angle);
        run.set_column(Channel::Angle, angle, Origin::Measured)
            .ok()?;
    }
    let drives = if scenario.input == Input::Torque {
        Channel::Torque
    } else {
        Channel::Current
    };
    let origin = if speed_from_angle::span(scenario).is_some() {
        Origin::Derived
    } else {
        Origin::Measured
    };
    run.set_column(drives, spread(&driving), Origin::Measured)
        .ok()?;
    run.set_column(Channel::Speed, spread(&speed), origin)
        .ok()?;
    Some(run)
}
