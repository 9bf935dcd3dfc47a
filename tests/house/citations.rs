//! Pages that a file cites are in the repository.

use std::fs;
use std::path::Path;

use super::architecture::{files, root};

/// Names of pages that the program writes.
const WRITTEN: &[&str] = &["validation.md", "lines.md"];

/// Every name of a Markdown page in a text.
fn cited(text: &str) -> impl Iterator<Item = &str> {
    let words = text.split(|c: char| !(c.is_ascii_alphanumeric() || "_./-".contains(c)));
    words.filter(|word| {
        word.strip_suffix(".md")
            .is_some_and(|name| !name.is_empty())
    })
}

/// Whether a page stands where a reader would look for it: beside the file, in `docs/`, or from the root of the tree or the crate.
fn is_there(path: &Path, page: &str) -> bool {
    let beside = root().join(path.parent().unwrap_or(path));
    let from = [
        beside,
        root().join("docs"),
        root().join("firmware-protocol"),
        root().to_owned(),
    ];
    from.iter().any(|folder| folder.join(page).is_file())
}

#[test]
fn no_file_cites_a_page_that_is_not_there() {
    let mut missing = Vec::new();
    let folders = [
        "src",
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
        [
            "README.md",
            "CHANGELOG.md",
            "ARCHITECTURE.md",
            "CONTRIBUTING.md",
            "SECURITY.md",
        ]
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
    assert!(
        missing.is_empty(),
        "cited and not there:\n{}",
        missing.join("\n")
    );
}

#[test]
fn the_check_of_citations_can_fail() {
    let here = Path::new("src/core/plant/mod.rs");
    assert!(is_there(here, "docs/physics.md") && is_there(here, "physics.md"));
    assert!(!is_there(here, &["nowhere", "md"].join(".")));
    let text = "see (docs/method.md), `README.md`; .md is none";
    assert_eq!(
        cited(text).collect::<Vec<_>>(),
        ["docs/method.md", "README.md"]
    );
}
