//! Command times, which a drive may take to do what it is told, as its link knows it. Pure arithmetic over the profile.

use super::register_map::{Commands, Step};

/// What a command is given beyond the time of its steps, s: writes take time too, and the status is read after them.
const MARGIN_S: f64 = 1.0;
/// As above for a stop, s: many profiles only write it, and the shaft comes down by the drive's own ramp.
const STOP_MARGIN_S: f64 = 2.0;
/// Cycles that are allowed on top: steps go on in the cycle after the one that ends them, and a reply may be lost.
const CYCLES: f64 = 10.0;

/// Longest time from a command until the drive reports that it has obeyed, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandTimes {
    /// To run.
    pub enable_s: f64,
    /// To have its output off.
    pub stop_s: f64,
    /// To be without its fault.
    pub reset_s: f64,
}

impl Default for CommandTimes {
    /// Of a drive that obeys at once.
    fn default() -> Self {
        Self {
            enable_s: 1.0,
            stop_s: 1.0,
            reset_s: 1.0,
        }
    }
}

impl CommandTimes {
    /// What the commands of a profile allow.
    pub fn of(commands: &Commands) -> Self {
        Self {
            enable_s: longest_s(&commands.enable) + MARGIN_S,
            stop_s: longest_s(&commands.stop) + STOP_MARGIN_S,
            reset_s: longest_s(&commands.reset) + MARGIN_S,
        }
    }

    /// For a drive that is asked once in `period_s`: nothing shows between two cycles.
    #[must_use]
    pub fn asked_every(self, period_s: f64) -> Self {
        let cycles_s = CYCLES * period_s;
        Self {
            enable_s: self.enable_s + cycles_s,
            stop_s: self.stop_s + cycles_s,
            reset_s: self.reset_s + cycles_s,
        }
    }
}

/// Delays and longest waits.
fn longest_s(steps: &[Step]) -> f64 {
    steps
        .iter()
        .map(|step| match step {
            Step::Write(_) => 0.0,
            Step::Delay { seconds } => *seconds,
            Step::Wait { within_s, .. } => *within_s,
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DriveProfile;

    fn of(profile: &str) -> CommandTimes {
        let profile = DriveProfile::named(profile).unwrap();
        CommandTimes::of(&profile.registers.unwrap().commands)
    }

    #[test]
    fn delays_and_waits_of_a_profile_are_all_allowed() {
        // Waits of 1, 2 and 2 s; 10 s for the ramp.
        let waits = of("abb-efb");
        assert!(waits.enable_s > 5.0 && waits.enable_s < 7.0, "{waits:?}");
        assert!(waits.stop_s > 10.0 && waits.stop_s < 13.0, "{waits:?}");
        // Two pauses of 0.5 s, so that it never runs within 1 s.
        let pauses = of("abb-dcs-gateway");
        assert!(pauses.enable_s > 1.5, "{pauses:?}");
        assert!(pauses.reset_s > 1.0, "{pauses:?}");
    }

    #[test]
    fn no_profile_is_given_less_than_a_drive_that_obeys_at_once() {
        let least = CommandTimes::default();
        for name in DriveProfile::names() {
            if DriveProfile::named(name).unwrap().registers.is_none() {
                continue;
            }
            let times = of(name);
            assert!(times.enable_s >= least.enable_s, "{name}: {times:?}");
            assert!(times.stop_s >= least.stop_s, "{name}: {times:?}");
            assert!(times.reset_s >= least.reset_s, "{name}: {times:?}");
        }
    }

    #[test]
    fn a_slow_cycle_takes_its_time_on_top() {
        let slow = CommandTimes::default().asked_every(0.25);
        assert!((slow.enable_s - 3.5).abs() < 1e-9, "{slow:?}");
        assert!((slow.stop_s - 3.5).abs() < 1e-9 && (slow.reset_s - 3.5).abs() < 1e-9);
    }
}
