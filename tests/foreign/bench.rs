//! What every machine here is built from: a source of chance, an integrator, sensors, commands, and a log. Nothing of the
//! program is in it.

use std::f64::consts::TAU;
use std::fmt::Write as _;

/// Which of the three records of a machine: the same machine, another excitation and other noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Run {
    Fit,
    Holdout,
    Confirm,
}

impl Run {
    pub(crate) const ALL: [Self; 3] = [Self::Fit, Self::Holdout, Self::Confirm];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Fit => "fit",
            Self::Holdout => "holdout",
            Self::Confirm => "confirm",
        }
    }
}

/// Chance: `SplitMix64` (Steele, Lea and Flood 2014), normal deviates by Box and Muller (1958).
#[derive(Clone, Debug)]
pub(crate) struct Chance(u64);

impl Chance {
    /// What is the same in every run of one specimen: its size.
    pub(crate) const fn of_specimen(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0x5EED)
    }

    /// What differs between its runs: excitation and noise.
    pub(crate) const fn of_run(seed: u64, run: Run) -> Self {
        let of_run = Self::of_specimen(seed).0 ^ ((run as u64 + 1) << 40);
        Self(of_run.wrapping_mul(0xD134_2543_DE82_EF95))
    }

    const fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Evenly between 0 and 1, never 0.
    fn share(&mut self) -> f64 {
        ((self.bits() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.share()
    }

    /// A nominal value that a specimen misses by at most this share.
    pub(crate) fn near(&mut self, nominal: f64, share: f64) -> f64 {
        nominal * self.between(1.0 - share, 1.0 + share)
    }

    pub(crate) fn sign(&mut self) -> f64 {
        if self.bits() >> 63 == 0 { 1.0 } else { -1.0 }
    }

    /// Of mean 0 and deviation 1.
    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.share().ln()).sqrt();
        radius * (TAU * self.share()).cos()
    }
}

/// Noise with a memory: first-order autoregression whose deviation stays as it is.
pub(crate) struct Coloured {
    memory: f64,
    deviation: f64,
    state: f64,
}

impl Coloured {
    pub(crate) fn new(deviation: f64, memory_s: f64, period_s: f64) -> Self {
        Self { memory: (-period_s / memory_s).exp(), deviation, state: 0.0 }
    }

    pub(crate) fn next(&mut self, chance: &mut Chance) -> f64 {
        let fresh = (1.0 - self.memory * self.memory).sqrt() * self.deviation;
        self.state = self.memory * self.state + fresh * chance.normal();
        self.state
    }
}

/// What a converter of this step gives.
pub(crate) fn quantised(value: f64, step: f64) -> f64 {
    (value / step).round() * step
}

/// Whole counts of an incremental encoder below this angle.
pub(crate) fn counts(angle_rad: f64, per_turn: f64) -> f64 {
    (angle_rad / TAU * per_turn).floor()
}

/// One step of the classical method of Runge and Kutta (1901).
pub(crate) fn rk4<const N: usize>(
    state: [f64; N],
    step_s: f64,
    rate: impl Fn(&[f64; N]) -> [f64; N],
) -> [f64; N] {
    let ahead = |by: &[f64; N], part_s: f64| -> [f64; N] {
        std::array::from_fn(|n| state[n] + part_s * by[n])
    };
    let k1 = rate(&state);
    let k2 = rate(&ahead(&k1, 0.5 * step_s));
    let k3 = rate(&ahead(&k2, 0.5 * step_s));
    let k4 = rate(&ahead(&k3, step_s));
    std::array::from_fn(|n| state[n] + step_s / 6.0 * (k1[n] + 2.0 * (k2[n] + k3[n]) + k4[n]))
}

/// Dry friction by the stick and slip of Karnopp (1985): a shaft within the band is at rest until the torque breaks it loose.
#[derive(Clone, Copy)]
pub(crate) struct Dry {
    pub(crate) level_n_m: f64,
    pub(crate) band_rad_s: f64,
}

impl Dry {
    /// Which way it acts for a whole step: `None` where the shaft sticks.
    pub(crate) fn direction(self, speed_rad_s: f64, drive_n_m: f64) -> Option<f64> {
        if speed_rad_s.abs() > self.band_rad_s {
            Some(speed_rad_s.signum())
        } else if drive_n_m.abs() > self.level_n_m {
            Some(drive_n_m.signum())
        } else {
            None
        }
    }

    /// Speed after a step in which it acted this way: what would have been turned round by friction has come to rest.
    pub(crate) fn settled(direction: Option<f64>, speed_rad_s: f64) -> f64 {
        match direction {
            Some(direction) if direction * speed_rad_s > 0.0 => speed_rad_s,
            _ => 0.0,
        }
    }
}

/// A command that holds a level until the next one, or goes there along a straight line.
#[derive(Clone, Debug, Default)]
pub(crate) struct Levels {
    /// From this time on, this level.
    at: Vec<(f64, f64)>,
    /// Greatest change in a second; none without limit.
    slope_per_s: Option<f64>,
}

impl Levels {
    /// Rest first, then one level after the other, each for as long as drawn.
    pub(crate) fn steps(
        rest_s: f64,
        end_s: f64,
        hold_s: [f64; 2],
        chance: &mut Chance,
        mut level: impl FnMut(&mut Chance, usize) -> f64,
    ) -> Self {
        let (mut time_s, mut at) = (rest_s, vec![(0.0, 0.0)]);
        while time_s < end_s {
            let next = level(chance, at.len() - 1);
            at.push((time_s, next));
            time_s += chance.between(hold_s[0], hold_s[1]);
        }
        Self { at, slope_per_s: None }
    }

    pub(crate) fn along(self, slope_per_s: f64) -> Self {
        Self { slope_per_s: Some(slope_per_s), ..self }
    }

    pub(crate) fn value(&self, time_s: f64) -> f64 {
        let mut value = 0.0;
        for (n, (from_s, level)) in self.at.iter().enumerate() {
            if *from_s > time_s {
                break;
            }
            let until_s = self.at.get(n + 1).map_or(time_s, |next| next.0.min(time_s));
            value = match self.slope_per_s {
                None => *level,
                Some(slope) => {
                    let most = slope * (until_s - from_s);
                    value + (level - value).clamp(-most, most)
                }
            };
        }
        value
    }
}

/// A record as its owner has it.
pub(crate) struct Log {
    heads: &'static str,
    pub(crate) rows: Vec<Vec<f64>>,
}

impl Log {
    /// With these heads, in the owner's own words.
    pub(crate) const fn new(heads: &'static str) -> Self {
        Self { heads, rows: Vec::new() }
    }

    pub(crate) fn row(&mut self, cells: &[f64]) {
        self.rows.push(cells.to_vec());
    }

    /// With so many digits behind the point as a logger prints.
    pub(crate) fn text(&self) -> String {
        let mut text = format!("{}\n", self.heads);
        for row in &self.rows {
            for (n, cell) in row.iter().enumerate() {
                let comma = if n == 0 { "" } else { "," };
                let _ = write!(text, "{comma}{cell:.6}");
            }
            text.push('\n');
        }
        text
    }
}
