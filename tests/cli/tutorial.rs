//! The tutorial: its commands run, in their order, and what it shows of their output is there.

use std::os::unix::fs::symlink;
use std::process::Command;

use super::kit::prelude::*;

/// Blocks of commands of a page, each with the output that is shown beneath it.
fn blocks(page: &str) -> Vec<(&str, Vec<&str>)> {
    let mut blocks: Vec<(&str, Vec<&str>)> = Vec::new();
    let fences: Vec<&str> = page.split("```").collect();
    // Every second piece is what a pair of fences holds: the language, then the text.
    for fence in fences.iter().skip(1).step_by(2) {
        let (language, text) = fence.split_once('\n').unwrap();
        match language {
            "sh" => blocks.push((text, Vec::new())),
            "text" => blocks.last_mut().unwrap().1.extend(text.lines()),
            _ => {}
        }
    }
    blocks
}

/// Whether the parts of a pattern between its ellipses stand in the line, in their order.
fn fits(line: &str, pattern: &str) -> bool {
    let mut rest = line;
    let mut is_free = false;
    for part in pattern.split('…') {
        match rest.find(part) {
            Some(at) if is_free || at == 0 => rest = &rest[at + part.len()..],
            _ => return false,
        }
        is_free = true;
    }
    pattern.ends_with('…') || rest.is_empty()
}

#[test]
fn every_command_of_the_tutorial_runs_and_prints_what_is_shown() {
    let desk = Desk::new();
    let repository = Path::new(env!("CARGO_MANIFEST_DIR"));
    symlink(repository.join("bench-configs"), desk.path("bench-configs")).unwrap();
    let folder = Path::new(BINARY).parent().unwrap().display();
    let path = format!("{folder}:{}", std::env::var("PATH").unwrap());
    let page = fs::read_to_string(repository.join("docs/tutorial.md")).unwrap();
    let blocks = blocks(&page);
    assert!(blocks.len() > 8, "{}", blocks.len());
    for (commands, shown) in blocks {
        let mut shell = Command::new("sh");
        shell.args(["-ec", commands]).env("PATH", &path);
        let done = super::kit::Done::of(&shell.current_dir(desk.folder()).output().unwrap());
        let output = format!("{}\n{}", done.stdout, done.stderr);
        assert_eq!(done.status, 0, "{commands}\n{output}");
        for pattern in shown.into_iter().filter(|pattern| !pattern.is_empty()) {
            let is_there = output.lines().any(|line| fits(line, pattern));
            assert!(is_there, "{pattern:?} is not in the output of\n{commands}\n{output}");
        }
    }
    for page in ["found.html", "better.toml", "figures/figure-2.svg", "simulated.csv"] {
        assert!(desk.path(page).exists(), "{page}");
    }
}

#[test]
fn a_pattern_fits_only_its_own_text() {
    assert!(fits("picture  a/b.svg", "picture…b.svg"));
    assert!(fits("picture", "picture") && fits("x picture y", "…picture…"));
    assert!(!fits("a picture", "picture…") && !fits("picture of", "picture"));
    assert!(!fits("picture a", "…a…picture…"));
}
