//! Lines of Rust that each crate and room may hold, tests and comments included: at most 2 % above what stood there when its
//! line was written. Who needs more deletes elsewhere, or raises a budget in a commit of its own that says why.

use crate::architecture::{root, rust_files};
use std::fs;

/// Folder and its budget of lines.
const BUDGETS: &[(&str, usize)] = &[
    ("crates/drivebench-bench", 28_650),
    ("crates/drivebench-control", 6_180),
    ("crates/drivebench-diagnose", 23_030),
    ("crates/drivebench-emulator", 12_180),
    ("crates/drivebench-identify", 23_960),
    ("crates/drivebench-link", 18_150),
    ("crates/drivebench-model", 17_300),
    ("crates/drivebench-studies", 9_760),
    ("firmware-protocol", 4_740),
    ("src/commands", 14_190),
    ("src/report", 9_020),
    ("src/runtime", 3_010),
    ("src/tui", 7_790),
    ("src/workflow", 4_890),
    ("tests/bench", 2_240),
    ("tests/cli", 4_840),
    ("tests/foreign", 1_500),
    ("tests/house", 1_070),
    ("tests/kit", 1_150),
    ("tests/live", 3_150),
    ("tests/witness", 1_430),
];

/// Every folder that holds Rust must have a budget: a new crate or room is a decision too.
const FOLDERS_OF_ROOMS: &[&str] = &["crates", "src", "tests"];

/// Named numeric constants of the whole repository, no more than stood there: a threshold more replaces a model.
const MOST_NUMERIC_CONSTANTS: usize = 704;

const NUMERIC: &[&str] =
    &["f64", "f32", "usize", "u64", "u32", "u16", "u8", "i64", "i32", "Duration"];

/// Rooms with more lines than their budget.
fn overruns(budgets: &[(&str, usize)], lines_of: impl Fn(&str) -> usize) -> Vec<String> {
    let counted = budgets.iter().map(|(folder, budget)| (folder, *budget, lines_of(folder)));
    counted
        .filter(|(_, budget, lines)| lines > budget)
        .map(|(folder, budget, lines)| format!("{folder}: {lines} lines, its budget is {budget}"))
        .collect()
}

fn lines_of(folder: &str) -> usize {
    rust_files(&[folder]).iter().map(|(_, text)| text.lines().count()).sum()
}

fn is_numeric_constant(line: &str) -> bool {
    let Some((_, constant)) = line.split_once("const ") else { return false };
    let Some((name, rest)) = constant.split_once(": ") else { return false };
    let is_name = name.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_');
    let kind = rest.split([' ', ';', '=']).next().unwrap_or("");
    is_name && NUMERIC.contains(&kind)
}

#[test]
fn every_room_keeps_its_budget_of_lines() {
    let overruns = overruns(BUDGETS, lines_of);
    assert!(overruns.is_empty(), "{overruns:#?}");
}

#[test]
fn the_check_of_the_budgets_can_fail() {
    assert_eq!(overruns(&[("a", 10), ("b", 9)], |_| 10), ["b: 10 lines, its budget is 9"]);
    assert!(is_numeric_constant("    pub(super) const MOST_ROWS: usize = 3;"));
    assert!(
        !is_numeric_constant("const fn rows() -> usize {")
            && !is_numeric_constant("const ALL: &[f64] = &[];")
    );
}

#[test]
fn every_room_has_a_budget() {
    for folder in FOLDERS_OF_ROOMS {
        for entry in
            fs::read_dir(root().join(folder)).expect("a folder of the repository can be listed")
        {
            let entry = entry.expect("an entry of a folder can be read");
            let room = format!("{folder}/{}", entry.file_name().to_string_lossy());
            let is_room = entry.path().is_dir() && !room.ends_with("snapshots");
            assert!(
                !is_room || BUDGETS.iter().any(|(folder, _)| *folder == room),
                "{room} has no budget"
            );
        }
    }
}

#[test]
fn numeric_constants_keep_their_budget() {
    let all = rust_files(&["src", "crates", "firmware-protocol", "tests", "benches", "examples"]);
    let count: usize = all
        .iter()
        .map(|(_, text)| text.lines().filter(|line| is_numeric_constant(line)).count())
        .sum();
    assert!(
        count <= MOST_NUMERIC_CONSTANTS,
        "{count} named numeric constants, {MOST_NUMERIC_CONSTANTS} are allowed"
    );
}
