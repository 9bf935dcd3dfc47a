//! Read-only check of a profile on its drive: identity, reading of every mapped signal, plausibility for a drive at rest, and other
//! decodings of the registers. Function codes 03, 04, 08 and 43, and requests of the stream without side effects.
//!
//! ```text
//! RawClient -> mapped.rs (a profile's registers) --> register_map::Picture -> what fits, other decodings --.
//!           '> own.rs (our own map) -------------> telemetry, identity -------------------------------------> ProbeReport
//! OwnStream -^                                                                                    report.rs
//! ```

mod mapped;
mod own;
mod report;

pub use report::{ProbeFinding, ProbeReport, ProbeVerdict, ProbedCheck, ProbedSignal, ProbedState};

use super::cell_bus::CellBus;
use super::link::Result;
use super::modbus::RawClient;
use super::open::OwnStream;
use super::profile::DriveProfile;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeDepth {
    /// Only the signals of the profile, enough to check whether it is that of this drive.
    Readings,
    /// Also the neighbouring registers of implausible signals, and the device identification.
    Whole,
}

/// Looks at a drive over Modbus with a profile.
///
/// # Errors
/// Nothing answers, or the port is gone. A drive that refuses registers, or is another one, is no error but the verdict.
pub fn probe(
    client: &mut RawClient,
    profile: &DriveProfile,
    depth: ProbeDepth,
) -> Result<ProbeReport> {
    let mut report = match &profile.registers {
        Some(map) => mapped::probe(client, profile, map, depth)?,
        None => own::probe(client, profile)?,
    };
    if depth == ProbeDepth::Whole {
        report.names = client.names()?;
        report.answers_function_8 = client.sends_back()?;
    }
    report.counters = Some(client.counters());
    Ok(report)
}

/// Looks at a drive of another language than Modbus with its profile.
///
/// # Errors
/// As [`probe`].
pub fn probe_cells(mut bus: &mut dyn CellBus, profile: &DriveProfile) -> Result<ProbeReport> {
    match &profile.registers {
        Some(map) => mapped::probe(&mut bus, profile, map, ProbeDepth::Readings),
        None => Ok(ProbeReport::of(profile)),
    }
}

/// Looks at our own drive over its stream.
///
/// # Errors
/// As [`probe`].
pub fn probe_stream(stream: &mut OwnStream, profile: &DriveProfile) -> Result<ProbeReport> {
    own::probe_stream(&mut stream.0, profile)
}
