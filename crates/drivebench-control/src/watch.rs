//! Watch of a closed loop, whatever its controller: whether it swings by itself, or stands at a limit and gets nowhere.
//!
//! Play and elasticity between motor and load, or a delay that the model does not have, can turn gains that are right on
//! paper into a steady swing. It is recognised, around a reference that stands still, by its half-swings, which are alike
//! and quick; where they are slow, or play makes them irregular, by their size since the reference was reached; or by a
//! second that is spent at a limit while the error does not fall. The gains are then lowered by steps, where the controller can. A swing that goes on
//! all the same is not the loop's own, and they are given back. What swings by much and cannot be made softer, or does not
//! get to its reference at the limit, is to be ended.

use std::collections::VecDeque;

use drivebench_model::numerics::count::whole;

/// Half-swings that make a swing.
const HALVES: usize = 6;
/// Longest half-swing, cycles: the loop's own swing is a few dead times long.
const LONGEST: u32 = 16;
/// Largest half-swing over the least.
const ALIKE: f64 = 3.0;
/// A swing against which something is done is at least so many times the noise, and this share of the reference.
const NOISES: f64 = 10.0;
const REFERENCE_SHARE: f64 = 0.02;
/// One that is told of, in the noise and in the last step of the reference; one that is as large all the time, by the
/// amplitude of the sine of its root mean square. What noise does to a loop comes near the first, not near the second.
const TOLD_NOISES: f64 = 8.0;
const TOLD_STEADY_NOISES: f64 = 5.0;
const TOLD_STEP_SHARE: f64 = 0.02;
/// Of the watched time, after the reference was reached, for which it is looked at.
const LOOKED_AT: f64 = 0.75;
/// Times that it goes from one side to the other within half of the watched time, beyond this share of its size on either.
const TURNS: usize = 3;
const BEYOND: f64 = 0.4;
/// It is told of again when it has grown by this factor.
const NEWS_FACTOR: f64 = 1.5;
/// One that ends a loop which cannot be made softer: share of the largest reference so far.
const END_SHARE: f64 = 0.05;
/// What each step leaves of the gains, and how many steps are tried: a coupling of 21 Hz that is damped by 2 % goes on
/// swinging with a tenth of them.
const STEP: f64 = 0.7;
const STEPS: i32 = 8;
/// A swing that is left at this share of the first after all steps is not the loop's own.
const NOT_OWN: f64 = 0.7;
/// Half-swings of which the later ones are left at this share of the earlier ones last, others die away; the same of the
/// halves of the time for which an irregular swing is looked at.
const LASTS: f64 = 0.85;
const GOES_ON: f64 = 0.6;
/// The time over which limits are watched, s, and its fewest cycles.
const WATCHED_S: f64 = 1.0;
const FEWEST_CYCLES: usize = 20;
/// Share of its cycles that count as most, and the share by which an error at least falls from its first quarter to its
/// last: a shaft that takes a minute to come up to speed does.
const MOST: f64 = 0.8;
const FALLS: f64 = 0.01;

/// What was found in a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Finding {
    /// The loop swings: its gains are to fall to this share of what the tuning says.
    Soften { swing_rad_s: f64, share: f64 },
    /// Softer gains did not help, so the swing is not the loop's: back to what the tuning says.
    GiveBack { swing_rad_s: f64 },
    /// It swings, by too little to do anything against it, or with gains that are as soft as they get.
    Swings { swing_rad_s: f64 },
    /// It goes on swinging by more than is let at a motor, and the gains cannot fall (any more).
    SwingsOn { swing_rad_s: f64, most_rad_s: f64 },
    /// Most of the last second was spent at a limit, and the error does not fall.
    Saturated { limited_share: f64, error_rad_s: f64 },
}

/// The watch of one loop.
#[derive(Clone, Debug)]
pub struct LoopWatch {
    noise_rad_s: f64,
    /// The controller's gains can fall.
    softens: bool,
    reference_rad_s: f64,
    /// Of the reference, so far: its last step, and its largest size.
    last_step_rad_s: f64,
    largest_rad_s: f64,
    halves: HalfSwings,
    /// Errors of the last second with this reference, and whether a limit held the output.
    second: VecDeque<(f64, bool)>,
    /// Sign of the first of them, and the cycles since it changed: since the reference was reached.
    first_side: f64,
    arrived: usize,
    cycles: usize,
    /// Cycles until it is looked through again.
    until_look: usize,
    steps: i32,
    first_rad_s: f64,
    gave_back: bool,
    told_rad_s: f64,
}

impl LoopWatch {
    /// `noise_rad_s`: standard deviation of a speed sample. `softens`: the gains of the controller can fall.
    pub fn new(noise_rad_s: f64, period_s: f64, softens: bool) -> Self {
        let cycles = whole((WATCHED_S / period_s).round());
        Self {
            noise_rad_s,
            softens,
            reference_rad_s: f64::NAN,
            last_step_rad_s: 0.0,
            largest_rad_s: 0.0,
            halves: HalfSwings::default(),
            second: VecDeque::new(),
            first_side: 0.0,
            arrived: 0,
            cycles: cycles.max(FEWEST_CYCLES),
            until_look: 0,
            steps: 0,
            first_rad_s: 0.0,
            gave_back: false,
            told_rad_s: 0.0,
        }
    }

    /// What is left of the gains.
    pub fn share(&self) -> f64 {
        if self.gave_back { 1.0 } else { STEP.powi(self.steps) }
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
            self.halves.forget();
            self.second.clear();
            (self.first_side, self.arrived) = (0.0, 0);
            return None;
        }
        if self.first_side == 0.0 {
            self.first_side = error.signum();
        }
        let arrives = error * self.first_side < 0.0;
        self.arrived += usize::from(arrives || self.arrived > 0);
        let swings = self.halves.push(error);
        self.second.push_back((error, limited));
        if self.second.len() > self.cycles {
            self.second.pop_front();
        }
        // One that dies away is that of the machine behind a step, not the loop's.
        let counts = |swing: &Alike| swing.least_rad_s > self.floor_rad_s() && swing.lasts;
        if let Some(swing) = swings.filter(counts) {
            return self.found(swing.mean_rad_s);
        }
        self.saturated().or_else(|| self.irregular())
    }

    /// A swing against which something is to be done.
    fn found(&mut self, swing_rad_s: f64) -> Option<Finding> {
        self.halves.forget();
        self.second.clear();
        self.act(swing_rad_s)
    }

    /// A step of the gains is left.
    const fn can_soften(&self) -> bool {
        self.softens && !self.gave_back && self.steps < STEPS
    }

    /// The least half-swing against which something is done, rad/s.
    fn floor_rad_s(&self) -> f64 {
        (NOISES * self.noise_rad_s).max(REFERENCE_SHARE * self.reference_rad_s.abs())
    }

    fn tell(&mut self, swing_rad_s: f64) -> Option<Finding> {
        let is_new = swing_rad_s > NEWS_FACTOR * self.told_rad_s;
        is_new.then(|| {
            self.told_rad_s = swing_rad_s;
            Finding::Swings { swing_rad_s }
        })
    }

    /// What is done against a swing.
    fn act(&mut self, swing_rad_s: f64) -> Option<Finding> {
        if self.can_soften() {
            if self.steps == 0 {
                self.first_rad_s = swing_rad_s;
            }
            self.steps += 1;
            let share = self.share();
            return Some(Finding::Soften { swing_rad_s, share });
        }
        if self.softens && !self.gave_back && swing_rad_s > NOT_OWN * self.first_rad_s {
            self.gave_back = true;
            self.told_rad_s = swing_rad_s;
            return Some(Finding::GiveBack { swing_rad_s });
        }
        let most_rad_s = (NOISES * self.noise_rad_s).max(END_SHARE * self.largest_rad_s);
        if swing_rad_s > most_rad_s {
            return Some(Finding::SwingsOn { swing_rad_s, most_rad_s });
        }
        self.tell(swing_rad_s)
    }

    /// What swings without half-swings that are alike, or slowly, looked for sixteen times in a second: by its size in the last
    /// half of what is looked at, where it is not dying away.
    fn irregular(&mut self) -> Option<Finding> {
        self.until_look = self.until_look.saturating_sub(1);
        let looked_at = whole(LOOKED_AT * self.cycles as f64);
        let known = self.second.len().min(self.arrived);
        if known < looked_at || self.until_look > 0 {
            return None;
        }
        self.until_look = self.cycles / 16;
        let errors = || {
            let all = self.second.iter().map(|cycle| cycle.0);
            all.skip(self.second.len() - looked_at)
        };
        let last = || errors().skip(looked_at / 2);
        let (low, high) = ends(last());
        let swing_rad_s = 0.5 * (high - low);
        let before = ends(errors().take(looked_at / 2));
        let is_large = |swing_rad_s: f64, noises: f64| {
            let told = (noises * self.noise_rad_s).max(TOLD_STEP_SHARE * self.last_step_rad_s);
            swing_rad_s >= told
        };
        let told = is_large(swing_rad_s, TOLD_NOISES)
            || is_large(sine_amplitude(last()), TOLD_STEADY_NOISES);
        if !told || swing_rad_s < GOES_ON * 0.5 * (before.1 - before.0) {
            return None;
        }
        let (low, high) = (low.min(before.0), high.max(before.1));
        let (size, middle) = (0.5 * (high - low), 0.5 * (high + low));
        let beyond = |(_, error): &(usize, f64)| (error - middle).abs() > BEYOND * size;
        let mut sides: Vec<(usize, bool)> = (errors().enumerate().filter(beyond))
            .map(|(cycle, error)| (cycle, error > middle))
            .collect();
        sides.dedup_by_key(|one| one.1);
        // The first side was not turned to.
        let turns = sides.get(1..).unwrap_or_default();
        let quick = |some: &[(usize, bool)]| some[TURNS - 1].0 - some[0].0 < self.cycles / 2;
        if !turns.windows(TURNS).any(quick) {
            return None;
        }
        if swing_rad_s > self.floor_rad_s() {
            self.found(swing_rad_s)
        } else {
            self.tell(swing_rad_s)
        }
    }

    /// Most of the last second at a limit, and nothing comes of it.
    fn saturated(&mut self) -> Option<Finding> {
        if self.second.len() < self.cycles {
            return None;
        }
        let all = || self.second.iter();
        let limited = all().filter(|cycle| cycle.1).count();
        let limited_share = limited as f64 / self.cycles as f64;
        if limited_share < MOST {
            return None;
        }
        let quarter = self.cycles / 4;
        let mean = |errors: &mut dyn Iterator<Item = &(f64, bool)>| {
            errors.take(quarter).map(|cycle| cycle.0.abs()).sum::<f64>() / quarter as f64
        };
        let (first, last) = (mean(&mut all()), mean(&mut all().rev()));
        if last < self.floor_rad_s() || last < (1.0 - FALLS) * first {
            return None;
        }
        let crosses = all().zip(all().skip(1)).any(|(one, next)| one.0 * next.0 < 0.0);
        if crosses {
            return self.found(last);
        }
        self.second.clear();
        Some(Finding::Saturated { limited_share, error_rad_s: last })
    }
}

/// Least and largest.
fn ends(errors: impl Iterator<Item = f64>) -> (f64, f64) {
    errors.fold((f64::MAX, f64::MIN), |(low, high), error| (low.min(error), high.max(error)))
}

/// Amplitude of the sine that has the root mean square of these errors about their mean.
fn sine_amplitude(errors: impl Iterator<Item = f64>) -> f64 {
    let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for error in errors {
        count += 1.0;
        sum += error;
        squares += error * error;
    }
    (2.0 * (squares / count - (sum / count).powi(2)).max(0.0)).sqrt()
}

/// Half-swings that are alike: their mean, the least of them, and whether the last ones are about as large as the first.
#[derive(Clone, Copy, Debug)]
struct Alike {
    mean_rad_s: f64,
    least_rad_s: f64,
    lasts: bool,
}

/// Half-swings that follow each other.
#[derive(Clone, Debug, Default)]
struct HalfSwings {
    /// Largest errors of the last ones, oldest first.
    halves: [f64; HALVES],
    known: usize,
    /// The one that is under way: its sign, largest error and cycles.
    sign: f64,
    largest: f64,
    cycles: u32,
}

impl HalfSwings {
    fn forget(&mut self) {
        (self.known, self.cycles, self.sign, self.largest) = (0, 0, 0.0, 0.0);
    }

    /// One error. At the end of a half-swing what it and those before it are, where they are alike.
    fn push(&mut self, error: f64) -> Option<Alike> {
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
        let least_rad_s = self.halves.iter().copied().fold(f64::MAX, f64::min);
        let most = self.halves.iter().copied().fold(0.0, f64::max);
        let (earlier, later) = self.halves.split_at(HALVES / 2);
        let [earlier, later] = [earlier, later].map(|halves| halves.iter().sum::<f64>());
        let alike = Alike {
            mean_rad_s: (earlier + later) / HALVES as f64,
            least_rad_s,
            lasts: later > LASTS * earlier,
        };
        (self.known == HALVES && most < ALIKE * least_rad_s).then_some(alike)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 0.01;

    /// A sine around 100 rad/s; the amplitude may depend on the share of the gains.
    fn findings(
        softens: bool,
        period: f64,
        amplitude: impl Fn(f64) -> f64,
        cycles: u32,
    ) -> (Vec<Finding>, f64) {
        let mut watch = LoopWatch::new(0.15, PERIOD_S, softens);
        let found = (0..cycles).filter_map(|n| {
            let angle = std::f64::consts::TAU * f64::from(n) / period;
            let speed = 100.0 + amplitude(watch.share()) * angle.sin();
            watch.push(100.0, speed, false)
        });
        (found.collect(), watch.share())
    }

    #[test]
    fn a_swing_that_ends_with_softer_gains_leaves_them_soft() {
        let (found, share) = findings(true, 5.0, |share| if share > 0.6 { 8.0 } else { 0.3 }, 400);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!((share - 0.49).abs() < 1e-12);
    }

    #[test]
    fn a_swing_that_goes_on_is_not_the_loops_own_and_a_large_one_ends_it() {
        let ended = |found: &[Finding]| {
            let ends = |finding: &&Finding| matches!(finding, Finding::SwingsOn { .. });
            found.iter().filter(ends).count()
        };
        for (amplitude, ends) in [(4.0, false), (8.0, true)] {
            let (found, share) = findings(true, 9.0, |_| amplitude, 800);
            assert!(matches!(found[8], Finding::GiveBack { .. }), "{found:?}");
            assert!((share - 1.0).abs() < 1e-12);
            assert_eq!(ended(&found[9..]) > 0, ends, "{found:?}");
            // Told of within half a second where nothing can be softened, and the end where it is large.
            let (found, _) = findings(false, 9.0, |_| amplitude, 45);
            assert_eq!(found.len(), 1, "{found:?}");
            assert_eq!(ended(&found) > 0, ends, "{found:?}");
        }
    }

    #[test]
    fn a_small_or_irregular_swing_is_told_of_once_and_what_cannot_be_told_from_noise_is_not() {
        let told = |amplitude: f64| {
            let mut watch = LoopWatch::new(0.15, PERIOD_S, false);
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
        let found = told(1.6);
        assert!(matches!(found[..], [Finding::Swings { .. }]), "{found:?}");
        assert!(told(0.5).is_empty());
    }

    #[test]
    fn a_swing_that_dies_away_ends_nothing() {
        let mut watch = LoopWatch::new(0.15, PERIOD_S, false);
        for n in 0..400 {
            let time = f64::from(n);
            let speed = 100.0 + 30.0 * (-time / 40.0).exp() * (time / 1.5).sin();
            let found = watch.push(100.0, speed, false);
            assert!(!matches!(found, Some(Finding::SwingsOn { .. })), "{n} {found:?}");
        }
    }

    #[test]
    fn noise_slow_waves_and_a_reference_that_moves_are_none() {
        for softens in [false, true] {
            assert!(findings(softens, 2.3, |_| 0.6, 400).0.is_empty());
            assert!(findings(softens, 60.0, |_| 20.0, 800).0.is_empty());
            let mut watch = LoopWatch::new(0.15, PERIOD_S, softens);
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

    /// The first finding of a shaft that is at a limit all the time.
    fn at_the_limit(softens: bool, speed: impl Fn(f64) -> f64) -> Option<(u32, Finding)> {
        let mut watch = LoopWatch::new(0.15, PERIOD_S, softens);
        let cycle = |n: u32| Some((n, watch.push(100.0, speed(PERIOD_S * f64::from(n)), true)?));
        (0..1000).find_map(cycle)
    }

    #[test]
    fn a_limit_that_gets_nowhere_is_noticed_within_a_second_and_a_slow_run_up_is_none() {
        for softens in [false, true] {
            // A minute to come up; then it is there, and the limit is no fault.
            assert_eq!(at_the_limit(softens, |t| (100.0 / 60.0) * t), None);
            assert_eq!(at_the_limit(softens, |t| (50.0 * t).min(99.9)), None);
            let (cycle, found) = at_the_limit(softens, |_| 60.0).unwrap();
            assert!(cycle <= 101, "{cycle}");
            assert!(matches!(found, Finding::Saturated { .. }), "{found:?}");
            // From limit to limit, slower than any half-swing that would count.
            let swing = |t: f64| 100.0 + 60.0 * (4.0 * t).sin();
            let (cycle, found) = at_the_limit(softens, swing).unwrap();
            assert!(cycle <= 150, "{cycle}");
            match found {
                Finding::Soften { .. } => assert!(softens),
                Finding::SwingsOn { .. } => assert!(!softens),
                other => panic!("{other:?}"),
            }
        }
    }
}
