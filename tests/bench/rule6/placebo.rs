//! Regressors that mean nothing, as effects with one coefficient: what no machine has, and what belongs to another moment.

use drivebench::plant::effect::{Card, Enters};
use drivebench::plant::{Effect, Instant, ParameterRole, ParameterSpec, Scenario, Terms};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const PARAMETERS: &[ParameterSpec] = &[ParameterSpec {
    key: "size",
    unit: "-",
    min: f64::MIN,
    max: f64::MAX,
    scale: 1.0,
    role: ParameterRole::Coefficient,
    logarithmic: false,
    shapes: &[],
}];

/// Which equation the regressor is put into.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Into {
    Voltage,
    Torque,
}

/// A value at each instant, or a function of the speed.
enum Form {
    InTime { period_s: f64, values: Vec<f64> },
    OfSpeed(fn(f64) -> f64),
}

struct Placebo {
    card: Card,
    into: Into,
    form: Form,
}

impl Placebo {
    fn at(&self, at: &Instant) -> f64 {
        match &self.form {
            Form::InTime { period_s, values } => {
                let place = (at.time_s / period_s).clamp(0.0, (values.len() - 1) as f64);
                let before = place.floor() as usize;
                let after = (before + 1).min(values.len() - 1);
                values[before] + (place - before as f64) * (values[after] - values[before])
            }
            Form::OfSpeed(function) => function(at.speed_rad_s),
        }
    }
}

struct Sized(&'static Placebo, f64);

impl Terms for Sized {
    fn torque_n_m(&self, at: &Instant, _own: &[f64]) -> f64 {
        if self.0.into == Into::Torque {
            self.1 * self.0.at(at)
        } else {
            0.0
        }
    }

    fn voltage_v(&self, at: &Instant, _own: &[f64]) -> f64 {
        if self.0.into == Into::Voltage {
            self.1 * self.0.at(at)
        } else {
            0.0
        }
    }
}

/// The catalogue's effects live as long as the program, and so do these.
struct Kept(&'static Placebo);

impl Effect for Kept {
    fn card(&self) -> &'static Card {
        &self.0.card
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        PARAMETERS
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Sized(self.0, values[0]))
    }
}

fn kept(id: &'static str, into: Into, form: Form) -> &'static dyn Effect {
    let card = Card {
        id,
        name: id,
        enters: match into {
            Into::Voltage => Enters::Voltage,
            Into::Torque => Enters::Torque,
        },
        ..Card::PLAIN
    };
    let placebo = Box::leak(Box::new(Placebo { card, into, form }));
    Box::leak(Box::new(Kept(placebo)))
}

/// `count` placebos made of the signals of a run on even stamps: the same instants for training and hold-out, which
/// must be parts of it.
pub(crate) fn placebos(run: &Scenario, count: usize, seed: u64) -> Vec<&'static dyn Effect> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let period_s = run.sample_time_s[1] - run.sample_time_s[0];
    let mut placebos = vec![kept(
        "placebo: sin 3.7 w",
        Into::Torque,
        Form::OfSpeed(|speed| (3.7 * speed).sin()),
    )];
    while placebos.len() < count {
        // Six kinds in turn; in the torque balance those of the motion, in the voltage balance that of the current.
        let (id, into, values) = match placebos.len() % 6 {
            0 => (
                "placebo: shuffled angle",
                Into::Torque,
                shuffled_angle(run, &mut rng),
            ),
            1 => (
                "placebo: shifted w",
                Into::Torque,
                shifted(&run.speed_rad_s, &mut rng),
            ),
            2 => (
                "placebo: w of another phase",
                Into::Torque,
                another_phase(&run.speed_rad_s, &mut rng),
            ),
            3 => (
                "placebo: blocks of w |w| permuted",
                Into::Torque,
                permuted(&run.speed_rad_s, |w| w * w.abs(), &mut rng),
            ),
            4 => (
                "placebo: shifted i",
                Into::Voltage,
                shifted(&run.current_a, &mut rng),
            ),
            _ => (
                "placebo: i of another phase",
                Into::Voltage,
                another_phase(&run.current_a, &mut rng),
            ),
        };
        placebos.push(kept(id, into, Form::InTime { period_s, values }));
    }
    placebos
}

fn shuffled_angle(run: &Scenario, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let order = rng.random_range(1.0..20.0);
    let mut angles: Vec<f64> = run.shaft_angle().iter().map(|point| point.1).collect();
    angles.shuffle(rng);
    angles.iter().map(|angle| (order * angle).sin()).collect()
}

/// At least a tenth of the record away, round its end.
fn shifted(values: &[f64], rng: &mut ChaCha8Rng) -> Vec<f64> {
    let by = (rng.random_range(0.1..0.9) * values.len() as f64) as usize;
    (0..values.len())
        .map(|k| values[(k + by) % values.len()])
        .collect()
}

/// Spectrum of the signal with every phase drawn anew: lines up to 10 Hz, above which these signals have little.
fn another_phase(values: &[f64], rng: &mut ChaCha8Rng) -> Vec<f64> {
    let n = values.len();
    let mut other = vec![0.0; n];
    let lines = (10.0 * n as f64 * super::record::PERIOD_S) as usize;
    for line in 1..=lines {
        let step = std::f64::consts::TAU * line as f64 / n as f64;
        let (mut re, mut im) = (0.0, 0.0);
        for (k, value) in values.iter().enumerate() {
            let (sin, cos) = (step * k as f64).sin_cos();
            re += value * cos;
            im += value * sin;
        }
        let (size, phase) = (
            2.0 * re.hypot(im) / n as f64,
            rng.random_range(0.0..std::f64::consts::TAU),
        );
        for (k, other) in other.iter_mut().enumerate() {
            *other += size * (step * k as f64 + phase).cos();
        }
    }
    other
}

/// Blocks of half a second in another order.
fn permuted(values: &[f64], of: fn(f64) -> f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let length = (0.5 / super::record::PERIOD_S) as usize;
    let mut blocks: Vec<&[f64]> = values.chunks(length).collect();
    blocks.shuffle(rng);
    blocks.concat().into_iter().map(of).collect()
}
