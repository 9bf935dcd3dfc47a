//! Stiff stretches, in which an effect makes the current settle faster than a sub-step can follow.
//!
//! The linear rate `R/L` is propagated exactly, whatever it is. What an effect adds to it (a drop that builds up within
//! 0.1 A, an inductance that is gone at high current) is evaluated in the middle of a sub-step, which swings from one
//! side to the other once `h dU/di / L` is above two: on a motor of 0.5 mH a drop of 1 V does it.
//!
//! ```text
//! dU/di |     _
//!       |    | |            a table of it over the current, once for each run;
//!       |____| |______      a sub-step whose current comes by a steep place is done again in short pieces
//!            0          i
//! ```

use std::cmp::Ordering;

use super::equations::Equations;
use crate::numerics::count::whole;
use crate::plant::scenario::Input;

/// Cells of the table to either side of zero; each current is 1.15 times the next.
const CELLS_ASIDE: usize = 80;
/// Rate times step up to which a sub-step needs no pieces.
const LONGEST: f64 = 1.0;

/// Rates that effects add to that of the armature circuit, by current.
#[derive(Clone, Debug, Default)]
pub(super) struct Steep {
    /// `(from, to, rate)` in A and 1/s, in the order of the currents. Empty where no place is steep.
    cells: Vec<(f64, f64, f64)>,
}

/// The rate that effects add, by current; empty where none does.
fn table(equations: &Equations) -> Vec<(f64, f64, f64)> {
    // Twice what flows through the resistance alone under the full supply: reversed at full speed.
    let most_a = 2.0 * equations.stall_current_a();
    if equations.is_linear() || equations.input != Input::Voltage || !most_a.is_finite() {
        return Vec::new();
    }
    let grid = |place: usize| match place.cmp(&CELLS_ASIDE) {
        Ordering::Less => -most_a * 1.15_f64.powf(-(place as f64)),
        Ordering::Equal => 0.0,
        Ordering::Greater => most_a * 1.15_f64.powf(-((2 * CELLS_ASIDE - place) as f64)),
    };
    let cells = (0..2 * CELLS_ASIDE).map(|place| {
        let (from_a, to_a) = (grid(place), grid(place + 1));
        (from_a, to_a, equations.added_rate(from_a, to_a))
    });
    cells.collect()
}

/// The fastest rate that effects add at any current, 1/s.
pub(super) fn fastest(equations: &Equations) -> f64 {
    let cells = table(equations).into_iter();
    cells.fold(0.0, |most, (_, _, rate)| most.max(rate))
}

impl Steep {
    /// The steep places for sub-steps of up to `longest_step_s`.
    pub(super) fn of(equations: &Equations, longest_step_s: f64) -> Self {
        let mut cells = table(equations);
        cells.retain(|(_, _, rate)| rate * longest_step_s > LONGEST);
        Self { cells }
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// Number of pieces of a sub-step of length `h` whose current went from one value to the other. Steeper effects than 256
    /// pieces resolve have no physical size, but occur in trials of a fit.
    pub(super) fn pieces(&self, from_a: f64, to_a: f64, h: f64) -> usize {
        let (low, high) = (from_a.min(to_a), from_a.max(to_a));
        let first = self.cells.partition_point(|cell| cell.1 < low);
        let between = self.cells[first..].iter().take_while(|cell| cell.0 <= high);
        let rate = between.fold(0.0_f64, |most, cell| most.max(cell.2));
        let pieces = whole((rate * h / 0.5).ceil().min(256.0));
        if rate * h <= LONGEST { 1 } else { pieces }
    }
}
