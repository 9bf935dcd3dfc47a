//! From "these two cannot be told apart" over the recommended bench file to a name: the real binary against its software
//! drive, in virtual time, so that no stalled machine decides what a run can tell apart.

use std::fs;
use std::path::Path;

use crate::kit::{BENCH, PLAIN, call, column, json_of, only_folder};
use serde_json::Value;

/// The default bench with a weak sequence and little time.
fn weak_bench(emulator: &Path) -> String {
    let (head, _) = BENCH
        .split_once("[[sequence]]")
        .expect("the default bench has a sequence");
    let head = head
        .replace(
            "config = \"zk-22fc-hidden\"",
            &format!("config = \"{}\"", emulator.display()),
        )
        .replace("time_s = 30.0", "time_s = 7.5");
    assert!(head.contains("time_s = 7.5"));
    let levels = "[20.0, 60.0, 35.0, 80.0, 50.0]";
    format!(
        "{head}\n[[sequence]]\nstandstill = {{ seconds = 0.6 }}\n[[sequence]]\n\
         steps = {{ levels_v = {levels}, hold_s = 0.5 }}\n"
    )
}

fn recorded(bench: &Path, run_seed: u64, out: &Path) -> std::path::PathBuf {
    let arguments =
        format!("run {{}} --headless --port sim: --seed 5 --run-seed {run_seed} --out {{}} --json");
    call(&arguments, &[bench, out]).expect(0);
    only_folder(out)
}

fn diagnosed(run: &Path, bench: &Path, next: &Path) -> Value {
    let arguments = "diagnose {} --bench {} --next-bench {} --json";
    json_of(arguments, &[run, bench, next])
}

#[test]
fn what_one_run_cannot_tell_apart_the_recommended_run_names() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let (emulator, bench, next) = (at("emulator.toml"), at("bench.toml"), at("next.toml"));
    let hidden = "\n[[hidden]]\nid = \"current_offset\"\noffset_a = 0.3\n";
    fs::write(&emulator, format!("{PLAIN}{hidden}")).expect("a file");
    fs::write(&bench, weak_bench(&emulator)).expect("a file");

    let run = recorded(&bench, 1, &at("weak"));
    let weak = diagnosed(&run, &bench, &next);
    assert_eq!(weak["verdict"], "ambiguous", "{}", weak["sentence"]);
    let rivals = weak["confusable"].to_string();
    assert!(rivals.contains("current_offset"), "{rivals}");
    let recommended = &weak["next_experiment"];
    let expected = recommended["expected_separation"].as_f64();
    assert!(expected.is_some_and(|d| d > 1e3), "{recommended}");

    let arguments = "diagnose {} --bench {}";
    let missing = call(arguments, &[&run, &at("no.toml")]).expect(2);
    assert!(missing.error().contains("no.toml"), "{}", missing.stderr);

    // Exactly the file that was written; the drive keeps the limits that the plan promised.
    let run = recorded(&next, 2, &at("next"));
    let told = diagnosed(&run, &bench, &at("none.toml"));
    assert_eq!(told["verdict"], "effect", "{}", told["sentence"]);
    assert_eq!(told["effects"], serde_json::json!(["current_offset"]));
    assert!(!at("none.toml").exists(), "nothing is left to recommend");
    let peaks = &recommended["peaks"];
    for (column, key) in [("current_a", "current_a"), ("speed_rad_s", "speed_rad_s")] {
        let promised = peaks[key].as_f64().unwrap_or_default();
        let reached = largest(&run.join("samples.csv"), column);
        assert!(
            (0.8..1.2).contains(&(reached / promised)),
            "{column}: {reached} of {promised}"
        );
    }
}

/// Largest magnitude of a column.
fn largest(samples: &Path, column_name: &str) -> f64 {
    let text = fs::read_to_string(samples).expect("the samples are there");
    let sizes = column(&text, column_name).into_iter().map(f64::abs);
    sizes.fold(0.0, f64::max)
}
