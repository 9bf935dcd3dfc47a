//! The checks over the emulated drive, a scripted drive, a host with pauses, and a drive of another make whose profile may be
//! wrong about the set-points.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use super::*;
use crate::bench_file::BenchFile;
use crate::limits::Nameplate;
use crate::testing::{Fault, ScriptedDrive, Stalls, exact, gone, has, in_memory, near, within};
use drivebench_emulator::{
    EmulatorConfig, FaultsConfig, ForeignBus, ForeignDrive, Guise, Latency, MemoryLink, SoftDrive,
    VirtualClock, mystery, open_line,
};
use drivebench_link::{CellBus, CommandTimes, ProfiledLink, Put};

const NONE: Waivers = Waivers { watchdog: false, direction: false, plausibility: false };
const NO_WATCHDOG: Waivers = Waivers { watchdog: true, ..NONE };

/// Without a first move, as for a motor that is not known.
fn options() -> CheckOptions<'static> {
    CheckOptions {
        rate_hz: 100.0,
        hardware_allowed: false,
        hardware_confirmed: false,
        waivers: NONE,
        first_move: None,
        stopped: &|| false,
        reset_fault: false,
    }
}

fn waived() -> CheckOptions<'static> {
    CheckOptions { waivers: NO_WATCHDOG, ..options() }
}

fn limits() -> Limits {
    BenchFile::embedded_default().limits()
}

/// Nameplate and profile of a first move on our own drive.
fn plain() -> (Nameplate, DriveProfile) {
    (BenchFile::embedded_default().nameplate().unwrap(), DriveProfile::named("own").unwrap())
}

/// With the first move on this nameplate and drive.
fn moving(first: &(Nameplate, DriveProfile)) -> CheckOptions<'_> {
    stopped_by(&|| false, first)
}

/// The same with a stop request.
fn stopped_by<'a>(
    stopped: &'a (dyn Fn() -> bool + Send + Sync),
    (nameplate, profile): &'a (Nameplate, DriveProfile),
) -> CheckOptions<'a> {
    CheckOptions {
        first_move: Some(FirstMove { nameplate, profile, is_withheld: false }),
        stopped,
        ..options()
    }
}

/// A bench over an emulated drive, with the first move.
fn moved(
    config: &EmulatorConfig,
    bench: &BenchFile,
    waivers: Waivers,
) -> (CheckReport, MemoryLink) {
    let (mut link, mut clock) = in_memory(config, 3);
    let first = (bench.nameplate().unwrap(), plain().1);
    let options = CheckOptions { waivers, ..moving(&first) };
    (check(&mut link, &mut clock, &bench.limits(), options).unwrap(), link)
}

fn emulator(name: &str) -> EmulatorConfig {
    EmulatorConfig::embedded(name).unwrap()
}

fn text<'a>(report: &'a CheckReport, name: &str) -> &'a str {
    let item = report.items.iter().find(|item| item.name == name);
    item.map_or("", |item| &item.text)
}

#[track_caller]
fn passes(report: &CheckReport) {
    assert!(report.passed(), "{:?}", report.refusal());
}

#[track_caller]
fn refuses(report: &CheckReport, name: &str, words: &str) {
    let refusal = report.refusal().unwrap();
    assert_eq!(refusal.name, name, "{}", refusal.text);
    has(&refusal.text, words);
}

#[track_caller]
fn turned_less(link: &MemoryLink, than_rad: f64) {
    within(link.drive().plant().angle_rad().abs(), ..than_rad);
}

#[test]
fn every_embedded_motor_passes_the_pulse_and_rests() {
    let bench = BenchFile::embedded_default();
    for name in ["plain", "hidden", "viscous", "fan", "brushes", "warming"] {
        let (report, link) = moved(&emulator(&format!("zk-22fc-{name}")), &bench, NONE);
        assert!(report.passed(), "{name}: {:?}", report.refusal());
        let plant = link.drive().plant();
        within(plant.speed_rad_s().abs(), ..1.0);
        within(plant.current_a().abs(), ..0.2);
        turned_less(&link, 3.0);
        has(text(&report, "direction"), "one way and back");
        let ratios = text(&report, "plausibility");
        has(ratios, "forward back-EMF constant 0.3");
        has(ratios, "back resistance");
        assert!(report.waived.is_empty());
    }
}

#[test]
fn every_hidden_effect_of_every_mystery_passes_the_pulse() {
    let bench = BenchFile::embedded_default();
    for seed in 0..60 {
        let config = mystery::draw(seed).config;
        let (report, _) = moved(&config, &bench, NONE);
        assert!(report.passed(), "seed {seed}, {:?}: {:?}", config.hidden, report.refusal());
    }
}

#[test]
fn a_broken_machine_is_refused_with_its_name() {
    type Case = (fn(&mut FaultsConfig), &'static str);
    let bench = BenchFile::embedded_default();
    for (fault, words) in [
        (|faults| faults.encoder_reversed = true, "encoder reversed"),
        (|faults| faults.encoder_frozen_from_s = Some(0.0), "encoder frozen or not connected"),
        (|faults| faults.locked_rotor = true, "the shaft is held"),
        (|faults| faults.open_phase = true, "open armature circuit"),
    ] as [Case; 4]
    {
        let mut config = emulator("zk-22fc-plain");
        fault(&mut config.faults);
        let (report, link) = moved(&config, &bench, NONE);
        refuses(&report, "direction", words);
        assert!(report.refusal().unwrap().help.is_some());
        // Found within some per cent of the rated speed.
        turned_less(&link, 6.0);
        let waived = Waivers { direction: true, ..NONE };
        let (report, link) = moved(&config, &bench, waived);
        passes(&report);
        assert_eq!(report.waived, ["plausibility", "direction"]);
        turned_less(&link, 1e-12);
    }
}

#[test]
fn a_foreign_nameplate_is_refused_unless_waived() {
    let config = emulator("zk-22fc-plain");
    let mut bench = BenchFile::embedded_default();
    bench.motor.back_emf_v_s_per_rad = Some(0.3538 / drivebench_model::units::rpm_from_rad_s(1.0));
    let (report, _) = moved(&config, &bench, NONE);
    refuses(&report, "plausibility", "factor 9.549");
    refuses(&report, "plausibility", "V per r/min");
    let waived = Waivers { plausibility: true, ..NONE };
    let (report, _) = moved(&config, &bench, waived);
    assert!(report.passed());
    assert_eq!(report.waived, ["plausibility"]);
    assert!(text(&report, "plausibility").starts_with("WAIVED"));
    let mut bench = BenchFile::embedded_default();
    bench.motor.resistance_ohm = Some(12.0);
    let (report, _) = moved(&config, &bench, NONE);
    refuses(&report, "plausibility", "another motor");
}

#[test]
fn a_vertical_load_moves_only_with_its_brake() {
    let mut bench = BenchFile::embedded_default();
    bench.load.vertical = true;
    let text = format!(
        "{}\n[brake]\nrelease_s = 0.1\napply_s = 0.1\n[[hidden]]\nid = \"constant_load\"\nconstant_n_m = 0.8\n",
        include_str!("../../../../bench-configs/emulators/zk-22fc-plain.toml")
    );
    let vertical = EmulatorConfig::parse("vertical", &text).unwrap();
    let (report, link) = moved(&vertical, &bench, NONE);
    refuses(&report, "load", "load.hold_current_a");
    turned_less(&link, 1e-12);
    bench.load.hold_current_a = Some(0.8 / 0.3538);
    bench.load.brake_release_s = Some(0.2);
    bench.load.brake_apply_s = Some(0.2);
    let (report, link) = moved(&vertical, &bench, NONE);
    passes(&report);
    // The load did not fall.
    turned_less(&link, 3.0);
}

#[test]
fn a_panic_within_the_pulse_leaves_the_output_off() {
    let first = plain();
    let (mut link, mut clock) = in_memory(&emulator("zk-22fc-plain"), 3);
    let cycles = AtomicU32::new(0);
    let bomb = || {
        assert!(cycles.fetch_add(1, Ordering::Relaxed) < 30, "boom");
        false
    };
    let options = stopped_by(&bomb, &first);
    let checked = AssertUnwindSafe(|| check(&mut link, &mut clock, &limits(), options).map(|_| ()));
    assert!(catch_unwind(checked).is_err(), "the pulse has more than 30 cycles");
    // Long before the drive's watchdog of 0.5 s, and five time constants of the winding.
    link.advance_to(clock.now_s() + 0.05);
    within(link.drive().plant().current_a(), ..0.1);
    assert_ne!(format!("{:?}", link.drive().state()), "Running");
}

#[test]
fn a_stop_ends_the_pulse_and_a_weak_field_precedes_it() {
    let first = plain();
    let (mut link, mut clock) = in_memory(&emulator("zk-22fc-plain"), 3);
    let options = stopped_by(&|| true, &first);
    let stopped = check(&mut link, &mut clock, &limits(), options);
    assert!(matches!(stopped, Err(CheckError::Stopped)), "{stopped:?}");
    turned_less(&link, 1e-12);
    let limits = Limits { field_min_a: Some(0.3), ..limits() };
    refuses(&check(&mut link, &mut clock, &limits, options).unwrap(), "field", "");
}

/// The checks on a scripted drive: the output is off afterwards in every case.
fn checked(
    drive: &mut ScriptedDrive,
    options: CheckOptions<'_>,
) -> Result<CheckReport, CheckError> {
    let result = check(drive, &mut VirtualClock::new(), &limits(), options);
    assert_eq!(drive.stops, u32::from(!drive.demands.is_empty()));
    result
}

fn faulty(from: u64, to: u64, fault: Fault) -> ScriptedDrive {
    ScriptedDrive::new(0.01).with(from, to, fault)
}

/// A drive of 100 Hz with a change.
fn scripted(change: impl FnOnce(&mut ScriptedDrive)) -> ScriptedDrive {
    let mut drive = ScriptedDrive::new(0.01);
    change(&mut drive);
    drive
}

fn hardware() -> ScriptedDrive {
    scripted(|drive| drive.is_emulator = false)
}

fn speed_noise(report: &CheckReport) -> f64 {
    floor(&report.noise, Channel::Speed).1
}

#[test]
fn the_emulated_drive_passes_unless_its_link_is_slow() {
    let emulated = |latency: Latency| {
        let mut clock = VirtualClock::new();
        let drive = SoftDrive::new(&EmulatorConfig::embedded_default(), 3);
        let mut link = MemoryLink::new(drive, clock.clone(), latency);
        let report = check(&mut link, &mut clock, &limits(), options()).unwrap();
        within(link.drive().plant().speed_rad_s().abs(), ..1.0);
        report
    };
    let report = emulated(Latency::default());
    passes(&report);
    let names: Vec<&str> = report.items.iter().map(|item| item.name).collect();
    assert_eq!(names.join(" "), "identity limits link standstill watchdog direction");
    has(text(&report, "direction"), "the motor is not known");
    near(report.round_trip_p50_s, 0.0073, 1e-6);
    near(report.reachable_rate_hz, 137.0, 1.0);
    near(report.watchdog_proven_s.unwrap(), 0.76, 1e-9);
    // The emulator's sensor has 0.15 rad/s.
    within(speed_noise(&report), 0.1..0.2);
    assert!(report.signals.contains(&Channel::Current));
    let report = emulated(Latency { request_s: 0.01, reply_s: 0.01 });
    refuses(&report, "link", "reaches 50 Hz, requested 100 Hz");
    assert_eq!(report.items.len(), 3, "nothing is tried after a refusal");
}

#[test]
fn a_drive_that_is_not_safe_to_energise_is_refused() {
    let turns = Fault::Set(Channel::Speed, 50.0);
    let with_watchdog = |watchdog_s| scripted(|drive| drive.watchdog_s = watchdog_s);
    let slow_line = scripted(|drive| drive.shortest_cycle_s = Some(0.02));
    let reset = CheckOptions { reset_fault: true, ..options() };
    for (mut drive, options, check, words) in [
        (hardware(), options(), "identity", "hardware"),
        (hardware(), reset, "identity", "hardware"),
        (slow_line, options(), RATE_CHECK, "at most 50 Hz at its baud rate, requested 100 Hz"),
        (faulty(5, 15, Fault::Timeout), options(), "link", "10 lost"),
        (faulty(0, u64::MAX, turns.clone()), options(), "standstill", "does not come to rest"),
        // One that begins to move later is no noise either.
        (faulty(20, 30, turns), waived(), "standstill", "with the output off: speed 50"),
        (faulty(0, u64::MAX, Fault::TripWith(2)), options(), "standstill", "in fault"),
        (with_watchdog(None), options(), "watchdog", "no watchdog"),
        (with_watchdog(Some(0.0)), options(), "watchdog", "at most 1 s"),
        (with_watchdog(Some(1.5)), options(), "watchdog", "at most 1 s"),
        (with_watchdog(Some(f64::NAN)), options(), "watchdog", "at most 1 s"),
    ] {
        refuses(&checked(&mut drive, options).unwrap(), check, words);
        assert!(drive.demands.iter().all(|demand| !demand.energises()), "{check}: {words}");
        let is_touched = !["identity", RATE_CHECK].contains(&check);
        assert_eq!(!drive.demands.is_empty(), is_touched, "{check}: {words}");
    }
}

#[test]
fn hardware_is_moved_only_with_the_option() {
    let first = plain();
    let with_a_screen =
        CheckOptions { hardware_allowed: true, waivers: NO_WATCHDOG, ..moving(&first) };
    let report = checked(&mut hardware(), with_a_screen).unwrap();
    refuses(&report, "direction", "");
    has(report.refusal().unwrap().help.unwrap(), "--hardware");
}

#[test]
fn a_drive_whose_watchdog_does_nothing_is_refused_unless_waived() {
    let report = checked(&mut ScriptedDrive::new(0.01), options()).unwrap();
    refuses(&report, "watchdog", "silence");
    let report = checked(&mut ScriptedDrive::new(0.01), waived()).unwrap();
    assert!(report.passed() && report.watchdog_proven_s.is_none());
    assert_eq!(report.waived, ["watchdog"]);
}

#[test]
fn a_coasting_shaft_is_waited_for_and_is_no_noise() {
    let mut drive = faulty(0, 30, Fault::Set(Channel::Speed, 50.0));
    let report = checked(&mut drive, waived()).unwrap();
    passes(&report);
    has(text(&report, "link"), "0 lost");
    within(speed_noise(&report), ..1e-9);
}

#[test]
fn motion_at_zero_output_stops_at_the_first_sample() {
    let mut calm = ScriptedDrive::new(0.01);
    checked(&mut calm, waived()).unwrap();
    let first = calm.demands.iter().position(|d| d.energises()).unwrap();
    for (at, fault) in [
        (first, Fault::Set(Channel::Speed, 10.2)),
        (first + 3, Fault::Set(Channel::Speed, -10.2)),
        (first + 3, Fault::Set(Channel::Current, 11.2)),
        // The sample after the silence.
        (calm.demands.len() - 1, Fault::Set(Channel::Speed, 10.2)),
    ] {
        let mut drive = faulty(at as u64, u64::MAX, fault);
        let report = checked(&mut drive, waived()).unwrap();
        refuses(&report, "watchdog", "the shaft moved at zero reference");
        assert_eq!(drive.demands.len(), at + 1, "nothing was sent after it");
    }
}

#[test]
fn a_silent_drive_and_a_stop_that_fails_are_link_errors() {
    let silent = checked(&mut faulty(0, u64::MAX, Fault::Timeout), options());
    assert!(matches!(silent, Err(CheckError::Link(LinkError::Timeout { .. }))), "{silent:?}");
    let mut drive = faulty(0, u64::MAX, Fault::NeverRuns);
    drive.stop_fails = Some(gone);
    let error = checked(&mut drive, options()).unwrap_err();
    has(&error, "watchdog: the drive does not run at zero");
    has(&error, "stop NOT confirmed by the drive");
    has(error.help(), "shaft stands still");
}

#[test]
fn nothing_is_energised_after_a_stop_request() {
    let mut drive = ScriptedDrive::new(0.01);
    let stopped = checked(&mut drive, CheckOptions { stopped: &|| true, ..options() });
    assert!(matches!(stopped, Err(CheckError::Stopped)), "{stopped:?}");
    assert!(!drive.demands.iter().any(|demand| demand.energises()));
    near(drive.bound_s, limits().link_silence_s, 1e-12);
}

#[test]
fn a_latched_fault_is_reset_on_request() {
    for reset_fault in [false, true] {
        let (mut link, mut clock) = in_memory(&emulator("zk-22fc-plain"), 3);
        // A host that was killed while the drive ran: its watchdog has tripped.
        let (seq, demand) = (1, Demand::Voltage(0.0));
        link.exchange(Command { seq, demand }).unwrap();
        clock.set_time_s(1.0);
        let options = CheckOptions { reset_fault, ..options() };
        let report = check(&mut link, &mut clock, &limits(), options).unwrap();
        if reset_fault {
            passes(&report);
            assert_eq!(text(&report, "reset"), "the drive is without a fault");
        } else {
            assert_eq!(report.refusal().unwrap().text, "the drive is in fault");
        }
    }
}

#[test]
fn the_enable_time_of_a_drive_does_not_depend_on_the_rate() {
    // With the watchdog waived, a drive that may take 2 s to run.
    let check_at = |drive: &mut ScriptedDrive, rate_hz: f64| {
        drive.times.enable_s = 2.0;
        checked(drive, CheckOptions { rate_hz, ..waived() }).unwrap()
    };
    let mut prompt = ScriptedDrive::new(0.001);
    check_at(&mut prompt, 1000.0);
    let first = prompt.demands.iter().take_while(|demand| !demand.energises()).count() as u64;
    let mut slow = ScriptedDrive::new(0.001).with(first, first + 1500, Fault::NeverRuns);
    passes(&check_at(&mut slow, 1000.0));
    for rate_hz in [4.0, 100.0, 1000.0] {
        let mut drive = ScriptedDrive::new(1.0 / rate_hz).with(0, u64::MAX, Fault::NeverRuns);
        let report = check_at(&mut drive, rate_hz);
        let times = CommandTimes { enable_s: 2.0, ..CommandTimes::default() };
        let waited_s = times.polled_every(1.0 / rate_hz).enable_s;
        let words = format!("the drive does not run at zero within {waited_s:.2} s");
        assert_eq!(report.refusal().unwrap().text, words);
        let sent = drive.demands.iter().filter(|demand| demand.energises()).count() as f64;
        near(sent, waited_s * rate_hz, 1.5);
    }
}

#[test]
fn pauses_of_the_host_refuse_no_good_machine() {
    let config = emulator("zk-22fc-plain");
    // Below the silence that is allowed and the drive's watchdog.
    let stalls = || Stalls { share: 0.03, longest_s: 0.2 };
    let first = plain();
    for rate_hz in [20.0, 50.0, 100.0] {
        let options = CheckOptions { rate_hz, ..moving(&first) };
        let refused = |seed| {
            let (mut link, mut clock) = stalls().at(&config, seed);
            let report = check(&mut link, &mut clock, &limits(), options).unwrap();
            // A line that loses a tenth of its replies is refused as such.
            let refusal = report.refusal().filter(|item| item.name != "link")?;
            Some(format!("{seed}: {}", refusal.sentence()))
        };
        let refusals: Vec<String> = (0..200).filter_map(refused).collect();
        assert!(refusals.is_empty(), "{rate_hz} Hz: {refusals:#?}");
    }
}

/// A servo amplifier whose set-point has two registers.
fn servo(order: &str, scale: &str) -> DriveProfile {
    let text = DriveProfile::text("epulse50-dc").unwrap();
    let from = "address = 0x1026\ntype = \"i16\"\n";
    let to = format!(
        "address = 0x1026\ntype = \"i32\"\nreadback = true\nword_order = \"{order}\"\nscale = {scale}\n"
    );
    assert!(text.contains(from));
    DriveProfile::parse("epulse50-dc", &text.replacen(from, &to, 1)).unwrap()
}

/// A host with one profile at that servo amplifier.
struct Host {
    link: ProfiledLink<ForeignBus>,
    clock: VirtualClock,
    profile: DriveProfile,
}

impl Host {
    fn new(profile: DriveProfile) -> Self {
        let guise = Guise::of(&servo("high_first", "0.1")).unwrap();
        let clock = VirtualClock::new();
        let drive = ForeignDrive::new(&guise, &exact("zk-22fc-plain"), 1);
        let bus = ForeignBus::new(drive, &guise, clock.clone());
        let link = ProfiledLink::new(Arc::clone(profile.registers.as_ref().unwrap()), bus);
        Self { link, clock, profile }
    }

    /// With the profile of the drive.
    fn right() -> Self {
        Self::new(servo("high_first", "0.1"))
    }

    fn check(&mut self, reset_fault: bool) -> CheckReport {
        let limits = Limits { link_silence_s: 1.0, bus_min_v: None, bus_max_v: None, ..limits() };
        let first = (plain().0, self.profile.clone());
        let options =
            CheckOptions { rate_hz: 15.0, waivers: NO_WATCHDOG, reset_fault, ..moving(&first) };
        check(&mut self.link, &mut self.clock, &limits, options).unwrap()
    }

    fn is_running(&self) -> bool {
        self.link.bus().drive().is_running()
    }
}

#[test]
fn what_the_drive_states_of_its_motor_is_compared_with_the_nameplate() {
    let profile = DriveProfile::named("vesc-foc").unwrap();
    let guise = Guise::of(&profile).unwrap();
    for (share, remark) in
        [(1.2, ""), (1.5, "; the nameplate differs by more than 30 %: R 1.65 ohm")]
    {
        let mut clock = VirtualClock::new();
        let config = exact("zk-22fc-plain");
        let mut link = open_line(Some(&guise), &config, 1, &profile, clock.clone()).unwrap();
        let mut nameplate = plain().0;
        nameplate.resistance_ohm *= share;
        let first = FirstMove { nameplate: &nameplate, profile: &profile, is_withheld: true };
        let options = CheckOptions { first_move: Some(first), hardware_allowed: true, ..waived() };
        let report = check(link.as_mut(), &mut clock, &limits(), options).unwrap();
        passes(&report);
        let states = "the drive states R 1.1 ohm, L 0.0099 H, Ke 0.3538 V.s/rad between two lines (stored as 0.55, 0.00495, 0.2043)";
        assert_eq!(text(&report, "motor"), format!("{states}{remark}"));
    }
}

#[test]
fn a_field_oriented_drive_is_checked_for_its_phases_and_pole_pairs() {
    type Case<'a> = (&'a DriveProfile, fn(&mut FaultsConfig), &'a str, &'a str);
    let profile = DriveProfile::named("vesc-foc").unwrap();
    let text_of = DriveProfile::text("vesc-foc").unwrap();
    // A drive that is configured for seven times the pole pairs of its motor.
    let configured = text_of.replacen("scale = 0.5\n", "scale = 0.0714285714\n", 1);
    let configured = DriveProfile::parse("vesc-foc", &configured).unwrap();
    let cases: [Case<'_>; 4] = [
        (&profile, |_| {}, "", ""),
        (&profile, |faults| faults.encoder_reversed = true, "direction", "half an electrical turn"),
        (&profile, |faults| faults.locked_rotor = true, "direction", "or two phases are exchanged"),
        (
            &configured,
            |_| {},
            "plausibility",
            "gives 7.00 times too, and the drive's pole pairs are in both: by the nameplate the motor has 0.143 times",
        ),
    ];
    for (far, fault, name, words) in cases {
        let mut clock = VirtualClock::new();
        let mut config = exact("zk-22fc-plain");
        fault(&mut config.faults);
        let guise = Guise::of(far).unwrap();
        let mut link = open_line(Some(&guise), &config, 1, &profile, clock.clone()).unwrap();
        let first = FirstMove { nameplate: &plain().0, profile: &profile, is_withheld: false };
        let options = CheckOptions {
            first_move: Some(first),
            hardware_allowed: true,
            hardware_confirmed: true,
            ..options()
        };
        let report = check(link.as_mut(), &mut clock, &limits(), options).unwrap();
        // Its time-out is proven by its flag.
        within(report.watchdog_proven_s.unwrap(), 1.0..1.6);
        link.stop().unwrap();
        if words.is_empty() {
            passes(&report);
        } else {
            refuses(&report, name, words);
        }
    }
}

#[test]
fn a_right_set_point_passes_at_rest_and_in_the_pulse() {
    let mut host = Host::right();
    let report = host.check(false);
    passes(&report);
    assert_eq!(text(&report, "set-points"), "speed_ref read back as written");
    assert!(!host.is_running());
}

#[test]
fn a_wrong_word_order_or_scale_of_speed_stops_the_pulse() {
    let high = "high_first";
    for (order, scale) in [("low_first", "0.1"), (high, "0.01"), (high, "1.0")] {
        let mut host = Host::new(servo(order, scale));
        let report = host.check(false);
        let refusal = &report.refusal().unwrap().text;
        has(format!("{order} {scale}: {refusal}"), "word order or scale of speed_ref right?");
        // A quarter of the rated speed, and the increase within one cycle.
        let link = &host.link;
        let speed = link.reading("speed").or(link.reading("shaft_speed"));
        assert!(speed.is_none_or(|rpm| rpm.abs() < 1000.0), "{speed:?}");
        assert!(!host.is_running(), "it was stopped");
    }
}

#[test]
fn a_set_point_with_another_readback_is_refused_at_rest() {
    let mut host = Host::right();
    let bus = host.link.bus_mut();
    bus.write(Put { function: 16, address: 0x1026, cells: &[5, 0] }).unwrap();
    bus.drive_mut().ignore(Some("speed_ref"));
    refuses(&host.check(false), "set-points", "setpoint speed_ref was written as");
    assert!(!host.is_running());
}

#[test]
fn a_drive_that_runs_already_is_refused_untouched() {
    for reset_fault in [false, true] {
        let mut host = Host::right();
        let bus = host.link.bus_mut();
        for (address, words) in [(0x0010, &[2][..]), (0x1000, &[1]), (0x1026, &[0, 9990])] {
            bus.write(Put { function: 16, address, cells: words }).unwrap();
        }
        host.clock.set_time_s(2.0);
        let report = host.check(reset_fault);
        refuses(&report, "standstill", "the drive is running; who commands it? speed");
        assert_eq!(report.last_seq, 0, "no command was sent");
        assert!(report.noise.is_empty());
        assert!(host.is_running(), "it is left to the other master");
    }
}
