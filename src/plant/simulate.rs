//! Free run of a model: exact zero-order hold where it is linear, true stick-slip, no chatter.
//!
//! Motion has three modes: stuck, forward, backward. The sign of the friction comes from the mode, never from a noisy
//! or vanishing speed. A zero crossing inside a step is located and the step is cut there; the shaft then sticks if the
//! driving torque is within the friction level, else it goes on in the direction of the net torque.
//!
//! Between events the linear part is propagated exactly. Effects enter as a forcing that is evaluated at the middle of
//! a sub-step (exponential midpoint rule, second order), so that a stiff armature circuit needs no small steps.

use super::effect::{Instant, Terms};
use super::model::{Model, ModelError};
use super::motor::MotorKey;
use super::propagator::{M2, Propagator};
use super::scenario::{Input, Scenario};
use crate::numerics::count::whole;

/// Longest sub-step with effects, s: drops at current reversals and Stribeck humps are resolved.
const LONGEST_STEP_WITH_EFFECTS_S: f64 = 5e-4;
/// Longest sub-step of the bare baseline, s: exact within, but a reversal must not hide inside.
const LONGEST_STEP_S: f64 = 5e-3;
/// States that all effects of one model may have together.
const MOST_STATES: usize = 4;

/// State of motor and effects.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    pub current_a: f64,
    pub speed_rad_s: f64,
    pub angle_rad: f64,
    own: [f64; MOST_STATES],
    mode: Mode,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Mode {
    #[default]
    Undecided,
    Stuck,
    Forward,
    Backward,
}

impl Mode {
    const fn sign(self) -> f64 {
        match self {
            Self::Forward => 1.0,
            Self::Backward => -1.0,
            Self::Stuck | Self::Undecided => 0.0,
        }
    }
}

impl State {
    pub fn at(current_a: f64, speed_rad_s: f64) -> Self {
        Self {
            current_a,
            speed_rad_s,
            ..Self::default()
        }
    }

    /// The same state with the states of the effects at these values, as a winding that is warm already.
    #[must_use]
    pub fn with_effects(mut self, own: &[f64]) -> Self {
        for (state, value) in self.own.iter_mut().zip(own) {
            *state = *value;
        }
        self
    }

    /// Takes over what was measured; the mode of motion follows from it.
    fn anchor(&mut self, current_a: f64, speed_rad_s: f64) {
        if current_a.is_finite() {
            self.current_a = current_a;
        }
        if speed_rad_s.is_finite() {
            self.speed_rad_s = speed_rad_s;
            self.mode = Mode::Undecided;
        }
    }
}

/// A simulated run at the scenario's sample times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    pub current_a: Vec<f64>,
    pub speed_rad_s: Vec<f64>,
}

/// A model made ready for simulation: numbers only.
pub struct Plant {
    resistance_ohm: f64,
    torque_constant: f64,
    inertia: f64,
    coulomb: f64,
    input: Input,
    /// Linear part: `d/dt [i, w] = A [i, w] + forcing`.
    a: M2,
    /// Forcing per volt.
    per_volt: f64,
    terms: Vec<Box<dyn Terms>>,
    longest_step_s: f64,
    whole: Propagator,
    half: Propagator,
    /// Propagators while stuck: the current alone.
    stuck: Propagator,
    stuck_half: Propagator,
}

impl Plant {
    /// Compiles a complete model for one kind of input.
    pub fn new(model: &Model, input: Input) -> Result<Self, ModelError> {
        let value = |key: MotorKey| {
            model.motor.get(key).ok_or_else(|| ModelError::Unset {
                key: key.key().to_owned(),
            })
        };
        let inertia = value(MotorKey::Inertia)?;
        let (resistance_ohm, torque_constant, a, per_volt) = match input {
            Input::Voltage => {
                let (r, l, ke) = (
                    value(MotorKey::Resistance)?,
                    value(MotorKey::Inductance)?,
                    value(MotorKey::BackEmf)?,
                );
                let kt = model.motor.torque_constant().unwrap_or(ke);
                (r, kt, [[-r / l, -ke / l], [kt / inertia, 0.0]], 1.0 / l)
            }
            Input::Current => {
                let kt = model
                    .motor
                    .torque_constant()
                    .ok_or_else(|| ModelError::Unset {
                        key: MotorKey::TorqueConstant.key().to_owned(),
                    })?;
                (0.0, kt, [[0.0, 0.0], [kt / inertia, 0.0]], 0.0)
            }
            Input::Torque => (0.0, 1.0, [[0.0, 0.0], [1.0 / inertia, 0.0]], 0.0),
        };
        let terms: Vec<Box<dyn Terms>> = model
            .effects
            .iter()
            .map(|active| active.effect.terms(&active.values_or_guess()))
            .collect();
        let longest_step_s = if terms.is_empty() {
            LONGEST_STEP_S
        } else {
            LONGEST_STEP_WITH_EFFECTS_S
        };
        Ok(Self {
            resistance_ohm,
            torque_constant,
            inertia,
            coulomb: value(MotorKey::LoadTorque)?,
            input,
            a,
            per_volt,
            terms,
            longest_step_s,
            whole: Propagator::default(),
            half: Propagator::default(),
            stuck: Propagator::default(),
            stuck_half: Propagator::default(),
        })
    }

    /// Number of states of all effects together.
    pub fn effect_states(&self) -> usize {
        self.terms.iter().map(|terms| terms.states()).sum()
    }

    /// Simulates `scenario` from `start` (the state at its first input event) into `out`, whose memory is used again.
    pub fn simulate_into(&mut self, scenario: &Scenario, start: State, out: &mut Trajectory) {
        self.run(scenario, start, None, out);
    }

    /// Predictions over short horizons: after every `horizon` samples the current and speed are set to the measured
    /// ones. A horizon of one gives one-step predictions. States of effects go on from the simulation.
    pub fn predict_ahead(
        &mut self,
        scenario: &Scenario,
        start: State,
        horizon: usize,
    ) -> Trajectory {
        let mut out = Trajectory::default();
        self.run(scenario, start, Some(horizon.max(1)), &mut out);
        out
    }

    fn run(
        &mut self,
        scenario: &Scenario,
        start: State,
        horizon: Option<usize>,
        out: &mut Trajectory,
    ) {
        out.current_a.clear();
        out.speed_rad_s.clear();
        let mut state = start;
        let mut event = 0;
        let mut now_s = scenario.events[0].0;
        let mut angle = AngleTrack::new(&scenario.angle);
        for (sample, &sample_s) in scenario.sample_time_s.iter().enumerate() {
            while now_s < sample_s {
                while event + 1 < scenario.events.len() && scenario.events[event + 1].0 <= now_s {
                    event += 1;
                }
                let next_s = scenario
                    .events
                    .get(event + 1)
                    .map_or(sample_s, |next| next.0.min(sample_s));
                self.advance(
                    &mut state,
                    now_s,
                    next_s - now_s,
                    scenario.events[event].1,
                    &mut angle,
                );
                now_s = next_s;
            }
            if self.input != Input::Voltage {
                let held = scenario
                    .events
                    .partition_point(|(time, _)| *time <= sample_s)
                    .max(1)
                    - 1;
                state.current_a = scenario.events[held].1;
            }
            out.current_a.push(state.current_a);
            out.speed_rad_s.push(state.speed_rad_s);
            if horizon.is_some_and(|horizon| sample % horizon == 0) {
                state.anchor(scenario.current_a[sample], scenario.speed_rad_s[sample]);
            }
        }
    }

    /// Simulates `scenario` from `start`.
    pub fn simulate(&mut self, scenario: &Scenario, start: State) -> Trajectory {
        let mut out = Trajectory::default();
        self.simulate_into(scenario, start, &mut out);
        out
    }

    /// Advances by `dt_s` under a constant input.
    fn advance(
        &mut self,
        state: &mut State,
        now_s: f64,
        dt_s: f64,
        input: f64,
        angle: &mut AngleTrack<'_>,
    ) {
        // A hair of slack: 1 ms split into steps of 0.5 ms must not become three because of rounding.
        let steps = (dt_s / self.longest_step_s - 1e-6).ceil().max(1.0);
        let h = dt_s / steps;
        for step in 0..whole(steps) {
            let begin_s = now_s + step as f64 * h;
            if let Some(measured) = angle.at(begin_s + 0.5 * h) {
                state.angle_rad = measured;
            }
            let at = Instant {
                time_s: begin_s,
                voltage_v: input,
                ..Instant::default()
            };
            self.sub_step(state, at, h);
            if angle.is_empty() {
                state.angle_rad += state.speed_rad_s * h;
            }
        }
    }

    /// One sub-step with its mode changes.
    fn sub_step(&mut self, state: &mut State, mut at: Instant, h: f64) {
        if self.input != Input::Voltage {
            state.current_a = at.voltage_v;
        }
        if state.mode == Mode::Undecided {
            state.mode = self.mode_at(state, &at);
        }
        let mut left = h;
        // Each pass ends the sub-step or changes the mode at an event; more than a few events in half a millisecond
        // are a shaft that is coming to rest.
        for _ in 0..4 {
            let mode = state.mode;
            let next = self.trial(state, &at, left);
            let passed = if mode == Mode::Stuck {
                self.driving_torque(&next, &at).abs() <= self.friction(&next, &at)
            } else {
                next.speed_rad_s * mode.sign() >= 0.0
            };
            if passed {
                *state = next;
                return;
            }
            let cut = self.locate(state, &at, left, mode);
            *state = self.trial(state, &at, cut);
            state.speed_rad_s = 0.0;
            left -= cut;
            at.time_s += cut;
            state.mode = if mode == Mode::Stuck {
                if self.driving_torque(state, &at) > 0.0 {
                    Mode::Forward
                } else {
                    Mode::Backward
                }
            } else {
                self.mode_at(state, &at)
            };
            if left <= 1e-9 * h {
                return;
            }
        }
        state.mode = Mode::Stuck;
        let mut rest = self.trial(state, &at, left);
        rest.speed_rad_s = 0.0;
        *state = rest;
    }

    /// Time within `(0, h]` at which the mode ends: the zero of the speed, or the moment of breaking away.
    /// Bisection guarded secant (Illinois); a few evaluations at each of the rare events.
    fn locate(&mut self, state: &State, at: &Instant, h: f64, mode: Mode) -> f64 {
        let margin = |plant: &mut Self, t: f64| {
            let there = plant.trial(state, at, t);
            if mode == Mode::Stuck {
                plant.friction(&there, at) - plant.driving_torque(&there, at).abs()
            } else {
                there.speed_rad_s * mode.sign()
            }
        };
        let (mut low, mut high) = (0.0, h);
        let mut at_low = if mode == Mode::Stuck {
            self.friction(state, at) - self.driving_torque(state, at).abs()
        } else {
            state.speed_rad_s * mode.sign()
        };
        if at_low <= 0.0 {
            return 0.0;
        }
        let mut at_high = margin(self, h);
        let mut last_was_low = None;
        for _ in 0..20 {
            let t = (low * at_high - high * at_low) / (at_high - at_low);
            let there = margin(self, t);
            if there.abs() < 1e-12 || high - low < 1e-9 * h {
                return t;
            }
            // An end that stays twice in a row is weighted down, else the secant would creep.
            let is_low = there > 0.0;
            if is_low {
                (low, at_low) = (t, there);
            } else {
                (high, at_high) = (t, there);
            }
            if last_was_low == Some(is_low) {
                if is_low {
                    at_high *= 0.5;
                } else {
                    at_low *= 0.5;
                }
            }
            last_was_low = Some(is_low);
        }
        high
    }

    /// State after `h` if the mode stays as it is.
    fn trial(&mut self, state: &State, at: &Instant, h: f64) -> State {
        if h <= 0.0 {
            return *state;
        }
        let is_stuck = state.mode == Mode::Stuck;
        self.prepare(h, is_stuck);
        let (whole, half) = if is_stuck {
            (self.stuck, self.stuck_half)
        } else {
            (self.whole, self.half)
        };
        let mut next = *state;
        let start = [state.current_a, state.speed_rad_s];
        let forcing = self.forcing(state, at);
        let end = if self.terms.is_empty() {
            whole.apply(start, forcing)
        } else {
            let mut middle = *state;
            let x = half.apply(start, forcing);
            (middle.current_a, middle.speed_rad_s) = (x[0], x[1]);
            self.advance_own(state, at, 0.5 * h, &mut middle.own);
            let centred = Instant {
                time_s: at.time_s + 0.5 * h,
                ..*at
            };
            let forcing = self.forcing(&middle, &centred);
            self.advance_own(&middle, &centred, h, &mut next.own);
            whole.apply(start, forcing)
        };
        (next.current_a, next.speed_rad_s) = (end[0], end[1]);
        next
    }

    /// Forcing of the linear part: input and effects, in A/s and rad/s2.
    fn forcing(&self, state: &State, at: &Instant) -> [f64; 2] {
        let here = instant(state, at);
        let (mut volts, mut torque, mut level) = (at.voltage_v, 0.0, self.coulomb);
        let mut own = &state.own[..];
        for terms in &self.terms {
            volts -= terms.voltage_v(&here, own, self.resistance_ohm);
            torque += terms.torque_n_m(&here, own);
            level += terms.friction_n_m(&here);
            own = &own[terms.states()..];
        }
        let acceleration = match state.mode {
            Mode::Stuck | Mode::Undecided => 0.0,
            moving => -(torque + moving.sign() * level.max(0.0)) / self.inertia,
        };
        [volts * self.per_volt, acceleration]
    }

    /// Torque that would move the shaft, friction left out.
    fn driving_torque(&self, state: &State, at: &Instant) -> f64 {
        let here = instant(state, at);
        let mut own = &state.own[..];
        let mut torque = self.torque_constant * state.current_a;
        for terms in &self.terms {
            torque -= terms.torque_n_m(&here, own);
            own = &own[terms.states()..];
        }
        torque
    }

    fn friction(&self, state: &State, at: &Instant) -> f64 {
        let here = instant(state, at);
        let added: f64 = self
            .terms
            .iter()
            .map(|terms| terms.friction_n_m(&here))
            .sum();
        (self.coulomb + added).max(0.0)
    }

    fn mode_at(&self, state: &State, at: &Instant) -> Mode {
        let direction = if state.speed_rad_s == 0.0 {
            self.driving_torque(state, at)
        } else {
            state.speed_rad_s
        };
        if state.speed_rad_s == 0.0 && direction.abs() <= self.friction(state, at) {
            Mode::Stuck
        } else if direction > 0.0 {
            Mode::Forward
        } else {
            Mode::Backward
        }
    }

    fn advance_own(&self, from: &State, at: &Instant, h: f64, to: &mut [f64; MOST_STATES]) {
        let here = instant(from, at);
        let mut first = 0;
        for terms in &self.terms {
            let states = terms.states();
            if states == 0 {
                continue;
            }
            let mut rates = [0.0; MOST_STATES];
            terms.derivative(
                &here,
                &from.own[first..first + states],
                &mut rates[..states],
            );
            for (offset, rate) in rates[..states].iter().enumerate() {
                to[first + offset] += h * rate;
            }
            first += states;
        }
    }

    fn prepare(&mut self, h: f64, stuck: bool) {
        // Stamps that differ by rounding share one propagator.
        let same = |p: &Propagator| (p.interval_s - h).abs() <= 1e-12 * h;
        if stuck && !same(&self.stuck) {
            let still = [[self.a[0][0], 0.0], [0.0, 0.0]];
            self.stuck = Propagator::new(&still, h);
            self.stuck_half = Propagator::new(&still, 0.5 * h);
        } else if !stuck && !same(&self.whole) {
            self.whole = Propagator::new(&self.a, h);
            self.half = Propagator::new(&self.a, 0.5 * h);
        }
    }
}

fn instant(state: &State, at: &Instant) -> Instant {
    Instant {
        current_a: state.current_a,
        speed_rad_s: state.speed_rad_s,
        angle_rad: state.angle_rad,
        ..*at
    }
}

/// Linear interpolation of the measured angle, walked forward only.
struct AngleTrack<'a> {
    points: &'a [(f64, f64)],
    next: usize,
}

impl<'a> AngleTrack<'a> {
    const fn new(points: &'a [(f64, f64)]) -> Self {
        Self { points, next: 0 }
    }

    const fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    fn at(&mut self, time_s: f64) -> Option<f64> {
        let last = self.points.last()?;
        while self.next < self.points.len() && self.points[self.next].0 <= time_s {
            self.next += 1;
        }
        Some(
            match (self.next.checked_sub(1), self.points.get(self.next)) {
                (Some(before), Some(after)) => {
                    let before = self.points[before];
                    let share = (time_s - before.0) / (after.0 - before.0);
                    before.1 + share * (after.1 - before.1)
                }
                (None, Some(first)) => first.1,
                (_, None) => last.1,
            },
        )
    }
}

#[cfg(test)]
mod tests;
