//! Names missing effects: one run is fitted, another held out. Here both are simulated, with a fan on the shaft.
//!
//! ```sh
//! cargo run --release --example diagnose_two_runs
//! ```
#![expect(clippy::print_stdout, reason = "the output of an example")]

use std::error::Error;

use drivebench::diagnosis::{Diagnosis, Evidence, diagnose};
use drivebench::identification::output_error::FitError;
use drivebench::plant::{Model, Motor, Scenario, testing};
use drivebench::report::wording::diagnosis::diagnosis as sentence;

/// Diagnosis of a motor with a known baseline from both runs.
pub fn missing(fit: Scenario, holdout: Scenario) -> Result<Diagnosis, FitError> {
    let nameplate = Model::baseline(Motor::zk_22fc());
    diagnose(&nameplate, Evidence::new(fit, Some(holdout), None))
}

fn main() -> Result<(), Box<dyn Error>> {
    let found = missing(testing::with_a_fan(0), testing::with_a_fan(3))?;
    println!("{}", sentence(&found));
    for one in found.candidates.iter().take(5) {
        println!("{:>24}  {:.3}", one.effect, one.probability);
    }
    Ok(())
}
