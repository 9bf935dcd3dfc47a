//! The core of drivebench: physics, identification, control and diagnosis as functions of time. It knows no clock, no file and
//! no terminal, so that a record, a simulation and a live run go through the same code, and others can use it as a library.
//!
//! ```text
//! Run or Scenario (sample, plant) -> identification -> Model -> diagnosis: what it misses
//!                                                         '-> control: gains, and the loop that uses them
//! ```
//!
//! A motor of which the voltage is known is identified, and a run that it gives is explained by its own model:
//!
//! ```
//! use drivebench_core::identification::scheme::{Data, default_for};
//! use drivebench_core::plant::{Model, Motor, Scenario, testing};
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

pub mod config_text;
pub mod control;
pub mod diagnosis;
pub mod excitation;
pub mod identification;
pub mod numerics;
pub mod plant;
pub mod sample;
pub mod signal;
pub mod text;
pub mod units;
