//! Session, guard, runner: one bench run from standstill to standstill.
//!
//! ```text
//! bench file --> plan (predicts and refuses) --> check (link, standstill, watchdog, first move)
//!                                                   |
//!   clock --> runner --- Cycle, Sample, Intent ---> session + guard (pure)
//!               ^  \<-- Send, Record, Event -------------/
//!      DriveLink    \--> recorder, on-line identification, Snapshot --> screen --> Intent
//! ```

mod bench_file;
mod burst;
mod check;
mod clock;
pub mod column_proposal;
mod currents;
mod describe;
mod difference;
mod escalate;
#[cfg(test)]
mod fault_trials;
mod guard;
mod init_file;
mod limits;
mod line_watch;
mod live_online;
mod mechanics;
mod pattern;
mod pilot;
mod plan;
mod plausibility;
pub mod recording;
mod reopen;
mod runner;
mod session;
mod snapshot;
mod speed;
mod stop;
#[cfg(test)]
mod testing;
mod timing;
mod trip;

pub use bench_file::{
    BenchFile, BenchFileError, DriveSection, EMBEDDED_DEFAULT, EMBEDDED_NAME, EmulatorSection,
    LimitsSection, LinkSection, Port, Protocol, Refused, RunsSection,
};
pub use burst::burst_part;
pub use check::{
    CheckError, CheckItem, CheckOptions, CheckReport, FirstMove, NoiseFloor, RATE_CHECK, Waivers,
    check, check_signals,
};
pub use clock::{Clock, MonotonicClock};
pub use currents::{CurrentsPilot, CurrentsSection};
pub use describe::{layout, manifest};
pub use difference::{Difference, first_difference};
pub use drivebench_emulator::VirtualClock;
pub use escalate::{EscalationPlan, Scaled, bounds, plan_escalation, scale, stage_session};
pub use guard::{Causes, Guard, RestError, Shaped};
pub use init_file::{InitError, InitFile, InitRequest, InitUse, Readback, Reasoned, init_file};
pub use limits::{Limits, MotorSection, Nameplate};
pub use live_online::{Excitation, OnlineResult, OnlineSettings, RowEstimator, replay};
pub use mechanics::{Brake, DriveFacts, LoadSection, SupplySection};
pub use pattern::fits_pattern;
pub use pilot::{Pilot, PilotEvent};
pub use plan::{Observability, Plan, PlanError, Prospect, Refusal, SegmentPlan, plan_run};
pub use plausibility::Plausibility;
pub use reopen::{LostDrive, ReopenEnding, Reopened, RunEnd, reopen};
pub use runner::{Bench, RunOptions, RunSummary, run};
pub use session::{Action, Input, Intent, Level, Lost, Notice, Outcome, Phase, Session};
pub use snapshot::{InnovationPoint, Latest, Snapshot, SnapshotCell, Target, TracePoint};
pub use speed::{
    ControllerKind, Design, ForwardUse, GainChange, GainsSection, LoopDelay, PilotSettings,
    Reference, ReferenceError, ReferencePart, ReferenceStep, Regulator, RegulatorError, SpeedPilot,
    SpeedReport, SpeedSection, StepFigures, Tracking, Watched, check_motor, measure_delay,
    timing as loop_timing,
};
pub use stop::{LastSeconds, Stop};
pub use timing::Timing;
pub use trip::{Trip, TripKind};

/// Appends to a queue that keeps so many.
fn push_within<T>(queue: &mut std::collections::VecDeque<T>, item: T, most: usize) {
    if queue.len() == most {
        queue.pop_front();
    }
    queue.push_back(item);
}
