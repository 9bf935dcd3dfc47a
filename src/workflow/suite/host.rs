//! Acts on a command while its motor turns: signals, a terminal that goes, a line that is cut, a disk that is full.

use serde::Deserialize;

/// What is done to a command, or to what it depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Act {
    /// SIGKILL.
    Kill,
    /// SIGINT, once or a second time shortly after.
    Interrupt,
    InterruptTwice,
    /// SIGTERM.
    Terminate,
    /// SIGHUP.
    HangUp,
    /// SIGSTOP for `for_s`, then SIGCONT.
    Pause,
    /// It runs on a screen, whose terminal is closed.
    CloseTerminal,
    /// It runs on a screen, which takes nothing for `for_s`.
    BlockOutput,
    /// It runs on a screen, which shrinks to one row of one column.
    Shrink,
    /// Nobody reads what it prints any more.
    CloseOutput,
    /// The software drive is killed.
    KillDrive,
    /// The line goes, and comes back under the same name after `for_s`; without it never.
    Unplug,
    /// The same with another drive behind it.
    OtherDrive,
    /// A TCP connection is closed (FIN) or reset (RST), and can be made again after `for_s`; without it never.
    Cut,
    Reset,
    /// The line is there and carries nothing, for `for_s` or for good.
    BlackHole,
    /// Another run is begun on the same port.
    SecondHost,
    /// Another program reads the same serial port. It is the command's alone, and only root may open it all the same.
    SecondReader,
    /// The folder of its runs is deleted.
    FolderGone,
    /// No file of it may grow any more (`RLIMIT_FSIZE`), in place of a disk that is full.
    DiskFull,
    /// Before it begins: the port is not there, may not be opened, or its folder may not be written.
    PortAbsent,
    PortForbidden,
    OutForbidden,
}

impl Act {
    /// Whether it is done before the command begins.
    pub const fn is_before(self) -> bool {
        matches!(
            self,
            Self::PortAbsent | Self::PortForbidden | Self::OutForbidden
        )
    }

    /// Whether the command runs on a screen.
    pub const fn has_screen(self) -> bool {
        matches!(self, Self::CloseTerminal | Self::BlockOutput | Self::Shrink)
    }

    /// Whether something stands between the command and its drive.
    pub const fn is_on_line(self) -> bool {
        matches!(
            self,
            Self::Unplug | Self::OtherDrive | Self::Cut | Self::Reset | Self::BlackHole
        )
    }

    /// Whether it has to last for a time; `None`: it may.
    const fn lasts(self) -> Option<bool> {
        match self {
            Self::Pause | Self::BlockOutput | Self::OtherDrive => Some(true),
            Self::Unplug | Self::Cut | Self::Reset | Self::BlackHole => None,
            _ => Some(false),
        }
    }
}

/// An act at its time.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HostAct {
    pub act: Act,
    /// From the first set-point beyond `beyond_v`, as the drive sees it, s.
    #[serde(default)]
    pub at_s: f64,
    /// V. The pulse of the checks is the first set-point that is not zero; a run may ask for more.
    #[serde(default)]
    pub beyond_v: f64,
    pub for_s: Option<f64>,
}

/// Longest time of an act, s.
const MOST_S: f64 = 600.0;

impl HostAct {
    /// What is wrong with it, and what is allowed.
    pub(super) fn refusal(&self) -> Option<(String, String)> {
        let time = |key: &str, value: f64| {
            let what = format!("host: {key} = {value} is not allowed");
            let allowed = (0.0..=MOST_S).contains(&value);
            (!allowed).then(|| (what, format!("allowed: 0 to {MOST_S}")))
        };
        let times = [
            time("at_s", self.at_s),
            time("beyond_v", self.beyond_v),
            time("for_s", self.for_s.unwrap_or(0.0)),
        ];
        if let Some(refusal) = times.into_iter().flatten().next() {
            return Some(refusal);
        }
        match (self.act.lasts(), self.for_s) {
            (Some(true), None) => Some((
                "host: the act lasts, and for_s is left out".to_owned(),
                "give for_s, s".to_owned(),
            )),
            (Some(false), Some(_)) => Some((
                "host: for_s stands with an act that is done at once".to_owned(),
                "for_s is for pause, block_output, unplug, other_drive, cut, reset and black_hole"
                    .to_owned(),
            )),
            _ if self.act.is_before() && (self.at_s > 0.0 || self.beyond_v > 0.0) => Some((
                "host: at_s or beyond_v stands with an act that is done before the command begins"
                    .to_owned(),
                "leave both out".to_owned(),
            )),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_act_has_the_times_that_it_needs() {
        let refused = |text: &str| {
            let act: HostAct = toml::from_str(text).unwrap();
            act.refusal().map(|(what, _)| what)
        };
        assert_eq!(refused("act = \"kill\"\nat_s = 1.0\nbeyond_v = 30"), None);
        assert_eq!(refused("act = \"unplug\""), None);
        assert_eq!(refused("act = \"unplug\"\nfor_s = 2"), None);
        for (text, words) in [
            ("act = \"pause\"", "for_s is left out"),
            ("act = \"kill\"\nfor_s = 1", "done at once"),
            (
                "act = \"port_absent\"\nat_s = 1",
                "before the command begins",
            ),
            ("act = \"kill\"\nat_s = -1", "at_s = -1 is not allowed"),
            ("act = \"pause\"\nfor_s = 1e9", "for_s = 1000000000 is not"),
        ] {
            let said = refused(text).unwrap();
            assert!(said.contains(words), "{text}: {said}");
        }
    }
}
