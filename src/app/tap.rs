//! The capture of what goes over a wire; what goes wrong with it is told at the end and stops nothing.

use std::path::Path;

use super::failure::{Failure, USAGE};
use super::{output, rig};
use crate::drive::TapFile;

/// The capture that a command was asked for, if it was.
pub(crate) struct Tap(Option<TapFile>);

impl Tap {
    /// A new file, if one was asked for. Nothing is running yet, so one that cannot be made is refused.
    pub(crate) fn create(path: Option<&Path>) -> Result<Self, Failure> {
        let Some(path) = path else {
            return Ok(Self(None));
        };
        output::refuse_existing(path, "--tap")?;
        let file = TapFile::create(path, rig::now().into()).map_err(|error| {
            Failure::with_help(
                USAGE,
                format!("{}: cannot write: {error}", path.display()),
                "name a file that does not exist yet, in a folder that does",
            )
        })?;
        Ok(Self(Some(file)))
    }

    pub(crate) fn file(&self) -> Option<&TapFile> {
        self.0.as_ref()
    }
}

impl Drop for Tap {
    fn drop(&mut self) {
        if let Some(Err(reason)) = self.0.take().map(TapFile::finish) {
            output::message(&format!("warning: {reason}"));
        }
    }
}
