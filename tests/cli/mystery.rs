//! A mystery from the drawing of its seed to the answer with its truth, through the real binary.

use crate::kit::prelude::*;
use drivebench::emulator::mystery::draw;

/// The first seed that hides this effect; `None`: that hides nothing.
fn seed_of(id: Option<&str>) -> u64 {
    let hides = |seed: &u64| draw(*seed).truth.effect().map(|e| e.id.clone()).as_deref() == id;
    (0..2000).find(hides).expect("every effect is drawn")
}

#[test]
fn an_emulator_of_a_mystery_shows_at_its_end_what_it_hid() {
    let folder = Desk::new();
    let pty = folder.path("d.pty");
    let seed = seed_of(Some("backlash"));
    let text = format!("emulate --mystery {seed} --pty {{}}");
    let emulator = Emulator::start(&text, &[&pty]);
    emulator.process.signal(Signal::SIGTERM);
    let (ready, stderr) = (emulator.ready, emulator.process.end().stderr);
    lacks(&ready, &["backlash"]);
    has(&stderr, &[&format!("mystery {seed} hides backlash (")]);
}

#[test]
fn a_commissioning_of_a_mystery_ends_with_the_truth() {
    let out = Desk::new();
    let seed = seed_of(Some("voltage_drop"));
    let runs = out.path("runs");
    let text = format!("commission --port sim: --headless --mystery {seed} --out {{}}");
    let card = call(&text, &[&runs]).expect(0).stdout;
    let sentence = "the emulator has voltage_drop: the diagnosis is right; drop_v: true ";
    has(&card, &[sentence]);
    let result = read_json(runs.join("latest/result.json"));
    let size = &result["truth"]["sizes"][0];
    let drop_v = draw(seed).truth.effects[0].parameters[0].value;
    assert_eq!((&size["key"], &size["true"]), (&"drop_v".into(), &drop_v.into()));
    assert!(number(size, "/error_percent").abs() < 10.0, "{size}");
}

#[test]
fn a_mystery_is_of_the_emulator_alone() {
    refusals(
        "run --headless --port /dev/nowhere --mystery 3 => --mystery hides an effect in our own
         emulate zk-22fc-plain --mystery 3 => cannot be used with",
        &[],
    );
}

#[test]
fn a_bench_file_that_names_the_mystery_is_the_same_machine() {
    let out = Desk::new();
    let bench = BENCH
        .replace("config = \"zk-22fc-hidden\"", "config = \"mystery\"")
        .replace("\nseed = 1\n", "\nseed = 11\n");
    let file = out.put("bench.toml", &bench);
    let samples = |text: &str, runs: &str| {
        let runs = out.path(runs);
        let paths = [file.as_path(), runs.as_path()];
        let paths = if text.contains("{} ") { &paths[..] } else { &paths[1..] };
        call(text, paths).expect(0);
        fs::read_to_string(only_folder(&runs).join("samples.csv")).expect("samples")
    };
    let named = samples("run {} --port sim: --headless --json --out {}", "named");
    let drawn = samples("run --port sim: --headless --json --mystery 11 --out {}", "drawn");
    assert_eq!(named, drawn);
}

#[test]
fn an_unexplained_error_is_reported_with_its_curve() {
    let room = Desk::new();
    let seed = seed_of(Some("torque_bump"));
    let runs = ["1", "2"].map(|run_seed| {
        let out = room.path(run_seed);
        let text =
            format!("run --port sim: --headless --mystery {seed} --run-seed {run_seed} --out {{}}");
        call(&text, &[&out]).expect(0);
        only_folder(&out)
    });
    let done = call("diagnose {} --holdout {}", &[&runs[0], &runs[1]]).expect(0);
    let stdout = &done.stdout;
    has(stdout, &["no effect of the catalogue explains it"]);
    has(stdout, &["curve  ", "torque error follows the speed"]);
    let (_, add) = stdout.split_once("next      drivebench ").unwrap();
    let add = add.replace('\\', " ");
    assert!(add.starts_with("add table --equation torque --axis speed_rad_s "), "{add}");
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
    assert_eq!(draw(seed).truth.effect().map(|effect| effect.id.as_str()), Some("torque_bump"));
    let room = Desk::new();
    let out = room.path("runs");
    let text = format!("run --port sim: --headless --mystery {seed} --run-seed 1 --out {{}}");
    call(&text, &[&out]).expect(0);
    let answer = json_of("diagnose {} --json", &[&only_folder(&out)]);
    assert_eq!(answer["verdict"], "unexplained", "{}", answer["sentence"]);
}
