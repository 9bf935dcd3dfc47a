//! The checks over the emulated drive, over a scripted one, on a laptop that stands still now and then, and before a drive
//! of another make, of which the profile may be wrong about the set-points.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use super::*;
use crate::bench_file::BenchFile;
use crate::limits::Nameplate;
use crate::testing::{Fault, ScriptedDrive, Stalls, exact, gone, has, in_memory, near, within};
use drivebench_emulator::{
    EmulatorConfig, FaultsConfig, ForeignBus, ForeignDrive, Guise, Latency, MemoryLink, SoftDrive,
    VirtualClock, mystery,
};
use drivebench_link::{CommandTimes, ProfiledLink, RegisterBus};

const NONE: Waivers = Waivers { watchdog: false, direction: false, plausibility: false };
const NO_WATCHDOG: Waivers = Waivers { watchdog: true, ..NONE };

/// Without a first move, as for a motor that is not known.
fn options() -> CheckOptions<'static> {
    CheckOptions {
        rate_hz: 100.0,
        hardware_allowed: false,
        hardware_said: false,
        waivers: NONE,
        first_move: None,
        stopped: &|| false,
        reset_fault: false,
    }
}

fn asking(change: impl FnOnce(&mut CheckOptions<'static>)) -> CheckOptions<'static> {
    let mut options = options();
    change(&mut options);
    options
}

fn waived() -> CheckOptions<'static> {
    asking(|options| options.waivers = NO_WATCHDOG)
}

fn limits() -> Limits {
    BenchFile::embedded_default().limits()
}

/// Plate and profile of a first move on our own drive.
fn plain() -> (Nameplate, DriveProfile) {
    let plate = BenchFile::embedded_default().nameplate().unwrap();
    (plate, DriveProfile::named("own").unwrap())
}

/// With the first move on this plate and drive.
fn moving(first: &(Nameplate, DriveProfile)) -> CheckOptions<'_> {
    stopped_by(&|| false, first)
}

/// The same with somebody who may ask to stop.
fn stopped_by<'a>(
    stopped: &'a (dyn Fn() -> bool + Send + Sync),
    (plate, profile): &'a (Nameplate, DriveProfile),
) -> CheckOptions<'a> {
    CheckOptions {
        first_move: Some(FirstMove { plate, profile, is_withheld: false }),
        stopped,
        ..options()
    }
}

fn emulated(latency: Latency) -> CheckReport {
    let mut clock = VirtualClock::new();
    let drive = SoftDrive::new(&EmulatorConfig::embedded_default(), 3);
    let mut link = MemoryLink::new(drive, clock.clone(), latency);
    let report = check(&mut link, &mut clock, &limits(), options()).unwrap();
    within(link.drive().plant().speed_rad_s().abs(), ..1.0);
    report
}

/// A bench over a software drive, with the first move.
fn moved(
    config: &EmulatorConfig,
    bench: &BenchFile,
    waivers: Waivers,
) -> (CheckReport, MemoryLink) {
    let (mut link, mut clock) = in_memory(config, 3);
    let first = (bench.nameplate().unwrap(), plain().1);
    let options = CheckOptions { waivers, ..moving(&first) };
    let report = check(&mut link, &mut clock, &bench.limits(), options).unwrap();
    (report, link)
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

/// The check of this name refused, in these words.
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
        let (refusal, hidden) = (report.refusal(), &config.hidden);
        assert!(report.passed(), "seed {seed}, {hidden:?}: {refusal:?}");
    }
}

#[test]
fn a_broken_machine_is_refused_with_its_name() {
    type Case = (fn(&mut FaultsConfig), &'static str);
    let frozen = "encoder frozen or not connected";
    let bench = BenchFile::embedded_default();
    let cases: [Case; 4] = [
        (|faults| faults.encoder_reversed = true, "encoder reversed"),
        (|faults| faults.encoder_frozen_from_s = Some(0.0), frozen),
        (|faults| faults.locked_rotor = true, "the shaft is held"),
        (|faults| faults.open_phase = true, "open armature circuit"),
    ];
    for (fault, words) in cases {
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
fn real_hardware_is_moved_only_after_the_word() {
    let mut drive = ScriptedDrive::new(0.01);
    drive.is_emulator = false;
    let first = plain();
    let beside_a_screen =
        CheckOptions { hardware_allowed: true, waivers: NO_WATCHDOG, ..moving(&first) };
    let report = scripted(drive, beside_a_screen).unwrap();
    refuses(&report, "direction", "");
    has(report.refusal().unwrap().help.unwrap(), "--hardware");
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
    let asked = stopped_by(&bomb, &first);
    let checked = AssertUnwindSafe(|| check(&mut link, &mut clock, &limits(), asked).map(|_| ()));
    let result = catch_unwind(checked);
    assert!(result.is_err(), "the pulse has more than 30 cycles");
    // Long before the drive's watchdog of 0.5 s, and five time constants of the winding.
    link.advance_to(clock.now_s() + 0.05);
    within(link.drive().plant().current_a(), ..0.1);
    assert_ne!(format!("{:?}", link.drive().state()), "Running");
}

#[test]
fn a_stop_ends_the_pulse_and_a_weak_field_precedes_it() {
    let first = plain();
    let (mut link, mut clock) = in_memory(&emulator("zk-22fc-plain"), 3);
    let asked = stopped_by(&|| true, &first);
    let stopped = check(&mut link, &mut clock, &limits(), asked);
    assert!(matches!(stopped, Err(CheckError::Stopped)), "{stopped:?}");
    turned_less(&link, 1e-12);
    let limits = Limits { field_min_a: Some(0.3), ..limits() };
    let report = check(&mut link, &mut clock, &limits, asked).unwrap();
    refuses(&report, "field", "");
}

fn scripted(
    mut drive: ScriptedDrive,
    options: CheckOptions<'_>,
) -> Result<CheckReport, CheckError> {
    let result = check(&mut drive, &mut VirtualClock::new(), &limits(), options);
    let asked = u32::from(!drive.demands.is_empty());
    assert_eq!(drive.stops, asked, "the output is off whatever was found");
    result
}

/// The checks before a scripted drive that a test looks at afterwards.
fn checked(drive: &mut ScriptedDrive, options: CheckOptions<'_>) -> CheckReport {
    check(drive, &mut VirtualClock::new(), &limits(), options).unwrap()
}

fn faulty(from: u64, to: u64, fault: Fault) -> ScriptedDrive {
    ScriptedDrive::new(0.01).with(from, to, fault)
}

#[test]
fn the_emulated_drive_passes_every_check_with_figures() {
    let report = emulated(Latency::default());
    passes(&report);
    let names: Vec<&str> = report.items.iter().map(|item| item.name).collect();
    let order = "identity limits link standstill watchdog direction";
    assert_eq!(names.join(" "), order);
    has(text(&report, "direction"), "the motor is not known");
    near(report.round_trip_p50_s, 0.0073, 1e-6);
    near(report.reachable_rate_hz, 137.0, 1.0);
    near(report.watchdog_proven_s.unwrap(), 0.76, 1e-9);
    // The emulator's sensor has 0.15 rad/s.
    within(speed_noise(&report), 0.1..0.2);
    assert!(report.signals.contains(&Channel::Current));
}

fn speed_noise(report: &CheckReport) -> f64 {
    let mut floors = report.noise.iter();
    let speed = floors.find(|floor| floor.channel == Channel::Speed);
    speed.unwrap().std
}

#[test]
fn a_slow_link_is_refused_with_its_rate() {
    let report = emulated(Latency { request_s: 0.01, reply_s: 0.01 });
    refuses(&report, "link", "reaches 50 Hz, asked 100 Hz");
    assert_eq!(report.items.len(), 3, "nothing is tried after a refusal");
}

#[test]
fn a_drive_whose_watchdog_does_nothing_is_refused_unless_waived() {
    let report = scripted(ScriptedDrive::new(0.01), options()).unwrap();
    refuses(&report, "watchdog", "silence");
    let report = scripted(ScriptedDrive::new(0.01), waived()).unwrap();
    assert!(report.passed() && report.watchdog_proven_s.is_none());
    assert_eq!(report.waived, ["watchdog"]);
}

#[test]
fn a_wrong_watchdog_is_refused_without_energising() {
    for watchdog_s in [None, Some(0.0), Some(1.5), Some(f64::NAN)] {
        let mut drive = ScriptedDrive::new(0.01);
        drive.watchdog_s = watchdog_s;
        refuses(&checked(&mut drive, options()), "watchdog", "");
        assert!(drive.demands.iter().all(|demand| !demand.energises()));
    }
}

#[test]
fn a_shaft_that_turns_and_a_drive_in_fault_are_refused() {
    for fault in [Fault::Set(Channel::Speed, 30.0), Fault::TripWith(2)] {
        let report = scripted(faulty(0, u64::MAX, fault), options()).unwrap();
        refuses(&report, "standstill", "");
    }
}

#[test]
fn a_shaft_that_coasts_is_waited_for_and_not_counted_as_noise() {
    let turns = Fault::Set(Channel::Speed, 50.0);
    let report = scripted(faulty(0, 30, turns.clone()), waived()).unwrap();
    passes(&report);
    has(text(&report, "link"), "0 lost");
    within(speed_noise(&report), ..1e-9);
    // One that begins to move later is no noise either.
    let report = scripted(faulty(20, 30, turns), waived()).unwrap();
    refuses(&report, "standstill", "moves with the output off: speed 50");
}

#[test]
fn motion_at_zero_output_stops_at_the_first_sample() {
    let mut calm = ScriptedDrive::new(0.01);
    checked(&mut calm, waived());
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
        let mut drive = faulty(u64::try_from(at).unwrap(), u64::MAX, fault);
        let report = checked(&mut drive, waived());
        let refusal = report.refusal().expect(&words);
        assert_eq!(refusal.name, "watchdog");
        let (says, sent) = (&refusal.text, drive.demands.len());
        let is_named = says.starts_with("the shaft moved at zero reference");
        assert!(is_named, "{words}: {says}");
        assert_eq!(sent, at + 1, "{words}: nothing was sent after it");
        assert_eq!(drive.stops, 1);
    }
}

#[test]
fn a_rate_beyond_the_line_is_refused_without_a_request() {
    let mut drive = ScriptedDrive::new(0.01);
    drive.shortest_cycle_s = Some(0.02);
    let report = checked(&mut drive, options());
    let words = "at most 50 Hz at its baud rate, asked 100 Hz";
    refuses(&report, RATE_CHECK, words);
    assert!(drive.demands.is_empty());
}

#[test]
fn hardware_needs_to_be_allowed() {
    for hardware_allowed in [false, true] {
        let mut drive = ScriptedDrive::new(0.01);
        drive.is_emulator = false;
        let asked = asking(|options| options.hardware_allowed = hardware_allowed);
        let report = scripted(drive, asked).unwrap();
        let is_by_identity = report.refusal().unwrap().name == "identity";
        assert_eq!(is_by_identity, !hardware_allowed);
    }
}

#[test]
fn a_silent_drive_is_a_link_error_and_a_lossy_one_a_refusal() {
    let silent = scripted(faulty(0, u64::MAX, Fault::Timeout), options());
    let is_timeout = matches!(silent, Err(CheckError::Link(LinkError::Timeout { .. })));
    assert!(is_timeout, "{silent:?}");
    let report = scripted(faulty(5, 15, Fault::Timeout), options()).unwrap();
    refuses(&report, "link", "10 lost");
}

#[test]
fn nothing_is_energised_after_a_stop_request() {
    let mut drive = ScriptedDrive::new(0.01);
    let asked = asking(|options| options.stopped = &|| true);
    let stopped = check(&mut drive, &mut VirtualClock::new(), &limits(), asked);
    assert!(matches!(stopped, Err(CheckError::Stopped)), "{stopped:?}");
    assert!(drive.stops == 1 && !drive.demands.iter().any(|demand| demand.energises()));
    near(drive.bound_s, limits().link_silence_s, 1e-12);
}

#[test]
fn a_stop_that_fails_is_said_beside_what_had_ended_the_checks() {
    let mut drive = faulty(0, u64::MAX, Fault::NeverRuns);
    drive.stop_fails = Some(gone);
    let error = scripted(drive, options()).unwrap_err();
    has(&error, "watchdog: the drive does not run at zero");
    has(&error, "stop NOT confirmed by the drive");
    has(error.help(), "shaft stands still");
}

#[test]
fn a_hardware_fault_is_reset_only_with_permission() {
    let mut drive = ScriptedDrive::new(0.01);
    drive.is_emulator = false;
    let asked = asking(|options| options.reset_fault = true);
    refuses(&checked(&mut drive, asked), "identity", "");
    assert!(drive.demands.is_empty() && drive.stops == 0);
}

#[test]
fn a_latched_fault_is_reset_on_request() {
    for reset_fault in [false, true] {
        let (mut link, mut clock) = in_memory(&emulator("zk-22fc-plain"), 3);
        // A host that was killed while the drive ran: its watchdog has tripped.
        let (seq, demand) = (1, Demand::Voltage(0.0));
        link.exchange(Command { seq, demand }).unwrap();
        clock.set_time_s(1.0);
        let asked = asking(|options| options.reset_fault = reset_fault);
        let report = check(&mut link, &mut clock, &limits(), asked).unwrap();
        if reset_fault {
            passes(&report);
            assert_eq!(text(&report, "reset"), "the drive is without a fault");
        } else {
            assert_eq!(report.refusal().unwrap().text, "the drive is in fault");
        }
    }
}

/// The checks at `rate_hz` with the watchdog waived, before a drive that may take 2 s to run.
fn patient(drive: &mut ScriptedDrive, rate_hz: f64) -> CheckReport {
    drive.times.enable_s = 2.0;
    let asked = CheckOptions { rate_hz, ..waived() };
    checked(drive, asked)
}

#[test]
fn a_drive_that_takes_its_time_to_run_passes_at_a_high_rate_too() {
    let mut prompt = ScriptedDrive::new(0.001);
    patient(&mut prompt, 1000.0);
    let demands = prompt.demands.iter();
    let first = demands.take_while(|demand| !demand.energises()).count() as u64;
    let mut slow = ScriptedDrive::new(0.001).with(first, first + 1500, Fault::NeverRuns);
    passes(&patient(&mut slow, 1000.0));
}

#[test]
fn a_drive_that_never_runs_is_given_up_in_time() {
    for rate_hz in [4.0, 100.0, 1000.0] {
        let mut drive = ScriptedDrive::new(1.0 / rate_hz).with(0, u64::MAX, Fault::NeverRuns);
        let report = patient(&mut drive, rate_hz);
        let times = CommandTimes { enable_s: 2.0, ..CommandTimes::default() };
        let waited_s = times.polled_every(1.0 / rate_hz).enable_s;
        let words = format!("the drive does not run at zero within {waited_s:.2} s");
        assert_eq!(report.refusal().unwrap().text, words);
        let asked = drive.demands.iter().filter(|d| d.energises()).count() as f64;
        near(asked, waited_s * rate_hz, 1.5);
    }
}

/// Below the silence that is allowed and the drive's watchdog.
const STALLS: Stalls = Stalls { share: 0.03, longest_s: 0.2 };

#[test]
fn a_good_machine_is_not_refused_because_the_laptop_stood_still() {
    let config = emulator("zk-22fc-plain");
    let first = plain();
    for rate_hz in [20.0, 50.0, 100.0] {
        let options = CheckOptions { rate_hz, ..moving(&first) };
        let refused = |seed| {
            let (mut link, mut clock) = STALLS.at(&config, seed);
            let report = check(&mut link, &mut clock, &limits(), options).unwrap();
            // A line that loses a tenth of its replies is refused as such, and rightly.
            let refusal = report.refusal().filter(|item| item.name != "link")?;
            Some(format!("{seed}: {}: {}", refusal.name, refusal.text))
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

struct Table {
    link: ProfiledLink<ForeignBus>,
    clock: VirtualClock,
    host: DriveProfile,
}

impl Table {
    /// A host with one profile at a servo amplifier.
    fn new(host: DriveProfile) -> Self {
        let guise = Guise::of(&servo("high_first", "0.1")).unwrap();
        let clock = VirtualClock::new();
        let drive = ForeignDrive::new(&guise, &exact("zk-22fc-plain"), 1);
        let bus = ForeignBus::new(drive, &guise, clock.clone());
        let link = ProfiledLink::new(Arc::clone(host.registers.as_ref().unwrap()), bus);
        Self { link, clock, host }
    }

    /// With the profile of the drive.
    fn right() -> Self {
        Self::new(servo("high_first", "0.1"))
    }

    fn check(&mut self, reset_fault: bool) -> CheckReport {
        let limits = Limits { link_silence_s: 1.0, bus_min_v: None, bus_max_v: None, ..limits() };
        let first = (plain().0, self.host.clone());
        let options =
            CheckOptions { rate_hz: 15.0, waivers: NO_WATCHDOG, reset_fault, ..moving(&first) };
        check(&mut self.link, &mut self.clock, &limits, options).unwrap()
    }

    fn is_running(&self) -> bool {
        self.link.bus().drive().is_running()
    }
}

#[test]
fn a_right_set_point_passes_at_rest_and_in_the_pulse() {
    let mut table = Table::right();
    let report = table.check(false);
    passes(&report);
    let compared = text(&report, "set-points");
    assert_eq!(compared, "speed_ref read back as written");
    assert!(!table.is_running());
}

#[test]
fn a_wrong_word_order_or_scale_of_speed_stops_the_pulse() {
    let high = "high_first";
    for (order, scale) in [("low_first", "0.1"), (high, "0.01"), (high, "1.0")] {
        let mut table = Table::new(servo(order, scale));
        let report = table.check(false);
        let refusal = &report.refusal().unwrap().text;
        has(format!("{order} {scale}: {refusal}"), "asked ");
        has(refusal, "word order or scale of speed_ref right?");
        // A quarter of the rated speed and what a cycle adds.
        let link = &table.link;
        let speed = link.reading("speed").or(link.reading("shaft_speed"));
        assert!(speed.is_none_or(|rpm| rpm.abs() < 1000.0), "{speed:?}");
        assert!(!table.is_running(), "it was stopped");
    }
}

#[test]
fn a_set_point_that_reads_back_otherwise_is_refused_at_rest() {
    let mut table = Table::right();
    let bus = table.link.bus_mut();
    bus.write(16, 0x1026, &[5, 0]).unwrap();
    bus.drive_mut().ignore(Some("speed_ref"));
    let report = table.check(false);
    refuses(&report, "set-points", "setpoint speed_ref was written as");
    assert!(!table.is_running());
}

#[test]
fn a_drive_that_runs_already_is_refused_untouched() {
    for reset_fault in [false, true] {
        let mut table = Table::right();
        let bus = table.link.bus_mut();
        for (address, words) in [(0x0010, &[2][..]), (0x1000, &[1]), (0x1026, &[0, 9990])] {
            bus.write(16, address, words).unwrap();
        }
        table.clock.set_time_s(2.0);
        let report = table.check(reset_fault);
        let words = "the drive is running; who commands it? speed";
        refuses(&report, "standstill", words);
        assert_eq!(report.last_seq, 0, "nothing was asked of it");
        assert!(report.noise.is_empty());
        assert!(table.is_running(), "it is left to who runs it");
    }
}
