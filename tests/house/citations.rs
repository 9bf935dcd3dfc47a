//! Pages that a file cites are in the repository.

use std::fs;
use std::path::Path;

use super::architecture::{files, root};

/// Names of pages that the program writes.
const WRITTEN: &[&str] = &["tables.md", "validation.md", "lines.md"];

/// Every name of a Markdown page in a text.
fn cited(text: &str) -> impl Iterator<Item = &str> {
    let words = text.split(|c: char| !(c.is_ascii_alphanumeric() || "_./-".contains(c)));
    words.filter(|word| word.strip_suffix(".md").is_some_and(|name| !name.is_empty()))
}

/// Whether a page stands where a reader would look for it: beside the file, in `docs/`, or from the root of the tree or the crate.
fn is_there(path: &Path, page: &str) -> bool {
    let beside = root().join(path.parent().unwrap_or(path));
    let from = [beside, root().join("docs"), root().join("firmware-protocol"), root().to_owned()];
    from.iter().any(|folder| folder.join(page).is_file())
}

#[test]
fn no_file_cites_a_page_that_is_not_there() {
    let mut missing = Vec::new();
    let folders = [
        "src",
        "crates",
        "tests",
        "benches",
        "docs",
        "firmware-protocol",
        "bench-configs",
        ".ci",
        ".github",
    ];
    let mut all: Vec<_> = folders.iter().flat_map(|folder| files(folder)).collect();
    all.extend(
        ["README.md", "CHANGELOG.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "SECURITY.md"]
            .map(Into::into),
    );
    for path in all {
        // Pictures and captures are no text.
        let Ok(text) = fs::read_to_string(root().join(&path)) else {
            continue;
        };
        for page in cited(&text) {
            if !WRITTEN.contains(&page) && !is_there(&path, page) {
                missing.push(format!("{}: {page}", path.display()));
            }
        }
    }
    assert!(missing.is_empty(), "cited and not there:\n{}", missing.join("\n"));
}

/// Targets of the links and pictures of a page, outside its code.
fn links(page: &str) -> Vec<&str> {
    let prose = page.split("```").step_by(2);
    let ends = prose.flat_map(|text| text.split("](").skip(1));
    let targets = ends.filter_map(|rest| Some(rest.split_once(')')?.0));
    targets.filter(|to| !to.contains("://")).collect()
}

/// The anchor of a heading, as GitHub makes it.
fn anchor(heading: &str) -> String {
    let heading = heading.trim_start_matches('#').trim().to_lowercase();
    let kept = heading.chars().filter(|c| c.is_alphanumeric() || "-_ ".contains(*c));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// Whether a link of a page leads to a file, and to a heading of it where it names one.
fn leads_somewhere(page: &Path, to: &str) -> bool {
    let (file, place) = to.split_once('#').unwrap_or((to, ""));
    let target = match file {
        "" => root().join(page),
        _ => root().join(page.parent().unwrap_or(page)).join(file),
    };
    if place.is_empty() {
        return target.exists();
    }
    let text = fs::read_to_string(target).unwrap_or_default();
    let mut headings = text.lines().filter(|line| line.starts_with('#'));
    headings.any(|heading| anchor(heading) == place)
}

#[test]
fn every_link_of_a_page_leads_somewhere() {
    let below = ["docs", "firmware-protocol", "examples", ".github"].map(files);
    let own = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "SECURITY.md"];
    let pages = below.into_iter().flatten().chain(own.map(Into::into));
    let mut broken = Vec::new();
    for page in pages.filter(|page| page.extension().is_some_and(|ending| ending == "md")) {
        let text = fs::read_to_string(root().join(&page)).unwrap_or_default();
        let lost = links(&text).into_iter().filter(|to| !leads_somewhere(&page, to));
        broken.extend(lost.map(|to| format!("{}: {to}", page.display())));
    }
    assert!(broken.is_empty(), "broken links:\n{}", broken.join("\n"));
    let page = Path::new("docs/tutorial.md");
    assert_eq!(links("[a](method.md#c) ```[d](e)``` [f](http://g)"), ["method.md#c"]);
    assert!(leads_somewhere(page, "method.md#9-limits") && leads_somewhere(page, "../README.md"));
    assert!(!leads_somewhere(page, "method.md#90-limits") && !leads_somewhere(page, "README.md"));
}

#[test]
fn the_check_of_citations_can_fail() {
    let here = Path::new("crates/drivebench-model/src/plant/mod.rs");
    assert!(is_there(here, "docs/physics.md") && is_there(here, "physics.md"));
    assert!(!is_there(here, &["nowhere", "md"].join(".")));
    let text = "see (docs/method.md), `README.md`; .md is none";
    assert_eq!(cited(text).collect::<Vec<_>>(), ["docs/method.md", "README.md"]);
}
