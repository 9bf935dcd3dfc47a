//! The table of faults in docs/links.md: every number has its row, what a row cites as its proof is there, and every kind of
//! fault of the software drive stands in it, in a suite and in the example.

use std::collections::BTreeMap;
use std::fs;

use drivebench::emulator::FaultKind;

use super::architecture::{files, root};

/// Faults of the table, numbered from 1.
const FAULTS: usize = 70;

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).expect("a file of the repository is readable text")
}

/// What a row cites, and whether it says that it is run by hand.
type Proof = (String, bool);

/// The section of the page that has the table.
fn page() -> String {
    let page = read("docs/links.md");
    let table = page.split_once("\n## 7. ");
    let table = table.and_then(|(_, rest)| rest.split("\n## ").next());
    table.map(str::to_owned).expect("the seventh section of docs/links.md is the table of faults")
}

/// Number and proofs of each row.
fn rows(page: &str) -> Vec<(usize, Vec<Proof>)> {
    let cells = page.lines().filter_map(|line| {
        let cells: Vec<&str> = line.trim_matches('|').split(" | ").collect();
        let [number, _, _, _, proofs] = cells[..] else {
            return None;
        };
        let pieces: Vec<&str> = proofs.split('`').skip(1).collect();
        let proofs = pieces.chunks(2).map(|piece| {
            let by_hand = piece.get(1).is_some_and(|rest| rest.starts_with(" (by hand)"));
            (piece[0].to_owned(), by_hand)
        });
        Some((number.trim().parse().ok()?, proofs.collect()))
    });
    cells.collect()
}

/// Names of all tests, and whether each is ignored unless it is asked for.
fn tests() -> BTreeMap<String, bool> {
    let all = ["src", "crates", "tests"].into_iter().flat_map(files);
    let rust = all.filter(|path| path.extension().is_some_and(|ending| ending == "rs"));
    let mut names = BTreeMap::new();
    for path in rust {
        let text = read(&path.display().to_string());
        let (mut is_test, mut is_ignored) = (false, false);
        for line in text.lines().map(str::trim) {
            let name = line.strip_prefix("fn ").and_then(|rest| rest.split_once('('));
            if let (true, Some((name, _))) = (is_test, name) {
                // Of two that have one name one that is run is enough.
                let ignored: &mut bool = names.entry(name.to_owned()).or_insert(true);
                *ignored &= is_ignored;
            }
            let goes_on = line.starts_with("#[");
            is_test = line == "#[test]" || (is_test && goes_on);
            is_ignored = goes_on && (is_ignored || line.starts_with("#[ignore"));
        }
    }
    names
}

#[test]
fn every_fault_has_a_proof_that_is_there() {
    let rows = rows(&page());
    let numbers: Vec<usize> = rows.iter().map(|(number, _)| *number).collect();
    assert_eq!(numbers, (1..=FAULTS).collect::<Vec<_>>());
    let tests = tests();
    for (number, proofs) in rows {
        let is_run = proofs.iter().any(|(_, by_hand)| !by_hand);
        assert!(is_run, "fault {number} has no proof that is run each time");
        for (proof, by_hand) in proofs {
            if let Some(suite) = proof.strip_suffix(".toml") {
                let suite = read(&format!("bench-configs/suites/{suite}.toml"));
                let tag = format!("\"fault-{number:02}\"");
                assert!(suite.contains(&tag), "{proof} has no case with {tag}");
            } else {
                let ignored = tests.get(&proof);
                assert!(ignored.is_some(), "fault {number}: no test {proof}");
                assert!(
                    ignored == Some(&by_hand),
                    "fault {number}: {proof} is ignored and not marked \"by hand\", or the other way round"
                );
            }
        }
    }
}

/// Number, injector and kinds of each row, as "bytes" and its kinds.
fn injected(page: &str) -> Vec<(usize, String, Vec<String>)> {
    let cells = page.lines().filter_map(|line| {
        let cells: Vec<&str> = line.trim_matches('|').split(" | ").collect();
        let [number, _, injected, ..] = cells[..] else {
            return None;
        };
        let (injector, kinds) = injected.split_once(' ').unwrap_or((injected, ""));
        let kinds = kinds.split('`').skip(1).step_by(2).map(str::to_owned);
        let number = number.trim().parse().ok()?;
        Some((number, injector.to_owned(), kinds.collect()))
    });
    cells.collect()
}

/// Cases of the suite with the tag of a fault.
fn cases(suite: &str, number: usize) -> Vec<&str> {
    let tag = format!("\"fault-{number:02}\"");
    let cases = suite.split("[[case]]");
    cases.filter(|case| case.contains(&tag)).collect()
}

#[test]
fn every_kind_of_fault_has_its_row_case_and_example() {
    let rows = injected(&page());
    let suite = read("bench-configs/suites/faults-line.toml");
    let example = read("bench-configs/emulators/example.toml");
    for (number, injector, kinds) in &rows {
        let is_known = ["bytes", "drive", "host", "file"].contains(&injector.as_str());
        assert!(is_known, "fault {number}: injector {injector}");
        for kind in kinds {
            let mut table = FaultKind::TABLE.iter();
            let row = table.find(|(_, name, ..)| name == kind);
            let (.., own, _) = row.unwrap_or_else(|| panic!("fault {number}: no kind {kind}"));
            assert_eq!(format!("{own:?}").to_lowercase(), *injector, "{number}: {kind}");
        }
    }
    for (_, name, _, what) in FaultKind::TABLE {
        let key = format!("kind = \"{name}\"");
        let of_kind = rows.iter().filter(|(.., kinds)| kinds.iter().any(|kind| kind == name));
        let numbers: Vec<usize> = of_kind.map(|(number, ..)| *number).collect();
        assert!(!numbers.is_empty(), "docs/links.md has no row with {name}");
        for number in numbers {
            let mut cases = cases(&suite, number).into_iter();
            let mut is_tried = cases.any(|case| case.contains(&key));
            // A reply is held back alone among all other faults.
            is_tried |= *name == "held_reply" && suite.contains(&key);
            assert!(is_tried, "fault {number}: no case with {key}");
        }
        let mut lines = example.lines();
        let line = lines.find(|line| line.contains(&key));
        let is_told = line.is_some_and(|line| line.contains(what));
        assert!(is_told, "example.toml: {key} is not told as {what:?}");
    }
}
