//! What everything else computes with: units, signals, samples, excitation, and the motor with its effects, as functions of time.
//! No clock, no file, no link.
//!
//! ```text
//! units < text < sample < signal < numerics < {plant, excitation}
//! ```

pub mod config_text;
pub mod excitation;
pub mod numerics;
pub mod plant;
pub mod sample;
pub mod signal;
pub mod text;
pub mod units;
