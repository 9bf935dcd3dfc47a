//! Deviation of the measured voltage from the commanded one.
//!
//! A drive at its current limit, at the limit of its bus voltage or in a ramp of its own does not apply the command. A fit with
//! the command as the input is biased then.

use drivebench_model::numerics::statistics::{largest, robust_deviation};
use drivebench_model::sample::{Channel, Origin, ParameterEstimate, Reason, Run};

/// Rows in which the measured voltage is not the commanded one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Departure {
    /// Share of the rows with a measured voltage, 0..1.
    pub share: f64,
    pub largest_v: f64,
}

/// Changes every settled verdict: the estimates depend on the commanded voltage.
pub fn limit(parameters: &mut [ParameterEstimate], reason: &str) {
    for parameter in parameters {
        parameter.unsettle(Reason::VoltageLimited, reason);
    }
}

/// Compares measured and commanded voltage; `None` where the run has not both, or where they agree.
pub fn find(run: &Run) -> Option<Departure> {
    if run.origin(Channel::Voltage) != Origin::Measured {
        return None;
    }
    let commands: Vec<(f64, f64)> = run.points(Channel::VoltageCmd).collect();
    let largest_command_v = largest(commands.iter().map(|command| command.1));
    let differences: Vec<f64> = run
        .points(Channel::Voltage)
        .filter_map(|(time_s, measured_v)| {
            let next = commands.partition_point(|command| command.0 <= time_s);
            let command = commands[..next].last()?.1;
            // A sample at the instant of a step may have either level.
            let before = next.checked_sub(2).map_or(command, |at| commands[at].1);
            let is_before = (measured_v - before).abs() < (measured_v - command).abs();
            Some(measured_v - if is_before { before } else { command })
        })
        .collect();
    if differences.len() < 20 {
        return None;
    }
    // Above eight standard deviations of the noise, and above 2 % for voltage drops and rounding.
    let threshold = (8.0 * robust_deviation(&differences)).max(0.02 * largest_command_v);
    let departed = differences.iter().filter(|d| d.abs() > threshold);
    let share = departed.clone().count() as f64 / differences.len() as f64;
    (share > 0.005).then(|| Departure { share, largest_v: largest(departed) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 10 s of steps; the drive applies `applied(command)` and measures it with 20 mV of ripple.
    fn run(applied: impl Fn(usize, f64) -> f64, origin: Origin) -> Run {
        let rows = 1000_usize;
        let mut run = Run::new("r", (0..rows).map(|k| 0.01 * k as f64).collect()).unwrap();
        let command: Vec<f64> = (0..rows).map(|k| 20.0 * ((k / 100) % 4) as f64).collect();
        let measured = command.iter().enumerate();
        let measured = measured.map(|(k, u)| applied(k, *u) + [0.02, -0.02][k % 2]).collect();
        run.set_column(Channel::VoltageCmd, command, Origin::Commanded).unwrap();
        run.set_column(Channel::Voltage, measured, origin).unwrap();
        run
    }

    #[test]
    fn a_limited_voltage_is_found_with_its_share() {
        assert_eq!(find(&run(|_, u| u, Origin::Measured)), None);
        // A constant small loss is no limiting, and a voltage that nobody measured shows none.
        assert_eq!(find(&run(|_, u| 0.99 * u, Origin::Measured)), None);
        assert_eq!(find(&run(|_, u| 0.5 * u, Origin::Unknown)), None);
        let limited = run(|k, u| if k % 100 < 10 { u.min(35.0) } else { u }, Origin::Measured);
        let departure = find(&limited).unwrap();
        // Two of four levels lie above 35 V, one tenth of the time; a sample may show the level before.
        assert!((0.04..0.06).contains(&departure.share), "{departure:?}");
        assert!((departure.largest_v - 25.0).abs() < 0.1, "{departure:?}");
    }
}
