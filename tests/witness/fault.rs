//! Everything that goes wrong in a trial, and what has to follow: one table.

use std::fmt;

/// What is done to a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Sensor {
    /// It keeps the value of the moment.
    Frozen,
    /// It tells so many times the truth: -1 reversed, 0 stuck at zero.
    Scaled(f64),
}

/// What happens to a share of the replies, in a thousand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Reply {
    /// So many s later.
    Late(f64),
    Lost,
    Doubled,
    GarbageBefore,
    GarbageAfter,
    WrongCrc,
    Truncated,
    OtherUnit,
    /// Its second part so many s later.
    Split(f64),
}

/// What is done to the program, or to what surrounds it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Host {
    Interrupt,
    InterruptTwice,
    Terminate,
    HangUp,
    Quit,
    User1,
    /// Stopped for a second, then continued.
    Suspend,
    Kill,
    CloseTerminal,
    CloseOutput,
    StopKey,
    QuitKey,
    /// Ctrl-C as a key; the signal where there is no screen.
    InterruptKey,
    FolderGone,
    /// From the start of the process on no file may grow beyond a few kB.
    DiskFull,
}

/// What goes wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Act {
    /// Nothing does.
    #[default]
    Nothing,
    Replies(Reply, u32),
    /// So many in a thousand each are late by this much, s, lost, and doubled.
    PoorLine(f64, u32),
    /// So many in a thousand in all, each spoilt in one of all ways; late ones by this much, s.
    RoughLine(f64, u32),
    LateOnce(f64),
    /// Two other devices talk on the line.
    ForeignFrames,
    /// Another master writes set-points.
    SecondMaster,
    Exception(u8),
    /// Neither side hears the other, for so long.
    Dead(f64),
    /// The drive hears and says nothing.
    Mute,
    Unplugged,
    Speed(Sensor),
    Current(Sensor),
    /// Acknowledged and not followed.
    SetPointsIgnored,
    EnableIgnored,
    Trip,
    CommLoss,
    LocalControl,
    InvalidCodes,
    FrozenRegisters,
    /// The drive answers nothing for so long, then everything.
    Busy(f64),
    Blocked,
    Driven,
    StopIgnored(Host),
    /// Off for so long, then as after power-up.
    PowerLost(f64),
    Host(Host),
}

/// What has to follow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Class {
    /// Zero within the longer of 3 cycles and 100 ms, one cycle and this, s, once it can be seen.
    Cut(f64),
    /// The ramp begins within that and ends in its own time.
    Ramp,
    /// Zero within the drive's watchdog.
    Watchdog,
    /// The run ends as if nothing had been.
    GoesOn,
    /// Nothing is ever energised beyond the pulse of the checks.
    Refused,
}

/// A way of running the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    Run,
    RunScreen,
    Commission,
    Speed,
    SpeedScreen,
}

impl Way {
    pub(crate) const ALL: [Self; 5] =
        [Self::Run, Self::RunScreen, Self::Commission, Self::Speed, Self::SpeedScreen];

    pub(crate) const fn command(self) -> &'static str {
        match self {
            Self::Run | Self::RunScreen => "run",
            Self::Commission => "commission",
            Self::Speed | Self::SpeedScreen => "speed",
        }
    }

    pub(crate) const fn has_screen(self) -> bool {
        matches!(self, Self::RunScreen | Self::SpeedScreen)
    }
}

/// What a fault is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Subject {
    /// The line, where the run goes on.
    Line,
    /// The program, or what surrounds it.
    Host,
    Drive,
}

/// One line of the table: what goes wrong, and what has to follow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fault {
    pub(crate) name: &'static str,
    pub(crate) act: Act,
    pub(crate) class: Class,
    /// Exit statuses that are documented for it.
    pub(crate) statuses: &'static [i32],
    /// One of these has to occur in what the program says; parted by `|`.
    words: &'static str,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

impl Fault {
    /// Whether it can happen at all in this way of running.
    pub(crate) fn happens(&self, way: Way) -> bool {
        match self.act {
            Act::Host(Host::Interrupt | Host::CloseOutput | Host::FolderGone) => !way.has_screen(),
            Act::Host(Host::InterruptKey | Host::CloseTerminal | Host::StopKey | Host::QuitKey) => {
                way.has_screen()
            }
            _ => true,
        }
    }

    pub(crate) fn ways(&self) -> impl Iterator<Item = Way> {
        Way::ALL.into_iter().filter(|way| self.happens(*way))
    }

    pub(crate) const fn subject(&self) -> Subject {
        match (self.act, self.class) {
            (Act::Host(_), _) => Subject::Host,
            (Act::Nothing, _) => Subject::Drive,
            (_, Class::GoesOn) => Subject::Line,
            _ => Subject::Drive,
        }
    }

    pub(crate) const fn host(&self) -> Option<Host> {
        match self.act {
            Act::Host(host) | Act::StopIgnored(host) => Some(host),
            _ => None,
        }
    }

    /// What is worth telling is missing from the words, in words.
    pub(crate) fn untold(&self, said: &str) -> Option<String> {
        let said = said.to_lowercase();
        let is_told = self.words.split('|').any(|word| said.contains(word));
        (!is_told).then(|| format!("nothing said of {:?}", self.words))
    }
}

const DONE: &[i32] = &[0];
const LINK: &[i32] = &[3];
const TRIP: &[i32] = &[4];
/// A drive that does not do as it is told is a failure of the device or a trip.
const LINK_OR_TRIP: &[i32] = &[3, 4];
/// The longer of 200 ms and 5 cycles, in which a measurement that cannot be is found out, s.
pub(crate) const FOUND_OUT_S: f64 = 0.2;
/// In which somebody else on the line shows in what they leave, s.
const NOTICED_S: f64 = 1.0;

/// What has to follow: how soon the output is off, the exit statuses, and what is said.
const fn follows(act: Act) -> (Class, &'static [i32], &'static str) {
    use Class::{Cut, GoesOn, Ramp, Refused, Watchdog};
    match act {
        Act::Nothing
        | Act::Replies(..)
        | Act::PoorLine(..)
        | Act::RoughLine(..)
        | Act::Host(Host::QuitKey) => (GoesOn, DONE, ""),
        Act::LateOnce(_) => (GoesOn, DONE, "late repl|replies late|came late|stale"),
        Act::ForeignFrames => (GoesOn, DONE, "second master|another master|frames on the line"),
        Act::SecondMaster => (Cut(NOTICED_S), LINK_OR_TRIP, "master|set-point|commanded"),
        Act::Exception(2) => (Cut(0.0), LINK, "exception 0x02|illegal data address"),
        Act::Exception(4) => (Cut(0.0), LINK, "exception 0x04|device failure|server failure"),
        Act::Exception(_) => (Cut(0.0), LINK, "exception 0x06"),
        Act::Dead(f64::INFINITY) => (Watchdog, LINK, "no reply|silent|gone"),
        Act::Dead(seconds) => (Cut(seconds), LINK, "no reply|silent|gone"),
        Act::Mute => (Cut(0.0), LINK, "no reply|silent"),
        Act::Unplugged => (Watchdog, LINK, "gone|unplugged|hung up|silent"),
        Act::Busy(_) => (Cut(0.0), LINK, "no reply|silent|busy|late"),
        Act::Speed(Sensor::Frozen) => (Cut(FOUND_OUT_S), TRIP, "encoder|speed|over-current"),
        Act::Speed(Sensor::Scaled(by)) => {
            let words = if by < 0.0 {
                "encoder|speed|revers|over-current"
            } else if by > 0.0 {
                "encoder|speed|scale|over-current"
            } else {
                "encoder|speed|over-current"
            };
            (Cut(FOUND_OUT_S), TRIP, words)
        }
        Act::Current(_) => (Cut(FOUND_OUT_S), TRIP, "current"),
        Act::SetPointsIgnored => (Cut(FOUND_OUT_S), TRIP, "set-point|setpoint|voltage"),
        // Nor does it tell that it has stopped.
        Act::FrozenRegisters => (
            Cut(FOUND_OUT_S),
            LINK_OR_TRIP,
            "frozen|stuck|stands still|same|encoder|voltage|still runs|over-current",
        ),
        Act::InvalidCodes => (Cut(0.0), LINK_OR_TRIP, "speed|not available|invalid|missing"),
        Act::EnableIgnored => {
            (Refused, LINK_OR_TRIP, "does not run|not running|never ran|never runs")
        }
        Act::Trip => (Cut(0.0), TRIP, "fault"),
        Act::CommLoss => (Cut(0.0), TRIP, "watchdog|communication|comm_loss"),
        Act::LocalControl => (Cut(0.0), TRIP, "local"),
        Act::Blocked => (Cut(0.0), TRIP, "current"),
        Act::Driven => (Cut(0.0), TRIP, "speed|over-current"),
        Act::StopIgnored(_) => (
            Watchdog,
            &[3, 4, 130],
            "not confirmed|still|did not stop|not stopped|unconfirmed|set-point not followed",
        ),
        Act::PowerLost(_) => (Cut(0.0), LINK_OR_TRIP, "silent|no reply|stopped|not run"),
        Act::Host(Host::Suspend) => (Watchdog, LINK_OR_TRIP, "stood still|suspend|watchdog|silent"),
        // The process has no status of its own.
        Act::Host(Host::Kill) => (Watchdog, &[-1], ""),
        Act::Host(Host::CloseOutput) => (GoesOn, &[0, 2, 6, 141], ""),
        Act::Host(Host::FolderGone) => (GoesOn, &[0, 2, 6], "record|written|no such file"),
        Act::Host(Host::DiskFull) => (GoesOn, &[0, 2, 6], "record|written|too large|no space"),
        Act::Host(_) => (Ramp, &[130], ""),
    }
}

const fn fault(name: &'static str, act: Act) -> Fault {
    let (class, statuses, words) = follows(act);
    Fault { name, act, class, statuses, words }
}

/// Replies of which something is done to this share, in a thousand.
const FEW: u32 = 10;
const SOME: u32 = 20;

pub(crate) const FAULTS: &[Fault] = &[
    // The line: a run goes on, and what is hidden in it is told.
    fault("nothing", Act::Nothing),
    fault("one late reply", Act::LateOnce(0.07)),
    fault("late replies", Act::Replies(Reply::Late(0.03), FEW)),
    fault("lost replies", Act::Replies(Reply::Lost, FEW)),
    fault("doubled replies", Act::Replies(Reply::Doubled, FEW)),
    fault("garbage before replies", Act::Replies(Reply::GarbageBefore, SOME)),
    fault("garbage after replies", Act::Replies(Reply::GarbageAfter, SOME)),
    fault("wrong check sums", Act::Replies(Reply::WrongCrc, SOME)),
    fault("truncated replies", Act::Replies(Reply::Truncated, SOME)),
    fault("replies of another unit", Act::Replies(Reply::OtherUnit, SOME)),
    fault("foreign frames", Act::ForeignFrames),
    fault("second master writes", Act::SecondMaster),
    fault("exception 02", Act::Exception(2)),
    fault("exception 04", Act::Exception(4)),
    fault("exception 06", Act::Exception(6)),
    fault("dead line", Act::Dead(f64::INFINITY)),
    fault("dead for 0.3 s", Act::Dead(0.3)),
    fault("mute drive", Act::Mute),
    fault("unplugged", Act::Unplugged),
    fault("busy for 0.5 s", Act::Busy(0.5)),
    // The drive.
    fault("encoder frozen", Act::Speed(Sensor::Frozen)),
    fault("encoder reversed", Act::Speed(Sensor::Scaled(-1.0))),
    fault("encoder stuck at zero", Act::Speed(Sensor::Scaled(0.0))),
    fault("encoder times 0.3", Act::Speed(Sensor::Scaled(0.3))),
    fault("encoder times 3", Act::Speed(Sensor::Scaled(3.0))),
    fault("current stuck at zero", Act::Current(Sensor::Scaled(0.0))),
    fault("current frozen", Act::Current(Sensor::Frozen)),
    fault("current times 4", Act::Current(Sensor::Scaled(4.0))),
    fault("set-points ignored", Act::SetPointsIgnored),
    fault("frozen registers", Act::FrozenRegisters),
    fault("invalid codes", Act::InvalidCodes),
    fault("enable ignored", Act::EnableIgnored),
    fault("drive trips", Act::Trip),
    fault("watchdog of the drive trips", Act::CommLoss),
    fault("local control", Act::LocalControl),
    fault("over-current", Act::Blocked),
    fault("over-speed", Act::Driven),
    fault("stop ignored", Act::StopIgnored(Host::InterruptKey)),
    fault("power lost for 1 s", Act::PowerLost(1.0)),
    // The program.
    fault("SIGINT", Act::Host(Host::Interrupt)),
    fault("Ctrl-C", Act::Host(Host::InterruptKey)),
    fault("SIGINT twice", Act::Host(Host::InterruptTwice)),
    fault("SIGTERM", Act::Host(Host::Terminate)),
    fault("SIGHUP", Act::Host(Host::HangUp)),
    fault("SIGQUIT", Act::Host(Host::Quit)),
    fault("SIGUSR1", Act::Host(Host::User1)),
    fault("terminal closed", Act::Host(Host::CloseTerminal)),
    fault("stop key", Act::Host(Host::StopKey)),
    fault("suspended for 1 s", Act::Host(Host::Suspend)),
    fault("SIGKILL", Act::Host(Host::Kill)),
    fault("output closed", Act::Host(Host::CloseOutput)),
    fault("q while it turns", Act::Host(Host::QuitKey)),
    fault("record folder gone", Act::Host(Host::FolderGone)),
    fault("disk full", Act::Host(Host::DiskFull)),
];
