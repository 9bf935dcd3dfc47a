//! A user-defined effect, outside of the catalogue: a card, parameters and an equation; then fitted and judged like any other.
//!
//! ```sh
//! cargo run --release --example own_effect
//! ```
#![expect(clippy::print_stdout, reason = "the output of an example")]

use std::error::Error;

use drivebench::diagnosis::{AddResult, Evidence, add};
use drivebench::identification::output_error::FitError;
use drivebench::plant::effect::{Card, Enters, Terms};
use drivebench::plant::{Effect, Instant, Model, Motor, ParameterSpec, testing};
use drivebench::report::wording::change::change;

/// A load that grows with the third power of the speed.
struct Propeller;

impl Effect for Propeller {
    fn card(&self) -> &'static Card {
        const CARD: &Card = &Card {
            id: "cubic_load",
            name: "cubic load",
            enters: Enters::Torque,
            equation: "T = k w^3",
            takes_power: true,
            ..Card::PLAIN
        };
        CARD
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const { &[ParameterSpec::coefficient("cubic_n_m_s3_per_rad3", "N.m.s3/rad3", 1e-8)] }
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Cubic { n_m_s3_per_rad3: values[0] })
    }
}

struct Cubic {
    n_m_s3_per_rad3: f64,
}

impl Terms for Cubic {
    fn torque_n_m(&self, at: &Instant, _own: &[f64]) -> f64 {
        self.n_m_s3_per_rad3 * at.speed_rad_s.powi(3)
    }
}

/// Whether two runs of a motor with a fan show it.
pub fn judged() -> Result<AddResult, FitError> {
    let runs = Evidence::new(testing::with_a_fan(0), Some(testing::with_a_fan(3)), None);
    add(&Propeller, &Model::baseline(Motor::zk_22fc()), runs)
}

fn main() -> Result<(), Box<dyn Error>> {
    let result = judged()?;
    println!("accepted: {}; {}", result.accepted, change(&result));
    for one in &result.parameters {
        println!("{} = {:?} ± {:?}", one.key, one.value, one.std);
    }
    Ok(())
}
