//! Terms of a model's effects at an instant of a run, and what their forms may be wrong by there.

use std::f64::consts::TAU;

use drivebench_model::plant::{
    Coupling, Input, Instant, Model, MotorKey, Scenario, ShaftAngle, State, Sums, Terms,
};

/// What the form of an effect may be wrong by, as a share of what it does; where a torque drives, of friction too, and of
/// the torque itself, which no machine measures better.
pub(super) const FORM_SHARE: f64 = 0.05;
const DRIVE_SHARE: f64 = 0.02;

/// The motor's constants in a run: a given torque is the current of a motor with a torque constant of one, and what has no
/// voltage has no armature.
pub(super) fn constants(model: &Model, scenario: &Scenario) -> Instant {
    let mut motor = Instant::of(&model.motor);
    motor.supply_v = scenario.supply_v();
    if scenario.input != Input::Voltage {
        (motor.resistance_ohm, motor.back_emf_v_s_per_rad) = (0.0, 0.0);
    }
    if scenario.input == Input::Torque {
        motor.torque_n_m_per_a = 1.0;
    }
    motor
}

/// Damping ratio of the least damped coupling: what is not known of a twist dies away with it at last.
const LEAST_DAMPING: f64 = 0.01;

/// What the effects of a model do at an instant: volts, newton metres, and newton metres of what rings.
pub(super) struct Forms {
    pub(super) terms: Vec<Box<dyn Terms>>,
    motor: Instant,
    coupling: f64,
    /// Time in which what rings dies away, s.
    pub(super) ringing_s: f64,
    /// What of it may be wrong, as a share.
    pub(super) ringing_share: f64,
    inertia: f64,
    friction: f64,
    /// Friction and torque per unit of the input whose forms count: none under a voltage.
    coulomb: f64,
    drive: f64,
}

impl Forms {
    pub(super) fn of(model: &Model, scenario: &Scenario) -> Self {
        let terms: Vec<Box<dyn Terms>> = model
            .effects
            .iter()
            .map(|active| active.effect.terms(&active.values_or_guess()))
            .collect();
        let coupling = terms.iter().find_map(|terms| terms.coupling());
        let dies_s =
            |c: Coupling| 1.0 / (TAU * c.frequency_hz * c.damping_ratio.max(LEAST_DAMPING));
        // When the sides of a play meet nobody can foretell: a moment later the whole blow is an error.
        let in_phase = |c: Coupling| if c.gap_rad > 0.0 { 1.0 } else { FORM_SHARE };
        let counts = f64::from(u8::from(scenario.input != Input::Voltage));
        Self {
            terms,
            motor: constants(model, scenario),
            coupling: coupling.map_or(0.0, |c| c.inertia_ratio),
            ringing_s: coupling.map_or(0.0, dies_s),
            ringing_share: coupling.map_or(0.0, in_phase),
            inertia: model.motor.get(MotorKey::Inertia).unwrap_or(0.0),
            friction: model.motor.get(MotorKey::LoadTorque).unwrap_or(0.0),
            coulomb: counts * model.motor.get(MotorKey::LoadTorque).unwrap_or(0.0),
            drive: counts * DRIVE_SHARE / FORM_SHARE * constants(model, scenario).torque_n_m_per_a,
        }
    }

    pub(super) fn instant(&self, time_s: f64, voltage_v: f64, state: &State) -> Instant {
        Instant {
            time_s,
            voltage_v,
            current_a: state.current_a,
            speed_rad_s: state.speed_rad_s,
            angle: ShaftAngle::at(state.angle_rad),
            ..self.motor
        }
    }

    /// Squares by which the forms count, V2, (N.m)2 and (N.m)2 of what rings, and the rates of current, A/s, and speed, rad/s2,
    /// but for what a second inertia does.
    pub(super) fn at(
        &self,
        at: &Instant,
        state: &State,
        acceleration: f64,
        load_n_m: f64,
        inverse_inductance: f64,
    ) -> ([f64; 3], [f64; 2]) {
        let direction = state.direction();
        let (mut volts, mut torque) = (0.0, 0.0);
        let ringing = (self.coupling * self.inertia * acceleration).powi(2);
        if self.drive > 0.0 {
            torque += (self.drive * state.current_a).powi(2);
            torque += (self.coulomb * direction).powi(2);
        }
        let inductive = at.voltage_v
            - at.resistance_ohm * at.current_a
            - at.back_emf_v_s_per_rad * at.speed_rad_s;
        let mut all = Sums::default();
        let mut own = state.own();
        for terms in self.terms.iter().filter(|terms| terms.coupling().is_none()) {
            let sums = terms.sums(at, own);
            own = &own[terms.states().min(own.len())..];
            volts += sums.voltage_v.powi(2) + (sums.current_rate_gain * inductive).powi(2);
            torque += sums.torque_n_m.powi(2) + sums.friction_n_m.powi(2);
            torque += (sums.inertia_gain * self.inertia * acceleration).powi(2);
            all.voltage_v += sums.voltage_v;
            all.torque_n_m += sums.torque_n_m;
            all.friction_n_m += sums.friction_n_m;
            all.current_rate_gain += sums.current_rate_gain;
            all.inertia_gain += sums.inertia_gain;
        }
        let friction = direction * (self.friction + all.friction_n_m).max(0.0);
        let drives = at.torque_n_m_per_a * at.current_a - all.torque_n_m - load_n_m - friction;
        let rates = [
            (1.0 + all.current_rate_gain) * (inductive - all.voltage_v) * inverse_inductance,
            direction.abs() * drives / (self.inertia * (1.0 + all.inertia_gain)),
        ];
        ([volts, torque, ringing], rates)
    }
}
