//! Hidden effects: one file each, one line each in the catalogue.
//!
//! ```text
//! configuration --mechanism()--> Mechanism: what it does inside the machine
//!     put-out voltage -> supply -> resistance, inductance, voltage loss --> voltage balance
//!     flux -----------------------------------------------------------> both balances
//!     drag (moving only), load (also at rest), friction (holds at rest) -> torque balance, stick-slip
//!     shaft: a second inertia
//!               --path()------> Path: what lies between command, machine and measurement (path.rs)
//!               --parts()-----> other effects, where it is made of several
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
mod flux_saturation;
mod foreign;
mod friction_onset;
mod inductance_saturation;
mod inertia_change;
mod load_dependent_friction;
mod load_step;
mod mechanism;
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
mod torque_ripple;
mod viscous_friction;
mod voltage_drop;
mod voltage_offset;
mod winding_heating;

use serde::{Deserialize, Serialize};

pub use asymmetric_viscous::AsymmetricViscous;
pub use backlash::Backlash;
pub use cogging::Cogging;
pub use command_delay::CommandDelay;
pub use constant_load::ConstantLoad;
pub use current_filter::CurrentFilter;
pub use current_offset::CurrentOffset;
pub use discontinuous_conduction::DiscontinuousConduction;
pub use eccentric_load::EccentricLoad;
pub use elastic_coupling::ElasticCoupling;
pub use field_change::FieldChange;
pub use flux_saturation::FluxSaturation;
pub use foreign::{
    ExponentialStribeck, FanThreeHalves, HarmonicCogging, LoadRamp, Messy, RandomLoad, Shaker,
    SoftDrop, TorqueBump,
};
pub use friction_onset::FrictionOnset;
pub use inductance_saturation::InductanceSaturation;
pub use inertia_change::InertiaChange;
pub use load_dependent_friction::LoadDependentFriction;
pub use load_step::LoadStep;
pub use mechanism::{Mechanism, Moment, Site};
pub use one_sided_load::OneSidedLoad;
pub use parameter::{Refused, TrueParameter};
pub use quadratic_load::QuadraticLoad;
pub use restart_delay::RestartDelay;
pub use speed_delay::SpeedDelay;
pub use speed_filter::SpeedFilter;
pub use speed_offset::SpeedOffset;
pub use start_delay::StartDelay;
pub use stribeck_friction::StribeckFriction;
pub use supply_sag::SupplySag;
pub use torque_ripple::TorqueRipple;
pub use viscous_friction::ViscousFriction;
pub use voltage_drop::VoltageDrop;
pub use voltage_offset::VoltageOffset;
pub use winding_heating::WindingHeating;

use super::Path;
pub(super) use super::shaft::Shaft;

/// What a configuration stands for in the machine. Every part defaults to "nothing there".
trait Hidden {
    /// What it does inside the machine on this site, from rest and cold.
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        None
    }

    /// What it does between command, machine and measurement.
    fn path(&self) -> Path {
        Path::default()
    }

    /// The second inertia that it puts behind the shaft.
    fn shaft(&self, _site: &Site) -> Option<Shaft> {
        None
    }

    /// The effects that it is made of.
    fn parts(&self, _site: &Site) -> Vec<HiddenEffect> {
        Vec::new()
    }
}

/// The catalogue: `Variant(Config)` per effect. The ids of `known` are those of the model file.
macro_rules! catalogue {
    (
        known { $($known:ident = $known_id:literal),+ $(,)? }
        foreign { $($foreign:ident = $foreign_id:literal),+ $(,)? }
    ) => {
        /// One hidden effect as it stands in the emulator's configuration.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(tag = "id")]
        pub enum HiddenEffect {
            $(#[serde(rename = $known_id)] $known($known),)+
            $(#[serde(rename = $foreign_id)] $foreign($foreign),)+
        }

        impl HiddenEffect {
            /// Every id, in catalogue order.
            pub const IDS: &'static [&'static str] = &[$($known_id,)+ $($foreign_id),+];

            /// Ids of what no catalogue of the host has.
            pub const FOREIGN: &'static [&'static str] = &[$($foreign_id),+];

            pub const fn id(&self) -> &'static str {
                match self {
                    $(Self::$known(_) => $known_id,)+
                    $(Self::$foreign(_) => $foreign_id,)+
                }
            }

            /// The true parameters, under the keys of the model file.
            pub fn parameters(&self) -> Vec<TrueParameter> {
                match self {
                    $(Self::$known(config) => config.parameters(),)+
                    $(Self::$foreign(config) => config.parameters(),)+
                }
            }

            /// The first value that this effect cannot have.
            pub fn refused(&self) -> Option<Refused> {
                match self {
                    $(Self::$known(config) => config.refused(),)+
                    $(Self::$foreign(config) => config.refused(),)+
                }
            }

            fn hidden(&self) -> &dyn Hidden {
                match self {
                    $(Self::$known(config) => config,)+
                    $(Self::$foreign(config) => config,)+
                }
            }
        }
    };
}

catalogue! {
    known {
        ViscousFriction = "viscous_friction",
        QuadraticLoad = "quadratic_load",
        StribeckFriction = "stribeck_friction",
        ConstantLoad = "constant_load",
        AsymmetricViscous = "asymmetric_viscous",
        Cogging = "cogging",
        TorqueRipple = "torque_ripple",
        EccentricLoad = "eccentric_load",
        LoadDependentFriction = "load_dependent_friction",
        LoadStep = "load_step",
        OneSidedLoad = "one_sided_load",
        FrictionOnset = "friction_onset",
        InertiaChange = "inertia_change",
        ElasticCoupling = "elastic_coupling",
        Backlash = "backlash",
        VoltageDrop = "voltage_drop",
        SupplySag = "supply_sag",
        WindingHeating = "winding_heating",
        FluxSaturation = "flux_saturation",
        InductanceSaturation = "inductance_saturation",
        FieldChange = "field_change",
        DiscontinuousConduction = "discontinuous_conduction",
        CommandDelay = "command_delay",
        StartDelay = "start_delay",
        RestartDelay = "restart_delay",
        SpeedDelay = "speed_delay",
        SpeedFilter = "speed_filter",
        CurrentFilter = "current_filter",
        CurrentOffset = "current_offset",
        SpeedOffset = "speed_offset",
        VoltageOffset = "voltage_offset",
    }
    foreign {
        Shaker = "shaker",
        TorqueBump = "torque_bump",
        RandomLoad = "random_load",
        SoftDrop = "soft_drop",
        FanThreeHalves = "fan_three_halves",
        ExponentialStribeck = "exponential_stribeck",
        HarmonicCogging = "harmonic_cogging",
        LoadRamp = "load_ramp",
        Messy = "messy",
    }
}

impl HiddenEffect {
    /// Whether no catalogue of the host has it.
    pub fn is_foreign(&self) -> bool {
        Self::FOREIGN.contains(&self.id())
    }

    /// The mechanism at work on this site, from rest and cold; `None` for what is only in the path or a second inertia.
    pub fn mechanism(&self, site: &Site) -> Option<Box<dyn Mechanism>> {
        self.hidden().mechanism(site)
    }

    /// What it does between command, machine and measurement, its parts included.
    pub fn path(&self, site: &Site) -> Path {
        self.hidden()
            .parts(site)
            .iter()
            .fold(self.hidden().path(), |path, part| {
                path.plus(part.path(site))
            })
    }

    /// The effects that it is made of; itself where it is one.
    pub fn single(&self, site: &Site) -> Vec<Self> {
        match self.hidden().parts(site) {
            parts if parts.is_empty() => vec![self.clone()],
            parts => parts,
        }
    }

    /// The second inertia that it puts behind the shaft.
    pub(super) fn shaft(&self, site: &Site) -> Option<Shaft> {
        self.hidden().shaft(site)
    }

    /// Whether it is a second inertia; a machine can have one.
    pub const fn is_shaft(&self) -> bool {
        matches!(self, Self::ElasticCoupling(_) | Self::Backlash(_))
    }

    /// All mechanisms at work, those of its parts included.
    pub(super) fn mechanisms(&self, site: &Site) -> Vec<Box<dyn Mechanism>> {
        let parts = self.hidden().parts(site);
        let of_parts = parts.iter().flat_map(|part| part.mechanisms(site));
        self.mechanism(site).into_iter().chain(of_parts).collect()
    }
}

#[cfg(test)]
pub(in crate::emulator) mod test_samples;
#[cfg(test)]
mod tests;
