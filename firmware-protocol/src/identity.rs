//! The identity block: who the drive is and what it limits itself to.

use crate::registers as r;
use crate::registers::{IDENTITY_ADDRESS, IDENTITY_WORDS, MAGIC, PROTOCOL_VERSION};
use crate::wire::{Sink, Source, Words, WordsMut};

/// What the device is and which control words it takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceKind(pub u16);

impl DeviceKind {
    /// The drive is software.
    pub const EMULATOR: u16 = 1;
    /// Takes voltage set-points.
    pub const VOLTAGE: u16 = 1 << (8 + 3);
    /// Takes current set-points.
    pub const CURRENT: u16 = 1 << (8 + 4);
    /// Takes speed set-points.
    pub const SPEED: u16 = 1 << (8 + 5);

    /// Whether a flag is set.
    pub const fn has(self, flag: u16) -> bool {
        self.0 & flag == flag
    }
}

/// Reason why a block is not the identity of a supported drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IdentityError {
    /// Another device, or another map: the first word is not [`MAGIC`].
    Magic(u16),
    /// A drive of another protocol version.
    Version(u16),
}

/// Who the drive is and what it limits itself to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Identity {
    /// What the device is and which control words it takes.
    pub kind: DeviceKind,
    /// Serial number.
    pub serial_number: u32,
    /// High byte major, low byte minor.
    pub firmware_version: u16,
    /// The drive limits the current to this magnitude, A.
    pub current_limit_a: f64,
    /// The drive limits the voltage to this magnitude, V.
    pub voltage_limit_v: f64,
    /// The drive trips above this magnitude, rad/s.
    pub speed_limit_rad_s: f64,
    /// Command silence after which the drive stops itself, ms.
    pub watchdog_ms: u16,
    /// Pole pairs; 0 for a brushed motor.
    pub pole_pairs: u16,
    /// Rated voltage of the motor, V.
    pub rated_voltage_v: f64,
    /// Rated current of the motor, A.
    pub rated_current_a: f64,
    /// Rated speed of the motor, rad/s.
    pub rated_speed_rad_s: f64,
    /// Period of the drive's control, microseconds.
    pub control_period_us: u16,
    /// Distance of captured samples, microseconds; 0: no capture.
    pub capture_period_us: u16,
    /// Samples that one capture holds.
    pub capture_length: u16,
}

impl Identity {
    /// The block as it stands at [`IDENTITY_ADDRESS`].
    pub fn to_registers(&self) -> [u16; IDENTITY_WORDS] {
        let mut block = [0; IDENTITY_WORDS];
        let base = IDENTITY_ADDRESS;
        let sink = &mut WordsMut { block: &mut block, base };
        sink.raw(&r::IDENTITY_MAGIC, MAGIC.into());
        sink.raw(&r::IDENTITY_VERSION, PROTOCOL_VERSION.into());
        sink.raw(&r::DEVICE_KIND, self.kind.0.into());
        sink.raw(&r::SERIAL_NUMBER, self.serial_number.into());
        sink.raw(&r::FIRMWARE_VERSION, self.firmware_version.into());
        sink.value(&r::CURRENT_LIMIT, self.current_limit_a);
        sink.value(&r::VOLTAGE_LIMIT, self.voltage_limit_v);
        sink.value(&r::SPEED_LIMIT, self.speed_limit_rad_s);
        sink.raw(&r::WATCHDOG, self.watchdog_ms.into());
        sink.raw(&r::POLE_PAIRS, self.pole_pairs.into());
        sink.value(&r::RATED_VOLTAGE, self.rated_voltage_v);
        sink.value(&r::RATED_CURRENT, self.rated_current_a);
        sink.value(&r::RATED_SPEED, self.rated_speed_rad_s);
        sink.raw(&r::CONTROL_PERIOD, self.control_period_us.into());
        sink.raw(&r::CAPTURE_PERIOD, self.capture_period_us.into());
        sink.raw(&r::CAPTURE_LENGTH, self.capture_length.into());
        block
    }

    /// Reads the block.
    ///
    /// # Errors
    /// The device does not have this register map, or another version of it.
    pub fn from_registers(block: &[u16; IDENTITY_WORDS]) -> Result<Self, IdentityError> {
        let source = &mut Words { block, base: IDENTITY_ADDRESS };
        let magic = source.u16(&r::IDENTITY_MAGIC);
        if magic != MAGIC {
            return Err(IdentityError::Magic(magic));
        }
        let version = source.u16(&r::IDENTITY_VERSION);
        if version != PROTOCOL_VERSION {
            return Err(IdentityError::Version(version));
        }
        Ok(Self {
            kind: DeviceKind(source.u16(&r::DEVICE_KIND)),
            serial_number: source.u32(&r::SERIAL_NUMBER),
            firmware_version: source.u16(&r::FIRMWARE_VERSION),
            current_limit_a: source.value(&r::CURRENT_LIMIT),
            voltage_limit_v: source.value(&r::VOLTAGE_LIMIT),
            speed_limit_rad_s: source.value(&r::SPEED_LIMIT),
            watchdog_ms: source.u16(&r::WATCHDOG),
            pole_pairs: source.u16(&r::POLE_PAIRS),
            rated_voltage_v: source.value(&r::RATED_VOLTAGE),
            rated_current_a: source.value(&r::RATED_CURRENT),
            rated_speed_rad_s: source.value(&r::RATED_SPEED),
            control_period_us: source.u16(&r::CONTROL_PERIOD),
            capture_period_us: source.u16(&r::CAPTURE_PERIOD),
            capture_length: source.u16(&r::CAPTURE_LENGTH),
        })
    }
}
