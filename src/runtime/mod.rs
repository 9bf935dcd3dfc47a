//! What commands share: the rig with its link and files, every way out, and the terminal.
//!
//! ```text
//! RigOptions -> Rig (link, clock, emulator, files) --.
//!                                                     '-> a run on a thread of its own, shown by a screen -> Recorded
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

pub(crate) use controls::Controls;
pub(crate) use ending::{Audience, ScreenEnd, ScreenReturn, conduct, spawn, watched};
pub use failure::Failure;
pub(crate) use failure::{INTERNAL, INTERRUPTED, LINK, NOT_IDENTIFIABLE, REFUSED, USAGE};
pub(crate) use files::{
    Recorded, early_end, estimates, load, model_file, names_in, parquet, read_model, read_text,
    require_parquet, samples_as_parquet, speed_command,
};
pub(crate) use opening::{Tap, address, serve, wired_profile};
pub use output::Terminal;
pub(crate) use output::{Form, lines, quoted, quoted_word};
pub(crate) use progress::ProgressLine;
pub(crate) use rig::{
    MYSTERY, OpenRig, Rig, RigOptions, SpeedAbout, Switches, failed_plan, nameplate,
};
