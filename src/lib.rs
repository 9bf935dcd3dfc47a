//! drivebench: connect to a motor drive, identify the motor on line, and find which physical effect is missing in its model.
//!
//! The libraries are crates of their own, lowest floor first; each uses only those before it. They are shown here under one
//! name for those who embed them. Above them stands the program.
//!
//! ```text
//! crates:  model < identify < {diagnose, control};  model < link < emulator;  {identify, control, link, emulator} < bench
//! program: report < workflow < tui < runtime < commands < main
//! ```
//!
//! The identification of a motor from a run with a known voltage:
//!
//! ```
//! use drivebench::identification::scheme::{Data, default_for};
//! use drivebench::plant::{Model, Motor, Scenario, testing};
//!
//! let run = testing::with_rows_lost(&testing::with_a_fan(0), |_| false);
//! let scenario = Scenario::from_run(&run)?;
//! let unknown = Model::baseline(Motor::new("unknown"));
//! let data = Data { run: &run, scenario: &scenario, model: &unknown };
//! let found = default_for(&scenario).identify(&data)?;
//! let resistance_ohm = found.parameters.iter().find(|one| one.key == "resistance_ohm");
//! assert!(resistance_ohm.is_some_and(|one| one.value.is_some()));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub use drivebench_bench::{self as bench, recording};
pub use drivebench_control as control;
pub use drivebench_diagnose as diagnosis;
pub use drivebench_emulator as emulator;
pub use drivebench_identify as identification;
pub use drivebench_link as drive;
pub use drivebench_model::{
    config_text, excitation, numerics, plant, sample, signal, tabulated, text, units,
};

pub mod commands;
pub mod report;
pub mod runtime;
pub mod tui;
pub mod workflow;
