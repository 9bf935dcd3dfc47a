//! Every profile commissioned against its emulated drive, in virtual time, as far as its signals allow.

mod stamps;
mod states;
mod trial;

use super::*;
use crate::drive::{DriveLink, LinkError, ProfiledLink, RegisterBus};
use crate::emulator::VirtualClock;
use crate::sample::{Channel, Command, Demand, DriveState, Quality, Sample};

type Link = ProfiledLink<ForeignBus>;

/// A bench with one drive: time passes between exchanges.
struct Table {
    link: Link,
    clock: VirtualClock,
    time_s: f64,
    period_s: f64,
    seq: u64,
}

type Changes<'a> = &'a [(&'a str, &'a str)];

/// The text of a profile with the first of each replaced.
fn changed(text: &str, changes: Changes<'_>) -> String {
    changes.iter().fold(text.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    })
}

fn profile_with(name: &str, changes: Changes<'_>) -> DriveProfile {
    let text = changed(DriveProfile::text(name).unwrap(), changes);
    DriveProfile::parse(name, &text).unwrap()
}

impl Table {
    fn new(name: &str) -> Self {
        Self::of(&profile_with(name, &[]), None)
    }

    fn of(profile: &DriveProfile, watchdog_s: Option<f64>) -> Self {
        Self::mixed(profile, profile, watchdog_s)
    }

    /// A drive of the profile `name` with `changes` that the host has identified.
    fn identified(name: &str, changes: Changes<'_>) -> Self {
        Self::of(&profile_with(name, changes), None).known()
    }

    fn known(mut self) -> Self {
        self.link.identify().unwrap();
        self
    }

    /// The same, running with this reference for half a second.
    fn running(name: &str, changes: Changes<'_>, reference: Option<(&str, f64)>) -> Self {
        let mut table = Self::identified(name, changes);
        table.enable(reference);
        table.hold(reference, 0.5);
        table
    }

    /// A host with one profile at a drive of another.
    fn mixed(host: &DriveProfile, far: &DriveProfile, watchdog_s: Option<f64>) -> Self {
        let guise = Guise {
            watchdog_s,
            ..Guise::of(far).unwrap()
        };
        let mut config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
        config.tolerance = 0.0;
        let clock = VirtualClock::new();
        let drive = ForeignDrive::new(&guise, &config, 1);
        let bus = ForeignBus::new(drive, &guise, clock.clone());
        let link = ProfiledLink::new(Arc::clone(host.registers.as_ref().unwrap()), bus);
        // No faster than the line, and often enough for a dead man's switch.
        let refreshes = link
            .map()
            .set_points
            .iter()
            .filter_map(crate::drive::register_map::SetPoint::refresh_s);
        let usual_s = 1.2 * link.shortest_cycle_s().unwrap() + 0.02;
        let period_s = refreshes.fold(usual_s, f64::min);
        Self {
            link,
            clock,
            time_s: 0.0,
            period_s,
            seq: 0,
        }
    }

    fn far(&mut self) -> &mut ForeignDrive {
        self.link.bus_mut().drive_mut()
    }

    fn pass(&mut self, time_s: f64) {
        self.time_s = self.time_s.max(self.link.bus().now_s()) + time_s;
        self.clock.set_time_s(self.time_s);
    }

    /// The next cycle begins a period after the last, or when that has ended.
    fn next_cycle(&mut self) {
        self.time_s = (self.time_s + self.period_s).max(self.link.bus().now_s());
        self.clock.set_time_s(self.time_s);
        self.seq += 1;
    }

    fn demand(&mut self, demand: Demand) -> Result<Sample, LinkError> {
        self.next_cycle();
        let seq = self.seq;
        self.link.exchange(Command { seq, demand })
    }

    fn run(&mut self, reference: Option<(&str, f64)>) -> Result<Sample, LinkError> {
        self.next_cycle();
        self.link.run_at(reference, self.seq)
    }

    /// Runs until the drive says so.
    fn enable(&mut self, reference: Option<(&str, f64)>) {
        for _ in 0..400 {
            if self.run(reference).unwrap().state == Some(DriveState::Running) {
                return;
            }
        }
        panic!("{} does not run", self.link.map().device.id);
    }

    /// The first error of two hundred cycles.
    fn first_error(&mut self, reference: Option<(&str, f64)>) -> LinkError {
        let error = (0..200).find_map(|_| self.run(reference).err());
        error.unwrap_or_else(|| panic!("{} runs", self.link.map().device.id))
    }

    /// The same where each cycle has another speed.
    fn first_error_over(&mut self, speeds: impl IntoIterator<Item = f64>) -> LinkError {
        let mut speeds = speeds.into_iter();
        let error = speeds.find_map(|rpm| self.run(Some(("speed_ref", rpm))).err());
        error.unwrap()
    }

    fn told(&mut self, set_point: &str) -> Option<u16> {
        self.far().told_last(set_point)
    }

    /// The last that the servo amplifier was told is zero, and to be off.
    #[track_caller]
    fn assert_told_to_stop(&mut self) {
        let told = ["speed_ref", "enable_word"].map(|point| self.told(point));
        assert_eq!(told, [Some(0); 2]);
    }

    fn hold(&mut self, reference: Option<(&str, f64)>, seconds: f64) -> Sample {
        let until_s = self.link.bus().now_s() + seconds;
        loop {
            let sample = self.run(reference).unwrap();
            if self.link.bus().now_s() > until_s {
                return sample;
            }
        }
    }
}

#[track_caller]
fn assert_says(error: &impl std::fmt::Display, part: &str) {
    let error = error.to_string();
    assert!(error.contains(part), "{error}, without {part:?}");
}

/// A set-point of each drive and the speed of the emulated motor with it, rad/s; one pole pair.
fn target(name: &str) -> (Option<(&'static str, f64)>, f64) {
    use crate::units::rad_s_from_rpm as rpm;
    const HZ: f64 = std::f64::consts::TAU;
    let rated = 293.2;
    match name {
        "abb-dcs-gateway" | "abb-efb" | "epulse50-dc" | "schneider-atv312" => {
            (Some(("speed_ref", 900.0)), rpm(900.0))
        }
        "delta-ms300" | "toshiba-vfs11" | "yaskawa-a1000" => (Some(("speed_ref", 20.0)), 20.0 * HZ),
        "siemens-v20" | "vacon10" => (Some(("speed_ref", 30.0)), 0.3 * rated),
        // 30 % of 120 V less friction over Ke.
        "roboteq-dc" => (Some(("power_ref", 30.0)), 97.0),
        _ => (None, 0.1 * rated),
    }
}

fn is_identified_enabled_driven_and_stopped(name: &str) {
    let mut table = Table::new(name);
    let identity = table.link.identify().unwrap();
    assert!(
        identity.is_emulator && !identity.product.is_empty(),
        "{name}"
    );
    let rest = table.demand(Demand::Disable).unwrap();
    assert_ne!(rest.state, Some(DriveState::Running), "{name}");
    assert!(table.far().speed_rad_s().abs() < 1.0, "{name}");
    let (reference, speed_rad_s) = target(name);
    table.enable(reference);
    let sample = table.hold(reference, 4.0);
    let true_speed = table.far().speed_rad_s();
    assert!(
        (true_speed - speed_rad_s).abs() < 0.06 * speed_rad_s,
        "{name}: {true_speed}, not {speed_rad_s}"
    );
    let of_drive = |channel: &Channel| *channel != Channel::TimeHalfWidth;
    for channel in Channel::ALL.into_iter().filter(of_drive) {
        let mapped = table.link.map().of_channel(channel).is_some();
        assert_eq!(
            sample.get(channel).is_some(),
            mapped,
            "{name} {}",
            channel.key()
        );
    }
    let off = sample.get(Channel::Speed).map(|speed| speed - true_speed);
    assert!(off.is_none_or(|off| off.abs() < 3.0), "{name}: {off:?}");
    let current = sample.get(Channel::Current);
    let is_likely = current.is_none_or(|current| (0.5..4.0).contains(&current));
    assert!(is_likely, "{name}: {current:?}");
    table.link.stop().unwrap();
    table.pass(3.0);
    let rest = table.demand(Demand::Disable).unwrap();
    assert_ne!(rest.state, Some(DriveState::Running), "{name}");
    let speed = table.far().speed_rad_s();
    assert!(speed.abs() < 0.05 * 293.2, "{name} still turns: {speed}");
    assert!(table.link.statistics().balances(), "{name}");
    assert_eq!(table.link.statistics().exception, 0, "{name}");
}

fn silence_trips_its_watchdog_and_nothing_old_comes_back(name: &str) {
    let mut table = Table::of(&profile_with(name, &[]), Some(0.5));
    let boot_s = table.link.map().watchdog.keys.boot_delay_s;
    table.pass(boot_s);
    let watchdog_s = table.link.identify().unwrap().watchdog_s;
    let (reference, _) = target(name);
    table.enable(reference);
    table.hold(reference, 1.5);
    let speed = table.far().speed_rad_s();
    assert!(speed > 20.0, "{name} {speed}");
    table.pass(4.0);
    let now_s = table.link.bus().now_s();
    table.far().advance_to(now_s);
    let speed = table.far().speed_rad_s();
    assert!(speed.abs() < 6.0, "{name}: {speed} after the silence");
    let tells = table.link.map().state("fault").is_some();
    let lapse = table.run(reference);
    // The host knows only what the drive tells, or what its profile says of it as delivered.
    if watchdog_s.is_some_and(|time_s| time_s < 4.0) {
        assert_says(&lapse.unwrap_err(), "told to stop before anything else");
    }
    let sample = table.demand(Demand::Disable).unwrap();
    if tells {
        assert_eq!(sample.state, Some(DriveState::Fault), "{name}");
    }
    for _ in 0..20 {
        table.demand(Demand::Disable).unwrap();
    }
    let speed = table.far().speed_rad_s();
    assert!(speed.abs() < 6.0, "{name}: the old set-point came back");
    // After a reset it can be enabled again.
    for _ in 0..20 {
        table.demand(Demand::ResetFault).unwrap();
    }
    table.enable(reference);
}

fn a_trip_is_a_fault_and_enable_is_not_repeated(name: &str) {
    let mut table = Table::new(name);
    if table.link.map().state("fault").is_none() {
        return;
    }
    table.link.identify().unwrap();
    let (reference, _) = target(name);
    table.enable(reference);
    table.hold(reference, 1.0);
    table.far().trip();
    table.run(reference).unwrap();
    for _ in 0..50 {
        let sample = table.run(reference).unwrap();
        assert_eq!(sample.state, Some(DriveState::Fault), "{name}");
    }
    assert!(!table.far().is_running(), "{name}");
    for _ in 0..30 {
        table.demand(Demand::ResetFault).unwrap();
    }
    let sample = table.demand(Demand::Disable).unwrap();
    assert_ne!(sample.state, Some(DriveState::Fault), "{name}");
    assert_eq!(sample.fault, None, "{name}");
}

#[test]
fn a_status_that_never_comes_names_the_step_and_the_drive_is_stopped() {
    let mut table = Table::identified("schneider-atv312", &[]);
    table.far().force("status", Some(0x0021));
    let error = table.first_error(Some(("speed_ref", 500.0)));
    let LinkError::Sequence {
        command,
        step,
        reason,
        ..
    } = &error
    else {
        panic!("{error}");
    };
    assert_eq!((*command, *step), ("enable", 4));
    assert!(
        reason.starts_with("not switched on: status is 0x0021 after 1 s"),
        "{reason}"
    );
    assert!(!error.is_transient());
    assert!(!table.far().is_running());
}

#[test]
fn a_set_point_that_reads_back_otherwise_three_times_is_a_stop() {
    let mut table = Table::identified("abb-dcs-gateway", &[]);
    table.enable(Some(("speed_ref", 100.0)));
    table.far().ignore(Some("speed_ref"));
    let error = table.first_error_over((1..20).map(|k| 100.0 + f64::from(k)));
    assert_says(&error, "3 times in a row");
    for _ in 0..5 {
        table.demand(Demand::Disable).unwrap();
    }
    assert!(!table.far().is_running());
}

#[test]
fn codes_and_values_that_cannot_be_are_missing_and_never_zero() {
    let valid = "valid = [0, 163.83]";
    let with_invalid = format!("{valid}\ninvalid = [0x7FFF]");
    let mut table = Table::identified("siemens-v20", &[(valid, &with_invalid)]);
    let good = table.demand(Demand::Disable).unwrap();
    assert!(good.get(Channel::Current).is_some());
    for (signal, pattern, channel) in [
        ("current", 0x7FFF, Channel::Current),
        ("current", 0xFFFF, Channel::Current),
        ("speed", 0x8000, Channel::Speed),
    ] {
        table.far().force(signal, Some(pattern));
        let sample = table.demand(Demand::Disable).unwrap();
        assert_eq!(sample.get(channel), None, "{signal} {pattern:#x}");
        assert_eq!(sample.quality(channel), Quality::Missing);
        table.far().force(signal, None);
    }
    assert_eq!(table.link.rejected(), 3);
}

#[test]
fn a_sign_in_the_control_word_turns_the_other_way() {
    let mut table = Table::identified("siemens-v20", &[]);
    table.enable(Some(("speed_ref", 20.0)));
    table.hold(Some(("speed_ref", 20.0)), 2.0);
    assert!(table.far().speed_rad_s() > 40.0);
    table.hold(Some(("speed_ref", -20.0)), 4.0);
    let speed = table.far().speed_rad_s();
    assert!(speed < -40.0, "{speed}");
}

#[test]
fn limits_and_slew_hold_a_set_point_back_and_say_so() {
    let slow = "limits = [-600, 600]\nslew_per_s = 200.0";
    let mut table = Table::identified("epulse50-dc", &[("limits = [-3000, 3000]", slow)]);
    table.enable(Some(("speed_ref", 5000.0)));
    let sample = table.hold(Some(("speed_ref", 5000.0)), 1.0);
    assert!(sample.limited);
    let part = table.far().speed_rad_s();
    let expected = 10.0..35.0;
    assert!(
        expected.contains(&part),
        "{part} rad/s after 1 s at 200 rpm/s"
    );
    table.hold(Some(("speed_ref", 5000.0)), 5.0);
    let speed = table.far().speed_rad_s();
    assert!((speed - 62.8).abs() < 3.0, "{speed}: 600 rpm are the limit");
}

#[test]
fn demands_are_taken_in_si_where_the_profile_gives_them_and_refused_with_a_reason_elsewhere() {
    let mut table = Table::identified("epulse50-dc", &[]);
    assert_eq!(table.link.zero(), Demand::Speed(0.0));
    for _ in 0..200 {
        table.demand(Demand::Speed(50.0)).unwrap();
    }
    assert!((table.far().speed_rad_s() - 50.0).abs() < 2.0);
    let error = table.demand(Demand::Voltage(5.0)).unwrap_err();
    assert!(matches!(error, LinkError::Refused { .. }), "{error}");
    assert_says(&error, "takes no voltage command");
    let error = table.demand(Demand::Speed(f64::NAN)).unwrap_err();
    assert!(matches!(error, LinkError::Refused { .. }), "{error}");
}

#[test]
fn a_lost_reply_costs_one_exchange() {
    let mut table = Table::identified("vacon10", &[]);
    let reference = Some(("speed_ref", 20.0));
    table.enable(reference);
    table.link.bus_mut().lose(1);
    assert!(table.run(reference).unwrap_err().is_transient());
    let state = table.run(reference).unwrap().state;
    assert_eq!(state, Some(DriveState::Running));
}

#[test]
fn a_lost_field_is_a_trip() {
    let limited = "[limits]\nfield_min_a = 0.3\n\n[rates]";
    let mut table = Table::identified("abb-dcs-gateway", &[("[rates]", limited)]);
    let reference = Some(("speed_ref", 500.0));
    table.enable(reference);
    table.hold(reference, 1.0);
    table.far().lose_field();
    let fault = (0..200).any(|_| table.run(reference).unwrap().state == Some(DriveState::Fault));
    assert!(fault);
    for _ in 0..20 {
        table.run(reference).unwrap();
    }
    assert!(!table.far().is_running());
}

#[test]
fn a_profile_for_another_drive_is_refused_before_anything_is_written() {
    let identity = "\n[[identity]]\nsignal = \"speed_scaling\"\nwithin = [500, 2000]\n\n[rates]";
    let host = profile_with("abb-efb", &[("\n[rates]", identity)]);
    // The emulated motor is rated 2800 rpm, and its profile does not ask who it is.
    let mut table = Table::mixed(&host, &profile_with("abb-efb", &[]), None);
    let error = table.link.identify().unwrap_err();
    assert_says(&error, "this is not ABB");
    // The registers of one make do not exist at another.
    let other = profile_with("siemens-v20", &[]);
    let mut table = Table::mixed(&host, &other, None);
    let refused = table.link.identify();
    assert!(matches!(refused, Err(LinkError::Exception { .. })));
}

#[test]
fn the_watchdog_register_is_set_and_read_back() {
    let mut table = Table::new("siemens-v20");
    assert_eq!(table.link.identify().unwrap().watchdog_s, Some(1.0));
    let mut delta = Table::of(&profile_with("delta-ms300", &[]), Some(2.5));
    assert_eq!(delta.link.identify().unwrap().watchdog_s, Some(2.5));
    let mut off = Table::new("delta-ms300");
    assert_eq!(off.link.identify().unwrap().watchdog_s, None);
}

#[test]
fn a_memory_that_wears_out_is_not_written_in_a_loop() {
    const DUTY: &str = "quantity = \"duty\"\nlimits = [-100, 100]\n";
    let [refreshed, worn] = ["refresh_ms = 100.0", "nvm = true"].map(|key| format!("{DUTY}{key}"));
    let mut table = Table::identified("roboteq-dc", &[(&refreshed, &worn)]);
    let error = (0..100)
        .find_map(|k| table.run(Some(("power_ref", f64::from(k) * 0.1))).err())
        .unwrap();
    assert_says(&error, "memory that wears out");
}

#[test]
fn what_a_drive_does_not_know_gets_the_exact_exception() {
    let profile = DriveProfile::named("toshiba-vfs11").unwrap();
    let guise = Guise::of(&profile).unwrap();
    let config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    let mut drive = ForeignDrive::new(&guise, &config, 1);
    let cases: [(&str, &[u8], &[u8]); 6] = [
        ("one register a request", &[3, 0xFD, 0, 0, 2], &[0x83, 3]),
        ("no FC16", &[16, 0xFA, 0, 0, 1, 2, 0, 0], &[0x90, 1]),
        ("no such register", &[3, 0, 0, 0, 1], &[0x83, 2]),
        ("no diagnosis", &[8, 0, 0, 1, 2], &[0x88, 1]),
        ("5.7 A", &[3, 0xFE, 0x70, 0, 1], &[3, 2, 0, 57]),
        ("echo", &[6, 0xFA, 1, 7, 0xD0], &[6, 0xFA, 1, 7, 0xD0]),
    ];
    for (name, request, answer) in cases {
        assert_eq!(drive.answer(request), answer, "{name}");
    }
}

/// One test of each kind for each drive, under its name.
macro_rules! drives {
    ($($module:ident: $name:literal),* $(,)?) => {
        $(mod $module {
            #[test]
            fn is_identified_enabled_driven_and_stopped() {
                super::is_identified_enabled_driven_and_stopped($name);
            }

            #[test]
            fn silence_trips_its_watchdog_and_nothing_old_comes_back() {
                super::silence_trips_its_watchdog_and_nothing_old_comes_back($name);
            }

            #[test]
            fn a_trip_is_a_fault_and_enable_is_not_repeated() {
                super::a_trip_is_a_fault_and_enable_is_not_repeated($name);
            }
        })*
    };
}

drives! {
    abb_dcs_gateway: "abb-dcs-gateway",
    abb_efb: "abb-efb",
    delta_ms300: "delta-ms300",
    epulse50_dc: "epulse50-dc",
    leadshine_iem: "leadshine-iem",
    roboteq_dc: "roboteq-dc",
    schneider_atv312: "schneider-atv312",
    siemens_v20: "siemens-v20",
    toshiba_vfs11: "toshiba-vfs11",
    vacon10: "vacon10",
    yaskawa_a1000: "yaskawa-a1000",
}
