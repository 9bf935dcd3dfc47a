//! Axis map: each equation's error as a curve over one variable, with its uncertainty.

use std::ops::RangeInclusive;

use serde::Serialize;

use super::regression::{Regression, Variable};
use super::windows::{FEWEST_HALF, Windows};
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error::FitError;
use drivebench_model::findings;
use drivebench_model::plant::effect::Axis;
use drivebench_model::plant::{Balance, Model, Scenario};
use drivebench_model::sample::TWO_SIDED_95;

/// Samples that half a window of the torque balance has at least: the shaft is slow, so that more of the noise can be
/// averaged than of the winding's current.
const FEWEST_HALF_OF_TORQUE: usize = 5;
/// Standard deviations from which on a value is significant.
const FOUND_SIGMAS: f64 = 3.0;
/// Adjusted R2 below which no dependence on an axis is reported.
const FOLLOWS_SHARE: f64 = 0.1;

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
        self.r2 >= FOLLOWS_SHARE
    }

    /// The knot with the largest significant value.
    fn peak(&self) -> Option<usize> {
        let sure = |knot: &usize| self.values[*knot].abs() > FOUND_SIGMAS * self.std[*knot];
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
            Balance::Torque => FEWEST_HALF_OF_TORQUE,
            Balance::Voltage => FEWEST_HALF,
        };
        let mut windows = Windows::new(model, scenario, noise, fewest_half)?;
        if windows.missing_signal().is_some() {
            break;
        }
        // Without a fit of its own the error of an equation would be that of values from another equation.
        windows.fit_own(*equation);
        let errors = Regression::new(&windows, *equation, true);
        let variables = Variable::of(*equation, scenario.input, false).into_iter();
        maps.extend(variables.filter_map(|variable| errors.map(variable)));
        if *equation == Balance::Torque {
            maps.extend(errors.line_map());
        }
    }
    maps.sort_by(|a, b| b.r2.total_cmp(&a.r2));
    Ok(maps)
}

impl Regression<'_> {
    fn map(&self, variable: Variable) -> Option<AxisMap> {
        let Variable::Axis(axis) = variable else { return None };
        let basis = self.basis(variable, 1.0)?;
        let fit = self.fit(&basis.rows)?;
        let (values, std) = fit.curve(&basis);
        let integrated = axis == Axis::Angle && self.windows.scenario.angle.is_empty();
        let mut map = AxisMap {
            equation: self.equation.key(),
            axis: axis.key(),
            r2: fit.r2,
            knots: basis.knots,
            values,
            std,
            error_over_noise: fit.over_noise(),
            finding: AxisFinding::NotFollowed { integrated },
        };
        if map.is_followed() {
            map.finding = AxisFinding::Followed { integrated };
        }
        Some(map)
    }

    fn line_map(&self) -> Option<AxisMap> {
        let line = self.strongest_line()?;
        let (size, std) = line.fit.amplitude();
        let is_found = line.fit.r2 >= FOLLOWS_SHARE && line.is_alone;
        Some(AxisMap {
            equation: self.equation.key(),
            axis: "frequency_hz",
            r2: line.fit.r2,
            knots: vec![line.frequency_hz],
            values: vec![size / line.window_gain],
            std: vec![std / line.window_gain],
            error_over_noise: line.fit.over_noise(),
            finding: if is_found { AxisFinding::Line } else { AxisFinding::NoLine },
        })
    }
}

#[cfg(test)]
mod tests;
