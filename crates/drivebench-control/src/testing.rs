//! Fixtures of this crate's tests: closeness, and the machine of paper A in a loop of 10 ms.

use std::sync::{Arc, Mutex};

use super::{
    CurrentLimit, Limiter, LinearPlant, LoopTiming, Measured, PiGains, SpeedController,
    TrialMachine,
};
pub(super) use drivebench_model::plant::testing::with;
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
    with(&model(0.0045), "elastic_coupling", &[22.0, inertia_ratio, damping_ratio, 0.5])
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

/// The paper's motor with a current limit of the drive; `noise` in those of the usual sensors.
pub(super) fn machine(noise: f64) -> TrialMachine {
    TrialMachine {
        resistance_ohm: 1.1,
        inductance_h: 0.0099,
        back_emf_v_s_per_rad: 0.3538,
        torque_n_m_per_a: 0.3538,
        friction_n_m: 0.455,
        viscous_n_m_s_per_rad: 0.0,
        coupling: None,
        drive_current_limit_a: 11.4,
        period_s: 0.01,
        delay_periods: 2,
        speed_noise_rad_s: 0.15 * noise,
        current_noise_a: 0.03 * noise,
    }
}

/// 110 V, and 10 A through that motor's winding at the end of the dead time.
pub(super) fn limiter(timing: &LoopTiming) -> Limiter {
    Limiter {
        output: 110.0,
        current: Some(CurrentLimit {
            current_a: 10.0,
            resistance_ohm: 1.1,
            back_emf_v_s_per_rad: 0.3538,
            ahead_s: timing.dead_time_s(),
        }),
    }
}

pub(super) const fn pi_gains(proportional: f64, integral_time_s: f64) -> PiGains {
    PiGains { proportional, integral_time_s, reference_filter_s: 0.0, notch: None }
}

/// Gives the same output whatever is measured, and records its references.
#[derive(Clone, Default)]
pub(super) struct Fixed {
    pub(super) output: f64,
    pub(super) follows_plan: bool,
    pub(super) references: Arc<Mutex<Vec<f64>>>,
}

impl Fixed {
    pub(super) fn new(output: f64) -> Self {
        Self { output, ..Self::default() }
    }
}

impl SpeedController for Fixed {
    fn follow_plan(&mut self) -> bool {
        self.follows_plan
    }
    fn step(&mut self, reference_rad_s: f64, _: &Measured, _: f64) -> f64 {
        self.references.lock().unwrap().push(reference_rad_s);
        self.output
    }
    fn applied(&mut self, _: f64) {}
    fn reset(&mut self, _: &Measured, _: f64) {}
}
