//! Runs over live drives: who opens the link, in which order the work is done, and who sees to its end.
//!
//! ```text
//! RigOptions -> Rig (link, clock, emulator, files) --.
//!                                                     '-> run | commission | speed -> Recorded -> the command's result
//! signals, keys, the terminal -> Ends .. Strings --------^ (work, on a thread of its own beside a screen)
//! ending: whatever returns, fails, panics or hangs up -> zero, disable, the drive's word -> status
//! ```
//!
//! * `rig`, `opening`, `reopening`, `tap`: from a bench file to a link, and to the same drive once more.
//! * `checks`, `escalation`, `run`, `commission`, `speed`: the order of work; a test gives a rig of its own.
//! * `ending`, `signals`, `strings`: every way out. Nothing else may end a program whose motor turns.
//! * `recorded`, `pages`, `speed_page`, `model_output`, `seal`: what is left in folders.
//! * `output`, `progress`, `failure`: the only words to stdout and stderr, none of which may panic.

mod checks;
pub(crate) mod commission;
pub(crate) mod discovery;
mod ending;
mod escalation;
pub(crate) mod failure;
pub(crate) mod files;
pub(crate) mod model_output;
pub(crate) mod opening;
pub(crate) mod output;
pub(crate) mod pages;
pub(crate) mod progress;
mod recorded;
mod reopening;
mod rig;
mod run;
pub(crate) mod seal;
pub(crate) mod signals;
mod speed;
mod speed_page;
mod strings;
mod tap;

pub use commission::{CommissionDone, commission};
pub use ending::{Audience, Ended, Left, beside_screen, conduct};
pub use escalation::escalation_failure;
pub use failure::Failure;
pub use recorded::Recorded;
pub use reopening::Reopener;
pub(crate) use rig::MYSTERY;
pub use rig::{OpenRig, Rig, RigOptions};
pub(crate) use run::run_result;
pub use run::{RunDone, RunRequest, Whole, run};
pub(crate) use speed::speed_result;
pub use speed::{SpeedDone, SpeedRequest, SpeedResult, speed};
pub use strings::{DriveCell, DriveWord, Ends, Strings};
pub(crate) use tap::Tap;
