use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};

use super::*;
use crate::VirtualClock;
use crate::recording::{Layout, MemoryRecorder};
use crate::testing::{Fault, ScriptedDrive, has, within};

struct Case {
    /// The attempt from which on the port can be opened.
    there_at: u32,
    serial_number: &'static str,
    confirms: bool,
    faults: Vec<(u64, u64, Fault)>,
    limit_s: Option<f64>,
    intent: Option<Intent>,
    /// A stop key was pressed.
    stopped: bool,
}

impl Default for Case {
    fn default() -> Self {
        Self {
            there_at: 4,
            serial_number: "7",
            confirms: true,
            faults: Vec::new(),
            limit_s: Some(10.0),
            intent: None,
            stopped: false,
        }
    }
}

struct Outcome {
    reopened: Reopened,
    has_link: bool,
    requests: Vec<String>,
    events: Vec<serde_json::Value>,
    shown: Arc<crate::Snapshot>,
}

/// The result of the standard case with a change.
fn done(change: impl FnOnce(&mut Case)) -> Outcome {
    let mut case = Case::default();
    change(&mut case);
    case.go()
}

impl Case {
    fn go(&self) -> Outcome {
        let mut clock = VirtualClock::new();
        clock.set_time_s(20.0);
        let mut recorder = MemoryRecorder::new(Layout::plain(&[]));
        let (sender, intents) = channel();
        if let Some(intent) = self.intent.clone() {
            sender.send(intent).unwrap();
        }
        let snapshots = SnapshotCell::default();
        let before = Identity {
            vendor: "drivebench".to_owned(),
            product: "script".to_owned(),
            serial_number: "7".to_owned(),
            is_emulator: true,
            watchdog_s: Some(0.3),
            ..Identity::default()
        };
        let requests = Arc::<Mutex<Vec<String>>>::default();
        let mut tries = 0;
        let (reopened, link) = reopen(
            LostDrive {
                clock: &mut clock,
                recorder: &mut recorder,
                stopped: &|| self.stopped,
                intents: &intents,
                snapshots: &snapshots,
                link: "/dev/serial/by-id/x",
                before: &before,
                end: RunEnd { drive_minus_host_s: -5.0, last_reply_s: 19.9 },
                seq: 900,
                limit_s: self.limit_s,
                seed: 1,
            },
            &mut || {
                tries += 1;
                if tries < self.there_at {
                    return Err(LinkError::Open("x".to_owned(), "it does not exist".to_owned()));
                }
                let mut drive = ScriptedDrive::new(0.01);
                drive.faults.extend(self.faults.iter().cloned());
                drive.serial_number = self.serial_number;
                drive.confirms_stop = self.confirms;
                drive.requests = Arc::clone(&requests);
                Ok(Box::new(drive))
            },
        );
        let events = recorder.events.lines().map(|l| serde_json::from_str(l).unwrap());
        Outcome {
            reopened,
            has_link: link.is_some(),
            requests: requests.lock().unwrap().clone(),
            events: events.collect(),
            shown: snapshots.latest(),
        }
    }
}

#[test]
fn the_same_drive_is_stopped_and_nothing_else() {
    let done = Case::default().go();
    assert_eq!(done.reopened.ending, ReopenEnding::Stopped);
    assert!(done.has_link && done.reopened.is_safe());
    assert_eq!(done.reopened.attempts, 4);
    assert_eq!(done.requests, ["identify", "stop", "Disable"]);
    // Not the state before the loss.
    assert_eq!(done.shown.drive_state, Some(DriveState::Disabled));
    // 50, 100, 200 and 400 ms, each up to a quarter off, after the reply 0.1 s before.
    within(done.reopened.downtime_s, 0.6..1.2);
    assert_eq!(done.reopened.state, Some("disabled"));
    let kinds: Vec<_> = done.events.iter().map(|e| &e["event"]).collect();
    // The same reason three times is one event.
    assert_eq!(kinds, ["link_lost", "reopen_failed", "reopened"]);
    assert_eq!(done.events[0]["watchdog_s"], 0.3);
    assert_eq!(done.events[0]["time_s"], 15.0);
    let last = &done.events[2];
    assert_eq!(last["ending"], "stopped");
    assert_eq!(last["identity"]["serial_number"], "7");
    assert_eq!(done.shown.phase, Some(Phase::Safe));
    has(done.shown.reopening.as_deref().unwrap(), "stop confirmed; nothing is armed");
}

#[test]
fn another_drive_is_only_read() {
    let done = done(|case| case.serial_number = "8");
    assert_eq!(done.reopened.ending, ReopenEnding::AnotherDrive);
    assert!(!done.has_link);
    assert_eq!(done.requests, ["identify"]);
    has(&done.reopened.text, "identity mismatch");
    has(&done.reopened.text, "\"8\", before it was \"7\"");
    assert_ne!(done.shown.phase, Some(Phase::Safe));
}

#[test]
fn a_drive_that_is_absent_in_fault_or_without_state_is_not_safe() {
    type Change = fn(&mut Case);
    let cases: [(Change, ReopenEnding, &str); 5] = [
        (|case| case.confirms = false, ReopenEnding::StopUnconfirmed, "not confirmed"),
        (
            |case| case.faults = vec![(0, u64::MAX, Fault::TripWith(7))],
            ReopenEnding::Stopped,
            "it is in fault",
        ),
        (
            |case| case.faults = vec![(0, u64::MAX, Fault::Timeout)],
            ReopenEnding::GivenUp,
            "given up",
        ),
        (|case| case.there_at = u32::MAX, ReopenEnding::GivenUp, "it does not exist"),
        (|case| case.limit_s = Some(0.0), ReopenEnding::GivenUp, "no time for an attempt"),
    ];
    for (change, ending, words) in cases {
        let done = done(change);
        assert_eq!(done.reopened.ending, ending, "{words}");
        has(&done.reopened.text, words);
        assert_ne!(done.shown.phase, Some(Phase::Safe), "{words}");
        assert_eq!(done.has_link, ending != ReopenEnding::GivenUp, "{words}");
        assert_eq!(done.reopened.is_safe(), ending == ReopenEnding::Stopped, "{words}");
        // The search for 10 s ends in time.
        within(done.reopened.downtime_s, ..=10.2);
    }
}

#[test]
fn a_stop_or_quit_ends_the_search_at_once() {
    for intent in [Some(Intent::Stop), Some(Intent::Quit), None] {
        let done = done(|case| {
            (case.there_at, case.limit_s) = (u32::MAX, None);
            (case.stopped, case.intent) = (intent.is_none(), intent);
        });
        assert_eq!(done.reopened.ending, ReopenEnding::Interrupted);
        within(done.reopened.downtime_s, ..0.2);
    }
}
