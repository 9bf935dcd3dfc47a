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
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Act {
    /// Nothing does.
    Nothing,
    Replies(Reply, u32),
    /// So many in a thousand each are late by this much, s, lost, and doubled.
    PoorLine(f64, u32),
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
    pub(crate) const ALL: [Self; 5] = [
        Self::Run,
        Self::RunScreen,
        Self::Commission,
        Self::Speed,
        Self::SpeedScreen,
    ];

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

/// The ways in which it can happen at all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Where {
    Everywhere,
    Screen,
    Headless,
}

/// One line of the table.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fault {
    pub(crate) name: &'static str,
    pub(crate) act: Act,
    pub(crate) class: Class,
    /// Exit statuses that are documented for it.
    pub(crate) statuses: &'static [i32],
    /// Each of these has to occur in what the program says; alternatives are parted by `|`.
    pub(crate) words: &'static [&'static str],
    pub(crate) place: Where,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

impl Fault {
    pub(crate) fn happens(&self, way: Way) -> bool {
        match self.place {
            Where::Everywhere => true,
            Where::Screen => way.has_screen(),
            Where::Headless => !way.has_screen(),
        }
    }

    pub(crate) const fn host(&self) -> Option<Host> {
        match self.act {
            Act::Host(host) | Act::StopIgnored(host) => Some(host),
            _ => None,
        }
    }

    /// What is worth telling is missing from the words, in words.
    pub(crate) fn untold(&self, said: &str) -> Vec<String> {
        let said = said.to_lowercase();
        let is_told = |wanted: &&&str| !wanted.split('|').any(|word| said.contains(word));
        let untold = self.words.iter().filter(is_told);
        untold
            .map(|wanted| format!("nothing said of {wanted:?}"))
            .collect()
    }
}

const DONE: &[i32] = &[0];
const LINK: &[i32] = &[3];
const TRIP: &[i32] = &[4];
/// A drive that does not do as it is told is a failure of the device or a trip.
const LINK_OR_TRIP: &[i32] = &[3, 4];
const INTERRUPTED: &[i32] = &[130];
/// The process has no status of its own.
const KILLED: &[i32] = &[-1];
/// The longer of 200 ms and 5 cycles, in which a measurement that cannot be is found out, s.
const FOUND_OUT_S: f64 = 0.2;
/// In which somebody else on the line shows in what they leave, s.
const NOTICED_S: f64 = 1.0;

const fn line(name: &'static str, act: Act, words: &'static [&'static str]) -> Fault {
    fault(name, act, Class::GoesOn, DONE, words, Where::Everywhere)
}

const fn cut(
    name: &'static str,
    act: Act,
    statuses: &'static [i32],
    words: &'static [&'static str],
) -> Fault {
    fault(
        name,
        act,
        Class::Cut(0.0),
        statuses,
        words,
        Where::Everywhere,
    )
}

/// A measurement that cannot be.
const fn odd(name: &'static str, act: Act, words: &'static [&'static str]) -> Fault {
    let class = Class::Cut(FOUND_OUT_S);
    fault(name, act, class, TRIP, words, Where::Everywhere)
}

const fn leave(name: &'static str, host: Host, place: Where) -> Fault {
    let act = Act::Host(host);
    fault(name, act, Class::Ramp, INTERRUPTED, &[], place)
}

const fn fault(
    name: &'static str,
    act: Act,
    class: Class,
    statuses: &'static [i32],
    words: &'static [&'static str],
    place: Where,
) -> Fault {
    Fault {
        name,
        act,
        class,
        statuses,
        words,
        place,
    }
}

/// Replies of which something is done to this share, in a thousand.
const FEW: u32 = 10;
const SOME: u32 = 20;

pub(crate) const FAULTS: &[Fault] = &[
    // The line: a run goes on, and what is hidden in it is told.
    line("nothing", Act::Nothing, &[]),
    line(
        "one late reply",
        Act::LateOnce(0.07),
        &["late repl|replies late|came late|stale"],
    ),
    line("late replies", Act::Replies(Reply::Late(0.03), FEW), &[]),
    line("lost replies", Act::Replies(Reply::Lost, FEW), &[]),
    line("doubled replies", Act::Replies(Reply::Doubled, FEW), &[]),
    line(
        "garbage before replies",
        Act::Replies(Reply::GarbageBefore, SOME),
        &[],
    ),
    line(
        "garbage after replies",
        Act::Replies(Reply::GarbageAfter, SOME),
        &[],
    ),
    line("wrong check sums", Act::Replies(Reply::WrongCrc, SOME), &[]),
    line(
        "truncated replies",
        Act::Replies(Reply::Truncated, SOME),
        &[],
    ),
    line(
        "replies of another unit",
        Act::Replies(Reply::OtherUnit, SOME),
        &[],
    ),
    line(
        "foreign frames",
        Act::ForeignFrames,
        &["second master|another master|frames on the line"],
    ),
    fault(
        "second master writes",
        Act::SecondMaster,
        Class::Cut(NOTICED_S),
        LINK_OR_TRIP,
        &["master|set-point|commanded"],
        Where::Everywhere,
    ),
    cut(
        "exception 02",
        Act::Exception(2),
        LINK,
        &["exception 0x02|illegal data address"],
    ),
    cut(
        "exception 04",
        Act::Exception(4),
        LINK,
        &["exception 0x04|device failure|server failure"],
    ),
    cut(
        "exception 06",
        Act::Exception(6),
        LINK,
        &["busy|exception 0x06|no reply|silent"],
    ),
    fault(
        "dead line",
        Act::Dead(f64::INFINITY),
        Class::Watchdog,
        LINK,
        &["no reply|silent|gone"],
        Where::Everywhere,
    ),
    fault(
        "dead for 0.3 s",
        Act::Dead(0.3),
        Class::Cut(0.3),
        LINK,
        &["no reply|silent|gone"],
        Where::Everywhere,
    ),
    cut("mute drive", Act::Mute, LINK, &["no reply|silent"]),
    fault(
        "unplugged",
        Act::Unplugged,
        Class::Watchdog,
        LINK,
        &["gone|unplugged|hung up|silent"],
        Where::Everywhere,
    ),
    cut(
        "busy for 0.5 s",
        Act::Busy(0.5),
        LINK,
        &["no reply|silent|busy|late"],
    ),
    // The drive.
    odd(
        "encoder frozen",
        Act::Speed(Sensor::Frozen),
        &["encoder|speed|over-current"],
    ),
    odd(
        "encoder reversed",
        Act::Speed(Sensor::Scaled(-1.0)),
        &["encoder|speed|revers|over-current"],
    ),
    odd(
        "encoder stuck at zero",
        Act::Speed(Sensor::Scaled(0.0)),
        &["encoder|speed|over-current"],
    ),
    odd(
        "encoder times 0.3",
        Act::Speed(Sensor::Scaled(0.3)),
        &["encoder|speed|scale|over-current"],
    ),
    odd(
        "encoder times 3",
        Act::Speed(Sensor::Scaled(3.0)),
        &["encoder|speed|scale|over-current"],
    ),
    odd(
        "current stuck at zero",
        Act::Current(Sensor::Scaled(0.0)),
        &["current"],
    ),
    odd("current frozen", Act::Current(Sensor::Frozen), &["current"]),
    odd(
        "current times 4",
        Act::Current(Sensor::Scaled(4.0)),
        &["current"],
    ),
    odd(
        "set-points ignored",
        Act::SetPointsIgnored,
        &["set-point|setpoint|voltage"],
    ),
    fault(
        "frozen registers",
        Act::FrozenRegisters,
        Class::Cut(FOUND_OUT_S),
        // Nor does it tell that it has stopped.
        LINK_OR_TRIP,
        &["frozen|stuck|stands still|same|encoder|voltage|still runs|over-current"],
        Where::Everywhere,
    ),
    cut(
        "invalid codes",
        Act::InvalidCodes,
        LINK_OR_TRIP,
        &["speed|not available|invalid|missing"],
    ),
    fault(
        "enable ignored",
        Act::EnableIgnored,
        Class::Refused,
        LINK_OR_TRIP,
        &["does not run|not running|never ran|never runs"],
        Where::Everywhere,
    ),
    cut("drive trips", Act::Trip, TRIP, &["fault"]),
    cut(
        "watchdog of the drive trips",
        Act::CommLoss,
        TRIP,
        &["watchdog|communication|comm_loss"],
    ),
    cut("local control", Act::LocalControl, TRIP, &["local"]),
    cut("over-current", Act::Blocked, TRIP, &["current"]),
    cut("over-speed", Act::Driven, TRIP, &["speed|over-current"]),
    fault(
        "stop ignored",
        Act::StopIgnored(Host::InterruptKey),
        Class::Watchdog,
        &[3, 4, 130],
        &["not confirmed|still|did not stop|not stopped|unconfirmed|set-point not followed"],
        Where::Everywhere,
    ),
    cut(
        "power lost for 1 s",
        Act::PowerLost(1.0),
        LINK_OR_TRIP,
        &["silent|no reply|stopped|not run"],
    ),
    // The program.
    leave("SIGINT", Host::Interrupt, Where::Headless),
    leave("Ctrl-C", Host::InterruptKey, Where::Screen),
    leave("SIGINT twice", Host::InterruptTwice, Where::Everywhere),
    leave("SIGTERM", Host::Terminate, Where::Everywhere),
    leave("SIGHUP", Host::HangUp, Where::Everywhere),
    leave("SIGQUIT", Host::Quit, Where::Everywhere),
    leave("SIGUSR1", Host::User1, Where::Everywhere),
    leave("terminal closed", Host::CloseTerminal, Where::Screen),
    leave("stop key", Host::StopKey, Where::Screen),
    fault(
        "suspended for 1 s",
        Act::Host(Host::Suspend),
        Class::Watchdog,
        LINK_OR_TRIP,
        &["stood still|suspend|watchdog|silent"],
        Where::Everywhere,
    ),
    fault(
        "SIGKILL",
        Act::Host(Host::Kill),
        Class::Watchdog,
        KILLED,
        &[],
        Where::Everywhere,
    ),
    fault(
        "output closed",
        Act::Host(Host::CloseOutput),
        Class::GoesOn,
        &[0, 2, 6, 141],
        &[],
        Where::Headless,
    ),
    fault(
        "q while it turns",
        Act::Host(Host::QuitKey),
        Class::GoesOn,
        DONE,
        &[],
        Where::Screen,
    ),
    fault(
        "record folder gone",
        Act::Host(Host::FolderGone),
        Class::GoesOn,
        &[0, 2, 6],
        &["record|written|no such file"],
        Where::Headless,
    ),
    fault(
        "disk full",
        Act::Host(Host::DiskFull),
        Class::GoesOn,
        &[0, 2, 6],
        &["record|written|too large|no space"],
        Where::Everywhere,
    ),
];
