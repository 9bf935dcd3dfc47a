use super::*;

#[test]
fn every_embedded_configuration_is_valid_and_the_default_hides_something() {
    let mut names = EmulatorConfig::embedded_names();
    assert!(names.all(|name| EmulatorConfig::embedded(name).is_ok()));
    assert_eq!(EmulatorConfig::embedded_default().hidden.len(), 1);
}

fn refusal(text: &str) -> EmulatorConfigError {
    EmulatorConfig::parse("e.toml", text).unwrap_err()
}

const EXAMPLE: &str = include_str!("../../../../bench-configs/emulators/example.toml");

/// Every effect of the example, those behind a `#` too, in catalogue order.
fn every_hidden_effect() -> Vec<HiddenEffect> {
    let text = EXAMPLE.replace("\n#[[hidden]]", "\n[[hidden]]");
    let (head, blocks) = text.split_once("[[hidden]]").unwrap();
    let mut effects: Vec<HiddenEffect> = blocks
        .split("[[hidden]]")
        .map(|block| {
            let keys = block.lines().map(|line| line.strip_prefix('#').unwrap_or(line));
            let keys = keys.filter(|line| line.contains(" = ") && !line.starts_with(' '));
            let keys: Vec<&str> = keys.collect();
            let text = format!("{head}[[hidden]]\n{}", keys.join("\n"));
            EmulatorConfig::parse("example.toml", &text).unwrap().hidden[0].clone()
        })
        .collect();
    let place = |effect: &HiddenEffect| HiddenEffect::ids().position(|id| id == effect.id());
    effects.sort_by_key(place);
    effects
}

#[test]
fn a_second_inertia_behind_a_second_inertia_is_refused() {
    let mut config = EmulatorConfig::parse("example.toml", EXAMPLE).unwrap();
    config.hidden = every_hidden_effect().into_iter().filter(HiddenEffect::is_shaft).collect();
    let error = refusal(&toml::to_string(&config).unwrap());
    assert!(matches!(error, EmulatorConfigError::TwoShafts { .. }), "{error}");
    config.hidden.truncate(1);
    EmulatorConfig::parse("e.toml", &toml::to_string(&config).unwrap()).unwrap();
}

#[test]
fn the_example_documents_every_key() {
    let mut full = EmulatorConfig::parse("example.toml", EXAMPLE).unwrap();
    full.hidden = every_hidden_effect();
    let ids: Vec<&str> = full.hidden.iter().map(HiddenEffect::id).collect();
    assert!(HiddenEffect::ids().eq(ids));
    full.motor.torque_n_m_per_a = Some(0.35);
    full.line.gap_us = Some(1750.0);
    full.faults.encoder_frozen_from_s = Some(1.0);
    full.changes = vec![Change { time_s: 1.0, inertia_ratio: 2.0, load_n_m: 0.5 }];
    let text = toml::to_string(&full).unwrap();
    for (key, _) in text.lines().filter_map(|line| line.split_once(" = ")) {
        let mut places = ["", "#", "# "].map(|mark| format!("\n{mark}{key} = ")).into_iter();
        assert!(places.any(|place| EXAMPLE.contains(&place)), "{key}");
    }
}

#[test]
fn the_example_states_the_defaults_as_they_are() {
    // Every key with a default, left out.
    let optional = [
        "tolerance",
        "winding_limit_c",
        "watchdog_ms",
        "output_off",
        "voltage_v",
        "bus_v = 0",
        "angle_rad",
    ];
    let example = EmulatorConfig::parse("example.toml", EXAMPLE).unwrap();
    let is_given = |line: &&str| !optional.iter().any(|key| line.starts_with(key));
    let short: Vec<&str> = EXAMPLE.lines().filter(is_given).collect();
    let defaulted = EmulatorConfig::parse("short", &short.join("\n")).unwrap();
    assert_eq!(defaulted.watchdog_ms, example.watchdog_ms);
    assert_eq!(defaulted.limits, example.limits);
    assert_eq!(example.line, LineConfig::default());
}

#[test]
fn a_change_that_no_bench_can_make_is_refused() {
    let with =
        |changes: &str| EmulatorConfig::parse("e.toml", &format!("{EXAMPLE}\n{changes}")).map(drop);
    assert!(with("[[change]]\ntime_s = 1.0\n[[change]]\ntime_s = 2.0\nload_n_m = -1").is_ok());
    let twice = "time_s = 2.0\n[[change]]\ntime_s = 2.0";
    for (change, expected) in [
        ("time_s = -1.0", "change.time_s = -1"),
        ("time_s = nan", "change.time_s = NaN"),
        (twice, "later than the change before"),
        ("time_s = 1\ninertia_ratio = 0.0", "change.inertia_ratio = 0"),
        ("time_s = 1\nload_n_m = 2e9", "change.load_n_m = 2000000000"),
        ("inertia_ratio = 2.0", "missing field `time_s`"),
        ("time_s = 1\ninertia = 2.0", "unknown field `inertia`"),
    ] {
        let error = with(&format!("[[change]]\n{change}")).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    let key = "encoder_frozen_from_s = ";
    let frozen = EXAMPLE.replace(&format!("# {key}2.0"), &format!("{key}-2.0"));
    let error = refusal(&frozen).to_string();
    assert!(error.contains("encoder_frozen_from_s = -2"), "{error}");
}

#[test]
fn unknown_names_are_refused_with_line_and_nearest_name() {
    for (from, to) in [
        ("current_limit_a", "curent_limit_a"),
        ("drop_v", "drop_volts"),
        ("voltage_drop", "voltage_dorp"),
    ] {
        let text = EXAMPLE.replace(from, to);
        let error = refusal(&text);
        assert_eq!(error.help(), format!("did you mean `{from}`?"));
        let EmulatorConfigError::Text(place) = &error else {
            panic!("{error}");
        };
        if to == "curent_limit_a" {
            let line = text.lines().position(|line| line.starts_with(to));
            assert_eq!(place.line, line.unwrap() + 1);
        }
        assert!(error.to_string().contains(to), "{error}");
    }
}

#[test]
fn a_flux_that_runs_away_is_refused_with_the_largest_size() {
    let with = |size: &str| {
        let text = format!(
            "{EXAMPLE}\n[[hidden]]\nid = \"flux_saturation\"\nsaturation_per_a2 = {size}\n"
        );
        EmulatorConfig::parse("e.toml", &text)
    };
    assert!(with("4e-4").is_ok());
    let error = with("6e-4").unwrap_err();
    assert!(error.to_string().contains("0 to 5.4e-4"), "{error}");
}

#[test]
fn values_that_no_drive_can_have_are_refused() {
    for (from, to) in [
        ("tolerance = 0.0", "tolerance = 0.7"),
        ("watchdog_ms = 200", "watchdog_ms = 5"),
        ("inertia_kg_m2 = 0.0045", "inertia_kg_m2 = -1"),
        ("stribeck_speed_rad_s = 10.0", "stribeck_speed_rad_s = 0"),
        ("current_limit_a = 11.4", "current_limit_a = nan"),
    ] {
        assert!(EXAMPLE.contains(from), "{from}");
        let error = refusal(&EXAMPLE.replace(from, to));
        assert!(error.to_string().contains(from.split(' ').next().unwrap()), "{error}");
    }
}
