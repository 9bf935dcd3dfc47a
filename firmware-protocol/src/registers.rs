//! The one register table. Codec, SPEC.md and golden vectors come from it.
//!
//! Addresses are protocol addresses (from 0) of holding registers; input registers mirror them.

/// Version of map and stream; a host refuses another one.
pub const PROTOCOL_VERSION: u16 = 1;
/// First word of the identity block: `DB`.
pub const MAGIC: u16 = 0x4442;
/// Samples that the capture window shows at once.
pub const CAPTURE_WINDOW_SAMPLES: u16 = 40;

/// How the words of a register form a number; two words are sent high word first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One word, unsigned.
    U16,
    /// One word, two's complement.
    I16,
    /// Two words, unsigned.
    U32,
    /// Two words, two's complement.
    I32,
}

impl Kind {
    /// Registers that one value takes.
    pub const fn words(self) -> u8 {
        match self {
            Self::U16 | Self::I16 => 1,
            Self::U32 | Self::I32 => 2,
        }
    }

    /// Smallest raw number that fits.
    pub const fn lowest(self) -> i64 {
        match self {
            Self::U16 | Self::U32 => 0,
            Self::I16 => i16::MIN as i64,
            Self::I32 => i32::MIN as i64,
        }
    }

    /// Largest raw number that fits.
    pub const fn highest(self) -> i64 {
        match self {
            Self::U16 => u16::MAX as i64,
            Self::I16 => i16::MAX as i64,
            Self::U32 => u32::MAX as i64,
            Self::I32 => i32::MAX as i64,
        }
    }

    /// Name in the specification.
    pub const fn name(self) -> &'static str {
        match self {
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::U32 => "u32",
            Self::I32 => "i32",
        }
    }
}

/// Who may change a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Only the drive.
    Read,
    /// The host too.
    ReadWrite,
}

/// One row of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Register {
    /// Protocol address of the first word.
    pub address: u16,
    /// Unique key.
    pub name: &'static str,
    /// SI unit of the scaled value; empty for a count or a code.
    pub unit: &'static str,
    /// Raw number times scale is the value in `unit`.
    pub scale: f64,
    /// How the words form the raw number.
    pub kind: Kind,
    /// Who may change it.
    pub access: Access,
    /// Smallest raw number allowed.
    pub min: i64,
    /// Largest raw number allowed.
    pub max: i64,
    /// Values of this row, `stride` addresses apart; 1 except in the capture window.
    pub repeat: u16,
    /// Distance between repeated values, registers.
    pub stride: u16,
    /// Meaning.
    pub meaning: &'static str,
}

/// A count or a code that only the drive changes.
const fn count(address: u16, name: &'static str, kind: Kind, meaning: &'static str) -> Register {
    Register {
        address,
        name,
        unit: "",
        scale: 1.0,
        kind,
        access: Access::Read,
        min: kind.lowest(),
        max: kind.highest(),
        repeat: 1,
        stride: 0,
        meaning,
    }
}

/// A scaled quantity; the raw number at the end of the range that has no mirror image means "not available".
const fn quantity(
    address: u16,
    name: &'static str,
    (kind, scale, unit): (Kind, f64, &'static str),
    meaning: &'static str,
) -> Register {
    let (min, max) = match kind {
        Kind::U16 | Kind::U32 => (0, kind.highest() - 1),
        Kind::I16 | Kind::I32 => (kind.lowest() + 1, kind.highest()),
    };
    Register { unit, scale, min, max, ..count(address, name, kind, meaning) }
}

const fn writable(register: Register, min: i64, max: i64) -> Register {
    Register { access: Access::ReadWrite, min, max, ..register }
}

const fn in_unit(register: Register, unit: &'static str) -> Register {
    Register { unit, ..register }
}

const fn repeated(register: Register) -> Register {
    Register { repeat: CAPTURE_WINDOW_SAMPLES, stride: 3, ..register }
}

const VOLTAGE_SCALE: (Kind, f64, &str) = (Kind::I16, 0.01, "V");
const CURRENT_SCALE: (Kind, f64, &str) = (Kind::I16, 0.01, "A");
const SPEED_SCALE: (Kind, f64, &str) = (Kind::I16, 0.02, "rad/s");
const VOLTAGE_LIMIT_SCALE: (Kind, f64, &str) = (Kind::U16, 0.01, "V");
const CURRENT_LIMIT_SCALE: (Kind, f64, &str) = (Kind::U16, 0.01, "A");
const SPEED_LIMIT_SCALE: (Kind, f64, &str) = (Kind::U16, 0.02, "rad/s");

/// Declares each register as a constant of its own and as a row of [`REGISTERS`].
macro_rules! table {
    ($($name:ident = $row:expr;)*) => {
        $(#[doc = concat!("Row of the table: ", stringify!($name), ".")] pub const $name: Register = $row;)*
        /// Every register, by rising address.
        pub const REGISTERS: &[Register] = &[$($name),*];
    };
}

table! {
    STATUS = count(0, "status", Kind::U16, "bits 0..2 state (0 disabled, 1 ready, 2 running, 3 fault); bit 4 current limit active, 5 voltage limit active, 6 watchdog tripped, 7 command applied since the last sample, 8 emulator; other bits 0");
    FAULT = count(1, "fault", Kind::U16, "fault code, 0 none; latched until reset");
    SEQUENCE_ECHO = count(2, "sequence_echo", Kind::U16, "sequence number of the last command applied");
    TIME = in_unit(count(3, "time", Kind::U32, "drive time of this sample; wraps"), "us");
    APPLIED_TIME = in_unit(count(5, "applied_time", Kind::U32, "drive time at which the last command was applied; wraps"), "us");
    VOLTAGE = quantity(7, "voltage", VOLTAGE_SCALE, "armature voltage, instantaneous");
    CURRENT = quantity(8, "current", CURRENT_SCALE, "armature current, instantaneous");
    SPEED = quantity(9, "speed", SPEED_SCALE, "shaft speed");
    ANGLE = Register { min: Kind::I32.lowest(), ..quantity(10, "angle", (Kind::I32, 1e-4, "rad"), "shaft angle, many turns; wraps, never saturates") };
    BUS_VOLTAGE = quantity(12, "bus_voltage", (Kind::U16, 0.1, "V"), "voltage of the intermediate circuit");
    TEMPERATURE = quantity(13, "temperature", (Kind::I16, 0.1, "C"), "temperature of the output stage");
    VOLTAGE_COMMAND = quantity(14, "voltage_command", VOLTAGE_SCALE, "voltage that the drive puts out now, after its limits");
    TELEMETRY_VERSION = count(15, "telemetry_version", Kind::U16, "protocol version");

    SEQUENCE = writable(count(32, "sequence", Kind::U16, "number of this command, echoed when applied"), 0, 0xFFFF);
    CONTROL = writable(count(33, "control", Kind::U16, "0 disable, 1 stop, 2 reset fault, 3 voltage, 4 current, 5 speed"), 0, 5);
    SET_POINT = writable(quantity(34, "set_point", (Kind::I32, 1e-3, "V, A or rad/s"), "set-point in the unit of the control word"), Kind::I32.lowest() + 1, Kind::I32.highest());

    IDENTITY_MAGIC = count(64, "magic", Kind::U16, "0x4442, the letters DB");
    IDENTITY_VERSION = count(65, "protocol_version", Kind::U16, "protocol version");
    DEVICE_KIND = count(66, "device_kind", Kind::U16, "bit 0 emulator; bits 8 + c: control word c is supported (c = 3 voltage, 4 current, 5 speed)");
    SERIAL_NUMBER = count(67, "serial_number", Kind::U32, "serial number");
    FIRMWARE_VERSION = count(69, "firmware_version", Kind::U16, "high byte major, low byte minor");
    CURRENT_LIMIT = quantity(70, "current_limit", CURRENT_LIMIT_SCALE, "the drive limits the current to this magnitude");
    VOLTAGE_LIMIT = quantity(71, "voltage_limit", VOLTAGE_LIMIT_SCALE, "the drive limits the voltage to this magnitude");
    SPEED_LIMIT = quantity(72, "speed_limit", SPEED_LIMIT_SCALE, "the drive trips above this magnitude");
    WATCHDOG = writable(in_unit(count(73, "watchdog", Kind::U16, "command silence after which the drive stops itself; 0 (off) is not allowed"), "ms"), 20, 5000);
    POLE_PAIRS = count(74, "pole_pairs", Kind::U16, "pole pairs of the motor; 0: brushed direct current");
    RATED_VOLTAGE = quantity(75, "rated_voltage", VOLTAGE_LIMIT_SCALE, "rated voltage of the motor");
    RATED_CURRENT = quantity(76, "rated_current", CURRENT_LIMIT_SCALE, "rated current of the motor");
    RATED_SPEED = quantity(77, "rated_speed", SPEED_LIMIT_SCALE, "rated speed of the motor");
    CONTROL_PERIOD = in_unit(count(78, "control_period", Kind::U16, "period of the drive's own control; commands are applied on it"), "us");
    CAPTURE_PERIOD = in_unit(count(79, "capture_period", Kind::U16, "distance of captured samples; 0: no capture"), "us");
    CAPTURE_LENGTH = count(80, "capture_length", Kind::U16, "samples that one capture holds");

    CAPTURE_CONTROL = writable(count(128, "capture_control", Kind::U16, "0 abort, 1 arm (starts when the next command is applied), 2 start now"), 0, 2);
    CAPTURE_STATE = count(129, "capture_state", Kind::U16, "0 empty, 1 armed, 2 recording, 3 complete");
    CAPTURE_COUNT = count(130, "capture_count", Kind::U16, "samples recorded so far");
    CAPTURE_TIME = in_unit(count(131, "capture_time", Kind::U32, "drive time of captured sample 0"), "us");
    WINDOW_INDEX = writable(count(133, "window_index", Kind::U16, "index of the captured sample that the window begins with"), 0, 0xFFFF);
    WINDOW_COUNT = count(134, "window_count", Kind::U16, "valid samples in the window, 0..40");
    WINDOW_VOLTAGE = repeated(quantity(135, "window_voltage", VOLTAGE_SCALE, "captured voltage: mean since the sample before"));
    WINDOW_CURRENT = repeated(quantity(136, "window_current", CURRENT_SCALE, "captured current"));
    WINDOW_SPEED = repeated(quantity(137, "window_speed", SPEED_SCALE, "captured speed"));
}

/// First address of the telemetry block; it is read in one request and is then one consistent snapshot.
pub const TELEMETRY_ADDRESS: u16 = STATUS.address;
/// Length of the telemetry block.
pub const TELEMETRY_WORDS: usize = block_words(STATUS, TELEMETRY_VERSION);
/// First address of the command block.
pub const COMMAND_ADDRESS: u16 = SEQUENCE.address;
/// Length of the command block.
pub const COMMAND_WORDS: usize = block_words(SEQUENCE, SET_POINT);
/// First address of the identity block.
pub const IDENTITY_ADDRESS: u16 = IDENTITY_MAGIC.address;
/// Length of the identity block.
pub const IDENTITY_WORDS: usize = block_words(IDENTITY_MAGIC, CAPTURE_LENGTH);
/// First address of the capture block.
pub const CAPTURE_ADDRESS: u16 = CAPTURE_CONTROL.address;
/// Length of the capture block, window included.
pub const CAPTURE_WORDS: usize = block_words(CAPTURE_CONTROL, WINDOW_SPEED);

const fn block_words(first: Register, last: Register) -> usize {
    (last.address + (last.repeat - 1) * last.stride + last.kind.words() as u16 - first.address)
        as usize
}

impl Register {
    /// The raw number for a value in the register's unit: rounded to the nearest step, saturated to the
    /// allowed range; NaN becomes [`Register::not_available`]. The angle, which is always
    /// there, wraps instead of saturating.
    pub fn encode(&self, value: f64) -> i64 {
        let raw = rounded(value * self.steps_per_unit());
        if self.wraps() {
            return wrapped(raw);
        }
        match self.not_available() {
            Some(code) if value.is_nan() => code,
            _ => raw.clamp(self.min, self.max),
        }
    }

    /// The value in the register's unit; NaN for "not available".
    pub fn decode(&self, raw: i64) -> f64 {
        if self.not_available() == Some(raw) {
            f64::NAN
        } else {
            raw as f64 / self.steps_per_unit()
        }
    }

    /// The raw number outside the allowed range that stands for a missing value, where there is one.
    pub fn not_available(&self) -> Option<i64> {
        let code = match self.kind {
            Kind::U16 | Kind::U32 => self.kind.highest(),
            Kind::I16 | Kind::I32 => self.kind.lowest(),
        };
        let scaled = self.steps_per_unit() > 1.0;
        (scaled && !(self.min..=self.max).contains(&code)).then_some(code)
    }

    /// Whether a raw number is a value that may be written.
    pub fn allows(&self, raw: i64) -> bool {
        (self.min..=self.max).contains(&raw)
    }

    /// Puts a raw number into a block that begins at `base`; what is outside the block is left out.
    pub fn put(&self, block: &mut [u16], base: u16, raw: i64) {
        let at = usize::from(self.address.wrapping_sub(base));
        let bytes = raw.to_be_bytes();
        let low = [bytes[4], bytes[5], bytes[6], bytes[7]];
        let words = [u16::from_be_bytes([low[0], low[1]]), u16::from_be_bytes([low[2], low[3]])];
        let words = if self.kind.words() == 1 { &words[1..] } else { &words[..] };
        for (slot, word) in block.iter_mut().skip(at).zip(words) {
            *slot = *word;
        }
    }

    /// The raw number in a block that begins at `base`; words outside the block count as 0.
    pub fn get(&self, block: &[u16], base: u16) -> i64 {
        let at = usize::from(self.address.wrapping_sub(base));
        let word = |offset: usize| block.get(at + offset).copied().unwrap_or(0);
        self.kind.number(word(0), word(1))
    }

    /// Number of steps in one unit, exactly; `raw / steps` is the shortest decimal where `raw * scale` is not.
    pub(crate) fn steps_per_unit(&self) -> f64 {
        rounded(1.0 / self.scale) as f64
    }

    pub(crate) fn wraps(&self) -> bool {
        self.address == ANGLE.address
    }
}

impl Kind {
    /// The number in one or two words; `second` is ignored by one-word kinds.
    pub(crate) fn number(self, first: u16, second: u16) -> i64 {
        let both = u32::from(first) << 16 | u32::from(second);
        match self {
            Self::U16 => i64::from(first),
            Self::I16 => i64::from(first.cast_signed()),
            Self::U32 => i64::from(both),
            Self::I32 => i64::from(both.cast_signed()),
        }
    }
}

/// Nearest whole number, halves to the even one: where a sensor has finer steps than a register, halves that all went away
/// from zero would make every reading too large. Saturates, NaN gives 0 (`core` has no `f64::round_ties_even`).
#[expect(clippy::cast_possible_truncation, reason = "the cast saturates")]
pub(crate) fn rounded(value: f64) -> i64 {
    let whole = value as i64;
    let rest = (value - whole as f64).abs();
    let is_odd = whole % 2 != 0;
    if rest > 0.5 || (is_odd && rest >= 0.5) {
        whole.saturating_add(if value < 0.0 { -1 } else { 1 })
    } else {
        whole
    }
}

/// Keeps the low 32 bits as a signed number.
#[expect(clippy::cast_possible_truncation, reason = "wrapping is the purpose")]
fn wrapped(raw: i64) -> i64 {
    i64::from(raw as i32)
}

/// What stands at an address: the row and which word of its value.
pub fn find(address: u16) -> Option<(&'static Register, u8)> {
    REGISTERS.iter().find_map(|register| {
        let offset = address.checked_sub(register.address)?;
        let (copy, word) = match register.stride {
            0 => (0, offset),
            stride => (offset / stride, offset % stride),
        };
        (copy < register.repeat && word < u16::from(register.kind.words()))
            .then_some((register, u8::try_from(word).unwrap_or(0)))
    })
}

/// Why a write is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WriteError {
    /// There is no register at an address of the range: Modbus exception 02.
    NoRegister,
    /// A register of the range is read-only: exception 02.
    ReadOnly,
    /// The range cuts a two-word value in half: exception 02.
    HalfValue,
    /// A value lies outside the register's range: exception 03.
    Range,
}

/// Checks a whole write against the table: existence, access, whole values, raw range.
pub fn check_write(address: u16, values: &[u16]) -> Result<(), WriteError> {
    let mut at = address;
    let mut rest = values;
    while let Some(&first) = rest.first() {
        let (register, word) = find(at).ok_or(WriteError::NoRegister)?;
        if register.access == Access::Read {
            return Err(WriteError::ReadOnly);
        }
        let words = usize::from(register.kind.words());
        if word != 0 || rest.len() < words {
            return Err(WriteError::HalfValue);
        }
        if !register.allows(register.kind.number(first, rest.get(1).copied().unwrap_or(0))) {
            return Err(WriteError::Range);
        }
        rest = &rest[words..];
        at = match at.checked_add(u16::from(register.kind.words())) {
            Some(next) => next,
            None if rest.is_empty() => break,
            None => return Err(WriteError::NoRegister),
        };
    }
    Ok(())
}

/// Whether every address of a range holds a register; half of a two-word value may be read.
pub fn check_read(address: u16, words: usize) -> bool {
    (0..words).all(|offset| {
        u16::try_from(offset)
            .ok()
            .and_then(|offset| address.checked_add(offset))
            .is_some_and(|address| find(address).is_some())
    })
}
