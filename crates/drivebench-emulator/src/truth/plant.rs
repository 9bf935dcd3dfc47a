//! The true motor in time: armature circuit, torque balance, stick and slip.

use super::change::{Change, Changes};
use super::effect::{HiddenEffect, Mechanism, Moment, Site};
use super::shaft::Shaft;
use super::{MotorTruth, Path};

/// Stick, slip and reversal events that one step may hold before it is closed as stuck.
const EVENTS_PER_STEP: usize = 8;

/// What the inverter does at the motor's terminals over one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Terminals {
    /// Output voltage command, V: the motor gets it if the supply does not sag.
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

    /// Where a torque that is not zero turns a shaft that does not hold.
    const fn towards(torque: f64) -> Self {
        if torque > 0.0 { Self::Forward } else { Self::Backward }
    }
}

/// Current, speed and angle, and behind a coupling the load's speed and the twist; symbols of the literature: i, w, theta,
/// w2, x. Without a coupling the last two stay zero.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    i: f64,
    w: f64,
    theta: f64,
    w2: f64,
    x: f64,
}

impl State {
    fn moved(self, rate: &Self, h: f64) -> Self {
        Self {
            i: self.i + h * rate.i,
            w: self.w + h * rate.w,
            theta: self.theta + h * rate.theta,
            w2: self.w2 + h * rate.w2,
            x: self.x + h * rate.x,
        }
    }

    fn middle(self, other: Self) -> Self {
        Self {
            i: 0.5 * (self.i + other.i),
            w: 0.5 * (self.w + other.w),
            theta: 0.5 * (self.theta + other.theta),
            w2: 0.5 * (self.w2 + other.w2),
            x: 0.5 * (self.x + other.x),
        }
    }
}

/// The true machine. Its state changes only through [`Plant::advance`].
#[expect(clippy::struct_excessive_bools, reason = "each is a fault of its own")]
pub struct Plant {
    motor: MotorTruth,
    effects: Vec<Box<dyn Mechanism>>,
    shaft: Option<Shaft>,
    path: Path,
    bus_v: f64,
    state: State,
    /// Since the last start, s.
    time_s: f64,
    motion: Motion,
    /// Whether a shaft that is stuck has been so for any time: one that only passes zero speed has not.
    has_rested: bool,
    load_motion: Motion,
    terminal_v: f64,
    is_locked: bool,
    is_braked: bool,
    is_open: bool,
    changes: Changes,
}

impl Plant {
    /// A machine at rest, cold and without current, on a supply of its rated voltage.
    pub fn new(motor: MotorTruth, hidden: &[HiddenEffect]) -> Self {
        let site = Site { bus_v: motor.rated_voltage_v, motor, seed: 0 };
        Self::on_site(site, hidden)
    }

    /// A machine at rest, cold and without current.
    pub fn on_site(site: Site, hidden: &[HiddenEffect]) -> Self {
        Self {
            effects: hidden.iter().flat_map(|effect| effect.mechanisms(&site)).collect(),
            shaft: hidden.iter().find_map(|effect| effect.shaft(&site)),
            path: hidden.iter().fold(Path::default(), |path, effect| path.plus(effect.path(&site))),
            bus_v: site.bus_v,
            motor: site.motor,
            state: State::default(),
            time_s: 0.0,
            motion: Motion::Stuck,
            has_rested: true,
            load_motion: Motion::Stuck,
            terminal_v: 0.0,
            is_locked: false,
            is_braked: false,
            is_open: false,
            changes: Changes::new(Vec::new()),
        }
    }

    /// The same machine with a load that changes while the drive runs, in the order of the times.
    #[must_use]
    pub fn with_changes(mut self, changes: Vec<Change>) -> Self {
        self.changes = Changes::new(changes);
        self
    }

    /// The same machine with a shaft that cannot turn, or a circuit that is interrupted, or both.
    #[must_use]
    pub const fn broken(mut self, is_locked: bool, is_open: bool) -> Self {
        (self.is_locked, self.is_open) = (is_locked, is_open);
        self
    }

    /// A brake holds the shaft from now on, or lets it go: it is stronger than whatever turns.
    pub const fn brake(&mut self, holds: bool) {
        self.is_braked = holds;
        if holds {
            (self.state.w, self.motion) = (0.0, Motion::Stuck);
        }
    }

    /// The drive has been started: events and drifts count from here.
    pub const fn start(&mut self) {
        self.time_s = 0.0;
        self.changes.restart();
    }

    pub const fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Path from command to measurement, which the drive applies.
    pub const fn path(&self) -> &Path {
        &self.path
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

    pub fn bus_v(&self) -> f64 {
        self.bus_v * self.supply_factor()
    }

    pub const fn motion(&self) -> Motion {
        self.motion
    }

    pub fn winding_rise_k(&self) -> f64 {
        self.effects.iter().filter_map(|effect| effect.winding_rise_k()).sum()
    }

    /// Voltage to put out that brings the current to `target_a` within `step_s`, V: what a fast current limiter chops to.
    pub fn voltage_for_current(&self, target_a: f64, step_s: f64) -> f64 {
        let State { i, w, .. } = self.state;
        let mean = 0.5 * (i + target_a);
        let needed = self.inductance(mean) * (target_a - i) / step_s
            + self.resistance() * mean
            + self.motor.back_emf_v_s_per_rad * self.flux(&self.state) * w
            + self.voltage_loss(mean);
        needed / self.supply_factor()
    }

    /// Switches the terminals without letting time pass.
    pub fn hold(&mut self, terminals: Terminals) {
        self.terminal_v = self.voltage_at(terminals);
    }

    /// Advances by `step_s` with the terminals held; stick, slip and reversal are located inside the step.
    pub fn advance(&mut self, terminals: Terminals, step_s: f64) {
        self.changes.advance_to(self.time_s);
        let circuit = self.circuit(terminals);
        let before = self.state;
        let mut left = step_s;
        for event in 0..EVENTS_PER_STEP {
            let last = event + 1 == EVENTS_PER_STEP;
            let load_before = self.release_load();
            left -= match self.motion {
                Motion::Stuck => self.advance_stuck(circuit, left, last),
                Motion::Forward | Motion::Backward => self.advance_sliding(circuit, left),
            };
            self.hold_load(load_before);
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
        if !self.effects.is_empty() {
            let middle = self.moment(&before.middle(self.state));
            let put_out_v = match terminals {
                Terminals::Voltage(volts) => volts,
                Terminals::Open { .. } => self.terminal_v,
            };
            for effect in &mut self.effects {
                effect.advance(step_s, &middle, put_out_v);
            }
        }
        self.time_s += step_s;
    }

    fn voltage_at(&self, terminals: Terminals) -> f64 {
        match (terminals, self.state.i == 0.0) {
            (Terminals::Voltage(volts), _) => volts * self.supply_factor(),
            (Terminals::Open { .. }, true) => {
                self.motor.back_emf_v_s_per_rad * self.flux(&self.state) * self.state.w
            }
            (Terminals::Open { bus_v }, false) => -bus_v.copysign(self.state.i),
        }
    }

    /// Voltage in the armature circuit; `None` where the circuit is open and carries nothing.
    fn circuit(&self, terminals: Terminals) -> Option<f64> {
        match terminals {
            _ if self.is_open => None,
            Terminals::Voltage(volts) => Some(volts * self.supply_factor()),
            Terminals::Open { .. } if self.state.i == 0.0 => None,
            Terminals::Open { bus_v } => Some(-bus_v.copysign(self.state.i)),
        }
    }

    /// Net torque on a shaft at rest, N.m, and the friction that holds it without the extra breakaway torque.
    fn torque_at_rest(&self, state: &State) -> (f64, f64) {
        let at = self.moment(state);
        let (load, friction) = self.loads(&at);
        (at.torque_n_m - load - self.coupling_torque(state), (self.coulomb() + friction).max(0.0))
    }

    /// At rest the friction balances the drive torque up to the breakaway level. Returns the time used, s.
    fn advance_stuck(&mut self, circuit: Option<f64>, step_s: f64, give_up: bool) -> f64 {
        let extra: f64 = self.effects.iter().map(|effect| effect.breakaway_extra_n_m()).sum();
        let excess = |state: State| {
            let (driving, level) = self.torque_at_rest(&state);
            driving.abs() - level - extra
        };
        let start = self.state;
        let end = self.rk4(start, circuit, 0.0, step_s);
        if give_up
            || self.is_locked
            || self.is_braked
            || (excess(start) <= 0.0 && excess(end) <= 0.0)
        {
            self.state = end;
            self.has_rested = true;
            return step_s;
        }
        let used = if excess(start) > 0.0 {
            0.0
        } else {
            let used = locate(step_s, |h| excess(self.rk4(start, circuit, 0.0, h)));
            self.state = self.rk4(start, circuit, 0.0, used);
            self.has_rested = true;
            used
        };
        self.motion = Motion::towards(self.torque_at_rest(&self.state).0);
        if self.has_rested {
            for effect in &mut self.effects {
                effect.broke_away(self.motion.direction());
            }
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
            let used = locate(step_s, |h| -self.rk4(start, circuit, direction, h).w * direction);
            self.state = self.rk4(start, circuit, direction, used);
            used
        } else {
            0.0
        };
        self.state.w = 0.0;
        // Whether it holds or goes through is for the stuck mode to say.
        self.motion = Motion::Stuck;
        self.has_rested = false;
        used
    }

    /// The load behind a coupling breaks away where the coupling pulls harder than its friction holds. Returns its mode
    /// for the step that follows.
    fn release_load(&mut self) -> Motion {
        if let Some(shaft) = &self.shaft
            && self.load_motion == Motion::Stuck
        {
            let pull = self.coupling_torque(&self.state);
            if pull.abs() > shaft.friction_split * self.motor.load_torque_n_m {
                self.load_motion = Motion::towards(pull);
            }
        }
        self.load_motion
    }

    /// The load has come to rest where its speed has changed sign within the step. It is not located further: at 50 us the
    /// speed that is lost is some mrad/s.
    fn hold_load(&mut self, moved: Motion) {
        if self.shaft.is_some() && self.state.w2 * moved.direction() < 0.0 {
            self.state.w2 = 0.0;
            self.load_motion = Motion::Stuck;
        }
    }

    /// One Runge-Kutta step of fourth order in a fixed mode.
    fn rk4(&self, state: State, circuit: Option<f64>, direction: f64, h: f64) -> State {
        let mut rate = State::default();
        let mut end = state;
        for (ahead, part) in [(0.0, 6.0), (0.5, 3.0), (0.5, 3.0), (1.0, 6.0)] {
            rate = self.rate(&state.moved(&rate, ahead * h), circuit, direction);
            end = end.moved(&rate, h / part);
        }
        end
    }

    /// L di/dt = u - R i - phi Ke w - losses, J dw/dt = phi Kt i - friction s - drag - load, with s the direction of the
    /// mode. Behind a coupling J is the motor's part, and J2 dw2/dt = T - friction s2, dx/dt = w - w2.
    #[inline]
    fn rate(&self, state: &State, circuit: Option<f64>, direction: f64) -> State {
        let State { i, w, w2, .. } = *state;
        let motor = &self.motor;
        let at = self.moment(state);
        let di = circuit.map_or(0.0, |u| {
            let back_emf = motor.back_emf_v_s_per_rad * at.flux_factor * w;
            (u - self.resistance() * i - back_emf - self.voltage_loss(i)) / self.inductance(i)
        });
        let coupled = self.coupling_torque(state);
        let (dw2, dx) = self.shaft.as_ref().map_or((0.0, 0.0), |shaft| {
            let s2 = self.load_motion.direction();
            let level = shaft.friction_split * motor.load_torque_n_m;
            let torque = (coupled - level * s2) * s2.abs();
            (torque / (shaft.load_share * self.inertia(&at)), w - w2)
        });
        let mut rate = State { i: di, w: 0.0, theta: 0.0, w2: dw2, x: dx };
        if direction != 0.0 {
            let (load, friction) = self.loads(&at);
            let drag: f64 = self.effects.iter().map(|effect| effect.drag_torque_n_m(w)).sum();
            let held = (self.coulomb() + friction).max(0.0) * direction;
            let share = self.shaft.as_ref().map_or(1.0, |shaft| shaft.motor_share);
            rate.w = (at.torque_n_m - held - drag - load - coupled) / (share * self.inertia(&at));
            rate.theta = w;
        }
        rate
    }

    /// Arguments of the effects at a state.
    #[inline]
    fn moment(&self, state: &State) -> Moment {
        let mut at = Moment {
            time_s: self.time_s,
            current_a: state.i,
            speed_rad_s: state.w,
            angle_rad: state.theta,
            flux_factor: 0.0,
            torque_n_m: 0.0,
        };
        at.flux_factor = self.effects.iter().map(|effect| effect.flux_factor(&at)).product();
        at.torque_n_m = self.motor.torque_constant() * at.flux_factor * state.i;
        at
    }

    /// Torque from outside and friction beyond Coulomb, N.m.
    fn loads(&self, at: &Moment) -> (f64, f64) {
        let pull = self.changes.now().load_n_m;
        self.effects.iter().fold((pull, 0.0), |(load, friction), effect| {
            (load + effect.load_torque_n_m(at), friction + effect.friction_n_m(at))
        })
    }

    /// Coulomb friction at the motor's own shaft, N.m.
    fn coulomb(&self) -> f64 {
        let behind = self.shaft.as_ref().map_or(0.0, |shaft| shaft.friction_split);
        (1.0 - behind) * self.motor.load_torque_n_m
    }

    /// Torque that the coupling takes from the motor, N.m.
    fn coupling_torque(&self, state: &State) -> f64 {
        self.shaft.as_ref().map_or(0.0, |shaft| shaft.torque_n_m(state.x, state.w - state.w2))
    }

    fn flux(&self, state: &State) -> f64 {
        self.moment(state).flux_factor
    }

    fn resistance(&self) -> f64 {
        let factors = self.effects.iter().map(|effect| effect.resistance_factor());
        self.motor.resistance_ohm * factors.product::<f64>()
    }

    fn inductance(&self, i: f64) -> f64 {
        let factors = self.effects.iter().map(|effect| effect.inductance_factor(i));
        self.motor.inductance_h * factors.product::<f64>()
    }

    fn inertia(&self, at: &Moment) -> f64 {
        let factors = self.effects.iter().map(|effect| effect.inertia_factor(at));
        self.changes.now().inertia_ratio * self.motor.inertia_kg_m2 * factors.product::<f64>()
    }

    fn supply_factor(&self) -> f64 {
        self.effects.iter().map(|effect| effect.supply_factor()).product()
    }

    fn voltage_loss(&self, i: f64) -> f64 {
        self.effects.iter().map(|effect| effect.voltage_loss_v(i)).sum()
    }
}

/// The time in `0..=step_s` at which `rising`, not positive at 0 and positive at the end, becomes positive.
fn locate(step_s: f64, rising: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (0.0, step_s);
    // Halvings by which an event is located: a step of 50 us to below a femtosecond.
    for _ in 0..48 {
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
