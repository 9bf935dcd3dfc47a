//! LQG control with a disturbance observer and integral action.
//!
//! The Kalman filter has the load torque as a third state, a random walk. Its estimate is predicted over the loop's delay with
//! the outputs within it; the feedback acts on the prediction. The load is fed forward, and an integral of the error
//! compensates the errors of the model.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::PaperBError;
use crate::limiter::limited;
use crate::{LinearPlant, LoopTiming, Measured, SpeedController};
use drivebench_model::numerics::riccati;
use drivebench_model::plant::{Model, MotorKey};

/// Weights; the noises are standard deviations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoadObservingSettings {
    pub speed_noise_rad_s: f64,
    /// Of the load torque's random walk after a second, N.m.
    pub load_wander_n_m: f64,
    /// Error that costs as much as `voltage_v`, rad/s.
    pub error_rad_s: f64,
    pub voltage_v: f64,
    /// Time constant of the integral part, s.
    pub integral_s: f64,
}

impl Default for LoadObservingSettings {
    fn default() -> Self {
        Self {
            speed_noise_rad_s: 0.15,
            load_wander_n_m: 1.0,
            error_rad_s: 3.0,
            voltage_v: 10.0,
            integral_s: 0.5,
        }
    }
}

#[derive(Clone, Debug)]
pub struct LoadObserving {
    /// One period of current, speed and load, the voltage held.
    phi: Matrix3<f64>,
    gamma: Vector3<f64>,
    filter: Vector3<f64>,
    /// Of current, speed and the error's integral.
    feedback: Vector3<f64>,
    resistance_ohm: f64,
    back_emf_v_s_per_rad: f64,
    torque_n_m_per_a: f64,
    iterations: [usize; 2],
    delay_periods: usize,
    x: Vector3<f64>,
    integral: f64,
    /// Outputs within the delay, the oldest first.
    delayed: VecDeque<f64>,
    wanted: f64,
    limited: f64,
}

impl LoadObserving {
    pub const ID: &str = "load-observer";

    /// Refused: recursions that do not converge, and as a setting that is not allowed a value that the model lacks.
    pub fn new(
        model: &Model,
        plant: &LinearPlant,
        timing: &LoopTiming,
        settings: &LoadObservingSettings,
    ) -> Result<Self, PaperBError> {
        let value = |key: MotorKey| {
            model.motor.get(key).ok_or(PaperBError::Setting {
                what: key.key(),
                value: f64::NAN,
                allowed: "a value in the model file",
            })
        };
        let inertia = value(MotorKey::Inertia)?;
        let (phi_2, gamma_2) = plant.rigid().held_over(timing.period_s);
        let (phi, gamma) = with_load(plant, timing.period_s, inertia);
        let c = Vector3::new(0.0, 1.0, 0.0);
        let load_variance = settings.load_wander_n_m.powi(2) * timing.period_s;
        let process = gamma * gamma.transpose() * settings.voltage_v.powi(2) * 1e-4
            + Matrix3::from_diagonal(&Vector3::new(1e-6, 1e-6, load_variance));
        let noise = settings.speed_noise_rad_s.powi(2).max(1e-9);
        // Of the steady gains.
        let tolerance = 1e-10;
        let filter = riccati::filter(&phi, &process, &c, noise, tolerance)
            .ok_or(PaperBError::Iteration("filter's gain"))?;
        let mut with_integral = Matrix3::identity();
        (with_integral.fixed_view_mut::<2, 2>(0, 0)).copy_from(&phi_2.fixed_view::<2, 2>(0, 0));
        with_integral[(2, 1)] = timing.period_s;
        let input = Vector3::new(gamma_2[0], gamma_2[1], 0.0);
        let error_cost = settings.error_rad_s.powi(-2);
        let integral_cost = error_cost / settings.integral_s.powi(2);
        let weight = Matrix3::from_diagonal(&Vector3::new(0.0, error_cost, integral_cost));
        let voltage_cost = settings.voltage_v.powi(-2);
        let feedback = riccati::feedback(&with_integral, &input, &weight, voltage_cost, tolerance)
            .ok_or(PaperBError::Iteration("feedback's gain"))?;
        let delay_periods = timing.whole_cycles();
        Ok(Self {
            phi,
            gamma,
            filter: filter.gain,
            feedback: feedback.gain,
            resistance_ohm: value(MotorKey::Resistance)?,
            back_emf_v_s_per_rad: value(MotorKey::BackEmf)?,
            torque_n_m_per_a: model.motor.torque_constant().unwrap_or(f64::NAN),
            iterations: [filter.changes.len(), feedback.changes.len()],
            delay_periods,
            x: Vector3::zeros(),
            integral: 0.0,
            delayed: vec![0.0; delay_periods].into(),
            wanted: 0.0,
            limited: 0.0,
        })
    }

    /// Estimated load torque, N.m, against positive motion.
    pub fn load_n_m(&self) -> f64 {
        self.x[2]
    }
}

/// Current, speed and a constant load torque, over one period (Van Loan 1978).
fn with_load(plant: &LinearPlant, period_s: f64, inertia: f64) -> (Matrix3<f64>, Vector3<f64>) {
    let (a, b) = plant.matrices();
    let mut joint = nalgebra::Matrix4::<f64>::zeros();
    joint.fixed_view_mut::<2, 2>(0, 0).copy_from(a);
    joint[(1, 2)] = -1.0 / inertia;
    joint.fixed_view_mut::<2, 1>(0, 3).copy_from(b);
    let expm = (joint * period_s).exp();
    (expm.fixed_view::<3, 3>(0, 0).into_owned(), expm.fixed_view::<3, 1>(0, 3).into_owned())
}

impl SpeedController for LoadObserving {
    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64 {
        let mut correction = self.filter * (now.speed_rad_s - self.x[1]);
        if now.limited {
            // The output was cut: the missing speed is no load.
            correction[2] = 0.0;
            self.x[0] = now.current_a.unwrap_or(self.x[0]);
        }
        self.x += correction;
        let mut ahead = self.x;
        for &voltage in &self.delayed {
            ahead = self.phi * ahead + self.gamma * voltage;
        }
        let error = ahead[1] - reference_rad_s;
        if now.limited && self.limited == 0.0 {
            // A limit within the drive: it cuts on the side of the error.
            self.limited = -error.signum();
        }
        if error * self.limited >= 0.0 {
            self.integral += period_s * error;
        }
        let load_a = ahead[2] / self.torque_n_m_per_a;
        let holding_v = self.back_emf_v_s_per_rad * reference_rad_s + self.resistance_ohm * load_a;
        let deviation = Vector3::new(ahead[0] - load_a, error, self.integral);
        self.wanted = holding_v - self.feedback.dot(&deviation);
        self.wanted
    }

    fn applied(&mut self, output: f64) {
        self.limited = limited(self.wanted, output);
        self.delayed.push_back(output);
        let acting = self.delayed.pop_front().unwrap_or(output);
        self.x = self.phi * self.x + self.gamma * acting;
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        let current = now.current_a.unwrap_or(0.0);
        self.x = Vector3::new(current, now.speed_rad_s, self.torque_n_m_per_a * current);
        self.integral = 0.0;
        self.limited = 0.0;
        self.wanted = output;
        self.delayed.clear();
        self.delayed.resize(self.delay_periods, output);
    }

    fn explain(&self) -> Vec<String> {
        vec![
            format!(
                "Kalman gain {:.4} A, {:.4} rad/s, {:.5} N.m per rad/s after {} iterations; feedback {:.4} V/A, {:.4} V per rad/s, integral {:.4} V/rad after {}",
                self.filter[0],
                self.filter[1],
                self.filter[2],
                self.iterations[0],
                self.feedback[0],
                self.feedback[1],
                self.feedback[2],
                self.iterations[1]
            ),
            format!(
                "acts on the state predicted over {} cycles; the observed load, {:.3} N.m now, is fed forward",
                self.delay_periods, self.x[2]
            ),
        ]
    }
}
