//! The catalogue of physical effects beyond the baseline: one file each, one line in [`CATALOGUE`].
//!
//! ```text
//! Effect (card, parameters) --terms(values)--> Terms: additions to
//!     the voltage balance (V, subtracted from u)      the friction level (N.m, against the motion)
//!     the torque balance (N.m, subtracted)            states of its own
//!     the rates of current and speed (gains on 1/L and on J)
//!     the path of command and measurement (Path)      a second inertia behind a shaft (Coupling)
//! ```

mod angle;
mod asymmetric_viscous;
mod backlash;
mod cogging;
mod command_delay;
mod constant_load;
mod current_filter;
mod current_offset;
mod custom;
mod defined;
mod definition;
mod discontinuous_conduction;
mod eccentric_load;
mod elastic_coupling;
mod field_change;
mod flux_saturation;
mod formula;
mod friction_onset;
mod grammar;
mod inductance_saturation;
mod inertia_change;
mod kind;
mod lagged_drag;
mod lagged_load;
mod load_dependent_friction;
mod load_step;
mod one_sided_load;
mod parameter;
mod quadratic_load;
mod restart_delay;
mod speed_delay;
mod speed_filter;
mod speed_offset;
mod start_delay;
mod stribeck_friction;
mod supply_sag;
mod table;
mod terms;
mod torque_ripple;
mod viscous_friction;
mod voltage_drop;
mod voltage_offset;
mod winding_heating;

pub use angle::ShaftAngle;
pub use defined::{FAMILIES, define, family};
pub use definition::{DefinitionError, Layout};
pub use formula::{Formula, Place, SYMBOLS};
pub use grammar::{Mistake, Tree, read as read_expression};
pub use kind::{BiasedFit, Harmonic, Limit, TermKind, VISCOUS_SLOPE, VOLTAGE_DROP};
pub use parameter::{ParameterRole, ParameterSpec, SearchRange};
pub use table::{Axis, weights as table_weights};
pub use terms::{Coupling, Instant, Path, Sums, Terms};

use crate::plant::run_scales::Measure;
use crate::tabulated;
use parameter::WAVE_ORDERS;
use terms::{
    begun, current_rate_gain, friction, inertia_gain, path, torque, voltage, voltage_and_torque,
};

pub const CATALOGUE: &[&dyn Effect] = &[
    &viscous_friction::EFFECT,
    &quadratic_load::EFFECT,
    &lagged_load::EFFECT,
    &lagged_drag::EFFECT,
    &stribeck_friction::EFFECT,
    &constant_load::EFFECT,
    &asymmetric_viscous::EFFECT,
    &cogging::EFFECT,
    &eccentric_load::EFFECT,
    &torque_ripple::EFFECT,
    &load_dependent_friction::EFFECT,
    &load_step::EFFECT,
    &one_sided_load::EFFECT,
    &friction_onset::EFFECT,
    &inertia_change::EFFECT,
    &voltage_drop::EFFECT,
    &supply_sag::EFFECT,
    &winding_heating::EFFECT,
    &flux_saturation::EFFECT,
    &inductance_saturation::EFFECT,
    &field_change::EFFECT,
    &discontinuous_conduction::EFFECT,
    &command_delay::EFFECT,
    &start_delay::EFFECT,
    &restart_delay::EFFECT,
    &speed_delay::EFFECT,
    &speed_filter::EFFECT,
    &current_filter::EFFECT,
    &current_offset::EFFECT,
    &speed_offset::EFFECT,
    &voltage_offset::EFFECT,
    &elastic_coupling::EFFECT,
    &backlash::EFFECT,
];

pub fn find(id: &str) -> Option<&'static dyn Effect> {
    CATALOGUE.iter().copied().find(|effect| effect.card().id == id)
}

tabulated! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Balance {
        Voltage = "voltage",
        Torque = "torque",
    }
    pub const fn key(self) -> &'static str;
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Enters {
    Voltage,
    Torque,
    /// Both balances, as a change of the flux does.
    Both,
    /// Neither: it lies between the motor and what is commanded or measured.
    Path,
}

impl Balance {
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Voltage => "V",
            Self::Torque => "N.m",
        }
    }
}

impl From<Balance> for Enters {
    fn from(balance: Balance) -> Self {
        match balance {
            Balance::Voltage => Self::Voltage,
            Balance::Torque => Self::Torque,
        }
    }
}

impl Enters {
    pub const fn includes(self, balance: Balance) -> bool {
        matches!(
            (self, balance),
            (Self::Both, _) | (Self::Voltage, Balance::Voltage) | (Self::Torque, Balance::Torque)
        )
    }
}

/// An effect: its description, its parameters and its terms.
#[derive(Debug)]
pub struct Card {
    pub id: &'static str,
    pub name: &'static str,
    pub enters: Enters,
    pub equation: &'static str,
    /// Causes that share this equation: a name is an equation, not a cause.
    pub causes: &'static str,
    pub looks_like: &'static str,
    pub excite: &'static str,
    pub remedy: &'static str,
    pub needs_angle: bool,
    /// Whether it dissipates power, so that a negative size is impossible and shows that the fit compensates another effect. Not
    /// so a voltage drop, which a drive may over-compensate.
    pub takes_power: bool,
    /// Prior probability: the share of machines and runs in which it shows.
    pub share_beforehand: f64,
    /// Equation and axis, where it is a function of one quantity.
    pub curve: Option<(Balance, Axis)>,
    /// Equivalent effects, of which a model holds one: simple ones that this one contains, and ones that are this one to first
    /// order.
    pub alternatives: &'static [&'static str],
    /// Effects that are never selected together with it: both together are equivalent to a third effect.
    pub excludes: &'static [&'static str],
    /// Pairs of effects that are together equivalent to this one, to first order.
    pub stands_for: &'static [[&'static str; 2]],
    /// The simpler effect to which it degenerates at the end of a range.
    pub limit: Option<Limit>,
    /// Kind of a harmonic of the shaft angle, the first without an `order`; `None` for any other effect.
    pub harmonic: Option<Harmonic>,
    /// Whether steps of it at many moments add up to the random walk of the load that a Kalman filter follows.
    pub is_disturbance_step: bool,
    /// The quantity that it changes, for a text with a signed size; else the name of the effect.
    pub changes: Option<&'static str>,
    /// Cause of a drift of its size from run to run.
    pub drift_cause: Option<&'static str>,
    /// Fits that it biases most where the model lacks it.
    pub biases: &'static [BiasedFit],
    /// Effects that no run can separate from it, because both have the same equation.
    pub equivalences: &'static [&'static str],
    /// The first gives the effect its size.
    pub parameters: &'static [ParameterSpec],
    /// Its law as a formula of [`SYMBOLS`] and its parameters; empty for a delay or a second inertia.
    pub formula: &'static [(Place, &'static str)],
    /// Its terms, for values in the order of the parameters.
    pub terms: fn(&[f64]) -> Box<dyn Terms>,
}

impl Card {
    /// Defaults of a card: no texts, no terms.
    pub const PLAIN: Self = Self {
        id: "",
        name: "",
        enters: Enters::Path,
        equation: "",
        causes: "",
        looks_like: "",
        excite: "",
        remedy: "",
        needs_angle: false,
        takes_power: false,
        share_beforehand: 0.1,
        curve: None,
        alternatives: &[],
        excludes: &[],
        stands_for: &[],
        limit: None,
        harmonic: None,
        is_disturbance_step: false,
        changes: None,
        drift_cause: None,
        biases: &[],
        equivalences: &[],
        parameters: &[],
        formula: &[],
        terms: |_| Box::new(Path::default()),
    };
}

/// A physical effect: of the catalogue, or one that a user or the data define.
pub trait Effect: Sync {
    fn card(&self) -> &Card;

    fn parameters(&self) -> &'static [ParameterSpec] {
        self.card().parameters
    }

    /// Which parameter gives the effect its size: the first coefficient; of an effect that has none, the first of all.
    fn size_index(&self) -> usize {
        self.parameters().iter().position(ParameterSpec::is_coefficient).unwrap_or(0)
    }

    /// `values` in the order of [`Effect::parameters`].
    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        (self.card().terms)(values)
    }

    /// Whether it depends on the time since the first command of a run or has a state, so that runs of its machine cannot be
    /// concatenated: see [`Terms`].
    fn goes_on_over_runs(&self) -> bool {
        let specs = self.parameters().iter();
        // A size of zero would have no terms.
        let present = |value: f64| if value == 0.0 { 1.0 } else { value };
        let values: Vec<f64> = specs.map(|spec| present(spec.guess())).collect();
        self.terms(&values).goes_on_over_runs()
    }

    /// Its law; `None` for a delay or a second inertia.
    fn formula(&self) -> Option<Vec<Formula>> {
        let keys: Vec<&str> = self.parameters().iter().map(|spec| spec.key).collect();
        let stated = self.card().formula;
        let formulas = stated.iter().map(|&(place, text)| {
            let tree = formula::read(text, &keys)?;
            Some(Formula { place, tree })
        });
        (!stated.is_empty()).then(|| formulas.collect()).flatten()
    }

    /// Its settings in a model file, except the parameters: empty for effects of the catalogue.
    fn settings(&self) -> Vec<(&'static str, toml::Value)> {
        Vec::new()
    }

    fn layout(&self) -> Layout {
        Layout::Keys
    }

    /// One parameter in a model file; `None` where nothing is written.
    fn written(&self, _parameter: usize, value: Option<f64>) -> Option<toml::Value> {
        value.map(toml::Value::Float)
    }
}

impl Effect for Card {
    fn card(&self) -> &Card {
        self
    }
}

#[cfg(test)]
mod tests;
