//! The on-line schemes over a recorded run, wired as the live bench wires them.

use super::left_out::motor_alone;
use super::{Data, Identified, IdentifyError, Scheme};
use crate::identification::online::{Online, OnlineConfig};

/// Paper A's scheme 2 with the trapezoid: inertia and load torque from current and speed.
pub(super) struct Scheme2;

/// Scheme 3: resistance, inductance, back-EMF, inertia and load torque from voltage, current and speed together.
pub(super) struct Scheme3;

fn over_run(data: &Data<'_>) -> Online {
    let mut online = Online::new(OnlineConfig::from_model(data.model));
    for sample in data.run_as_used().samples() {
        online.push(&sample);
    }
    online
}

impl Scheme for Scheme2 {
    fn id(&self) -> &'static str {
        "2"
    }

    fn summary(&self) -> &'static str {
        "on line, current and speed, trapezoid: inertia and load torque (torque constant known)"
    }

    fn identify(&self, data: &Data<'_>) -> Result<Identified, IdentifyError> {
        let found = over_run(data).scheme_2();
        Ok(Identified::new(self.id(), data.model, found).leaving_out(data.model, motor_alone))
    }
}

impl Scheme for Scheme3 {
    fn id(&self) -> &'static str {
        "3"
    }

    fn summary(&self) -> &'static str {
        "on line, voltage, current and speed: everything, as the bench shows it live"
    }

    fn identify(&self, data: &Data<'_>) -> Result<Identified, IdentifyError> {
        let found = over_run(data).estimates();
        Ok(Identified::new(self.id(), data.model, found).leaving_out(data.model, motor_alone))
    }
}
