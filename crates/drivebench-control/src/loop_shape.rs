//! Analysis of a sampled speed loop: stability margins, bandwidth, spectral radius, step response (Franklin, Powell and
//! Workman, Digital Control of Dynamic Systems, 1998).
//!
//! Exact for the linear plant with a zero-order hold and a delay of any fraction of a period. A filter of the measurement is
//! taken as sampled with the loop.

use std::sync::{Arc, OnceLock};

use nalgebra::{Complex, SMatrix, SVector};
use serde::{Deserialize, Serialize};

use super::linear_plant::STATES;
use super::notch::{Notch, NotchMemory};
use super::{LinearPlant, LoopTiming};
use drivebench_model::numerics::{count, linear_map, root};

/// Gains of a PI regulator `u = Kp (e + (1/Tn) integral of e)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PiGains {
    /// Actuator's unit per rad/s.
    pub proportional: f64,
    /// Tn, s.
    pub integral_time_s: f64,
    /// First-order filter of the reference, s; 0 without.
    pub reference_filter_s: f64,
    /// Before the regulator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub notch: Option<Notch>,
}

impl PiGains {
    /// `share`: of the tuned gain, as text.
    pub(super) fn text(&self, share: &str) -> String {
        let (kp, tn_s) = (self.proportional, self.integral_time_s);
        let notch = self.notch.map_or_else(String::new, |notch| format!(", {}", notch.text()));
        format!("Kp = {kp:.4} per rad/s{share}, Tn = {tn_s:.4} s{notch}")
    }
}

/// Stability margins at the worst of all crossings; infinite where a crossing does not exist.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Margins {
    /// At a gain of one; negative for a loop that is not stable.
    pub phase_margin_deg: f64,
    /// Factor by which the gain may grow, or fall where that is nearer.
    pub gain_margin: f64,
    /// Where the open loop's gain first falls to one, rad/s.
    pub crossover_rad_s: f64,
    /// Where the closed loop's gain has first fallen by 3 dB, rad/s.
    pub bandwidth_rad_s: f64,
    /// Largest eigenvalue of the sampled closed loop: below 1 it is stable.
    pub radius: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StepPoint {
    pub time_s: f64,
    /// Per unit of the reference step.
    pub speed: f64,
    /// Actuator's unit per rad/s of the step.
    pub output: f64,
    /// Between which the speed lies in 90 % of the draws; none without draws.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub low: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub high: Option<f64>,
}

#[derive(Clone, Debug)]
pub struct LoopShape {
    gains: PiGains,
    timing: LoopTiming,
    /// Whole periods of the delay.
    whole: usize,
    states: usize,
    phi: SMatrix<f64, STATES, STATES>,
    /// Effect of the older and of the newer of the two outputs that act within a period.
    older: SVector<f64, STATES>,
    newer: SVector<f64, STATES>,
    /// Of the measurement's filter, see [`lag_share`].
    filter_share: f64,
    /// Resonance and anti-resonance of the plant, rad/s.
    resonances_rad_s: Vec<f64>,
    /// Frequency response of the plant, the same for all gains.
    responses: Arc<OnceLock<Vec<PlantResponse>>>,
}

/// Plant, delay and filter at a frequency.
#[derive(Clone, Copy, Debug)]
struct PlantResponse {
    frequency_rad_s: f64,
    /// One period back, 1/z.
    back: Complex<f64>,
    plant: Complex<f64>,
}

#[derive(Clone, Debug)]
struct Memory {
    x: SVector<f64, STATES>,
    /// Outputs within the delay, the newest first.
    pipe: Vec<f64>,
    integral: f64,
    filtered: f64,
    reference: f64,
    notch: NotchMemory,
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
        let resonances = plant.coupling().map(|coupling| {
            // Both masses free, and the load on a motor that is held.
            let free = std::f64::consts::TAU * coupling.frequency_hz;
            [free, free * (1.0 - coupling.inertia_ratio).sqrt()]
        });
        Self {
            gains: *gains,
            timing: *timing,
            whole: count::whole(whole),
            states: plant.states(),
            phi: second * first,
            older: second * pushed,
            newer,
            filter_share: lag_share(timing.period_s, timing.filter_s),
            resonances_rad_s: resonances.into_iter().flatten().collect(),
            responses: Arc::default(),
        }
    }

    /// The same plant under other gains; its frequency response is shared.
    #[must_use]
    pub fn with_gains(&self, gains: &PiGains) -> Self {
        Self { gains: *gains, ..self.clone() }
    }

    fn rest(&self) -> Memory {
        Memory {
            x: SVector::zeros(),
            pipe: vec![0.0; self.whole + 1],
            integral: 0.0,
            filtered: 0.0,
            reference: 0.0,
            notch: NotchMemory::at_rest(),
        }
    }

    /// One period; `reference` after its filter.
    fn step(&self, memory: &mut Memory, reference: f64) -> f64 {
        memory.filtered += self.filter_share * (memory.x[1] - memory.filtered);
        let error = reference - memory.filtered;
        let error = memory.notch.pass(self.gains.notch.as_ref(), error, self.timing.period_s);
        let gain = self.gains.proportional;
        memory.integral += gain * self.timing.period_s / self.gains.integral_time_s * error;
        let output = gain * error + memory.integral;
        memory.pipe.rotate_right(1);
        let oldest = std::mem::replace(&mut memory.pipe[0], output);
        // With the new output at the front, that place has the one `whole` periods old, and `oldest` the one before it.
        let newer = memory.pipe[self.whole];
        memory.x = self.phi * memory.x + self.older * oldest + self.newer * newer;
        output
    }

    /// Largest eigenvalue of the closed loop; infinite for an invalid timing.
    pub fn radius(&self) -> f64 {
        if !self.timing.is_valid() {
            return f64::INFINITY;
        }
        let filter = usize::from(self.filter_share < 1.0);
        let notch = if self.gains.notch.is_some() { 4 } else { 0 };
        let pipe = self.states..self.states + self.whole + 1;
        let integral = pipe.end;
        let notch_at = integral + 1 + filter;
        linear_map::radius(notch_at + notch, |state| {
            let mut memory = self.rest();
            memory.x.as_mut_slice()[..self.states].copy_from_slice(&state[..self.states]);
            memory.pipe.copy_from_slice(&state[pipe.clone()]);
            memory.integral = state[integral];
            if filter > 0 {
                memory.filtered = state[integral + 1];
            }
            if let [x1, x2, y1, y2] = state[notch_at..] {
                (memory.notch.inputs, memory.notch.outputs) = ([x1, x2], [y1, y2]);
            }
            self.step(&mut memory, 0.0);
            state[..self.states].copy_from_slice(&memory.x.as_slice()[..self.states]);
            state[pipe.clone()].copy_from_slice(&memory.pipe);
            state[integral] = memory.integral;
            if filter > 0 {
                state[integral + 1] = memory.filtered;
            }
            if notch > 0 {
                state[notch_at..notch_at + 2].copy_from_slice(&memory.notch.inputs);
                state[notch_at + 2..].copy_from_slice(&memory.notch.outputs);
            }
        })
    }

    /// Speed of `(z - Phi)^-1 push`, by Gaussian elimination with partial pivoting.
    fn speed(&self, z: Complex<f64>, push: &SVector<Complex<f64>, STATES>) -> Complex<f64> {
        let size = self.states;
        let mut rows = [[Complex::new(0.0, 0.0); STATES + 1]; STATES];
        for (n, row) in rows.iter_mut().enumerate().take(size) {
            for (column, cell) in row.iter_mut().enumerate().take(size) {
                *cell = Complex::from(-self.phi[(n, column)]);
            }
            row[n] += z;
            row[STATES] = push[n];
        }
        // The speed's column last: elimination alone solves for it.
        for (step, column) in [0, 2, 3].into_iter().filter(|n| *n < size).enumerate() {
            let of = |row: &[Complex<f64>; STATES + 1]| row[column].norm_sqr();
            let pivot = (step..size)
                .fold(step, |best, n| if of(&rows[n]) > of(&rows[best]) { n } else { best });
            rows.swap(step, pivot);
            let (done, rest) = rows.split_at_mut(step + 1);
            let lead = &done[step];
            for row in rest.iter_mut().take(size - step - 1) {
                let factor = row[column] / lead[column];
                for (cell, above) in row.iter_mut().zip(lead) {
                    *cell -= factor * above;
                }
            }
        }
        rows[size - 1][STATES] / rows[size - 1][1]
    }

    fn response_at(&self, frequency_rad_s: f64) -> PlantResponse {
        let z = Complex::new(0.0, frequency_rad_s * self.timing.period_s).exp();
        let back = z.inv();
        let push = std::array::from_fn(|n| back * self.older[n] + self.newer[n]);
        let late = back.powu(u32::try_from(self.whole).unwrap_or(u32::MAX));
        let filter = self.filter_share / (1.0 - (1.0 - self.filter_share) * back);
        let plant = late * self.speed(z, &SVector::from(push)) * filter;
        PlantResponse { frequency_rad_s, back, plant }
    }

    /// Open loop of a plant's response.
    fn with_regulator(&self, response: &PlantResponse) -> Complex<f64> {
        let PlantResponse { back, plant, .. } = *response;
        let integral = self.timing.period_s / self.gains.integral_time_s / (1.0 - back);
        let regulator = self.gains.proportional * (1.0 + integral) * plant;
        match &self.gains.notch {
            Some(notch) => regulator * notch.response(back, self.timing.period_s),
            None => regulator,
        }
    }

    fn open(&self, frequency_rad_s: f64) -> Complex<f64> {
        self.with_regulator(&self.response_at(frequency_rad_s))
    }

    /// Frequencies between which no crossing is missed: steps of 3 %, at most a tenth of the frequency at which the delay has a
    /// phase of 180 degrees, and a geometric refinement about each resonance.
    fn frequencies(&self) -> Vec<f64> {
        let nyquist = std::f64::consts::PI / self.timing.period_s;
        let longest = 0.1 * nyquist / (1.0 + self.whole as f64);
        let mut found = Vec::new();
        let mut next = 1e-5 * nyquist;
        while next < nyquist {
            found.push(next);
            next += (0.03 * next).min(longest);
        }
        for resonance in &self.resonances_rad_s {
            found.push(*resonance);
            for offset in (0..18).map(|n| 5e-4 * 1.35_f64.powi(n)) {
                found.extend([resonance * (1.0 - offset), resonance * (1.0 + offset)]);
            }
        }
        found.retain(|frequency| *frequency < nyquist);
        found.push(nyquist);
        found.sort_by(f64::total_cmp);
        found
    }

    pub fn margins(&self) -> Margins {
        let responses = self
            .responses
            .get_or_init(|| self.frequencies().into_iter().map(|w| self.response_at(w)).collect());
        let radius = self.radius();
        let is_stable = radius < 1.0;
        let mut margins = Margins {
            phase_margin_deg: f64::INFINITY,
            gain_margin: f64::INFINITY,
            crossover_rad_s: f64::NAN,
            bandwidth_rad_s: f64::NAN,
            radius,
        };
        let size = |open: Complex<f64>| open.norm() - 1.0;
        let closed =
            |open: Complex<f64>| (open / (1.0 + open)).norm() - std::f64::consts::FRAC_1_SQRT_2;
        let on_axis = |open: Complex<f64>| {
            let growth = 1.0 / open.norm();
            if is_stable { growth.max(open.norm()) } else { growth }
        };
        let mut before = Complex::new(f64::NAN, f64::NAN);
        let mut low = f64::NAN;
        for response in responses {
            let (high, after) = (response.frequency_rad_s, self.with_regulator(response));
            // Zero of a quantity that changes its sign in between.
            let at = |quantity: &dyn Fn(Complex<f64>) -> f64| {
                let sign = quantity(before).signum();
                root::halved(low, high, 40, |w| sign * quantity(self.open(w)) > 0.0)
            };
            let falls = |quantity: &dyn Fn(Complex<f64>) -> f64| {
                quantity(before) > 0.0 && quantity(after) <= 0.0
            };
            if falls(&size) || falls(&|open| -size(open)) {
                let at = at(&size);
                let phase = wrapped(180.0 + self.open(at).arg().to_degrees());
                margins.phase_margin_deg = margins.phase_margin_deg.min(phase.abs());
                if margins.crossover_rad_s.is_nan() && falls(&size) {
                    margins.crossover_rad_s = at;
                }
            }
            if margins.bandwidth_rad_s.is_nan() && falls(&closed) {
                margins.bandwidth_rad_s = at(&closed);
            }
            if before.re < 0.0 && after.re < 0.0 && before.im * after.im <= 0.0 {
                let open = self.open(at(&|open| open.im));
                margins.gain_margin = margins.gain_margin.min(on_axis(open));
            }
            (low, before) = (high, after);
        }
        // Without a crossing it is above at every frequency, or below. At the last, Nyquist's, the open loop is real.
        let last = before;
        let at_end = |at_end: f64| if at_end > 0.0 { f64::INFINITY } else { 0.0 };
        if margins.crossover_rad_s.is_nan() {
            margins.crossover_rad_s = at_end(size(last));
        }
        if margins.bandwidth_rad_s.is_nan() {
            margins.bandwidth_rad_s = at_end(closed(last));
        }
        if last.re < 0.0 {
            margins.gain_margin = margins.gain_margin.min(on_axis(last));
        }
        if !is_stable {
            margins.phase_margin_deg = -margins.phase_margin_deg;
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
                    low: None,
                    high: None,
                }
            })
            .collect()
    }
}

/// Share of a step that a first-order lag covers in a period; all of it without one.
pub(super) fn lag_share(period_s: f64, lag_s: f64) -> f64 {
    if lag_s > 0.0 { -(-period_s / lag_s).exp_m1() } else { 1.0 }
}

/// Between -180 and 180 degrees.
fn wrapped(degrees: f64) -> f64 {
    (degrees + 180.0).rem_euclid(360.0) - 180.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Actuator;
    use crate::testing::{assert_close, elastic, pi_gains, slow_machine, timing};

    fn shape(cycles: f64, proportional: f64) -> LoopShape {
        LoopShape::new(&slow_machine(), &timing(cycles), &pi_gains(proportional, 0.19))
    }

    #[track_caller]
    fn gain_margin_is_where_the_radius_is_one(shape: &LoopShape) {
        let margins = shape.margins();
        assert!(margins.radius < 1.0, "{margins:?}");
        let at = |factor: f64| {
            let proportional = factor * shape.gains.proportional;
            // Kp is scaled, Tn is kept: the integral gain is scaled too.
            shape.with_gains(&PiGains { proportional, ..shape.gains }).radius()
        };
        assert!(at(0.999 * margins.gain_margin) < 1.0, "{margins:?}");
        assert!(at(1.001 * margins.gain_margin) > 1.0, "{margins:?}");
    }

    /// A loop of 2 ms around a motor with half of its inertia behind a coupling of 22 Hz.
    fn coupled(damping_ratio: f64, actuator: Actuator, gains: [f64; 2], cycles: f64) -> LoopShape {
        let model = elastic(0.5, damping_ratio);
        let plant = match actuator {
            Actuator::Current => LinearPlant::current(&model, 0.0, 0.002),
            _ => LinearPlant::voltage(&model, 0.0),
        };
        let quick = LoopTiming { period_s: 0.002, delay_s: 0.002 * cycles, filter_s: 0.0 };
        LoopShape::new(&plant.unwrap(), &quick, &pi_gains(gains[0], gains[1]))
    }

    #[test]
    fn at_the_gain_margin_an_eigenvalue_leaves_the_unit_circle() {
        use Actuator::{Current, Voltage};
        for cycles in [0.0, 0.3, 1.0, 2.0, 2.5] {
            gain_margin_is_where_the_radius_is_one(&shape(cycles, 0.8));
        }
        for damping_ratio in [0.001, 0.02, 0.1] {
            for cycles in [0.0, 0.4, 1.0, 2.0] {
                for (actuator, gains) in [(Voltage, [0.2, 0.026]), (Current, [0.3, 0.06])] {
                    let shape = coupled(damping_ratio, actuator, gains, cycles);
                    gain_margin_is_where_the_radius_is_one(&shape);
                    let notch = Notch { frequency_hz: 22.0, damping_ratio: 0.2, depth: 0.1 };
                    let gains = PiGains { notch: Some(notch), ..shape.gains };
                    gain_margin_is_where_the_radius_is_one(&shape.with_gains(&gains));
                }
            }
        }
    }

    #[test]
    fn a_coupling_costs_margins_that_a_rigid_plant_does_not_show() {
        // Computed independently, from the matrix exponential of the four states on 8000 frequencies.
        let gains = [0.269_689_950_5, 0.025_692_268_5];
        let margins = coupled(0.02, Actuator::Voltage, gains, 1.0).margins();
        assert_close(margins.gain_margin, 4.358, 1e-3);
        assert_close(margins.phase_margin_deg, 64.05, 1e-3);
        assert_close(margins.bandwidth_rad_s / std::f64::consts::TAU, 6.88, 3e-3);
        // Lightly damped it rises above one at the resonance: that crossing counts.
        let margins = coupled(0.005, Actuator::Voltage, gains, 1.0).margins();
        assert_close(margins.phase_margin_deg, 51.95, 2e-3);
        let rigid = LinearPlant::voltage(&elastic(0.5, 0.02), 0.0).unwrap().rigid();
        let whole = coupled(0.02, Actuator::Voltage, gains, 1.0);
        let rigid = LoopShape::new(&rigid, &whole.timing, &whole.gains).margins();
        assert_close(rigid.gain_margin, 11.49, 0.01);
    }

    #[test]
    fn at_the_phase_margin_an_eigenvalue_leaves_the_unit_circle() {
        // By a delay, whose phase grows with the frequency: at all crossings at once.
        let plant = LinearPlant::current(&elastic(0.5, 0.02), 0.0, 0.002).unwrap();
        let shape = coupled(0.02, Actuator::Current, [0.5, 0.06], 1.0);
        let late = |delay_s: f64| {
            let timing = LoopTiming { delay_s: shape.timing.delay_s + delay_s, ..shape.timing };
            LoopShape::new(&plant, &timing, &shape.gains).radius() < 1.0
        };
        let limit_s = root::halved(0.0, 0.02, 30, late);
        let crossings: Vec<f64> = (100..30_000)
            .map(|n| 0.01 * f64::from(n))
            .filter(|w| (shape.open(*w).norm() > 1.0) != (shape.open(w + 0.01).norm() > 1.0))
            .collect();
        // The resonance rises above one and falls again.
        assert_eq!(crossings.len(), 3, "{crossings:?}");
        let phase = |w: &f64| wrapped(180.0 + shape.open(*w).arg().to_degrees());
        // A delay turns one way only, and further than half a turn if need be.
        let delays = crossings.iter().map(|w| phase(w).rem_euclid(360.0).to_radians() / w);
        assert_close(delays.fold(f64::MAX, f64::min), limit_s, 1e-5);
        let least = crossings.iter().map(|w| phase(w).abs()).fold(f64::MAX, f64::min);
        assert_close(shape.margins().phase_margin_deg, least, 1e-3);
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
            // A hold after a part of a period is exact at the samples: to second order in the change within a period.
            assert_close(phase(0.0) - phase(cycles), w * 0.01 * cycles, 2e-5);
        }
    }

    #[test]
    fn a_gain_above_one_up_to_nyquist_has_no_bandwidth() {
        // Slow sampling without a delay: at Nyquist's frequency the closed loop's gain is still above one.
        let slow = LoopTiming { period_s: 0.1, ..timing(0.0) };
        let margins = LoopShape::new(&slow_machine(), &slow, &pi_gains(0.6, 0.2)).margins();
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
