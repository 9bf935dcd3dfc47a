//! The contract that every effect of the catalogue keeps.

use super::*;

#[test]
fn ids_and_keys_are_unique_and_every_card_is_filled() {
    let mut ids: Vec<&str> = CATALOGUE.iter().map(|effect| effect.card().id).collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), CATALOGUE.len());
    for effect in CATALOGUE {
        let card = effect.card();
        for text in [
            card.name,
            card.equation,
            card.causes,
            card.looks_like,
            card.excite,
            card.remedy,
        ] {
            assert!(text.len() > 4, "{}: {text:?}", card.id);
        }
        // A second inertia has no size: it is there with its frequency, or it is not.
        let values: Vec<f64> = effect
            .parameters()
            .iter()
            .map(ParameterSpec::guess)
            .collect();
        assert!(
            effect.parameters()[0].is_coefficient() || effect.terms(&values).coupling().is_some(),
            "{}",
            card.id
        );
    }
}

#[test]
fn an_effect_of_size_zero_adds_nothing_and_a_size_doubled_doubles_it() {
    let at = Instant {
        time_s: 1.0,
        voltage_v: 40.0,
        current_a: 3.0,
        speed_rad_s: 5.0,
        angle_rad: 0.7,
        ..Instant::of(&crate::plant::Motor::zk_22fc())
    };
    let total = |effect: &dyn Effect, size: f64| {
        let mut values: Vec<f64> = effect
            .parameters()
            .iter()
            .map(ParameterSpec::guess)
            .collect();
        values[0] = size;
        let terms = effect.terms(&values);
        let own = vec![2.0; terms.states()];
        [
            terms.voltage_v(&at, &own),
            terms.torque_n_m(&at, &own),
            terms.friction_n_m(&at),
        ]
    };
    for effect in CATALOGUE {
        if effect.card().enters == Enters::Path || !effect.parameters()[0].is_coefficient() {
            continue;
        }
        let scale = effect.parameters()[0].scale;
        let none = total(*effect, 0.0);
        let (once, twice) = (total(*effect, scale), total(*effect, 2.0 * scale));
        assert!(
            none.iter().all(|term| term.abs() < 1e-15),
            "{}",
            effect.card().id
        );
        assert!(
            once.iter().any(|term| term.abs() > 1e-6),
            "{} adds nothing",
            effect.card().id
        );
        for (one, two) in once.iter().zip(&twice) {
            assert!((two - 2.0 * one).abs() < 1e-12, "{}", effect.card().id);
        }
        let entered = match effect.card().enters {
            Enters::Voltage => once[0],
            Enters::Torque => once[1] + once[2],
            Enters::Both => once[0].min(once[1] + once[2]),
            Enters::Path => unreachable!("left out above"),
        };
        assert!(
            entered.abs() > 1e-6,
            "{} does not enter the balance its card names",
            effect.card().id
        );
    }
}
