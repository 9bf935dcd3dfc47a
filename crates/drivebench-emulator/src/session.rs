//! One session with one host in real time: bytes are held back until their wire time has passed. Of several hosts one is in
//! command.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use super::codec::{Codec, Responder};
use super::line_faults::LineFaults;
use super::pace::Pace;

/// The drive is brought up to date at least this often, s.
const LONGEST_WAIT_S: f64 = 0.01;
/// Time without a command after which a host loses control, s: longer than the watchdog of the usual drives, so that the motor
/// stands when another host takes control.
pub(super) const HAND_OVER_S: f64 = 2.0;

/// The host has gone; what it wrote before was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Gone;

pub(crate) trait Port {
    /// Waits at most `timeout` for bytes; 0: none came.
    fn read_within(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize, Gone>;

    /// Hands over what the host has room for; returns the bytes that were taken.
    fn write(&mut self, bytes: &[u8]) -> usize;
}

#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) sessions: AtomicU64,
    pub(super) answers: AtomicU64,
}

/// The one of several connected hosts whose commands the drive accepts, until it disconnects or is silent for [`HAND_OVER_S`].
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Commander {
    /// Number of its session, and when it commanded last, s.
    held: Option<(u64, f64)>,
}

impl Commander {
    /// Whether this session may command at `now_s`; it is in command from then on.
    pub(super) fn takes(&mut self, session: u64, now_s: f64) -> bool {
        let by_another =
            self.held.is_some_and(|(holder, at_s)| holder != session && now_s - at_s < HAND_OVER_S);
        if !by_another {
            self.held = Some((session, now_s));
        }
        !by_another
    }

    pub(super) fn leaves(&mut self, session: u64) {
        self.held = self.held.filter(|(holder, _)| *holder != session);
    }
}

pub(super) struct FarEnd<'a> {
    pub(super) drive: &'a mut dyn Responder,
    /// Drive time by the wall clock, s.
    pub(super) clock: &'a dyn Fn() -> f64,
    pub(super) stop: &'a AtomicBool,
    pub(super) counters: &'a Counters,
    pub(super) commander: &'a mut Commander,
    pub(super) line_faults: &'a mut LineFaults,
}

/// One host and what is under way to and from it.
pub(super) struct Session {
    number: u64,
    codec: Codec,
    pace: Pace,
    incoming: VecDeque<(f64, u8)>,
    outgoing: VecDeque<(f64, Vec<u8>)>,
    answers: Vec<Vec<u8>>,
    silent_from_s: Option<f64>,
    last_answer_s: Option<f64>,
    /// When its last byte came, s.
    pub(super) received_s: f64,
    gone: bool,
    broken: bool,
}

/// What a session waits for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Turn {
    /// Something is due then, s; until that it listens.
    Until(f64),
    /// The host is gone or uses another protocol, or `stop` is set; the time of the last answer, for a host that may still
    /// want to read it.
    Over(Option<f64>),
}

impl Session {
    pub(super) fn new(codec: Codec, pace: Pace, far: &FarEnd<'_>) -> Self {
        Self {
            number: far.counters.sessions.fetch_add(1, Ordering::Relaxed),
            codec,
            pace,
            incoming: VecDeque::new(),
            outgoing: VecDeque::new(),
            answers: Vec::new(),
            silent_from_s: None,
            last_answer_s: None,
            received_s: (far.clock)(),
            gone: false,
            broken: false,
        }
    }

    /// Serves until the host goes, uses another protocol, or `stop` is set. Returns the time of the last answer.
    pub(super) fn serve(&mut self, port: &mut dyn Port, far: &mut FarEnd<'_>) -> Option<f64> {
        loop {
            match self.turn(port, far) {
                Turn::Over(last_answer_s) => return last_answer_s,
                Turn::Until(next_s) => self.listen(port, far, next_s),
            }
        }
    }

    pub(super) fn turn(&mut self, port: &mut dyn Port, far: &mut FarEnd<'_>) -> Turn {
        let now = (far.clock)();
        // What a host wrote before it went still counts, at its own time: the drive then runs a little ahead.
        let seen_until = if self.gone { f64::INFINITY } else { now };
        while let Some((at, byte)) = due(&mut self.incoming, seen_until) {
            far.drive.advance_to(at);
            far.drive.request_from(self.number);
            let (commander, number) = (&mut *far.commander, self.number);
            let may_command = &mut || commander.takes(number, at);
            far.line_faults.host_byte(byte);
            let mut drive = far.line_faults.before(far.drive, at);
            let pushed = self.codec.push(byte, &mut drive, may_command, &mut self.answers);
            self.broken |= pushed.is_err();
            self.send(at, far);
            self.silent_from_s = Some(at + self.pace.gap_s());
        }
        far.drive.advance_to(now);
        if self.incoming.is_empty() && self.silent_from_s.is_some_and(|from| from <= now) {
            self.silent_from_s = None;
            let mut drive = far.line_faults.before(far.drive, now);
            self.codec.idle(&mut drive, &mut self.answers);
            self.send(now, far);
            far.line_faults.silence();
        }
        for (due, bytes) in far.line_faults.unrequested(now, now + LONGEST_WAIT_S, far.drive) {
            self.under_way(due, bytes);
        }
        if self.gone {
            far.commander.leaves(self.number);
            return Turn::Over(None);
        }
        while let Some((_, answer)) = due(&mut self.outgoing, now) {
            deliver(far.counters, port, &answer);
            self.last_answer_s = Some(now);
        }
        if (self.broken && self.outgoing.is_empty()) || far.stop.load(Ordering::Relaxed) {
            far.commander.leaves(self.number);
            return Turn::Over(self.last_answer_s);
        }
        // Bytes of one request are looked at together, each at its own time.
        let next_s = [
            self.incoming.back().map(|(at, _)| *at),
            self.outgoing.front().map(|(due, _)| *due),
            self.silent_from_s,
        ];
        Turn::Until(next_s.into_iter().flatten().fold(now + LONGEST_WAIT_S, f64::min))
    }

    pub(super) fn listen(&mut self, port: &mut dyn Port, far: &FarEnd<'_>, next_s: f64) {
        let mut buffer = [0; 1024];
        let wait = Duration::from_secs_f64((next_s - (far.clock)()).max(0.0));
        // Bytes under way on the line; a host that writes more has to wait.
        if self.incoming.len() >= 4096 {
            std::thread::sleep(wait);
            return;
        }
        match port.read_within(&mut buffer, wait) {
            Ok(count) => {
                let now = (far.clock)();
                if count > 0 {
                    self.received_s = now;
                }
                for byte in &buffer[..count] {
                    self.incoming.push_back((self.pace.arrival_s(now), *byte));
                }
            }
            Err(_) => self.gone = true,
        }
    }

    pub(super) const fn let_go(&mut self) {
        self.gone = true;
    }

    fn send(&mut self, end_s: f64, far: &mut FarEnd<'_>) {
        for answer in std::mem::take(&mut self.answers) {
            let due_s = self.pace.delivery_s(end_s, answer.len());
            for (due, bytes) in far.line_faults.reply(answer, end_s, due_s, far.drive.ran_s()) {
                self.under_way(due, bytes);
            }
        }
    }

    /// Bytes that arrive then, behind those that arrive earlier.
    fn under_way(&mut self, due_s: f64, bytes: Vec<u8>) {
        let place = self.outgoing.partition_point(|(at, _)| *at <= due_s);
        self.outgoing.insert(place, (due_s, bytes));
    }
}

fn deliver(counters: &Counters, port: &mut dyn Port, answer: &[u8]) {
    // Counted first: who has the answer also finds it counted.
    counters.answers.fetch_add(1, Ordering::Relaxed);
    // A host that takes nothing loses the rest.
    port.write(answer);
}

fn due<T>(queue: &mut VecDeque<(f64, T)>, now_s: f64) -> Option<(f64, T)> {
    if queue.front()?.0 <= now_s { queue.pop_front() } else { None }
}
