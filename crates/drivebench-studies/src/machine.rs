//! The motors of the paper's figures and their exact discrete form while they turn forward; excitation, noise and spread over
//! seeds: everything random here comes from a stated seed.

use drivebench::tabulated;
use nalgebra::Matrix4;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use serde::Serialize;

use drivebench::numerics::count::whole;
use drivebench::numerics::statistics::variance;
use drivebench::plant::{Input, Model, Motor, MotorKey, Plant, Scenario, State, Trajectory};

/// A motor with the resistance and back-EMF constant of paper A's ZK-22FC and these time constants, s. The load torque is that
/// of rated current: large enough to be identified at 60 V at the terminals.
pub(super) fn motor(ta_s: f64, tm_s: f64) -> Motor {
    let name = format!("Ta {ta_s} s, TM {tm_s} s");
    made_of(&name, 1.1, 0.3538, [ta_s, tm_s], 2.0)
}

/// A motor with these time constants: electrical and mechanical, s.
pub(super) fn made_of(
    name: &str,
    resistance_ohm: f64,
    back_emf_v_s_per_rad: f64,
    [ta_s, tm_s]: [f64; 2],
    load_torque_n_m: f64,
) -> Motor {
    let ke = back_emf_v_s_per_rad;
    Motor::new(name)
        .with(MotorKey::Resistance, resistance_ohm)
        .with(MotorKey::Inductance, ta_s * resistance_ohm)
        .with(MotorKey::BackEmf, ke)
        .with(MotorKey::Inertia, tm_s * ke * ke / resistance_ohm)
        .with(MotorKey::LoadTorque, load_torque_n_m)
}

pub(super) const COMPLETE: &str = "the motors of the figures are complete";

/// A value of a motor from this file, which sets every one of them.
pub(super) fn value(motor: &Motor, key: MotorKey) -> f64 {
    motor.get(key).expect(COMPLETE)
}

/// Ta, TM, Ke, J and Mc of a motor, as far as it has them.
pub(super) fn figures(motor: &Motor) -> [Option<f64>; 5] {
    [
        motor.electrical_time_constant_s(),
        motor.mechanical_time_constant_s(),
        motor.get(MotorKey::BackEmf),
        motor.get(MotorKey::Inertia),
        motor.get(MotorKey::LoadTorque),
    ]
}

pub(super) fn stamps(period_s: f64, samples: usize) -> Vec<f64> {
    (0..samples).map(|k| period_s * k as f64).collect()
}

/// The baseline motor under the voltages of a scenario.
pub(super) fn simulated(motor: &Motor, scenario: &Scenario, from: State) -> Trajectory {
    Plant::new(&Model::baseline(motor.clone()), Input::Voltage)
        .expect(COMPLETE)
        .simulate(scenario, from)
}

/// Speed, rad/s, and current, A.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Turning {
    pub(super) speed_rad_s: f64,
    pub(super) current_a: f64,
}

/// Paper A, eq. (10) to (12) with the misprint of eq. (10) corrected: the state one period later, exactly, under a held
/// voltage and a load torque against forward motion.
#[derive(Clone, Copy, Debug)]
pub(super) struct ZeroOrderHold {
    /// Rows and columns: speed, current, voltage, load (`sign Mc`).
    step: Matrix4<f64>,
}

impl ZeroOrderHold {
    pub(super) fn new(motor: &Motor, period_s: f64) -> Self {
        let of = |key| value(motor, key);
        let (r, l, ke) =
            (of(MotorKey::Resistance), of(MotorKey::Inductance), of(MotorKey::BackEmf));
        let inertia = of(MotorKey::Inertia);
        #[rustfmt::skip]
        let rates = Matrix4::new(
            0.0,     ke / inertia, 0.0,     of(MotorKey::LoadTorque) / inertia,
            -ke / l, -r / l,       1.0 / l, 0.0,
            0.0,     0.0,          0.0,     0.0,
            0.0,     0.0,          0.0,     0.0,
        );
        Self { step: (rates * period_s).exp() }
    }

    /// The state one period later; `sign Mc = -1` for forward motion.
    pub(super) fn after(&self, now: Turning, voltage_v: f64) -> Turning {
        let g = &self.step;
        let next = |row: usize| {
            g[(row, 0)] * now.speed_rad_s + g[(row, 1)] * now.current_a + g[(row, 2)] * voltage_v
                - g[(row, 3)]
        };
        Turning { speed_rad_s: next(0), current_a: next(1) }
    }

    /// `[a1, a2, b1, b2, b3]` of paper A, eq. (13).
    pub(super) fn difference_equation(&self) -> [f64; 5] {
        let g = &self.step;
        let (g11, g12, g21, g22) = (g[(0, 0)], g[(0, 1)], g[(1, 0)], g[(1, 1)]);
        let input = |column: usize| {
            let (h1, h2) = (g[(0, column)], g[(1, column)]);
            (h1, h2 * g12 - h1 * g22)
        };
        let ((b1, b2), (m1, m2)) = (input(2), input(3));
        [g11 + g22, g12 * g21 - g11 * g22, b1, b2, m1 + m2]
    }
}

/// Speed and current at each sample; each motor in turn for so many samples, from the first one's steady state under the
/// first voltage. `voltage_v[k]` is held from sample `k` to the next; `disturbance_rad_s[k]` is added to the speed at sample
/// `k`, as an unmeasured load.
pub(super) fn forward(
    motors: &[(&Motor, usize)],
    period_s: f64,
    voltage_v: &[f64],
    disturbance_rad_s: Option<&[f64]>,
) -> Vec<Turning> {
    let mut out = Vec::with_capacity(voltage_v.len());
    let Some((first, _)) = motors.first() else {
        return out;
    };
    let mut now = steady(first, voltage_v.first().copied().unwrap_or(0.0));
    for (motor, samples) in motors {
        let hold = ZeroOrderHold::new(motor, period_s);
        for _ in 0..*samples {
            let k = out.len();
            if let Some(disturbance) = disturbance_rad_s {
                now.speed_rad_s += disturbance[k];
            }
            out.push(now);
            now = hold.after(now, voltage_v[k]);
        }
    }
    out
}

/// Constant speed under a constant voltage.
pub(super) fn steady(motor: &Motor, voltage_v: f64) -> Turning {
    let of = |key| value(motor, key);
    let current_a = of(MotorKey::LoadTorque) / of(MotorKey::BackEmf);
    Turning {
        speed_rad_s: (voltage_v - of(MotorKey::Resistance) * current_a) / of(MotorKey::BackEmf),
        current_a,
    }
}

/// A signal-to-noise ratio and what it is a ratio of.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SignalToNoise {
    pub value: f64,
    pub of: RatioOf,
}

tabulated! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "snake_case")]
    pub enum RatioOf {
        /// Variances.
        Power = "power",
        /// Standard deviations.
        Amplitude = "amplitude",
    }
    pub const fn name(self) -> &'static str;
}

impl SignalToNoise {
    pub(super) const fn power(value: f64) -> Self {
        Self { value, of: RatioOf::Power }
    }

    pub(super) const fn amplitude(value: f64) -> Self {
        Self { value, of: RatioOf::Amplitude }
    }

    /// Standard deviation of the noise at this ratio to the signal's deviation from its mean.
    pub(super) fn noise_for(self, signal: &[f64]) -> f64 {
        let deviation = variance(signal).sqrt();
        match self.of {
            RatioOf::Power => deviation / self.value.sqrt(),
            RatioOf::Amplitude => deviation / self.value,
        }
    }
}

/// Random numbers of one purpose; other purposes of the same seed are independent of it.
pub(super) fn random(seed: u64, purpose: u64) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(purpose);
    random
}

/// Two voltages in turn, each held for a random whole number of periods in `hold`.
pub(super) fn random_binary(
    random: &mut ChaCha8Rng,
    levels_v: [f64; 2],
    hold: std::ops::RangeInclusive<usize>,
    samples: usize,
) -> Vec<f64> {
    let mut out = Vec::with_capacity(samples);
    let mut high = false;
    while out.len() < samples {
        high = !high;
        let length = random.random_range(hold.clone()).min(samples - out.len());
        out.extend(std::iter::repeat_n(levels_v[usize::from(high)], length));
    }
    out
}

/// White Gaussian noise of variance one.
pub(super) fn white(random: &mut ChaCha8Rng, samples: usize) -> Vec<f64> {
    (0..samples).map(|_| StandardNormal.sample(random)).collect()
}

pub(super) fn with_noise(signal: &[f64], noise: &[f64], deviation: f64) -> Vec<f64> {
    let both = signal.iter().zip(noise);
    both.map(|(signal, noise)| signal + deviation * noise).collect()
}

/// How estimates of one quantity lie over time and seeds.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Spread {
    pub set_value: f64,
    /// 5 %, 50 % and 95 % quantile of the estimates that there are; NaN where there is none.
    pub low: f64,
    pub median: f64,
    pub high: f64,
    /// Of the median, per cent of the set value.
    pub error_percent: f64,
    /// Share of the estimates that exist (positive, physical), per cent.
    pub told_percent: f64,
}

impl Spread {
    /// Of values that may be NaN where the scheme gave none.
    pub(super) fn of(set_value: f64, estimates: impl IntoIterator<Item = f64>) -> Self {
        let all: Vec<f64> = estimates.into_iter().collect();
        let mut finite: Vec<f64> = all.iter().copied().filter(|v| v.is_finite()).collect();
        finite.sort_by(f64::total_cmp);
        let quantile = |share: f64| {
            let last = finite.len().checked_sub(1)?;
            finite.get(whole((share * last as f64).round())).copied()
        };
        let [low, median, high] =
            [0.05, 0.5, 0.95].map(|share| quantile(share).unwrap_or(f64::NAN));
        Self {
            set_value,
            low,
            median,
            high,
            error_percent: 100.0 * (median / set_value - 1.0),
            told_percent: 100.0 * finite.len() as f64 / all.len().max(1) as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench::sample::Channel;

    #[test]
    fn the_discrete_form_is_the_plant() {
        for (ta_s, tm_s) in [(0.1, 0.2), (0.1, 0.4), (0.009, 0.045)] {
            let motor = motor(ta_s, tm_s);
            let times = stamps(0.02, 200);
            let volts = |k: usize| if k.is_multiple_of(7) { 90.0 } else { 40.0 };
            let start = steady(&motor, 60.0);
            let events = (0..200).map(|k| (times[k], volts(k))).collect();
            let scenario = Scenario::planned("", Input::Voltage, Channel::Voltage, events, times);
            let from = State::at(start.current_a, start.speed_rad_s);
            let truth = simulated(&motor, &scenario, from);
            let hold = ZeroOrderHold::new(&motor, 0.02);
            let [a1, a2, b1, b2, b3] = hold.difference_equation();
            let (mut now, w) = (start, &truth.speed_rad_s);
            for k in 1..200 {
                now = hold.after(now, volts(k - 1));
                assert!((now.speed_rad_s - w[k]).abs() < 1e-9, "{k}");
                assert!((now.current_a - truth.current_a[k]).abs() < 1e-9, "{k}");
                if k > 1 {
                    let next =
                        a1 * w[k - 1] + a2 * w[k - 2] + b1 * volts(k - 1) + b2 * volts(k - 2) - b3;
                    assert!((next - w[k]).abs() < 1e-9, "{k} {next} {}", w[k]);
                }
            }
            assert!((motor.mechanical_time_constant_s().unwrap() - tm_s).abs() < 1e-12);
        }
    }

    #[test]
    fn noise_has_the_given_ratio_to_the_signal() {
        let signal: Vec<f64> = (0..4000).map(|k| 50.0 + (0.1 * f64::from(k)).sin()).collect();
        let noise = white(&mut random(1, 1), 4000);
        for (ratio, power) in
            [(SignalToNoise::power(10.0), 10.0), (SignalToNoise::amplitude(10.0), 100.0)]
        {
            let noisy = with_noise(&signal, &noise, ratio.noise_for(&signal));
            let rest: Vec<f64> = noisy.iter().zip(&signal).map(|(a, b)| a - b).collect();
            let found = variance(&signal) / variance(&rest);
            assert!((found / power - 1.0).abs() < 0.1, "{found}");
        }
    }

    #[test]
    fn quantiles_leave_out_missing_values() {
        let spread = Spread::of(2.0, (0..=100).map(f64::from).chain([f64::NAN]));
        assert!((spread.low - 5.0).abs() < 1e-12 && (spread.median - 50.0).abs() < 1e-12);
        assert!((spread.error_percent - 2400.0).abs() < 1e-9);
        assert!(spread.told_percent < 99.1);
        assert!(Spread::of(1.0, []).median.is_nan());
    }
}
