//! The emulator's configuration: plant, hidden effects, limits, sensors, line.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::fault::FaultEntry;
use super::truth::effect::{HiddenEffect, flux_saturation};
use super::truth::{Change, MotorTruth, NoiseConfig, QuantisationConfig};
use drivebench_link::Protocol;
use drivebench_model::config_text::{self, ConfigError};

macro_rules! embedded {
    ($($name:literal),+ $(,)?) => {
        [$(($name, include_str!(concat!("../../../bench-configs/emulators/", $name, ".toml")))),+]
    };
}

const EMBEDDED: [(&str, &str); 12] = embedded![
    "zk-22fc-hidden",
    "zk-22fc-plain",
    "zk-22fc-viscous",
    "zk-22fc-fan",
    "zk-22fc-brushes",
    "zk-22fc-warming",
    "zk-22fc-locked",
    "zk-22fc-open",
    "zk-22fc-changing",
    "zk-22fc-elastic",
    "small-servo-behind-zk-22fc",
    "large-motor-behind-zk-22fc",
];

/// A configuration that no drive can have.
#[derive(Debug, Error)]
pub enum EmulatorConfigError {
    #[error(transparent)]
    Text(#[from] ConfigError),
    #[error("{file}: {key} = {value} is not allowed (expected {allowed})")]
    Value { file: String, key: &'static str, value: f64, allowed: &'static str },
    #[error(
        "{file}: {key} of the hidden effect {effect} = {value} is not allowed (expected {allowed})"
    )]
    Hidden {
        file: String,
        effect: &'static str,
        key: &'static str,
        value: f64,
        allowed: &'static str,
    },
    #[error(
        "{file}: saturation_per_a2 of the hidden effect flux_saturation = {value} is not allowed (expected 0 to {most:.1e} on \
         this motor: beyond, the back-EMF at rated speed falls faster with the current than the voltage of the \
         resistance grows, and the current runs away)"
    )]
    RunsAway { file: String, value: f64, most: f64 },
    #[error(
        "{file}: two hidden effects put a second inertia behind the shaft (expected one at most)"
    )]
    TwoShafts { file: String },
    #[error("[[fault]] kind = {kind:?} does nothing {on} (expected {allowed})")]
    Idle { kind: &'static str, on: &'static str, allowed: &'static str },
    #[error("there is no embedded emulator {name:?}")]
    Unknown { name: String },
}

impl EmulatorConfigError {
    pub fn help(&self) -> String {
        match self {
            Self::Text(error) => error.help.clone(),
            Self::Value { .. } | Self::Hidden { .. } | Self::Idle { .. } => {
                "see bench-configs/emulators/example.toml for every key, its unit and its default"
                    .to_owned()
            }
            Self::RunsAway { .. } => {
                "a smaller size, or a motor with more resistance; [limits] current_limit_a counts too".to_owned()
            }
            Self::TwoShafts { .. } => {
                "keep either elastic_coupling or backlash; backlash is elastic too".to_owned()
            }
            Self::Unknown { name } => {
                config_text::help_for_unknown(name, EMBEDDED.iter().map(|(name, _)| *name))
            }
        }
    }
}

/// A software drive with its motor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EmulatorConfig {
    /// R, L, Ke, J and Mc of the specimen each lie within this fraction of the nameplate; drawn from the seed.
    #[serde(default)]
    pub tolerance: f64,
    /// Command silence after which the running drive stops itself, ms.
    #[serde(default = "default_watchdog_ms")]
    pub watchdog_ms: u16,
    pub motor: MotorTruth,
    pub limits: LimitsConfig,
    #[serde(default)]
    pub noise: NoiseConfig,
    #[serde(default)]
    pub quantisation: QuantisationConfig,
    #[serde(default)]
    pub line: LineConfig,
    /// Left out: nothing holds the shaft while the output is off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub brake: Option<BrakeConfig>,
    #[serde(default)]
    pub faults: FaultsConfig,
    #[serde(default)]
    pub hidden: Vec<HiddenEffect>,
    /// What changes on the shaft while the drive runs, in the order of the times.
    #[serde(default, rename = "change", skip_serializing_if = "Vec::is_empty")]
    pub changes: Vec<Change>,
    #[serde(default, rename = "fault", skip_serializing_if = "Vec::is_empty")]
    pub faulty: Vec<FaultEntry>,
    /// Which of the specimen's days this is: sensor noise and random loads are drawn anew on each. A hold-out with the
    /// noise of the fitted run would test less than it seems to.
    #[serde(skip)]
    pub day: u64,
}

/// Faults of the machine and its cabling; those without a time are there from the start, and all of them stay.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FaultsConfig {
    pub locked_rotor: bool,
    pub open_phase: bool,
    pub encoder_reversed: bool,
    /// Speed and angle stay as they are so long after each start of the drive, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder_frozen_from_s: Option<f64>,
    /// The field current is gone so long after each start of the drive, s, as long as it runs; only a profile with a field
    /// shows it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub field_lost_from_s: Option<f64>,
}

impl FaultsConfig {
    fn refused(&self) -> Option<(&'static str, f64, &'static str)> {
        let times = [
            ("faults.encoder_frozen_from_s", self.encoder_frozen_from_s),
            ("faults.field_lost_from_s", self.field_lost_from_s),
        ];
        times.into_iter().find_map(|(key, from_s)| {
            let bad = from_s.filter(|from_s| !(0.0..=86_400.0).contains(from_s))?;
            Some((key, bad, "0 to 86400 s"))
        })
    }
}

/// A brake on the shaft that the drive works: shut while the output is off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BrakeConfig {
    pub release_s: f64,
    pub apply_s: f64,
}

const fn default_watchdog_ms() -> u16 {
    200
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LimitsConfig {
    /// The inverter lowers its voltage so that the current stays below this magnitude.
    pub current_limit_a: f64,
    pub bus_v: f64,
    pub speed_limit_rad_s: f64,
    /// The thermal switch in the winding opens above this temperature (with 25 C around).
    #[serde(default = "default_winding_limit_c")]
    pub winding_limit_c: f64,
    #[serde(default)]
    pub output_off: OutputOff,
    /// A supply that takes nothing back: what braking returns charges this capacitance, F. Left out: it takes all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bus_capacitance_f: Option<f64>,
}

/// Insulation class H.
const fn default_winding_limit_c() -> f64 {
    180.0
}

/// State of the motor's terminals while the output is off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OutputOff {
    /// Both terminals on the same rail: the motor brakes electrically, within the current limit.
    #[default]
    ZeroVolt,
    /// All switches off: the motor coasts.
    Open,
}

/// The serial line that a pseudo-terminal emulates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LineConfig {
    /// 0: as fast as the machine can.
    pub baud: u32,
    /// 10 for 8N1, 11 for 8E1 and 8N2.
    pub bits_per_char: u8,
    /// Turnaround time of the drive before its answer.
    pub turnaround_ms: f64,
    /// Share of the answers over a wire that come late, and by how much; the drive in memory is never late.
    #[serde(skip_serializing_if = "is_zero")]
    pub late_share: f64,
    #[serde(skip_serializing_if = "is_zero")]
    pub late_ms: f64,
    /// Silence between Modbus frames; left out: 3.5 characters, and 1750 us above 19200 baud.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gap_us: Option<f64>,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde gives a reference")]
const fn is_zero(value: &f64) -> bool {
    value.to_bits() == 0
}

impl Default for LineConfig {
    fn default() -> Self {
        Self {
            baud: 115_200,
            bits_per_char: 10,
            turnaround_ms: 0.5,
            late_share: 0.0,
            late_ms: 0.0,
            gap_us: None,
        }
    }
}

impl EmulatorConfig {
    pub fn parse(file: &str, text: &str) -> Result<Self, EmulatorConfigError> {
        let config: Self = config_text::parse(file, text)?;
        config.check(file)?;
        Ok(config)
    }

    /// The configuration that `commission` uses when none is given: a ZK-22FC with a hidden effect.
    #[expect(
        clippy::missing_panics_doc,
        reason = "the text is part of the program and a test parses it"
    )]
    pub fn embedded_default() -> Self {
        Self::embedded(EMBEDDED[0].0).expect("a test parses every embedded configuration")
    }

    pub fn embedded(name: &str) -> Result<Self, EmulatorConfigError> {
        let Some((_, text)) = EMBEDDED.iter().find(|(embedded, _)| *embedded == name) else {
            let name = name.to_owned();
            return Err(EmulatorConfigError::Unknown { name });
        };
        Self::parse(name, text)
    }

    /// Names of the embedded configurations, the default first.
    pub fn embedded_names() -> impl Iterator<Item = &'static str> {
        EMBEDDED.iter().map(|(name, _)| *name)
    }

    /// The first value outside of the hidden effects that no drive can have, as `(key, value, what is allowed)`.
    fn impossible(&self) -> Option<(&'static str, f64, &'static str)> {
        const LIMIT: &str = "above 0; at most what a register carries, or 1000 C";
        const OPTION: &str = "above 0; at most 1 F, or 10 s";
        if let Some((key, value)) = self.motor.impossible() {
            return Some((key, value, "a positive number, for load_torque_n_m also 0"));
        }
        let to = |most: f64| f64::MIN_POSITIVE..=most;
        let (limits, noise, step) = (&self.limits, &self.noise, &self.quantisation);
        let capacitance_f = limits.bus_capacitance_f.unwrap_or(1.0);
        let (release_s, apply_s) = self.brake.map_or((1.0, 1.0), |b| (b.release_s, b.apply_s));
        let carried = [("current_limit_a", limits.current_limit_a), ("bus_v", limits.bus_v)];
        let speed = [("speed_limit_rad_s", limits.speed_limit_rad_s)];
        let winding = [("winding_limit_c", limits.winding_limit_c)];
        let brake = [("brake.release_s", release_s), ("brake.apply_s", apply_s)];
        let sensors = [
            ("noise.voltage_v", noise.voltage_v),
            ("noise.current_a", noise.current_a),
            ("noise.speed_rad_s", noise.speed_rad_s),
            ("noise.bus_v", noise.bus_v),
            ("quantisation.voltage_v", step.voltage_v),
            ("quantisation.current_a", step.current_a),
            ("quantisation.speed_rad_s", step.speed_rad_s),
            ("quantisation.angle_rad", step.angle_rad),
            ("line.turnaround_ms", self.line.turnaround_ms),
            ("line.late_ms", self.line.late_ms),
            ("line.gap_us", self.line.gap_us.unwrap_or(0.0)),
        ];
        let watchdog = [("watchdog_ms", self.watchdog_ms.into())];
        let bits = [("line.bits_per_char", self.line.bits_per_char.into())];
        let late = [("line.late_share", self.line.late_share)];
        let groups: [(&[(&'static str, f64)], _, _); 10] = [
            (&[("tolerance", self.tolerance)], 0.0..=0.5, "0 to 0.5"),
            (&watchdog, 20.0..=5000.0, "20 to 5000"),
            (&carried, to(655.0), LIMIT),
            (&speed, to(1310.0), LIMIT),
            (&winding, to(1000.0), LIMIT),
            (&[("bus_capacitance_f", capacitance_f)], to(1.0), OPTION),
            (&brake, to(10.0), OPTION),
            (&sensors, 0.0..=f64::MAX, "0 or more"),
            (&bits, 10.0..=12.0, "10 to 12"),
            (&late, 0.0..=1.0, "0 to 1"),
        ];
        groups.into_iter().find_map(|(rows, range, allowed)| {
            let (key, value) = rows.iter().find(|row| !range.contains(&row.1))?;
            Some((*key, *value, allowed))
        })
    }

    /// Whether what goes wrong needs a line to go wrong on.
    pub fn needs_line(&self) -> bool {
        self.faulty.iter().any(|fault| fault.kind.needs_line())
    }

    /// Refuses faults that would do nothing on such a drive.
    pub fn suits(&self, as_another: bool, link: Protocol) -> Result<(), EmulatorConfigError> {
        self.faulty.iter().try_for_each(|fault| fault.suits(as_another, link))
    }

    fn check(&self, file: &str) -> Result<(), EmulatorConfigError> {
        let refuse = |(key, value, allowed)| {
            Err(EmulatorConfigError::Value { file: file.to_owned(), key, value, allowed })
        };
        if let Some(impossible) = self.impossible() {
            return refuse(impossible);
        }
        for effect in &self.hidden {
            if let Some((key, value, allowed)) = effect.refused() {
                return Err(EmulatorConfigError::Hidden {
                    file: file.to_owned(),
                    effect: effect.id(),
                    key,
                    value,
                    allowed,
                });
            }
        }
        let refused = Change::refused(&self.changes)
            .or_else(|| self.faults.refused())
            .or_else(|| self.faulty.iter().find_map(FaultEntry::refused));
        if let Some(refused) = refused {
            return refuse(refused);
        }
        let current_limit_a = self.limits.current_limit_a;
        let most = flux_saturation::largest_stable(&self.motor, current_limit_a, self.tolerance);
        let file = file.to_owned();
        let saturating = self.hidden.iter().filter(|e| e.id() == "flux_saturation");
        let mut sizes = saturating.filter_map(|e| e.value("saturation_per_a2"));
        if let Some(value) = sizes.find(|value| *value > most) {
            return Err(EmulatorConfigError::RunsAway { file, value, most });
        }
        if self.hidden.iter().filter(|e| e.is_shaft()).count() > 1 {
            return Err(EmulatorConfigError::TwoShafts { file });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
