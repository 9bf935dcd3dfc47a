//! Parameter error and coverage against the line of a measurement: delays, vague stamps, late and lost replies.
//!
//! ```text
//! drive (motor, line, seed) -> Run -> output-error fit -> value, interval -> error, inside or outside -> LineStudy -> pages
//!
//! a drive at the far end of a line, as a host records it:
//! cycle: |--- write exchange ---|--- read exchange ---|
//!            ^ applied              ^ sampled   stamp = middle of request out and first byte in
//! ```
//!
//! Every motor and every excitation is another; the same seed gives the same numbers.

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use serde::Serialize;

use drivebench::emulator::truth::{MotorTruth, Plant, Terminals};
use drivebench::identification::{scheme, stamps};
use drivebench::numerics::statistics::median;
use drivebench::plant::{Model, Motor, Scenario};
use drivebench::sample::{Channel, Origin, ParameterEstimate, Run, Verdict};

pub use drivebench::identification::belief::KEYS;

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
pub const HOST_STAMPED: Pace =
    Pace { rate_hz: 50.0, request_s: 0.8e-3, reply_s: 1.6e-3, drive_cycle_s: 2e-3 };

/// One line of a table: a line, or a cause that was left out.
#[derive(Clone, Debug, Serialize)]
pub struct LineRow {
    pub name: String,
    pub rate_hz: f64,
    /// Half-widths of the stamps, s: median and 99 %; zero where the drive stamps.
    pub half_width_s: [f64; 2],
    pub runs: usize,
    /// In the order of [`KEYS`].
    pub parameters: [ParameterRow; 5],
}

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

#[derive(Clone, Debug, Serialize)]
pub struct LineStudy {
    pub runs: usize,
    pub seed: u64,
    pub lines: Vec<LineRow>,
    pub causes: Vec<LineRow>,
}

pub const KINDS: usize = 25;

/// `runs` records of each kind; `report` is called with the number of kinds that are done.
pub fn line_study(runs: usize, seed: u64, report: impl Fn(usize)) -> LineStudy {
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
            let errors = Errors { late: share, lost: share, doubled: share, ..errors };
            let name = format!("{name}; {percent:.0} %");
            lines.push(row(name, pace, errors, runs, seed, StampWidths::Used));
            report(lines.len());
        }
    }
    let ignored = StampWidths::Ignored;
    let causes = [
        ("all causes, stamps believed", all, ignored),
        ("all causes", all, StampWidths::Used),
        ("no error of stamps", clocked, StampWidths::Used),
        ("no jitter, stamps believed", prompt, ignored),
        ("no quantisation, stamps believed", fine, ignored),
        ("voltage sampled only, stamps believed", sampled, ignored),
        ("voltage sampled only", sampled, StampWidths::Used),
    ];
    let mut found = LineStudy { runs, seed, lines, causes: Vec::new() };
    for (name, errors, widths) in causes {
        let row = row(name.to_owned(), HOST_STAMPED, errors, runs, seed, widths);
        found.causes.push(row);
        report(found.lines.len() + found.causes.len());
    }
    found
}

/// Whether the fit uses the half-widths of the stamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StampWidths {
    Used,
    Ignored,
}

/// One kind of record, `runs` times.
pub fn row(
    name: String,
    pace: Pace,
    errors: Errors,
    runs: usize,
    seed: u64,
    widths: StampWidths,
) -> LineRow {
    let identified = |seed| {
        let recorded = record(seed, pace, errors);
        let estimates = match widths {
            StampWidths::Used => identify(&recorded.run),
            StampWidths::Ignored => identify(&recorded.run.without(Channel::TimeHalfWidth)),
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
    let data = scheme::Data { run, scenario: &scenario, model: &Model::baseline(Motor::new("?")) };
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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VoltageKnown {
    /// The command, and the voltage at the sample.
    Commanded,
    /// Only the voltage at the sample.
    Sampled,
}

#[derive(Clone, Copy, Debug)]
pub struct Errors {
    /// The host stamps samples and commands; else the drive does.
    pub stamps: bool,
    /// The drive answers and samples when its own cycle comes; else at once.
    pub jitter: bool,
    /// Resolution of registers: 0.1 V, 0.01 A, 1 r/min.
    pub quantised: bool,
    pub voltage: VoltageKnown,
    /// Shares of replies that are late, lost and doubled.
    pub late: f64,
    pub lost: f64,
    pub doubled: f64,
}

#[derive(Clone, Copy, Debug)]
pub struct Pace {
    pub rate_hz: f64,
    /// Request and reply on the wire, s.
    pub request_s: f64,
    pub reply_s: f64,
    /// The drive's cycle, s: it samples and applies within one.
    pub drive_cycle_s: f64,
}

/// One record with its truth: R, L, Ke, J, Mc.
pub struct Recorded {
    pub run: Run,
    pub truth: [f64; 5],
    pub samples: usize,
    pub length_s: f64,
}

/// Time, half-width of the stamp, s; voltage, current, speed.
type Row = (f64, f64, [f64; 3]);

/// A motor of its own for each seed, near that of paper A, under voltage steps of its own.
pub fn record(seed: u64, pace: Pace, errors: Errors) -> Recorded {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut near = |value: f64| value * rng.random_range(-0.4..0.4_f64).exp();
    let truth = [1.1, 0.0099, 0.3538, 4.5e-3, 0.455].map(&mut near);
    let mut plant = Plant::new(motor(truth), &[]);
    let mut far = FarEnd { plant: &mut plant, now_s: 0.0, volts: 0.0 };
    let (mut rows, mut commands): (Vec<Row>, Vec<(f64, f64)>) = (Vec::new(), vec![(0.0, 0.0)]);
    // At rest before the first step.
    let (mut cycle_s, mut wanted, mut held_until_s) = (1e-3, 0.0, 1.0);
    let length_s = 7.0;
    while cycle_s < length_s {
        if cycle_s >= held_until_s {
            let size: f64 = rng.random_range(10.0..70.0);
            let forward = rng.random::<f64>() < 0.6;
            wanted = if forward { size } else { -size };
            held_until_s = cycle_s + rng.random_range(0.1..0.5);
        }
        let mut within = |span_s: f64| {
            if errors.jitter { rng.random_range(0.0..span_s) } else { 0.5 * span_s }
        };
        let applied_s = cycle_s + pace.request_s + within(pace.drive_cycle_s);
        let requested_s = applied_s + pace.reply_s + within(1e-3);
        let sampled_s = requested_s + pace.request_s + within(pace.drive_cycle_s);
        let mut first_byte_s = sampled_s + within(pace.drive_cycle_s) + 2e-4;
        far.advance_to(applied_s);
        if (far.volts - wanted).abs() > 0.0 {
            let stamp_s = if errors.stamps { cycle_s } else { applied_s };
            commands.push((stamp_s, wanted));
        }
        far.volts = wanted;
        far.advance_to(sampled_s);
        let luck: f64 = rng.random();
        let mut received = true;
        let mut free_s = first_byte_s + pace.reply_s;
        if luck < errors.late {
            // At most 60 ms late.
            first_byte_s += rng.random_range(0.2..1.0) * 0.06;
            free_s = first_byte_s + pace.reply_s;
        } else if luck < errors.late + errors.lost {
            received = false;
            // The silence after which it is given up.
            free_s = requested_s + 0.08;
        } else if luck < errors.late + errors.lost + errors.doubled {
            // What a second reply costs before the line is clean again.
            free_s += 0.005;
        }
        let mut read = |value: f64, noise: f64, step: f64| {
            let noisy = value + noise * rng.sample::<f64, _>(StandardNormal);
            if errors.quantised { (noisy / step).round() * step } else { noisy }
        };
        if received {
            let values = [
                read(far.volts, 0.0, 0.1),
                read(far.plant.current_a(), 0.01, 0.01),
                read(far.plant.speed_rad_s(), 0.03, std::f64::consts::TAU / 60.0),
            ];
            let half_width_s = 0.5 * (first_byte_s - requested_s);
            let (time_s, half_width_s) = if errors.stamps {
                (0.5 * (requested_s + first_byte_s), half_width_s)
            } else {
                (sampled_s, f64::NAN)
            };
            rows.push((time_s, half_width_s, values));
        }
        cycle_s = free_s.max(cycle_s + 1.0 / pace.rate_hz);
    }
    let samples = rows.len();
    Recorded { run: run_of(&rows, &commands, errors), truth, samples, length_s }
}

fn motor(truth: [f64; 5]) -> MotorTruth {
    MotorTruth {
        name: "own".to_owned(),
        rated_voltage_v: 110.0,
        rated_current_a: 5.7,
        rated_speed_rad_s: 293.2,
        resistance_ohm: truth[0],
        inductance_h: truth[1],
        back_emf_v_s_per_rad: truth[2],
        torque_n_m_per_a: None,
        inertia_kg_m2: truth[3],
        load_torque_n_m: truth[4],
    }
}

struct FarEnd<'a> {
    plant: &'a mut Plant,
    now_s: f64,
    volts: f64,
}

impl FarEnd<'_> {
    fn advance_to(&mut self, time_s: f64) {
        let longest_s = 1e-4_f64;
        while self.now_s < time_s {
            let step_s = longest_s.min(time_s - self.now_s);
            self.plant.advance(Terminals::Voltage(self.volts), step_s);
            // The last step ends at the instant itself, whatever the sum has lost.
            self.now_s = if step_s < longest_s { time_s } else { self.now_s + step_s };
        }
    }
}

fn run_of(rows: &[Row], commands: &[(f64, f64)], errors: Errors) -> Run {
    /// Time, command, half-width, voltage, current, speed.
    type Line = (f64, [f64; 5]);
    let missing = f64::NAN;
    let line =
        |&(time_s, half_width_s, [u, i, w]): &Row| (time_s, [missing, half_width_s, u, i, w]);
    let mut lines: Vec<Line> = rows.iter().map(line).collect();
    if errors.voltage == VoltageKnown::Commanded {
        for &(time_s, volts) in commands {
            match lines.binary_search_by(|line| line.0.total_cmp(&time_s)) {
                Ok(at) => lines[at].1[0] = volts,
                Err(at) => lines.insert(at, (time_s, [volts, missing, missing, missing, missing])),
            }
        }
    }
    let times = lines.iter().map(|line| line.0).collect();
    let mut run = Run::new("line", times).unwrap_or_default();
    let columns = [
        (Channel::VoltageCmd, Origin::Commanded),
        (Channel::TimeHalfWidth, Origin::Derived),
        (Channel::Voltage, Origin::Measured),
        (Channel::Current, Origin::Measured),
        (Channel::Speed, Origin::Measured),
    ];
    for (at, (channel, origin)) in columns.into_iter().enumerate() {
        let cells: Vec<f64> = lines.iter().map(|line| line.1[at]).collect();
        if cells.iter().any(|cell| cell.is_finite()) {
            // Columns are as long as the time axis that was made of the same lines.
            let _ = run.set_column(channel, cells, origin);
        }
    }
    run
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_of_a_host_have_a_half_width() {
        let host = record(1, HOST_STAMPED, ALL_ERRORS).run;
        let widths: Vec<f64> = host.points(Channel::TimeHalfWidth).map(|p| p.1).collect();
        assert!(widths.len() > 200 && widths.iter().all(|s| (0.5e-3..5e-3).contains(s)));
        let scenario = Scenario::from_run(&host).unwrap();
        assert!(scenario.typical_half_width_s().unwrap() > 1e-3);
        let clocked = Errors { stamps: false, ..ALL_ERRORS };
        let drive = record(1, HOST_STAMPED, clocked).run;
        assert!(drive.column(Channel::TimeHalfWidth).is_none());
        let scenario = Scenario::from_run(&drive).unwrap();
        assert_eq!(scenario.typical_half_width_s(), None);
        assert_eq!(scenario.input_delay_s(), None);
    }
}
