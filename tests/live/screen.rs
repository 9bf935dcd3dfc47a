//! The whole program in a real pseudo-terminal: the screen as a person sees it, keys as a person presses them.

use crate::kit::prelude::*;

const SIZE: (u16, u16) = (120, 40);

/// The default bench and its drive, both of which let a loaded machine stand still for a while.
fn start(command: &str, desk: &Desk) -> Session {
    let bench = BENCH
        .replace("link_silence_s = 0.45", "link_silence_s = 0.95")
        // A busy machine keeps this rate as well.
        .replace("rate_hz = 100.0", "rate_hz = 50.0");
    let emulator = HIDDEN.replace("watchdog_ms = 500", "watchdog_ms = 1000");
    desk.put("bench.toml", &bench);
    desk.put("drive.toml", &emulator);
    let text = format!("{command} bench.toml --port emulator --emulator drive.toml");
    Session::start(line(&text, &[]), desk.folder(), SIZE)
}

#[test]
fn space_stops_the_run_and_q_gives_the_terminal_back() {
    let folder = Desk::new();
    let mut session = start("run", &folder);
    session.wait_for(" SIM  RUNNING");
    assert!(session.screen.screen().alternate_screen());
    assert!(session.screen.screen().hide_cursor());
    session.wait_for("resistance");
    session.wait("a curve", |screen| {
        let dots = |letter: char| ('\u{2801}'..='\u{28ff}').contains(&letter);
        screen.contents().chars().filter(|letter| dots(*letter)).count() > 60
    });
    // Energised: no way out but the stop.
    session.press("q");
    session.wait_for("stop first: Space");
    session.press("?");
    session.wait_for("help, any key closes it");
    session.press(" ");
    session.wait_for("STOPPED");
    session.press("?");
    session.wait("help closed", |screen| !screen.contents().contains("any key closes it"));
    session.wait_for("Output off, q = quit.");
    session.leave("q", 130);
    has(&session.text(), &["stopped"]);
}

/// The commanded volts of the record as far as it is written.
pub(crate) fn commands(desk: &Desk) -> Vec<f64> {
    column(&desk.read("samples.csv"), "voltage_cmd_v")
}

fn is_driven(folder: &Desk) -> bool {
    commands(folder).iter().any(|volts| volts.abs() > 1.0)
}

/// The output is zero when the record ends, and the record has the outcome.
fn expect_stopped(folder: &Desk) {
    assert!(is_driven(folder));
    assert_eq!(commands(folder).last(), Some(&0.0));
    let manifest = folder.manifest();
    assert_eq!(manifest["finished"], true, "{manifest:#}");
    assert_eq!(manifest["outcome"], "interrupted", "{manifest:#}");
}

#[test]
fn ctrl_c_stops_and_leaves_by_itself() {
    at_once(["run", "commission"], |command| {
        let folder = Desk::new();
        let mut session = start(command, &folder);
        session.wait_for(" SIM  RUNNING");
        session.wait("a voltage", |_| is_driven(&folder));
        // With a mark on its way into the record.
        session.leave("m\u{3}", 130);
        expect_stopped(&folder);
    });
}
