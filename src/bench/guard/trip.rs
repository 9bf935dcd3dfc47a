//! Why a run was ended by the guard.

use serde::Serialize;

use crate::sample::{Channel, DriveState};

/// What was found; the name in events and reports is the snake-case form.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TripKind {
    OverCurrent,
    OverSpeed,
    OverVoltage,
    Travel,
    BusLow,
    BusHigh,
    /// The output was on for longer than the limit.
    TimeLimit,
    /// No valid reply for longer than the limit.
    LinkSilence,
    /// The host itself stood still (stopped process, suspended machine): nobody watched the motor meanwhile.
    HostGap,
    /// A limited quantity that the drive used to give is missing.
    SignalMissing,
    /// The drive's time, or the host's, does not advance.
    ClockStuck,
    /// The drive reports a fault of its own.
    DriveFault,
    /// The drive does not run although it is commanded to: its watchdog, its keypad or its enable input.
    NotRunning,
    /// The measured speed stays where it is while voltage and current say that it changes.
    EncoderFrozen,
    /// The measured speed has the opposite sign of what voltage and current say.
    EncoderReversed,
    /// The measured speed is far from what voltage and current say.
    SpeedImplausible,
    /// The speed grows beyond its reference although the torque is against it.
    Runaway,
}

impl TripKind {
    pub const fn name(self) -> &'static str {
        match self {
            Self::OverCurrent => "over-current",
            Self::OverSpeed => "over-speed",
            Self::OverVoltage => "over-voltage",
            Self::Travel => "travel window left",
            Self::BusLow => "bus voltage too low",
            Self::BusHigh => "bus voltage too high",
            Self::TimeLimit => "time limit",
            Self::LinkSilence => "link silent",
            Self::HostGap => "host stood still",
            Self::SignalMissing => "signal missing",
            Self::ClockStuck => "clock stuck",
            Self::DriveFault => "drive fault",
            Self::NotRunning => "drive does not run",
            Self::EncoderFrozen => "encoder frozen",
            Self::EncoderReversed => "encoder reversed",
            Self::SpeedImplausible => "speed implausible",
            Self::Runaway => "runaway",
        }
    }

    /// Whether it was the link that was lost (exit status 3) and not a limit that was crossed (4).
    pub const fn is_link(self) -> bool {
        matches!(self, Self::LinkSilence | Self::HostGap)
    }
}

/// One trip: the value that was found and the limit that it broke.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trip {
    pub kind: TripKind,
    /// Host time of the decision, s.
    pub at_s: f64,
    pub value: f64,
    pub limit: f64,
    /// The whole sentence, with value, limit and unit.
    pub reason: String,
}

impl Trip {
    /// A measured quantity beyond its limit.
    pub(super) fn beyond(
        kind: TripKind,
        channel: Channel,
        at_s: f64,
        value: f64,
        limit: f64,
    ) -> Self {
        let (name, unit) = (channel.name(), channel.unit());
        Self {
            kind,
            at_s,
            value,
            limit,
            reason: format!(
                "{}: {name} {value:.4} {unit}, limit {limit:.4} {unit}",
                kind.name()
            ),
        }
    }

    /// A span of time that was too long.
    pub(super) fn after(kind: TripKind, at_s: f64, value_s: f64, limit_s: f64, what: &str) -> Self {
        Self {
            kind,
            at_s,
            value: value_s,
            limit: limit_s,
            reason: format!(
                "{}: {what} for {value_s:.3} s, limit {limit_s:.3} s",
                kind.name()
            ),
        }
    }

    /// Something that was seen too many times in a row.
    pub(super) fn repeated(kind: TripKind, at_s: f64, times: u32, limit: u32, what: &str) -> Self {
        Self {
            kind,
            at_s,
            value: f64::from(times),
            limit: f64::from(limit),
            reason: format!(
                "{}: {what} in {times} samples running, {limit} allowed",
                kind.name()
            ),
        }
    }

    pub(super) fn drive_fault(at_s: f64, code: Option<u16>) -> Self {
        let code_text =
            code.map_or_else(|| "no code".to_owned(), |code| format!("code {code:#06x}"));
        Self {
            kind: TripKind::DriveFault,
            at_s,
            value: code.map_or(0.0, f64::from),
            limit: 0.0,
            reason: format!("drive fault: the drive reports a fault, {code_text}"),
        }
    }

    pub(super) fn not_running(at_s: f64, state: DriveState, value_s: f64, limit_s: f64) -> Self {
        Self {
            kind: TripKind::NotRunning,
            at_s,
            value: value_s,
            limit: limit_s,
            reason: format!(
                "drive does not run: state {:?} for {value_s:.3} s while commanded to run, limit {limit_s:.3} s",
                state.name()
            ),
        }
    }

    /// A speed that cannot be: by the encoder, by voltage and current, and the difference that would be believed, rad/s.
    pub(in crate::bench) fn of_speed(
        kind: TripKind,
        at_s: f64,
        (by_encoder, by_voltage, doubt): (f64, f64, f64),
        what: &str,
    ) -> Self {
        Self {
            kind,
            at_s,
            value: by_encoder,
            limit: by_voltage,
            reason: format!(
                "{}: the measured speed {what} {by_encoder:.1} rad/s, by voltage and current it is {by_voltage:.1} rad/s, \
                 {doubt:.1} rad/s of difference are allowed",
                kind.name()
            ),
        }
    }

    pub(in crate::bench) fn runaway(at_s: f64, speed_rad_s: f64, reference_rad_s: f64) -> Self {
        Self {
            kind: TripKind::Runaway,
            at_s,
            value: speed_rad_s,
            limit: reference_rad_s,
            reason: format!(
                "runaway: the speed grows to {speed_rad_s:.1} rad/s against the torque, the reference is {reference_rad_s:.1} rad/s"
            ),
        }
    }

    /// No speed to answer to for too long.
    pub(in crate::bench) fn silent_speed(at_s: f64, silent_s: f64, limit_s: f64) -> Self {
        Self::after(TripKind::SignalMissing, at_s, silent_s, limit_s, "no speed")
    }
}
