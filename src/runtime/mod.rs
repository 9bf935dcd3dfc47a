//! What commands share: the rig with its link and files, every way out, and the terminal.
//!
//! ```text
//! RigOptions -> Rig (link, clock, emulator, files) --.
//!                                                     '-> a run on a thread of its own beside a screen -> Recorded
//! signals, keys, a closed terminal -> Ends .. Controls ---^
//! ending: return, failure, panic, hang-up -> zero, disable, the state of the drive -> exit status
//! ```
//!
//! * `rig`, `opening`: from a bench file to a link, and to the same drive again.
//! * `ending`, `signals`, `controls`: every way out. Nothing else may end a program whose motor turns.
//! * `files`: what a run leaves in its folder. `output`, `progress`: the [`Terminal`], made in `main` and handed down, so
//!   that there is no mutable state of the process. None of them panics.

pub(crate) mod controls;
pub(crate) mod ending;
pub(crate) mod failure;
pub(crate) mod files;
pub(crate) mod opening;
pub(crate) mod output;
pub(crate) mod progress;
pub(crate) mod rig;
pub mod signals;

pub use failure::Failure;
pub use output::Terminal;
