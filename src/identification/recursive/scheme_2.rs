//! Scheme 2 of paper A: inertia and load torque from current and speed, the torque constant known.
//!
//! `w_k - w_{k-1} = (Kt/J) int i - (Mc/J) sgn(w) T` on consecutive samples with their true stamps.
//! Under voltage steps on the motor of paper A (L/R = 9 ms) the trapezoid gives J 0.02 % low at T = 1 ms, 0.5 % at 5 ms,
//! 1.5 % at 10 ms, and Mc up to 5 % off at 10 ms: more than the standard deviations, which know only the noise. Scheme 3
//! corrects the integral and does not have this error.

use super::direction::Direction;
use super::mechanical::{MechanicalBalance, MechanicalRow};
use crate::sample::ParameterEstimate;

/// A longer gap between samples ends the row: the current between them is not known.
const LONGEST_GAP_S: f64 = 0.1;

/// How the current is integrated between two samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CurrentIntegral {
    #[default]
    Trapezoid,
    /// The left rectangle that the paper prints; 5 to 14 % high on a start of its motor.
    Rectangle,
}

/// The estimator; feed it with [`Self::push`].
#[derive(Clone, Debug)]
pub struct Scheme2 {
    integral: CurrentIntegral,
    stride_s: f64,
    balance: MechanicalBalance,
    direction: Direction,
    block: Option<Block>,
    period_s: f64,
}

#[derive(Clone, Copy, Debug)]
struct Block {
    begin_s: f64,
    begin_speed: f64,
    last_s: f64,
    last_current: f64,
    charge: f64,
    direction: i8,
}

impl Scheme2 {
    /// `stride_s`: least length of a row; 0 makes one of each pair of samples, as the paper does.
    pub fn new(integral: CurrentIntegral, forgetting: f64, stride_s: f64) -> Self {
        Self {
            integral,
            stride_s,
            balance: MechanicalBalance::new(forgetting),
            direction: Direction::default(),
            block: None,
            period_s: f64::NAN,
        }
    }

    /// Standard deviation of the speed at standstill, rad/s: widens the dead zone.
    pub fn set_speed_noise(&mut self, noise_rad_s: f64) {
        self.direction.noise_rad_s = noise_rad_s;
    }

    /// Takes one sample; samples that are not finite or not later than the last one are left out.
    pub fn push(&mut self, time_s: f64, current_a: f64, speed_rad_s: f64) {
        if !(time_s.is_finite() && current_a.is_finite() && speed_rad_s.is_finite()) {
            return;
        }
        let sign = self.direction.of(speed_rad_s);
        let fresh = Block {
            begin_s: time_s,
            begin_speed: speed_rad_s,
            last_s: time_s,
            last_current: current_a,
            charge: 0.0,
            direction: sign,
        };
        let Some(mut block) = self.block else {
            self.block = Some(fresh);
            return;
        };
        let step_s = time_s - block.last_s;
        if step_s <= 0.0 {
            return;
        }
        self.period_s = step_s;
        if step_s > LONGEST_GAP_S {
            self.block = Some(fresh);
            return;
        }
        block.charge += step_s
            * match self.integral {
                CurrentIntegral::Trapezoid => 0.5 * (block.last_current + current_a),
                CurrentIntegral::Rectangle => block.last_current,
            };
        block.last_s = time_s;
        block.last_current = current_a;
        if sign != block.direction {
            block.direction = 0;
        }
        self.block = Some(block);
        // A tolerance of one millionth: stamps such as 0.01 carry rounding.
        if time_s - block.begin_s >= self.stride_s * (1.0 - 1e-6) {
            self.balance.take(&MechanicalRow {
                begin_s: block.begin_s,
                end_s: time_s,
                speed_step_rad_s: speed_rad_s - block.begin_speed,
                current_integral_a_s: block.charge,
                direction: block.direction,
            });
            self.block = Some(fresh);
        }
    }

    /// Inertia and load torque for a torque constant, N.m/A, and its standard deviation.
    pub fn estimates(&self, torque: Option<(f64, f64)>) -> Vec<ParameterEstimate> {
        self.balance.estimates(
            torque,
            (
                self.direction.largest_rad_s(),
                self.direction.dead_zone_rad_s(),
            ),
            self.period_s,
        )
    }
}
