//! Trips: what ended a run, with the value that was found and the limit that it broke.

use drivebench_model::tabulated;
use std::fmt::Display;

use serde::{Deserialize, Serialize};

use drivebench_model::sample::DriveState;

tabulated! {
    /// The name in events and reports is the snake-case form.
    #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum TripKind {
        OverCurrent = "over-current",
        OverSpeed = "over-speed",
        OverVoltage = "over-voltage",
        Travel = "travel window left",
        BusLow = "bus voltage too low",
        BusHigh = "bus voltage too high",
        TimeLimit = "time limit",
        /// No valid reply for longer than the limit.
        LinkSilence = "link silent",
        /// No valid reply for longer than the limit, but exceptions of a drive or a gateway.
        Refused = "requests refused",
        /// The computer was suspended, as a laptop whose lid is closed: the motor ran unsupervised.
        Suspended = "computer suspended",
        /// The process was stopped: the motor ran unsupervised.
        HostGap = "host stood still",
        /// A limited quantity that the drive used to give is missing.
        SignalMissing = "signal missing",
        /// The drive's time, or the host's, does not advance.
        ClockStuck = "clock stuck",
        /// The drive's time jumps: it was switched off and on again.
        Restarted = "drive restarted",
        DriveFault = "drive fault",
        /// The drive does not run although it is commanded to: its watchdog, its keypad or its enable input.
        NotRunning = "drive does not run",
        LocalControl = "local control",
        OtherMaster = "another master",
        /// Safe torque off, or another enable input, has switched the output off.
        TorqueOff = "torque off",
        /// The measured speed is constant while by voltage and current it changes.
        EncoderFrozen = "encoder frozen",
        /// The measured speed has the opposite sign of that by voltage and current.
        EncoderReversed = "encoder reversed",
        /// The measured speed is far from that by voltage and current.
        SpeedImplausible = "speed implausible",
        /// The shaft does not turn under a current that should turn it: it is held, or the encoder is frozen.
        ShaftHeld = "shaft held",
        /// The measured angle is not the integral of the measured speed.
        AngleImplausible = "angle implausible",
        /// The measured current is constant while by voltage and speed it changes.
        CurrentStuck = "current stuck",
        /// The measured current has the opposite sign of that by voltage and speed.
        CurrentReversed = "current reversed",
        /// The measured current is far from that by voltage and speed.
        CurrentImplausible = "current implausible",
        OpenCircuit = "open circuit",
        SetPointIgnored = "set-point not followed",
        /// The measured voltage is not that by current and speed.
        VoltageImplausible = "voltage implausible",
        SignalsSwapped = "signals swapped",
        /// The field current is below the least: a motor without a field runs away.
        FieldLost = "field lost",
        /// The speed grows beyond its reference although the torque is against it.
        Runaway = "runaway",
        /// A speed loop oscillates, and its gains cannot fall.
        LoopSwings = "loop swings",
        LoopSaturated = "loop saturated",
    }
    pub const fn name(self) -> &'static str;
}

impl TripKind {
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
