//! Suites of bench tests: verdicts, limits, time limits, evidence, and what machines read of them.

use crate::kit::prelude::*;

/// A run, and a limit on its resistance.
fn suite(limit: &str) -> String {
    format!(
        "name = \"small\"\n[defaults]\nemulator = \"zk-22fc-plain\"\n\
         [[case]]\nname = \"resistance & <co>\"\ntags = [\"quick\"]\nrepeat = 2\n\
         [[case.step]]\nexcite = {{ run_seed = 3 }}\n\
         [[case.step]]\nassert = {{ resistance_ohm = {limit}, outcome = \"done\" }}\n\
         signal = [{{ channel = \"current_a\", at_s = 0.2, within_s = 0.1, value = 0.0, within = 0.3 }}]\n\
         [[case]]\nname = \"over a line\"\nneeds = [\"line\"]\n[[case.step]]\nexcite = {{}}\n"
    )
}

/// A suite carried out in virtual time, with its files for machines.
fn tested(desk: &Desk, text: &str, options: &str) -> Done {
    let file = desk.put("suite.toml", text);
    let [junit, metrics, out] = ["j.xml", "m.txt", "out"].map(|name| desk.path(name));
    call(
        &format!("test {{}} --json --junit {{}} --metrics {{}} --out {{}} {options}"),
        &[&file, &junit, &metrics, &out],
    )
}

fn found_by(done: &Done) -> Value {
    serde_json::from_str(&done.stdout).unwrap()
}

#[test]
fn a_suite_passes_with_its_spread_and_leaves_no_evidence() {
    let desk = Desk::new();
    let done = tested(&desk, &suite("[0.9, 1.3]"), "").expect(0);
    let found = found_by(&done);
    assert_eq!(found["passed"], 2);
    assert_eq!(found["skipped"], 1, "{found:#}");
    assert_eq!(found["spread"][0]["key"], "resistance_ohm");
    assert_eq!(found["spread"][0]["count"], 2);
    assert!(found["spread"][0]["std"].as_f64().unwrap() > 0.0);
    let folder = only_folder(&desk.path("out"));
    assert_eq!(
        fs::read_dir(&folder).unwrap().count(),
        1,
        "result.json alone"
    );
    has(
        &done.stderr,
        &["PASSED", "seed 2", "skipped", "needs a line in real time"],
    );
    let junit = fs::read_to_string(desk.path("j.xml")).unwrap();
    has(
        &junit,
        &[
            "tests=\"3\" failures=\"0\" errors=\"0\" skipped=\"1\"",
            "resistance &amp; &lt;co&gt; [seed 1]",
        ],
    );
    let metrics = fs::read_to_string(desk.path("m.txt")).unwrap();
    has(
        &metrics,
        &["verdict=\"passed\"} 2", "key=\"resistance_ohm\"} 1."],
    );
    assert!(metrics.ends_with("# EOF\n"));
}

#[test]
fn a_limit_that_is_not_kept_is_said_with_its_evidence() {
    let desk = Desk::new();
    let done = tested(&desk, &suite("\"< 0.5\""), "--filter quick").expect(1);
    has(
        &done.stderr,
        &[
            "FAILED",
            "resistance_ohm: 1.",
            "has to be < 0.5",
            "2 of 2 cases did not pass",
        ],
    );
    let found = found_by(&done);
    let evidence = Path::new(found["cases"][0]["evidence"].as_str().unwrap());
    let run = only_folder(&evidence.join("runs"));
    assert!(run.join("samples.csv").is_file() && run.join("report.html").is_file());
    assert!(evidence.join("01-excite.txt").is_file());
    let junit = fs::read_to_string(desk.path("j.xml")).unwrap();
    has(
        &junit,
        &[
            "<failure type=\"limit\" message=\"resistance_ohm: 1.",
            "drivebench run --port sim:",
        ],
    );
}

#[test]
fn a_motor_that_is_refused_passes_where_that_is_what_has_to_be() {
    let desk = Desk::new();
    let case = |status: &str| {
        format!(
            "name = \"negative\"\n[[case]]\nname = \"open\"\n\
             [[case.step]]\nfault = {{ faults = {{ open_phase = true }} }}\n\
             [[case.step]]\nexcite = {{}}\n{status}\n"
        )
    };
    let asked = "status = 3\n[[case.step]]\nassert = { error = \"~ open armature\" }";
    tested(&desk, &case(asked), "").expect(0);
    for name in ["j.xml", "m.txt"] {
        fs::remove_file(desk.path(name)).unwrap();
    }
    // Without the status it stands in the way of a judgement, and its own status is that of the suite.
    let done = tested(&desk, &case(""), "").expect(3);
    has(
        &done.stderr,
        &[
            "ERROR",
            "exit status 3, has to be 0: direction: neither a current flows",
        ],
    );
}

#[test]
fn a_command_that_does_not_end_in_its_time_is_ended_and_said_so() {
    let desk = Desk::new();
    let text = "name = \"late\"\n[[case]]\nname = \"slow\"\ntimeout_s = 0.05\nport = \"emulator\"\n\
                [[case.step]]\nexcite = {}\n";
    let done = tested(&desk, text, "").expect(1);
    has(
        &done.stderr,
        &[
            "ERROR",
            "not done in 0.05 s; it was ended, the motor stopped by its guard",
        ],
    );
}

#[test]
fn parts_of_a_suite_are_each_case_once() {
    let desk = Desk::new();
    let text = suite("[0.9, 1.3]").replace("repeat = 2", "repeat = 4");
    let mut seeds = Vec::new();
    for part in ["1/3", "2/3", "3/3"] {
        let options = format!("--shard {part}");
        let found = found_by(&tested(&desk, &text, &options).expect(0));
        for case in found["cases"].as_array().unwrap() {
            seeds.push((
                case["name"].as_str().unwrap().to_owned(),
                case["seed"].as_u64().unwrap(),
            ));
        }
        fs::remove_file(desk.path("j.xml")).unwrap();
        fs::remove_file(desk.path("m.txt")).unwrap();
    }
    seeds.sort();
    assert_eq!(seeds.len(), 5);
    seeds.dedup();
    assert_eq!(seeds.len(), 5);
}

#[test]
fn what_cannot_be_run_is_refused_before_anything_is() {
    let desk = Desk::new();
    let good = suite("[0.9, 1.3]");
    for (text, options, words) in [
        (
            good.replace("run_seed", "runseed"),
            "",
            &[
                "suite.toml:9:",
                "unknown option `runseed` of excite",
                "help: did you mean `run_seed`?",
            ][..],
        ),
        (
            good.replace("excite", "excitation"),
            "",
            &["unknown field `excitation`", "`excite`"],
        ),
        (
            good.clone(),
            "--filter nothing",
            &["no case of \"small\" has nothing"],
        ),
        (good.clone(), "--shard 4/3", &["1 <= I <= N"]),
    ] {
        let done = tested(&desk, &text, options).expect(2);
        has(&done.stderr, words);
        assert!(!desk.path("out").exists());
    }
    // A real port, and nobody who says that the motor may turn.
    let done = tested(&desk, &good, "--port /dev/ttyNONE").expect(3);
    has(
        &done.stderr,
        &["nobody has said that its motor may turn", "--hardware"],
    );
}

#[test]
fn shipped_suites_are_read_and_listed() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/suites");
    for entry in fs::read_dir(root).unwrap() {
        let listed = call("test {} --list", &[&entry.unwrap().path()]).expect(0);
        assert!(listed.stdout.lines().count() > 3, "{}", listed.stdout);
    }
}
