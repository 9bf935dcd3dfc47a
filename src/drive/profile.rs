//! What is known about a drive before it is asked: how it is wired, what it can do, what its signals are.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::register_map::RegisterMap;
use crate::config_text::{self, ConfigError, help_for_unknown};
use crate::sample::{Channel, Origin, Side};

/// A file of `bench-configs/drives/` under its name.
macro_rules! embedded {
    ($name:literal) => {
        (
            $name,
            include_str!(concat!("../../bench-configs/drives/", $name, ".toml")),
        )
    };
}

/// The profiles that are built in: name and text.
const EMBEDDED: [(&str, &str); 13] = [
    embedded!("own"),
    embedded!("own-stream"),
    embedded!("abb-dcs-gateway"),
    embedded!("abb-efb"),
    embedded!("delta-ms300"),
    embedded!("epulse50-dc"),
    embedded!("leadshine-iem"),
    embedded!("roboteq-dc"),
    embedded!("schneider-atv312"),
    embedded!("siemens-v20"),
    embedded!("toshiba-vfs11"),
    embedded!("vacon10"),
    embedded!("yaskawa-a1000"),
];

/// A drive as its configuration file describes it.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct DriveProfile {
    pub name: String,
    /// Where the numbers come from.
    pub source: String,
    pub trust: Trust,
    pub link: LinkSettings,
    pub capabilities: Capabilities,
    pub signals: SignalOrigins,
    #[serde(default)]
    pub sides: SignalSides,
    pub watchdog: Watchdog,
    #[serde(default)]
    pub limits: DriveLimits,
    /// The registers of a drive that speaks another language than ours.
    #[serde(skip)]
    pub registers: Option<Arc<RegisterMap>>,
}

/// How far the numbers of a profile may be believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Trust {
    Manual,
    Code,
    Unverified,
}

impl Trust {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Manual => "manual",
            Self::Code => "code",
            Self::Unverified => "unverified",
        }
    }
}

/// The language on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    ModbusRtu,
    ModbusTcp,
    Stream,
}

impl Protocol {
    pub const fn name(self) -> &'static str {
        match self {
            Self::ModbusRtu => "modbus-rtu",
            Self::ModbusTcp => "modbus-tcp",
            Self::Stream => "stream",
        }
    }
}

/// Data bits, parity, stop bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
pub enum Framing {
    #[default]
    #[serde(rename = "8N1")]
    EightNoneOne,
    #[serde(rename = "8E1")]
    EightEvenOne,
    #[serde(rename = "8O1")]
    EightOddOne,
    #[serde(rename = "8N2")]
    EightNoneTwo,
}

impl Framing {
    pub const fn name(self) -> &'static str {
        match self {
            Self::EightNoneOne => "8N1",
            Self::EightEvenOne => "8E1",
            Self::EightOddOne => "8O1",
            Self::EightNoneTwo => "8N2",
        }
    }

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
    /// Silence before a Modbus RTU request, us; `None`: as the standard says.
    pub gap_us: Option<f64>,
    /// Time for one exchange, ms; `None`: from wire and reply time.
    pub deadline_ms: Option<f64>,
    /// The far end is the software drive of this process, whatever guise it has; in no file.
    #[serde(skip)]
    pub emulated: bool,
}

/// What the drive can be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Capabilities {
    pub voltage_command: bool,
    pub current_command: bool,
    pub speed_command: bool,
}

/// Where each signal comes from; `None`: the drive does not have it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SignalOrigins {
    pub voltage_cmd_v: Option<Origin>,
    pub voltage_v: Option<Origin>,
    pub current_a: Option<Origin>,
    pub speed_rad_s: Option<Origin>,
    pub angle_rad: Option<Origin>,
    pub torque_n_m: Option<Origin>,
    pub bus_v: Option<Origin>,
    pub temperature_c: Option<Origin>,
}

impl SignalOrigins {
    pub const fn get(&self, channel: Channel) -> Option<Origin> {
        match channel {
            // The reference and the uncertainty of a stamp are the host's own.
            Channel::Reference | Channel::TimeHalfWidth => None,
            Channel::VoltageCmd => self.voltage_cmd_v,
            Channel::Voltage => self.voltage_v,
            Channel::Current => self.current_a,
            Channel::Speed => self.speed_rad_s,
            Channel::Angle => self.angle_rad,
            Channel::Torque => self.torque_n_m,
            Channel::Bus => self.bus_v,
            Channel::Temperature => self.temperature_c,
        }
    }
}

/// On which side of the power stage voltage and current are taken; `None`: the profile does not say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SignalSides {
    pub voltage_v: Option<Side>,
    pub current_a: Option<Side>,
}

impl SignalSides {
    pub const fn get(self, channel: Channel) -> Option<Side> {
        match channel {
            Channel::Voltage => self.voltage_v,
            Channel::Current => self.current_a,
            _ => None,
        }
    }
}

/// What keeps the drive's watchdog quiet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum KickedBy {
    /// Only a write of the command block.
    Command,
    /// Any write.
    Write,
    /// Any message, reading too.
    Any,
}

/// The drive's own stop when the host is silent.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Watchdog {
    pub kicked_by: KickedBy,
    /// After power-up, ms.
    pub default_ms: Option<f64>,
}

/// Bounds beside those that the drive reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct DriveLimits {
    pub current_a: Option<f64>,
    pub voltage_v: Option<f64>,
    pub speed_rad_s: Option<f64>,
}

/// Why there is no profile.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ProfileError {
    #[error("drive profile {name:?} is not known (expected one of: {known})")]
    Unknown { name: String, known: String },
    #[error(transparent)]
    Text(#[from] ConfigError),
    #[error("drive profile {profile:?}: {key} {value} is not allowed (expected {allowed})")]
    Range {
        profile: String,
        key: &'static str,
        value: f64,
        allowed: &'static str,
    },
}

impl ProfileError {
    /// The next step.
    pub fn help(&self) -> String {
        match self {
            Self::Unknown { name, .. } => help_for_unknown(name, EMBEDDED.map(|(name, _)| name)),
            Self::Text(error) => error.help.clone(),
            Self::Range { .. } => "see bench-configs/drives/own.toml".to_owned(),
        }
    }
}

impl DriveProfile {
    /// A built-in profile.
    pub fn named(name: &str) -> Result<Self, ProfileError> {
        Self::parse(&format!("{name}.toml"), Self::text(name)?)
    }

    /// The file of a built-in profile.
    pub fn text(name: &str) -> Result<&'static str, ProfileError> {
        EMBEDDED
            .into_iter()
            .find(|(known, _)| *known == name)
            .map(|(_, text)| text)
            .ok_or_else(|| ProfileError::Unknown {
                name: name.to_owned(),
                known: Self::names().collect::<Vec<_>>().join(", "),
            })
    }

    /// Names of the built-in profiles.
    pub fn names() -> impl Iterator<Item = &'static str> {
        EMBEDDED.into_iter().map(|(name, _)| name)
    }

    /// Reads a profile; `file` names it in errors. A file with a register map says so with `schema`.
    pub fn parse(file: &str, text: &str) -> Result<Self, ProfileError> {
        if has_register_map(text) {
            let (map, profile) = RegisterMap::with_profile(file, text)?;
            return Ok(Self {
                registers: Some(Arc::new(map)),
                ..profile
            });
        }
        let profile: Self = config_text::parse(file, text)?;
        profile.check()?;
        Ok(profile)
    }

    /// One line for whoever uses it: which drive, and how far its numbers may be believed.
    pub fn provenance(&self) -> String {
        let (title, note) = self
            .registers
            .as_ref()
            .map_or((String::new(), String::new()), |map| {
                let doubtful = map.unverified();
                let doubt = if doubtful.is_empty() {
                    String::new()
                } else {
                    format!("; unverified: {}", doubtful.join(", "))
                };
                (format!(" ({})", map.device.name), doubt)
            });
        format!(
            "drive profile {}{title}: trust {}{note}; source: {}",
            self.name,
            self.trust.name(),
            self.source
        )
    }

    pub(super) fn check(&self) -> Result<(), ProfileError> {
        let range = |key, value: f64, good: bool, allowed| {
            if good {
                Ok(())
            } else {
                Err(ProfileError::Range {
                    profile: self.name.clone(),
                    key,
                    value,
                    allowed,
                })
            }
        };
        let link = &self.link;
        let baud = f64::from(link.baud);
        range("link.baud", baud, link.baud > 0, "more than 0")?;
        let unit = (1..=247).contains(&link.unit);
        range("link.unit", link.unit.into(), unit, "1 to 247")?;
        let reply = (0.0..=10_000.0).contains(&link.reply_ms);
        range("link.reply_ms", link.reply_ms, reply, "0 to 10000")?;
        let gap_us = link.gap_us.unwrap_or(0.0);
        let gap = (0.0..=1e6).contains(&gap_us);
        range("link.gap_us", gap_us, gap, "0 to 1000000")?;
        let deadline_ms = link.deadline_ms.unwrap_or(1.0);
        let deadline = (1.0..=60_000.0).contains(&deadline_ms);
        range("link.deadline_ms", deadline_ms, deadline, "1 to 60000")?;
        let watchdog_ms = self.watchdog.default_ms.unwrap_or(1.0);
        let watchdog = watchdog_ms.is_finite() && watchdog_ms > 0.0;
        range("watchdog.default_ms", watchdog_ms, watchdog, "more than 0")?;
        for (key, limit) in [
            ("limits.current_a", self.limits.current_a),
            ("limits.voltage_v", self.limits.voltage_v),
            ("limits.speed_rad_s", self.limits.speed_rad_s),
        ] {
            let value = limit.unwrap_or(1.0);
            range(key, value, value.is_finite() && value > 0.0, "more than 0")?;
        }
        Ok(())
    }
}

/// Profiles of our own register map have no `schema`; where neither is there the error is that of our own.
fn has_register_map(text: &str) -> bool {
    let starts = |line: &str, key: &str| {
        line.strip_prefix(key)
            .is_some_and(|rest| rest.trim_start().starts_with('='))
    };
    let mut lines = text.lines().map(str::trim);
    lines.any(|line| starts(line, "schema") || line == "[device]")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_own_profile_is_read_and_says_what_it_has() {
        let own = DriveProfile::named("own").unwrap();
        assert!(own.capabilities.voltage_command);
        assert_eq!(own.signals.get(Channel::Current), Some(Origin::Measured));
        assert_eq!(own.signals.get(Channel::Torque), None);
        assert_eq!(own.sides.get(Channel::Current), Some(Side::Terminal));
        assert_eq!(own.sides.get(Channel::Speed), None);
        assert_eq!(own.watchdog.kicked_by, KickedBy::Command);
        assert_eq!(own.link.framing.bits_per_char(), 10);
    }

    #[test]
    fn an_unknown_profile_lists_what_there_is() {
        let error = DriveProfile::named("onw").unwrap_err();
        assert_eq!(
            error.to_string(),
            format!(
                "drive profile \"onw\" is not known (expected one of: {})",
                DriveProfile::names().collect::<Vec<_>>().join(", ")
            )
        );
        assert_eq!(error.help(), "did you mean `own`?");
    }

    #[test]
    fn unknown_keys_and_values_out_of_range_are_refused() {
        let (_, own) = EMBEDDED[0];
        let text = own.replace("reply_ms = 1.0 ", "replyms = 1.0 ");
        let ProfileError::Text(error) = DriveProfile::parse("x.toml", &text).unwrap_err() else {
            panic!("the key is wrong");
        };
        assert_eq!(error.help, "did you mean `reply_ms`?");
        for (from, to, key) in [
            ("unit = 1 ", "unit = 0 ", "link.unit"),
            ("baud = 115200 ", "baud = 0 ", "link.baud"),
            ("reply_ms = 1.0", "reply_ms = nan", "link.reply_ms"),
            (
                "# deadline_ms = 50.0",
                "deadline_ms = 0.0",
                "link.deadline_ms",
            ),
            ("# current_a = 11.4", "current_a = -1.0", "limits.current_a"),
        ] {
            let error = DriveProfile::parse("x.toml", &own.replace(from, to)).unwrap_err();
            assert!(error.to_string().contains(key), "{error}");
        }
    }
}
