//! One contract for every link, against the software drive: in memory, over a pseudo-terminal and over TCP.

use std::time::Instant;

use drivebench::drive::{DriveLink, DriveProfile, LinkError, Protocol, Target, open};
use drivebench::emulator::{
    EmulatorConfig, Endpoint, Latency, MemoryLink, ServerHandle, SoftDrive, VirtualClock, spawn,
};
use drivebench::sample::{Channel, Command, Demand, DriveState};

/// The clock of the test; the links take it as their epoch.
#[expect(clippy::disallowed_methods, reason = "a real link runs in real time")]
fn now() -> Instant {
    Instant::now()
}

/// A drive without wire time, so that the test is about the contract and not about the line.
fn config(baud: u32) -> EmulatorConfig {
    let mut config = EmulatorConfig::embedded_default();
    config.line.baud = baud;
    config.line.turnaround_ms = if baud == 0 { 0.0 } else { 0.5 };
    config.watchdog_ms = 5000;
    config
}

fn served(kind: Protocol, endpoint: Endpoint, baud: u32) -> (ServerHandle, Box<dyn DriveLink>) {
    let over_tcp = matches!(endpoint, Endpoint::Tcp(_));
    let server = spawn(config(baud), 7, kind, endpoint).unwrap();
    let scheme = if over_tcp { "tcp:" } else { "" };
    let target: Target = format!("{scheme}{}", server.address()).parse().unwrap();
    let mut profile = DriveProfile::named("own").unwrap();
    profile.link.protocol = kind;
    profile.link.deadline_ms = Some(3000.0);
    profile.link.gap_us = (baud == 0).then_some(0.0);
    (server, open(&target, &profile, now()).unwrap())
}

fn any_port() -> Endpoint {
    Endpoint::Tcp(([127, 0, 0, 1], 0).into())
}

fn contract(link: &mut dyn DriveLink, mut tick: impl FnMut()) {
    let identity = link.identify().unwrap();
    assert!(identity.is_emulator);
    assert_eq!(identity.protocol_version, 1);
    assert_eq!(identity.serial_number, "7");
    assert_eq!(identity.watchdog_s, Some(5.0));
    assert_eq!(identity.current_limit_a, Some(11.4));
    let mut before_s = f64::NEG_INFINITY;
    // Across the end of the sixteen bits that travel.
    for seq in 65_530..65_550 {
        tick();
        let sample = link.exchange(Command { seq, demand: Demand::Voltage(12.0) }).unwrap();
        assert_eq!(sample.seq, Some(seq));
        let applied = sample.applied.unwrap();
        assert_eq!(applied.seq, seq);
        assert!(applied.time_s > before_s, "{seq}: {applied:?} {before_s}");
        assert!(applied.time_s <= sample.time_s + 1e-9);
        assert!(sample.time_s - applied.time_s < 0.01);
        assert_eq!(sample.state, Some(DriveState::Running));
        let command_v = sample.get(Channel::VoltageCmd).unwrap();
        assert!((command_v - 12.0).abs() < 0.01, "{command_v}");
        assert!(sample.get(Channel::Current).is_some() && sample.get(Channel::Speed).is_some());
        before_s = applied.time_s;
    }
    tick();
    link.stop().unwrap();
    tick();
    let rest = link.exchange(Command { seq: 70_000, demand: Demand::Disable }).unwrap();
    assert_ne!(rest.state, Some(DriveState::Running));
    assert_eq!(rest.get(Channel::VoltageCmd), Some(0.0));
    let statistics = link.statistics();
    assert!(statistics.balances());
    assert_eq!(statistics.lost(), 0, "{statistics:?}");
}

#[test]
fn in_memory() {
    let clock = VirtualClock::new();
    let drive = SoftDrive::new(&config(0), 7);
    let mut link = MemoryLink::new(drive, clock.clone(), Latency::default());
    let mut time_s = 0.0;
    contract(&mut link, || {
        time_s += 0.02;
        clock.set_time_s(time_s);
    });
}

#[test]
fn over_pseudo_terminals_and_tcp() {
    for (kind, endpoint, baud) in [
        (Protocol::ModbusRtu, Endpoint::temporary_pty(), 0),
        (Protocol::ModbusRtu, Endpoint::temporary_pty(), 115_200),
        (Protocol::Stream, Endpoint::temporary_pty(), 0),
        (Protocol::ModbusTcp, any_port(), 0),
        (Protocol::ModbusRtuOverTcp, any_port(), 0),
        (Protocol::Stream, any_port(), 0),
    ] {
        // Shown where the case fails.
        println!("{kind:?} over {endpoint:?}, {baud} baud");
        let (_server, mut link) = served(kind, endpoint, baud);
        contract(&mut *link, || ());
    }
}

#[test]
fn a_peer_that_vanishes_is_noticed_at_once_and_for_good() {
    for (kind, endpoint) in [
        (Protocol::ModbusRtu, Endpoint::temporary_pty()),
        (Protocol::ModbusTcp, any_port()),
        (Protocol::ModbusRtuOverTcp, any_port()),
        (Protocol::Stream, Endpoint::temporary_pty()),
        (Protocol::Stream, any_port()),
    ] {
        let name = format!("{kind:?} {endpoint:?}");
        let (server, mut link) = served(kind, endpoint, 0);
        let volts = |seq| Command { seq, demand: Demand::Voltage(1.0) };
        link.exchange(volts(1)).unwrap();
        server.join().unwrap();
        let start = now();
        for seq in 2..5 {
            let error = link.exchange(volts(seq)).unwrap_err();
            assert!(matches!(error, LinkError::Gone { .. }), "{name}: {error}");
        }
        assert!(!link.has_sent_command(), "{name}");
        assert!(matches!(link.stop(), Err(LinkError::Gone { .. })));
        // Its deadline is three seconds.
        assert!(start.elapsed().as_secs_f64() < 2.0, "{name}");
        let statistics = link.statistics();
        assert!(statistics.aborted <= 1 && statistics.balances(), "{name}");
    }
}
