//! The whole loop by keys, over a pseudo-terminal with a screen parser, from the start to the report: commission, the run
//! that shows more, its diagnosis, the effect added, the speed loop.

use super::next_run::weak_bench;
use super::screen::keep_what_scrolls;
use crate::kit::prelude::*;

/// They stand below what the loop has come to.
fn to_the_steps(session: &mut Session) {
    session.press(&"\u{1b}[6~".repeat(9));
}

/// The page of the loop has the step of its last run, too; a run has no page of steps.
fn until_the_run_is_done(session: &mut Session) {
    session.wait("the end of the run", |screen| {
        let shown = screen.contents();
        shown.contains("DONE") && shown.contains("Tab parameters")
    });
}

#[test]
fn the_whole_loop_is_driven_by_keys() {
    let desk = Desk::new();
    let (emulator, bench) = (desk.path("emulator.toml"), desk.path("bench.toml"));
    let hidden = "\n[[hidden]]\nid = \"current_offset\"\noffset_a = 0.3\n";
    fs::write(&emulator, format!("{PLAIN}{hidden}")).unwrap();
    // With the time that the reference of the speed loop takes.
    fs::write(&bench, weak_bench(&emulator).replace("time_s = 7.5", "time_s = 30.0")).unwrap();
    let arguments = line("commission {} --port sim: --seed 5 --out runs", &[&bench]);
    let mut session = Session::start(arguments, desk.folder(), (160, 50));

    // The runs are too short to distinguish rivals, and the page names a run that would.
    session.wait_for("x next experiment");
    to_the_steps(&mut session);
    session.wait_for("needs    effects not distinguished or not shown so far");
    session.press("x");
    until_the_run_is_done(&mut session);
    session.press("q");
    session.wait_for("the recommended run");
    session.wait_for("a add");
    session.wait_for("current_offset");
    session.press("a");
    session.wait_for("+ in the model current_offset");
    session.wait_for("at the floor");
    session.wait_for("NOTHING MISSING");
    session.press("q");

    // Back on the page of the loop: the gains are tuned, the loop follows.
    session.wait_for("l speed loop");
    to_the_steps(&mut session);
    session.wait_for("✓ done     next experiment");
    session.press("l");
    until_the_run_is_done(&mut session);
    session.press("q");
    session.wait_for("l speed loop");
    to_the_steps(&mut session);
    session.wait_for("reference followed within");
    keep_what_scrolls(&mut session);
    let left = session.leave("q", 0);
    has(&left, &["next experiment: ", "current_offset"]);
    has(&left, &["speed loop: reference followed within"]);

    let mut reports = 0;
    for folder in fs::read_dir(desk.path("runs")).unwrap() {
        let folder = folder.unwrap().path();
        if folder.is_symlink() {
            // The latest of them, once more.
            continue;
        }
        assert!(folder.join("samples.csv").exists(), "{folder:?}");
        reports += usize::from(folder.join("report.html").exists());
    }
    assert_eq!(reports, 6, "four runs, the experiment and the speed loop");
}

#[test]
fn ctrl_c_on_the_screen_of_what_follows_ends_the_program() {
    let desk = Desk::new();
    let arguments = line("commission --port sim: --seed 7 --out runs", &[]);
    let mut session = Session::start(arguments, desk.folder(), (160, 50));
    session.wait_for("l speed loop");
    session.press("l");
    until_the_run_is_done(&mut session);
    session.press("\u{3}");
    assert_eq!(session.end(), 130, "{}", session.text());
    // What was measured before is printed all the same.
    has(&session.text(), &["report.html", "interrupted"]);
    session.expect_terminal_as_it_was();
}
