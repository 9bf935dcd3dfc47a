//! The plan of the house, held by a test: floors, file sizes, pictures, clocks, and data files that parse.
//!
//! ```text
//! manifests, **.rs -> code without comments -> crate paths -> rooms -> which floor? -> violations (must be none)
//! ```

use std::fs;
use std::path::{Path, PathBuf};

/// Each library, and the libraries of the house that it may use; Cargo allows no circle. The program uses all of them.
const CRATES: &[(&str, &str)] = &[
    ("drivebench-model", ""),
    ("drivebench-identify", "model"),
    ("drivebench-diagnose", "model identify"),
    ("drivebench-control", "model identify"),
    ("drivebench-link", "model firmware-protocol"),
    ("drivebench-emulator", "model link firmware-protocol"),
    ("drivebench-bench", "model identify control link emulator"),
    // It uses the library of the program.
    ("drivebench-studies", ""),
];

/// Rooms of one crate, lowest first; rooms on one floor don't see each other.
const FLOORS: &[(&str, &str)] = &[
    (
        "crates/drivebench-model/src/",
        "units config_text < text < sample < signal < numerics < plant excitation",
    ),
    ("src/", "report < workflow < tui < runtime < commands < main"),
];

/// Libraries that a room must not use all the same, outside its tests: screens know no drive.
const CLOSED: &[(&str, &[&str])] = &[("src/tui/", &["drivebench_link", "drivebench_emulator"])];

/// Folders with code of the house.
const CODE: &[&str] = &["src", "crates", "firmware-protocol"];

/// The only files that may read a clock.
const CLOCK_FILES: &[&str] = &[
    "crates/drivebench-bench/src/clock.rs",
    "crates/drivebench-emulator/src/server.rs",
    "crates/drivebench-link/src/waiting.rs",
    "src/commands/test/process.rs",
    "src/runtime/opening.rs",
    "src/runtime/progress.rs",
    "src/tui/application.rs",
];

const MOST_LINES: usize = 900;

pub(super) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Every file below a folder, in order, as path from the root of the repository.
pub(super) fn files(folder: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![root().join(folder)];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(&folder).expect("a folder of the repository can be listed") {
            let path = entry.expect("an entry of a folder can be read").path();
            if path.is_dir() {
                open.push(path);
            } else {
                let inside = path.strip_prefix(root()).expect("it lies below the root");
                found.push(inside.to_owned());
            }
        }
    }
    found.sort();
    found
}

pub(super) fn rust_files(folders: &[&str]) -> Vec<(String, String)> {
    let all = folders.iter().flat_map(|folder| files(folder));
    let rust = all.filter(|path| path.extension().is_some_and(|ending| ending == "rs"));
    let read: Vec<(String, String)> =
        rust.map(|path| (path.display().to_string(), read(&path))).collect();
    assert!(!read.is_empty(), "no Rust file in {folders:?}");
    read
}

fn read(path: &Path) -> String {
    fs::read_to_string(root().join(path)).expect("a source file is readable text")
}

/// The crate's folder, its plan, and the room of a file: `src/report/page.rs` is in the room `report`. None in a crate of one room.
fn room_of(path: &str) -> Option<(&'static str, &str)> {
    let (folder, plan) = FLOORS.iter().find(|(folder, _)| path.starts_with(folder))?;
    let first = path[folder.len()..].split('/').next()?;
    Some((plan, first.strip_suffix(".rs").unwrap_or(first)))
}

fn floor_of(plan: &str, room: &str) -> Option<usize> {
    let mut floors = plan.split('<');
    floors.position(|floor| floor.split_whitespace().any(|there| there == room))
}

pub(super) fn is_test_file(path: &str) -> bool {
    path.contains("/tests/") || path.ends_with("tests.rs")
}

/// The text without comments and without what stands in double quotes; line breaks stay.
fn code(text: &str) -> String {
    let mut code = String::with_capacity(text.len());
    let mut rest = text.chars().peekable();
    while let Some(here) = rest.next() {
        match (here, rest.peek()) {
            ('/', Some('/')) => while rest.next_if(|c| *c != '\n').is_some() {},
            // A quote as character, which opens no text.
            ('\'', Some('"')) => {
                rest.next();
            }
            ('\'', Some('\\')) => {
                rest.next();
                rest.next();
            }
            ('"', _) => {
                code.push_str("\"\"");
                while let Some(inside) = rest.next() {
                    match inside {
                        '\\' => {
                            rest.next();
                        }
                        '\n' => code.push('\n'),
                        '"' => break,
                        _ => {}
                    }
                }
            }
            _ => code.push(here),
        }
    }
    code
}

fn identifier(text: &str) -> &str {
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_');
    &text[..end.unwrap_or(text.len())]
}

/// Rooms that a path of the crate's root leads to: `crate::sample::Run`, `crate::{text::Table, plant}`,
/// `super::super::plant`. With their lines.
fn rooms_used(plan: &str, text: &str) -> Vec<(usize, String)> {
    let code = code(text);
    let mut found = Vec::new();
    for root in ["crate::", "super::"] {
        for (at, _) in code.match_indices(root) {
            let line = 1 + code[..at].matches('\n').count();
            let rest = &code[at + root.len()..];
            let names: Vec<&str> = match rest.strip_prefix('{') {
                Some(group) => first_names(group),
                None => vec![identifier(rest)],
            };
            // A relative path may lead to a namesake inside the room; only the names of rooms are of interest.
            let rooms = names.into_iter().filter(|name| floor_of(plan, name).is_some());
            if root == "super::" && !code[..at].ends_with("super::") {
                continue;
            }
            found.extend(rooms.map(|name| (line, name.to_owned())));
        }
    }
    found.sort();
    found
}

/// First segment of each path in `a::b, c::{d, e}, f}...`.
fn first_names(group: &str) -> Vec<&str> {
    let (mut names, mut depth, mut begins) = (Vec::new(), 0_usize, true);
    for (at, here) in group.char_indices() {
        match here {
            '{' => depth += 1,
            '}' if depth == 0 => break,
            '}' => depth -= 1,
            ',' if depth == 0 => begins = true,
            _ if begins && !here.is_whitespace() => {
                names.push(identifier(&group[at..]));
                begins = false;
            }
            _ => {}
        }
    }
    names
}

/// What a file does against the plan of the floors.
fn floor_violations(path: &str, text: &str) -> Vec<String> {
    let closed = CLOSED
        .iter()
        .find(|(folder, _)| path.starts_with(folder) && !is_test_file(path))
        .map_or(&[][..], |(_, crates)| crates);
    let code = code(text);
    let mut violations: Vec<String> = closed
        .iter()
        .filter(|name| code.contains(*name))
        .map(|name| format!("{path}: uses {name}"))
        .collect();
    // The root only lists the rooms.
    let Some((plan, room)) = room_of(path).filter(|(_, room)| *room != "lib") else {
        return violations;
    };
    let Some(floor) = floor_of(plan, room) else {
        return vec![format!("{path}: the room {room:?} has no floor in the plan")];
    };
    let used = rooms_used(plan, text).into_iter();
    violations.extend(
        used.filter(|(_, used)| {
            used != room && floor_of(plan, used).is_none_or(|used| used >= floor)
        })
        .map(|(line, used)| format!("{path}:{line}: {room} uses {used}")),
    );
    violations
}

/// The libraries of the house among the `[dependencies]` of a manifest.
fn libraries_used(manifest: &str) -> Vec<&str> {
    let begin = manifest.find("\n[dependencies]\n");
    let section = begin.map_or("", |begin| &manifest[begin + 17..]);
    let section = section.split("\n[").next().unwrap_or_default();
    let names = section.lines().filter_map(|line| line.split(['.', ' ']).next());
    names.filter(|name| name.starts_with("drivebench-") || *name == "firmware-protocol").collect()
}

fn reads_a_clock(text: &str) -> bool {
    let code = code(text);
    let clocks = ["Instant", "SystemTime", "Timestamp", "Zoned", "Utc"];
    let mut clocks = clocks.into_iter().chain(["Local"]);
    clocks.any(|clock| code.contains(&format!("{clock}::now")))
}

/// Marks of unfinished work; spelt in pieces, so that this file has none.
fn unfinished_marks(text: &str) -> Vec<(usize, String)> {
    let marks = ["TO DO", "FIX ME", "to do!", "unimple mented!"].map(|mark| mark.replace(' ', ""));
    let lines = text.lines().enumerate();
    lines
        .flat_map(|(index, line)| {
            let here = marks.iter().filter(|mark| line.contains(mark.as_str()));
            here.map(move |mark| (index + 1, mark.clone())).collect::<Vec<_>>()
        })
        .collect()
}

/// Words such as `SECONDS_DONE` where a figure has to come, which no code of a page holds.
fn placeholders(page: &str) -> Vec<String> {
    // Fences of code blocks begin with three of the marks that enclose code in a line.
    let prose = page.split("```").step_by(2);
    let prose = prose.flat_map(|text| text.split('`').step_by(2));
    let words = prose.flat_map(|text| text.split(|c: char| c != '_' && !c.is_alphanumeric()));
    let is_one = |word: &&str| {
        let all = word.chars().all(|c| c == '_' || c.is_ascii_uppercase() || c.is_ascii_digit());
        all && word.trim_matches('_').contains('_')
            && word.contains(|c: char| c.is_ascii_uppercase())
    };
    words.filter(is_one).map(str::to_owned).collect()
}

#[test]
fn every_arrow_goes_down() {
    let violations: Vec<String> =
        rust_files(CODE).iter().flat_map(|(path, text)| floor_violations(path, text)).collect();
    assert!(violations.is_empty(), "{}", violations.join("\n"));
}

#[test]
fn every_library_uses_lower_ones_only() {
    for folder in fs::read_dir(root().join("crates")).expect("there are libraries") {
        let folder = folder.expect("an entry of a folder can be read").path();
        let name = folder.file_name().map(|name| name.to_string_lossy());
        let name = name.expect("a folder has a name");
        let manifest = read(&folder.join("Cargo.toml"));
        let may = CRATES.iter().find(|(of, _)| **of == *name);
        let (_, may) = may.unwrap_or_else(|| panic!("{name} has no floor in the plan"));
        for used in libraries_used(&manifest) {
            let short = used.strip_prefix("drivebench-").unwrap_or(used);
            let allowed = may.split(' ').any(|one| one == short);
            assert!(allowed, "{name} uses {used}; it may use {may:?}");
        }
    }
    let manifest = "[package]\n[dependencies]\nserde = 1\ndrivebench-bench.workspace = true\n[x]\ndrivebench-y = 1";
    assert_eq!(libraries_used(manifest), ["drivebench-bench"]);
}

#[test]
fn the_check_of_the_floors_can_fail() {
    let model = "crates/drivebench-model/src";
    for (folder, file, text, arrows) in [
        (model, "plant/motor.rs", "use crate::sample::Run;", 0),
        (model, "plant/motor.rs", "use crate::plant::Motor;", 0),
        (model, "plant/motor.rs", "use crate::excitation::Part;", 1),
        (model, "units.rs", "use crate::config_text::E;", 1),
        (model, "sample/a.rs", "use super::super::plant::Motor;", 1),
        (model, "kitchen/a.rs", "", 1),
        ("src", "report/a.rs", "let x = crate::commands::main();", 1),
        (
            "src",
            "workflow/a.rs",
            "use crate::{\n    report::{a, b},\n    commands::Failure, tui,\n};",
            2,
        ),
        ("src", "tui/a.rs", "use drivebench_link::DriveLink;", 1),
        ("src", "tui/tests/a.rs", "use drivebench_link::Link;", 0),
        // Words about a room are no arrow.
        (
            "src",
            "report/a.rs",
            "// crate::commands\n/// crate::commands\nlet a = \"crate::commands\"; let b = '\"';",
            0,
        ),
        ("src", "report/a.rs", "let b = '\"'; let c = '\\''; use crate::commands; // '\"'", 1),
    ] {
        let found = floor_violations(&format!("{folder}/{file}"), text);
        assert_eq!(found.len(), arrows, "{file}: {text}: {found:?}");
    }
    // The number of a line is that of the path.
    let found = floor_violations("src/report/a.rs", "\n\nuse crate::commands::Failure;");
    assert_eq!(found, ["src/report/a.rs:3: report uses commands"]);
}

#[test]
fn no_file_is_too_long() {
    for (path, text) in rust_files(&["src", "crates", "tests", "firmware-protocol"]) {
        let lines = text.lines().count();
        assert!(lines <= MOST_LINES, "{path}: {lines} lines, at most {MOST_LINES}");
    }
}

#[test]
fn every_part_opens_with_its_picture() {
    let sources = rust_files(&["src", "crates", "firmware-protocol/src"]);
    let name = |path: &str| path.rsplit('/').next().unwrap_or(path).to_owned();
    let is_part = |path: &str| {
        let beside = path.strip_suffix(".rs").unwrap_or(path);
        ["mod.rs", "lib.rs", "main.rs"].contains(&name(path).as_str())
            || root().join(beside).is_dir()
    };
    let parts: Vec<_> = sources.iter().filter(|(path, _)| is_part(path)).collect();
    assert!(parts.len() > CRATES.len(), "only {} parts", parts.len());
    for (path, text) in parts {
        assert!(text.starts_with("//! "), "{path} does not open with //!");
        let head = text.lines().take_while(|line| line.starts_with("//!"));
        let has_picture = head.into_iter().any(|line| line == "//! ```text");
        // The root of a library, and the rooms of the model and of the program.
        let inside = path.split_once("src/").map_or("", |(_, inside)| inside);
        let is_room = name(path) == "lib.rs"
            || room_of(path).is_some()
                && inside.matches('/').count() == 1
                && name(path) == "mod.rs";
        assert!(has_picture || !is_room, "{path} has no picture of its part");
    }
}

#[test]
fn only_the_owners_of_a_clock_read_it() {
    for (path, text) in rust_files(&["src", "crates", "firmware-protocol/src"]) {
        let owner = CLOCK_FILES.contains(&path.as_str());
        assert_eq!(
            reads_a_clock(&text),
            owner,
            "{path}: reading a clock belongs in {CLOCK_FILES:?}, and each of these has one"
        );
    }
    assert!(reads_a_clock("let t = std::time::Instant::now();"));
    assert!(!reads_a_clock("// Instant::now\nlet a = \"SystemTime::now\";"));
}

#[test]
fn nothing_is_left_unfinished() {
    for (path, text) in rust_files(&["src", "crates", "tests", "firmware-protocol"]) {
        let marks = unfinished_marks(&text);
        assert!(marks.is_empty(), "{path}: {marks:?}");
    }
    let fake = format!("fn a() {{}}\n// {}{} later\n", "TO", "DO");
    assert_eq!(unfinished_marks(&fake).len(), 1);
}

#[test]
fn no_page_waits_for_its_figures() {
    let below = ["docs", "firmware-protocol"].into_iter().flat_map(files);
    let own = ["README.md", "CHANGELOG.md", "ARCHITECTURE.md", "CONTRIBUTING.md"];
    let pages = below.chain(own.map(PathBuf::from));
    for path in pages.filter(|path| path.extension().is_some_and(|ending| ending == "md")) {
        let text = read(&path);
        let found = (placeholders(&text), unfinished_marks(&text));
        assert!(found.0.is_empty() && found.1.is_empty(), "{}: {found:?}", path.display());
    }
    let fake =
        "| a | SECONDS_A |\n`NO_COLOR`\n```sh\nCI_TOTAL=1\n```\nB_C, `--s SECONDS`, A, 1_000";
    assert_eq!(placeholders(fake), ["SECONDS_A", "B_C"]);
}

/// The file's text parsed by the reader of its folder; the reason where it is refused.
fn parse_config(path: &str, text: &str) -> Result<(), String> {
    use drivebench::bench::BenchFile;
    use drivebench::drive::DriveProfile;
    use drivebench::emulator::EmulatorConfig;
    use drivebench::workflow::suite::Suite;
    let bench = |text: &str| BenchFile::parse(path, text).map(drop).map_err(|e| e.to_string());
    match path.split('/').nth(1).unwrap_or_default() {
        "benches" => bench(text),
        "drives" => DriveProfile::parse(path, text).map(drop).map_err(|e| e.to_string()),
        "emulators" => EmulatorConfig::parse(path, text).map(drop).map_err(|e| e.to_string()),
        "suites" => {
            let options = |_| {
                let of_steps = ["run-seed", "drive", "output", "holdout", "controller", "reopen-s"];
                let waivers = ["reset-fault", "waive-watchdog"];
                of_steps.into_iter().chain(waivers).map(str::to_owned).collect()
            };
            Suite::parse(path, text, options).map(drop).map_err(|e| e.to_string())
        }
        // A nameplate is the [motor] table of a bench file; the rest of the bench does not matter here.
        "motors" => bench(&format!(
            "name = \"nameplate\"\n[drive]\nprofile = \"own\"\n[link]\nport = \"sim:\"\n\
             [[sequence]]\nstandstill = {{ seconds = 1.0 }}\n[motor]\n{text}"
        )),
        other => Err(format!("no reader for files of {other:?} is in this test")),
    }
}

#[test]
fn every_configuration_in_the_repository_parses() {
    let configs = files("bench-configs");
    assert!(configs.len() >= 4, "{configs:?}");
    for path in configs {
        let text = read(&path);
        let path = path.display().to_string();
        let parsed = parse_config(&path, &text);
        assert_eq!(parsed, Ok(()), "{path}");
        // And the reader is strict, so that the line above means something.
        let wrong = format!("of_tomorrow = 1\n{text}");
        assert!(parse_config(&path, &wrong).is_err(), "{path}: an unknown key passed");
    }
}
