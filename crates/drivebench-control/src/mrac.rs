//! Model-reference adaptive control (MRAC), compared in paper A: no identification, the gains are driven by the error to a model.
//!
//! The paper only cites it. The law here, stated in full: `u = kr r - kw w - ki i + k1`, reference model of second order
//! `wm / r = 1 / ((1 + s Tm)(1 + s Te))` behind the loop's dead time, `v = e + Td de/dt` with `e = wm - w`, and
//! proportional-integral adaptation `k = integral of g v x / n + p v x / n` with `x = (r, -w, -i, 1)` and `n = 1 + |x|^2`
//! (Landau 1979, hyperstability; normalised). In saturation the model's error does not come from the gains: there the
//! adaptation is disconnected and the model's state set to the shaft's speed, unless that is switched off for comparison.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use super::limiter::limited;
use super::{LinearPlant, LoopTiming, Measured, SpeedController};

/// Sizes that make speed, current and voltage comparable.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MracScales {
    pub speed_rad_s: f64,
    pub current_a: f64,
}

#[derive(Clone, Debug)]
pub struct Mrac {
    /// Of reference, speed, current and one, scaled to volts.
    integral: [f64; 4],
    now: [f64; 4],
    largest_v: f64,
    /// Of the adaptation, for a unit error on a unit signal.
    unit_v: f64,
    scales: MracScales,
    /// Slow and fast time constant of the reference model, s, and the weight of the error's rate.
    model_s: [f64; 2],
    rate_s: f64,
    model: [f64; 2],
    /// References within the dead time.
    delayed: VecDeque<f64>,
    begun: bool,
    last_error: f64,
    disconnects: bool,
    wanted: f64,
    limited: bool,
}

impl Mrac {
    pub const ID: &str = "mrac";

    /// Gains that fit the model's plant exactly; `disconnects` in saturation, as paper A does. `None` for a plant without
    /// a back-EMF: the law is one for a voltage command.
    pub fn new(
        plant: &LinearPlant,
        timing: &LoopTiming,
        scales: MracScales,
        disconnects: bool,
    ) -> Option<Self> {
        let gain = plant.gain()?;
        let (a, b) = plant.matrices();
        // The fast pole remains that of the circuit; the slow one is placed.
        let small_s = -1.0 / a[(0, 0)] + timing.small_time_s();
        let model_s = [3.0 * small_s, -1.0 / a[(0, 0)]];
        // (s + 1/Tm)(s + 1/Te) = s^2 + (R + ki)/L s + (Ke + kw) Kt/(L J).
        let to_rate = a[(1, 0)] * b[0];
        let current = (1.0 / model_s[0] + 1.0 / model_s[1] + a[(0, 0)]) / b[0];
        let whole = 1.0 / (model_s[0] * model_s[1] * to_rate);
        let gains = [
            whole * scales.speed_rad_s,
            (whole - 1.0 / gain) * scales.speed_rad_s,
            current * scales.current_a,
            0.0,
        ];
        // Over the initial gain: without identification there is no other bound.
        let largest = 40.0;
        let largest_v = largest * gains[0].abs();
        Some(Self {
            integral: gains,
            now: gains,
            largest_v,
            unit_v: largest_v / largest,
            scales,
            model_s,
            rate_s: small_s,
            model: [0.0; 2],
            delayed: vec![0.0; timing.whole_cycles()].into(),
            begun: false,
            last_error: 0.0,
            disconnects,
            wanted: 0.0,
            limited: false,
        })
    }

    /// Gains of reference, speed and current, V per rad/s and V per A, and the constant part, V.
    fn gains(&self) -> [f64; 4] {
        let ([reference, speed, current, constant], scales) = (self.now, &self.scales);
        let per_speed = [reference, speed].map(|gain| gain / scales.speed_rad_s);
        [per_speed[0], per_speed[1], current / scales.current_a, constant]
    }

    fn reset_model(&mut self, speed_rad_s: f64) {
        self.model = [speed_rad_s; 2];
        self.delayed.iter_mut().for_each(|reference| *reference = speed_rad_s);
    }

    /// One period of the reference model: two lags in series, each exact for a held input.
    fn advance_model(&mut self, reference_rad_s: f64, period_s: f64) {
        self.delayed.push_back(reference_rad_s);
        let input = self.delayed.pop_front().unwrap_or(reference_rad_s);
        let [slow, fast] = self.model_s.map(|time_s| -(-period_s / time_s).exp_m1());
        self.model[0] += fast * (input - self.model[0]);
        self.model[1] += slow * (self.model[0] - self.model[1]);
    }

    fn adapt(&mut self, signals: &[f64; 4], speed: f64, period_s: f64) {
        let error = (self.model[1] - speed) / self.scales.speed_rad_s;
        let rate = (error - self.last_error) / period_s;
        self.last_error = error;
        let filtered = error + self.rate_s * rate;
        let size = 1.0 + signals.iter().map(|x| x * x).sum::<f64>();
        for ((gain, now), signal) in self.integral.iter_mut().zip(&mut self.now).zip(signals) {
            let push = self.unit_v * filtered * signal / size;
            let bounded = |gain: f64| gain.clamp(-self.largest_v, self.largest_v);
            // g = 6 1/s and p = 0.3.
            *gain = bounded(*gain + 6.0 * period_s * push);
            *now = bounded(*gain + 0.3 * push);
        }
    }
}

impl SpeedController for Mrac {
    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64 {
        let speed = now.speed_rad_s;
        let signals = [
            reference_rad_s / self.scales.speed_rad_s,
            -speed / self.scales.speed_rad_s,
            -now.current_a.unwrap_or(0.0) / self.scales.current_a,
            1.0,
        ];
        if !std::mem::replace(&mut self.begun, true) {
            self.reset_model(speed);
        }
        self.advance_model(reference_rad_s, period_s);
        if self.disconnects && (self.limited || now.limited) {
            self.model = [speed; 2];
            self.last_error = 0.0;
            self.now = self.integral;
        } else {
            self.adapt(&signals, speed, period_s);
        }
        self.wanted = self.now.iter().zip(&signals).map(|(gain, x)| gain * x).sum();
        self.wanted
    }

    fn applied(&mut self, output: f64) {
        self.limited = limited(self.wanted, output) != 0.0;
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        let speed = now.speed_rad_s;
        self.reset_model(speed);
        self.begun = true;
        self.last_error = 0.0;
        self.limited = false;
        // The constant part is the output less the other parts at this speed.
        let scaled = speed / self.scales.speed_rad_s;
        let current = now.current_a.unwrap_or(0.0) / self.scales.current_a;
        self.integral[3] =
            output - (self.integral[0] - self.integral[1]) * scaled + self.integral[2] * current;
        self.now = self.integral;
        self.wanted = output;
    }

    fn explain(&self) -> Vec<String> {
        let [reference, speed, current, constant] = self.gains();
        vec![
            format!(
                "reference model with {:.1} and {:.1} ms; gains now: reference {reference:.4}, speed {speed:.4} V per rad/s, current {current:.4} V per A, constant {constant:.3} V",
                1e3 * self.model_s[0],
                1e3 * self.model_s[1]
            ),
            if self.disconnects {
                "the adaptation is disconnected while the output is limited".to_owned()
            } else {
                "the adaptation goes on while the output is limited: the error at the limit changes the gains".to_owned()
            },
        ]
    }
}
