//! The table of codes in docs/method.md has every code of every finding, and no other.

use std::collections::BTreeMap;
use std::fs;

use drivebench::report::wording::CODES;

use super::architecture::root;

/// What stands between backquotes.
fn quoted(text: &str) -> impl Iterator<Item = String> {
    text.split('`').skip(1).step_by(2).map(str::to_owned)
}

#[test]
fn the_table_of_codes_has_every_code_and_no_other() {
    let page = fs::read_to_string(root().join("docs/method.md")).unwrap();
    let (_, section) = page.split_once("## 13. Codes of findings").unwrap();
    let section = section.split("\n## ").next().unwrap();
    let rows = section.lines().filter_map(|line| {
        let (of, codes) = line.strip_prefix("| ")?.strip_suffix(" |")?.split_once(" | ")?;
        let codes: Vec<String> = quoted(codes).collect();
        (!codes.is_empty()).then(|| (of.replace('`', ""), codes))
    });
    let table: BTreeMap<String, Vec<String>> = rows.collect();
    let codes = |codes: &[&str]| codes.iter().map(|code| (*code).to_owned()).collect();
    let known = CODES.iter().map(|(of, list)| ((*of).to_owned(), codes(list)));
    assert_eq!(table, known.collect::<BTreeMap<String, Vec<String>>>());
}
