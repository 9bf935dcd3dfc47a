//! The telemetry block: one measured instant of the drive.

use crate::codes::coded;
use crate::registers as r;
use crate::registers::{TELEMETRY_ADDRESS, TELEMETRY_WORDS};
use crate::wire::{Sink, Source, Words, WordsMut};

coded! {
    /// The drive's state machine.
    #[derive(Default)]
    State: u16 {
        /// Output off; so after power-up, after `Disable` and after a fault was reset.
        #[default]
        Disabled = 0,
        /// Output off after `Stop`.
        Ready = 1,
        /// Output on, watchdog armed.
        Running = 2,
        /// Output off, latched until `ResetFault`.
        Fault = 3,
    }
}

/// The status word: state and flags.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status(pub u16);

impl Status {
    /// The drive limits the current now.
    pub const CURRENT_LIMIT: u16 = 1 << 4;
    /// The drive limits the voltage now.
    pub const VOLTAGE_LIMIT: u16 = 1 << 5;
    /// The watchdog stopped the drive; cleared with the fault.
    pub const WATCHDOG: u16 = 1 << 6;
    /// A command was applied since the last sample was read.
    pub const COMMAND_APPLIED: u16 = 1 << 7;
    /// The drive is software.
    pub const EMULATOR: u16 = 1 << 8;

    /// A state without flags.
    pub const fn new(state: State) -> Self {
        Self(state.code())
    }

    /// The state; `None` for a reserved code, to be treated as a fault.
    pub const fn state(self) -> Option<State> {
        State::from_code(self.0 & 0b111)
    }

    /// Sets a flag if `on`.
    #[must_use]
    pub const fn with(self, flag: u16, on: bool) -> Self {
        if on { Self(self.0 | flag) } else { Self(self.0 & !flag) }
    }

    /// Whether a limit of the drive holds its output now.
    pub const fn is_limited(self) -> bool {
        self.has(Self::CURRENT_LIMIT) || self.has(Self::VOLTAGE_LIMIT)
    }

    /// Whether a flag is set.
    pub const fn has(self, flag: u16) -> bool {
        self.0 & flag == flag
    }
}

/// Declares the faults: for each its name and what has happened; the code of a fault is its position.
macro_rules! faults {
    ($($(#[$doc:meta])* $fault:ident, $name:literal, $text:literal;)*) => {
        /// Why the drive stopped itself.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub enum Fault {
            $($(#[$doc])* #[doc = $text] $fault,)*
            /// A code of a later version.
            Other(u16),
        }

        impl Fault {
            const NAMED: &[(Self, &str, &str)] = &[$((Self::$fault, $name, $text)),*];
        }
    };
}

faults! {
    #[default] None, "none", "no fault";
    Watchdog, "watchdog", "no command came within the watchdog time";
    OverCurrent, "over-current", "current above the trip level";
    OverVoltage, "over-voltage", "intermediate circuit: voltage too high";
    UnderVoltage, "under-voltage", "intermediate circuit: voltage too low";
    OverTemperature, "over-temperature", "output stage or motor too hot";
    OverSpeed, "over-speed", "speed above the speed limit";
    BadCommand, "bad command", "a command block that means nothing";
    Sensor, "sensor", "current, speed or angle sensor failed";
    Internal, "internal", "internal fault";
}

impl Fault {
    /// Every named fault, by rising code.
    pub fn all() -> impl Iterator<Item = Self> {
        Self::NAMED.iter().map(|(fault, ..)| *fault)
    }

    /// Code in the fault register.
    pub fn code(self) -> u16 {
        match self {
            Self::Other(code) => code,
            named => (0..).zip(Self::all()).find(|(_, fault)| *fault == named).map_or(0, |it| it.0),
        }
    }

    /// The fault of a code.
    pub fn from_code(code: u16) -> Self {
        Self::all().nth(code.into()).unwrap_or(Self::Other(code))
    }

    /// Text of the fault.
    pub fn text(self) -> &'static str {
        self.row().map_or("a code that this version does not know", |(_, _, text)| text)
    }

    /// Words for a person.
    pub fn name(self) -> &'static str {
        self.row().map_or("unknown", |(_, name, _)| name)
    }

    fn row(self) -> Option<&'static (Self, &'static str, &'static str)> {
        Self::NAMED.iter().find(|(fault, ..)| *fault == self)
    }
}

/// One measured instant. A quantity that the drive does not have is NaN.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Telemetry {
    /// State and flags.
    pub status: Status,
    /// Why the drive is in fault.
    pub fault: Fault,
    /// Sequence number of the last command applied.
    pub seq: u16,
    /// Drive time of this sample, microseconds; wraps after 71.6 minutes.
    pub time_us: u32,
    /// Drive time at which command `seq` was applied, microseconds; wraps.
    pub applied_us: u32,
    /// Armature voltage, V.
    pub voltage_v: f64,
    /// Armature current, A.
    pub current_a: f64,
    /// Shaft speed, rad/s.
    pub speed_rad_s: f64,
    /// Shaft angle, rad; wraps by [`Telemetry::ANGLE_SPAN_RAD`].
    pub angle_rad: f64,
    /// Voltage of the intermediate circuit, V.
    pub bus_v: f64,
    /// Temperature of the output stage, Celsius.
    pub temperature_c: f64,
    /// Voltage that the drive puts out now, V.
    pub voltage_cmd_v: f64,
    /// Protocol version of the drive.
    pub protocol_version: u16,
}

impl Telemetry {
    /// The angle jumps by this much when its counter wraps, on registers and on the stream; rad.
    pub const ANGLE_SPAN_RAD: f64 = 4_294_967_296.0 * r::ANGLE.scale;

    /// The block as it stands at [`TELEMETRY_ADDRESS`]: rounded, saturated.
    pub fn to_registers(&self) -> [u16; TELEMETRY_WORDS] {
        let mut block = [0; TELEMETRY_WORDS];
        self.write(&mut WordsMut { block: &mut block, base: TELEMETRY_ADDRESS });
        block
    }

    /// Reads the block.
    pub fn from_registers(block: &[u16; TELEMETRY_WORDS]) -> Self {
        Self::read(&mut Words { block, base: TELEMETRY_ADDRESS })
    }

    /// Every field in the order of the table.
    pub(crate) fn write(&self, sink: &mut impl Sink) {
        sink.raw(&r::STATUS, self.status.0.into());
        sink.raw(&r::FAULT, self.fault.code().into());
        sink.raw(&r::SEQUENCE_ECHO, self.seq.into());
        sink.raw(&r::TIME, self.time_us.into());
        sink.raw(&r::APPLIED_TIME, self.applied_us.into());
        sink.value(&r::VOLTAGE, self.voltage_v);
        sink.value(&r::CURRENT, self.current_a);
        sink.value(&r::SPEED, self.speed_rad_s);
        sink.value(&r::ANGLE, self.angle_rad);
        sink.value(&r::BUS_VOLTAGE, self.bus_v);
        sink.value(&r::TEMPERATURE, self.temperature_c);
        sink.value(&r::VOLTAGE_COMMAND, self.voltage_cmd_v);
        sink.raw(&r::TELEMETRY_VERSION, self.protocol_version.into());
    }

    pub(crate) fn read(source: &mut impl Source) -> Self {
        Self {
            status: Status(source.u16(&r::STATUS)),
            fault: Fault::from_code(source.u16(&r::FAULT)),
            seq: source.u16(&r::SEQUENCE_ECHO),
            time_us: source.u32(&r::TIME),
            applied_us: source.u32(&r::APPLIED_TIME),
            voltage_v: source.value(&r::VOLTAGE),
            current_a: source.value(&r::CURRENT),
            speed_rad_s: source.value(&r::SPEED),
            angle_rad: source.value(&r::ANGLE),
            bus_v: source.value(&r::BUS_VOLTAGE),
            temperature_c: source.value(&r::TEMPERATURE),
            voltage_cmd_v: source.value(&r::VOLTAGE_COMMAND),
            protocol_version: source.u16(&r::TELEMETRY_VERSION),
        }
    }
}
