//! A drive at the far end of a line, as a host records it: its own motor, samples stamped by the host or by itself,
//! resolution of registers, replies that are late, lost or doubled.
//!
//! ```text
//! cycle: |--- write exchange ---|--- read exchange ---|
//!            ^ applied              ^ sampled   stamp = middle of request out and first byte in
//! ```

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::emulator::truth::{MotorTruth, Plant, Terminals};
use crate::sample::{Channel, Origin, Run};

/// Step of the truth, s.
const TRUTH_STEP_S: f64 = 1e-4;
/// Time at rest before the first step, and of the whole record, s.
const REST_S: f64 = 1.0;
const LENGTH_S: f64 = 7.0;
/// Longest delay of a late reply, and the silence after which a lost one is given up, s.
const LATE_S: f64 = 0.06;
const DEADLINE_S: f64 = 0.08;
/// What a doubled reply costs before the line is clean again, s.
const CLEAN_S: f64 = 0.005;

/// What the record has of the voltage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VoltageKnown {
    /// The command, and the voltage at the sample.
    Commanded,
    /// Only the voltage at the sample.
    Sampled,
}

/// Which errors of the record are there.
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

/// What the line takes.
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
    let mut far = FarEnd {
        plant: &mut plant,
        now_s: 0.0,
        volts: 0.0,
    };
    let (mut rows, mut commands): (Vec<Row>, Vec<(f64, f64)>) = (Vec::new(), vec![(0.0, 0.0)]);
    let (mut cycle_s, mut wanted, mut held_until_s) = (1e-3, 0.0, REST_S);
    while cycle_s < LENGTH_S {
        if cycle_s >= held_until_s {
            let size: f64 = rng.random_range(10.0..70.0);
            let forward = rng.random::<f64>() < 0.6;
            wanted = if forward { size } else { -size };
            held_until_s = cycle_s + rng.random_range(0.1..0.5);
        }
        let mut within = |span_s: f64| {
            if errors.jitter {
                rng.random_range(0.0..span_s)
            } else {
                0.5 * span_s
            }
        };
        let applied_s = cycle_s + pace.request_s + within(pace.drive_cycle_s);
        let asked_s = applied_s + pace.reply_s + within(1e-3);
        let sampled_s = asked_s + pace.request_s + within(pace.drive_cycle_s);
        let mut first_byte_s = sampled_s + within(pace.drive_cycle_s) + 2e-4;
        far.advance_to(applied_s);
        if (far.volts - wanted).abs() > 0.0 {
            let stamp_s = if errors.stamps { cycle_s } else { applied_s };
            commands.push((stamp_s, wanted));
        }
        far.volts = wanted;
        far.advance_to(sampled_s);
        let luck: f64 = rng.random();
        let mut heard = true;
        let mut free_s = first_byte_s + pace.reply_s;
        if luck < errors.late {
            first_byte_s += rng.random_range(0.2..1.0) * LATE_S;
            free_s = first_byte_s + pace.reply_s;
        } else if luck < errors.late + errors.lost {
            heard = false;
            free_s = asked_s + DEADLINE_S;
        } else if luck < errors.late + errors.lost + errors.doubled {
            free_s += CLEAN_S;
        }
        let mut read = |value: f64, noise: f64, step: f64| {
            let noisy = value + noise * rng.sample::<f64, _>(StandardNormal);
            if errors.quantised {
                (noisy / step).round() * step
            } else {
                noisy
            }
        };
        if heard {
            let values = [
                read(far.volts, 0.0, 0.1),
                read(far.plant.current_a(), 0.01, 0.01),
                read(far.plant.speed_rad_s(), 0.03, std::f64::consts::TAU / 60.0),
            ];
            let half_width_s = 0.5 * (first_byte_s - asked_s);
            let (time_s, half_width_s) = if errors.stamps {
                (0.5 * (asked_s + first_byte_s), half_width_s)
            } else {
                (sampled_s, f64::NAN)
            };
            rows.push((time_s, half_width_s, values));
        }
        cycle_s = free_s.max(cycle_s + 1.0 / pace.rate_hz);
    }
    let samples = rows.len();
    Recorded {
        run: run_of(&rows, &commands, errors),
        truth,
        samples,
        length_s: LENGTH_S,
    }
}

fn motor(truth: [f64; 5]) -> MotorTruth {
    let [
        resistance_ohm,
        inductance_h,
        back_emf_v_s_per_rad,
        inertia_kg_m2,
        load_torque_n_m,
    ] = truth;
    MotorTruth {
        name: "own".to_owned(),
        rated_voltage_v: 110.0,
        rated_current_a: 5.7,
        rated_speed_rad_s: 293.2,
        resistance_ohm,
        inductance_h,
        back_emf_v_s_per_rad,
        torque_n_m_per_a: None,
        inertia_kg_m2,
        load_torque_n_m,
    }
}

struct FarEnd<'a> {
    plant: &'a mut Plant,
    now_s: f64,
    volts: f64,
}

impl FarEnd<'_> {
    fn advance_to(&mut self, time_s: f64) {
        while self.now_s < time_s {
            let step_s = TRUTH_STEP_S.min(time_s - self.now_s);
            self.plant.advance(Terminals::Voltage(self.volts), step_s);
            // The last step ends at the instant itself, whatever the sum has lost.
            self.now_s = if step_s < TRUTH_STEP_S {
                time_s
            } else {
                self.now_s + step_s
            };
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
    for (at, (channel, origin)) in [
        (Channel::VoltageCmd, Origin::Commanded),
        (Channel::TimeHalfWidth, Origin::Derived),
        (Channel::Voltage, Origin::Measured),
        (Channel::Current, Origin::Measured),
        (Channel::Speed, Origin::Measured),
    ]
    .into_iter()
    .enumerate()
    {
        let cells: Vec<f64> = lines.iter().map(|line| line.1[at]).collect();
        if cells.iter().any(|cell| cell.is_finite()) {
            // Columns are as long as the time axis that was made of the same lines.
            let _ = run.set_column(channel, cells, origin);
        }
    }
    run
}
