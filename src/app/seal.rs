//! The sealed truth of a mystery, beside the runs that were made with it.

use std::path::{Path, PathBuf};

use super::failure::{Failure, USAGE};
use super::output;
use crate::emulator::mystery::{Mystery, SealError};

/// Writes the sealed truth and says where it is. The seed fixes every letter of it, so that the same mystery may be
/// drawn again, and another one finds its place taken.
pub(crate) fn seal(mystery: &Mystery, path: &Path) -> Result<(), Failure> {
    let text = mystery.truth.seal()?;
    let is_there = std::fs::read_to_string(path).is_ok_and(|there| there == text);
    if !is_there {
        output::refuse_existing(path, "--seal or --out")?;
        output::file(path, &text)?;
    }
    output::message(&format!("sealed truth in {}", path.display()));
    Ok(())
}

pub(crate) fn sealed_name(seed: u64) -> PathBuf {
    PathBuf::from(format!("mystery-{seed}.sealed.json"))
}

impl From<SealError> for Failure {
    fn from(error: SealError) -> Self {
        let help = error.help();
        Self::with_help(USAGE, error.to_string(), help)
    }
}
