//! What a line does to a measurement: delays, vague stamps, late and lost replies against parameter error and coverage.
//!
//! ```text
//! drive (motor, line, seed) -> Run -> output-error fit -> value, interval -> error, inside or outside -> LineStudy -> pages
//! ```
//!
//! Every motor and every excitation is another; the same seed gives the same numbers.

mod drive;

use rayon::prelude::*;
use serde::Serialize;

use crate::identification::{scheme, stamps};
use crate::numerics::statistics::median;
use crate::plant::{Model, Motor, MotorKey, Scenario};
use crate::sample::{Channel, ParameterEstimate, Run, Verdict};

pub use drive::{Errors, Pace, Recorded, VoltageKnown, record};

/// R, L, Ke, J, Mc.
pub const KEYS: [MotorKey; 5] = [
    MotorKey::Resistance,
    MotorKey::Inductance,
    MotorKey::BackEmf,
    MotorKey::Inertia,
    MotorKey::LoadTorque,
];

/// Everything that a host's record can suffer from, but for what happens to replies.
pub const ALL_ERRORS: Errors = Errors {
    stamps: true,
    jitter: true,
    quantised: true,
    voltage: VoltageKnown::Commanded,
    late: 0.0,
    lost: 0.0,
    doubled: 0.0,
};

/// A profiled drive without a clock at 115,200 baud.
pub const HOST_STAMPED: Pace = Pace {
    rate_hz: 50.0,
    request_s: 0.8e-3,
    reply_s: 1.6e-3,
    drive_cycle_s: 2e-3,
};

/// One line of a table: a line, or a cause that was left out.
#[derive(Clone, Debug, Serialize)]
pub struct LineRow {
    pub name: String,
    /// Samples per second that came.
    pub rate_hz: f64,
    /// Half-widths of the stamps, s: median and 99 %; zero where the drive stamps.
    pub half_width_s: [f64; 2],
    pub runs: usize,
    /// In the order of [`KEYS`].
    pub parameters: [ParameterRow; 5],
}

/// What was found of one parameter.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct ParameterRow {
    /// Runs in which it has a value.
    pub valued: usize,
    /// Of these, in which the 95 % interval holds the truth.
    pub covered: usize,
    pub settled: usize,
    /// Of the settled ones, how many lie more than three standard deviations off.
    pub settled_wrong: usize,
    /// Median of the relative error, signed and by size, and of the relative standard deviation, %.
    pub bias_percent: f64,
    pub error_percent: f64,
    pub std_percent: f64,
}

impl ParameterRow {
    /// Share of the values whose interval holds the truth.
    pub fn coverage(&self) -> f64 {
        self.covered as f64 / self.valued as f64
    }
}

/// The whole study.
#[derive(Clone, Debug, Serialize)]
pub struct LineStudy {
    pub runs: usize,
    pub seed: u64,
    pub lines: Vec<LineRow>,
    pub causes: Vec<LineRow>,
}

/// `runs` records of each kind.
pub fn line_study(runs: usize, seed: u64) -> LineStudy {
    let pace = |rate_hz, request_s, reply_s, drive_cycle_s| Pace {
        rate_hz,
        request_s,
        reply_s,
        drive_cycle_s,
    };
    let all = ALL_ERRORS;
    let but = |change: fn(&mut Errors)| {
        let mut errors = all;
        change(&mut errors);
        errors
    };
    let clocked = but(|errors| errors.stamps = false);
    let prompt = but(|errors| errors.jitter = false);
    let fine = but(|errors| errors.quantised = false);
    let own = but(|errors| (errors.stamps, errors.quantised) = (false, false));
    let sampled = but(|errors| errors.voltage = VoltageKnown::Sampled);
    let slow = pace(20.0, 4.2e-3, 8.0e-3, 4e-3);
    let links = [
        ("own, stream", pace(200.0, 0.2e-3, 0.4e-3, 1e-3), own),
        ("own, Modbus RTU", pace(100.0, 0.8e-3, 3.2e-3, 1e-3), own),
        ("own, Modbus TCP", pace(100.0, 0.2e-3, 0.3e-3, 1e-3), own),
        ("profiled, with a clock", HOST_STAMPED, clocked),
        ("profiled, without one", HOST_STAMPED, all),
        ("profiled, 19,200 baud", slow, all),
    ];
    let mut lines = Vec::new();
    for (name, pace, errors) in links {
        for percent in [0.0, 1.0, 5.0] {
            let share = 0.01 * percent;
            let errors = Errors {
                late: share,
                lost: share,
                doubled: share,
                ..errors
            };
            let name = format!("{name}; {percent:.0} %");
            lines.push(row(name, pace, errors, runs, seed, Told::All));
        }
    }
    let believed = Told::StampsBelieved;
    let causes = [
        ("all causes, stamps believed", all, believed),
        ("all causes", all, Told::All),
        ("no error of stamps", clocked, Told::All),
        ("no jitter, stamps believed", prompt, believed),
        ("no quantisation, stamps believed", fine, believed),
        ("voltage sampled only, stamps believed", sampled, believed),
        ("voltage sampled only", sampled, Told::All),
    ];
    let cause = |(name, errors, told): (&str, Errors, Told)| {
        row(name.to_owned(), HOST_STAMPED, errors, runs, seed, told)
    };
    LineStudy {
        runs,
        seed,
        lines,
        causes: causes.map(cause).into(),
    }
}

/// Whether the fit is told how vague the stamps are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Told {
    All,
    StampsBelieved,
}

/// One kind of record, `runs` times.
pub fn row(
    name: String,
    pace: Pace,
    errors: Errors,
    runs: usize,
    seed: u64,
    told: Told,
) -> LineRow {
    let identified = |seed| {
        let recorded = record(seed, pace, errors);
        let estimates = match told {
            Told::All => identify(&recorded.run),
            Told::StampsBelieved => identify(&recorded.run.without(Channel::TimeHalfWidth)),
        };
        (recorded, estimates)
    };
    let seeds = (seed..seed + runs as u64).into_par_iter();
    let found: Vec<(Recorded, Vec<ParameterEstimate>)> = seeds.map(identified).collect();
    let recorded = found.iter().map(|(recorded, _)| &recorded.run);
    let half_widths = recorded.flat_map(|run| run.points(Channel::TimeHalfWidth));
    let mut half_widths: Vec<f64> = half_widths.map(|point| point.1).collect();
    half_widths.sort_by(f64::total_cmp);
    let at = |share: usize| half_widths.get(half_widths.len() * share / 100).copied();
    let rates = found.iter().map(|(r, _)| r.samples as f64 / r.length_s);
    LineRow {
        name,
        rate_hz: rates.sum::<f64>() / runs as f64,
        half_width_s: [at(50), at(99)].map(|width_s| width_s.unwrap_or(0.0)),
        runs,
        parameters: std::array::from_fn(|j| parameter_row(j, &found)),
    }
}

/// As `identify` does it, without a first guess.
fn identify(run: &Run) -> Vec<ParameterEstimate> {
    let Ok(scenario) = Scenario::from_run(run) else {
        return Vec::new();
    };
    let data = scheme::Data {
        run,
        scenario: &scenario,
        model: &Model::baseline(Motor::new("?")),
    };
    let found = scheme::find("output-error").and_then(|scheme| scheme.identify(&data));
    let mut parameters = found.map(|found| found.parameters).unwrap_or_default();
    if let Some(half_width_s) = scenario.typical_half_width_s() {
        stamps::refuse(&mut parameters, half_width_s);
    }
    parameters
}

fn parameter_row(j: usize, found: &[(Recorded, Vec<ParameterEstimate>)]) -> ParameterRow {
    let mut row = ParameterRow::default();
    let (mut signed, mut sizes, mut stds) = (Vec::new(), Vec::new(), Vec::new());
    for (recorded, estimates) in found {
        let truth = recorded.truth[j];
        let Some(estimate) = estimates.iter().find(|e| e.key == KEYS[j].key()) else {
            continue;
        };
        let (Some(value), Some(std), Some([low, high])) =
            (estimate.value, estimate.std, estimate.interval_95())
        else {
            continue;
        };
        row.valued += 1;
        row.covered += usize::from((low..=high).contains(&truth));
        if estimate.verdict == Verdict::Settled {
            row.settled += 1;
            row.settled_wrong += usize::from((value - truth).abs() > 3.0 * std);
        }
        signed.push(100.0 * (value / truth - 1.0));
        sizes.push(100.0 * (value / truth - 1.0).abs());
        stds.push(100.0 * std / truth);
    }
    row.bias_percent = median(&signed);
    row.error_percent = median(&sizes);
    row.std_percent = median(&stds);
    row
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_host_stamps_carries_its_half_width_and_what_a_drive_stamps_carries_none() {
        let host = record(1, HOST_STAMPED, ALL_ERRORS).run;
        let widths: Vec<f64> = host.points(Channel::TimeHalfWidth).map(|p| p.1).collect();
        assert!(widths.len() > 200 && widths.iter().all(|s| (0.5e-3..5e-3).contains(s)));
        let scenario = Scenario::from_run(&host).unwrap();
        assert!(scenario.typical_half_width_s().unwrap() > 1e-3);
        let clocked = Errors {
            stamps: false,
            ..ALL_ERRORS
        };
        let drive = record(1, HOST_STAMPED, clocked).run;
        assert!(drive.column(Channel::TimeHalfWidth).is_none());
        let scenario = Scenario::from_run(&drive).unwrap();
        assert_eq!(scenario.typical_half_width_s(), None);
        assert_eq!(scenario.input_delay_s(), None);
    }
}
