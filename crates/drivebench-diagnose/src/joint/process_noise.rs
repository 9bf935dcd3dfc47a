//! Terms of a model's effects at an instant of a run, and the process noise that errors of their forms make.

use std::f64::consts::TAU;

use drivebench_model::plant::{
    ActiveEffect, Coupling, Input, Instant, Model, MotorKey, Scenario, ShaftAngle, State, Sums,
    Terms,
};

/// Error of the form of an effect as process noise, as a share of its torque or voltage.
pub(super) const FORM_SHARE: f64 = 0.05;

/// The motor's constants in a run. A torque input is treated as the current of a motor with a torque constant of one; without a
/// voltage there is no armature circuit.
pub(super) fn constants(model: &Model, scenario: &Scenario) -> Instant {
    let mut motor = Instant::of(&model.motor).in_run(scenario);
    if scenario.input != Input::Voltage {
        (motor.resistance_ohm, motor.back_emf_v_s_per_rad) = (0.0, 0.0);
    }
    if scenario.input == Input::Torque {
        motor.torque_n_m_per_a = 1.0;
    }
    motor
}

pub(super) fn terms_of(active: &ActiveEffect) -> Box<dyn Terms> {
    active.effect.terms(&active.values_or_guess())
}

/// Applies `f` to each pair of sums.
pub(super) fn combined(a: &Sums, b: &Sums, f: impl Fn(f64, f64) -> f64) -> Sums {
    Sums {
        voltage_v: f(a.voltage_v, b.voltage_v),
        torque_n_m: f(a.torque_n_m, b.torque_n_m),
        friction_n_m: f(a.friction_n_m, b.friction_n_m),
        current_rate_gain: f(a.current_rate_gain, b.current_rate_gain),
        inertia_gain: f(a.inertia_gain, b.inertia_gain),
    }
}

/// Voltages and torques of the effects of a model at an instant, for the process noise by errors of their forms.
pub(super) struct FormErrors {
    pub(super) terms: Vec<Box<dyn Terms>>,
    motor: Instant,
    coupling: f64,
    /// Time in which an oscillation of the coupling decays, s.
    pub(super) ringing_s: f64,
    /// Error of its torque, as a share.
    pub(super) ringing_share: f64,
    inertia: f64,
    friction: f64,
    /// Friction and torque per unit of the input whose errors count: none under a voltage.
    coulomb: f64,
    drive: f64,
}

impl FormErrors {
    pub(super) fn of(model: &Model, scenario: &Scenario) -> Self {
        let terms: Vec<Box<dyn Terms>> = model.effects.iter().map(terms_of).collect();
        let coupling = terms.iter().find_map(|terms| terms.coupling());
        // A damping ratio of at least 0.01, so that an unknown twist decays.
        let decay_s = |c: Coupling| 1.0 / (TAU * c.frequency_hz * c.damping_ratio.max(0.01));
        // The instant at which the flanks of a backlash meet is not predictable: the whole torque of the impact is an error.
        let error = |c: Coupling| if c.gap_rad > 0.0 { 1.0 } else { FORM_SHARE };
        let counts = f64::from(u8::from(scenario.input != Input::Voltage));
        let motor = constants(model, scenario);
        let friction = model.motor.get(MotorKey::LoadTorque).unwrap_or(0.0);
        Self {
            terms,
            motor,
            coupling: coupling.map_or(0.0, |c| c.inertia_ratio),
            ringing_s: coupling.map_or(0.0, decay_s),
            ringing_share: coupling.map_or(0.0, error),
            inertia: model.motor.get(MotorKey::Inertia).unwrap_or(0.0),
            friction,
            coulomb: counts * friction,
            // Error of a measured torque: 0.02 of it, at the best.
            drive: counts * 0.02 / FORM_SHARE * motor.torque_n_m_per_a,
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

    /// Squares of voltage, torque and coupling torque of the effects, V2 and (N.m)2; and the rates of current, A/s, and speed,
    /// rad/s2, without a coupling.
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
            all = combined(&all, &sums, |all, own| all + own);
        }
        let friction = direction * (self.friction + all.friction_n_m).max(0.0);
        let drives = at.torque_n_m_per_a * at.current_a - all.torque_n_m - load_n_m - friction;
        let rates = [
            (1.0 + all.current_rate_gain) * (inductive - all.voltage_v) * inverse_inductance,
            direction.abs() * drives / (self.inertia * (1.0 + all.inertia_gain)),
        ];
        let ringing = (self.coupling * self.inertia * acceleration).powi(2);
        ([volts, torque, ringing], rates)
    }
}
