//! Many runs as one table: the same whatever the threads, the parts and the kills; and the queries of its page.

use std::process::Command;

use crate::kit::prelude::*;

/// Three machines in spring and in autumn, of which the second has a dry bearing by then and the third hides an effect; and a
/// folder in which a run should be and is not.
fn fleet(desk: &Desk) -> PathBuf {
    let dry = PLAIN.replace("load_torque_n_m = 0.455", "load_torque_n_m = 0.5096");
    let (plain, dry) = (desk.put("plain.toml", PLAIN), desk.put("dry.toml", &dry));
    let hidden = desk.put("hidden.toml", HIDDEN);
    let runs = desk.path("runs");
    for (serial, spring, autumn) in
        [(11, &plain, &plain), (12, &plain, &dry), (13, &hidden, &hidden)]
    {
        for (month, emulator) in [("03", spring), ("10", autumn)] {
            let out = desk.path("one");
            let options = format!(
                "run --headless --port sim: --json --out {{}} --emulator {{}} --seed {serial} --run-seed 1{month}"
            );
            call(&options, &[&out, emulator]).expect(0);
            let made = only_folder(&out);
            let mut manifest = read_json(made.join("manifest.json"));
            manifest["stamp"] = format!("2026{month}01T120000Z").into();
            fs::write(made.join("manifest.json"), manifest.to_string()).unwrap();
            fs::create_dir_all(runs.join(month)).unwrap();
            fs::rename(&made, runs.join(month).join(format!("machine-{serial}"))).unwrap();
            fs::remove_dir_all(&out).unwrap();
        }
    }
    fs::create_dir_all(runs.join("torn")).unwrap();
    fs::write(runs.join("torn/manifest.json"), "{").unwrap();
    runs
}

/// The numbers of one column, in the rows that have one: no cell before it has a comma.
fn figures(table: &str, name: &str) -> Vec<f64> {
    let mut rows = table.lines().map(|row| row.split(',').collect::<Vec<_>>());
    let place = rows.next().unwrap().iter().position(|cell| *cell == name).unwrap();
    rows.filter_map(|row| row[place].parse().ok()).collect()
}

/// Analyses into a file of this name; the status is 1, as one run cannot be read.
#[track_caller]
fn table(desk: &Desk, runs: &Path, name: &str, options: &str) -> String {
    let out = desk.path(name);
    call(&format!("analyse {{}} --out {{}} {options}"), &[runs, &out]).expect(1);
    assert!(!desk.path(format!("{name}.part")).exists());
    fs::read_to_string(out).unwrap()
}

#[test]
fn threads_parts_and_kills_do_not_change_the_table() {
    let desk = Desk::new();
    let runs = fleet(&desk);
    let whole = table(&desk, &runs, "whole.csv", "--jobs 1");
    let lines: Vec<&str> = whole.lines().collect();
    assert_eq!(lines.len(), 8, "{whole}");
    for (row, words) in [
        (1, ["03/machine-11,ok,,", "2026-03-01T12:00:00Z,drivebench software drive,11,ZK-22FC"]),
        (6, ["10/machine-13,ok,,", "2026-10-01T12:00:00Z,drivebench software drive,13,ZK-22FC"]),
        (7, ["torn,unread,", "without a samples.csv"]),
    ] {
        has(lines[row], &words);
    }
    let inertia = figures(&whole, "inertia_kg_m2");
    assert!(
        inertia.len() == 6 && inertia.iter().all(|value| (0.004..0.005).contains(value)),
        "{inertia:?}"
    );
    for (low, high) in
        figures(&whole, "load_torque_n_m_low").iter().zip(figures(&whole, "load_torque_n_m_high"))
    {
        assert!(*low < high);
    }
    assert_eq!(table(&desk, &runs, "four.csv", "--jobs 4"), whole);
    // On standard output, and as lines of JSON.
    let printed = call("analyse {} {}", &[&runs, &runs.join("03")]).expect(1);
    assert_eq!(printed.stdout, whole);
    let printed = call("analyse {} --json", &[&runs]).expect(1).stdout;
    let first: Value = serde_json::from_str(printed.lines().next().unwrap()).unwrap();
    assert_eq!(first["drive_serial"], "11");
    assert!((number(&first, "/inertia_kg_m2") - inertia[0]).abs() < 1e-15);
    // Parts.
    let mut parts = String::new();
    for part in 1..=3 {
        let out = desk.path(format!("part-{part}.csv"));
        let status = i32::from(part == 3);
        call(&format!("analyse {{}} --out {{}} --shard {part}/3"), &[&runs, &out]).expect(status);
        let text = fs::read_to_string(out).unwrap();
        let (header, rows) = text.split_once('\n').unwrap();
        assert_eq!(header, lines[0]);
        parts.push_str(rows);
    }
    assert_eq!(format!("{}\n{parts}", lines[0]), whole);
    // Whatever a kill has left of the journal, it is gone on with.
    let (part, out) = (desk.path("killed.csv.part"), desk.path("killed.csv"));
    for cut in (0..whole.len()).step_by(whole.len() / 12).chain([whole.len()]) {
        fs::write(&part, &whole[..cut]).unwrap();
        refusal("analyse {} --out {}", &[&runs, &out]);
        let kept = whole[..cut].matches('\n').count().saturating_sub(1);
        let sum = call("analyse {} --out {} --resume --json", &[&runs, &out]).expect(1).json();
        assert_eq!(sum["kept"], kept, "cut at {cut}");
        assert_eq!(fs::read_to_string(&out).unwrap(), whole, "cut at {cut}");
        assert!(!part.exists());
        fs::remove_file(&out).unwrap();
    }
}

#[test]
fn only_what_is_still_true_is_kept() {
    let desk = Desk::new();
    let runs = fleet(&desk);
    let whole = table(&desk, &runs, "fleet.csv", "");
    refusal("analyse {} --out {}", &[&runs, &desk.path("fleet.csv")]);
    let kept = |options: &str| {
        let text = format!("analyse {{}} --out {{}} --resume --json {options}");
        let sum = call(&text, &[&runs, &desk.path("fleet.csv")]).expect(1).json();
        sum["kept"].as_u64().unwrap()
    };
    assert_eq!(kept(""), 7);
    // One value of one run is another.
    let samples = runs.join("03/machine-12/samples.csv");
    let text = fs::read_to_string(&samples).unwrap();
    let (head, last) = text.trim_end().rsplit_once('\n').unwrap();
    fs::write(&samples, format!("{head}\n")).unwrap();
    assert_eq!(kept(""), 6);
    assert_ne!(fs::read_to_string(desk.path("fleet.csv")).unwrap(), whole);
    fs::write(&samples, format!("{head}\n{last}\n")).unwrap();
    assert_eq!(kept(""), 6);
    assert_eq!(fs::read_to_string(desk.path("fleet.csv")).unwrap(), whole);
    // Another analysis has rows of its own: those of the one before are counted, and not lost for runs that are not named.
    let spring = runs.join("03");
    let sum = |runs: &Path, options: &str| {
        let text = format!("analyse {{}} --out {{}} --resume --json {options}");
        call(&text, &[runs, &desk.path("fleet.csv")])
    };
    let refused = sum(&spring, "--scheme weak-form").expect(2).error();
    has(&refused, &["4 rows of other options", "not named now"]);
    assert_eq!(fs::read_to_string(desk.path("fleet.csv")).unwrap(), whole);
    assert!(!desk.path("fleet.csv.part").exists());
    let other = sum(&runs, "--scheme weak-form").expect(1).json();
    assert_eq!((&other["kept"], &other["left_out"]), (&0.into(), &7.into()));
    let back = sum(&runs, "").expect(1).json();
    assert_eq!((&back["kept"], &back["left_out"]), (&0.into(), &7.into()));
    let fewer = sum(&spring, "").expect(0).json();
    assert_eq!((&fewer["kept"], &fewer["left_out"]), (&3.into(), &4.into()));
    // What somebody else wrote is not gone on with, neither as a table nor as a journal.
    let samples = fs::read_to_string(&samples).unwrap();
    for (name, out) in [("s.csv", "s.csv"), ("t.csv.part", "t.csv")] {
        let (file, out) = (desk.put(name, &samples), desk.path(out));
        let error = refusal("analyse {} --out {} --resume", &[&spring, &out]);
        has(&error, &[name, "its columns differ"]);
        assert_eq!(fs::read_to_string(&file).unwrap(), samples, "{name}");
    }
    assert!(!desk.path("s.csv.part").exists() && !desk.path("t.csv").exists());
}

#[test]
fn what_is_no_run_is_refused_before_anything_is_written() {
    let desk = Desk::new();
    let out = desk.path("fleet.txt");
    fs::create_dir_all(desk.path("empty")).unwrap();
    refusals(
        "analyse => RUNS
         analyse {} --resume => --out
         analyse nowhere => no such run
         analyse nowhere/* => no run matches this pattern
         analyse {} --out {} => .csv or .parquet
         analyse {} --shard 3/2 => 1 <= I <= N
         analyse {} --scheme 7 => output-error",
        &[&desk.path("empty"), &out],
    );
    // A folder without a run is a row, and with no other the command has read nothing.
    let table = desk.path("fleet.csv");
    call("analyse {} --out {}", &[&desk.path("empty"), &table])
        .fails(2, &["1 of 1 runs could not be read"]);
    has(&fs::read_to_string(&table).unwrap(), &["empty,unread,", "without a samples.csv"]);
    // A line break in a path is a blank in its row, and the row is there.
    let broken = desk.path("line\nbreak");
    fs::create_dir_all(&broken).unwrap();
    let table = desk.path("broken.csv");
    for (options, kept) in [("", 0), ("--resume", 1)] {
        let text = format!("analyse {{}} --out {{}} --json {options}");
        let done = call(&text, &[&broken, &table]).expect(2);
        has(&done.stdout, &[&format!("\"kept\": {kept}")]);
        has(&fs::read_to_string(&table).unwrap(), &["line break,unread,"]);
    }
    fs::create_dir_all(desk.path("line break")).unwrap();
    refusals("analyse {} {} => two runs have this name", &[&broken, &desk.path("line break")]);
}

/// The blocks of a page that stand behind `<!-- tool: name -->`.
fn blocks(page: &str, tool: &str) -> Vec<(String, String)> {
    let mark = format!("<!-- {tool}: ");
    let blocks = page.split(&mark).skip(1).map(|part| {
        let (name, rest) = part.split_once(" -->").unwrap();
        let code = rest.split("```").nth(1).unwrap();
        let (_language, code) = code.split_once('\n').unwrap();
        (name.to_owned(), code.to_owned())
    });
    blocks.collect()
}

#[test]
fn queries_of_the_page_find_bearing_and_hidden_effect() {
    let page = include_str!("../../docs/suites.md");
    let desk = Desk::new();
    let runs = fleet(&desk);
    let whole = table(&desk, &runs, "fleet.csv", "--diagnose");
    let header: Vec<&str> = whole.lines().next().unwrap().split(',').collect();
    let of_a_parameter =
        |name: &&&str| ["_std", "_low", "_high", "_verdict"].iter().any(|end| name.ends_with(end));
    for name in header.iter().filter(|name| !of_a_parameter(name)) {
        assert!(page.contains(&format!("`{name}`")), "the page does not name {name}");
    }
    let queries = blocks(page, "duckdb");
    let names: Vec<&str> = queries.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["drift", "worst", "effects", "unread"]);
    let python = |code: &str| {
        let output = Command::new("python3").args(["-c", code]).current_dir(desk.folder()).output();
        output.map_or_else(|_| Done::default(), |output| Done::of(&output))
    };
    let is_there = |module: &str| {
        let is_there = python(&format!("import {module}; print(1)")).stdout.starts_with('1');
        if !is_there {
            eprintln!(
                "SKIPPED: {module} for Python is not installed: its queries of docs/suites.md were not run"
            );
        }
        is_there
    };
    if is_there("duckdb") {
        let found = queries.iter().map(|(_, query)| {
            let code =
                format!("import duckdb, json\nprint(json.dumps(duckdb.sql({query:?}).fetchall()))");
            let rows: Value = serde_json::from_str(&python(&code).expect(0).stdout).unwrap();
            rows
        });
        let found: Vec<Value> = found.collect();
        let [drift, worst, effects, unread] = &found[..] else { panic!("{found:?}") };
        // Twelve per cent more friction, beyond all doubt; the other two as they were.
        let serial = |row: &Value| row[1].to_string().replace('"', "");
        assert_eq!(serial(&drift[0]), "12", "{drift}");
        assert!((number(&drift[0], "/3") - 12.0).abs() < 1.0, "{drift}");
        assert!(number(&drift[0], "/4") > 30.0, "{drift}");
        assert!(number(&drift[1], "/3").abs() < 1.5, "{drift}");
        assert_eq!(serial(&worst[0]), "13", "{worst}");
        assert_eq!(effects[0], json!(["stribeck_friction", 2, 1]), "{effects}");
        assert!(word(&unread[0], "/0").ends_with("torn"), "{unread}");
    }
    if is_there("polars") {
        let (_, code) = blocks(page, "polars").pop().unwrap();
        let printed = format!("{code}\nprint(drift.row(0)[1], drift.row(0)[3])");
        let stdout = python(&printed).expect(0).stdout;
        let (serial, percent) = stdout.lines().last().unwrap().split_once(' ').unwrap();
        assert_eq!(serial, "12", "{stdout}");
        assert!((percent.parse::<f64>().unwrap() - 12.0).abs() < 1.0, "{stdout}");
    }
}

/// Excites and identifies; nothing may have drifted.
const SUITE: &str = "name = \"yearly\"\n[[case]]\nname = \"as it was\"\nemulator = \"EMULATOR\"\nseed = 12\n\
    needs = [\"baseline\"]\n[[case.step]]\nexcite = { run_seed = 5 }\n[[case.step]]\nidentify = {}\n\
    [[case.step]]\nassert = { drift = \"none\", drift_percent = \"< 5\", drift_open_percent = \"< 5\" }\n";

/// A fleet, and a suite that one of its machines has to pass as it was.
struct Yearly {
    desk: Desk,
    spring: PathBuf,
    other: PathBuf,
}

impl Yearly {
    fn new() -> Self {
        let desk = Desk::new();
        let runs = fleet(&desk);
        let (spring, other) = (runs.join("03/machine-12"), runs.join("03/machine-11"));
        Self { desk, spring, other }
    }

    fn suite(&self, emulator: &str) -> PathBuf {
        let text = SUITE.replace("EMULATOR", emulator);
        self.desk.put("suite.toml", &text)
    }

    fn test(&self, emulator: &str, baseline: &Path, options: &str) -> Done {
        let text = format!("test {{}} --json --out {{}} --baseline {{}} {options}");
        let (suite, out) = (self.suite(emulator), self.desk.path("suites"));
        call(&text, &[&suite, &out, baseline])
    }

    /// The machine with more friction, against its spring; what came of it, and its folder.
    fn drifted(&self) -> (Done, Value, PathBuf) {
        let failed = self.test("dry.toml", &self.spring, "--keep").expect(1);
        let found: Value = serde_json::from_str(&failed.stdout).unwrap();
        let case = self.desk.path(found["cases"][0]["evidence"].as_str().unwrap());
        (failed, found, case)
    }
}

#[test]
fn a_suite_names_what_has_drifted_since_an_earlier_run() {
    let yearly = Yearly::new();
    let passed = yearly.test("plain.toml", &yearly.spring, "").expect(0);
    let found: Value = serde_json::from_str(&passed.stdout).unwrap();
    let drift = &found["cases"][0]["steps"][1]["identified"]["drift"];
    has(
        word(drift, "/sentence"),
        &["no drift shown since 2026-03-01: 5 parameters compared", "larger than"],
    );
    has(word(drift, "/caution"), &["one run on each side"]);

    let (failed, found, _) = yearly.drifted();
    has(&failed.stderr, &["FAILED", "drift: load_torque_n_m, has to be none", "drift_percent: 1"]);
    let changes =
        found["cases"][0]["steps"][1]["identified"]["drift"]["changes"].as_array().unwrap().clone();
    let friction = changes.iter().find(|change| change["key"] == "load_torque_n_m").unwrap();
    has(
        word(friction, "/sentence"),
        &["+1", "% (95 % interval +1", "since 2026-03-01", "possible cause: bearing"],
    );
    let others = changes.iter().filter(|change| change["key"] != "load_torque_n_m");
    assert!(
        others.clone().count() == 4 && others.clone().all(|change| change["drifted"] == false),
        "{changes:?}"
    );
}

#[test]
fn an_earlier_result_is_a_baseline_and_counts_once() {
    let yearly = Yearly::new();
    let test =
        |emulator: &str, baseline: &Path, options: &str| yearly.test(emulator, baseline, options);
    let (desk, suite) = (&yearly.desk, |emulator: &str| yearly.suite(emulator));
    let (.., case) = yearly.drifted();
    // It has the figures of its run.
    let result = case.parent().unwrap().to_owned();
    let back = test("plain.toml", &result, "").expect(1);
    has(&back.stderr, &["drift: load_torque_n_m, has to be none"]);
    let itself = test("dry.toml", &result, "").expect(0);
    has(&itself.stdout, &["figure for figure as it was then"]);

    // Given twice, and with the run that it is of, it is one earlier run.
    let kept = only_folder(&case.join("runs"));
    let twice = [&result, &result.join("result.json"), &kept];
    let twice = twice.map(|path| path.display().to_string());
    let [first, second, run] = twice.each_ref();
    let options = format!("--baseline {second} --baseline {run} --baseline {first}");
    let counted = test("plain.toml", &result, &options).expect(1);
    has(&counted.stdout, &["one run on each side", "3 of the baseline"]);

    // What was carried and is not any more, what cannot be compared at all, and a unit that has no number.
    let doctored = |name: &str, change: &dyn Fn(&mut Value)| {
        let mut result = read_json(result.join("result.json"));
        change(&mut result["cases"][0]["steps"][1]["identified"]);
        desk.put(name, &result.to_string())
    };
    let more = doctored("more.json", &|found| {
        let parameters = &mut found["parameters"];
        parameters["viscous_friction.coefficient"] = parameters["inertia_kg_m2"].clone();
    });
    let lost = test("dry.toml", &more, "").expect(1);
    has(
        &lost.stdout,
        &[
            "drift: viscous_friction.coefficient not compared: not observable in the later runs, has to be none",
            "drift_percent: not known",
            "drift_open_percent: not known",
            "; not compared: viscous_friction.coefficient",
        ],
    );
    let paths = [suite("dry.toml"), desk.path("suites"), more];
    let paths = paths.each_ref().map(PathBuf::as_path);
    let tested = call("test {} --out {} --baseline {}", &paths).expect(1);
    has(&tested.stdout, &["  viscous_friction.coefficient not compared:"]);
    let less = doctored("less.json", &|found| found["parameters"] = json!({}));
    has(
        &test("dry.toml", &less, "").expect(1).stdout,
        &[
            "no comparison",
            "drift: not in the result",
            "drift_percent: not in the result",
            "drift_open_percent: not in the result",
        ],
    );
    let unnumbered = doctored("unnumbered.json", &|found| {
        found["machine"]["drive_serial"] = "".into();
    });
    has(
        &test("dry.toml", &unnumbered, "--any-machine").expect(0).stdout,
        &["no serial number: not known to be the same unit"],
    );
}

#[test]
fn another_machine_is_no_baseline() {
    let yearly = Yearly::new();
    let (desk, other) = (&yearly.desk, &yearly.other);
    let refused = yearly.test("plain.toml", other, "").expect(1);
    has(
        &refused.stderr,
        &["not known to be of this machine", "serial 12", "serial 11", "--any-machine"],
    );
    let compared = yearly.test("plain.toml", other, "--any-machine").expect(1);
    has(&compared.stderr, &["has to be none"]);

    // Without one the case is skipped; where it does not say that it needs one, it cannot be judged.
    let alone = |text: &str| {
        call("test {} --json --out {}", &[&desk.put("suite.toml", text), &desk.path("suites")])
    };
    let plain = SUITE.replace("EMULATOR", "plain.toml");
    has(&alone(&plain).expect(0).stderr, &["skipped", "no --baseline"]);
    let unsaid = plain.replace("needs = [\"baseline\"]\n", "");
    has(&alone(&unsaid).expect(1).stderr, &["ERROR", "give --baseline RUN"]);
    refusal("test {} --baseline {}", &[&yearly.suite("plain.toml"), &desk.path("plain.toml")]);
}
