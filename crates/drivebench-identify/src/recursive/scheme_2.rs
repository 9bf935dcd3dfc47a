//! Scheme 2 of paper A: inertia and load torque from current and speed, the torque constant known.
//!
//! `w_k - w_{k-1} = (Kt/J) int i - (Mc/J) sgn(w) T` on consecutive samples with their true stamps.
//! Between samples the current is interpolated linearly. The error of that is estimated by Richardson extrapolation: a second
//! estimate from every second sample differs by one (first order) to three times (second order) the error, and the
//! difference over 1.5 is part of the standard deviation. Scheme 3 computes the current between samples: it has no such error.

use super::mechanical::{MechanicalBalance, MechanicalRow};
use super::{Direction, LONGEST_GAP_S};
use drivebench_model::sample::ParameterEstimate;

/// How the current is integrated between two samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CurrentIntegral {
    #[default]
    Trapezoid,
    /// The left rectangle that the paper prints; 5 to 14 % high on a start of its motor.
    Rectangle,
}

#[derive(Clone, Debug)]
pub struct Scheme2 {
    integral: CurrentIntegral,
    forgetting: f64,
    fine: Rows,
    /// The same from every second sample.
    coarse: Rows,
    samples: u64,
    direction: Direction,
    last_s: f64,
    period_s: f64,
}

/// A balance and the current, unfinished row.
#[derive(Clone, Debug)]
struct Rows {
    stride_s: f64,
    balance: MechanicalBalance,
    block: Option<Block>,
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
    /// `stride_s`: smallest length of a row; 0 makes one of each pair of samples, as the paper does.
    pub fn new(integral: CurrentIntegral, forgetting: f64, stride_s: f64) -> Self {
        let rows = Rows { stride_s, balance: MechanicalBalance::new(forgetting), block: None };
        Self {
            integral,
            forgetting,
            fine: rows.clone(),
            coarse: rows,
            samples: 0,
            direction: Direction::default(),
            last_s: f64::NAN,
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
        let step_s = time_s - self.last_s;
        if step_s <= 0.0 {
            return;
        }
        self.last_s = time_s;
        if step_s > LONGEST_GAP_S {
            (self.fine.block, self.coarse.block) = (None, None);
            self.samples = 0;
        } else if step_s.is_finite() {
            self.period_s = step_s;
        }
        let fresh = Block {
            begin_s: time_s,
            begin_speed: speed_rad_s,
            last_s: time_s,
            last_current: current_a,
            charge: 0.0,
            direction: self.direction.of(speed_rad_s),
        };
        self.fine.take(self.integral, fresh);
        if self.samples.is_multiple_of(2) {
            // Rows of twice the length carry the memory of two.
            let long = 2.0 * self.period_s > self.fine.stride_s * (1.0 + 1e-6);
            self.coarse.balance.set_forgetting(self.forgetting.powi(if long { 2 } else { 1 }));
            self.coarse.take(self.integral, fresh);
        }
        self.samples += 1;
    }

    /// Relative error of J and error of Mc/Kt, A, by the current between samples.
    fn sampling_error(&self) -> [f64; 2] {
        let (Some([a, b]), Some([coarse_a, coarse_b])) =
            (self.fine.balance.values(), self.coarse.balance.values())
        else {
            return [0.0; 2];
        };
        // A rule of second order would give 3, but the current has a corner at each step of the voltage, and where L/R is
        // not resolved the order falls to the first.
        let order = match self.integral {
            CurrentIntegral::Trapezoid => 1.5,
            CurrentIntegral::Rectangle => 1.0,
        };
        [(a / coarse_a - 1.0).abs() / order, (coarse_b / coarse_a - b / a).abs() / order]
    }

    /// Inertia and load torque for a torque constant, N.m/A, and its standard deviation.
    pub fn estimates(&self, torque: Option<(f64, f64)>) -> Vec<ParameterEstimate> {
        let (moved, sampling) = (&self.direction, self.sampling_error());
        (self.fine.balance).estimates(torque, moved, self.period_s, sampling)
    }
}

impl Rows {
    fn take(&mut self, integral: CurrentIntegral, fresh: Block) {
        let Some(mut block) = self.block else {
            self.block = Some(fresh);
            return;
        };
        let step_s = fresh.begin_s - block.last_s;
        block.charge += step_s
            * match integral {
                CurrentIntegral::Trapezoid => 0.5 * (block.last_current + fresh.last_current),
                CurrentIntegral::Rectangle => block.last_current,
            };
        block.last_s = fresh.begin_s;
        block.last_current = fresh.last_current;
        if fresh.direction != block.direction {
            block.direction = 0;
        }
        self.block = Some(block);
        // A tolerance of one millionth: stamps such as 0.01 carry rounding.
        if fresh.begin_s - block.begin_s >= self.stride_s * (1.0 - 1e-6) {
            self.balance.take(&MechanicalRow {
                begin_s: block.begin_s,
                end_s: fresh.begin_s,
                speed_step_rad_s: fresh.begin_speed - block.begin_speed,
                current_integral_a_s: block.charge,
                doubtful_integral_a_s: block.charge,
                direction: block.direction,
                speed_rad_s: 0.5 * (block.begin_speed + fresh.begin_speed),
                carry: 1.0,
            });
            self.block = Some(fresh);
        }
    }
}
