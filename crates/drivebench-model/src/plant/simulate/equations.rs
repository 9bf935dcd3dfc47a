//! State, linear part and forcing of the equations, and the friction that holds the shaft (stiction).

use crate::plant::effect::{Coupling, Enters, Instant, Path, ShaftAngle, Sums, Terms};
use crate::plant::model::{Model, ModelError};
use crate::plant::motor::MotorKey;
use crate::plant::propagator::M2;
use crate::plant::run_scales::RunScales;
use crate::plant::scenario::{Input, Scenario};
use crate::plant::simulate::Transient;

/// States that all effects of one model may have together.
pub(super) const MOST_STATES: usize = 6;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    pub current_a: f64,
    pub speed_rad_s: f64,
    pub angle_rad: f64,
    pub(super) own: [f64; MOST_STATES],
    pub(super) mode: Mode,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Mode {
    #[default]
    Undecided,
    Stuck,
    Forward,
    Backward,
}

impl Mode {
    pub(super) fn towards(direction: f64) -> Self {
        if direction > 0.0 { Self::Forward } else { Self::Backward }
    }

    pub(super) const fn sign(self) -> f64 {
        match self {
            Self::Forward => 1.0,
            Self::Backward => -1.0,
            Self::Stuck | Self::Undecided => 0.0,
        }
    }
}

impl State {
    pub fn at(current_a: f64, speed_rad_s: f64) -> Self {
        Self { current_a, speed_rad_s, ..Self::default() }
    }

    /// The same with these states of the effects, such as a warm winding.
    #[must_use]
    pub fn with_effects(mut self, own: &[f64]) -> Self {
        for (state, value) in self.own.iter_mut().zip(own) {
            *state = *value;
        }
        self
    }

    /// Adds the changes that are numbers; a changed speed gets a new mode of motion.
    pub(super) fn correct(&mut self, change_a: f64, change_rad_s: f64) {
        if change_a.is_finite() {
            self.current_a += change_a;
        }
        if change_rad_s.is_finite() && change_rad_s != 0.0 {
            self.speed_rad_s += change_rad_s;
            self.mode = Mode::Undecided;
        }
    }

    /// The states of the effects, one effect after the other.
    pub fn own(&self) -> &[f64] {
        &self.own
    }

    /// Direction of motion: one forward, minus one backward, zero at rest.
    pub fn direction(&self) -> f64 {
        match self.mode {
            Mode::Undecided if self.speed_rad_s != 0.0 => self.speed_rad_s.signum(),
            mode => mode.sign(),
        }
    }
}

struct Entry {
    terms: Box<dyn Terms>,
    states: usize,
}

pub(super) struct Equations {
    /// The motor's constants, part of every instant.
    motor: Instant,
    pub(super) inverse_inertia: f64,
    changes_inertia: bool,
    coulomb: f64,
    /// Coulomb friction of the load on an elastic shaft.
    pub(super) coulomb_load: f64,
    pub(super) input: Input,
    /// Linear part: `d/dt [i, w] = A [i, w] + forcing`.
    pub(super) a: M2,
    per_volt: f64,
    /// Effects that enter a balance.
    terms: Vec<Entry>,
    pub(super) states: usize,
    pub(super) path: Path,
    own_path: Path,
    /// Of the link, in a run with stamps of the host.
    input_delay_s: f64,
    pub(super) coupling: Option<Coupling>,
    pub(super) needs_angle: bool,
    /// Load torque in addition to the model's, against positive motion.
    pub(super) load_n_m: f64,
    pub(super) extra_v: f64,
}

impl Equations {
    pub(super) fn new(model: &Model, input: Input) -> Result<Self, ModelError> {
        let given = |key: MotorKey, value: Option<f64>| {
            let key = key.key().to_owned();
            value.ok_or(ModelError::Unset { key })
        };
        let value = |key: MotorKey| given(key, model.motor.get(key));
        let effects = model.effects.iter().map(|active| {
            (active.effect.card().enters, active.effect.terms(&active.values_or_guess()))
        });
        let effects: Vec<_> = effects.collect();
        let path = effects.iter().map(|(_, terms)| terms.path()).fold(Path::default(), Path::plus);
        let mut couplings = effects.iter().filter_map(|(_, terms)| terms.coupling());
        let coupling = couplings.next();
        if couplings.next().is_some() {
            return Err(ModelError::SecondCoupling);
        }
        // With a second inertia these are the motor's equations: the load has its share of inertia and friction.
        let (load_share, friction_share) = coupling
            .map_or((0.0, 0.0), |coupling| (coupling.inertia_ratio, coupling.friction_split));
        let inertia = value(MotorKey::Inertia)? * (1.0 - load_share);
        let coulomb = value(MotorKey::LoadTorque)?;
        let mut motor = Instant::of(&model.motor);
        let (torque_constant, a, per_volt) = match input {
            Input::Voltage => {
                let (r, l) = (value(MotorKey::Resistance)?, value(MotorKey::Inductance)?);
                let ke = value(MotorKey::BackEmf)?;
                let kt = model.motor.torque_constant().unwrap_or(ke);
                (kt, [[-r / l, -ke / l], [kt / inertia, 0.0]], 1.0 / l)
            }
            Input::Current => {
                let kt = given(MotorKey::TorqueConstant, model.motor.torque_constant())?;
                (kt, [[0.0, 0.0], [kt / inertia, 0.0]], 0.0)
            }
            Input::Torque => (1.0, [[0.0, 0.0], [1.0 / inertia, 0.0]], 0.0),
        };
        motor.torque_n_m_per_a = torque_constant;
        // After every event in time.
        let at_end = Instant { time_s: f64::MAX, ..motor };
        let mut gains = effects.iter().map(|(_, terms)| terms.inertia_gain(&at_end));
        let changes_inertia = gains.any(|gain| gain != 0.0);
        let terms: Vec<Entry> = effects
            .into_iter()
            .filter(|(enters, terms)| *enters != Enters::Path && terms.coupling().is_none())
            .map(|(_, terms)| Entry { states: terms.states(), terms })
            .collect();
        Ok(Self {
            motor,
            path,
            own_path: path,
            input_delay_s: model.input_delay_s.unwrap_or(0.0),
            coupling,
            needs_angle: (model.effects.iter()).any(|active| active.effect.card().needs_angle),
            inverse_inertia: 1.0 / inertia,
            changes_inertia,
            coulomb: coulomb * (1.0 - friction_share),
            coulomb_load: coulomb * friction_share,
            input,
            a,
            per_volt,
            states: terms.iter().map(|entry| entry.states).sum(),
            terms,
            load_n_m: 0.0,
            extra_v: 0.0,
        })
    }

    /// Sets the supply of the run that is simulated next.
    pub(super) const fn set_run(&mut self, supply_v: f64, scales: &RunScales) {
        self.motor = self.motor.with(supply_v, scales);
    }

    /// The path of the model, with what is known of the run's sensors and of its link.
    pub(super) fn set_path(&mut self, run: &Scenario) {
        self.path = self.own_path.plus(Path::of(run.sensors));
        if run.is_stamped_by_host() {
            self.path.command_delay_s += self.input_delay_s;
        }
    }

    pub(super) fn is_linear(&self) -> bool {
        self.terms.is_empty()
    }

    fn sums(&self, state: &State, at: &Instant) -> Sums {
        let mut sums = Sums::default();
        if self.terms.is_empty() {
            return sums;
        }
        let here = self.instant(state, at);
        // The usual case of one effect needs no sum.
        if let [only] = &self.terms[..] {
            return only.terms.sums(&here, &state.own);
        }
        let mut own = &state.own[..];
        for entry in &self.terms {
            entry.terms.add_to(&mut sums, &here, own);
            own = &own[entry.states..];
        }
        sums
    }

    /// Forcing of the linear part: input and effects, in A/s and rad/s2.
    #[inline]
    pub(super) fn forcing(&self, state: &State, at: &Instant) -> [f64; 2] {
        let sums = self.sums(state, at);
        let acceleration = match state.mode {
            Mode::Stuck | Mode::Undecided => 0.0,
            moving => {
                let level = (self.coulomb + sums.friction_n_m).max(0.0);
                let against = sums.torque_n_m + self.load_n_m + moving.sign() * level;
                let mut acceleration = -against * self.inverse_inertia;
                if sums.inertia_gain != 0.0 {
                    // The linear part has the motor's torque over its own inertia.
                    let linear = self.a[1][0] * state.current_a;
                    acceleration = (linear + acceleration) / (1.0 + sums.inertia_gain) - linear;
                }
                acceleration
            }
        };
        // Under a given current there is no electrical equation, and its constants may be missing.
        if self.input != Input::Voltage {
            return [0.0, acceleration];
        }
        let mut voltage_v = at.voltage_v + self.extra_v - sums.voltage_v;
        if sums.current_rate_gain != 0.0 {
            let inductive_v = voltage_v
                - self.motor.resistance_ohm * state.current_a
                - self.motor.back_emf_v_s_per_rad * state.speed_rad_s;
            voltage_v += sums.current_rate_gain * inductive_v;
        }
        [voltage_v * self.per_volt, acceleration]
    }

    pub(super) fn current_rate(&self, state: &State, at: &Instant) -> f64 {
        let [[by_current, by_speed], _] = self.a;
        let linear = by_current * state.current_a + by_speed * state.speed_rad_s;
        linear + self.forcing(state, at)[0]
    }

    /// Whether the current settles within an interval, so that it is no straight line.
    pub(super) fn settles_within(&self, interval_s: f64) -> bool {
        self.input == Input::Voltage && interval_s * -self.a[0][0] >= 0.5
    }

    /// The part of a current that settles within an interval, from its rate at the begin and its change.
    pub(super) fn transient(
        &self,
        rate_a_per_s: f64,
        change_a: f64,
        interval_s: f64,
    ) -> Transient<1> {
        let time_constant_s = -1.0 / self.a[0][0];
        let share = 1.0 - (-interval_s / time_constant_s).exp();
        let size_a =
            (rate_a_per_s - change_a / interval_s) / (share / interval_s - 1.0 / time_constant_s);
        Transient { size_a: [size_a], time_constant_s }
    }

    /// The share by which effects that change the inertia reduce any acceleration.
    pub(super) fn acceleration_loss(&self, state: &State, at: &Instant) -> f64 {
        if !self.changes_inertia {
            return 0.0;
        }
        let gain = self.sums(state, at).inertia_gain;
        gain / (1.0 + gain)
    }

    /// Current of the full supply through the resistance alone, A.
    pub(super) fn stall_current_a(&self, voltage_v: f64) -> f64 {
        (voltage_v / self.motor.resistance_ohm).abs()
    }

    /// Change by the effects of the reciprocal electrical time constant between two currents, 1/s, at rest under this voltage:
    /// `((1 + g) (R + dU/di) - R) / L` with the gain `g` of the current's rate.
    pub(super) fn added_rate(&self, from_a: f64, to_a: f64, voltage_v: f64) -> f64 {
        let sums = |current_a: f64| {
            let at = Instant { voltage_v, ..Instant::default() };
            self.sums(&State::at(current_a, 0.0), &at)
        };
        let (from, to) = (sums(from_a), sums(to_a));
        let slope_ohm = (to.voltage_v - from.voltage_v) / (to_a - from_a);
        let gain = from.current_rate_gain.max(to.current_rate_gain);
        let resistance_ohm = self.motor.resistance_ohm;
        ((1.0 + gain) * (resistance_ohm + slope_ohm) - resistance_ohm).abs() * self.per_volt
    }

    /// The angle for the effects, the same over a sub-step; zero where no effect needs it.
    pub(super) fn angle(&self, angle_rad: f64) -> ShaftAngle {
        let angle = self.needs_angle.then(|| ShaftAngle::at(angle_rad));
        angle.unwrap_or_default()
    }

    fn instant(&self, state: &State, at: &Instant) -> Instant {
        Instant {
            time_s: at.time_s,
            voltage_v: at.voltage_v,
            current_a: state.current_a,
            speed_rad_s: state.speed_rad_s,
            angle: at.angle,
            ..self.motor
        }
    }

    /// Torque that would move the shaft, friction left out.
    pub(super) fn driving_torque(&self, state: &State, at: &Instant) -> f64 {
        self.drive_and_level(state, at).0
    }

    /// Torque that would move the shaft, friction left out, and the friction level against it.
    pub(super) fn drive_and_level(&self, state: &State, at: &Instant) -> (f64, f64) {
        let sums = self.sums(state, at);
        (
            self.motor.torque_n_m_per_a * state.current_a - sums.torque_n_m - self.load_n_m,
            (self.coulomb + sums.friction_n_m).max(0.0),
        )
    }

    /// Friction level less driving torque, N.m: negative where a shaft at rest breaks away.
    pub(super) fn stiction_margin(&self, state: &State, at: &Instant) -> f64 {
        let (driving, level) = self.drive_and_level(state, at);
        level - driving.abs()
    }

    pub(super) fn mode_at(&self, state: &State, at: &Instant) -> Mode {
        if state.speed_rad_s != 0.0 {
            return Mode::towards(state.speed_rad_s);
        }
        if self.stiction_margin(state, at) >= 0.0 {
            return Mode::Stuck;
        }
        Mode::towards(self.driving_torque(state, at))
    }

    /// One explicit Euler step of the states of the effects.
    #[inline]
    pub(super) fn advance_own(
        &self,
        from: &State,
        at: &Instant,
        h: f64,
        to: &mut [f64; MOST_STATES],
    ) {
        if self.states == 0 {
            return;
        }
        let here = self.instant(from, at);
        let mut first = 0;
        for Entry { terms, states, .. } in &self.terms {
            if *states == 0 {
                continue;
            }
            let range = first..first + states;
            let mut rates = [0.0; MOST_STATES];
            terms.derivative(&here, &from.own[range.clone()], &mut rates[..*states]);
            for (value, rate) in to[range].iter_mut().zip(&rates) {
                *value += h * rate;
            }
            first += states;
        }
    }
}
