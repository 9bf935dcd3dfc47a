//! `reproduce` through the real binary: text, JSON, files, and what it refuses.

use crate::kit::prelude::*;
use std::io::{BufRead, BufReader, Read};

#[test]
fn an_unknown_paper_is_told_what_is_allowed() {
    let error = refusal("reproduce paper-z --json", &[]);
    has(&error, &["paper-z", "paper-a"]);
}

#[test]
fn a_folder_with_results_is_not_overwritten() {
    let out = Desk::new();
    fs::write(out.path("mine.txt"), "mine").unwrap();
    let done = call("reproduce paper-a --out {}", &[out.folder()]).fails(2, &["never overwritten"]);
    assert!(done.stdout.is_empty());
    assert_eq!(fs::read_dir(out.folder()).unwrap().count(), 1);
}

#[test]
fn the_size_of_the_study_is_refused_where_it_means_nothing() {
    call("reproduce paper-a --sets 2 --json", &[]).fails(2, &["--sets"]);
    call("reproduce discovery --sets 0 --mysteries 0 --json", &[]).expect(2);
}

#[test]
fn an_interrupted_study_ends_with_130_and_leaves_nothing_behind() {
    let room = Desk::new();
    let out = room.path("study");
    let mut study = Process::start(&line("reproduce discovery --out {}", &[&out]));
    let mut stderr = BufReader::new(study.0.stderr.take().unwrap());
    let mut first = String::new();
    stderr.read_line(&mut first).unwrap();
    assert!(first.contains("machines"), "{first}");
    study.signal(Signal::SIGINT);
    let mut rest = String::new();
    stderr.read_to_string(&mut rest).unwrap();
    let done = study.end();
    assert_eq!(done.status, 130, "{rest}");
    assert!(done.stdout.is_empty() && !out.exists());
    assert!(rest.contains("error: interrupted"), "{rest}");
}

#[test]
fn a_study_of_mysteries_alone_counts_their_answers_and_intervals() {
    let room = Desk::new();
    let out = room.path("study");
    let study = "reproduce discovery --sets 0 --mysteries 2 --seed 3 --out {}";
    let done = call(study, &[&out]).expect(0);
    has(&done.stderr, &["mystery 4: hidden "]);
    let page = fs::read_to_string(out.join("validation.md")).unwrap();
    has(
        &page,
        &[
            "--sets 0 --mysteries 2 --seed 3",
            "Of 2 mystery drives",
            "| resistance_ohm ",
        ],
    );
    lacks(&page, &["One hidden effect"]);
    // A study is a result, and results are never overwritten.
    call(study, &[&out]).fails(2, &["never overwritten"]);
}

/// One run serves the text and the files; a second one, as JSON, is the same to the bit.
#[test]
fn paper_a_is_printed_plotted_and_filed_the_same_every_time() {
    let room = Desk::new();
    let out = room.path("paper-a");
    let done = call("reproduce paper-a --out {}", &[&out]).expect(0);
    assert_eq!(only_folder(room.folder()), out);
    has(
        &done.stdout,
        &[
            "Figure 2",
            "Figure 3",
            "Figure 4",
            "Table 1",
            "TQ16",
            "power",
            "equation error",
        ],
    );
    for word in ["NaN", "inf"] {
        assert!(!done.stdout.contains(word), "{word} in {}", done.stdout);
    }
    for name in "figure-2 figure-3 figure-4 sampling-ta sampling-tm noise figure-5 figure-6 figure-7-saturation figure-7-adaptation".split(' ') {
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
    has(&table, &["3654,0.4380", "4536,0.4149"]);

    let json = json_of("reproduce paper-a --json", &[]);
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
    let room = Desk::new();
    let out = room.path("paper-b");
    let done = call("reproduce paper-b --out {}", &[&out]).expect(0);
    has(
        &done.stdout,
        &[
            "chosen by us",
            "Figure 4",
            "Figure 5",
            "K and gamma",
            "Hall",
            "back-EMF",
        ],
    );
    for word in ["NaN", "inf"] {
        assert!(!done.stdout.contains(word), "{word} in {}", done.stdout);
    }
    for name in "figure-4 figure-5 convergence hall back-emf back-emf-closed".split(' ') {
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
    has(
        &table,
        &["pi (fixed)", "addc", "mrac", "paper-b", "load-observer"],
    );

    let json = json_of("reproduce paper-b --json", &[]);
    assert_eq!(json["paper"], "paper-b");
    let loads = fs::read_to_string(out.join("figure-5.csv")).unwrap();
    let dip = json["figure_5"]["courses"][1]["applied"]["dip_rad_s"]
        .as_f64()
        .unwrap();
    assert!(
        loads.contains(&format!("0.05 K3,applied,{dip:.2}")),
        "{loads}"
    );
    call("reproduce paper-b --seed 2 --json", &[]).expect(2);
}
