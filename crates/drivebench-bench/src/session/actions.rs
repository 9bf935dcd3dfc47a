//! Inputs and actions of a session.

use drivebench_model::tabulated;
use serde::Serialize;

use crate::recording::Event;
use crate::trip::Trip;
use drivebench_link::LinkError;
use drivebench_model::findings;
use drivebench_model::sample::{Command, Sample};

#[derive(Clone, Debug, PartialEq)]
pub enum Input {
    /// The deadline of a cycle: time to send.
    Cycle,
    Sample(Box<Sample>),
    Lost(Lost),
    /// The silence that is allowed is over, and no cycle begins yet.
    Silence,
    /// The computer was suspended for so long, s.
    Suspended(f64),
    /// So many frames of another master write to the drive.
    OtherMaster(u64),
    /// So many deadlines passed before this cycle began.
    Missed(u64),
    Intent(Intent),
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Lost {
    /// The next cycle may try again.
    Transient(String),
    /// An exception of a busy drive or gateway: the next cycle may try again.
    Busy(String),
    /// The drive does not have what was requested: no retry can help.
    Refused(String),
    /// The link does not come back within this session.
    Gone(String),
}

impl From<&LinkError> for Lost {
    fn from(error: &LinkError) -> Self {
        match error {
            // Illegal function, address or value (Modbus Application Protocol 1.1b3, section 7).
            LinkError::Exception { code: 1..=3, .. } => Self::Refused(error.to_string()),
            // A busy drive (04 to 06) or a gateway: the limit of link silence decides.
            LinkError::Exception { .. } => Self::Busy(error.to_string()),
            error if error.is_transient() => Self::Transient(error.to_string()),
            error => Self::Gone(error.to_string()),
        }
    }
}

findings! {
    /// A request of the user, of a signal or of the workflow.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub enum Intent {
        /// Output on at zero, then the program.
        Start = "start",
        /// Ramp down and end; a second one ends at once.
        Stop = "stop",
        /// As `Stop`, and the program is to end (Ctrl-C, SIGTERM, SIGHUP, `q`).
        Quit = "quit",
        ResetFault = "reset_fault",
        Mark(String) = "mark",
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    Info,
    Warning,
    Error,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Notice {
    pub level: Level,
    pub text: String,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    Done,
    Stopped,
    Interrupted,
    Tripped(Trip),
    LinkLost {
        reason: String,
    },
    /// The session could not be armed, so nothing moved.
    NotStarted {
        reason: String,
    },
}

impl Outcome {
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Stopped => "stopped",
            Self::Interrupted => "interrupted",
            Self::Tripped(_) => "tripped",
            Self::LinkLost { .. } => "link_lost",
            Self::NotStarted { .. } => "not_started",
        }
    }

    pub(super) const fn phase(&self) -> Phase {
        match self {
            Self::Done => Phase::Done,
            Self::Stopped | Self::Interrupted | Self::NotStarted { .. } => Phase::Stopped,
            Self::Tripped(_) => Phase::Tripped,
            Self::LinkLost { .. } => Phase::LinkLost,
        }
    }

    pub const fn exit_status(&self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Stopped | Self::Interrupted => 130,
            Self::Tripped(_) => 4,
            Self::LinkLost { .. } | Self::NotStarted { .. } => 3,
        }
    }
}

/// In the order in which they are to be done.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    Send(Command),
    /// The drive is to start a burst capture with the command that is sent next.
    ArmBurst,
    /// A row of the record; the recorder pairs it with the commands that were sent.
    Row(Box<Sample>),
    Event(Event),
    Notice(Notice),
    Finished(Outcome),
}

tabulated! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Phase {
        /// No valid reply yet, or the drive was found running or in fault.
        Connecting = "connecting",
        Safe = "safe",
        /// Output on at zero; waits for the drive to run, and for the start.
        Armed = "armed",
        Running = "running",
        RampDown = "ramp down",
        /// Stop is sent in every cycle until the drive confirms it.
        Stopping = "stopping",
        Done = "done",
        Stopped = "stopped",
        Tripped = "tripped",
        LinkLost = "link lost",
    }
    pub const fn name(self) -> &'static str;
}

impl Phase {
    pub const fn is_final(self) -> bool {
        matches!(self, Self::Done | Self::Stopped | Self::Tripped | Self::LinkLost)
    }

    /// Whether commands and samples belong to the record of the run.
    pub const fn is_recorded(self) -> bool {
        self.is_energised() || matches!(self, Self::Stopping)
    }

    pub const fn is_energised(self) -> bool {
        matches!(self, Self::Armed | Self::Running | Self::RampDown)
    }
}
