use super::*;
use crate::limits::short;
use crate::testing::{has, near, within};
use drivebench_model::excitation::Output;

fn nameplate() -> MotorSection {
    BenchFile::embedded_default().motor
}

fn readback() -> Readback {
    Readback {
        is_offline: false,
        who: "a test".to_owned(),
        current_limit_a: Some(9.0),
        voltage_limit_v: Some(120.0),
        bus_v: Some(120.0),
        watchdog_s: Some(0.5),
        motor: None,
    }
}

fn made_for(
    profile: &DriveProfile,
    motor: &MotorSection,
    readback: Readback,
) -> Result<InitFile, InitError> {
    init_file(&InitRequest {
        profile,
        drive: &profile.name,
        port: "/dev/ttyUSB0",
        port_reason: "",
        motor,
        motor_file: "motor.toml",
        readback,
    })
}

fn made(profile: &str, motor: &MotorSection, readback: Readback) -> Result<InitFile, InitError> {
    made_for(&DriveProfile::named(profile).unwrap(), motor, readback)
}

fn reason<'a>(file: &'a InitFile, key: &str) -> &'a Reasoned {
    file.reasons.iter().find(|reason| reason.key == key).unwrap()
}

#[test]
fn every_limit_has_its_value_and_its_reason() {
    let file = made("own", &nameplate(), readback()).unwrap();
    let current = reason(&file, "limits.current_a");
    assert_eq!(current.value, Some(9.0));
    assert_eq!(
        current.reason,
        "smaller of 2.0 x rated current 5.7 A (nameplate) and the drive's own limit 9 A (read back)"
    );
    let limits = file.bench.limits();
    near(limits.speed_rad_s, 366.5, 1e-9);
    near(limits.voltage_v, 110.0, 1e-9);
    assert_eq!((limits.bus_min_v, limits.bus_max_v), (Some(96.0), Some(150.0)));
    near(limits.link_silence_s, 0.45, 1e-9);
    for key in ["current_a", "speed_rad_s", "voltage_v", "slew_v_per_s", "time_s", "link_silence_s"]
    {
        let reason = reason(&file, &format!("limits.{key}"));
        assert!(reason.value.is_some() && reason.reason.len() > 20, "{reason:?}");
        has(&file.text, &format!("\n{key} = "));
    }
    let mut comments = file.text.lines().filter(|line| line.starts_with('#'));
    assert!(comments.all(|line| line.len() <= 118), "{}", file.text);
    let plan = file.plan.as_ref().unwrap();
    assert!(!plan.is_refused());
    within(plan.peak_current_a, 3.0..9.0);
    within(plan.peak_speed_rad_s, 150.0..);
    assert!(file.bench.sequence.len() >= 5);
    assert_eq!(
        file.next("b.toml"),
        [
            "drivebench plan b.toml",
            "drivebench run b.toml --hardware --headless",
            "drivebench speed b.toml --hardware --headless"
        ]
    );
}

#[test]
fn a_drive_that_starts_late_does_so_before_the_first_step() {
    let made = made("own", &nameplate(), readback()).unwrap().bench;
    let embedded = BenchFile::embedded_default();
    for (bench, times_s) in [(made, [0.55, 0.75, 0.95]), (embedded, [0.3, 0.4, 0.49])] {
        let program = bench.program(1).unwrap();
        for time_s in times_s {
            let Output::Voltage(volts) = program.value_at(time_s) else {
                panic!("{}: off at {time_s} s", bench.name);
            };
            within(volts, 0.9..1.1);
        }
    }
}

#[test]
fn a_value_that_was_not_read_back_is_stated() {
    let offline = Readback { is_offline: true, ..Readback::default() };
    let file = made("own", &nameplate(), offline).unwrap();
    let current = reason(&file, "limits.current_a");
    assert_eq!(current.value, Some(11.4));
    assert!(current.reason.ends_with("its own current limit was not read back (--offline)"));
    assert!(file.bench.limits().bus_max_v.is_none());
    has(&file.text, "none of its own limits is known here");
    has(&file.text, "# bus_min_v: none. ");
    let file = made("own", &nameplate(), Readback { current_limit_a: None, ..readback() }).unwrap();
    has(&reason(&file, "limits.current_a").reason, "does not report its own current limit");
}

#[test]
fn an_unknown_motor_is_left_to_the_escalation() {
    let motor = MotorSection { resistance_ohm: None, ..nameplate() };
    let file = made("own", &motor, readback()).unwrap();
    assert!(file.bench.motor.is_unknown() && file.plan.is_none());
    assert!(file.bench.speed.is_none() && file.bench.limits.slew_v_per_s.is_none());
    has(&file.text, "# resistance_ohm: none. ");
    let run = "drivebench run b.toml --hardware --headless";
    assert_eq!(file.next("b.toml"), [run]);
}

#[test]
fn a_drive_that_takes_a_current_gets_a_sequence_of_currents() {
    let file = made("vesc-foc", &nameplate(), readback()).unwrap();
    assert_eq!(file.purpose, InitUse::Currents);
    let (plan, currents) = (file.plan.as_ref().unwrap(), file.bench.currents.as_ref().unwrap());
    assert!(!plan.is_refused() && file.bench.sequence.is_empty());
    // More than the friction of 1.29 A, and no more than the rated current; a cycle beyond the highest reversal.
    within(currents.levels_a[0], 1.4..3.0);
    within(plan.peak_current_a, 5.0..5.71);
    within(plan.peak_speed_rad_s, 187.0..200.0);
    assert_eq!(file.next("b.toml").len(), 3);
    let motor = MotorSection { inertia_kg_m2: None, ..nameplate() };
    let file = made("vesc-foc", &motor, readback()).unwrap();
    assert!(file.plan.is_none() && file.bench.limits().time_s > 70.0);
    let levels = &file.bench.currents.as_ref().unwrap().levels_a;
    assert!(levels.is_sorted() && levels[0] < 0.2, "{levels:?}");
}

#[test]
fn what_the_drive_states_of_its_motor_completes_the_nameplate() {
    let rated = MotorSection {
        resistance_ohm: None,
        inductance_h: None,
        back_emf_v_s_per_rad: None,
        ..nameplate()
    };
    let stated = StatedMotor {
        resistance_ohm: Some(1.3),
        inductance_h: Some(0.008),
        back_emf_v_s_per_rad: Some(0.34),
        ..StatedMotor::default()
    };
    let stating = Readback { motor: Some(stated), ..readback() };
    assert!(made("vesc-foc", &rated, readback()).unwrap().plan.is_none());
    let file = made("vesc-foc", &rated, stating.clone()).unwrap();
    for line in [
        "resistance_ohm = 1.3  # ohm; as the drive states it, between two lines",
        "inductance_h = 0.008  # H; as the drive states it, between two lines",
        "back_emf_v_s_per_rad = 0.34  # V.s/rad; as the drive states it, between two lines",
        "inertia_kg_m2 = 0.0045  # kg.m2, load included",
    ] {
        has(&file.text, line);
    }
    assert!(file.plan.is_some());
    // What is given stays, and of an unknown motor only the rated values count.
    let file = made("vesc-foc", &nameplate(), stating.clone()).unwrap();
    assert_eq!(file.bench.motor, nameplate());
    assert!(!file.text.contains("as the drive states it"), "{}", file.text);
    let unknown = MotorSection { unknown: true, ..rated };
    assert_eq!(made("own", &unknown, stating).unwrap().bench.motor, unknown);
}

#[test]
fn a_drive_without_voltage_gets_a_speed_loop_or_a_reason() {
    let file = made("epulse50-dc", &nameplate(), readback()).unwrap();
    assert_eq!(file.purpose, InitUse::SpeedLoop);
    has(&file.remarks[0], "takes no voltage command");
    let speed = file.bench.speed.as_ref().unwrap();
    assert_eq!(speed.controller.id(), "pi");
    assert!(speed.drive_lag_s.is_some());
    let speed = "drivebench speed b.toml --hardware --headless";
    assert_eq!(file.next("b.toml"), [speed]);
    let unknown = Readback { watchdog_s: None, ..readback() };
    has(made("epulse50-dc", &nameplate(), unknown).unwrap().remarks.join("\n"), "--waive-watchdog");
    // Its reference takes 3000 rpm.
    has(&reason(&file, "limits.speed_rad_s").reason, "314.2 rad/s (profile)");
}

#[test]
fn a_request_that_no_drive_or_motor_fits_is_refused() {
    let without_resistance = MotorSection { resistance_ohm: None, ..nameplate() };
    let negative = MotorSection { rated_current_a: -1.0, ..nameplate() };
    for (profile, motor, words) in [
        ("own", negative, "motor.toml: rated_current_a = -1 is not allowed"),
        // A drive without a voltage command cannot find the motor from small steps.
        ("epulse50-dc", without_resistance, "resistance_ohm is left out"),
        ("siemens-v20", nameplate(), "takes no armature voltage"),
        ("siemens-v20", nameplate(), "no speed loop"),
    ] {
        has(made(profile, &motor, readback()).unwrap_err(), words);
    }
}

#[test]
fn every_line_gets_a_rate_that_it_carries() {
    let [own, stream, epulse] =
        ["own", "own-stream", "epulse50-dc"].map(|name| DriveProfile::named(name).unwrap());
    let mut slow = own.clone();
    slow.link.baud = 9600;
    for (profile, rates_hz) in
        [(own, 60.0..100.1), (stream, 200.0..500.1), (epulse, 10.0..29.1), (slow, 0.0..20.0)]
    {
        within(made_for(&profile, &nameplate(), readback()).unwrap().bench.link.rate_hz, rates_hz);
    }
}

#[test]
fn motors_of_other_sizes_get_a_sequence_of_their_own() {
    // Rated V, A and rad/s; then ohm, H, V.s/rad, kg.m2 and N.m.
    let servo = ([24.0, 3.0, 400.0], [0.6, 0.0004, 0.05, 3e-5, 0.01]);
    let big = ([440.0, 78.0, 157.0], [0.4, 0.006, 2.6, 0.9, 12.0]);
    for (name, (rated, [r, l, ke, j, mc])) in [("small servo", servo), ("30 kW", big)] {
        let motor = MotorSection {
            name: name.to_owned(),
            unknown: false,
            rated_voltage_v: rated[0],
            rated_current_a: rated[1],
            rated_speed_rad_s: rated[2],
            resistance_ohm: Some(r),
            inductance_h: Some(l),
            back_emf_v_s_per_rad: Some(ke),
            inertia_kg_m2: Some(j),
            load_torque_n_m: Some(mc),
        };
        let free =
            Readback { current_limit_a: None, voltage_limit_v: None, bus_v: None, ..readback() };
        let plan = made("own", &motor, free).unwrap().plan.unwrap();
        assert!(!plan.is_refused(), "{name}: {:?}", plan.refusals);
        let ratio = plan.peak_current_ratio;
        assert!(ratio > 0.5, "{name}: {ratio}");
    }
}

#[test]
fn names_and_numbers_are_plain() {
    assert_eq!(name("ZK-22FC", "own"), "zk-22fc-own");
    assert_eq!(name("Motor Nr. 7/b", "abb"), "motor-nr-7-b-abb");
    let short = [11.4, 366.5, 2.0 * 5.7, 0.45, 123_456.0].map(short);
    let texts = short.map(|value| format!("{value:?}"));
    assert_eq!(texts, ["11.4", "366.5", "11.4", "0.45", "123400.0"]);
}

#[test]
fn the_silence_is_compared_with_the_profiles_watchdog() {
    let mut profile = DriveProfile::named("epulse50-dc").unwrap();
    let mut map = (*profile.registers.clone().unwrap()).clone();
    map.watchdog.keys.set_ms = Some(800.0);
    profile.registers = Some(map.into());
    let silent = Readback { watchdog_s: Some(0.0), ..readback() };
    let file = made_for(&profile, &nameplate(), silent).unwrap();
    let silence = reason(&file, "limits.link_silence_s");
    assert_eq!(silence.value, Some(0.72));
    has(&silence.reason, "0.8 s (set by the profile");
}
