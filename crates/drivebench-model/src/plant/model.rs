//! Baseline motor plus the effects that were added to it.

use thiserror::Error;

use super::effect::{self, Effect, ParameterRole, ParameterSpec, Path, Terms};
use super::motor::{Motor, MotorKey};

#[derive(Clone, Debug, Error, PartialEq)]
pub enum ModelError {
    #[error("effect {id:?} is not in the catalogue")]
    UnknownEffect { id: String },
    #[error("effect {id:?} is in the model already")]
    Duplicate { id: String },
    #[error("elastic_coupling and backlash are both in the model: there is one second inertia")]
    SecondCoupling,
    #[error("effect {id:?} is not in the model")]
    Absent { id: String },
    #[error("{key} = {value} is not allowed (expected {allowed})")]
    Value {
        key: String,
        value: f64,
        allowed: String,
    },
    #[error("parameter {key:?} is not one of this model")]
    UnknownParameter { key: String },
    #[error("{key} has no value: identify the model first, or give it in the model file")]
    Unset { key: String },
}

impl ModelError {
    /// The key that the error is about, as it stands in a model file; empty where it is about none.
    pub fn key(&self) -> &str {
        match self {
            Self::Value { key, .. } | Self::UnknownParameter { key } | Self::Unset { key } => {
                key.rsplit('.').next().unwrap_or(key)
            }
            Self::UnknownEffect { .. }
            | Self::Duplicate { .. }
            | Self::Absent { .. }
            | Self::SecondCoupling => "",
        }
    }

    pub const fn help(&self) -> &'static str {
        match self {
            Self::UnknownEffect { .. } => "`drivebench effects` lists the catalogue",
            Self::SecondCoupling => "take one out: backlash has the elasticity of the shaft in it",
            Self::Duplicate { .. } | Self::Absent { .. } => {
                "see the [[effect]] tables of the model file"
            }
            Self::Value { .. } | Self::UnknownParameter { .. } => {
                "see the commented example in bench-configs/"
            }
            Self::Unset { .. } => "run `drivebench identify RUN --model MODEL.toml` first",
        }
    }
}

/// An effect in a model; a value left out is to be fitted.
#[derive(Clone)]
pub struct ActiveEffect {
    pub effect: &'static dyn Effect,
    pub values: Vec<Option<f64>>,
}

impl std::fmt::Debug for ActiveEffect {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ActiveEffect")
            .field("id", &self.effect.card().id)
            .field("values", &self.values)
            .finish()
    }
}

impl ActiveEffect {
    pub fn new(effect: &'static dyn Effect) -> Self {
        Self {
            effect,
            values: vec![None; effect.parameters().len()],
        }
    }

    /// With these values, in the order of its parameters.
    pub fn with(effect: &'static dyn Effect, values: &[f64]) -> Self {
        Self {
            effect,
            values: values.iter().copied().map(Some).collect(),
        }
    }

    pub fn id(&self) -> &'static str {
        self.effect.card().id
    }

    /// Values in the order of the effect's parameters, the unset ones at their first guess.
    pub fn values_or_guess(&self) -> Vec<f64> {
        let specs = self.effect.parameters();
        self.values
            .iter()
            .zip(specs)
            .map(|(value, spec)| value.unwrap_or_else(|| spec.guess()))
            .collect()
    }

    /// Its terms where they are known at any instant: every value is given, and nothing but that instant decides them.
    pub fn terms_of_the_instant(&self) -> Option<Box<dyn Terms>> {
        let values: Option<Vec<f64>> = self.values.iter().copied().collect();
        let terms = self.effect.terms(&values?);
        terms.is_of_the_instant().then_some(terms)
    }
}

/// One parameter of a model: a motor key or an effect's.
#[derive(Clone, Copy, Debug)]
pub enum Slot {
    Motor(MotorKey),
    Effect {
        index: usize,
        parameter: usize,
        spec: &'static ParameterSpec,
        id: &'static str,
    },
}

impl Slot {
    /// `inertia_kg_m2`, or `stribeck_friction.stribeck_n_m`.
    pub fn key(&self) -> String {
        match self {
            Self::Motor(key) => key.key().to_owned(),
            Self::Effect { spec, id, .. } => format!("{id}.{}", spec.key),
        }
    }

    /// Whether it is an effect's parameter that is found in this way.
    pub fn has_role(&self, role: ParameterRole) -> bool {
        matches!(self, Self::Effect { spec, .. } if spec.role == role)
    }

    pub const fn unit(&self) -> &'static str {
        match self {
            Self::Motor(key) => key.unit(),
            Self::Effect { spec, .. } => spec.unit,
        }
    }
}

/// A motor and its effects; `fixed` lists the parameters that a fit leaves alone.
#[derive(Clone, Debug, Default)]
pub struct Model {
    pub motor: Motor,
    pub effects: Vec<ActiveEffect>,
    pub fixed: Vec<String>,
    /// Those of `fixed` that are it only for the sake of an effect.
    pub held: Vec<Held>,
}

/// A parameter that an effect would explain as well, fixed for as long as the effect is in the model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Held {
    pub effect: String,
    pub key: String,
}

impl Model {
    pub fn baseline(motor: Motor) -> Self {
        Self {
            motor,
            ..Self::default()
        }
    }

    /// Every parameter of the model. The torque constant is one only where the motor gives it, and the electrical keys
    /// only where the model is electrical.
    pub fn slots(&self) -> Vec<Slot> {
        let mechanical_only = self.is_mechanical_only();
        let mut slots: Vec<Slot> = MotorKey::ALL
            .into_iter()
            .filter(|key| !(mechanical_only && key.is_electrical()))
            .filter(|key| *key != MotorKey::TorqueConstant || self.motor.get(*key).is_some())
            .map(Slot::Motor)
            .collect();
        for (index, active) in self.effects.iter().enumerate() {
            for (parameter, spec) in active.effect.parameters().iter().enumerate() {
                slots.push(Slot::Effect {
                    index,
                    parameter,
                    spec,
                    id: active.id(),
                });
            }
        }
        slots
    }

    /// Slots that a fit may change. A given torque constant is never fitted: the torque balance fixes only the ratios
    /// of torque constant, inertia and load. Neither is what is chosen from a grid.
    pub fn free_slots(&self) -> Vec<Slot> {
        let mut slots = self.slots();
        slots.retain(|slot| {
            !self.fixed.contains(&slot.key())
                && !matches!(slot, Slot::Motor(MotorKey::TorqueConstant))
                && !slot.has_role(ParameterRole::Choice)
        });
        slots
    }

    /// True when no electrical key is given: only the torque balance can be used.
    pub fn is_mechanical_only(&self) -> bool {
        let mechanical = self.motor.get(MotorKey::Inertia).is_some()
            || self.motor.get(MotorKey::LoadTorque).is_some();
        mechanical
            && MotorKey::ALL
                .into_iter()
                .filter(|key| key.is_electrical())
                .all(|key| self.motor.get(key).is_none())
    }

    pub fn get(&self, slot: &Slot) -> Option<f64> {
        match *slot {
            Slot::Motor(key) => self.motor.get(key),
            Slot::Effect {
                index, parameter, ..
            } => self.effects[index].values[parameter],
        }
    }

    pub fn set(&mut self, slot: &Slot, value: f64) {
        match *slot {
            Slot::Motor(key) => self.motor.set(key, value),
            Slot::Effect {
                index, parameter, ..
            } => self.effects[index].values[parameter] = Some(value),
        }
    }

    pub fn effect_ids(&self) -> Vec<&'static str> {
        self.effects.iter().map(ActiveEffect::id).collect()
    }

    pub fn has(&self, id: &str) -> bool {
        self.effects.iter().any(|active| active.id() == id)
    }

    /// The model with one more effect, its parameters to be fitted.
    pub fn with_effect(&self, id: &str) -> Result<Self, ModelError> {
        if self.has(id) {
            return Err(ModelError::Duplicate { id: id.to_owned() });
        }
        let effect =
            effect::find(id).ok_or_else(|| ModelError::UnknownEffect { id: id.to_owned() })?;
        let mut model = self.clone();
        model.effects.push(ActiveEffect::new(effect));
        Ok(model)
    }

    /// The way of command and measurement, as far as its effects have their values.
    pub fn known_path(&self) -> Path {
        let known = self.effects.iter().filter_map(|active| {
            let values: Option<Vec<f64>> = active.values.iter().copied().collect();
            Some(active.effect.terms(&values?).path())
        });
        known.fold(Path::default(), Path::plus)
    }

    /// Fixes the parameter `key` for as long as the effect `id` is in the model. False where somebody fixed it for good.
    pub fn hold(&mut self, id: &str, key: &str) -> bool {
        let is_fixed = self.fixed.iter().any(|fixed| fixed == key);
        if is_fixed && !self.held.iter().any(|held| held.key == key) {
            return false;
        }
        if !is_fixed {
            self.fixed.push(key.to_owned());
        }
        let held = Held {
            effect: id.to_owned(),
            key: key.to_owned(),
        };
        if !self.held.contains(&held) {
            self.held.push(held);
        }
        true
    }

    /// The model with one effect less, and free what was fixed for its sake.
    pub fn without_effect(&self, id: &str) -> Result<Self, ModelError> {
        if !self.has(id) {
            return Err(ModelError::Absent { id: id.to_owned() });
        }
        let mut model = self.clone();
        model.effects.retain(|active| active.id() != id);
        let prefix = format!("{id}.");
        model.fixed.retain(|key| !key.starts_with(&prefix));
        model.held.retain(|held| held.effect != id);
        let is_freed = |key: &String| {
            let holds = |held: &Held| held.key == *key;
            self.held.iter().any(holds) && !model.held.iter().any(holds)
        };
        model.fixed.retain(|key| !is_freed(key));
        Ok(model)
    }

    /// Checks that every given value is finite, positive where physics wants it, and within its bounds.
    pub fn validate(&self) -> Result<(), ModelError> {
        let refuse = |key: String, value: f64, allowed: &str| {
            Err(ModelError::Value {
                key,
                value,
                allowed: allowed.to_owned(),
            })
        };
        for slot in self.slots() {
            let Some(value) = self.get(&slot) else {
                continue;
            };
            match &slot {
                Slot::Motor(MotorKey::LoadTorque) if !(value >= 0.0 && value.is_finite()) => {
                    return refuse(slot.key(), value, "0 or more");
                }
                Slot::Motor(key)
                    if *key != MotorKey::LoadTorque && !(value > 0.0 && value.is_finite()) =>
                {
                    return refuse(slot.key(), value, "a number above 0");
                }
                Slot::Effect { spec, .. } if !(spec.min..=spec.max).contains(&value) => {
                    let allowed = if spec.is_coefficient() {
                        "a finite number".to_owned()
                    } else {
                        format!("{} to {} {}", spec.min, spec.max, spec.unit)
                    };
                    return refuse(slot.key(), value, &allowed);
                }
                _ => {}
            }
        }
        let keys: Vec<String> = self.slots().iter().map(Slot::key).collect();
        match self.fixed.iter().find(|key| !keys.contains(key)) {
            Some(key) => Err(ModelError::UnknownParameter { key: key.clone() }),
            None => Ok(()),
        }
    }

    /// A parameter that has no value and is not to be fitted, if there is one.
    pub fn require_complete(&self) -> Result<(), ModelError> {
        match self.slots().iter().find(|slot| self.get(slot).is_none()) {
            Some(slot) => Err(ModelError::Unset { key: slot.key() }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effects_are_added_once_and_removed_with_their_fixed_keys() {
        let base = Model::baseline(Motor::zk_22fc());
        let mut more = base.with_effect("stribeck_friction").unwrap();
        more.fixed
            .push("stribeck_friction.stribeck_speed_rad_s".to_owned());
        assert!(more.validate().is_ok());
        assert!(matches!(
            more.with_effect("stribeck_friction"),
            Err(ModelError::Duplicate { .. })
        ));
        let back = more.without_effect("stribeck_friction").unwrap();
        assert!(back.effects.is_empty() && back.fixed.is_empty());
        assert!(matches!(
            base.with_effect("gremlins"),
            Err(ModelError::UnknownEffect { .. })
        ));
    }

    #[test]
    fn what_was_fixed_for_an_effect_is_free_without_it() {
        let mut model = Model::baseline(Motor::zk_22fc());
        model.fixed.push("inductance_h".to_owned());
        for id in ["voltage_drop", "supply_sag"] {
            model = model.with_effect(id).unwrap();
            assert!(model.hold(id, "resistance_ohm"));
        }
        assert!(!model.hold("supply_sag", "inductance_h"), "fixed for good");
        assert_eq!(model.fixed, ["inductance_h", "resistance_ohm"]);
        let one = model.without_effect("supply_sag").unwrap();
        assert_eq!(one.fixed, model.fixed, "the other still holds it");
        let none = one.without_effect("voltage_drop").unwrap();
        assert_eq!(none.fixed, ["inductance_h"]);
        assert!(none.held.is_empty());
    }

    #[test]
    fn a_negative_inertia_and_nan_are_refused() {
        for value in [-1.0, 0.0, f64::NAN, f64::INFINITY] {
            let motor = Motor::zk_22fc().with(MotorKey::Inertia, value);
            assert!(Model::baseline(motor).validate().is_err(), "{value}");
        }
    }

    #[test]
    fn a_mechanical_model_has_no_electrical_slots() {
        let motor = Motor::new("axis")
            .with(MotorKey::Inertia, 90.0)
            .with(MotorKey::LoadTorque, 10.0);
        let model = Model::baseline(motor);
        assert_eq!(model.slots().len(), 2);
        assert!(Model::baseline(Motor::new("unknown")).slots().len() == 5);
    }
}
