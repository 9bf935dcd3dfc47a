//! The papers' figures and tables, computed again beside what the papers print.
//!
//! ```text
//! machine (exact discrete motor), signal (excitation, noise, spread) -> figure_2, figure_3, figure_4, table_1
//!                                       schemes (one record, every scheme) -> sampling, noise
//!                                            all of them -> PaperA -> pages -> report (HTML, SVG, CSV, text)
//! ```
//!
//! Pure computation from stated seeds: the same program gives the same numbers. Where a paper does not say what it
//! did (motor, excitation, what S/N is a ratio of), the result says what was chosen.

mod figure_2;
mod figure_3;
mod figure_4;
mod machine;
mod noise;
mod sampling;
mod schemes;
mod signal;
mod table_1;

use serde::{Serialize, Serializer};

pub use figure_2::{ByParameter, Figure2, Method};
pub use figure_3::Figure3;
pub use figure_4::Figure4;
pub use signal::{RatioOf, SignalToNoise, Spread};
pub use table_1::Table1;

/// Motor of Figures 2 and 3, s: the text gives none. It asks for Ta, TM > 0.1 s at T = 15 to 20 ms, so this is the
/// fastest motor that it admits, at the slower of its periods; TM is that of its Figure 6 before the jump.
const TA_S: f64 = 0.1;
const TM_S: f64 = 0.2;
const PERIOD_S: f64 = 0.02;
/// Excitation of Figures 2 and 3, which the text does not give either: two voltages in turn, each held 2 to 15 periods.
/// Both keep the shaft turning forward, so that the sign of the speed is no question.
const LEVELS_V: [f64; 2] = [30.0, 90.0];
const HOLD: std::ops::RangeInclusive<usize> = 2..=15;
/// Seeds over which the spread of Figures 2 and 3 is told, and the one that is drawn.
const SEEDS: u64 = 60;
const SHOWN_SEED: u64 = 1;

/// Where the noise enters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseModel {
    /// White noise in the difference equation itself, `epsilon_k` of eq. (3): the machine is disturbed and the
    /// regressors are what they are. Least squares is made for this.
    EquationError,
    /// White noise on what is measured: it is in the regressors too.
    Sensor,
}

impl NoiseModel {
    pub const fn text(self) -> &'static str {
        match self {
            Self::EquationError => "equation error",
            Self::Sensor => "sensor noise",
        }
    }
}

/// An estimate over the samples, NaN where the scheme gives none.
#[derive(Clone, Debug, Default)]
pub struct Trace(pub Vec<f64>);

/// In JSON every so many samples of a trace are given.
const TRACE_STRIDE: usize = 20;

impl Serialize for Trace {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Thinned {
            every: usize,
            values: Vec<f64>,
        }
        let values = self.0.iter().step_by(TRACE_STRIDE).copied().collect();
        let every = TRACE_STRIDE;
        Thinned { every, values }.serialize(serializer)
    }
}
