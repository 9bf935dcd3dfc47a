//! Runs that know current and motion but no torque constant: everything in the torque balance is a ratio to it.

use crate::plant::{Input, Model, MotorKey, Scenario};
use crate::sample::ParameterEstimate;
use crate::text::number::with_std;

/// Whether current is all that drives this run, with nothing to turn it into torque.
pub(super) fn lacks_torque_constant(model: &Model, scenario: &Scenario) -> bool {
    scenario.input == Input::Current && model.motor.torque_constant().is_none()
}

/// The model with a torque constant of one: its values are then ratios.
pub(super) fn with_unit_torque_constant(model: &Model) -> Model {
    let mut unit = model.clone();
    unit.motor.set(MotorKey::TorqueConstant, 1.0);
    unit
}

/// A value in units of the unknown torque constant: the ratio is told in the reason, but it is not the parameter.
pub(super) fn told(found: ParameterEstimate) -> ParameterEstimate {
    let (Some(value), Some(std)) = (found.value, found.std) else {
        return found;
    };
    let reason = format!(
        "known only relative to the torque constant: {} {} per N.m/A; give torque_n_m_per_a or \
         back_emf_v_s_per_rad, or run once more with a known added inertia",
        with_std(value, std),
        found.unit
    );
    ParameterEstimate::not_observable(&found.key, found.unit, reason)
}
