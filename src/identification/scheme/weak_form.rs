//! Weak form of both balances.

use super::{Data, Identified, IdentifyError, Scheme};
use crate::identification::weak_form;
use crate::sample::ParameterEstimate;

pub(super) struct WeakForm;

impl Scheme for WeakForm {
    fn id(&self) -> &'static str {
        "weak-form"
    }

    fn summary(&self) -> &'static str {
        "balances averaged over smooth windows (default without a voltage)"
    }

    fn identify(&self, data: &Data<'_>) -> Result<Identified, IdentifyError> {
        let parameters: Vec<ParameterEstimate> = weak_form::fit(data.model, data.scenario)?
            .into_iter()
            .flat_map(|balance| balance.parameters)
            .collect();
        Ok(Identified::new(self.id(), data.model, parameters).with_note(
            "weak form: windows without standstill; friction values depend on the method by some per cent",
        ))
    }
}
