//! Whether a trial went as the table says, by the drive's own log alone.

use super::drive::{Drive, Row};
use super::fault::{Act, Class, Host};

/// One step of the set-point's register and a little, V.
const STEP_V: f64 = 0.15;
/// What counts as zero output, V.
const ZERO_V: f64 = 0.05;

/// Cycle of the bench file, s, and its slew limit, V/s.
const PERIOD_S: f64 = 0.02;
const SLEW_V_PER_S: f64 = 300.0;
/// Longest time that the stop command of the profile takes, s.
const STOP_S: f64 = 0.5;
/// Highest voltage of a pulse, V.
const PULSE_V: f64 = 30.0;
/// Silence after which the program gives a link up: the longer of 3 cycles and 100 ms; and one cycle.
const REACTION_S: f64 = 0.1 + PERIOD_S;

/// Where the output went for good.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Ending {
    /// From here on it is zero, s; `None`: it never is.
    pub(crate) zero_s: Option<f64>,
    /// Last time that its magnitude rose, s.
    pub(crate) rose_s: f64,
    /// First time after that at which it fell, s.
    pub(crate) fell_s: f64,
    /// Magnitude from which it fell, V.
    pub(crate) volts: f64,
    pub(crate) is_off: bool,
}

pub(crate) fn ending(log: &[Row]) -> Ending {
    let mut end = Ending::default();
    let mut low = 0.0_f64;
    for row in log {
        let volts = row.volts.abs();
        if volts > low + STEP_V {
            (end.rose_s, end.fell_s, end.volts) = (row.time_s, f64::INFINITY, volts);
            low = volts;
        } else if volts < low - STEP_V {
            end.fell_s = end.fell_s.min(row.time_s);
            low = volts;
        }
        if volts > ZERO_V {
            end.zero_s = None;
        } else if end.zero_s.is_none() {
            end.zero_s = Some(row.time_s);
        }
        end.is_off = !row.is_on;
    }
    end
}

/// What was wrong, in words; `from_s`: when the host could see the fault, or was told to end.
pub(crate) fn judge(drive: &Drive, act: Act, class: Class, from_s: Option<f64>) -> Vec<String> {
    let end = ending(&drive.log);
    let mut wrong = Vec::new();
    let Some(zero_s) = end.zero_s else {
        return vec!["the output is not zero at the end".to_owned()];
    };
    if !end.is_off {
        wrong.push("the output is on at the end".to_owned());
    }
    if class == Class::Refused {
        let most = drive.log.iter().map(|row| row.volts.abs()).fold(0.0, f64::max);
        if most > PULSE_V {
            wrong.push(format!("energised with {most:.1} V"));
        }
        return wrong;
    }
    let Some(from_s) = from_s else {
        wrong.push("the fault never came about".to_owned());
        return wrong;
    };
    let mut within = |what: &str, took_s: f64, allowed_s: f64| {
        if took_s > allowed_s {
            wrong.push(format!("{what} after {took_s:.3} s instead of {allowed_s:.3} s"));
        }
    };
    match class {
        Class::Cut(extra_s) => within("zero", zero_s - from_s, REACTION_S + extra_s),
        Class::Ramp => {
            within("the ramp begins", end.fell_s - from_s, REACTION_S);
            within("the magnitude rises", end.rose_s - from_s, REACTION_S);
            let ramp_s = end.volts / SLEW_V_PER_S + STOP_S;
            within("the ramp ends", zero_s - end.fell_s, ramp_s + REACTION_S);
        }
        Class::Watchdog => {
            // Whatever still arrives counts for the drive.
            let last_s = match act {
                Act::Host(Host::Kill | Host::Suspend) | Act::StopIgnored(_) => drive.written_s,
                _ => from_s,
            };
            let allowed_s = drive.watchdog_s() + PERIOD_S;
            within("zero", zero_s - last_s.max(from_s), allowed_s);
        }
        Class::GoesOn | Class::Refused => {}
    }
    wrong
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(time_s: f64, volts: f64) -> Row {
        Row { time_s, volts, current_a: 0.0, speed_rad_s: 0.0, is_on: volts != 0.0 }
    }

    #[test]
    fn the_end_is_the_last_fall_to_zero() {
        let volts = [0.0, 5.0, 0.0, 40.0, 40.0, 30.0, 20.0, 0.0, 0.0];
        let log: Vec<Row> = (0..).zip(volts).map(|(t, u)| row(f64::from(t), u)).collect();
        let wanted =
            Ending { zero_s: Some(7.0), rose_s: 3.0, fell_s: 5.0, volts: 40.0, is_off: true };
        assert_eq!(ending(&log), wanted);
        // It rises again while it should stop.
        let armed = [log, vec![row(9.0, 3.0)]].concat();
        assert_eq!(ending(&armed).zero_s, None);
    }
}
