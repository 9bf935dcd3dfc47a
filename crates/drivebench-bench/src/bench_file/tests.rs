use super::*;
use crate::speed::GainsSection;
use crate::testing::{has, near, within};
use drivebench_control::Actuator;
use drivebench_control::tuning::Rule;

fn changed_text(from: &str, to: &str) -> String {
    assert!(EMBEDDED_DEFAULT.contains(from), "{from}");
    EMBEDDED_DEFAULT.replacen(from, to, 1)
}

fn changed(from: &str, to: &str) -> Result<BenchFile, BenchFileError> {
    BenchFile::parse("b.toml", &changed_text(from, to))
}

/// The same with the checks of `speed`.
fn changed_for_speed(from: &str, to: &str) -> Result<BenchFile, BenchFileError> {
    let text = changed_text(from, to);
    let bench = BenchFile::parse("b.toml", &text)?;
    bench.check_speed("b.toml", &text).map(|()| bench)
}

/// Number of the line of the embedded bench that begins with `begin`, from 1.
fn line_of(begin: &str) -> usize {
    EMBEDDED_DEFAULT.lines().position(|line| line.starts_with(begin)).unwrap() + 1
}

fn is_read_back(bench: BenchFile) {
    assert_eq!(BenchFile::parse("again", &bench.to_toml()), Ok(bench));
}

#[test]
fn the_embedded_bench_is_valid_and_reads_back_as_it_is_written() {
    let bench = BenchFile::embedded_default();
    assert_eq!(bench.port(), Port::Emulator);
    within(bench.program(1).unwrap().duration_s(), 10.0..14.0);
    is_read_back(bench);
}

#[test]
fn the_embedded_bench_documents_every_key() {
    let mut full = BenchFile::embedded_default();
    full.link.deadline_ms = Some(1.0);
    full.motor.unknown = true;
    full.load = LoadSection {
        vertical: true,
        hold_current_a: Some(1.0),
        brake_release_s: Some(1.0),
        brake_apply_s: Some(1.0),
    };
    full.supply = SupplySection { regenerates: false, brake_power_w: Some(1.0) };
    full.limits = LimitsSection { travel_rad: Some(1.0), ..full.limits };
    if let Some(speed) = &mut full.speed {
        speed.bandwidth_rad_s = Some(1.0);
        speed.slew_v_per_s = Some(1.0);
        speed.actuator = Some(Actuator::Voltage);
        speed.drive_lag_s = Some(1.0);
        speed.rule = Some(Rule::ModulusOptimum);
        speed.gains = Some(GainsSection { proportional_v_s_per_rad: 1.0, integral_time_s: 1.0 });
    }
    for (key, _) in full.to_toml().lines().filter_map(|line| line.split_once(" = ")) {
        has(EMBEDDED_DEFAULT, &format!("{key} = "));
    }
}

#[test]
fn an_unknown_part_of_a_sequence_has_its_nearest_one() {
    let error = changed("\nstandstill = {", "\nstandstil = {").unwrap_err();
    assert_eq!(error.help(), "did you mean `standstill`?");
}

#[test]
fn an_impossible_value_is_named_with_key_and_allowed_range() {
    for (from, to, key) in [
        ("rate_hz = 100.0", "rate_hz = 0.0", "link.rate_hz = 0"),
        ("inertia_kg_m2 = 0.0045", "inertia_kg_m2 = -1.0", "motor.inertia_kg_m2 = -1"),
        ("slew_v_per_s = ", "slew_v_per_s = 0.0 # ", "limits.slew_v_per_s = 0"),
        ("link_silence_s = 0.45", "link_silence_s = 0.015", "limits.link_silence_s = 0.015"),
        ("port = \"emulator\"", "port = \"tcp:nowhere\"", "link.port = \"tcp:nowhere\""),
        ("time_s = ", "time_s = inf # ", "limits.time_s = inf"),
    ] {
        let error = changed(from, to).unwrap_err();
        has(&error, key);
        has(&error, "expected");
    }
    has(changed("seconds = 0.25", "seconds = -0.25").unwrap_err(), "sequence part 1 (standstill)");
}

#[test]
fn runs_of_equal_seeds_are_equal_and_of_others_not() {
    let bench = BenchFile::embedded_default();
    let runs = bench.runs;
    let corners = |seed| bench.program(seed).unwrap().polyline();
    assert_eq!(corners(runs.fit), corners(runs.repeat));
    assert_ne!(corners(runs.fit), corners(runs.select));
    assert_ne!(corners(runs.select), corners(runs.confirm));
}

#[test]
fn ports_have_one_text_form_each() {
    let tcp = |address: &str| Some(Port::Tcp(address.to_owned()));
    for (text, port) in [
        ("sim:", Some(Port::Sim)),
        ("sim:rtu", Some(Port::SimRtu)),
        ("tcp:h:502", tcp("h:502")),
        ("tcp:[::1]:502", tcp("[::1]:502")),
        ("tcp:502", None),
        ("", None),
        ("/dev/ttyUSB0", Some(Port::Serial("/dev/ttyUSB0".to_owned()))),
    ] {
        assert_eq!(Port::parse(text), port, "{text}");
    }
}

#[test]
fn all_but_the_rated_values_may_be_left_out() {
    let bench = changed("\ncurrent_a = ", "\n# current_a = ").unwrap();
    near(bench.limits().current_a, 4.0 * 5.7, 1e-12);
    let bench = changed("inertia_kg_m2 = 0.0045 ", "# ").unwrap();
    assert!(bench.motor.is_unknown() && bench.nameplate().is_none());
    assert_eq!(bench.motor.missing(), Some("inertia_kg_m2"));
    is_read_back(bench);
    let unknown = changed("name = \"ZK-22FC\"", "name = \"ZK-22FC\"\nunknown = true").unwrap();
    assert!(unknown.motor.is_unknown() && unknown.nameplate().is_some());
    assert!(!BenchFile::embedded_default().motor.is_unknown());
    has(changed("rated_current_a = 5.7 ", "# ").unwrap_err(), "rated_current_a");
}

#[test]
fn a_reference_beyond_a_limit_is_refused_with_line_and_value() {
    let (right, wrong) = ("high_rad_s = 110.0", "high_rad_s = 400.0");
    // A run of the excitation does not follow it.
    assert!(changed(right, wrong).is_ok());
    let error = changed_for_speed(right, wrong).unwrap_err();
    let BenchFileError::Text(place) = &error else {
        panic!("{error}");
    };
    assert_eq!(place.line, line_of("square = {"));
    // (110 V - 1.1 ohm 0.455 N.m/Kt)/Ke is less than the speed limit.
    has(&error, "high_rad_s = 400");
    has(&error, "306.9");
}

#[test]
fn a_speed_section_is_strict() {
    let beyond =
        "speed.current_limit_a = 14 is not allowed (expected up to limits.current_a = 13 A)";
    for (from, to, expected) in [
        ("controller = \"addc\"", "controller = \"pid\"", "pid"),
        ("rule = \"modulus", "rule = \"modulo", "modulo-optimum"),
        ("current_limit_a = 10.0", "current_limit_a = 14.0", beyond),
        ("# bandwidth_rad_s = 20.0", "bandwidth_rad_s = -1.0", "speed.bandwidth_rad_s = -1"),
        ("half_period_s = 2.0", "half_period_s = 5.0", "limits.time_s = 30"),
        ("periods = 3", "period = 3", "period"),
    ] {
        has(changed_for_speed(from, to).unwrap_err(), expected);
    }
    let without = changed("[speed]", "[[sequence]]\nstandstill = { seconds = 0.5 }\n#").map(drop);
    assert!(without.is_err(), "keys of [speed] are none of a sequence");
}

#[test]
fn load_and_supply_become_limits_or_are_refused() {
    let with = |sections: &str| changed("[runs]", &format!("{sections}\n[runs]"));
    let brake = "hold_current_a = 2.0\nbrake_release_s = 0.3\nbrake_apply_s = 0.2";
    let supply = "[supply]\nregenerates = false\nbrake_power_w = 40.0";
    let bench = with(&format!("[load]\nvertical = true\n{brake}\n{supply}")).unwrap();
    let limits = bench.limits();
    assert_eq!(limits.braking_w, Some(40.0));
    assert_eq!(limits.load.brake().map(|brake| brake.release_s), Some(0.3));
    is_read_back(bench);
    for (section, words) in [
        (&*format!("load]\n{brake}"), "nothing without load.vertical"),
        ("load]\nvertical = true\nhold_current_a = 40.0", "less than limits.current_a"),
        ("load]\nvertical = true\nbrake_apply_s = -1.0", "0 to 10 s"),
        ("load]\nvertikal = true", "vertikal"),
        ("supply]\nbrake_power_w = 4.0", "nothing without supply.regenerates"),
        ("supply]\nregenerates = false\nbrake_power_w = nan", "0 or more"),
    ] {
        has(with(&format!("[{section}")).unwrap_err(), words);
    }
    let unknown = changed_text("# unknown = false", "unknown = true");
    let unknown = unknown.replacen("[runs]", "[load]\nvertical = true\n[runs]", 1);
    has(BenchFile::parse("b.toml", &unknown).unwrap_err(), "a known motor");
}
