//! Why a run was ended by the guard.

use serde::Serialize;

use crate::sample::{Channel, DriveState, Hindrance};

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
    /// The computer was suspended, as a laptop whose lid is closed: nobody watched the motor meanwhile.
    Suspended,
    /// The host itself stood still (stopped process): nobody watched the motor meanwhile.
    HostGap,
    /// A limited quantity that the drive used to give is missing.
    SignalMissing,
    /// The drive's time, or the host's, does not advance.
    ClockStuck,
    /// The drive reports a fault of its own.
    DriveFault,
    /// The drive does not run although it is commanded to: its watchdog, its keypad or its enable input.
    NotRunning,
    /// Somebody else has taken the command of the drive: its keypad, its terminals, another master.
    LocalControl,
    /// Frames on the line write to the drive, and none of them is ours.
    OtherMaster,
    /// Safe torque off, or another enable input, has switched the output off.
    TorqueOff,
    /// The measured speed stays where it is while voltage and current say that it changes.
    EncoderFrozen,
    /// The measured speed has the opposite sign of what voltage and current say.
    EncoderReversed,
    /// The measured speed is far from what voltage and current say.
    SpeedImplausible,
    /// The shaft stands under a current that should turn it: it is held, or the encoder stands still.
    ShaftHeld,
    /// The measured angle does not go with the measured speed.
    AngleImplausible,
    /// The measured current stays where it is while voltage and speed say that it changes.
    CurrentStuck,
    /// The measured current has the opposite sign of what voltage and speed say.
    CurrentReversed,
    /// The measured current is far from what voltage and speed say.
    CurrentImplausible,
    /// No current flows although there is a voltage.
    OpenCircuit,
    /// The drive does not do what it is asked.
    SetPointIgnored,
    /// The measured voltage is not the one that the motor answers to.
    VoltageImplausible,
    /// Two measured quantities stand in each other's place.
    SignalsSwapped,
    /// The field current is below the least: a motor without a field runs away.
    FieldLost,
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
            Self::Suspended => "computer suspended",
            Self::HostGap => "host stood still",
            Self::SignalMissing => "signal missing",
            Self::ClockStuck => "clock stuck",
            Self::DriveFault => "drive fault",
            Self::NotRunning => "drive does not run",
            Self::LocalControl => "local control",
            Self::OtherMaster => "another master",
            Self::TorqueOff => "torque off",
            Self::EncoderFrozen => "encoder frozen",
            Self::EncoderReversed => "encoder reversed",
            Self::SpeedImplausible => "speed implausible",
            Self::ShaftHeld => "shaft held",
            Self::AngleImplausible => "angle implausible",
            Self::CurrentStuck => "current stuck",
            Self::CurrentReversed => "current reversed",
            Self::CurrentImplausible => "current implausible",
            Self::OpenCircuit => "open circuit",
            Self::SetPointIgnored => "set-point not followed",
            Self::VoltageImplausible => "voltage implausible",
            Self::SignalsSwapped => "signals swapped",
            Self::FieldLost => "field lost",
            Self::Runaway => "runaway",
        }
    }

    /// Whether it was the link that was lost (exit status 3) and not a limit that was crossed (4).
    pub const fn is_link(self) -> bool {
        matches!(self, Self::LinkSilence | Self::HostGap | Self::Suspended)
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

    /// The computer was suspended for so long.
    pub(super) fn suspended(at_s: f64, slept_s: f64) -> Self {
        Self {
            kind: TripKind::Suspended,
            at_s,
            value: slept_s,
            limit: 0.0,
            reason: format!(
                "this computer was suspended for {slept_s:.1} s, and nobody watched the motor meanwhile"
            ),
        }
    }

    /// Somebody else writes to the drive: so many frames of theirs were seen.
    pub(super) fn other_master(at_s: f64, frames: u64) -> Self {
        let kind = TripKind::OtherMaster;
        Self {
            kind,
            at_s,
            value: frames as f64,
            limit: 0.0,
            reason: format!(
                "{}: {frames} frames on the line write to this drive and are not ours; its set-points are no longer the commanded ones; disconnect the other master, or take its write access",
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

    pub(super) fn field_lost(at_s: f64, field_a: Option<f64>, least_a: f64) -> Self {
        let found = field_a.map_or_else(
            || "cannot be read".to_owned(),
            |amperes| format!("{amperes:.3} A"),
        );
        Self {
            kind: TripKind::FieldLost,
            at_s,
            value: field_a.unwrap_or(0.0),
            limit: least_a,
            reason: format!(
                "field lost: field current {found}, at least {least_a:.3} A (limits.field_min_a of the drive's profile)"
            ),
        }
    }

    pub(super) fn drive_fault(at_s: f64, code: Option<u16>, text: Option<&str>) -> Self {
        // 0 is no code.
        let code = code.filter(|code| *code != 0);
        let code_text = match (code, text) {
            (Some(code), Some(text)) => format!("code {code:#06x}: {text}"),
            (Some(code), None) => format!("code {code:#06x}"),
            (None, Some(text)) => text.to_owned(),
            (None, None) => "no code".to_owned(),
        };
        Self {
            kind: TripKind::DriveFault,
            at_s,
            value: code.map_or(0.0, f64::from),
            limit: 0.0,
            reason: format!("drive fault: the drive reports a fault, {code_text}"),
        }
    }

    pub(super) fn hindered(at_s: f64, hindrance: Hindrance) -> Self {
        let kind = match hindrance {
            Hindrance::LocalControl => TripKind::LocalControl,
            Hindrance::TorqueOff => TripKind::TorqueOff,
        };
        Self {
            kind,
            at_s,
            value: 0.0,
            limit: 0.0,
            reason: format!("{}: {}", kind.name(), hindrance.sentence()),
        }
    }

    pub(in crate::bench) fn not_running(
        at_s: f64,
        state: DriveState,
        value_s: f64,
        limit_s: f64,
    ) -> Self {
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

    /// Something measured that cannot be: the value, what it should be, and the sentence after the name.
    pub(in crate::bench) fn implausible(
        kind: TripKind,
        at_s: f64,
        (value, expected): (f64, f64),
        what: &str,
    ) -> Self {
        Self {
            kind,
            at_s,
            value,
            limit: expected,
            reason: format!("{}: {what}", kind.name()),
        }
    }

    /// A shaft that does not come to rest after the pulse of the checks.
    pub(in crate::bench) fn unrested(at_s: f64, speed_rad_s: f64, waited_s: f64) -> Self {
        Self {
            kind: TripKind::OverSpeed,
            at_s,
            value: speed_rad_s,
            limit: 0.0,
            reason: format!(
                "the shaft does not come to rest: {speed_rad_s:.2} rad/s after {waited_s:.1} s of zero"
            ),
        }
    }

    /// A drive that goes on running although its output is to be off.
    pub(in crate::bench) fn unstopped(at_s: f64, waited_s: f64) -> Self {
        Self::after(
            TripKind::NotRunning,
            at_s,
            waited_s,
            waited_s,
            "it still runs although its output is to be off",
        )
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
