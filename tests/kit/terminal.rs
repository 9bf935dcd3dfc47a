//! The program in a real pseudo-terminal of any size: the screen as a person sees it, keys as a person presses them.

use std::ffi::OsStr;
use std::io::{Read, Write};
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use portable_pty::{Child, CommandBuilder, MasterPty, PtyPair, PtySize, native_pty_system};

/// Generous, because tests share the machine; nothing here waits for time to pass.
const PATIENCE: Duration = Duration::from_secs(120);

pub(crate) struct Session {
    pub(crate) screen: vt100::Parser,
    /// Every byte that came.
    pub(crate) sent: Vec<u8>,
    child: Box<dyn Child + Send + Sync>,
    /// Modes of the terminal before the program was started.
    modes: String,
    /// Until it is hung up.
    end: Option<End>,
}

/// The other end of the terminal.
struct End {
    output: Receiver<Vec<u8>>,
    keys: Box<dyn Write + Send>,
    master: Box<dyn MasterPty + Send>,
    reader: JoinHandle<()>,
}

impl Session {
    /// The binary on `(columns, rows)`.
    pub(crate) fn start(
        arguments: impl IntoIterator<Item = impl AsRef<OsStr>>,
        folder: &Path,
        size: (u16, u16),
    ) -> Self {
        Self::of(super::BINARY, arguments, folder, size)
    }

    pub(crate) fn of(
        program: &str,
        arguments: impl IntoIterator<Item = impl AsRef<OsStr>>,
        folder: &Path,
        (cols, rows): (u16, u16),
    ) -> Self {
        let size = PtySize { rows, cols, ..PtySize::default() };
        let pair = native_pty_system().openpty(size);
        let PtyPair { slave, master } = pair.expect("a pseudo-terminal");
        let modes = modes(master.as_ref());
        let mut command = CommandBuilder::new(program);
        command.args(arguments);
        command.cwd(folder);
        command.env("TERM", "xterm-256color");
        let child = slave.spawn_command(command).expect("it starts");
        drop(slave);
        let mut source = master.try_clone_reader().unwrap();
        let keys = master.take_writer().unwrap();
        let (sender, output) = channel();
        let reader = std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(count @ 1..) = source.read(&mut bytes) {
                if sender.send(bytes[..count].to_vec()).is_err() {
                    break;
                }
            }
        });
        let [rows, cols] = [rows, cols].map(|count| count.try_into().expect("more than none"));
        Self {
            screen: vt100::Parser::new(rows, cols, 0),
            sent: Vec::new(),
            child,
            modes,
            end: Some(End { output, keys, master, reader }),
        }
    }

    pub(crate) fn text(&self) -> String {
        self.screen.screen().contents()
    }

    fn other(&self) -> &End {
        self.end.as_ref().expect("it is not hung up")
    }

    fn take(&mut self, bytes: &[u8]) {
        self.screen.process(bytes);
        self.sent.extend(bytes);
    }

    /// The text after everything that has come so far.
    pub(crate) fn now(&mut self) -> String {
        while let Some(bytes) = self.end.as_ref().and_then(|end| end.output.try_recv().ok()) {
            self.take(&bytes);
        }
        self.text()
    }

    fn read_until(&mut self, what: &str, wanted: impl Fn(&Self) -> bool) {
        while !wanted(self) {
            match self.other().output.recv_timeout(PATIENCE) {
                Ok(bytes) => self.take(&bytes),
                Err(RecvTimeoutError::Timeout) => {
                    panic!("waited in vain for {what}:\n{}", self.text())
                }
                Err(RecvTimeoutError::Disconnected) => {
                    panic!("the program ended before {what}:\n{}", self.text())
                }
            }
        }
    }

    /// Reads on until the screen is as wanted.
    pub(crate) fn wait(&mut self, what: &str, wanted: impl Fn(&vt100::Screen) -> bool) {
        self.read_until(what, |session| wanted(session.screen.screen()));
    }

    pub(crate) fn wait_for(&mut self, text: &str) {
        self.wait(text, |screen| screen.contents().contains(text));
    }

    /// Reads on until this has been sent, even if it is wiped away again.
    pub(crate) fn wait_for_sent(&mut self, text: &str) {
        self.read_until(text, |session| String::from_utf8_lossy(&session.sent).contains(text));
    }

    pub(crate) fn id(&self) -> u32 {
        self.child.process_id().unwrap()
    }

    /// The program's side of the terminal.
    #[cfg(target_os = "linux")]
    pub(crate) fn terminal(&self) -> std::fs::File {
        use std::os::unix::fs::OpenOptionsExt as _;
        let mut options = std::fs::OpenOptions::new();
        // Never as the terminal of the test itself.
        options.read(true).custom_flags(nix::libc::O_NOCTTY);
        let path = format!("/proc/{}/fd/1", self.id());
        options.open(path).expect("the program has a terminal")
    }

    /// The terminal has another number of columns and rows from now on.
    pub(crate) fn resize(&mut self, (cols, rows): (u16, u16)) {
        let size = PtySize { rows, cols, ..PtySize::default() };
        self.other().master.resize(size).expect("a terminal");
        let [rows, cols] = [rows, cols].map(|count| count.try_into().expect("more than none"));
        self.screen.set_size(rows, cols);
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.id().cast_signed()), signal).unwrap();
    }

    pub(crate) fn press(&mut self, keys: &str) {
        self.try_press(keys).unwrap();
    }

    /// Nobody hears it where the terminal is hung up.
    pub(crate) fn try_press(&mut self, keys: &str) -> std::io::Result<()> {
        let Some(end) = &mut self.end else {
            return Ok(());
        };
        end.keys.write_all(keys.as_bytes())?;
        end.keys.flush()
    }

    /// Exit status where the program has ended; -1: by a signal.
    pub(crate) fn ended(&mut self) -> Option<i32> {
        let status = self.child.try_wait().expect("a child can be waited for")?;
        let of_signal = status.signal().map(|_| -1);
        Some(of_signal.unwrap_or_else(|| status.exit_code().cast_signed()))
    }

    /// Exit status, after everything that was still to be read.
    pub(crate) fn end(&mut self) -> u32 {
        while let Ok(bytes) = self.other().output.recv_timeout(PATIENCE) {
            self.take(&bytes);
        }
        self.child.wait().unwrap().exit_code()
    }

    /// Takes the terminal away from the program. The writer says goodbye with a line feed and an end of file.
    pub(crate) fn hang_up(&mut self) {
        self.now();
        if let Some(End { output, keys, master, reader }) = self.end.take() {
            // The reader ends with the next frame, for which nobody waits any more.
            drop(output);
            let _ = reader.join();
            drop((keys, master));
        }
    }

    /// Closes the terminal under the program; its exit status.
    pub(crate) fn close(mut self) -> u32 {
        self.hang_up();
        self.child.wait().unwrap().exit_code()
    }

    /// The keys end the program with this status, and the terminal is as it was; what is left on it.
    #[track_caller]
    pub(crate) fn leave(&mut self, keys: &str, status: u32) -> String {
        self.press(keys);
        assert_eq!(self.end(), status, "{}", self.text());
        self.expect_terminal_as_it_was();
        self.text()
    }

    /// The shell gets the terminal as it was: its modes, its own screen, a cursor.
    #[track_caller]
    pub(crate) fn expect_terminal_as_it_was(&self) {
        assert_eq!(modes(self.other().master.as_ref()), self.modes);
        assert!(!self.screen.screen().alternate_screen());
        assert!(!self.screen.screen().hide_cursor());
    }
}

fn modes(master: &dyn MasterPty) -> String {
    format!("{:?}", master.get_termios().unwrap())
}
