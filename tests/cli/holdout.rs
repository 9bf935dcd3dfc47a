//! Hold-outs that test nothing, and files with holes: both are reported, and the remaining results are given.

use crate::kit::prelude::*;
use std::sync::OnceLock;

use crate::kit::motor_log::{Bench, COLUMNS, Row, csv, steps};
/// `share` of the steps.
fn record(bench: Bench, share: f64) -> Vec<Row> {
    bench.record(|time_s| share * steps(time_s))
}

/// The same motor with other noise.
fn again(seed: u64) -> Bench {
    Bench { seed, ..Bench::PAPER_A }
}

/// Another motor.
const OTHER: Bench = Bench { resistance_ohm: 3.3, ke: 0.17, seed: 29, ..Bench::PAPER_A };

fn good() -> &'static [Row] {
    static ROWS: OnceLock<Vec<Row>> = OnceLock::new();
    ROWS.get_or_init(|| record(Bench::PAPER_A, 1.0))
}

fn text_of(rows: &[Row], change: impl Fn(&mut Row)) -> String {
    csv(COLUMNS, rows, change)
}

/// What cannot serve as a hold-out is set aside with its reason, and the run is judged by its own last part.
#[test]
fn a_holdout_that_tests_nothing_is_not_used_and_the_reason_is_given() {
    let desk = Desk::new();
    let nameplate = desk.nameplate();
    let run = desk.put("run.csv", &text_of(good(), |_| {}));
    let again = record(again(23), 0.9);
    let other = record(OTHER, 0.9);
    let again_but = |change: fn(&mut Row)| text_of(&again, change);
    for (reason, text) in [
        ("are those of the run", text_of(good(), |_| {})),
        ("not of the same motor", text_of(&other, |_| {})),
        ("a tenth of the run", text_of(&again[..100], |_| {})),
        ("nothing changes", again_but(|row| row[1..].fill(0.0))),
        ("seems to be in mA", again_but(|row| row[2] *= 1e3)),
        ("seems to be in ms", again_but(|row| row[0] *= 1e3)),
    ] {
        let holdout = desk.put("holdout.csv", &text);
        let done =
            call("diagnose {} --json --model {} --holdout {}", &[&run, &nameplate, &holdout])
                .expect(0);
        let found = done.json();
        assert_eq!(found["holdout_from"], "split", "{reason}: {}", done.stderr);
        assert_eq!(found["verdict"], "none", "{reason}: {found:#}");
        has(&done.stderr, &[reason, "not used"]);
        has(&found["notes"].to_string(), &[reason]);
    }
    let good = desk.put("holdout.csv", &text_of(&again, |_| {}));
    let done =
        call("diagnose {} --json --model {} --holdout {}", &[&run, &nameplate, &good]).expect(0);
    assert_eq!(done.json()["holdout_from"], "run");
    lacks(&done.stderr, &["warning"]);
}

/// A torque and a speed that have nothing to do with each other: no names, no places, and where to look next.
#[test]
fn a_model_no_better_than_the_mean_is_not_fitted() {
    let desk = Desk::new();
    let row = |row: u16| {
        let t = 0.005 * f64::from(row);
        let torque = 0.05 * ((7.3 * t).sin() + (2.9 * t + 1.0).sin() * (13.1 * t).cos());
        let speed = 30.0 * (1.7 * t).sin() + 20.0 * (4.1 * t).sin();
        format!("{t:.3},{torque:.5},{speed:.3}\n")
    };
    let rows: String = (0..4000).map(row).collect();
    let run = desk.put("run.csv", &format!("time_s,torque_n_m,speed_rad_s\n{rows}"));
    let done = call("diagnose {}", &[&run]).expect(0);
    has(&done.stdout, &["NOT FITTED", "no effect is named"]);
    has(&done.stdout, &["not observable", "drivebench identify", "--full"]);
    lacks(&done.stdout, &["settled", "ruled out "]);
    let done = call("compare {}", &[&run]).expect(0);
    has(&done.stdout, &["NOT FITTED"]);
    let found = call("diagnose {} --json", &[&run]).expect(0).json();
    assert_eq!(found["verdict"], "not_fitted", "{found:#}");
    assert!(found["candidates"].as_array().unwrap().is_empty());
}

/// Without a standstill errors are counted in the residual of the refitted baseline, and no word may call that a floor.
#[test]
fn without_a_noise_floor_nothing_is_given_in_multiples_of_it() {
    let desk = Desk::new();
    let nameplate = desk.nameplate();
    let [run, holdout, confirm] = [("run", 7, 1.0), ("holdout", 37, 0.9), ("confirm", 41, 0.8)]
        .map(|(name, seed, share)| {
            let rows = record(Bench { drop_v: 2.0, ..again(seed) }, share);
            desk.put(&format!("{name}.csv"), &text_of(&rows[120..], |_| {}))
        });
    let model = desk.path("model2.toml");
    let page = desk.path("page.html");
    let paths: [&Path; 5] = [&nameplate, &run, &holdout, &confirm, &model];
    let files: [&Path; 4] = [&run, &nameplate, &holdout, &page];
    let diagnosed = "diagnose {} --model {} --holdout {} --html {}";
    let added = "add voltage_drop --model {} --run {} --holdout {} --confirm {} --output {}";
    let refused = "add quadratic_load --model {} --run {} --holdout {} --confirm {}";
    let diagnosis = call(diagnosed, &files).expect(0).stdout;
    let accepted = call(added, &paths).expect(0).stdout;
    let refusal = call(refused, &paths[..4]);
    for (name, text) in [
        ("diagnose", diagnosis),
        ("page", fs::read_to_string(page).expect("written")),
        ("add", accepted),
        ("refused", refusal.stdout.clone() + &refusal.stderr),
        ("model", fs::read_to_string(model).expect("written")),
    ] {
        let text = text.replace("&#39;", "'");
        assert!(!text.contains("times the noise"), "{name}: {text}");
        assert!(!text.contains("at the noise floor"), "{name}: {text}");
        assert!(text.contains("the baseline's residual"), "{name}: {text}");
    }
}

/// Stderr and page of a command on the run, a hold-out and the nameplate.
fn page_of(desk: &Desk, command: &str, run: &Path, holdout: &Path) -> (String, String) {
    let page = desk.path(format!("{command}.html"));
    let nameplate = desk.nameplate();
    let text = format!("{command} {{}} --holdout {{}} --model {{}} --html {{}}");
    let done = call(&text, &[run, holdout, &nameplate, &page]).expect(0);
    (done.stderr, fs::read_to_string(page).expect("the page is written"))
}

#[test]
fn a_page_names_what_it_is_judged_by_and_what_is_objected_to() {
    let desk = Desk::new();
    let put = |name: &str, rows: &[Row]| desk.put(name, &text_of(rows, |_| {}));
    let run = put("run.csv", good());
    let (other, again) =
        (put("other.csv", &record(OTHER, 0.9)), put("again.csv", &record(again(23), 0.9)));
    let (unseen, objected) = ("not used in the fit", "its samples are those of the run");
    for (command, holdout, stands, stands_not) in [
        (
            "diagnose",
            &other,
            &["run.csv, last 40 % held out", "not of the same motor"][..],
            &["held out other.csv", "run 2"][..],
        ),
        ("compare", &run, &[objected], &[unseen]),
        ("compare", &again, &["held out again.csv", unseen], &["About the data"]),
    ] {
        let _ = fs::remove_file(desk.path(format!("{command}.html")));
        let (_, page) = page_of(&desk, command, &run, holdout);
        has(&page, stands);
        lacks(&page, stands_not);
    }
}

#[test]
fn holes_and_dropped_rows_are_on_stderr_and_on_both_pages() {
    let desk = Desk::new();
    let with_hole = |rows: &[Row]| [&rows[..700], &rows[760..]].concat();
    let torn = text_of(&with_hole(good()), |_| {}) + "7.99,1";
    let run = desk.put("run.csv", &torn);
    let again = with_hole(&record(again(23), 0.9));
    let holdout = desk.put("again.csv", &text_of(&again, |_| {}));
    for command in ["diagnose", "compare"] {
        let (stderr, page) = page_of(&desk, command, &run, &holdout);
        for text in [&stderr, &page] {
            has(text, &["run.csv: 60 of ", "again.csv: 60 of ", "of voltage_v are missing"]);
        }
        assert!(page.contains("Rows of the file that were dropped: 1"), "{command}: {page}");
    }
}

/// What is fitted judges nothing: a later run that is the hold-out, the confirming run or another later run is set aside.
#[test]
fn a_later_run_that_judges_or_is_there_already_is_not_fitted() {
    let desk = Desk::new();
    let nameplate = desk.nameplate();
    let run = desk.put("run.csv", &text_of(good(), |_| {}));
    let put = |name: &str, seed| {
        let rows = record(again(seed), 0.9);
        desk.put(name, &text_of(&rows, |_| {}))
    };
    let (judges, later) = (put("judges.csv", 23), put("later.csv", 24));
    for (options, second, of) in [
        ("--holdout {} --with {}", &judges, "the hold-out"),
        ("--confirm {} --with {}", &judges, "the confirming run"),
        ("--with {} --with {}", &later, "the later run before it"),
    ] {
        let command = format!("compare {{}} --json --model {{}} {options}");
        let done = call(&command, &[&run, &nameplate, second, second]).expect(0);
        let notes = done.json()["notes"].to_string();
        let expected = format!("its samples are those of {of}");
        has(&notes, &[&expected, "it is not used"]);
    }
    let done = call(
        "compare {} --json --model {} --holdout {} --with {}",
        &[&run, &nameplate, &judges, &later],
    );
    let notes = done.expect(0).json()["notes"].to_string();
    lacks(&notes, &["is not used"]);
}
