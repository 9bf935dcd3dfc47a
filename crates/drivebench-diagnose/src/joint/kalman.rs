//! Extended Kalman filter along a run (Kailath, An innovations approach to least-squares estimation, IEEE Trans. Automatic
//! Control 13, 1968): its innovations over their standard deviations are white if the model is right.
//!
//! The four states are the deviations of current and speed from the model, a disturbance torque and an error of the input; the
//! last two are first-order Gauss-Markov processes. The shaft integrates the disturbance, so that the error of a free run drifts
//! and tests on it would be wrong; the innovations are white for any course of the disturbance.

use super::process_noise::{FORM_SHARE, FormErrors};
use super::torque_balance::{filter_balance, unbalanced_with};
use drivebench_identify::noise::common_rounding;
use drivebench_identify::stamps::spread;
use drivebench_model::numerics::propagator::{LinearPart, Propagator};
use drivebench_model::numerics::statistics::{largest, median_step};
use drivebench_model::plant::{
    Correction, Input, Model, MotorKey, Path, Plant, Scenario, State, SubStep, Trajectory,
    UnknownInput,
};

/// Noise parameters of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Noise {
    /// Standard deviations of the sensors.
    pub current_a: f64,
    pub speed_rad_s: f64,
    /// Standard deviation and correlation time of the disturbance torque.
    pub disturbance_n_m: f64,
    pub correlation_s: f64,
    /// Standard deviation of the error of the input: of a voltage, V, correlated over [`Dynamics`]' `input_s`; of a torque, N.m,
    /// measured or from a measured current, independent from row to row.
    pub input: f64,
    /// Prior deviation of the logarithm of the sensors' noise.
    pub sensors: f64,
    /// Random errors of host stamps, as a share of those of independent instants within their half-widths: what a line delays
    /// alike at every exchange is an offset of the stamps, a nuisance of its own.
    pub stamps: f64,
    /// Standard deviations of the rounding of the measured current and speed, A and rad/s, contained in those of the sensors.
    pub rounding: [f64; 2],
}

/// Linear dynamics of the deviations. Of a balance of torques the second deviation is the unbalanced torque, which no state keeps,
/// and the input's error is the noise of the last speed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dynamics {
    moving: LinearPart,
    stuck: LinearPart,
    /// Inertia where the torque balance is the measurement: its rows are in newton metres.
    pub(super) balanced_kg_m2: Option<f64>,
    /// One over the inertia; 1 where the torque balance is the measurement.
    pub(super) inverse_inertia: f64,
    pub(super) inverse_inductance: f64,
    /// Rates of current and speed for one unit of the input's error.
    pub(super) per_input: [f64; 2],
    /// Correlation time of that error, s; zero where it is white.
    input_s: f64,
    /// Correlation time of the error of a coupling's form, s.
    ringing_s: f64,
}

/// The two correlation times, in times of response: a winding that warms or a bus that sags is slower than the shaft, and an
/// oscillation has a period of a quarter of it.
const INPUT_RESPONSES: f64 = 1.25;
const RINGING_RESPONSES: f64 = 0.25;

impl Dynamics {
    pub(super) fn of(model: &Model, scenario: &Scenario) -> Option<Self> {
        let value = |key| model.motor.get(key);
        let inertia = value(MotorKey::Inertia)?;
        let mut dynamics = Self {
            moving: LinearPart::new(&[[0.0; 2]; 2]),
            stuck: LinearPart::new(&[[0.0; 2]; 2]),
            balanced_kg_m2: Some(inertia),
            inverse_inertia: 1.0,
            inverse_inductance: 0.0,
            per_input: [1.0, 0.0],
            input_s: 0.0,
            ringing_s: scenario.scales.responses(RINGING_RESPONSES),
        };
        if scenario.input == Input::Voltage {
            let (r, l) = (value(MotorKey::Resistance)?, value(MotorKey::Inductance)?);
            let (ke, kt) = (value(MotorKey::BackEmf)?, model.motor.torque_constant()?);
            dynamics.moving = LinearPart::new(&[[-r / l, -ke / l], [kt / inertia, 0.0]]);
            dynamics.stuck = LinearPart::new(&[[-r / l, 0.0], [0.0, 0.0]]);
            (dynamics.balanced_kg_m2, dynamics.inverse_inertia) = (None, 1.0 / inertia);
            dynamics.inverse_inductance = 1.0 / l;
            dynamics.per_input = [1.0 / l, 0.0];
            dynamics.input_s = scenario.scales.responses(INPUT_RESPONSES);
        }
        Some(dynamics)
    }

    /// Autocorrelation of the input's error over an interval, and the variance of its mean over so many samples as a share of the
    /// variance of one.
    pub(super) fn mean_input(&self, interval_s: f64, samples: f64) -> (f64, f64) {
        if self.input_s > 0.0 {
            ((-interval_s / self.input_s).exp(), 1.0)
        } else {
            (0.0, 1.0 / samples)
        }
    }

    /// Standard deviations of the noise of both measurements: of current and speed, or of the torque of a balance.
    pub(super) fn measurement_noise(&self, noise: &Noise) -> [f64; 2] {
        let is_balance = self.balanced_kg_m2.is_some();
        [noise.current_a, if is_balance { noise.input } else { noise.speed_rad_s }]
    }

    /// Transition matrix of the deviations over an interval.
    pub(super) fn over(&self, interval_s: f64, rests: bool) -> Propagator {
        if let Some(inertia) = self.balanced_kg_m2 {
            let on_speed = if interval_s > 0.0 { -inertia / interval_s } else { 0.0 };
            return Propagator { phi: [[0.0; 2]; 2], gamma: [[0.0; 2], [on_speed, 1.0]] };
        }
        let part = if rests { &self.stuck } else { &self.moving };
        part.over(interval_s)
    }
}

/// Time update over the interval between two samples.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Transition {
    pub(super) propagator: Propagator,
    pub(super) interval_s: f64,
    /// Direction of motion in the interval; zero at rest.
    pub(super) direction: f64,
    /// Factor of the speed's deviation: zero where the shaft comes to rest or was at rest.
    pub(super) speed_factor: f64,
    /// Variances by errors of the forms of the model's effects: of voltage, torque, and the torque of an oscillating coupling.
    pub(super) form: [f64; 3],
    /// Autocorrelation of the input's error over the interval, and the share of its variance.
    pub(super) input_keeps: f64,
    pub(super) input_share: f64,
    /// Variances of current and speed added by an unknown voltage or a reversal, and whether the states were reset to the
    /// measurement after a gap of the record.
    pub(super) added_variance: [f64; 2],
    pub(super) restarts: bool,
    /// Part of `added_variance` by gaps of the record: unknown voltage, or a state reset to a measurement.
    pub(super) unobserved: [f64; 2],
    /// Variances added where commands act at independent instants within their half-widths.
    pub(super) edges: [f64; 2],
    /// Covariance of current and speed in `added_variance`: one unknown voltage moves both.
    pub(super) covariance: f64,
}

/// Sequential measurement update of a sample by two scalars: current, then speed.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Update {
    /// Gains on the four states, and one over the standard deviation of the innovation; zero where not measured.
    pub(super) current: [f64; 5],
    pub(super) speed: [f64; 5],
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

/// Gains and transitions of one run, used for a model and for all models near it.
#[derive(Clone, Debug, Default)]
pub(super) struct FilterGains {
    pub(super) updates: Vec<Update>,
    /// Autocorrelation of the disturbance over the interval to each sample.
    pub(super) decays: Vec<f64>,
    /// `passages[k]` leads to sample `k`.
    pub(super) transitions: Vec<Transition>,
    /// Innovations of both signals.
    pub(super) rows: usize,
    /// Delay of the model's commands, s.
    pub(super) command_delay_s: f64,
    /// Sub-steps of simulation that one pass costs.
    pub(super) work: u64,
}

/// A filtered run.
#[derive(Clone, Debug, Default)]
pub(super) struct FilteredRun {
    /// Before and after each correction: current, speed.
    pub(super) before: Vec<[f64; 2]>,
    pub(super) after: Vec<[f64; 2]>,
    /// Rates of current, A/s, and speed, rad/s2, as each sample is taken.
    pub(super) rates: Vec<[f64; 2]>,
    pub(super) direction: Vec<f64>,
    /// Innovations over their standard deviations; zero where not measured.
    pub(super) white: Vec<[f64; 2]>,
    /// Variances of the samples by independent errors of their times within the half-widths.
    pub(super) stamp_variance: Vec<[f64; 2]>,
    /// Variances of the samples of current and speed by an error of rounding that neighbours have in common; empty for a balance of
    /// torques.
    pub(super) rounding_variance: [Vec<f64>; 2],
    /// The sub-steps of the model, where an interval between two samples is too long for one transition of its deviations, until the
    /// grid is made of them.
    pub(super) trace: Option<Vec<SubStep>>,
}

/// Covariance matrix of the four states.
pub(super) type Covariance = [[f64; 4]; 4];

/// Stationary covariance, before the first sample of a run.
pub(super) fn stationary(noise: &Noise) -> Covariance {
    let mut p = [[0.0; 4]; 4];
    p[2][2] = noise.disturbance_n_m.powi(2);
    p[3][3] = noise.input.powi(2);
    p
}

fn measured(scenario: &Scenario, noise: &Noise, sample: usize) -> [Option<f64>; 2] {
    let value = |values: &[f64], level: f64| {
        Some(values[sample]).filter(|value| value.is_finite() && level.is_finite())
    };
    [value(&scenario.current_a, noise.current_a), value(&scenario.speed_rad_s, noise.speed_rad_s)]
}

/// Variance of the speed that a break-away or a change of sign adds: a deviation of 0.0017 of the largest speed.
pub(super) fn reversal_variance(scenario: &Scenario) -> f64 {
    (0.0017 * largest(&scenario.speed_rad_s)).powi(2)
}

/// The state of the filter between two samples.
struct Filter<'a> {
    scenario: &'a Scenario,
    noise: &'a Noise,
    dynamics: Dynamics,
    forms: FormErrors,
    p: Covariance,
    load_n_m: f64,
    input: f64,
    jump: f64,
    direction: f64,
    last_s: f64,
    last_speed: f64,
    /// Number of the command that holds.
    event: usize,
    /// Error of the times of commands, and delay of the model's commands, s.
    command_jitter_s: f64,
    command_delay_s: f64,
    /// The path of the model, with what is known of the run's sensors.
    path: Path,
    /// Ends of the holes behind which the model begins again; the first `holes_passed` lie behind.
    hole_ends_s: Vec<f64>,
    holes_passed: usize,
    /// Whether the voltage changed at unknown instants.
    is_sampled: bool,
    /// Square of a coupling's torque with the decay of its oscillation; the largest so far, assumed after a gap of the record; and
    /// the time of the last gap, from which on the twist is unknown.
    ringing: f64,
    most_ringing: f64,
    twist_unknown_from_s: f64,
    rounding_variance: [Vec<f64>; 2],
    /// Propagators over the last interval, moving and at rest.
    cached: (f64, [Propagator; 2]),
}

impl<'a> Filter<'a> {
    fn new(model: &Model, scenario: &'a Scenario, start: State, noise: &'a Noise) -> Option<Self> {
        let dynamics = Dynamics::of(model, scenario)?;
        let mut p = stationary(noise);
        // Initial current: deviation of a tenth of the largest (an offset of the voltage may drive one at rest). Initial speed of
        // a shaft that did not rest: ten standard deviations of the sensor.
        p[0][0] = (0.1 * largest(&scenario.current_a)).powi(2);
        if start.speed_rad_s != 0.0 && noise.speed_rad_s.is_finite() {
            p[1][1] = (10.0 * noise.speed_rad_s).powi(2);
        }
        let holes = scenario.unknown_input.iter();
        let restarted = holes.filter(|hole| hole.restart.is_some());
        let forms = FormErrors::of(model, scenario);
        let paths = forms.terms.iter().map(|terms| terms.path());
        let path = paths.fold(Path::of(scenario.sensors), Path::plus);
        Some(Self {
            scenario,
            noise,
            dynamics,
            command_delay_s: path.command_delay_s + model.input_delay_in(scenario),
            path,
            forms,
            p,
            load_n_m: 0.0,
            input: 0.0,
            jump: reversal_variance(scenario),
            direction: start.direction(),
            last_s: scenario.begin_s(),
            last_speed: start.speed_rad_s,
            event: 0,
            command_jitter_s: scenario.input_delay_s().map_or(0.0, |delay| delay.1),
            hole_ends_s: restarted.map(|hole| hole.to_s).collect(),
            holes_passed: 0,
            is_sampled: scenario.has_sampled_input(),
            ringing: 0.0,
            most_ringing: 0.0,
            twist_unknown_from_s: f64::NEG_INFINITY,
            rounding_variance: [
                common_rounding(&scenario.current_a, noise.rounding[0]),
                common_rounding(&scenario.speed_rad_s, noise.rounding[1]),
            ],
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

    /// Variance of the voltage by the commands until `time_s`: the instant within its exchange at which a command was applied
    /// is not known.
    fn edges_v2(&mut self, time_s: f64, interval_s: f64) -> f64 {
        let events = &self.scenario.events;
        let share = (self.command_jitter_s / interval_s).min(1.0);
        let mut variance = 0.0;
        while self.event + 1 < events.len()
            && events[self.event + 1].0 + self.command_delay_s < time_s
        {
            variance += ((events[self.event + 1].1 - events[self.event].1) * share).powi(2);
            self.event += 1;
        }
        variance
    }

    /// Mean square of the error of the mean voltage between two instants by holes of the record, V2: behind a hole it acts as
    /// late as the model's commands do. Errors of two holes are independent.
    fn holes_v2(&self, from_s: f64, to_s: f64, variance: impl Fn(&UnknownInput) -> f64) -> f64 {
        let holes = &self.scenario.unknown_input;
        let over = [from_s - self.command_delay_s, to_s - self.command_delay_s];
        let first = holes.partition_point(|hole| hole.to_s <= over[0]);
        (holes[first..].iter())
            .take_while(|hole| hole.from_s < over[1])
            .map(|hole| unknown_v2([hole.from_s, hole.to_s], variance(hole), over))
            .sum()
    }

    /// The part of it by changes of a sampled voltage, and that part if their instants were uniformly distributed. They are from the
    /// current after them, which tells nothing else: neither its own error nor, with it, that of the speed.
    fn sampled_v2(&self, from_s: f64, to_s: f64) -> [f64; 2] {
        let scenario = self.scenario;
        let change_v = |hole: &UnknownInput| {
            let [before_v, after_v] = [hole.from_s, hole.to_s].map(|at_s| scenario.input_at(at_s));
            after_v - before_v
        };
        let uniform_v2 = |hole: &UnknownInput| change_v(hole).powi(2) / 12.0;
        let known_v2 = |hole: &UnknownInput| hole.variance;
        let variances: [&dyn Fn(&UnknownInput) -> f64; 2] = [&known_v2, &uniform_v2];
        variances.map(|variance| {
            let of_edge =
                |hole: &UnknownInput| if hole.is_of_edge() { variance(hole) } else { 0.0 };
            if self.is_sampled { self.holes_v2(from_s, to_s, of_edge) } else { 0.0 }
        })
    }

    /// The same by the drive's current limit: how long the whole command acted before the limit held it is not known.
    fn limits_v2(&self, from_s: f64, to_s: f64) -> f64 {
        let limits = &self.scenario.limits;
        let first = limits.partition_point(|limit| limit.to_s <= from_s);
        (limits[first..].iter())
            .take_while(|limit| limit.from_s < to_s)
            .map(|limit| unknown_v2([limit.from_s, limit.to_s], limit.variance, [from_s, to_s]))
            .sum()
    }

    /// Variance of a coupling's torque from its square now. The envelope counts, not the instantaneous value: at a zero crossing
    /// an error of phase is an error of the full torque. After a gap the twist is unknown until the oscillation has decayed.
    fn ringing(&mut self, square: f64, interval_s: f64) -> f64 {
        let decay_s = self.forms.ringing_s;
        if decay_s <= 0.0 {
            return 0.0;
        }
        self.most_ringing = square.max(self.most_ringing);
        self.ringing = square.max(self.ringing * (-2.0 * interval_s / decay_s).exp());
        let unobserved = (-(self.last_s - self.twist_unknown_from_s) / decay_s).exp();
        self.ringing * (self.forms.ringing_share.powi(2) + unobserved)
    }

    /// Variances added over an interval that ends at `time_s`: of current and speed, the part by gaps of the record, and the
    /// covariance of the two.
    fn added_variance(
        &self,
        [interval_s, time_s]: [f64; 2],
        moved: [f64; 2],
    ) -> ([f64; 2], [f64; 2], f64) {
        let from_s = time_s - interval_s;
        let holes_v2 = self.holes_v2(from_s, time_s, |hole| hole.variance);
        let one_v2 = holes_v2 + self.limits_v2(from_s, time_s);
        let [sampled_v2, uniform_v2] = self.sampled_v2(from_s, time_s);
        let unobserved = moved.map(|moved| moved * moved * holes_v2);
        let [current, speed] = moved.map(|moved| moved * moved * one_v2);
        let current = current + moved[0] * moved[0] * (uniform_v2 - sampled_v2);
        let covariance = moved[0] * moved[1] * (one_v2 - sampled_v2);
        ([current, speed], unobserved, covariance)
    }

    /// Time update to `sample`, where the model is in `state`: the transition, the autocorrelation of the disturbance, and the
    /// rates of current and speed.
    fn time_update(&mut self, sample: usize, state: &State) -> (Transition, f64, [f64; 2]) {
        let time_s = self.scenario.sample_time_s[sample];
        let interval_s = time_s - self.last_s;
        self.last_s = time_s;
        let now = state.direction();
        let rests = now == 0.0;
        let crossed = now * self.direction < 0.0;
        let released = self.direction == 0.0 && !rests && sample > 0;
        let propagator = self.propagator(interval_s, rests);
        let decay = (-interval_s / self.noise.correlation_s).exp();
        let edges_v2 = self.edges_v2(time_s, interval_s);
        let passes = interval_s > 0.0;
        let acceleration = (state.speed_rad_s - self.last_speed) / interval_s;
        let acceleration = if passes { acceleration } else { 0.0 };
        let input = self.scenario.events[self.event].1;
        let at = self.forms.instant(time_s - self.scenario.begin_s(), input, state);
        let inductance = self.dynamics.inverse_inductance;
        let load_n_m = self.load_n_m;
        let (squares, rates) = self.forms.at(&at, state, acceleration, load_n_m, inductance);
        let end_s = self.hole_ends_s.get(self.holes_passed);
        let restarts = end_s.is_some_and(|to_s| *to_s <= time_s);
        self.holes_passed += usize::from(restarts);
        let moved = propagator.apply([0.0; 2], [inductance, 0.0]);
        let (added_variance, unobserved, covariance) = if restarts {
            // A signal of unknown noise (infinite) is not used.
            let levels = [self.noise.current_a, self.noise.speed_rad_s];
            let known = levels.map(|level| if level.is_finite() { level } else { 0.0 });
            let measured = known.map(|level| level * level);
            (measured, measured, 0.0)
        } else {
            self.added_variance([interval_s, time_s], moved)
        };
        if restarts {
            self.ringing = self.most_ringing;
            self.twist_unknown_from_s = time_s;
        }
        let mut form = squares.map(|square| FORM_SHARE * FORM_SHARE * square);
        form[2] = self.ringing(squares[2], interval_s);
        let transition = Transition {
            propagator: if restarts { Propagator::default() } else { propagator },
            added_variance,
            restarts,
            unobserved,
            edges: if restarts { [0.0; 2] } else { moved.map(|moved| moved * moved * edges_v2) },
            covariance,
            interval_s,
            direction: now,
            speed_factor: if rests || released { 0.0 } else { 1.0 },
            form,
            input_keeps: self.dynamics.mean_input(interval_s, 1.0).0,
            input_share: 1.0,
        };
        self.p = predicted_covariance(&self.p, &transition, &self.dynamics, self.noise, decay);
        if crossed || released {
            self.p[1][1] += self.jump;
        }
        if rests {
            fix_speed(&mut self.p);
        }
        self.load_n_m *= decay;
        self.input *= transition.input_keeps;
        // Before the first command nothing has moved.
        (transition, decay, if passes { rates } else { [0.0; 2] })
    }

    /// Gains for what was measured at `sample`, where the model reads `reading`, and the variances of the samples by errors of
    /// their times.
    fn gains(&mut self, sample: usize, reading: [f64; 2], rests: bool) -> (Update, [f64; 2]) {
        let (mut update, mut stamp_variance) = (Update::default(), [0.0; 2]);
        let stamps = self.noise.stamps.powi(2);
        let [current, speed] = measured(self.scenario, self.noise, sample);
        let mut moved = 0.0;
        if let Some(value) = current {
            stamp_variance[0] = spread(self.scenario, &self.scenario.current_a, sample).powi(2);
            let added = self.rounding_variance[0][sample] + stamps * stamp_variance[0];
            update.current = self.gain(0, self.noise.current_a.powi(2) + added);
            moved = update.current[1] * (value - reading[0]);
        }
        if let Some(value) = speed {
            let e = value - reading[1] - moved;
            // A shaft that rests in the model and is measured to move, by five standard deviations, is released.
            if rests && e.abs() > 5.0 * self.noise.speed_rad_s {
                self.p[1][1] += e * e;
            }
            stamp_variance[1] = spread(self.scenario, &self.scenario.speed_rad_s, sample).powi(2);
            let added = self.rounding_variance[1][sample] + stamps * stamp_variance[1];
            update.speed = self.gain(1, self.noise.speed_rad_s.powi(2) + added);
        }
        (update, stamp_variance)
    }

    /// Gain of one scalar of `variance`, which the covariance takes in.
    fn gain(&mut self, measured: usize, variance: f64) -> [f64; 5] {
        let p = &self.p;
        let s = p[measured][measured] + variance;
        let k = [0, 1, 2, 3].map(|row| p[row][measured] / s);
        self.p = updated_covariance(p, &k, measured);
        [k[0], k[1], k[2], k[3], 1.0 / s.sqrt()]
    }
}

/// Mean square of the error of the mean voltage over an interval by another of this variance, V2.
fn unknown_v2(own: [f64; 2], variance: f64, over: [f64; 2]) -> f64 {
    let shared_s = own[1].min(over[1]) - own[0].max(over[0]);
    variance * (shared_s / (over[1] - over[0])).powi(2)
}

/// Filters `scenario` with `model`, computing the gains.
pub(super) fn filter_run(
    model: &Model,
    scenario: &Scenario,
    start: State,
    noise: &Noise,
) -> Option<(FilterGains, FilteredRun)> {
    if scenario.input != Input::Voltage {
        return filter_balance(model, scenario, noise);
    }
    let mut filter = Filter::new(model, scenario, start, noise)?;
    let mut plant = Plant::new(model, scenario.input).ok()?;
    let path = filter.path;
    let is_refined =
        plant.is_of_one_inertia() && needs_refinement(model, scenario, &path).unwrap_or(false);
    if is_refined {
        plant = plant.traced();
    }
    let n = scenario.samples();
    let mut gains =
        FilterGains { command_delay_s: filter.command_delay_s, ..FilterGains::default() };
    let mut out = FilteredRun { stamp_variance: vec![[0.0; 2]; n], ..FilteredRun::default() };
    let mut trajectory = Trajectory::default();
    let mut step = |sample: usize, reading: [f64; 2], state: &State| {
        let (transition, decay, rates) = filter.time_update(sample, state);
        let now = transition.direction;
        let (update, stamp_variance) = filter.gains(sample, reading, now == 0.0);
        let values = measured(scenario, noise, sample);
        let (change, white) = update.correct(values, reading);
        filter.load_n_m += change[2];
        filter.input += change[3];
        gains.rows += values.iter().flatten().count();
        gains.updates.push(update);
        gains.decays.push(decay);
        gains.transitions.push(transition);
        let before = [state.current_a, state.speed_rad_s];
        let after = [before[0] + change[0], before[1] + change[1]];
        out.rates.push(rates_of_readings(rates, &path, state, reading));
        out.stamp_variance[sample] = stamp_variance;
        out.before.push(before);
        out.after.push(after);
        out.white.push(white);
        out.direction.push(now);
        filter.last_speed = after[1];
        let is_corrected = change[1] != 0.0;
        filter.direction = if is_corrected { after[1].signum() } else { now };
        Some(correction(change, filter.load_n_m, filter.input))
    };
    plant.follow_into(scenario, start, &mut trajectory, &mut step);
    out.rounding_variance = filter.rounding_variance;
    gains.work = plant.work() + FOLLOWED_COST * n as u64;
    out.trace = is_refined.then(|| plant.into_trace());
    Some((gains, out))
}

/// Whether deviations need more than one transition between two samples: with a lag between motion and measurement, or with a measured
/// current that settles within the interval. `None` where a measured current neither settles nor has a rate that is constant over
/// the interval, which holds up to half of the armature's time constant: their tangents are some per cent off, of which a complete
/// model at 100 Hz leaves 1.05 times the noise. The speed integrates the current.
pub(super) fn needs_refinement(model: &Model, scenario: &Scenario, path: &Path) -> Option<bool> {
    let lags_s = path.speed_delay_s + path.speed_filter_s + path.current_filter_s;
    if lags_s > 0.0 || path.averages_current {
        return Some(true);
    }
    let has_current = scenario.current_a.iter().any(|current_a| current_a.is_finite());
    if scenario.input != Input::Voltage || !has_current {
        return Some(false);
    }
    let constant_s = model.motor.electrical_time_constant_s()?;
    match median_step(&scenario.sample_time_s) / constant_s {
        constants if constants < 0.5 => Some(false),
        constants if constants > 2.0 => Some(true),
        _ => None,
    }
}

/// Rates of the readings, A/s and rad/s2, from those of the motion: the output of a filter changes by its distance from the input.
fn rates_of_readings(rates: [f64; 2], path: &Path, state: &State, reading: [f64; 2]) -> [f64; 2] {
    let behind_a = state.current_a + path.current_offset_a - reading[0];
    let delayed_rad_s = state.speed_rad_s + path.speed_offset_rad_s - rates[1] * path.speed_delay_s;
    let of_filter = |behind: f64, filter_s: f64, rate: f64| {
        if filter_s > 0.0 { behind / filter_s } else { rate }
    };
    [
        of_filter(behind_a, path.current_filter_s, rates[0]),
        of_filter(delayed_rad_s - reading[1], path.speed_filter_s, rates[1]),
    ]
}

/// Cost of a measurement update, in sub-steps of simulation: measured on records at 1 kHz and at 100 Hz.
pub(super) const FOLLOWED_COST: u64 = 6;

const fn correction(change: [f64; 4], load_n_m: f64, voltage_v: f64) -> Correction {
    Correction { current_a: change[0], speed_rad_s: change[1], load_n_m, voltage_v }
}

/// Whitened innovations of another model with the gains of `gains`, and the sub-steps that it cost.
pub(super) fn innovations_with(
    gains: &FilterGains,
    model: &Model,
    scenario: &Scenario,
    start: State,
    noise: &Noise,
    out: &mut Vec<[f64; 2]>,
) -> Option<u64> {
    if scenario.input != Input::Voltage {
        return unbalanced_with(gains, model, scenario, out);
    }
    let mut plant = Plant::new(model, scenario.input).ok()?;
    out.clear();
    let (mut load, mut input) = (0.0, 0.0);
    let mut trajectory = Trajectory::default();
    plant.follow_into(scenario, start, &mut trajectory, |sample, reading, _| {
        let update = &gains.updates[sample];
        load *= gains.decays[sample];
        input *= gains.transitions[sample].input_keeps;
        let (change, white) = update.correct(measured(scenario, noise, sample), reading);
        load += change[2];
        input += change[3];
        out.push(white);
        Some(correction(change, load, input))
    });
    let is_finite = |white: &[f64; 2]| white[0].is_finite() && white[1].is_finite();
    let work = plant.work() + FOLLOWED_COST * scenario.samples() as u64;
    out.iter().all(is_finite).then_some(work)
}

/// Covariance after a time update: `F P F' + Q`.
pub(super) fn predicted_covariance(
    p: &Covariance,
    transition: &Transition,
    dynamics: &Dynamics,
    noise: &Noise,
    decay: f64,
) -> Covariance {
    let propagator = &transition.propagator;
    let first = propagator.apply([1.0, 0.0], [0.0; 2]);
    let second = propagator.apply([0.0, 1.0], [0.0; 2]).map(|on| on * transition.speed_factor);
    let moving = if transition.direction == 0.0 { 0.0 } else { 1.0 };
    let load = propagator.apply([0.0; 2], [0.0, -dynamics.inverse_inertia]).map(|on| on * moving);
    let input = propagator.apply([0.0; 2], dynamics.per_input);
    let keeps = transition.input_keeps;
    let f = [
        [first[0], second[0], load[0], input[0]],
        [first[1] * moving, second[1], load[1], input[1] * moving],
        [0.0, 0.0, decay, 0.0],
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
    let edges = transition.edges.map(|variance| noise.stamps.powi(2) * variance);
    out[0][0] += transition.added_variance[0] + edges[0];
    out[0][1] += transition.covariance * moving;
    out[1][0] += transition.covariance * moving;
    let ringing = transition.form[2] * dynamics.ringing_s * transition.interval_s;
    out[1][1] +=
        (transition.added_variance[1] + edges[1] + ringing * dynamics.inverse_inertia.powi(2))
            * moving;
    out[2][2] += (noise.disturbance_n_m.powi(2) + transition.form[1]) * (1.0 - decay * decay);
    if dynamics.balanced_kg_m2.is_some() {
        // The noise of the next speed acts with the opposite sign of that of the last one.
        let (speed, variance) = (-input[1] * moving, noise.speed_rad_s.powi(2));
        out[1][1] += speed * speed * variance;
        out[1][3] += speed * variance;
        out[3][1] += speed * variance;
        out[3][3] += variance;
        return out;
    }
    out[3][3] +=
        (noise.input.powi(2) * transition.input_share + transition.form[0]) * (1.0 - keeps * keeps);
    out
}

/// Sets the speed of a shaft at rest as known: zero variance.
pub(super) fn fix_speed(p: &mut Covariance) {
    p[1] = [0.0; 4];
    for row in p {
        row[1] = 0.0;
    }
}

/// Covariance after a scalar measurement update with these gains: `(I - K H) P`.
pub(super) fn updated_covariance(p: &Covariance, k: &[f64; 4], measured: usize) -> Covariance {
    let mut out = *p;
    for row in 0..4 {
        for column in 0..4 {
            out[row][column] -= k[row] * p[measured][column];
        }
    }
    out
}

/// Sensor noise of a bench, and nearly no disturbance.
#[cfg(test)]
pub(super) const QUIET: Noise = Noise {
    current_a: drivebench_model::plant::testing::CURRENT_NOISE_A,
    speed_rad_s: drivebench_model::plant::testing::SPEED_NOISE_RAD_S,
    disturbance_n_m: 1e-6,
    correlation_s: 0.5,
    input: 1e-6,
    sensors: 0.1,
    stamps: 1.0,
    rounding: [0.0; 2],
};

/// The same besides a disturbance of the load and an error of the voltage.
#[cfg(test)]
pub(super) const DISTURBED: Noise = Noise { disturbance_n_m: 0.01, input: 0.05, ..QUIET };

/// A hole of one lost row under 20 V, of unknown voltage.
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
        let (gains, filtered) = filter_run(&model, &scenario, State::default(), &QUIET).unwrap();
        assert_eq!(gains.rows, 2 * scenario.samples());
        let n = scenario.samples() as f64;
        for signal in 0..2 {
            let white: Vec<f64> = filtered.white.iter().map(|white| white[signal]).collect();
            for lag in 0..20 {
                let pairs = white.iter().zip(&white[lag..]);
                let rho = pairs.map(|(a, b)| a * b).sum::<f64>() / n;
                // Four standard deviations of 4,000 numbers.
                let [expected, most] = if lag == 0 { [1.0, 2.0] } else { [0.0, 1.0] };
                assert!((rho - expected).abs() < 4.0 * f64::sqrt(most / n), "lag {lag}: {rho}");
            }
        }
        // The same model with its own gains.
        let (mut again, start) = (Vec::new(), State::default());
        let steps = innovations_with(&gains, &model, &scenario, start, &QUIET, &mut again);
        assert_eq!(steps, Some(gains.work));
        for (a, b) in again.iter().flatten().zip(filtered.white.iter().flatten()) {
            assert!((a - b).abs() < 1e-9);
        }
    }

    #[test]
    fn a_rounding_that_neighbours_share_is_no_systematic_error() {
        let model = nameplate();
        let events = vec![(0.0, 0.0), (0.2, 40.0), (1.2, 80.0), (2.4, 30.0)];
        let mut scenario = record(&model, events, 1e-3, 4.0, 3);
        let quantum = 4.0 * QUIET.current_a;
        for current_a in &mut scenario.current_a {
            *current_a = quantum * (*current_a / quantum).round();
        }
        let rounding = quantum / 12f64.sqrt();
        // Variance of the sums of a hundred innovations, 1 if they are independent.
        let of_sums = |common: f64| {
            let current_a = QUIET.current_a.hypot(rounding);
            let noise = Noise { current_a, rounding: [common, 0.0], ..QUIET };
            let (_, filtered) = filter_run(&model, &scenario, State::default(), &noise).unwrap();
            let white: Vec<f64> = filtered.white.iter().map(|white| white[0]).collect();
            let sums = white.chunks(100).map(|part| part.iter().sum::<f64>().powi(2) / 100.0);
            sums.sum::<f64>() / 40.0
        };
        let [alone, shared] = [0.0, rounding].map(of_sums);
        assert!(alone > 4.0 && shared < 2.0, "{alone} {shared}");
    }

    #[test]
    fn the_unknown_voltage_of_a_hole_acts_as_late_as_commands() {
        let bare = nameplate();
        let mut scenario = record(&bare, vec![(0.0, 20.0)], 1e-3, 1.0, 3);
        scenario.unknown_input = vec![hole(0.5, 0.501, 9.0)];
        for (model, begin_s) in [(bare, 0.5), (truth("command_delay", &[2e-3]), 0.502)] {
            let filter = Filter::new(&model, &scenario, State::default(), &QUIET).unwrap();
            for (from_s, unknown_v2) in [(0.0, 9.0), (-1e-3, 0.0), (1e-3, 0.0)] {
                let from_s = begin_s + from_s;
                let found = filter.holes_v2(from_s, from_s + 1e-3, |hole| hole.variance);
                assert!((found - unknown_v2).abs() < 1e-6, "{from_s}: {found}");
            }
        }
    }

    #[test]
    fn the_error_of_a_coupling_decays_with_its_oscillation() {
        let square = 4.0;
        let elastic = truth("elastic_coupling", &[20.0, 0.5, 0.05, 0.5]);
        let backlash = truth("backlash", &[0.05, 50.0, 0.5, 0.05, 0.5]);
        let scenario = record(&elastic, vec![(0.0, 20.0)], 1e-3, 0.1, 3);
        let filter = |model| Filter::new(model, &scenario, State::default(), &QUIET).unwrap();
        // The impact that ends a play is all error.
        assert!((filter(&backlash).ringing(square, 1e-3) / square - 1.0).abs() < 1e-9);
        let mut filter = filter(&elastic);
        let share = |found: f64| found / (square * FORM_SHARE * FORM_SHARE);
        assert!((share(filter.ringing(square, 1e-3)) - 1.0).abs() < 1e-9);
        // A quarter of a period later there is no torque.
        let later = share(filter.ringing(0.0, 0.25 / 20.0));
        assert!((0.8..0.9).contains(&later), "{later}");
        // Behind a hole all is unknown, until three times the time of decay.
        filter.twist_unknown_from_s = filter.last_s;
        assert!(filter.ringing(square, 1e-3) > square);
        filter.last_s += 0.5;
        let later = filter.ringing(square, 1e-3);
        assert!(later < 0.05 * square, "{later}");
    }

    #[test]
    fn behind_a_hole_a_shaft_may_oscillate_as_much_as_ever() {
        let model = truth("elastic_coupling", &[20.0, 0.5, 0.05, 0.5]);
        let mut scenario = record(&model, vec![(0.0, 0.0), (0.1, 40.0)], 1e-3, 2.5, 3);
        let last = scenario.samples() - 1;
        let to_s = scenario.sample_time_s[last];
        scenario.unknown_input = vec![UnknownInput {
            restart: Some([scenario.current_a[last], scenario.speed_rad_s[last]]),
            ..hole(to_s - 0.4, to_s, 100.0)
        }];
        let (gains, _) = filter_run(&model, &scenario, State::default(), &QUIET).unwrap();
        let unknown = |sample: usize| gains.transitions[sample].form[2];
        let most = (0..last).map(unknown).fold(0.0, f64::max) / (FORM_SHARE * FORM_SHARE);
        // It had long come to rest.
        assert!(unknown(last - 1) < 0.01 * most);
        assert!(unknown(last) > 0.9 * most, "{} {most}", unknown(last));
    }
}
