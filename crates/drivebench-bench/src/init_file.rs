//! A bench file from a drive profile, a nameplate and the values read back from the drive: every limit with its reason. Pure.
//!
//! ```text
//! profile, nameplate, Readback -> purpose of the drive -> limits.rs -> sequence.rs (fitted, planned)
//!                                                         page.rs -> text -> BenchFile::parse (the text is valid)
//! ```

mod limits;
mod page;
mod sequence;

use serde::Serialize;
use thiserror::Error;

use super::bench_file::{
    BenchFile, BenchFileError, DriveSection, EmulatorSection, LimitsSection, LinkSection, Port,
    Protocol, RunsSection,
};
use super::check::LONGEST_WATCHDOG_S;
use super::limits::{MotorSection, POSITIVE};
use super::mechanics::{DriveFacts, LoadSection, SupplySection};
use super::plan::Plan;
use drivebench_link::offer::{self, Purpose};
use drivebench_link::{DriveProfile, StatedMotor};
use drivebench_model::excitation::ExcitationError;

/// Values that the drive reported; nothing is written to it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Readback {
    /// Nothing was read.
    pub is_offline: bool,
    /// Identity of the drive.
    pub who: String,
    pub current_limit_a: Option<f64>,
    pub voltage_limit_v: Option<f64>,
    /// At rest.
    pub bus_v: Option<f64>,
    /// 0: it is off.
    pub watchdog_s: Option<f64>,
    pub motor: Option<StatedMotor>,
}

#[derive(Clone, Debug)]
pub struct InitRequest<'a> {
    /// As it will be wired: with the baud rate and the unit of this line.
    pub profile: &'a DriveProfile,
    /// How the bench file names the profile.
    pub drive: &'a str,
    pub port: &'a str,
    /// Why this name of the port; empty where it is the one that was given.
    pub port_reason: &'a str,
    pub motor: &'a MotorSection,
    pub motor_file: &'a str,
    pub readback: Readback,
}

/// A value of the file with its reason.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reasoned {
    /// As in the bench file: `limits.current_a`.
    pub key: String,
    /// Null: left out.
    pub value: Option<f64>,
    pub reason: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum InitUse {
    Voltages,
    Currents,
    /// A speed loop, and no sequence of voltages.
    SpeedLoop,
}

#[derive(Clone, Debug)]
pub struct InitFile {
    pub bench: BenchFile,
    pub text: String,
    pub purpose: InitUse,
    pub reasons: Vec<Reasoned>,
    pub remarks: Vec<String>,
    /// The plan of the sequence; none while the motor is not known.
    pub plan: Option<Plan>,
}

#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{reason}")]
pub struct InitError {
    pub reason: String,
    pub help: String,
}

impl InitError {
    fn new(reason: impl Into<String>, help: impl Into<String>) -> Self {
        Self { reason: reason.into(), help: help.into() }
    }
}

impl From<BenchFileError> for InitError {
    fn from(error: BenchFileError) -> Self {
        Self::new(error.to_string(), error.help())
    }
}

impl From<ExcitationError> for InitError {
    fn from(error: ExcitationError) -> Self {
        Self::new(error.to_string(), error.help())
    }
}

impl Reasoned {
    fn new(key: &str, value: Option<f64>, reason: impl Into<String>) -> Self {
        Self { key: key.to_owned(), value, reason: reason.into() }
    }
}

impl InitFile {
    /// The commands that use it, in order; `file` names it.
    pub fn next(&self, file: &str) -> Vec<String> {
        let consent = match self.bench.port() {
            Port::Tcp(_) | Port::Serial(_) => "--hardware --headless",
            Port::Emulator | Port::Sim | Port::SimRtu => "--headless",
        };
        let mut next = Vec::new();
        if self.purpose != InitUse::SpeedLoop {
            // An unknown motor cannot be planned: `run` finds it first.
            if self.plan.is_some() {
                next.push(format!("drivebench plan {file}"));
            }
            next.push(format!("drivebench run {file} {consent}"));
        }
        if self.bench.speed.is_some() {
            next.push(format!("drivebench speed {file} {consent}"));
        }
        next
    }
}

/// Makes the file.
///
/// # Errors
/// The drive's signals are enough for no purpose, a nameplate value is not allowed, or even the smallest sequence exceeds a
/// limit.
pub fn init_file(request: &InitRequest<'_>) -> Result<InitFile, InitError> {
    let given = request;
    let motor = &completed(request.motor, request.readback.motor.unwrap_or_default());
    let request = &InitRequest { motor, ..given.clone() };
    let profile = request.profile;
    if let Some((key, value)) = motor.refused() {
        let file = request.motor_file;
        return Err(InitError::new(
            format!("{file}: {key} = {value} is not allowed (expected {POSITIVE})"),
            "see bench-configs/motors/zk-22fc.toml",
        ));
    }
    let voltages = offer::refusal(profile, Purpose::Voltages);
    let speed_loop = offer::refusal(profile, Purpose::SpeedLoop);
    let mut remarks = motor.contradictions();
    remarks.extend(offer::remarks(profile));
    let currents = offer::refusal(profile, Purpose::Currents);
    let purpose = match (&voltages, &speed_loop) {
        (None, _) => InitUse::Voltages,
        (Some(why), _) if currents.is_none() => {
            remarks.insert(0, format!("a sequence of currents, none of voltages: {why}"));
            InitUse::Currents
        }
        (Some(why), None) => {
            remarks.insert(0, format!("only `speed`: {why}"));
            InitUse::SpeedLoop
        }
        (Some(why), Some(also)) => {
            return Err(InitError::new(
                format!("{why}; and no speed loop: {also}"),
                "the profile states what the drive has: docs/drives.md shows how to complete it",
            ));
        }
    };
    if purpose == InitUse::SpeedLoop && motor.is_unknown() {
        let key = motor.missing().unwrap_or("motor.unknown = false");
        return Err(InitError::new(
            format!(
                "{}: {key} is left out, and {} takes no voltage with which the motor could be found",
                request.motor_file, profile.name
            ),
            "complete the nameplate, or find the motor with a drive that takes a voltage",
        ));
    }
    let mut reasons = Vec::new();
    let rate = limits::rate(request);
    reasons.push(rate.reason.clone());
    let mut bench = BenchFile {
        name: name(&motor.name, &profile.name),
        drive: DriveSection { profile: request.drive.to_owned() },
        link: LinkSection {
            port: request.port.to_owned(),
            protocol: protocol(profile, request.port),
            baud: Some(profile.link.baud),
            unit: profile.link.unit,
            rate_hz: rate.hz,
            deadline_ms: None,
        },
        drive_facts: DriveFacts::of(profile),
        emulator: EmulatorSection::default(),
        motor: motor.clone(),
        load: LoadSection::default(),
        supply: SupplySection::default(),
        limits: LimitsSection::default(),
        runs: RunsSection::default(),
        speed: None,
        currents: None,
        sequence: Vec::new(),
    };
    let limits = limits::reasons(request, &bench);
    limits::apply(&mut bench.limits, &limits);
    reasons.extend(limits);
    let fitted = sequence::fit(&mut bench, request, purpose)?;
    reasons.extend(fitted.reasons);
    remarks.extend(rate.remarks);
    remarks.extend(unproven_watchdog(request));
    remarks.extend(fitted.remarks);
    let plan = fitted.plan;
    let text = page::text(given, &bench, purpose, &reasons, &remarks, plan.as_ref());
    let read = BenchFile::parse("the new bench file", &text)?;
    read.check_speed("the new bench file", &text)?;
    Ok(InitFile { bench: read, text, purpose, reasons, remarks, plan })
}

/// The nameplate with what it leaves out and the drive states; of an unknown motor only the rated values are used.
fn completed(given: &MotorSection, stated: StatedMotor) -> MotorSection {
    let stated = if given.unknown { StatedMotor::default() } else { stated };
    MotorSection {
        resistance_ohm: given.resistance_ohm.or(stated.resistance_ohm),
        inductance_h: given.inductance_h.or(stated.inductance_h),
        back_emf_v_s_per_rad: given.back_emf_v_s_per_rad.or(stated.back_emf_v_s_per_rad),
        ..given.clone()
    }
}

/// A remark where the proof of the watchdog will fail.
fn unproven_watchdog(request: &InitRequest<'_>) -> Option<String> {
    let map = request.profile.registers.as_ref();
    let set_s = map.and_then(|map| map.watchdog.set_s());
    let delivered_s = request.profile.watchdog.default_ms.map(|ms| 1e-3 * ms);
    let time_s = set_s.or(request.readback.watchdog_s).or(delivered_s);
    let found = match time_s {
        Some(time_s) if time_s > 0.0 && time_s <= LONGEST_WATCHDOG_S => return None,
        Some(time_s) if time_s > 0.0 => format!("is {time_s} s, more than {LONGEST_WATCHDOG_S} s"),
        Some(_) => "is off".to_owned(),
        None => "is not known".to_owned(),
    };
    Some(format!(
        "the time of the drive's watchdog {found}: set it at the drive, or nothing is energised without --waive-watchdog, which is recorded"
    ))
}

/// Over TCP there is no RTU, and over a serial port no TCP; the registers are the same.
fn protocol(profile: &DriveProfile, port: &str) -> Protocol {
    match (profile.link.protocol, Port::parse(port)) {
        (own, _) if !own.is_modbus() => own,
        (Protocol::ModbusRtuOverTcp, Some(Port::Tcp(_) | Port::Emulator | Port::Sim)) => {
            Protocol::ModbusRtuOverTcp
        }
        (_, Some(Port::Tcp(_))) | (Protocol::ModbusTcp, Some(Port::Emulator | Port::Sim)) => {
            Protocol::ModbusTcp
        }
        _ => Protocol::ModbusRtu,
    }
}

/// Begins the names of run folders.
fn name(motor: &str, drive: &str) -> String {
    let text = format!("{motor}-{drive}").to_ascii_lowercase();
    let parts = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|part| !part.is_empty());
    parts.collect::<Vec<_>>().join("-")
}

#[cfg(test)]
mod tests;
