//! Regressors that mean nothing, as effects with one coefficient: what belongs to another moment, or to no machine.

use super::simulated::{KNOWN, axis, evidence, nameplate, truth};
use super::*;
use crate::plant::effect::{Card, Enters, Terms};
use crate::plant::{ParameterRole, ParameterSpec};

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

/// A value at each sample, or a function of the speed where there is none.
struct Placebo {
    card: Card,
    period_s: f64,
    values: Vec<f64>,
}

struct Sized(&'static Placebo, f64);

impl Terms for Sized {
    fn torque_n_m(&self, at: &Instant, _own: &[f64]) -> f64 {
        let values = &self.0.values;
        let value = if values.is_empty() {
            (3.7 * at.speed_rad_s).sin()
        } else {
            let place = crate::numerics::count::whole((at.time_s / self.0.period_s).round());
            values[place.min(values.len() - 1)]
        };
        self.1 * value
    }
}

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

fn placebo(id: &'static str, period_s: f64, values: Vec<f64>) -> &'static dyn Effect {
    let card = Card {
        id,
        name: id,
        enters: Enters::Torque,
        ..Card::PLAIN
    };
    let kept: &'static Placebo = Box::leak(Box::new(Placebo {
        card,
        period_s,
        values,
    }));
    Box::leak(Box::new(kept))
}

/// Speeds of another moment, at least a tenth of the record away.
fn placebos(run: &Scenario, count: usize, seed: u64) -> Vec<&'static dyn Effect> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let period_s = run.sample_time_s[1] - run.sample_time_s[0];
    let n = run.samples();
    let mut placebos = vec![placebo("placebo: sin 3.7 w", period_s, vec![])];
    while placebos.len() < count {
        let by = crate::numerics::count::whole(rng.random_range(0.1..0.9) * n as f64);
        let shifted = |term: fn(f64) -> f64| -> Vec<f64> {
            let values = (0..n).map(|k| term(run.speed_rad_s[(k + by) % n]));
            values.collect()
        };
        let (id, values) = match placebos.len() % 3 {
            0 => ("placebo: shifted w", shifted(|w| w)),
            1 => ("placebo: shifted w |w|", shifted(|w| w * w.abs())),
            // Less its mean: that is a constant load, which a record may well miss.
            _ => {
                let sizes = shifted(f64::abs);
                let mean = crate::numerics::statistics::mean(&sizes);
                let rest = sizes.iter().map(|size| size - mean).collect();
                ("placebo: shifted |w| less its mean", rest)
            }
        };
        placebos.push(placebo(id, period_s, values));
    }
    placebos
}

#[test]
fn placebos_are_refused() {
    let (mut judged, mut passed) = (0, 0);
    for seed in 0..6 {
        let (id, values) = KNOWN[seed % KNOWN.len()];
        // Half of the records miss an effect: a model that is wrong must not make placebos right.
        let machine = if seed < 3 { truth(id, values) } else { axis() };
        let data = evidence(&machine, 20 + seed as u64);
        for one in placebos(&data.training, 6, seed as u64) {
            let added = add(one, &nameplate(), &data).unwrap();
            judged += 1;
            if added.accepted {
                eprintln!("{}: {}", added.effect, added.reason);
                passed += 1;
            }
        }
    }
    eprintln!("placebos added: {passed} of {judged}");
    assert!(passed < 2, "{passed} of {judged}");
}
