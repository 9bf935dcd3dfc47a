//! `identify` over several runs of one machine, with an added inertia, behind a gearbox; through the real binary.

use crate::kit::prelude::*;

/// A run in virtual time of the plain ZK-22FC with torque constant 0.30 N.m/A and the given inertia, kg.m2.
fn run_with(inertia_kg_m2: f64, seed: u32) -> Recorded {
    let emulator = PLAIN.replace("tolerance = 0.1", "tolerance = 0.0").replace(
        "inertia_kg_m2 = 0.0045",
        &format!("inertia_kg_m2 = {inertia_kg_m2}\ntorque_n_m_per_a = 0.30"),
    );
    let desk = Desk::new();
    let file = desk.put("emulator.toml", &emulator);
    recorded(&format!("--emulator {{}} --seed {seed}"), &[&file])
}

#[test]
fn a_known_added_inertia_gives_the_absolute_scale() {
    let (bare, disc) = (run_with(0.0045, 1), run_with(0.005, 2));
    let added = format!("{}=0.0005", disc.display());
    let text = format!("identify {{}} --added-inertia {added} --json");
    let done = call(&text, &[&bare]).expect(0);
    let found = done.json();
    for (key, truth) in
        [("torque_n_m_per_a", 0.30), ("inertia_kg_m2", 0.0045), ("load_torque_n_m", 0.455)]
    {
        let value = number(&found, &format!("/absolute/{key}/value"));
        let std = number(&found, &format!("/absolute/{key}/std"));
        assert!((value / truth - 1.0).abs() < 0.01, "{key} {value}");
        assert!((value - truth).abs() < 4.0 * std, "{key} {value} +- {std}");
    }
    // Without the disc Kt = Ke = 0.3538 is assumed, and everything mechanical is as much too large.
    let assumed = number(&found, "/parameters/inertia_kg_m2/value");
    assert!((assumed / 0.0045 - 0.3538 / 0.30).abs() < 0.01, "{assumed}");
    lacks(&done.stdout, &["plausible"]);

    let ten_times = format!("identify {{}} --added-inertia {}=0.005 --json", disc.display());
    let wrong = call(&ten_times, &[&bare]).expect(0);
    has(&wrong.stdout, &["plausible"]);
}

#[test]
fn several_runs_give_the_spread_between_them() {
    let runs = [run_with(0.0045, 3), run_with(0.0045, 4), run_with(0.0047, 5)];
    let paths: Vec<_> = runs.iter().map(|run| &**run).collect();
    let found = json_of("identify {} {} {} --json --gear-ratio 10", &paths);
    let at = |pointer: &str| number(&found, pointer);
    assert!((at("/parameters/inertia_kg_m2/runs") - 3.0).abs() < 1e-9);
    // 0.0045, 0.0045, 0.0047, times Ke/Kt.
    let expected = 0.3538 / 0.30 * 0.0002 / 3f64.sqrt();
    let spread = at("/parameters/inertia_kg_m2/run_to_run_std");
    assert!((spread / expected - 1.0).abs() < 0.05, "{spread} {expected}");
    let reason = &found["parameters"]["inertia_kg_m2"]["reason"];
    assert!(reason.as_str().unwrap().contains("run to run"), "{reason}");
    assert_eq!(found["parameters"]["resistance_ohm"]["verdict"], "settled");
    assert_eq!(found["runs"].as_array().map(Vec::len), Some(3));
    let load = at("/load_shaft/parameters/inertia_kg_m2/value");
    assert!((load / at("/parameters/inertia_kg_m2/value") - 100.0).abs() < 1e-9);
}

#[test]
fn a_drive_that_limits_the_voltage_settles_nothing() {
    // The embedded program on twice the inertia: the emulated drive reaches its current limit.
    let heavy = run_with(0.0095, 7);
    let found = json_of("identify {} --json", &[&heavy]);
    for (key, parameter) in found["parameters"].as_object().unwrap() {
        assert_ne!(parameter["verdict"], "settled", "{key} {parameter}");
    }
    assert!(found["notes"].to_string().contains("limited it"), "{found:#}");
}

#[test]
fn a_nameplate_that_does_not_fit_is_reported_with_both_numbers() {
    let run = run_with(0.0045, 8);
    let plate = include_str!("../../bench-configs/motors/zk-22fc.toml");
    let folder = Desk::new();
    let file = folder.path("motor.toml");
    let compare = |text: &str| {
        fs::write(&file, text).expect("a temporary file");
        json_of("identify {} --nameplate {} --json", &[&run, &file])
    };
    assert_eq!(compare(plate)["nameplate"]["fits"], true);
    let other = compare(&plate.replace("resistance_ohm = 1.1 ", "resistance_ohm = 3.3 "));
    assert_eq!(other["nameplate"]["fits"], false);
    let rows = other["nameplate"]["rows"].to_string();
    assert!(rows.contains("3.300 ohm"), "{rows}");
}

#[test]
fn a_load_trace_never_overwrites_a_record() {
    let run = run_with(0.0045, 9);
    let samples = run.join("samples.csv");
    let model = run.join("model.toml");
    let before = fs::read(&samples).expect("a record");
    let text = "identify {} --model {} --load-torque {}";
    call(text, &[&samples, &model, &samples]).fails(2, &["nothing is overwritten"]);
    assert_eq!(fs::read(&samples).expect("a record"), before);
}

#[test]
fn wrong_options_are_named_with_what_is_allowed() {
    refusals(
        "identify {} --gear-ratio 0           => 0.001 to 100000
         identify {} --added-inertia disc     => RUN=KG_M2
         identify {} --added-inertia disc=-1  => RUN=KG_M2
         identify {} --known-arm 0.5          => KG,M
         identify {} --known-arm 0.5,-0.1     => KG,M
         identify {} --known-arm inf,0.1      => KG,M
         identify {} --scheme 4               => output-error",
        &[&Runs::plain().fit],
    );
}

#[test]
fn one_size_has_one_deviation_whatever_command_gives_it() {
    let runs = Runs::hidden();
    let desk = Desk::new();
    let better = desk.path("better.toml");
    let (fit, holdout): (&Path, &Path) = (&runs.fit, &runs.holdout);
    let id = "stribeck_friction";
    let add = format!("add {id} --run {{}} --holdout {{}} --output {{}} --json");
    let added = call(&add, &[fit, holdout, &better]).expect(0).json();
    let diagnosed = json_of("diagnose {} --holdout {} --json", &[fit, holdout]);
    let remove = format!("remove {id} --model {{}} --run {{}} --holdout {{}} --json");
    let removed = call(&remove, &[&better, fit, holdout]).expect(1).json();
    let identified = json_of("identify {} --model {} --json", &[fit, &better]);
    let written = fs::read_to_string(&better).expect("a model file");
    let written: toml::Table = written.parse().expect("a model file");
    let of_file = |key: &str| {
        let fitted = written["history"]["fitted"].as_array().expect("a list");
        let own =
            fitted.iter().find(|own| own["key"].as_str() == Some(key)).expect("a fitted value");
        own["std"].as_float().expect("a number")
    };
    let at = |found: &Value, place: &str, what: &str| number(found, &format!("{place}/{what}"));
    for key in ["stribeck_n_m", "stribeck_speed_rad_s"] {
        let place = format!("/parameters/{key}");
        let own = format!("/parameters/{id}.{key}");
        let named = format!("/candidates/0/parameters/{key}");
        let value = at(&added, &place, "value");
        let std = at(&added, &place, "std");
        let of_file = of_file(&format!("{id}.{key}"));
        assert!((of_file / std - 1.0).abs() < 1e-12, "{of_file} {std}");
        for (command, found, place, share) in [
            ("diagnose", &diagnosed, &named, 1e-9),
            // What starts from the values found ends within some hundredths of their deviations of them.
            ("remove", &removed, &place, 0.1),
            // One run alone determines its random part less accurately than two.
            ("identify", &identified, &own, 0.4),
        ] {
            let apart = (at(found, place, "value") - value) / std;
            let wider = at(found, place, "std") / std;
            assert!(
                apart.abs() < share && (wider - 1.0).abs() < share,
                "{command} {key}: {apart} deviations apart, {wider} times as wide"
            );
        }
    }
    for key in ["resistance_ohm", "inertia_kg_m2"] {
        let wider = at(&identified, &format!("/parameters/{key}"), "std") / of_file(key);
        assert!((wider - 1.0).abs() < 0.4, "{key}: {wider} times as wide");
    }
    // The cards show the same number.
    let card = |text: &str, paths: &[&Path]| {
        let shown = call(text, paths).stdout;
        let is_size = |row: &&str| row.contains("stribeck_n_m") && row.contains('±');
        let mut rows = shown.lines().filter(is_size);
        let row = rows.next().expect("a row with the size").to_owned();
        let from = row.find("stribeck_n_m").expect("it was found") + "stribeck_n_m".len();
        row[from..].split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let of_diagnose = card("diagnose {} --holdout {}", &[fit, holdout]);
    let add = format!("add {id} --run {{}} --holdout {{}}");
    assert_eq!(of_diagnose, card(&add, &[fit, holdout]).replacen("N.m ", "N.m - ", 1));
}

/// One step of voltage out of rest at 20 Hz, voltage and speed only: 2.4 rad/s/V and 0.12 s behind 0.4 V of friction.
fn step_of(volts: f64) -> String {
    let row = |row: u8| {
        let time_s = 0.05 * f64::from(row);
        let speed = 2.4 * (volts - 0.4) * (1.0 - (-time_s / 0.12).exp());
        // Rounded as a counter gives it.
        format!("{time_s:.2},{volts},{speed:.2}\n")
    };
    let rows = (0..60).map(row).collect::<String>();
    format!("time_s,voltage_v,speed_rad_s\n{rows}")
}

#[test]
fn steps_of_several_levels_have_together_what_none_has_alone() {
    let desk = Desk::new();
    let model = desk.put(
        "model.toml",
        "[motor]\nname = \"geared\"\nresistance_ohm = 8.0\ninductance_h = 0.003\n\
         fixed = [\"resistance_ohm\", \"inductance_h\"]\n",
    );
    let levels = [4.0, 6.0, 8.0, 10.0, 11.0, 12.0];
    let files = levels.map(|volts| desk.put(&format!("v{volts}.csv"), &step_of(volts)));
    let mut paths: Vec<&Path> = files.iter().map(|file| &**file).collect();
    paths.push(&model);
    let found = json_of("identify {} {} {} {} {} {} --model {} --json", &paths);
    let back_emf = number(&found, "/parameters/back_emf_v_s_per_rad/value");
    assert!((back_emf * 2.4 - 1.0).abs() < 0.02, "{found:#}");
    let inertia = number(&found, "/parameters/inertia_kg_m2/value");
    assert!((inertia * 8.0 * 2.4 * 2.4 / 0.12 - 1.0).abs() < 0.1, "{found:#}");
    assert_eq!(found["joint"], true);
    let gain = number(&found, "/parameters/first_order.gain_rad_s_per_v/value");
    assert!((gain / 2.4 - 1.0).abs() < 0.02, "{found:#}");
    let alone = json_of("identify {} --model {} --json", &[&files[2], &model]);
    let reason = &alone["parameters"]["back_emf_v_s_per_rad"]["reason"];
    assert!(reason.as_str().unwrap().contains("together with"), "{reason}");
}
