//! Register map of the drive: access and ranges are those of the protocol's table.

use firmware_protocol::modbus::{Exception, RegisterBank};
use firmware_protocol::registers::{
    self as r, CAPTURE_ADDRESS, CAPTURE_WINDOW_SAMPLES, CAPTURE_WORDS, COMMAND_ADDRESS,
    IDENTITY_ADDRESS, TELEMETRY_ADDRESS, TELEMETRY_WORDS, check_read, check_write,
};
use firmware_protocol::{CaptureControl, CaptureSample};

use super::SoftDrive;
use crate::fault::FaultKind;

const VENDOR: &str = "drivebench";
const PRODUCT_CODE: &str = "soft-drive";
const PRODUCT_NAME: &str = "drivebench software drive";

impl RegisterBank for SoftDrive {
    fn read(&mut self, address: u16, out: &mut [u16]) -> Result<(), Exception> {
        if !check_read(address, out.len()) {
            return Err(Exception::IllegalAddress);
        }
        if usize::from(address) < usize::from(TELEMETRY_ADDRESS) + TELEMETRY_WORDS {
            let unread = self.applied_unread;
            copy(TELEMETRY_ADDRESS, &self.telemetry().to_registers(), address, out);
            // Reading the status word clears its mark of an applied command.
            self.applied_unread = unread && address > r::STATUS.address;
        }
        copy(COMMAND_ADDRESS, &self.command_block.registers(), address, out);
        copy(IDENTITY_ADDRESS, &self.identity().to_registers(), address, out);
        if self.has(FaultKind::OtherVersion) {
            // A protocol version that does not exist yet.
            let version = &[(firmware_protocol::PROTOCOL_VERSION + 8)];
            copy(r::IDENTITY_VERSION.address, version, address, out);
        }
        if usize::from(address) + out.len() > usize::from(CAPTURE_ADDRESS) {
            copy(CAPTURE_ADDRESS, &self.capture_registers(), address, out);
        }
        Ok(())
    }

    fn write(&mut self, address: u16, values: &[u16]) -> Result<(), Exception> {
        check_write(address, values)?;
        let first = values.first().copied().unwrap_or_default();
        // The table's writable registers other than the command block have no writable neighbours.
        if address == r::WATCHDOG.address {
            if !self.set_watchdog_ms(first) {
                return Err(Exception::IllegalValue);
            }
        } else if address == r::CAPTURE_CONTROL.address {
            let control = CaptureControl::from_code(first).ok_or(Exception::IllegalValue)?;
            self.capture_control = first;
            self.control_capture(control);
        } else if address == r::WINDOW_INDEX.address {
            self.window_index = first;
        } else {
            let mut block = self.command_block;
            let command = block.write(address, values)?;
            self.step();
            self.command_block = block;
            self.apply(command);
        }
        Ok(())
    }

    fn readable(&self, address: u16, quantity: usize) -> bool {
        check_read(address, quantity)
    }

    fn identification(&self, object: u8) -> Option<&str> {
        match object {
            0 => Some(VENDOR),
            1 => Some(PRODUCT_CODE),
            2 => Some(env!("CARGO_PKG_VERSION")),
            4 => Some(PRODUCT_NAME),
            _ => None,
        }
    }
}

impl SoftDrive {
    pub(super) fn control_capture(&mut self, control: CaptureControl) {
        self.capture.control(control, self.tick);
    }

    fn capture_registers(&self) -> [u16; CAPTURE_WORDS] {
        let mut block = [0; CAPTURE_WORDS];
        let index = self.window_index;
        let window = self.capture.samples(index, usize::from(CAPTURE_WINDOW_SAMPLES));
        let state = self.capture.state().code();
        let counts = [
            (r::CAPTURE_CONTROL, self.capture_control.into()),
            (r::CAPTURE_STATE, state.into()),
            (r::CAPTURE_COUNT, self.capture.count().into()),
            (r::CAPTURE_TIME, self.micros(self.capture.first_tick()).into()),
            (r::WINDOW_INDEX, index.into()),
            (r::WINDOW_COUNT, i64::try_from(window.len()).unwrap_or(0)),
        ];
        for (register, raw) in counts {
            register.put(&mut block, CAPTURE_ADDRESS, raw);
        }
        let start = usize::from(r::WINDOW_VOLTAGE.address - CAPTURE_ADDRESS);
        let slots = block[start..].chunks_exact_mut(CaptureSample::WORDS);
        let missing =
            CaptureSample { voltage_v: f64::NAN, current_a: f64::NAN, speed_rad_s: f64::NAN };
        for (slot, sample) in slots.zip(window.iter().chain(std::iter::repeat(&missing))) {
            slot.copy_from_slice(&sample.to_registers());
        }
        block
    }
}

/// Copies what a block at `base` has of the range that begins at `address`.
fn copy(base: u16, block: &[u16], address: u16, out: &mut [u16]) {
    for (offset, slot) in out.iter_mut().enumerate() {
        let at = (usize::from(address) + offset).checked_sub(usize::from(base));
        if let Some(word) = at.and_then(|at| block.get(at)) {
            *slot = *word;
        }
    }
}
