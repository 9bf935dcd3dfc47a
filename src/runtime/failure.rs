//! Why a command ended without success: one headline, one help line, one exit status.

use crate::report::export::ExportError;
use drivebench_bench::recording::RecordingError;
use drivebench_bench::{BenchFileError, CheckError, InitError, RegulatorError};
use drivebench_control::PlantError;
use drivebench_control::tuning::TuningError;
use drivebench_emulator::EmulatorConfigError;
use drivebench_identify::frequency_response::FrequencyResponseError;
use drivebench_identify::kalman::LoadError;
use drivebench_identify::output_error::FitError;
use drivebench_identify::scheme::IdentifyError;
use drivebench_link::{LinkError, ProfileError, TargetError};
use drivebench_model::config_text::ConfigError;
use drivebench_model::plant::{ModelError, ScenarioError};

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
        Self { status, headline: headline.into(), help: None }
    }

    pub fn with_help(status: u8, headline: impl Into<String>, help: impl Into<String>) -> Self {
        Self { status, headline: headline.into(), help: Some(help.into()) }
    }

    /// With this next step, where there is one.
    #[must_use]
    pub fn helped_by(self, help: Option<impl Into<String>>) -> Self {
        Self { help: help.map(Into::into).or(self.help), ..self }
    }

    /// With a remark behind the headline, where there is one.
    pub(crate) fn with_remark(mut self, remark: Option<&str>) -> Self {
        if let Some(remark) = remark {
            self.headline = format!("{}; {remark}", self.headline);
        }
        self
    }

    /// Usage or configuration, or more than plan or line allow.
    pub fn usage(headline: impl Into<String>, help: impl Into<String>) -> Self {
        Self::with_help(USAGE, headline, help)
    }

    /// The link or the device behind it.
    pub fn link(headline: impl Into<String>, help: impl Into<String>) -> Self {
        Self::with_help(LINK, headline, help)
    }

    /// The data do not determine the requested parameters.
    pub fn not_identifiable(headline: impl Into<String>, help: impl Into<String>) -> Self {
        Self::with_help(NOT_IDENTIFIABLE, headline, help)
    }

    /// A fault of this program, or a record that could not be kept.
    pub fn internal(headline: impl Into<String>) -> Self {
        Self::new(INTERNAL, headline)
    }

    /// By a person or a signal.
    pub fn interrupted(headline: impl Into<String>) -> Self {
        Self::new(INTERRUPTED, headline)
    }

    pub fn headline(&self) -> &str {
        &self.headline
    }

    /// The failure as one line for programs.
    pub(super) fn json(&self) -> serde_json::Value {
        serde_json::json!({
            "error": { "status": self.status, "message": self.headline, "help": self.help() }
        })
    }

    /// The next step; where none was given, what the status means for the reader.
    pub(crate) fn help(&self) -> &str {
        self.help.as_deref().unwrap_or(match self.status {
            REFUSED => "the figures are on stdout; `drivebench diagnose` names what is missing in the model",
            LINK => "check cable, power and address of the drive",
            TRIP => "find the cause before the next run",
            NOT_IDENTIFIABLE => "the reason of each parameter is on stdout; excite the motor more, or require less",
            INTERRUPTED => "start the command again to repeat the run",
            INTERNAL => "this is a fault of drivebench itself; please report it with the command",
            _ => "see drivebench --help",
        })
    }
}

impl From<serde_json::Error> for Failure {
    fn from(error: serde_json::Error) -> Self {
        Self::internal(format!("the result has no JSON form: {error}"))
    }
}

/// Errors of the lower floors as failures: their own text and help, and this status.
macro_rules! failures {
    ($($error:ty: $status:expr;)*) => {$(
        impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                let status: fn(&$error) -> u8 = $status;
                Self::with_help(status(&error), error.to_string(), error.help())
            }
        }
    )*};
}

failures! {
    BenchFileError: |_| USAGE;
    EmulatorConfigError: |_| USAGE;
    ExportError: |_| USAGE;
    ModelError: |_| USAGE;
    PlantError: |_| USAGE;
    ProfileError: |_| USAGE;
    RecordingError: |_| USAGE;
    RegulatorError: |_| USAGE;
    // A file without the columns, the rows or the time axis of a run: the file or its map has to be changed.
    ScenarioError: |_| USAGE;
    TargetError: |_| USAGE;
    TuningError: |_| USAGE;
    CheckError: |error| if matches!(error, CheckError::Stopped) { INTERRUPTED } else { LINK };
    LinkError: |_| LINK;
    FitError: |error| usage_if(matches!(error, FitError::Model(_)), NOT_IDENTIFIABLE);
    FrequencyResponseError: |error| usage_if(matches!(error, FrequencyResponseError::NoVoltage { .. }), NOT_IDENTIFIABLE);
    IdentifyError: |error| usage_if(error.is_usage(), NOT_IDENTIFIABLE);
    LoadError: |error| usage_if(matches!(error, LoadError::Incomplete { .. } | LoadError::Value { .. }), NOT_IDENTIFIABLE);
}

const fn usage_if(is_usage: bool, otherwise: u8) -> u8 {
    if is_usage { USAGE } else { otherwise }
}

impl From<ConfigError> for Failure {
    fn from(error: ConfigError) -> Self {
        Self::usage(error.to_string(), error.help)
    }
}

impl From<InitError> for Failure {
    fn from(error: InitError) -> Self {
        Self::usage(error.reason, error.help)
    }
}
