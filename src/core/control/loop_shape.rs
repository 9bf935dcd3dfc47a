//! A sampled speed loop seen before the motor moves: margins, bandwidth, spectral radius, step response.
//!
//! Exact for the linear plant: the output holds between samples and arrives late by any delay, whole periods or not.
//! A filter of the measurement is taken as sampled with the loop.

use nalgebra::{Complex, Matrix2, Vector2};
use serde::{Deserialize, Serialize};

use super::{LinearPlant, LoopTiming};
use crate::numerics::{count, linear_map, root};

/// Frequencies between the lowest and Nyquist's on which crossings are looked for.
const FREQUENCIES: usize = 600;
/// Lowest frequency, as share of Nyquist's.
const LOWEST: f64 = 1e-5;
/// Halvings of a bracket around a crossing.
const HALVINGS: usize = 40;

/// Gains of a PI regulator `u = Kp (e + (1/Tn) integral of e)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PiGains {
    /// Actuator's unit per rad/s.
    pub proportional: f64,
    /// Tn, s.
    pub integral_time_s: f64,
    /// First-order filter of the reference, s; 0 without.
    pub reference_filter_s: f64,
}

/// How far a loop is from swinging; infinite where a crossing does not exist.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Margins {
    pub phase_margin_deg: f64,
    /// Factor by which the gain may grow.
    pub gain_margin: f64,
    /// Where the open loop's gain is one, rad/s.
    pub crossover_rad_s: f64,
    /// Where the closed loop's gain has fallen by 3 dB, rad/s.
    pub bandwidth_rad_s: f64,
    /// Largest eigenvalue of the sampled closed loop: below 1 it is stable.
    pub radius: f64,
}

/// One point of a predicted step response.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StepPoint {
    pub time_s: f64,
    /// Per unit of the reference step.
    pub speed: f64,
    /// Actuator's unit per rad/s of the step.
    pub output: f64,
}

/// A plant, its delays and a PI regulator, closed to a loop.
#[derive(Clone, Debug)]
pub struct LoopShape {
    gains: PiGains,
    timing: LoopTiming,
    /// Whole periods of the delay.
    whole: usize,
    phi: Matrix2<f64>,
    /// Effect of the older and of the newer of the two outputs that act within a period.
    older: Vector2<f64>,
    newer: Vector2<f64>,
    /// Share of the way that the measurement's filter goes in a period.
    filter_share: f64,
}

/// What the sampled loop remembers.
#[derive(Clone, Debug)]
struct Memory {
    x: Vector2<f64>,
    /// Outputs that are on their way, the newest first.
    pipe: Vec<f64>,
    integral: f64,
    filtered: f64,
    reference: f64,
}

impl LoopShape {
    pub fn new(plant: &LinearPlant, timing: &LoopTiming, gains: &PiGains) -> Self {
        let periods = timing.delay_cycles().clamp(0.0, LoopTiming::MOST_CYCLES);
        let mut whole = periods.floor();
        let mut rest_s = (periods - whole) * timing.period_s;
        // 0.02/0.01 may come as 1.999..: what is a millionth short of a period is one.
        if timing.period_s - rest_s < 1e-6 * timing.period_s {
            (whole, rest_s) = (whole + 1.0, 0.0);
        }
        let (first, pushed) = plant.held_over(rest_s);
        let (second, newer) = plant.held_over(timing.period_s - rest_s);
        Self {
            gains: *gains,
            timing: *timing,
            whole: count::whole(whole),
            phi: second * first,
            older: second * pushed,
            newer,
            filter_share: lag_share(timing.period_s, timing.filter_s),
        }
    }

    fn rest(&self) -> Memory {
        Memory {
            x: Vector2::zeros(),
            pipe: vec![0.0; self.whole + 1],
            integral: 0.0,
            filtered: 0.0,
            reference: 0.0,
        }
    }

    /// One period: `reference` as the regulator sees it, after its filter.
    fn step(&self, memory: &mut Memory, reference: f64) -> f64 {
        memory.filtered += self.filter_share * (memory.x[1] - memory.filtered);
        let error = reference - memory.filtered;
        let gain = self.gains.proportional;
        memory.integral += gain * self.timing.period_s / self.gains.integral_time_s * error;
        let output = gain * error + memory.integral;
        memory.pipe.rotate_right(1);
        let oldest = std::mem::replace(&mut memory.pipe[0], output);
        // With the new output at the front the one `whole` periods old stands at that place; the one before it just left.
        let newer = memory.pipe[self.whole];
        memory.x = self.phi * memory.x + self.older * oldest + self.newer * newer;
        output
    }

    /// Largest eigenvalue of the closed loop; infinite where the timing is none that can be looked at.
    pub fn radius(&self) -> f64 {
        if !self.timing.is_valid() {
            return f64::INFINITY;
        }
        let filter = usize::from(self.filter_share < 1.0);
        let size = 2 + self.whole + 1 + 1 + filter;
        let pipe = 2..3 + self.whole;
        linear_map::radius(size, |state| {
            let mut memory = Memory {
                x: Vector2::new(state[0], state[1]),
                pipe: state[pipe.clone()].to_vec(),
                integral: state[pipe.end],
                filtered: if filter > 0 { state[pipe.end + 1] } else { 0.0 },
                reference: 0.0,
            };
            self.step(&mut memory, 0.0);
            state[..2].copy_from_slice(memory.x.as_slice());
            state[pipe.clone()].copy_from_slice(&memory.pipe);
            state[pipe.end] = memory.integral;
            if filter > 0 {
                state[pipe.end + 1] = memory.filtered;
            }
        })
    }

    /// Open loop, regulator included, at a frequency, rad/s.
    pub fn open(&self, frequency_rad_s: f64) -> Complex<f64> {
        let z = Complex::new(0.0, frequency_rad_s * self.timing.period_s).exp();
        let back = z.inv();
        let phi = &self.phi;
        let determinant = (z - phi[(0, 0)]) * (z - phi[(1, 1)]) - phi[(0, 1)] * phi[(1, 0)];
        let speed = |push: &Vector2<f64>| {
            (phi[(1, 0)] * push[0] + (z - phi[(0, 0)]) * push[1]) / determinant
        };
        let late = back.powu(u32::try_from(self.whole).unwrap_or(u32::MAX));
        let plant = late * (speed(&self.newer) + back * speed(&self.older));
        let filter = self.filter_share / (1.0 - (1.0 - self.filter_share) * back);
        let integral = self.timing.period_s / self.gains.integral_time_s / (1.0 - back);
        self.gains.proportional * (1.0 + integral) * plant * filter
    }

    pub fn margins(&self) -> Margins {
        let nyquist = std::f64::consts::PI / self.timing.period_s;
        let step = (1.0 / LOWEST).ln() / FREQUENCIES as f64;
        let grid: Vec<f64> = (0..=FREQUENCIES)
            .map(|n| nyquist * LOWEST * (step * n as f64).exp())
            .collect();
        let mut margins = Margins {
            phase_margin_deg: f64::INFINITY,
            gain_margin: f64::INFINITY,
            crossover_rad_s: f64::NAN,
            bandwidth_rad_s: f64::NAN,
            radius: self.radius(),
        };
        let size = |w: f64| self.open(w).norm() - 1.0;
        let closed = |w: f64| {
            let open = self.open(w);
            (open / (1.0 + open)).norm() - std::f64::consts::FRAC_1_SQRT_2
        };
        let imaginary = |w: f64| self.open(w).im;
        for pair in grid.windows(2) {
            let (low, high) = (pair[0], pair[1]);
            if size(low) > 0.0 && size(high) <= 0.0 {
                let at = crossing(low, high, size);
                margins.crossover_rad_s = at;
                let phase = 180.0 + self.open(at).arg().to_degrees();
                margins.phase_margin_deg = margins.phase_margin_deg.min(wrapped(phase));
            }
            if closed(low) > 0.0 && closed(high) <= 0.0 {
                margins.bandwidth_rad_s = crossing(low, high, closed);
            }
            let (before, after) = (self.open(low), self.open(high));
            if before.re < 0.0 && after.re < 0.0 && before.im * after.im <= 0.0 {
                let at = crossing(low, high, |w| imaginary(w) * before.im.signum());
                let gain = 1.0 / self.open(at).norm();
                margins.gain_margin = margins.gain_margin.min(gain);
            }
        }
        // What crosses nowhere is above at every frequency, or below.
        let nowhere = |at_end: f64| if at_end > 0.0 { f64::INFINITY } else { 0.0 };
        if margins.crossover_rad_s.is_nan() {
            margins.crossover_rad_s = nowhere(size(nyquist));
        }
        if margins.bandwidth_rad_s.is_nan() {
            margins.bandwidth_rad_s = nowhere(closed(nyquist));
        }
        // At Nyquist's frequency the open loop is real.
        let last = self.open(nyquist);
        if last.re < 0.0 {
            margins.gain_margin = margins.gain_margin.min(1.0 / last.norm());
        }
        margins
    }

    /// Response of the linear loop to a unit step of the reference.
    pub fn step_response(&self, duration_s: f64) -> Vec<StepPoint> {
        let mut memory = self.rest();
        let share = lag_share(self.timing.period_s, self.gains.reference_filter_s);
        let periods = count::whole((duration_s / self.timing.period_s).clamp(0.0, 1e6));
        (0..=periods)
            .map(|n| {
                let speed = memory.x[1];
                memory.reference += share * (1.0 - memory.reference);
                let reference = memory.reference;
                let output = self.step(&mut memory, reference);
                StepPoint {
                    time_s: n as f64 * self.timing.period_s,
                    speed,
                    output,
                }
            })
            .collect()
    }
}

/// Share of the way that a first-order lag goes in a period; all of it without one.
pub(super) fn lag_share(period_s: f64, lag_s: f64) -> f64 {
    if lag_s > 0.0 {
        -(-period_s / lag_s).exp_m1()
    } else {
        1.0
    }
}

/// Between -180 and 180 degrees.
fn wrapped(degrees: f64) -> f64 {
    (degrees + 180.0).rem_euclid(360.0) - 180.0
}

/// Where a quantity that is positive at `low` and not at `high` goes through zero.
fn crossing(low: f64, high: f64, quantity: impl Fn(f64) -> f64) -> f64 {
    root::halved(low, high, HALVINGS, |middle| quantity(middle) > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::testing::{assert_close, slow_machine, timing};

    fn shape(cycles: f64, proportional: f64) -> LoopShape {
        let gains = PiGains {
            proportional,
            integral_time_s: 0.19,
            reference_filter_s: 0.0,
        };
        LoopShape::new(&slow_machine(), &timing(cycles), &gains)
    }

    #[test]
    fn the_gain_margin_is_where_the_radius_is_one() {
        for cycles in [0.0, 0.3, 1.0, 2.0, 2.5] {
            let margin = shape(cycles, 0.8).margins().gain_margin;
            let at = |factor: f64| shape(cycles, 0.8 * factor).radius();
            assert!(at(0.999 * margin) < 1.0, "{cycles}: {margin}");
            assert!(at(1.001 * margin) > 1.0, "{cycles}: {margin}");
        }
    }

    #[test]
    fn the_step_response_ends_at_one_and_starts_after_the_delay() {
        let response = shape(2.0, 0.8).step_response(3.0);
        assert_close(response.last().unwrap().speed, 1.0, 1e-3);
        assert!(response[..=2].iter().all(|point| point.speed == 0.0));
        assert!(response[3].speed > 0.0);
    }

    #[test]
    fn a_delay_turns_phase_by_its_share_of_the_period() {
        let w = 5.0;
        let phase = |cycles| shape(cycles, 0.8).open(w).arg();
        for cycles in [0.5, 1.0, 1.7] {
            // Holding after a part of a period is exact at the samples: to second order in what happens in a period.
            assert_close(phase(0.0) - phase(cycles), w * 0.01 * cycles, 2e-5);
        }
    }

    #[test]
    fn a_loop_that_never_falls_has_no_end_of_its_bandwidth() {
        // Slow sampling without a delay: at Nyquist's frequency the closed loop still gives more than it gets.
        let gains = PiGains {
            proportional: 0.6,
            integral_time_s: 0.2,
            reference_filter_s: 0.0,
        };
        let slow = LoopTiming {
            period_s: 0.1,
            ..timing(0.0)
        };
        let margins = LoopShape::new(&slow_machine(), &slow, &gains).margins();
        assert!(margins.bandwidth_rad_s.is_infinite(), "{margins:?}");
        assert!(timing(64.0).is_valid() && !timing(65.0).is_valid());
        assert!(shape(65.0, 0.01).radius().is_infinite());
    }

    #[test]
    fn an_unstable_loop_has_no_margin_left() {
        let margins = shape(2.0, 8.0).margins();
        assert!(margins.radius > 1.0 && margins.gain_margin < 1.0);
        assert!(margins.phase_margin_deg < 0.0);
    }
}
