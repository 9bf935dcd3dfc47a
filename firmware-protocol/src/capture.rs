//! Burst capture: voltage, current and speed that the drive itself samples, far faster than a link carries.
//!
//! Arm (or start), wait for `Complete`, then read windows: one FC23 writes the window index and reads count and window.

use crate::registers as r;

/// What the host asks of the capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CaptureControl {
    /// Drop what is recorded or armed.
    Abort,
    /// Start when the next command is applied.
    Arm,
    /// Start now.
    Start,
}

impl CaptureControl {
    /// Code in the register.
    pub const fn code(self) -> u16 {
        match self {
            Self::Abort => 0,
            Self::Arm => 1,
            Self::Start => 2,
        }
    }

    /// The request of a code, if there is one.
    pub const fn from_code(code: u16) -> Option<Self> {
        match code {
            0 => Some(Self::Abort),
            1 => Some(Self::Arm),
            2 => Some(Self::Start),
            _ => None,
        }
    }
}

/// Where the capture is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CaptureState {
    /// Nothing recorded.
    #[default]
    Empty,
    /// Waits for the next command.
    Armed,
    /// Records.
    Recording,
    /// All samples are there.
    Complete,
}

impl CaptureState {
    /// Code in the register.
    pub const fn code(self) -> u16 {
        match self {
            Self::Empty => 0,
            Self::Armed => 1,
            Self::Recording => 2,
            Self::Complete => 3,
        }
    }

    /// The state of a code, if there is one.
    pub const fn from_code(code: u16) -> Option<Self> {
        match code {
            0 => Some(Self::Empty),
            1 => Some(Self::Armed),
            2 => Some(Self::Recording),
            3 => Some(Self::Complete),
            _ => None,
        }
    }
}

/// One captured instant; sample `k` was taken at `capture time + k * capture period`. Its voltage is the mean over the
/// period that ends there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CaptureSample {
    /// Armature voltage, V.
    pub voltage_v: f64,
    /// Armature current, A.
    pub current_a: f64,
    /// Shaft speed, rad/s.
    pub speed_rad_s: f64,
}

impl CaptureSample {
    /// Registers of one sample in the window.
    pub const WORDS: usize = r::WINDOW_VOLTAGE.stride as usize;

    /// The sample as it stands in the window.
    pub fn to_registers(&self) -> [u16; Self::WORDS] {
        let mut block = [0; Self::WORDS];
        let base = r::WINDOW_VOLTAGE.address;
        for (register, value) in self.fields() {
            register.put(&mut block, base, register.encode(value));
        }
        block
    }

    /// Reads a sample of the window.
    pub fn from_registers(block: &[u16; Self::WORDS]) -> Self {
        let value = |register: &r::Register| {
            register.decode(register.get(block, r::WINDOW_VOLTAGE.address))
        };
        Self {
            voltage_v: value(&r::WINDOW_VOLTAGE),
            current_a: value(&r::WINDOW_CURRENT),
            speed_rad_s: value(&r::WINDOW_SPEED),
        }
    }

    pub(crate) fn fields(&self) -> [(r::Register, f64); 3] {
        [
            (r::WINDOW_VOLTAGE, self.voltage_v),
            (r::WINDOW_CURRENT, self.current_a),
            (r::WINDOW_SPEED, self.speed_rad_s),
        ]
    }
}
