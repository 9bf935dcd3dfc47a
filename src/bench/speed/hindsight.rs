//! The voltage behind a drive's own current loop: nobody commands it, and between two samples it is known only where it is
//! steady. A new command kicks it just when the sample is taken.

use super::encoder_watch::Seen;
use crate::bench::limits::Nameplate;

/// Between two samples voltage and current may move by these shares of the rated ones, and the mean still stands for what
/// was in force meanwhile: a current loop gives a step of its command in a part of a cycle.
const STEADY_V: f64 = 0.05;
const STEADY_A: f64 = 0.1;
/// The same of the command: a current loop answers a step of it with several volts for each ampere.
const STEADY_COMMAND: f64 = 0.03;

/// Gives each sample when the next has come.
pub(super) struct Hindsight {
    before: Option<Seen>,
    command_a: f64,
    steady_v: f64,
    steady_a: f64,
    steady_command_a: f64,
}

impl Hindsight {
    pub(super) fn new(motor: &Nameplate) -> Self {
        Self {
            before: None,
            command_a: 0.0,
            steady_command_a: STEADY_COMMAND * motor.rated_current_a,
            steady_v: STEADY_V * motor.rated_voltage_v,
            steady_a: STEADY_A * motor.rated_current_a,
        }
    }

    pub(super) const fn reset(&mut self) {
        self.before = None;
    }

    /// `now` with the voltage that was measured, and the current that was asked for; returns the sample before with the
    /// voltage that was in force until now.
    pub(super) fn look_back(&mut self, now: Seen, command_a: f64) -> Option<Seen> {
        let asked_before_a = std::mem::replace(&mut self.command_a, command_a);
        let before = self.before.replace(now)?;
        let steady = (now.current_a - before.current_a).abs() <= self.steady_a
            && (command_a - asked_before_a).abs() <= self.steady_command_a;
        let both = before.voltage_v.zip(now.voltage_v).filter(|(a, b)| {
            let moved = (b - a).abs();
            steady && moved <= self.steady_v
        });
        Some(Seen {
            voltage_v: both.map(|(a, b)| 0.5 * (a + b)),
            ..before
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_steady_voltage_is_known_and_one_sample_late() {
        let mut hindsight = Hindsight::new(&Nameplate::zk_22fc());
        let seen = |time_s: f64, current_a: f64, voltage_v: Option<f64>| Seen {
            time_s,
            speed_rad_s: 10.0,
            current_a,
            voltage_v,
            reference_rad_s: 10.0,
        };
        let mut back = |now| {
            hindsight
                .look_back(now, 0.0)
                .map(|seen| (seen.time_s, seen.voltage_v))
        };
        assert_eq!(back(seen(0.0, 1.0, Some(10.0))), None);
        assert_eq!(back(seen(0.01, 1.1, Some(12.0))), Some((0.0, Some(11.0))));
        assert_eq!(back(seen(0.02, 1.1, Some(30.0))), Some((0.01, None)));
        assert_eq!(back(seen(0.03, 9.0, Some(30.0))), Some((0.02, None)));
        assert_eq!(back(seen(0.04, 9.0, None)), Some((0.03, None)));
    }
}
