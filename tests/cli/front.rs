//! In and out of the program as a user meets it: called alone, the link to the newest run, models and runs for other tools,
//! two models on one run, what a shell and a script get.

use std::process::Command;

use crate::kit::prelude::*;

/// A model of the motor with these effects, as tables of a model file.
fn model(desk: &Desk, name: &str, effects: &str) -> PathBuf {
    desk.put(name, &format!("{MODEL}{effects}"))
}

const STRIBECK: &str =
    "[[effect]]\nid = \"stribeck_friction\"\nstribeck_n_m = 0.2\nstribeck_speed_rad_s = 8.0\n";

#[test]
fn called_alone_it_shows_the_loop_and_the_next_step() {
    let desk = Desk::new();
    let alone = || desk.call("").expect(0);
    let first = alone();
    assert_eq!(first.stderr, "");
    has(&first.stdout, &["no bench file, model or run yet", "Next\n  drivebench commission\n"]);
    desk.put("bench.toml", BENCH);
    has(&alone().stdout, &["bench files: bench.toml", "Next\n  drivebench plan bench.toml\n"]);
    desk.call("run bench.toml --headless --port sim:").expect(0);
    has(
        &alone().stdout,
        &["runs: 1, the newest ", "Next\n  drivebench diagnose runs/latest\n", "/report.html"],
    );
    model(&desk, "model.toml", STRIBECK);
    has(
        &alone().stdout,
        &[
            "model: model.toml (with stribeck_friction)",
            "Next\n  drivebench tune --model model.toml\n",
        ],
    );
    for row in alone().stdout.lines() {
        assert!(row.chars().count() <= 100, "{row}");
    }
}

#[test]
fn latest_is_the_newest_run_wherever_a_run_is_taken() {
    let desk = Desk::new();
    let record = |seed: &str| {
        let options = format!("--emulator zk-22fc-plain --run-seed {seed}");
        let done = desk.simulate("run --headless", &options, &[]).expect(0);
        PathBuf::from(word(&done.json(), "/folder"))
    };
    let link = desk.out().join("latest");
    let first = record("1");
    assert_eq!(fs::read_link(&link).unwrap(), Path::new(first.file_name().unwrap()));
    let second = record("2");
    assert_eq!(fs::read_link(&link).unwrap(), Path::new(second.file_name().unwrap()));
    for command in ["identify {}", "compare {}", "replay {}"] {
        let command = format!("{command} --json");
        let (through, direct) = (json_of(&command, &[&link]), json_of(&command, &[&second]));
        assert_eq!(through, direct, "{command}");
    }
    // What is written down names the run, not the link.
    let model = desk.path("added.toml");
    call("add viscous_friction --run {} --output {}", &[&link, &model]);
    let identified = desk.path("identified.toml");
    call("identify {} --output {}", &[&link, &identified]).expect(0);
    let text = fs::read_to_string(&identified).unwrap();
    has(&text, &[second.file_name().unwrap().to_str().unwrap()]);
    lacks(&text, &["latest"]);
}

#[test]
fn what_else_is_called_latest_stays_and_the_run_is_kept() {
    let desk = Desk::new();
    let own = desk.out().join("latest");
    fs::create_dir_all(&own).unwrap();
    fs::write(own.join("mine"), "mine").unwrap();
    let done = desk.simulate("commission --headless", "--emulator zk-22fc-plain", &[]).expect(0);
    assert_eq!(fs::read_to_string(own.join("mine")).unwrap(), "mine");
    assert_eq!(done.stderr.matches("no link `latest`").count(), 1, "{}", done.stderr);
}

#[test]
fn a_simulation_has_the_measurement_next_to_it() {
    let runs = Runs::plain();
    let paths: [&Path; 2] = [&runs.model, &runs.fit];
    let alone = call("simulate --model {} --run {}", &paths).expect(0).stdout;
    let both = call("simulate --model {} --run {} --measured", &paths).expect(0).stdout;
    assert_eq!(column(&alone, "speed_rad_s"), column(&both, "speed_rad_s"));
    let recorded = fs::read_to_string(runs.fit.join("samples.csv")).unwrap();
    for (signal, name) in
        [("current_a", "measured_current_a"), ("speed_rad_s", "measured_speed_rad_s")]
    {
        let (there, here) = (column(&recorded, signal), column(&both, name));
        assert!(here.len() > 1000 && there.len() >= here.len(), "{signal}");
        let known = here.iter().filter(|value| there.contains(value)).count();
        assert_eq!(known, here.len(), "{signal}: a value that was not measured");
        let model = column(&both, signal);
        let rms = |pairs: &mut dyn Iterator<Item = f64>| {
            let squares: Vec<f64> = pairs.map(|value| value * value).collect();
            (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
        };
        let error = rms(&mut here.iter().zip(&model).map(|(a, b)| a - b));
        let size = rms(&mut here.iter().copied());
        assert!(error < 0.1 * size, "{signal}: {error} of {size} between neighbours of a row");
    }
}

#[test]
fn of_two_models_one_is_better_only_beyond_chance() {
    let runs = Runs::hidden();
    let desk = Desk::new();
    let (bare, with) = (runs.model.clone(), desk.path("with.toml"));
    let add = "add stribeck_friction --run {} --holdout {} --output {}";
    call(add, &[&runs.fit, &runs.holdout, &with]).expect(0);
    let text = "compare {} --holdout {} --model {} --model {}";
    let found = json_of(&format!("{text} --json"), &[&runs.fit, &runs.holdout, &bare, &with]);
    assert_eq!(found["better"], "second", "{found}");
    assert_eq!(found["models"][1]["effects"][0], "stribeck_friction");
    let [before, after] = [0, 1].map(|one| found["holdout_rmse"][one].as_f64().unwrap());
    assert!(after < 0.5 * before, "{before} {after}");
    let swapped = json_of(&format!("{text} --json"), &[&runs.fit, &runs.holdout, &with, &bare]);
    assert_eq!(swapped["better"], "first");
    let same = call(text, &[&runs.fit, &runs.holdout, &with, &with]).expect(0);
    has(&same.stdout, &["A  ", "B  ", "both models give the same"]);
    let error = refusal(&format!("{text} --min-fit 90"), &[&runs.fit, &runs.holdout, &bare, &with]);
    has(&error, &["--min-fit", "one model"]);
    let three = format!("{text} --model {{}}");
    has(&refusal(&three, &[&runs.fit, &runs.holdout, &bare, &with, &bare]), &["more than two"]);
}

#[test]
fn behind_a_coupling_a_notch_is_tuned_for_every_draw() {
    let desk = Desk::new();
    let coupling = "[[effect]]\nid = \"elastic_coupling\"\nfrequency_hz = 22.0\ninertia_ratio = 0.5\n\
                    damping_ratio = 0.02\nfriction_split = 0.5\n\n[history]\n\
                    fitted = [{ key = \"elastic_coupling.frequency_hz\", std = 0.2 }]\n";
    let model = model(&desk, "elastic.toml", coupling);
    let tuned = json_of("tune --model {} --rate-hz 200 --delay-cycles 2 --json", &[&model]);
    assert_eq!(tuned["gains"]["notch"]["frequency_hz"], 22.0);
    assert_eq!(tuned["draws"]["count"], 200);
    assert_eq!(tuned["draws"]["stable_share"], 1.0);
    let worst = number(&tuned, "/draws/worst/gain_margin");
    assert!((1.8..number(&tuned, "/margins/gain_margin")).contains(&worst));
    let middle = &tuned["step"][10];
    assert!(number(middle, "/low") < number(middle, "/speed"));
    assert!(number(middle, "/high") > number(middle, "/speed"));
    let slow =
        json_of("tune --model {} --rate-hz 200 --delay-cycles 2 --json --no-notch", &[&model]);
    assert!(slow["gains"].get("notch").is_none());
    let hertz = |tuned: &Value| number(tuned, "/margins/bandwidth_rad_s") / std::f64::consts::TAU;
    assert!(hertz(&tuned) > 1.05 * hertz(&slow));
    let card =
        call("tune --model {} --rate-hz 200 --delay-cycles 2 --full", &[&model]).expect(0).stdout;
    let worth = format!(
        "a notch at 22.0 Hz keeps {:.1} Hz of bandwidth; without it {:.1} Hz",
        hertz(&tuned),
        hertz(&slow)
    );
    let flat = card.split_whitespace().collect::<Vec<_>>().join(" ");
    has(&flat, &[&worth, "worst of 200 draws of the parameters (100 % stable)"]);
    // It goes out whole or not at all.
    let gains = desk.put("gains.json", &tuned.to_string());
    let text = "export --model {} --to json --gains {} --limit-v 110";
    let document = json_of(text, &[&model, &gains]);
    assert_eq!(document["regulator"]["notch"]["frequency_hz"], 22.0);
}

#[test]
fn a_model_is_exported_with_its_own_gains_only() {
    let desk = Desk::new();
    let own = model(&desk, "own.toml", STRIBECK);
    let tuned = call("tune --model {} --json", &[&own]).expect(0).stdout;
    let gains = desk.put("gains.json", &tuned);
    let header = desk.path("pump-1.h");
    let text = "export --model {} --to c --gains {} --limit-v 110 --output {}";
    let done = call(text, &[&own, &gains, &header]).expect(0);
    has(&done.stdout, &["pump-1.h: ZK-22FC with stribeck_friction"]);
    let written = fs::read_to_string(&header).unwrap();
    has(&written, &["pump_1_step(", "pump_1_regulate(", "stribeck_friction_stribeck_n_m = 0.2,"]);
    has(&refusal(text, &[&own, &gains, &header]), &["nothing is overwritten"]);
    // It is a header that a strict compiler takes; where there is none, the test prints that.
    let source = desk.put("main.c", "#include \"pump-1.h\"\nint main(void) { return 0; }\n");
    let compiled = Command::new("cc")
        .args(["-std=c99", "-pedantic", "-Werror", "-Wall", "-fsyntax-only"])
        .arg(&source)
        .output();
    match compiled {
        Ok(output) => {
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        }
        Err(error) => eprintln!("SKIPPED: no C compiler: {error}"),
    }
    let document = json_of("export --model {} --to json", &[&own]);
    assert_eq!(document["motor"]["inertia_kg_m2"], 0.0045);
    assert_eq!(document["effect"][0]["id"], "stribeck_friction");
    let law = word(&document, "/laws/0/terms/0/formula");
    assert_eq!(law, "stribeck_n_m * exp(-(w / stribeck_speed_rad_s)^2.0)");
    let other =
        desk.put("other.toml", &fs::read_to_string(&own).unwrap().replace("0.0045", "0.009"));
    let text = "export --model {} --to python --gains {} --limit-v 110";
    has(&refusal(text, &[&other, &gains]), &["gains of another model", "drivebench tune"]);
    has(&refusal("export --model {} --to c --gains {}", &[&own, &gains]), &["--limit-v"]);
    let play = "[[effect]]\nid = \"backlash\"\ngap_rad = 0.02\nfrequency_hz = 40.0\ninertia_ratio = 0.5\n\
                damping_ratio = 0.05\nfriction_split = 0.5\n";
    let loose = model(&desk, "loose.toml", play);
    has(&refusal("export --model {} --to matlab", &[&loose]), &["backlash", "second inertia"]);
    let document = json_of("export --model {} --to json", &[&loose]);
    assert!(document["laws"][0]["terms"].is_null(), "{document}");
}

#[test]
fn a_torque_map_is_empty_where_the_runs_show_nothing() {
    let desk = Desk::new();
    let own = model(&desk, "own.toml", STRIBECK);
    let runs = Runs::plain();
    let (fit, other): (&Path, &Path) = (runs.fit.as_ref(), runs.holdout.as_ref());
    let text = "export --torque-map friction --run {} --run {} --model {} --to csv";
    let table = call(text, &[fit, other, &own]).expect(0).stdout;
    let rows: Vec<Vec<&str>> = table.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows[0].join(","), "speed_rad_s,torque_n_m,torque_low_n_m,torque_high_n_m,windows");
    assert_eq!(rows.len(), 25, "{table}");
    let mut known = 0;
    for row in &rows[1..] {
        let [speed, cells @ .., windows] = row.as_slice() else { panic!("{row:?}") };
        let windows: u32 = windows.parse().unwrap();
        assert_eq!(cells.iter().all(|cell| cell.is_empty()), windows < 4, "{row:?}");
        if windows < 4 {
            continue;
        }
        known += 1;
        let against = speed.parse::<f64>().unwrap().signum();
        let [mean, low, high] = [0, 1, 2].map(|at| against * cells[at].parse::<f64>().unwrap());
        // Coulomb friction of the specimen, which the nameplate has to a tenth; of its J and Kt too.
        assert!(mean > 0.25 && mean < 0.65, "{row:?}");
        assert!((low - mean) * (high - mean) < 0.0, "{row:?}");
    }
    assert!(known >= 6, "{table}");
    let header = desk.path("rubs.h");
    let text = "export --torque-map friction --run {} --model {} --to c --output {}";
    let stdout = call(text, &[fit, &own, &header]).expect(0).stdout;
    has(&stdout, &["friction of ZK-22FC, ", " of 24 bins measured, "]);
    let written = fs::read_to_string(&header).unwrap();
    has(&written, &["rubs_torque(float speed_rad_s,"]);
    // A run turns too fast for what the angle does.
    refusals(
        "export --torque-map friction --run {} --to csv => --model
         export --torque-map friction --run {} --model {} --to json => a torque map as csv or c
         export --torque-map cogging --run {} --model {} --to csv => no bin has 4 windows
         export --torque-map drag --run {} --model {} --to csv => friction, cogging",
        &[fit, &own],
    );
    refusals("export --model {} --to csv => --torque-map", &[&own]);
}

#[test]
fn a_run_keeps_its_samples_as_columns_by_an_option() {
    let desk = Desk::new();
    if cfg!(not(feature = "parquet")) {
        for (command, paths) in [
            ("run --headless --port sim: --parquet --out {}", vec![desk.out()]),
            (
                "export --run {} --to parquet --output {}",
                vec![Runs::plain().fit.to_path_buf(), desk.path("run.parquet")],
            ),
        ] {
            let paths: Vec<&Path> = paths.iter().map(PathBuf::as_path).collect();
            let error = refusal(command, &paths);
            has(&error, &["built without Parquet", "--features parquet"]);
        }
        assert!(!desk.out().exists(), "nothing is recorded");
        return;
    }
    call("run --headless --port sim: --parquet --out {}", &[&desk.out()]).expect(0);
    let (run, exported) = (desk.run(), desk.path("run.parquet"));
    let text = "export --run {} --to parquet --output {}";
    has(&call(text, &[&run, &exported]).expect(0).stdout, &[" rows"]);
    let kept = fs::read(run.join("samples.parquet")).unwrap();
    assert_eq!(kept, fs::read(&exported).unwrap(), "one writer for both");
    assert!(kept.starts_with(b"PAR1") && kept.ends_with(b"PAR1"));

    let python = |arguments: &[&std::ffi::OsStr]| {
        let output = Command::new("python3").args(arguments).output();
        output.map_or_else(|_| Done::default(), |output| Done::of(&output))
    };
    if python(&["-c".as_ref(), "import pyarrow; print(1)".as_ref()]).stdout.is_empty() {
        eprintln!("SKIPPED: pyarrow is not installed: the Parquet file was not read by it");
        return;
    }
    let peer = Path::new(env!("CARGO_MANIFEST_DIR")).join(".ci/interop/parquet_peer.py");
    let samples = run.join("samples.csv");
    let read = python(&[peer.as_ref(), samples.as_ref(), exported.as_ref()]).expect(0);
    has(&read.stdout, &[" rows of 10 columns"]);
}

#[test]
fn completions_are_scripts_that_their_shells_take() {
    for (shell, part) in [
        ("bash", "_drivebench"),
        ("zsh", "#compdef drivebench"),
        ("fish", "complete -c drivebench"),
    ] {
        let text = call(&format!("completions {shell}"), &[]).expect(0).stdout;
        has(&text, &[part, "commission", "export"]);
        let desk = Desk::new();
        let script = desk.put("script", &text);
        match Command::new(shell).arg("-n").arg(&script).output() {
            Ok(output) => assert!(
                output.status.success(),
                "{shell}: {}",
                String::from_utf8_lossy(&output.stderr)
            ),
            Err(_) => eprintln!("SKIPPED: {shell} is not installed: its script was not read by it"),
        }
    }
}

#[test]
fn the_manual_has_a_page_for_every_command() {
    let desk = Desk::new();
    let folder = desk.path("man/man1");
    for _ in 0..2 {
        call("man --out {}", &[&folder]).expect(0);
    }
    for page in
        ["drivebench", "drivebench-diagnose", "drivebench-registers-write", "drivebench-export"]
    {
        let text = fs::read_to_string(folder.join(format!("{page}.1"))).unwrap();
        has(&text, &[".SH NAME", ".SH SYNOPSIS"]);
    }
    let page = call("man", &[]).expect(0).stdout;
    has(&page, &[".TH drivebench 1", "safety trip"]);
}

#[test]
fn with_json_an_error_is_a_document_too() {
    for (text, status) in [
        ("compare /nowhere/run --json", 2),
        ("compare --what --json", 2),
        ("export --model /nowhere.toml --to c", 2),
    ] {
        let done = call(text, &[]).expect(status);
        assert_eq!(done.stdout, "");
        let objects: Vec<Value> = done
            .stderr
            .lines()
            .filter(|line| line.starts_with("{\"error\""))
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        assert_eq!(objects.len(), usize::from(text.contains("--json")), "{}", done.stderr);
        let error = done.error();
        for object in objects {
            assert_eq!(object["error"]["status"], status);
            let [message, help] =
                ["message", "help"].map(|key| object["error"][key].as_str().unwrap());
            assert_eq!(error, format!("error: {message}\nhelp: {help}"));
        }
    }
}

#[test]
fn a_screen_without_colours_has_none() {
    let is_coloured = |arguments: &str| {
        let folder = Desk::new();
        let runs = Runs::hidden();
        let text = format!("{arguments} diagnose {{}} --holdout {{}} --screen");
        let arguments = line(&text, &[&runs.fit, &runs.holdout]);
        let mut session = Session::start(&arguments, folder.folder(), (80, 24));
        session.wait_for("DIAGNOSIS");
        session.wait_for("stribeck_friction");
        session.press("q");
        session.end();
        String::from_utf8_lossy(&session.sent).split("\u{1b}[").any(|part| {
            let end = part.find(|c: char| !c.is_ascii_digit() && c != ';');
            let (codes, rest) = part.split_at(end.unwrap_or(0));
            let is_colour = |code: &str| matches!(code.parse(), Ok(30..=37 | 40..=47 | 90..=97));
            rest.starts_with('m') && (codes.split(';').any(is_colour) || codes.contains("8;5;"))
        })
    };
    assert!(is_coloured("--theme colour"));
    assert!(!is_coloured("--theme mono"));
}
