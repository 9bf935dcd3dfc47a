//! Oscillation detector of a closed loop, whatever its controller: amplitudes between zero crossings of the control error
//! (Hägglund, A control-loop performance monitor, 1995), and saturation without progress.
//!
//! Backlash and elasticity between motor and load, or a delay that the model does not have, can turn gains with margins into
//! a limit cycle. Around a constant reference it shows in half-periods that are alike and short; where they are long, or
//! backlash makes them irregular, in the amplitude since the reference was reached; or in a second at a limit while the error
//! does not fall. The gains are then reduced by steps, where the controller allows it. An oscillation that persists all the
//! same is not the loop's own: they are restored. A large one that no gain can end, and a reference that the limit keeps out
//! of reach, end the loop.
//!
//! The trials in `speed/tests/watch.rs` of the bench hold the thresholds: no ringing of a second is missed behind a coupling,
//! and none is reported on a motor that is what its model is.

use std::collections::VecDeque;

use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::extent;

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Finding {
    /// The loop oscillates: its gains are to fall to this share of the tuned ones.
    ReduceGain { amplitude_rad_s: f64, share: f64 },
    /// Smaller gains did not help, so the oscillation is not the loop's: back to the tuned ones.
    RestoreGain { amplitude_rad_s: f64 },
    /// By too little to act against, or with the smallest gains.
    Oscillates { amplitude_rad_s: f64 },
    /// By more than is allowed, and the gains cannot fall (any more).
    Persists { amplitude_rad_s: f64, most_rad_s: f64 },
    /// Most of the window was spent at a limit, and the error does not fall.
    Saturated { limited_share: f64, error_rad_s: f64 },
}

#[derive(Clone, Debug, Default)]
pub struct LoopWatch {
    noise_rad_s: f64,
    can_reduce_gain: bool,
    reference_rad_s: f64,
    /// Of the reference, so far: its last step, and its largest size.
    last_step_rad_s: f64,
    largest_rad_s: f64,
    half_periods: HalfPeriods,
    /// Errors of the window with this reference, and whether a limit held the output.
    window: VecDeque<(f64, bool)>,
    cycles: usize,
    /// Sign of the first error with this reference, and the cycles since it changed: since the reference was reached.
    first_side: f64,
    arrived: usize,
    /// Cycles until the next search for an irregular oscillation.
    until_search: usize,
    steps: i32,
    first_rad_s: f64,
    is_restored: bool,
    reported_rad_s: f64,
}

impl LoopWatch {
    /// `noise_rad_s`: standard deviation of a speed sample.
    pub fn new(noise_rad_s: f64, period_s: f64, can_reduce_gain: bool) -> Self {
        Self {
            noise_rad_s,
            can_reduce_gain,
            reference_rad_s: f64::NAN,
            // A window of one second.
            cycles: whole((1.0 / period_s).round()).max(20),
            ..Self::default()
        }
    }

    pub fn share(&self) -> f64 {
        if self.is_restored { 1.0 } else { 0.7_f64.powi(self.steps) }
    }

    /// One cycle; `limited`: the output before it was held by a limit.
    pub fn push(
        &mut self,
        reference_rad_s: f64,
        speed_rad_s: f64,
        limited: bool,
    ) -> Option<Finding> {
        let error = reference_rad_s - speed_rad_s;
        if reference_rad_s.to_bits() != self.reference_rad_s.to_bits() || !error.is_finite() {
            let step = reference_rad_s - self.reference_rad_s;
            if step.is_finite() {
                self.last_step_rad_s = step.abs();
            }
            self.largest_rad_s = self.largest_rad_s.max(reference_rad_s.abs());
            self.reference_rad_s = reference_rad_s;
            self.restart();
            (self.first_side, self.arrived) = (0.0, 0);
            return None;
        }
        if self.first_side == 0.0 {
            self.first_side = error.signum();
        }
        self.arrived += usize::from(error * self.first_side < 0.0 || self.arrived > 0);
        let alike = self.half_periods.push(error);
        self.window.push_back((error, limited));
        if self.window.len() > self.cycles {
            self.window.pop_front();
        }
        // A decaying one is the response of the machine to a step, not a limit cycle.
        if let Some(alike) = alike
            && alike.least_rad_s > self.acted_rad_s()
            && alike.persists
        {
            return self.found(alike.mean_rad_s);
        }
        self.saturated().or_else(|| self.irregular())
    }

    fn restart(&mut self) {
        self.half_periods = HalfPeriods::default();
        self.window.clear();
    }

    /// An amplitude that no noise has and that is this share of a reference, rad/s.
    fn clear_rad_s(&self, share: f64, reference_rad_s: f64) -> f64 {
        (10.0 * self.noise_rad_s).max(share * reference_rad_s)
    }

    /// The least amplitude that is acted against, rad/s.
    fn acted_rad_s(&self) -> f64 {
        self.clear_rad_s(0.02, self.reference_rad_s.abs())
    }

    fn report(&mut self, amplitude_rad_s: f64) -> Option<Finding> {
        // Once more where it has grown since.
        (amplitude_rad_s > 1.5 * self.reported_rad_s).then(|| {
            self.reported_rad_s = amplitude_rad_s;
            Finding::Oscillates { amplitude_rad_s }
        })
    }

    fn found(&mut self, amplitude_rad_s: f64) -> Option<Finding> {
        self.restart();
        if self.can_reduce_gain && !self.is_restored {
            // A coupling of 21 Hz with 2 % of damping still oscillates with a tenth of the gains: 0.7^8 is 0.06.
            if self.steps < 8 {
                if self.steps == 0 {
                    self.first_rad_s = amplitude_rad_s;
                }
                self.steps += 1;
                return Some(Finding::ReduceGain { amplitude_rad_s, share: self.share() });
            }
            if amplitude_rad_s > 0.7 * self.first_rad_s {
                self.is_restored = true;
                self.reported_rad_s = amplitude_rad_s;
                return Some(Finding::RestoreGain { amplitude_rad_s });
            }
        }
        let most_rad_s = self.clear_rad_s(0.05, self.largest_rad_s);
        if amplitude_rad_s > most_rad_s {
            return Some(Finding::Persists { amplitude_rad_s, most_rad_s });
        }
        self.report(amplitude_rad_s)
    }

    /// Sixteen times in a window: an oscillation whose half-periods are long or not alike, by its amplitude in the last half
    /// of the errors, where it is not dying away.
    fn irregular(&mut self) -> Option<Finding> {
        self.until_search = self.until_search.saturating_sub(1);
        let searched = whole(0.75 * self.cycles as f64);
        if self.window.len().min(self.arrived) < searched || self.until_search > 0 {
            return None;
        }
        self.until_search = self.cycles / 16;
        let errors = || self.window.iter().map(|cycle| cycle.0).skip(self.window.len() - searched);
        let last = || errors().skip(searched / 2);
        let (low, high) = extent(last());
        let amplitude_rad_s = 0.5 * (high - low);
        let before = extent(errors().take(searched / 2));
        let is_large = |amplitude_rad_s: f64, noises: f64| {
            amplitude_rad_s >= (noises * self.noise_rad_s).max(0.02 * self.last_step_rad_s)
        };
        // Noise in a loop comes near the first, in its peaks, but not near the second.
        let is_reported = is_large(amplitude_rad_s, 8.0) || is_large(sine_amplitude(last()), 5.0);
        let decays = amplitude_rad_s < 0.6 * 0.5 * (before.1 - before.0);
        if !is_reported || decays {
            return None;
        }
        let (low, high) = (low.min(before.0), high.max(before.1));
        let (size, middle) = (0.5 * (high - low), 0.5 * (high + low));
        let mut sides: Vec<(usize, bool)> = errors()
            .enumerate()
            .filter(|(_, error)| (error - middle).abs() > 0.4 * size)
            .map(|(cycle, error)| (cycle, error > middle))
            .collect();
        sides.dedup_by_key(|one| one.1);
        // Three changes of side within half of the window; the first side is none.
        let turns = sides.get(1..).unwrap_or_default();
        if !turns.windows(3).any(|some| some[2].0 - some[0].0 < self.cycles / 2) {
            return None;
        }
        if amplitude_rad_s > self.acted_rad_s() {
            self.found(amplitude_rad_s)
        } else {
            self.report(amplitude_rad_s)
        }
    }

    /// Most of the window at a limit, without progress.
    fn saturated(&mut self) -> Option<Finding> {
        if self.window.len() < self.cycles {
            return None;
        }
        let all = || self.window.iter();
        let limited_share = all().filter(|cycle| cycle.1).count() as f64 / self.cycles as f64;
        if limited_share < 0.8 {
            return None;
        }
        let quarter = self.cycles / 4;
        let mean = |errors: &mut dyn Iterator<Item = &(f64, bool)>| {
            errors.take(quarter).map(|cycle| cycle.0.abs()).sum::<f64>() / quarter as f64
        };
        let (first, last) = (mean(&mut all()), mean(&mut all().rev()));
        // A shaft that takes a minute to come up to speed makes progress.
        if last < self.acted_rad_s() || last < 0.99 * first {
            return None;
        }
        if all().zip(all().skip(1)).any(|(one, next)| one.0 * next.0 < 0.0) {
            return self.found(last);
        }
        self.window.clear();
        Some(Finding::Saturated { limited_share, error_rad_s: last })
    }
}

/// Amplitude of the sine with the root mean square of these errors about their mean.
fn sine_amplitude(errors: impl Iterator<Item = f64>) -> f64 {
    let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for error in errors {
        count += 1.0;
        sum += error;
        squares += error * error;
    }
    (2.0 * (squares / count - (sum / count).powi(2)).max(0.0)).sqrt()
}

/// Half-periods of like amplitude: the mean, the least, and whether the later ones are about as large as the earlier.
#[derive(Clone, Copy, Debug)]
struct SteadyOscillation {
    mean_rad_s: f64,
    least_rad_s: f64,
    persists: bool,
}

#[derive(Clone, Debug, Default)]
struct HalfPeriods {
    /// Largest errors of the last ones, oldest first.
    amplitudes: [f64; 6],
    known: usize,
    /// The present one: its sign, largest error and cycles.
    sign: f64,
    largest: f64,
    cycles: u32,
}

impl HalfPeriods {
    /// One error. At the end of a half-period the last ones, where they are alike.
    fn push(&mut self, error: f64) -> Option<SteadyOscillation> {
        self.cycles += 1;
        // A loop's own oscillation has half-periods of a few dead times.
        if self.cycles > 16 {
            *self = Self::default();
        }
        if error * self.sign >= 0.0 {
            self.largest = self.largest.max(error.abs());
            if self.sign == 0.0 {
                self.sign = error.signum();
            }
            return None;
        }
        let count = self.amplitudes.len();
        self.amplitudes.rotate_left(1);
        self.amplitudes[count - 1] = self.largest;
        self.known = (self.known + 1).min(count);
        (self.sign, self.largest, self.cycles) = (error.signum(), error.abs(), 0);
        let (least_rad_s, most) = extent(self.amplitudes);
        let (earlier, later) = self.amplitudes.split_at(count / 2);
        let [earlier, later] = [earlier, later].map(|half| half.iter().sum::<f64>());
        let alike = SteadyOscillation {
            mean_rad_s: (earlier + later) / count as f64,
            least_rad_s,
            persists: later > 0.85 * earlier,
        };
        (self.known == count && most < 3.0 * least_rad_s).then_some(alike)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 0.01;

    fn watch(can_reduce_gain: bool) -> LoopWatch {
        LoopWatch::new(0.15, PERIOD_S, can_reduce_gain)
    }

    /// A sine around 100 rad/s; the amplitude may depend on the share of the gains.
    fn findings(
        can_reduce_gain: bool,
        period: f64,
        amplitude: impl Fn(f64) -> f64,
        cycles: u32,
    ) -> (Vec<Finding>, f64) {
        let mut watch = watch(can_reduce_gain);
        let found = (0..cycles).filter_map(|n| {
            let angle = std::f64::consts::TAU * f64::from(n) / period;
            watch.push(100.0, 100.0 + amplitude(watch.share()) * angle.sin(), false)
        });
        (found.collect(), watch.share())
    }

    #[test]
    fn an_oscillation_that_smaller_gains_end_leaves_them_small() {
        let (found, share) = findings(true, 5.0, |share| if share > 0.6 { 8.0 } else { 0.3 }, 400);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!((share - 0.49).abs() < 1e-12);
    }

    #[test]
    fn a_persistent_oscillation_restores_gains_and_a_large_one_ends() {
        let ends =
            |found: &[Finding]| found.iter().any(|one| matches!(one, Finding::Persists { .. }));
        for (amplitude, is_ended) in [(4.0, false), (8.0, true)] {
            let (found, share) = findings(true, 9.0, |_| amplitude, 800);
            assert!(matches!(found[8], Finding::RestoreGain { .. }), "{found:?}");
            assert!((share - 1.0).abs() < 1e-12);
            assert_eq!(ends(&found[9..]), is_ended, "{found:?}");
            // Reported within half a second where no gain can fall.
            let (found, _) = findings(false, 9.0, |_| amplitude, 45);
            assert_eq!((found.len(), ends(&found)), (1, is_ended), "{found:?}");
        }
    }

    #[test]
    fn an_irregular_oscillation_above_the_noise_is_reported_once() {
        let reported = |amplitude: f64| {
            let mut watch = watch(false);
            let (mut state, mut found) = (7_u32, Vec::new());
            watch.push(90.0, 90.0, false);
            for n in 0..600_u32 {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let size = amplitude * (0.2 + 0.8 * f64::from(state >> 16) / 65_536.0);
                let side = if n % 8 < 4 { size } else { -size };
                found.extend(watch.push(110.0, 110.3 + side, false));
            }
            found
        };
        let found = reported(1.6);
        assert!(matches!(found[..], [Finding::Oscillates { .. }]), "{found:?}");
        assert!(reported(0.5).is_empty());
    }

    #[test]
    fn an_oscillation_that_dies_away_ends_nothing() {
        let mut watch = watch(false);
        for n in 0..400 {
            let time = f64::from(n);
            let speed = 100.0 + 30.0 * (-time / 40.0).exp() * (time / 1.5).sin();
            let found = watch.push(100.0, speed, false);
            assert!(!matches!(found, Some(Finding::Persists { .. })), "{n} {found:?}");
        }
    }

    #[test]
    fn noise_slow_waves_and_a_moving_reference_are_no_oscillation() {
        for can_reduce_gain in [false, true] {
            assert!(findings(can_reduce_gain, 2.3, |_| 0.6, 400).0.is_empty());
            assert!(findings(can_reduce_gain, 60.0, |_| 20.0, 800).0.is_empty());
            let mut watch = watch(can_reduce_gain);
            for n in 0..400_u32 {
                let away = if n % 4 < 2 { 8.0 } else { -8.0 };
                let reference = 100.0 + 0.1 * f64::from(n);
                assert_eq!(watch.push(reference, reference + away, true), None);
            }
            for _ in 0..100 {
                assert_eq!(watch.push(100.0, f64::NAN, true), None);
            }
        }
    }

    #[test]
    fn a_limit_without_progress_is_found_within_a_second() {
        for can_reduce_gain in [false, true] {
            // The first finding of a shaft that is at a limit all the time.
            let first = |speed: &dyn Fn(f64) -> f64| {
                let mut watch = watch(can_reduce_gain);
                (0..1000_u32).find_map(|n| {
                    Some((n, watch.push(100.0, speed(PERIOD_S * f64::from(n)), true)?))
                })
            };
            // A minute to come up to speed; and there, where the limit is no fault.
            assert_eq!(first(&|t| (100.0 / 60.0) * t), None);
            assert_eq!(first(&|t| (50.0 * t).min(99.9)), None);
            let (cycle, found) = first(&|_| 60.0).unwrap();
            let is_found = cycle <= 101 && matches!(found, Finding::Saturated { .. });
            assert!(is_found, "{cycle} {found:?}");
            // From limit to limit, slower than any half-period that counts.
            let (cycle, found) = first(&|t| 100.0 + 60.0 * (4.0 * t).sin()).unwrap();
            assert!(cycle <= 150, "{cycle}");
            match found {
                Finding::ReduceGain { .. } => assert!(can_reduce_gain),
                Finding::Persists { .. } => assert!(!can_reduce_gain),
                other => panic!("{other:?}"),
            }
        }
    }
}
