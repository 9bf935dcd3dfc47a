//! From telemetry as it travels to a sample on the link's time axis, and from the identity block to an identity.

use firmware_protocol::registers::PROTOCOL_VERSION;
use firmware_protocol::{Control, DeviceKind, Fault, IdentityError, State, Telemetry};

use super::clock_map::{ClockMap, DriveClock, signed_difference};
use super::link::{Identity, LinkError};
use super::register_bus::Span;
use crate::sample::{Applied, Channel, Demand, DriveState, Sample};

/// The time axis of one connection. Drive time 0 is the first drive time that was seen, at `identify` where that
/// comes first: samples of one connection share one origin, and the drive's time since power-up says nothing.
#[derive(Clone, Debug, Default)]
pub struct Timeline {
    clock: DriveClock,
    pub(super) map: ClockMap,
    angle: Option<(f64, f64)>,
}

impl Timeline {
    /// Notes a drive time without a sample; returns it on the time axis, s.
    pub fn note(&mut self, time_us: u32, span: Span) -> f64 {
        let time_s = self.clock.follow(time_us, span.answered_s);
        self.map.observe(span, time_s);
        time_s
    }

    /// The sample of an exchange.
    pub fn sample(&mut self, telemetry: &Telemetry, seq: u64, span: Span) -> Sample {
        let mut sample = Sample::at(self.note(telemetry.time_us, span));
        sample.host_time_s = Some(span.answered_s);
        sample.seq = Some(seq);
        sample.state = Some(match telemetry.status.state() {
            Some(State::Disabled) => DriveState::Disabled,
            Some(State::Ready) => DriveState::Ready,
            Some(State::Running) => DriveState::Running,
            // A reserved code is to be treated as a fault.
            Some(State::Fault) | None => DriveState::Fault,
        });
        sample.status = Some(telemetry.status.0);
        sample.limited = telemetry.status.is_limited();
        let fault = Some(telemetry.fault).filter(|fault| *fault != Fault::None);
        sample.fault = fault.map(Fault::code);
        sample.fault_text = fault.map(|fault| fault.text().into());
        sample.applied = (telemetry.seq == low_word(seq)).then(|| {
            let age_us = signed_difference(telemetry.time_us, telemetry.applied_us);
            Applied {
                seq,
                time_s: sample.time_s - f64::from(age_us) * 1e-6,
            }
        });
        for (channel, value) in [
            (Channel::VoltageCmd, telemetry.voltage_cmd_v),
            (Channel::Voltage, telemetry.voltage_v),
            (Channel::Current, telemetry.current_a),
            (Channel::Speed, telemetry.speed_rad_s),
            (Channel::Angle, self.unwrap_angle(telemetry.angle_rad)),
            (Channel::Bus, telemetry.bus_v),
            (Channel::Temperature, telemetry.temperature_c),
        ] {
            sample.set(channel, value);
        }
        sample
    }

    fn unwrap_angle(&mut self, raw: f64) -> f64 {
        const SPAN: f64 = Telemetry::ANGLE_SPAN_RAD;
        let (last, turns) = self.angle.unwrap_or((raw, 0.0));
        let turns = turns - ((raw - last) / SPAN).round();
        self.angle = Some((raw, turns));
        raw + turns * SPAN
    }
}

/// The part of a sequence number that travels.
pub const fn low_word(seq: u64) -> u16 {
    let [.., high, low] = seq.to_be_bytes();
    u16::from_be_bytes([high, low])
}

/// What the drive is asked, as it travels.
pub const fn control(demand: Demand) -> Control {
    match demand {
        Demand::Disable => Control::Disable,
        Demand::Stop => Control::Stop,
        Demand::ResetFault => Control::ResetFault,
        Demand::Voltage(volts) => Control::Voltage(volts),
        Demand::Current(amperes) => Control::Current(amperes),
        Demand::Speed(speed) => Control::Speed(speed),
    }
}

/// The identity as the rest of the program knows it; names come from elsewhere.
pub fn identity(block: &firmware_protocol::Identity) -> Identity {
    let known = |value: f64| value.is_finite().then_some(value);
    let [major, minor] = block.firmware_version.to_be_bytes();
    Identity {
        vendor: String::new(),
        product: String::new(),
        serial_number: block.serial_number.to_string(),
        firmware: format!("{major}.{minor}"),
        protocol_version: PROTOCOL_VERSION,
        is_emulator: block.kind.has(DeviceKind::EMULATOR),
        watchdog_s: Some(f64::from(block.watchdog_ms) * 1e-3),
        current_limit_a: known(block.current_limit_a),
        voltage_limit_v: known(block.voltage_limit_v),
    }
}

/// Why an identity block is none of ours.
pub fn identity_error(link: &str, error: IdentityError) -> LinkError {
    let link = link.to_owned();
    match error {
        IdentityError::Version(found) => LinkError::Version {
            link,
            found,
            expected: PROTOCOL_VERSION,
        },
        IdentityError::Magic(found) => LinkError::Identity(
            link,
            format!(
                "register 64 reads {found:#06x}, not 0x4442: this drive does not have drivebench's register map"
            ),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn span(asked_s: f64, answered_s: f64) -> Span {
        Span {
            asked_s,
            answered_s,
        }
    }

    fn telemetry(seq: u16, time_us: u32, applied_us: u32) -> Telemetry {
        Telemetry {
            seq,
            time_us,
            applied_us,
            temperature_c: f64::NAN,
            ..Telemetry::default()
        }
    }

    #[test]
    fn the_applied_time_is_on_the_axis_of_the_sample_across_a_turn_of_the_counter() {
        let mut timeline = Timeline::default();
        timeline.note(u32::MAX - 1499, span(1.0, 1.001));
        let telemetry = telemetry(5, 500, u32::MAX - 499);
        let sample = timeline.sample(&telemetry, 65_541, span(1.002, 1.003));
        assert!((sample.time_s - 0.002).abs() < 1e-12);
        let applied = sample.applied.unwrap();
        assert_eq!(applied.seq, 65_541);
        assert!((applied.time_s - 0.001).abs() < 1e-12);
        assert_eq!(sample.get(Channel::Temperature), None);
        assert_eq!(sample.get(Channel::Current), Some(0.0));
    }

    #[test]
    fn a_command_that_the_drive_does_not_report_has_no_applied_time() {
        let sample = Timeline::default().sample(&telemetry(4, 10, 5), 5, span(0.0, 0.0));
        assert_eq!(sample.applied, None);
    }

    #[test]
    fn the_angle_goes_on_over_its_wrap() {
        let mut timeline = Timeline::default();
        let half = 0.5 * Telemetry::ANGLE_SPAN_RAD;
        let first = timeline.unwrap_angle(half - 1.0);
        let second = timeline.unwrap_angle(-half + 1.0);
        assert!((second - first - 2.0).abs() < 1e-6);
        assert!((timeline.unwrap_angle(half - 1.0) - first).abs() < 1e-6);
    }
}
