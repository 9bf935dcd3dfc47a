//! What every command that opens a drive or prints shares: the link and its files, every way out, and the streams.
//!
//! ```text
//! RigOptions -> Rig (link, clock, emulator, files) --.
//!                                                     '-> a run on a thread of its own beside a screen -> Recorded
//! signals, keys, the terminal -> Ends .. Controls --------^
//! ending: return, failure, panic, hang-up -> zero, disable, the state of the drive -> exit status
//! ```
//!
//! * `rig`, `opening`: from a bench file to a link, and to the same drive again.
//! * `ending`, `signals`, `controls`: every way out. Nothing else may end a program whose motor turns.
//! * `files`: what a run leaves in its folder. `output`, `progress`, `failure`: stdout and stderr; none of them panics.

pub(crate) mod appearance;
pub mod controls;
pub mod ending;
pub mod failure;
pub mod files;
pub mod opening;
pub mod output;
pub mod progress;
pub mod rig;
pub mod signals;

pub use controls::{Controls, DriveCell, DriveWord, Ends};
pub use ending::{Audience, Ended, Left, beside_screen, conduct};
pub use failure::Failure;
pub use files::Recorded;
pub use opening::Reopener;
pub use rig::{OpenRig, Rig, RigOptions};
