//! Profile of a drive: wiring, commands, signals and limits, known before the first request.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::register_map::{Quantity, RegisterMap};
use super::settings::{DriveLimits, KickedBy, LinkSettings, RangeError, Trust, check_ranges};
use drivebench_model::config_text::{self, ConfigError, help_for_unknown};
use drivebench_model::sample::{Channel, Origin, Side};

/// A file of `bench-configs/drives/` under its name.
macro_rules! embedded {
    ($name:literal) => {
        ($name, include_str!(concat!("../../../bench-configs/drives/", $name, ".toml")))
    };
}

const EMBEDDED: [(&str, &str); 20] = [
    embedded!("own"),
    embedded!("own-stream"),
    embedded!("abb-dcs-gateway"),
    embedded!("abb-efb"),
    embedded!("delta-ms300"),
    embedded!("dynamixel-xl330"),
    embedded!("dynamixel-xm430"),
    embedded!("epulse50-dc"),
    embedded!("leadshine-iem"),
    embedded!("odrive-0.5"),
    embedded!("odrive-0.5-torque"),
    embedded!("roboteq-dc"),
    embedded!("roboteq-sdc"),
    embedded!("schneider-atv312"),
    embedded!("siemens-v20"),
    embedded!("toshiba-vfs11"),
    embedded!("vacon10"),
    embedded!("vesc-dc"),
    embedded!("vesc-foc"),
    embedded!("yaskawa-a1000"),
];

/// A drive as its configuration file describes it.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct DriveProfile {
    pub name: String,
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
    /// The register map of a drive of another make.
    #[serde(skip)]
    pub registers: Option<Arc<RegisterMap>>,
}

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
            Channel::Reference | Channel::CurrentCmd | Channel::TimeHalfWidth => None,
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

/// Side of the power stage on which voltage and current are measured; `None`: not given in the profile.
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

/// The drive's own stop when the host is silent.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Watchdog {
    pub kicked_by: KickedBy,
    /// After power-up, ms.
    pub default_ms: Option<f64>,
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum ProfileError {
    #[error("drive profile {name:?} is not known")]
    Unknown { name: String },
    #[error(transparent)]
    Text(#[from] ConfigError),
    #[error(transparent)]
    Range(#[from] RangeError),
}

impl ProfileError {
    pub fn help(&self) -> String {
        match self {
            Self::Unknown { name } => help_for_unknown(name, EMBEDDED.map(|(name, _)| name)),
            Self::Text(error) => error.help.clone(),
            Self::Range(_) => "see bench-configs/drives/own.toml".to_owned(),
        }
    }
}

impl DriveProfile {
    pub fn named(name: &str) -> Result<Self, ProfileError> {
        Self::parse(&format!("{name}.toml"), Self::text(name)?)
    }

    pub fn text(name: &str) -> Result<&'static str, ProfileError> {
        EMBEDDED
            .into_iter()
            .find(|(known, _)| *known == name)
            .map(|(_, text)| text)
            .ok_or_else(|| ProfileError::Unknown { name: name.to_owned() })
    }

    pub fn names() -> impl Iterator<Item = &'static str> {
        EMBEDDED.into_iter().map(|(name, _)| name)
    }

    /// Reads a profile; `file` names it in errors. The key `schema` marks a file with a register map.
    pub fn parse(file: &str, text: &str) -> Result<Self, ProfileError> {
        if has_register_map(text) {
            let (map, link, limits) = RegisterMap::with_settings(file, text)?;
            return Ok(Self::of(map, link, limits));
        }
        let profile: Self = config_text::parse(file, text)?;
        let watchdog_ms = profile.watchdog.default_ms;
        check_ranges(&profile.name, &profile.link, watchdog_ms, &profile.limits)?;
        Ok(profile)
    }

    /// Commands and signals of a drive with a register map of its own.
    fn of(map: RegisterMap, link: LinkSettings, limits: DriveLimits) -> Self {
        let keys = |channel| map.of_channel(channel).map(|signal| &signal.keys);
        let origin = |channel| keys(channel).and_then(|keys| keys.origin);
        let side = |channel| keys(channel).and_then(|keys| keys.side);
        let able = |quantity| map.demand(quantity).is_some();
        Self {
            name: map.device.id.clone(),
            source: map.device.source.clone(),
            trust: map.device.trust,
            link,
            capabilities: Capabilities {
                voltage_command: able(Quantity::Voltage),
                current_command: able(Quantity::Current),
                speed_command: able(Quantity::Speed),
            },
            signals: SignalOrigins {
                voltage_cmd_v: None,
                voltage_v: origin(Channel::Voltage),
                current_a: origin(Channel::Current),
                speed_rad_s: origin(Channel::Speed),
                angle_rad: origin(Channel::Angle),
                torque_n_m: origin(Channel::Torque),
                bus_v: origin(Channel::Bus),
                temperature_c: origin(Channel::Temperature),
            },
            sides: SignalSides {
                voltage_v: side(Channel::Voltage),
                current_a: side(Channel::Current),
            },
            watchdog: Watchdog {
                kicked_by: map.watchdog.keys.kicked_by,
                // Off as delivered is no time.
                default_ms: map.watchdog.default_s().filter(|s| *s > 0.0).map(|s| s * 1e3),
            },
            limits,
            registers: Some(Arc::new(map)),
        }
    }

    /// Over a line of this baud rate. The rate of the fast signals is stated at the profile's own, and a faster line carries more.
    pub fn set_baud(&mut self, baud: u32) {
        let times = f64::from(baud) / f64::from(self.link.baud);
        self.link.baud = baud;
        if let Some(map) = self.registers.as_mut().filter(|_| times > 1.0) {
            Arc::make_mut(map).rates.fast_hz *= times;
        }
    }

    /// One line for the user: the drive, and how far its numbers are verified.
    pub fn provenance(&self) -> String {
        let (mut title, mut note) = (String::new(), String::new());
        if let Some(map) = &self.registers {
            title = format!(" ({})", map.device.name);
            let doubtful = map.unverified().join(", ");
            if !doubtful.is_empty() {
                note = format!("; unverified: {doubtful}");
            }
        }
        let (name, trust, source) = (&self.name, self.trust.name(), &self.source);
        format!("drive profile {name}{title}: trust {trust}{note}; source: {source}")
    }
}

/// Profiles of our own register map have no `schema`; where neither is there the error is that of our own.
fn has_register_map(text: &str) -> bool {
    let starts = |line: &str, key: &str| {
        line.strip_prefix(key).is_some_and(|rest| rest.trim_start().starts_with('='))
    };
    text.lines().map(str::trim).any(|line| starts(line, "schema") || line == "[device]")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_profile_names_the_nearest_or_what_there_is() {
        let error = DriveProfile::named("onw").unwrap_err();
        assert_eq!(error.to_string(), "drive profile \"onw\" is not known");
        assert_eq!(error.help(), "did you mean `own`?");
        let help = DriveProfile::named("xyzzy").unwrap_err().help();
        assert!(help.starts_with("allowed: own, own-stream, "), "{help}");
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
            ("# deadline_ms = 50.0", "deadline_ms = 0.0", "link.deadline_ms"),
            ("# current_a = 11.4", "current_a = -1.0", "limits.current_a"),
        ] {
            let error = DriveProfile::parse("x.toml", &own.replace(from, to)).unwrap_err();
            assert!(error.to_string().contains(key), "{error}");
        }
    }
}
