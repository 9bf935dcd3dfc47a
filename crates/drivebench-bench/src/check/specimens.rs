//! The pulse over many motors: no motor that fits its nameplate is refused, on any line and with pauses of the host, and one
//! with the nameplate of another motor is.

use std::sync::Arc;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::*;
use crate::limits::Nameplate;
use crate::testing::{LateClock, exact, has, in_memory, nameplate_of, random_motor, within};
use drivebench_emulator::truth::effect::HiddenEffect;
use drivebench_emulator::{
    EmulatorConfig, ForeignBus, ForeignDrive, Guise, Latency, MemoryLink, SoftDrive, VirtualClock,
    open_line,
};
use drivebench_link::{DriveProfile, ProfiledLink};
use drivebench_model::units::rpm_from_rad_s;

/// A random motor with a nameplate within the tolerance of specimens, and an effect that no nameplate states.
fn specimen(seed: u64) -> (Nameplate, EmulatorConfig) {
    let mut config = random_motor(seed);
    let mut nameplate = nameplate_of(config.motor.clone());
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(1);
    let mut between = |least: f64, most: f64| rng.random_range(least..most);
    nameplate.resistance_ohm /= between(0.8, 1.4);
    nameplate.back_emf_v_s_per_rad /= between(0.85, 1.2);
    nameplate.inertia_kg_m2 /= between(0.5, 2.0);
    nameplate.load_torque_n_m /= between(0.5, 2.0);
    let torque = config.motor.load_torque_n_m;
    let speed = nameplate.rated_speed_rad_s;
    let hidden: &[(&str, &[(&str, f64)])] = &[
        ("viscous_friction", &[("viscous_n_m_s_per_rad", torque / speed)]),
        (
            "stribeck_friction",
            &[("stribeck_n_m", 0.3 * torque), ("stribeck_speed_rad_s", 0.03 * speed)],
        ),
        ("voltage_drop", &[("drop_v", 0.01 * nameplate.rated_voltage_v)]),
        ("command_delay", &[("delay_s", 2e-3)]),
        ("speed_delay", &[("delay_s", 2e-3)]),
    ];
    if let Some((id, values)) = hidden.get(usize::try_from(seed % 6).unwrap()) {
        config.hidden = vec![HiddenEffect::new(id, values).unwrap()];
    }
    (nameplate, config)
}

/// The checks with the first move; nothing is waived.
fn first_move(
    link: &mut dyn DriveLink,
    clock: &mut dyn Clock,
    (nameplate, rate_hz): (&Nameplate, f64),
) -> CheckReport {
    let profile = DriveProfile::named("own").unwrap();
    checked(link, clock, nameplate, &profile, rate_hz, Waivers::default()).unwrap()
}

fn checked(
    link: &mut dyn DriveLink,
    clock: &mut dyn Clock,
    nameplate: &Nameplate,
    profile: &DriveProfile,
    rate_hz: f64,
    waivers: Waivers,
) -> Result<CheckReport, CheckError> {
    // Below the drive's watchdog.
    let link_silence_s = (4.0 / rate_hz).max(0.4);
    let limits = Limits { link_silence_s, ..Limits::for_motor(nameplate, rate_hz) };
    let first_move = CheckOptions::first_move(rate_hz, nameplate, profile);
    check(link, clock, &limits, CheckOptions { waivers, ..first_move })
}

/// The refusals among so many seeds.
fn refused(count: u64, report: impl Fn(u64) -> CheckReport + Sync) -> Vec<String> {
    let refusal = |seed| Some(format!("{seed}: {}", report(seed).refusal()?.sentence()));
    (0..count).into_par_iter().filter_map(refusal).collect()
}

/// One of the values, selected by the seed.
fn one_of<T: Copy>(seed: u64, all: &[T]) -> T {
    all[usize::try_from(seed).unwrap() % all.len()]
}

/// A clock of a host that stalls for this time, s, at random instants within and around the pulse.
fn with_pauses(clock: VirtualClock, pause_s: f64, seed: u64) -> LateClock<impl FnMut(f64) -> f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut next_s = 0.0;
    let late_s = move |now_s: f64| {
        if now_s < next_s {
            return 0.0;
        }
        next_s = now_s + pause_s + rng.random_range(0.05..0.8);
        pause_s
    };
    LateClock { clock, late_s }
}

#[test]
fn no_motor_within_tolerance_is_refused() {
    let refusals = refused(200, |seed| {
        let (nameplate, config) = specimen(seed);
        let rate_hz = one_of(seed, &[20.0, 50.0, 100.0, 200.0, 500.0]);
        let latency = Latency { request_s: 0.2 / rate_hz, reply_s: 0.5 / rate_hz };
        let mut clock = VirtualClock::new();
        let mut link = MemoryLink::new(SoftDrive::new(&config, seed), clock.clone(), latency);
        first_move(&mut link, &mut clock, (&nameplate, rate_hz))
    });
    // One has a large inertia and hardly any friction: it still coasts in the reverse pulse, which does not turn it back.
    let of_nameplate = refusals.iter().filter(|text| text.contains("plausibility:"));
    assert_eq!(of_nameplate.count(), 0, "{refusals:#?}");
    assert!(refusals.len() <= 1, "{refusals:#?}");
}

#[test]
fn a_pause_of_the_host_refuses_no_matching_motor() {
    let refusals = refused(200, |seed| {
        let (nameplate, config) = specimen(seed);
        let clock = VirtualClock::new();
        let profile = DriveProfile::named("own").unwrap();
        let mut link = open_line(None, &config, seed, &profile, clock.clone()).unwrap();
        let pause_s = one_of(seed, &[0.03, 0.06, 0.1, 0.2]);
        let mut clock = with_pauses(clock, pause_s, seed);
        let rate_hz = one_of(seed / 4, &[20.0, 50.0, 100.0]);
        first_move(link.as_mut(), &mut clock, (&nameplate, rate_hz))
    });
    assert!(refusals.is_empty(), "{refusals:#?}");
}

/// A change of the nameplate, and how many of a hundred motors are refused for it at least; the others have an interval with a
/// plausible value.
type Wrong = (&'static str, fn(&mut Nameplate), usize);

#[test]
fn another_motor_or_other_units_are_refused_where_visible() {
    let wrong: [Wrong; 7] = [
        ("Ke x 0.3", |nameplate| nameplate.back_emf_v_s_per_rad *= 0.3, 50),
        ("Ke x 0.5", |nameplate| nameplate.back_emf_v_s_per_rad *= 0.5, 5),
        ("Ke x 2", |nameplate| nameplate.back_emf_v_s_per_rad *= 2.0, 30),
        ("R x 0.3", |nameplate| nameplate.resistance_ohm *= 0.3, 1),
        ("R x 5", |nameplate| nameplate.resistance_ohm *= 5.0, 30),
        ("V per r/min", |nameplate| nameplate.back_emf_v_s_per_rad /= rpm_from_rad_s(1.0), 90),
        ("r/min for rad/s", |nameplate| nameplate.back_emf_v_s_per_rad *= rpm_from_rad_s(1.0), 90),
    ];
    for (name, change, least) in wrong {
        let refusals = refused(100, |seed| {
            let config = random_motor(seed);
            let mut nameplate = nameplate_of(config.motor.clone());
            change(&mut nameplate);
            let (mut link, mut clock) = in_memory(&config, seed);
            first_move(&mut link, &mut clock, (&nameplate, 100.0))
        });
        assert!(refusals.len() >= least, "{name}: {}", refusals.len());
    }
}

#[test]
fn a_pulse_of_pauses_only_is_repeated_once_then_refused() {
    let config = exact("zk-22fc-plain");
    let nameplate = Nameplate::zk_22fc();
    let profile = DriveProfile::named("own").unwrap();
    for plausibility in [false, true] {
        let waivers = Waivers { plausibility, ..Waivers::default() };
        let (mut link, clock) = in_memory(&config, 3);
        // From the pulse on every cycle is late.
        let late_s = |now_s: f64| if now_s > 1.35 { 0.03 } else { 0.0 };
        let mut clock = LateClock { clock, late_s };
        let report = checked(&mut link, &mut clock, &nameplate, &profile, 100.0, waivers).unwrap();
        let item = report.items.last().unwrap();
        assert_eq!(item.name, "plausibility", "{}", item.text);
        has(&item.text, "the pulse was repeated and still cannot be evaluated");
        assert_eq!(item.passed, plausibility);
        assert_eq!(report.waived.contains(&"plausibility"), plausibility);
        // Twice there and back, and no faster than once.
        within(link.drive().plant().angle_rad().abs(), ..6.0);
        within(link.drive().plant().speed_rad_s().abs(), ..1.0);
    }
}

#[test]
fn every_profiles_machine_passes_a_pulse_with_pauses() {
    let nameplate = Nameplate::zk_22fc();
    let mut passed = 0;
    for name in DriveProfile::names() {
        let profile = DriveProfile::named(name).unwrap();
        let Some(guise) = Guise::of(&profile) else {
            continue;
        };
        for pause_s in [0.0, 0.1, 0.2] {
            let clock = VirtualClock::new();
            let config = exact("zk-22fc-plain");
            let mut link: Box<dyn DriveLink> = if profile.link.protocol.is_modbus() {
                let drive = ForeignDrive::new(&guise, &config, 1);
                let bus = ForeignBus::new(drive, &guise, clock.clone());
                Box::new(ProfiledLink::new(Arc::clone(&guise.map), bus))
            } else {
                open_line(Some(&guise), &config, 1, &profile, clock.clone()).unwrap()
            };
            let (link, mut clock) = (link.as_mut(), with_pauses(clock, pause_s, 7));
            let waivers = Waivers { watchdog: true, ..Waivers::default() };
            let report = match checked(link, &mut clock, &nameplate, &profile, 10.0, waivers) {
                // Its profile has no set-point in SI units.
                Err(CheckError::Link(LinkError::Refused(..))) => continue,
                // A pause of the host longer than the drive's watchdog is reported.
                Err(CheckError::Link(LinkError::Sequence { reason, .. })) if pause_s > 0.0 => {
                    assert!(reason.contains("watchdog of 0.2 s"), "{name}: {reason}");
                    continue;
                }
                report => report.unwrap(),
            };
            if let Some(item) = report.refusal() {
                let is_pulse = ["direction", "plausibility"].contains(&item.name);
                assert!(!is_pulse, "{name}, {pause_s} s: {}", item.text);
            }
            passed += usize::from(report.passed());
        }
    }
    // The others have no set-point in SI units, or a line that is too slow.
    assert!(passed >= 6, "{passed}");
}
