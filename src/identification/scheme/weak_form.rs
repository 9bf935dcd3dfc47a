//! Weak form of both balances.

use super::{Data, Identified, IdentifyError, Scheme};
use crate::identification::{missing_cells, torque_ratio, weak_form};
use crate::plant::{Model, Scenario};
use crate::sample::{ParameterEstimate, Verdict};

pub(super) struct WeakForm;

impl Scheme for WeakForm {
    fn id(&self) -> &'static str {
        "weak-form"
    }

    fn summary(&self) -> &'static str {
        "balances averaged over smooth windows (default without a voltage)"
    }

    fn identify(&self, data: &Data<'_>) -> Result<Identified, IdentifyError> {
        let parameters = parameters(data.model, data.scenario)?;
        Ok(Identified::new(self.id(), data.model, parameters).with_note(
            "weak form: windows without standstill; friction values depend on the method by some per cent",
        ))
    }
}

/// Values of both balances: over whole rows, and as ratios in the reasons where the torque constant is unknown.
pub(super) fn parameters(
    model: &Model,
    scenario: &Scenario,
) -> Result<Vec<ParameterEstimate>, IdentifyError> {
    let bridged = missing_cells::bridged(scenario);
    let scenario = bridged.as_ref().unwrap_or(scenario);
    let relative = torque_ratio::lacks_torque_constant(model, scenario);
    let unit = relative.then(|| torque_ratio::with_unit_torque_constant(model));
    let balances = weak_form::fit(unit.as_ref().unwrap_or(model), scenario)?;
    let told = |found: ParameterEstimate| match found.verdict {
        Verdict::Fixed => found,
        _ if relative => torque_ratio::told(found),
        _ => found,
    };
    Ok(balances
        .into_iter()
        .flat_map(|balance| balance.parameters)
        .map(told)
        .collect())
}
