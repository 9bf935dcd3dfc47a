//! Path between the command, the machine and the measurement: delays, filters, offsets.

/// Delays, filters and offsets; all zero is the direct way.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Path {
    /// The drive acts on every set-point this much later than it says.
    pub command_delay_s: f64,
    /// The drive puts out nothing for this long after the first set-point that is not zero.
    pub start_delay_s: f64,
    /// The same after every start from rest.
    pub restart_delay_s: f64,
    /// Added to every voltage that the drive puts out while it runs.
    pub voltage_offset_v: f64,
    /// The measured speed is that of this much earlier.
    pub speed_delay_s: f64,
    /// Time constants of first-order filters in the measurement.
    pub speed_filter_s: f64,
    pub current_filter_s: f64,
    /// What a sensor adds to the truth.
    pub current_offset_a: f64,
    pub speed_offset_rad_s: f64,
}

impl Path {
    /// Both ways one after the other. Time constants of filters in series add up only nearly; nobody chains them here.
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
