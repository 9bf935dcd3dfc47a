use super::*;
use crate::bench::bench_file::BenchFile;
use crate::bench::testing::{Fault, ScriptedDrive};
use crate::emulator::{EmulatorConfig, Latency, MemoryLink, SoftDrive, VirtualClock};

fn options() -> CheckOptions {
    CheckOptions {
        rate_hz: 100.0,
        hardware_allowed: false,
        waive_watchdog: false,
    }
}

fn emulated(latency: Latency, options: CheckOptions) -> CheckReport {
    let mut clock = VirtualClock::new();
    let drive = SoftDrive::new(&EmulatorConfig::embedded_default(), 3);
    let mut link = MemoryLink::new(drive, clock.clone(), latency);
    let limits = BenchFile::embedded_default().limits();
    let report = check(&mut link, &mut clock, &limits, options).unwrap();
    assert!(link.drive().plant().speed_rad_s().abs() < 1.0);
    report
}

fn scripted(mut drive: ScriptedDrive, options: CheckOptions) -> Result<CheckReport, CheckError> {
    let limits = BenchFile::embedded_default().limits();
    let result = check(&mut drive, &mut VirtualClock::new(), &limits, options);
    assert_eq!(drive.stops, 1, "the output is off whatever was found");
    result
}

#[test]
fn the_emulated_drive_passes_every_check_with_figures() {
    let report = emulated(Latency::default(), options());
    assert!(report.passed(), "{:?}", report.refusal());
    let names: Vec<&str> = report.items.iter().map(|item| item.name).collect();
    assert_eq!(
        names,
        ["identity", "limits", "link", "standstill", "watchdog"]
    );
    assert!((report.round_trip_p50_s - 0.0073).abs() < 1e-6);
    assert!((report.reachable_rate_hz - 137.0).abs() < 1.0);
    assert!((report.watchdog_proven_s.unwrap() - 0.76).abs() < 1e-9);
    let speed = report
        .noise
        .iter()
        .find(|floor| floor.channel == Channel::Speed)
        .unwrap();
    // The emulator's sensor has 0.15 rad/s.
    assert!((0.1..0.2).contains(&speed.std), "{speed:?}");
    assert!(report.signals.contains(&Channel::Current));
}

#[test]
fn a_link_that_is_too_slow_is_refused_with_the_rate_that_it_reaches() {
    let slow = Latency {
        request_s: 0.01,
        reply_s: 0.01,
    };
    let report = emulated(slow, options());
    let refusal = report.refusal().unwrap();
    assert_eq!(refusal.name, "link");
    assert!(
        refusal.text.contains("reaches 50 Hz, asked 100 Hz"),
        "{}",
        refusal.text
    );
    assert_eq!(report.items.len(), 3, "nothing is tried after a refusal");
}

#[test]
fn a_drive_whose_watchdog_does_nothing_is_refused_unless_waived() {
    let report = scripted(ScriptedDrive::new(0.01), options()).unwrap();
    let refusal = report.refusal().unwrap();
    assert_eq!(refusal.name, "watchdog");
    assert!(refusal.text.contains("silence"), "{}", refusal.text);
    let waived = CheckOptions {
        waive_watchdog: true,
        ..options()
    };
    let report = scripted(ScriptedDrive::new(0.01), waived).unwrap();
    assert!(report.passed() && report.watchdog_proven_s.is_none());
}

#[test]
fn a_watchdog_that_is_off_or_too_long_is_refused_without_energising() {
    for watchdog_s in [None, Some(0.0), Some(1.5), Some(f64::NAN)] {
        let mut drive = ScriptedDrive::new(0.01);
        drive.watchdog_s = watchdog_s;
        let limits = BenchFile::embedded_default().limits();
        let report = check(&mut drive, &mut VirtualClock::new(), &limits, options()).unwrap();
        assert_eq!(report.refusal().unwrap().name, "watchdog");
        assert!(drive.demands.iter().all(|demand| !demand.energises()));
    }
}

#[test]
fn a_shaft_that_turns_and_a_drive_in_fault_are_refused() {
    for fault in [Fault::Set(Channel::Speed, 30.0), Fault::TripWith(2)] {
        let drive = ScriptedDrive::new(0.01).with(0, u64::MAX, fault);
        let report = scripted(drive, options()).unwrap();
        assert_eq!(report.refusal().unwrap().name, "standstill");
    }
}

#[test]
fn hardware_needs_to_be_allowed() {
    let mut drive = ScriptedDrive::new(0.01);
    drive.is_emulator = false;
    let report = scripted(drive, options()).unwrap();
    assert_eq!(report.refusal().unwrap().name, "identity");
    let mut drive = ScriptedDrive::new(0.01);
    drive.is_emulator = false;
    let allowed = CheckOptions {
        hardware_allowed: true,
        ..options()
    };
    assert_ne!(
        scripted(drive, allowed).unwrap().refusal().unwrap().name,
        "identity"
    );
}

#[test]
fn a_silent_drive_is_a_link_error_and_a_lossy_one_a_refusal() {
    let silent = ScriptedDrive::new(0.01).with(0, u64::MAX, Fault::Timeout);
    assert!(matches!(
        scripted(silent, options()),
        Err(CheckError::Link(LinkError::Timeout { .. }))
    ));
    let lossy = ScriptedDrive::new(0.01).with(5, 15, Fault::Timeout);
    let report = scripted(lossy, options()).unwrap();
    assert!(report.refusal().unwrap().text.contains("10 lost"));
}
