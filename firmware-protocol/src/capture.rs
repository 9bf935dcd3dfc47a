//! Burst capture: voltage, current and speed that the drive itself samples, far faster than a link carries.
//!
//! Arm (or start), wait for `Complete`, then read windows: one FC23 writes the window index and reads count and window.

use crate::codes::coded;
use crate::registers as r;

coded! {
    /// Command to the capture.
    CaptureControl: u16 {
        /// Drop what is recorded or armed.
        Abort = 0,
        /// Start when the next command is applied.
        Arm = 1,
        /// Start now.
        Start = 2,
    }
}

coded! {
    /// State of the capture.
    #[derive(Default)]
    CaptureState: u16 {
        /// Nothing recorded.
        #[default]
        Empty = 0,
        /// Waits for the next command.
        Armed = 1,
        /// Records.
        Recording = 2,
        /// All samples are there.
        Complete = 3,
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
