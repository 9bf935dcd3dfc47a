//! The table of quantities that a run can carry.

use crate::tabulated;

tabulated! {
    /// One quantity: its CSV column, symbol and unit stand in one table, [`Channel::ALL`] in column order.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
    pub enum Channel {
        Reference = ("reference_rad_s", "speed reference", "w*", "rad/s"),
        VoltageCmd = ("voltage_cmd_v", "voltage command", "u*", "V"),
        CurrentCmd = ("current_cmd_a", "current command", "i*", "A"),
        Voltage = ("voltage_v", "voltage", "u", "V"),
        Current = ("current_a", "current", "i", "A"),
        Speed = ("speed_rad_s", "speed", "w", "rad/s"),
        Angle = ("angle_rad", "angle", "theta", "rad"),
        Torque = ("torque_n_m", "torque", "T", "N.m"),
        Bus = ("bus_v", "bus voltage", "ubus", "V"),
        Temperature = ("temperature_c", "temperature", "temp", "C"),
        /// No signal of the motor but the uncertainty of the row's stamp: see [`super::Sample::time_half_width_s`].
        TimeHalfWidth = ("time_half_width_s", "half-width of the stamp", "dt", "s"),
    }
    const fn row(self) -> (&'static str, &'static str, &'static str, &'static str);
}

impl Channel {
    pub const COUNT: usize = Self::ALL.len();

    /// The CSV column and configuration key, with its unit suffix.
    pub const fn key(self) -> &'static str {
        self.row().0
    }

    pub const fn name(self) -> &'static str {
        self.row().1
    }

    pub const fn symbol(self) -> &'static str {
        self.row().2
    }

    pub const fn unit(self) -> &'static str {
        self.row().3
    }

    pub const fn index(self) -> usize {
        self as usize
    }

    /// Commands and references hold from their instant until the next one (zero-order hold); measurements do not.
    pub const fn is_commanded(self) -> bool {
        matches!(self, Self::Reference | Self::VoltageCmd | Self::CurrentCmd)
    }

    pub fn from_key(key: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|channel| channel.key() == key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_in_order_and_keys_are_unique() {
        for (position, channel) in Channel::ALL.into_iter().enumerate() {
            assert_eq!(channel.index(), position);
            assert_eq!(Channel::from_key(channel.key()), Some(channel));
        }
        assert_eq!(Channel::from_key("speed_rpm"), None);
    }
}
