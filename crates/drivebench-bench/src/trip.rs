//! Trips: what ended a run, with the value that was found and the limit that it broke.

use std::fmt::Display;

use serde::{Deserialize, Serialize};

use drivebench_model::sample::DriveState;

/// The name in events and reports is the snake-case form.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TripKind {
    OverCurrent,
    OverSpeed,
    OverVoltage,
    Travel,
    BusLow,
    BusHigh,
    TimeLimit,
    /// No valid reply for longer than the limit.
    LinkSilence,
    /// No valid reply for longer than the limit, but exceptions of a drive or a gateway.
    Refused,
    /// The computer was suspended, as a laptop whose lid is closed: the motor ran unsupervised.
    Suspended,
    /// The process was stopped: the motor ran unsupervised.
    HostGap,
    /// A limited quantity that the drive used to give is missing.
    SignalMissing,
    /// The drive's time, or the host's, does not advance.
    ClockStuck,
    /// The drive's time jumps: it was switched off and on again.
    Restarted,
    DriveFault,
    /// The drive does not run although it is commanded to: its watchdog, its keypad or its enable input.
    NotRunning,
    LocalControl,
    OtherMaster,
    /// Safe torque off, or another enable input, has switched the output off.
    TorqueOff,
    /// The measured speed is constant while by voltage and current it changes.
    EncoderFrozen,
    /// The measured speed has the opposite sign of that by voltage and current.
    EncoderReversed,
    /// The measured speed is far from that by voltage and current.
    SpeedImplausible,
    /// The shaft does not turn under a current that should turn it: it is held, or the encoder is frozen.
    ShaftHeld,
    /// The measured angle is not the integral of the measured speed.
    AngleImplausible,
    /// The measured current is constant while by voltage and speed it changes.
    CurrentStuck,
    /// The measured current has the opposite sign of that by voltage and speed.
    CurrentReversed,
    /// The measured current is far from that by voltage and speed.
    CurrentImplausible,
    OpenCircuit,
    SetPointIgnored,
    /// The measured voltage is not that by current and speed.
    VoltageImplausible,
    SignalsSwapped,
    /// The field current is below the least: a motor without a field runs away.
    FieldLost,
    /// The speed grows beyond its reference although the torque is against it.
    Runaway,
    /// A speed loop oscillates, and its gains cannot fall.
    LoopSwings,
    LoopSaturated,
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
            Self::Refused => "requests refused",
            Self::Suspended => "computer suspended",
            Self::HostGap => "host stood still",
            Self::SignalMissing => "signal missing",
            Self::ClockStuck => "clock stuck",
            Self::Restarted => "drive restarted",
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
            Self::LoopSwings => "loop swings",
            Self::LoopSaturated => "loop saturated",
        }
    }

    /// Whether it was the link that was lost (exit status 3) and not a limit that was crossed (4).
    pub const fn is_link(self) -> bool {
        matches!(self, Self::LinkSilence | Self::Refused | Self::HostGap | Self::Suspended)
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
    /// Found value and limit, and the sentence after the name of the kind.
    pub(super) fn new(
        kind: TripKind,
        at_s: f64,
        (value, limit): (f64, f64),
        what: impl Display,
    ) -> Self {
        Self { kind, at_s, value, limit, reason: format!("{}: {what}", kind.name()) }
    }

    pub(super) fn after(
        kind: TripKind,
        at_s: f64,
        (value_s, limit_s): (f64, f64),
        what: &str,
    ) -> Self {
        let what = format!("{what} for {value_s:.3} s, limit {limit_s:.3} s");
        Self::new(kind, at_s, (value_s, limit_s), what)
    }

    /// Exceptions instead of a valid reply for too long; `message` is the last one.
    pub(super) fn refused(at_s: f64, times_s: (f64, f64), message: &str) -> Self {
        let mut trip = Self::after(TripKind::Refused, at_s, times_s, "no valid reply");
        trip.reason.push_str("; the drive answers: ");
        trip.reason.push_str(message);
        trip
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
        let what = format!("the drive reports a fault, {code_text}");
        Self::new(TripKind::DriveFault, at_s, (code.map_or(0.0, f64::from), 0.0), what)
    }

    pub(super) fn not_running(at_s: f64, state: DriveState, value_s: f64, limit_s: f64) -> Self {
        let what = format!(
            "state {:?} for {value_s:.3} s while commanded to run, limit {limit_s:.3} s",
            state.name()
        );
        Self::new(TripKind::NotRunning, at_s, (value_s, limit_s), what)
    }

    /// A shaft that does not come to rest after the pulse of the checks.
    pub(super) fn not_at_rest(at_s: f64, speed_rad_s: f64, waited_s: f64) -> Self {
        let reason = format!(
            "the shaft does not come to rest: {speed_rad_s:.2} rad/s after {waited_s:.1} s of zero"
        );
        Self { reason, ..Self::new(TripKind::OverSpeed, at_s, (speed_rad_s, 0.0), "") }
    }

    /// A drive that still runs although its output is to be off, or does not reply.
    pub(super) fn unstopped(at_s: f64, waited_s: f64, replies: bool) -> Self {
        let what = if replies {
            "it still runs although its output is to be off"
        } else {
            "no reply confirms that its output is off"
        };
        Self::after(TripKind::NotRunning, at_s, (waited_s, waited_s), what)
    }
}
