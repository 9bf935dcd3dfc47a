//! The whole program in a real pseudo-terminal: the screen as a person sees it, keys as a person presses them.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of an integration test are test code"
)]

use std::io::{Read, Write};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use portable_pty::{Child, CommandBuilder, PtySize, native_pty_system};

/// Generous, because tests share the machine; nothing here waits for time to pass.
const PATIENCE: Duration = Duration::from_secs(60);

struct Session {
    screen: vt100::Parser,
    output: Receiver<Vec<u8>>,
    keys: Box<dyn Write + Send>,
    child: Box<dyn Child + Send + Sync>,
    _master: Box<dyn portable_pty::MasterPty + Send>,
}

impl Session {
    fn start(arguments: &[&str], folder: &std::path::Path) -> Self {
        let size = PtySize {
            rows: 40,
            cols: 120,
            pixel_width: 0,
            pixel_height: 0,
        };
        let pair = native_pty_system().openpty(size).unwrap();
        let mut command = CommandBuilder::new(env!("CARGO_BIN_EXE_drivebench"));
        command.args(arguments);
        command.cwd(folder);
        command.env("TERM", "xterm-256color");
        let child = pair.slave.spawn_command(command).unwrap();
        drop(pair.slave);
        let mut reader = pair.master.try_clone_reader().unwrap();
        let keys = pair.master.take_writer().unwrap();
        let (sender, output) = channel();
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(count @ 1..) = reader.read(&mut bytes) {
                if sender.send(bytes[..count].to_vec()).is_err() {
                    break;
                }
            }
        });
        let (rows, columns) = (40.try_into().unwrap(), 120.try_into().unwrap());
        Self {
            screen: vt100::Parser::new(rows, columns, 0),
            output,
            keys,
            child,
            _master: pair.master,
        }
    }

    fn text(&self) -> String {
        self.screen.screen().contents()
    }

    /// Reads on until the screen is as wanted.
    fn wait(&mut self, what: &str, wanted: impl Fn(&vt100::Screen) -> bool) {
        while !wanted(self.screen.screen()) {
            match self.output.recv_timeout(PATIENCE) {
                Ok(bytes) => self.screen.process(&bytes),
                Err(RecvTimeoutError::Timeout) => {
                    panic!("waited in vain for {what}:\n{}", self.text())
                }
                Err(RecvTimeoutError::Disconnected) => {
                    panic!("the program ended before {what}:\n{}", self.text())
                }
            }
        }
    }

    fn wait_for(&mut self, text: &str) {
        self.wait(text, |screen| screen.contents().contains(text));
    }

    fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).unwrap();
        self.keys.flush().unwrap();
    }

    /// Exit status, after everything that was still to be read.
    fn end(&mut self) -> u32 {
        while let Ok(bytes) = self.output.recv_timeout(PATIENCE) {
            self.screen.process(&bytes);
        }
        self.child.wait().unwrap().exit_code()
    }
}

#[test]
fn space_stops_the_run_and_q_gives_the_terminal_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::start(&["run", "--port", "emulator"], folder.path());
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
    let mut session = Session::start(&["run", "--port", "emulator"], folder.path());
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
