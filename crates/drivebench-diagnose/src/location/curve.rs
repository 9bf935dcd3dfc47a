//! Axis map: each equation's error as a curve over one variable, with its uncertainty.
//!
//! The windows, the hat functions and the line are those of the location; added are knots that are refined where the
//! curvature is large, a covariance clustered in blocks of time, and the curve's share of an error of which the equation's own
//! parameters are fitted too. The current is no axis of the torque balance and the voltage none of the voltage
//! balance: they are what the balance is solved for.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::axis::{Search, hat};
use super::windows::{FEWEST_HALF, Windows, own_keys};
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error::FitError;
use drivebench_model::findings;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::least_squares;
use drivebench_model::plant::effect::Axis;
use drivebench_model::plant::{Balance, Input, Model, Scenario};
use drivebench_model::sample::TWO_SIDED_95;

/// Hat functions over speed, current or voltage, and over time.
const KNOTS: usize = 14;
const KNOTS_IN_TIME: usize = 24;
/// Harmonics of the angle, and the knots at which the curve over a turn is given.
const HARMONICS: usize = 4;
const KNOTS_OF_A_TURN: usize = 16;
/// Thresholds of the curve over an axis.
struct Settings {
    /// Share of the range that two knots are apart at least.
    closest_share: f64,
    /// Knots that a curve has at least.
    fewest_knots: usize,
    /// Knots that it may come to have.
    most_knots: usize,
    /// Rounds of refining.
    rounds: usize,
    /// What each of them must add to the share that is explained.
    worth_refining_share: f64,
    /// Share of an average knot's data below which a knot is left out, without data there.
    least_data_share: f64,
    /// Samples that half a window of the torque balance has at least: the shaft is slow, so that more of the noise can be
    /// averaged than of the winding's current.
    fewest_half_of_torque: usize,
    /// Standard deviations from which on a value is significant.
    found_sigmas: f64,
    /// Adjusted R2 below which no dependence on an axis is reported.
    follows_share: f64,
}

const SETTINGS: Settings = Settings {
    closest_share: 0.01,
    fewest_knots: 3,
    most_knots: 32,
    rounds: 5,
    worth_refining_share: 0.004,
    least_data_share: 0.02,
    fewest_half_of_torque: 5,
    found_sigmas: 3.0,
    follows_share: 0.1,
};

/// Error of one equation as a function of one axis.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AxisMap {
    /// `torque` or `voltage`.
    pub equation: &'static str,
    /// `speed_rad_s`, `current_a`, `voltage_v`, `angle_rad`, `time_s` (since the run's first command), or
    /// `frequency_hz`: a line in the spectrum of the torque error.
    pub axis: &'static str,
    /// Adjusted share of the error's variance that follows the axis.
    pub r2: f64,
    /// Places on the axis; of a line its frequency.
    pub knots: Vec<f64>,
    /// Error of the equation there, V or N.m, a loss counted positive; of a line its amplitude.
    pub values: Vec<f64>,
    /// Standard deviation of each value, clustered in blocks of time.
    pub std: Vec<f64>,
    /// Error of the equation after a fit of its own parameters, in units of the measurement noise;
    /// `None` where the noise is not known.
    pub error_over_noise: Option<f64>,
    #[serde(rename = "code")]
    pub finding: AxisFinding,
}

findings! {
    /// Whether an error follows an axis; `integrated` where the angle was not measured.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum AxisFinding {
        Followed { integrated: bool } = "error_follows_axis",
        NotFollowed { integrated: bool } = "error_does_not_follow_axis",
        Line = "line_in_spectrum",
        NoLine = "no_line_in_spectrum",
    }
}

impl AxisMap {
    /// Whether enough of the error follows the axis to be reported.
    pub fn is_followed(&self) -> bool {
        self.r2 >= SETTINGS.follows_share
    }

    /// The knot with the largest significant value.
    fn peak(&self) -> Option<usize> {
        let sure =
            |knot: &usize| self.values[*knot].abs() > SETTINGS.found_sigmas * self.std[*knot];
        (0..self.values.len())
            .filter(sure)
            .max_by(|a, b| self.values[*a].abs().total_cmp(&self.values[*b].abs()))
    }

    /// Confidence range of the position of its largest value, with that value: the knots around the peak that do not differ
    /// significantly from it.
    pub fn largest(&self) -> Option<(RangeInclusive<f64>, f64)> {
        let peak = self.peak()?;
        let height = self.values[peak];
        let is_as_large = |knot: &usize| {
            let uncertainty = self.std[peak].hypot(self.std[*knot]);
            (height - self.values[*knot]).abs() < TWO_SIDED_95 * uncertainty
        };
        let first = (0..peak).rev().take_while(is_as_large).last();
        let last = (peak + 1..self.knots.len()).take_while(is_as_large).last();
        let [first, last] = [first, last].map(|knot| self.knots[knot.unwrap_or(peak)]);
        Some((first..=last, height))
    }
}

/// The maps of both balances of a run, those that explain most first.
pub fn axis_map(
    model: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> Result<Vec<AxisMap>, FitError> {
    let mut maps = Vec::new();
    for equation in super::equations(scenario.input) {
        let fewest_half = match equation {
            Balance::Torque => SETTINGS.fewest_half_of_torque,
            Balance::Voltage => FEWEST_HALF,
        };
        let mut windows = Windows::new(model, scenario, noise, fewest_half)?;
        if windows.missing_signal().is_some() {
            break;
        }
        // Without a fit of its own the error of an equation would be that of values from another equation.
        if let Some(changes) = windows.own_changes(*equation) {
            windows.take_out(*equation, &changes);
        }
        let search =
            Search { windows: &windows, equation: *equation, own: own_keys(*equation).len() };
        let axes = axes(*equation, scenario.input).iter();
        maps.extend(axes.filter_map(|axis| search.map(*axis)));
        if *equation == Balance::Torque {
            maps.extend(search.line_map());
        }
    }
    maps.sort_by(|a, b| b.r2.total_cmp(&a.r2));
    Ok(maps)
}

/// The axes of a balance. The input of a run that is driven by current or torque is what its balance is solved for.
fn axes(equation: Balance, input: Input) -> &'static [Axis] {
    match (equation, input) {
        (Balance::Voltage, _) => &[Axis::Speed, Axis::Current, Axis::Angle, Axis::Time],
        (Balance::Torque, Input::Voltage) => &[Axis::Speed, Axis::Voltage, Axis::Angle, Axis::Time],
        (Balance::Torque, Input::Current | Input::Torque) => {
            &[Axis::Speed, Axis::Angle, Axis::Time]
        }
    }
}

/// Knots over what the run reached: of time evenly, else half way between as many samples each and even spacing, so that a
/// the curve is resolved where the run has few samples, too.
fn knots(axis: Axis, along: &[f64]) -> Vec<f64> {
    let mut sorted: Vec<f64> = along.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let (Some(&first), Some(&last)) = (sorted.first(), sorted.last()) else {
        return Vec::new();
    };
    let is_time = axis == Axis::Time;
    let intervals = if is_time { KNOTS_IN_TIME } else { KNOTS } - 1;
    let at = |knot: usize| {
        let even = first + knot as f64 / intervals as f64 * (last - first);
        let place = sorted[knot * (sorted.len() - 1) / intervals];
        if is_time { even } else { 0.5 * (place + even) }
    };
    let mut knots: Vec<f64> = (0..=intervals).map(at).collect();
    knots.dedup_by(|after, before| *after - *before <= SETTINGS.closest_share * (last - first));
    knots
}

/// Knots halfway beside the two sharpest bends of a curve.
fn refined(knots: &[f64], values: &[f64]) -> Option<Vec<f64>> {
    let last = knots.len() - 1;
    let closest = SETTINGS.closest_share * (knots[last] - knots[0]);
    let slope = |at: usize| (values[at + 1] - values[at]) / (knots[at + 1] - knots[at]);
    let bend = |at: usize| (slope(at) - slope(at - 1)).abs();
    let mut bends: Vec<usize> = (1..last).collect();
    bends.sort_by(|a, b| bend(*b).total_cmp(&bend(*a)));
    let mut finer = knots.to_vec();
    for at in bends.into_iter().take(2) {
        for (low, high) in [(at - 1, at), (at, at + 1)] {
            let middle = 0.5 * (knots[low] + knots[high]);
            if knots[high] - knots[low] > 2.0 * closest && !finer.contains(&middle) {
                finer.push(middle);
            }
        }
    }
    finer.sort_by(f64::total_cmp);
    (finer.len() > knots.len() && finer.len() <= SETTINGS.most_knots).then_some(finer)
}

/// Sines and cosines of the harmonics of an angle, times a weight, added to a row.
fn harmonics(angle_rad: f64, weight: f64, row: &mut [f64]) {
    for (index, cell) in row.iter_mut().enumerate() {
        let (sin, cos) = ((index / 2 + 1) as f64 * angle_rad).sin_cos();
        *cell += weight * if index % 2 == 0 { sin } else { cos };
    }
}

/// Regression of an error on columns besides the equation's own.
struct Explained {
    /// Adjusted share of the variance that the own columns leave.
    r2: f64,
    coefficients: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Root mean square of what the own columns leave.
    rms: f64,
    /// Windows beyond the own columns.
    spare: f64,
}

impl Search<'_> {
    /// Least squares of the error over rows whose first columns are the equation's own. The others count only with what these
    /// cannot explain as well; directions that are then lost (a curve over the current that is a resistance) stay at
    /// zero.
    fn explain(&self, rows: &[Vec<f64>]) -> Option<Explained> {
        let own = self.own;
        let added = rows.first()?.len() - own;
        if rows.len() <= own + added {
            return None;
        }
        let base = DMatrix::from_fn(rows.len(), own, |row, column| rows[row][column]);
        let columns = DMatrix::from_fn(rows.len(), added, |row, column| rows[row][own + column]);
        let errors = self.of().map(|window| window.error(self.equation));
        let errors = DMatrix::from_iterator(rows.len(), 1, errors);
        let (bread, _) = least_squares::inverse_where_determined(&base);
        let left_over = |of: &DMatrix<f64>| of - &base * (&bread * base.tr_mul(of));
        let (residual, columns) = (left_over(&errors).column(0).into_owned(), left_over(&columns));
        let (bread, _) = least_squares::inverse_where_determined(&columns);
        let coefficients = &bread * columns.tr_mul(&residual);
        let left = &residual - &columns * &coefficients;
        let spare = (rows.len() - own) as f64;
        let variance = residual.norm_squared() / spare;
        let r2 = 1.0 - left.norm_squared() / (spare - added as f64) / variance;
        let begin_s = self.of().next()?.time_s;
        let block =
            |time_s: f64| whole((time_s - begin_s) / self.windows.scenario.scales.block_s());
        let blocks: Vec<usize> = self.of().map(|window| block(window.time_s)).collect();
        let known = vec![true; added];
        let covariance = least_squares::clustered(&columns, &left, &blocks, bread, &known);
        r2.is_finite().then_some(Explained {
            r2,
            coefficients,
            covariance,
            rms: variance.sqrt(),
            spare,
        })
    }

    /// Error after the fit of the own parameters, in units of the noise.
    fn over_noise(&self, explained: &Explained) -> Option<f64> {
        let floors = self.of().map(|window| window.floor(self.equation).powi(2));
        let floor = (floors.sum::<f64>() / self.of().count() as f64).sqrt();
        (floor > 0.0).then(|| explained.rms / floor)
    }

    /// The curve at its knots, `shape` giving its values for the coefficients.
    fn axis_map(
        &self,
        axis: Axis,
        knots: Vec<f64>,
        shape: &DMatrix<f64>,
        rows: &[Vec<f64>],
    ) -> Option<AxisMap> {
        let explained = self.explain(rows)?;
        let values = shape * &explained.coefficients;
        let covariance = shape * &explained.covariance * shape.transpose();
        let deviation = |variance: &f64| variance.max(0.0).sqrt();
        Some(AxisMap {
            equation: self.equation.key(),
            axis: axis.key(),
            r2: explained.r2,
            knots,
            values: values.as_slice().to_vec(),
            std: covariance.diagonal().iter().map(deviation).collect(),
            error_over_noise: self.over_noise(&explained),
            finding: AxisFinding::NotFollowed { integrated: false },
        })
    }

    fn map(&self, axis: Axis) -> Option<AxisMap> {
        let scenario = self.windows.scenario;
        let along: Vec<f64> = match axis {
            Axis::Speed => scenario.speed_rad_s.clone(),
            Axis::Current => scenario.current_a.clone(),
            Axis::Angle => self.angle_at_samples()?,
            Axis::Time => {
                let since_begin = |time_s: &f64| time_s - scenario.begin_s();
                scenario.sample_time_s.iter().map(since_begin).collect()
            }
            Axis::Voltage => {
                let at = |time_s: &f64| scenario.input_at(*time_s);
                scenario.sample_time_s.iter().map(at).collect()
            }
        };
        let mut map =
            if axis == Axis::Angle { self.turn(&along)? } else { self.hats(axis, &along)? };
        let integrated = axis == Axis::Angle && scenario.angle.is_empty();
        map.finding = if map.is_followed() {
            AxisFinding::Followed { integrated }
        } else {
            AxisFinding::NotFollowed { integrated }
        };
        Some(map)
    }

    /// Harmonics over a turn.
    fn turn(&self, along: &[f64]) -> Option<AxisMap> {
        let step_rad = TAU / KNOTS_OF_A_TURN as f64;
        let knots: Vec<f64> = (0..KNOTS_OF_A_TURN).map(|knot| knot as f64 * step_rad).collect();
        let mut shape = DMatrix::zeros(KNOTS_OF_A_TURN, 2 * HARMONICS);
        for (knot, angle_rad) in knots.iter().enumerate() {
            let mut row = [0.0; 2 * HARMONICS];
            harmonics(*angle_rad, 1.0, &mut row);
            shape.row_mut(knot).copy_from_slice(&row);
        }
        let rows = self.averaged(along, 2 * HARMONICS, harmonics);
        self.axis_map(Axis::Angle, knots, &shape, &rows)
    }

    /// Hat functions over an axis, refined where the curvature is large.
    fn hats(&self, axis: Axis, along: &[f64]) -> Option<AxisMap> {
        let rows = |knots: &[f64]| {
            let put = |value, weight, row: &mut [f64]| hat(knots, value, weight, row);
            self.averaged(along, knots.len(), put)
        };
        let fit = |knots: Vec<f64>| {
            // The knots with data of usable windows.
            let tried = rows(&knots);
            let data = |knot: usize| tried.iter().map(|row| row[self.own + knot].powi(2)).sum();
            let data: Vec<f64> = (0..knots.len()).map(data).collect();
            let least = SETTINGS.least_data_share * data.iter().sum::<f64>() / data.len() as f64;
            let kept = knots.into_iter().zip(data).filter(|(_, data)| *data >= least);
            let knots: Vec<f64> = kept.map(|(knot, _)| knot).collect();
            let enough = knots.len() >= SETTINGS.fewest_knots;
            let shape = DMatrix::identity(knots.len(), knots.len());
            let rows = enough.then(|| rows(&knots))?;
            self.axis_map(axis, knots, &shape, &rows)
        };
        let mut best = fit(knots(axis, along))?;
        // Without a dependence a finer curve would fit the noise.
        let refines = axis != Axis::Time && best.is_followed();
        for _ in 0..if refines { SETTINGS.rounds } else { 0 } {
            let Some(finer) = refined(&best.knots, &best.values).and_then(&fit) else {
                break;
            };
            if finer.r2 < best.r2 + SETTINGS.worth_refining_share {
                break;
            }
            best = finer;
        }
        Some(best)
    }

    /// The strongest line in the spectrum of the error.
    fn line_map(&self) -> Option<AxisMap> {
        let line = self.strongest_line()?;
        let rows = self.rows(2, |window, row| {
            row.copy_from_slice(&line.wave(window.time_s));
        });
        let found = self.explain(&rows)?;
        let size = found.coefficients.norm();
        let amplitude = size / line.window_gain;
        let along = &found.coefficients / size;
        let variance = (along.transpose() * &found.covariance * &along)[(0, 0)];
        // The best of many frequencies explains part of any noise: degrees of freedom for that choice.
        let chance = 2.0 * (line.tried as f64).ln().max(0.0);
        let r2 = 1.0 - (1.0 - found.r2) * found.spare / (found.spare - chance);
        Some(AxisMap {
            equation: self.equation.key(),
            axis: "frequency_hz",
            r2,
            knots: vec![line.frequency_hz],
            values: vec![amplitude],
            std: vec![variance.max(0.0).sqrt() / line.window_gain],
            error_over_noise: self.over_noise(&found),
            finding: if r2 < SETTINGS.follows_share || !line.is_alone {
                AxisFinding::NoLine
            } else {
                AxisFinding::Line
            },
        })
    }
}

#[cfg(test)]
mod tests;
