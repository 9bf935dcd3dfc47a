//! Readings from one step of voltage: the plain baseline.

use super::left_out::motor_alone;
use super::{Data, Identified, IdentifyError, Scheme};
use crate::identification::step_response;

pub(super) struct StepResponse;

impl Scheme for StepResponse {
    fn id(&self) -> &'static str {
        "step-response"
    }

    fn summary(&self) -> &'static str {
        "graphical readings from one step of voltage out of rest: a plain baseline, crude"
    }

    fn identify(&self, data: &Data<'_>) -> Result<Identified, IdentifyError> {
        let (parameters, notes) = step_response::estimates(data.model, data.scenario);
        let mut identified = Identified::new(self.id(), data.model, parameters);
        identified.notes = notes;
        Ok(identified.leaving_out(data.model, motor_alone))
    }
}
