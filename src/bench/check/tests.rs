//! The checks over the emulated drive and over a scripted one; `foreign.rs`: before a drive of another make.

mod foreign;
mod patience;
mod stalls;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU32, Ordering};

use super::*;
use crate::bench::bench_file::BenchFile;
use crate::bench::testing::{Fault, ScriptedDrive};
use crate::emulator::{EmulatorConfig, Latency, MemoryLink, SoftDrive, VirtualClock};

/// Without a first move, as for a motor that is not known.
fn options() -> CheckOptions<'static> {
    CheckOptions {
        rate_hz: 100.0,
        hardware_allowed: false,
        hardware_said: false,
        waivers: Waivers::default(),
        first_move: None,
        reset_fault: false,
    }
}

fn emulated(latency: Latency, options: CheckOptions<'_>) -> CheckReport {
    let mut clock = VirtualClock::new();
    let drive = SoftDrive::new(&EmulatorConfig::embedded_default(), 3);
    let mut link = MemoryLink::new(drive, clock.clone(), latency);
    let limits = BenchFile::embedded_default().limits();
    let report = check(&mut link, &mut clock, &limits, options).unwrap();
    assert!(link.drive().plant().speed_rad_s().abs() < 1.0);
    report
}

/// The embedded bench over an emulator, with the first move.
fn moved(
    emulator: &str,
    change: impl FnOnce(&mut EmulatorConfig),
    bench: &BenchFile,
    waivers: Waivers,
) -> (CheckReport, MemoryLink) {
    let mut config = EmulatorConfig::embedded(emulator).unwrap();
    change(&mut config);
    let mut clock = VirtualClock::new();
    let drive = SoftDrive::new(&config, 3);
    let mut link = MemoryLink::new(drive, clock.clone(), Latency::default());
    let profile = DriveProfile::named("own").unwrap();
    let plate = bench.nameplate().unwrap();
    let first = FirstMove {
        plate: &plate,
        profile: &profile,
        stopped: &|| false,
    };
    let options = CheckOptions {
        waivers,
        first_move: Some(first),
        ..options()
    };
    let report = check(&mut link, &mut clock, &bench.limits(), options).unwrap();
    (report, link)
}

fn text<'a>(report: &'a CheckReport, name: &str) -> &'a str {
    let item = report.items.iter().find(|item| item.name == name);
    item.map_or("", |item| &item.text)
}

#[test]
fn every_embedded_motor_passes_the_pulse_and_is_at_rest_after_it() {
    let bench = BenchFile::embedded_default();
    for emulator in [
        "zk-22fc-plain",
        "zk-22fc-hidden",
        "zk-22fc-viscous",
        "zk-22fc-fan",
        "zk-22fc-brushes",
        "zk-22fc-warming",
    ] {
        let (report, link) = moved(emulator, |_| {}, &bench, Waivers::default());
        assert!(report.passed(), "{emulator}: {:?}", report.refusal());
        let plant = link.drive().plant();
        assert!(plant.speed_rad_s().abs() < 1.0 && plant.current_a().abs() < 0.2);
        assert!(plant.angle_rad().abs() < 3.0, "{}", plant.angle_rad());
        assert!(text(&report, "direction").contains("one way and back"));
        let ratios = text(&report, "plausibility");
        assert!(
            ratios.contains("forward back-EMF constant 0.3") && ratios.contains("back resistance"),
            "{ratios}"
        );
        assert!(report.waived.is_empty());
    }
}

#[test]
fn every_hidden_effect_of_every_mystery_passes_the_pulse() {
    let bench = BenchFile::embedded_default();
    for seed in 0..60 {
        let config = crate::emulator::mystery::draw(seed).config;
        let (report, _) = moved(
            "zk-22fc-plain",
            |plain| *plain = config.clone(),
            &bench,
            Waivers::default(),
        );
        assert!(
            report.passed(),
            "seed {seed}, {:?}: {:?}",
            config.hidden,
            report.refusal()
        );
    }
}

#[test]
fn a_broken_machine_is_refused_with_its_name() {
    type Case = (&'static str, fn(&mut EmulatorConfig), &'static str);
    let bench = BenchFile::embedded_default();
    let cases: [Case; 4] = [
        (
            "reversed",
            |config| config.faults.encoder_reversed = true,
            "encoder reversed",
        ),
        (
            "frozen",
            |config| config.faults.encoder_frozen_from_s = Some(0.0),
            "encoder frozen or not connected",
        ),
        (
            "locked",
            |config| config.faults.locked_rotor = true,
            "the shaft is held",
        ),
        (
            "open",
            |config| config.faults.open_phase = true,
            "open armature circuit",
        ),
    ];
    for (name, fault, words) in cases {
        let (report, link) = moved("zk-22fc-plain", fault, &bench, Waivers::default());
        let refusal = report.refusal().unwrap();
        assert_eq!(refusal.name, "direction", "{name}");
        assert!(refusal.text.contains(words), "{name}: {}", refusal.text);
        assert!(refusal.help.is_some());
        // Found within some per cent of the rated speed (LINKS.md 5.3: 36).
        assert!(link.drive().plant().angle_rad().abs() < 6.0, "{name}");
        let waived = Waivers {
            direction: true,
            ..Waivers::default()
        };
        let (report, link) = moved("zk-22fc-plain", fault, &bench, waived);
        assert!(report.passed(), "{:?}", report.refusal());
        assert_eq!(report.waived, ["plausibility", "direction"]);
        assert!(
            link.drive().plant().angle_rad().abs() < 1e-12,
            "nothing moved"
        );
    }
}

#[test]
fn a_nameplate_in_other_units_or_of_another_motor_is_refused_unless_waived() {
    let mut bench = BenchFile::embedded_default();
    bench.motor.back_emf_v_s_per_rad = Some(0.3538 / crate::units::rpm_from_rad_s(1.0));
    let (report, _) = moved("zk-22fc-plain", |_| {}, &bench, Waivers::default());
    let refusal = report.refusal().unwrap();
    assert_eq!(refusal.name, "plausibility");
    assert!(
        refusal.text.contains("factor 9.549") && refusal.text.contains("V per r/min"),
        "{}",
        refusal.text
    );
    let waived = Waivers {
        plausibility: true,
        ..Waivers::default()
    };
    let (report, _) = moved("zk-22fc-plain", |_| {}, &bench, waived);
    assert!(report.passed());
    assert_eq!(report.waived, ["plausibility"]);
    assert!(text(&report, "plausibility").starts_with("WAIVED"));
    let mut bench = BenchFile::embedded_default();
    bench.motor.resistance_ohm = Some(12.0);
    let (report, _) = moved("zk-22fc-plain", |_| {}, &bench, Waivers::default());
    let refusal = report.refusal().unwrap();
    assert_eq!(refusal.name, "plausibility", "{}", refusal.text);
    assert!(refusal.text.contains("another motor"), "{}", refusal.text);
}

#[test]
fn a_vertical_load_is_not_moved_without_its_brake_and_held_with_it() {
    let mut bench = BenchFile::embedded_default();
    bench.load.vertical = true;
    let vertical = |config: &mut EmulatorConfig| {
        *config = EmulatorConfig::parse(
            "vertical",
            &format!(
                "{}\n[brake]\nrelease_s = 0.1\napply_s = 0.1\n[[hidden]]\nid = \"constant_load\"\nconstant_n_m = 0.8\n",
                include_str!("../../../bench-configs/emulators/zk-22fc-plain.toml")
            ),
        )
        .unwrap();
    };
    let (report, link) = moved("zk-22fc-plain", vertical, &bench, Waivers::default());
    let refusal = report.refusal().unwrap();
    assert_eq!(refusal.name, "load");
    assert!(
        refusal.text.contains("load.hold_current_a"),
        "{}",
        refusal.text
    );
    assert!(link.drive().plant().angle_rad().abs() < 1e-12);
    bench.load.hold_current_a = Some(0.8 / 0.3538);
    bench.load.brake_release_s = Some(0.2);
    bench.load.brake_apply_s = Some(0.2);
    let (report, link) = moved("zk-22fc-plain", vertical, &bench, Waivers::default());
    assert!(report.passed(), "{:?}", report.refusal());
    let angle = link.drive().plant().angle_rad();
    assert!(angle.abs() < 3.0, "{angle} rad: the load fell");
}

#[test]
fn real_hardware_is_moved_only_after_the_word() {
    let bench = BenchFile::embedded_default();
    let mut drive = ScriptedDrive::new(0.01);
    drive.is_emulator = false;
    let profile = DriveProfile::named("own").unwrap();
    let plate = bench.nameplate().unwrap();
    let beside_a_screen = CheckOptions {
        hardware_allowed: true,
        waivers: Waivers {
            watchdog: true,
            ..Waivers::default()
        },
        first_move: Some(FirstMove {
            plate: &plate,
            profile: &profile,
            stopped: &|| false,
        }),
        ..options()
    };
    let report = scripted(drive, beside_a_screen).unwrap();
    let refusal = report.refusal().unwrap();
    assert_eq!(refusal.name, "direction");
    assert!(refusal.help.unwrap().contains("--hardware"));
}

#[test]
fn a_panic_within_the_pulse_leaves_the_output_off() {
    let bench = BenchFile::embedded_default();
    let profile = DriveProfile::named("own").unwrap();
    let plate = bench.nameplate().unwrap();
    let mut clock = VirtualClock::new();
    let drive = SoftDrive::new(&EmulatorConfig::embedded("zk-22fc-plain").unwrap(), 3);
    let mut link = MemoryLink::new(drive, clock.clone(), Latency::default());
    let cycles = AtomicU32::new(0);
    let bomb = || {
        assert!(cycles.fetch_add(1, Ordering::Relaxed) < 30, "boom");
        false
    };
    let asked = CheckOptions {
        first_move: Some(FirstMove {
            plate: &plate,
            profile: &profile,
            stopped: &bomb,
        }),
        ..options()
    };
    let limits = bench.limits();
    let result = catch_unwind(AssertUnwindSafe(|| {
        check(&mut link, &mut clock, &limits, asked).map(|_| ())
    }));
    assert!(result.is_err(), "the pulse has more than 30 cycles");
    // Long before the drive's watchdog of 0.5 s, and five time constants of the winding.
    link.advance_to(clock.now_s() + 0.05);
    let plant = link.drive().plant();
    assert!(plant.current_a() < 0.1, "{} A", plant.current_a());
    assert_ne!(format!("{:?}", link.drive().state()), "Running");
}

#[test]
fn the_user_s_stop_ends_the_pulse_and_a_field_below_its_least_is_refused_before_it() {
    let bench = BenchFile::embedded_default();
    let profile = DriveProfile::named("own").unwrap();
    let plate = bench.nameplate().unwrap();
    let mut clock = VirtualClock::new();
    let drive = SoftDrive::new(&EmulatorConfig::embedded("zk-22fc-plain").unwrap(), 3);
    let mut link = MemoryLink::new(drive, clock.clone(), Latency::default());
    let asked = CheckOptions {
        first_move: Some(FirstMove {
            plate: &plate,
            profile: &profile,
            stopped: &|| true,
        }),
        ..options()
    };
    let report = check(&mut link, &mut clock, &bench.limits(), asked).unwrap();
    assert_eq!(report.refusal().unwrap().text, "stopped by the user");
    assert!(link.drive().plant().angle_rad().abs() < 1e-12);
    let limits = Limits {
        field_min_a: Some(0.3),
        ..bench.limits()
    };
    let report = check(&mut link, &mut clock, &limits, asked).unwrap();
    assert_eq!(report.refusal().unwrap().name, "field");
}

fn scripted(
    mut drive: ScriptedDrive,
    options: CheckOptions<'_>,
) -> Result<CheckReport, CheckError> {
    let limits = BenchFile::embedded_default().limits();
    let result = check(&mut drive, &mut VirtualClock::new(), &limits, options);
    let asked = u32::from(!drive.demands.is_empty());
    assert_eq!(drive.stops, asked, "the output is off whatever was found");
    result
}

#[test]
fn the_emulated_drive_passes_every_check_with_figures() {
    let report = emulated(Latency::default(), options());
    assert!(report.passed(), "{:?}", report.refusal());
    let names: Vec<&str> = report.items.iter().map(|item| item.name).collect();
    assert_eq!(
        names,
        [
            "identity",
            "limits",
            "link",
            "standstill",
            "watchdog",
            "direction"
        ]
    );
    assert!(text(&report, "direction").contains("the motor is not known"));
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
        waivers: Waivers {
            watchdog: true,
            ..Waivers::default()
        },
        ..options()
    };
    let report = scripted(ScriptedDrive::new(0.01), waived).unwrap();
    assert!(report.passed() && report.watchdog_proven_s.is_none());
    assert_eq!(report.waived, ["watchdog"]);
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
fn a_shaft_that_coasts_is_waited_for_and_not_counted_as_noise() {
    let waived = CheckOptions {
        waivers: Waivers {
            watchdog: true,
            ..Waivers::default()
        },
        ..options()
    };
    let drive = ScriptedDrive::new(0.01).with(0, 30, Fault::Set(Channel::Speed, 50.0));
    let report = scripted(drive, waived).unwrap();
    assert!(report.passed(), "{:?}", report.refusal());
    assert!(text(&report, "link").contains("0 lost"));
    let speed = report.noise.iter().find(|f| f.channel == Channel::Speed);
    assert!(speed.unwrap().std < 1e-9, "{speed:?}");
    // One that begins to move later is no noise either.
    let drive = ScriptedDrive::new(0.01).with(20, 30, Fault::Set(Channel::Speed, 50.0));
    let report = scripted(drive, waived).unwrap();
    let refusal = report.refusal().unwrap();
    assert!(
        refusal.text.contains("moves with the output off: speed 50"),
        "{}",
        refusal.text
    );
}

#[test]
fn what_moves_at_zero_is_stopped_with_the_first_sample_that_shows_it_and_never_waived() {
    let waived = || CheckOptions {
        waivers: Waivers {
            watchdog: true,
            ..Waivers::default()
        },
        ..options()
    };
    let limits = BenchFile::embedded_default().limits();
    let mut calm = ScriptedDrive::new(0.01);
    check(&mut calm, &mut VirtualClock::new(), &limits, waived()).unwrap();
    let asked = calm.demands.len();
    let first = calm.demands.iter().position(|d| d.energises()).unwrap();
    for (at, fault) in [
        (first, Fault::Set(Channel::Speed, 10.2)),
        (first + 3, Fault::Set(Channel::Speed, -10.2)),
        (first + 3, Fault::Set(Channel::Current, 11.2)),
        // The last look is the one after the silence.
        (asked - 1, Fault::Set(Channel::Speed, 10.2)),
    ] {
        let words = format!("{at} {fault:?}");
        let from = u64::try_from(at).unwrap();
        let mut drive = ScriptedDrive::new(0.01).with(from, u64::MAX, fault);
        let report = check(&mut drive, &mut VirtualClock::new(), &limits, waived()).unwrap();
        let refusal = report.refusal().expect(&words);
        assert_eq!(refusal.name, "watchdog");
        assert!(
            refusal
                .text
                .starts_with("the shaft moved at zero reference"),
            "{words}: {}",
            refusal.text
        );
        assert_eq!(
            drive.demands.len(),
            at + 1,
            "{words}: nothing was sent after it"
        );
        assert_eq!(drive.stops, 1);
    }
}

#[test]
fn a_rate_that_the_line_cannot_carry_is_refused_without_asking_anything() {
    let mut drive = ScriptedDrive::new(0.01);
    drive.shortest_cycle_s = Some(0.02);
    let limits = BenchFile::embedded_default().limits();
    let report = check(&mut drive, &mut VirtualClock::new(), &limits, options()).unwrap();
    let refusal = report.refusal().unwrap();
    assert_eq!(refusal.name, RATE_CHECK);
    assert!(
        refusal
            .text
            .contains("at most 50 Hz at its baud rate, asked 100 Hz"),
        "{}",
        refusal.text
    );
    assert!(drive.demands.is_empty());
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

#[test]
fn a_fault_of_real_hardware_is_not_reset_before_somebody_said_that_it_may_move() {
    let mut drive = ScriptedDrive::new(0.01);
    drive.is_emulator = false;
    let mut clock = VirtualClock::new();
    let asked = CheckOptions {
        reset_fault: true,
        ..options()
    };
    let limits = BenchFile::embedded_default().limits();
    let report = check(&mut drive, &mut clock, &limits, asked).unwrap();
    assert_eq!(report.refusal().unwrap().name, "identity");
    assert!(drive.demands.is_empty() && drive.stops == 0);
}

#[test]
fn a_latched_fault_is_cleared_where_that_is_asked_for_and_the_checks_go_on() {
    let limits = BenchFile::embedded_default().limits();
    for reset_fault in [false, true] {
        let mut clock = VirtualClock::new();
        let drive = SoftDrive::new(&EmulatorConfig::embedded("zk-22fc-plain").unwrap(), 3);
        let mut link = MemoryLink::new(drive, clock.clone(), Latency::default());
        // A host that was killed while the drive ran: its watchdog has tripped.
        let left = Command {
            seq: 1,
            demand: Demand::Voltage(0.0),
        };
        link.exchange(left).unwrap();
        clock.set_time_s(1.0);
        let asked = CheckOptions {
            reset_fault,
            ..options()
        };
        let report = check(&mut link, &mut clock, &limits, asked).unwrap();
        if reset_fault {
            assert!(report.passed(), "{:?}", report.refusal());
            assert_eq!(text(&report, "reset"), "the drive is without a fault");
        } else {
            assert_eq!(report.refusal().unwrap().text, "the drive is in fault");
        }
    }
}
