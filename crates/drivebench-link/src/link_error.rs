//! Errors of an exchange, with the next step for the user.

use thiserror::Error;

use super::exceptions::{self, Requested};
use super::unexpected::Unexpected;

/// Error of an exchange. Transient classes cost one cycle; `Gone` ends the session. A pair is link and reason.
#[derive(Clone, Debug, Error)]
pub enum LinkError {
    #[error("{}: cannot open: {}", whom(.0), .1)]
    Open(String, String),
    #[error("{}: no reply within {deadline_ms} ms to {request}", whom(link))]
    Timeout { link: String, deadline_ms: u64, request: String },
    #[error("{}: {}", whom(.0), .1)]
    Corrupt(String, String),
    #[error("{}: the reply belongs to an earlier request: {}", whom(.0), .1)]
    Stale(String, String),
    /// No request was sent, because the next reply might be that to an earlier one.
    #[error("{}: no request sent: {}", whom(.0), .1)]
    Unproven(String, String),
    #[error("{}: the reply belongs to another request: {}", whom(.0), .1)]
    Mismatch(String, String),
    #[error(
        "{}: {}: exception {code:#04x} {name}",
        whom(link),
        exceptions::sentence(*code, *requested, request)
    )]
    Exception { link: String, request: String, code: u8, name: &'static str, requested: Requested },
    /// Something else than the reply came.
    #[error("{}: {}", whom(link), what.sentence(request))]
    Unexpected { link: String, request: String, what: Unexpected },
    #[error("{}: the link is gone: {}", whom(.0), .1)]
    Gone(String, String),
    #[error(
        "{}: drive protocol version {found} is not {expected}, that of this program",
        whom(link)
    )]
    Version { link: String, found: u16, expected: u16 },
    #[error("{}: {}", whom(.0), .1)]
    Identity(String, String),
    /// Nothing was sent: the profile or its limits forbid it.
    #[error("{}: not sent: {}", whom(.0), .1)]
    Refused(String, String),
    /// The drive answers without reporting that it has stopped.
    #[error("{}: {}", whom(.0), .1)]
    Unstopped(String, String),
    /// A step of a command waited in vain for a status of the drive.
    #[error("{}: {command}, step {step} of {steps}: {reason}", whom(link))]
    Sequence { link: String, command: &'static str, step: usize, steps: usize, reason: String },
}

/// Result of an exchange.
pub type Result<T, E = LinkError> = std::result::Result<T, E>;

/// A link's name before a colon: that of the drive in memory, `sim:`, ends with one.
fn whom(link: &str) -> &str {
    link.trim_end_matches(':')
}

/// Ends the name of a link with frames of RTU over TCP.
pub(super) const OVER_TCP: &str = " (RTU)";

fn is_network(link: &str) -> bool {
    link.starts_with("tcp:")
}

impl LinkError {
    /// The next step for the person at the bench.
    pub fn help(&self) -> &'static str {
        match self {
            Self::Open(link, _) if is_network(link) => {
                "check address and port, and that the unit is on; some units take one connection at a time"
            }
            Self::Open { .. } => {
                "`drivebench ports` lists what is plugged in; no other program may hold the port"
            }
            Self::Timeout { link, .. } if link.ends_with(OVER_TCP) => {
                "is the drive powered, and do baud rate, parity and unit number fit on the serial side of the converter? A server of Modbus TCP does not answer RTU: leave --rtu-over-tcp out"
            }
            Self::Timeout { link, .. } if is_network(link) => {
                "is the drive powered, and the unit number right? A transparent serial converter carries RTU frames: --rtu-over-tcp (link.protocol = \"modbus-rtu-over-tcp\" in a bench file)"
            }
            Self::Timeout { .. } => {
                "is the drive powered, and wired? `drivebench doctor --port PORT --scan` finds baud rate, parity and unit"
            }
            Self::Corrupt(link, _) if is_network(link) => {
                "a gateway or converter damages the frames: check baud rate, parity and time-outs of its serial side"
            }
            Self::Corrupt { .. } => {
                "check baud rate and parity (`drivebench doctor --port PORT --scan` finds them), termination and shielding"
            }
            Self::Unproven { .. } => {
                "the link's earlier errors name the cause: a silent drive (power, cable), late replies (link.reply_ms, link.deadline_ms), or damaged frames (termination, shielding)"
            }
            Self::Unexpected { link, what, .. } => what.help(is_network(link)),
            Self::Stale { .. } => {
                "the drive or an adapter answers late: allow it more (link.reply_ms, link.deadline_ms), set the adapter's latency timer to 1 ms"
            }
            Self::Mismatch { .. } => {
                "two devices may share the address or the bus; see the link statistics"
            }
            Self::Exception { code, requested, .. } => exceptions::help(*code, *requested),
            Self::Gone(link, _) if is_network(link) => {
                "the peer closed the connection: check that it is on and that no other program uses it (some units take one connection, or one request a connection); then start again"
            }
            Self::Gone { .. } => {
                "check the cable, the adapter, and that the peer is switched on; then start again"
            }
            Self::Version { .. } => "use the drivebench release that matches the drive's firmware",
            Self::Identity { .. } => "check that the profile is the one of this drive",
            Self::Unstopped { .. } => {
                "switch its supply off; then look at its display, and at who else commands it"
            }
            Self::Refused { .. } => "see the drive's profile: what it maps, and its limits",
            Self::Sequence { .. } => {
                "look at the drive's display (enable input, local control, a fault) and at the line of the profile; then start again"
            }
        }
    }

    /// An exception to a request that a drive profile makes.
    pub(super) fn of_profile(mut self) -> Self {
        if let Self::Exception { requested, .. } = &mut self {
            requested.is_of_profile = true;
        }
        self
    }

    /// Whether the next cycle may simply try again.
    pub const fn is_transient(&self) -> bool {
        matches!(self, Self::Unexpected { what, .. } if !matches!(what, Unexpected::RtuFrames))
            || matches!(
                self,
                Self::Timeout { .. }
                    | Self::Corrupt { .. }
                    | Self::Stale { .. }
                    | Self::Mismatch { .. }
                    | Self::Unproven { .. }
            )
    }
}
