//! What may be said of each fitted parameter.

use super::covariance::clustered;
use super::free_run::FreeRun;
use crate::numerics::levenberg_marquardt::Minimum;
use crate::plant::{Model, MotorKey, Scenario, Slot};
use crate::sample::{ParameterEstimate, Verdict};

/// Relative standard deviation above which a positive parameter is not carried by the data.
const NOT_OBSERVABLE: f64 = 0.5;
/// Relative standard deviation below which it is settled.
const SETTLED: f64 = 0.02;

/// Estimates of every slot of `model`, free and fixed.
pub(super) fn estimates(
    model: &Model,
    problem: &FreeRun<'_>,
    minimum: &Minimum,
    scenario: &Scenario,
) -> Vec<ParameterEstimate> {
    let covariance = clustered(minimum, problem.rows(), scenario);
    let slopes = problem.slopes(&minimum.x);
    model
        .slots()
        .iter()
        .map(|slot| {
            let key = slot.key();
            let value = model.get(slot);
            let Some(index) = problem
                .free_slots()
                .iter()
                .position(|free| free.key() == key)
            else {
                let (std, reason) = (Some(0.0), None);
                return ParameterEstimate {
                    key,
                    value,
                    std,
                    unit: slot.unit(),
                    verdict: Verdict::Fixed,
                    reason,
                };
            };
            let variance = covariance[(index, index)];
            let std = variance
                .is_finite()
                .then(|| variance.max(0.0).sqrt() * slopes[index].abs());
            judge(slot, value.unwrap_or(f64::NAN), std, scenario)
        })
        .collect()
}

fn judge(slot: &Slot, value: f64, std: Option<f64>, scenario: &Scenario) -> ParameterEstimate {
    let (key, unit) = (slot.key(), slot.unit());
    let Some(std) = std else {
        return ParameterEstimate::not_observable(
            &key,
            unit,
            "the run does not excite it: no unique value",
        );
    };
    let relative = std / value.abs().max(f64::MIN_POSITIVE);
    let positive = matches!(slot, Slot::Motor(_));
    if positive && relative > NOT_OBSERVABLE {
        let reason = match slot {
            Slot::Motor(MotorKey::Inductance) => inductance_reason(scenario, relative),
            _ => format!(
                "relative uncertainty {:.0} %: the run does not excite it",
                100.0 * relative
            ),
        };
        return ParameterEstimate::not_observable(&key, unit, reason);
    }
    // An effect's coefficient may be zero within its uncertainty: that is a finding, not a failure.
    let settled = relative <= SETTLED || !positive;
    ParameterEstimate {
        key,
        value: Some(value),
        std: Some(std),
        unit,
        verdict: if settled {
            Verdict::Settled
        } else {
            Verdict::Searching
        },
        reason: (!settled).then(|| format!("relative uncertainty {:.1} %", 100.0 * relative)),
    }
}

fn inductance_reason(scenario: &Scenario, relative: f64) -> String {
    let times = &scenario.sample_time_s;
    let period_ms = 1e3 * (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    format!(
        "relative uncertainty {:.0} % at a period of {period_ms:.1} ms: sample faster, or use burst capture",
        100.0 * relative
    )
}
