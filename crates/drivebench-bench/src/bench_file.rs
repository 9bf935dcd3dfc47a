//! The bench file: drive, link, motor, limits and the sequence of excitations.

use std::fmt::Display;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::currents::CurrentsSection;
use super::limits::{Limits, MotorSection, Nameplate, POSITIVE};
use super::mechanics::{DriveFacts, LoadSection, SupplySection};
use super::speed::{Reference, ReferenceError, SpeedSection};
pub use drivebench_link::Protocol;
use drivebench_link::offer::Purpose;
use drivebench_model::config_text::{self, ConfigError};
use drivebench_model::excitation::{self, ExcitationError, Segment};

/// The bench of `commission` without a bench file.
pub const EMBEDDED_DEFAULT: &str =
    include_str!("../../../bench-configs/benches/zk-22fc-emulated.toml");
pub const EMBEDDED_NAME: &str = "zk-22fc-emulated.toml (embedded)";

#[derive(Clone, Debug, Error, PartialEq)]
pub enum BenchFileError {
    #[error(transparent)]
    Text(#[from] ConfigError),
    #[error("{file}: {refused}")]
    Value { file: String, refused: Refused },
    #[error("{file}: {error}")]
    Sequence {
        file: String,
        #[source]
        error: ExcitationError,
    },
}

impl BenchFileError {
    pub fn help(&self) -> String {
        match self {
            Self::Text(error) => error.help.clone(),
            Self::Value { .. } => {
                "see bench-configs/benches/zk-22fc-emulated.toml for every key, its unit and its default"
                    .to_owned()
            }
            Self::Sequence { error, .. } => error.help().to_owned(),
        }
    }
}

#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{key} = {value} is not allowed (expected {allowed})")]
pub struct Refused {
    pub key: String,
    pub value: String,
    pub allowed: String,
}

impl Refused {
    pub(super) fn new(key: &str, value: impl Display, allowed: impl Into<String>) -> Self {
        Self { key: key.to_owned(), value: value.to_string(), allowed: allowed.into() }
    }

    fn of(self, file: &str) -> BenchFileError {
        BenchFileError::Value { file: file.to_owned(), refused: self }
    }
}

/// A whole bench file, every default filled in on reading; written back it is the effective configuration.
#[derive(Clone, Debug, Deserialize, Serialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct BenchFile {
    pub name: String,
    pub drive: DriveSection,
    pub link: LinkSection,
    #[serde(default)]
    pub emulator: EmulatorSection,
    pub motor: MotorSection,
    #[serde(default)]
    pub limits: LimitsSection,
    #[serde(default, skip_serializing_if = "LoadSection::is_default")]
    pub load: LoadSection,
    #[serde(default, skip_serializing_if = "SupplySection::is_default")]
    pub supply: SupplySection,
    /// Of the drive's profile, once it is known.
    #[serde(skip)]
    pub drive_facts: DriveFacts,
    #[serde(default)]
    pub runs: RunsSection,
    /// What `drivebench speed` does; left out: it is not for this bench.
    pub speed: Option<SpeedSection>,
    /// In place of `sequence`, for a drive that is commanded by current.
    pub currents: Option<CurrentsSection>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sequence: Vec<Segment>,
}

#[derive(Clone, Debug, Deserialize, Serialize, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
pub struct DriveSection {
    /// Name of an embedded drive profile, or path of one.
    pub profile: String,
}

#[derive(Clone, Debug, Deserialize, Serialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct LinkSection {
    /// As in [`Port`]'s text form.
    pub port: String,
    #[serde(default)]
    pub protocol: Protocol,
    /// Left out: that of the drive's profile.
    pub baud: Option<u32>,
    #[serde(default = "default_unit")]
    pub unit: u8,
    #[serde(default = "default_rate_hz")]
    pub rate_hz: f64,
    /// Longest wait for a reply; left out: nine tenths of a period.
    pub deadline_ms: Option<f64>,
}

const fn default_unit() -> u8 {
    1
}

const fn default_rate_hz() -> f64 {
    100.0
}

/// Where the drive is. The emulator is never a fallback: it is used only where it is named.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Port {
    /// `emulator`: the software drive behind a pseudo-terminal or a local TCP port, in real time.
    Emulator,
    /// `sim:`: the software drive in memory, in virtual time.
    Sim,
    /// `sim:rtu`: the same at the far end of a Modbus RTU line in memory, byte by byte.
    SimRtu,
    /// `tcp:HOST:PORT`.
    Tcp(String),
    /// Anything else: path of a serial port.
    Serial(String),
}

impl Port {
    pub fn parse(text: &str) -> Option<Self> {
        match text {
            "" => None,
            "emulator" => Some(Self::Emulator),
            "sim:" => Some(Self::Sim),
            "sim:rtu" => Some(Self::SimRtu),
            _ => match text.strip_prefix("tcp:") {
                Some(address) => {
                    let (host, port) = address.rsplit_once(':')?;
                    let valid = !host.is_empty() && port.parse::<u16>().is_ok();
                    valid.then(|| Self::Tcp(address.to_owned()))
                }
                None => Some(Self::Serial(text.to_owned())),
            },
        }
    }

    pub const fn is_emulated(&self) -> bool {
        matches!(self, Self::Emulator | Self::Sim | Self::SimRtu)
    }

    /// Whether the time of the run is virtual.
    pub const fn is_virtual(&self) -> bool {
        matches!(self, Self::Sim | Self::SimRtu)
    }
}

#[derive(Clone, Debug, Deserialize, Serialize, PartialEq, Eq)]
#[serde(deny_unknown_fields, default)]
pub struct EmulatorSection {
    /// Name of an embedded emulator, or path of one. Used with the ports `emulator`, `sim:` and `sim:rtu` only.
    pub config: String,
    /// Draws the specimen within its tolerance, and the sensor noise.
    pub seed: u64,
}

impl Default for EmulatorSection {
    fn default() -> Self {
        Self { config: "zk-22fc-hidden".to_owned(), seed: 1 }
    }
}

/// `[limits]`; what is left out follows from the nameplate (`Limits::for_motor`).
#[derive(Clone, Debug, Default, Deserialize, Serialize, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct LimitsSection {
    pub current_a: Option<f64>,
    pub speed_rad_s: Option<f64>,
    pub voltage_v: Option<f64>,
    pub slew_v_per_s: Option<f64>,
    pub travel_rad: Option<f64>,
    pub bus_min_v: Option<f64>,
    pub bus_max_v: Option<f64>,
    pub time_s: Option<f64>,
    pub link_silence_s: Option<f64>,
}

impl LimitsSection {
    /// Key, unit and value of every limit.
    pub(super) fn rows(&mut self) -> [(&'static str, &'static str, &mut Option<f64>); 9] {
        [
            ("current_a", "A, either sign", &mut self.current_a),
            ("speed_rad_s", "rad/s, either sign", &mut self.speed_rad_s),
            ("voltage_v", "V, either sign", &mut self.voltage_v),
            ("slew_v_per_s", "V/s", &mut self.slew_v_per_s),
            ("travel_rad", "rad", &mut self.travel_rad),
            ("bus_min_v", "V", &mut self.bus_min_v),
            ("bus_max_v", "V", &mut self.bus_max_v),
            ("time_s", "s with the output on", &mut self.time_s),
            ("link_silence_s", "s", &mut self.link_silence_s),
        ]
    }
}

/// `[runs]`: the seeds with which `commission` repeats the sequence. The random parts of the sequence use their own
/// seed plus the run's, so that each run is another one of the same kind.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq, Eq)]
#[serde(deny_unknown_fields, default)]
pub struct RunsSection {
    /// The run on which models are fitted.
    pub fit: u64,
    /// The hold-out by which effects are chosen.
    pub select: u64,
    /// The hold-out of which the error is reported.
    pub confirm: u64,
    /// Repeats an earlier run, for the repeatability floor.
    pub repeat: u64,
    /// Part of the sequence, from 1, with whose first command the drive starts a burst capture.
    pub burst_at: Option<usize>,
}

impl Default for RunsSection {
    fn default() -> Self {
        Self { fit: 1, select: 2, confirm: 3, repeat: 1, burst_at: None }
    }
}

impl BenchFile {
    /// Reads and checks a bench file; `file` names it in errors.
    pub fn parse(file: &str, text: &str) -> Result<Self, BenchFileError> {
        let bench: Self = config_text::parse(file, text)?;
        bench.check(file)?;
        Ok(bench)
    }

    /// The emulated ZK-22FC with a hidden effect.
    ///
    /// # Panics
    /// Never: a test reads the embedded text.
    pub fn embedded_default() -> Self {
        Self::parse(EMBEDDED_NAME, EMBEDDED_DEFAULT).expect("a test parses the embedded bench")
    }

    /// The effective configuration as text; it reads back as the same bench.
    ///
    /// # Panics
    /// Never: every field has a TOML form.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a bench file has only tables, numbers and strings")
    }

    pub fn port(&self) -> Port {
        Port::parse(&self.link.port).unwrap_or_else(|| Port::Serial(self.link.port.clone()))
    }

    pub fn period_s(&self) -> f64 {
        1.0 / self.link.rate_hz
    }

    /// Baud rate of the line, as given by the bench file or set from the profile; 115,200 Bd by default.
    pub fn baud(&self) -> u32 {
        self.link.baud.unwrap_or(115_200)
    }

    pub fn deadline_s(&self) -> f64 {
        self.link.deadline_ms.map_or(0.9 * self.period_s(), |ms| ms * 1e-3)
    }

    /// Limits with every default filled in.
    pub fn limits(&self) -> Limits {
        let rate_hz = self.link.rate_hz;
        let defaults = match self.motor.nameplate() {
            Some(nameplate) => Limits::for_motor(&nameplate, rate_hz),
            None => Limits::for_rated(&self.motor, rate_hz),
        };
        let (given, bounds) = (&self.limits, &self.drive_facts.bounds);
        let converter = self.drive_facts.converter;
        // The drive's profile bounds a default; a given value beyond it is refused elsewhere.
        let bounded = |given: Option<f64>, default: f64, bound: Option<f64>| {
            given.unwrap_or_else(|| bound.map_or(default, |bound| default.min(bound)))
        };
        Limits {
            current_a: bounded(given.current_a, defaults.current_a, bounds.current_a),
            speed_rad_s: bounded(given.speed_rad_s, defaults.speed_rad_s, bounds.speed_rad_s),
            voltage_v: bounded(given.voltage_v, defaults.voltage_v, bounds.voltage_v),
            slew_v_per_s: given.slew_v_per_s.unwrap_or(defaults.slew_v_per_s),
            travel_rad: given.travel_rad,
            bus_min_v: given.bus_min_v,
            bus_max_v: given.bus_max_v,
            time_s: given.time_s.unwrap_or(defaults.time_s),
            link_silence_s: given.link_silence_s.unwrap_or_else(|| {
                // One lost reply is no lost link.
                defaults.link_silence_s.max(self.drive_facts.lost_reply_s.unwrap_or(0.0))
            }),
            braking_w: self.supply.braking_w(),
            quadrants: converter.map_or(defaults.quadrants, |converter| converter.quadrants),
            dead_time_s: converter.map_or(0.0, |converter| 1e-3 * converter.dead_time_ms),
            field_min_a: self.drive_facts.field_min_a,
            load: self.load,
        }
    }

    /// The nameplate; `None` where `[motor]` leaves a value out.
    pub fn nameplate(&self) -> Option<Nameplate> {
        self.motor.nameplate()
    }

    /// The sequence of one run, its random parts seeded with `run_seed` besides their own seed.
    pub fn program(&self, run_seed: u64) -> Result<excitation::Program, ExcitationError> {
        let mut segments = self.sequence.clone();
        for seed in segments.iter_mut().filter_map(|segment| cells(segment).seed) {
            // Far apart, so that run 2 is not run 1 with its parts exchanged.
            *seed = seed.wrapping_add(run_seed.wrapping_mul(1000));
        }
        excitation::Program::new(&segments, self.limits().slew_v_per_s)
    }

    /// The signals that a run of the bench needs.
    pub const fn purpose(&self) -> Purpose {
        if self.currents.is_some() { Purpose::Currents } else { Purpose::Voltages }
    }

    fn check(&self, file: &str) -> Result<(), BenchFileError> {
        if let Some(refused) = self.refused() {
            return Err(refused.of(file));
        }
        if let Some(currents) = &self.currents {
            if !self.sequence.is_empty() {
                let allowed = "left out, or [[sequence]]: a run has one of them";
                return Err(Refused::new("currents", "given", allowed).of(file));
            }
            return currents.refused(&self.limits()).map_or(Ok(()), |it| Err(it.of(file)));
        }
        let error = |error| BenchFileError::Sequence { file: file.to_owned(), error };
        self.program(self.runs.fit).map(drop).map_err(error)
    }

    fn refused(&self) -> Option<Refused> {
        let (link, limits) = (&self.link, self.limits());
        let (load, supply) = (&self.load, &self.supply);
        if self.name.is_empty() || self.name.contains(['/', '\\']) {
            let allowed = "a name that can stand in a folder's name";
            return Some(Refused::new("name", format!("{:?}", self.name), allowed));
        }
        if Port::parse(&link.port).is_none() {
            return Some(Refused::new("link.port", format!("{:?}", link.port), PORTS));
        }
        if !(1.0..=2000.0).contains(&link.rate_hz) {
            return Some(Refused::new("link.rate_hz", link.rate_hz, "1 to 2000"));
        }
        let bad_ms = link.deadline_ms.filter(|ms| !(0.5..=10_000.0).contains(ms));
        if let Some(ms) = bad_ms {
            return Some(Refused::new("link.deadline_ms", ms, "0.5 to 10000"));
        }
        if let Some((key, value)) = self.motor.refused() {
            return Some(Refused::new(&format!("motor.{key}"), value, POSITIVE));
        }
        for (key, _, value) in self.limits.clone().rows() {
            if let Some(value) = value.filter(|value| !(value.is_finite() && *value > 0.0)) {
                let key = format!("limits.{key}");
                return Some(Refused::new(&key, value, "a positive number"));
            }
        }
        let mechanics = load.refused(limits.current_a).or_else(|| supply.refused());
        if mechanics.is_some() {
            return mechanics;
        }
        if load.vertical && self.motor.is_unknown() {
            let allowed =
                "a known motor: the small steps that find an unknown one would let the load fall";
            return Some(Refused::new("load.vertical", "true", allowed));
        }
        if self.currents.is_some() && load.vertical {
            let allowed = "false with [currents]: a load that pulls is not held meanwhile";
            return Some(Refused::new("load.vertical", "true", allowed));
        }
        let parts = 1..=self.sequence.len();
        if let Some(part) = self.runs.burst_at.filter(|part| !parts.contains(part)) {
            let allowed = "the number of a part of the sequence, from 1";
            return Some(Refused::new("runs.burst_at", part, allowed));
        }
        // The wait for one reply must not count as silence.
        if limits.link_silence_s < self.period_s() + self.deadline_s() {
            let allowed = "at least one period of link.rate_hz and link.deadline_ms together";
            return Some(Refused::new("limits.link_silence_s", limits.link_silence_s, allowed));
        }
        let (low, _) = limits.bus_min_v.zip(limits.bus_max_v).filter(|(low, high)| low >= high)?;
        Some(Refused::new("limits.bus_min_v", low, "less than limits.bus_max_v"))
    }

    /// A limit of this bench beyond what the profile of its drive allows: key, value and the most that is allowed.
    pub fn beyond_drive(&self) -> Option<(&'static str, f64, f64)> {
        let (given, bounds) = (&self.limits, &self.drive_facts.bounds);
        let pairs = [
            ("limits.current_a", given.current_a, bounds.current_a),
            ("limits.speed_rad_s", given.speed_rad_s, bounds.speed_rad_s),
            ("limits.voltage_v", given.voltage_v, bounds.voltage_v),
        ];
        pairs
            .into_iter()
            .filter_map(|(key, given, bound)| Some((key, given?, bound?)))
            .find(|(_, given, bound)| given > bound)
    }

    /// `[speed]` against the limits: a reference beyond them is refused with its line in `text`, before anything moves.
    /// What `drivebench speed` needs, and no other command.
    ///
    /// # Errors
    /// The first value that is not allowed.
    pub fn check_speed(&self, file: &str, text: &str) -> Result<(), BenchFileError> {
        let Some(speed) = &self.speed else {
            return Ok(());
        };
        let limits = self.limits();
        if let Some(refused) = speed.refused(&limits) {
            return Err(refused.of(file));
        }
        let reference = self.reference(speed).map_err(|error| at_its_line(file, text, &error))?;
        let needed_s = reference.duration_s() + SPEED_ENDS_S;
        if needed_s > limits.time_s {
            let allowed = format!("at least {needed_s} s, which the reference takes with its ends");
            return Err(Refused::new("limits.time_s", limits.time_s, allowed).of(file));
        }
        Ok(())
    }

    pub fn reference(&self, speed: &SpeedSection) -> Result<Reference, ReferenceError> {
        speed.reference(&self.limits(), self.nameplate().as_ref())
    }
}

/// The values of a part of a sequence that may be scaled, rounded and seeded.
#[derive(Default)]
pub(super) struct Cells<'a> {
    pub(super) volts: Vec<&'a mut f64>,
    pub(super) times_s: Vec<&'a mut f64>,
    /// Of its random levels.
    pub(super) seed: Option<&'a mut u64>,
}

pub(super) fn cells(segment: &mut Segment) -> Cells<'_> {
    let mut cells = Cells::default();
    let (volts, times_s) = (&mut cells.volts, &mut cells.times_s);
    let dither = match segment {
        Segment::Steps(steps) => {
            volts.extend(&mut steps.levels_v);
            times_s.push(&mut steps.hold_s);
            steps.dither.as_mut()
        }
        Segment::Staircase(stairs) => {
            volts.extend([&mut stairs.from_v, &mut stairs.to_v]);
            stairs.dither.as_mut()
        }
        Segment::Ramp(ramp) => {
            volts.extend([&mut ramp.from_v, &mut ramp.to_v]);
            times_s.push(&mut ramp.seconds);
            ramp.dither.as_mut()
        }
        Segment::Prbs(prbs) => {
            volts.extend([&mut prbs.amplitude_v, &mut prbs.offset_v]);
            times_s.extend([&mut prbs.clock_s, &mut prbs.seconds]);
            cells.seed = Some(&mut prbs.seed);
            None
        }
        Segment::Sine(sine) => {
            volts.push(&mut sine.amplitude_v);
            times_s.push(&mut sine.seconds);
            None
        }
        Segment::Chirp(chirp) => {
            volts.extend([&mut chirp.amplitude_v, &mut chirp.offset_v]);
            times_s.push(&mut chirp.seconds);
            None
        }
        Segment::Standstill(_) | Segment::CoastDown(_) => None,
    };
    if let Some(dither) = dither {
        volts.push(&mut dither.amplitude_v);
        times_s.push(&mut dither.clock_s);
        cells.seed = Some(&mut dither.seed);
    }
    cells
}

/// Time of a speed run beyond its reference, s: to enable the drive, and to come to rest.
pub(super) const SPEED_ENDS_S: f64 = 4.0;

/// The error of a reference at the line that names the value.
fn at_its_line(file: &str, text: &str, error: &ReferenceError) -> BenchFileError {
    let mut headers = text.match_indices("[[speed.reference]]").map(|(offset, _)| offset);
    let from = headers.nth(error.number.saturating_sub(1)).unwrap_or(0);
    let key = error.key.rsplit(' ').next().unwrap_or(error.key);
    let offset = text[from..].find(key).map_or(from, |found| from + found);
    let help = "see [speed] in bench-configs/benches/zk-22fc-emulated.toml";
    ConfigError::at(file, text, offset, error.to_string(), help).into()
}

const PORTS: &str = "emulator, sim:, sim:rtu, tcp:HOST:PORT or the path of a serial port";

#[cfg(test)]
mod tests;
