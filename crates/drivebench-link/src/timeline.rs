//! The link's time axis: from the drive's counters to seconds, from the host's clock to the drive's, from telemetry as it
//! travels to a sample, and from the identity block to an identity.

use std::collections::VecDeque;

use firmware_protocol::registers::PROTOCOL_VERSION;
use firmware_protocol::{
    Control, DeviceKind, DriveCommand, Fault, IdentityError, State, Telemetry,
};

use super::cell_bus::Span;
use super::link::{Identity, LinkError};
use drivebench_model::sample::{Applied, Channel, Command, Demand, DriveState, Sample};

/// The drive's microsecond counter as seconds since the link connected: the first counter seen is 0.
#[derive(Clone, Debug, Default)]
pub struct DriveClock {
    last: Option<Last>,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    raw_us: u32,
    host_s: f64,
    since_connect_us: f64,
}

impl DriveClock {
    /// Drive time of a counter read at host time `host_s`. The number of wraps since the last reading follows from the host's clock,
    /// so that a pause may be longer than one wrap of 71.6 minutes.
    pub fn follow(&mut self, raw_us: u32, host_s: f64) -> f64 {
        let since_connect_us = self.last.map_or(0.0, |last| {
            let step_us = f64::from(signed_difference(raw_us, last.raw_us));
            let passed_us = (host_s - last.host_s) * 1e6;
            // Microseconds of one wrap of the counter: 2^32.
            let wrap_us = 4_294_967_296.0;
            let wraps = ((passed_us - step_us) / wrap_us).round();
            last.since_connect_us + step_us + wraps * wrap_us
        });
        self.last = Some(Last { raw_us, host_s, since_connect_us });
        since_connect_us * 1e-6
    }
}

/// `later - earlier` of two counters less than half a turn apart, us.
pub const fn signed_difference(later_us: u32, earlier_us: u32) -> i32 {
    later_us.wrapping_sub(earlier_us).cast_signed()
}

/// Offset and rate of the drive's clock against the host's: a line through the exchanges with the smallest round trip (the clock
/// filter of NTP, RFC 5905 §10), since delays only ever add.
///
/// Error: half of the smallest round trip, as the two directions need not take the same time. It carries host
/// times over to the drive's clock; no sample is moved by it.
#[derive(Clone, Debug, Default)]
pub struct ClockMap {
    marks: VecDeque<Mark>,
}

#[derive(Clone, Copy, Debug)]
struct Mark {
    window: f64,
    host_s: f64,
    offset_s: f64,
    delay_s: f64,
}

impl ClockMap {
    /// Takes an exchange: host times of request and reply, drive time of the sample between them.
    pub fn observe(&mut self, span: Span, drive_s: f64) {
        let host_s = 0.5 * (span.asked_s + span.answered_s);
        let mark = Mark {
            // The best exchange of each window is kept, s.
            window: (host_s / 0.5).floor(),
            host_s,
            offset_s: drive_s - host_s,
            delay_s: span.answered_s - span.asked_s,
        };
        match self.marks.back_mut() {
            Some(last) if last.window >= mark.window && mark.delay_s >= last.delay_s => {}
            Some(last) if last.window >= mark.window => *last = mark,
            _ => self.marks.push_back(mark),
        }
        // Windows that are remembered.
        if self.marks.len() > 120 {
            self.marks.pop_front();
        }
    }

    /// Exchanges that the line goes through.
    pub fn marks(&self) -> usize {
        self.marks.len().max(1)
    }

    /// Drive time minus host time, at the host time given; s. `None` before the first exchange.
    pub fn offset_s(&self, host_s: f64) -> Option<f64> {
        let (centre_s, offset_s, slope) = self.line()?;
        Some(offset_s + slope * (host_s - centre_s))
    }

    /// Centre of the marks in host time, offset there, slope.
    fn line(&self) -> Option<(f64, f64, f64)> {
        let smallest = self.marks.iter().map(|mark| mark.delay_s).min_by(f64::total_cmp)?;
        let is_good = move |mark: &&Mark| mark.delay_s <= 1.5 * smallest;
        let good = || self.marks.iter().filter(is_good);
        let count = good().count() as f64;
        let centre_s = good().map(|mark| mark.host_s).sum::<f64>() / count;
        let offset_s = good().map(|mark| mark.offset_s).sum::<f64>() / count;
        let spread: f64 = good().map(|mark| (mark.host_s - centre_s).powi(2)).sum();
        let joint: f64 =
            good().map(|mark| (mark.host_s - centre_s) * (mark.offset_s - offset_s)).sum();
        let slope = if spread > 0.0 { joint / spread } else { 0.0 };
        Some((centre_s, offset_s, slope))
    }
}

/// Time axis of one connection: drive time 0 is the first drive time read, at `identify` if that comes first. All samples of a
/// connection share this origin; the time since power-up is not used.
#[derive(Clone, Debug, Default)]
pub struct Timeline {
    clock: DriveClock,
    angle: Option<(f64, f64)>,
}

impl Timeline {
    /// Notes a drive time without a sample; returns it on the time axis, s.
    pub fn note(&mut self, time_us: u32, span: Span) -> f64 {
        self.clock.follow(time_us, span.answered_s)
    }

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
            Applied { seq, time_s: sample.time_s - f64::from(age_us) * 1e-6 }
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
        let span = Telemetry::ANGLE_SPAN_RAD;
        let (last, wraps) = self.angle.unwrap_or((raw, 0.0));
        let wraps = wraps - ((raw - last) / span).round();
        self.angle = Some((raw, wraps));
        raw + wraps * span
    }
}

/// The part of a sequence number that travels.
pub(super) const fn low_word(seq: u64) -> u16 {
    let [.., high, low] = seq.to_be_bytes();
    u16::from_be_bytes([high, low])
}

pub const fn command(command: Command) -> DriveCommand {
    let control = match command.demand {
        Demand::Disable => Control::Disable,
        Demand::Stop => Control::Stop,
        Demand::ResetFault => Control::ResetFault,
        Demand::Voltage(volts) => Control::Voltage(volts),
        Demand::Current(amperes) => Control::Current(amperes),
        Demand::Speed(speed) => Control::Speed(speed),
    };
    DriveCommand::new(low_word(command.seq), control)
}

/// Identity of the program from that of the protocol; the names come from the device identification.
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
        motor: None,
    }
}

/// Why an identity block is none of ours.
pub fn identity_error(link: &str, error: IdentityError) -> LinkError {
    let link = link.to_owned();
    match error {
        IdentityError::Version(found) => {
            LinkError::Version { link, found, expected: PROTOCOL_VERSION }
        }
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
    use proptest::prelude::*;

    use super::*;

    fn telemetry(seq: u16, time_us: u32, applied_us: u32) -> Telemetry {
        Telemetry { seq, time_us, applied_us, temperature_c: f64::NAN, ..Telemetry::default() }
    }

    #[test]
    fn applied_time_and_angle_survive_a_turn_of_the_counter() {
        let mut timeline = Timeline::default();
        timeline.note(u32::MAX - 1499, Span::new(1.0, 1.001));
        let telemetry = telemetry(5, 500, u32::MAX - 499);
        let sample = timeline.sample(&telemetry, 65_541, Span::new(1.002, 1.003));
        assert!((sample.time_s - 0.002).abs() < 1e-12);
        let applied = sample.applied.unwrap();
        assert_eq!(applied.seq, 65_541);
        assert!((applied.time_s - 0.001).abs() < 1e-12);
        assert_eq!(sample.get(Channel::Temperature), None);
        assert_eq!(sample.get(Channel::Current), Some(0.0));
        // Telemetry with the number of another command has no applied time.
        assert_eq!(timeline.sample(&telemetry, 65_542, Span::new(1.004, 1.005)).applied, None);
        let half = 0.5 * Telemetry::ANGLE_SPAN_RAD;
        let mut timeline = Timeline::default();
        let first = timeline.unwrap_angle(half - 1.0);
        assert!((timeline.unwrap_angle(-half + 1.0) - first - 2.0).abs() < 1e-6);
        assert!((timeline.unwrap_angle(half - 1.0) - first).abs() < 1e-6);
    }

    #[test]
    fn the_first_counter_is_time_zero_and_a_turn_is_no_jump() {
        let mut clock = DriveClock::default();
        assert!(clock.follow(u32::MAX - 999, 5.0).abs() < 1e-12);
        assert!((clock.follow(1000, 5.002) - 0.002).abs() < 1e-12);
        // A little back: the applied time of a command, or a reordered look.
        assert!((clock.follow(500, 5.002) - 0.001_5).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn pauses_of_any_length_are_followed(
            start in any::<u32>(),
            pauses in proptest::collection::vec(0.0..20_000.0_f64, 1..20),
        ) {
            let mut clock = DriveClock::default();
            clock.follow(start, 0.0);
            let mut true_us = 0_u64;
            for pause_s in pauses {
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "in range")]
                let step = (pause_s * 1e6) as u64;
                true_us += step;
                #[expect(clippy::cast_possible_truncation, reason = "the counter wraps")]
                let raw = start.wrapping_add(true_us as u32);
                // The host's clock is off by 100 ppm.
                let host_s = true_us as f64 * 1e-6 * 1.000_1;
                let drive_s = clock.follow(raw, host_s);
                prop_assert!((drive_s - true_us as f64 * 1e-6).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn late_replies_do_not_move_the_map() {
        let mut map = ClockMap::default();
        assert_eq!(map.offset_s(0.0), None);
        // 30 s at 100 Hz; the drive is 7 s behind and 50 ppm fast; every third reply is up to 20 ms late.
        for k in 0..3000 {
            let sent_s = f64::from(k) * 0.01;
            let is_late = k % 3 != 0;
            let late_s = f64::from(is_late) * f64::from(k % 20) * 1e-3;
            let sampled_s = sent_s + 0.002;
            map.observe(Span::new(sent_s, sent_s + 0.004 + late_s), sampled_s * 1.000_05 - 7.0);
        }
        let drift = map.offset_s(30.0).unwrap() - map.offset_s(0.0).unwrap();
        assert!((drift / 30.0 - 50e-6).abs() < 2e-6);
        assert!((map.offset_s(30.0).unwrap() - (-7.0 + 30.0 * 5e-5)).abs() < 1e-4);
    }
}
