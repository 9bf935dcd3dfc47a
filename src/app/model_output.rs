//! Model files that commands write.

use crate::diagnosis::Rung;
use crate::identification::noise::FloorSource;
use crate::plant::FittedValue;
use crate::sample::ParameterEstimate;

/// The standard deviations that a model file keeps beside its values.
pub(crate) fn fitted(parameters: &[ParameterEstimate]) -> Vec<FittedValue> {
    parameters
        .iter()
        .filter_map(|p| {
            Some(FittedValue {
                key: p.key.clone(),
                std: p.std.filter(|std| *std > 0.0)?,
            })
        })
        .collect()
}

/// One line of a model file's ladder.
pub(crate) fn rung(rung: &Rung, floor: FloorSource) -> String {
    let effects = if rung.effects.is_empty() {
        "baseline".to_owned()
    } else {
        rung.effects.join(" + ")
    };
    format!(
        "{effects}: held-out error {:.2} {}",
        rung.holdout_rmse,
        floor.times()
    )
}
