//! drivebench: connect to a motor drive, identify the motor on line, and learn which physical effect its model misses.
//!
//! The floors of the house, lowest first; a file uses only what stands on a lower floor:
//!
//! ```text
//! units < text < sample < signal < numerics < {plant, excitation, drive, recording} < identification < {diagnosis, control}
//!       < emulator < bench < report < workflow < tui < app < cli < main
//! ```

pub use drivebench_core::{
    config_text, control, diagnosis, excitation, identification, numerics, plant, sample, signal,
    text, units,
};

pub mod app;
pub mod bench;
pub mod cli;
pub mod drive;
pub mod emulator;
pub mod recording;
pub mod report;
pub mod tui;
pub mod workflow;
