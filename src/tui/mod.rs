//! The live screens: they see snapshots, workflow states and intents, never a drive.
//!
//! ```text
//! SnapshotCell, ProgressCell, WorkerCell --\
//! keys, resize (crossterm) ----------------+--> Event --> Model::update --> Effect --> Intent to the bench, leave
//!                                                           |
//!                                                view(&Model, frame): pure, drawn only after a change
//! ```
//!
//! * `show` owns the terminal and the loop; `terminal` gives it back on every path.
//! * `model`, `update`, `keys`: what is shown, and what each key does in each state.
//! * `diagnosis/`: the screen of a diagnosis, with a model, an update and keys of its own.
//! * `screen/`: one file per screen; `widget/`: one file per widget, each a function of its data.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "cells and digits are counted after a clamp, and these casts saturate"
)]

mod diagnosis;
mod keys;
mod model;
mod screen;
mod show;
mod terminal;
mod theme;
mod update;
mod view;
mod widget;
mod worker;

#[cfg(test)]
mod tests;

pub use diagnosis::{DiscoveryScreen, show_discovery};
pub use show::{Exit, ShowOptions, is_gone, show};
pub use worker::{FinishOnDrop, WorkerCell};
