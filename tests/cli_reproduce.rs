//! `reproduce` through the real binary: text, JSON, files, and what it refuses.

mod program;

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::process::Stdio;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use program::{command, drivebench, line, only_folder};
use serde_json::Value;

#[test]
fn an_unknown_paper_is_told_what_is_allowed() {
    let error = drivebench(line("reproduce paper-z --json", &[]))
        .expect(2)
        .error();
    assert!(
        error.contains("paper-z") && error.contains("paper-a"),
        "{error}"
    );
}

#[test]
fn a_folder_with_results_is_not_overwritten() {
    let out = tempfile::tempdir().unwrap();
    fs::write(out.path().join("mine.txt"), "mine").unwrap();
    let done = drivebench(line("reproduce paper-a --out {}", &[out.path()])).expect(2);
    assert!(
        done.error().contains("never overwritten"),
        "{}",
        done.stderr
    );
    assert!(done.stdout.is_empty());
    assert_eq!(fs::read_dir(out.path()).unwrap().count(), 1);
}

#[test]
fn the_size_of_the_study_is_refused_where_it_means_nothing() {
    let paper = drivebench(line("reproduce paper-a --sets 2 --json", &[])).expect(2);
    assert!(paper.error().contains("--sets"), "{}", paper.stderr);
    drivebench(line("reproduce discovery --sets 0 --mysteries 0 --json", &[])).expect(2);
}

#[test]
fn an_interrupted_study_ends_with_130_and_leaves_nothing_behind() {
    let room = tempfile::tempdir().unwrap();
    let out = room.path().join("study");
    let mut child = command(line("reproduce discovery --out {}", &[&out]))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    let mut first = String::new();
    stderr.read_line(&mut first).unwrap();
    assert!(first.contains("machines"), "{first}");
    let id = i32::try_from(child.id()).unwrap();
    kill(Pid::from_raw(id), Signal::SIGINT).unwrap();
    let mut rest = String::new();
    stderr.read_to_string(&mut rest).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{rest}");
    assert!(output.stdout.is_empty() && !out.exists());
    assert!(rest.contains("error: interrupted"), "{rest}");
}

#[test]
fn a_study_of_mysteries_alone_counts_their_answers_and_intervals() {
    let room = tempfile::tempdir().unwrap();
    let out = room.path().join("study");
    let study = "reproduce discovery --sets 0 --mysteries 2 --seed 3 --out {}";
    let done = drivebench(line(study, &[&out])).expect(0);
    assert!(
        done.stderr.contains("mystery 4: hidden "),
        "{}",
        done.stderr
    );
    let page = fs::read_to_string(out.join("validation.md")).unwrap();
    assert!(page.contains("--sets 0 --mysteries 2 --seed 3"), "{page}");
    assert!(page.contains("Of 2 mystery drives"), "{page}");
    assert!(page.contains("| resistance_ohm "), "{page}");
    assert!(!page.contains("One hidden effect"), "{page}");
    // A study is a result, and results are never overwritten.
    let again = drivebench(line(study, &[&out])).expect(2);
    assert!(again.error().contains("never overwritten"));
}

/// One run serves the text and the files; a second one, as JSON, is the same to the bit.
#[test]
fn paper_a_is_printed_plotted_and_filed_the_same_every_time() {
    let room = tempfile::tempdir().unwrap();
    let out = room.path().join("paper-a");
    let done = drivebench(line("reproduce paper-a --out {}", &[&out])).expect(0);
    assert_eq!(only_folder(room.path()), out);
    for word in [
        "Figure 2",
        "Figure 3",
        "Figure 4",
        "Table 1",
        "TQ16",
        "power",
        "equation error",
    ] {
        assert!(done.stdout.contains(word), "{word}");
    }
    for word in ["NaN", "inf"] {
        assert!(!done.stdout.contains(word), "{word} in {}", done.stdout);
    }
    for name in [
        "figure-2",
        "figure-3",
        "figure-4",
        "sampling-ta",
        "sampling-tm",
        "noise",
        "figure-5",
        "figure-6",
        "figure-7-saturation",
        "figure-7-adaptation",
    ] {
        let svg = fs::read_to_string(out.join(format!("{name}.svg"))).unwrap();
        assert!(
            svg.starts_with("<?xml") && svg.trim_end().ends_with("</svg>"),
            "{name}"
        );
        assert!(
            !svg.contains("NaN") && svg.matches("class=\"series").count() > 1,
            "{name}"
        );
    }
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert_eq!(page.matches("<svg class=\"plot").count(), 10);
    let table = fs::read_to_string(out.join("table-1.csv")).unwrap();
    let first: Vec<&str> = table
        .lines()
        .map(|row| row.split(',').next().unwrap())
        .collect();
    assert_eq!(first, ["N", "8", "10", "20", "30", "40", "50"]);
    for name in ["figure-5", "figure-6", "figure-7-adaptation", "controllers"] {
        let table = fs::read_to_string(out.join(format!("{name}.csv"))).unwrap();
        assert!(table.lines().count() > 5, "{name}: {table}");
    }
    // The paper's own figures stand beside ours.
    assert!(
        table.contains("3654,0.4380") && table.contains("4536,0.4149"),
        "{table}"
    );

    let json = drivebench(line("reproduce paper-a --json", &[]))
        .expect(0)
        .json();
    assert_eq!(json["paper"], "paper-a");
    let rows = json["table_1"]["rows"].as_array().unwrap();
    let mean = |row: &Value| row["inertia_with_noise"]["mean"].as_f64().unwrap();
    for (row, text) in rows.iter().zip(table.lines().skip(1)) {
        let printed = format!("{:.0} ±", 1e6 * mean(row));
        assert!(text.contains(&printed), "{printed} in {text}");
    }
    let cases = json["figure_2"]["cases"].as_array().unwrap();
    let noises: Vec<&Value> = cases.iter().map(|case| &case["noise"]).collect();
    assert!(
        noises.iter().any(|n| **n == "sensor") && noises.iter().any(|n| **n == "equation_error")
    );
    for case in cases {
        let of = &case["signal_to_noise"]["of"];
        assert!(*of == "power" || *of == "amplitude", "{of}");
    }
}

/// The control of paper B: one run serves text and files, a second one is the same to the bit.
#[test]
fn paper_b_is_printed_plotted_and_filed_the_same_every_time() {
    let room = tempfile::tempdir().unwrap();
    let out = room.path().join("paper-b");
    let done = drivebench(line("reproduce paper-b --out {}", &[&out])).expect(0);
    for word in [
        "chosen by us",
        "Figure 4",
        "Figure 5",
        "K and gamma",
        "Hall",
        "back-EMF",
    ] {
        assert!(done.stdout.contains(word), "{word}");
    }
    for word in ["NaN", "inf"] {
        assert!(!done.stdout.contains(word), "{word} in {}", done.stdout);
    }
    for name in [
        "figure-4",
        "figure-5",
        "convergence",
        "hall",
        "back-emf",
        "back-emf-closed",
    ] {
        let svg = fs::read_to_string(out.join(format!("{name}.svg"))).unwrap();
        assert!(
            !svg.contains("NaN") && svg.matches("class=\"series").count() > 1,
            "{name}"
        );
    }
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert_eq!(page.matches("<svg class=\"plot").count(), 6);
    // Six regulators in five cases, and a head.
    let table = fs::read_to_string(out.join("controllers.csv")).unwrap();
    assert_eq!(table.lines().count(), 31, "{table}");
    for name in ["pi (fixed)", "addc", "mrac", "paper-b", "load-observer"] {
        assert!(table.contains(name), "{name}");
    }

    let json = drivebench(line("reproduce paper-b --json", &[]))
        .expect(0)
        .json();
    assert_eq!(json["paper"], "paper-b");
    let loads = fs::read_to_string(out.join("figure-5.csv")).unwrap();
    let dip = json["figure_5"]["courses"][1]["applied"]["dip_rad_s"]
        .as_f64()
        .unwrap();
    assert!(loads.contains(&format!("yes,applied,{dip:.2}")), "{loads}");
    drivebench(line("reproduce paper-b --seed 2 --json", &[])).expect(2);
}
