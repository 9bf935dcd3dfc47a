//! The sealed file: the truth as JSON, under a key stream that is the same in every copy of the program.
//!
//! ```text
//! truth -> JSON -> xor ChaCha8(key, nonce) -> hex      checksum: FNV-1a of the JSON
//! ```

use std::fmt::Write as _;

use rand::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::Truth;
use crate::numerics::checksum::{EMPTY, fnv_1a};

const FORMAT: &str = "drivebench-mystery";
const VERSION: u32 = 1;
/// It hides, it does not protect.
const KEY: u64 = 0x6d79_7374_6572_7921;
const NONCE_STREAM: u64 = 5;

/// The file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Envelope {
    format: String,
    version: u32,
    note: String,
    nonce: String,
    sealed: String,
    checksum: String,
}

/// A file that holds no sealed truth, or one that somebody has changed.
#[derive(Debug, Error)]
pub enum SealError {
    #[error("{file}: not a sealed mystery: {reason}")]
    Format { file: String, reason: String },
    #[error("{file}: sealed in version {version} (expected {VERSION})")]
    Version { file: String, version: u32 },
    #[error("{file}: the seal is broken: its content is not what its checksum says")]
    Broken { file: String },
    #[error("the truth has no JSON form: {0}")]
    Truth(serde_json::Error),
}

impl SealError {
    /// The next step.
    pub const fn help(&self) -> &'static str {
        match self {
            Self::Format { .. } => {
                "give the file that `drivebench emulate --mystery SEED` wrote, mystery-SEED.sealed.json"
            }
            Self::Version { .. } => "open it with the drivebench that wrote it",
            Self::Broken { .. } => "write it anew: the same seed gives the same mystery",
            Self::Truth(_) => {
                "this is a fault of drivebench itself; please report it with the seed"
            }
        }
    }
}

pub(super) fn seal(truth: &Truth) -> Result<String, SealError> {
    let plain = serde_json::to_vec(truth).map_err(SealError::Truth)?;
    let mut rng = ChaCha8Rng::seed_from_u64(truth.seed);
    rng.set_stream(NONCE_STREAM);
    let nonce = rng.next_u64();
    let envelope = Envelope {
        format: FORMAT.to_owned(),
        version: VERSION,
        note: "drivebench reveal opens this; make your guess first".to_owned(),
        nonce: format!("{nonce:016x}"),
        sealed: hex(&masked(&plain, nonce)),
        checksum: format!("{:016x}", checksum(&plain)),
    };
    serde_json::to_string_pretty(&envelope)
        .map(|text| text + "\n")
        .map_err(SealError::Truth)
}

pub(super) fn open(file: &str, text: &str) -> Result<Truth, SealError> {
    let format = |reason: String| SealError::Format {
        file: file.to_owned(),
        reason,
    };
    let envelope: Envelope =
        serde_json::from_str(text).map_err(|error| format(error.to_string()))?;
    if envelope.format != FORMAT {
        return Err(format(format!("its format is {:?}", envelope.format)));
    }
    if envelope.version != VERSION {
        return Err(SealError::Version {
            file: file.to_owned(),
            version: envelope.version,
        });
    }
    let broken = || SealError::Broken {
        file: file.to_owned(),
    };
    let nonce = u64::from_str_radix(&envelope.nonce, 16).map_err(|_| broken())?;
    let sealed = bytes(&envelope.sealed).ok_or_else(broken)?;
    let plain = masked(&sealed, nonce);
    if format!("{:016x}", checksum(&plain)) != envelope.checksum {
        return Err(broken());
    }
    serde_json::from_slice(&plain).map_err(|_| broken())
}

/// The same twice is the original.
fn masked(plain: &[u8], nonce: u64) -> Vec<u8> {
    let mut rng = ChaCha8Rng::seed_from_u64(KEY ^ nonce);
    let mut mask = vec![0; plain.len()];
    rng.fill_bytes(&mut mask);
    plain
        .iter()
        .zip(mask)
        .map(|(byte, mask)| byte ^ mask)
        .collect()
}

/// FNV-1a, 64 bits.
pub(super) fn checksum(bytes: &[u8]) -> u64 {
    fnv_1a(EMPTY, bytes.iter().copied())
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

fn bytes(hex: &str) -> Option<Vec<u8>> {
    if !hex.is_ascii() || !hex.len().is_multiple_of(2) {
        return None;
    }
    (0..hex.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&hex[at..at + 2], 16).ok())
        .collect()
}
