//! Progress and Ctrl-C as a person at a terminal meets them: the whole program in a pseudo-terminal.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of an integration test are test code"
)]

#[expect(dead_code, reason = "the other tests of the command line use the rest")]
mod program;

use std::fmt::Write as _;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use nix::sys::stat::Mode;
use nix::unistd::{Pid, mkfifo};
use portable_pty::{Child, CommandBuilder, MasterPty, PtySize, native_pty_system};
use program::{command, line};

/// Generous, because tests share the machine; nothing here waits for time to pass.
const PATIENCE: Duration = Duration::from_secs(120);

/// Back to the first column, and nothing to the right of it.
const WIPE: &str = "\r\x1b[K";

/// A record long enough to keep any machine busy for seconds: made-up volts, and a first-order answer to them.
fn long_record(folder: &Path) -> PathBuf {
    let mut text = String::from("time_s,voltage_v,current_a,speed_rad_s\n");
    let (mut speed, mut random) = (0.0_f64, 12_345_u64);
    for k in 0..60_000_u32 {
        random = random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        let noise = f64::from((random >> 40) as u32 & 0xffff) / 65_536.0 - 0.5;
        let volts = if k < 500 {
            0.0
        } else {
            30.0 * f64::from((k / 200 * 7919) % 13) / 6.5 - 30.0
        };
        let current = (volts - 0.3538 * speed) / 1.1;
        speed += 1e-3 * (0.3538 * current - 0.002 * speed) / 0.0045;
        let _ = writeln!(
            text,
            "{},{volts},{},{}",
            f64::from(k) * 1e-3,
            current + 0.1 * noise,
            speed + 0.5 * noise
        );
    }
    let path = folder.join("long.csv");
    std::fs::write(&path, text).unwrap();
    path
}

struct Terminal {
    output: Receiver<Vec<u8>>,
    seen: Vec<u8>,
    keys: Box<dyn Write + Send>,
    child: Box<dyn Child + Send + Sync>,
    _master: Box<dyn MasterPty + Send>,
}

impl Terminal {
    fn start(arguments: &[PathBuf], folder: &Path) -> Self {
        let size = PtySize {
            rows: 24,
            cols: 80,
            pixel_width: 0,
            pixel_height: 0,
        };
        let pair = native_pty_system().openpty(size).unwrap();
        let mut command = CommandBuilder::new(program::BINARY);
        command.args(arguments);
        command.cwd(folder);
        let child = pair.slave.spawn_command(command).unwrap();
        drop(pair.slave);
        let mut reader = pair.master.try_clone_reader().unwrap();
        let (sender, output) = channel();
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(count @ 1..) = reader.read(&mut bytes) {
                if sender.send(bytes[..count].to_vec()).is_err() {
                    break;
                }
            }
        });
        Self {
            output,
            seen: Vec::new(),
            keys: pair.master.take_writer().unwrap(),
            child,
            _master: pair.master,
        }
    }

    fn wait_for(&mut self, text: &str) {
        while !String::from_utf8_lossy(&self.seen).contains(text) {
            match self.output.recv_timeout(PATIENCE) {
                Ok(bytes) => self.seen.extend(bytes),
                Err(why) => panic!(
                    "{text:?} did not come ({why}): {:?}",
                    String::from_utf8_lossy(&self.seen)
                ),
            }
        }
    }

    /// Exit status, and what a person then sees.
    fn end(self) -> (u32, String) {
        let (status, sent) = self.sent();
        let mut screen =
            vt100::Parser::new(24_u16.try_into().unwrap(), 80_u16.try_into().unwrap(), 0);
        screen.process(&sent);
        (status, screen.screen().contents())
    }

    /// Exit status, and every byte that came.
    fn sent(mut self) -> (u32, Vec<u8>) {
        while let Ok(bytes) = self.output.recv_timeout(PATIENCE) {
            self.seen.extend(bytes);
        }
        (self.child.wait().unwrap().exit_code(), self.seen)
    }
}

#[test]
fn ctrl_c_in_a_diagnosis_ends_it_with_130_and_a_clean_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let run = long_record(folder.path());
    let bench = folder.path().join("next.toml");
    let arguments = line("diagnose {} --until-floor --next-bench {}", &[&run, &bench]);
    let mut terminal = Terminal::start(&arguments, folder.path());
    terminal.wait_for("diagnose: ");
    terminal.wait_for(" s");
    terminal.keys.write_all(&[3]).unwrap();
    let (status, screen) = terminal.end();
    assert_eq!(status, 130, "{screen}");
    assert!(screen.contains("error: interrupted"), "{screen}");
    assert!(
        !screen.contains("diagnose: "),
        "the line is left behind: {screen}"
    );
    assert!(!bench.exists());
}

#[test]
fn progress_is_one_line_that_goes_when_the_answer_comes() {
    let folder = tempfile::tempdir().unwrap();
    let record = std::fs::read(long_record(folder.path())).unwrap();
    // A pipe, so that the command waits for its data until the line has been seen, however fast the machine is.
    let run = folder.path().join("pipe.csv");
    mkfifo(&run, Mode::S_IRUSR | Mode::S_IWUSR).unwrap();
    let arguments = line("compare {} --json", &[&run]);
    let mut terminal = Terminal::start(&arguments, folder.path());
    terminal.wait_for("compare: ");
    let written = std::thread::spawn(move || std::fs::write(run, record));
    // The answer is longer than the screen, off which a line left behind would have scrolled: the bytes themselves tell.
    let (status, sent) = terminal.sent();
    written.join().unwrap().unwrap();
    let sent = String::from_utf8_lossy(&sent);
    assert_eq!(status, 0, "{sent}");
    let last = sent.rfind("compare: ").expect("no line was drawn");
    let (drawn, left) = sent.split_at(last);
    assert!(drawn.ends_with(WIPE), "{drawn:?}");
    let end = left.find('\r').expect("nothing follows the line");
    let (line, after) = left.split_at(end);
    assert!(
        !line.contains('{'),
        "the answer stands behind the line: {line:?}"
    );
    assert!(after.starts_with(WIPE), "the line is left behind: {left:?}");
    assert!(after[WIPE.len()..].starts_with('{'), "{after:?}");
}

#[test]
fn without_a_terminal_there_is_no_progress_and_a_signal_ends_it_all_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let run = long_record(folder.path());
    let mut child = command(line("diagnose {} --json --until-floor", &[&run]))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The first message comes after the signals are watched.
    let mut first = [0; 8];
    child
        .stderr
        .as_mut()
        .unwrap()
        .read_exact(&mut first)
        .unwrap();
    kill(
        Pid::from_raw(i32::try_from(child.id()).unwrap()),
        Signal::SIGTERM,
    )
    .unwrap();
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{stderr}");
    assert!(output.stdout.is_empty());
    assert!(stderr.contains("error: interrupted"), "{stderr}");
    assert!(
        !stderr.contains("diagnose: ") && !stderr.contains('\u{1b}'),
        "{stderr}"
    );
}
