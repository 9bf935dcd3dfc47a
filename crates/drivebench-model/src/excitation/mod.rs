//! Excitation programs: pure, seekable, seeded functions of time.
//!
//! ```text
//! [Segment] (configuration) -> target pieces -> slew limit -> Program -> value_at(t): Output
//!   a kind of excitation        straight lines   exact        polyline    in any order
//! ```
//!
//! Everything is a polyline: the slew limit is then exact, and the value at an instant is found by searching, so it does
//! not depend on what was asked before. A new kind is one struct and one line in the catalogue below; the contract test
//! in `contract_tests.rs` then covers it.

mod chirp;
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

pub use chirp::Chirp;
pub use dither::Dither;
pub use error::ExcitationError;
pub use levels::{Ramp, Staircase, Steps};
pub use piece::{Piece, Target};
pub use prbs::Prbs;
pub use program::{Output, Program, Span};
pub use rest::{CoastDown, Standstill};
pub use rich::{RICH_SECONDS, rich};
pub use sine::Sine;

use error::Refusal;

/// What a kind of excitation is called, and how it stands in a bench file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Card {
    /// Its key in a bench file.
    pub id: &'static str,
    /// An example for a bench file.
    pub example: &'static str,
}

/// One kind of excitation: what is asked for, before the slew limit.
pub trait Excitation {
    /// Refuses values that make no program.
    fn check(&self) -> Result<(), Refusal>;

    /// Length in s; only asked for after [`Excitation::check`].
    fn duration_s(&self) -> f64;

    /// The wanted voltage over `0..duration_s`, without gaps; only asked for after [`Excitation::check`].
    fn target(&self) -> Target;
}

macro_rules! catalogue {
    ($($kind:ident),* $(,)?) => {
        /// One part of a sequence, as it stands in a bench file: `steps = { levels_v = [12.0, -12.0], hold_s = 0.5 }`.
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum Segment {
            $($kind($kind),)*
        }

        impl Segment {
            /// Every kind, in the order of the catalogue.
            pub const CARDS: &[Card] = &[$($kind::CARD),*];

            pub const fn card(&self) -> Card {
                match self {
                    $(Self::$kind(_) => $kind::CARD,)*
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
    Standstill, Steps, Staircase, Ramp, Prbs, Sine, Chirp, CoastDown,
];

#[cfg(test)]
mod contract_tests;
