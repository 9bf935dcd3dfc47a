//! The forms of an effect that the screen tries.

use crate::plant::{Effect, ParameterRole, Scenario};

/// Every combination of the grids of an effect's shapes, choices and event times; its coefficients at zero.
pub(super) fn shape_grid(effect: &dyn Effect, training: &Scenario) -> Vec<Vec<f64>> {
    let specs = effect.parameters();
    let length_s = training.sample_time_s[training.samples() - 1] - training.begin_s();
    let mut grid = vec![vec![0.0; specs.len()]];
    for (index, spec) in specs.iter().enumerate() {
        if spec.is_coefficient() {
            continue;
        }
        let unit = if spec.role == ParameterRole::EventTime {
            length_s
        } else {
            1.0
        };
        grid = grid
            .into_iter()
            .flat_map(|values| {
                spec.shapes.iter().map(move |shape| {
                    let mut values = values.clone();
                    values[index] = shape * unit;
                    values
                })
            })
            .collect();
    }
    grid
}
