//! The plan of the house, held by a test: floors, file sizes, pictures, clocks, and data files that parse.
//!
//! ```text
//! src/**.rs, crates/**.rs -> code without comments -> crate paths -> rooms -> which floor? -> violations (must be none)
//! ```

use std::fs;
use std::path::{Path, PathBuf};

/// Lowest first; rooms on one floor don't see each other.
const FLOORS: &str = "units config_text < text < sample < signal < numerics < plant excitation < identification \
    < diagnosis control < drive recording < emulator < bench < report < workflow < tui < app < cli < main studies";

/// Lower rooms that a room must not use all the same, outside its tests: screens know no drive.
const CLOSED: &[(&str, &[&str])] = &[("tui", &["drive", "emulator"])];

/// The folder of the crate that knows no clock, no file and no terminal; the library shows its rooms beside its own.
const CORE: &str = "src/core/";

/// The only rooms that speak the firmware's protocol.
const FIRMWARE_ROOMS: &[&str] = &["drive", "emulator"];

/// The only files that may read a clock.
const CLOCK_FILES: &[&str] = &[
    "src/app/opening.rs",
    "src/app/progress.rs",
    "src/app/suite/process.rs",
    "src/bench/clock.rs",
    "src/drive/waiting.rs",
    "src/emulator/server.rs",
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
    let read: Vec<(String, String)> = rust
        .map(|path| (path.display().to_string(), read(&path)))
        .collect();
    assert!(!read.is_empty(), "no Rust file in {folders:?}");
    read
}

fn read(path: &Path) -> String {
    fs::read_to_string(root().join(path)).expect("a source file is readable text")
}

/// `src/drive/link.rs` and `src/drive.rs` are in the room `drive`, `src/core/plant/motor.rs` in the room `plant`,
/// `crates/drivebench-studies/src/page.rs` in the room `studies`.
fn room_of(path: &str) -> &str {
    if let Some(of_crate) = path.strip_prefix("crates/drivebench-") {
        return of_crate.split('/').next().unwrap_or(of_crate);
    }
    let inside = path
        .strip_prefix(CORE)
        .or(path.strip_prefix("src/"))
        .unwrap_or(path);
    let first = inside.split('/').next().unwrap_or(inside);
    first.strip_suffix(".rs").unwrap_or(first)
}

fn floor_of(room: &str) -> Option<usize> {
    let mut floors = FLOORS.split('<');
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

/// Rooms that a path of the crate's root leads to: `crate::drive::Sample`, `crate::{bench::Plan, plant}`,
/// `super::super::plant`. With their lines.
fn rooms_used(text: &str) -> Vec<(usize, String)> {
    let code = code(text);
    let mut found = Vec::new();
    for root in ["crate::", "drivebench::", "super::"] {
        for (at, _) in code.match_indices(root) {
            let line = 1 + code[..at].matches('\n').count();
            let rest = &code[at + root.len()..];
            let names: Vec<&str> = match rest.strip_prefix('{') {
                Some(group) => first_names(group),
                None => vec![identifier(rest)],
            };
            // A relative path may lead to a namesake inside the room; only the names of rooms are of interest.
            let rooms = names.into_iter().filter(|name| floor_of(name).is_some());
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
    let room = room_of(path);
    // The root only lists the rooms.
    if room == "lib" {
        return Vec::new();
    }
    let Some(floor) = floor_of(room) else {
        return vec![format!(
            "{path}: the room {room:?} has no floor in the plan"
        )];
    };
    let closed = CLOSED
        .iter()
        .find(|(from, _)| *from == room && !is_test_file(path))
        .map_or(&[][..], |(_, rooms)| rooms);
    let mut violations: Vec<String> = rooms_used(text)
        .into_iter()
        .filter(|(_, used)| used != room)
        .filter(|(_, used)| {
            floor_of(used).is_none_or(|used| used >= floor) || closed.contains(&used.as_str())
        })
        .map(|(line, used)| format!("{path}:{line}: {room} uses {used}"))
        .collect();
    if code(text).contains("drivebench_studies") && room != "studies" {
        violations.push(format!("{path}: {room} uses studies"));
    }
    if code(text).contains("firmware_protocol") && !FIRMWARE_ROOMS.contains(&room) {
        violations.push(format!("{path}: {room} uses firmware_protocol"));
    }
    violations
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
            here.map(move |mark| (index + 1, mark.clone()))
                .collect::<Vec<_>>()
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
        let all = word
            .chars()
            .all(|c| c == '_' || c.is_ascii_uppercase() || c.is_ascii_digit());
        all && word.trim_matches('_').contains('_')
            && word.contains(|c: char| c.is_ascii_uppercase())
    };
    words.filter(is_one).map(str::to_owned).collect()
}

#[test]
fn every_arrow_goes_down() {
    let violations: Vec<String> = rust_files(&["src", "crates"])
        .iter()
        .flat_map(|(path, text)| floor_violations(path, text))
        .collect();
    assert!(violations.is_empty(), "{}", violations.join("\n"));
}

#[test]
fn the_check_of_the_floors_can_fail() {
    for (path, text, arrows) in [
        ("core/plant/motor.rs", "use crate::sample::Run;", 0),
        ("core/plant/motor.rs", "use crate::bench::Plan;", 1),
        ("core/plant/motor.rs", "use crate::drive::Link;", 1),
        ("core/plant/motor.rs", "use crate::plant::Motor;", 0),
        ("core/units.rs", "use crate::config_text::E;", 1),
        ("core/sample/run.rs", "let x = crate::cli::main();", 1),
        ("core/sample/run.rs", "use super::super::drive::Link;", 1),
        (
            "emulator/pty.rs",
            "use crate::{\n    units::{a, bench},\n    cli::Failure, tui,\n};",
            2,
        ),
        ("core/identification/a.rs", "crate::recording::x()", 1),
        ("tui/a.rs", "use crate::drive::DriveLink;", 1),
        ("tui/tests/a.rs", "use crate::drive::Link;", 0),
        ("bench/a.rs", "use firmware_protocol::Map;", 1),
        ("drive/a.rs", "use firmware_protocol::Map;", 0),
        ("cli/a.rs", "use drivebench_studies::page;", 1),
        ("kitchen/a.rs", "", 1),
        // Words about a room are no arrow.
        (
            "core/plant/a.rs",
            "// crate::cli\n/// crate::cli\nlet a = \"crate::cli\"; let b = '\"';",
            0,
        ),
        (
            "core/plant/a.rs",
            "let b = '\"'; let c = '\\''; use crate::cli; // '\"'",
            1,
        ),
    ] {
        let found = floor_violations(&format!("src/{path}"), text);
        assert_eq!(found.len(), arrows, "{path}: {text}: {found:?}");
    }
    let of_studies = "crates/drivebench-studies/src/main.rs";
    let below = "use drivebench::cli; use drivebench_studies::page;";
    assert_eq!(floor_violations(of_studies, below).len(), 0);
    assert_eq!(floor_violations(of_studies, "use crate::main;").len(), 1);
    // The number of a line is that of the path.
    let told = floor_violations("src/emulator/pty.rs", "\n\nuse crate::cli::Failure;");
    assert_eq!(told, ["src/emulator/pty.rs:3: emulator uses cli"]);
}

#[test]
fn every_floor_has_its_rooms_in_the_library() {
    let roots = ["src/lib.rs", "src/core/lib.rs"].map(|path| read(Path::new(path)));
    let lines = roots.iter().flat_map(|text| text.lines());
    for line in lines.filter_map(|l| l.strip_prefix("pub mod ")) {
        let room = identifier(line);
        assert!(floor_of(room).is_some(), "{room} has no floor in the plan");
    }
}

#[test]
fn no_file_is_too_long() {
    for (path, text) in rust_files(&["src", "crates", "tests", "firmware-protocol"]) {
        let lines = text.lines().count();
        assert!(
            lines <= MOST_LINES,
            "{path}: {lines} lines, at most {MOST_LINES}"
        );
    }
}

/// Folders above a file, those of the core counted as beside the rest.
fn depth(path: &str) -> usize {
    path.replacen(CORE, "src/", 1).matches('/').count()
}

#[test]
fn every_part_opens_with_its_picture() {
    let sources = rust_files(&["src", "crates", "firmware-protocol/src"]);
    let is_part = |path: &str| {
        let name = path.rsplit('/').next().unwrap_or(path);
        let beside = path.strip_suffix(".rs").unwrap_or(path);
        ["mod.rs", "lib.rs", "main.rs"].contains(&name)
            || depth(path) == 1
            || root().join(beside).is_dir()
    };
    let parts: Vec<_> = sources.iter().filter(|(path, _)| is_part(path)).collect();
    assert!(
        parts.len() > FLOORS.split('<').count() / 2,
        "only {} parts",
        parts.len()
    );
    for (path, text) in parts {
        assert!(text.starts_with("//! "), "{path} does not open with //!");
        let head = text.lines().take_while(|line| line.starts_with("//!"));
        let has_picture = head.into_iter().any(|line| line == "//! ```text");
        let is_room = depth(path) == 2 && path.ends_with("mod.rs");
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
    assert!(!reads_a_clock(
        "// Instant::now\nlet a = \"SystemTime::now\";"
    ));
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
    let own = [
        "README.md",
        "CHANGELOG.md",
        "ARCHITECTURE.md",
        "CONTRIBUTING.md",
    ];
    let pages = below.chain(own.map(PathBuf::from));
    for path in pages.filter(|path| path.extension().is_some_and(|ending| ending == "md")) {
        let text = read(&path);
        let found = (placeholders(&text), unfinished_marks(&text));
        assert!(
            found.0.is_empty() && found.1.is_empty(),
            "{}: {found:?}",
            path.display()
        );
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
    let bench = |text: &str| {
        BenchFile::parse(path, text)
            .map(drop)
            .map_err(|e| e.to_string())
    };
    match path.split('/').nth(1).unwrap_or_default() {
        "benches" => bench(text),
        "drives" => DriveProfile::parse(path, text)
            .map(drop)
            .map_err(|e| e.to_string()),
        "emulators" => EmulatorConfig::parse(path, text)
            .map(drop)
            .map_err(|e| e.to_string()),
        "suites" => {
            let options = |_| {
                [
                    "run-seed",
                    "drive",
                    "output",
                    "holdout",
                    "controller",
                    "reset-fault",
                    "reopen-s",
                ]
                .map(str::to_owned)
                .into()
            };
            Suite::parse(path, text, options)
                .map(drop)
                .map_err(|e| e.to_string())
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
        assert!(
            parse_config(&path, &wrong).is_err(),
            "{path}: an unknown key passed"
        );
    }
}
