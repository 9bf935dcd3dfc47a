//! Seventeen ways in which a line or a drive goes wrong, done to the bytes of a reply.

use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::RngCore;

/// The faults of a line and of a device behind it, as lists of field failures number them (1 to 17).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    ByteLost,
    ByteInserted,
    BitsFlipped,
    Doubled,
    Late,
    LateTwoDeep,
    OtherUnit,
    OtherRequest,
    Refused,
    Busy,
    CutOff,
    GarbageBetween,
    Babble,
    InChunks,
    OwnEcho,
    WrongBaud,
    Silent,
}

impl Fault {
    pub(super) const ALL: [Self; 17] = [
        Self::ByteLost,
        Self::ByteInserted,
        Self::BitsFlipped,
        Self::Doubled,
        Self::Late,
        Self::LateTwoDeep,
        Self::OtherUnit,
        Self::OtherRequest,
        Self::Refused,
        Self::Busy,
        Self::CutOff,
        Self::GarbageBetween,
        Self::Babble,
        Self::InChunks,
        Self::OwnEcho,
        Self::WrongBaud,
        Self::Silent,
    ];
}

/// Random numbers of a run.
pub(super) struct Dice(pub(super) ChaCha8Rng);

impl Dice {
    pub(super) fn below(&mut self, bound: usize) -> usize {
        (self.0.next_u32() as usize) % bound.max(1)
    }

    fn bytes(&mut self, count: usize) -> Vec<u8> {
        let mut bytes = vec![0; count];
        self.0.fill_bytes(&mut bytes);
        bytes
    }
}

/// What a faulty reply is made of: the language knows how to write the frames.
pub(super) struct Reply {
    pub(super) request: Vec<u8>,
    pub(super) honest: Vec<u8>,
    /// The same content under another unit's name, or of another kind.
    pub(super) other_unit: Vec<u8>,
    /// A whole reply to another request: function, length or number differ.
    pub(super) other_request: Vec<u8>,
    /// Refusals: for good, and for now.
    pub(super) refusal: Vec<u8>,
    pub(super) busy: Vec<u8>,
}

/// Times of the line that the faults must straddle.
#[derive(Clone, Copy)]
pub(super) struct Times {
    pub(super) turnaround: Duration,
    /// After this nobody waits for the reply any more.
    pub(super) deadline: Duration,
}

/// Late replies that are held back until something else is asked.
#[derive(Default)]
pub(super) struct Held(Vec<Vec<u8>>);

/// What comes back for one request, and when.
pub(super) fn inflict(
    fault: Option<Fault>,
    reply: Reply,
    held: &mut Held,
    times: Times,
    dice: &mut Dice,
) -> Vec<(Duration, Vec<u8>)> {
    let soon = times.turnaround;
    let mut out: Vec<_> = held.0.drain(..).map(|late| (soon, late)).collect();
    let mut honest = reply.honest;
    let length = honest.len();
    let Some(fault) = fault else {
        out.push((soon, honest));
        return out;
    };
    match fault {
        Fault::ByteLost => {
            honest.remove(dice.below(length));
        }
        Fault::ByteInserted => {
            let byte = dice.bytes(1)[0];
            honest.insert(dice.below(length + 1), byte);
        }
        Fault::BitsFlipped => {
            for _ in 0..=dice.below(3) {
                honest[dice.below(length)] ^= 1 << dice.below(8);
            }
        }
        Fault::CutOff => honest.truncate(dice.below(length)),
        _ => {}
    }
    match fault {
        Fault::ByteLost | Fault::ByteInserted | Fault::BitsFlipped | Fault::CutOff => {
            out.push((soon, honest));
        }
        Fault::Doubled => {
            // At once, in the gap, or long after.
            let again = soon + Duration::from_micros([0, 300, 2500, 9000][dice.below(4)]);
            out.extend([(soon, honest.clone()), (again, honest)]);
        }
        Fault::Late if dice.below(2) == 0 => held.0.push(honest),
        Fault::Late => {
            let after = Duration::from_micros(dice.below(20_000) as u64);
            out.push((times.deadline + after, honest));
        }
        // The copy makes the next request find two of them.
        Fault::LateTwoDeep => held.0.extend([honest.clone(), honest]),
        Fault::OtherUnit => out.push((soon, reply.other_unit)),
        Fault::OtherRequest => out.push((soon, reply.other_request)),
        Fault::Refused => out.push((soon, reply.refusal)),
        Fault::Busy => out.push((soon, reply.busy)),
        Fault::GarbageBetween => {
            let count = [3, 40, 1500, 1 << 16][dice.below(4)];
            let garbage = dice.bytes(count);
            // Before the reply it must not be taken for it, behind it not for the next.
            let before = dice.below(2) == 0;
            out.push((soon, honest));
            out.insert(if before { 0 } else { out.len() }, (soon, garbage));
        }
        Fault::Babble => {
            let mut at = soon;
            while at < times.deadline {
                out.push((at, dice.bytes(24)));
                at += Duration::from_millis(2);
            }
        }
        Fault::InChunks => {
            let rest = honest.split_off(dice.below(length));
            let later = soon + Duration::from_millis(16);
            out.extend([(soon, honest), (later, rest)]);
        }
        Fault::OwnEcho => out.extend([(Duration::ZERO, reply.request), (soon, honest)]),
        Fault::WrongBaud => out.push((soon, dice.bytes(length))),
        Fault::Silent => {}
    }
    out
}
