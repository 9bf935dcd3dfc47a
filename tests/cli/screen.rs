//! The diagnosis on the screen of a real pseudo-terminal: add with one key, see the error fall, write, leave.

use crate::kit::prelude::*;
use std::num::NonZero;

fn diagnose(more: &str, folder: &Path, size: (u16, u16)) -> Session {
    let runs = Runs::hidden();
    let mut arguments = line("diagnose {} --holdout {} --screen", &[&runs.fit, &runs.holdout]);
    arguments.extend(line(more, &[]));
    Session::start(&arguments, folder, size)
}

/// More rows than the terminal reports to the program: the first line of what is printed at the end stays on the screen.
pub(crate) fn keep_what_scrolls(session: &mut Session) {
    let (_, columns) = session.screen.screen().size();
    session.screen.screen_mut().set_size(NonZero::new(400).expect("more than none"), columns);
}

const ADD: &str = "a add";
const UP: &str = "\u{1b}[A";

#[test]
fn one_key_adds_an_effect_and_the_error_falls_to_the_floor() {
    let folder = Desk::new();
    let mut session = diagnose("--output found.toml", folder.folder(), (80, 24));
    session.wait_for(ADD);
    session.press("a");
    session.wait_for("+ in the model stribeck_friction");
    session.wait_for("added stribeck_friction");
    session.wait_for("at the floor");
    session.wait_for("NOTHING MISSING");
    session.press("w");
    session.wait_for("model written to");
    session.press(UP);
    session.wait_for("▶ + in the model");
    session.press("r");
    session.wait_for("refused: ");
    keep_what_scrolls(&mut session);
    session.press("q");
    assert_eq!(session.end(), 0, "{}", session.text());
    // Without --mouse the terminal keeps its mouse.
    lacks(&String::from_utf8_lossy(&session.sent), &["\u{1b}[?1000h"]);
    // The text that stays is of the final model: how it was made, and its file.
    let left = session.text();
    has(
        &left,
        &[
            "model written to found.toml",
            // Every other effect is ruled out by these runs.
            "NOTHING MISSING: held-out error ",
            "  + stribeck_friction: held-out error ",
            "drivebench tune --model found.toml",
        ],
    );
    lacks(&left, &["missing: stribeck_friction"]);
    session.expect_terminal_as_it_was();
    let model = fs::read_to_string(folder.path("found.toml")).unwrap();
    has(&model, &["id = \"stribeck_friction\""]);
}

#[test]
fn leaving_in_the_middle_of_a_search_gives_the_terminal_back() {
    for key in ["q", "\u{3}"] {
        let folder = Desk::new();
        let mut session = diagnose("", folder.folder(), (100, 30));
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
fn v_and_d_go_on_after_a_commissioning() {
    let folder = Desk::new();
    let arguments = line("commission --port sim: --seed 7 --out runs", &[]);
    let mut session = Session::start(arguments, folder.folder(), (120, 40));
    session.wait_for("d diagnosis by hand");
    // The drive was recorded in a burst, and the messages wait until the screen is left: nothing writes over it.
    let burst = String::from_utf8_lossy(&session.sent).contains("burst capture");
    assert!(!burst, "{}", session.text());
    session.wait_for("after ± std");
    session.press("v");
    session.wait_for("speed: measured - model");
    session.wait_for("run 1 of 3");
    session.press("q");
    session.wait_for(ADD);
    // Back to the page of the loop, with what can follow.
    session.press("q");
    session.wait_for("l speed loop");
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
    has(&left, &["stribeck_friction"]);
    has(&left, &["interrupted in the diagnosis by hand"]);
    session.expect_terminal_as_it_was();
}

#[test]
fn d_goes_on_by_hand_after_a_run_and_the_next_command_has_what_was_written() {
    for (writes, next) in [
        (false, "next      drivebench diagnose runs/"),
        (true, "drivebench tune --model model.toml"),
    ] {
        let folder = Desk::new();
        let arguments = line("run --port sim: --seed 7 --out runs", &[]);
        let mut session = Session::start(arguments, folder.folder(), (120, 40));
        session.wait_for("d = diagnosis by hand, q = quit");
        lacks(&session.text(), &["Space = STOP"]);
        session.press("d");
        session.wait_for("DIAGNOSIS");
        session.wait_for(ADD);
        if writes {
            session.press("w");
            session.wait_for("model written to model.toml");
        }
        keep_what_scrolls(&mut session);
        has(&session.leave("q", 0), &["DONE: ", next, "/report.html"]);
    }
}

/// Whether the process stands still, as a shell leaves one.
fn is_halted(id: u32) -> bool {
    let status = fs::read_to_string(format!("/proc/{id}/status")).unwrap_or_default();
    status.lines().any(|line| line.starts_with("State:\tT"))
}

/// A shell that halts its jobs and brings them back; the job is a shell of its own with the program in it, as `cargo run` is.
const JOB: &str = r#"
set -m
sh -c '"$@"; exit $?' job "$@"
echo "halted $?"
read answer
fg
echo "over $?"
"#;

#[test]
fn ctrl_z_halts_the_whole_job_and_fg_brings_the_screen_back() {
    let folder = Desk::new();
    let runs = Runs::hidden();
    let mut arguments = line("-c {} shell", &[Path::new(JOB)]);
    arguments.push(BINARY.into());
    arguments.extend(line("diagnose {} --holdout {} --screen", &[&runs.fit, &runs.holdout]));
    let mut session = Session::of("sh", arguments, folder.folder(), (100, 30));
    session.wait_for(ADD);
    session.press("\u{1a}");
    session.wait("the shell", |screen| !screen.alternate_screen());
    session.wait_for("halted ");
    session.press("\n");
    session.wait("the screen", vt100::Screen::alternate_screen);
    session.wait_for(ADD);
    session.press("q");
    session.wait_for("over 0");
    assert_eq!(session.end(), 0, "{}", session.text());
    session.expect_terminal_as_it_was();
}

#[test]
fn ctrl_z_without_a_shell_is_explained_and_ignored() {
    let folder = Desk::new();
    // The program leads its session.
    let mut session = diagnose("", folder.folder(), (100, 30));
    session.wait_for(ADD);
    session.press("\u{1a}");
    session.wait_for("Ctrl-Z: there is no shell");
    session.press("e");
    session.wait_for("error over speed x current");
    session.leave("qq", 0);
}

#[test]
fn after_a_trip_nothing_is_diagnosed_and_the_status_stays() {
    let fast = "[[sequence]]\nsteps = { levels_v = [95.0, 0.0], hold_s = 1.0 }\n";
    let stiff = PLAIN.replace("bus_v = 120.0", "bus_v = 120.0\nbus_capacitance_f = 1e-3");
    let folder = Desk::new();
    let bench = folder.put("bench.toml", &super::first_move::bench("", fast));
    let emulator = folder.put("emulator.toml", &stiff);
    let arguments = line("run {} --emulator {} --port sim: --out runs", &[&bench, &emulator]);
    let mut session = Session::start(arguments, folder.folder(), (100, 30));
    session.wait_for("SAFETY TRIP");
    session.wait_for("q = quit");
    for key in ["d", "v"] {
        session.press(key);
        session.wait_for("not yet: the diagnosis begins after a completed run");
        session.press("f");
        session.wait_for("FROZEN");
        session.press("f");
        session.wait("the answer gone", |screen| !screen.contents().contains("FROZEN"));
    }
    has(&session.leave("q", 4), &["bus voltage too high"]);
}

#[test]
fn the_mouse_is_an_option_and_a_click_selects() {
    let folder = Desk::new();
    let mut session = diagnose("--mouse", folder.folder(), (100, 30));
    session.wait_for(ADD);
    session.wait_for("▶ ✓ supported   stribeck_friction");
    let row = session.text().lines().position(|row| row.contains("stribeck_friction  "));
    // Counted from one; the row below the selected one, as terminals tell it (SGR).
    let below = row.expect("the list") + 2;
    session.press(&format!("\u{1b}[<0;30;{below}M\u{1b}[<0;30;{below}m"));
    session.wait("another row", |screen| {
        !screen.contents().contains("▶ ✓ supported   stribeck_friction")
    });
    session.leave("q", 0);
    has(&String::from_utf8_lossy(&session.sent), &["\u{1b}[?1000l"]);
}

#[test]
#[cfg(target_os = "linux")]
fn ctrl_z_gives_the_reason_of_its_refusal_while_the_bench_is_at_work() {
    let folder = Desk::new();
    let arguments = line("run --port emulator --seed 7 --out runs", &[]);
    let mut session = Session::start(arguments, folder.folder(), (120, 40));
    session.wait_for("RUNNING");
    session.press("\u{1a}");
    session.wait_for("Ctrl-Z: not while the bench is at work");
    assert!(!is_halted(session.id()));
    session.press(" ");
    session.wait_for("STOPPED");
    session.leave("q", 130);
}

#[test]
fn a_model_is_whole_in_its_file_after_q_and_after_ctrl_c() {
    for (keys, status) in [("wq", 0), ("w\u{3}", 130)] {
        let folder = Desk::new();
        let mut session = diagnose("--output kept.toml", folder.folder(), (100, 30));
        session.wait_for(ADD);
        session.press("a");
        // The answer is there, and the worker looks for the next run.
        session.wait_for("NOTHING MISSING");
        session.leave(keys, status);
        let model = fs::read_to_string(folder.path("kept.toml"));
        // Ctrl-C may come before the file is begun.
        assert!(model.is_ok() || status == 130);
        if let Ok(text) = model {
            has(&text, &["id = \"stribeck_friction\"", "[[history.fitted]]"]);
            assert!(text.ends_with('\n'), "{text}");
        }
    }
}

#[test]
fn a_signal_after_the_screen_ends_the_program() {
    let folder = Desk::new();
    let mut session = diagnose("--html page.html", folder.folder(), (100, 30));
    session.wait_for(ADD);
    session.press("a");
    session.wait_for("NOTHING MISSING");
    session.press("q");
    session.wait("the end of the screen", |screen| !screen.alternate_screen());
    session.signal(Signal::SIGTERM);
    assert_eq!(session.end(), 130, "{}", session.text());
    has(&session.text(), &["interrupted"]);
    assert!(!folder.path("page.html").exists());
}

#[test]
fn a_recorded_run_is_searched_only_after_d() {
    let folder = Desk::new();
    let runs = Runs::hidden();
    for command in ["view {} --holdout {}", "compare {} --holdout {} --screen"] {
        let arguments = line(command, &[&runs.fit, &runs.holdout]);
        let mut session = Session::start(&arguments, folder.folder(), (100, 30));
        session.wait_for("COMPARISON");
        session.wait_for("speed: measured - model");
        session.press("v");
        session.wait_for("run 1 of 2");
        session.press("q");
        session.wait_for("d diagnose");
        lacks(&session.text(), &["supported"]);
        session.press("d");
        session.wait_for(ADD);
        session.wait_for("stribeck_friction");
        session.leave("q", 0);
    }
}
