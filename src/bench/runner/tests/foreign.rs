//! Runs on a drive of another make in virtual time, and what ends them from the drive's side.

use std::sync::Arc;

use super::*;
use crate::bench::limits::Limits;
use crate::drive::{CommandTimes, DriveProfile, Identity, LinkError, LinkName, ProfiledLink};
use crate::emulator::{ForeignBus, ForeignDrive, Guise};

/// A servo amplifier that tells who has its command and whether its torque is off.
fn profile() -> DriveProfile {
    let text = DriveProfile::text("epulse50-dc").unwrap().replacen(
        "[state]\n",
        "[state]\n\
         remote = { signal = \"enabled\", mask = 0x02, equals = 0x02 }\n\
         sto = { signal = \"enabled\", mask = 0x04, equals = 0x04 }\n",
        1,
    );
    DriveProfile::parse("epulse50-dc", &text).unwrap()
}

/// The drive, to which something happens at an exchange.
struct Befallen {
    link: ProfiledLink<ForeignBus>,
    at: u64,
    happens: fn(&mut ForeignDrive),
}

impl DriveLink for Befallen {
    fn name(&self) -> LinkName {
        self.link.name()
    }

    fn identify(&mut self) -> Result<Identity, LinkError> {
        self.link.identify()
    }

    fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
        if command.seq == self.at {
            (self.happens)(self.link.bus_mut().drive_mut());
        }
        self.link.exchange(command)
    }

    fn stop(&mut self) -> Result<(), LinkError> {
        self.link.stop()
    }

    fn confirms_stop(&self) -> bool {
        self.link.confirms_stop()
    }

    fn command_times(&self) -> CommandTimes {
        self.link.command_times()
    }

    fn statistics(&self) -> LinkStatistics {
        self.link.statistics()
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        self.link.shortest_cycle_s()
    }
}

fn summary(
    profile: &DriveProfile,
    demand: Demand,
    at: u64,
    happens: fn(&mut ForeignDrive),
) -> (RunSummary, String, Befallen) {
    let mut config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    config.tolerance = 0.0;
    let guise = Guise::of(profile).unwrap();
    let mut clock = VirtualClock::new();
    let drive = ForeignDrive::new(&guise, &config, 1);
    let bus = ForeignBus::new(drive, &guise, clock.clone());
    let mut link = Befallen {
        link: ProfiledLink::new(Arc::clone(&guise.map), bus),
        at,
        happens,
    };
    link.identify().unwrap();
    let motor = Nameplate::zk_22fc();
    let limits = Limits {
        link_silence_s: 0.4,
        ..Limits::for_motor(&motor, 20.0)
    };
    let program = Wave {
        duration_s: 4.0,
        demand: move |_| demand,
    };
    let session = Session::new(Box::new(program), Guard::new(limits, &motor, None));
    let (summary, recorder) = carry_out(session, &mut link, &mut clock, 20.0);
    (summary, recorder.events_jsonl(), link)
}

const SLOW: Demand = Demand::Speed(30.0);

#[test]
fn an_undisturbed_run_is_done_and_confirmed() {
    let (summary, events, _) = summary(&profile(), SLOW, u64::MAX, |_| {});
    assert_eq!(summary.outcome, Outcome::Done, "{:?}", summary.notices);
    assert!(events.contains("\"stop_confirmed\":true"), "{events}");
}

/// The drive of which a command takes its time.
fn slow(from: &str, to: &str) -> DriveProfile {
    let text = DriveProfile::text("epulse50-dc").unwrap();
    assert!(text.contains(from));
    DriveProfile::parse("epulse50-dc", &text.replacen(from, to, 1)).unwrap()
}

#[test]
fn a_drive_that_takes_long_to_run_as_its_profile_says_is_waited_for() {
    let profile = slow("enable = [\n", "enable = [\n  { delay_ms = 1600 },\n");
    let (summary, _, _) = summary(&profile, SLOW, u64::MAX, |_| {});
    assert_eq!(summary.outcome, Outcome::Done, "{:?}", summary.notices);
}

#[test]
fn a_drive_that_takes_long_to_stop_as_its_profile_says_is_no_lost_link() {
    let profile = slow("stop = [\n", "stop = [\n  { delay_ms = 1600 },\n");
    let (summary, events, _) = summary(&profile, SLOW, u64::MAX, |_| {});
    assert_eq!(summary.outcome, Outcome::Done, "{:?}", summary.notices);
    assert!(events.contains("\"stop_confirmed\":true"), "{events}");
    let mut said = summary.notices.iter().map(|notice| notice.text.as_str());
    assert!(said.all(|text| !text.contains("confirmed")));
}

#[test]
fn keypad_and_torque_off_end_a_run_with_their_own_words() {
    type Case = (fn(&mut ForeignDrive), &'static str);
    let cases: [Case; 2] = [
        (
            |drive| drive.take_local(true),
            "local control: the drive is under local control",
        ),
        (
            |drive| drive.switch_torque_off(true),
            "torque off: safe torque off (STO) is active",
        ),
    ];
    for (happens, words) in cases {
        let (summary, _, link) = summary(&profile(), SLOW, 60, happens);
        let Outcome::Tripped(trip) = &summary.outcome else {
            panic!("{:?}", summary.outcome);
        };
        assert!(trip.reason.starts_with(words), "{}", trip.reason);
        assert_eq!(summary.stop_error, None);
        let drive = link.link.bus().drive();
        assert_eq!(drive.told_last("speed_ref"), Some(0));
        assert_eq!(drive.told_last("enable_word"), Some(0));
    }
}

#[test]
fn torque_off_before_the_start_is_refused_in_words_and_nothing_is_enabled() {
    let (summary, _, link) = summary(&profile(), SLOW, 1, |drive| drive.switch_torque_off(true));
    let Outcome::NotStarted { reason } = &summary.outcome else {
        panic!("{:?}", summary.outcome);
    };
    assert!(
        reason.contains("safe torque off (STO) is active"),
        "{reason}"
    );
    assert_ne!(link.link.bus().drive().told_last("enable_word"), Some(1));
}

#[test]
fn a_drive_that_refuses_a_register_ends_the_run_at_once_and_names_it() {
    let (summary, events, _) = summary(&profile(), SLOW, 60, |drive| drive.refuse(Some(2)));
    let Outcome::LinkLost { reason } = &summary.outcome else {
        panic!("{:?}", summary.outcome);
    };
    assert!(reason.contains("profile epulse50-dc:"), "{reason}");
    assert!(reason.contains("exception 0x02"), "{reason}");
    assert!(events.contains("refused_by_drive"), "{events}");
}

#[test]
fn a_drive_that_stays_busy_ends_the_run_after_the_silence_that_is_allowed() {
    let (summary, _, _) = summary(&profile(), SLOW, 60, |drive| drive.refuse(Some(6)));
    let Outcome::LinkLost { reason } = &summary.outcome else {
        panic!("{:?}", summary.outcome);
    };
    assert!(reason.contains("link silent"), "{reason}");
    assert!(reason.contains("limit 0.400 s"), "{reason}");
}

#[test]
fn a_drive_without_a_word_on_its_state_is_stopped_but_not_confirmed() {
    let text = DriveProfile::text("roboteq-dc").unwrap();
    let from = "scale = 0.1\nunit = \"%\"\nquantity = \"duty\"\nlimits = [-100, 100]";
    assert!(text.contains(from));
    let to = "scale = 0.12\nunit = \"V\"\nquantity = \"voltage\"\nlimits = [-120, 120]";
    let profile = DriveProfile::parse("roboteq-dc", &text.replacen(from, to, 1)).unwrap();
    let (summary, events, link) = summary(&profile, Demand::Voltage(8.0), u64::MAX, |_| {});
    assert_eq!(summary.outcome, Outcome::Done, "{:?}", summary.notices);
    assert!(!link.confirms_stop());
    assert!(events.contains("\"stop_confirmed\":false"), "{events}");
    let said = summary.notices.iter().map(|notice| notice.text.as_str());
    assert!(
        said.into_iter()
            .any(|text| text.starts_with("stop unconfirmed"))
    );
}
