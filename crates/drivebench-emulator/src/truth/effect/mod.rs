//! Hidden effects: one file each, one line each in `CATALOGUE`.
//!
//! ```text
//! kind (id, parameters, sizes) + values = HiddenEffect, as it stands in a configuration
//!     Inside ---> Mechanism: what it does inside the machine
//!         put-out voltage -> supply -> resistance, inductance, voltage loss --> voltage balance
//!         flux -----------------------------------------------------------> both balances
//!         drag (moving only), load (also at rest), friction (holds at rest) -> torque balance, stick-slip
//!     Behind ---> Shaft: a second inertia
//!     Between --> Path: dead times, filters and offsets of commands and measurements (path.rs)
//!     Together -> several other effects
//! ```
//!
//! Under `foreign/` are effects that no catalogue of the host has: for them the right answer is that nothing known
//! explains the run.

mod asymmetric_viscous;
mod backlash;
mod cogging;
mod command_delay;
mod constant_load;
mod current_filter;
mod current_offset;
mod discontinuous_conduction;
mod eccentric_load;
mod elastic_coupling;
mod field_change;
pub mod flux_saturation;
mod foreign;
mod friction_onset;
mod inductance_saturation;
mod inertia_change;
mod kind;
mod lagged_drag;
mod lagged_load;
mod load_dependent_friction;
mod load_step;
mod mechanism;
mod one_sided_load;
mod quadratic_load;
mod restart_delay;
mod speed_delay;
mod speed_filter;
mod speed_offset;
mod start_delay;
mod stribeck_friction;
mod supply_sag;
mod torque_ripple;
mod viscous_friction;
mod voltage_drop;
mod voltage_offset;
mod winding_heating;

use rand_chacha::ChaCha8Rng;
use serde::de::Error as _;
use serde::ser::SerializeMap as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use kind::Allowed::{Delay, Fraction, Loss, NotNegative, Positive, Share, Signed, Wave};
use kind::{Acts, Dice, HiddenKind, NOT_STUDIED, Parameter, named};
pub use kind::{Refused, TrueParameter};
pub use mechanism::{Mechanism, Moment, Site};
use mechanism::{
    drag, flux_factor, friction, inductance_factor, inertia_factor, load, voltage_loss,
};

use super::Path;
pub(super) use super::shaft::Shaft;

/// Every hidden effect. The order is that in which mysteries number those of the host's catalogue, and then the others.
static CATALOGUE: &[HiddenKind] = &[
    viscous_friction::KIND,
    quadratic_load::KIND,
    stribeck_friction::KIND,
    constant_load::KIND,
    asymmetric_viscous::KIND,
    cogging::KIND,
    torque_ripple::KIND,
    eccentric_load::KIND,
    load_dependent_friction::KIND,
    lagged_load::KIND,
    lagged_drag::KIND,
    load_step::KIND,
    one_sided_load::KIND,
    friction_onset::KIND,
    inertia_change::KIND,
    elastic_coupling::KIND,
    backlash::KIND,
    voltage_drop::KIND,
    supply_sag::KIND,
    winding_heating::KIND,
    flux_saturation::KIND,
    inductance_saturation::KIND,
    field_change::KIND,
    discontinuous_conduction::KIND,
    command_delay::KIND,
    start_delay::KIND,
    restart_delay::KIND,
    speed_delay::KIND,
    speed_filter::KIND,
    current_filter::KIND,
    current_offset::KIND,
    speed_offset::KIND,
    voltage_offset::KIND,
    foreign::shaker::KIND,
    foreign::torque_bump::KIND,
    foreign::random_load::KIND,
    foreign::exponential_stribeck::KIND,
    foreign::fan_three_halves::KIND,
    foreign::soft_drop::KIND,
    foreign::harmonic_cogging::KIND,
    foreign::load_ramp::KIND,
    foreign::messy::KIND,
];

/// One hidden effect as it stands in the emulator's configuration: an id, and a number for each key.
#[derive(Clone, Debug)]
pub struct HiddenEffect {
    kind: &'static HiddenKind,
    values: Vec<f64>,
}

impl HiddenEffect {
    /// The effect `id` with a value for each of its keys; `None` where the catalogue has no such effect or key, or one is
    /// left out.
    pub fn new(id: &str, values: &[(&str, f64)]) -> Option<Self> {
        let kind = CATALOGUE.iter().find(|kind| kind.id == id)?;
        let value = |parameter: &Parameter| {
            values.iter().find(|(key, _)| *key == parameter.key).map(|(_, value)| *value)
        };
        let complete: Option<Vec<f64>> = kind.parameters.iter().map(value).collect();
        let values = complete.filter(|complete| complete.len() == values.len())?;
        Some(Self { kind, values })
    }

    /// Every id, in catalogue order.
    pub fn ids() -> impl Iterator<Item = &'static str> {
        CATALOGUE.iter().map(|kind| kind.id)
    }

    /// Ids that a mystery draws from: those of the host's catalogue, or those that no catalogue has. Known effects in a
    /// wrong shape are not drawn: for them the name of the next of kin would be right too.
    pub(crate) fn mysteries(foreign: bool) -> Vec<&'static str> {
        let drawn = CATALOGUE
            .iter()
            .filter(|kind| kind.mystery.is_some() && kind.names.is_empty() == foreign);
        drawn.map(|kind| kind.id).collect()
    }

    /// The effect as a mystery draws it on a motor with this nameplate; `None` where none draws it.
    pub(crate) fn mystery(id: &str, rng: &mut ChaCha8Rng, nameplate: &Site) -> Option<Self> {
        let kind = CATALOGUE.iter().find(|kind| kind.id == id)?;
        let values = kind.mystery?(&mut Dice::new(rng, nameplate));
        Some(Self { kind, values })
    }

    /// Ids that the study of the diagnosis draws, with the names of the host's catalogue that are right for each.
    pub fn studied() -> impl Iterator<Item = (&'static str, &'static [&'static str])> {
        CATALOGUE.iter().filter(|kind| kind.is_studied()).map(|kind| (kind.id, kind.names))
    }

    /// The effect as the study draws it, each value multiplied by `share` of its key.
    pub fn study(id: &str, share: impl Fn(&str) -> f64, rng: &mut ChaCha8Rng) -> Option<Self> {
        let kind = CATALOGUE.iter().filter(|kind| kind.is_studied()).find(|kind| kind.id == id)?;
        let drawn = kind.parameters.iter().zip(kind.study(rng));
        let values = drawn.map(|(p, value)| share(p.key) * value).collect();
        Some(Self { kind, values })
    }

    pub const fn id(&self) -> &'static str {
        self.kind.id
    }

    /// The true parameters, under the keys of the model file.
    pub fn parameters(&self) -> Vec<TrueParameter> {
        let parameters = self.kind.parameters.iter().zip(&self.values);
        parameters.map(|(parameter, value)| (parameter.key, *value, parameter.unit)).collect()
    }

    pub fn value(&self, key: &str) -> Option<f64> {
        let place = self.kind.parameters.iter().position(|p| p.key == key)?;
        Some(self.values[place])
    }

    /// The first value that this effect cannot have.
    pub fn refused(&self) -> Option<Refused> {
        self.kind.parameters.iter().zip(&self.values).find_map(|(parameter, value)| {
            Some((parameter.key, *value, parameter.allowed.refuses(*value)?))
        })
    }

    /// Whether no catalogue of the host has it.
    pub fn is_foreign(&self) -> bool {
        !self.kind.names.contains(&self.kind.id)
    }

    /// The mechanism at work on this site, from rest and cold; `None` for what is only in the path or a second inertia.
    pub fn mechanism(&self, site: &Site) -> Option<Box<dyn Mechanism>> {
        match self.kind.acts {
            Acts::Inside(make) => Some(make(&self.values, site)),
            _ => None,
        }
    }

    /// What it does between command, machine and measurement, its parts included.
    pub fn path(&self, site: &Site) -> Path {
        match self.kind.acts {
            Acts::Between(field) => {
                let mut path = Path::default();
                *field(&mut path) = self.values[0];
                path
            }
            Acts::Together(make) => make(self.values[0], site)
                .iter()
                .fold(Path::default(), |path, part| path.plus(part.path(site))),
            Acts::Inside(_) | Acts::Behind(_) => Path::default(),
        }
    }

    /// The effects that it is made of; itself where it is one.
    pub fn single(&self, site: &Site) -> Vec<Self> {
        match self.kind.acts {
            Acts::Together(make) => make(self.values[0], site),
            _ => vec![self.clone()],
        }
    }

    /// The second inertia that it puts behind the shaft.
    pub(super) fn shaft(&self, site: &Site) -> Option<Shaft> {
        match self.kind.acts {
            Acts::Behind(make) => Some(make(&self.values, site)),
            _ => None,
        }
    }

    /// Whether it is a second inertia; a machine can have one.
    pub const fn is_shaft(&self) -> bool {
        matches!(self.kind.acts, Acts::Behind(_))
    }

    /// All mechanisms at work, those of its parts included.
    pub(super) fn mechanisms(&self, site: &Site) -> Vec<Box<dyn Mechanism>> {
        self.single(site).iter().filter_map(|part| part.mechanism(site)).collect()
    }

    /// One of each in the sizes of the example configuration, for tests.
    #[cfg(test)]
    pub(crate) fn one_of_each() -> Vec<Self> {
        let usual = |kind: &'static HiddenKind| Self {
            kind,
            values: kind.parameters.iter().map(|parameter| parameter.usual).collect(),
        };
        CATALOGUE.iter().map(usual).collect()
    }
}

impl PartialEq for HiddenEffect {
    fn eq(&self, other: &Self) -> bool {
        self.id() == other.id() && self.values == other.values
    }
}

impl Serialize for HiddenEffect {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(1 + self.values.len()))?;
        map.serialize_entry("id", self.id())?;
        for (key, value, _) in self.parameters() {
            map.serialize_entry(key, &value)?;
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for HiddenEffect {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let table = toml::Table::deserialize(deserializer)?;
        let id = table.get("id").ok_or_else(|| D::Error::missing_field("id"))?;
        let id = id.as_str().unwrap_or_default();
        let kind = CATALOGUE
            .iter()
            .find(|kind| kind.id == id)
            .ok_or_else(|| D::Error::custom(unknown("variant", id, Self::ids())))?;
        let keys = kind.parameters.iter().map(|parameter| parameter.key);
        let is_unknown = |key: &&String| *key != "id" && !keys.clone().any(|known| known == *key);
        if let Some(key) = table.keys().find(is_unknown) {
            return Err(D::Error::custom(unknown("field", key, keys)));
        }
        let value = |key| {
            let value = table.get(key).ok_or_else(|| D::Error::missing_field(key))?;
            f64::deserialize(value.clone()).map_err(|error| D::Error::custom(error.message()))
        };
        let values = keys.clone().map(value).collect::<Result<_, _>>()?;
        Ok(Self { kind, values })
    }
}

/// In the words of serde's message for an enum or a struct.
fn unknown(what: &str, given: &str, known: impl Iterator<Item = &'static str>) -> String {
    let known: Vec<String> = known.map(|name| format!("`{name}`")).collect();
    let expected = match &known[..] {
        [one] => one.clone(),
        [one, other] => format!("{one} or {other}"),
        _ => format!("one of {}", known.join(", ")),
    };
    format!("unknown {what} `{given}`, expected {expected}")
}

#[cfg(test)]
mod tests;
