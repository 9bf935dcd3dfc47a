//! Results as documents, and their output: self-contained pages, Markdown, and text for a terminal.
//!
//! ```text
//! CommissionReport, ComparisonReport, RunReport, commands --> Document (headline, facts, tables, charts, lists, commands)
//!     Document --> html: one file, inline CSS and SVG       --> markdown: the page as text
//!              '-> terminal: the card, or all of it; screens show the same rows
//! Model and gains -> export: source text of other languages, from the formula of each effect
//! scenario, trajectories --> plot (ticks, decimation, gaps) --> SVG figure in the page
//! ```
//!
//! All forms come from the same [`Document`], so that they agree. No estimate is printed without its
//! standard deviation and verdict ([`drivebench_model::text::number`]); a value that is missing is a gap or a text, never a zero and
//! never NaN.

pub mod commission;
pub mod comparison;
pub mod conventions;
mod document;
pub mod export;
mod findings;
mod html;
mod markdown;
pub mod plot;
mod response;
pub mod run;
mod table;
pub(crate) mod tables;
pub mod terminal;
mod traces;
pub mod wording;

pub use commission::{CommissionReport, tone};
pub use comparison::{ComparisonReport, SignalFigures, comparison_document, error_changes};
pub use document::{Bars, Document, Tone};
pub use findings::{card_facts, curve_chart, curve_picture, effect_document, open_questions};
pub use response::response_chart;
pub use run::{EarlyEnd, LastSeconds, RunReport};
pub use table::{Cell, Columns, Table};
pub use traces::ConfirmRun;

pub const SAFETY_NOTICE: &str = "A stop over a serial line or a network is not a safety function. Have a wired STO or \
                                 emergency stop within reach whenever the motor can turn.";

/// The kind of the drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Target {
    Emulator,
    Hardware,
    /// A file from elsewhere, or a log without it.
    #[default]
    Unknown,
}

impl Target {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Emulator => "emulator (software drive)",
            Self::Hardware => "hardware",
            Self::Unknown => "not stated",
        }
    }
}

/// `(label, value)` pairs that are shown as they are.
pub type Facts = Vec<(String, String)>;

/// Under which conditions the numbers of a report came about.
#[derive(Clone, Debug, Default)]
pub struct Context {
    pub target: Target,
    /// When the (first) run began, as a date in UTC; its motor. Empty where not recorded.
    pub date: String,
    pub motor: String,
    pub run_folders: Vec<String>,
    pub identity: Facts,
    pub plan: Facts,
    pub link: Facts,
    pub seed: Option<u64>,
    pub versions: Facts,
    /// Gaps, set-aside runs and other notes on the data.
    pub notes: Vec<String>,
    pub rows_dropped: usize,
}

#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
