//! Inverse dynamics: the balances differentiated and low-passed, then plain least squares; the field's reference.
//!
//! ```text
//! Run --(even grid, grid)--> angle or speed, current or torque
//!     --(zero-phase low pass, central differences, processing)--> speed, acceleration
//!     --(terms of the balance, columns)--> both sides low-passed again, one row in D --> least squares, mean of D fits
//! ```
//!
//! Gautier's inverse dynamic identification model with least squares, as Janot, Gautier and Brunot (2019) apply it to
//! their electromechanical axis: a zero-phase Butterworth low pass of order 4 on the measured position, central
//! differences, the same filter on both sides, decimation. A filter on both sides of a linear balance changes neither
//! side's coefficients; terms that are not linear in the signals (the sign of the speed) are formed from the filtered
//! speed. Shape parameters of effects stay as they are given.
//!
//! Decimation to the rate whose Nyquist frequency is the cut-off loses nothing and makes rows nearly independent. Which
//! of the D offsets is taken is chance (on a measured axis it moves the friction by 0.1 % at this rate, by 1 % at half
//! of it), so the mean over all offsets is given.

mod columns;
mod grid;
mod processing;
mod torque_rows;

use nalgebra::{DMatrix, DVector};

pub use self::grid::Motion;
pub use self::processing::Processing;
pub use self::torque_rows::torque_rows;

use self::columns::Rows;
use self::grid::Part;
use super::output_error::BLOCK_S;
use super::torque_ratio;
use super::verdict::judge;
use crate::numerics::count::whole;
use crate::numerics::filter::decimated;
use crate::numerics::least_squares;
use crate::plant::{Balance, Input, Model, MotorKey, Scenario, Slot};
use crate::sample::{ParameterEstimate, Run, Verdict};

/// An acceleration whose own part is less than this many times its noise (in power) carries no inertia.
const LEAST_SIGNAL: f64 = 4.0;
/// Period as a share of the electrical time constant beyond which the current is not resolved.
const SLOWEST: f64 = 0.5;
/// A left-hand side that varies less than this, relatively, is a stuck column and no measurement.
const STUCK: f64 = 1e-9;

/// Estimates of one balance, and how they came about.
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
    let mut equations = vec![Balance::Torque];
    if scenario.input == Input::Voltage {
        equations.insert(0, Balance::Voltage);
    }
    let gridded = grid::gridded(run, scenario);
    let mut model = model.clone();
    let mut balances = Vec::new();
    for equation in equations {
        let unknowns = unknowns(&model, scenario, equation);
        let balance = match &gridded {
            None => refused(
                equation,
                &unknowns,
                None,
                "no stretch of 60 samples without a gap tells speed or angle and what drives the shaft",
            ),
            Some(gridded) => {
                let processing = Processing::choose(gridded);
                balance(
                    &model,
                    scenario,
                    equation,
                    &unknowns,
                    &gridded.parts,
                    processing,
                )
            }
        };
        for estimate in &balance.parameters {
            if let (Some(key), Some(value)) = (MotorKey::from_key(&estimate.key), estimate.value) {
                model.motor.set(key, value);
            }
        }
        balances.push(balance);
    }
    // A torque has no armature circuit before it that would have to be resolved.
    if scenario.input != Input::Torque
        && let Some(gridded) = &gridded
        && let Some(ta_s) = model.motor.electrical_time_constant_s()
    {
        let period_s = gridded.parts[0].period_s;
        let slow = period_s > SLOWEST * ta_s;
        let all = balances.iter_mut().flat_map(|b| &mut b.parameters);
        all.filter(|_| slow)
            .for_each(|parameter| unresolved(parameter, period_s, ta_s));
    }
    balances
}

/// The current moves on between two samples, and half the samples miss it as well: what they differ by understates the
/// error, up to 2.3 times where the period equals the time constant (measured on the ZK-22FC at 10 ms).
fn unresolved(parameter: &mut ParameterEstimate, period_s: f64, ta_s: f64) {
    if parameter.value.is_none() || parameter.verdict == Verdict::Fixed {
        return;
    }
    parameter.std = parameter.std.map(|std| 3.0 * std);
    if parameter.verdict == Verdict::Settled {
        parameter.verdict = Verdict::Searching;
        parameter.reason = Some(format!(
            "the period of {:.1} ms does not resolve the armature circuit (L/R = {:.1} ms): use the output-error fit, or \
             sample faster",
            1e3 * period_s,
            1e3 * ta_s
        ));
    }
}

/// The parameters that enter a balance linearly, each with its value where that is fixed.
fn unknowns(model: &Model, scenario: &Scenario, equation: Balance) -> Vec<(Slot, Option<f64>)> {
    let keys: &[MotorKey] = match equation {
        Balance::Voltage => &[
            MotorKey::Resistance,
            MotorKey::Inductance,
            MotorKey::BackEmf,
        ],
        Balance::Torque => &[MotorKey::Inertia, MotorKey::LoadTorque],
    };
    let effects = model.slots().into_iter().filter(|slot| match slot {
        Slot::Effect { index, spec, .. } => {
            let enters = model.effects[*index]
                .effect
                .card()
                .enters
                .includes(equation);
            let driven = equation == Balance::Torque || scenario.input == Input::Voltage;
            enters && spec.is_coefficient() && driven
        }
        Slot::Motor(_) => false,
    });
    let motor = keys.iter().map(|key| Slot::Motor(*key));
    motor
        .chain(effects)
        .map(|slot| {
            let is_fixed = model.fixed.contains(&slot.key());
            (slot, model.get(&slot).filter(|_| is_fixed))
        })
        .collect()
}

fn refused(
    equation: Balance,
    unknowns: &[(Slot, Option<f64>)],
    processing: Option<Processing>,
    reason: &str,
) -> Balanced {
    let parameters = unknowns
        .iter()
        .map(|(slot, value)| match value {
            Some(value) => fixed(slot, *value),
            None => ParameterEstimate::not_observable(&slot.key(), slot.unit(), reason),
        })
        .collect();
    Balanced {
        equation,
        parameters,
        relative_error_percent: f64::NAN,
        rows: 0,
        rows_left_out: 0,
        offset_spread_percent: f64::NAN,
        processing,
    }
}

fn fixed(slot: &Slot, value: f64) -> ParameterEstimate {
    ParameterEstimate {
        key: slot.key(),
        value: Some(value),
        std: Some(0.0),
        unit: slot.unit(),
        verdict: Verdict::Fixed,
        reason: None,
    }
}

fn balance(
    model: &Model,
    scenario: &Scenario,
    equation: Balance,
    unknowns: &[(Slot, Option<f64>)],
    parts: &[Part],
    processing: Processing,
) -> Balanced {
    let slots: Vec<Slot> = unknowns.iter().map(|unknown| unknown.0).collect();
    let rows = |parts: &[Part], processing: &Processing| -> Vec<Rows> {
        let of_part = |part| columns::rows(model, scenario, equation, &slots, part, processing);
        parts.iter().filter_map(of_part).collect()
    };
    let full = rows(parts, &processing);
    if let Some(reason) = why_not(&full, scenario, equation, &slots) {
        return refused(equation, unknowns, Some(processing), &reason);
    }
    let Some(solved) = Solved::new(&full, unknowns, processing.decimation) else {
        let usable = full.iter().flat_map(|rows| &rows.valid).filter(|v| **v);
        let reason = format!(
            "{} usable rows: the shaft hardly moves in this run",
            usable.count()
        );
        return refused(equation, unknowns, Some(processing), &reason);
    };
    // The same filter on every second sample: what the samples miss between them moves the values. Where motion and
    // current are well resolved a third of the move would be the error at the full rate, where they are not all of it.
    let thinned: Vec<Part> = parts.iter().map(Part::thinned).collect();
    let thin = rows(&thinned, &processing);
    // Half the cut-off: signs and other terms that the filter blunts err the more the lower it is.
    let blunter = processing.at_half_cut_off();
    let blunt = rows(parts, &blunter);
    let others = [
        Solved::new(&thin, unknowns, (processing.decimation / 2).max(1)),
        Solved::new(&blunt, unknowns, blunter.decimation),
    ];
    let free: Vec<&Slot> = unknowns
        .iter()
        .filter(|unknown| unknown.1.is_none())
        .map(|unknown| &unknown.0)
        .collect();
    let relative = equation == Balance::Torque
        && scenario.input != Input::Torque
        && model.motor.torque_constant().is_none();
    let estimates = free.iter().enumerate().map(|(place, slot)| {
        let found = solved.judged(place, slot, &free, &others, &processing);
        if relative {
            torque_ratio::told(found)
        } else {
            gated(found, slot)
        }
    });
    let mut estimates = estimates.collect::<Vec<_>>().into_iter();
    let parameters = unknowns
        .iter()
        .map(|(slot, value)| match value {
            Some(value) => fixed(slot, *value),
            None => estimates
                .next()
                .expect("one estimate was made for every unknown that is not fixed"),
        })
        .collect();
    let total: usize = full.iter().map(|rows| rows.valid.len()).sum();
    Balanced {
        equation,
        parameters,
        relative_error_percent: solved.relative_error_percent,
        rows: total,
        rows_left_out: total - solved.rows,
        offset_spread_percent: solved.spread_percent,
        processing: Some(processing),
    }
}

/// Why these rows cannot be solved, if they cannot.
fn why_not(
    rows: &[Rows],
    scenario: &Scenario,
    equation: Balance,
    slots: &[Slot],
) -> Option<String> {
    let lefts = || rows.iter().flat_map(|rows| rows.left.iter().copied());
    if lefts().all(|left| !left.is_finite()) {
        let missing = match (equation, scenario.input) {
            (Balance::Voltage, _) => "voltage",
            (Balance::Torque, Input::Torque) => "torque",
            (Balance::Torque, _) => "current",
        };
        return Some(format!("the run has no {missing}"));
    }
    let unknown = |column: usize| {
        let mut cells = rows.iter().flat_map(|rows| &rows.columns[column]);
        cells.all(|cell| !cell.is_finite())
    };
    if let Some(slot) = (0..slots.len())
        .find(|column| unknown(*column))
        .map(|column| &slots[column])
    {
        return Some(match slot {
            Slot::Motor(_) => "the run has no current".to_owned(),
            Slot::Effect { id, .. } => {
                format!("effect {id} needs a signal that the run does not have (angle or current)")
            }
        });
    }
    let (least, most) = lefts().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), left| {
        (least.min(left), most.max(left))
    });
    let stuck = most - least <= STUCK * most.abs().max(least.abs());
    stuck.then(|| {
        format!("what drives the shaft is {most} throughout, to the last digit: no excitation, or a stuck column")
    })
}

/// The mean of the fits over all offsets of the decimation.
struct Solved {
    x: DVector<f64>,
    /// Mean of the block-clustered covariances: neighbouring offsets see the same noise, so averaging them gains nothing.
    covariance: DMatrix<f64>,
    bread: DMatrix<f64>,
    rows: usize,
    rows_per_fit: f64,
    relative_error_percent: f64,
    spread_percent: f64,
}

impl Solved {
    fn new(parts: &[Rows], unknowns: &[(Slot, Option<f64>)], decimation: usize) -> Option<Self> {
        let fits: Vec<Fit> = (0..decimation)
            .filter_map(|offset| Fit::new(parts, unknowns, decimation, offset))
            .collect();
        let count = fits.len() as f64;
        let first = fits.first()?;
        let size = first.solution.x.len();
        let zero = DMatrix::zeros(size, size);
        let mean = fits
            .iter()
            .fold(DVector::zeros(size), |sum, fit| sum + &fit.solution.x)
            / count;
        // A value that is lost in its noise is no measure for its own spread.
        let size_of = |place: usize| {
            let variance = first.solution.covariance[(place, place)];
            let std = if variance.is_finite() {
                variance.max(0.0).sqrt()
            } else {
                0.0
            };
            mean[place].abs().max(std).max(f64::MIN_POSITIVE)
        };
        let spread_percent = (0..size)
            .map(|place| {
                let squares: f64 = fits
                    .iter()
                    .map(|fit| (fit.solution.x[place] - mean[place]).powi(2))
                    .sum();
                100.0 * (squares / count).sqrt() / size_of(place)
            })
            .fold(0.0, f64::max);
        Some(Self {
            covariance: fits
                .iter()
                .fold(zero.clone(), |sum, fit| sum + &fit.solution.covariance)
                / count,
            bread: fits.iter().fold(zero, |sum, fit| sum + &fit.bread) / count,
            rows: fits.iter().map(|fit| fit.solution.residual.len()).sum(),
            rows_per_fit: fits
                .iter()
                .map(|fit| fit.solution.residual.len() as f64)
                .sum::<f64>()
                / count,
            relative_error_percent: 100.0
                * fits
                    .iter()
                    .map(|fit| fit.solution.residual.norm() / fit.level)
                    .sum::<f64>()
                / count,
            spread_percent,
            x: mean,
        })
    }

    fn judged(
        &self,
        place: usize,
        slot: &Slot,
        free: &[&Slot],
        others: &[Option<Self>],
        processing: &Processing,
    ) -> ParameterEstimate {
        let own = |place: usize| 1.0 / self.bread[(place, place)].max(f64::MIN_POSITIVE);
        let power = self.rows_per_fit * processing.acceleration_noise.powi(2);
        let accelerates = |slot: &Slot| matches!(slot, Slot::Motor(MotorKey::Inertia));
        let determined = self.covariance[(place, place)].is_finite();
        if determined && accelerates(slot) && own(place) < LEAST_SIGNAL * power {
            let reason = format!(
                "the acceleration is {:.1} times its noise in power, at least {LEAST_SIGNAL} is needed: \
                 the run does not excite it",
                own(place) / power
            );
            return ParameterEstimate::not_observable(&slot.key(), slot.unit(), reason);
        }
        // Noise in the acceleration pulls the inertia towards zero, and with it every value that shares its direction.
        let pull = free
            .iter()
            .position(|slot| accelerates(slot))
            .map_or(0.0, |inertia| {
                self.bread[(place, inertia)] * power * self.x[inertia]
            });
        let moves = others
            .iter()
            .flatten()
            .map(|other| other.x[place] - self.x[place]);
        let variance = self.covariance[(place, place)].max(0.0);
        let doubts = moves.chain([pull]).filter(|doubt| doubt.is_finite());
        let std = (variance + doubts.map(|doubt| doubt * doubt).sum::<f64>()).sqrt();
        let std = if determined { std } else { f64::NAN };
        judge(slot, self.x[place], Some(std), 1.0 / processing.rate_hz)
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
        unknowns: &[(Slot, Option<f64>)],
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
                for (cell, (_, value)) in line.iter().zip(unknowns) {
                    match value {
                        Some(value) => known += value * cell,
                        None => cells.push(*cell),
                    }
                }
                right.push(left[row] - known);
                blocks.push(whole((time_s[row] - begin_s) / BLOCK_S));
            }
        }
        let free = unknowns
            .iter()
            .filter(|unknown| unknown.1.is_none())
            .count();
        let matrix = DMatrix::from_row_slice(right.len(), free, &cells);
        let right = DVector::from_vec(right);
        let (bread, _) = least_squares::inverse_where_determined(&matrix);
        Some(Self {
            solution: least_squares::solve(&matrix, &right, &blocks)?,
            bread,
            level: right.norm().max(f64::MIN_POSITIVE),
        })
    }
}

/// Physics gates of a value that was found.
fn gated(found: ParameterEstimate, slot: &Slot) -> ParameterEstimate {
    let (Slot::Motor(_), Some(value)) = (slot, found.value) else {
        return found;
    };
    if value >= 0.0 {
        return found;
    }
    ParameterEstimate {
        verdict: Verdict::Invalid,
        reason: Some("negative, which physics forbids: check the signs of current, torque and motion, or add the effect that is missing".to_owned()),
        ..found
    }
}

#[cfg(test)]
mod tests;
