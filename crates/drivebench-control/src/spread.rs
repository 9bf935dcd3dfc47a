//! Monte Carlo draws of a plant over the uncertainty of its fitted parameters.
//!
//! Each parameter is drawn from a normal distribution with the standard deviation of its fit, independently: a model file
//! keeps no correlations, so that the spread is rather too wide than too narrow. Draws that make no plant are drawn again,
//! which truncates the distribution at what is physical.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::{LinearPlant, PlantError};
use drivebench_model::plant::{FittedValue, Model};

const DRAWS: usize = 200;

/// Plants of the model with its fitted parameters drawn; none where no deviation is known. The seed is fixed: the same model
/// has the same margins everywhere.
pub fn drawn(
    model: &Model,
    fitted: &[FittedValue],
    plant: impl Fn(&Model) -> Result<LinearPlant, PlantError>,
) -> Vec<LinearPlant> {
    let slots: Vec<_> = (model.slots().into_iter())
        .filter_map(|slot| {
            let key = slot.key();
            let std = fitted.iter().find(|fitted| fitted.key == key)?.std;
            let value = model.get(&slot)?;
            (std.is_finite() && std > 0.0).then_some((slot, value, std))
        })
        .collect();
    if slots.is_empty() {
        return Vec::new();
    }
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut one = || {
        (0..200).find_map(|_| {
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

    #[test]
    fn draws_spread_as_their_fit_and_stay_physical() {
        let model = elastic(0.5, 0.02);
        let plant = |model: &Model| LinearPlant::voltage(model, 0.0);
        assert!(drawn(&model, &[], plant).is_empty());
        let stds = [
            ("elastic_coupling.frequency_hz", 0.3),
            ("elastic_coupling.damping_ratio", 0.02),
            ("stribeck_friction.stribeck_n_m", 1.0),
        ]
        .map(|(key, std)| FittedValue { key: key.to_owned(), std });
        let plants = drawn(&model, &stds, plant);
        assert_eq!(plants.len(), DRAWS);
        let couplings = || plants.iter().filter_map(LinearPlant::coupling);
        let mean = |of: fn(&drivebench_model::plant::Coupling) -> f64| {
            couplings().map(of).sum::<f64>() / DRAWS as f64
        };
        assert_close(mean(|coupling| coupling.frequency_hz), 22.0, 0.01);
        assert_close(mean(|coupling| (coupling.frequency_hz - 22.0).powi(2)).sqrt(), 0.3, 0.05);
        // Cut off at zero: a mean of one deviation grows by 0.29 of it.
        assert!(couplings().all(|coupling| coupling.damping_ratio >= 0.0));
        assert_close(mean(|coupling| coupling.damping_ratio), 0.0258, 0.003);
        assert!(couplings().all(|coupling| (coupling.inertia_ratio - 0.5).abs() < 1e-12));
        assert_eq!(plants, drawn(&model, &stds, plant));
    }
}
