//! Acts on a command while it runs, done for real, and when they were done by the clock that its drive keeps its journal in.
//!
//! ```text
//! journal of the drive --> the motor turns --> [ act ] --> what the command said and how it ended
//! this process, the command and the drive watched --> how long the machine stood still, which says nothing of any of them
//! ```

use std::collections::{BTreeSet, HashMap};
use std::fs::{self, File};
use std::io::{self, PipeReader, Read, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use nix::sys::signal::Signal;
use serde_json::{Value, json};

use super::line::{Carries, Line};
use super::own_drive::OwnDrive;
use super::process::{self, Done, End, monotonic_s};
use crate::emulator::JournalRow;
use crate::workflow::suite::{Act, HostAct, figures};

/// Between two looks at the command and at what its drive notes.
const LOOK: Duration = Duration::from_millis(2);
/// Between the two signals of one who insists, s.
const INSISTS_S: f64 = 0.05;
/// A machine that kept one of us from running for so long has stood still, s.
pub(super) const STOOD_STILL_S: f64 = 0.02;
/// Between two looks at how long threads waited for a processor, s.
const WAITS_S: f64 = 0.02;
/// Between two keys, s.
const KEYS_S: f64 = 0.5;
/// What stood still so long before the act still counts, s.
const BEFORE_S: f64 = 1.0;
/// With one of these a command says that its link is lost.
const LOST: [&str; 3] = ["link silent", "link is gone", "link lost"];
/// Status of a command that SIGKILL has ended, as a shell gives it.
const KILLED: u8 = 137;
/// Columns and rows of a screen.
const SCREEN: (u16, u16) = (120, 40);
/// A user that owns nothing.
const NOBODY: u32 = 65_534;

/// What a command is started in, and what may be done to it.
pub(super) struct Stage<'a> {
    pub(super) act: HostAct,
    pub(super) drive: &'a mut OwnDrive,
    /// Between the two, where the act is on the line.
    pub(super) line: Option<&'a Line>,
    /// Starts another drive, as somebody plugs it in.
    pub(super) other: &'a mut dyn FnMut() -> io::Result<OwnDrive>,
    /// Another run on the same port.
    pub(super) second: Command,
    /// Where the command puts its runs.
    pub(super) runs: &'a Path,
    /// Runs that are not of this command.
    pub(super) before: &'a BTreeSet<PathBuf>,
    pub(super) folder: &'a Path,
    pub(super) timeout_s: f64,
    pub(super) stop: &'a AtomicBool,
}

/// What came of it.
pub(super) struct Came {
    pub(super) done: Done,
    /// When it was done.
    pub(super) act_s: Option<f64>,
    /// What is found under `host` in the result.
    pub(super) found: Value,
    /// Longest time for which this machine stood still around the act, s.
    pub(super) stood_still_s: f64,
}

/// What the command prints to.
enum Outlet {
    Pipes([(Option<PipeReader>, File); 2]),
    #[cfg(target_os = "linux")]
    Screen {
        terminal: Option<crate::emulator::PtyPort>,
        copy: File,
    },
}

impl Outlet {
    /// Takes what is there.
    fn read(&mut self) {
        let mut bytes = [0; 4096];
        match self {
            Self::Pipes(pipes) => {
                for (pipe, copy) in pipes {
                    while let Some(Ok(count @ 1..)) =
                        pipe.as_mut().map(|pipe| pipe.read(&mut bytes))
                    {
                        // The evidence of a case; who has no room for it has no room for a suite.
                        let _ = copy.write_all(&bytes[..count]);
                    }
                }
            }
            #[cfg(target_os = "linux")]
            Self::Screen { terminal, copy } => {
                use crate::emulator::Port as _;
                while let Some(Ok(count @ 1..)) = terminal
                    .as_mut()
                    .map(|terminal| terminal.read_within(&mut bytes, Duration::ZERO))
                {
                    let _ = copy.write_all(&bytes[..count]);
                }
            }
        }
    }

    /// Nobody reads it from now on.
    fn close(&mut self) {
        match self {
            Self::Pipes(pipes) => {
                for (pipe, _) in pipes {
                    *pipe = None;
                }
            }
            #[cfg(target_os = "linux")]
            Self::Screen { terminal, .. } => *terminal = None,
        }
    }

    fn press(&mut self, key: u8) {
        match self {
            Self::Pipes(_) => {}
            #[cfg(target_os = "linux")]
            Self::Screen { terminal, .. } => {
                use crate::emulator::Port as _;
                if let Some(terminal) = terminal {
                    terminal.write(&[key]);
                }
            }
        }
    }

    fn resize(&self, columns: u16, rows: u16) -> io::Result<()> {
        match self {
            Self::Pipes(_) => Ok(()),
            #[cfg(target_os = "linux")]
            Self::Screen { terminal, .. } => match terminal {
                Some(terminal) => resize(terminal, columns, rows),
                None => Ok(()),
            },
        }
    }
}

#[cfg(target_os = "linux")]
fn resize(terminal: &crate::emulator::PtyPort, columns: u16, rows: u16) -> io::Result<()> {
    let size = rustix::termios::Winsize {
        ws_row: rows,
        ws_col: columns,
        ws_xpixel: 0,
        ws_ypixel: 0,
    };
    Ok(rustix::termios::tcsetwinsize(terminal.as_fd(), size)?)
}

/// Starts `command` with a screen, or with pipes.
fn start(
    mut command: Command,
    has_screen: bool,
    folder: &Path,
    [stdout, stderr]: [&Path; 2],
) -> io::Result<(Child, Outlet)> {
    if !has_screen {
        let ((out, to_out), (err, to_err)) = (io::pipe()?, io::pipe()?);
        for pipe in [&out, &err] {
            process::do_not_block(pipe)?;
        }
        command.stdin(Stdio::null()).stdout(to_out).stderr(to_err);
        let pipes = [
            (Some(out), File::create(stdout)?),
            (Some(err), File::create(stderr)?),
        ];
        return Ok((process::start(command)?, Outlet::Pipes(pipes)));
    }
    on_screen(command, folder, stderr)
}

#[cfg(target_os = "linux")]
fn on_screen(mut command: Command, folder: &Path, copy: &Path) -> io::Result<(Child, Outlet)> {
    let terminal = crate::emulator::PtyPort::open()?;
    resize(&terminal, SCREEN.0, SCREEN.1)?;
    let name = folder.join("screen.pty");
    terminal.publish(&name)?;
    let end = || {
        use std::os::unix::fs::OpenOptionsExt as _;
        let mut options = File::options();
        options.read(true).write(true);
        options
            .custom_flags(nix::fcntl::OFlag::O_NOCTTY.bits())
            .open(&name)
    };
    command.stdin(end()?).stdout(end()?).stderr(end()?);
    command.env("TERM", "xterm-256color");
    let child = process::start_at_terminal(command)?;
    let outlet = Outlet::Screen {
        terminal: Some(terminal),
        copy: File::create(copy)?,
    };
    Ok((child, outlet))
}

#[cfg(not(target_os = "linux"))]
fn on_screen(_: Command, _: &Path, _: &Path) -> io::Result<(Child, Outlet)> {
    Err(io::ErrorKind::Unsupported.into())
}

/// What is done before the command begins.
pub(super) fn prepare(act: Act, command: &mut Command, port: &Path, runs: &Path) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    use std::os::unix::process::CommandExt as _;
    let allow =
        |path: &Path, mode: u32| fs::set_permissions(path, fs::Permissions::from_mode(mode));
    // Nothing is forbidden to root, and only root can be another.
    let is_root = rustix::process::geteuid().is_root();
    let (port_mode, runs_mode) = match act {
        Act::PortForbidden => (0o000, 0o777),
        Act::OutForbidden => (0o666, 0o555),
        _ => return Ok(()),
    };
    fs::create_dir_all(runs)?;
    allow(port, port_mode)?;
    allow(runs, runs_mode)?;
    if is_root {
        command.uid(NOBODY).gid(NOBODY);
    }
    Ok(())
}

/// Runs `command` to its end, with the act at its time.
pub(super) fn run(stage: Stage<'_>, command: Command, files: [&Path; 2]) -> io::Result<Came> {
    let begin_s = monotonic_s();
    let has_screen = stage.act.act.has_screen();
    let (child, outlet) = start(command, has_screen, stage.folder, files)?;
    let (timeout_s, stop, act) = (stage.timeout_s, stage.stop, stage.act);
    let mut watched = Watched {
        begin_s,
        outlet,
        is_read: true,
        act_s: None,
        pending: None,
        second: None,
        reader: None,
        other: None,
        lost_s: None,
        stderr: files[1].to_owned(),
        pressed_s: begin_s,
        gaps: Vec::new(),
        last_s: begin_s,
        waits: HashMap::new(),
        waited_s: begin_s,
        stage,
    };
    if act.act.is_before() {
        watched.act_s = Some(begin_s);
    }
    let mut done = process::attend(child, timeout_s, stop, LOOK, |child| watched.look(child))?;
    if done.end == End::Killed && act.act == Act::Kill && watched.act_s.is_some() {
        done.end = End::Status(KILLED);
    }
    watched.came(done)
}

struct Watched<'a> {
    stage: Stage<'a>,
    begin_s: f64,
    outlet: Outlet,
    is_read: bool,
    act_s: Option<f64>,
    /// What is still to be done, and when, s.
    pending: Option<(f64, Act)>,
    second: Option<Child>,
    reader: Option<Child>,
    other: Option<OwnDrive>,
    /// When the command said that its link is lost.
    lost_s: Option<f64>,
    stderr: PathBuf,
    pressed_s: f64,
    /// From when one of us was kept from running, and for how long, s.
    gaps: Vec<(f64, f64)>,
    last_s: f64,
    /// What each thread had waited for a processor at the last look, ns.
    waits: HashMap<PathBuf, u64>,
    waited_s: f64,
}

impl Watched<'_> {
    fn look(&mut self, child: Option<&Child>) -> io::Result<()> {
        let now_s = monotonic_s();
        if self.is_read {
            self.outlet.read();
        }
        let Some(child) = child else {
            // What it said at last; nothing can be done to it any more.
            if self.act_s.is_some() {
                self.listen(now_s);
            }
            return Ok(());
        };
        self.watch_machine(now_s, child);
        if self.act_s.is_none() {
            if self.is_due(now_s) {
                self.act_s = Some(monotonic_s());
                self.act(child)?;
                // What we do ourselves is no machine that stands still.
                self.last_s = monotonic_s();
            }
        } else {
            if let Some((_, act)) = self.pending.take_if(|(at_s, _)| now_s >= *at_s) {
                self.end_act(act, child);
            }
            self.listen(now_s);
        }
        if self.stage.act.act.has_screen() && now_s - self.pressed_s > KEYS_S {
            self.pressed_s = now_s;
            if newest(self.stage.runs, self.stage.before).is_some_and(|run| is_finished(&run)) {
                self.outlet.press(b'q');
            }
        }
        Ok(())
    }

    /// The motor has been asked for what the act waits for, for as long.
    fn is_due(&mut self, now_s: f64) -> bool {
        let (begin_s, act) = (self.begin_s, self.stage.act);
        let is_asked =
            |row: &&JournalRow| row.time_s >= begin_s && row.set_point_v.abs() > act.beyond_v;
        let rows = self.stage.drive.rows();
        rows.iter()
            .find(is_asked)
            .is_some_and(|row| now_s >= row.time_s + act.at_s)
    }

    fn act(&mut self, child: &Child) -> io::Result<()> {
        let HostAct { act, for_s, .. } = self.stage.act;
        let send = |signal| process::signal(child, signal);
        let mut lasts_s = for_s;
        match act {
            Act::Kill => send(Signal::SIGKILL),
            Act::Interrupt => send(Signal::SIGINT),
            Act::InterruptTwice => {
                send(Signal::SIGINT);
                lasts_s = Some(INSISTS_S);
            }
            Act::Terminate => send(Signal::SIGTERM),
            Act::HangUp => send(Signal::SIGHUP),
            Act::Pause => send(Signal::SIGSTOP),
            Act::CloseTerminal | Act::CloseOutput => self.outlet.close(),
            Act::BlockOutput => self.is_read = false,
            Act::Shrink => self.outlet.resize(1, 1)?,
            Act::KillDrive => self.stage.drive.kill(),
            Act::Unplug | Act::Cut => self.line(Carries::Gone),
            Act::Reset => self.line(Carries::Reset),
            Act::BlackHole => self.line(Carries::Nothing),
            Act::OtherDrive => {
                self.line(Carries::Gone);
                let other = (self.stage.other)()?;
                if let Some(line) = self.stage.line {
                    line.lead_to(&other.address)?;
                }
                self.other = Some(other);
            }
            Act::SecondHost => {
                let said = File::create(self.stage.folder.join("second-host.txt"))?;
                let second = &mut self.stage.second;
                second
                    .stdin(Stdio::null())
                    .stdout(Stdio::null())
                    .stderr(said);
                let second = std::mem::replace(second, Command::new("true"));
                self.second = Some(process::start(second)?);
            }
            Act::SecondReader => {
                let mut reader = Command::new("cat");
                reader.arg(self.stage.drive.port());
                reader.stdin(Stdio::null()).stdout(Stdio::null());
                reader.stderr(File::create(self.stage.folder.join("second-reader.txt"))?);
                self.reader = Some(process::start(reader)?);
            }
            Act::FolderGone => {
                // At once: while it is emptied file by file, it may be made again.
                let gone = self.stage.folder.join("gone");
                fs::rename(self.stage.runs, &gone)?;
                fs::remove_dir_all(gone)?;
            }
            Act::DiskFull => fill(child, newest(self.stage.runs, self.stage.before))?,
            Act::PortAbsent | Act::PortForbidden | Act::OutForbidden => {}
        }
        let now_s = self.act_s.unwrap_or_else(monotonic_s);
        self.pending = lasts_s.map(|lasts_s| (now_s + lasts_s, act));
        Ok(())
    }

    fn end_act(&mut self, act: Act, child: &Child) {
        match act {
            Act::InterruptTwice => process::signal(child, Signal::SIGINT),
            Act::Pause => process::signal(child, Signal::SIGCONT),
            Act::BlockOutput => self.is_read = true,
            Act::OtherDrive | Act::Unplug | Act::Cut | Act::Reset | Act::BlackHole => {
                self.line(Carries::Everything);
            }
            _ => {}
        }
    }

    fn line(&self, carries: Carries) {
        if let Some(line) = self.stage.line {
            line.set(carries);
        }
    }

    fn listen(&mut self, now_s: f64) {
        let act = self.stage.act.act;
        let loses = act.is_on_line() || matches!(act, Act::KillDrive | Act::SecondReader);
        if loses && self.lost_s.is_none() {
            let said = fs::read_to_string(&self.stderr).unwrap_or_default();
            let is_said = LOST.iter().any(|words| said.contains(words));
            self.lost_s = is_said.then_some(now_s);
        }
    }

    fn watch_machine(&mut self, now_s: f64, child: &Child) {
        if now_s - self.last_s > STOOD_STILL_S {
            self.gaps.push((self.last_s, now_s - self.last_s));
        }
        self.last_s = now_s;
        if now_s - self.waited_s < WAITS_S {
            return;
        }
        self.waited_s = now_s;
        for process in [child.id(), self.stage.drive.id()] {
            let waited_s = kept_waiting_s(process, &mut self.waits);
            if waited_s > STOOD_STILL_S {
                self.gaps.push((now_s - waited_s, waited_s));
            }
        }
    }

    fn came(mut self, done: Done) -> io::Result<Came> {
        self.outlet.read();
        self.end_reader();
        let act = self.stage.act.act;
        let (timeout_s, stop) = (self.stage.timeout_s, self.stage.stop);
        let second = match self.second.take() {
            Some(second) => match process::attend(second, timeout_s, stop, LOOK, |_| Ok(()))?.end {
                End::Status(status) => Some(status),
                End::Asked(_) | End::Killed => None,
            },
            None => None,
        };
        let second_said = fs::read_to_string(self.stage.folder.join("second-host.txt")).ok();
        let touched = self.other.as_mut().and_then(|other| {
            let end_s = monotonic_s();
            is_touched(other.rows_at_rest(), end_s)
        });
        let begin_s = self.begin_s;
        let after = |at_s: Option<f64>| at_s.zip(self.act_s).map(|(at_s, act_s)| at_s - act_s);
        let lost_after_s = after(self.lost_s);
        let act_s = self.act_s;
        let rows = self.stage.drive.rows_at_rest();
        let late = rows
            .iter()
            .filter(|row| row.time_s >= begin_s && row.late_s > STOOD_STILL_S);
        self.gaps.extend(late.map(|row| (row.time_s, row.late_s)));
        let rows_lost = (act == Act::Kill)
            .then(|| rows_lost(rows.last(), &newest(self.stage.runs, self.stage.before)?))
            .flatten();
        let counts = |(at_s, _): &&(f64, f64)| act_s.is_none_or(|act_s| *at_s > act_s - BEFORE_S);
        let stood_still_s = self
            .gaps
            .iter()
            .filter(counts)
            .map(|(_, gap_s)| *gap_s)
            .fold(0.0, f64::max);
        let found = json!({
            "acted": act_s.is_some(),
            "lost_after_s": lost_after_s,
            "rows_lost": rows_lost,
            "second_status": second,
            "second_said": second_said,
            "other_drive_touched": touched,
            "stood_still_s": stood_still_s,
        });
        Ok(Came {
            done,
            act_s,
            found,
            stood_still_s,
        })
    }
}

impl Watched<'_> {
    fn end_reader(&mut self) {
        if let Some(mut reader) = self.reader.take() {
            // It may have ended with its port.
            let _ = reader.kill();
            let _ = reader.wait();
        }
    }
}

impl Drop for Watched<'_> {
    /// Whatever cut it short, neither the second host nor the second reader runs on unwatched.
    fn drop(&mut self) {
        self.end_reader();
        if let Some(mut second) = self.second.take() {
            let _ = process::end(&mut second, LOOK, &mut |_| Ok(()));
        }
    }
}

/// The figures of a motor since `begin_s`, as they stand under `motor` in the result; times count from `act_s`.
pub(super) fn motor(rows: &[JournalRow], begin_s: f64, act_s: f64) -> Value {
    let first = rows.partition_point(|row| row.time_s < begin_s);
    serde_json::to_value(figures(&rows[first..], act_s)).unwrap_or_default()
}

/// The folders in a folder of runs; the link to the newest is none.
pub(super) fn runs_in(runs: &Path) -> BTreeSet<PathBuf> {
    let entries = fs::read_dir(runs).into_iter().flatten().flatten();
    let folders = entries.map(|entry| entry.path());
    folders
        .filter(|path| path.is_dir() && !path.is_symlink())
        .collect()
}

/// Whether anything was written to a drive that was never meant to be written to; not known where its journal does not reach
/// to the end of the command.
fn is_touched(rows: &[JournalRow], end_s: f64) -> Option<bool> {
    let is_written = |row: &JournalRow| row.seq != 0 || row.output_on || row.state != "disabled";
    let is_whole = rows.last().is_some_and(|row| row.time_s >= end_s);
    let found = rows.iter().any(is_written);
    (found || is_whole).then_some(found)
}

/// The newest run that was not there `before`.
pub(super) fn newest(runs: &Path, before: &BTreeSet<PathBuf>) -> Option<PathBuf> {
    let mut runs = runs_in(runs);
    runs.retain(|run| !before.contains(run));
    runs.pop_last()
}

fn is_finished(run: &Path) -> bool {
    let text = fs::read_to_string(run.join("manifest.json")).unwrap_or_default();
    let manifest: Value = serde_json::from_str(&text).unwrap_or_default();
    manifest.get("finished") == Some(&Value::Bool(true))
}

/// Commands that the drive has applied and of which the record has no row: a reply that was on its way is one.
fn rows_lost(last: Option<&JournalRow>, run: &Path) -> Option<u16> {
    let text = fs::read_to_string(run.join("samples.csv")).ok()?;
    let whole = &text[..=text.rfind('\n')?];
    let (head, row) = (whole.lines().next()?, whole.lines().next_back()?);
    let place = head.split(',').position(|name| name == "seq")?;
    let seq: u64 = row.split(',').nth(place)?.parse().ok()?;
    let low = u16::try_from(seq & 0xFFFF).ok()?;
    Some(last?.seq.wrapping_sub(low))
}

/// No file of this process grows beyond what the record of its run is now. It stands for a full disk, which the program
/// handles as the same; what the system says is another word (EFBIG, not ENOSPC).
fn fill(child: &Child, run: Option<PathBuf>) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        use rustix::process::{Pid, Resource, Rlimit, prlimit};
        let samples = run.map(|run| run.join("samples.csv"));
        let size = samples.and_then(|path| Some(fs::metadata(path).ok()?.len()));
        let size = size.ok_or_else(|| io::Error::other("there is no record yet"))?;
        let id = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
        let limit = Rlimit {
            current: Some(size),
            maximum: Some(size),
        };
        prlimit(id, Resource::Fsize, limit)?;
        Ok(())
    }
    #[cfg(not(target_os = "linux"))]
    {
        let _ = (child, run);
        Err(io::ErrorKind::Unsupported.into())
    }
}

/// The longest time that a thread of a process has waited for a processor since the last look, s.
fn kept_waiting_s(process: u32, waits: &mut HashMap<PathBuf, u64>) -> f64 {
    let tasks = fs::read_dir(format!("/proc/{process}/task"));
    let mut longest = 0;
    for task in tasks.into_iter().flatten().flatten() {
        let text = fs::read_to_string(task.path().join("schedstat")).ok();
        let waited = text.and_then(|text| text.split(' ').nth(1)?.parse().ok());
        if let Some(waited) = waited {
            let before = waits.insert(task.path(), waited);
            longest = longest.max(waited.saturating_sub(before.unwrap_or(waited)));
        }
    }
    longest as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drive_whose_journal_is_behind_is_not_said_to_be_untouched() {
        let row = |time_s: f64, seq: u16| JournalRow {
            time_s,
            set_point_v: 0.0,
            output_on: false,
            voltage_v: 0.0,
            current_a: 0.0,
            speed_rad_s: 0.0,
            state: "disabled".to_owned(),
            fault: "none".to_owned(),
            host: None,
            seq,
            late_s: 0.0,
        };
        assert_eq!(is_touched(&[], 1.0), None);
        assert_eq!(is_touched(&[row(0.9, 0)], 1.0), None);
        assert_eq!(is_touched(&[row(0.9, 0), row(1.1, 0)], 1.0), Some(false));
        assert_eq!(is_touched(&[row(0.9, 3)], 1.0), Some(true));
    }
}
