//! Effects that no catalogue of the host has, or in a shape that none has: tests of honesty.
//!
//! ```text
//! nothing like it in the catalogue: shaker, torque_bump, random_load
//! a known effect in a wrong shape:  soft_drop, fan_three_halves, exponential_stribeck, harmonic_cogging, load_ramp
//! a real bench's background:        messy
//! ```

pub(super) mod exponential_stribeck;
pub(super) mod fan_three_halves;
pub(super) mod harmonic_cogging;
pub(super) mod load_ramp;
pub(super) mod messy;
pub(super) mod random_load;
pub(super) mod shaker;
pub(super) mod soft_drop;
pub(super) mod torque_bump;

use super::{
    Acts, HiddenEffect, HiddenKind, Mechanism, Moment, NOT_STUDIED, NotNegative, Parameter,
    Positive, Site, Wave, drag, friction, load, named, voltage_loss,
};
