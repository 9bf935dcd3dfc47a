//! The command line through the real binary: on files, and on emulated drives in virtual time. What needs its deadlines
//! kept is in `tests/live`.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of an integration test are test code"
)]

#[path = "../kit/mod.rs"]
mod kit;

mod analyse;
mod bad_input;
mod bode;
mod card;
mod examples;
mod first_move;
mod front;
mod guided;
mod holdout;
mod identify;
mod input;
mod line;
mod map;
#[cfg(target_os = "linux")]
mod mystery;
mod next_run;
mod offline;
mod progress;
mod replay;
mod report;
mod screen;
mod stop;
mod suite;
mod tutorial;
mod unknown;
mod workshop;
