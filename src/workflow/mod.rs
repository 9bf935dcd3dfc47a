//! The order of the loop, as a pure state machine that screens and headless runs drive alike.
//!
//! ```text
//! connect -> check -> [escalate: an unknown motor from small steps] -> plan -> record fit, select, confirm, repeat -> identify -> compare -> diagnose -> add -> tune -> report
//!    \________ Task out: what is to be done next _____________/
//!     '------- Done in: what came of it; a failed task ends the loop with its reason
//! ```
//!
//! guide.rs says of each step what it needs, what it unlocks and which command does the same.
//! discovery.rs is the analysis as a conversation: add an effect, see what is missing then.
//! leaning.rs looks at a run that is still going on: what its residual leans on, provisionally.
//! suite/ reads a suite of bench tests and judges what came of its cases.
//! truth.rs sets what a software drive hides beside the answer, after the analysis.
//!
//! The driver (`app`) carries the tasks out: it owns link, clock and files. The analysis itself is pure and is done here.

mod burst;
mod commission;
mod discovery;
mod guide;
mod keyed;
mod leaning;
mod next_bench;
pub mod suite;
mod truth;

pub use burst::BurstResult;
pub use commission::{
    Commission, CommissionResult, Escalate, EscalationResult, Progress, ProgressCell, RunRecord,
    StageRecord, StepState, StepView, Task, compared, scaled_sentence,
};
pub use discovery::{
    Discovery, News, Order, Tell, curve_table, four_digits, hold_what_the_curve_holds,
};
pub use guide::{Called, Role, Step};
pub use leaning::{LeaningCell, LeaningWatch, Provisional};
pub use next_bench::{bench_for, experiment_limits, next_bench};
pub use truth::{ORDER, Size, Truth, sizes};
