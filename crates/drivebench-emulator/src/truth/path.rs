//! Path from command to machine and from machine to measurement: dead times, filters, offsets.
//!
//! The host's model has the same parameters in a type of its own (`drivebench-model`, `plant/effect/terms.rs`). They are not shared:
//! the emulator's physics is an independent implementation, so that a diagnosis is never tested on its own formulas.

/// Dead times, filters and offsets; all zero is no change.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Path {
    /// Dead time from set-point to output.
    pub command_delay_s: f64,
    /// Time of zero output after the first set-point that is not zero.
    pub start_delay_s: f64,
    /// The same after every start from rest.
    pub restart_delay_s: f64,
    /// Added to every voltage that the drive puts out while it runs.
    pub voltage_offset_v: f64,
    /// Dead time of the measured speed.
    pub speed_delay_s: f64,
    /// Time constants of first-order filters in the measurement.
    pub speed_filter_s: f64,
    pub current_filter_s: f64,
    /// Offsets of the sensors.
    pub current_offset_a: f64,
    pub speed_offset_rad_s: f64,
}

impl Path {
    /// Two paths in series. The time constants of filters add up only approximately; no configuration has two of one kind.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            command_delay_s: self.command_delay_s + other.command_delay_s,
            start_delay_s: self.start_delay_s + other.start_delay_s,
            restart_delay_s: self.restart_delay_s + other.restart_delay_s,
            voltage_offset_v: self.voltage_offset_v + other.voltage_offset_v,
            speed_delay_s: self.speed_delay_s + other.speed_delay_s,
            speed_filter_s: self.speed_filter_s + other.speed_filter_s,
            current_filter_s: self.current_filter_s + other.current_filter_s,
            current_offset_a: self.current_offset_a + other.current_offset_a,
            speed_offset_rad_s: self.speed_offset_rad_s + other.speed_offset_rad_s,
        }
    }
}
