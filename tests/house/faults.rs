//! The table of faults in docs/links.md: every number has its row, and what a row cites as its proof is there.

use std::collections::BTreeSet;
use std::fs;

use super::architecture::{files, root};

/// Faults of the table, numbered from 1.
const FAULTS: usize = 70;

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).expect("a file of the repository is readable text")
}

/// Number and proofs of each row.
fn rows(page: &str) -> Vec<(usize, Vec<String>)> {
    let cells = page.lines().filter_map(|line| {
        let cells: Vec<&str> = line.trim_matches('|').split(" | ").collect();
        let [number, _, _, proofs] = cells[..] else {
            return None;
        };
        let proofs = proofs.split('`').skip(1).step_by(2).map(str::to_owned);
        Some((number.trim().parse().ok()?, proofs.collect()))
    });
    cells.collect()
}

/// Names of all tests.
fn tests() -> BTreeSet<String> {
    let all = ["src", "tests"].into_iter().flat_map(files);
    let rust = all.filter(|path| path.extension().is_some_and(|ending| ending == "rs"));
    let mut names = BTreeSet::new();
    for path in rust {
        let text = read(&path.display().to_string());
        let mut is_test = false;
        for line in text.lines().map(str::trim) {
            let name = line
                .strip_prefix("fn ")
                .and_then(|rest| rest.split_once('('));
            if let (true, Some((name, _))) = (is_test, name) {
                names.insert(name.to_owned());
            }
            is_test = line == "#[test]" || (is_test && line.starts_with("#["));
        }
    }
    names
}

#[test]
fn every_fault_has_a_proof_that_is_there() {
    let rows = rows(&read("docs/links.md"));
    let numbers: Vec<usize> = rows.iter().map(|(number, _)| *number).collect();
    assert_eq!(numbers, (1..=FAULTS).collect::<Vec<_>>());
    let tests = tests();
    for (number, proofs) in rows {
        assert!(!proofs.is_empty(), "fault {number} has no proof");
        for proof in proofs {
            if proof.ends_with(".toml") {
                let suite = read(&format!("bench-configs/suites/{proof}"));
                let tag = format!("\"fault-{number:02}\"");
                assert!(suite.contains(&tag), "{proof} has no case with {tag}");
            } else {
                assert!(tests.contains(&proof), "fault {number}: no test {proof}");
            }
        }
    }
}
