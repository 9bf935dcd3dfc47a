//! A drive whose hidden effect a seed draws.
//!
//! ```text
//! seed --draw--> Mystery { config: of the drive, truth: what an answer is compared with }
//! ```
//!
//! The seed fixes everything: effect, sizes and specimen.

use std::fmt;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::EmulatorConfig;
use super::truth::MotorTruth;
use super::truth::effect::{HiddenEffect, Site};
use drivebench_model::text::number::{shortest, with_unit};

/// A software drive and what it hides.
#[derive(Clone, Debug, PartialEq)]
pub struct Mystery {
    pub seed: u64,
    /// Of the drive, together with the seed.
    pub config: EmulatorConfig,
    pub truth: Truth,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Truth {
    pub seed: u64,
    /// The specimen, not the nameplate.
    pub motor: MotorTruth,
    /// None, or one.
    pub effects: Vec<TrueEffect>,
}

/// One hidden effect with its size.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrueEffect {
    pub id: String,
    /// No catalogue of the host has it: the right answer is that nothing known explains the run.
    pub is_foreign: bool,
    pub parameters: Vec<TrueValue>,
}

/// One parameter, under the key of the model file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrueValue {
    pub key: String,
    pub value: f64,
    pub unit: String,
}

impl Truth {
    pub fn effect(&self) -> Option<&TrueEffect> {
        self.effects.first()
    }
}

/// Draws a mystery: the motor of paper A within 15 %, and nothing, an effect of the catalogue, or one that is in none.
#[expect(
    clippy::missing_panics_doc,
    reason = "the embedded configuration is part of the program and a test parses it"
)]
pub fn draw(seed: u64) -> Mystery {
    let mut config = EmulatorConfig::embedded("zk-22fc-plain")
        .expect("a test parses every embedded configuration");
    // The specimen's parameters lie within this fraction of the nameplate.
    config.tolerance = 0.15;
    // The thermal switch must not end a run that only warms the winding up.
    config.limits.winding_limit_c = 300.0;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // Stream of the generator; tolerances, noise and random loads have their own.
    rng.set_stream(4);
    config.hidden = hidden(&mut rng, &Site::of(&config.motor)).into_iter().collect();
    let effects = config.hidden.iter().map(TrueEffect::from).collect();
    let motor = config.motor.specimen(config.tolerance, seed);
    Mystery { seed, config, truth: Truth { seed, motor, effects } }
}

fn hidden(rng: &mut ChaCha8Rng, nameplate: &Site) -> Option<HiddenEffect> {
    let kind: f64 = rng.random();
    // 10 % of the seeds have no hidden effect, 8 % one that no catalogue has.
    if kind < 0.1 {
        return None;
    }
    let ids = HiddenEffect::mysteries(kind < 0.1 + 0.08);
    let id = ids[rng.random_range(0..ids.len())];
    HiddenEffect::mystery(id, rng, nameplate)
}

impl From<&HiddenEffect> for TrueEffect {
    fn from(effect: &HiddenEffect) -> Self {
        Self {
            id: effect.id().to_owned(),
            is_foreign: effect.is_foreign(),
            parameters: effect
                .parameters()
                .into_iter()
                .map(|(key, value, unit)| TrueValue {
                    key: key.to_owned(),
                    value,
                    unit: unit.to_owned(),
                })
                .collect(),
        }
    }
}

impl fmt::Display for TrueEffect {
    /// The effect with its sizes.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = |own: &TrueValue| {
            let value = with_unit(&shortest(own.value, 4), &own.unit);
            format!("{} = {value}", own.key)
        };
        let sizes: Vec<String> = self.parameters.iter().map(size).collect();
        write!(f, "{} ({})", self.id, sizes.join(", "))
    }
}

#[cfg(test)]
mod tests;
