//! Kind of a hidden effect: what its file states, parameters, sizes and what it does.

use std::ops::Range;

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::{HiddenEffect, Mechanism, Path, Shaft, Site};

/// One parameter of the truth: key as in the model file, value, unit.
pub type TrueParameter = (&'static str, f64, &'static str);

/// A value that a parameter cannot have: key, value, what is allowed.
pub type Refused = (&'static str, f64, &'static str);

/// A kind of hidden effect; its id and keys are those of the model file. The doc of each explains its keys.
#[derive(Debug)]
pub(super) struct HiddenKind {
    pub(super) id: &'static str,
    /// Names of the host's catalogue that are right for it; none where no catalogue has it.
    pub(super) names: &'static [&'static str],
    pub(super) parameters: &'static [Parameter],
    /// How a mystery draws the values, in the order of the parameters; `None` where no mystery hides it.
    pub(super) mystery: Option<fn(&mut Dice<'_>) -> Vec<f64>>,
    pub(super) acts: Acts,
}

impl HiddenKind {
    /// Whether the study of the diagnosis draws it.
    pub(super) fn is_studied(&self) -> bool {
        self.parameters.iter().all(Parameter::is_studied)
    }

    /// Its values as the study draws them, in the order of the parameters.
    pub(super) fn study(&self, rng: &mut ChaCha8Rng) -> Vec<f64> {
        let mut other_part = None;
        self.parameters.iter().map(|p| p.drawn(rng, &mut other_part)).collect()
    }

    /// What it does inside the motor of paper A with these values.
    #[cfg(test)]
    pub(super) fn mechanism(&self, values: &[f64]) -> Box<dyn Mechanism> {
        self.mechanism_on(&Site::of(&crate::truth::motor::zk_22fc()), values)
    }

    #[cfg(test)]
    pub(super) fn mechanism_on(&self, site: &Site, values: &[f64]) -> Box<dyn Mechanism> {
        match self.acts {
            Acts::Inside(make) => make(values, site),
            _ => panic!("{} does nothing inside the machine", self.id),
        }
    }
}

/// Where a kind is at work.
#[derive(Clone, Copy, Debug)]
pub(super) enum Acts {
    /// Inside the machine on this site, from rest and cold.
    Inside(fn(&[f64], &Site) -> Box<dyn Mechanism>),
    /// Between command, machine and measurement, as this value of the path.
    Between(fn(&mut Path) -> &mut f64),
    /// Behind the shaft, as a second inertia.
    Behind(fn(&[f64], &Site) -> Shaft),
    /// In several other effects, of which it is made.
    Together(fn(f64, &Site) -> Vec<HiddenEffect>),
}

/// The first values in the order of the parameters.
pub(super) fn named<const N: usize>(values: &[f64]) -> [f64; N] {
    std::array::from_fn(|index| values[index])
}

#[derive(Debug)]
pub(super) struct Parameter {
    pub(super) key: &'static str,
    pub(super) unit: &'static str,
    pub(super) allowed: Allowed,
    /// In the machines of the tests.
    #[cfg_attr(not(test), expect(dead_code, reason = "only tests use it"))]
    pub(super) usual: f64,
    /// Between which the study draws it, evenly; empty where it does not.
    studied: Range<f64>,
    /// Of these the study draws one.
    one_of: &'static [f64],
}

/// In place of a range: the study does not draw it.
pub(super) const NOT_STUDIED: Range<f64> = 0.0..0.0;

impl Parameter {
    /// N, periods per turn; the study draws one of these.
    pub(super) const fn order(one_of: &'static [f64]) -> Self {
        Self { one_of, ..Allowed::Order.of("order", "-", 7.0, 1.0..400.0) }
    }

    pub(super) const fn is_studied(&self) -> bool {
        self.studied.start < self.studied.end
    }

    /// As the study draws it. `other_part`: of the wave of which this parameter is the first part, for the next one.
    fn drawn(&self, rng: &mut ChaCha8Rng, other_part: &mut Option<f64>) -> f64 {
        if !self.one_of.is_empty() {
            return self.one_of[rng.random_range(0..self.one_of.len())];
        }
        let size = |rng: &mut ChaCha8Rng| rng.random_range(self.studied.clone());
        match self.allowed {
            Allowed::Signed => {
                let sign = if rng.random() { 1.0 } else { -1.0 };
                sign * size(rng)
            }
            Allowed::Wave => other_part.take().unwrap_or_else(|| {
                let amplitude = size(rng);
                let phase = rng.random_range(0.0..std::f64::consts::TAU);
                *other_part = Some(amplitude * phase.cos());
                amplitude * phase.sin()
            }),
            _ => size(rng),
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Allowed {
    /// Any number; the study draws either sign.
    Signed,
    /// Any number: the sine and then the cosine of a wave, whose amplitude is what the study draws.
    Wave,
    NotNegative,
    Positive,
    Fraction,
    /// Between 0 and 1, without them.
    Share,
    /// 0 to 0.5: a loss that leaves something over.
    Loss,
    /// Whole numbers, 1 to 400.
    Order,
    Delay,
}

impl Allowed {
    /// The parameter that may be this, its size in the tests, and the range in which the study draws it.
    pub(super) const fn of(
        self,
        key: &'static str,
        unit: &'static str,
        usual: f64,
        studied: Range<f64>,
    ) -> Parameter {
        Parameter { key, unit, allowed: self, usual, studied, one_of: &[] }
    }

    pub(super) fn refuses(self, value: f64) -> Option<&'static str> {
        let (ok, text) = match self {
            Self::Signed | Self::Wave => (true, "a number"),
            Self::NotNegative => (value >= 0.0, "0 or more"),
            Self::Positive => (value > 0.0, "above 0"),
            Self::Fraction => ((0.0..=1.0).contains(&value), "0 to 1"),
            Self::Share => (value > 0.0 && value < 1.0, "between 0 and 1"),
            Self::Loss => ((0.0..=0.5).contains(&value), "0 to 0.5"),
            Self::Order => {
                (value.fract() == 0.0 && (1.0..=400.0).contains(&value), "a whole number, 1 to 400")
            }
            Self::Delay => ((0.0..=1.0).contains(&value), "0 to 1 s"),
        };
        (!(value.is_finite() && ok)).then_some(text)
    }
}

/// Sizes of a mystery: torques are 3 to 15 % of the rated torque. Voltages are 1 to 4 % of the rated voltage (the resistance
/// itself drops 6 %); offsets stay within what a host's checks at rest allow. Delays and filters are of a size that a
/// sample every 10 ms resolves.
pub(super) struct Dice<'a> {
    rng: &'a mut ChaCha8Rng,
    pub(super) rated_torque_n_m: f64,
    /// The size of an effect that is a torque.
    pub(super) torque_n_m: f64,
    pub(super) voltage_v: f64,
    pub(super) current_a: f64,
    pub(super) speed_rad_s: f64,
}

impl<'a> Dice<'a> {
    pub(super) fn new(rng: &'a mut ChaCha8Rng, nameplate: &Site) -> Self {
        let motor = &nameplate.motor;
        let mut dice = Self {
            rng,
            rated_torque_n_m: nameplate.rated_torque_n_m(),
            torque_n_m: 0.0,
            voltage_v: motor.rated_voltage_v,
            current_a: motor.rated_current_a,
            speed_rad_s: motor.rated_speed_rad_s,
        };
        // Drawn whether it is used or not: the published mysteries stand on this order.
        dice.torque_n_m = dice.size(0.03, 0.15) * dice.rated_torque_n_m;
        dice
    }

    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.rng.random::<f64>()
    }

    /// Small sizes as often as large ones.
    pub(super) fn size(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    pub(super) fn sign(&mut self) -> f64 {
        if self.rng.random() { 1.0 } else { -1.0 }
    }

    pub(super) fn signed(&mut self, low: f64, high: f64) -> f64 {
        self.sign() * self.size(low, high)
    }

    /// Two parts, a quarter of a turn apart, of `amplitude` at any phase.
    pub(super) fn wave(&mut self, amplitude: f64) -> [f64; 2] {
        let phase = self.between(0.0, std::f64::consts::TAU);
        [amplitude * phase.cos(), amplitude * phase.sin()]
    }

    pub(super) fn order(&mut self) -> f64 {
        f64::from(self.rng.random_range(3..=16_u8))
    }

    /// Whole ticks of the drive.
    pub(super) fn delay_s(&mut self, low_ms: f64, high_ms: f64) -> f64 {
        (self.size(low_ms, high_ms) * 20.0).round() * 50e-6
    }
}
