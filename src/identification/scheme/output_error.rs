//! Batch output-error fit: the reference among our methods.

use super::{Data, Identified, IdentifyError, Scheme};
use crate::identification::noise::NoiseFloor;
use crate::identification::{output_error, start};
use crate::plant::Input;

pub(super) struct OutputError;

impl Scheme for OutputError {
    fn id(&self) -> &'static str {
        "output-error"
    }

    fn summary(&self) -> &'static str {
        "batch fit of the free run (default with a voltage)"
    }

    fn identify(&self, data: &Data<'_>) -> Result<Identified, IdentifyError> {
        if data.scenario.input != Input::Voltage {
            return Err(IdentifyError::Unusable {
                scheme: self.id(),
                run: data.run.name.clone(),
                reason: "it has no voltage to simulate from".to_owned(),
                help: "use --scheme weak-form, or map a voltage with --map voltage_v=HEADER",
            });
        }
        let start = start::complete(data.model, data.scenario)?;
        let noise = NoiseFloor::from_standstill(data.scenario)
            .unwrap_or_else(|| NoiseFloor::from_spread(data.scenario));
        let fit = output_error::fit(&[start], data.scenario, &noise)?;
        Ok(Identified {
            scheme: self.id(),
            model: fit.model,
            parameters: fit.parameters,
            notes: Vec::new(),
        })
    }
}
