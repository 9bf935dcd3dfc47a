//! Limit cycles of a loop: whether it swings by itself, and how much softer it has to be.
//!
//! Play and elasticity between motor and load, or a delay that the model does not have, can turn gains that are right on
//! paper into a steady swing. It is recognised by its half-swings: alike, quick, around a reference that stands still. The
//! gains are then lowered by steps. A swing that goes on all the same is not the loop's own, and they are given back.

/// Half-swings that make a swing.
const HALVES: usize = 6;
/// Longest half-swing, cycles: the loop's own swing is a few dead times long.
const LONGEST: u32 = 12;
/// Largest half-swing over the least.
const ALIKE: f64 = 3.0;
/// A swing is at least so many times the noise, and this share of the reference.
const NOISES: f64 = 10.0;
const REFERENCE_SHARE: f64 = 0.02;
/// What each step leaves of the gains, and how many steps are tried: a coupling of 21 Hz that is damped by 2 % goes on
/// swinging with a tenth of them.
const STEP: f64 = 0.7;
const STEPS: i32 = 8;
/// A swing that is left at this share of the first after all steps is not the loop's own.
const NOT_OWN: f64 = 0.7;

/// What is to be done with the gains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Verdict {
    /// Lower them to this share of what the tuning says; the swing is so large, rad/s.
    Soften { share: f64, swing_rad_s: f64 },
    /// The swing does not come from the loop: back to what the tuning says.
    GiveBack { swing_rad_s: f64 },
}

/// The watch of one loop.
#[derive(Clone, Debug)]
pub(super) struct Swing {
    noise_rad_s: f64,
    reference_rad_s: f64,
    /// Largest errors of the last half-swings that follow each other, oldest first.
    halves: [f64; HALVES],
    known: usize,
    /// The half-swing that is under way: its sign, largest error and cycles.
    sign: f64,
    largest: f64,
    cycles: u32,
    steps: i32,
    first_rad_s: f64,
    gave_back: bool,
}

impl Swing {
    /// `noise_rad_s`: standard deviation of a speed sample.
    pub(super) const fn new(noise_rad_s: f64) -> Self {
        Self {
            noise_rad_s,
            reference_rad_s: f64::NAN,
            halves: [0.0; HALVES],
            known: 0,
            sign: 0.0,
            largest: 0.0,
            cycles: 0,
            steps: 0,
            first_rad_s: 0.0,
            gave_back: false,
        }
    }

    /// What is left of the gains.
    pub(super) fn share(&self) -> f64 {
        if self.gave_back {
            1.0
        } else {
            STEP.powi(self.steps)
        }
    }

    /// One cycle.
    pub(super) fn push(&mut self, reference_rad_s: f64, speed_rad_s: f64) -> Option<Verdict> {
        let error = reference_rad_s - speed_rad_s;
        if reference_rad_s.to_bits() != self.reference_rad_s.to_bits() || !error.is_finite() {
            self.reference_rad_s = reference_rad_s;
            self.forget();
            return None;
        }
        self.cycles += 1;
        if self.cycles > LONGEST {
            self.forget();
        }
        if error * self.sign >= 0.0 {
            self.largest = self.largest.max(error.abs());
            if self.sign == 0.0 {
                self.sign = error.signum();
            }
            return None;
        }
        self.halves.rotate_left(1);
        self.halves[HALVES - 1] = self.largest;
        self.known = (self.known + 1).min(HALVES);
        (self.sign, self.largest, self.cycles) = (error.signum(), error.abs(), 0);
        self.judge()
    }

    fn forget(&mut self) {
        (self.known, self.cycles, self.sign, self.largest) = (0, 0, 0.0, 0.0);
    }

    fn judge(&mut self) -> Option<Verdict> {
        let least = self.halves.iter().copied().fold(f64::MAX, f64::min);
        let most = self.halves.iter().copied().fold(0.0, f64::max);
        let floor = (NOISES * self.noise_rad_s).max(REFERENCE_SHARE * self.reference_rad_s.abs());
        let swings = self.known == HALVES && least > floor && most < ALIKE * least;
        if !swings || self.gave_back {
            return None;
        }
        let swing_rad_s = self.halves.iter().sum::<f64>() / HALVES as f64;
        self.forget();
        if self.steps == 0 {
            self.first_rad_s = swing_rad_s;
        }
        if self.steps < STEPS {
            self.steps += 1;
            let share = self.share();
            return Some(Verdict::Soften { share, swing_rad_s });
        }
        if swing_rad_s > NOT_OWN * self.first_rad_s {
            self.gave_back = true;
            return Some(Verdict::GiveBack { swing_rad_s });
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sine around 100 rad/s; the amplitude may depend on the share of the gains.
    fn verdicts(period: f64, amplitude: impl Fn(f64) -> f64, cycles: u32) -> (Vec<Verdict>, f64) {
        let mut swing = Swing::new(0.15);
        let found = (0..cycles).filter_map(|n| {
            let angle = std::f64::consts::TAU * f64::from(n) / period;
            let speed = 100.0 + amplitude(swing.share()) * angle.sin();
            swing.push(100.0, speed)
        });
        (found.collect(), swing.share())
    }

    #[test]
    fn a_swing_that_ends_with_softer_gains_leaves_them_soft() {
        let (found, share) = verdicts(5.0, |share| if share > 0.6 { 8.0 } else { 0.3 }, 400);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!((share - 0.49).abs() < 1e-12);
    }

    #[test]
    fn a_swing_that_goes_on_is_not_the_loops_own() {
        let (found, share) = verdicts(9.0, |_| 8.0, 800);
        assert_eq!(found.len(), 9, "{found:?}");
        assert!(matches!(found[8], Verdict::GiveBack { .. }));
        assert!((share - 1.0).abs() < 1e-12);
    }

    #[test]
    fn noise_slow_waves_and_a_reference_that_moves_are_none() {
        assert!(verdicts(2.3, |_| 0.9, 400).0.is_empty());
        assert!(verdicts(60.0, |_| 20.0, 800).0.is_empty());
        let mut swing = Swing::new(0.15);
        for n in 0..400_u32 {
            let away = if n % 4 < 2 { 8.0 } else { -8.0 };
            let reference = 100.0 + 0.1 * f64::from(n);
            assert_eq!(swing.push(reference, reference + away), None);
        }
        for _ in 0..100 {
            assert_eq!(swing.push(100.0, f64::NAN), None);
        }
    }
}
