//! The command block: control word, set-point and sequence number.

use crate::registers as r;
use crate::registers::{COMMAND_ADDRESS, COMMAND_WORDS, WriteError, check_write};

/// The commanded output. Everything but the three set-points means zero output.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Control {
    /// Output off, state `Disabled`.
    #[default]
    Disable,
    /// Zero output at once, state `Ready`.
    Stop,
    /// Clears a latched fault whose cause is gone; output off, state `Disabled`, as `Disable` if there is no fault.
    ResetFault,
    /// Armature voltage, V; state `Running`.
    Voltage(f64),
    /// Armature current, A; state `Running`.
    Current(f64),
    /// Shaft speed, rad/s; state `Running`.
    Speed(f64),
}

impl Control {
    /// The control word.
    pub const fn code(self) -> u16 {
        match self {
            Self::Disable => 0,
            Self::Stop => 1,
            Self::ResetFault => 2,
            Self::Voltage(_) => 3,
            Self::Current(_) => 4,
            Self::Speed(_) => 5,
        }
    }

    /// The set-point in its unit; 0 where there is none.
    pub const fn set_point(self) -> f64 {
        match self {
            Self::Disable | Self::Stop | Self::ResetFault => 0.0,
            Self::Voltage(value) | Self::Current(value) | Self::Speed(value) => value,
        }
    }
}

/// One command.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DriveCommand {
    /// Number that the drive echoes once the command is applied.
    pub seq: u16,
    /// The commanded output.
    pub control: Control,
}

impl DriveCommand {
    /// A command with this number.
    pub const fn new(seq: u16, control: Control) -> Self {
        Self { seq, control }
    }

    /// The block as written to [`COMMAND_ADDRESS`]. A set-point that is NaN becomes a block that the drive refuses.
    pub fn to_registers(&self) -> [u16; COMMAND_WORDS] {
        let mut block = [0; COMMAND_WORDS];
        r::SEQUENCE.put(&mut block, COMMAND_ADDRESS, self.seq.into());
        r::CONTROL.put(&mut block, COMMAND_ADDRESS, self.control.code().into());
        let set_point = r::SET_POINT.encode(self.control.set_point());
        r::SET_POINT.put(&mut block, COMMAND_ADDRESS, set_point);
        block
    }

    /// Reads the block. `None` if it means nothing (a control word outside 0..=5, a set-point that is the code for "not
    /// available"): the drive answers exception 03 and leaves everything as it is.
    pub fn from_registers(block: &[u16; COMMAND_WORDS]) -> Option<Self> {
        let [seq, control, ..] = *block;
        let set_point = r::SET_POINT.decode(r::SET_POINT.get(block, COMMAND_ADDRESS));
        if set_point.is_nan() {
            return None;
        }
        let control = match control {
            0 => Control::Disable,
            1 => Control::Stop,
            2 => Control::ResetFault,
            3 => Control::Voltage(set_point),
            4 => Control::Current(set_point),
            5 => Control::Speed(set_point),
            _ => return None,
        };
        Some(Self { seq, control })
    }
}

/// The command block as a drive keeps it. A write may cover a part of it; the rest then counts as last written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CommandBlock {
    words: [u16; COMMAND_WORDS],
}

impl CommandBlock {
    /// Takes a write and gives the command that it makes; on error the block stays as it was.
    ///
    /// # Errors
    /// An address outside the block, half a set-point, a control word or set-point out of range.
    pub fn write(&mut self, address: u16, values: &[u16]) -> Result<DriveCommand, WriteError> {
        check_write(address, values)?;
        let at = usize::from(address.checked_sub(COMMAND_ADDRESS).ok_or(WriteError::NoRegister)?);
        let mut next = *self;
        next.words
            .get_mut(at..at + values.len())
            .ok_or(WriteError::NoRegister)?
            .copy_from_slice(values);
        // A voltage must not become a speed because the control word alone was changed.
        let wrote_set_point = at + values.len() == COMMAND_WORDS;
        let control_changed = r::CONTROL.get(&next.words, COMMAND_ADDRESS)
            != r::CONTROL.get(&self.words, COMMAND_ADDRESS);
        if control_changed && !wrote_set_point {
            next.forget_set_point();
        }
        let command = DriveCommand::from_registers(&next.words).ok_or(WriteError::Range)?;
        *self = next;
        self.forget_unless_energised(command.control);
        Ok(command)
    }

    /// Takes a whole command, as the stream carries it.
    pub fn set(&mut self, command: DriveCommand) {
        self.words = command.to_registers();
        self.forget_unless_energised(command.control);
    }

    /// To be called when the drive stops itself (watchdog, fault): an old set-point must not come back with a
    /// later write of the control word alone, nor an old control word with a later write of the set-point alone.
    pub fn forget(&mut self) {
        let [seq, ..] = self.words;
        self.words = DriveCommand::new(seq, Control::Disable).to_registers();
    }

    /// What the host reads back.
    pub const fn registers(&self) -> [u16; COMMAND_WORDS] {
        self.words
    }

    fn forget_unless_energised(&mut self, control: Control) {
        if matches!(control, Control::Disable | Control::Stop | Control::ResetFault) {
            self.forget_set_point();
        }
    }

    fn forget_set_point(&mut self) {
        r::SET_POINT.put(&mut self.words, COMMAND_ADDRESS, 0);
    }
}
