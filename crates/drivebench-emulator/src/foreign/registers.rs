//! Registers of the motor's true state, as the profile defines them.

use std::f64::consts::{SQRT_2, TAU};

use super::{FIELD_A, ForeignDrive};
use drivebench_link::CellTable;
use drivebench_link::register_map::{
    Byte, CellSize, Condition, Kind, Layout, Order, Quantity, Signal, Unit, product_of,
};
use drivebench_model::sample::Hindrance;
use drivebench_model::units::{rad_s_from_rpm, rpm_from_rad_s};

/// A speed in the unit of a profile, rad/s. `si`: one unit by the profile; otherwise one pole pair.
pub(super) fn rad_s(value: f64, unit: Unit, si: Option<f64>) -> f64 {
    match unit {
        Unit::Rpm => rad_s_from_rpm(value),
        Unit::RadS => value,
        _ => value * si.unwrap_or(TAU),
    }
}

fn in_unit(speed_rad_s: f64, unit: Unit, si: Option<f64>) -> f64 {
    match unit {
        Unit::Rpm => rpm_from_rad_s(speed_rad_s),
        Unit::RadS => speed_rad_s,
        _ => speed_rad_s / si.unwrap_or(TAU),
    }
}

pub(super) fn number(layout: Layout, registers: &[u16]) -> f64 {
    let mut ordered: Vec<u8> = Vec::new();
    if layout.cell == CellSize::Byte {
        ordered.extend(registers.iter().map(|cell| cell.to_le_bytes()[0]));
        if layout.bytes == Order::LowFirst {
            ordered.reverse();
        }
    } else {
        for word in registers {
            let bytes = match layout.bytes {
                Order::HighFirst => word.to_be_bytes(),
                Order::LowFirst => word.to_le_bytes(),
            };
            match layout.words {
                Order::HighFirst => ordered.extend(bytes),
                Order::LowFirst => drop(ordered.splice(0..0, bytes)),
            }
        }
    }
    let bits = ordered.iter().fold(0, |bits, byte| bits << 8 | u32::from(*byte));
    number_of(layout.kind, bits)
}

/// The nearest bits that the type has for a raw number.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "casts of a float saturate, as the registers of a drive do"
)]
pub(super) fn bits(kind: Kind, raw: f64) -> u32 {
    let raw_whole = raw.round_ties_even();
    match kind {
        Kind::U8 => (raw_whole.abs() as u8).into(),
        Kind::I8 => u8::from_be_bytes((raw_whole as i8).to_be_bytes()).into(),
        Kind::U16 => (raw_whole.abs() as u16).into(),
        Kind::I16 => u16::from_be_bytes((raw_whole as i16).to_be_bytes()).into(),
        Kind::U32 => raw_whole.abs() as u32,
        Kind::I32 => u32::from_be_bytes((raw_whole as i32).to_be_bytes()),
        Kind::F32 => (raw as f32).to_bits(),
    }
}

/// A cell of a pattern of 32 bits, counted as the drive has them.
fn byte_of(pattern: u32, layout: Layout, offset: u16) -> u8 {
    let ordered = match layout.bytes {
        Order::HighFirst => layout.cells() - 1 - offset,
        Order::LowFirst => offset,
    };
    pattern.to_le_bytes()[usize::from(ordered)]
}

/// The bits of a counter that begins again after `span` counts.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "less than the span, which fits 32 bits"
)]
fn count(raw: f64, span: f64) -> u32 {
    // Close below the span a remainder may round up to it.
    raw.floor().rem_euclid(span).min(span - 1.0) as u32
}

pub(super) fn number_of(kind: Kind, bits: u32) -> f64 {
    let [b3, b2, b1, b0] = bits.to_be_bytes();
    match kind {
        Kind::U8 => b0.into(),
        Kind::I8 => i8::from_be_bytes([b0]).into(),
        Kind::U16 => u16::from_be_bytes([b1, b0]).into(),
        Kind::I16 => i16::from_be_bytes([b1, b0]).into(),
        Kind::U32 => bits.into(),
        Kind::I32 => i32::from_be_bytes([b3, b2, b1, b0]).into(),
        Kind::F32 => f32::from_bits(bits).into(),
    }
}

const fn with_condition(word: u32, condition: &Condition, holds: bool) -> u32 {
    let with = (word & !condition.mask) | condition.pattern;
    if holds == condition.negated {
        // The lowest bit of the mask is enough to be another pattern.
        with ^ (condition.mask & condition.mask.wrapping_neg())
    } else {
        with
    }
}

impl ForeignDrive {
    /// One register; `None`: it is not there.
    pub(super) fn register(&mut self, table: CellTable, address: u16) -> Option<u16> {
        let map = std::sync::Arc::clone(&self.map);
        let mut word = None;
        for signal in &map.signals {
            let mut raw = |name: &str| map.signal(name).map(|decides| self.pattern(decides));
            let Some(at) = signal.placed(&mut raw) else { continue };
            let Some(offset) = address.checked_sub(at.address) else { continue };
            if at.table != table || offset >= at.layout.cells() {
                continue;
            }
            let (value, mask) = self.shown(signal, offset);
            word = Some((word.unwrap_or(0) & !mask) | (value & mask));
        }
        if word.is_some() {
            return word;
        }
        if let Some((at, unit_s)) = &map.watchdog.time
            && at.address == address
        {
            return Some(
                u16::try_from(bits(Kind::U16, self.watchdog_s / unit_s)).unwrap_or(u16::MAX),
            );
        }
        if let Some(word) = self.written.get(&address) {
            return Some(*word);
        }
        (self.is_mapped(table, address) || self.is_hole(table, address)).then_some(0)
    }

    /// An unused register that lies between used ones: drives answer it within the reach of a block.
    fn is_hole(&self, table: CellTable, address: u16) -> bool {
        let reach = self.map.max_hole;
        let near = |from: u16, to: u16| (from..=to).any(|at| self.is_mapped(table, at));
        reach > 0
            && near(address.saturating_sub(reach), address)
            && near(address, address.saturating_add(reach))
    }

    /// The word of a signal at an offset, and which bits of it are the signal's.
    fn shown(&mut self, signal: &Signal, offset: u16) -> (u16, u16) {
        let layout = &signal.location.layout;
        let pattern = self.pattern(signal);
        if layout.cell == CellSize::Byte && layout.bits.is_none() {
            return (byte_of(pattern, *layout, offset).into(), 0xFF);
        }
        let (shift, width) = match (layout.bits, layout.byte) {
            (Some((first, last)), _) => (u32::from(first), u32::from(last - first) + 1),
            (None, Some(Byte::High)) => (8, 8),
            (None, Some(Byte::Low)) => (0, 8),
            (None, None) => (0, 32),
        };
        let whole = u32::MAX >> (32 - width);
        let [b3, b2, b1, b0] = ((pattern & whole) << shift).to_be_bytes();
        let [m3, m2, m1, m0] = (whole << shift).to_be_bytes();
        if layout.cell == CellSize::Byte {
            let (value, mask) = ((pattern & whole) << shift, whole << shift);
            return (byte_of(value, *layout, offset).into(), byte_of(mask, *layout, offset).into());
        }
        let first_is_high = layout.words == Order::HighFirst;
        let high = layout.cells() == 2 && (offset == 0) == first_is_high;
        let (word, mask) = if high { ([b3, b2], [m3, m2]) } else { ([b1, b0], [m1, m0]) };
        match layout.bytes {
            Order::HighFirst => (u16::from_be_bytes(word), u16::from_be_bytes(mask)),
            Order::LowFirst => (u16::from_le_bytes(word), u16::from_le_bytes(mask)),
        }
    }

    fn pattern(&mut self, signal: &Signal) -> u32 {
        if let Some(forced) = self.forced.get(&signal.name) {
            return *forced;
        }
        if let Some((at, unit_s)) = self.map.watchdog.time
            && at.table == signal.location.table
            && at.address == signal.location.address
        {
            // All ones: it has expired.
            let expired = 2.0_f64.powi(i32::from(at.layout.width())) - 1.0;
            let raw = if self.has_lost_host() { expired } else { self.watchdog_s / unit_s };
            return bits(signal.location.layout.kind, raw);
        }
        let status = self.status(&signal.name);
        let natural = match signal.keys.quantity {
            Quantity::Status => status,
            Quantity::FaultCode if self.fault.is_some() => {
                // Fault code of every trip.
                bits(signal.location.layout.kind, 5.0)
            }
            Quantity::FaultCode => 0,
            _ => {
                let factor = self.factor(&signal.numbers.scale_by);
                let value = self.truth(signal);
                let raw = (value - signal.numbers.offset) / (signal.numbers.scale * factor);
                let raw = if signal.keys.truncated { raw.trunc() } else { raw };
                match (signal.keys.quantity, signal.wraps_at) {
                    (Quantity::Clock, None) => {
                        count(raw, 2.0_f64.powi(i32::from(signal.location.layout.width())))
                    }
                    (_, Some(span)) => count(raw, span),
                    _ => bits(signal.location.layout.kind, raw),
                }
            }
        };
        self.with_expected_identity(signal, natural)
    }

    /// Status bits: the stages of the enable command, and the states of the profile.
    fn status(&self, signal: &str) -> u32 {
        let state = |name| self.map.state(name).filter(|condition| condition.signal == signal);
        let mut word = self.sequence.shown(signal);
        if self.fault.is_some() {
            word = 0;
            if let Some(fault) = state("fault").filter(|condition| !condition.negated) {
                word |= fault.pattern;
            }
        }
        if self.sequence.shows_running()
            && self.fault.is_none()
            && let Some(running) = state("running").filter(|condition| !condition.holds(word))
        {
            word = with_condition(word, running, true);
        }
        let looks = self.map.watchdog.keys.auto_resume;
        if (self.has_lost_host() || looks && self.processing.had_lost_host())
            && let Some(lost) = state("comm_loss")
        {
            word = (word & !lost.mask) | lost.pattern;
        }
        let local = self.hindrance == Some(Hindrance::LocalControl);
        for (name, holds) in [
            ("local", local),
            ("remote", !local),
            ("sto", self.hindrance == Some(Hindrance::TorqueOff)),
        ] {
            if let Some(condition) = state(name) {
                word = with_condition(word, condition, holds);
            }
        }
        word
    }

    /// Product of nameplate values that others are scaled with.
    pub(super) fn factor(&self, scale_by: &[String]) -> f64 {
        let nameplate = &self.nameplate;
        let value = |name: &str| {
            let Some(signal) = self.map.signal(name) else { return Some(1.0) };
            let natural = match signal.keys.quantity {
                Quantity::RatedCurrent => nameplate.rated_current_a,
                Quantity::RatedVoltage => nameplate.rated_voltage_v,
                Quantity::RatedSpeed => {
                    in_unit(nameplate.rated_speed_rad_s, signal.numbers.unit, None)
                }
                _ => 1.0,
            };
            Some(self.factor_with_expected_identity(signal, natural))
        };
        product_of(scale_by, value).unwrap_or(1.0)
    }

    /// Whether others are scaled with this signal.
    fn is_factor(&self, signal: &Signal) -> bool {
        let signals = self.map.signals.iter().map(|other| &other.numbers);
        let points = self.map.set_points.iter().map(|point| &point.numbers);
        let mut factors = signals.chain(points).flat_map(|numbers| &numbers.scale_by);
        factors.any(|name| name.strip_prefix('/').unwrap_or(name) == signal.name)
    }

    /// What is true, in the unit of the signal.
    fn truth(&mut self, signal: &Signal) -> f64 {
        let sensed = self.soft.telemetry();
        let (nameplate, (limit_a, limit_v)) = (&self.nameplate, self.limits_a_v);
        let unit = signal.numbers.unit;
        let si = signal.channel.map(|(_, si)| si);
        match signal.keys.quantity {
            Quantity::Current if !signal.keys.since_last_read => sensed.current_a,
            Quantity::Current | Quantity::DrivingCurrent => {
                self.processing.mean_current_a(self.soft.time_s())
            }
            Quantity::Voltage => sensed.voltage_v,
            Quantity::BusVoltage => sensed.bus_v,
            Quantity::LineVoltage => sensed.bus_v / SQRT_2,
            Quantity::ShaftSpeed if signal.keys.filter_ms.is_some() => {
                in_unit(self.processing.speed_rad_s(), unit, si)
            }
            Quantity::ShaftSpeed | Quantity::OutputSpeed => in_unit(sensed.speed_rad_s, unit, si),
            Quantity::Torque if unit == Unit::Percent => {
                100.0 * sensed.current_a / nameplate.rated_current_a
            }
            Quantity::Torque => nameplate.torque_constant() * sensed.current_a,
            Quantity::Power => 1e-3 * sensed.voltage_v * sensed.current_a,
            Quantity::Duty => 100.0 * sensed.voltage_cmd_v / limit_v,
            Quantity::FieldCurrent if self.has_no_field() => 0.0,
            Quantity::FieldCurrent => FIELD_A,
            Quantity::Angle => sensed.angle_rad / si.unwrap_or(1.0),
            Quantity::Clock => match unit {
                Unit::Microsecond => 1e6 * self.soft.time_s(),
                Unit::Millisecond => 1e3 * self.soft.time_s(),
                _ => self.soft.time_s(),
            },
            Quantity::Temperature => 25.0,
            Quantity::RatedCurrent => nameplate.rated_current_a,
            Quantity::RatedVoltage => nameplate.rated_voltage_v,
            Quantity::RatedSpeed => in_unit(nameplate.rated_speed_rad_s, unit, None),
            Quantity::CurrentLimit => limit_a,
            Quantity::VoltageLimit => limit_v,
            Quantity::MotorResistance => nameplate.resistance_ohm,
            Quantity::MotorInductance => nameplate.inductance_h,
            Quantity::MotorBackEmf => nameplate.back_emf_v_s_per_rad,
            Quantity::Other if self.is_factor(signal) => 1.0,
            Quantity::Status
            | Quantity::FaultCode
            | Quantity::Word
            | Quantity::Speed
            | Quantity::Other => 0.0,
        }
    }
}
