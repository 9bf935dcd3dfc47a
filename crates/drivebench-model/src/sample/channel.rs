//! The table of quantities that a run can carry.

/// One quantity: its CSV column, symbol and unit stand in one table, [`Channel::ALL`] in column order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Channel {
    Reference,
    VoltageCmd,
    CurrentCmd,
    Voltage,
    Current,
    Speed,
    Angle,
    Torque,
    Bus,
    Temperature,
    /// No signal of the motor but the uncertainty of the row's stamp: see [`super::Sample::time_half_width_s`].
    TimeHalfWidth,
}

impl Channel {
    pub const COUNT: usize = 11;

    pub const ALL: [Self; Self::COUNT] = [
        Self::Reference,
        Self::VoltageCmd,
        Self::CurrentCmd,
        Self::Voltage,
        Self::Current,
        Self::Speed,
        Self::Angle,
        Self::Torque,
        Self::Bus,
        Self::Temperature,
        Self::TimeHalfWidth,
    ];

    const fn row(self) -> (&'static str, &'static str, &'static str, &'static str) {
        match self {
            Self::Reference => ("reference_rad_s", "speed reference", "w*", "rad/s"),
            Self::VoltageCmd => ("voltage_cmd_v", "voltage command", "u*", "V"),
            Self::CurrentCmd => ("current_cmd_a", "current command", "i*", "A"),
            Self::Voltage => ("voltage_v", "voltage", "u", "V"),
            Self::Current => ("current_a", "current", "i", "A"),
            Self::Speed => ("speed_rad_s", "speed", "w", "rad/s"),
            Self::Angle => ("angle_rad", "angle", "theta", "rad"),
            Self::Torque => ("torque_n_m", "torque", "T", "N.m"),
            Self::Bus => ("bus_v", "bus voltage", "ubus", "V"),
            Self::Temperature => ("temperature_c", "temperature", "temp", "C"),
            Self::TimeHalfWidth => ("time_half_width_s", "half-width of the stamp", "dt", "s"),
        }
    }

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
