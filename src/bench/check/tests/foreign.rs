//! The checks before a drive of another make, of which the profile may be wrong about the set-points.

use std::sync::Arc;

use super::*;
use crate::drive::{ProfiledLink, RegisterBus};
use crate::emulator::{ForeignBus, ForeignDrive, Guise};

/// A servo amplifier whose set-point has two registers.
fn profile(order: &str, scale: &str) -> DriveProfile {
    let text = DriveProfile::text("epulse50-dc").unwrap();
    let (from, to) = (
        "address = 0x1026\ntype = \"i16\"\n",
        format!(
            "address = 0x1026\ntype = \"i32\"\nreadback = true\nword_order = \"{order}\"\nscale = {scale}\n"
        ),
    );
    assert!(text.contains(from));
    DriveProfile::parse("epulse50-dc", &text.replacen(from, &to, 1)).unwrap()
}

struct Table {
    link: ProfiledLink<ForeignBus>,
    clock: VirtualClock,
    host: DriveProfile,
}

impl Table {
    /// A host with one profile at a drive of another.
    fn new(host: DriveProfile, far: &DriveProfile) -> Self {
        let guise = Guise::of(far).unwrap();
        let mut config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
        config.tolerance = 0.0;
        let clock = VirtualClock::new();
        let drive = ForeignDrive::new(&guise, &config, 1);
        let bus = ForeignBus::new(drive, &guise, clock.clone());
        let link = ProfiledLink::new(Arc::clone(host.registers.as_ref().unwrap()), bus);
        Self { link, clock, host }
    }

    fn check(&mut self) -> CheckReport {
        self.check_after(false)
    }

    fn check_after(&mut self, reset_fault: bool) -> CheckReport {
        let bench = BenchFile::embedded_default();
        let plate = bench.nameplate().unwrap();
        let limits = Limits {
            link_silence_s: 1.0,
            bus_min_v: None,
            bus_max_v: None,
            ..bench.limits()
        };
        let options = CheckOptions {
            rate_hz: 15.0,
            waivers: Waivers {
                watchdog: true,
                ..Waivers::default()
            },
            first_move: Some(FirstMove {
                plate: &plate,
                profile: &self.host,
                stopped: &|| false,
            }),
            reset_fault,
            ..options()
        };
        check(&mut self.link, &mut self.clock, &limits, options).unwrap()
    }
}

#[test]
fn a_set_point_that_is_right_is_compared_at_rest_and_passes_the_pulse() {
    let far = profile("high_first", "0.1");
    let mut table = Table::new(far.clone(), &far);
    let report = table.check();
    assert!(report.passed(), "{:?}", report.refusal());
    assert_eq!(
        text(&report, "set-points"),
        "speed_ref read back as written"
    );
    assert!(!table.link.bus().drive().is_running());
}

#[test]
fn a_speed_of_another_word_order_or_scale_is_stopped_in_the_pulse_and_asked_about() {
    let far = profile("high_first", "0.1");
    for (order, scale) in [
        ("low_first", "0.1"),
        ("high_first", "0.01"),
        ("high_first", "1.0"),
    ] {
        let mut table = Table::new(profile(order, scale), &far);
        let report = table.check();
        let refusal = report.refusal().unwrap();
        assert!(
            refusal.text.contains("asked ")
                && refusal
                    .text
                    .contains("word order or scale of speed_ref right?"),
            "{order} {scale}: {}",
            refusal.text
        );
        // A quarter of the rated speed and what a cycle adds.
        let speed = table
            .link
            .reading("speed")
            .or(table.link.reading("shaft_speed"));
        assert!(speed.is_none_or(|rpm| rpm.abs() < 1000.0), "{speed:?}");
        assert!(!table.link.bus().drive().is_running(), "it was stopped");
    }
}

#[test]
fn a_set_point_that_reads_back_otherwise_is_refused_at_rest() {
    let far = profile("high_first", "0.1");
    let mut table = Table::new(far.clone(), &far);
    let bus = table.link.bus_mut();
    bus.write(16, 0x1026, &[5, 0]).unwrap();
    bus.drive_mut().ignore(Some("speed_ref"));
    let report = table.check();
    let refusal = report.refusal().unwrap();
    assert_eq!(refusal.name, "set-points");
    assert!(
        refusal.text.contains("setpoint speed_ref was written as"),
        "{}",
        refusal.text
    );
    assert!(!table.link.bus().drive().is_running());
}

#[test]
fn a_drive_that_somebody_runs_is_refused_and_nothing_is_asked_of_it() {
    for reset_fault in [false, true] {
        is_left_running(reset_fault);
    }
}

fn is_left_running(reset_fault: bool) {
    let far = profile("high_first", "0.1");
    let mut table = Table::new(far.clone(), &far);
    let bus = table.link.bus_mut();
    for (address, words) in [(0x0010, &[2][..]), (0x1000, &[1]), (0x1026, &[0, 9990])] {
        bus.write(16, address, words).unwrap();
    }
    table.clock.set_time_s(2.0);
    let report = table.check_after(reset_fault);
    let refusal = report.refusal().unwrap();
    assert_eq!(refusal.name, "standstill");
    assert!(
        refusal
            .text
            .contains("the drive is running; who commands it? speed"),
        "{}",
        refusal.text
    );
    assert_eq!(report.last_seq, 0, "nothing was asked of it");
    assert!(report.noise.is_empty());
    assert!(
        table.link.bus().drive().is_running(),
        "it is left to who runs it"
    );
}
