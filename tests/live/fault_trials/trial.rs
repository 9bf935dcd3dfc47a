//! One trial in real time: the real binary, the witness on a pseudo-terminal, a fault, and the judgement.

use std::fmt;
use std::process::{Command, Stdio};
use std::time::Duration;

use super::line::{Line, STOOD_STILL_S};
use crate::kit::prelude::*;
use crate::kit::process::KeptWaiting;
use crate::witness::drive::{BENCH, Drive, PROFILE};
use crate::witness::fault::{Act, Class, Fault, Host, Way};
use crate::witness::trials;

/// A trial that takes longer hangs, s.
const PATIENCE_S: f64 = 100.0;
const POLL: Duration = Duration::from_millis(2);
/// Nothing comes any more of a program that has had nothing running for so long, s: a person leaves.
const HOPELESS_S: f64 = 8.0;
/// Between two keys, s: a person's.
const KEYS_S: f64 = 0.4;
/// The witness stays for so long after the program, s: its watchdog, and somewhat more.
const AFTER_S: f64 = 0.7;
/// Standard deviations within which a parameter has to be: a hundred trials with three of them each.
const SIGMAS: f64 = 3.5;
/// Attempts at a trial in which the witness stood still.
const ATTEMPTS: u32 = 4;
/// Columns and rows of the screen.
const SIZE: (u16, u16) = (120, 40);
/// Files may grow so far on a full disk, in blocks of 512 bytes.
const FULL_BLOCKS: u32 = 60;

/// What came of a trial.
pub(crate) struct Trial {
    pub(crate) fault: &'static Fault,
    pub(crate) way: Way,
    pub(crate) status: i32,
    /// What was wrong; nothing: it passed.
    pub(crate) wrong: Vec<String>,
    /// The last lines of the output.
    pub(crate) output: String,
    /// R, Ke, J: value, standard deviation, verdict.
    pub(crate) parameters: Vec<String>,
    pub(crate) seconds: f64,
    /// Longest time for which the witness stood still, or the program was kept from running, s.
    pub(crate) stood_still_s: f64,
    pub(crate) attempts: u32,
    /// The fault was there at all.
    came_about: bool,
}

impl Trial {
    pub(crate) fn passed(&self) -> bool {
        self.wrong.is_empty()
    }

    /// No conclusion: the witness has no record of what happened, however often it was tried.
    pub(crate) fn is_counted_apart(&self) -> bool {
        !self.passed() && self.stood_still_s > STOOD_STILL_S
    }
}

impl fmt::Display for Trial {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} {} x {:?}: status {}, {:.1} s",
            match (self.passed(), self.is_counted_apart()) {
                (true, _) => "ok  ",
                (false, true) => "APART",
                (false, false) => "FAIL",
            },
            self.fault,
            self.way,
            self.status,
            self.seconds
        )?;
        if self.attempts > 1 || self.stood_still_s > STOOD_STILL_S {
            let ms = self.stood_still_s * 1e3;
            write!(f, " (attempt {}, it stood still for {ms:.0} ms)", self.attempts)?;
        }
        for parameter in &self.parameters {
            write!(f, "; {parameter}")?;
        }
        for wrong in &self.wrong {
            write!(f, "\n     {wrong}")?;
        }
        if !self.passed() {
            write!(f, "\n     output: {}", self.output.replace('\n', "\n           "))?;
        }
        Ok(())
    }
}

/// The trial, repeated where the witness itself stood still.
pub(crate) fn trial(fault: &'static Fault, way: Way, seed: u64) -> Trial {
    let mut attempts = 1;
    loop {
        let mut done = attempt(fault, way, seed);
        done.attempts = attempts;
        // A program that stood still itself may end before there was a fault.
        let disturbed = done.stood_still_s > STOOD_STILL_S || !done.came_about;
        if done.passed() || !disturbed || attempts == ATTEMPTS {
            return done;
        }
        attempts += 1;
    }
}

/// The program: without a screen, or on one.
enum Program {
    Headless(Process),
    OnScreen(Box<Session>),
}

impl Program {
    fn start(fault: &Fault, way: Way, folder: &Path) -> Self {
        let command = way.command();
        let text = format!("{command} bench.toml --hardware --out runs --reopen-s 1");
        let mut arguments = line(&text, &[]);
        let mut program = BINARY;
        if fault.act == Act::Host(Host::DiskFull) {
            // What a full disk does to a write, without one: the file does not grow any more.
            let shell = format!("trap '' XFSZ; ulimit -f {FULL_BLOCKS}; exec \"$0\" \"$@\"");
            arguments.splice(0..0, ["-c", &shell, BINARY].map(PathBuf::from));
            program = "/bin/sh";
        }
        if way.has_screen() {
            return Self::OnScreen(Box::new(Session::of(program, arguments, folder, SIZE)));
        }
        let mut command = Command::new(program);
        command.args(arguments).arg("--headless");
        command.current_dir(folder).stdin(Stdio::null());
        Self::Headless(Process::of(command))
    }

    fn id(&self) -> u32 {
        match self {
            Self::Headless(process) => process.0.id(),
            Self::OnScreen(session) => session.id(),
        }
    }

    fn signal(&self, signal: Signal) {
        match self {
            Self::Headless(process) => process.signal(signal),
            Self::OnScreen(session) => session.signal(signal),
        }
    }

    /// Nothing where there is no screen, nor of a program that has just ended.
    fn press(&mut self, key: &str) {
        if let Self::OnScreen(session) = self {
            let _ = session.try_press(key);
        }
    }

    /// Nobody reads its output from now on.
    fn close(&mut self) {
        match self {
            Self::Headless(process) => drop((process.0.stdout.take(), process.0.stderr.take())),
            Self::OnScreen(session) => session.hang_up(),
        }
    }

    /// -1: by a signal.
    fn ended(&mut self) -> Option<i32> {
        match self {
            Self::Headless(process) => {
                let status = process.0.try_wait().expect("a child can be waited for")?;
                Some(status.code().unwrap_or(-1))
            }
            Self::OnScreen(session) => session.ended(),
        }
    }

    /// What stands on the screen.
    fn shown(&mut self) -> String {
        match self {
            Self::Headless(_) => String::new(),
            Self::OnScreen(session) => session.now(),
        }
    }

    /// Its whole output, once it has ended; of a screen the text on it.
    fn output(self) -> String {
        match self {
            Self::Headless(process) => {
                let done = process.end();
                done.stdout + &done.stderr
            }
            Self::OnScreen(mut session) => {
                std::thread::sleep(Duration::from_millis(50));
                session.now()
            }
        }
    }
}

/// What is done to the program at its time, and when that was, s.
fn inflict(host: Host, program: &mut Program, folder: &Path, line: &Line) -> f64 {
    let pause = |ms| std::thread::sleep(Duration::from_millis(ms));
    let at_s = line.now_s();
    match host {
        Host::InterruptTwice => {
            program.signal(Signal::SIGINT);
            pause(50);
            program.signal(Signal::SIGINT);
        }
        Host::Terminate => program.signal(Signal::SIGTERM),
        Host::HangUp => program.signal(Signal::SIGHUP),
        Host::Quit => program.signal(Signal::SIGQUIT),
        Host::User1 => program.signal(Signal::SIGUSR1),
        Host::Kill => program.signal(Signal::SIGKILL),
        Host::Suspend => {
            program.signal(Signal::SIGSTOP);
            pause(1000);
            program.signal(Signal::SIGCONT);
        }
        Host::CloseTerminal => {
            program.close();
            return line.now_s();
        }
        Host::CloseOutput => program.close(),
        Host::StopKey => program.press(" "),
        Host::QuitKey => program.press("q"),
        Host::InterruptKey if matches!(program, Program::OnScreen(_)) => program.press("\u{3}"),
        Host::Interrupt | Host::InterruptKey => program.signal(Signal::SIGINT),
        Host::FolderGone => {
            // At once: while it is emptied file by file, the recorder may make it again.
            let gone = folder.join("gone");
            fs::rename(folder.join("runs"), &gone).expect("it was there");
            fs::remove_dir_all(gone).expect("the folder of this trial");
        }
        Host::DiskFull => {}
    }
    at_s
}

/// Presses what a person would press, and does what the fault has it do; the status, when that was done, and the screens.
fn sit_through(
    fault: &Fault,
    way: Way,
    program: &mut Program,
    folder: &Path,
    line: &Line,
) -> (i32, Option<f64>, Vec<String>) {
    let (mut done_s, mut pressed_s, mut off_s) = (None, 0.0, None);
    let mut stood = Vec::new();
    let mut kept = KeptWaiting::default();
    let status = loop {
        if let Some(status) = program.ended() {
            break status;
        }
        let now_s = line.now_s();
        if now_s > PATIENCE_S {
            program.signal(Signal::SIGKILL);
            break -3;
        }
        let waited_s = kept.since_last_look_s(program.id());
        let (from_s, is_on) = {
            let mut state = line.lock();
            if waited_s > STOOD_STILL_S {
                state.gaps.push((now_s - waited_s, waited_s));
            }
            (state.drive.from_s, state.drive.is_on())
        };
        off_s = if is_on { None } else { off_s.or(Some(now_s)) };
        if done_s.is_none()
            && let (Some(host), Some(from_s)) = (fault.host(), from_s)
            && now_s >= from_s
        {
            done_s = Some(inflict(host, program, folder, line));
        }
        if way.has_screen() && now_s - pressed_s > KEYS_S {
            pressed_s = now_s;
            let shown = program.shown();
            if !shown.trim().is_empty() {
                stood.push(shown.clone());
            }
            if shown.contains("y = start") {
                program.press("y");
            } else if from_s.is_none() && !shown.trim().is_empty() {
                program.press("s");
            } else if let Some(off_s) = off_s
                && (shown.contains("q = quit") && now_s - off_s > 0.8 || now_s - off_s > HOPELESS_S)
            {
                program.press("q");
            }
        }
        std::thread::sleep(POLL);
    };
    stood.dedup();
    (status, done_s, stood)
}

fn attempt(fault: &'static Fault, way: Way, seed: u64) -> Trial {
    let desk = Desk::new();
    let line = Line::open(Drive::new(fault.act, seed), desk.path("drive.pty"));
    desk.put("drive.toml", PROFILE);
    desk.put("bench.toml", BENCH);
    let mut program = Program::start(fault, way, desk.folder());
    let (status, done_s, stood) = sit_through(fault, way, &mut program, desk.folder(), &line);
    let seconds = line.now_s();
    std::thread::sleep(Duration::from_secs_f64(AFTER_S));
    let mut output = program.output();
    for screen in stood.iter().rev().take(12) {
        output.push('\n');
        output.push_str(screen);
    }
    let state = line.lock();
    let from_s = trials::from_s(fault, &state.drive, done_s);
    // What matters is what the witness did not see once the fault was there, or shortly before.
    let stood_still_s = state
        .gaps
        .iter()
        .filter(|(at_s, _)| from_s.is_none_or(|from_s| *at_s > from_s - 1.0))
        .map(|(_, gap_s)| *gap_s)
        .fold(0.0, f64::max);
    let came_about = state.drive.from_s.is_some();
    let mut wrong = trials::wrong(fault, &state.drive, done_s, status);
    drop(state);
    let documents = documents(&desk.out());
    // A screen is full of words; what counts is what stands as an error, and what is kept.
    let mut reported: String = documents.iter().map(|(text, _)| text.as_str()).collect();
    let is_notice = |line: &&str| {
        let line = line.trim_start();
        line.starts_with("error:") || line.starts_with("help:")
    };
    reported.extend(output.lines().filter(is_notice).map(|line| format!("\n{line}")));
    if way == Way::Commission && fault.class == Class::GoesOn {
        reported.push_str(&output);
    }
    output.push_str(&reported);
    if fault.act != Act::Host(Host::CloseTerminal) {
        wrong.extend(fault.untold(&reported));
    }
    if output.contains("panicked at") {
        wrong.push("it panicked".to_owned());
    }
    let loses_record = matches!(fault.act, Act::Host(Host::FolderGone | Host::DiskFull));
    if loses_record && way == Way::Run && !output.contains("resistance") {
        wrong.push("the result was not printed".to_owned());
    }
    let mut parameters = Vec::new();
    if fault.class == Class::GoesOn && way.command() == "run" {
        for (_, result) in &documents {
            let (words, off) = trials::hold_against_truth(SIGMAS, |key| {
                let parameter = &result["parameters"][key];
                let verdict = parameter["verdict"].as_str().unwrap_or("not given");
                (verdict, parameter["value"].as_f64(), parameter["std"].as_f64())
            });
            parameters.extend(words);
            wrong.extend(off);
        }
    }
    let last: Vec<&str> = output.lines().filter(|l| !l.trim().is_empty()).collect();
    Trial {
        fault,
        way,
        status,
        wrong,
        output: last[..last.len().min(45)].join("\n"),
        parameters,
        seconds,
        stood_still_s,
        attempts: 1,
        came_about,
    }
}

/// How the runs say that they ended, and their results.
fn documents(runs: &Path) -> Vec<(String, Value)> {
    let Ok(entries) = fs::read_dir(runs) else {
        return Vec::new();
    };
    let folders = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let read = |path: PathBuf| {
        let text = fs::read_to_string(path).unwrap_or_default();
        serde_json::from_str::<Value>(&text).unwrap_or_default()
    };
    folders
        .filter(|folder| folder.is_dir() && !folder.is_symlink())
        .map(|folder| {
            let manifest = read(folder.join("manifest.json"));
            let result = read(folder.join("result.json"));
            (format!("\n{} {}", manifest["outcome"], result["notices"]), result)
        })
        .collect()
}
