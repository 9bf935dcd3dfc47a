//! The whole program in a real pseudo-terminal: the screen as a person sees it, keys as a person presses them.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of an integration test are test code"
)]

mod terminal;

use terminal::Session;

const SIZE: (u16, u16) = (120, 40);

#[test]
fn space_stops_the_run_and_q_gives_the_terminal_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::start(&["run", "--port", "emulator"], folder.path(), SIZE);
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
    assert!(!session.screen.screen().alternate_screen());
    assert!(!session.screen.screen().hide_cursor());
    assert!(session.text().contains("stopped"), "{}", session.text());
}

#[test]
fn ctrl_c_stops_and_leaves_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::start(&["run", "--port", "emulator"], folder.path(), SIZE);
    session.wait_for(" SIM  RUNNING");
    session.press("\u{3}");
    assert_eq!(session.end(), 130, "{}", session.text());
    assert!(!session.screen.screen().alternate_screen());
    assert!(!session.screen.screen().hide_cursor());
    assert_eq!(
        std::fs::read_dir(folder.path().join("runs"))
            .unwrap()
            .count(),
        1
    );
}
