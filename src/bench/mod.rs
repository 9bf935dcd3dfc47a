//! Session, guard, runner: one bench run from standstill to standstill.
//!
//! ```text
//! bench file --> plan (predicts and refuses) --> check (link, standstill, watchdog proof)
//!                                                   |
//!   clock --> runner --- Cycle, Sample, Intent ---> session + guard (pure)
//!               ^  \<-- Send, Record, Event -------------/
//!      DriveLink    \--> recorder, on-line identification, Snapshot --> screen --> Intent
//! ```

mod bench_file;
mod clock;
mod guard;
mod limits;
mod plan;
mod program;
mod session;
#[cfg(test)]
mod testing;

pub use bench_file::{
    BenchFile, BenchFileError, DriveSection, EMBEDDED_DEFAULT, EMBEDDED_NAME, EmulatorSection,
    LimitsSection, LinkSection, Port, Protocol, RunsSection,
};
pub use clock::{Clock, MonotonicClock, VirtualClock};
pub use guard::{Causes, Guard, RearmError, Shaped, Trip, TripKind};
pub use limits::{Limits, Nameplate};
pub use plan::{Observability, Plan, Prospect, Refusal, SegmentPlan, plan};
pub use program::Program;
pub use session::{Action, Input, Intent, Level, Lost, Notice, Outcome, Phase, Session};
