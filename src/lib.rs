//! drivebench: connect to a motor drive, identify the motor on line, and learn which physical effect its model misses.
//!
//! The floors of the house, lowest first; a file uses only what stands on a lower floor:
//!
//! ```text
//! units < text < sample < signal < numerics < {plant, excitation, drive, recording} < identification < {diagnosis, control}
//!       < emulator < bench < report < workflow < tui < app < cli < main
//! ```

pub mod app;
pub mod bench;
pub mod cli;
pub mod config_text;
pub mod control;
pub mod diagnosis;
pub mod drive;
pub mod emulator;
pub mod excitation;
pub mod identification;
pub mod numerics;
pub mod plant;
pub mod recording;
pub mod report;
pub mod sample;
pub mod signal;
pub mod text;
pub mod tui;
pub mod units;
pub mod workflow;
