//! The whole program in a real pseudo-terminal: the screen as a person sees it, keys as a person presses them.

use std::fs;
use std::path::Path;

use crate::kit::terminal::Session;
use crate::kit::{BENCH, HIDDEN, column, manifest, only_folder};

const SIZE: (u16, u16) = (120, 40);

/// The default bench and its drive, both of which let a loaded machine stand still for a while.
fn start(command: &str, folder: &Path) -> Session {
    let bench = BENCH.replace("link_silence_s = 0.45", "link_silence_s = 0.95");
    let emulator = HIDDEN.replace("watchdog_ms = 500", "watchdog_ms = 1000");
    for (name, text) in [("bench.toml", bench), ("drive.toml", emulator)] {
        fs::write(folder.join(name), text).unwrap();
    }
    let line = [
        command,
        "bench.toml",
        "--port",
        "emulator",
        "--emulator",
        "drive.toml",
    ];
    Session::start(line, folder, SIZE)
}

#[test]
fn space_stops_the_run_and_q_gives_the_terminal_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = start("run", folder.path());
    session.wait_for(" SIM  RUNNING");
    assert!(session.screen.screen().alternate_screen());
    assert!(session.screen.screen().hide_cursor());
    session.wait_for("resistance");
    session.wait("a curve", |screen| {
        let dots = |letter: char| ('\u{2801}'..='\u{28ff}').contains(&letter);
        screen
            .contents()
            .chars()
            .filter(|letter| dots(*letter))
            .count()
            > 60
    });
    // Energised: no way out but the stop.
    session.press("q");
    session.wait_for("stop first: Space");
    session.press("?");
    session.wait_for("help, any key closes it");
    session.press(" ");
    session.wait_for("STOPPED");
    session.press("?");
    session.wait("help closed", |screen| {
        !screen.contents().contains("any key closes it")
    });
    session.wait_for("Output off, q = quit.");
    session.press("q");
    assert_eq!(session.end(), 130, "{}", session.text());
    session.expect_terminal_as_it_was();
    assert!(session.text().contains("stopped"), "{}", session.text());
}

/// The commanded volts of the record as far as it is written.
fn commands(folder: &Path) -> Vec<f64> {
    let run = only_folder(&folder.join("runs"));
    let samples = fs::read_to_string(run.join("samples.csv")).unwrap();
    column(&samples, "voltage_cmd_v")
}

fn is_driven(folder: &Path) -> bool {
    commands(folder).iter().any(|volts| volts.abs() > 1.0)
}

/// The output is zero when the record ends, and the record says how it ended.
fn expect_stopped(folder: &Path) {
    assert!(is_driven(folder));
    assert_eq!(commands(folder).last(), Some(&0.0));
    let manifest = manifest(&folder.join("runs"));
    assert_eq!(manifest["finished"], true, "{manifest:#}");
    assert_eq!(manifest["outcome"], "interrupted", "{manifest:#}");
}

#[test]
fn ctrl_c_stops_and_leaves_by_itself() {
    for command in ["run", "commission"] {
        let folder = tempfile::tempdir().unwrap();
        let mut session = start(command, folder.path());
        session.wait_for(" SIM  RUNNING");
        session.wait("a voltage", |_| is_driven(folder.path()));
        // With a mark on its way into the record.
        session.press("m\u{3}");
        assert_eq!(session.end(), 130, "{}", session.text());
        session.expect_terminal_as_it_was();
        expect_stopped(folder.path());
    }
}
