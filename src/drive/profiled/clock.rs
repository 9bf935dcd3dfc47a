//! The drive's own clock, where its profile maps it: unwrapped, and the time axis of the samples.

use super::readings::Readings;
use crate::drive::clock_map::{ClockMap, DriveClock};
use crate::drive::register_map::{PollRate, Quantity, RegisterMap};

/// The counter is followed as one of so many counts to the turn, whatever its width; a narrower one is shifted up to it.
const BITS: u16 = 32;
/// What [`DriveClock`] takes a count for, s.
const COUNT_S: f64 = 1e-6;

pub(super) struct Clock {
    /// Position of its signal in the map.
    signal: usize,
    /// How far its counts are shifted up.
    shift: u16,
    /// One count of the shifted counter, s, and one of its own.
    count_s: f64,
    resolution_s: f64,
    counter: DriveClock,
    map: ClockMap,
}

impl Clock {
    pub(super) fn of(map: &RegisterMap) -> Option<Self> {
        let signal = map.signals.iter().position(|signal| {
            signal.keys.quantity == Quantity::Clock && signal.keys.poll == PollRate::Fast
        })?;
        let resolution_s = map.signals[signal].clock_count_s()?;
        let shift = BITS - 16 * map.signals[signal].location.layout.registers();
        Some(Self {
            signal,
            shift,
            count_s: resolution_s * 0.5_f64.powi(i32::from(shift)),
            resolution_s,
            counter: DriveClock::default(),
            map: ClockMap::default(),
        })
    }

    /// Drive time of the counter as it was read last, s since the first one.
    pub(super) fn follow(&mut self, readings: &Readings) -> f64 {
        let reading = readings.at(self.signal);
        let span = reading.span;
        // The link ended before it was read for the first time.
        let raw = reading.pattern.unwrap_or_default() << self.shift;
        let counts = self.count_s / COUNT_S;
        let time_s = self.counter.follow(raw, span.middle_s() / counts) * counts;
        self.map.observe(span, time_s);
        time_s
    }

    /// Half of a count, s: between two of them nothing is told.
    pub(super) const fn half_width_s(&self) -> f64 {
        0.5 * self.resolution_s
    }

    /// A host time on the drive's clock, s; before the first look at it, its zero.
    pub(super) fn of_host_s(&self, host_s: f64) -> f64 {
        self.map
            .offset_s(host_s)
            .map_or(0.0, |offset_s| host_s + offset_s)
    }

    pub(super) const fn map(&self) -> &ClockMap {
        &self.map
    }
}
