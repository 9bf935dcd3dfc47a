//! Runs over live drives: who opens the link, in which order the work is done, and who sees to its end.
//!
//! ```text
//! RigOptions -> Rig (link, clock, emulator, files) --.
//!                                                     '-> run | commission | speed -> Recorded -> the command's result
//! signals, keys, the terminal -> Ends .. Controls --------^ (work, on a thread of its own beside a screen)
//! ending: whatever returns, fails, panics or hangs up -> zero, disable, the drive's word -> status
//! ```
//!
//! * `rig`, `opening`: from a bench file to a link, and to the same drive once more; `survey`, `doctor`: drives and
//!   lines that are only looked at; `registers`: raw ones, read and written; `catalogue`: the effects.
//! * `run` (and commissioning), `speed`, `identify` (and replay), `forecast`, `by_hand`, `screen`, `versus`: the
//!   order of work of each command; a test of a live run gives a rig of its own.
//! * `suite`: bench tests, each step a process of this program; `analyse`: many runs as one table, a row each.
//! * `evidence`: runs and models that are judged, and the run that would tell more.
//! * `guided`: what can follow a commissioning on its screen.
//! * `ending`, `signals`, `controls`: every way out. Nothing else may end a program whose motor turns.
//! * `files`, `pages`: what is left in folders; `cards`: what is left on the terminal; `report`: the page of a run and its
//!   pictures once more; `export`: models for other tools; `bode`: frequency response; `tune`: gains, and those from a file; `front`: what the program
//!   says when it is called alone.
//! * `output`, `progress`, `failure`: the only words to stdout and stderr, none of which may panic.

pub(crate) mod analyse;
pub(crate) mod bode;
pub(crate) mod by_hand;
pub(crate) mod cards;
pub(crate) mod catalogue;
mod controls;
pub(crate) mod doctor;
mod ending;
pub(crate) mod evidence;
pub(crate) mod export;
pub(crate) mod failure;
pub(crate) mod files;
pub(crate) mod forecast;
pub(crate) mod front;
pub(crate) mod guided;
pub(crate) mod identify;
pub(crate) mod opening;
pub mod output;
pub(crate) mod pages;
pub mod progress;
pub(crate) mod registers;
pub(crate) mod report;
mod rig;
mod run;
pub(crate) mod screen;
pub mod signals;
mod speed;
pub(crate) mod suite;
pub(crate) mod survey;
pub(crate) mod tune;
pub(crate) mod versus;

pub use controls::{Controls, DriveCell, DriveWord, Ends};
pub use ending::{Audience, Ended, Left, beside_screen, conduct};
pub use failure::Failure;
pub use files::Recorded;
pub use opening::Reopener;
pub(crate) use opening::Tap;
pub(crate) use rig::MYSTERY;
pub use rig::{OpenRig, Rig, RigOptions};
pub(crate) use run::run_result;
pub use run::{
    CommissionDone, Connection, RunDone, Whole, commission, connect, escalation_failure, run,
};
pub(crate) use speed::speed_result;
pub use speed::{SpeedDone, SpeedRequest, SpeedResult, speed};
