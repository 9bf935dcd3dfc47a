//! The terminal application: it handles snapshots, workflow states, news of an analysis and intents, never a drive.
//!
//! ```text
//! SnapshotCell, ProgressCell, WorkerCell --\                                       /--> Intent to the bench
//! News of the analysis --------------------+--> Screen: update (pure) --> Effect -+--> Order to the analysis
//! keys, resize (crossterm) --> key table --/           |                           \--> leave
//!                                            view (pure), drawn only after a change
//! ```
//!
//! * `application`: the event loop, which shows one screen, a value, until it is left, and gives the terminal back on every
//!   path.
//! * `keys`: the key table, one meaning for each key on every screen.
//! * `frame`, `axis_chart`, `plot`, `theme`: documents, help, hints, panels, charts and colours that all screens have in
//!   common.
//! * `live/`: the screen of a run and of the steps around it; `diagnosis/`: the screen on which effects are added by hand;
//!   `traces/`: the page of both on which measured and model stand over time; `response/`: the page, and the screen, on which
//!   they stand over frequency.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "cells and digits are counted after a clamp, and these casts saturate"
)]

mod application;
mod axis_chart;
mod diagnosis;
mod frame;
mod keys;
mod live;
mod plot;
mod response;
#[cfg(test)]
mod screens;
#[cfg(test)]
mod testing;
mod theme;
mod traces;

pub use application::{Exit, Screen, is_gone, show};
pub use diagnosis::{DiagnosisScreen, DiagnosisSources, Opens};
pub use keys::Press;
pub use live::{FinishOnDrop, LiveScreen, LiveSources, WorkerCell};
pub use response::ResponseScreen;
pub use theme::Appearance;
pub use traces::StoppedAt;
