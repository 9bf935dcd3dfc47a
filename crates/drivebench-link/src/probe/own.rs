//! Our own drive: its identity block and one telemetry, over Modbus or the stream.

use std::sync::atomic::AtomicBool;

use firmware_protocol::registers::{REGISTERS, TELEMETRY_ADDRESS, TELEMETRY_WORDS};
use firmware_protocol::{State, Telemetry};

use super::report::{ProbeReport, ProbedCheck, ProbedSignal, ProbedState};
use crate::line_bus::Framed;
use crate::link::{DriveLink, Result};
use crate::link_core::retried;
use crate::modbus::{RawClient, read_batch};
use crate::own::{OwnLink, TELEMETRY};
use crate::profile::DriveProfile;
use crate::register_map::{Quantity, Unit, confirms, expected_at_rest};

pub(super) fn probe(client: &mut RawClient, profile: &DriveProfile) -> Result<ProbeReport> {
    let mut report = ProbeReport::of(profile);
    let identity = retried(|| client.identify())?;
    report.checks.push(ProbedCheck {
        what: "the identity block of drivebench's register map has to stand at register 64"
            .to_owned(),
        passed: identity.is_some(),
        found: if identity.is_some() { "it" } else { "something else" }.to_owned(),
    });
    if identity.is_some() {
        let mut batch = read_batch(client, &[TELEMETRY], 1, &AtomicBool::new(false));
        let block = batch.reads.pop().map_or_else(|| Ok(Vec::new()), |r| r.values)?;
        if let Ok(block) = <[u16; TELEMETRY_WORDS]>::try_from(block.as_slice()) {
            let limit_a = identity.as_ref().and_then(|found| found.current_limit_a);
            take(&mut report, &block, limit_a, true);
        }
    }
    report.watchdog_s = identity.as_ref().and_then(|found| found.watchdog_s);
    report.identity = identity;
    report.judge();
    Ok(report)
}

pub(super) fn probe_stream(
    link: &mut OwnLink<Framed>,
    profile: &DriveProfile,
) -> Result<ProbeReport> {
    let mut report = ProbeReport::of(profile);
    let identity = link.identify()?;
    let block = link.telemetry()?.value.to_registers();
    take(&mut report, &block, identity.current_limit_a, false);
    report.watchdog_s = identity.watchdog_s;
    report.identity = Some(identity);
    report.judge();
    Ok(report)
}

/// Signals and states of a telemetry. `has_raw`: it travelled as registers.
fn take(
    report: &mut ProbeReport,
    block: &[u16; TELEMETRY_WORDS],
    current_limit_a: Option<f64>,
    has_raw: bool,
) {
    let end = usize::from(TELEMETRY_ADDRESS) + TELEMETRY_WORDS;
    let rows = REGISTERS
        .iter()
        .filter(|row| (usize::from(TELEMETRY_ADDRESS)..end).contains(&usize::from(row.address)));
    for row in rows {
        let value = row.decode(row.get(block, TELEMETRY_ADDRESS));
        let known = value.is_finite().then_some(value);
        let expected = meaning(row.name)
            .and_then(|(quantity, unit)| expected_at_rest(quantity, unit, current_limit_a));
        let within = |[low, high]: [f64; 2]| known.is_some_and(|v| (low..=high).contains(&v));
        let from = usize::from(row.address - TELEMETRY_ADDRESS);
        let raw = block.get(from..from + usize::from(row.kind.words()));
        report.signals.push(ProbedSignal {
            name: row.name.to_owned(),
            unit: row.unit,
            table: if has_raw { "holding" } else { "stream" },
            address: row.address,
            raw: raw.filter(|_| has_raw).map(<[u16]>::to_vec),
            value: known,
            missing: known.is_none().then(|| "the drive reports it as not available".to_owned()),
            plausible: expected.filter(|_| known.is_some()).map(within),
            expected,
            confirms: expected.zip(known).is_some_and(|(range, value)| confirms(range, value)),
            candidates: Vec::new(),
            quantity: (row.name == "bus_voltage").then_some(Quantity::BusVoltage),
        });
    }
    let state = Telemetry::from_registers(block).status.state();
    for (name, of) in [("running", State::Running), ("fault", State::Fault)] {
        report
            .states
            .push(ProbedState { name: name.to_owned(), holds: state.map(|state| state == of) });
    }
}

fn meaning(name: &str) -> Option<(Quantity, Unit)> {
    Some(match name {
        "voltage" | "voltage_command" => (Quantity::Voltage, Unit::V),
        "current" => (Quantity::Current, Unit::A),
        "speed" => (Quantity::ShaftSpeed, Unit::RadS),
        "bus_voltage" => (Quantity::BusVoltage, Unit::V),
        "temperature" => (Quantity::Temperature, Unit::Celsius),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_that_is_judged_is_a_row_of_the_table() {
        assert_eq!(REGISTERS.iter().filter(|row| meaning(row.name).is_some()).count(), 6);
        assert!(REGISTERS.iter().any(|row| row.name == "bus_voltage"));
    }
}
