//! Event-driven simulation of a model: exact zero-order hold where it is linear, stick-slip as a hybrid automaton, no chatter.
//!
//! Motion has three modes: stuck, forward, backward (Karnopp, *J. Dyn. Sys. Meas. Control* 107, 1985, but with located events
//! instead of a dead band of the speed). The sign of the friction is that of the mode. A zero crossing inside a step is located
//! and the step is cut there; the shaft then sticks if the driving torque is within the friction level, else it continues in
//! the direction of the net torque.
//!
//! Between events the linear part is propagated exactly. Effects enter as a forcing that is evaluated at the middle of
//! a sub-step (exponential midpoint rule, second order; Hochbruck and Ostermann, *Acta Numerica* 19, 2010), so that a stiff
//! armature circuit needs no small steps.

mod commands;
mod equations;
mod sensors;
mod steep;
mod steps;
mod two_mass;

pub use commands::starts_from_rest;
pub use equations::State;
use equations::{Equations, Mode};
pub use sensors::{Reading, Sensors, Transient};
use steep::Steep;
use steps::Steps;
use two_mass::TwoMass;

use super::effect::Instant;
use super::limited::LimitReached;
use super::model::{Model, ModelError};
use super::run_scales::RunScales;
use super::scenario::{Input, REFERENCE_SUPPLY_V, Scenario};
use crate::numerics::count::whole;
use crate::numerics::root;
use crate::numerics::statistics::largest;

/// Longest sub-step with effects, in times of response: resolves voltage drops at current reversals and Stribeck friction at reversals.
const LONGEST_STEP_WITH_EFFECTS: f64 = 0.0125;

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    pub current_a: Vec<f64>,
    pub speed_rad_s: Vec<f64>,
}

/// Correction of the state by a measurement; a change that is NaN is zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Correction {
    pub current_a: f64,
    pub speed_rad_s: f64,
    /// Load torque in addition to the model's, against positive motion, until the next correction.
    pub load_n_m: f64,
    /// Voltage in addition to the input, until the next correction.
    pub voltage_v: f64,
}

#[derive(Clone, Copy, Debug)]
pub struct SubStep {
    pub begin_s: f64,
    pub length_s: f64,
    pub input: f64,
    /// Current, A, and speed, rad/s, at its begin and its end.
    pub from: [f64; 2],
    pub to: [f64; 2],
    /// Directions of motion at its begin and its end; zero at rest.
    pub directions: [f64; 2],
}

pub struct Plant {
    equations: Equations,
    /// In the present run.
    longest_step_s: f64,
    least_step_s: f64,
    moving: Steps,
    /// While stuck: the current alone.
    stuck: Steps,
    two_mass: Option<Box<TwoMass>>,
    /// Sensors with delays, filters or offsets; `None` where the measurement is the motion.
    sensors: Option<Sensors<1>>,
    /// Currents at which sub-steps must be shorter, in the present run.
    steep: Steep,
    /// Start of the present run, s.
    begin_s: f64,
    work: u64,
    /// The sub-steps of the present run, where they are kept.
    trace: Option<Vec<SubStep>>,
}

fn longest_step_s(equations: &Equations, scales: &RunScales) -> f64 {
    let linear = equations.is_linear();
    // Linear steps are exact, but two reversals within one are not detected, and an oscillating load reverses often. The
    // sensors interpolate the motion between two steps linearly: they need short ones.
    let responses = match (&equations.coupling, equations.path.measures_directly()) {
        (None, true) if linear => 10.0 * LONGEST_STEP_WITH_EFFECTS,
        (Some(_), true) if linear => 2.0 * LONGEST_STEP_WITH_EFFECTS,
        _ => LONGEST_STEP_WITH_EFFECTS,
    };
    let mut step_s = scales.responses(responses);
    if equations.needs_angle {
        // 0.3 rad are a fourteenth of the period of six teeth.
        step_s = step_s.min(0.3 / scales.speed_rad_s);
    }
    // Ten between two samples are enough: with 20 the sizes found on the records of a servo at 100 Hz, whose current settles in a
    // hundredth of a period, are the same within 1 %.
    step_s = step_s.max(scales.period_s / 10.0);
    // Twenty sub-steps in a period of an oscillating load. Halved as often as needed: steps that followed its frequency in a fit
    // would make the cost jump.
    let most_s = equations.coupling.map_or(f64::INFINITY, |coupling| 0.05 / coupling.frequency_hz);
    while step_s > most_s && most_s > 0.0 {
        step_s *= 0.5;
    }
    step_s
}

fn reading(time_s: f64, state: &State) -> Reading<1> {
    Reading { time_s, current_a: [state.current_a], speed_rad_s: [state.speed_rad_s] }
}

impl Plant {
    pub fn new(model: &Model, input: Input) -> Result<Self, ModelError> {
        let equations = Equations::new(model, input)?;
        let still = [[equations.a[0][0], 0.0], [0.0, 0.0]];
        let linear = equations.is_linear();
        Ok(Self {
            longest_step_s: longest_step_s(&equations, &RunScales::REFERENCE),
            least_step_s: 0.0,
            moving: Steps::new(&equations.a, !linear),
            stuck: Steps::new(&still, !linear),
            two_mass: equations
                .coupling
                .map(|coupling| Box::new(TwoMass::new(&coupling, &equations))),
            sensors: None,
            steep: Steep::default(),
            begin_s: 0.0,
            work: 0,
            trace: None,
            equations,
        })
    }

    pub const fn is_of_one_inertia(&self) -> bool {
        self.two_mass.is_none()
    }

    /// Keeps the sub-steps of the runs to come.
    #[must_use]
    pub fn traced(mut self) -> Self {
        self.trace = Some(Vec::new());
        self
    }

    /// The sub-steps of the last run, where they were kept.
    pub fn into_trace(self) -> Vec<SubStep> {
        self.trace.unwrap_or_default()
    }

    /// With sub-steps of `step_s` instead of the shorter ones for effects: for runs that are compared with each other, not with a
    /// measurement. The steps of a second inertia stay.
    #[must_use]
    pub fn coarse(mut self, step_s: f64) -> Self {
        if self.two_mass.is_none() {
            self.least_step_s = step_s;
        }
        self
    }

    /// Computing effort so far, in exact sub-steps of a linear machine.
    pub const fn work(&self) -> u64 {
        self.work
    }

    /// Step of the classical Runge-Kutta method for this plant, s, for programs without exact propagators: a quarter of the
    /// fastest time constant, with an error below 1e-5.
    pub fn runge_kutta_step_s(&mut self) -> f64 {
        self.equations.set_run(REFERENCE_SUPPLY_V, &RunScales::REFERENCE);
        let equations = &self.equations;
        let a = &equations.a;
        let electromechanical = (a[0][1] * a[1][0]).abs().sqrt();
        let path = &equations.path;
        let lags = [path.speed_filter_s, path.current_filter_s].into_iter();
        let lag = lags.filter(|tau| *tau > 0.0).map(f64::recip).fold(0.0, f64::max);
        let rate =
            a[0][0].abs() + electromechanical + lag + steep::fastest(equations, REFERENCE_SUPPLY_V);
        (0.25 / rate).min(RunScales::REFERENCE.responses(LONGEST_STEP_WITH_EFFECTS))
    }

    pub fn effect_states(&self) -> usize {
        self.equations.states
    }

    /// Simulates `scenario` from `start` (the state at its first input event) into `out`, whose memory is used again.
    pub fn simulate_into(&mut self, scenario: &Scenario, start: State, out: &mut Trajectory) {
        self.follow_into(scenario, start, out, |_, _, _| None);
    }

    /// Predictions over `horizon` samples: at the samples `first`, `first + horizon`, ... current and speed are set to the measured ones.
    /// A horizon of one gives one-step predictions. States of effects are those of the simulation.
    pub fn predict_ahead(
        &mut self,
        scenario: &Scenario,
        start: State,
        horizon: usize,
        first: usize,
    ) -> Trajectory {
        let mut out = Trajectory::default();
        let horizon = horizon.max(1);
        let first = first % horizon;
        let correct = |sample: usize, [current_a, speed_rad_s]: [f64; 2], _: &State| {
            (sample % horizon == first).then(|| Correction {
                current_a: scenario.current_a[sample] - current_a,
                speed_rad_s: scenario.speed_rad_s[sample] - speed_rad_s,
                ..Correction::default()
            })
        };
        self.follow_into(scenario, start, &mut out, correct);
        out
    }

    /// Simulates with corrections: after every sample `correct` gets the sample's number, the readings of the sensors and the
    /// state, and returns the correction. `out` has the predictions before each correction.
    pub fn follow_into(
        &mut self,
        scenario: &Scenario,
        start: State,
        out: &mut Trajectory,
        mut correct: impl FnMut(usize, [f64; 2], &State) -> Option<Correction>,
    ) {
        (self.equations.load_n_m, self.equations.extra_v) = (0.0, 0.0);
        self.trace.iter_mut().for_each(Vec::clear);
        out.current_a.clear();
        out.speed_rad_s.clear();
        self.moving.clear();
        self.stuck.clear();
        let mut state = start;
        if let Some(two_mass) = &mut self.two_mass {
            two_mass.start(&state);
        }
        let mut event = 0;
        let holes = scenario.unknown_input.iter();
        let restarts = holes.filter_map(|hole| Some((hole.to_s, hole.restart?)));
        let mut restarts = restarts.peekable();
        self.equations.set_path(scenario);
        let late_s = self.equations.path.command_delay_s;
        // A delayed command of a hole acts until after it: up to then the state is unknown.
        let unknown = restarts.clone().filter(|_| late_s > 0.0);
        let mut unknown = unknown.map(|(to_s, _)| to_s..to_s + late_s).peekable();
        let mut limits = scenario.limits.iter().peekable();
        let events =
            commands::applied(&scenario.events, &self.equations.path, scenario.scales.rest_s());
        self.begin_s = scenario.begin_s();
        self.equations.set_run(scenario.supply_v(), &scenario.scales);
        self.longest_step_s =
            longest_step_s(&self.equations, &scenario.scales).max(self.least_step_s);
        let most_v = largest(scenario.events.iter().map(|event| event.1));
        self.steep = Steep::of(&self.equations, self.longest_step_s, most_v);
        let mut now_s = self.begin_s;
        let angles = self.equations.needs_angle.then(|| scenario.shaft_angle());
        let mut angle = AngleTrack { points: angles.as_deref().unwrap_or_default(), next: 0 };
        self.sensors = (!self.equations.path.measures_directly())
            .then(|| Sensors::new(self.equations.path, reading(now_s, &state)));
        for (sample, &sample_s) in scenario.sample_time_s.iter().enumerate() {
            while now_s < sample_s {
                while event + 1 < events.len() && events[event + 1].0 <= now_s {
                    event += 1;
                }
                let mut next_s =
                    events.get(event + 1).map_or(sample_s, |next| next.0.min(sample_s));
                let mut input = events[event].1;
                while limits.next_if(|limit| limit.to_s <= now_s).is_some() {}
                if let Some(limit) = limits.peek()
                    && now_s >= limit.from_s + late_s
                    && let Some(rise_s) = self.rise_s(limit, input, &state, now_s)
                {
                    input = limit.command_v;
                    next_s = next_s.min(now_s + rise_s);
                }
                let restart = restarts.next_if(|restart| restart.0 <= next_s);
                if let Some((at_s, _)) = restart {
                    next_s = at_s.max(now_s);
                }
                let dt_s = next_s - now_s;
                self.advance(&mut state, now_s, dt_s, input, &mut angle);
                now_s = next_s;
                if let Some((_, measured)) = restart {
                    self.restart(&mut state, measured);
                }
            }
            if self.equations.input != Input::Voltage {
                let present = events.partition_point(|(time, _)| *time <= sample_s).max(1) - 1;
                state.current_a = events[present].1;
            }
            if unknown.peek().is_some_and(|interval| interval.start < sample_s) {
                let measured = [scenario.current_a[sample], scenario.speed_rad_s[sample]];
                self.restart(&mut state, measured);
                unknown.next_if(|interval| interval.end <= sample_s);
            }
            let readings = self.readings(&state);
            out.current_a.push(readings[0]);
            out.speed_rad_s.push(readings[1]);
            if let Some(sensors) = &mut self.sensors {
                sensors.begin_mean();
            }
            if let Some(change) = correct(sample, readings, &state) {
                self.correct(&mut state, change.current_a, change.speed_rad_s);
                self.equations.load_n_m = change.load_n_m;
                self.equations.extra_v = change.voltage_v;
            }
        }
    }

    /// Time for which the whole command acts before the current is within 0.1 % of its limit, at which the voltage is `limited_v`,
    /// s, at most the longest sub-step; `None` where it has reached it, or the drive has not started yet.
    fn rise_s(
        &self,
        limit: &LimitReached,
        limited_v: f64,
        state: &State,
        now_s: f64,
    ) -> Option<f64> {
        let direction = (limit.command_v - limited_v).signum();
        let missing_a = direction * (limit.current_a - state.current_a);
        if limited_v == 0.0 || missing_a <= 1e-3 * limit.current_a.abs() {
            return None;
        }
        let at = Instant {
            time_s: now_s - self.begin_s,
            voltage_v: limit.command_v,
            angle: self.equations.angle(state.angle_rad),
            ..Instant::default()
        };
        let rate = direction * self.equations.current_rate(state, &at);
        let rise_s = missing_a / rate;
        let most_s = self.longest_step_s;
        Some(if rate > 0.0 { rise_s.min(most_s) } else { most_s })
    }

    /// Changes the state, and the states of the sensors by as much, so that the readings change with it.
    fn correct(&mut self, state: &mut State, current_a: f64, speed_rad_s: f64) {
        if let Some(sensors) = &mut self.sensors {
            sensors.correct(&[current_a], &[speed_rad_s]);
        }
        if let Some(two_mass) = &mut self.two_mass {
            two_mass.correct(speed_rad_s);
        }
        state.correct(current_a, speed_rad_s);
    }

    fn readings(&self, state: &State) -> [f64; 2] {
        let direct = [state.current_a, state.speed_rad_s];
        self.sensors.as_ref().map_or(direct, |sensors| sensors.read().map(|[value]| value))
    }

    /// Continues from the measurement after a hole in the input.
    fn restart(&mut self, state: &mut State, [current_a, speed_rad_s]: [f64; 2]) {
        let readings = self.readings(state);
        self.correct(state, current_a - readings[0], speed_rad_s - readings[1]);
        // A load that had stopped or reversed in the simulation would load the shaft.
        if let Some(two_mass) = &mut self.two_mass {
            two_mass.start(state);
        }
    }

    pub fn simulate(&mut self, scenario: &Scenario, start: State) -> Trajectory {
        let mut out = Trajectory::default();
        self.simulate_into(scenario, start, &mut out);
        out
    }

    fn advance(
        &mut self,
        state: &mut State,
        now_s: f64,
        dt_s: f64,
        input: f64,
        angle: &mut AngleTrack<'_>,
    ) {
        // Tolerance for rounding: 1 ms in steps of 0.5 ms are two steps, not three.
        let (steps, h) = if dt_s <= self.longest_step_s * (1.0 + 1e-6) {
            (1, dt_s)
        } else {
            let steps = (dt_s / self.longest_step_s - 1e-6).ceil();
            (whole(steps), dt_s / steps)
        };
        for step in 0..steps {
            let begin_s = now_s + step as f64 * h;
            if let Some(measured) = angle.at(begin_s + 0.5 * h) {
                state.angle_rad = measured;
            }
            let at = Instant {
                time_s: begin_s - self.begin_s,
                voltage_v: input,
                angle: self.equations.angle(state.angle_rad),
                ..Instant::default()
            };
            let before = self.trace.is_some().then_some(*state);
            let settles = self.sensors.is_some() && self.equations.settles_within(h);
            let rate_a_per_s = settles.then(|| self.equations.current_rate(state, &at));
            let from_a = state.current_a;
            self.resolved_step(state, at, h);
            if let (Some(trace), Some(before)) = (&mut self.trace, before) {
                trace.push(SubStep {
                    begin_s,
                    length_s: h,
                    input,
                    from: [before.current_a, before.speed_rad_s],
                    to: [state.current_a, state.speed_rad_s],
                    directions: [before.direction(), state.direction()],
                });
            }
            if angle.is_empty() {
                state.angle_rad += state.speed_rad_s * h;
            }
            if let Some(sensors) = &mut self.sensors {
                let change_a = state.current_a - from_a;
                let transient =
                    rate_a_per_s.map(|rate| self.equations.transient(rate, change_a, h));
                sensors.follow_with(reading(begin_s + h, state), transient);
            }
        }
    }

    /// One sub-step, in shorter pieces where an effect is too steep for its length: each of these in its turn, so that the current is
    /// followed closely only where the effect is steep.
    #[inline]
    fn resolved_step(&mut self, state: &mut State, at: Instant, h: f64) {
        if self.steep.is_empty() {
            self.sub_step(state, at, h);
            return;
        }
        let begin = (*state, self.two_mass.as_ref().map(|shaft| shaft.load));
        self.sub_step(state, at, h);
        let pieces = self.steep.pieces(begin.0.current_a, state.current_a, h);
        if pieces == 1 {
            return;
        }
        *state = begin.0;
        if let (Some(two_mass), Some(load)) = (&mut self.two_mass, begin.1) {
            two_mass.load = load;
        }
        let piece_s = h / pieces as f64;
        for piece in 0..pieces {
            let at = Instant { time_s: at.time_s + piece as f64 * piece_s, ..at };
            self.resolved_step(state, at, piece_s);
        }
    }

    /// One sub-step with its mode changes.
    fn sub_step(&mut self, state: &mut State, mut at: Instant, h: f64) {
        if self.equations.input != Input::Voltage {
            state.current_a = at.voltage_v;
        }
        // Relative cost of a step, measured on runs with discontinuous current, cogging and an elastic shaft.
        self.work += match (&self.two_mass, self.equations.is_linear()) {
            (Some(_), _) => 20,
            (None, false) => 10,
            (None, true) => 1,
        };
        if let Some(two_mass) = &mut self.two_mass {
            two_mass.sub_step(&self.equations, state, at, h);
            return;
        }
        if state.mode == Mode::Undecided {
            state.mode = self.equations.mode_at(state, &at);
        }
        let mut remaining = h;
        // Each pass ends the sub-step or changes the mode at an event; more than four events in half a millisecond are a shaft
        // that comes to rest.
        for _ in 0..4 {
            let mode = state.mode;
            let next = self.trial(state, &at, remaining);
            if self.margin(&next, &at, mode) >= 0.0 {
                *state = next;
                return;
            }
            let cut = self.locate(state, &at, remaining, mode);
            *state = self.trial(state, &at, cut);
            state.speed_rad_s = 0.0;
            remaining -= cut;
            at.time_s += cut;
            state.mode = if mode == Mode::Stuck {
                Mode::towards(self.equations.driving_torque(state, &at))
            } else {
                self.equations.mode_at(state, &at)
            };
            if remaining <= 1e-9 * h {
                return;
            }
        }
        state.mode = Mode::Stuck;
        *state = self.trial(state, &at, remaining);
        state.speed_rad_s = 0.0;
    }

    /// Time within `[0, h]` at which the mode ends: the zero of the speed, or the breakaway.
    fn locate(&mut self, state: &State, at: &Instant, h: f64, mode: Mode) -> f64 {
        let margin = |plant: &mut Self, t: f64| {
            let next = plant.trial(state, at, t);
            plant.margin(&next, at, mode)
        };
        let at_begin = self.margin(state, at, mode);
        if at_begin <= 0.0 {
            return 0.0;
        }
        let at_end = margin(self, h);
        root::illinois((0.0, at_begin), (h, at_end), h, 20, |t| margin(self, t))
    }

    /// Event function: positive within the mode, zero at its end.
    #[inline]
    fn margin(&self, state: &State, at: &Instant, mode: Mode) -> f64 {
        match mode {
            Mode::Stuck => self.equations.stiction_margin(state, at),
            moving => state.speed_rad_s * moving.sign(),
        }
    }

    /// State after `h` if the mode does not change.
    #[inline]
    fn trial(&mut self, state: &State, at: &Instant, h: f64) -> State {
        if h <= 0.0 {
            return *state;
        }
        let is_stuck = state.mode == Mode::Stuck;
        let steps = if is_stuck { &mut self.stuck } else { &mut self.moving };
        let (step, equations) = (steps.over(h), &self.equations);
        let mut next = *state;
        let start = [state.current_a, state.speed_rad_s];
        let mut forcing = equations.forcing(state, at);
        if !equations.is_linear() {
            let mut middle = *state;
            [middle.current_a, middle.speed_rad_s] = step.half.apply(start, forcing);
            equations.advance_own(state, at, 0.5 * h, &mut middle.own);
            let centred = Instant { time_s: at.time_s + 0.5 * h, ..*at };
            forcing = equations.forcing(&middle, &centred);
            equations.advance_own(&middle, &centred, h, &mut next.own);
        }
        [next.current_a, next.speed_rad_s] = step.whole.apply(start, forcing);
        next
    }
}

/// Linear interpolation of the measured angle at ascending instants.
struct AngleTrack<'a> {
    points: &'a [(f64, f64)],
    next: usize,
}

impl AngleTrack<'_> {
    const fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    fn at(&mut self, time_s: f64) -> Option<f64> {
        let last = self.points.last()?;
        while self.next < self.points.len() && self.points[self.next].0 <= time_s {
            self.next += 1;
        }
        let before = self.next.checked_sub(1).map(|before| self.points[before]);
        Some(match (before, self.points.get(self.next)) {
            (Some(before), Some(after)) => {
                let share = (time_s - before.0) / (after.0 - before.0);
                before.1 + share * (after.1 - before.1)
            }
            (None, Some(first)) => first.1,
            (_, None) => last.1,
        })
    }
}

#[cfg(test)]
mod tests;
