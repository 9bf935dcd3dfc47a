//! The true motor in time: armature circuit, torque balance, stick and slip.

use super::MotorTruth;
use super::effect::{HiddenEffect, Mechanism};

/// Stick, slip and reversal events that one step may hold before it is closed as stuck.
const EVENTS_PER_STEP: usize = 8;
/// Halvings by which an event is located: a step of 50 us to below a femtosecond.
const EVENT_ITERATIONS: usize = 48;

/// What the inverter does at the motor's terminals over one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Terminals {
    /// Holds this voltage, V.
    Voltage(f64),
    /// Switches off: the diodes drive the current to zero against this bus voltage, V; then the circuit is open.
    Open { bus_v: f64 },
}

/// The shaft's mode: its friction is known in each, there is no sign function to chatter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    Stuck,
    Forward,
    Backward,
}

impl Motion {
    const fn direction(self) -> f64 {
        match self {
            Self::Stuck => 0.0,
            Self::Forward => 1.0,
            Self::Backward => -1.0,
        }
    }
}

/// Current, speed and angle; symbols of the literature: i, w, theta.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    i: f64,
    w: f64,
    theta: f64,
}

impl State {
    fn moved(self, rate: Self, h: f64) -> Self {
        Self {
            i: self.i + h * rate.i,
            w: self.w + h * rate.w,
            theta: self.theta + h * rate.theta,
        }
    }
}

/// The true machine. Its state changes only through [`Plant::advance`].
pub struct Plant {
    motor: MotorTruth,
    effects: Vec<Box<dyn Mechanism>>,
    state: State,
    motion: Motion,
    terminal_v: f64,
    is_locked: bool,
    is_open: bool,
}

impl Plant {
    /// A machine at rest, cold and without current.
    pub fn new(motor: MotorTruth, hidden: &[HiddenEffect]) -> Self {
        let effects = hidden.iter().map(|effect| effect.build(&motor)).collect();
        Self {
            motor,
            effects,
            state: State::default(),
            motion: Motion::Stuck,
            terminal_v: 0.0,
            is_locked: false,
            is_open: false,
        }
    }

    /// The same machine with a shaft that cannot turn, or a circuit that is interrupted, or both.
    #[must_use]
    pub const fn broken(mut self, is_locked: bool, is_open: bool) -> Self {
        (self.is_locked, self.is_open) = (is_locked, is_open);
        self
    }

    pub const fn current_a(&self) -> f64 {
        self.state.i
    }

    pub const fn speed_rad_s(&self) -> f64 {
        self.state.w
    }

    /// Unwrapped.
    pub const fn angle_rad(&self) -> f64 {
        self.state.theta
    }

    /// Voltage between the terminals, V: what a voltmeter there reads.
    pub const fn terminal_v(&self) -> f64 {
        self.terminal_v
    }

    pub const fn motion(&self) -> Motion {
        self.motion
    }

    /// Rise of the winding over ambient, K.
    pub fn winding_rise_k(&self) -> f64 {
        self.effects
            .iter()
            .filter_map(|effect| effect.winding_rise_k())
            .sum()
    }

    /// Voltage that brings the current to `target_a` within `step_s`, V: what a fast current limiter chops to.
    pub fn voltage_for_current(&self, target_a: f64, step_s: f64) -> f64 {
        let State { i, w, .. } = self.state;
        let mean = 0.5 * (i + target_a);
        self.motor.inductance_h * (target_a - i) / step_s
            + self.resistance() * mean
            + self.motor.back_emf_v_s_per_rad * w
            + self.voltage_loss(mean)
    }

    /// Switches the terminals without letting time pass.
    pub fn hold(&mut self, terminals: Terminals) {
        self.terminal_v = self.voltage_at(terminals);
    }

    /// Advances by `step_s` with the terminals held; stick, slip and reversal are located inside the step.
    pub fn advance(&mut self, terminals: Terminals, step_s: f64) {
        let circuit = self.circuit(terminals);
        let before = self.state;
        let mut left = step_s;
        for event in 0..EVENTS_PER_STEP {
            let last = event + 1 == EVENTS_PER_STEP;
            left -= match self.motion {
                Motion::Stuck => self.advance_stuck(circuit, left, last),
                Motion::Forward | Motion::Backward => self.advance_sliding(circuit, left),
            };
            if left <= 0.0 {
                break;
            }
        }
        if let Terminals::Open { .. } = terminals
            && before.i * self.state.i <= 0.0
        {
            // The diodes block once the current has reached zero.
            self.state.i = 0.0;
        }
        self.terminal_v = self.voltage_at(terminals);
        let (i, w) = (
            0.5 * (before.i + self.state.i),
            0.5 * (before.w + self.state.w),
        );
        for effect in &mut self.effects {
            effect.advance(step_s, i, w);
        }
    }

    fn voltage_at(&self, terminals: Terminals) -> f64 {
        match (terminals, self.state.i == 0.0) {
            (Terminals::Voltage(volts), _) => volts,
            (Terminals::Open { .. }, true) => self.motor.back_emf_v_s_per_rad * self.state.w,
            (Terminals::Open { bus_v }, false) => -bus_v.copysign(self.state.i),
        }
    }

    /// Voltage in the armature circuit; `None` where the circuit is open and carries nothing.
    fn circuit(&self, terminals: Terminals) -> Option<f64> {
        match terminals {
            _ if self.is_open => None,
            Terminals::Voltage(volts) => Some(volts),
            Terminals::Open { .. } if self.state.i == 0.0 => None,
            Terminals::Open { bus_v } => Some(-bus_v.copysign(self.state.i)),
        }
    }

    /// At rest the friction balances the drive torque up to the breakaway level. Returns the time used, s.
    fn advance_stuck(&mut self, circuit: Option<f64>, step_s: f64, give_up: bool) -> f64 {
        let level = self.motor.load_torque_n_m
            + self
                .effects
                .iter()
                .map(|effect| effect.breakaway_extra_n_m())
                .sum::<f64>();
        let kt = self.motor.torque_constant();
        let excess = |state: State| (kt * state.i).abs() - level;
        let start = self.state;
        let end = self.rk4(start, circuit, 0.0, step_s);
        if give_up || self.is_locked || (excess(start) <= 0.0 && excess(end) <= 0.0) {
            self.state = end;
            return step_s;
        }
        let used = if excess(start) > 0.0 {
            0.0
        } else {
            let used = locate(step_s, |h| excess(self.rk4(start, circuit, 0.0, h)));
            self.state = self.rk4(start, circuit, 0.0, used);
            used
        };
        self.motion = if self.state.i > 0.0 {
            Motion::Forward
        } else {
            Motion::Backward
        };
        for effect in &mut self.effects {
            effect.broke_away(self.motion.direction());
        }
        used
    }

    /// Slides in one direction until the step ends or the speed reaches zero. Returns the time used, s.
    fn advance_sliding(&mut self, circuit: Option<f64>, step_s: f64) -> f64 {
        let direction = self.motion.direction();
        let start = self.state;
        let end = self.rk4(start, circuit, direction, step_s);
        if end.w * direction > 0.0 {
            self.state = end;
            return step_s;
        }
        let used = if start.w * direction > 0.0 {
            let used = locate(step_s, |h| {
                -self.rk4(start, circuit, direction, h).w * direction
            });
            self.state = self.rk4(start, circuit, direction, used);
            used
        } else {
            0.0
        };
        self.state.w = 0.0;
        // Whether it holds or goes through is for the stuck mode to say.
        self.motion = Motion::Stuck;
        used
    }

    /// One Runge-Kutta step of fourth order in a fixed mode.
    fn rk4(&self, state: State, circuit: Option<f64>, direction: f64, h: f64) -> State {
        let k1 = self.rate(state, circuit, direction);
        let k2 = self.rate(state.moved(k1, 0.5 * h), circuit, direction);
        let k3 = self.rate(state.moved(k2, 0.5 * h), circuit, direction);
        let k4 = self.rate(state.moved(k3, h), circuit, direction);
        state
            .moved(k1, h / 6.0)
            .moved(k2, h / 3.0)
            .moved(k3, h / 3.0)
            .moved(k4, h / 6.0)
    }

    /// L di/dt = u - R i - Ke w - losses, J dw/dt = Kt i - Mc s - drag, with s the direction of the mode.
    fn rate(&self, state: State, circuit: Option<f64>, direction: f64) -> State {
        let State { i, w, .. } = state;
        let motor = &self.motor;
        let di = circuit.map_or(0.0, |u| {
            (u - self.resistance() * i - motor.back_emf_v_s_per_rad * w - self.voltage_loss(i))
                / motor.inductance_h
        });
        if direction == 0.0 {
            return State {
                i: di,
                w: 0.0,
                theta: 0.0,
            };
        }
        let drag: f64 = self
            .effects
            .iter()
            .map(|effect| effect.drag_torque_n_m(w))
            .sum();
        let torque = motor.torque_constant() * i - motor.load_torque_n_m * direction - drag;
        State {
            i: di,
            w: torque / motor.inertia_kg_m2,
            theta: w,
        }
    }

    fn resistance(&self) -> f64 {
        self.motor.resistance_ohm
            * self
                .effects
                .iter()
                .map(|effect| effect.resistance_factor())
                .product::<f64>()
    }

    fn voltage_loss(&self, i: f64) -> f64 {
        self.effects
            .iter()
            .map(|effect| effect.voltage_loss_v(i))
            .sum()
    }
}

/// The time in `0..=step_s` at which `rising`, not positive at 0 and positive at the end, becomes positive.
fn locate(step_s: f64, rising: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (0.0, step_s);
    for _ in 0..EVENT_ITERATIONS {
        let middle = 0.5 * (low + high);
        if rising(middle) > 0.0 {
            high = middle;
        } else {
            low = middle;
        }
    }
    high
}

#[cfg(test)]
#[path = "plant_tests.rs"]
mod tests;
