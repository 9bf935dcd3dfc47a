//! Study of the diagnosis on machines whose truth is known: how often it names the hidden effect.
//!
//! ```text
//! what is hidden, how large -> Case (cases) -> emulated machine, excited and recorded (record) -> diagnose -> Outcome (judge)
//!                       what is in it, and how large (truth) <---'    of each effect, the finding <---'
//!     all outcomes -> counts with bounds, matrix (calibration)     all findings -> what probabilities and bounds are worth (calibration)
//!     motor's parameters -> what their intervals hold (calibration)
//! ```
//!
//! Virtual time and stated seeds: the same program gives the same page. The emulator's effects have other mathematical
//! forms than the catalogue's, and each set has a motor of its own.

pub(super) mod calibration;
mod cases;
mod classes;
pub mod commission;
mod judge;
mod mysteries;
mod record;
#[cfg(test)]
mod tests;

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use rayon::prelude::*;
use serde::Serialize;

pub use calibration::{
    Bin, Bounded, Calibration, Coverage, Matrix, ParameterFinding, Sizes, Tally, coverage,
    coverage_of, distinct, matrix, median_errors, sizes,
};
pub use cases::{Case, Excitation, Group, NOTHING};
pub use classes::Class;
pub use judge::{Answer, Finding, Outcome};
pub use mysteries::{MysteryAnswer, RecordAnswer, files, records};

use super::lines::LineStudy;
use drivebench::bench::BenchFile;
use drivebench::diagnosis::{Evidence, diagnose};
use drivebench::plant::Model;

#[derive(Clone, Copy, Debug)]
pub struct Size {
    /// Sets in each cell (effect and excitation); the other groups are multiples of it.
    pub sets: u64,
    pub seed: u64,
    /// A few sets at 100 Hz instead: for a test.
    pub reduced: bool,
}

impl Size {
    pub fn machines(self) -> usize {
        cases::all(self).len()
    }
}

#[derive(Clone, Debug, Serialize)]
pub struct Study {
    pub study: &'static str,
    pub seed: u64,
    pub sets_in_each_cell: u64,
    pub counts: Vec<GroupCount>,
    pub matrix: Matrix,
    /// Of all sets together.
    pub calibration: Calibration,
    pub coverage: Vec<Coverage>,
    pub answers: Vec<Answer>,
    /// Real machines; empty where no folder of records was given.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub records: Vec<RecordAnswer>,
    /// Mystery drives that the whole program commissioned; empty where none was requested.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub mysteries: Vec<MysteryAnswer>,
    /// What lines of every kind do to a measurement; none where that was not requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lines: Option<LineStudy>,
}

/// Counts of one group, for one excitation.
#[derive(Clone, Debug, Serialize)]
pub struct GroupCount {
    pub group: Group,
    pub excitation: &'static str,
    pub tally: Tally,
}

/// Runs the study on all cores; `after` is called with each set when it is done, in no order. `None` where it was
/// interrupted: a part of a study would not be the study.
pub fn run(
    size: Size,
    interrupted: &AtomicBool,
    after: impl Fn(usize, usize, &Answer) + Sync,
) -> Option<Study> {
    let cases = cases::all(size);
    let done = AtomicUsize::new(0);
    let answers: Vec<Option<Answer>> = cases
        .par_iter()
        .map(|case| {
            if interrupted.load(Ordering::Acquire) {
                return None;
            }
            let answer = answer(case);
            let number = 1 + done.fetch_add(1, Ordering::AcqRel);
            after(number, cases.len(), &answer);
            Some(answer)
        })
        .collect();
    let answers: Vec<Answer> = answers.into_iter().collect::<Option<_>>()?;
    Some(Study {
        study: "discovery",
        seed: size.seed,
        sets_in_each_cell: size.sets,
        counts: calibration::counts(&answers),
        matrix: calibration::matrix(&answers),
        calibration: Calibration::of(&answers),
        coverage: coverage(&answers.iter().collect::<Vec<_>>()),
        answers,
        records: Vec::new(),
        mysteries: Vec::new(),
        lines: None,
    })
}

/// One set from the machine to the verdict. The diagnosis starts from the nameplate and gets the rows of two runs,
/// nothing else.
fn answer(case: &Case) -> Answer {
    let runs = match record::runs(case) {
        Ok(runs) => runs,
        Err(error) => return Answer::failed(case, error.to_string()),
    };
    let reference = BenchFile::embedded_default().motor.motor();
    let own = case.motor_class().map_or_else(
        || reference.clone(),
        |own| own.nameplate(&reference, runs.motor.back_emf_v_s_per_rad),
    );
    let nameplate = Model::baseline(own);
    let evidence = Evidence::new(runs.fit, Some(runs.holdout), None);
    match diagnose(&nameplate, evidence) {
        Ok(diagnosis) => Answer::of(case, &runs.truths, &runs.motor, &diagnosis),
        Err(error) => Answer::failed(case, error.to_string()),
    }
}
