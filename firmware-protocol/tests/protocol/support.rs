//! A drive's registers for the tests, and the freshness check of generated files.

use std::path::PathBuf;

use firmware_protocol::modbus::{Exception, RegisterBank, RtuReceiver, respond, rtu, tcp};
use firmware_protocol::registers::{
    self, CAPTURE_CONTROL, CAPTURE_STATE, COMMAND_ADDRESS, COMMAND_WORDS, IDENTITY_ADDRESS,
    TELEMETRY_ADDRESS, WATCHDOG, WINDOW_CURRENT, WINDOW_SPEED, WINDOW_VOLTAGE,
};
use firmware_protocol::stream::{self, Decoder, Frame, FrameError};
use firmware_protocol::{
    CaptureControl, CaptureState, CommandBlock, Control, DeviceKind, DriveCommand, Fault, Identity,
    PROTOCOL_VERSION, State, Status, Telemetry,
};

pub(crate) const UNIT: u8 = 1;

/// The drive that the vectors tell of: memory behind the rules of the register table, a state machine that never
/// fails, and a shaft that never changes.
pub(crate) struct Bank {
    pub(crate) memory: Vec<u16>,
    pub(crate) command: CommandBlock,
    pub(crate) telemetry: Telemetry,
    pub(crate) identity: Identity,
    pub(crate) writes: usize,
    pub(crate) names: Vec<(u8, String)>,
}

impl Bank {
    pub(crate) fn new() -> Self {
        let mut memory = vec![0; 512];
        for register in [WINDOW_VOLTAGE, WINDOW_CURRENT, WINDOW_SPEED] {
            for copy in 0..register.repeat {
                memory[usize::from(register.address + copy * register.stride)] = 0x8000;
            }
        }
        let names = [(0, "drivebench"), (1, "DB-EMU"), (2, "1.2")];
        let mut command = CommandBlock::default();
        command.set(DriveCommand::new(telemetry().seq, Control::Voltage(24.0)));
        Self {
            memory,
            command,
            telemetry: telemetry(),
            identity: identity(),
            writes: 0,
            names: names.map(|(id, text)| (id, text.to_owned())).to_vec(),
        }
    }

    /// The telemetry; who reads the status has seen that a command was applied.
    pub(crate) fn sample(&mut self, reads_status: bool) -> Telemetry {
        let seen = self.telemetry;
        if reads_status {
            self.telemetry.status = seen.status.with(Status::COMMAND_APPLIED, false);
        }
        seen
    }

    pub(crate) fn supports(&self, control: Control) -> bool {
        let flag = 1 << (8 + control.code());
        control.code() < Control::Voltage(0.0).code() || self.identity.kind.has(flag)
    }

    pub(crate) fn apply(&mut self, command: DriveCommand) {
        let state = match command.control {
            Control::Disable | Control::ResetFault => State::Disabled,
            Control::Stop => State::Ready,
            Control::Voltage(_) | Control::Current(_) | Control::Speed(_) => State::Running,
        };
        self.telemetry.seq = command.seq;
        self.telemetry.status =
            Status::new(state).with(Status::COMMAND_APPLIED, true).with(Status::EMULATOR, true);
        if self.capture_state() == CaptureState::Armed {
            self.set_capture_state(CaptureState::Recording);
        }
    }

    pub(crate) fn control_capture(&mut self, control: CaptureControl) {
        CAPTURE_CONTROL.put(&mut self.memory, 0, control.code().into());
        self.set_capture_state(match control {
            CaptureControl::Abort => CaptureState::Empty,
            CaptureControl::Arm => CaptureState::Armed,
            CaptureControl::Start => CaptureState::Recording,
        });
    }

    pub(crate) fn capture_state(&self) -> CaptureState {
        let code = self.memory[usize::from(CAPTURE_STATE.address)];
        CaptureState::from_code(code).expect("only states are put there")
    }

    fn set_capture_state(&mut self, state: CaptureState) {
        CAPTURE_STATE.put(&mut self.memory, 0, state.code().into());
    }
}

impl RegisterBank for Bank {
    fn read(&mut self, address: u16, out: &mut [u16]) -> Result<(), Exception> {
        if !registers::check_read(address, out.len()) {
            return Err(Exception::IllegalAddress);
        }
        if address < COMMAND_ADDRESS {
            let block = self.sample(address == 0).to_registers();
            put(&mut self.memory, TELEMETRY_ADDRESS, &block);
        }
        put(&mut self.memory, COMMAND_ADDRESS, &self.command.registers());
        let identity = self.identity.to_registers();
        put(&mut self.memory, IDENTITY_ADDRESS, &identity);
        let at = usize::from(address);
        out.copy_from_slice(&self.memory[at..at + out.len()]);
        Ok(())
    }

    fn write(&mut self, address: u16, values: &[u16]) -> Result<(), Exception> {
        registers::check_write(address, values)?;
        let commands = usize::from(COMMAND_ADDRESS)..usize::from(COMMAND_ADDRESS) + COMMAND_WORDS;
        if commands.contains(&usize::from(address)) {
            let mut block = self.command;
            let command = block.write(address, values)?;
            if !self.supports(command.control) {
                return Err(Exception::IllegalValue);
            }
            self.command = block;
            self.apply(command);
        } else if address == CAPTURE_CONTROL.address {
            let control = CaptureControl::from_code(values[0]).ok_or(Exception::IllegalValue)?;
            self.control_capture(control);
        } else if address == WATCHDOG.address {
            self.identity.watchdog_ms = values[0];
        } else {
            put(&mut self.memory, address, values);
        }
        self.writes += 1;
        Ok(())
    }

    fn readable(&self, address: u16, quantity: usize) -> bool {
        registers::check_read(address, quantity)
    }

    fn identification(&self, object: u8) -> Option<&str> {
        let found = self.names.iter().find(|(id, _)| *id == object)?;
        Some(&found.1)
    }
}

fn put(memory: &mut [u16], address: u16, values: &[u16]) {
    let at = usize::from(address);
    memory[at..at + values.len()].copy_from_slice(values);
}

pub(crate) fn telemetry() -> Telemetry {
    Telemetry {
        status: Status::new(State::Running)
            .with(Status::COMMAND_APPLIED, true)
            .with(Status::EMULATOR, true),
        fault: Fault::None,
        seq: 0x1234,
        time_us: 0x0102_0304,
        applied_us: 0x0102_0000,
        voltage_v: 24.0,
        current_a: -1.25,
        speed_rad_s: 60.5,
        angle_rad: -1234.5678,
        bus_v: 48.2,
        temperature_c: 31.4,
        voltage_cmd_v: 24.0,
        protocol_version: PROTOCOL_VERSION,
    }
}

pub(crate) fn identity() -> Identity {
    Identity {
        kind: DeviceKind(DeviceKind::EMULATOR | DeviceKind::VOLTAGE | DeviceKind::SPEED),
        serial_number: 0x0001_86A1,
        firmware_version: 0x0102,
        current_limit_a: 12.0,
        voltage_limit_v: 48.0,
        speed_limit_rad_s: 180.0,
        watchdog_ms: 200,
        pole_pairs: 0,
        rated_voltage_v: 42.0,
        rated_current_a: 6.5,
        rated_speed_rad_s: 104.72,
        control_period_us: 100,
        capture_period_us: 100,
        capture_length: 2000,
    }
}

pub(crate) fn rtu_frame(unit: u8, pdu: &[u8]) -> Vec<u8> {
    rtu::encode_frame(unit, pdu).to_vec()
}

pub(crate) fn tcp_frame(transaction: u16, unit: u8, pdu: &[u8]) -> Vec<u8> {
    tcp::encode_frame(transaction, unit, pdu).to_vec()
}

pub(crate) fn stream_frame(frame: &Frame) -> Vec<u8> {
    stream::encode(frame).to_vec()
}

/// Every frame, and every damage, in the bytes of a stream.
pub(crate) fn decode(bytes: &[u8]) -> Vec<Result<Frame, FrameError>> {
    let mut decoder = Decoder::new();
    bytes.iter().filter_map(|byte| decoder.push(*byte)).collect()
}

/// The response to a request, both without their frames.
pub(crate) fn response(bank: &mut impl RegisterBank, request: &[u8]) -> Vec<u8> {
    respond(bank, request).to_vec()
}

/// What a drive answers to everything found in `line`, with a silent gap after it if `gap`; a broadcast gets nothing.
pub(crate) fn serve(
    receiver: &mut RtuReceiver,
    bank: &mut Bank,
    line: &[u8],
    gap: bool,
) -> Vec<String> {
    let mut answers = Vec::new();
    let mut drain = |receiver: &mut RtuReceiver| {
        while let Some(request) = receiver.take_frame() {
            answers.push(hex(&request.answer(bank)));
        }
    };
    for &byte in line {
        receiver.push(byte);
        drain(receiver);
    }
    if gap {
        receiver.idle();
        drain(receiver);
    }
    answers
}

/// The text of a committed file of this crate.
pub(crate) fn committed(name: &str) -> String {
    std::fs::read_to_string(file(name)).expect("the vectors are committed")
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    let words: Vec<_> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    words.join(" ")
}

pub(crate) fn unhex(text: &str) -> Vec<u8> {
    text.split_whitespace()
        .map(|byte| u8::from_str_radix(byte, 16).expect("the vectors are hexadecimal bytes"))
        .collect()
}

/// A file of this crate.
pub(crate) fn file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// The committed file equals what the code says; `UPDATE_SPEC=1` writes it anew.
pub(crate) fn assert_fresh(name: &str, wanted: &str) {
    let path = file(name);
    if std::env::var_os("UPDATE_SPEC").is_some_and(|value| value == "1")
        && std::fs::read_to_string(&path).ok().as_deref() != Some(wanted)
    {
        std::fs::write(&path, wanted).expect("the crate's own folder can be written");
    }
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        found == wanted,
        "{name} is not what the code says; run UPDATE_SPEC=1 cargo test -p firmware-protocol"
    );
}
