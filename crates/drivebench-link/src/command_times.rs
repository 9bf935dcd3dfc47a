//! Command times of a drive, from its profile. Pure arithmetic over the profile.

use super::register_map::{Commands, Step};

/// Longest time from a command until the drive confirms it, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandTimes {
    pub enable_s: f64,
    pub stop_s: f64,
    pub reset_s: f64,
}

impl Default for CommandTimes {
    /// For a drive without steps of its own.
    fn default() -> Self {
        Self { enable_s: 1.0, stop_s: 1.0, reset_s: 1.0 }
    }
}

impl CommandTimes {
    /// By the steps of a profile's commands.
    pub fn of(commands: &Commands) -> Self {
        // Beyond the time of the steps, s, for the writes and the status read after them.
        let margin_s = 1.0;
        Self {
            enable_s: longest_s(&commands.enable) + margin_s,
            // Twice the margin, because many profiles only write a stop, and the drive decelerates by its own ramp.
            stop_s: longest_s(&commands.stop) + 2.0,
            reset_s: longest_s(&commands.reset) + margin_s,
        }
    }

    /// For a drive that is polled with `period_s`, which delays every confirmation.
    #[must_use]
    pub fn polled_every(self, period_s: f64) -> Self {
        // Cycles that are allowed on top: steps go on in the cycle after the one that ends them, and a reply may be lost.
        let cycles_s = 10.0 * period_s;
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

    #[test]
    fn delays_and_waits_of_a_profile_are_all_allowed() {
        let least = CommandTimes::default();
        for name in DriveProfile::names() {
            let Some(map) = DriveProfile::named(name).unwrap().registers else { continue };
            let times = CommandTimes::of(&map.commands);
            let (enable_s, stop_s, reset_s) = match name {
                // Waits of 1, 2 and 2 s; 10 s for the ramp.
                "abb-efb" => (5.0..7.0, 10.0..13.0, 1.0..99.0),
                // Two pauses of 0.5 s, so that it never runs within 1 s.
                "abb-dcs-gateway" => (1.5..99.0, 1.0..99.0, 1.001..99.0),
                _ => (least.enable_s..99.0, least.stop_s..99.0, least.reset_s..99.0),
            };
            assert!(enable_s.contains(&times.enable_s), "{name}: {times:?}");
            assert!(stop_s.contains(&times.stop_s), "{name}: {times:?}");
            assert!(reset_s.contains(&times.reset_s), "{name}: {times:?}");
        }
        // A slow cycle takes its time on top.
        let slow = least.polled_every(0.25);
        for time_s in [slow.enable_s, slow.stop_s, slow.reset_s] {
            assert!((time_s - 3.5).abs() < 1e-9, "{slow:?}");
        }
    }
}
