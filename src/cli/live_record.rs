//! The folder of `reproduce discovery --live`: what is finished is kept, and a study that was interrupted can be gone on with.
//!
//! ```text
//! live/unfinished.json             while it is there, a second start in the same folder goes on
//! live/modbus-rtu-7/answer.json    a drive that is finished; a drive without it is recorded anew
//! ```

use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::failure::{Failure, INTERNAL, USAGE};
use super::signals;
use crate::workflow::reproduce::discovery::{LiveAnswer, LiveLink};

const UNFINISHED: &str = "unfinished.json";
const ANSWER: &str = "answer.json";
/// A file under way; a reader does not take it for the file.
const PART: &str = "part";

/// Answers of two versions of the program are not one study.
#[derive(Serialize, Deserialize)]
struct Unfinished {
    version: String,
}

/// The folder of the drives, in the study's.
pub(super) struct LiveFolder(PathBuf);

impl LiveFolder {
    /// Of the study in `out`.
    pub(super) fn of(out: &Path) -> Self {
        Self(out.join("live"))
    }

    pub(super) fn path(&self) -> &Path {
        &self.0
    }

    /// Runs, models and answer of one drive.
    pub(super) fn drive(&self, link: LiveLink, seed: u64) -> PathBuf {
        self.0.join(format!("{}-{seed}", link.protocol()))
    }

    /// Whether a study in it was interrupted, so that it can be gone on with.
    ///
    /// # Errors
    /// Another version of the program began it.
    pub(super) fn is_unfinished(&self) -> Result<bool, Failure> {
        let Ok(text) = fs::read_to_string(self.0.join(UNFINISHED)) else {
            return Ok(false);
        };
        let begun: Option<Unfinished> = serde_json::from_str(&text).ok();
        let begun = begun.map_or_else(|| "another version".to_owned(), |begun| begun.version);
        let version = env!("CARGO_PKG_VERSION");
        if begun == version {
            return Ok(true);
        }
        Err(Failure::with_help(
            USAGE,
            format!(
                "{}: an unfinished study that drivebench {begun} began, and this is {version}: their answers are not one study",
                self.0.display()
            ),
            "give another folder with --out, or go on with the version that began it",
        ))
    }

    /// From here on the study is unfinished.
    pub(super) fn begin(&self) -> Result<(), Failure> {
        let unfinished = Unfinished {
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        fs::create_dir_all(&self.0).map_err(|error| cannot(&self.0, &error))?;
        write(&self.0.join(UNFINISHED), &unfinished)
    }

    /// The study is whole, and is not gone on with any more.
    pub(super) fn finish(&self) -> Result<(), Failure> {
        let path = self.0.join(UNFINISHED);
        fs::remove_file(&path).map_err(|error| cannot(&path, &error))
    }

    /// The answer of a drive that was finished by an earlier start.
    pub(super) fn answer(&self, link: LiveLink, seed: u64) -> Option<LiveAnswer> {
        let text = fs::read_to_string(self.drive(link, seed).join(ANSWER)).ok()?;
        let answer: LiveAnswer = serde_json::from_str(&text).ok()?;
        (answer.link == link && answer.seed == seed).then_some(answer)
    }

    pub(super) fn keep(&self, answer: &LiveAnswer) -> Result<(), Failure> {
        let folder = self.drive(answer.link, answer.seed);
        // A drive that failed at its first run has no folder yet.
        fs::create_dir_all(&folder).map_err(|error| cannot(&folder, &error))?;
        write(&folder.join(ANSWER), answer)
    }

    /// Removes what an interrupted start has left of a drive without an answer.
    pub(super) fn clear(&self, link: LiveLink, seed: u64) -> Result<(), Failure> {
        let folder = self.drive(link, seed);
        match fs::remove_dir_all(&folder) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(cannot(&folder, &error))
            }
            _ => Ok(()),
        }
    }
}

/// The whole file or none.
fn write(path: &Path, value: &impl Serialize) -> Result<(), Failure> {
    let _whole = signals::writing();
    let part = path.with_extension(PART);
    let text = serde_json::to_string_pretty(value).map_err(|error| cannot(path, &error))?;
    fs::write(&part, text + "\n")
        .and_then(|()| fs::rename(&part, path))
        .map_err(|error| cannot(path, &error))
}

fn cannot(path: &Path, error: &dyn std::error::Error) -> Failure {
    Failure::with_help(
        INTERNAL,
        format!("{}: {error}", path.display()),
        "check the folder, and start the command again: it goes on with what is kept",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finished_drive_is_found_again_and_half_a_drive_is_not() {
        let room = tempfile::tempdir().unwrap();
        let folder = LiveFolder::of(room.path());
        assert!(!folder.is_unfinished().unwrap());
        folder.begin().unwrap();
        assert!(folder.is_unfinished().unwrap());
        let mut answer = LiveAnswer::failed(LiveLink::Stream, 7, "no drive".to_owned());
        answer.holdout_before = Some(4.1);
        folder.keep(&answer).unwrap();
        assert_eq!(folder.answer(LiveLink::Stream, 7), Some(answer));
        assert_eq!(folder.answer(LiveLink::ModbusRtu, 7), None);
        let half = folder.drive(LiveLink::ModbusRtu, 7);
        fs::create_dir_all(&half).unwrap();
        fs::write(half.join("model-1.toml"), "[motor]").unwrap();
        folder.clear(LiveLink::ModbusRtu, 7).unwrap();
        assert!(!half.exists());
        folder.clear(LiveLink::ModbusRtu, 7).unwrap();
        folder.finish().unwrap();
        assert!(!folder.is_unfinished().unwrap());
        // Another version's answers are not taken for this one's.
        fs::write(folder.path().join(UNFINISHED), r#"{"version": "0.0.0"}"#).unwrap();
        let refused = folder.is_unfinished().unwrap_err();
        assert!(refused.headline().contains("0.0.0"), "{refused:?}");
    }
}
