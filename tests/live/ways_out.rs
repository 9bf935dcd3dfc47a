//! Every way out of a run with its motor on, over real pseudo-terminals: the drive in a process of its own is the witness.
//! It got its stop, and its watchdog did not have to act.

use std::process::{Command, Stdio};
use std::time::Duration;

use nix::sys::termios::{FlowArg, tcflow};

use crate::kit::prelude::*;
use crate::kit::process::{FAULT, RUNNING, STATE, WATCHDOG_TRIPPED, telemetry};
use crate::screen::commands;

/// A drive in its own process, whose watchdog leaves a loaded machine some time, and a bench that runs for long.
struct Lab {
    desk: Desk,
    drive: Emulator,
}

impl Lab {
    fn new() -> Self {
        Self::with("levels_v = [40.0], hold_s = 50.0")
    }

    fn with(steps: &str) -> Self {
        let desk = Desk::new();
        let bench = BENCH
            .replace("link_silence_s = 0.45", "link_silence_s = 0.95")
            .replace("time_s = 30.0", "time_s = 60.0")
            // A busy machine keeps this rate as well.
            .replace("rate_hz = 100.0", "rate_hz = 50.0");
        let (head, _) = bench.split_once("[[sequence]]").unwrap();
        let sequence = format!(
            "{head}[[sequence]]\nstandstill = {{ seconds = 0.3 }}\n[[sequence]]\nsteps = {{ {steps} }}\n"
        );
        desk.put("bench.toml", &sequence);
        let drive = PLAIN.replace("watchdog_ms = 500", "watchdog_ms = 1000");
        let config = desk.put("drive.toml", &drive);
        let drive = Emulator::on("modbus-rtu", &desk.path("drive"), "{}", &[&config]);
        Self { desk, drive }
    }

    fn path(&self) -> &Path {
        self.desk.folder()
    }

    fn arguments(&self, command: &str) -> [String; 4] {
        [command.to_owned(), "bench.toml".to_owned(), "--port".to_owned(), self.drive.port()]
    }

    fn on_screen(&self, command: &str) -> Session {
        let mut session = Session::start(self.arguments(command), self.path(), (120, 40));
        session.wait_for(" SIM  RUNNING");
        session.wait("a motor that turns", |_| self.turns());
        session
    }

    /// A run whose motor turns.
    fn headless(&self) -> Process {
        self.desk.turning(|| {
            let mut command = Command::new(BINARY);
            command.args(self.arguments("run")).arg("--headless");
            self.spawn(command)
        })
    }

    fn spawn(&self, mut command: Command) -> Process {
        command.current_dir(self.path()).stdin(Stdio::null());
        Process::of(command)
    }

    fn turns(&self) -> bool {
        self.desk.turns(60.0)
    }

    /// By the drive's own status, some time after its watchdog would have acted.
    #[track_caller]
    fn expect_stopped(&self, by: &str) {
        std::thread::sleep(Duration::from_millis(1200));
        let words = wait_for("an answer", || telemetry(&self.drive.port()));
        assert_ne!(words[0] & STATE, RUNNING, "{by}: status {:#x}", words[0]);
        assert_eq!(words[0] & WATCHDOG_TRIPPED, 0, "{by}: the watchdog stopped it");
        assert_eq!(words[1], 0, "{by}: fault");
    }
}

#[test]
fn a_closed_terminal_stops_the_motor_with_status_130() {
    at_once(["run", "commission", "speed"], |command| {
        let lab = Lab::new();
        assert_eq!(lab.on_screen(command).close(), 130, "{command}");
        lab.expect_stopped(command);
        if command == "run" {
            let manifest = lab.desk.read("manifest.json");
            has(&manifest, &["\"interrupted\"", "\"finished\": true"]);
        }
    });
}

/// A terminal that takes nothing for a while, as one behind a slow line: the bench goes on, row by row.
fn a_terminal_that_takes_nothing_for_a_while_holds_up_nothing() {
    const BLOCKED_ROWS: usize = 90;
    let lab = Lab::with("levels_v = [40.0, -40.0, 0.0], hold_s = 1.5");
    let mut session = lab.on_screen("run");
    let rows = || commands(&lab.desk).len();
    let terminal = session.terminal();
    tcflow(&terminal, FlowArg::TCOOFF).unwrap();
    let before = rows();
    // The last chunk may still be on its way; then nothing comes any more.
    let seen = wait_for("rows while nothing is drawn", || {
        session.now();
        (rows() >= before + BLOCKED_ROWS / 3).then_some(session.sent.len())
    });
    wait_for("more rows", || {
        session.now();
        (rows() >= before + BLOCKED_ROWS).then_some(())
    });
    assert_eq!(session.sent.len(), seen, "the terminal does not respond");
    tcflow(&terminal, FlowArg::TCOON).unwrap();
    drop(terminal);
    session.wait_for("DONE");
    session.leave("q", 0);
    lab.expect_stopped("a slow terminal");
    let times = column(&lab.desk.read("samples.csv"), "time_s");
    // Those of the time in which nothing was drawn are among them, in their order.
    assert!(times.len() >= before + BLOCKED_ROWS, "{} rows", times.len());
    assert!(times.windows(2).all(|pair| pair[0] < pair[1]), "{times:?}");
}

fn a_terminal_of_one_cell_holds_up_nothing() {
    const SMALL_ROWS: usize = 90;
    let lab = Lab::with("levels_v = [40.0, -40.0, 0.0], hold_s = 1.5");
    let mut session = lab.on_screen("run");
    session.resize((1, 1));
    let before = commands(&lab.desk).len();
    wait_for("rows with a terminal of one cell", || {
        session.now();
        (commands(&lab.desk).len() >= before + SMALL_ROWS).then_some(())
    });
    session.resize((120, 40));
    session.wait_for("DONE");
    session.press("q");
    assert_eq!(session.end(), 0, "{}", session.text());
    lab.expect_stopped("a small terminal");
}

#[test]
fn signals_on_the_screen_stop_the_motor_with_status_130() {
    at_once([Signal::SIGQUIT, Signal::SIGHUP, Signal::SIGUSR1], |signal| {
        let lab = Lab::new();
        let mut session = lab.on_screen("run");
        session.signal(signal);
        assert_eq!(session.end(), 130, "{signal}: {}", session.text());
        session.expect_terminal_as_it_was();
        lab.expect_stopped(signal.as_str());
    });
}

#[test]
fn signals_without_a_screen_stop_the_motor_with_status_130() {
    let signals = [
        Signal::SIGQUIT,
        Signal::SIGUSR1,
        Signal::SIGUSR2,
        Signal::SIGALRM,
        Signal::SIGPIPE,
        Signal::SIGTSTP,
        #[cfg(target_os = "linux")]
        Signal::SIGPWR,
    ];
    at_once(signals, |signal| {
        let lab = Lab::new();
        let run = lab.headless();
        // As the terminal halts a background job.
        run.signal(Signal::SIGTTOU);
        run.signal(Signal::SIGTTIN);
        run.signal(signal);
        run.end().fails(130, &["stopped before"]);
        lab.expect_stopped(signal.as_str());
    });
}

#[test]
fn a_halted_process_is_stopped_by_the_watchdog_for_good() {
    let lab = Lab::new();
    let run = lab.headless();
    run.signal(Signal::SIGSTOP);
    // Beyond the watchdog of the drive, 1 s.
    std::thread::sleep(Duration::from_millis(2500));
    run.signal(Signal::SIGCONT);
    let done = run.end();
    assert!([3, 4].contains(&done.status), "{}", done.stderr);
    let words = wait_for("an answer", || telemetry(&lab.drive.port()));
    assert_eq!(words[0] & STATE, FAULT, "status {:#x}", words[0]);
    assert_ne!(words[0] & WATCHDOG_TRIPPED, 0, "status {:#x}", words[0]);
}

/// Whatever it would like to say: nobody reads it any more, and that neither ends the program nor holds it up.
fn a_run_that_nobody_reads_any_more_ends_its_motor_all_the_same() {
    let lab = Lab::new();
    let mut run = lab.headless();
    drop((run.0.stdout.take(), run.0.stderr.take()));
    run.signal(Signal::SIGTERM);
    assert_eq!(wait_for("the end", || run.0.try_wait().unwrap()).code(), Some(130));
    lab.expect_stopped("closed pipes");
}

/// In parallel, since they wait most of the time.
#[test]
fn a_reader_that_stalls_or_leaves_holds_up_nothing() {
    let tests: [fn(); 3] = [
        a_terminal_that_takes_nothing_for_a_while_holds_up_nothing,
        a_terminal_of_one_cell_holds_up_nothing,
        a_run_that_nobody_reads_any_more_ends_its_motor_all_the_same,
    ];
    at_once(tests, |test| test());
}

/// A limit on the size of files is a disk that is full in the middle of a run.
#[test]
fn a_run_on_a_full_disk_goes_on_and_prints_its_result() {
    let lab = Lab::with("levels_v = [40.0, -40.0, 0.0], hold_s = 2.0");
    let mut command = Command::new("sh");
    // Blocks of 512 bytes: the samples outgrow them.
    command.args(["-c", "ulimit -f 28; exec \"$0\" \"$@\"", BINARY]);
    command.args(lab.arguments("run")).arg("--headless");
    let done = lab.spawn(command).end().expect(6);
    let error = done.error();
    has(&error, &["record could not be kept"]);
    has(&done.stderr, &["the run goes on"]);
    has(&done.stdout, &["DONE: ", "back_emf"]);
    lab.expect_stopped("a full disk");
    let manifest = lab.desk.read("manifest.json");
    has(&manifest, &["\"finished\": false"]);
    // What there was room for is there, row by row.
    let opened = call("identify {} --json", &[&lab.desk.run()]);
    assert!(opened.status == 0 || opened.status == 5, "{}", opened.stderr);
}

#[test]
fn a_deleted_folder_is_reported_and_made_again() {
    let lab = Lab::with("levels_v = [40.0, 0.0], hold_s = 1.5");
    let run = lab.headless();
    // At once: while it is emptied file by file, the recorder may make it again.
    let gone = lab.path().join("gone");
    fs::rename(lab.desk.run(), &gone).unwrap();
    fs::remove_dir_all(gone).unwrap();
    let done = run.end().expect(0);
    has(&done.stderr, &["was deleted or renamed"]);
    has(&lab.desk.read("manifest.json"), &["\"finished\": true"]);
    let events = lab.desk.read("events.jsonl");
    has(&events, &["\"event\":\"record\"", "\"to\":\"armed\""]);
    lab.expect_stopped("a folder that is gone");
}
