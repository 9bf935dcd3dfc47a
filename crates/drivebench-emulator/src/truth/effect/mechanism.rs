//! Mechanism: what an effect does inside the machine, and the frames that make one from a single law.

use crate::truth::MotorTruth;

/// Where an effect is at work: the specimen and its supply.
#[derive(Clone, Debug)]
pub struct Site {
    pub motor: MotorTruth,
    /// Open-circuit voltage of the drive's supply, V.
    pub bus_v: f64,
    /// For what is random.
    pub seed: u64,
}

impl Site {
    /// A motor on a supply of its rated voltage.
    pub fn of(motor: &MotorTruth) -> Self {
        Self { motor: motor.clone(), bus_v: motor.rated_voltage_v, seed: 0 }
    }

    pub fn rated_torque_n_m(&self) -> f64 {
        self.motor.torque_constant() * self.motor.rated_current_a
    }
}

/// State of the machine: the arguments of the effects.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moment {
    /// Since the drive was last started.
    pub time_s: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
    pub angle_rad: f64,
    /// Flux as a multiple of the nameplate's.
    pub flux_factor: f64,
    pub torque_n_m: f64,
}

impl Moment {
    /// Step response of a first-order lag: `1 - exp(-(t - from_s)/time_constant_s)`, zero before `from_s`.
    pub(super) fn first_order_lag(&self, from_s: f64, time_constant_s: f64) -> f64 {
        let since_s = self.time_s - from_s;
        if since_s > 0.0 { -(-since_s / time_constant_s).exp_m1() } else { 0.0 }
    }
}

/// One physical effect at work in the true machine. Every hook defaults to "no effect there".
pub trait Mechanism: Send {
    /// Torque against a shaft that turns, N.m; positive against positive speed. Not called at rest.
    fn drag_torque_n_m(&self, _speed_rad_s: f64) -> f64 {
        0.0
    }

    /// Torque from outside, N.m; positive against positive speed, and there at rest too.
    fn load_torque_n_m(&self, _at: &Moment) -> f64 {
        0.0
    }

    /// Friction beyond Coulomb, N.m: always against the motion, and it holds a shaft at rest.
    fn friction_n_m(&self, _at: &Moment) -> f64 {
        0.0
    }

    /// Torque beyond friction that a shaft at rest holds before it breaks away, N.m.
    fn breakaway_extra_n_m(&self) -> f64 {
        0.0
    }

    /// The shaft has rested and just broken away in `direction` (+1 or -1). One that passes zero speed on its way back has
    /// not rested, and keeps its state.
    fn broke_away(&mut self, _direction: f64) {}

    /// Inertia, as a multiple of the motor's.
    fn inertia_factor(&self, _at: &Moment) -> f64 {
        1.0
    }

    /// Voltage lost inside the motor, V, with the sign of the current.
    fn voltage_loss_v(&self, _current_a: f64) -> f64 {
        0.0
    }

    /// Resistance now, as a multiple of the one at 25 C.
    fn resistance_factor(&self) -> f64 {
        1.0
    }

    /// Incremental inductance, as a multiple of the one without current.
    fn inductance_factor(&self, _current_a: f64) -> f64 {
        1.0
    }

    /// Flux (that is: back-EMF and torque constant), as a multiple of the nameplate's. The flux and torque of `at` are not
    /// computed yet.
    fn flux_factor(&self, _at: &Moment) -> f64 {
        1.0
    }

    /// Voltage of the drive's supply now, as a multiple of the one without load: what the motor gets of every volt.
    fn supply_factor(&self) -> f64 {
        1.0
    }

    /// Temperature rise of the winding over ambient, K, if the effect computes it.
    fn winding_rise_k(&self) -> Option<f64> {
        None
    }

    /// Advances own states by one step with the machine as it is in the step's middle, `put_out_v` the voltage that the
    /// drive means to put out.
    fn advance(&mut self, _step_s: f64, _at: &Moment, _put_out_v: f64) {}
}

/// A mechanism that is one law: the method of [`Mechanism`] that it answers, and its argument.
macro_rules! laws {
    ($($(#[$doc:meta])* $name:ident, $method:ident, $argument:ty;)+) => {$(
        $(#[$doc])*
        pub(super) fn $name(law: impl Fn($argument) -> f64 + Send + 'static) -> Box<dyn Mechanism> {
            struct Law<F>(F);

            impl<F: Fn($argument) -> f64 + Send> Mechanism for Law<F> {
                fn $method(&self, at: $argument) -> f64 {
                    (self.0)(at)
                }
            }

            Box::new(Law(law))
        }
    )+};
}

laws! {
    /// Torque against a shaft that turns at this speed, N.m.
    drag, drag_torque_n_m, f64;
    /// Torque from outside, N.m.
    load, load_torque_n_m, &Moment;
    /// Friction beyond Coulomb, N.m.
    friction, friction_n_m, &Moment;
    /// Inertia, as a multiple of the motor's.
    inertia_factor, inertia_factor, &Moment;
    /// Voltage lost at this current, V.
    voltage_loss, voltage_loss_v, f64;
    /// Incremental inductance at this current, as a multiple of the one without.
    inductance_factor, inductance_factor, f64;
    /// Flux, as a multiple of the nameplate's.
    flux_factor, flux_factor, &Moment;
}
