//! From "these runs do not distinguish the two" over the recommended bench file to a name: the real binary against its software
//! drive, in virtual time, so that no stalled machine decides what a run can tell apart.

use crate::kit::prelude::*;

/// The default bench with a weak sequence and little time.
pub(crate) fn weak_bench(emulator: &Path) -> String {
    let (head, _) = BENCH.split_once("[[sequence]]").expect("the default bench has a sequence");
    let head = head
        .replace("config = \"zk-22fc-hidden\"", &format!("config = \"{}\"", emulator.display()))
        .replace("time_s = 30.0", "time_s = 7.5");
    assert!(head.contains("time_s = 7.5"));
    let levels = "[20.0, 60.0, 35.0, 80.0, 50.0]";
    format!(
        "{head}\n[[sequence]]\nstandstill = {{ seconds = 0.6 }}\n[[sequence]]\n\
         steps = {{ levels_v = {levels}, hold_s = 0.5 }}\n"
    )
}

fn run_of(bench: &Path, run_seed: u64) -> Recorded {
    recorded(&format!("{{}} --seed 5 --run-seed {run_seed}"), &[bench])
}

fn diagnosed(run: &Path, bench: &Path, next: &Path) -> Value {
    json_of("diagnose {} --bench {} --next-bench {} --json", &[run, bench, next])
}

#[test]
fn what_one_run_cannot_tell_apart_the_recommended_run_names() {
    let folder = Desk::new();
    let at = |name: &str| folder.path(name);
    let (emulator, bench, next) = (at("emulator.toml"), at("bench.toml"), at("next.toml"));
    let hidden = "\n[[hidden]]\nid = \"current_offset\"\noffset_a = 0.3\n";
    fs::write(&emulator, format!("{PLAIN}{hidden}")).expect("a file");
    fs::write(&bench, weak_bench(&emulator)).expect("a file");

    let run = run_of(&bench, 1);
    let weak = diagnosed(&run, &bench, &next);
    assert_eq!(weak["verdict"], "ambiguous", "{}", weak["sentence"]);
    let rivals = weak["confusable"].to_string();
    has(&rivals, &["current_offset"]);
    let recommended = &weak["next_experiment"];
    assert!(recommended["expected_separation"].as_f64().is_some_and(|d| d > 1e3), "{recommended}");

    call("diagnose {} --bench {}", &[&run, &at("no.toml")]).fails(2, &["no.toml"]);

    // Exactly the file that was written; the drive keeps the limits that the plan promised.
    let first = run;
    let run = run_of(&next, 2);
    let found = diagnosed(&run, &bench, &at("other.toml"));
    assert_eq!(found["verdict"], "effect", "{}", found["sentence"]);
    assert_eq!(found["effects"], json!(["current_offset"]));
    let both = json_of("diagnose {} --with {} --bench {} --json", &[&first, &run, &bench]);
    assert_eq!(both["verdict"], "effect", "{}", both["sentence"]);
    assert_eq!(both["effects"], json!(["current_offset"]));
    assert_eq!(both["confusable"], json!([]), "the pair is distinguished");
    assert!(both["next_experiment"]["pair"].is_null(), "and not recommended again");
    let peaks = &recommended["peaks"];
    for (column, key) in [("current_a", "current_a"), ("speed_rad_s", "speed_rad_s")] {
        let promised = peaks[key].as_f64().unwrap_or_default();
        let reached = largest(&run.join("samples.csv"), column);
        assert!((0.8..1.2).contains(&(reached / promised)), "{column}: {reached} of {promised}");
    }
}

/// Largest magnitude of a column.
fn largest(samples: &Path, column_name: &str) -> f64 {
    let text = fs::read_to_string(samples).expect("the samples are there");
    column(&text, column_name).into_iter().map(f64::abs).fold(0.0, f64::max)
}
