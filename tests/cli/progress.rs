//! Progress and Ctrl-C as a person at a terminal meets them: the whole program in a pseudo-terminal.

use crate::kit::prelude::*;
use std::io::Read;

use crate::kit::motor_log::noise;
use nix::sys::stat::Mode;
use nix::unistd::mkfifo;

/// Back to the first column, and nothing to the right of it.
const WIPE: &str = "\r\x1b[K";

/// A record long enough to keep any machine busy for seconds: made-up volts, and a first-order answer to them.
fn long_record(folder: &Path) -> PathBuf {
    let mut text = String::from("time_s,voltage_v,current_a,speed_rad_s\n");
    let (mut speed, mut noise) = (0.0_f64, noise(12_345));
    for k in 0..60_000_u32 {
        let volts =
            if k < 500 { 0.0 } else { 30.0 * f64::from((k / 200 * 7919) % 13) / 6.5 - 30.0 };
        let current = (volts - 0.3538 * speed) / 1.1;
        speed += 1e-3 * (0.3538 * current - 0.002 * speed) / 0.0045;
        let _ = writeln!(
            text,
            "{},{volts},{},{}",
            f64::from(k) * 1e-3,
            current + noise(0.03),
            speed + noise(0.15)
        );
    }
    let path = folder.join("long.csv");
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn ctrl_c_in_a_diagnosis_ends_it_with_130_and_a_clean_terminal() {
    let folder = Desk::new();
    let run = long_record(folder.folder());
    let bench = folder.path("next.toml");
    let arguments = line("diagnose {} --until-floor --next-bench {}", &[&run, &bench]);
    let mut session = Session::start(&arguments, folder.folder(), (80, 24));
    session.wait_for_sent("diagnose: ");
    session.wait_for_sent(" s");
    session.press("\u{3}");
    let (status, screen) = (session.end(), session.text());
    assert_eq!(status, 130, "{screen}");
    has(&screen, &["error: interrupted"]);
    assert!(!screen.contains("diagnose: "), "the line is left behind: {screen}");
    assert!(!bench.exists());
}

#[test]
fn progress_is_one_line_that_goes_when_the_answer_comes() {
    let folder = Desk::new();
    let record = fs::read(long_record(folder.folder())).unwrap();
    // A pipe, so that the command waits for its data until the line has been read, however fast the machine is.
    let run = folder.path("pipe.csv");
    mkfifo(&run, Mode::S_IRUSR | Mode::S_IWUSR).unwrap();
    let arguments = line("compare {} --json", &[&run]);
    let mut session = Session::start(&arguments, folder.folder(), (80, 24));
    session.wait_for_sent("compare: ");
    let written = std::thread::spawn(move || fs::write(run, record));
    // The answer is longer than the screen, off which a line left behind would have scrolled: the bytes themselves tell.
    let status = session.end();
    written.join().unwrap().unwrap();
    let sent = String::from_utf8_lossy(&session.sent);
    assert_eq!(status, 0, "{sent}");
    let (drawn, left) = sent.split_at(sent.rfind("compare: ").expect("no line was drawn"));
    assert!(drawn.ends_with(WIPE), "{drawn:?}");
    let (line, after) = left.split_at(left.find('\r').expect("nothing follows the line"));
    assert!(!line.contains('{'), "the answer stands behind the line: {line:?}");
    assert!(after.starts_with(WIPE), "the line is left behind: {left:?}");
    assert!(after[WIPE.len()..].starts_with('{'), "{after:?}");
}

#[test]
fn without_a_terminal_nothing_is_drawn_and_a_signal_ends_it() {
    let folder = Desk::new();
    let run = long_record(folder.folder());
    let mut process = Process::start(&line("diagnose {} --json --until-floor", &[&run]));
    // The first message comes after the signals are watched.
    let stderr = process.0.stderr.as_mut().unwrap();
    stderr.read_exact(&mut [0; 8]).unwrap();
    process.signal(Signal::SIGTERM);
    let done = process.end().expect(130);
    let stderr = done.stderr;
    assert!(done.stdout.is_empty());
    has(&stderr, &["error: interrupted"]);
    assert!(!stderr.contains('\u{1b}'), "{stderr}");
}
