//! A learned curve as an effect of the model, while its name is still unknown.

use crate::plant::effect::{self, Axis, DefinitionError};
use crate::plant::{Effect, Model, Slot};

/// A table over these knots, its values yet to be fitted.
///
/// # Errors
/// Knots that do not rise, or too few or too many of them.
pub fn table(
    id: &str,
    equation: &str,
    axis: Axis,
    knots: &[f64],
) -> Result<&'static dyn Effect, DefinitionError> {
    let knots = knots.iter().copied().map(toml::Value::from).collect();
    let settings = [
        ("equation", equation.into()),
        ("axis", axis.key().into()),
        ("knots", toml::Value::Array(knots)),
    ];
    let settings = settings.map(|(key, value)| (key.to_owned(), value));
    let settings = toml::Table::from_iter(settings);
    effect::define(id, &settings).map(|(effect, _)| effect)
}

/// A knot that a person can read in a model file.
pub fn four_digits(knot: f64) -> f64 {
    format!("{knot:.3e}").parse().unwrap_or(knot)
}

/// A curve over the current holds a resistance, one over the speed a back-EMF: beside the curve neither can be told, so that
/// the parameter is fixed at what the baseline's fit gave it, for as long as the curve `id` is in the model. Returns its
/// key where that was done.
pub fn hold_what_the_curve_holds(
    model: &mut Model,
    fitted: &Model,
    id: &str,
    equation: &str,
    axis: Axis,
) -> Option<&'static str> {
    let held = match (equation, axis) {
        ("voltage", Axis::Current) => "resistance_ohm",
        ("voltage", Axis::Speed) => "back_emf_v_s_per_rad",
        _ => return None,
    };
    if model.fixed.iter().any(|key| key == held) {
        model.hold(id, held);
        return None;
    }
    let slot = fitted
        .slots()
        .into_iter()
        .find(|slot: &Slot| slot.key() == held)?;
    model.set(&slot, fitted.get(&slot)?);
    model.hold(id, held);
    Some(held)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::{ActiveEffect, Motor};

    #[test]
    fn knots_are_readable() {
        assert!((four_digits(-118.716_712_5) + 118.7).abs() < 1e-12);
        assert!(four_digits(0.0).abs() < 1e-300);
    }

    #[test]
    fn a_curve_over_the_current_takes_the_resistance_out_of_the_fit() {
        let fitted = Model::baseline(Motor::zk_22fc());
        let mut model = fitted.clone();
        for (id, equation, axis, held) in [
            ("table_i", "voltage", Axis::Current, Some("resistance_ohm")),
            ("table_i", "voltage", Axis::Current, None),
            ("table_w", "torque", Axis::Speed, None),
        ] {
            let found = hold_what_the_curve_holds(&mut model, &fitted, id, equation, axis);
            assert_eq!(found, held, "{id}");
            assert_eq!(model.fixed, ["resistance_ohm"], "{id}");
        }
        let curve = table("table_i", "voltage", Axis::Current, &[-1.0, 0.0, 1.0]).unwrap();
        model.effects.push(ActiveEffect::new(curve));
        let without = model.without_effect("table_i").unwrap();
        assert!(without.fixed.is_empty(), "{:?}", without.fixed);
    }
}
