//! Kit of this room's tests: closeness, and the machine of paper A in a loop of 10 ms.

use super::{LinearPlant, LoopTiming};
use drivebench_model::plant::{Model, Motor, MotorKey};

/// Equal to `tolerance`, relative to the larger of both where that is above one.
#[track_caller]
pub(crate) fn assert_close(found: f64, expected: f64, tolerance: f64) {
    let scale = found.abs().max(expected.abs());
    let within = tolerance * if scale > 1.0 { scale } else { 1.0 };
    assert!((found - expected).abs() <= within, "{found} is not {expected} within {tolerance}");
}

/// Inertia of the paper's motor for a mechanical time constant.
pub(super) fn inertia(mechanical_s: f64) -> f64 {
    mechanical_s * 0.3538 * 0.3538 / 1.1
}

pub(super) fn model(inertia_kg_m2: f64) -> Model {
    Model::baseline(Motor::zk_22fc().with(MotorKey::Inertia, inertia_kg_m2))
}

/// The paper's motor with this share of its inertia behind a coupling of 22 Hz.
pub(super) fn elastic(inertia_ratio: f64, damping_ratio: f64) -> Model {
    let mut model = model(0.0045).with_effect("elastic_coupling").unwrap();
    model.effects[0].values = [22.0, inertia_ratio, damping_ratio, 0.5].map(Some).to_vec();
    model
}

pub(super) fn plant(inertia_kg_m2: f64) -> LinearPlant {
    LinearPlant::voltage(&model(inertia_kg_m2), 0.0).unwrap()
}

/// The paper's motor with five times its inertia.
pub(super) fn slow_machine() -> LinearPlant {
    plant(0.0228)
}

/// A loop of 10 ms with so many cycles of delay.
pub(super) fn timing(cycles: f64) -> LoopTiming {
    LoopTiming { period_s: 0.01, delay_s: 0.01 * cycles, filter_s: 0.0 }
}
