//! The extended Kalman filter over a recorded run.

use super::{Data, Identified, IdentifyError, Scheme};
use crate::identification::kalman::{self, KalmanConfig};
use crate::plant::{ActiveEffect, Input};

pub(super) struct Ekf;

impl Scheme for Ekf {
    fn id(&self) -> &'static str {
        "ekf"
    }

    fn summary(&self) -> &'static str {
        "on line, extended Kalman filter over state and parameters; then again over the whole run"
    }

    fn identify(&self, data: &Data<'_>) -> Result<Identified, IdentifyError> {
        if data.scenario.input != Input::Voltage {
            return Err(IdentifyError::Unusable {
                scheme: self.id(),
                run: data.run.name.clone(),
                reason: "it has no voltage to predict the current from".to_owned(),
                help: "use --scheme weak-form, or map a voltage with --map voltage_v=HEADER",
            });
        }
        let config = KalmanConfig {
            model: data.model.clone(),
            ..KalmanConfig::default()
        };
        let found = kalman::identify(&config, &data.run_as_used(), &data.scenario.unknown_input);
        let identified = Identified::new(self.id(), data.model, found.estimates());
        let left_out = kalman::effects_left_out(data.model);
        let why = |active: &ActiveEffect| {
            left_out.contains(&active.id()).then_some(
                "the filter subtracts effects whose values are all given, and that depend on voltage, current and speed alone",
            )
        };
        Ok(identified
            .with_note(found.summary())
            .leaving_out(data.model, why))
    }
}
