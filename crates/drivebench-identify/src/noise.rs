//! Noise floor of a record: standard deviation and autocorrelation of the measurement noise, from a standstill.

use std::ops::Range;

use serde::Serialize;
use statrs::distribution::{Continuous, ContinuousCDF, Normal};

use super::speed_from_angle;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::{
    autocorrelation, extent, finite, mean, median, robust_deviation, variance,
};
use drivebench_model::plant::{Input, Scenario};

/// Where the noise floor comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FloorSource {
    /// Standard deviation over the leading standstill.
    Standstill,
    /// Difference of two runs with the same excitation.
    Repeat,
    /// Neither: errors are in units of the residual of the refitted baseline.
    None,
}

/// Standard deviation of the measurement noise, per signal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NoiseFloor {
    pub current_a: f64,
    pub speed_rad_s: f64,
    pub source: FloorSource,
    /// Independent samples of the estimate: the relative standard deviation of a standard deviation is 1/sqrt(2 n).
    pub samples: usize,
    /// Autocorrelation at lag one of the noise of current and speed at rest, as of a first-order autoregressive process.
    pub memory: [f64; 2],
}

/// Standard deviation, independent samples and autocorrelation of the noise of one signal.
type Known = (f64, usize, f64);

/// Fewest samples at rest for a standard deviation.
pub const FEWEST_SAMPLES: usize = 20;

/// Fewest of a second signal, as of a speed that a drive renews less often: known to a quarter, which the tolerance takes into
/// account.
pub const FEWEST_BESIDE: usize = 8;

impl NoiseFloor {
    /// Whether an error in units of the floor is that of a correct model.
    pub fn is_at_the_floor(&self, nrms: f64) -> bool {
        self.is_at(1.0, nrms)
    }

    /// The same of a floor that is `height` times as high, because the noise in motion is larger than at a standstill.
    pub fn is_at(&self, height: f64, nrms: f64) -> bool {
        self.source != FloorSource::None && nrms <= height * self.tolerance(1.1)
    }

    /// The multiple of the floor that a perfect model exceeds in one case of two hundred, because the floor itself was
    /// estimated from few samples; at least `least`.
    pub fn tolerance(&self, least: f64) -> f64 {
        if self.samples == 0 {
            least
        } else {
            least.max(1.0 + 2.6 / (2.0 * self.samples as f64).sqrt())
        }
    }

    /// From the leading standstill with zero input; at least the quantum over sqrt(12). Of a shaft that still coasts when the record
    /// begins only the part after it has stopped.
    pub fn from_standstill(scenario: &Scenario) -> Option<Self> {
        let rows = rest_rows(scenario)?;
        // `None`: no variation. `Some(0)`: a signal that varies but is exactly constant at rest, as a simulated one.
        let floor = |values: &[f64]| -> Option<Known> {
            let at_rest = finite(&values[rows.clone()]);
            if at_rest.len() < FEWEST_BESIDE {
                return None;
            }
            let settled = settled(&at_rest);
            let quantum = quantum(values).unwrap_or(0.0);
            let (level, count) = in_motion(settled, quantum);
            let (least, most) = extent(finite(values));
            // Equal values of a signal with less noise than its resolution are not an autocorrelation.
            let memory = if level > quantum { memory(settled) } else { 0.0 };
            // The squares of an AR(1) process are correlated with the square of its autocorrelation.
            let independent = count * (1.0 - memory * memory) / (1.0 + memory * memory);
            (level > 0.0 || most > least).then_some((level, whole(independent).max(1), memory))
        };
        let current = floor(&scenario.current_a).filter(|_| current_is_an_output(scenario));
        // A drive that reports means has released the motor at rest, and reads nothing there.
        let rough =
            if scenario.sensors.averages_current { roughness(&scenario.current_a) } else { 0.0 };
        let current = current.map(|(level, count, memory)| (level.max(rough), count, memory));
        // The quantisation noise of a speed that is derived from a coarse angle, or restored from behind a filter, vanishes at rest.
        let derived = speed_from_angle::noise(scenario).unwrap_or(0.0);
        let derived = derived.max(scenario.speed_rounding_rad_s);
        // That of a drive's own speed, from the counts of its angle: what it shows in motion, at most of a difference over one sample.
        let of_counts = speed_from_angle::noise_of_counts(scenario);
        let derived = derived.max(of_counts.min(roughness(&scenario.speed_rad_s)));
        let speed = floor(&scenario.speed_rad_s);
        let speed = speed.map(|(level, count, memory)| (level.max(derived), count, memory));
        let most = [&scenario.current_a, &scenario.speed_rad_s]
            .map(|values| finite(&values[rows.clone()]).len());
        if most.into_iter().max()? < FEWEST_SAMPLES {
            return None;
        }
        // A standard deviation of zero is not that of a sensor.
        let known = || current.iter().chain(&speed);
        if known().any(|(level, ..)| *level <= 0.0) {
            return None;
        }
        let samples = known().map(|(_, samples, _)| *samples).min()?;
        let level = |known: Option<Known>| known.map_or(f64::INFINITY, |(level, ..)| level);
        let memory = |known: Option<Known>| known.map_or(0.0, |(.., memory)| memory);
        Some(Self {
            current_a: level(current),
            speed_rad_s: level(speed),
            source: FloorSource::Standstill,
            samples,
            memory: [memory(current), memory(speed)],
        })
    }

    /// Pooled over the standstills of several runs of one machine, weighted with their samples.
    pub fn pooled(rests: &[Self]) -> Option<Self> {
        let first = rests.first()?;
        let mean = |level: fn(&Self) -> f64| {
            let known = rests.iter().filter(|rest| level(rest).is_finite());
            let (squares, samples) = known.fold((0.0, 0.0), |(squares, samples), rest| {
                let n = rest.samples as f64;
                (squares + n * level(rest).powi(2), samples + n)
            });
            if samples > 0.0 { (squares / samples).sqrt() } else { f64::INFINITY }
        };
        Some(Self {
            current_a: mean(|rest| rest.current_a),
            speed_rad_s: mean(|rest| rest.speed_rad_s),
            source: first.source,
            samples: rests.iter().map(|rest| rest.samples).sum(),
            memory: [0, 1].map(|k| rests.iter().map(|rest| rest.memory[k]).fold(0.0, f64::max)),
        })
    }

    /// Weights for both signals where no noise is known: a hundredth of their standard deviation.
    pub fn from_spread(scenario: &Scenario) -> Self {
        let spread = |values: &[f64]| {
            let deviation = variance(&finite(values)).sqrt();
            let scale = (deviation > 0.0).then_some(0.01 * deviation);
            scale.unwrap_or(f64::INFINITY)
        };
        let current = current_is_an_output(scenario).then(|| spread(&scenario.current_a));
        Self {
            current_a: current.unwrap_or(f64::INFINITY),
            speed_rad_s: spread(&scenario.speed_rad_s),
            source: FloorSource::None,
            samples: 0,
            memory: [0.0; 2],
        }
    }
}

/// Number of these values, one of each sample, at rest.
pub fn samples_at_rest(scenario: &Scenario, values: &[f64]) -> usize {
    let rows = rest_rows(scenario).unwrap_or_default();
    finite(&values[rows]).len()
}

/// The rows of the leading standstill in which no signal drifts: all, or as many of the last quarters as there are.
fn rest_rows(scenario: &Scenario) -> Option<Range<usize>> {
    let rest = scenario.leading_standstill();
    // The first two samples after switching on may still carry a transient.
    let begin = rest.start + 2;
    let rows = begin..rest.end.max(begin);
    let signals = [&scenario.current_a, &scenario.speed_rad_s];
    let resolved = signals.map(|values| (values, quantum(values).unwrap_or(0.0)));
    (0..4)
        .map(|quarter| rows.start + quarter * rows.len() / 4..rows.end)
        .take_while(|part| part.len() >= FEWEST_SAMPLES)
        .find(|part| {
            let mut signals = resolved.iter();
            signals.all(|(values, quantum)| !drifts(&values[part.clone()], *quantum))
        })
}

/// Whether the mean of a signal changes by more than eight standard deviations of its noise, from the differences of neighbouring
/// samples (von Neumann), or of its `quantum`, zero where it is not known. Its first third may be a transient.
///
/// A signal with less noise than its resolution changes rarely: one step of one quantum is not a drift.
fn drifts(values: &[f64], quantum: f64) -> bool {
    let present = finite(values);
    let third = present.len() / 3;
    if third == 0 {
        return false;
    }
    let middle = &present[third..2 * third];
    let last = &present[present.len() - third..];
    let steps = present.windows(2).map(|pair| (pair[1] - pair[0]).powi(2));
    let roughness = (0.5 * steps.sum::<f64>() / (present.len() - 1) as f64).sqrt();
    let noise = roughness.max(quantum_noise(quantum));
    // Means over a third differ much less by noise, even after a slow filter, and much more on a coasting shaft.
    (mean(last) - mean(middle)).abs() > 8.0 * noise
}

/// The standstill without a transient at its beginning: a current by an offset of the drive's voltage, or a coasting shaft.
fn settled(at_rest: &[f64]) -> &[f64] {
    let n = at_rest.len();
    let last_half = &at_rest[n / 2..];
    if last_half.len() < FEWEST_SAMPLES / 2 {
        return at_rest;
    }
    // The logarithm of the ratio of the halves' variances has a deviation of the root of 8/n: 3.3 of them by chance in one
    // case of two thousand.
    let halves = (3.3 * (8.0 / n as f64).sqrt()).exp();
    let limit = (0.5 + 0.5 * halves).sqrt().max(1.15) * standard_deviation(last_half);
    (0..2)
        .map(|quarter| &at_rest[quarter * n / 4..])
        .find(|part| standard_deviation(part) <= limit)
        .unwrap_or(last_half)
}

/// Autocorrelation at lag one, zero within three standard deviations of that of white noise; at most 0.98, where a hundred samples
/// are equivalent to one.
fn memory(at_rest: &[f64]) -> f64 {
    let found = autocorrelation(at_rest, 1).first().copied().unwrap_or(0.0);
    let is_coloured = found > 3.0 / (at_rest.len() as f64).sqrt();
    if is_coloured { found.min(0.98) } else { 0.0 }
}

fn current_is_an_output(scenario: &Scenario) -> bool {
    scenario.input == Input::Voltage
}

/// Standard deviation of the rounding to multiples of `quantum`: a uniform error is its width over the root of twelve.
fn quantum_noise(quantum: f64) -> f64 {
    quantum / 12f64.sqrt()
}

/// Noise in motion, of the samples at rest, and the number of independent ones that would be as certain. A signal that is coarser than
/// its noise stands still at rest, where it is a multiple of its quantum; in motion the rounding adds to the noise, of which the shares
/// of the samples that flip to either neighbour are the measure: they lie a quantum apart.
fn in_motion(at_rest: &[f64], quantum: f64) -> (f64, f64) {
    let (level, count) = (standard_deviation(at_rest), at_rest.len() as f64);
    if level >= quantum {
        return (level, count);
    }
    let middle = median(at_rest);
    let beyond = |side: f64| at_rest.iter().filter(move |v| side * (**v - middle) > 0.5 * quantum);
    let flips = [1.0, -1.0].map(|side| beyond(side).count() as f64);
    // Where a quarter of the samples flip the deviation has the rounding in it.
    let least = level.max(quantum_noise(quantum));
    let all = flips[0] + flips[1];
    // Without a flip all are equal, or lie to both sides of the middle.
    if (all == 0.0 && level > 0.0) || all >= 0.25 * count {
        return (least, count);
    }
    // None is less than one: where all are equal the noise lies between none and this.
    let shares = flips.map(|flips| flips.max(0.5) / count);
    let normal = Normal::standard();
    let distances = shares.map(|share| normal.inverse_cdf(1.0 - share));
    let deviations = distances[0] + distances[1];
    let variances = [0, 1].map(|side| {
        let share = shares[side];
        share * (1.0 - share) / count / normal.pdf(distances[side]).powi(2)
    });
    let noise = quantum / deviations;
    let mut level = noise.hypot(quantum_noise(quantum));
    let relative = (variances[0] + variances[1]).sqrt() / deviations * (noise / level).powi(2);
    // Flips to one side alone may be of an offset by an unknown part of the quantum, and less noise: halfway.
    if flips.contains(&0.0) {
        level = 0.5 * (least + level);
    }
    (level, count.min(0.5 / relative.powi(2)))
}

/// Resolution of the instrument: the smallest step between values, if nearly every step is a multiple of it.
fn quantum(values: &[f64]) -> Option<f64> {
    let mut sorted = finite(values);
    sorted.sort_by(f64::total_cmp);
    let range = sorted.last()? - sorted.first()?;
    // Smaller steps are rounding in the file.
    let steps: Vec<f64> = sorted
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .filter(|step| *step > 1e-6 * range)
        .collect();
    let smallest = steps.iter().copied().min_by(f64::total_cmp)?;
    let multiples = steps.iter().filter(|step| {
        let rest = (**step / smallest).fract();
        rest.min(1.0 - rest) < 0.05
    });
    (multiples.count() as f64 >= 0.95 * steps.len() as f64).then_some(smallest)
}

fn standard_deviation(values: &[f64]) -> f64 {
    variance(values).sqrt()
}

/// Standard deviation of the rounding of a signal to multiples of its quantum; zero where it has none.
pub fn rounding(values: &[f64]) -> f64 {
    quantum(values).map_or(0.0, quantum_noise)
}

/// Variance that its rounding, of this standard deviation, adds to each value of a signal: the error that a run of `n` equal values has in
/// common counts once, hence with `n` times its variance, of which the noise of each value has one.
pub fn common_rounding(values: &[f64], rounding: f64) -> Vec<f64> {
    let variance = rounding * rounding;
    let mut added = vec![0.0; values.len()];
    let present: Vec<usize> = (0..values.len()).filter(|row| values[*row].is_finite()).collect();
    for equal in present.chunk_by(|a, b| (values[*a] - values[*b]).abs() < rounding) {
        for row in equal {
            added[*row] = variance * (equal.len() - 1) as f64;
        }
    }
    added
}

/// Noise of a signal in motion, at least that of its rounding.
pub fn noise_in_motion(values: &[f64]) -> f64 {
    roughness(values).max(rounding(values))
}

/// Noise of a signal by its second differences (difference-based estimator: Gasser, Sroka and Jennen-Steinmetz, Biometrika 73,
/// 1986), robust against outliers and steps; zero without a signal.
pub(super) fn roughness(values: &[f64]) -> f64 {
    let differences = values.windows(3).map(|v| v[0] - 2.0 * v[1] + v[2]);
    let differences = finite(&differences.collect::<Vec<f64>>());
    if differences.is_empty() {
        return 0.0;
    }
    robust_deviation(&differences) / 6f64.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{every, run_of};
    use drivebench_model::sample::{Channel, Origin};
    use rand::SeedableRng as _;
    use rand_distr::Distribution as _;

    fn scenario(standstill: usize, speed: impl Fn(usize) -> f64) -> Scenario {
        let volts = |k| if k < standstill { 0.0 } else { 10.0 };
        let columns = [
            (Channel::Voltage, (0..400).map(volts).collect()),
            (Channel::Speed, (0..400).map(speed).collect()),
        ];
        let mut run = run_of(every(0.01, 4.0), columns);
        run.set_origin(Channel::Voltage, Origin::Unknown);
        Scenario::from_run(&run).unwrap()
    }

    fn floor(standstill: usize, speed: impl Fn(usize) -> f64) -> Option<NoiseFloor> {
        NoiseFloor::from_standstill(&scenario(standstill, speed))
    }

    #[test]
    fn the_rounding_of_equal_values_counts_once() {
        let values = [0.5, 0.5, 0.5, f64::NAN, 0.5, 1.0, 1.5, 1.5];
        let own = rounding(&values);
        assert!((own - 0.5 / 12f64.sqrt()).abs() < 1e-12);
        let added = common_rounding(&values, own).into_iter().map(|variance| variance / own / own);
        for (added, expected) in added.zip([3.0, 3.0, 3.0, 0.0, 3.0, 0.0, 1.0, 1.0]) {
            assert!((added - expected).abs() < 1e-9, "{added} {expected}");
        }
        let smooth: Vec<f64> = (0..50).map(|k| f64::from(k).sqrt()).collect();
        assert!(rounding(&smooth) == 0.0 && common_rounding(&smooth, 0.0) == [0.0; 50]);
    }

    fn alternating(k: usize) -> f64 {
        [0.1, -0.1][k % 2]
    }

    #[test]
    fn the_floor_is_that_of_a_shaft_at_rest_for_long_enough() {
        let noisy = |k: usize| alternating(k) + if k > 50 { k as f64 } else { 0.0 };
        let rest = floor(50, noisy).unwrap();
        assert!(rest.current_a.is_infinite());
        assert_eq!(floor(10, noisy), None);
        // One that coasts when the record begins is at rest after it has stopped.
        let coasts = |k: usize| alternating(k) + 60.0 - 0.5 * k as f64;
        assert_eq!(floor(100, coasts), None);
        // So slowly that its means differ, with less between two samples than the noise.
        let stops = |k: usize| alternating(k) + (12.0 - 0.2 * k as f64).max(0.0);
        let stopped = floor(100, stops).unwrap();
        assert!(stopped.samples < 80);
        for floor in [rest, stopped] {
            assert!((floor.speed_rad_s - 0.1).abs() < 0.002, "{floor:?}");
        }
    }

    #[test]
    fn a_speed_from_counts_is_as_rough_as_it_is_in_motion_and_no_rougher_than_they_make_it() {
        let speed = |k: usize| if k < 50 { 0.1 * alternating(k) } else { 1.0 + alternating(k) };
        let with_counts = |count_rad: f64| {
            let mut run = scenario(50, speed);
            let turns = |k: usize| ((k as f64 * 0.31).sin() * 3.0).round() * count_rad;
            run.angle = (0..400).map(|k| (run.sample_time_s[k], turns(k))).collect();
            NoiseFloor::from_standstill(&run).unwrap().speed_rad_s
        };
        let none = floor(50, speed).unwrap().speed_rad_s;
        let rough = roughness(&(0..400).map(speed).collect::<Vec<f64>>());
        assert!(rough > 2.0 * none, "{rough} {none}");
        assert!((with_counts(0.01) / rough - 1.0).abs() < 1e-9);
        // Two readings of a count of 1 mrad, 10 ms apart.
        assert!((with_counts(1e-3) - 0.1 / 6f64.sqrt()).abs() < 1e-6, "{}", with_counts(1e-3));
        assert!((with_counts(1e-5) - none).abs() < 1e-9);
    }

    #[test]
    fn rounding_adds_in_motion_to_a_noise_that_hardly_shows_at_rest() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let sigma = rand_distr::Normal::new(0.0, 0.6).unwrap();
        let noise: Vec<f64> = (0..400).map(|_| sigma.sample(&mut rng)).collect();
        for (quantum, expected, within) in
            [(2.4, 0.6_f64.hypot(2.4 / 12f64.sqrt()), 0.12), (0.3, 0.61, 0.12)]
        {
            let speed = |k: usize| {
                let turns = if k < 200 { 0.0 } else { 1.7 * (k - 200) as f64 };
                quantum * ((turns + noise[k]) / quantum).round()
            };
            let found = floor(200, speed).unwrap().speed_rad_s;
            assert!((found / expected - 1.0).abs() < within, "{quantum}: {found}");
        }
    }

    #[test]
    fn a_sensor_whose_noise_is_a_quarter_of_its_quantum_is_as_noisy_as_its_flips_show() {
        // Of 100 samples at rest, 2.5 of a hundred are expected on either side.
        let truth = 0.25_f64.hypot(1.0 / 12f64.sqrt());
        for (above, below) in [(2, 3), (5, 1), (6, 0), (0, 3)] {
            let mut at_rest = vec![0.0; 100];
            at_rest[..above].fill(1.0);
            at_rest[above..above + below].fill(-1.0);
            let (level, samples) = in_motion(&at_rest, 1.0);
            assert!((level / truth - 1.0).abs() < 0.15, "{above} {below}: {level}");
            assert!((30.0..=100.0).contains(&samples), "{above} {below}: {samples}");
        }
        // Without a flip it is that of the rounding, and half of the noise that would have shown.
        let level = in_motion(&[0.0; 100], 1.0).0 * 12f64.sqrt();
        assert!((1.05..1.15).contains(&level), "{level}");
    }

    #[test]
    fn a_signal_without_noise_has_no_floor_below_its_resolution() {
        let silent = |k: usize| if k < 50 { 0.0 } else { (k as f64).sin() };
        assert_eq!(floor(50, silent), None);
        assert!(NoiseFloor::from_spread(&scenario(50, silent)).speed_rad_s > 0.0);
        let counts = |k: usize| (k.saturating_sub(50) / 3) as f64 * 0.5;
        let of_quantum = floor(50, counts).unwrap().speed_rad_s;
        let of_rounding = of_quantum / (0.5 / 12f64.sqrt());
        assert!((1.0..1.2).contains(&of_rounding), "{of_rounding}");
        // An offset near the edge of two counts is no drift: nearly all of the first half shows one, all of the second the other.
        let moves = |k: usize| (k.saturating_sub(100) / 3) as f64;
        let edge = |k: usize| 0.1 * (moves(k) + f64::from(u8::from((70..100).contains(&k))));
        let whole = floor(100, edge).unwrap();
        let between = (0.1 / 12f64.sqrt()..0.1).contains(&whole.speed_rad_s);
        assert!(between && whole.samples > 90, "{whole:?}");
        // A run-out of many counts is one.
        let coasts = |k: usize| 0.1 * (moves(k) + 100_usize.saturating_sub(k) as f64);
        assert_eq!(floor(100, coasts), None);
    }

    #[test]
    fn coloured_noise_counts_as_fewer_samples() {
        // An autoregressive process of 0.9, and white noise.
        let white = |k: usize| ((78.233 * k as f64).sin() * 43_758.545).fract() - 0.5;
        let coloured = (0..400).scan(0.0, |level, k| {
            *level = 0.9 * *level + white(k);
            Some(*level)
        });
        let coloured: Vec<f64> = coloured.collect();
        let [white, coloured] =
            [floor(400, white), floor(400, |k| coloured[k])].map(Option::unwrap);
        assert!(white.memory[1].abs() < 1e-12 && white.samples > 380, "{white:?}");
        assert!((0.7..0.95).contains(&coloured.memory[1]), "{coloured:?}");
        assert!((20..150).contains(&coloured.samples), "{coloured:?}");
    }
}
