//! Paper B: LQG control (Kalman filter, state feedback by dynamic programming) with adaptive compensation of the load.
//!
//! Corrections to the scan: `u* = -gamma G (x - [r, r])`; the predictor works on measured speeds and
//! is fed `u*`, not `u* + u0`. Symbols: n is the speed, here in rad/s; A, B, D, F are the coefficients of eq. (9).

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::{Measured, SpeedController};
use drivebench_model::numerics::linear_map;
use drivebench_model::numerics::riccati::{self, Steady};

/// `n(z)/U(z) = (A z + B) / (z^2 + F z + D)`: an integrator and a lag, the back-EMF does not feed back (eq. (6) to (9)).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PaperBPlant {
    pub a: f64,
    pub b: f64,
    pub d: f64,
    pub f: f64,
}

impl PaperBPlant {
    /// `electrical_s` is T1, `mechanical_s` Tm of the paper.
    pub fn new(
        period_s: f64,
        electrical_s: f64,
        mechanical_s: f64,
        back_emf_v_s_per_rad: f64,
    ) -> Self {
        let at = period_s / electrical_s;
        let decay = (-at).exp();
        let rate = electrical_s / (back_emf_v_s_per_rad * mechanical_s);
        Self {
            // a T - 1 + exp(-a T) without the cancellation of a short period.
            a: (at + (-at).exp_m1()) * rate,
            b: (-(-at).exp_m1() - at * decay) * rate,
            d: decay,
            f: -(1.0 + decay),
        }
    }

    /// State `x1 = n(k)`, `x2 = n(k+1) - A u(k)`: `x(k+1) = G x + H u`.
    pub fn state_space(&self) -> (Matrix2<f64>, Vector2<f64>) {
        (Matrix2::new(0.0, 1.0, -self.d, -self.f), Vector2::new(self.a, self.b - self.a * self.f))
    }
}

/// T, Q, R, V, W, mu are not in the paper; these values are chosen here.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperBSettings {
    /// Variance of the noise on the input, V^2 (Q).
    pub process_noise: f64,
    /// Variance of the noise on the speed, (rad/s)^2 (R).
    pub measurement_noise: f64,
    /// Cost of the speed's error (V) and of the voltage (W).
    pub error_cost: f64,
    pub voltage_cost: f64,
    /// Share by which the filtered prediction error follows (mu).
    pub filter_share: f64,
    /// Size of the compensation, in paper B's K3; 0 switches it off.
    pub compensation: f64,
    /// Change of a gain at which its iteration ends.
    pub tolerance: f64,
}

impl Default for PaperBSettings {
    fn default() -> Self {
        Self {
            process_noise: 0.05,
            measurement_noise: 0.02,
            error_cost: 1.0,
            voltage_cost: 0.02,
            filter_share: 0.1,
            compensation: 0.3,
            tolerance: 1e-6,
        }
    }
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum PaperBError {
    #[error("{what} = {value} is not allowed (expected {allowed})")]
    Setting { what: &'static str, value: f64, allowed: &'static str },
    #[error("the {0} does not converge with these settings")]
    Iteration(&'static str),
    #[error("the closed loop would have a radius of {radius:.4} (allowed: below 1)")]
    Unstable { radius: f64 },
}

impl PaperBError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::Setting { .. } => "leave it out for the default",
            Self::Iteration(_) => "give costs and noises that are above zero and not too far apart",
            Self::Unstable { .. } => {
                "lower the compensation or its filter share, or raise the voltage's cost"
            }
        }
    }
}

#[derive(Clone, Debug)]
pub struct PaperB {
    plant: PaperBPlant,
    settings: PaperBSettings,
    filter: Steady<2>,
    /// gamma G.
    feedback: Vector2<f64>,
    feedback_changes: Vec<f64>,
    gain_3: f64,
    radius: f64,
    state: Memory,
    wanted: f64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Memory {
    x: Vector2<f64>,
    /// Measured speeds and u* of the last two cycles, the newer first.
    speeds: [f64; 2],
    voltages: [f64; 2],
    filtered: f64,
    compensation: f64,
    /// A limit of the drive held the output before.
    limited: bool,
}

impl PaperB {
    pub const ID: &str = "paper-b";

    pub fn new(plant: PaperBPlant, settings: PaperBSettings) -> Result<Self, PaperBError> {
        check(&settings)?;
        let (g, h) = plant.state_space();
        let c = Vector2::new(1.0, 0.0);
        let process = h * h.transpose() * settings.process_noise;
        let (noise, tolerance) = (settings.measurement_noise, settings.tolerance);
        let filter = riccati::filter(&g, &process, &c, noise, tolerance)
            .ok_or(PaperBError::Iteration("filter's gain"))?;
        let weight = Matrix2::new(settings.error_cost, 0.0, 0.0, 0.0);
        let feedback = riccati::feedback(&g, &h, &weight, settings.voltage_cost, tolerance)
            .ok_or(PaperBError::Iteration("feedback's gain"))?;
        let mut controller = Self {
            gain_3: settings.compensation / (plant.a + plant.b),
            plant,
            settings,
            filter,
            feedback: feedback.gain,
            feedback_changes: feedback.changes,
            radius: 0.0,
            state: Memory::default(),
            wanted: 0.0,
        };
        let radius = controller.closed_radius();
        controller.radius = radius;
        (radius < 1.0).then_some(controller).ok_or(PaperBError::Unstable { radius })
    }

    /// Largest eigenvalue of the loop closed with its own plant.
    pub const fn radius(&self) -> f64 {
        self.radius
    }

    /// Relative change of the filter's gain and of the feedback's, iteration by iteration.
    pub fn convergence(&self) -> (&[f64], &[f64]) {
        (&self.filter.changes, &self.feedback_changes)
    }

    /// Steady gains of the filter and of the feedback.
    pub const fn gains(&self) -> (&Vector2<f64>, &Vector2<f64>) {
        (&self.filter.gain, &self.feedback)
    }

    /// One cycle. While `limited` the motor did not have the voltages of the prediction, whose error is no load then: the
    /// compensation is held.
    fn cycle(&self, memory: &mut Memory, reference: f64, speed: f64, limited: bool) -> f64 {
        let PaperBPlant { a, b, d, f } = self.plant;
        let predicted = -f * memory.speeds[0] - d * memory.speeds[1]
            + a * memory.voltages[0]
            + b * memory.voltages[1];
        let share = self.settings.filter_share;
        if !limited && !memory.limited {
            memory.filtered += share * (speed - predicted - memory.filtered);
            memory.compensation -= self.gain_3 * memory.filtered;
        }
        memory.limited = limited;
        let x = memory.x + self.filter.gain * (speed - memory.x[0]);
        let voltage = -self.feedback.dot(&(x - Vector2::new(reference, reference)));
        let (g, h) = self.plant.state_space();
        memory.x = g * x + h * voltage;
        memory.speeds = [speed, memory.speeds[0]];
        memory.voltages = [voltage, memory.voltages[0]];
        voltage + memory.compensation
    }

    fn closed_radius(&self) -> f64 {
        let (g, h) = self.plant.state_space();
        linear_map::radius(10, |state| {
            let mut memory = Memory {
                x: Vector2::new(state[2], state[3]),
                speeds: [state[4], state[5]],
                voltages: [state[6], state[7]],
                filtered: state[8],
                compensation: state[9],
                limited: false,
            };
            let machine = Vector2::new(state[0], state[1]);
            let output = self.cycle(&mut memory, 0.0, machine[0], false);
            let machine = g * machine + h * output;
            state[..2].copy_from_slice(machine.as_slice());
            state[2..4].copy_from_slice(memory.x.as_slice());
            state[4..6].copy_from_slice(&memory.speeds);
            state[6..8].copy_from_slice(&memory.voltages);
            state[8] = memory.filtered;
            // Switched off, the compensation is a constant and no part of the loop.
            state[9] = if self.gain_3 > 0.0 { memory.compensation } else { 0.0 };
        })
    }
}

impl SpeedController for PaperB {
    fn step(&mut self, reference_rad_s: f64, now: &Measured, _period_s: f64) -> f64 {
        let mut state = self.state;
        self.wanted = self.cycle(&mut state, reference_rad_s, now.speed_rad_s, now.limited);
        self.state = state;
        self.wanted
    }

    fn applied(&mut self, output: f64) {
        // Predictor and filter get the limited output; the compensation does not wind up.
        let missing = output - self.wanted;
        let (_, h) = self.plant.state_space();
        self.state.x += h * missing;
        self.state.voltages[0] += missing;
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        let speed = now.speed_rad_s;
        self.state = Memory {
            x: Vector2::new(speed, speed),
            speeds: [speed; 2],
            voltages: [0.0; 2],
            filtered: 0.0,
            compensation: output,
            limited: false,
        };
    }

    fn explain(&self) -> Vec<String> {
        vec![
            format!(
                "Kalman gain {:.4}, {:.4} after {} iterations; feedback {:.4}, {:.4} V per rad/s after {}",
                self.filter.gain[0],
                self.filter.gain[1],
                self.filter.changes.len(),
                self.feedback[0],
                self.feedback[1],
                self.feedback_changes.len()
            ),
            format!(
                "compensation {:.2} of K3 through a filter of {:.2}; on the model alone, without delay and limits, the radius of the loop is {:.4}",
                self.settings.compensation, self.settings.filter_share, self.radius
            ),
        ]
    }
}

fn check(settings: &PaperBSettings) -> Result<(), PaperBError> {
    const POSITIVE: (f64, f64, &str) = (f64::from_bits(1), f64::MAX, "a finite value above 0");
    const SHARE: (f64, f64, &str) = (0.0, 1.0, "0 to 1");
    for (what, value, (least, most, allowed)) in [
        ("process_noise", settings.process_noise, POSITIVE),
        ("measurement_noise", settings.measurement_noise, POSITIVE),
        ("error_cost", settings.error_cost, POSITIVE),
        ("voltage_cost", settings.voltage_cost, POSITIVE),
        ("tolerance", settings.tolerance, POSITIVE),
        ("filter_share", settings.filter_share, SHARE),
        ("compensation", settings.compensation, SHARE),
    ] {
        if !(least..=most).contains(&value) {
            return Err(PaperBError::Setting { what, value, allowed });
        }
    }
    Ok(())
}
