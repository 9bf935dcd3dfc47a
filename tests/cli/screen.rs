//! The diagnosis on the screen of a real pseudo-terminal: guess, add with one key, see the error fall, write, leave.

use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::kit::terminal::Session;
use crate::kit::{call, has, only_folder};
use nix::sys::signal::Signal;

/// Two runs of an emulated motor with Stribeck friction, recorded in virtual time; made once, the tests only read them.
fn runs() -> &'static [PathBuf; 2] {
    static RUNS: OnceLock<[PathBuf; 2]> = OnceLock::new();
    RUNS.get_or_init(|| {
        ["1", "2"].map(|seed| {
            let out = tempfile::tempdir().unwrap().keep();
            let text = format!(
                "run --port sim: --headless --json --emulator zk-22fc-hidden --seed 7 --run-seed {seed} --out {{}}"
            );
            call(&text, &[&out]).expect(0);
            only_folder(&out)
        })
    })
}

fn diagnose(more: &[&str], folder: &Path, size: (u16, u16)) -> Session {
    let [fit, holdout] = runs();
    let mut arguments = vec![
        "diagnose",
        fit.to_str().unwrap(),
        "--holdout",
        holdout.to_str().unwrap(),
        "--screen",
    ];
    arguments.extend(more);
    Session::start(&arguments, folder, size)
}

/// More rows for the reader than the program knows of: what is printed at the end is seen from its first line on.
fn keep_what_scrolls(session: &mut Session) {
    let (_, columns) = session.screen.screen().size();
    let rows = NonZero::new(400).expect("more than none");
    session.screen.screen_mut().set_size(rows, columns);
}

const ADD: &str = "a add";
const UP: &str = "\u{1b}[A";
const DOWN: &str = "\u{1b}[B";

#[test]
fn guess_then_add_with_one_key_and_the_error_falls_to_the_floor() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = diagnose(
        &["--guess", "--output", "found.toml"],
        folder.path(),
        (80, 24),
    );
    session.wait_for("the tool has its answer");
    // No name is given away, and nothing can be added before there is a guess.
    assert!(!session.text().contains("supported"), "{}", session.text());
    session.press("a");
    session.wait_for("guess first");
    for _ in 0..4 {
        session.press(DOWN);
    }
    session.wait_for("▶ stribeck_friction");
    session.press("g");
    session.wait_for("right: you and the tool say stribeck_friction");
    session.press("a");
    session.wait_for("+ in the model stribeck_friction");
    session.wait_for("added stribeck_friction");
    session.wait_for("at the floor");
    session.wait_for("NOTHING MISSING");
    // The guess was at what was missing then.
    assert!(!session.text().contains("you: "), "{}", session.text());
    session.press("w");
    session.wait_for("model written to");
    session.press(UP);
    session.wait_for("▶ + in the model");
    session.press("r");
    session.wait_for("refused: ");
    keep_what_scrolls(&mut session);
    session.press("q");
    assert_eq!(session.end(), 0, "{}", session.text());
    // What stays behind is about the model as it stands, and says how it came about and where it is.
    let left = session.text();
    has(
        &left,
        &[
            "model written to found.toml",
            "by hand: + stribeck_friction: held-out error ",
            "nothing is missing",
        ],
    );
    assert!(!left.contains("missing: stribeck_friction"), "{left}");
    session.expect_terminal_as_it_was();
    let model = std::fs::read_to_string(folder.path().join("found.toml")).unwrap();
    assert!(model.contains("id = \"stribeck_friction\""), "{model}");
}

#[test]
fn a_small_terminal_shows_the_size_and_scrolls_the_help() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = diagnose(&[], folder.path(), (60, 20));
    session.wait_for(ADD);
    let shown = session.text();
    let row = shown.lines().find(|row| row.contains("▶")).unwrap();
    assert!(
        row.contains("stribeck_friction") && row.contains("N.m"),
        "{shown}"
    );
    assert!(shown.trim_end().ends_with("q leave"), "{shown}");
    session.press("?");
    session.wait_for("more below");
    for _ in 0..30 {
        session.press(DOWN);
    }
    session.wait_for("A name is an equation");
    session.press("x");
    session.wait("help closed", |screen| {
        !screen.contents().contains("A name is")
    });
    session.press("n");
    session.wait_for("what these runs do not tell");
    session.press("q");
    session.wait_for(ADD);
    session.press("q");
    assert_eq!(session.end(), 0, "{}", session.text());
    // The answer stays behind in the terminal.
    assert!(session.text().contains("rul"), "{}", session.text());
}

#[test]
fn leaving_in_the_middle_of_a_search_gives_the_terminal_back() {
    for key in ["q", "\u{3}"] {
        let folder = tempfile::tempdir().unwrap();
        let mut session = diagnose(&[], folder.path(), (100, 30));
        session.wait("the screen", vt100::Screen::alternate_screen);
        session.press(key);
        let status = session.end();
        // A machine that is fast enough has its answer before the key arrives.
        let answered = key == "q" && session.text().contains("ruled out");
        assert_eq!(status, if answered { 0 } else { 130 }, "{}", session.text());
        session.expect_terminal_as_it_was();
    }
}

#[test]
fn d_goes_on_by_hand_after_a_commissioning() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = [
        "commission",
        "--port",
        "sim:",
        "--seed",
        "7",
        "--out",
        "runs",
    ];
    let mut session = Session::start(arguments, folder.path(), (120, 40));
    session.wait_for("d diagnosis by hand");
    session.press("d");
    session.wait_for("DIAGNOSIS");
    session.wait_for(ADD);
    has(&session.text(), &["stribeck_friction"]);
    session.press("e");
    session.wait_for("error over speed x current");
    session.press("q");
    session.wait_for(ADD);
    keep_what_scrolls(&mut session);
    session.signal(Signal::SIGTERM);
    // The result is there all the same.
    assert_eq!(session.end(), 130, "{}", session.text());
    let left = session.text();
    assert!(left.contains("stribeck_friction"), "{left}");
    has(&left, &["interrupted in the diagnosis by hand"]);
    session.expect_terminal_as_it_was();
}

#[test]
fn a_model_that_was_asked_for_is_in_its_file_when_q_has_left() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = diagnose(&["--output", "kept.toml"], folder.path(), (100, 30));
    session.wait_for(ADD);
    session.press("a");
    // The answer is there, and the worker looks for the next run.
    session.wait_for("NOTHING MISSING");
    session.press("wq");
    assert_eq!(session.end(), 0, "{}", session.text());
    let model = std::fs::read_to_string(folder.path().join("kept.toml")).unwrap();
    assert!(model.contains("id = \"stribeck_friction\""), "{model}");
}

#[test]
fn ctrl_c_right_behind_w_leaves_a_whole_model_or_none() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = diagnose(&["--output", "kept.toml"], folder.path(), (100, 30));
    session.wait_for(ADD);
    session.press("a");
    session.wait_for("NOTHING MISSING");
    session.press("w\u{3}");
    assert_eq!(session.end(), 130, "{}", session.text());
    session.expect_terminal_as_it_was();
    if let Ok(text) = std::fs::read_to_string(folder.path().join("kept.toml")) {
        assert!(text.contains("id = \"stribeck_friction\""), "{text}");
        assert!(text.ends_with('\n'), "{text}");
        assert!(text.contains("[[history.fitted]]"), "{text}");
    }
}

#[test]
fn a_signal_after_the_screen_ends_the_program() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = diagnose(&["--html", "page.html"], folder.path(), (100, 30));
    session.wait_for(ADD);
    session.press("a");
    session.wait_for("NOTHING MISSING");
    session.press("q");
    session.wait("the end of the screen", |screen| !screen.alternate_screen());
    session.signal(Signal::SIGTERM);
    assert_eq!(session.end(), 130, "{}", session.text());
    assert!(session.text().contains("interrupted"), "{}", session.text());
    assert!(!folder.path().join("page.html").exists());
}
