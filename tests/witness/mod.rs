//! A drive that knows nothing of the program under test, and keeps the truth of what it did: the witness.
//!
//! ```text
//! bytes, time -> codec.rs -> [ drive.rs: registers, states, watchdog, faults of fault.rs ] -> bytes, times
//!                                 | u              ^ i, w
//!                             motor.rs             |       log of u, i, w -> judge.rs -> what was wrong
//! ```
//!
//! trials.rs: which faults in which ways, several at once, and the judgement with the exit status and the truth.
//!
//! A function of time: the same drive hangs at a pseudo-terminal in real time and at a line in memory in virtual time.
#![allow(dead_code, reason = "each user of the witness needs its part")]
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "registers are made of numbers"
)]

pub(crate) mod codec;
pub(crate) mod drive;
pub(crate) mod fault;
pub(crate) mod judge;
pub(crate) mod motor;
pub(crate) mod trials;
