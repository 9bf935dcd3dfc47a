//! The program in a real pseudo-terminal of any size: the screen as a person sees it, keys as a person presses them.

use std::io::{Read, Write};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use portable_pty::{Child, CommandBuilder, PtySize, native_pty_system};

/// Generous, because tests share the machine; nothing here waits for time to pass.
const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) struct Session {
    pub(crate) screen: vt100::Parser,
    output: Receiver<Vec<u8>>,
    keys: Box<dyn Write + Send>,
    pub(crate) child: Box<dyn Child + Send + Sync>,
    /// Modes of the terminal before the program was started.
    modes: String,
    master: Box<dyn portable_pty::MasterPty + Send>,
}

impl Session {
    /// `(columns, rows)`.
    pub(crate) fn start(
        arguments: &[&str],
        folder: &std::path::Path,
        (columns, rows): (u16, u16),
    ) -> Self {
        let size = PtySize {
            rows,
            cols: columns,
            pixel_width: 0,
            pixel_height: 0,
        };
        let pair = native_pty_system().openpty(size).unwrap();
        let mut command = CommandBuilder::new(env!("CARGO_BIN_EXE_drivebench"));
        command.args(arguments);
        command.cwd(folder);
        command.env("TERM", "xterm-256color");
        let modes = modes(pair.master.as_ref());
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
        let (rows, columns) = (rows.try_into().unwrap(), columns.try_into().unwrap());
        Self {
            screen: vt100::Parser::new(rows, columns, 0),
            output,
            keys,
            child,
            modes,
            master: pair.master,
        }
    }

    pub(crate) fn text(&self) -> String {
        self.screen.screen().contents()
    }

    /// Reads on until the screen is as wanted.
    pub(crate) fn wait(&mut self, what: &str, wanted: impl Fn(&vt100::Screen) -> bool) {
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

    pub(crate) fn wait_for(&mut self, text: &str) {
        self.wait(text, |screen| screen.contents().contains(text));
    }

    pub(crate) fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).unwrap();
        self.keys.flush().unwrap();
    }

    /// Exit status, after everything that was still to be read.
    pub(crate) fn end(&mut self) -> u32 {
        while let Ok(bytes) = self.output.recv_timeout(PATIENCE) {
            self.screen.process(&bytes);
        }
        self.child.wait().unwrap().exit_code()
    }

    /// Closes the terminal under the program; its exit status.
    #[allow(dead_code, reason = "not every test file closes terminals")]
    pub(crate) fn close(self) -> u32 {
        let mut child = self.child;
        // The reader's thread ends with the next frame, for which nobody waits any more.
        drop((self.output, self.keys, self.master));
        child.wait().unwrap().exit_code()
    }

    /// The shell gets the terminal as it was: its modes, its own screen, a cursor.
    #[track_caller]
    pub(crate) fn expect_terminal_as_it_was(&self) {
        assert_eq!(modes(self.master.as_ref()), self.modes);
        assert!(!self.screen.screen().alternate_screen());
        assert!(!self.screen.screen().hide_cursor());
    }
}

fn modes(master: &dyn portable_pty::MasterPty) -> String {
    format!("{:?}", master.get_termios().unwrap())
}
