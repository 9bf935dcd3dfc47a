//! The studies through the real binary: text, JSON, files, and what is refused.
#![expect(clippy::unwrap_used, reason = "a test fails where it unwraps nothing")]

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;

fn command(text: &str, out: Option<&Path>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_drivebench-studies"));
    command.args(text.split(' ')).stdin(Stdio::null());
    if let Some(out) = out {
        command.arg("--out").arg(out);
    }
    command
}

/// Exit status, stdout and stderr, the latter without its line breaks.
fn call(text: &str, out: Option<&Path>) -> (i32, String, String) {
    let done = command(text, out).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let stderr = text(&done.stderr).replace("\n  ", " ");
    (done.status.code().unwrap(), text(&done.stdout), stderr)
}

#[track_caller]
fn has(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
}

#[test]
fn what_is_not_understood_is_refused_with_what_is_allowed() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("mine.txt"), "mine").unwrap();
    let (own, proc) = (folder.path(), Path::new("/proc/studies"));
    for (text, out, parts) in [
        ("paper-z --json", None, &["paper-z", "help: "][..]),
        ("paper-a --sets 2 --json", None, &["--sets"]),
        ("paper-b --seed 2 --json", None, &["--seed"]),
        ("lines --mysteries 2 --json", None, &["--mysteries"]),
        ("discovery --sets 101 --json", None, &["101", "100"]),
        ("discovery --sets 0 --mysteries 0 --json", None, &["leaves nothing to study"]),
        ("discovery --records . --json", None, &["none of the records", "emps/DATA_EMPS.csv"]),
        ("paper-a", Some(own), &["never overwritten"]),
        ("lines", Some(proc), &["cannot write", "--out"]),
    ] {
        let (status, stdout, stderr) = call(text, out);
        assert_eq!((status, &*stdout), (2, ""), "{text}: {stderr}");
        has(&stderr, parts);
    }
    assert_eq!(fs::read_dir(own).unwrap().count(), 1);
}

#[test]
fn an_interrupted_study_ends_with_130_and_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("study");
    let mut command = command("discovery", Some(&out));
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut study = command.spawn().unwrap();
    let mut stderr = BufReader::new(study.stderr.take().unwrap());
    let mut first = String::new();
    stderr.read_line(&mut first).unwrap();
    has(&first, &["machines"]);
    let id = Pid::from_raw(i32::try_from(study.id()).unwrap());
    kill(id, Signal::SIGINT).unwrap();
    let mut rest = String::new();
    stderr.read_to_string(&mut rest).unwrap();
    let done = study.wait_with_output().unwrap();
    assert_eq!(done.status.code(), Some(130), "{rest}");
    assert!(done.stdout.is_empty() && !out.exists());
    has(&rest, &["error: interrupted"]);
}

#[test]
fn a_study_of_mysteries_counts_answers_and_intervals() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("study");
    let study = "discovery --sets 0 --mysteries 1 --seed 3";
    let (status, _, stderr) = call(study, Some(&out));
    assert_eq!(status, 0, "{stderr}");
    has(&stderr, &["mystery 3: hidden "]);
    let page = fs::read_to_string(out.join("tables.md")).unwrap();
    let parts = [study, "Of 1 mystery drives", "| resistance_ohm "];
    has(&page, &parts);
    assert!(!page.contains("One hidden effect") && !page.contains("(failed)"));
}

/// One run gives the JSON and the files; a second one, as text, is the same to the bit.
#[test]
fn the_papers_are_printed_plotted_and_filed_the_same_every_time() {
    for (paper, pictures, parts) in [
        (
            "paper-a",
            "figure-2 figure-3 figure-4 sampling-ta sampling-tm noise figure-5 figure-6 figure-7-saturation figure-7-adaptation",
            &["Figure 2", "Table 1", "TQ16", "power", "equation error"][..],
        ),
        (
            "paper-b",
            "figure-4 figure-5 convergence hall back-emf back-emf-closed",
            &["chosen by us", "Figure 5", "K and gamma", "Hall", "back-EMF"],
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join(paper);
        let read = |name: &str| fs::read_to_string(out.join(name)).unwrap();
        let (status, json, stderr) = call(&format!("{paper} --json"), Some(&out));
        assert_eq!(status, 0, "{stderr}");
        let json: Value = serde_json::from_str(&json).unwrap();
        assert_eq!(json["paper"], Value::from(paper));
        let text = read(&format!("{paper}.md"));
        has(&text, parts);
        assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
        for name in pictures.split(' ') {
            let svg = read(&format!("{name}.svg"));
            assert!(svg.starts_with("<?xml") && svg.trim_end().ends_with("</svg>"), "{name}");
            assert!(!svg.contains("NaN") && svg.matches("class=\"series").count() > 1, "{name}");
        }
        let drawn = read("report.html").matches("<svg class=\"plot").count();
        assert_eq!(drawn, pictures.split(' ').count());
        // Six regulators in five cases, and a head.
        let table = read("controllers.csv");
        assert_eq!(table.lines().count(), 31, "{table}");
        if paper == "paper-a" {
            // The paper's own figures stand beside ours.
            let table = read("table-1.csv");
            has(&table, &["3654,0.4380", "4536,0.4149"]);
            let mean = &json["table_1"]["rows"][5]["inertia_with_noise"]["mean"];
            has(&table, &[&format!("{:.0} ±", 1e6 * mean.as_f64().unwrap())]);
        } else {
            let dip = json["figure_5"]["courses"][1]["applied"]["dip_rad_s"].as_f64().unwrap();
            has(&read("figure-5.csv"), &[&format!("0.05 K3,applied,{dip:.2}")]);
            let again = folder.path().join("again");
            let (status, printed, _) = call(paper, Some(&again));
            assert_eq!(status, 0);
            has(&printed, parts);
            for file in fs::read_dir(&again).unwrap() {
                let name = file.unwrap().file_name().into_string().unwrap();
                assert!(fs::read_to_string(again.join(&name)).unwrap() == read(&name), "{name}");
            }
        }
    }
}
