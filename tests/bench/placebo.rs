//! Regressors that mean nothing, as effects with one coefficient: what no machine has, and what belongs to another moment.

use std::f64::consts::TAU;

use drivebench::numerics::count::whole;
use drivebench::numerics::statistics::mean;
use drivebench::plant::effect::{Card, Enters};
use drivebench::plant::{Effect, Instant, Measure, ParameterRole, ParameterSpec, Scenario, Terms};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const PARAMETERS: &[ParameterSpec] = &[ParameterSpec {
    key: "size",
    unit: "-",
    of: Measure::Absolute,
    min: f64::MIN,
    max: f64::MAX,
    most_of_length: f64::INFINITY,
    scale: 1.0,
    role: ParameterRole::Coefficient,
    logarithmic: false,
    shapes: &[],
}];

/// A value at each sample, or a function of the speed where there is none.
struct Placebo {
    card: Card,
    period_s: f64,
    values: Vec<f64>,
}

impl Placebo {
    fn at(&self, at: &Instant) -> f64 {
        let Some(last) = self.values.len().checked_sub(1) else {
            return (3.7 * at.speed_rad_s).sin();
        };
        let place = (at.time_s / self.period_s).clamp(0.0, last as f64);
        let before = whole(place);
        let [from, to] = [before, (before + 1).min(last)].map(|k| self.values[k]);
        from + (place - before as f64) * (to - from)
    }
}

struct Sized(&'static Placebo, f64);

impl Sized {
    fn within(&self, equation: Enters, at: &Instant) -> f64 {
        if self.0.card.enters == equation { self.1 * self.0.at(at) } else { 0.0 }
    }
}

impl Terms for Sized {
    fn torque_n_m(&self, at: &Instant, _own: &[f64]) -> f64 {
        self.within(Enters::Torque, at)
    }

    fn voltage_v(&self, at: &Instant, _own: &[f64]) -> f64 {
        self.within(Enters::Voltage, at)
    }
}

/// The catalogue's effects live as long as the program, and so do these.
impl Effect for &'static Placebo {
    fn card(&self) -> &'static Card {
        &self.card
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        PARAMETERS
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Sized(self, values[0]))
    }
}

/// A kind of placebo: its name, the equation that it is put into, and its value at each sample of a run.
type Kind = (&'static str, Enters, fn(&Scenario, &mut ChaCha8Rng) -> Vec<f64>);

/// For a run that a torque or a current drives: speeds of another moment.
pub(crate) const OF_THE_SPEED: &[Kind] = &[
    ("placebo: shifted w", Enters::Torque, |run, rng| shifted(&run.speed_rad_s, rng)),
    ("placebo: shifted w |w|", Enters::Torque, |run, rng| {
        shifted(&run.speed_rad_s, rng).iter().map(|w| w * w.abs()).collect()
    }),
    // Less its mean: that is a constant load, which a record may well miss.
    ("placebo: shifted |w| less its mean", Enters::Torque, |run, rng| {
        let sizes: Vec<f64> = shifted(&run.speed_rad_s, rng).iter().map(|w| w.abs()).collect();
        let mean = mean(&sizes);
        sizes.iter().map(|size| size - mean).collect()
    }),
];

/// For a run with a voltage, on even stamps: in the torque balance those of the motion, in the voltage balance that of the
/// current.
pub(crate) const OF_MOTION_AND_CURRENT: &[Kind] = &[
    ("placebo: shuffled angle", Enters::Torque, shuffled_angle),
    OF_THE_SPEED[0],
    ("placebo: w of another phase", Enters::Torque, |run, rng| {
        another_phase(&run.speed_rad_s, period_s(run), rng)
    }),
    ("placebo: blocks of w |w| permuted", Enters::Torque, |run, rng| {
        permuted(&run.speed_rad_s, period_s(run), rng).iter().map(|w| w * w.abs()).collect()
    }),
    ("placebo: shifted i", Enters::Voltage, |run, rng| shifted(&run.current_a, rng)),
    ("placebo: i of another phase", Enters::Voltage, |run, rng| {
        another_phase(&run.current_a, period_s(run), rng)
    }),
];

/// `count` placebos, the kinds in turn, made of the signals of a run: the same instants for training and hold-out.
pub(crate) fn placebos(
    run: &Scenario,
    kinds: &[Kind],
    count: usize,
    seed: u64,
) -> Vec<&'static dyn Effect> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let placebo = |id, enters, values| -> &'static dyn Effect {
        let card = Card { id, name: id, enters, ..Card::PLAIN };
        let kept: &'static Placebo =
            Box::leak(Box::new(Placebo { card, period_s: period_s(run), values }));
        Box::leak(Box::new(kept))
    };
    let mut placebos = vec![placebo("placebo: sin 3.7 w", Enters::Torque, vec![])];
    while placebos.len() < count {
        let (id, enters, values) = kinds[placebos.len() % kinds.len()];
        placebos.push(placebo(id, enters, values(run, &mut rng)));
    }
    placebos
}

fn period_s(run: &Scenario) -> f64 {
    run.sample_time_s[1] - run.sample_time_s[0]
}

fn shuffled_angle(run: &Scenario, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let order = rng.random_range(1.0..20.0);
    let mut angles: Vec<f64> = run.shaft_angle().iter().map(|point| point.1).collect();
    angles.shuffle(rng);
    angles.iter().map(|angle| (order * angle).sin()).collect()
}

/// At least a tenth of the record away, round its end.
fn shifted(values: &[f64], rng: &mut ChaCha8Rng) -> Vec<f64> {
    let by = whole(rng.random_range(0.1..0.9) * values.len() as f64);
    (0..values.len()).map(|k| values[(k + by) % values.len()]).collect()
}

/// Spectrum of the signal with every phase drawn anew: lines up to 10 Hz, above which these signals have little.
fn another_phase(values: &[f64], period_s: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let n = values.len();
    let mut other = vec![0.0; n];
    let lines = whole(10.0 * n as f64 * period_s);
    for line in 1..=lines {
        let step = TAU * line as f64 / n as f64;
        let (mut re, mut im) = (0.0, 0.0);
        for (k, value) in values.iter().enumerate() {
            let (sin, cos) = (step * k as f64).sin_cos();
            re += value * cos;
            im += value * sin;
        }
        let (size, phase) = (2.0 * re.hypot(im) / n as f64, rng.random_range(0.0..TAU));
        for (k, other) in other.iter_mut().enumerate() {
            *other += size * (step * k as f64 + phase).cos();
        }
    }
    other
}

/// Blocks of half a second in another order.
fn permuted(values: &[f64], period_s: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let mut blocks: Vec<&[f64]> = values.chunks(whole(0.5 / period_s)).collect();
    blocks.shuffle(rng);
    blocks.concat()
}
