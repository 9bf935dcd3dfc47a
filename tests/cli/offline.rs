//! The command line on recorded runs, through the real binary: `run` and `commission` in virtual time, and everything that works on files.

use crate::kit::prelude::*;

fn record(desk: &Desk, emulator: &str, run_seed: &str) -> Done {
    let options = format!("--emulator {emulator} --seed 7 --run-seed {run_seed}");
    desk.simulate("run --headless", &options, &[]).expect(0)
}

/// A command on the hidden motor's runs: `{}` are fit, hold-out and model, then `more`.
fn on_hidden(text: &str, more: &[&Path]) -> Done {
    let runs = Runs::hidden();
    let paths: [&Path; 3] = [&runs.fit, &runs.holdout, &runs.model];
    call(text, &[&paths, more].concat())
}

/// Each parameter as the contract of `identify` has it.
#[track_caller]
fn check_parameters(parameters: &Value) {
    let parameters = parameters.as_object().expect("a table of parameters");
    assert!(!parameters.is_empty());
    for (key, found) in parameters {
        let verdict = word(found, "/verdict");
        let allowed = ["settled", "searching", "not_observable", "invalid", "fixed"];
        assert!(allowed.contains(&verdict), "{key}: {verdict}");
        assert!(found["unit"].is_string(), "{key}");
        match verdict {
            "not_observable" => assert!(found["value"].is_null() && found["std"].is_null()),
            "invalid" => assert!(found["value"].is_number() && found["reason"].is_string()),
            "settled" | "searching" => assert!(number(found, "/std") > 0.0, "{key}"),
            _ => assert!(found["value"].is_number(), "{key}"),
        }
    }
}

#[test]
fn a_run_leaves_a_complete_folder_and_one_json_document() {
    let desk = Desk::new();
    let result = record(&desk, "zk-22fc-plain", "1").json();
    let folder = desk.run();
    assert_eq!(Path::new(word(&result, "/folder")), folder);
    check_parameters(&result["parameters"]);
    let files = "samples.csv events.jsonl manifest.json model.toml result.json report.html";
    for file in files.split(' ') {
        let size = fs::metadata(folder.join(file)).map_or(0, |metadata| metadata.len());
        assert!(size > 0, "{file}");
    }
    let manifest = desk.manifest();
    assert_eq!(manifest["finished"], true);
    let rows = desk.read("samples.csv").lines().count() - 1;
    assert_eq!(manifest["rows"].as_u64(), Some(rows as u64));
    for event in desk.read("events.jsonl").lines() {
        assert!(serde_json::from_str::<Value>(event).is_ok(), "{event}");
    }
}

#[test]
fn identify_finds_the_motor_that_was_emulated() {
    // The specimen lies within 10 % of the nameplate; every scheme must come to the same one.
    let runs = Runs::plain();
    let inertia = |scheme: &str| {
        let text = format!("identify {{}} --scheme {scheme} --json");
        let found = json_of(&text, &[&runs.fit]);
        assert_eq!(word(&found, "/scheme"), scheme);
        number(&found, "/parameters/inertia_kg_m2/value")
    };
    let reference = inertia("output-error");
    assert!((reference / 0.0045 - 1.0).abs() < 0.12, "{reference}");
    for scheme in ["weak-form", "2", "3"] {
        let other = inertia(scheme);
        assert!((other / reference - 1.0).abs() < 0.05, "{scheme}: {other}, not {reference}");
    }
}

#[test]
fn an_unmet_requirement_is_status_5_with_the_json() {
    let done = on_hidden("identify {} --require rotor_colour --json", &[]).expect(5);
    check_parameters(&done.json()["parameters"]);
    has(&done.error(), &["rotor_colour"]);
    let found = done.json();
    assert_eq!(word(&found, "/scheme"), "output-error");
    assert!((number(&found, "/period_s") - 0.01).abs() < 1e-6);
    assert!(found["parameters"]["resistance_ohm"]["value"].is_number());
}

#[test]
fn compare_keeps_its_contract() {
    let found = on_hidden("compare {} --holdout {} --model {} --json", &[]).expect(0).json();
    for signal in ["speed_rad_s", "current_a"] {
        for key in
            "fit_percent rmse noise_floor one_step_rmse holdout/fit_percent holdout/rmse".split(' ')
        {
            number(&found, &format!("/signals/{signal}/{key}"));
        }
    }
    let places = found["where"].as_array().unwrap();
    assert!(!places.is_empty());
    for place in places {
        for key in ["equation", "variable", "sentence"] {
            word(place, &format!("/{key}"));
        }
        let (from, to) = (number(place, "/from"), number(place, "/to"));
        assert!(from < to, "{place:#}");
        for share in ["share_of_error", "share_of_time"] {
            let share = number(place, &format!("/{share}"));
            assert!((0.0..=1.0).contains(&share), "{place:#}");
        }
    }
    assert_eq!(found["residual"]["white"], false);
    let outside = number(&found, "/residual/autocorrelation_outside_99_percent");
    assert!((0.0..=1.0).contains(&outside));
    assert_eq!(word(&found, "/holdout_from"), "run");
}

#[test]
fn a_fit_below_the_least_is_status_1() {
    let text = "compare {} --holdout {} --model {} --json --min-fit";
    let done = on_hidden(&format!("{text} 99.99"), &[]).expect(1);
    assert!(done.json()["signals"].is_object());
    has(&done.error(), &["99.99"]);
    on_hidden(&format!("{text} 50"), &[]).expect(0);
}

#[test]
fn diagnose_names_the_hidden_effect() {
    let found = on_hidden("diagnose {} --holdout {} --model {} --json", &[]).expect(0).json();
    assert_eq!(word(&found, "/verdict"), "effect");
    assert_eq!(word(&found, "/effect"), "stribeck_friction");
    assert_eq!(found["effects"][0], "stribeck_friction");
    assert_eq!(word(&found, "/holdout_from"), "run");
    assert_eq!(word(&found, "/noise_floor_from"), "standstill");
    assert!(number(&found, "/explained_percent") > 90.0);
    let candidates = found["candidates"].as_array().unwrap();
    for (index, candidate) in candidates.iter().enumerate() {
        assert_eq!(candidate["rank"].as_u64(), Some(index as u64 + 1));
        let status = word(candidate, "/status");
        let allowed = ["supported", "possible", "ruled_out", "not_excited"];
        assert!(allowed.contains(&status), "{status}");
        assert!(!word(candidate, "/evidence").is_empty());
    }
    let first = &candidates[0];
    assert_eq!(word(first, "/status"), "supported");
    // The emulator's friction has another form, so the size is near, not equal.
    let size = number(first, "/parameters/stribeck_n_m/value");
    assert!((0.1..0.22).contains(&size), "{size}");
    assert!(number(first, "/holdout_after") < 0.5 * number(first, "/holdout_before"));
    assert!(found["confusable"].is_array());
    // The next experiment, where there is one, is a bench file that `plan` takes.
    if let Some(bench) = found.pointer("/next_experiment/bench").and_then(Value::as_str) {
        let folder = Desk::new();
        let file = folder.path("next.toml");
        fs::write(&file, bench).unwrap();
        call("plan {}", &[&file]).expect(0);
    }
}

#[test]
fn what_was_not_computed_is_null_and_sizes_have_a_torque() {
    let found = on_hidden("diagnose {} --holdout {} --model {} --json", &[]).expect(0).json();
    let candidates = found["candidates"].as_array().unwrap();
    let torque = &candidates[0]["reached"]["torque_n_m"];
    let level = number(&candidates[0], "/parameters/stribeck_n_m/value");
    // At standstill the hump is at its level.
    assert!((number(torque, "/value") / level - 1.0).abs() < 1e-3);
    assert_eq!(word(torque, "/unit"), "N.m");
    assert!(torque["interval_95"][0].as_f64() < torque["interval_95"][1].as_f64());
    let mut passed_over = 0;
    for candidate in candidates {
        let probability = number(candidate, "/probability");
        assert!((0.0..=1.0).contains(&probability), "{candidate}");
        let is_named = found["effects"].as_array().unwrap().contains(&candidate["effect"]);
        let factor = number(candidate, "/interval_factor");
        assert!((factor - 1.0).abs() < 1e-9 || (factor - 2.0).abs() < 1e-9);
        if is_named {
            assert!(candidate["holdout_after"].is_number(), "{candidate}");
        } else {
            for key in "holdout_after error_after explained_percent reached".split(' ') {
                assert!(candidate[key].is_null(), "{key}: {candidate}");
            }
            passed_over += 1;
        }
    }
    assert!(passed_over > 3, "{passed_over} of {}", candidates.len());
}

#[test]
fn pages_are_whole_and_never_overwritten() {
    let folder = Desk::new();
    for (command, parts) in [
        (
            "diagnose {} --holdout {} --model {} --json --html {}",
            vec!["Ladder of models", "Effects that were tried", "noise floor", "in this run"],
        ),
        (
            "compare {} --holdout {} --model {} --json --html {}",
            vec!["Above the noise floor", "Residual tests", "class=\"cell\""],
        ),
    ] {
        let page = folder.path(format!("{}.html", parts.len()));
        on_hidden(command, &[&page]).expect(0).json();
        let html = fs::read_to_string(&page).unwrap();
        for part in parts.iter().chain(&["Where the model fails", "<svg", "</html>"]) {
            assert!(html.contains(part), "{part} is missing in {command}");
        }
        for outside in ["http://", "https://", "NaN", "src="] {
            assert!(!html.contains(outside), "{outside} in {command}");
        }
        on_hidden(command, &[&page]).expect(2).error();
        assert_eq!(fs::read_to_string(&page).unwrap(), html);
    }
}

#[test]
fn add_writes_a_model_for_other_commands_and_overwrites_none() {
    let folder = Desk::new();
    let richer = folder.path("richer.toml");
    let add = "--run {} --holdout {} --model {} --output {} --json";
    let text = format!("add stribeck_friction {add}");
    let found = on_hidden(&text, &[&richer]).expect(0).json();
    assert_eq!(found["accepted"], true);
    assert!(!word(&found, "/reason").is_empty());
    let speed = "/speed_rad_s/holdout/rmse";
    let (before, after) = (number(&found["before"], speed), number(&found["after"], speed));
    assert!(after < 0.5 * before, "{before} -> {after}");
    check_parameters(&found["parameters"]);
    let ladder = found["ladder"].as_array().unwrap();
    assert_eq!(ladder[0]["effects"], json!([]));
    assert_eq!(ladder[1]["effects"][0], "stribeck_friction");
    assert!(number(&ladder[1], "/holdout_rmse") < number(&ladder[0], "/holdout_rmse"));

    // Written, complete, and kept.
    let text_before = fs::read_to_string(&richer).unwrap();
    assert!(text_before.contains("stribeck_speed_rad_s"));
    on_hidden(&text, &[&richer]).fails(2, &["richer.toml"]);
    assert_eq!(fs::read_to_string(&richer).unwrap(), text_before);

    // A useless effect on top is refused, and nothing is written.
    let runs = Runs::hidden();
    let (fit, holdout): (&Path, &Path) = (&runs.fit, &runs.holdout);
    let none = folder.path("none.toml");
    let paths = [fit, holdout, &richer, &none];
    let refused = call(&format!("add voltage_drop {add}"), &paths).expect(1);
    assert_eq!(refused.json()["accepted"], false);
    assert!(!word(&refused.json(), "/reason").is_empty());
    let error = refused.error();
    has(&error, &["voltage_drop was not added", "--force"]);
    // The reason is given once.
    lacks(&error, &[word(&refused.json(), "/reason")]);
    // To remove what is needed is refused too.
    let kept = call(&format!("remove stribeck_friction {add}"), &paths).expect(1);
    assert_eq!(kept.json()["accepted"], false);
    assert!(!none.exists());

    // What is not needed can be removed.
    let (fuller, leaner) = (folder.path("fuller.toml"), folder.path("leaner.toml"));
    let with_drop = format!("{text_before}\n[[effect]]\nid = \"voltage_drop\"\ndrop_v = 0.01\n");
    fs::write(&fuller, with_drop).unwrap();
    let paths = [fit, holdout, &fuller, &leaner];
    let removed = call(&format!("remove voltage_drop {add}"), &paths).expect(0);
    assert_eq!(removed.json()["accepted"], true);
    let text = fs::read_to_string(&leaner).unwrap();
    has(&text, &["stribeck_friction"]);
    lacks(&text, &["id = \"voltage_drop\""]);

    // Simulated with its own model, a run is that model.
    let csv = folder.path("simulated.csv");
    let printed = call("simulate --model {} --run {}", &[&richer, fit]).expect(0);
    fs::write(&csv, &printed.stdout).unwrap();
    let same = json_of("compare {} --model {} --json", &[&csv, &richer]);
    for signal in ["speed_rad_s", "current_a"] {
        let fit = number(&same, &format!("/signals/{signal}/fit_percent"));
        assert!(fit > 99.9, "{signal}: {fit}");
    }
    let other = json_of("compare {} --model {} --json", &[&csv, &runs.model]);
    assert!(number(&other, "/signals/speed_rad_s/fit_percent") < 99.9);
}

/// The whole loop in virtual time; its JSON.
fn commission(emulator: &str, seed: &str) -> Value {
    let out = Desk::new();
    let text = format!(
        "commission --headless --port sim: --json --emulator {emulator} --seed {seed} --out {{}}"
    );
    let result = json_of(&text, &[out.folder()]);
    let runs = result["runs"].as_array().expect("a list of runs");
    assert!(runs.len() >= 3);
    for run in runs {
        assert!(Path::new(word(run, "/folder")).join("report.html").exists());
    }
    result
}

#[test]
fn commission_names_the_hidden_effect_and_halves_the_error() {
    // A specimen whose hidden friction stands well above the noise of the speed: of seed 23 after is 0.52 of before.
    let result = commission("zk-22fc-hidden", "1");
    assert_eq!(word(&result, "/diagnosis/verdict"), "effect");
    assert_eq!(word(&result, "/diagnosis/effect"), "stribeck_friction");
    assert_eq!(result["truth"]["named_correctly"], true);
    let rmse = |side: &str| number(&result[side], "/signals/speed_rad_s/holdout/rmse");
    let (before, after) = (rmse("before"), rmse("after"));
    assert!(after <= 0.5 * before, "{before} -> {after}");
    assert_eq!(result["ladder"][1]["effects"][0], "stribeck_friction");
}

#[test]
fn commission_names_nothing_where_nothing_is_hidden() {
    let result = commission("zk-22fc-plain", "1");
    assert_eq!(word(&result, "/diagnosis/verdict"), "none");
    assert!(result["diagnosis"]["effect"].is_null());
    assert_eq!(result["truth"]["named_correctly"], true);
}
