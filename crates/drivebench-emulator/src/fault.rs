//! Faults of line and drive as an emulator's file has them: which, from when, for how long, in which share of the replies.
//!
//! ```text
//! [[fault]] -> FaultEntry, a kind of the table -> line_faults.rs (what is done to the bytes) | drive/ (what the drive does)
//! ```

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::EmulatorConfigError;
use drivebench_link::Protocol;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FaultEntry {
    pub kind: FaultKind,
    /// After the start of the drive, s, once; left out: from its power-up on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_s: Option<f64>,
    /// Left out: it stays.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub for_s: Option<f64>,
    /// Of the replies that it hits, drawn from the seed.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub share: f64,
    /// By how much `late_reply` is late, ms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub late_ms: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub code: Option<u8>,
    /// By which the value of `speed_scaled` or `current_scaled` is multiplied.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub factor: Option<f64>,
    /// After the power-up, s: when the clock of `clock_wraps` does so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wraps_after_s: Option<f64>,
}

const fn one() -> f64 {
    1.0
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde gives a reference")]
const fn is_one(value: &f64) -> bool {
    value.to_bits() == 1.0_f64.to_bits()
}

/// Where a fault is injected. What happens to the host itself (signals, terminals, disks) is injected by its tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Injector {
    /// The bytes between drive and host: `line_faults.rs`.
    Bytes,
    /// The drive: drive/, and its supply.
    Drive,
}

/// The table of kinds: identifier, name in files, what happens; by injector.
macro_rules! kinds {
    ($($injector:ident { $($kind:ident $name:literal $what:literal)+ })+) => {
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        pub enum FaultKind {
            $($(
                #[doc = $what]
                #[serde(rename = $name)]
                $kind,
            )+)+
        }

        impl FaultKind {
            /// Every kind with its name, where it is injected, and what happens.
            pub const TABLE: &[(Self, &str, Injector, &str)] =
                &[$($((Self::$kind, $name, Injector::$injector, $what),)+)+];
        }
    };
}

kinds! {
    Bytes {
        ByteDropped "byte_dropped" "a byte of the reply is missing"
        ByteInserted "byte_inserted" "a byte too many"
        BitFlipped "bit_flipped" "one bit to three are wrong"
        DoubledReply "doubled_reply" "the reply comes twice"
        LateReply "late_reply" "it comes `late_ms` late"
        HeldReply "held_reply" "it is held back until the next request"
        HeldTwice "held_twice" "two copies of it are"
        WrongUnit "wrong_unit" "under the name of another unit; not on the stream"
        WrongRequest "wrong_request" "with another function or length; not on the stream"
        Exception "exception" "the request is refused with `code`; not on the stream"
        Truncated "truncated" "the end of the reply is missing"
        Garbage "garbage" "up to 64 KiB that mean nothing, before the reply or behind it"
        SplitReply "split_reply" "its second part comes 16 ms later"
        Echo "echo" "the line returns the request first"
        WrongBaud "wrong_baud" "nothing can be read"
        Silence "silence" "requests reach the drive and no reply comes back"
        BlackHole "black_hole" "neither requests nor replies arrive"
        Babble "babble" "something sends all the time"
        ForeignFrames "foreign_frames" "a master and another unit exchange frames; only on modbus-rtu"
        SecondMaster "second_master" "another master commands this drive; only on modbus-rtu"
    }
    Drive {
        PowerLost "power_lost" "it is off, and comes back as after power-up"
        Trip "trip" "it trips by a fault of its own"
        LocalControl "local_control" "it is commanded at its keypad; only under another profile"
        SetPointIgnored "set_point_ignored" "set-points are acknowledged and not followed"
        EnableIgnored "enable_ignored" "it does not follow its enable command"
        StopIgnored "stop_ignored" "stops are acknowledged and not followed"
        WatchdogDead "watchdog_dead" "its watchdog does nothing"
        Blocked "blocked" "the shaft is held"
        SpeedScaled "speed_scaled" "speed and angle are read `factor` times: -1 reversed, 0 stuck at zero"
        CurrentScaled "current_scaled" "the current is"
        SignalMissing "signal_missing" "speed and current are not available"
        FrozenRegisters "frozen_registers" "all that is measured stays as it is"
        ClockWraps "clock_wraps" "its clock wraps `wraps_after_s` after the power-up; only under the profile own"
        OtherVersion "other_version" "it has another version of the protocol; only under the profile own, not on the stream"
    }
}

impl FaultKind {
    fn row(self) -> Option<&'static (Self, &'static str, Injector, &'static str)> {
        Self::TABLE.iter().find(|(kind, ..)| *kind == self)
    }

    /// It needs bytes, or a drive that can be off.
    pub(super) fn needs_line(self) -> bool {
        let is_of_bytes =
            |(.., injector, _): &(Self, &str, Injector, &str)| *injector == Injector::Bytes;
        self == Self::PowerLost || self.row().is_some_and(is_of_bytes)
    }

    /// Where it would do nothing, as `(on what, what is allowed)`.
    fn idle(self, as_another: bool, protocol: Protocol) -> Option<(&'static str, &'static str)> {
        const ANOTHER: &str = "under the profile of another drive";
        const STREAM: &str = "where the language is not Modbus";
        let is_stream = protocol == Protocol::Stream;
        match self {
            Self::LocalControl if !as_another => {
                Some(("on our own drive, which has no keypad", "another profile"))
            }
            Self::OtherVersion | Self::ClockWraps if as_another => {
                Some((ANOTHER, "the profile own"))
            }
            Self::OtherVersion if is_stream => Some((STREAM, "modbus-rtu or modbus-tcp")),
            Self::WrongUnit | Self::WrongRequest | Self::Exception if !protocol.is_modbus() => {
                Some((STREAM, "modbus-rtu or modbus-tcp"))
            }
            Self::ForeignFrames | Self::SecondMaster if protocol != Protocol::ModbusRtu => {
                Some(("where no bus is shared", "modbus-rtu"))
            }
            _ => None,
        }
    }
}

impl FaultEntry {
    /// From the power-up on, for good, in every reply.
    #[cfg(test)]
    pub(super) const fn new(kind: FaultKind) -> Self {
        Self {
            kind,
            from_s: None,
            for_s: None,
            share: 1.0,
            late_ms: None,
            code: None,
            factor: None,
            wraps_after_s: None,
        }
    }

    /// Refuses what would do nothing on such a drive.
    pub(super) fn suits(
        &self,
        as_another: bool,
        protocol: Protocol,
    ) -> Result<(), EmulatorConfigError> {
        self.kind.idle(as_another, protocol).map_or(Ok(()), |(on, allowed)| {
            let kind = self.kind.row().map_or("", |(_, name, ..)| name);
            Err(EmulatorConfigError::Idle { kind, on, allowed })
        })
    }

    /// The first value that makes no sense, with what is allowed: `(key, value, allowed)`.
    pub(super) fn refused(&self) -> Option<(&'static str, f64, &'static str)> {
        const TIME: &str = "0 to 86400 s";
        const FOREIGN: &str = "left out: this kind has none";
        const TIMES: [f64; 2] = [0.0, 86_400.0];
        let is = |kind| self.kind == kind;
        let wraps = is(FaultKind::ClockWraps);
        let scaled = is(FaultKind::SpeedScaled) || is(FaultKind::CurrentScaled);
        let (late, refuses) = (is(FaultKind::LateReply), is(FaultKind::Exception));
        let code = self.code.map(f64::from);
        let rows = [
            ("fault.from_s", self.from_s, !wraps, TIMES, TIME),
            ("fault.for_s", self.for_s, !wraps, TIMES, TIME),
            ("fault.share", Some(self.share), true, [0.0, 1.0], "0 to 1"),
            ("fault.late_ms", self.late_ms, late, [0.0, 1e5], "0 to 100000"),
            ("fault.code", code, refuses, [1.0, 255.0], "1 to 255"),
            ("fault.factor", self.factor, scaled, [-1e3, 1e3], "-1000 to 1000"),
            ("fault.wraps_after_s", self.wraps_after_s, wraps, TIMES, TIME),
        ];
        let refused =
            |(key, value, belongs, [low, high], allowed): (_, Option<f64>, bool, [f64; 2], _)| {
                let value = value?;
                let allowed = if belongs { allowed } else { FOREIGN };
                (!belongs || !(low..=high).contains(&value)).then_some((key, value, allowed))
            };
        rows.into_iter().find_map(refused)
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct TimedFault {
    pub(super) entry: FaultEntry,
    begun_s: Option<f64>,
    /// Time of the next bytes without a request, s.
    pub(super) next_s: f64,
}

impl TimedFault {
    pub(super) fn new(entry: FaultEntry) -> Self {
        Self { entry, begun_s: entry.from_s.is_none().then_some(0.0), next_s: 0.0 }
    }

    /// Whether it is there at `now_s` of the drive's time; `ran_s`: since its last start, as long as it ran. A drive that has
    /// stopped in the same instant has reached it all the same.
    pub(super) fn is_active(&mut self, now_s: f64, ran_s: Option<f64>) -> bool {
        let starts = || ran_s.zip(self.entry.from_s).is_some_and(|(ran_s, from_s)| ran_s >= from_s);
        if self.begun_s.is_none() && starts() {
            self.begun_s = Some(now_s);
        }
        let for_s = self.entry.for_s.unwrap_or(f64::INFINITY);
        self.begun_s.is_some_and(|begun_s| now_s < begun_s + for_s)
    }

    /// Whether it is there and hits this reply.
    pub(super) fn hits(&mut self, now_s: f64, ran_s: Option<f64>, dice: &mut ChaCha8Rng) -> bool {
        self.is_active(now_s, ran_s) && dice.random::<f64>() < self.entry.share
    }
}

#[cfg(test)]
mod tests {
    use firmware_protocol::{Control, DriveCommand, Fault};

    use super::*;

    fn entry(text: &str) -> FaultEntry {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn a_fault_begins_once_and_ends_after_its_time() {
        let mut fault = TimedFault::new(entry("kind = \"trip\"\nfrom_s = 1.0\nfor_s = 0.5"));
        assert!(!fault.is_active(5.0, None));
        assert!(!fault.is_active(6.0, Some(0.9)));
        assert!(fault.is_active(6.1, Some(1.0)));
        assert!(fault.is_active(6.5, None), "it goes on where the drive stops");
        assert!(!fault.is_active(6.7, Some(1.6)));
        assert!(!fault.is_active(9.0, Some(1.0)), "once");
        assert!(TimedFault::new(entry("kind = \"trip\"")).is_active(0.0, None));
    }

    #[test]
    fn a_drive_that_stops_in_the_same_instant_has_reached_it() {
        let mut config = crate::EmulatorConfig::embedded("zk-22fc-plain").unwrap();
        config.faulty = vec![entry("kind = \"trip\"\nfrom_s = 1.0")];
        let mut drive = crate::SoftDrive::new(&config, 1);
        let mut hole = TimedFault::new(entry("kind = \"black_hole\"\nfrom_s = 1.0"));
        while drive.fault() == Fault::None {
            assert!(!hole.is_active(drive.time_s(), drive.ran_s()));
            drive.command(DriveCommand::new(1, Control::Voltage(5.0)));
            drive.advance_to(drive.time_s() + 0.1);
        }
        assert_eq!(drive.fault(), Fault::Internal);
        assert!(hole.is_active(drive.time_s(), drive.ran_s()));
    }

    #[test]
    fn entries_without_effect_are_refused_with_what_is_allowed() {
        let (rtu, tcp, stream) = (Protocol::ModbusRtu, Protocol::ModbusTcp, Protocol::Stream);
        for (kinds, as_another, protocol, allowed) in [
            (&["local_control"][..], true, rtu, None),
            (&["local_control"], false, rtu, Some("another profile")),
            (&["other_version", "clock_wraps"], true, rtu, Some("the profile own")),
            (&["other_version", "clock_wraps"], false, tcp, None),
            (&["wrong_unit", "wrong_request", "exception"], false, tcp, None),
            (
                &["wrong_unit", "wrong_request", "exception", "other_version"],
                false,
                stream,
                Some("modbus-rtu or modbus-tcp"),
            ),
            (&["foreign_frames", "second_master"], false, rtu, None),
            (&["foreign_frames", "second_master"], false, tcp, Some("modbus-rtu")),
            (&["foreign_frames", "second_master"], false, stream, Some("modbus-rtu")),
        ] {
            for kind in kinds {
                let suits = entry(&format!("kind = {kind:?}")).suits(as_another, protocol);
                let refused = suits.err().map(|error| error.to_string());
                let is_right = match (&refused, allowed) {
                    (Some(error), Some(allowed)) => {
                        error.ends_with(&format!("(expected {allowed})"))
                    }
                    (refused, allowed) => refused.is_none() && allowed.is_none(),
                };
                assert!(is_right, "{kind} {protocol}: {refused:?}");
            }
        }
        for (text, refused) in [
            ("kind = \"late_reply\"\nlate_ms = 30", None),
            ("kind = \"echo\"\nlate_ms = 30", Some("fault.late_ms")),
            ("kind = \"echo\"\nshare = 1.5", Some("fault.share")),
            ("kind = \"trip\"\nfrom_s = -1", Some("fault.from_s")),
        ] {
            assert_eq!(entry(text).refused().map(|(key, ..)| key), refused, "{text}");
        }
    }
}
