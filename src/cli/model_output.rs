//! Model files that commands write.

use std::path::Path;

use super::failure::{Failure, USAGE};
use crate::diagnosis::Rung;
use crate::identification::noise::FloorSource;
use crate::plant::FittedValue;
use crate::sample::ParameterEstimate;

/// Models are never overwritten.
pub(super) fn refuse_existing(path: &Path) -> Result<(), Failure> {
    if path.exists() {
        let headline = format!(
            "{}: exists already, and models are never overwritten",
            path.display()
        );
        return Err(Failure::with_help(
            USAGE,
            headline,
            "choose another name for --output",
        ));
    }
    Ok(())
}

/// The standard deviations that a model file keeps beside its values.
pub(super) fn fitted(parameters: &[ParameterEstimate]) -> Vec<FittedValue> {
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
pub(super) fn rung(rung: &Rung, floor: FloorSource) -> String {
    let effects = if rung.effects.is_empty() {
        "baseline".to_owned()
    } else {
        rung.effects.join(" + ")
    };
    format!(
        "{effects}: held-out error {:.3} {}",
        rung.holdout_rmse,
        floor.times()
    )
}
