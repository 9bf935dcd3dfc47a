//! What a drive is to the bench: a profile, and a link that exchanges a command for a sample.
//!
//! ```text
//! profile (TOML) ---+
//!                   v
//! Command -> [ DriveLink: modbus | stream | in memory ] -> Sample
//! ```

mod link;

pub use link::{DriveLink, Identity, LinkError, LinkName, LinkStatistics};
