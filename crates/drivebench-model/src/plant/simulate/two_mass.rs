//! Two-mass system with an elastic shaft, with or without backlash (Nordin and Gutman,
//! *Automatica* 38, 2002): motor and speed sensor on one side, the load on the other.
//!
//! ```text
//! current -> J1: w, stiction, effects  --T = k z(twist) + d (w - w2)-->  J2: w2, stiction
//! ```
//!
//! Each side sticks or slides in a direction, the shaft is in contact on one side or within its play: a hybrid automaton, linear
//! and propagated exactly between changes of its modes. A change within a step is located and the step is cut there, so that
//! the result is a smooth function of the parameters.
//!
//! For the four linear states (`dx/dt = A x + g`) the power series needs a few products with a sparse `A`. A length beyond its range
//! is a sum of that range times powers of two, for which matrices (`x(t) = Phi x(0) + Gamma g`) come from it by repeated squaring
//! (Moler and Van Loan 2003), and of a rest; step lengths that repeat get matrices of their own.

use super::equations::{Equations, Mode, State};
use super::steps::{self, is_same};
use crate::numerics::count::whole;
use crate::numerics::root;
use crate::plant::effect::{Coupling, Instant};

/// Rounding of the event function at the beginning of a mode, rad/s or N.m.
const ROUNDING: f64 = 1e-11;

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Load {
    speed_rad_s: f64,
    /// Natural frequency times the angle of the motor relative to the load, rad/s: all mechanical states have one unit.
    twist_rad_s: f64,
    mode: Mode,
    contact: Contact,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Contact {
    /// Within the play.
    #[default]
    Open,
    /// The motor pushes the load forward, or is braked by it.
    Ahead,
    /// The motor pushes the load backward.
    Behind,
}

impl Contact {
    const fn sign(self) -> f64 {
        match self {
            Self::Open => 0.0,
            Self::Ahead => 1.0,
            Self::Behind => -1.0,
        }
    }
}

/// The part of the automaton whose mode ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Motor,
    Load,
    Play,
}

const SIDES: [Side; 3] = [Side::Motor, Side::Load, Side::Play];

struct Begin {
    motor: State,
    load: Load,
    forcing: [f64; 3],
    at: Instant,
}

impl Begin {
    fn index(&self) -> usize {
        usize::from(self.motor.mode == Mode::Stuck)
            + 2 * usize::from(self.load.mode == Mode::Stuck)
            + 4 * usize::from(self.load.contact == Contact::Open)
    }
}

pub(super) struct TwoMass {
    /// k over the natural frequency, and d: shaft torque per twist and per difference of the speeds.
    stiffness: f64,
    damping: f64,
    inverse_motor: f64,
    inverse_load: f64,
    coulomb_n_m: f64,
    /// Half the play, in the unit of the twist.
    half_play_rad_s: f64,
    /// By motor stuck, load stuck, contact.
    flows: [Flow; 8],
    pub(super) load: Load,
}

impl TwoMass {
    pub(super) fn new(coupling: &Coupling, equations: &Equations) -> Self {
        // f, r, zeta: as in `Coupling`. With the twist times the natural frequency w0, k/(J1 w0) = w0 r,
        // d/J1 = 2 zeta w0 r, and with 1 - r for the load.
        let w0 = std::f64::consts::TAU * coupling.frequency_hz;
        let r = coupling.inertia_ratio;
        let zeta = coupling.damping_ratio;
        let inverse_motor = equations.inverse_inertia;
        let motor_inertia = 1.0 / inverse_motor;
        let flow = |index: usize| {
            let moves = |bit: usize| f64::from(u8::from(index & bit == 0));
            let (motor, load, spring) = (moves(1), moves(2), moves(4));
            let (a, on_motor, on_load) = (&equations.a, w0 * r, w0 * (1.0 - r));
            let of_motor =
                [a[1][0], -2.0 * zeta * w0 * r, load * 2.0 * zeta * w0 * r, -spring * on_motor];
            let of_load = [
                motor * 2.0 * zeta * w0 * (1.0 - r),
                -2.0 * zeta * w0 * (1.0 - r),
                spring * on_load,
            ];
            let sparse = Sparse {
                current: [a[0][0], motor * a[0][1]],
                motor: of_motor.map(|rate| motor * rate),
                load: of_load.map(|rate| load * rate),
                twist: [motor * w0, -load * w0],
            };
            Flow::new(sparse, !equations.is_linear())
        };
        Self {
            stiffness: w0 * r * motor_inertia,
            damping: 2.0 * zeta * w0 * r * motor_inertia,
            inverse_motor,
            inverse_load: (1.0 - r) / r * inverse_motor,
            coulomb_n_m: equations.coulomb_load,
            half_play_rad_s: 0.5 * coupling.gap_rad * w0,
            flows: std::array::from_fn(flow),
            load: Load::default(),
        }
    }

    /// Sets the load to its steady state: the speed of the motor, the shaft twisted by the load's friction.
    pub(super) fn start(&mut self, state: &State) {
        for flow in &mut self.flows {
            flow.clear();
        }
        let speed_rad_s = state.speed_rad_s;
        let direction = match speed_rad_s {
            0.0 => 0.0,
            moving => moving.signum(),
        };
        self.load = Load {
            speed_rad_s,
            twist_rad_s: direction * (self.half_play_rad_s + self.coulomb_n_m / self.stiffness),
            ..Load::default()
        };
        self.load.contact = self.contact_of(self.load.twist_rad_s);
    }

    /// Adds the correction of the motor's speed to that of a moving load, so that the torque of the shaft does not change; a load
    /// at rest stays at rest.
    pub(super) fn correct(&mut self, change_rad_s: f64) {
        if self.load.mode != Mode::Stuck && change_rad_s.is_finite() {
            self.load.speed_rad_s += change_rad_s;
            self.load.mode = Mode::Undecided;
        }
    }

    /// One sub-step with its changes of mode.
    #[inline(never)]
    pub(super) fn sub_step(
        &mut self,
        equations: &Equations,
        state: &mut State,
        mut at: Instant,
        h: f64,
    ) {
        if state.mode == Mode::Undecided {
            state.mode = self.motor_mode(equations, state, &at);
        }
        if self.load.mode == Mode::Undecided {
            self.load.mode = self.load_mode(state);
        }
        let mut remaining = h;
        // More than eight changes of mode in one sub-step: both sides come to rest.
        for _ in 0..8 {
            let from = self.begin(equations, state, at, remaining);
            let next = self.trial(equations, &from, remaining);
            let Some((cut, first)) = self.first_end(equations, &from, &next, remaining) else {
                (*state, self.load) = next;
                return;
            };
            (*state, self.load) = self.trial(equations, &from, cut);
            remaining -= cut;
            at.time_s += cut;
            self.change(equations, state, &at, first, &next);
            if remaining <= 1e-9 * h {
                return;
            }
        }
        let from = self.begin(equations, state, at, remaining);
        (*state, self.load) = self.trial(equations, &from, remaining);
        state.mode = Mode::Undecided;
        self.load.mode = Mode::Undecided;
        self.load.contact = self.contact_of(self.load.twist_rad_s);
    }

    /// A step of at most `h`.
    fn begin(&mut self, equations: &Equations, state: &State, at: Instant, h: f64) -> Begin {
        let begin = Begin {
            forcing: self.forcing(equations, state, &self.load, &at),
            motor: *state,
            load: self.load,
            at,
        };
        self.flows[begin.index()].prepare(h);
        begin
    }

    /// The first end of a mode within `h`, and whose mode it is.
    #[inline]
    fn first_end(
        &self,
        equations: &Equations,
        from: &Begin,
        next: &(State, Load),
        h: f64,
    ) -> Option<(f64, Side)> {
        let ends = SIDES.map(|side| {
            if self.margin(equations, next, from, side) < 0.0 {
                Some(h)
            } else {
                self.extremum_within(from, next, h, side)
            }
        });
        if ends == [None; 3] {
            return None;
        }
        let mut first = None;
        for (side, end) in SIDES.into_iter().zip(ends) {
            let Some(within) = end else { continue };
            if let Some(when) = self.locate(equations, from, within, side)
                && first.is_none_or(|(before, _)| when < before)
            {
                first = Some((when, side));
            }
        }
        first
    }

    /// The instant of the extremum of a speed that may have crossed zero twice within the step: between the crossings its friction
    /// changes direction or sticks.
    #[inline]
    fn extremum_within(
        &self,
        from: &Begin,
        (motor, load): &(State, Load),
        h: f64,
        side: Side,
    ) -> Option<f64> {
        let (mode, before, after) = match side {
            Side::Motor => (from.motor.mode, from.motor.speed_rad_s, motor.speed_rad_s),
            Side::Load => (from.load.mode, from.load.speed_rad_s, load.speed_rad_s),
            Side::Play => return None,
        };
        let sign = mode.sign();
        let flow = &self.flows[from.index()];
        let rate = |x: X| {
            let rates = flow.a.rates(x, from.forcing);
            sign * rates[if side == Side::Motor { 1 } else { 2 }]
        };
        let falling = rate(linear_states(&from.motor, &from.load));
        // At this constant deceleration it would not reach zero.
        if falling >= 0.0 || sign * before + falling * h > 0.0 {
            return None;
        }
        let rising = rate(linear_states(motor, load));
        if rising <= 0.0 || sign * after <= 0.0 {
            return None;
        }
        // Linear interpolation of the acceleration. An extremum closer to zero is rounding.
        let extremum_s = h * falling / (falling - rising);
        (sign * before + 0.5 * falling * extremum_s < -1e-9).then_some(extremum_s)
    }

    /// Changes the mode of `side` at its end; `beyond` is the state that the old mode leads to.
    fn change(
        &mut self,
        equations: &Equations,
        state: &mut State,
        at: &Instant,
        side: Side,
        beyond: &(State, Load),
    ) {
        match side {
            Side::Motor => {
                state.speed_rad_s = 0.0;
                state.mode = if state.mode == Mode::Stuck {
                    let driving = equations.driving_torque(&beyond.0, at);
                    Mode::towards(driving - self.shaft_torque(&beyond.0, &beyond.1))
                } else {
                    self.motor_mode(equations, state, at)
                };
            }
            Side::Load => {
                self.load.speed_rad_s = 0.0;
                self.load.mode = if self.load.mode == Mode::Stuck {
                    Mode::towards(self.shaft_torque(&beyond.0, &beyond.1))
                } else {
                    self.load_mode(state)
                };
            }
            Side::Play => {
                let contact = match (self.load.contact, self.load.twist_rad_s > 0.0) {
                    (Contact::Open, true) => Contact::Ahead,
                    (Contact::Open, false) => Contact::Behind,
                    (contact, _) => contact,
                };
                self.load.twist_rad_s = contact.sign() * self.half_play_rad_s;
                let was_open = self.load.contact == Contact::Open;
                self.load.contact = if was_open { contact } else { Contact::Open };
            }
        }
    }

    fn contact_of(&self, twist_rad_s: f64) -> Contact {
        // Without play the shaft is always in contact.
        if twist_rad_s > self.half_play_rad_s || self.half_play_rad_s == 0.0 {
            Contact::Ahead
        } else if twist_rad_s < -self.half_play_rad_s {
            Contact::Behind
        } else {
            Contact::Open
        }
    }

    /// Torque of the shaft, against the motor and on the load, N.m.
    #[inline]
    fn shaft_torque(&self, motor: &State, load: &Load) -> f64 {
        let twist = match load.contact {
            Contact::Open => 0.0,
            contact => load.twist_rad_s - contact.sign() * self.half_play_rad_s,
        };
        self.stiffness * twist + self.damping * (motor.speed_rad_s - load.speed_rad_s)
    }

    fn motor_mode(&self, equations: &Equations, state: &State, at: &Instant) -> Mode {
        if state.speed_rad_s != 0.0 {
            return Mode::towards(state.speed_rad_s);
        }
        let (driving, level) = equations.drive_and_level(state, at);
        stuck_or_moving(driving - self.shaft_torque(state, &self.load), level)
    }

    fn load_mode(&self, state: &State) -> Mode {
        if self.load.speed_rad_s != 0.0 || self.coulomb_n_m == 0.0 {
            return Mode::towards(self.load.speed_rad_s);
        }
        stuck_or_moving(self.shaft_torque(state, &self.load), self.coulomb_n_m)
    }

    /// Event function of the mode at `from`: positive within it, zero at its end.
    #[inline]
    fn margin(
        &self,
        equations: &Equations,
        (motor, load): &(State, Load),
        from: &Begin,
        side: Side,
    ) -> f64 {
        match side {
            Side::Motor if from.motor.mode == Mode::Stuck => {
                let (driving, level) = equations.drive_and_level(motor, &from.at);
                level - (driving - self.shaft_torque(motor, load)).abs()
            }
            Side::Motor => motor.speed_rad_s * from.motor.mode.sign(),
            // Without friction nothing changes when it turns.
            Side::Load if self.coulomb_n_m == 0.0 => 1.0,
            Side::Load if from.load.mode == Mode::Stuck => {
                self.coulomb_n_m - self.shaft_torque(motor, load).abs()
            }
            Side::Load => load.speed_rad_s * from.load.mode.sign(),
            Side::Play if self.half_play_rad_s == 0.0 => 1.0,
            Side::Play if from.load.contact == Contact::Open => {
                self.half_play_rad_s - load.twist_rad_s.abs()
            }
            Side::Play => load.twist_rad_s * from.load.contact.sign() - self.half_play_rad_s,
        }
    }

    /// Time within `[0, h]` at which the mode of `side` ends, if it does.
    #[inline(never)]
    fn locate(&self, equations: &Equations, from: &Begin, h: f64, side: Side) -> Option<f64> {
        let margin = |t: f64| {
            let next = self.trial(equations, from, t);
            self.margin(equations, &next, from, side)
        };
        let (mut low, mut at_low) = (0.0, margin(0.0));
        let (mut high, mut at_high) = (h, margin(h));
        if at_high >= 0.0 {
            return None;
        }
        if at_low < -ROUNDING {
            return Some(0.0);
        }
        if at_low <= ROUNDING {
            // The mode has just begun, at a zero of its event function: its end is the next zero.
            low = h;
            while at_low <= ROUNDING {
                low *= 0.5;
                if low < 1e-3 * h {
                    return Some(0.0);
                }
                at_low = margin(low);
                if at_low < -ROUNDING {
                    (high, at_high) = (low, at_low);
                }
            }
        }
        let (low, high) = ((low, at_low), (high, at_high));
        Some(root::illinois(low, high, h, 30, margin))
    }

    /// State after `h` if no mode changes.
    #[inline]
    fn trial(&self, equations: &Equations, from: &Begin, h: f64) -> (State, Load) {
        let mut next = (from.motor, from.load);
        if h <= 0.0 {
            return next;
        }
        let flow = &self.flows[from.index()];
        let x = linear_states(&from.motor, &from.load);
        let mut forcing = from.forcing;
        if !equations.is_linear() {
            let mut middle = next;
            set_linear_states(&mut middle, flow.half(x, forcing, h));
            equations.advance_own(&from.motor, &from.at, 0.5 * h, &mut middle.0.own);
            let centred = Instant { time_s: from.at.time_s + 0.5 * h, ..from.at };
            forcing = self.forcing(equations, &middle.0, &middle.1, &centred);
            equations.advance_own(&middle.0, &centred, h, &mut next.0.own);
        }
        set_linear_states(&mut next, flow.whole(x, forcing, h));
        next
    }

    /// Input, effects, friction and the offset of the play, in A/s and rad/s2.
    #[inline]
    fn forcing(&self, equations: &Equations, state: &State, load: &Load, at: &Instant) -> [f64; 3] {
        let [current, mut motor] = equations.forcing(state, at);
        let offset = self.stiffness * load.contact.sign() * self.half_play_rad_s;
        if state.mode != Mode::Stuck {
            motor += offset * self.inverse_motor;
        }
        let mut on_load = match load.mode {
            Mode::Stuck | Mode::Undecided => 0.0,
            moving => -(offset + moving.sign() * self.coulomb_n_m) * self.inverse_load,
        };
        let loss = equations.acceleration_loss(state, at);
        if loss != 0.0 {
            // The shaft's torque acts on both changed inertias.
            let shaft = self.shaft_torque(state, load);
            if state.mode != Mode::Stuck {
                motor += loss * shaft * self.inverse_motor;
            }
            if load.mode != Mode::Stuck {
                let net = shaft - load.mode.sign() * self.coulomb_n_m;
                on_load -= loss * net * self.inverse_load;
            }
        }
        [current, motor, on_load]
    }
}

fn linear_states(state: &State, load: &Load) -> X {
    [state.current_a, state.speed_rad_s, load.speed_rad_s, load.twist_rad_s]
}

fn set_linear_states((state, load): &mut (State, Load), x: X) {
    state.current_a = x[0];
    state.speed_rad_s = x[1];
    load.speed_rad_s = x[2];
    load.twist_rad_s = x[3];
}

fn stuck_or_moving(driving: f64, level: f64) -> Mode {
    if driving.abs() <= level { Mode::Stuck } else { Mode::towards(driving) }
}

/// Current, speed of the motor, speed of the load, twist as a speed (natural frequency times twist).
type X = [f64; 4];

/// Non-zero elements of the rows of `A`.
#[derive(Clone, Copy, Debug, Default)]
struct Sparse {
    current: [f64; 2],
    motor: X,
    load: [f64; 3],
    twist: [f64; 2],
}

impl Sparse {
    #[inline]
    fn times(self, x: X) -> X {
        let (c, m, l, t) = (&self.current, &self.motor, &self.load, &self.twist);
        [
            c[0] * x[0] + c[1] * x[1],
            (m[0] * x[0] + m[1] * x[1]) + (m[2] * x[2] + m[3] * x[3]),
            l[0] * x[1] + l[1] * x[2] + l[2] * x[3],
            t[0] * x[1] + t[1] * x[2],
        ]
    }

    /// `A x + g`: time derivatives of the states.
    #[inline]
    fn rates(self, x: X, g: [f64; 3]) -> X {
        let rates = self.times(x);
        [rates[0] + g[0], rates[1] + g[1], rates[2] + g[2], rates[3]]
    }

    /// Upper bound of the spectral radius: the diagonal, and geometric means of elements across it, which do not depend on the units
    /// of the states.
    fn size(&self) -> f64 {
        let (c, m, l, t) = (&self.current, &self.motor, &self.load, &self.twist);
        c[0].abs()
            + (c[1] * m[0]).abs().sqrt()
            + m[1].abs().max(l[1].abs())
            + ((m[3] * t[0]).abs() + (l[2] * t[1]).abs()).sqrt()
    }
}

/// `Phi` and the first three columns of `Gamma` (nothing forces the twist), by columns.
#[derive(Clone, Copy, Debug, Default)]
struct Matrices {
    phi: [X; 4],
    gamma: [X; 3],
}

impl Matrices {
    #[inline]
    fn apply(&self, x: X, g: [f64; 3]) -> X {
        let mut out = [0.0; 4];
        for (row, cell) in out.iter_mut().enumerate() {
            let (p, q) = (&self.phi, &self.gamma);
            *cell = (p[0][row] * x[0] + p[1][row] * x[1])
                + (p[2][row] * x[2] + p[3][row] * x[3])
                + (q[0][row] * g[0] + q[1][row] * g[1] + q[2][row] * g[2]);
        }
        out
    }

    /// By the series of a length for which `size t` is at most one.
    fn of_series(a: &Sparse, t: f64) -> Self {
        Self {
            phi: std::array::from_fn(|column| series(a, unit(column), [0.0; 3], t)),
            gamma: std::array::from_fn(|column| series(a, [0.0; 4], unit(column), t)),
        }
    }

    /// Over twice the length: `Phi(2t) = Phi(t) Phi(t)`, `Gamma(2t) = Phi(t) Gamma(t) + Gamma(t)`.
    fn doubled(&self) -> Self {
        Self {
            phi: self.phi.map(|column| self.apply(column, [0.0; 3])),
            gamma: std::array::from_fn(|column| self.apply(self.gamma[column], unit(column))),
        }
    }
}

fn unit<const N: usize>(index: usize) -> [f64; N] {
    std::array::from_fn(|other| f64::from(u8::from(other == index)))
}

/// `x + sum of t^n/n! A^(n-1) (A x + g)`.
#[inline]
fn series(a: &Sparse, x: X, g: [f64; 3], t: f64) -> X {
    let mut out = x;
    let mut term = a.rates(x, g);
    // With `size t` of one the remainder is below 1e-16.
    for order in 1..=18 {
        let factor = t / f64::from(order);
        let mut largest_change = 0.0_f64;
        for (sum, part) in out.iter_mut().zip(&mut term) {
            *part *= factor;
            *sum += *part;
            largest_change = largest_change.max(part.abs() - 1e-17 * sum.abs());
        }
        if largest_change <= 0.0 {
            break;
        }
        term = a.times(term);
    }
    out
}

type Step = steps::Step<Matrices>;

/// One linear mode with a cache of the matrices of its latest repeated step lengths. Delayed commands at half of the rows' distance
/// make four of them in turn.
#[derive(Clone, Debug, Default)]
struct Flow {
    a: Sparse,
    size: f64,
    with_half: bool,
    steps: [Step; 4],
    last: usize,
    /// Latest lengths without matrices, the newest first.
    missed_s: [f64; 4],
    /// Matrices over the range of the series, `1 / size`, times the powers of two.
    powers: Vec<Matrices>,
}

impl Flow {
    fn new(a: Sparse, with_half: bool) -> Self {
        Self { a, size: a.size(), with_half, ..Self::default() }
    }

    /// Empties the cache, so that the rounding of a run does not depend on the run before.
    fn clear(&mut self) {
        self.steps = [Step::default(); 4];
        self.missed_s = [0.0; 4];
    }

    /// Prepares a step of this length. A length that occurs once, such as that up to an event, gets no matrices.
    #[inline]
    fn prepare(&mut self, length_s: f64) {
        if self.steps[self.last].has_length(length_s) {
            return;
        }
        match self.steps.iter().position(|step| step.has_length(length_s)) {
            Some(known) => self.last = known,
            None => self.miss(length_s),
        }
    }

    #[inline(never)]
    fn miss(&mut self, length_s: f64) {
        while self.powers.len() < 64 && self.size * length_s >= (self.powers.len() as f64).exp2() {
            let range = || Matrices::of_series(&self.a, self.size.recip());
            let next = self.powers.last().map_or_else(range, Matrices::doubled);
            self.powers.push(next);
        }
        if self.missed_s.iter().any(|missed_s| is_same(*missed_s, length_s)) {
            self.last = (self.last + 1) % self.steps.len();
            let half = self.with_half.then(|| self.over(0.5 * length_s));
            let whole = self.over(length_s);
            self.steps[self.last] = Step { length_s, whole, half: half.unwrap_or_default() };
        }
        self.missed_s.rotate_right(1);
        self.missed_s[0] = length_s;
    }

    fn over(&self, length_s: f64) -> Matrices {
        Matrices {
            phi: std::array::from_fn(|column| self.uncached(unit(column), [0.0; 3], length_s)),
            gamma: std::array::from_fn(|column| self.uncached([0.0; 4], unit(column), length_s)),
        }
    }

    /// The state after `length_s`.
    #[inline]
    fn whole(&self, x: X, g: [f64; 3], length_s: f64) -> X {
        match &self.steps[self.last] {
            step if step.has_length(length_s) => step.whole.apply(x, g),
            _ => self.uncached(x, g, length_s),
        }
    }

    /// The state after half of `length_s`.
    #[inline]
    fn half(&self, x: X, g: [f64; 3], length_s: f64) -> X {
        match &self.steps[self.last] {
            step if step.has_length(length_s) => step.half.apply(x, g),
            _ => self.uncached(x, g, 0.5 * length_s),
        }
    }

    /// The state after at most the length that was prepared last.
    fn uncached(&self, x: X, g: [f64; 3], length_s: f64) -> X {
        let ranges = (self.size * length_s).floor();
        let rest_s = if ranges > 0.0 { length_s - ranges / self.size } else { length_s };
        let mut state = series(&self.a, x, g, rest_s);
        let mut left = whole(ranges);
        for power in &self.powers {
            if left & 1 == 1 {
                state = power.apply(state, g);
            }
            left >>= 1;
        }
        state
    }
}

#[cfg(test)]
mod tests;
