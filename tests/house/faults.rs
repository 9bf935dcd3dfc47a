//! The table of faults in docs/links.md: every number has its row, and what a row cites as its proof is there.

use std::collections::BTreeMap;
use std::fs;

use super::architecture::{files, root};

/// Faults of the table, numbered from 1.
const FAULTS: usize = 70;

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).expect("a file of the repository is readable text")
}

/// What a row cites, and whether it says that it is run by hand.
type Proof = (String, bool);

/// Number and proofs of each row.
fn rows(page: &str) -> Vec<(usize, Vec<Proof>)> {
    let cells = page.lines().filter_map(|line| {
        let cells: Vec<&str> = line.trim_matches('|').split(" | ").collect();
        let [number, _, _, proofs] = cells[..] else {
            return None;
        };
        let pieces: Vec<&str> = proofs.split('`').skip(1).collect();
        let proofs = pieces.chunks(2).map(|piece| {
            let by_hand = piece
                .get(1)
                .is_some_and(|rest| rest.starts_with(" (by hand)"));
            (piece[0].to_owned(), by_hand)
        });
        Some((number.trim().parse().ok()?, proofs.collect()))
    });
    cells.collect()
}

/// Names of all tests, and whether each is ignored unless it is asked for.
fn tests() -> BTreeMap<String, bool> {
    let all = ["src", "tests"].into_iter().flat_map(files);
    let rust = all.filter(|path| path.extension().is_some_and(|ending| ending == "rs"));
    let mut names = BTreeMap::new();
    for path in rust {
        let text = read(&path.display().to_string());
        let (mut is_test, mut is_ignored) = (false, false);
        for line in text.lines().map(str::trim) {
            let name = line
                .strip_prefix("fn ")
                .and_then(|rest| rest.split_once('('));
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
    let rows = rows(&read("docs/links.md"));
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
