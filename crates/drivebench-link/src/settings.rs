//! Settings of every profile, whatever its registers: wiring, trust in the numbers, bounds.

use std::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// An enumeration whose variants have one name each, in files and in texts.
macro_rules! named {
    ($(#[$meta:meta])* pub enum $type:ident { $($(#[$doc:meta])* $variant:ident = $name:literal,)+ }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
        pub enum $type {
            $($(#[$doc])* #[serde(rename = $name)] $variant,)+
        }

        impl $type {
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)+
                }
            }
        }
    };
}
pub(crate) use named;

named! {
    /// Trust in the numbers of a profile, by their source.
    pub enum Trust {
        Manual = "manual",
        Code = "code",
        Unverified = "unverified",
    }
}

named! {
    /// Protocol on the wire.
    #[derive(Default)]
    pub enum Protocol {
        #[default]
        ModbusRtu = "modbus-rtu",
        ModbusTcp = "modbus-tcp",
        /// Frames of RTU over a TCP connection, as transparent serial converters carry them.
        ModbusRtuOverTcp = "modbus-rtu-over-tcp",
        Stream = "stream",
        Vesc = "vesc",
        /// Dynamixel protocol 2.0.
        Dynamixel = "dynamixel-2",
        /// Lines of text that the profile gives.
        Lines = "lines",
    }
}

impl Protocol {
    pub const ALL: [Self; 7] = [
        Self::ModbusRtu,
        Self::ModbusTcp,
        Self::ModbusRtuOverTcp,
        Self::Stream,
        Self::Vesc,
        Self::Dynamixel,
        Self::Lines,
    ];

    /// Whether its profile is a register map of Modbus.
    pub const fn is_modbus(self) -> bool {
        matches!(self, Self::ModbusRtu | Self::ModbusTcp | Self::ModbusRtuOverTcp)
    }

    /// Whether its drives can be reached in memory without a line: those of registers, and our own.
    pub const fn has_memory_link(self) -> bool {
        self.is_modbus() || matches!(self, Self::Stream)
    }

    /// Whether it needs a network.
    pub const fn is_network(self) -> bool {
        matches!(self, Self::ModbusTcp | Self::ModbusRtuOverTcp)
    }

    /// Whether its frames are those of RTU, which carry no transaction number.
    pub const fn is_rtu(self) -> bool {
        matches!(self, Self::ModbusRtu | Self::ModbusRtuOverTcp)
    }

    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|known| known.name() == name)
    }
}

impl fmt::Display for Protocol {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

named! {
    /// Data bits, parity, stop bits.
    #[derive(Default)]
    pub enum Framing {
        #[default]
        EightNoneOne = "8N1",
        EightEvenOne = "8E1",
        EightOddOne = "8O1",
        EightNoneTwo = "8N2",
    }
}

impl Framing {
    /// Bits on the wire for one character, start bit included.
    pub const fn bits_per_char(self) -> u8 {
        match self {
            Self::EightNoneOne => 10,
            Self::EightEvenOne | Self::EightOddOne | Self::EightNoneTwo => 11,
        }
    }
}

/// How the drive is wired and how fast it answers.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct LinkSettings {
    pub protocol: Protocol,
    pub baud: u32,
    pub unit: u8,
    #[serde(default)]
    pub framing: Framing,
    /// Worst time from the end of a request to the start of its reply, ms.
    pub reply_ms: f64,
    /// Silence before a Modbus RTU request, us; `None`: that of the standard.
    pub gap_us: Option<f64>,
    /// Time for one exchange, ms; `None`: from wire and reply time.
    pub deadline_ms: Option<f64>,
    /// The far end is the software drive of this process, under whatever profile; in no file.
    #[serde(skip)]
    pub emulated: bool,
}

/// What restarts the drive's watchdog.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum KickedBy {
    /// Only a write of the command block.
    Command,
    Write,
    Any,
}

/// Bounds in addition to those that the drive reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct DriveLimits {
    pub current_a: Option<f64>,
    pub voltage_v: Option<f64>,
    pub speed_rad_s: Option<f64>,
}

/// A number of a profile that is not allowed.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("drive profile {profile:?}: {key} {value} is not allowed (expected {allowed})")]
pub struct RangeError {
    pub profile: String,
    pub key: &'static str,
    pub value: f64,
    pub allowed: &'static str,
}

/// Lowest, highest, and the text for that.
const POSITIVE: (f64, f64, &str) = (f64::MIN_POSITIVE, f64::MAX, "more than 0");

pub(super) fn check_ranges(
    profile: &str,
    link: &LinkSettings,
    watchdog_ms: Option<f64>,
    limits: &DriveLimits,
) -> Result<(), RangeError> {
    let unit = match link.protocol {
        // 0 and 255: the server itself (MODBUS Messaging on TCP/IP V1.0b, 4.4.2.4).
        Protocol::ModbusTcp => (0.0, 255.0, "0 to 255"),
        // 254 is every servo of the bus (e-Manual, protocol 2.0, 3.2).
        Protocol::Dynamixel => (0.0, 252.0, "0 to 252"),
        _ => (1.0, 247.0, "1 to 247"),
    };
    let reply = (0.0, 1e4, "0 to 10000");
    let (gap, deadline) = ((0.0, 1e6, "0 to 1000000"), (1.0, 6e4, "1 to 60000"));
    let rows = [
        ("link.baud", Some(link.baud.into()), POSITIVE),
        ("link.unit", Some(link.unit.into()), unit),
        ("link.reply_ms", Some(link.reply_ms), reply),
        ("link.gap_us", link.gap_us, gap),
        ("link.deadline_ms", link.deadline_ms, deadline),
        ("watchdog.default_ms", watchdog_ms, POSITIVE),
        ("limits.current_a", limits.current_a, POSITIVE),
        ("limits.voltage_v", limits.voltage_v, POSITIVE),
        ("limits.speed_rad_s", limits.speed_rad_s, POSITIVE),
    ];
    for (key, value, (low, high, allowed)) in rows {
        if let Some(value) = value.filter(|value| !(low..=high).contains(value)) {
            let profile = profile.to_owned();
            return Err(RangeError { profile, key, value, allowed });
        }
    }
    Ok(())
}
