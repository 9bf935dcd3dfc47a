//! Inverse dynamic identification model with least squares (IDIM-LS): the balances differentiated and low-passed on both sides.
//!
//! ```text
//! Run --(even grid, processing)--> angle or speed, current or torque
//!     --(zero-phase low pass, central differences, processing)--> speed, acceleration
//!     --(terms of the balance)--> both sides low-passed again, one row in D --> least squares, mean of D fits
//! ```
//!
//! As Janot, Gautier and Brunot (2019) apply it to their electromechanical axis: a zero-phase Butterworth low pass of order 4 on the measured position, central
//! differences, the same filter on both sides, decimation. A filter on both sides of a linear balance changes neither
//! side's coefficients; terms that are not linear in the signals (the sign of the speed) are formed from the filtered
//! speed. Shape parameters of effects stay as they are given.
//!
//! Decimation to the rate whose Nyquist frequency is the cut-off loses nothing and makes rows nearly independent. The choice
//! of the offset among D is arbitrary (on a measured axis it changes the friction by 0.1 % at this rate, by 1 % at half of it),
//! so the mean over all offsets is given.

mod processing;

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

pub use self::processing::{Motion, Processing};

use self::processing::{Measured, Part, filter, gridded, rate, spanned};
use super::balance::{
    self, Column, Derivation, Method, Signals, TorqueRows, Unknown, as_ratio, scored_s,
};
use super::verdict::judge;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::filter::{Butterworth, decimated};
use drivebench_model::numerics::least_squares;
use drivebench_model::numerics::statistics::extent;
use drivebench_model::plant::{
    Balance, Input, Instant, Model, MotorKey, Scenario, ShaftAngle, Slot,
};
use drivebench_model::sample::{ParameterEstimate, Reason, Run, Verdict};
use drivebench_model::signal;

#[derive(Clone, Debug)]
pub struct Balanced {
    pub equation: Balance,
    pub parameters: Vec<ParameterEstimate>,
    /// Norm of the residual over that of the left-hand side, per cent; NaN where nothing was solved.
    pub relative_error_percent: f64,
    /// Rows of both sides before decimation, and those left out at rest and at the ends.
    pub rows: usize,
    pub rows_left_out: usize,
    /// Largest spread (standard deviation) of a value between the offsets of the decimation, per cent.
    pub offset_spread_percent: f64,
    /// `None` where the run has no motion to process.
    pub processing: Option<Processing>,
}

/// Fits both balances (the torque balance alone where there is no voltage). Angle or speed come from `run`, because the
/// angle is filtered before it is differentiated.
pub fn fit(model: &Model, run: &Run, scenario: &Scenario) -> Vec<Balanced> {
    let equations: &[Balance] = match scenario.input {
        Input::Voltage => &[Balance::Voltage, Balance::Torque],
        Input::Current | Input::Torque => &[Balance::Torque],
    };
    let gridded = gridded(&Measured::of_run(run, scenario.input), scenario);
    let mut model = model.clone();
    let mut balances = Vec::new();
    let mut torque_deviation = 0.0;
    for &equation in equations {
        let case = Case {
            model: &model,
            scenario,
            equation,
            left_deviation: torque_deviation,
            unknowns: balance::unknowns(&model, scenario, equation, |_| true),
        };
        let balance = match &gridded {
            None => case.refused(
                None,
                "no interval of 60 samples without a gap has the speed or angle and the current or torque",
            ),
            Some(gridded) => case.solved(&gridded.parts, Processing::choose(gridded)),
        };
        torque_deviation = balance::set_motor(&mut model, &balance.parameters);
        balances.push(balance);
    }
    // With a given torque there is no armature circuit to be resolved.
    if scenario.input != Input::Torque
        && let Some(gridded) = &gridded
        && let Some(ta_s) = model.motor.electrical_time_constant_s()
    {
        let period_s = gridded.parts[0].period_s;
        let slow = period_s > 0.5 * ta_s;
        let all = balances.iter_mut().flat_map(|b| &mut b.parameters);
        // Half of the samples resolve the current as badly as all: their difference underestimates the error, by up to 2.3 times
        // where the period equals the time constant (measured on the ZK-22FC at 10 ms).
        for parameter in all.filter(|p| slow && p.value.is_some() && p.verdict != Verdict::Fixed) {
            parameter.std = parameter.std.map(|std| 3.0 * std);
            parameter.unsettle(Reason::SampledTooSlowly, format!(
                "the period of {:.1} ms does not resolve the armature circuit (L/R = {:.1} ms): use the output-error fit, \
                 or sample faster",
                1e3 * period_s,
                1e3 * ta_s
            ));
        }
    }
    balances
}

struct Case<'a> {
    model: &'a Model,
    scenario: &'a Scenario,
    equation: Balance,
    /// Relative standard deviation of a factor of the left-hand side.
    left_deviation: f64,
    unknowns: Vec<Unknown>,
}

impl Case<'_> {
    fn refused(&self, processing: Option<Processing>, reason: &str) -> Balanced {
        let unsolved = |unknown: &Unknown| unknown.unsolved(reason);
        Balanced {
            equation: self.equation,
            parameters: self.unknowns.iter().map(unsolved).collect(),
            relative_error_percent: f64::NAN,
            rows: 0,
            rows_left_out: 0,
            offset_spread_percent: f64::NAN,
            processing,
        }
    }

    fn solved(&self, parts: &[Part], processing: Processing) -> Balanced {
        let unknowns = &self.unknowns;
        let rows = |parts: &[Part], processing: &Processing| -> Vec<Rows> {
            let of_part = |part| self.rows(part, processing);
            parts.iter().filter_map(of_part).collect()
        };
        let full = rows(parts, &processing);
        if let Some(reason) = self.reason_against(&full) {
            return self.refused(Some(processing), &reason);
        }
        let block_s = self.scenario.scales.block_s();
        let Some(solved) = Solved::new(&full, unknowns, block_s, processing.decimation) else {
            let usable = full.iter().flat_map(|rows| &rows.valid).filter(|v| **v);
            let reason =
                format!("{} usable rows: the shaft hardly moves in this run", usable.count());
            return self.refused(Some(processing), &reason);
        };
        // Richardson: the same filter on every second sample. Where motion and current are well resolved a third of the change is
        // the error at the full rate, else all of it.
        let thinned: Vec<Part> = parts.iter().map(Part::thinned).collect();
        let thin = rows(&thinned, &processing);
        // Half the cut-off: the error by the filtering of signs and other nonlinear terms grows as the cut-off falls.
        let blunter = processing.at_half_cut_off();
        let blunt = rows(parts, &blunter);
        let others = [
            Solved::new(&thin, unknowns, block_s, (processing.decimation / 2).max(1)),
            Solved::new(&blunt, unknowns, block_s, blunter.decimation),
        ];
        let free = unknowns.iter().filter(|unknown| unknown.fixed.is_none());
        let free: Vec<&Slot> = free.map(|unknown| &unknown.slot).collect();
        let relative = self.equation == Balance::Torque
            && self.scenario.input != Input::Torque
            && self.model.motor.torque_constant().is_none();
        let mut columns = 0..;
        let estimate = |unknown: &Unknown| {
            let column = (unknown.fixed.is_none()).then(|| columns.next()).flatten();
            let Some(column) = column else { return unknown.unsolved("") };
            let found = solved.judged(column, &free, &others, (&processing, self.left_deviation));
            if relative { as_ratio(found) } else { gated(found, &unknown.slot) }
        };
        let parameters = unknowns.iter().map(estimate).collect();
        let total: usize = full.iter().map(|rows| rows.valid.len()).sum();
        Balanced {
            equation: self.equation,
            parameters,
            relative_error_percent: solved.relative_error_percent,
            rows: total,
            rows_left_out: total - solved.rows,
            offset_spread_percent: solved.spread_percent,
            processing: Some(processing),
        }
    }

    fn reason_against(&self, rows: &[Rows]) -> Option<String> {
        let unknowns = &self.unknowns;
        let lefts = || rows.iter().flat_map(|rows| rows.left.iter().copied());
        if lefts().all(|left| !left.is_finite()) {
            let missing = match (self.equation, self.scenario.input) {
                (Balance::Voltage, _) => "voltage",
                (Balance::Torque, Input::Torque) => "torque",
                (Balance::Torque, _) => "current",
            };
            return Some(format!("the run has no {missing}"));
        }
        let unknown = |column: usize| {
            rows.iter().flat_map(|rows| &rows.columns[column]).all(|cell| !cell.is_finite())
        };
        if let Some(column) = (0..unknowns.len()).find(|column| unknown(*column)) {
            return Some(match &unknowns[column].slot {
                Slot::Motor(_) => "the run has no current".to_owned(),
                Slot::Effect { id, .. } => format!(
                    "effect {id} needs a signal that the run does not have (angle or current)"
                ),
            });
        }
        let (least, most) = extent(lefts());
        let stuck = most - least <= 1e-9 * most.abs().max(least.abs());
        stuck.then(|| format!(
            "the input of the balance is {most} in all rows, to the last digit: no excitation, or a constant column"
        ))
    }

    fn rows(&self, part: &Part, processing: &Processing) -> Option<Rows> {
        let (model, scenario, equation) = (self.model, self.scenario, self.equation);
        let filtered = Filtered::of(part, processing)?;
        let low_pass = |values: &[f64]| filtered.filter.zero_phase(values);
        let speed = &filtered.speed;
        let current = filtered.averaged_like_speed(&part.current_a);
        let left = match (equation, scenario.input) {
            (Balance::Voltage, _) => filtered.averaged_like_speed(&held_means(scenario, part)),
            (Balance::Torque, Input::Torque) => {
                spanned(&filtered.averaged_like_speed(&part.torque_n_m))
            }
            (Balance::Torque, Input::Voltage | Input::Current) => {
                // Without a torque constant in units of it: the caller reports that.
                let kt = model.motor.torque_constant().unwrap_or(1.0);
                spanned(&current).iter().map(|i| kt * i).collect()
            }
        };
        let at = |k: usize| Instant {
            time_s: part.time_s(k) - scenario.begin_s(),
            voltage_v: if equation == Balance::Voltage { left[k] } else { 0.0 },
            current_a: current[k],
            speed_rad_s: speed[k],
            angle: ShaftAngle::at(part.angle_rad[k]),
            ..Instant::of(&model.motor).in_run(scenario)
        };
        let signals = Signals { model, equation, current_a: &current, speed_rad_s: speed, at: &at };
        let column = |unknown: &Unknown| match signals.column(&unknown.slot) {
            Column::Values(values) => low_pass(&spanned(&values)),
            Column::Rate(values) => low_pass(&rate(&values, part.period_s)),
        };
        let reach = processing.reach(part.period_s);
        let valid = match equation {
            Balance::Voltage => vec![true; speed.len()],
            Balance::Torque => moving(speed, processing.dead_zone_rad_s, reach),
        };
        Some(Rows {
            time_s: (0..part.samples()).map(|k| part.time_s(k)).collect(),
            left: low_pass(&left),
            columns: self.unknowns.iter().map(column).collect(),
            valid: inside(valid, reach),
        })
    }
}

/// The mean of the fits over all offsets of the decimation.
struct Solved {
    x: DVector<f64>,
    /// Mean of the block-clustered covariances: neighbouring offsets have the same noise, so averaging them gains nothing.
    covariance: DMatrix<f64>,
    bread: DMatrix<f64>,
    rows: usize,
    rows_per_fit: f64,
    relative_error_percent: f64,
    spread_percent: f64,
}

impl Solved {
    fn new(parts: &[Rows], unknowns: &[Unknown], block_s: f64, decimation: usize) -> Option<Self> {
        let fits: Vec<Fit> = (0..decimation)
            .filter_map(|offset| Fit::new(parts, unknowns, block_s, decimation, offset))
            .collect();
        let count = fits.len() as f64;
        let first = fits.first()?;
        let size = first.solution.x.len();
        let (mut mean, mut covariance) =
            (DVector::<f64>::zeros(size), DMatrix::<f64>::zeros(size, size));
        let mut bread = covariance.clone();
        for fit in &fits {
            mean += &fit.solution.x;
            covariance += &fit.solution.covariance;
            bread += &fit.bread;
        }
        mean /= count;
        // Relative to the standard deviation where that is larger than the value.
        let size_of = |column: usize| {
            let std = first.solution.covariance[(column, column)].max(0.0).sqrt();
            let finite_std = if std.is_finite() { std } else { 0.0 };
            f64::abs(mean[column]).max(finite_std).max(f64::MIN_POSITIVE)
        };
        let spread = |column: usize| {
            let errors = fits.iter().map(|fit| fit.solution.x[column] - mean[column]);
            let squares: f64 = errors.map(|error| error.powi(2)).sum();
            100.0 * (squares / count).sqrt() / size_of(column)
        };
        let spread_percent = (0..size).map(spread).fold(0.0, f64::max);
        let rows: usize = fits.iter().map(|fit| fit.solution.residual.len()).sum();
        let errors = fits.iter().map(|fit| fit.solution.residual.norm() / fit.level);
        Some(Self {
            covariance: covariance / count,
            bread: bread / count,
            rows,
            rows_per_fit: rows as f64 / count,
            relative_error_percent: 100.0 * errors.sum::<f64>() / count,
            spread_percent,
            x: mean,
        })
    }

    fn judged(
        &self,
        column: usize,
        free: &[&Slot],
        others: &[Option<Self>],
        (processing, left_deviation): (&Processing, f64),
    ) -> ParameterEstimate {
        let slot = free[column];
        let partial = 1.0 / self.bread[(column, column)].max(f64::MIN_POSITIVE);
        let power = self.rows_per_fit * processing.acceleration_noise.powi(2);
        let is_inertia = |slot: &Slot| matches!(slot, Slot::Motor(MotorKey::Inertia));
        let determined = self.covariance[(column, column)].is_finite();
        if determined && is_inertia(slot) && partial < 4.0 * power {
            let reason = format!(
                "the acceleration is {:.1} times its noise in power, at least 4 is needed: \
                 the run does not excite it",
                partial / power
            );
            let code = Reason::NotExcited;
            return ParameterEstimate::not_observable(&slot.key(), slot.unit(), code, reason);
        }
        // Errors in variables: noise in the acceleration attenuates the inertia and biases every value that is correlated with it.
        let inertia = free.iter().position(|slot| is_inertia(slot));
        let bias = inertia.map_or(0.0, |j| self.bread[(column, j)] * power * self.x[j]);
        let changes = others.iter().flatten().map(|other| other.x[column] - self.x[column]);
        let variance = self.covariance[(column, column)].max(0.0);
        let errors = changes
            .chain([bias, left_deviation * self.x[column]])
            .filter(|error| error.is_finite());
        let std = (variance + errors.map(|error| error * error).sum::<f64>()).sqrt();
        let std = if determined { std } else { f64::NAN };
        judge(slot, self.x[column], Some(std), 1.0 / processing.rate_hz)
    }
}

/// One fit on every `decimation`-th row.
struct Fit {
    solution: least_squares::Solution,
    bread: DMatrix<f64>,
    level: f64,
}

impl Fit {
    fn new(
        parts: &[Rows],
        unknowns: &[Unknown],
        block_s: f64,
        decimation: usize,
        offset: usize,
    ) -> Option<Self> {
        let (mut cells, mut right, mut blocks) = (Vec::new(), Vec::new(), Vec::new());
        let begin_s = parts.first()?.time_s[0];
        for part in parts {
            let thinned = |values: &[f64]| decimated(values, decimation, offset);
            let columns: Vec<Vec<f64>> = part.columns.iter().map(|c| thinned(c)).collect();
            let (left, time_s) = (thinned(&part.left), thinned(&part.time_s));
            let valid = part.valid.iter().skip(offset).step_by(decimation);
            for (row, valid) in valid.enumerate() {
                let line: Vec<f64> = columns.iter().map(|column| column[row]).collect();
                if !valid || !left[row].is_finite() || line.iter().any(|cell| !cell.is_finite()) {
                    continue;
                }
                let mut known = 0.0;
                for (cell, unknown) in line.iter().zip(unknowns) {
                    match unknown.fixed {
                        Some(value) => known += value * cell,
                        None => cells.push(*cell),
                    }
                }
                right.push(left[row] - known);
                blocks.push(whole((time_s[row] - begin_s) / block_s));
            }
        }
        let free = unknowns.iter().filter(|unknown| unknown.fixed.is_none());
        let matrix = DMatrix::from_row_slice(right.len(), free.count(), &cells);
        let right = DVector::from_vec(right);
        let (bread, _) = least_squares::inverse_where_determined(&matrix);
        Some(Self {
            solution: least_squares::solve(&matrix, &right, &blocks)?,
            bread,
            level: right.norm().max(f64::MIN_POSITIVE),
        })
    }
}

/// A negative parameter of the motor is invalid.
fn gated(found: ParameterEstimate, slot: &Slot) -> ParameterEstimate {
    let negative = found.value.is_some_and(|value| value < 0.0);
    if !(negative && matches!(slot, Slot::Motor(_))) {
        return found;
    }
    ParameterEstimate {
        verdict: Verdict::Invalid,
        code: Some(Reason::Impossible),
        reason: Some("negative, which is impossible: check the signs of current, torque and motion, or add the effect that is missing".to_owned()),
        ..found
    }
}

/// Rows of one part before decimation.
struct Rows {
    time_s: Vec<f64>,
    left: Vec<f64>,
    /// One column per unknown.
    columns: Vec<Vec<f64>>,
    /// Whether the balance holds there: away from the ends and, for torques, from rest.
    valid: Vec<bool>,
}

/// The low-passed signals of one part.
struct Filtered {
    filter: Butterworth,
    /// The speed itself, or the central difference of the angle.
    speed: Vec<f64>,
    angular: bool,
}

impl Filtered {
    /// `None` where the part is sampled too slowly for the cut-off.
    fn of(part: &Part, processing: &Processing) -> Option<Self> {
        let filter = filter(processing.cut_off_hz, part.period_s)?;
        let angular = processing.motion == Motion::Angle;
        let motion = filter.zero_phase(&part.motion);
        let speed = if angular { rate(&motion, part.period_s) } else { motion };
        Some(Self { filter, speed, angular })
    }

    /// A low-passed signal, averaged over the span of the central difference where the speed is one.
    fn averaged_like_speed(&self, values: &[f64]) -> Vec<f64> {
        let filtered = self.filter.zero_phase(values);
        if self.angular { spanned(&filtered) } else { filtered }
    }
}

/// Excludes the ends of a part, where the filter has a transient.
fn inside(mut valid: Vec<bool>, reach: usize) -> Vec<bool> {
    let ends = reach.min(valid.len());
    let tail = valid.len() - ends;
    valid[..ends].fill(false);
    valid[tail..].fill(false);
    valid
}

/// False at rest and within the length of the filter from it, where the friction is less than the Coulomb torque (stiction). A
/// reversal, which is faster than the filter resolves, stays.
fn moving(speed: &[f64], dead_zone_rad_s: f64, reach: usize) -> Vec<bool> {
    let mut moving = vec![true; speed.len()];
    let shortest = (reach / 2).max(3);
    let mut begin = 0;
    for k in 0..=speed.len() {
        if speed.get(k).is_some_and(|w| w.abs() <= dead_zone_rad_s) {
            continue;
        }
        if k - begin >= shortest {
            let end = (k + reach).min(speed.len());
            moving[begin.saturating_sub(reach)..end].fill(false);
        }
        begin = k + 1;
    }
    moving
}

/// Exact mean of the held voltage over one period either side of each sample: the span of the central differences.
fn held_means(scenario: &Scenario, part: &Part) -> Vec<f64> {
    let (events, period_s) = (&scenario.events, part.period_s);
    let mean = |time_s: f64| signal::mean(events, time_s - period_s, time_s + period_s);
    (0..part.samples()).map(|k| mean(part.time_s(k))).collect()
}

/// One part of the run without gaps.
struct Stretch {
    /// The one of the decimation.
    filter: Butterworth,
    /// Its samples among all.
    samples: Range<usize>,
    /// Those of them in which the balance holds.
    valid: Vec<usize>,
}

impl Stretch {
    fn kept(&self, values: &[f64]) -> Vec<f64> {
        let filtered = self.filter.zero_phase(values);
        self.valid.iter().map(|row| filtered[*row]).collect()
    }
}

/// Rows of the reference processing with room for any term: the torque balance of the scored part of `scenario`, no row left
/// out by decimation. `None` where nothing can be processed.
///
/// Definition, as Janot, Gautier and Brunot (2019) process their axis: the position through a zero-phase Butterworth low
/// pass of order 4 at a tenth of the rate; speed and acceleration as central differences; terms formed from these; then
/// both sides of the balance through the low pass of a decimation, at half of that cut-off, so that one row in ten holds
/// all of it. Published figures are of those rows: on the EMPS axis a relative error of 4.08 %, and 3.11 % with friction
/// that differs by direction. Every row is taken here instead of one in ten, which after that filter gives the same
/// (4.03 to 4.11 % over the ten offsets, 4.07 % over all rows). Without it the figure is 4.30 %, and of one row in ten
/// between 3.97 and 4.60 %, because this axis reverses every 3.12 s exactly, always at the same offset.
pub fn torque_rows(model: &Model, scenario: &Scenario) -> Option<TorqueRows> {
    let gridded = gridded(&Measured::of_scenario(scenario), scenario)?;
    let processing = Processing::choose(&gridded);
    let (scored_from_s, scored_to_s) = scored_s(scenario)?;
    let decimating = processing.at_half_cut_off();
    let kt = model.motor.torque_constant().unwrap_or(f64::NAN);
    let constants = Instant::of(&model.motor);
    let angles = scenario.shaft_angle();
    let (mut at, mut stretches) = (Vec::new(), Vec::new());
    let (mut time_s, mut left, mut inertia) = (Vec::new(), Vec::new(), Vec::new());
    for part in &gridded.parts {
        let both_sides = filter(decimating.cut_off_hz, part.period_s);
        let Some((filtered, both_sides)) = Filtered::of(part, &processing).zip(both_sides) else {
            continue;
        };
        let speed = &filtered.speed;
        let (driving, per_unit) = if scenario.input == Input::Torque {
            (filtered.averaged_like_speed(&part.torque_n_m), 1.0)
        } else {
            (filtered.averaged_like_speed(&part.current_a), kt)
        };
        let reach = decimating.reach(part.period_s);
        let valid = inside(moving(speed, processing.dead_zone_rad_s, reach), reach);
        let within = |k: usize| (scored_from_s..=scored_to_s).contains(&part.time_s(k));
        let valid = (0..speed.len()).filter(|k| valid[*k] && within(*k));
        let one = Stretch {
            filter: both_sides,
            samples: at.len()..at.len() + speed.len(),
            valid: valid.collect(),
        };
        for (k, (&speed_rad_s, &drives)) in speed.iter().zip(&driving).enumerate() {
            let measured = Some(part.angle_rad[k]).filter(|angle| angle.is_finite());
            let angle_rad =
                measured.unwrap_or_else(|| signal::line_with_ends(&angles, part.time_s(k)));
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
        let torque: Vec<f64> = driving.iter().map(|value| per_unit * value).collect();
        left.extend(one.kept(&spanned(&torque)));
        inertia.extend(one.kept(&rate(speed, part.period_s)));
        time_s.extend(one.valid.iter().map(|row| part.time_s(*row)));
        stretches.push(one);
    }
    if left.is_empty() || left.iter().chain(&inertia).any(|cell| !cell.is_finite()) {
        return None;
    }
    // Over the span of the central difference, as the speed.
    let averaging = move |values: &[f64]| -> Vec<f64> {
        let term = |own: &Stretch| own.kept(&spanned(&values[own.samples.clone()]));
        stretches.iter().flat_map(term).collect()
    };
    Some(TorqueRows {
        method: Method::InverseDynamics,
        derivation: Derivation::InverseDynamics {
            then_hz: decimating.cut_off_hz,
            one_in: decimating.decimation,
            processing: Box::new(processing),
        },
        at,
        begin_s: scenario.begin_s(),
        scales: scenario.scales,
        time_s,
        left,
        spans: Vec::new(),
        inertia,
        gain: f64::NAN,
        rate_gain: f64::NAN,
        span_s: 1.0 / decimating.cut_off_hz,
        weights: Vec::new(),
        averaging: Box::new(averaging),
    })
}

#[cfg(test)]
mod tests;
