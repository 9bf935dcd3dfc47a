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
    // They are never overwritten.
    for earlier in [&junit, &metrics] {
        let _ = fs::remove_file(earlier);
    }
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
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "result.json alone");
    has(&done.stderr, &["PASSED", "seed 2", "skipped", "needs a line in real time"]);
    let junit = fs::read_to_string(desk.path("j.xml")).unwrap();
    has(
        &junit,
        &[
            "<testsuites name=\"small\" tests=\"3\" failures=\"0\" errors=\"0\" time=",
            " skipped=\"1\" timestamp=",
            "resistance &amp; &lt;co&gt; [seed 1]",
        ],
    );
    let metrics = fs::read_to_string(desk.path("m.txt")).unwrap();
    has(&metrics, &["verdict=\"passed\"} 2", "key=\"resistance_ohm\"} 1."]);
    assert!(metrics.ends_with("# EOF\n"));
}

#[test]
fn a_limit_that_is_not_kept_is_reported_with_its_evidence() {
    let desk = Desk::new();
    let done = tested(&desk, &suite("\"< 0.5\""), "--filter quick").expect(1);
    has(
        &done.stderr,
        &["FAILED", "resistance_ohm: 1.", "has to be < 0.5", "2 of 2 cases did not pass"],
    );
    let found = found_by(&done);
    let evidence = Path::new(found["cases"][0]["evidence"].as_str().unwrap());
    let run = only_folder(&evidence.join("runs"));
    assert!(run.join("samples.csv").is_file() && run.join("report.html").is_file());
    assert!(evidence.join("01-excite.txt").is_file());
    let junit = fs::read_to_string(desk.path("j.xml")).unwrap();
    has(
        &junit,
        &["<failure type=\"limit\" message=\"resistance_ohm: 1.", "drivebench run --port sim:"],
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
    let expected = "status = 3\n[[case.step]]\nassert = { error = \"~ open armature\" }";
    tested(&desk, &case(expected), "").expect(0);
    // Without the status it stands in the way of a judgement, and its own status is that of the suite.
    let done = tested(&desk, &case(""), "").expect(3);
    has(&done.stderr, &["ERROR", "exit status 3, has to be 0: direction: neither a current flows"]);
}

#[test]
fn a_step_that_made_no_run_is_not_judged_by_the_run_of_another() {
    let desk = Desk::new();
    let text = "name = \"two\"\n[defaults]\nemulator = \"zk-22fc-plain\"\n[[case]]\nname = \"second\"\n\
                [[case.step]]\nas = \"good\"\nexcite = {}\n\
                [[case.step]]\nfault = { faults = { open_phase = true } }\n\
                [[case.step]]\nas = \"bad\"\nexcite = {}\nstatus = 3\n";
    let judged = |assert: &str, words: &str| {
        let text = format!("{text}[[case.step]]\nof = \"bad\"\n{assert}\n");
        let file = desk.put("suite.toml", &text);
        let done = call("test {} --out {}", &[&file, &desk.path("out")]).expect(1);
        has(&done.stderr, &[words]);
    };
    judged(
        "assert = { resistance_ohm = [0.5, 2.0], outcome = \"done\" }",
        "outcome: not in the result, has to be done; resistance_ohm: not in the result",
    );
    judged(
        "signal = [{ channel = \"current_a\", at_s = 0.2, within_s = 0.1, value = 0.0, within = 0.3 }]",
        "signal: no run was recorded",
    );
}

#[test]
fn a_step_without_a_run_leaves_the_last_run_in_place() {
    let desk = Desk::new();
    let text = "name = \"plans\"\n[defaults]\nemulator = \"zk-22fc-plain\"\n[[case]]\nname = \"between\"\n\
                [[case.step]]\nexcite = {}\n[[case.step]]\nplan = {}\n[[case.step]]\nidentify = {}\n";
    let found = found_by(&tested(&desk, text, "").expect(0));
    let steps = found["cases"][0]["steps"].as_array().unwrap();
    assert!(word(&steps[2], "/command").contains("/runs/"), "{steps:?}");
    let judged = "[[case.step]]\nof = \"plan\"\n\
                  signal = [{ channel = \"current_a\", at_s = 0.2, value = 0.0, within = 99.0 }]\n";
    let done = tested(&desk, &format!("{text}{judged}"), "").expect(1);
    has(&done.stderr, &["signal: no run was recorded"]);
}

#[test]
fn a_file_with_other_keys_is_made_for_the_case() {
    let desk = Desk::new();
    desk.put("bench.toml", BENCH);
    let case = |key: &str| {
        format!(
            "name = \"files\"\n[[case]]\nname = \"slow\"\nbench = \"@case/slow.toml\"\n[[case.step]]\n\
             file = {{ of = \"bench.toml\", name = \"slow.toml\", set = {{ limits = {{ {key} = 100.0 }} }} }}\n\
             [[case.step]]\nplan = {{}}\nstatus = 2\n[[case.step]]\nassert = {{ error = \"~ WORDS\" }}\n"
        )
    };
    let text = case("speed_rad_s").replace("WORDS", "100");
    tested(&desk, &text, "").expect(0);
    let text = case("speed_rads").replace("WORDS", "unknown field `speed_rads`");
    tested(&desk, &text, "").expect(0);
}

#[test]
fn a_command_that_does_not_end_in_its_time_is_ended_and_reported() {
    let desk = Desk::new();
    let text = "name = \"late\"\n[[case]]\nname = \"slow\"\ntimeout_s = 0.05\nport = \"emulator\"\n\
                [[case.step]]\nexcite = {}\n";
    let done = tested(&desk, text, "").expect(1);
    has(&done.stderr, &["ERROR", "not done in 0.05 s; terminated, it "]);
    assert!(!done.stderr.contains("by its guard"), "{}", done.stderr);
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
            seeds.push((case["name"].as_str().unwrap().to_owned(), case["seed"].as_u64().unwrap()));
        }
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
        (good.replace("excite", "excitation"), "", &["unknown field `excitation`", "`excite`"]),
        (good.clone(), "--filter nothing", &["no case of \"small\" has nothing"]),
        (good.clone(), "--shard 4/3", &["1 <= I <= N"]),
    ] {
        let done = tested(&desk, &text, options).expect(2);
        has(&done.stderr, words);
        assert!(!desk.path("out").exists());
    }
    // A real port without the consent that its motor may turn.
    let done = tested(&desk, &good, "--port /dev/ttyNONE").expect(3);
    has(&done.stderr, &["nobody has confirmed that its motor may turn", "--hardware"]);
}

#[test]
fn waived_checks_of_a_suite_are_listed_before_consent() {
    let desk = Desk::new();
    let text = "name = \"bold\"\n[[case]]\nname = \"unproven\"\nrepeat = 2\n\
                [[case.step]]\nexcite = { waive_watchdog = true, waive_direction = false }\n\
                [[case.step]]\nspeed = { reset_fault = true, waive_watchdog = true }\n\
                [[case]]\nname = \"careful\"\n[[case.step]]\nexcite = { waive_plausibility = false }\n";
    let warning =
        "case \"unproven\" sets waive_watchdog, reset_fault: checks that keep a real motor safe";
    for consent in ["", "--hardware"] {
        let options = format!("--port /dev/ttyNONE {consent}");
        let stderr = tested(&desk, text, &options).expect(3).stderr.replace("\n  ", " ");
        assert_eq!(stderr.matches(warning).count(), 1, "{stderr}");
        assert!(!stderr.contains("\"careful\" sets"), "{stderr}");
    }
    let done = tested(&desk, text, "--port sim: --list").expect(0);
    assert!(!done.stderr.contains("unproven"), "{}", done.stderr);
}

#[test]
fn shipped_suites_are_read_and_listed() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/suites");
    for entry in fs::read_dir(root).unwrap() {
        let listed = call("test {} --list", &[&entry.unwrap().path()]).expect(0);
        assert!(listed.stdout.lines().count() > 3, "{}", listed.stdout);
    }
}

/// A script with python3, its output for a person; nothing where it, or a module that it cannot do without, is missing.
fn python(module: &str, arguments: &[&Path]) -> Option<String> {
    let run = |words: &[&Path]| {
        let mut python = std::process::Command::new("python3");
        python.arg("-B").args(words).env("DRIVEBENCH", BINARY);
        python.current_dir(env!("CARGO_MANIFEST_DIR")).output()
    };
    let import = format!("import {module}");
    let imported = run(&[Path::new("-c"), Path::new(&import)]);
    if !imported.is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: python3 with {module} is not installed");
        return None;
    }
    let output = run(arguments).unwrap();
    let text_of = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let text = text_of(&output.stdout) + &text_of(&output.stderr);
    assert!(output.status.success(), "{text}");
    eprintln!("{text}");
    Some(text)
}

#[test]
fn results_of_a_suite_are_valid_for_other_readers() {
    const NAME: &str = r#""]]> & <x> 'q' \\ \"d\" \U0001F680 {a=\"b\"} # EOF""#;
    const WORD: &str = r#""]]> \u0001\u007f\u0085\n\t\uFFFE <![CDATA[""#;
    let desk = Desk::new();
    let text = format!(
        "{}[[case]]\nname = {NAME}\n[[case.step]]\nplan = {{}}\n[[case.step]]\nassert = {{ exit_status = 0 }}\n\
         [[case]]\nname = \"not kept\"\n[[case.step]]\nplan = {{}}\n[[case.step]]\nassert = {{ error = {WORD} }}\n",
        suite("[0.9, 1.3]")
    );
    let done = tested(&desk, &text, "").expect(1);
    let result = desk.put("result.json", &done.stdout);
    let [script, junit, metrics] =
        [".ci/interop/suite_peer.py".into(), desk.path("j.xml"), desk.path("m.txt")];
    if let Some(output) = python("json", &[&script, &junit, &metrics, &result]) {
        has(&output, &["5 cases by the rules of the schema"]);
    }
}

#[test]
fn the_example_for_pytest_makes_each_case_a_test() {
    let words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "examples/pytest"];
    if let Some(output) = python("pytest", &words.map(Path::new)) {
        has(&output, &["2 passed, 1 skipped"]);
    }
}

#[test]
fn answers_about_known_machines_make_a_confusion_matrix() {
    let desk = Desk::new();
    let text = "name = \"answers\"\n[defaults]\nemulator = \"zk-22fc-plain\"\n\
                [[case]]\nname = \"nothing\"\n[[case.step]]\ncommission = {}\n\
                [[case]]\nname = \"fan\"\n[[case.step]]\n\
                fault = { hidden = [{ id = \"quadratic_load\", quadratic_n_m_s2_per_rad2 = 1.8e-6 }] }\n\
                [[case.step]]\ncommission = {}\n[[case.step]]\nassert = { missing = \"none\" }\n";
    let file = desk.put("suite.toml", text);
    let [metrics, out] = ["m.txt", "out"].map(|name| desk.path(name));
    let done = call("test {} --metrics {} --out {}", &[&file, &metrics, &out]).expect(1);
    has(&done.stdout, &["(nothing)       (none) 1", "quadratic_load  quadratic_load 1"]);
    let folder = only_folder(&out);
    let result = read_json(folder.join("result.json"));
    assert_eq!(result["confusion"]["rows"], json!(["(nothing)", "quadratic_load"]));
    assert_eq!(
        fs::read_to_string(folder.join("confusion.csv")).unwrap(),
        "hidden,quadratic_load,(none)\n(nothing),0,1\nquadratic_load,1,0\n"
    );
    has(
        &fs::read_to_string(&metrics).unwrap(),
        &["hidden=\"quadratic_load\",named=\"quadratic_load\"} 1"],
    );
}

/// A machine without tolerance, so that a seed draws its noise alone.
fn exact(desk: &Desk) -> PathBuf {
    desk.put("machine.toml", &PLAIN.replace("tolerance = 0.1", "tolerance = 0.0"))
}

/// The suite that `init` writes from these runs, with other seeds, on a machine in which one thing is changed.
fn held_to(desk: &Desk, golden: &Path, from: &str, to: &str) -> Done {
    let text = fs::read_to_string(golden).unwrap();
    let machine = fs::read_to_string(desk.path("golden-emulator.toml")).unwrap();
    assert!(machine.contains(from) && text.contains("seed = 1\n"), "{machine}\n{text}");
    desk.put("golden-emulator.toml", &machine.replace(from, to));
    let other = desk.put("other.toml", &text.replace("seed = 1\n", "seed = 500\nrepeat = 2\n"));
    let done = call("test {} --out {}", &[&other, &desk.path("out")]);
    desk.put("golden-emulator.toml", &machine);
    done
}

#[test]
fn a_suite_from_a_commissioning_fails_on_a_changed_machine() {
    let desk = Desk::new();
    let machine = exact(&desk);
    let done = desk.simulate("commission --headless", "--emulator {} --seed 1", &[&machine]);
    let found = done.expect(0).json();
    let folders: Vec<PathBuf> =
        (0..4).map(|run| PathBuf::from(word(&found, &format!("/runs/{run}/folder")))).collect();
    let golden = desk.path("golden.toml");
    let done = call(
        "init --out {} --suite {} {} {} {}",
        &[&golden, &folders[0], &folders[1], &folders[2], &folders[3]],
    );
    let done = done.expect(0);
    has(
        &done.stdout,
        &["golden-bench.toml", "resistance_ohm = [1.0", "noise floors; a quarter more"],
    );
    held_to(&desk, &golden, "hidden = []", "hidden = []").expect(0);
    for (from, to, key) in [
        ("load_torque_n_m = 0.455", "load_torque_n_m = 0.50", "load_torque_n_m: 0.5"),
        ("inertia_kg_m2 = 0.0045", "inertia_kg_m2 = 0.0048", "inertia_kg_m2: 0.004"),
        (
            "hidden = []",
            "hidden = [{ id = \"quadratic_load\", quadratic_n_m_s2_per_rad2 = 1.8e-6 }]",
            "verdict: effect, has to be none",
        ),
    ] {
        let done = held_to(&desk, &golden, from, to).expect(1);
        has(&done.stderr, &[key, "2 of 2 cases did not pass"]);
    }
    // Nothing is overwritten.
    call("init --out {} --suite {}", &[&golden, &folders[0]]).fails(2, &["exists already"]);
}

#[test]
fn a_suite_from_runs_and_a_speed_loop_holds_both() {
    let desk = Desk::new();
    let machine = exact(&desk);
    let mut folders = Vec::new();
    for (command, seeds) in [("run --headless", "--run-seed 4"), ("speed", "")] {
        let options = format!("--emulator {{}} --seed 1 {seeds}");
        let found = desk.simulate(command, &options, &[&machine]);
        folders.push(PathBuf::from(word(&found.expect(0).json(), "/folder")));
    }
    let golden = desk.path("golden.toml");
    let found = json_of("init --json --out {} --suite {} {}", &[&golden, &folders[0], &folders[1]]);
    has(
        word(&found, "/suite"),
        &["excite = { run_seed = 4 }", "speed = {}", "loop.steps.1.overshoot_percent"],
    );
    held_to(&desk, &golden, "hidden = []", "hidden = []").expect(0);
}

#[test]
fn runs_that_ended_early_or_differ_make_no_suite() {
    let desk = Desk::new();
    let run = &Runs::plain().fit;
    let other = desk.path("other");
    fs::create_dir(&other).unwrap();
    fs::copy(run.join("result.json"), other.join("result.json")).unwrap();
    let manifest = fs::read_to_string(run.join("manifest.json")).unwrap();
    let out = desk.path("golden.toml");
    for (from, to, words) in [
        ("\"finished\": true", "\"finished\": false", "the record is incomplete"),
        ("\"outcome\": \"passed\"", "\"outcome\": \"safety trip\"", "safety trip"),
        ("rate_hz = 100", "rate_hz = 50", "differ in their bench"),
    ] {
        assert!(manifest.contains(from), "{manifest}");
        desk.put("other/manifest.json", &manifest.replace(from, to));
        call("init --out {} --suite {} {}", &[&out, run, &other]).fails(2, &[words]);
    }
    refusals("init --suite runs/x", &[]);
    assert!(!out.exists());
}

#[test]
fn shipped_suites_try_every_hidden_effect_and_every_profile() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/suites");
    let diagnosis = fs::read_to_string(root.join("diagnosis.toml")).unwrap();
    for id in drivebench::emulator::truth::effect::HiddenEffect::ids() {
        has(&diagnosis, &[&format!("id = \"{id}\"")]);
    }
    let profiles = fs::read_to_string(root.join("profiles.toml")).unwrap();
    for name in drivebench::drive::DriveProfile::names() {
        has(&profiles, &[&format!("drive = \"{name}\"")]);
    }
}
