//! Did the motor get the voltage that was commanded? Where the drive also measures it, this can be seen.
//!
//! A drive at its current limit, at the end of its bus voltage or in a ramp of its own applies something else than it was
//! told. A fit that takes the command for the voltage then bends every parameter to explain the difference.

use drivebench_model::numerics::statistics::robust_deviation;
use drivebench_model::sample::{Channel, Origin, ParameterEstimate, Run};

/// A difference beyond this many deviations of the usual one is none of noise.
const NOISE_DEVIATIONS: f64 = 8.0;
/// Differences below this share of the largest command are drops and rounding, which other checks look at.
const LEAST_SHARE: f64 = 0.02;
/// Share of the rows from which on the parameters are no longer sound.
const TOO_MANY: f64 = 0.005;
/// Rows below which a share says nothing.
const FEWEST_ROWS: usize = 20;

/// Rows in which the measured voltage is not the commanded one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Departure {
    /// Share of the rows that carry a measured voltage, 0..1.
    pub share: f64,
    /// Largest difference, V.
    pub largest_v: f64,
}

impl Departure {
    pub fn sentence(&self) -> String {
        format!(
            "the measured voltage is not the commanded one in {:.1} % of the rows (by up to {:.1} V): \
             the drive limited it (current limit, bus voltage, a ramp of its own)",
            100.0 * self.share,
            self.largest_v
        )
    }

    /// Nothing that rests on the commanded voltage is settled.
    pub fn limit(&self, parameters: &mut [ParameterEstimate]) {
        for parameter in parameters {
            parameter.unsettle(self.sentence());
        }
    }
}

/// Compares measured and commanded voltage; `None` where the run has not both, or where they agree.
pub fn find(run: &Run) -> Option<Departure> {
    if run.origin(Channel::Voltage) != Origin::Measured {
        return None;
    }
    let commands: Vec<(f64, f64)> = run.points(Channel::VoltageCmd).collect();
    let largest_command_v = commands.iter().fold(0.0_f64, |most, c| most.max(c.1.abs()));
    let differences: Vec<f64> = run
        .points(Channel::Voltage)
        .filter_map(|(time_s, measured_v)| {
            let next = commands.partition_point(|command| command.0 <= time_s);
            let held = commands[..next].last()?.1;
            // A sample at the very instant of a step may show either level.
            let before = next.checked_sub(2).map_or(held, |at| commands[at].1);
            let nearer = if (measured_v - before).abs() < (measured_v - held).abs() {
                before
            } else {
                held
            };
            Some(measured_v - nearer)
        })
        .collect();
    if differences.len() < FEWEST_ROWS {
        return None;
    }
    let usual = robust_deviation(&differences);
    let threshold = (NOISE_DEVIATIONS * usual).max(LEAST_SHARE * largest_command_v);
    let departed = differences.iter().filter(|d| d.abs() > threshold);
    let share = departed.clone().count() as f64 / differences.len() as f64;
    (share > TOO_MANY).then(|| Departure {
        share,
        largest_v: departed.fold(0.0, |most, d| most.max(d.abs())),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 10 s of steps; the drive applies `applied(command)` and measures it with 20 mV of ripple.
    fn run(applied: impl Fn(usize, f64) -> f64, origin: Origin) -> Run {
        let rows = 1000_usize;
        let mut run = Run::new("r", (0..rows).map(|k| 0.01 * k as f64).collect()).unwrap();
        let command: Vec<f64> = (0..rows).map(|k| 20.0 * ((k / 100) % 4) as f64).collect();
        let measured = command
            .iter()
            .enumerate()
            .map(|(k, u)| applied(k, *u) + if k.is_multiple_of(2) { 0.02 } else { -0.02 })
            .collect();
        run.set_column(Channel::VoltageCmd, command, Origin::Commanded)
            .unwrap();
        run.set_column(Channel::Voltage, measured, origin).unwrap();
        run
    }

    #[test]
    fn a_drive_that_follows_is_left_alone() {
        assert_eq!(find(&run(|_, u| u, Origin::Measured)), None);
        // A constant small loss is no limiting.
        assert_eq!(find(&run(|_, u| 0.99 * u, Origin::Measured)), None);
    }

    #[test]
    fn a_limited_voltage_is_found_with_its_share() {
        let limited = run(
            |k, u| if k % 100 < 10 { u.min(35.0) } else { u },
            Origin::Measured,
        );
        let departure = find(&limited).unwrap();
        // Two of four levels lie above 35 V, one tenth of the time; a sample may show the level before.
        assert!((0.04..0.06).contains(&departure.share), "{departure:?}");
        assert!((departure.largest_v - 25.0).abs() < 0.1, "{departure:?}");
    }

    #[test]
    fn a_voltage_that_nobody_measured_proves_nothing() {
        assert_eq!(find(&run(|_, u| 0.5 * u, Origin::Unknown)), None);
    }
}
