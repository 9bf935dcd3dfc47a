//! Reports: one page that needs nothing but itself, and its plain-text twin.
//!
//! ```text
//! CommissionReport, RunReport --(facts, tables, figures)--> Page --> html: one file, inline CSS and SVG
//!                                                             '----> text: Markdown that a terminal shows well
//! Model and gains -> export: source text of other languages, from the formula of each effect
//! scenario, trajectories --> plot (ticks, decimation, gaps) --> SVG figure in the page
//! ```
//!
//! What a command prints is a [`card::Card`] of the same report: a few lines, with the commands that go on.
//!
//! Both forms come from the same [`page::Page`], so they cannot say different things. No estimate is printed without its
//! standard deviation and verdict ([`drivebench_model::text::number`]); a value that is missing is a gap or a word, never a zero and
//! never NaN.

pub mod card;
pub mod commission;
pub mod comparison;
pub mod conventions;
pub mod export;
mod findings;
pub mod page;
pub mod plot;
pub mod run;
pub(crate) mod tables;
mod traces;

pub use card::Card;
pub use commission::CommissionReport;
pub use comparison::{ComparisonReport, SignalFigures};
pub use findings::effect_picture;
pub use page::{Page, Tone};
pub use run::{EarlyEnd, LastSeconds, RunReport, SpeedLoop};
pub use traces::ConfirmRun;

/// Stands on every page and at the end of every text.
pub const SAFETY_NOTICE: &str = "A stop over a serial line or a network is not a safety function. Have a wired STO or \
                                 emergency stop within reach whenever the motor can turn.";

/// What was at the far end of the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    Emulator,
    Hardware,
    /// A file from elsewhere, or a log that does not say.
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
#[derive(Clone, Debug)]
pub struct Context {
    pub target: Target,
    /// When the (first) run began, as a date in UTC; which motor it was of. Empty where nobody says.
    pub date: String,
    pub motor: String,
    /// Names of the run folders, in the order of recording.
    pub run_folders: Vec<String>,
    /// What the drive says it is.
    pub identity: Facts,
    /// Limits, predicted peaks and excitation.
    pub plan: Facts,
    /// Exchanges by their class, rate, lateness.
    pub link: Facts,
    pub seed: Option<u64>,
    pub versions: Facts,
    /// Holes, set-aside runs and what else is to be known of the data.
    pub notes: Vec<String>,
    /// Rows of the file that could not be read.
    pub rows_dropped: usize,
}

impl Default for Context {
    fn default() -> Self {
        Self {
            target: Target::Unknown,
            date: String::new(),
            motor: String::new(),
            run_folders: Vec::new(),
            identity: Facts::new(),
            plan: Facts::new(),
            link: Facts::new(),
            seed: None,
            versions: Facts::new(),
            notes: Vec::new(),
            rows_dropped: 0,
        }
    }
}

#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
