//! Properties of effects that are more than a number: elementary term, limit, harmonic, biased fits.

use super::{
    Card, Effect, command_delay, constant_load, current_filter, eccentric_load,
    load_dependent_friction, speed_delay, viscous_friction, voltage_drop, voltage_offset,
};

use crate::plant::scenario::Scenario;

pub use viscous_friction::SLOPE as VISCOUS_SLOPE;
pub use voltage_drop::DROP as VOLTAGE_DROP;

/// An elementary term that the rest of the program needs by itself, independent of the ids of the catalogue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TermKind {
    /// Torque in proportion to the speed.
    Drag,
    /// Constant torque.
    TorqueOffset,
    /// Torque of a weight out of centre: a sine over the angle of the shaft, with its sine and cosine parts.
    Weight,
    /// Friction in proportion to the torque that is transmitted.
    FrictionOfLoad,
    /// Constant voltage against the current.
    VoltageDrop,
    /// Constant voltage.
    VoltageOffset,
    /// Delay of the command, of the current (to first order, as a filter) and of the speed.
    LateCommand,
    LateCurrent,
    LateSpeed,
}

impl TermKind {
    /// The effect of the catalogue that is this term and nothing else; its parameters are coefficients.
    pub const fn effect(self) -> &'static dyn Effect {
        self.card()
    }

    pub const fn id(self) -> &'static str {
        self.card().id
    }

    const fn card(self) -> &'static Card {
        match self {
            Self::Drag => &viscous_friction::EFFECT,
            Self::TorqueOffset => &constant_load::EFFECT,
            Self::Weight => &eccentric_load::EFFECT,
            Self::FrictionOfLoad => &load_dependent_friction::EFFECT,
            Self::VoltageDrop => &voltage_drop::EFFECT,
            Self::VoltageOffset => &voltage_offset::EFFECT,
            Self::LateCommand => &command_delay::EFFECT,
            Self::LateCurrent => &current_filter::EFFECT,
            Self::LateSpeed => &speed_delay::EFFECT,
        }
    }
}

/// Amplitude of a sine over the angle of the shaft whose `order` is a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Harmonic {
    /// The same at every current.
    Fixed,
    /// In proportion to the current.
    OfCurrent,
}

/// The simpler effect to which an effect degenerates at the lower end of a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    pub simpler: &'static str,
    /// Index of the parameter, and its smallest value at which the effects differ, in the run of the reference.
    pub parameter: usize,
    pub least: f64,
}

impl Limit {
    /// The smallest value of the parameter of its effect in a run.
    pub fn least_in(&self, effect: &dyn Effect, scenario: &Scenario) -> f64 {
        scenario.scales.factor(effect.parameters()[self.parameter].of) * self.least
    }
}

/// A fit whose parameters an effect biases that the model lacks (omitted-variable bias), by more than it leaves in the residual.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BiasedFit {
    /// Of current and speed in a free run.
    FreeRun,
    /// Of the balance of torques.
    TorqueBalance,
}
