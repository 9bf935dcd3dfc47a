//! End to end: hosts that are not ours, over real pseudo-terminals and sockets.

use std::fs::File;
use std::io::{Read, Write};
use std::net::TcpStream;

use firmware_protocol::modbus::rtu;
use firmware_protocol::registers::{COMMAND_WORDS, TELEMETRY_WORDS};
use firmware_protocol::{Control, DriveCommand, State, Telemetry};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::os::fd::AsFd;
use tokio_modbus::client::{Reader, Writer};
use tokio_modbus::{ExceptionCode, Slave, prelude};

use super::*;
use crate::session::HAND_OVER_S;

fn config(baud: u32) -> EmulatorConfig {
    let mut config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    config.line.baud = baud;
    // Under load the host of a test may be late.
    config.watchdog_ms = 5000;
    config
}

fn pty(link: Protocol, baud: u32) -> ServerHandle {
    spawn(config(baud), 1, link, Endpoint::temporary_pty()).unwrap()
}

fn network(link: Protocol) -> ServerHandle {
    spawn(config(0), 1, link, Endpoint::Tcp("127.0.0.1:0".parse().unwrap())).unwrap()
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}

fn wait_until(is: impl Fn() -> bool) {
    while !is() {
        thread::sleep(Duration::from_millis(1));
    }
}

fn open(server: &ServerHandle) -> File {
    File::options().read(true).write(true).open(server.address()).unwrap()
}

/// Bytes, with five seconds of silence between them at most, until `enough` are there.
fn receive(host: &mut File, enough: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut buffer = [0; 512];
    while bytes.len() < enough {
        let mut fds = [PollFd::new(host.as_fd(), PollFlags::POLLIN)];
        if poll(&mut fds, PollTimeout::from(5000_u16)).unwrap() == 0 {
            break;
        }
        let count = host.read(&mut buffer).unwrap();
        bytes.extend_from_slice(&buffer[..count]);
    }
    bytes
}

fn rtu_frame(pdu: &[u8]) -> Vec<u8> {
    rtu::encode_frame(UNIT, pdu).to_vec()
}

/// FC23: writes a command, reads the sixteen registers of the telemetry.
fn exchange_pdu(command: DriveCommand) -> Vec<u8> {
    let mut pdu = vec![23, 0, 0, 0, 16, 0, 32, 0, 4, 8];
    let words: [u16; COMMAND_WORDS] = command.to_registers();
    pdu.extend(words.iter().flat_map(|word| word.to_be_bytes()));
    pdu
}

fn telemetry(frame: &[u8]) -> Telemetry {
    assert_eq!(frame.len(), 5 + 2 * TELEMETRY_WORDS, "{frame:02x?}");
    assert_eq!(rtu::crc16(frame), 0);
    let mut block = [0; TELEMETRY_WORDS];
    for (slot, pair) in block.iter_mut().zip(frame[3..35].chunks_exact(2)) {
        *slot = u16::from_be_bytes([pair[0], pair[1]]);
    }
    Telemetry::from_registers(&block)
}

fn volts(seq: u16, volts: f64) -> DriveCommand {
    DriveCommand::new(seq, Control::Voltage(volts))
}

fn exchange(host: &mut File, command: DriveCommand) -> Telemetry {
    host.write_all(&rtu_frame(&exchange_pdu(command))).unwrap();
    telemetry(&receive(host, 37))
}

#[test]
fn an_exchange_takes_at_least_its_wire_time() {
    let server = pty(Protocol::ModbusRtu, 115_200);
    let address = server.address().to_owned();
    let ready = format!("ready modbus-rtu {address} unit=1 baud=115200 profile=own");
    assert_eq!(server.ready_line(), ready);
    let mut host = open(&server);
    // 21 + 37 characters of ten bits, the gap before the answer and the turnaround.
    let wire_s = 58.0 * 10.0 / 115_200.0 + 0.001_75 + 0.000_5;
    let mut drive_times = Vec::new();
    for seq in 0..20 {
        let start = now();
        let telemetry = exchange(&mut host, volts(seq, 12.0));
        let took = start.elapsed().as_secs_f64();
        assert!(took >= wire_s, "{took} s");
        assert_eq!(telemetry.seq, seq);
        assert_eq!(telemetry.time_us, telemetry.applied_us);
        drive_times.push(telemetry.applied_us);
    }
    // The drive's own clock says the same: one cycle has two gaps.
    for pair in drive_times.windows(2) {
        assert!(f64::from(pair[1] - pair[0]) * 1e-6 >= wire_s + 0.001_75 - 2.0 * 50e-6);
    }
    assert_eq!(server.answers(), 20);
    server.join().unwrap();
    assert!(std::fs::symlink_metadata(address).is_err(), "cleaned up");
}

#[test]
fn a_second_session_works_and_gets_no_stale_bytes() {
    let server = pty(Protocol::ModbusRtu, 0);
    let mut first = open(&server);
    exchange(&mut first, volts(1, 6.0));
    // A request whose answer nobody reads.
    first.write_all(&rtu_frame(&exchange_pdu(volts(2, 6.0)))).unwrap();
    wait_until(|| server.answers() >= 2);
    drop(first);
    for session in 2..5_u16 {
        wait_until(|| server.sessions() >= session.into());
        let mut host = open(&server);
        assert_eq!(exchange(&mut host, volts(100 + session, 6.0)).seq, 100 + session);
        assert_eq!(receive_now(&mut host), 0, "nothing but the answer");
    }
}

fn receive_now(host: &mut File) -> usize {
    let mut fds = [PollFd::new(host.as_fd(), PollFlags::POLLIN)];
    if poll(&mut fds, PollTimeout::from(30_u16)).unwrap() == 0 {
        return 0;
    }
    host.read(&mut [0; 512]).unwrap()
}

#[test]
fn a_command_written_just_before_the_close_still_counts() {
    let server = pty(Protocol::ModbusRtu, 115_200);
    let mut host = open(&server);
    exchange(&mut host, volts(1, 24.0));
    host.write_all(&rtu_frame(&exchange_pdu(DriveCommand::new(2, Control::Stop)))).unwrap();
    drop(host);
    wait_until(|| server.sessions() >= 2);
    let mut host = open(&server);
    host.write_all(&rtu_frame(&[3, 0, 0, 0, 16])).unwrap();
    let telemetry = telemetry(&receive(&mut host, 37));
    assert_eq!(telemetry.seq, 2);
    assert_eq!(telemetry.status.state(), Some(State::Ready));
}

async fn connected(server: &ServerHandle) -> tokio_modbus::client::Context {
    prelude::tcp::connect_slave(server.address().parse().unwrap(), Slave(1)).await.unwrap()
}

#[test]
fn of_several_tcp_hosts_one_commands_and_all_read() {
    let server = network(Protocol::ModbusTcp);
    let _mute: Vec<_> = (0..3).map(|_| TcpStream::connect(server.address()).unwrap()).collect();
    let runtime = runtime();
    let within = Duration::from_secs(2);
    runtime.block_on(async {
        let (mut first, mut second) = (connected(&server).await, connected(&server).await);
        let [one, two] = [5, 6].map(|seq| volts(seq, 1.0).to_registers());
        let written = tokio::time::timeout(within, first.write_multiple_registers(32, &one)).await;
        written.unwrap().unwrap().unwrap();
        // A reader is served beside it; a second writer is refused.
        let words = second.read_holding_registers(0, 16).await.unwrap().unwrap();
        assert_eq!(words[2], 5);
        let refused = second.write_multiple_registers(32, &two).await.unwrap();
        assert_eq!(refused, Err(ExceptionCode::ServerDeviceBusy));
        // It is gone: the other one takes over.
        drop(first);
        tokio::time::sleep(Duration::from_millis(50)).await;
        second.write_multiple_registers(32, &two).await.unwrap().unwrap();
        assert_eq!(second.read_holding_registers(0, 16).await.unwrap().unwrap()[2], 6);
    });
}

#[test]
fn the_command_passes_on_where_its_holder_is_silent_or_gone() {
    let mut commander = Commander::default();
    assert!(commander.takes(1, 0.0) && commander.takes(1, 1.0));
    assert!(!commander.takes(2, 1.0 + 0.99 * HAND_OVER_S));
    assert!(commander.takes(2, 1.0 + 1.01 * HAND_OVER_S));
    assert!(!commander.takes(1, 2.0 + HAND_OVER_S));
    commander.leaves(1);
    assert!(!commander.takes(1, 2.0 + HAND_OVER_S));
    commander.leaves(2);
    assert!(commander.takes(1, 2.0 + HAND_OVER_S));
}

#[test]
fn impossible_endpoints_are_refused_with_the_reason() {
    const NOWHERE: &str = "/nonexistent/folder/drive";
    let (anywhere, nowhere) = (Endpoint::temporary_pty(), Endpoint::Pty(NOWHERE.into()));
    for (link, endpoint, part) in [
        (Protocol::ModbusTcp, anywhere, "modbus-tcp does not run over"),
        (Protocol::ModbusRtu, nowhere, NOWHERE),
    ] {
        let error = spawn(config(0), 1, link, endpoint).err().unwrap();
        assert!(error.to_string().contains(part), "{error}");
    }
}
