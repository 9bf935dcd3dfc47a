//! Excitation programs: pure, seekable, seeded functions of time.
//!
//! ```text
//! [Segment] (configuration) -> target pieces -> slew limit -> Program -> value_at(t): Output
//!   a kind of excitation        straight lines   exact        polyline    in any order
//! ```
//!
//! Everything is a polyline: the slew limit is then exact, and the value at an instant is found by binary search. A new kind
//! is one struct and one line in the catalogue below; the contract test in `contract_tests.rs` then covers it.

mod dither;
mod error;
mod levels;
mod lfsr;
mod piece;
mod prbs;
mod program;
mod rest;
mod rich;
mod sine;
mod slew;

pub use dither::Dither;
pub use error::ExcitationError;
pub use levels::{Ramp, Staircase, Steps};
pub use piece::{Piece, Target};
pub use prbs::Prbs;
pub use program::{Output, Program, Span};
pub use rest::{CoastDown, Standstill};
pub use rich::rich;
pub use sine::{Chirp, Sine};

use error::Refusal;

/// One kind of excitation before the slew limit. Length and target are defined for values that `check` accepts.
pub trait Excitation {
    fn check(&self) -> Result<(), Refusal>;

    fn duration_s(&self) -> f64;

    /// The set-point of the voltage over `0..duration_s`, without gaps.
    fn target(&self) -> Target;
}

macro_rules! catalogue {
    ($($kind:ident = $key:literal),* $(,)?) => {
        /// One part of a sequence, as it stands in a bench file: `steps = { levels_v = [12.0, -12.0], hold_s = 0.5 }`.
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum Segment {
            $($kind($kind),)*
        }

        impl Segment {
            pub(super) const fn key(&self) -> &'static str {
                match self {
                    $(Self::$kind(_) => $key,)*
                }
            }

            pub fn excitation(&self) -> &dyn Excitation {
                match self {
                    $(Self::$kind(excitation) => excitation,)*
                }
            }
        }
    };
}

catalogue![
    Standstill = "standstill",
    Steps = "steps",
    Staircase = "staircase",
    Ramp = "ramp",
    Prbs = "prbs",
    Sine = "sine",
    Chirp = "chirp",
    CoastDown = "coast_down",
];

#[cfg(test)]
mod contract_tests;
