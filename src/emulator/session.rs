//! One session with one host in real time: bytes are held back until their wire time has passed.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use super::dialogue::{Answering, Dialogue};
use super::pace::Pace;
use super::port::Port;

/// The drive is brought up to date at least this often, s.
const LONGEST_WAIT_S: f64 = 0.01;
/// Bytes under way on the line; a host that writes more has to wait.
const LONGEST_QUEUE: usize = 4096;

/// What a server has done so far.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) sessions: AtomicU64,
    pub(super) answers: AtomicU64,
    pub(super) bytes_dropped: AtomicU64,
}

/// What a session works with.
pub(super) struct Session<'a> {
    pub(super) dialogue: Dialogue,
    pub(super) pace: Pace,
    pub(super) drive: &'a mut dyn Answering,
    /// Drive time by the wall clock, s.
    pub(super) clock: &'a dyn Fn() -> f64,
    pub(super) stop: &'a AtomicBool,
    pub(super) counters: &'a Counters,
}

impl Session<'_> {
    /// Serves until the host goes, speaks something else, or `stop` is set. Returns the time of the last answer.
    pub(super) fn serve(&mut self, port: &mut dyn Port) -> Option<f64> {
        self.counters.sessions.fetch_add(1, Ordering::Relaxed);
        let mut incoming: VecDeque<(f64, u8)> = VecDeque::new();
        let mut outgoing: VecDeque<(f64, Vec<u8>)> = VecDeque::new();
        let mut buffer = [0; 1024];
        let mut answers = Vec::new();
        let mut silent_from_s = None;
        let mut last_answer_s = None;
        let (mut gone, mut broken) = (false, false);
        loop {
            let now = (self.clock)();
            // What a host wrote before it went still counts, at its own time: the drive then runs a little ahead.
            let seen_until = if gone { f64::INFINITY } else { now };
            while let Some((at, byte)) = due(&mut incoming, seen_until) {
                self.drive.advance_to(at);
                broken |= self.dialogue.push(byte, self.drive, &mut answers).is_err();
                self.send(at, &mut answers, &mut outgoing);
                silent_from_s = Some(at + self.pace.gap_s());
            }
            self.drive.advance_to(now);
            if incoming.is_empty() && silent_from_s.is_some_and(|from| from <= now) {
                silent_from_s = None;
                self.dialogue.idle(self.drive, &mut answers);
                self.send(now, &mut answers, &mut outgoing);
            }
            if gone {
                return None;
            }
            while let Some((_, answer)) = due(&mut outgoing, now) {
                self.deliver(port, &answer);
                last_answer_s = Some(now);
            }
            if (broken && outgoing.is_empty()) || self.stop.load(Ordering::Relaxed) {
                return last_answer_s;
            }
            // Bytes of one request are looked at together, each at its own time.
            let next_s = [
                incoming.back().map(|(at, _)| *at),
                outgoing.front().map(|(due, _)| *due),
                silent_from_s,
            ]
            .into_iter()
            .flatten()
            .fold(now + LONGEST_WAIT_S, f64::min);
            let wait = Duration::from_secs_f64((next_s - (self.clock)()).max(0.0));
            if incoming.len() >= LONGEST_QUEUE {
                std::thread::sleep(wait);
                continue;
            }
            match port.read_within(&mut buffer, wait) {
                Ok(count) => {
                    let now = (self.clock)();
                    for byte in &buffer[..count] {
                        incoming.push_back((self.pace.arrival_s(now), *byte));
                    }
                }
                Err(_) => gone = true,
            }
        }
    }

    fn send(
        &mut self,
        end_s: f64,
        answers: &mut Vec<Vec<u8>>,
        outgoing: &mut VecDeque<(f64, Vec<u8>)>,
    ) {
        for answer in answers.drain(..) {
            let due = self.pace.delivery_s(end_s, answer.len());
            outgoing.push_back((due, answer));
        }
    }

    fn deliver(&self, port: &mut dyn Port, answer: &[u8]) {
        // Counted first: who has the answer also finds it counted.
        self.counters.answers.fetch_add(1, Ordering::Relaxed);
        let taken = port.write(answer);
        let dropped = answer.len() - taken;
        self.counters
            .bytes_dropped
            .fetch_add(u64::try_from(dropped).unwrap_or(0), Ordering::Relaxed);
    }
}

/// The first entry, if its time has come.
fn due<T>(queue: &mut VecDeque<(f64, T)>, now_s: f64) -> Option<(f64, T)> {
    if queue.front()?.0 <= now_s {
        queue.pop_front()
    } else {
        None
    }
}
