//! The commissioning as a pure state machine, which screens and headless runs drive alike.
//!
//! ```text
//! connect -> check -> [escalate: an unknown motor from small steps] -> plan -> record fit, select, confirm, repeat -> identify -> compare -> diagnose -> add -> tune -> report
//!    \________ Task out: what is to be done next _____________/
//!     '------- Done in: its result; a failed task ends the commissioning with its reason
//! ```
//!
//! guide.rs: what each step needs and unlocks, and which command does the same.
//! discovery.rs: the diagnosis by hand.
//! `provisional_ranking.rs` ranks the effects by the residual of a run in progress.
//! suite/ reads a suite of bench tests and judges the results of its cases.
//! truth.rs compares the hidden effects of a software drive with the diagnosis.
//!
//! The driver (`commands`) carries the tasks out: it owns link, clock and files. The analysis itself is pure and is done here.

mod burst;
mod commission;
mod discovery;
mod guide;
mod keyed;
mod next_bench;
mod provisional_ranking;
pub mod suite;
mod truth;

pub use burst::BurstResult;
pub use commission::{
    Commission, CommissionResult, Escalate, EscalationResult, Progress, RunRecord, StageRecord,
    StepState, StepView, Task, compared, scaled_sentence,
};
pub use discovery::{
    Discovery, News, Order, Publish, curve_table, four_digits, hold_collinear_parameter,
};
pub use guide::{CommandContext, Role, Step};
pub use next_bench::{bench_for, experiment_limits, next_bench};
pub use provisional_ranking::{ProvisionalRanking, RankingWatch};
pub use truth::{ORDER, Size, Truth, sizes};

use drivebench_bench::Latest;

pub type ProgressCell = Latest<Progress>;
pub type RankingCell = Latest<ProvisionalRanking>;
