//! What is not known of a plant: draws of the fitted parameters about their values.
//!
//! Each parameter is drawn from a normal distribution with the standard deviation that its fit gave, on its own: a model
//! file keeps no correlations, so that the spread is rather too wide than too narrow. Draws that make no plant are drawn
//! again: what is left is cut off at what is physical.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::{LinearPlant, PlantError};
use drivebench_model::plant::{FittedValue, Model};

/// How many are drawn, and from which seed: the same model has the same margins everywhere.
const DRAWS: usize = 200;
const SEED: u64 = 1;
/// Draws for one that makes a plant, at most.
const TRIES: usize = 200;

/// Plants of the model with its fitted parameters drawn; none where no deviation is known.
pub fn drawn(
    model: &Model,
    fitted: &[FittedValue],
    plant: impl Fn(&Model) -> Result<LinearPlant, PlantError>,
) -> Vec<LinearPlant> {
    let of = |key: &str| fitted.iter().find(|fitted| fitted.key == key);
    let slots = model.slots().into_iter().filter_map(|slot| {
        let std = of(&slot.key())?.std;
        let value = model.get(&slot)?;
        (std.is_finite() && std > 0.0).then_some((slot, value, std))
    });
    let slots: Vec<_> = slots.collect();
    if slots.is_empty() {
        return Vec::new();
    }
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    let mut one = || {
        (0..TRIES).find_map(|_| {
            let mut other = model.clone();
            for (slot, value, std) in &slots {
                let normal: f64 = StandardNormal.sample(&mut random);
                other.set(slot, value + std * normal);
            }
            plant(&other).ok()
        })
    };
    (0..DRAWS).filter_map(|_| one()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_close, elastic};

    fn fitted(values: &[(&str, f64)]) -> Vec<FittedValue> {
        let fitted =
            values.iter().map(|(key, std)| FittedValue { key: (*key).to_owned(), std: *std });
        fitted.collect()
    }

    #[test]
    fn draws_spread_as_their_fit_says_and_stay_physical() {
        let model = elastic(0.5, 0.02);
        let plant = |model: &Model| LinearPlant::voltage(model, 0.0);
        assert!(drawn(&model, &[], plant).is_empty());
        let stds = [
            ("elastic_coupling.frequency_hz", 0.3),
            ("elastic_coupling.damping_ratio", 0.02),
            ("stribeck_friction.stribeck_n_m", 1.0),
        ];
        let plants = drawn(&model, &fitted(&stds), plant);
        assert_eq!(plants.len(), DRAWS);
        let couplings = || plants.iter().filter_map(LinearPlant::coupling);
        let mean = |of: fn(&drivebench_model::plant::Coupling) -> f64| {
            couplings().map(of).sum::<f64>() / DRAWS as f64
        };
        assert_close(mean(|coupling| coupling.frequency_hz), 22.0, 0.01);
        let square = mean(|coupling| (coupling.frequency_hz - 22.0).powi(2));
        assert_close(square.sqrt(), 0.3, 0.05);
        // Cut off at zero: a mean of one deviation grows by 0.29 of it.
        assert!(couplings().all(|coupling| coupling.damping_ratio >= 0.0));
        assert_close(mean(|coupling| coupling.damping_ratio), 0.0258, 0.003);
        assert!(couplings().all(|coupling| (coupling.inertia_ratio - 0.5).abs() < 1e-12));
        assert_eq!(plants, drawn(&model, &fitted(&stds), plant));
    }
}
