//! An extended Kalman filter follows a run with a model: innovations that are white where the model is right (Kailath, An
//! innovations approach to least-squares estimation, IEEE Trans. Automatic Control 13, 1968).
//!
//! States are the deviations of current and speed from the model, and a disturbance torque, a first-order Gauss-Markov process:
//! integrated by the shaft, it makes the error of a free run drift, so that tests on that error would be wrong. The innovations,
//! over their standard deviations, are independent under the model whatever the disturbance did.

use super::acting::{FORM_SHARE, Forms};
use drivebench_identify::stamps::spread;
use drivebench_model::numerics::propagator::{LinearPart, Propagator};
use drivebench_model::numerics::statistics::{largest, median};
use drivebench_model::plant::{
    Correction, Input, Model, MotorKey, Plant, Scenario, State, Trajectory,
};

/// What is random in a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Noise {
    /// Standard deviations of the sensors.
    pub current_a: f64,
    pub speed_rad_s: f64,
    /// Standard deviation and correlation time of the disturbance torque.
    pub disturbance_n_m: f64,
    pub correlation_s: f64,
    /// Standard deviation of the error of what drives the run: a slow one of a voltage, V; of a measured torque, N.m (or
    /// what a measured current makes of it), another one from sample to sample.
    pub input: f64,
    /// By how much the sensors may differ from this, as a standard deviation of the logarithm.
    pub sensors: f64,
}

/// Correlation time of the voltage's error, s.
const VOLTAGE_S: f64 = 0.05;
/// Periods without a torque, or without a speed, after which nobody knows what was held and where the shaft went.
const LONGEST_HOLD_PERIODS: f64 = 5.0;
/// Share of the largest speed below which friction is not yet developed where a torque drives: the balance of torques says
/// nothing of a reversal.
const REVERSAL_SHARE: f64 = 0.015;
/// Uncertainty of the speed after a break-away or a change of sign, as a share of the largest speed.
const JUMP_SHARE: f64 = 0.0017;
/// What is not known of the first current, as a share of the largest, and of the first speed, in units of its noise.
const START_SHARE: f64 = 0.1;
const START_SIGMAS: f64 = 10.0;
/// Standard deviations by which a shaft that is taken to rest must be measured to move to be released.
const RELEASED_SIGMAS: f64 = 5.0;

/// Time over which the error of a coupling's form is alike, s: about a period of its ringing.
const RINGING_S: f64 = 0.01;

/// The linear part that deviations follow.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dynamics {
    moving: LinearPart,
    stuck: LinearPart,
    pub inverse_inertia: f64,
    pub inverse_inductance: f64,
    /// What one unit of the input's error makes of current and speed in a second.
    pub per_input: [f64; 2],
    /// Correlation time of that error, s; zero where it is another one from sample to sample.
    input_s: f64,
}

impl Dynamics {
    pub(super) fn of(model: &Model, input: Input) -> Option<Self> {
        let value = |key| model.motor.get(key);
        let inertia = value(MotorKey::Inertia)?;
        let mut dynamics = Self {
            moving: LinearPart::new(&[[0.0; 2]; 2]),
            stuck: LinearPart::new(&[[0.0; 2]; 2]),
            inverse_inertia: 1.0 / inertia,
            inverse_inductance: 0.0,
            per_input: [0.0, 1.0 / inertia],
            input_s: 0.0,
        };
        if input == Input::Voltage {
            let (r, l) = (value(MotorKey::Resistance)?, value(MotorKey::Inductance)?);
            let (ke, kt) = (value(MotorKey::BackEmf)?, model.motor.torque_constant()?);
            dynamics.moving = LinearPart::new(&[[-r / l, -ke / l], [kt / inertia, 0.0]]);
            dynamics.stuck = LinearPart::new(&[[-r / l, 0.0], [0.0, 0.0]]);
            dynamics.inverse_inductance = 1.0 / l;
            dynamics.per_input = [1.0 / l, 0.0];
            dynamics.input_s = VOLTAGE_S;
        }
        Some(dynamics)
    }

    /// What the input's error keeps over an interval.
    fn input_keeps(&self, interval_s: f64) -> f64 {
        if self.input_s > 0.0 {
            (-interval_s / self.input_s).exp()
        } else {
            0.0
        }
    }

    /// The same for the mean over an interval of so many samples, and the share of the variance that the mean has.
    pub(super) fn mean_input(&self, interval_s: f64, samples: f64) -> (f64, f64) {
        let is_slow = self.input_s > 0.0;
        let share = if is_slow { 1.0 } else { 1.0 / samples };
        (self.input_keeps(interval_s), share)
    }

    /// How deviations go on over an interval.
    pub(super) fn over(&self, interval_s: f64, rests: bool) -> Propagator {
        let part = if rests { &self.stuck } else { &self.moving };
        part.over(interval_s)
    }
}

/// One interval between two samples as deviations pass it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Passage {
    pub propagator: Propagator,
    pub interval_s: f64,
    /// Direction of motion in the interval; zero at rest.
    pub direction: f64,
    /// What the speed's deviation is multiplied by: zero where the shaft comes to rest or was at rest.
    pub kept: f64,
    /// Variances of voltage, torque and quick torque by which the forms of the model's effects may be wrong.
    pub form: [f64; 3],
    /// What the input's error keeps, and the share of its variance that it has.
    pub input_keeps: f64,
    pub input_share: f64,
    /// Variances of current and speed that an unknown voltage or a reversal adds, and whether the model was taken over from the
    /// measurement behind a hole in the record.
    pub fresh: [f64; 2],
    pub begins_again: bool,
    /// The part of `fresh` that holes of the record make: a voltage that nobody knows, a state that was measured behind it.
    pub unobserved: [f64; 2],
    /// Covariance of the part of `fresh` that one voltage makes of both.
    pub together: f64,
}

/// What a sample corrects, one scalar after the other: current, then speed.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Update {
    /// Gains on the four states, and one over the standard deviation of the innovation; zero where not measured.
    pub current: [f64; 5],
    pub speed: [f64; 5],
}

impl Update {
    /// Correction of the four states by what was measured, and the whitened innovations; zero where not measured.
    fn correct(&self, measured: [Option<f64>; 2], reading: [f64; 2]) -> ([f64; 4], [f64; 2]) {
        let (mut change, mut white) = ([0.0; 4], [0.0; 2]);
        for (signal, gains) in [self.current, self.speed].iter().enumerate() {
            let Some(value) = measured[signal] else {
                continue;
            };
            let e = value - reading[signal] - change[signal] * signal as f64;
            for (change, gain) in change.iter_mut().zip(gains) {
                *change += gain * e;
            }
            white[signal] = e * gains[4];
        }
        (change, white)
    }
}

/// How one run is followed: the same for a model and for all that are near it.
#[derive(Clone, Debug)]
pub(super) struct Follower {
    pub updates: Vec<Update>,
    /// What the disturbance keeps until the next sample.
    pub forgets: Vec<f64>,
    /// `passages[k]` leads to sample `k`.
    pub passages: Vec<Passage>,
    /// Innovations of both signals.
    pub rows: usize,
    /// By how much the model's machine gets its commands later, s.
    pub late_s: f64,
    /// Sub-steps of simulation that one pass costs.
    pub work: u64,
}

/// A followed run.
#[derive(Clone, Debug)]
pub(super) struct Followed {
    /// Before and after each correction: current, speed.
    pub before: Vec<[f64; 2]>,
    pub after: Vec<[f64; 2]>,
    /// Rates of current, A/s, and speed, rad/s2, as each sample is taken.
    pub rates: Vec<[f64; 2]>,
    pub load_n_m: Vec<f64>,
    pub direction: Vec<f64>,
    /// Innovations over their standard deviations; zero where not measured.
    pub white: Vec<[f64; 2]>,
    /// Variances that the samples have because nobody knows when exactly they were taken.
    pub vague: Vec<[f64; 2]>,
}

pub(super) type P = [[f64; 4]; 4];

fn measured(scenario: &Scenario, noise: &Noise, sample: usize) -> [Option<f64>; 2] {
    let value = |values: &[f64], level: f64| {
        Some(values[sample]).filter(|value| value.is_finite() && level.is_finite())
    };
    let current = if scenario.input == Input::Voltage {
        value(&scenario.current_a, noise.current_a)
    } else {
        None
    };
    [current, value(&scenario.speed_rad_s, noise.speed_rad_s)]
}

/// Variance of the speed that a break-away or a change of sign adds.
pub(super) fn jump_of(scenario: &Scenario) -> f64 {
    (JUMP_SHARE * fastest(scenario)).powi(2)
}

fn fastest(scenario: &Scenario) -> f64 {
    largest(scenario.speed_rad_s.iter().copied())
}

/// What the filter knows between two samples.
struct Filter<'a> {
    scenario: &'a Scenario,
    noise: &'a Noise,
    dynamics: Dynamics,
    forms: Forms,
    p: P,
    load_n_m: f64,
    input: f64,
    /// Variance of the speed that a break-away or a change of sign adds.
    jump: f64,
    /// Where a torque drives: the speed below which its balance says nothing, and for how long one value may stand.
    slow_rad_s: f64,
    longest_hold_s: f64,
    /// When a speed was measured last, and after how long without one it begins anew.
    observed_s: f64,
    longest_blind_s: f64,
    direction: f64,
    last_s: f64,
    last_speed: f64,
    /// Number of the command that holds.
    event: usize,
    /// By how much the times of commands are not known, and by how much the model's machine gets them later, s.
    edge_s: f64,
    late_s: f64,
    /// Ends of the holes behind which the model begins again; the first `holes_passed` lie behind.
    hole_ends_s: Vec<f64>,
    holes_passed: usize,
    /// Square of what rings, as it dies away, and when a coupling's twist became unknown last.
    ringing: f64,
    /// The largest so far: so much there may be behind a hole.
    most_ringing: f64,
    twisted_s: f64,
    /// Propagators over the last interval, moving and at rest.
    cached: (f64, [Propagator; 2]),
}

impl<'a> Filter<'a> {
    fn new(model: &Model, scenario: &'a Scenario, start: State, noise: &'a Noise) -> Option<Self> {
        let dynamics = Dynamics::of(model, scenario.input)?;
        let mut p: P = [[0.0; 4]; 4];
        p[2][2] = noise.disturbance_n_m.powi(2);
        p[3][3] = noise.input.powi(2);
        // What flowed before the first row is not known, as where an offset of the voltage held it; nor how fast a
        // shaft turned that did not rest.
        let most_a = largest(scenario.current_a.iter().copied());
        p[0][0] = (START_SHARE * most_a).powi(2);
        if start.speed_rad_s != 0.0 && noise.speed_rad_s.is_finite() {
            p[1][1] = (START_SIGMAS * noise.speed_rad_s).powi(2);
        }
        let holes = scenario.unknown_input.iter();
        let restarted = holes.filter(|hole| hole.restart.is_some());
        let restarted = restarted.map(|hole| hole.to_s);
        let by_voltage = scenario.input == Input::Voltage;
        let events = scenario.events.windows(2);
        let held_s: Vec<f64> = events.map(|pair| pair[1].0 - pair[0].0).collect();
        let observed = scenario.sample_time_s.iter().zip(&scenario.speed_rad_s);
        let observed = observed.filter(|row| row.1.is_finite()).map(|row| *row.0);
        let observed: Vec<f64> = observed.collect();
        let gaps_s: Vec<f64> = observed.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let usual = if by_voltage {
            f64::INFINITY
        } else {
            LONGEST_HOLD_PERIODS
        };
        let slow_rad_s = REVERSAL_SHARE * fastest(scenario);
        let forms = Forms::of(model, scenario);
        let late_s = forms.terms.iter().map(|terms| terms.path().command_delay_s);
        Some(Self {
            scenario,
            noise,
            dynamics,
            late_s: late_s.sum(),
            forms,
            p,
            load_n_m: 0.0,
            input: 0.0,
            jump: jump_of(scenario),
            slow_rad_s: if by_voltage { 0.0 } else { slow_rad_s },
            longest_hold_s: usual * median(&held_s),
            observed_s: scenario.begin_s(),
            longest_blind_s: usual * median(&gaps_s),
            direction: start.direction(),
            last_s: scenario.begin_s(),
            last_speed: start.speed_rad_s,
            event: 0,
            edge_s: scenario.input_delay_s().map_or(0.0, |delay| delay.1),
            hole_ends_s: restarted.collect(),
            holes_passed: 0,
            ringing: 0.0,
            most_ringing: 0.0,
            twisted_s: f64::NEG_INFINITY,
            cached: (-1.0, [dynamics.over(0.0, false), dynamics.over(0.0, true)]),
        })
    }

    /// Propagator over `interval_s`, kept for the next interval of the same length.
    fn propagator(&mut self, interval_s: f64, rests: bool) -> Propagator {
        if (interval_s - self.cached.0).abs() > 1e-6 * interval_s {
            let over = |rests| self.dynamics.over(interval_s, rests);
            self.cached = (interval_s, [over(false), over(true)]);
        }
        self.cached.1[usize::from(rests)]
    }

    /// Variance of the voltage that the commands applied until `time_s` add: nobody knows when exactly within its
    /// exchange a command was applied.
    fn edges_v2(&mut self, time_s: f64, interval_s: f64) -> f64 {
        let events = &self.scenario.events;
        let share = (self.edge_s / interval_s).min(1.0);
        let mut variance = 0.0;
        while self.event + 1 < events.len() && events[self.event + 1].0 + self.late_s < time_s {
            variance += ((events[self.event + 1].1 - events[self.event].1) * share).powi(2);
            self.event += 1;
        }
        variance
    }

    /// Mean square of what is not known of the mean voltage between two instants, V2: what a hole of the record hides acts as
    /// late as the model's commands do, behind the hole still. Errors of two holes have nothing to do with each other.
    fn holes_v2(&self, from_s: f64, to_s: f64) -> f64 {
        let holes = &self.scenario.unknown_input;
        let (from_s, to_s) = (from_s - self.late_s, to_s - self.late_s);
        let first = holes.partition_point(|hole| hole.to_s <= from_s);
        (holes[first..].iter())
            .take_while(|hole| hole.from_s < to_s)
            .map(|hole| unknown_v2([hole.from_s, hole.to_s], hole.variance, [from_s, to_s]))
            .sum()
    }

    /// The same of how long the whole command acted before the drive's current limit held it: the current there is what was
    /// measured, and tells nothing of how fast it came to be.
    fn limits_v2(&self, from_s: f64, to_s: f64) -> f64 {
        let limits = &self.scenario.limits;
        let first = limits.partition_point(|limit| limit.to_s <= from_s);
        (limits[first..].iter())
            .take_while(|limit| limit.from_s < to_s)
            .map(|limit| unknown_v2([limit.from_s, limit.to_s], limit.variance, [from_s, to_s]))
            .sum()
    }

    /// Variance of what rings, of which there is so much now: where it passes zero another phase of it is all error. How a
    /// coupling was twisted at the end of a hole was not measured: until that has died away all is.
    fn ringing(&mut self, square: f64, interval_s: f64) -> f64 {
        let dies_s = self.forms.ringing_s;
        if dies_s <= 0.0 {
            return 0.0;
        }
        self.most_ringing = square.max(self.most_ringing);
        self.ringing = square.max(self.ringing * (-2.0 * interval_s / dies_s).exp());
        let unobserved = (-(self.last_s - self.twisted_s) / dies_s).exp();
        self.ringing * (self.forms.ringing_share.powi(2) + unobserved)
    }

    /// Goes to the time of `sample`, where the model is in `state`: the passage, what the disturbance keeps, and the rates of
    /// current and speed there.
    fn approach(&mut self, sample: usize, state: &State) -> (Passage, f64, [f64; 2]) {
        let time_s = self.scenario.sample_time_s[sample];
        let interval_s = time_s - self.last_s;
        self.last_s = time_s;
        let now = state.direction();
        let rests = now == 0.0;
        let crossed = now * self.direction < 0.0;
        let released = self.direction == 0.0 && !rests && sample > 0;
        let propagator = self.propagator(interval_s, rests);
        let forget = (-interval_s / self.noise.correlation_s).exp();
        let edges_v2 = self.edges_v2(time_s, interval_s);
        let passes = interval_s > 0.0;
        let acceleration = (state.speed_rad_s - self.last_speed) / interval_s;
        let acceleration = if passes { acceleration } else { 0.0 };
        let input = self.scenario.events[self.event].1;
        let since_s = time_s - self.scenario.begin_s();
        let at = self.forms.instant(since_s, input, state);
        let inverse_inductance = self.dynamics.inverse_inductance;
        let forms = &self.forms;
        let (squares, rates) =
            forms.at(&at, state, acceleration, self.load_n_m, inverse_inductance);
        // Before the first command nothing has moved.
        let rates = if passes { rates } else { [0.0; 2] };
        let end_s = self.hole_ends_s.get(self.holes_passed);
        let begins_again = end_s.is_some_and(|to_s| *to_s <= time_s);
        self.holes_passed += usize::from(begins_again);
        let (fresh, unobserved, together) = if begins_again {
            // A signal whose noise is not known is not looked at.
            let levels = [self.noise.current_a, self.noise.speed_rad_s];
            let known = levels.map(|level| if level.is_finite() { level } else { 0.0 });
            let measured = known.map(|level| level * level);
            (measured, measured, 0.0)
        } else {
            let moved = propagator.apply([0.0; 2], [self.dynamics.inverse_inductance, 0.0]);
            let holes_v2 = self.holes_v2(time_s - interval_s, time_s);
            let one_v2 = holes_v2 + self.limits_v2(time_s - interval_s, time_s);
            let unobserved = moved.map(|moved| moved * moved * holes_v2);
            let [current, speed] = moved.map(|moved| moved * moved * (one_v2 + edges_v2));
            let slow = state.speed_rad_s.abs().min(self.last_speed.abs()) < self.slow_rad_s;
            let held_s = time_s - self.scenario.events[self.event].0;
            let is_blind = time_s - self.observed_s > self.longest_blind_s;
            let anew = match (held_s > self.longest_hold_s || is_blind, slow) {
                (true, _) => self.slow_rad_s / REVERSAL_SHARE,
                (_, true) => self.slow_rad_s,
                _ => 0.0,
            };
            let together = moved[0] * moved[1] * one_v2;
            ([current, speed + anew * anew], unobserved, together)
        };
        if begins_again {
            self.ringing = self.most_ringing;
            self.twisted_s = time_s;
        }
        let mut form = squares.map(|square| FORM_SHARE * FORM_SHARE * square);
        form[2] = self.ringing(squares[2], interval_s);
        let taken_over = Propagator::default();
        let passage = Passage {
            propagator: if begins_again { taken_over } else { propagator },
            fresh,
            begins_again,
            unobserved,
            together,
            interval_s,
            direction: now,
            kept: if rests || released { 0.0 } else { 1.0 },
            form,
            input_keeps: self.dynamics.input_keeps(interval_s),
            input_share: 1.0,
        };
        self.p = predicted(&self.p, &passage, &self.dynamics, self.noise, forget);
        if crossed || released {
            self.p[1][1] += self.jump;
        }
        if rests {
            stop(&mut self.p);
        }
        self.load_n_m *= forget;
        self.input *= passage.input_keeps;
        (passage, forget, rates)
    }

    /// Gains for what was measured at `sample`, where the model reads `reading`, and the variances that the samples
    /// have because their times are vague.
    fn gains(&mut self, sample: usize, reading: [f64; 2], rests: bool) -> (Update, [f64; 2]) {
        let (mut update, mut vague) = (Update::default(), [0.0; 2]);
        let [current, speed] = measured(self.scenario, self.noise, sample);
        let mut moved = 0.0;
        if let Some(value) = current {
            vague[0] = spread(self.scenario, &self.scenario.current_a, sample).powi(2);
            update.current = self.gain(0, self.noise.current_a.powi(2) + vague[0]);
            moved = update.current[1] * (value - reading[0]);
        }
        if let Some(value) = speed {
            self.observed_s = self.scenario.sample_time_s[sample];
            let e = value - reading[1] - moved;
            if rests && e.abs() > RELEASED_SIGMAS * self.noise.speed_rad_s {
                self.p[1][1] += e * e;
            }
            vague[1] = spread(self.scenario, &self.scenario.speed_rad_s, sample).powi(2);
            update.speed = self.gain(1, self.noise.speed_rad_s.powi(2) + vague[1]);
        }
        (update, vague)
    }

    /// Gain of one scalar of `variance`, which the covariance takes in.
    fn gain(&mut self, measured: usize, variance: f64) -> [f64; 5] {
        let p = &self.p;
        let s = p[measured][measured] + variance;
        let k = [0, 1, 2, 3].map(|row| p[row][measured] / s);
        self.p = corrected(p, &k, measured);
        [k[0], k[1], k[2], k[3], 1.0 / s.sqrt()]
    }
}

/// Mean square of what an interval of this variance leaves unknown of the mean voltage over another, V2.
fn unknown_v2(own: [f64; 2], variance: f64, over: [f64; 2]) -> f64 {
    let shared_s = own[1].min(over[1]) - own[0].max(over[0]);
    variance * (shared_s / (over[1] - over[0])).powi(2)
}

/// Follows `scenario` with `model` and finds the gains on the way.
pub(super) fn lead(
    model: &Model,
    scenario: &Scenario,
    start: State,
    noise: &Noise,
) -> Option<(Follower, Followed)> {
    let mut filter = Filter::new(model, scenario, start, noise)?;
    let mut plant = Plant::new(model, scenario.input).ok()?;
    let n = scenario.samples();
    let mut follower = Follower {
        updates: Vec::with_capacity(n),
        forgets: Vec::with_capacity(n),
        passages: Vec::with_capacity(n),
        rows: 0,
        late_s: filter.late_s,
        work: 0,
    };
    let mut out = Followed::with_capacity(n);
    let mut trajectory = Trajectory::default();
    let mut step = |sample: usize, reading: [f64; 2], state: &State| {
        let (passage, forget, rates) = filter.approach(sample, state);
        out.rates.push(rates);
        let now = passage.direction;
        let (update, vague) = filter.gains(sample, reading, now == 0.0);
        let values = measured(scenario, noise, sample);
        let (change, white) = update.correct(values, reading);
        filter.load_n_m += change[2];
        filter.input += change[3];
        follower.rows += values.iter().flatten().count();
        follower.updates.push(update);
        follower.forgets.push(forget);
        follower.passages.push(passage);
        let before = [state.current_a, state.speed_rad_s];
        let after = [before[0] + change[0], before[1] + change[1]];
        out.vague[sample] = vague;
        out.before.push(before);
        out.after.push(after);
        out.load_n_m.push(filter.load_n_m);
        out.white.push(white);
        out.direction.push(now);
        filter.last_speed = after[1];
        let is_corrected = change[1] != 0.0;
        filter.direction = if is_corrected { after[1].signum() } else { now };
        Some(Correction {
            current_a: change[0],
            speed_rad_s: change[1],
            load_n_m: filter.load_n_m,
            voltage_v: filter.input,
        })
    };
    plant.follow_into(scenario, start, &mut trajectory, &mut step);
    follower.work = plant.work() + FOLLOWED_COST * n as u64;
    Some((follower, out))
}

/// Cost of correcting the state at a sample, in exact sub-steps: a record at 1 kHz took four times as long over each of them as
/// one at 100 Hz.
const FOLLOWED_COST: u64 = 6;

/// Whitened innovations of another model that is led as `follower` was.
pub(super) fn follow(
    follower: &Follower,
    model: &Model,
    scenario: &Scenario,
    start: State,
    noise: &Noise,
    out: &mut Vec<[f64; 2]>,
) -> Option<u64> {
    let mut plant = Plant::new(model, scenario.input).ok()?;
    out.clear();
    let (mut load, mut input) = (0.0, 0.0);
    let mut trajectory = Trajectory::default();
    plant.follow_into(scenario, start, &mut trajectory, |sample, reading, _| {
        let update = &follower.updates[sample];
        load *= follower.forgets[sample];
        input *= follower.passages[sample].input_keeps;
        let (change, white) = update.correct(measured(scenario, noise, sample), reading);
        load += change[2];
        input += change[3];
        out.push(white);
        Some(Correction {
            current_a: change[0],
            speed_rad_s: change[1],
            load_n_m: load,
            voltage_v: input,
        })
    });
    let is_finite = |white: &[f64; 2]| white[0].is_finite() && white[1].is_finite();
    let work = plant.work() + FOLLOWED_COST * scenario.samples() as u64;
    out.iter().all(is_finite).then_some(work)
}

pub(super) fn predicted(
    p: &P,
    passage: &Passage,
    dynamics: &Dynamics,
    noise: &Noise,
    forget: f64,
) -> P {
    let propagator = &passage.propagator;
    let first = propagator.apply([1.0, 0.0], [0.0; 2]);
    let second = propagator.apply([0.0, 1.0], [0.0; 2]);
    let load = propagator.apply([0.0; 2], [0.0, -dynamics.inverse_inertia]);
    let input = propagator.apply([0.0; 2], dynamics.per_input);
    let moving = if passage.direction == 0.0 { 0.0 } else { 1.0 };
    let keeps = passage.input_keeps;
    let [second, load] = [
        second.map(|on| on * passage.kept),
        load.map(|on| on * moving),
    ];
    let f = [
        [first[0], second[0], load[0], input[0]],
        [first[1] * moving, second[1], load[1], input[1] * moving],
        [0.0, 0.0, forget, 0.0],
        [0.0, 0.0, 0.0, keeps],
    ];
    let mut fp = [[0.0; 4]; 4];
    for row in 0..4 {
        for column in 0..4 {
            fp[row][column] = (0..4).map(|k| f[row][k] * p[k][column]).sum();
        }
    }
    let mut out = [[0.0; 4]; 4];
    for row in 0..4 {
        for column in 0..=row {
            out[row][column] = (0..4).map(|k| fp[row][k] * f[column][k]).sum();
            out[column][row] = out[row][column];
        }
    }
    out[0][0] += passage.fresh[0];
    out[0][1] += passage.together * moving;
    out[1][0] += passage.together * moving;
    let ringing = passage.form[2] * RINGING_S * passage.interval_s;
    out[1][1] += (passage.fresh[1] + ringing * dynamics.inverse_inertia.powi(2)) * moving;
    out[2][2] += (noise.disturbance_n_m.powi(2) + passage.form[1]) * (1.0 - forget * forget);
    out[3][3] +=
        (noise.input.powi(2) * passage.input_share + passage.form[0]) * (1.0 - keeps * keeps);
    out
}

/// The speed of a shaft at rest is known.
pub(super) fn stop(p: &mut P) {
    p[1] = [0.0; 4];
    for row in p {
        row[1] = 0.0;
    }
}

pub(super) fn corrected(p: &P, k: &[f64; 4], measured: usize) -> P {
    let mut out = *p;
    for row in 0..4 {
        for column in 0..4 {
            out[row][column] -= k[row] * p[measured][column];
        }
    }
    out
}

impl Followed {
    fn with_capacity(n: usize) -> Self {
        Self {
            before: Vec::with_capacity(n),
            after: Vec::with_capacity(n),
            rates: Vec::with_capacity(n),
            load_n_m: Vec::with_capacity(n),
            direction: Vec::with_capacity(n),
            white: Vec::with_capacity(n),
            vague: vec![[0.0; 2]; n],
        }
    }
}

/// Sensors of a bench, and next to nothing else that is random.
#[cfg(test)]
pub(super) const QUIET: Noise = Noise {
    current_a: drivebench_model::plant::testing::CURRENT_NOISE_A,
    speed_rad_s: drivebench_model::plant::testing::SPEED_NOISE_RAD_S,
    disturbance_n_m: 1e-6,
    correlation_s: 0.5,
    input: 1e-6,
    sensors: 0.1,
};

/// The same beside a disturbance of the load and a voltage that is not quite known.
#[cfg(test)]
pub(super) const DISTURBED: Noise = Noise {
    disturbance_n_m: 0.01,
    input: 0.05,
    ..QUIET
};

/// A hole of one lost row under 20 V, of which nobody knows the voltage.
#[cfg(test)]
pub(super) fn hole(from_s: f64, to_s: f64, variance: f64) -> drivebench_model::plant::UnknownInput {
    drivebench_model::plant::UnknownInput {
        from_s,
        to_s,
        lost_rows: 1,
        mean: 20.0,
        beside: [0.0; 3],
        variance,
        restart: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{nameplate, truth};
    use drivebench_model::plant::testing::record;

    #[test]
    fn innovations_under_the_right_noise_are_white() {
        let model = nameplate();
        let events = vec![(0.0, 0.0), (0.2, 40.0), (1.2, 80.0), (2.4, 30.0)];
        let scenario = record(&model, events, 1e-3, 4.0, 3);
        let (follower, followed) = lead(&model, &scenario, State::default(), &QUIET).unwrap();
        assert_eq!(follower.rows, 2 * scenario.samples());
        let n = scenario.samples() as f64;
        for signal in 0..2 {
            let white: Vec<f64> = followed.white.iter().map(|white| white[signal]).collect();
            let alike = |lag: usize| {
                let pairs = white.iter().zip(&white[lag..]);
                pairs.map(|(a, b)| a * b).sum::<f64>() / n
            };
            // Four standard deviations of what 4,000 numbers show.
            let variance = alike(0);
            assert!(
                (variance - 1.0).abs() < 4.0 * (2.0 / n).sqrt(),
                "{variance}"
            );
            for lag in 1..20 {
                let rho = alike(lag);
                assert!(rho.abs() < 4.0 / n.sqrt(), "lag {lag}: {rho}");
            }
        }
        // The same model follows as it led.
        let (mut again, start) = (Vec::new(), State::default());
        let steps = follow(&follower, &model, &scenario, start, &QUIET, &mut again);
        assert_eq!(steps, Some(follower.work));
        for (a, b) in again.iter().flatten().zip(followed.white.iter().flatten()) {
            assert!((a - b).abs() < 1e-9);
        }
    }

    #[test]
    fn what_a_hole_hides_acts_as_late_as_the_commands() {
        let bare = nameplate();
        let mut scenario = record(&bare, vec![(0.0, 20.0)], 1e-3, 1.0, 3);
        scenario.unknown_input = vec![hole(0.5, 0.501, 9.0)];
        let late = truth("command_delay", &[2e-3]);
        for (model, begin_s) in [(bare, 0.5), (late, 0.502)] {
            let filter = Filter::new(&model, &scenario, State::default(), &QUIET).unwrap();
            for (from_s, unknown_v2) in [(0.0, 9.0), (-1e-3, 0.0), (1e-3, 0.0)] {
                let from_s = begin_s + from_s;
                let found = filter.holes_v2(from_s, from_s + 1e-3);
                assert!((found - unknown_v2).abs() < 1e-6, "{from_s}: {found}");
            }
        }
    }

    #[test]
    fn what_rings_is_as_uncertain_where_it_passes_zero_and_wholly_unknown_behind_a_hole() {
        let model = truth("elastic_coupling", &[20.0, 0.5, 0.05, 0.5]);
        let scenario = record(&model, vec![(0.0, 20.0)], 1e-3, 0.1, 3);
        let mut filter = Filter::new(&model, &scenario, State::default(), &QUIET).unwrap();
        // A torque of 2 N.m, and a quarter of a period later none.
        assert!((filter.ringing(4.0, 1e-3) / (4.0 * FORM_SHARE * FORM_SHARE) - 1.0).abs() < 1e-9);
        let later = filter.ringing(0.0, 0.25 / 20.0);
        assert!(
            (0.8..0.9).contains(&(later / (4.0 * FORM_SHARE * FORM_SHARE))),
            "{later}"
        );
        filter.twisted_s = filter.last_s;
        assert!(filter.ringing(4.0, 1e-3) > 4.0);
        // Half a second is three times the time in which it dies away.
        filter.last_s += 0.5;
        let later = filter.ringing(4.0, 1e-3);
        assert!(later < 0.05 * 4.0, "{later}");
    }

    #[test]
    fn a_blow_that_ends_a_play_is_all_error() {
        let model = truth("backlash", &[0.05, 50.0, 0.5, 0.05, 0.5]);
        let scenario = record(&model, vec![(0.0, 20.0)], 1e-3, 0.1, 3);
        let mut filter = Filter::new(&model, &scenario, State::default(), &QUIET).unwrap();
        assert!((filter.ringing(4.0, 1e-3) / 4.0 - 1.0).abs() < 1e-9);
    }

    #[test]
    fn behind_a_hole_a_shaft_may_ring_as_much_as_it_ever_did() {
        let model = truth("elastic_coupling", &[20.0, 0.5, 0.05, 0.5]);
        let levels = vec![(0.0, 0.0), (0.1, 40.0)];
        let mut scenario = record(&model, levels, 1e-3, 2.5, 3);
        let last = scenario.samples() - 1;
        let to_s = scenario.sample_time_s[last];
        scenario.unknown_input = vec![drivebench_model::plant::UnknownInput {
            restart: Some([scenario.current_a[last], scenario.speed_rad_s[last]]),
            ..hole(to_s - 0.4, to_s, 100.0)
        }];
        let (follower, _) = lead(&model, &scenario, State::default(), &QUIET).unwrap();
        let unknown = |sample: usize| follower.passages[sample].form[2];
        let most = (0..last).map(unknown).fold(0.0, f64::max) / (FORM_SHARE * FORM_SHARE);
        // It had long come to rest.
        assert!(unknown(last - 1) < 0.01 * most);
        assert!(unknown(last) > 0.9 * most, "{} {most}", unknown(last));
    }
}
