//! Why a command ended without success: one headline, one help line, one exit status.

use crate::config_text::ConfigError;
use crate::identification::output_error::FitError;
use crate::identification::scheme::IdentifyError;
use crate::plant::{ModelError, ScenarioError};
use crate::recording::RecordingError;

pub(crate) const REFUSED: u8 = 1;
pub(crate) const USAGE: u8 = 2;
pub(crate) const LINK: u8 = 3;
pub(crate) const TRIP: u8 = 4;
pub(crate) const NOT_IDENTIFIABLE: u8 = 5;
pub(crate) const INTERNAL: u8 = 6;
pub(crate) const INTERRUPTED: u8 = 130;

#[derive(Debug)]
pub struct Failure {
    pub status: u8,
    headline: String,
    help: Option<String>,
}

impl Failure {
    pub fn new(status: u8, headline: impl Into<String>) -> Self {
        Self {
            status,
            headline: headline.into(),
            help: None,
        }
    }

    pub fn with_help(status: u8, headline: impl Into<String>, help: impl Into<String>) -> Self {
        Self {
            status,
            headline: headline.into(),
            help: Some(help.into()),
        }
    }

    pub fn headline(&self) -> &str {
        &self.headline
    }

    /// Two lines on stderr; where stderr is gone there is nobody left to tell.
    pub(crate) fn print(&self) {
        use std::io::Write;
        super::progress::above(|| {
            let mut stderr = std::io::stderr().lock();
            let _ = writeln!(stderr, "error: {}", self.headline);
            let _ = writeln!(stderr, "help: {}", self.help());
        });
    }

    /// The next step; where none was given, what the status means for the reader.
    fn help(&self) -> &str {
        self.help.as_deref().unwrap_or(match self.status {
            REFUSED => "the figures are on stdout; `drivebench diagnose` names what the model misses",
            LINK => "check cable, power and address of the drive",
            TRIP => "find the cause before the next run",
            NOT_IDENTIFIABLE => "the reason of each parameter is on stdout; excite the motor more, or ask for less",
            INTERRUPTED => "start the command again to repeat the run",
            INTERNAL => "this is a fault of drivebench itself; please report it with the command that was given",
            _ => "see drivebench --help",
        })
    }
}

impl From<ConfigError> for Failure {
    fn from(error: ConfigError) -> Self {
        Self::with_help(USAGE, error.to_string(), error.help)
    }
}

impl From<RecordingError> for Failure {
    fn from(error: RecordingError) -> Self {
        let help = error.help();
        Self::with_help(USAGE, error.to_string(), help)
    }
}

/// A file without the columns, the rows or the time axis of a run: it, or how it is read, is to be changed.
impl From<ScenarioError> for Failure {
    fn from(error: ScenarioError) -> Self {
        Self::with_help(USAGE, error.to_string(), error.help())
    }
}

impl From<ModelError> for Failure {
    fn from(error: ModelError) -> Self {
        Self::with_help(USAGE, error.to_string(), error.help())
    }
}

impl From<FitError> for Failure {
    fn from(error: FitError) -> Self {
        let status = if matches!(error, FitError::Model(_)) {
            USAGE
        } else {
            NOT_IDENTIFIABLE
        };
        Self::with_help(status, error.to_string(), error.help())
    }
}

impl From<IdentifyError> for Failure {
    fn from(error: IdentifyError) -> Self {
        let status = if error.is_usage() {
            USAGE
        } else {
            NOT_IDENTIFIABLE
        };
        Self::with_help(status, error.to_string(), error.help())
    }
}
