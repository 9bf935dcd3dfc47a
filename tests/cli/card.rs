//! What a person sees of a result: a card that fits a terminal, its next command, its page last; true words in it.

use crate::kit::prelude::*;

/// What a card fits into.
const COLUMNS: usize = 100;
const LINES: usize = 30;

/// The run in this folder whose name ends so, as a person writes its path.
fn run_of(desk: &Desk, role: &str) -> String {
    let folders = fs::read_dir(desk.out()).expect("runs");
    let mut names = folders.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let name = names.find(|name| name.ends_with(role)).expect("a run");
    format!("runs/{name}")
}

#[track_caller]
fn expect_card(command: &str, text: &str, last: &str) {
    let rows: Vec<&str> = text.lines().collect();
    assert!(rows.len() <= LINES, "{command}: {} lines\n{text}", rows.len());
    for row in &rows {
        let columns = row.chars().count();
        assert!(columns <= COLUMNS, "{command}: {columns} columns\n{row}");
        let is_markdown = ["#", "|", "> ", "- ["].iter().any(|mark| row.starts_with(mark));
        assert!(!is_markdown, "{command}: raw Markdown\n{row}");
    }
    let end = rows.last().expect("a last line");
    assert!(end.contains(last), "{command} ends with\n{end}");
}

/// Commands on the runs of a commissioning, their status, and a part of the last line of their card.
const RESULTS: &str = "
identify FIT SELECT | 0 | drivebench diagnose
compare FIT --holdout SELECT | 0 | --holdout
compare FIT --model motor.toml --holdout SELECT | 0 | --holdout
diagnose FIT --model motor.toml --holdout SELECT | 0 | --output model2.toml
diagnose FIT --holdout SELECT --html page.html | 0 | page.html
add stribeck_friction --model motor.toml --run FIT --holdout SELECT --output with.toml | 0 | --feed-forward compare
add cogging --model motor.toml --run FIT --holdout SELECT --output no.toml | 1 | --holdout
tune --model FIT/model.toml | 0 | drivebench speed --model
speed --headless --port sim: --seed 7 --model FIT/model.toml --out others | 0 | /report.html
run --headless --port sim: --seed 7 --out others | 0 | /report.html
";

#[test]
fn every_result_fits_a_terminal_and_ends_with_the_next_step() {
    let desk = Desk::new();
    let of_loop = "commission --headless --port sim: --seed 7 --out runs";
    let text = desk.call(of_loop).expect(0).stdout;
    expect_card(of_loop, &text, "/report.html");
    has(
        &text,
        &[
            "EFFECT FOUND: stribeck_friction; ",
            "+ stribeck_friction",
            "after ± std",
            "boundary lubrication",
            "remedy",
            "the diagnosis is right",
            "drivebench speed --port sim: --seed 7 --headless",
        ],
    );
    let (fit, select) = (run_of(&desk, "-fit"), run_of(&desk, "-select"));
    desk.put("motor.toml", MODEL);
    let on_runs = |command: &str| command.replace("FIT", &fit).replace("SELECT", &select);
    for [command, status, last] in cases(RESULTS) {
        let done = desk.call(&on_runs(command)).expect(status.parse().unwrap());
        expect_card(command, &done.stdout, last);
    }
    let text =
        desk.call(&on_runs("diagnose FIT --model motor.toml --holdout SELECT")).expect(0).stdout;
    has(&text, &["cause ", "remedy ", "drivebench add stribeck_friction --model motor.toml"]);
    // --full prints everything.
    let full = desk.call(&on_runs("diagnose FIT --holdout SELECT --full")).expect(0).stdout;
    assert!(full.lines().count() > LINES, "{full}");
    has(&full, &["EFFECTS THAT WERE TRIED"]);
}

/// What commands print in a folder of a run, mistakes among them.
const PRINTED: &str = "
plan
plan bench.toml
plan unknown.toml
run --headless --port sim: --seed 7
run --headless --port sim: --escalate --seed 7
run --headless --port sim: --escalate --emulator small-servo-behind-zk-22fc
run --headless --port nowhere
run no-bench.toml
speed --headless --port sim: --seed 7 --controller pi --feed-forward compare
speed --headless --port sim: --controller pid
probe --port emulator --drive epulse50-dc
probe --port emulator --drive siemens-v20
probe --port emulator --drive own
probe --port nowhere
probe --port emulator --drive nobody
doctor --port nowhere
ports
identify runs/latest
identify runs/latest --full
identify runs/latest --scheme 4
replay runs/latest
simulate --model runs/latest/model.toml --run runs/latest --output simulated.csv
simulate --model runs/latest
compare runs/latest
compare runs
compare nowhere.csv
compare runs/latest --map speed=w
view runs/latest
tune --model runs/latest/model.toml
tune --model runs/latest
export --model runs/latest/model.toml --to c --output motor.h
export --model runs/latest/model.toml --to fmu
export --run runs/latest --to parquet --output run.parquet
report runs/latest --output page.html
effects stribeck_friction
effects stribek
emulate --profile nobody
init --drive nobody --port x --motor y
registers
registers read x --port nowhere
reproduce paper-c
completions tcsh
man --out man1
man --out /proc/man1
effects --figure
run --seed -1
diagnos
";

#[test]
fn no_line_that_a_command_prints_is_wider_than_a_terminal() {
    let desk = Desk::new();
    let unknown = BENCH.replace("[motor]", "[motor]\nunknown = true");
    desk.put("bench.toml", BENCH);
    desk.put("unknown.toml", &unknown);
    desk.call("run --headless --port sim: --seed 7").expect(0);
    for command in PRINTED.lines().filter(|line| !line.is_empty()) {
        let mut process = std::process::Command::new(BINARY);
        let output = process.args(command.split(' ')).current_dir(desk.folder()).output();
        let output = output.expect("it runs");
        let [stdout, stderr] = [&output.stdout, &output.stderr]
            .map(|bytes| String::from_utf8_lossy(bytes).into_owned());
        let rows = || stdout.lines().chain(stderr.lines());
        assert!(rows().count() > 0, "{command}: nothing is printed");
        for row in rows() {
            // What is copied stays whole.
            let is_alone = !row.trim().contains(' ');
            let columns = row.chars().count();
            assert!(columns <= COLUMNS || is_alone, "{command}: {columns} columns\n{row}");
        }
        if !command.contains("--full") {
            let lines = stdout.lines().count();
            assert!(lines <= LINES, "{command}: {lines} lines\n{stdout}");
        }
        assert_ne!(output.status.code(), Some(6), "{command}: {stderr}");
    }
}

#[test]
fn a_mistake_is_answered_with_what_to_do() {
    for (command, parts) in [
        ("registers", &["no command is given", "allowed: read, write"][..]),
        ("completions tcsh", &["tcsh", "allowed: bash, elvish, fish, powershell, zsh"]),
        ("completions bash --json", &["'--json'", "see drivebench completions --help"]),
        ("effects --jsno", &["did you mean `--json`?"]),
        ("diagnos", &["did you mean `diagnose`?"]),
        ("effects stribek", &["did you mean `stribeck_friction`?"]),
        ("run --seed -1", &["'-1'", "see drivebench run --help"]),
        ("run --seed abc", &["expected a whole number from 0"]),
        ("emulate --listen 1502", &["expected ADDRESS:PORT"]),
        ("emulate --link vesc", &["own does not have the protocol vesc", "modbus-tcp", "stream"]),
        ("emulate --profile vacon10 --link vesc", &["vacon10 does not", "allowed: modbus-rtu"]),
        ("emulate --profile vesc-dc --link modbus-rtu", &["vesc-dc does not", "allowed: vesc"]),
        (
            "reproduce paper-a --json",
            &[
                "`reproduce paper-a --json`",
                "allowed: the program drivebench-studies",
                "cargo run --release -p drivebench-studies -- paper-a --json",
            ],
        ),
        ("compare r --min-fit high", &["expected a number"]),
        ("diagnose", &["usage: drivebench diagnose <RUN>", "for example `drivebench diagnose "]),
        ("diagnose a b", &["another is given", "--holdout", "--model"]),
        ("compare a b", &["another is given", "--holdout", "--model"]),
        ("view a b", &["--holdout RUN2"]),
        ("inspect runs", &["'inspect'", "see drivebench --help"]),
    ] {
        let error = refusal(command, &[]);
        has(&error, parts);
        lacks(&error, &["as a value", "found in string", "float literal"]);
    }
    let runs = &Runs::plain().fit;
    has(&refusal("tune --model {}", &[runs]), &["its model is ", "/model.toml"]);
    let desk = Desk::new();
    let bench = desk.put("vesc.toml", &BENCH.replace("modbus-rtu", "vesc"));
    let error = refusal("run {} --port sim: --headless", &[&bench]);
    has(&error, &["own does not have the protocol vesc", "allowed: modbus-rtu"]);
    let Ok(full) = fs::OpenOptions::new().write(true).open("/dev/full") else {
        // Only Linux has a disk that is always full.
        return;
    };
    let mut process = std::process::Command::new(BINARY);
    process.args(["completions", "bash"]).stdout(full);
    let done = Done::of(&process.output().expect("it runs"));
    let stderr = done.fails(6, &["cannot write the result", "free space"]).stderr;
    lacks(&stderr, &["fault of drivebench"]);
}

#[test]
fn a_brush_drop_is_no_other_motor_for_a_run_either() {
    let desk = Desk::new();
    let run = "run --headless --port sim: --emulator zk-22fc-brushes --seed 7 --out runs";
    let text = desk.call(run).expect(0).stdout;
    lacks(&text, &["does NOT fit", "another motor"]);
    has(&text, &["plate     nameplate not judged: the residual of the five-parameter model is "]);
}

#[test]
fn compare_names_its_model_and_agrees_with_diagnose() {
    let desk = Desk::new();
    desk.call("run --headless --port sim: --seed 7 --out runs").expect(0);
    let run = run_of(&desk, "emulated");
    let of = |command: String| -> Value {
        serde_json::from_str(&desk.call(&command).expect(0).stdout).expect("JSON")
    };
    let compared = of(format!("compare {run} --json"));
    let diagnosed = of(format!("diagnose {run} --json"));
    let [here, there] = [number(&compared, "/holdout_rmse"), number(&diagnosed, "/holdout_before")];
    assert!((here / there - 1.0).abs() < 0.01, "{here} and {there}");
    let text = desk.call(&format!("compare {run}")).expect(0).stdout;
    has(&text, &["model.toml, refitted to this run, as in diagnose"]);
    let given = desk.call(&format!("compare {run} --model {run}/model.toml")).expect(0).stdout;
    has(&given, &["model.toml, not refitted"]);
}

#[test]
fn what_was_nearly_right_is_named() {
    let desk = Desk::new();
    for _ in 0..2 {
        desk.call("run --headless --port sim: --seed 7 --out runs").expect(0);
    }
    let stderr = |command: &str| desk.call(command).stderr;
    has(&stderr("compare runs"), &["a folder of 2 runs", "did you mean the latest of them, runs/"]);
    has(&stderr("compare ."), &["no run", "help: "]);
    let run = run_of(&desk, "emulated");
    let text = stderr(&format!("identify {run} --require inertia"));
    has(&text, &["did you mean `inertia_kg_m2`?"]);
}

#[test]
fn a_command_with_a_long_path_is_printed_to_be_copied() {
    let desk = Desk::new();
    let out = desk.path("long".repeat(30));
    let shown = call("run --headless --port sim: --out {}", &[&out]).expect(0).stdout;
    let command = format!("drivebench diagnose {}", only_folder(&out).display());
    assert!(command.chars().count() > 100);
    has(&shown, &[&command]);
}
