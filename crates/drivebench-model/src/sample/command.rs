//! Command, the request of the host to the drive in one exchange.

/// One demand with the sequence number that the drive echoes, so that a late reply cannot be taken for another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    pub seq: u64,
    pub demand: Demand,
}

/// The requested output. Everything but the three set-points means zero output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Demand {
    /// Output off, state machine at rest; the exchange only reads.
    Disable,
    /// Zero output at once, then disabled.
    Stop,
    /// Clear a latched drive fault; output stays off.
    ResetFault,
    /// Armature voltage, V.
    Voltage(f64),
    /// Armature current, A.
    Current(f64),
    /// Shaft speed, rad/s.
    Speed(f64),
}

impl Demand {
    pub const fn energises(self) -> bool {
        matches!(self, Self::Voltage(_) | Self::Current(_) | Self::Speed(_))
    }

    /// The voltage that this demand puts on the motor, where it is one that fixes the voltage.
    pub const fn voltage_v(self) -> Option<f64> {
        match self {
            Self::Voltage(volts) => Some(volts),
            Self::Disable | Self::Stop | Self::ResetFault => Some(0.0),
            Self::Current(_) | Self::Speed(_) => None,
        }
    }

    /// The current that this demand drives through the motor, where it is one that fixes the current.
    pub const fn current_a(self) -> Option<f64> {
        match self {
            Self::Current(amperes) => Some(amperes),
            Self::Disable | Self::Stop | Self::ResetFault => Some(0.0),
            Self::Voltage(_) | Self::Speed(_) => None,
        }
    }
}
