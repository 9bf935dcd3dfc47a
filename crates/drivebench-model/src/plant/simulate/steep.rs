//! Stiffness by effects: step-size control of the explicit midpoint rule at currents where an effect makes the electrical time
//! constant short.
//!
//! The linear rate `R/L` is propagated exactly. The rate that an effect adds to it (a drop that builds up within 0.1 A, an
//! inductance that saturates at high current) is treated explicitly, which is stable only while `h dU/di / L` is below two
//! (Hairer and Wanner, *Solving Ordinary Differential Equations II*, section IV.2): a drop of 1 V on a motor of 0.5 mH exceeds it.
//!
//! ```text
//! dU/di |     _
//!       |    | |            a table of it over the current, once for each run;
//!       |____| |______      a sub-step whose current passes a steep cell is repeated in short pieces
//!            0          i
//! ```

use std::cmp::Ordering;

use super::equations::Equations;
use crate::numerics::count::whole;
use crate::plant::scenario::Input;

/// Currents at which effects add more than one over a sub-step to the rate of the armature circuit.
#[derive(Clone, Debug, Default)]
pub(super) struct Steep {
    /// `(from, to, rate)` in A and 1/s, in the order of the currents. Empty without stiffness.
    cells: Vec<(f64, f64, f64)>,
    /// No piece is shorter.
    least_step_s: f64,
}

/// The rate that effects add under a voltage, in cells of the current; empty where none does.
fn table(equations: &Equations, most_v: f64) -> Vec<(f64, f64, f64)> {
    // Twice the stall current: that of a reversal (plugging) at full speed.
    let most_a = 2.0 * equations.stall_current_a(most_v);
    if equations.is_linear() || equations.input != Input::Voltage || !most_a.is_finite() {
        return Vec::new();
    }
    // 80 cells on either side of zero, in geometric progression by 1.15: down to 1.6e-5 of the largest current.
    let side = 80_usize;
    let grid = |index: usize| match index.cmp(&side) {
        Ordering::Less => -most_a * 1.15_f64.powf(-(index as f64)),
        Ordering::Equal => 0.0,
        Ordering::Greater => most_a * 1.15_f64.powf(-((2 * side - index) as f64)),
    };
    let cell = |index: usize| {
        let (from_a, to_a) = (grid(index), grid(index + 1));
        (from_a, to_a, equations.added_rate(from_a, to_a, most_v))
    };
    (0..2 * side).map(cell).collect()
}

/// The fastest rate that effects add at any current under voltages of up to `most_v`, 1/s.
pub(super) fn fastest(equations: &Equations, most_v: f64) -> f64 {
    table(equations, most_v).into_iter().fold(0.0, |most, (_, _, rate)| most.max(rate))
}

impl Steep {
    /// The stiff cells for sub-steps of up to `longest_step_s` under voltages of up to `most_v`: rate times step above one, half of the limit of stability.
    pub(super) fn of(equations: &Equations, longest_step_s: f64, most_v: f64) -> Self {
        let mut cells = table(equations, most_v);
        cells.retain(|(_, _, rate)| rate * longest_step_s > 1.0);
        // A stiffer effect than 256 pieces resolve is not physical, but occurs in trials of a fit.
        Self { cells, least_step_s: longest_step_s / 256.0 }
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// Number of pieces, at most four, of a sub-step of length `h` whose current went from one value to the other; each of them is
    /// divided in its turn. A current that stood still stays where it is in a step of any length.
    pub(super) fn pieces(&self, from_a: f64, to_a: f64, h: f64) -> usize {
        let (low, high) = (from_a.min(to_a), from_a.max(to_a));
        let first = self.cells.partition_point(|cell| cell.1 < low);
        let between = self.cells[first..].iter().take_while(|cell| cell.0 <= high);
        let (rate, width_a) = between.fold((0.0_f64, 0.0), |(most, width_a), (from, to, rate)| {
            (most.max(*rate), f64::max(width_a, to - from))
        });
        let stands = high - low <= 1e-9 * width_a;
        if rate * h <= 1.0 || stands || h <= self.least_step_s {
            return 1;
        }
        whole((rate * h / 0.5).ceil().min(4.0))
    }
}
