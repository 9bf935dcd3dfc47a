//! The papers' figures and tables, computed again and compared; what a line does to a measurement; how often
//! the diagnosis is right.
//!
//! ```text
//! machine (exact discrete motor, excitation, noise, spread) -> figure_2, figure_3, transient (Figure 4, Table 1)
//!                                       schemes (one record, every scheme) -> errors against period and noise
//! loops (machines, regulators, trials) -> adaptive: Figures 5 to 7 of paper A
//!                                      -> paper_b: Figures 4 and 5 of paper B, convergence, noise, Hall edges
//! data_sheet: paper B's values against each other, and what its average model leaves out
//! lines (a drive behind a line, every kind) -> LineStudy: error and coverage against stamps, late and lost replies
//! study (machines whose truth is known, mystery drives) -> Study: counts of right and wrong answers
//!            PaperA, PaperB, LineStudy, Study -> pages --(layouts/*.md)--> page: HTML, Markdown, text, SVG, CSV
//! ```
//!
//! Pure computation from stated seeds: the same program gives the same numbers. Where a paper does not state what it
//! did (motor, excitation, what S/N is a ratio of), the result lists what was chosen.

pub mod adaptive;
mod charts;
pub mod data_sheet;
mod figure_2;
mod figure_3;
mod hall_sensor;
pub mod lines;
mod loops;
mod machine;
pub mod page;
mod pages;
pub mod paper_b;
mod schemes;
pub mod study;
mod transient;

use drivebench::tabulated;
use serde::{Serialize, Serializer};

pub use adaptive::AdaptiveLoop;
pub use figure_2::{ByParameter, Figure2, Method};
pub use figure_3::Figure3;
pub use loops::{Case, CaseRow, Comparison, Kind, LoadChange, Named, Step};
pub use machine::{RatioOf, SignalToNoise, Spread};
pub use paper_b::{PaperB, paper_b};
pub use schemes::{AtTa, Curve, Errors, NAMES, NoiseSweep, Sampling, Sweep};
pub use transient::{Figure4, Table1};

/// What Figures 2 and 3 are made of; the text gives none of it.
struct Figures2And3 {
    /// The paper requires Ta, TM > 0.1 s at T = 15 to 20 ms, so this is the fastest admissible motor, at the slower of its
    /// periods; TM is that of its Figure 6 before the jump.
    ta_s: f64,
    tm_s: f64,
    period_s: f64,
    /// Two voltages in turn, each held so many periods. Both keep the shaft turning forward, so that the sign of
    /// the friction torque does not change.
    levels_v: [f64; 2],
    hold: std::ops::RangeInclusive<usize>,
    /// Seeds of the spread, from 1 on; the first is drawn.
    seeds: u64,
}

const CHOSEN: Figures2And3 = Figures2And3 {
    ta_s: 0.1,
    tm_s: 0.2,
    period_s: 0.02,
    levels_v: [30.0, 90.0],
    hold: 2..=15,
    seeds: 60,
};

tabulated! {
    /// Where the noise enters.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "snake_case")]
    pub enum NoiseModel {
        /// White noise in the difference equation itself, `epsilon_k` of eq. (3): the machine is disturbed and the
        /// regressors are what they are. Least squares is made for this.
        EquationError = "equation error",
        /// White noise on what is measured: it is in the regressors too.
        Sensor = "sensor noise",
    }
    const fn text(self) -> &'static str;
}

/// An estimate over the samples, NaN where the scheme gives none.
#[derive(Clone, Debug, Default)]
pub struct Trace(pub Vec<f64>);

impl Serialize for Trace {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Thinned {
            every: usize,
            values: Vec<f64>,
        }
        let every = 20;
        let values = self.0.iter().step_by(every).copied().collect();
        Thinned { every, values }.serialize(serializer)
    }
}

/// What the paper prints of its own computer: its figures only. Ours are measured by `cargo bench` (benches/).
#[derive(Clone, Copy, Debug, Serialize)]
pub struct IterationTime {
    pub computer: &'static str,
    pub scheme_1_ms: f64,
    pub scheme_2_ms: f64,
}

#[derive(Clone, Debug, Serialize)]
pub struct PaperA {
    pub paper: &'static str,
    pub title: &'static str,
    /// What the paper leaves open and what was chosen.
    pub chosen: Vec<String>,
    pub figure_2: Figure2,
    pub figure_3: Figure3,
    pub figure_4: Figure4,
    pub table_1: Table1,
    pub sampling: Sampling,
    pub noise: NoiseSweep,
    pub adaptive: AdaptiveLoop,
    pub paper_iteration_time: IterationTime,
}

/// Computes everything; `begins` is called with the name of each part before it begins.
pub fn paper_a(mut begins: impl FnMut(&str)) -> PaperA {
    let mut part = |name: &str| begins(name);
    part("Figure 2");
    let figure_2 = figure_2::figure_2();
    part("Figure 3");
    let figure_3 = figure_3::figure_3();
    part("Figure 4 and Table 1");
    let (figure_4, table_1) = (transient::figure_4(), transient::table_1());
    part("errors against the period");
    let sampling = schemes::sampling();
    part("errors against the noise");
    let noise = schemes::noise();
    let adaptive = adaptive::adaptive_loop(&mut part);
    PaperA {
        paper: "paper-a",
        title: "Ma Runjin, Feng Yajun, Shi Miaohe: on-line identification of the parameters of a separately excited DC motor, and adaptive control",
        chosen: chosen(),
        figure_2,
        figure_3,
        figure_4,
        table_1,
        sampling,
        noise,
        adaptive,
        paper_iteration_time: IterationTime {
            computer: "TQ16",
            scheme_1_ms: 8.0,
            scheme_2_ms: 3.0,
        },
    }
}

fn chosen() -> Vec<String> {
    vec![
        format!(
            "Motor of Figures 2 and 3: the text gives none. Ta = {} s and TM = {} s at T = {:.0} ms: the fastest motor that the paper admits for its scheme 1 (Ta, TM above 0.1 s at T = 15 to 20 ms), with the TM of its Figure 6. Resistance and Ke are those of the ZK-22FC (1.1 ohm, 0.3538 V.s/rad), the load torque is 2 N.m, about rated.",
            CHOSEN.ta_s,
            CHOSEN.tm_s,
            1e3 * CHOSEN.period_s
        ),
        format!(
            "Excitation of Figures 2 and 3: the text gives none. {:.0} V and {:.0} V in turn, each held for {} to {} periods at random; the shaft always turns forward.",
            CHOSEN.levels_v[0],
            CHOSEN.levels_v[1],
            CHOSEN.hold.start(),
            CHOSEN.hold.end()
        ),
        "Noise: the text gives S/N without saying of what, or where the noise enters. Both readings of the ratio (power: of variances; amplitude: of standard deviations; the mean of the signal never counts) and both places (equation error, sensor) are computed.".to_owned(),
        format!(
            "Transient of Table 1: the paper shows it as a curve only. An emulated ZK-22FC (1.1 ohm, 9.9 mH, 0.0045 kg.m2, 0.455 N.m) starts from rest at {:.0} V, T = {:.0} ms; N counts the steps from one sample to the next since the voltage was switched on.",
            transient::START.voltage_v,
            1e3 * transient::START.period_s
        ),
        adaptive::chosen(),
        format!("Seeds are fixed: the same program gives the same figures. Spreads are over {} seeds, one of which is drawn.", CHOSEN.seeds),
    ]
}
