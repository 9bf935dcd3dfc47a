//! A sequence of currents, for a drive whose clean command is a current: relay excitation, whose current reverses when the shaft
//! reaches a speed, so that a free motor cannot run away (Aastrom and Hagglund, *Automatica* 20, 1984, for the relay).
//!
//! ```text
//! rest -> forward until +turn -> (zero current) -> backward until -turn -> next level and speed -> ... -> brake -> rest
//! ```

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::bench_file::Refused;
use super::limits::{Limits, MotorSection, Nameplate, short};
use super::pilot::Pilot;
use super::trip::{Trip, TripKind};
use drivebench_model::sample::{Channel, Demand, Sample};

/// Shares of the current for acceleration, and of the highest speed at which it reverses.
const LEVELS: [f64; 4] = [0.2, 0.4, 0.7, 1.0];
pub(super) const TURNS: [f64; 3] = [0.15, 0.45, 0.8];
/// Periods between two reversals at the highest speed with the highest level: fewer do not show the acceleration.
const SWING_PERIODS: f64 = 48.0;
/// The friction may be larger than that of the nameplate.
const FRICTION_MARGIN: f64 = 1.1;
/// Shares of the rated current and of the rated speed with which an unknown motor is searched for.
const SEARCH_LEVELS: [f64; 5] = [0.03, 0.06, 0.12, 0.25, 0.5];
const SEARCH_TURNS: [f64; 2] = [0.1, 0.4];
/// Highest share of the speed limit at which the current may reverse: the shaft runs on for the delay of a cycle.
const MOST_OF_LIMIT: f64 = 0.8;
/// Share of the longest time of a reversal in which the shaft is braked at the end.
const BRAKE_SHARE: f64 = 0.25;
/// Longest sequence, s.
const LONGEST_S: f64 = 600.0;

/// `[currents]` of a bench file, in place of `[[sequence]]`.
#[derive(Clone, Debug, Deserialize, Serialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct CurrentsSection {
    /// Magnitudes, A. Each is combined with each speed.
    pub levels_a: Vec<f64>,
    /// Speeds at which the current reverses, rad/s.
    pub turn_rad_s: Vec<f64>,
    /// Zero current before the first reversal, from which the noise at rest follows, and at the end.
    #[serde(default = "default_rest_s")]
    pub rest_s: f64,
    /// Length without the rest.
    pub seconds: f64,
    /// Time after which the current reverses where the shaft does not reach the speed.
    #[serde(default = "default_longest_s")]
    pub longest_s: f64,
    /// Time at zero current before every other reversal; 0: none.
    #[serde(default)]
    pub coast_s: f64,
    /// Of the order of levels and speeds.
    #[serde(default)]
    pub seed: u64,
}

const fn default_rest_s() -> f64 {
    0.5
}

const fn default_longest_s() -> f64 {
    5.0
}

impl CurrentsSection {
    /// What shows the inertia and the friction of this motor.
    pub fn for_motor(motor: &Nameplate, limits: &Limits, period_s: f64) -> Self {
        let back_emf = motor.back_emf_v_s_per_rad;
        let friction_a = FRICTION_MARGIN * motor.load_torque_n_m / back_emf;
        let most_a = motor.rated_current_a.min(0.6 * limits.current_a);
        let top_rad_s = motor
            .rated_speed_rad_s
            .min(0.7 * limits.speed_rad_s)
            .min(0.8 * (limits.voltage_v - motor.resistance_ohm * most_a).max(0.0) / back_emf);
        // From the highest speed of one direction to that of the other.
        let crossing = 2.0 * TURNS[2] * top_rad_s / (SWING_PERIODS * period_s);
        let accelerating_a =
            (most_a - friction_a).max(0.3 * most_a).min(motor.inertia_kg_m2 * crossing / back_emf);
        let turn_rad_s = TURNS.map(|share| short(share * top_rad_s));
        let acceleration = |level: f64| level * accelerating_a * back_emf / motor.inertia_kg_m2;
        // Back and forth at every level and speed; friction makes one way longer and the other shorter.
        let pairs = LEVELS.iter().flat_map(|&level| turn_rad_s.map(|turn| (level, turn)));
        let pass_s: f64 = pairs.map(|(level, turn)| 4.0 * turn / acceleration(level)).sum();
        let longest_s = 4.0 * 2.0 * turn_rad_s[2] / acceleration(LEVELS[0]);
        let coast_s = 0.25 * pass_s / LEVELS.len() as f64;
        Self {
            levels_a: LEVELS.map(|level| short(friction_a + level * accelerating_a)).to_vec(),
            turn_rad_s: turn_rad_s.to_vec(),
            // The noise at rest follows from 20 rows; a minute of a slow line is too short.
            rest_s: (40.0 * period_s).max(0.5),
            seconds: (1.5 * pass_s).clamp(10.0, (1200.0 * period_s).max(60.0)).ceil(),
            longest_s: short(longest_s.clamp(20.0 * period_s, 10.0)),
            coast_s: short(coast_s.clamp(5.0 * period_s, 1.0)),
            seed: 1,
        }
    }

    /// Small currents that rise, for a motor of which only the rated values are known.
    pub fn search(motor: &MotorSection, limits: &Limits, period_s: f64) -> Self {
        let most_a = motor.rated_current_a.min(0.6 * limits.current_a);
        let most_rad_s = motor.rated_speed_rad_s.min(limits.speed_rad_s);
        let longest_s = (60.0 * period_s).max(1.0);
        let swings = 2.0 * (SEARCH_LEVELS.len() * SEARCH_TURNS.len()) as f64;
        Self {
            levels_a: SEARCH_LEVELS.map(|share| short(share * most_a)).to_vec(),
            turn_rad_s: SEARCH_TURNS.map(|share| short(share * most_rad_s)).to_vec(),
            rest_s: (40.0 * period_s).max(0.5),
            seconds: (swings * longest_s).ceil(),
            longest_s: short(longest_s),
            coast_s: 0.0,
            seed: 1,
        }
    }

    pub fn duration_s(&self) -> f64 {
        self.seconds + BRAKE_SHARE * self.longest_s + 2.0 * self.rest_s
    }

    pub(super) fn refused(&self, limits: &Limits) -> Option<Refused> {
        let turn_rad_s = MOST_OF_LIMIT * limits.speed_rad_s;
        let rows: [(_, &[f64], f64, _); 6] = [
            ("currents.levels_a", &self.levels_a, limits.current_a, "A, the current limit"),
            ("currents.turn_rad_s", &self.turn_rad_s, turn_rad_s, "rad/s, 0.8 speed limits"),
            ("currents.rest_s", &[self.rest_s], LONGEST_S, "s"),
            ("currents.seconds", &[self.seconds], LONGEST_S, "s"),
            ("currents.longest_s", &[self.longest_s], LONGEST_S, "s"),
            ("currents.coast_s", &[self.coast_s], LONGEST_S, "s"),
        ];
        rows.into_iter().find_map(|(key, values, most, what)| {
            let may_be_zero = key == "currents.coast_s";
            let is_allowed =
                |value: &f64| (0.0..=most).contains(value) && (may_be_zero || *value > 0.0);
            let none = values.is_empty().then_some(f64::NAN);
            let bad = none.or_else(|| values.iter().copied().find(|value| !is_allowed(value)))?;
            Some(Refused::new(key, bad, format!("above 0 and at most {most} {what}")))
        })
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Rest,
    /// The current drives this way until the speed of the pair is reached.
    Driven(f64),
    /// Zero current, then the drive in this direction.
    Coasting(f64),
    /// Against the speed, until it changes its sign.
    Braking(f64),
    AtEnd,
}

/// The current of each instant, by the measured speed.
#[derive(Clone, Debug)]
pub struct CurrentsPilot {
    section: CurrentsSection,
    run_seed: Option<u64>,
    /// Level and speed of each pair of reversals.
    pairs: Vec<(f64, f64)>,
    pair: usize,
    phase: Phase,
    since_s: f64,
    /// Longest time without a speed, s.
    silence_s: f64,
    speed_rad_s: f64,
    speed_at_s: f64,
}

impl CurrentsPilot {
    /// `run_seed`: of the order; without one the levels stay in their order.
    pub fn new(section: &CurrentsSection, run_seed: Option<u64>, silence_s: f64) -> Self {
        let levels = section.levels_a.iter();
        let mut pairs: Vec<(f64, f64)> = levels
            .flat_map(|level| section.turn_rad_s.iter().map(|turn| (*level, *turn)))
            .collect();
        if let Some(run_seed) = run_seed {
            let seed = section.seed.wrapping_add(run_seed.wrapping_mul(1000));
            pairs.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
        }
        Self {
            section: section.clone(),
            run_seed,
            pairs,
            pair: 0,
            phase: Phase::Rest,
            since_s: 0.0,
            silence_s,
            speed_rad_s: 0.0,
            speed_at_s: 0.0,
        }
    }

    /// The current at `elapsed_s` since the begin, A, for the latest speed. Instants must not fall.
    fn current_a(&mut self, elapsed_s: f64, speed_rad_s: f64) -> f64 {
        let (level_a, turn_rad_s) = self.pairs[self.pair % self.pairs.len()];
        let lasted_s = elapsed_s - self.since_s;
        let is_over = elapsed_s >= self.section.rest_s + self.section.seconds;
        let next = match self.phase {
            Phase::Rest => (elapsed_s >= self.section.rest_s).then_some(Phase::Driven(1.0)),
            Phase::Driven(_) | Phase::Coasting(_) if is_over => {
                Some(Phase::Braking(-speed_rad_s.signum()))
            }
            Phase::Driven(way) => {
                let arrived = way * speed_rad_s >= turn_rad_s;
                let coasts =
                    self.section.coast_s > 0.0 && self.pair.is_multiple_of(2) == (way > 0.0);
                let next = if coasts { Phase::Coasting(-way) } else { Phase::Driven(-way) };
                (arrived || lasted_s >= self.section.longest_s).then_some(next)
            }
            Phase::Coasting(way) => {
                (lasted_s >= self.section.coast_s).then_some(Phase::Driven(way))
            }
            Phase::Braking(way) => {
                let stands =
                    way * speed_rad_s >= 0.0 || lasted_s >= BRAKE_SHARE * self.section.longest_s;
                stands.then_some(Phase::AtEnd)
            }
            Phase::AtEnd => None,
        };
        if let Some(next) = next {
            // A pair is over with its drive backward, and the zero current that may follow.
            let begins = matches!(next, Phase::Driven(way) if way > 0.0);
            self.pair += usize::from(begins && self.phase != Phase::Rest);
            (self.phase, self.since_s) = (next, elapsed_s);
        }
        match self.phase {
            Phase::Driven(way) => way * self.pairs[self.pair % self.pairs.len()].0,
            Phase::Braking(way) => way * level_a,
            Phase::Rest | Phase::Coasting(_) | Phase::AtEnd => 0.0,
        }
    }
}

impl Pilot for CurrentsPilot {
    fn duration_s(&self) -> f64 {
        self.section.duration_s()
    }

    fn segment_at(&self, time_s: f64) -> usize {
        usize::from(time_s >= self.section.rest_s)
    }

    fn segment_name(&self, index: usize) -> &str {
        if index == 0 { "rest" } else { "currents" }
    }

    fn zero(&self) -> Demand {
        Demand::Current(0.0)
    }

    fn begin(&mut self, now_s: f64, sample: Option<&Sample>) {
        *self = Self::new(&self.section, self.run_seed, self.silence_s);
        self.speed_rad_s = sample.and_then(|sample| sample.get(Channel::Speed)).unwrap_or(0.0);
        self.speed_at_s = now_s;
    }

    fn demand(&mut self, now_s: f64, elapsed_s: f64) -> Result<Demand, Trip> {
        let times_s = (now_s - self.speed_at_s, self.silence_s);
        if times_s.0 > times_s.1 {
            return Err(Trip::after(TripKind::SignalMissing, now_s, times_s, "no speed"));
        }
        Ok(Demand::Current(self.current_a(elapsed_s, self.speed_rad_s)))
    }

    fn sample(&mut self, now_s: f64, _elapsed_s: f64, sample: &Sample, _encoder_proven: bool) {
        if let Some(speed_rad_s) = sample.get(Channel::Speed) {
            (self.speed_rad_s, self.speed_at_s) = (speed_rad_s, now_s);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn section() -> CurrentsSection {
        CurrentsSection {
            levels_a: vec![2.0, 4.0],
            turn_rad_s: vec![50.0, 100.0],
            rest_s: 0.5,
            seconds: 20.0,
            longest_s: 5.0,
            coast_s: 0.2,
            seed: 1,
        }
    }

    fn pilot(seed: u64) -> CurrentsPilot {
        CurrentsPilot::new(&section(), Some(seed), 0.1)
    }

    /// Instant, current and speed of a shaft with friction under these currents.
    fn run(mut currents: CurrentsPilot, inertia_kg_m2: f64) -> Vec<[f64; 3]> {
        let (period_s, mut speed_rad_s) = (0.01, 0.0_f64);
        let rows = (0..2400).map(|row| {
            let time_s = period_s * f64::from(row);
            let amperes = currents.current_a(time_s, speed_rad_s);
            let before = speed_rad_s;
            let driving = 0.35 * amperes;
            let friction = 0.3_f64.min(driving.abs()).copysign(driving);
            let against = if before == 0.0 { friction } else { 0.3_f64.copysign(before) };
            speed_rad_s += (driving - against) / inertia_kg_m2 * period_s;
            if before * speed_rad_s < 0.0 && driving.abs() < 0.3 {
                speed_rad_s = 0.0;
            }
            [time_s, amperes, before]
        });
        rows.collect()
    }

    #[test]
    fn the_current_reverses_at_the_speeds_and_ends_at_rest() {
        let rows = run(pilot(1), 0.004);
        let beyond = rows.iter().map(|row| row[2].abs()).fold(0.0, f64::max);
        // One period of the highest acceleration beyond the highest speed.
        assert!((100.0..105.0).contains(&beyond), "{beyond}");
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        for (level, turn) in [(2.0, 50.0), (2.0, 100.0), (4.0, 50.0), (4.0, 100.0)] {
            for way in [1.0, -1.0] {
                let arrives = |pair: &[[f64; 3]]| {
                    near(pair[0][1], way * level)
                        && !near(pair[1][1], pair[0][1])
                        && (turn..turn + 5.0).contains(&(way * pair[1][2]))
                };
                assert!(rows.windows(2).any(arrives), "{level} A, {turn} rad/s, {way}");
            }
        }
        assert!(rows.iter().take(50).all(|row| row[1] == 0.0));
        let [_, amperes, speed] = rows[rows.len() - 1];
        assert!(amperes == 0.0 && speed.abs() < 10.0, "{amperes} A, {speed} rad/s");
        // Another seed is another order.
        let currents = |seed| run(pilot(seed), 0.004);
        assert!(currents(1) == rows && currents(2) != rows);
    }

    #[test]
    fn a_shaft_that_is_held_sees_both_signs() {
        let rows = run(pilot(1), 1e9);
        let signs = [1.0, -1.0].map(|way| rows.iter().filter(|row| row[1] * way > 0.0).count());
        assert!(signs.iter().all(|count| *count > 400), "{signs:?}");
    }

    #[test]
    fn values_beyond_the_limits_are_refused() {
        let limits = Limits::zk_22fc();
        assert_eq!(section().refused(&limits), None);
        let refused = |section: CurrentsSection| section.refused(&limits).unwrap().key;
        assert_eq!(refused(CurrentsSection { levels_a: vec![], ..section() }), "currents.levels_a");
        let fast = vec![10.0, 0.9 * limits.speed_rad_s];
        assert_eq!(
            refused(CurrentsSection { turn_rad_s: fast, ..section() }),
            "currents.turn_rad_s"
        );
        for seconds in [0.0, -1.0, f64::NAN, 1e9] {
            assert_eq!(refused(CurrentsSection { seconds, ..section() }), "currents.seconds");
        }
    }
}
