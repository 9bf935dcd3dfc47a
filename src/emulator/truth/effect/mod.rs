//! Hidden effects: one file each, one line each in the catalogue.
//!
//! ```text
//! speed   -> drag torque, breakaway torque --> torque balance
//! current -> voltage loss, R(T) -----------> voltage balance
//! ```

mod quadratic_load;
mod stribeck_friction;
mod viscous_friction;
mod voltage_drop;
mod winding_heating;

use serde::{Deserialize, Serialize};

pub use quadratic_load::QuadraticLoad;
pub use stribeck_friction::StribeckFriction;
pub use viscous_friction::ViscousFriction;
pub use voltage_drop::VoltageDrop;
pub use winding_heating::WindingHeating;

use super::MotorTruth;

/// One parameter of the truth: key as in the model file, value, unit.
pub type TrueParameter = (&'static str, f64, &'static str);

/// One physical effect at work in the true machine. Every hook defaults to "no effect there".
pub trait Mechanism: Send {
    /// Torque against the shaft, N.m; positive against positive speed. A function of speed and own state.
    fn drag_torque_n_m(&self, _speed_rad_s: f64) -> f64 {
        0.0
    }

    /// Torque beyond Coulomb friction that a shaft at rest holds before it breaks away, N.m.
    fn breakaway_extra_n_m(&self) -> f64 {
        0.0
    }

    /// The shaft has just broken away in `direction` (+1 or -1).
    fn broke_away(&mut self, _direction: f64) {}

    /// Voltage lost inside the motor, V, with the sign of the current.
    fn voltage_loss_v(&self, _current_a: f64) -> f64 {
        0.0
    }

    /// Resistance now, as a multiple of the one at 25 C.
    fn resistance_factor(&self) -> f64 {
        1.0
    }

    /// Rise of the winding over ambient, K, where the effect knows it.
    fn winding_rise_k(&self) -> Option<f64> {
        None
    }

    /// Advances own states by one step with current and speed in its middle.
    fn advance(&mut self, _step_s: f64, _current_a: f64, _speed_rad_s: f64) {}
}

/// The catalogue: `Variant(Config)` per effect; the ids are those of the model file.
macro_rules! catalogue {
    ($($variant:ident($config:ident) = $id:literal),+ $(,)?) => {
        /// One hidden effect as it stands in the emulator's configuration.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(tag = "id")]
        pub enum HiddenEffect {
            $(#[serde(rename = $id)] $variant($config),)+
        }

        impl HiddenEffect {
            /// Every id, in catalogue order.
            pub const IDS: &'static [&'static str] = &[$($id),+];

            pub const fn id(&self) -> &'static str {
                match self {
                    $(Self::$variant(_) => $id,)+
                }
            }

            /// The true parameters, under the keys of the model file.
            pub fn parameters(&self) -> Vec<TrueParameter> {
                match self {
                    $(Self::$variant(config) => config.parameters(),)+
                }
            }

            /// The mechanism at work in `motor`, from rest and cold.
            pub fn build(&self, motor: &MotorTruth) -> Box<dyn Mechanism> {
                match self {
                    $(Self::$variant(config) => config.build(motor),)+
                }
            }
        }
    };
}

catalogue! {
    ViscousFriction(ViscousFriction) = "viscous_friction",
    QuadraticLoad(QuadraticLoad) = "quadratic_load",
    StribeckFriction(StribeckFriction) = "stribeck_friction",
    VoltageDrop(VoltageDrop) = "voltage_drop",
    WindingHeating(WindingHeating) = "winding_heating",
}

#[cfg(test)]
mod tests {
    use super::super::motor::zk_22fc;
    use super::*;

    /// One of each, with the default sizes of the example configurations.
    fn one_of_each() -> Vec<HiddenEffect> {
        vec![
            HiddenEffect::ViscousFriction(ViscousFriction {
                viscous_n_m_s_per_rad: 4e-4,
            }),
            HiddenEffect::QuadraticLoad(QuadraticLoad {
                quadratic_n_m_s2_per_rad2: 1.8e-6,
            }),
            HiddenEffect::StribeckFriction(StribeckFriction {
                stribeck_n_m: 0.16,
                stribeck_speed_rad_s: 10.0,
            }),
            HiddenEffect::VoltageDrop(VoltageDrop { drop_v: 1.2 }),
            HiddenEffect::WindingHeating(WindingHeating {
                gain_per_a2_s: 2e-3,
                time_constant_s: 20.0,
            }),
        ]
    }

    #[test]
    fn contract_of_every_effect() {
        let effects = one_of_each();
        let ids: Vec<&str> = effects.iter().map(HiddenEffect::id).collect();
        assert_eq!(
            ids,
            HiddenEffect::IDS,
            "the test covers the whole catalogue"
        );
        let motor = zk_22fc();
        for effect in effects {
            let mut mechanism = effect.build(&motor);
            assert!(!effect.parameters().is_empty());
            for step in 0..4000 {
                let speed = 300.0 * (f64::from(step) * 0.01).sin();
                let current = 6.0 * (f64::from(step) * 0.017).cos();
                mechanism.advance(50e-6, current, speed);
                // A drag never drives (a bristle may give back what it stored, but never beyond its size), a loss
                // never feeds.
                assert!(mechanism.drag_torque_n_m(speed).is_finite());
                assert!(mechanism.voltage_loss_v(current) * current >= 0.0);
                assert!(mechanism.resistance_factor() >= 1.0);
                assert!(mechanism.breakaway_extra_n_m() >= 0.0);
            }
            assert!(mechanism.voltage_loss_v(0.0).abs() < 1e-12);
        }
    }
}
