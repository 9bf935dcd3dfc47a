//! Baseline motor plus the effects that were added to it.

use thiserror::Error;

use super::effect::{self, Effect, ParameterRole, ParameterSpec, Path, Terms};
use super::motor::{Motor, MotorKey};
use super::scenario::Scenario;

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
    Value { key: String, value: f64, allowed: String },
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
        Self { effect, values: vec![None; effect.parameters().len()] }
    }

    /// With these values, in the order of its parameters.
    pub fn with(effect: &'static dyn Effect, values: &[f64]) -> Self {
        Self { effect, values: values.iter().copied().map(Some).collect() }
    }

    pub fn id(&self) -> &'static str {
        self.effect.card().id
    }

    /// Values in the order of the effect's parameters, the unset ones at their first guess.
    pub fn values_or_guess(&self) -> Vec<f64> {
        let values = self.values.iter().zip(self.effect.parameters());
        values.map(|(value, spec)| value.unwrap_or_else(|| spec.guess())).collect()
    }

    /// Its terms, where no value is missing.
    fn given_terms(&self) -> Option<Box<dyn Terms>> {
        let values: Option<Vec<f64>> = self.values.iter().copied().collect();
        Some(self.effect.terms(&values?))
    }

    /// Its terms where no value is missing and they depend on the present instant alone.
    pub fn terms_of_the_instant(&self) -> Option<Box<dyn Terms>> {
        self.given_terms().filter(|terms| terms.is_of_the_instant())
    }
}

/// One parameter of a model: a motor key or an effect's.
#[derive(Clone, Copy, Debug)]
pub enum Slot {
    Motor(MotorKey),
    Effect { index: usize, parameter: usize, spec: &'static ParameterSpec, id: &'static str },
}

impl Slot {
    /// `inertia_kg_m2`, or `stribeck_friction.stribeck_n_m`.
    pub fn key(&self) -> String {
        match self {
            Self::Motor(key) => key.key().to_owned(),
            Self::Effect { spec, id, .. } => format!("{id}.{}", spec.key),
        }
    }

    /// Whether it is a parameter of an effect with this role.
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

/// A motor and its effects; `fixed` lists the parameters that a fit does not change.
#[derive(Clone, Debug, Default)]
pub struct Model {
    pub motor: Motor,
    pub effects: Vec<ActiveEffect>,
    pub fixed: Vec<String>,
    /// Those of `fixed` that are fixed only while an effect is in the model.
    pub held: Vec<Held>,
    /// By how much the commands act later than the stamps of the host, s, on a link without the drive's clock; negative where
    /// earlier. A property of the link: runs that the drive has stamped do not have it. `None` where it was not estimated.
    pub input_delay_s: Option<f64>,
}

/// A parameter that an effect would explain as well, fixed for as long as the effect is in the model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Held {
    pub effect: String,
    pub key: String,
}

impl Model {
    /// By how much the commands of this run act later than their stamps, s.
    pub fn input_delay_in(&self, run: &Scenario) -> f64 {
        self.input_delay_s.filter(|_| run.is_stamped_by_host()).unwrap_or(0.0)
    }

    pub fn baseline(motor: Motor) -> Self {
        Self { motor, ..Self::default() }
    }

    /// Every parameter of the model. The torque constant is one only where the motor gives it, and the electrical keys
    /// only where the model is electrical.
    pub fn slots(&self) -> Vec<Slot> {
        // Where no electrical key is given only the torque balance can be used.
        let mut given = MotorKey::ALL.into_iter().filter(|key| self.motor.get(*key).is_some());
        let has_any = given.clone().next().is_some();
        let mechanical_only = has_any && !given.any(MotorKey::is_electrical);
        let mut slots: Vec<Slot> = MotorKey::ALL
            .into_iter()
            .filter(|key| !(mechanical_only && key.is_electrical()))
            .filter(|key| *key != MotorKey::TorqueConstant || self.motor.get(*key).is_some())
            .map(Slot::Motor)
            .collect();
        for (index, active) in self.effects.iter().enumerate() {
            for (parameter, spec) in active.effect.parameters().iter().enumerate() {
                slots.push(Slot::Effect { index, parameter, spec, id: active.id() });
            }
        }
        slots
    }

    /// Slots that a fit may change. Not among them: a given torque constant, because the torque balance determines only the ratios
    /// of torque constant, inertia and load; and a parameter that is chosen from a grid.
    pub fn free_slots(&self) -> Vec<Slot> {
        let mut slots = self.slots();
        slots.retain(|slot| {
            !self.fixed.contains(&slot.key())
                && !matches!(slot, Slot::Motor(MotorKey::TorqueConstant))
                && !slot.has_role(ParameterRole::Choice)
        });
        slots
    }

    pub fn get(&self, slot: &Slot) -> Option<f64> {
        match *slot {
            Slot::Motor(key) => self.motor.get(key),
            Slot::Effect { index, parameter, .. } => self.effects[index].values[parameter],
        }
    }

    pub fn set(&mut self, slot: &Slot, value: f64) {
        match *slot {
            Slot::Motor(key) => self.motor.set(key, value),
            Slot::Effect { index, parameter, .. } => {
                self.effects[index].values[parameter] = Some(value);
            }
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
        let effect = effect::find(id);
        let effect = effect.ok_or_else(|| ModelError::UnknownEffect { id: id.to_owned() })?;
        let mut model = self.clone();
        model.effects.push(ActiveEffect::new(effect));
        Ok(model)
    }

    /// The path of command and measurement, by the effects that have their values.
    pub fn known_path(&self) -> Path {
        let known = self.effects.iter().filter_map(ActiveEffect::given_terms);
        known.map(|terms| terms.path()).fold(Path::default(), Path::plus)
    }

    /// Fixes the parameter `key` for as long as the effect `id` is in the model. False where it is fixed independently.
    pub fn hold(&mut self, id: &str, key: &str) -> bool {
        let is_fixed = self.fixed.iter().any(|fixed| fixed == key);
        if is_fixed && !self.held.iter().any(|held| held.key == key) {
            return false;
        }
        if !is_fixed {
            self.fixed.push(key.to_owned());
        }
        let held = Held { effect: id.to_owned(), key: key.to_owned() };
        if !self.held.contains(&held) {
            self.held.push(held);
        }
        true
    }

    /// The model with one effect less, and without the parameters that were fixed for it.
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

    /// Checks that every given value is finite, positive where physics requires it, and within its bounds.
    pub fn validate(&self) -> Result<(), ModelError> {
        for slot in self.slots() {
            let Some(value) = self.get(&slot) else { continue };
            let finite = value.is_finite();
            let (is_allowed, allowed) = match &slot {
                Slot::Motor(MotorKey::LoadTorque) => {
                    (value >= 0.0 && finite, "0 or more".to_owned())
                }
                Slot::Motor(_) => (value > 0.0 && finite, "a number above 0".to_owned()),
                Slot::Effect { spec, .. } => (spec.admits(value), spec.allowed()),
            };
            if !is_allowed {
                let key = slot.key();
                return Err(ModelError::Value { key, value, allowed });
            }
        }
        let keys: Vec<String> = self.slots().iter().map(Slot::key).collect();
        let unknown = self.fixed.iter().find(|key| !keys.contains(key)).cloned();
        unknown.map_or(Ok(()), |key| Err(ModelError::UnknownParameter { key }))
    }

    pub fn require_complete(&self) -> Result<(), ModelError> {
        let slots = self.slots();
        let unset = slots.iter().find(|slot| self.get(slot).is_none());
        unset.map_or(Ok(()), |slot| Err(ModelError::Unset { key: slot.key() }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn effects_are_added_once_and_removed_with_their_fixed_keys() {
        let base = Model::baseline(Motor::zk_22fc());
        let mut more = base.with_effect("stribeck_friction").unwrap();
        more.fixed.push("stribeck_friction.stribeck_speed_rad_s".to_owned());
        assert!(more.validate().is_ok());
        let duplicate = more.with_effect("stribeck_friction").unwrap_err();
        assert!(matches!(duplicate, ModelError::Duplicate { .. }));
        let back = more.without_effect("stribeck_friction").unwrap();
        assert!(back.effects.is_empty() && back.fixed.is_empty());
        let unknown = base.with_effect("gremlins").unwrap_err();
        assert!(matches!(unknown, ModelError::UnknownEffect { .. }));
        more.fixed.push("gremlins".to_owned());
        assert_eq!(more.validate().unwrap_err().key(), "gremlins");
        assert_eq!(more.require_complete().unwrap_err().key(), "stribeck_n_m");
    }

    #[test]
    fn what_was_fixed_for_an_effect_is_free_without_it() {
        let mut model = Model::baseline(Motor::zk_22fc());
        model.fixed.push("inductance_h".to_owned());
        for id in ["voltage_drop", "supply_sag"] {
            model = model.with_effect(id).unwrap();
            assert!(model.hold(id, "resistance_ohm"));
        }
        assert!(!model.hold("supply_sag", "inductance_h"), "fixed independently");
        assert_eq!(model.fixed, ["inductance_h", "resistance_ohm"]);
        let one = model.without_effect("supply_sag").unwrap();
        assert_eq!(one.fixed, model.fixed, "the other still holds it");
        let none = one.without_effect("voltage_drop").unwrap();
        assert_eq!(none.fixed, ["inductance_h"]);
        assert!(none.held.is_empty());
    }

    #[test]
    fn impossible_values_are_refused_and_slots_follow_the_keys() {
        for value in [-1.0, 0.0, f64::NAN, f64::INFINITY] {
            let motor = Motor::zk_22fc().with(MotorKey::Inertia, value);
            assert!(Model::baseline(motor).validate().is_err(), "{value}");
        }
        let axis = Motor::new("axis").with(MotorKey::Inertia, 90.0);
        assert_eq!(Model::baseline(axis.with(MotorKey::LoadTorque, 10.0)).slots().len(), 2);
        assert_eq!(Model::baseline(Motor::new("unknown")).slots().len(), 5);
    }
}
