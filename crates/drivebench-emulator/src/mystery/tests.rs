use std::collections::BTreeSet;

use super::*;
use drivebench_model::numerics::checksum::{EMPTY, fnv_1a};
use drivebench_model::plant::effect;

#[test]
fn every_effect_is_drawn_and_sometimes_none() {
    let drawn: Vec<Mystery> = (0..1500).map(draw).collect();
    let ids = drawn.iter().flat_map(|mystery| &mystery.truth.effects);
    let ids: BTreeSet<&str> = ids.map(|effect| effect.id.as_str()).collect();
    let listed: BTreeSet<&str> =
        [false, true].into_iter().flat_map(HiddenEffect::mysteries).collect();
    assert_eq!(ids, listed);
    // Binomial, four standard errors.
    let share = |count: usize| count as f64 / drawn.len() as f64;
    let none = drawn.iter().filter(|m| m.truth.effects.is_empty()).count();
    let foreign = drawn.iter().filter(|m| m.truth.effect().is_some_and(|e| e.is_foreign)).count();
    assert!((share(none) - 0.1).abs() < 0.031, "{none}");
    assert!((share(foreign) - 0.08).abs() < 0.028, "{foreign}");
}

#[test]
fn a_mystery_is_a_drive_with_effects_of_the_right_catalogue() {
    let known: Vec<&str> = HiddenEffect::ids().filter(|id| effect::find(id).is_some()).collect();
    let drawn = HiddenEffect::mysteries(false);
    assert_eq!(known, drawn, "a new effect joins the draw");
    for seed in 0..400 {
        let mystery = draw(seed);
        assert_eq!(mystery, draw(seed));
        let text = toml::to_string(&mystery.config).unwrap();
        assert_eq!(EmulatorConfig::parse("mystery", &text).unwrap(), mystery.config);
        for hidden in &mystery.truth.effects {
            let found = effect::find(&hidden.id);
            assert_eq!(found.is_none(), hidden.is_foreign, "{}", hidden.id);
            // Every parameter of the host's form can be compared.
            for spec in found.iter().flat_map(|effect| effect.parameters()) {
                let has = hidden.parameters.iter().any(|value| value.key == spec.key);
                assert!(has, "{}.{}", hidden.id, spec.key);
            }
        }
        for load in &mystery.config.hidden {
            if let Some(weight_n_m) = load.value("constant_n_m") {
                // Else it would run away as soon as the drive lets go.
                assert!(weight_n_m.abs() < mystery.truth.motor.load_torque_n_m);
            }
        }
    }
}

/// The published scores stand on these machines: the order in which sizes are drawn must not change. Who adds an effect to
/// the draw changes them, and publishes new scores.
#[test]
fn the_machines_of_the_published_seeds_stay_as_they_are() {
    let mut all = String::new();
    for seed in 1..=200 {
        let Mystery { config, truth, .. } = draw(seed);
        all += &toml::to_string(&config).unwrap();
        all += &serde_json::to_string(&truth).unwrap();
    }
    assert_eq!(fnv_1a(EMPTY, all.bytes()), 0xde25_a6bf_1d47_120e);
}
