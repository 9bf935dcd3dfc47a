//! A mystery from the drawing of its seed to its revelation, through the real binary.

use crate::kit::prelude::*;
use drivebench::emulator::mystery::{Truth, draw};

/// The first seed that hides this effect; `None`: that hides nothing.
fn seed_of(id: Option<&str>) -> u64 {
    let hides = |seed: &u64| draw(*seed).truth.effect().map(|e| e.id.clone()).as_deref() == id;
    (0..2000).find(hides).expect("every effect is drawn")
}

#[track_caller]
fn sealed(seed: u64, desk: &Desk) -> PathBuf {
    let text = draw(seed).truth.seal().expect("a truth can be sealed");
    desk.put("sealed.json", &text)
}

/// The run, beside which the sealed truth lies.
fn run_in(out: &Path) -> PathBuf {
    let mut entries = fs::read_dir(out)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    entries
        .find(|path| path.is_dir() && !path.is_symlink())
        .unwrap()
}

/// No effect's name, no size and no true value of the motor stands in this text.
#[track_caller]
fn tells_nothing(seed: u64, place: &str, text: &str) {
    let truth = draw(seed).truth;
    let values = truth
        .effects
        .iter()
        .flat_map(|effect| &effect.parameters)
        .map(|one| one.value);
    let motor = [truth.motor.resistance_ohm, truth.motor.inertia_kg_m2];
    // A short number, as an order, stands in many a text by chance.
    let long = values
        .chain(motor)
        .map(|value| value.to_string())
        .filter(|text| text.len() > 8);
    for value in long {
        assert!(!text.contains(&value), "{value} in {place}");
    }
    assert!(!text.contains("[[hidden]]"), "{place}");
    for effect in &truth.effects {
        assert!(!text.contains(&effect.id), "{} in {place}", effect.id);
    }
}

#[test]
fn the_emulator_of_a_mystery_seals_its_truth_and_does_not_tell_it() {
    let folder = Desk::new();
    let (pty, seal) = (folder.path("d.pty"), folder.path("s.json"));
    let seed = seed_of(Some("backlash"));
    let text = format!("emulate --mystery {seed} --pty {{}} --seal {{}}");
    let emulator = Emulator::start(&text, &[&pty, &seal]);
    emulator.process.signal(Signal::SIGTERM);
    let (ready, told) = (emulator.ready, emulator.process.end().stderr);

    assert!(ready.starts_with("ready modbus-rtu "), "{ready}");
    has(&told, &["sealed truth in "]);
    let sealed = fs::read_to_string(&seal).expect("the sealed file is there");
    for (place, text) in [
        ("ready line", &ready),
        ("stderr", &told),
        ("sealed file", &sealed),
    ] {
        tells_nothing(seed, place, text);
    }
    assert_eq!(
        Truth::open("s", &sealed).expect("it opens"),
        draw(seed).truth
    );
}

#[test]
fn nothing_that_a_run_leaves_behind_tells_what_a_mystery_hides() {
    let out = Desk::new();
    let seed = seed_of(Some("torque_ripple"));
    let text = format!("run --port sim: --headless --json --mystery {seed} --out {{}}");
    let runs = out.path("runs");
    let done = call(&text, &[&runs]).expect(0);
    assert_eq!(only_folder(out.folder()), runs);
    tells_nothing(seed, "stdout", &done.stdout);
    tells_nothing(seed, "stderr", &done.stderr);
    let mut seen = 0;
    let mut open = vec![runs.clone()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).expect("a folder of the run") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                open.push(path);
            } else if let Ok(text) = fs::read_to_string(&path) {
                tells_nothing(seed, &path.display().to_string(), &text);
                seen += 1;
            }
        }
    }
    assert!(
        seen >= 4,
        "samples, manifest, result and the sealed truth: {seen}"
    );
    assert!(runs.join(format!("mystery-{seed}.sealed.json")).exists());
}

#[test]
fn a_bench_file_that_names_the_mystery_runs_the_same_machine_again() {
    let out = Desk::new();
    let bench = BENCH
        .replace("config = \"zk-22fc-hidden\"", "config = \"mystery\"")
        .replace("\nseed = 1\n", "\nseed = 11\n");
    let file = out.put("bench.toml", &bench);
    let samples = |text: &str, runs: &str| {
        let runs = out.path(runs);
        let paths = [file.as_path(), runs.as_path()];
        let paths = if text.contains("{} ") {
            &paths[..]
        } else {
            &paths[1..]
        };
        call(text, paths).expect(0);
        let sealed = runs.join("mystery-11.sealed.json");
        fs::remove_file(sealed).expect("the sealed truth is beside the run");
        fs::read_to_string(only_folder(&runs).join("samples.csv")).expect("samples")
    };
    let named = samples("run {} --port sim: --headless --json --out {}", "named");
    let asked = samples(
        "run --port sim: --headless --json --mystery 11 --out {}",
        "asked",
    );
    assert_eq!(named, asked);
}

#[test]
fn reveal_scores_a_word_a_diagnosis_and_a_guess() {
    let folder = Desk::new();
    let file = sealed(seed_of(Some("voltage_drop")), &folder);
    for (word, outcome) in [
        ("voltage_drop", "right"),
        ("supply_sag", "wrong"),
        ("none", "wrong"),
        ("abstain", "abstained"),
    ] {
        let text = format!("reveal {{}} --answer {word} --json");
        let json = json_of(&text, &[&file]);
        assert_eq!(json["outcome"], outcome, "{word}");
        assert_eq!(json["truth"]["effects"][0]["effect"], "voltage_drop");
    }
    let drop_v = draw(seed_of(Some("voltage_drop"))).truth.effects[0].parameters[0].value;
    let diagnosis = json!({
        "verdict": "effect", "effect": "voltage_drop", "effects": ["voltage_drop"],
        "candidates": [{ "effect": "voltage_drop", "status": "supported",
            "parameters": { "drop_v": { "value": 1.05 * drop_v } } }],
    });
    let said = folder.put("diagnosis.json", &diagnosis.to_string());
    let text = "reveal {} --diagnosis {} --guess supply_sag";
    let done = call(text, &[&file, &said]).expect(0);
    has(
        &done.stdout,
        &[
            "hidden: voltage_drop (drop_v = ",
            "your guess: supply_sag: not it",
            "the tool's answer: right: voltage_drop was named",
            "(+5.0 %)",
            "what shows it: ",
            "what brings it out: ",
        ],
    );
}

#[test]
fn without_a_terminal_reveal_asks_nothing() {
    let folder = Desk::new();
    let file = sealed(seed_of(None), &folder);
    let done = call("reveal {}", &[&file]).expect(0);
    assert!(
        done.stdout.starts_with("hidden: nothing"),
        "{}",
        done.stdout
    );
    assert!(done.stderr.is_empty(), "{}", done.stderr);
    let json = json_of("reveal {} --json", &[&file]);
    assert!(json["outcome"].is_null());
    assert_eq!(json["truth"]["effects"], json!([]));
}

#[test]
fn what_cannot_be_revealed_is_refused_with_a_next_step() {
    let folder = Desk::new();
    let seed = seed_of(Some("cogging"));
    let file = sealed(seed, &folder);
    let text = fs::read_to_string(&file).expect("it was written");
    let text = text.replace("\"checksum\": \"", "\"checksum\": \"f");
    let broken = folder.put("broken.json", &text);
    call("reveal {}", &[&broken]).fails(2, &["the seal is broken"]);
    call("reveal {}", &[folder.folder()]).fails(2, &["help: "]);
    refusals(
        "reveal {} --answer coging => did you mean `cogging`?",
        &[&file],
    );
    refusals(
        "reveal {} --diagnosis {} => holds no verdict",
        &[&file, &file],
    );
    refusals(
        "run --headless --port /dev/nowhere --mystery 3 => --mystery hides an effect in our own
         emulate zk-22fc-plain --mystery 3 => cannot be used with",
        &[],
    );
}

#[test]
fn an_error_that_nothing_known_explains_is_told_with_the_curve_that_it_follows() {
    let room = Desk::new();
    let seed = seed_of(Some("torque_bump"));
    let runs = ["1", "2"].map(|run_seed| {
        let out = room.path(run_seed);
        let text =
            format!("run --port sim: --headless --mystery {seed} --run-seed {run_seed} --out {{}}");
        call(&text, &[&out]).expect(0);
        run_in(&out)
    });
    let done = call("diagnose {} --holdout {}", &[&runs[0], &runs[1]]).expect(0);
    let said = &done.stdout;
    has(said, &["no effect of the catalogue explains it"]);
    has(said, &["curve  ", "torque error follows the speed"]);
    let (_, add) = said.split_once("next      drivebench ").unwrap();
    let add = add.replace('\\', " ");
    let start = "add table --equation torque --axis speed_rad_s ";
    assert!(add.starts_with(start), "{add}");
    // What is recommended works as it is written.
    let mut words: Vec<PathBuf> = add.split_whitespace().map(PathBuf::from).collect();
    let output = words.last_mut().unwrap();
    *output = room.path(&output);
    let added = drivebench(words).expect(0).stdout;
    assert!(added.starts_with("ACCEPTED: "), "{added}");
    has(&added, &["falls by", "times the noise floor"]);
}

/// One run alone, of which the last two fifths are the hold-out: a torque bump that no card of the catalogue has. Four
/// effects each lower the error of that stretch a little, and a load step finds a time that suits it.
#[test]
fn a_split_run_names_nothing_that_only_leans_on_what_is_there() {
    let seed = 34;
    let truth = draw(seed).truth;
    assert_eq!(
        truth.effect().map(|effect| effect.id.as_str()),
        Some("torque_bump")
    );
    let room = Desk::new();
    let out = room.path("runs");
    let text = format!("run --port sim: --headless --mystery {seed} --run-seed 1 --out {{}}");
    call(&text, &[&out]).expect(0);
    let answer = json_of("diagnose {} --json", &[&run_in(&out)]);
    assert_eq!(answer["verdict"], "unexplained", "{}", answer["sentence"]);
}
