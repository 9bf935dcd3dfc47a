//! The terms of the voltage balance `u = R i + L di/dt + Ke w`, as ranges over some rows.

use super::REST_VOLTAGE;
use super::history::{Range, Row};

/// What the quantities are measured by: rated values, or limits where nothing is rated.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scale {
    pub(super) volts: f64,
    pub(super) amps: f64,
    pub(super) rad_s: f64,
}

/// The nameplate, as the balances need it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plate {
    pub(super) resistance: f64,
    pub(super) inductance: f64,
    pub(super) back_emf: f64,
    pub(super) inertia: f64,
    pub(super) friction: f64,
}

impl Plate {
    /// What the current takes of the voltage in a row, V.
    pub(super) fn current_v(&self, row: &Row) -> f64 {
        self.resistance * row.current_a + self.inductance * row.current_change_a / row.seconds
    }

    /// Error of the trapezoid between two samples, as a share of the change, for the winding and for the shaft.
    pub(super) fn quickness(&self, seconds: f64) -> f64 {
        (seconds * self.resistance / (6.0 * self.inductance)).min(0.5)
    }

    pub(super) fn slowness(&self, seconds: f64) -> f64 {
        let time_s = self.resistance * self.inertia / (self.back_emf * self.back_emf);
        (seconds / (3.0 * time_s)).min(0.5)
    }

    /// What a row's balance is in doubt because nobody looked within the cycle, V.
    pub(super) fn doubt_v(&self, row: &Row) -> f64 {
        self.quickness(row.seconds) * self.resistance * row.current_change_a.abs()
            + self.slowness(row.seconds) * self.back_emf * row.speed_change_rad_s.abs()
    }
}

/// The terms of the voltage balance over a window, V.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) volts: Range,
    pub(super) current: Range,
    pub(super) speed: Range,
    /// The means of the window's rows.
    pub(super) mean_volts: f64,
    pub(super) mean_current: f64,
    pub(super) mean_speed: f64,
}

impl Window {
    /// What lies between the voltage and the two others, where they may be off by these factors, V; 0: they fit.
    pub(super) fn gap(&self, current: Range, speed: Range, drop_v: f64) -> f64 {
        let needed = self.current.times(current).plus(self.speed.times(speed));
        self.volts.gap(needed.wider(drop_v))
    }

    /// What is left of the balance with the speed times this factor, V.
    pub(super) fn misfit(&self, speed: f64) -> f64 {
        (self.mean_volts - self.mean_current - speed * self.mean_speed).abs()
    }

    /// The same with another reading in the place of a measured one.
    pub(super) fn with(&self, current: Range, speed: Range) -> Self {
        Self {
            current,
            speed,
            ..*self
        }
    }
}

pub(super) const fn negative(range: Range) -> Range {
    Range::new(-range.high, -range.low)
}

/// Whether a reading of at least so many volts fits with the opposite sign, and not with its own.
pub(super) fn is_mirrored(
    window: &Window,
    reading: f64,
    other: f64,
    least_v: f64,
    rated_v: f64,
) -> bool {
    let rest = window.mean_volts - other;
    let as_read = (rest - reading).abs() - 0.5 * window.volts.width();
    let mirrored = (rest + reading).abs();
    let (size, slack) = (reading.abs(), REST_VOLTAGE * rated_v);
    size > least_v && as_read > size + slack && mirrored < 0.5 * size + slack
}
