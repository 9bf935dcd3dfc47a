//! The error over speed x current: where the machine was, and how wrong the model is there.

use serde::Serialize;

use super::Equation;
use super::balance::Windows;
use crate::numerics::count::whole;

/// Cells along each axis.
const CELLS: usize = 12;

/// Root mean square of what each equation lacks in the cells of speed x current. Rows go with the speed, columns with
/// the current, both from their lowest edge; null where the run never was.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorMap {
    pub speed_edges_rad_s: Vec<f64>,
    pub current_edges_a: Vec<f64>,
    /// Windows in each cell.
    pub count: Vec<Vec<usize>>,
    pub torque_rms_n_m: Vec<Vec<Option<f64>>>,
    pub voltage_rms_v: Vec<Vec<Option<f64>>>,
}

/// `None` where speed or current did not vary, or was not measured.
pub(super) fn of(windows: &Windows<'_>) -> Option<ErrorMap> {
    let edges = |value: fn(&super::balance::Window) -> f64| {
        let (from, to) = windows
            .each
            .iter()
            .map(value)
            .filter(|value| value.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(from, to), value| {
                (from.min(value), to.max(value))
            });
        (to > from).then(|| -> Vec<f64> {
            (0..=CELLS)
                .map(|k| from + (to - from) * k as f64 / CELLS as f64)
                .collect()
        })
    };
    let (speed, current) = (edges(|w| w.speed_rad_s)?, edges(|w| w.current_a)?);
    let cell = |edges: &[f64], value: f64| {
        let width = (edges[CELLS] - edges[0]) / CELLS as f64;
        whole((value - edges[0]) / width).min(CELLS - 1)
    };
    let mut count = vec![vec![0; CELLS]; CELLS];
    let mut sums = [Equation::Torque, Equation::Voltage]
        .map(|equation| (equation, vec![vec![(0.0, 0_usize); CELLS]; CELLS]));
    for window in &windows.each {
        if !(window.speed_rad_s.is_finite() && window.current_a.is_finite()) {
            continue;
        }
        let (row, column) = (
            cell(&speed, window.speed_rad_s),
            cell(&current, window.current_a),
        );
        count[row][column] += 1;
        for (equation, cells) in &mut sums {
            let error = window.error(*equation);
            if error.is_finite() {
                cells[row][column].0 += error * error;
                cells[row][column].1 += 1;
            }
        }
    }
    let [torque, voltage] = sums.map(|(_, cells)| -> Vec<Vec<Option<f64>>> {
        let rms = |(power, n): &(f64, usize)| (*n > 0).then(|| (power / *n as f64).sqrt());
        cells
            .iter()
            .map(|row| row.iter().map(rms).collect())
            .collect()
    });
    Some(ErrorMap {
        speed_edges_rad_s: speed,
        current_edges_a: current,
        count,
        torque_rms_n_m: torque,
        voltage_rms_v: voltage,
    })
}
