//! Effects that no catalogue of the host has, or in a shape that none has: tests of honesty.
//!
//! ```text
//! nothing like it in the catalogue: shaker, torque_bump, random_load
//! a known effect in a wrong shape:  soft_drop, fan_three_halves, exponential_stribeck, harmonic_cogging, load_ramp
//! a real bench's background:        messy
//! ```

mod exponential_stribeck;
mod fan_three_halves;
mod harmonic_cogging;
mod load_ramp;
mod messy;
mod random_load;
mod shaker;
mod soft_drop;
mod torque_bump;

pub use exponential_stribeck::ExponentialStribeck;
pub use fan_three_halves::FanThreeHalves;
pub use harmonic_cogging::HarmonicCogging;
pub use load_ramp::LoadRamp;
pub use messy::Messy;
pub use random_load::RandomLoad;
pub use shaker::Shaker;
pub use soft_drop::SoftDrop;
pub use torque_bump::TorqueBump;

use super::parameter::hidden_effect;
use super::{Hidden, HiddenEffect, Mechanism, Moment, Site};
