//! The catalogue of physical effects beyond the baseline: one file each, one line in [`CATALOGUE`].
//!
//! ```text
//! Effect (card, parameters) --terms(values)--> Terms: what it adds to
//!     the voltage balance (V, subtracted from u)      the friction level (N.m, against the motion)
//!     the torque balance (N.m, subtracted)            states of its own
//! ```

mod constant_load;
mod quadratic_load;
mod stribeck_friction;
mod viscous_friction;
mod voltage_drop;
mod winding_heating;

/// Every effect that the program can name, add and remove.
pub const CATALOGUE: &[&dyn Effect] = &[
    &viscous_friction::ViscousFriction,
    &quadratic_load::QuadraticLoad,
    &stribeck_friction::StribeckFriction,
    &constant_load::ConstantLoad,
    &voltage_drop::VoltageDrop,
    &winding_heating::WindingHeating,
];

/// The effect with this id.
pub fn find(id: &str) -> Option<&'static dyn Effect> {
    CATALOGUE
        .iter()
        .copied()
        .find(|effect| effect.card().id == id)
}

/// Which balance an effect enters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Balance {
    Voltage,
    Torque,
}

/// What a person should know about an effect.
#[derive(Debug)]
pub struct Card {
    pub id: &'static str,
    pub name: &'static str,
    pub balance: Balance,
    pub equation: &'static str,
    /// Causes that share this equation: a name is an equation, not a cause.
    pub causes: &'static str,
    pub looks_like: &'static str,
    pub excite: &'static str,
    pub remedy: &'static str,
}

/// One parameter of an effect.
#[derive(Debug)]
pub struct ParameterSpec {
    pub key: &'static str,
    pub unit: &'static str,
    pub min: f64,
    pub max: f64,
    /// A typical size: probe of the score screen and unit of the fit.
    pub scale: f64,
    /// Fitted as a logarithm (positive shape parameters) instead of linearly.
    pub logarithmic: bool,
    /// Values that the score screen tries for a shape parameter; empty for a coefficient that enters linearly.
    pub shapes: &'static [f64],
}

impl ParameterSpec {
    /// A coefficient: the effect is proportional to it.
    const fn coefficient(key: &'static str, unit: &'static str, max: f64, scale: f64) -> Self {
        Self {
            key,
            unit,
            min: -max,
            max,
            scale,
            logarithmic: false,
            shapes: &[],
        }
    }

    /// A positive shape parameter within bounds.
    const fn shape(
        key: &'static str,
        unit: &'static str,
        range: (f64, f64),
        shapes: &'static [f64],
    ) -> Self {
        Self {
            key,
            unit,
            min: range.0,
            max: range.1,
            scale: shapes[0],
            logarithmic: true,
            shapes,
        }
    }

    pub const fn is_coefficient(&self) -> bool {
        self.shapes.is_empty()
    }

    /// Where a fit starts when nothing better is known.
    pub const fn guess(&self) -> f64 {
        if self.is_coefficient() {
            self.scale
        } else {
            self.shapes[self.shapes.len() / 2]
        }
    }
}

/// The instant at which terms are evaluated.
#[derive(Clone, Copy, Debug, Default)]
pub struct Instant {
    pub time_s: f64,
    pub voltage_v: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
    pub angle_rad: f64,
}

/// A physical effect: its card, its parameters and its terms for given parameter values.
pub trait Effect: Sync {
    fn card(&self) -> &'static Card;
    /// The first is the coefficient that gives the effect its size.
    fn parameters(&self) -> &'static [ParameterSpec];
    /// `values` in the order of [`Effect::parameters`].
    fn terms(&self, values: &[f64]) -> Box<dyn Terms>;
}

/// What effects add to the balances at one instant, as [`Terms`] defines the signs.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sums {
    pub voltage_v: f64,
    pub torque_n_m: f64,
    pub friction_n_m: f64,
}

/// What an effect adds to the baseline's equations. `own` are the effect's states.
pub trait Terms: Send + Sync {
    /// Voltage drop, V: subtracted in the voltage balance. `resistance_ohm` is that of the cold winding.
    fn voltage_v(&self, _at: &Instant, _own: &[f64], _resistance_ohm: f64) -> f64 {
        0.0
    }

    /// Torque against positive motion whatever the direction, N.m: subtracted in the torque balance.
    fn torque_n_m(&self, _at: &Instant, _own: &[f64]) -> f64 {
        0.0
    }

    /// Addition to the Coulomb level, N.m: always against the motion, and it holds at rest.
    fn friction_n_m(&self, _at: &Instant) -> f64 {
        0.0
    }

    /// The three above at once: one call through the table of methods where a simulation would need three.
    fn sums(&self, at: &Instant, own: &[f64], resistance_ohm: f64) -> Sums {
        Sums {
            voltage_v: self.voltage_v(at, own, resistance_ohm),
            torque_n_m: self.torque_n_m(at, own),
            friction_n_m: self.friction_n_m(at),
        }
    }

    /// Number of states, all starting at zero.
    fn states(&self) -> usize {
        0
    }

    /// Time derivatives of the effect's states.
    fn derivative(&self, _at: &Instant, _own: &[f64], _out: &mut [f64]) {}
}

#[cfg(test)]
mod tests;
