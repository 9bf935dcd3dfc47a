//! Why a scheme gives no answer at all.

use thiserror::Error;

use crate::identification::output_error::FitError;
use crate::plant::ModelError;

#[derive(Clone, Debug, Error, PartialEq)]
pub enum IdentifyError {
    #[error("scheme {id:?} is not known (allowed: {allowed})")]
    UnknownScheme { id: String, allowed: String },
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Fit(FitError),
    /// The data cannot serve this scheme; another one may do.
    #[error("scheme {scheme} cannot use run {run:?}: {reason}")]
    Unusable {
        scheme: &'static str,
        run: String,
        reason: String,
        help: &'static str,
    },
}

impl IdentifyError {
    pub fn help(&self) -> &'static str {
        match self {
            Self::UnknownScheme { .. } => "see drivebench identify --help",
            Self::Model(error) => error.help(),
            Self::Fit(error) => error.help(),
            Self::Unusable { help, .. } => help,
        }
    }

    /// Whether the request is wrong, rather than the data too poor for it.
    pub const fn is_usage(&self) -> bool {
        matches!(self, Self::UnknownScheme { .. } | Self::Model(_))
    }
}

impl From<FitError> for IdentifyError {
    fn from(error: FitError) -> Self {
        match error {
            FitError::Model(error) => Self::Model(error),
            error => Self::Fit(error),
        }
    }
}
