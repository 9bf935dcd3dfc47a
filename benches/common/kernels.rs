//! The hot paths: code that runs once a cycle of the loop or once a row of a record, each alone and without a clock.
//!
//! `hot_paths` times them, and `kernel` runs one of them a given number of times, for external profilers.

use std::hint::black_box;

use drivebench::bench::replay;
use drivebench::control::tuning::{Request, tune};
use drivebench::control::{
    Actuator, Addc, AddcSettings, AntiWindup, Compensated, FeedForward, Holding, LinearPlant,
    LoadObserving, LoadObservingSettings, LoopTiming, Measured, Mrac, MracScales, PaperB,
    PaperBPlant, PaperBSettings, Pi, SpeedController,
};
use drivebench::identification::online::{Online, OnlineConfig};
use drivebench::numerics::recursive_least_squares::RecursiveLeastSquares;
use drivebench::plant::{Model, Motor, MotorKey};
use drivebench::recording::{CsvRows, ReadOptions, Row, read_csv, write_run};
use drivebench::sample::{Channel, Origin, Run, Sample};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::records::run_of_12_s;
use crate::rows::{SIGNALS, layout, row};

/// Work on so many elements (cycles, samples, rows).
pub(crate) struct Kernel {
    pub(crate) elements: usize,
    pub(crate) work: Box<dyn FnMut()>,
}

impl Kernel {
    fn new(elements: usize, work: impl FnMut() + 'static) -> Self {
        Self { elements, work: Box::new(work) }
    }
}

/// Makes a kernel with its data.
type Make = fn() -> Kernel;

/// Every hot path with its id, `group/name`.
pub(crate) const ALL: [(&str, Make); 15] = [
    ("rls/guarded_2", guarded::<2>),
    ("rls/guarded_4", guarded::<4>),
    ("rls/plain_2", plain::<2>),
    ("rls/plain_4", plain::<4>),
    ("online/push", online),
    ("control/pi", || cycles(pi())),
    ("control/pi_with_feed_forward", || cycles(compensated())),
    ("control/addc", || cycles(addc())),
    ("control/mrac", || cycles(mrac())),
    ("control/paper_b", || cycles(paper_b())),
    ("control/load_observer", || cycles(load_observer())),
    ("recording/row_out", row_out),
    ("recording/run_out", run_out),
    ("recording/run_in", run_in),
    ("recording/replay", replayed),
];

// Estimation.

const ROWS: usize = 4096;

fn rows<const N: usize>() -> Vec<([f64; N], f64)> {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    (0..ROWS)
        .map(|_| {
            let psi: [f64; N] = std::array::from_fn(|_| random.random_range(-1.0..1.0));
            let value = psi.iter().sum::<f64>() + random.random_range(-0.1..0.1);
            (psi, value)
        })
        .collect()
}

/// Recursive least squares of paper A, eq. (7)-(9): the plain covariance, which winds up with regressors of one
/// direction, to compare with.
struct PlainRecursiveLeastSquares<const N: usize> {
    forgetting: f64,
    parameters: [f64; N],
    covariance: [[f64; N]; N],
}

impl<const N: usize> PlainRecursiveLeastSquares<N> {
    /// `prior`: variance of each parameter before any data, in units of the noise variance.
    fn new(start: [f64; N], prior: [f64; N], forgetting: f64) -> Self {
        Self {
            forgetting,
            parameters: start,
            covariance: std::array::from_fn(|row| {
                std::array::from_fn(|column| if row == column { prior[row] } else { 0.0 })
            }),
        }
    }

    /// Takes one row and returns the innovation.
    fn update(&mut self, regressor: &[f64; N], value: f64) -> f64 {
        // x: regressor, k: gain, P: covariance, beta: forgetting, as in eq. (7)-(9).
        let p_x: [f64; N] = std::array::from_fn(|row| dot(&self.covariance[row], regressor));
        let denominator = self.forgetting + dot(regressor, &p_x);
        let innovation = value - dot(regressor, &self.parameters);
        for (parameter, along) in self.parameters.iter_mut().zip(&p_x) {
            *parameter += along / denominator * innovation;
        }
        let x_p: [f64; N] = std::array::from_fn(|column| {
            (0..N).map(|row| regressor[row] * self.covariance[row][column]).sum()
        });
        for (line, along) in self.covariance.iter_mut().zip(&p_x) {
            for (cell, across) in line.iter_mut().zip(&x_p) {
                *cell = (*cell - along * across / denominator) / self.forgetting;
            }
        }
        innovation
    }
}

fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn guarded<const N: usize>() -> Kernel {
    let rows = rows::<N>();
    let mut estimator = RecursiveLeastSquares::new([0.0; N], [1.0; N], 1e6, 0.98);
    let work = move || {
        for (psi, value) in &rows {
            black_box(estimator.update(black_box(psi), *value));
        }
    };
    Kernel::new(ROWS, work)
}

fn plain<const N: usize>() -> Kernel {
    let rows = rows::<N>();
    let mut estimator = PlainRecursiveLeastSquares::new([0.0; N], [1e6; N], 0.98);
    let work = move || {
        for (psi, value) in &rows {
            black_box(estimator.update(black_box(psi), *value));
        }
    };
    Kernel::new(ROWS, work)
}

fn online() -> Kernel {
    let run = run_of_12_s();
    let samples: Vec<Sample> = (0..run.sample_time_s.len())
        .map(|k| {
            Sample::at(run.sample_time_s[k])
                .with(Channel::VoltageCmd, run.events[k].1)
                .with(Channel::Current, run.current_a[k])
                .with(Channel::Speed, run.speed_rad_s[k])
        })
        .collect();
    let elements = samples.len();
    let work = move || {
        let mut online = Online::new(OnlineConfig::default());
        for sample in &samples {
            online.push(black_box(sample));
        }
        black_box(online);
    };
    Kernel::new(elements, work)
}

// Controllers.

const CYCLES: usize = 4096;
const PERIOD_S: f64 = 0.01;
const TIMING: LoopTiming =
    LoopTiming { period_s: PERIOD_S, delay_s: 2.0 * PERIOD_S, filter_s: 0.0 };

/// A shaft that follows a square wave as a first-order lag, so that no signal is constant.
fn followed() -> Vec<(f64, Measured)> {
    let mut speed = 0.0;
    (0..CYCLES)
        .map(|n| {
            let reference = if (n / 200) % 2 == 0 { 60.0 } else { 120.0 };
            let current = 0.2 * (reference - speed);
            speed += 0.1 * (reference - speed);
            let now = Measured { current_a: Some(current), ..Measured::at(speed) };
            (reference, now)
        })
        .collect()
}

fn cycles(mut controller: impl SpeedController + 'static) -> Kernel {
    let samples = followed();
    let work = move || {
        for (reference, now) in &samples {
            let output = controller.step(*reference, black_box(now), PERIOD_S);
            controller.applied(black_box(output).clamp(-110.0, 110.0));
        }
    };
    Kernel::new(CYCLES, work)
}

fn model() -> Model {
    Model::baseline(Motor::zk_22fc().with(MotorKey::Inertia, 0.0228))
}

fn linear() -> LinearPlant {
    LinearPlant::voltage(&model(), 0.0).expect("the model is complete")
}

fn holding() -> Holding {
    Holding::of(&model(), Actuator::Voltage, 0.0)
}

fn pi() -> Pi {
    let tuning = tune(&linear(), &TIMING, &Request::default());
    let gains = tuning.expect("the plant is an ordinary one").gains;
    Pi::new(gains, AntiWindup::Hold, holding())
}

fn compensated() -> Compensated {
    let forward = FeedForward::new(&model(), &[], Actuator::Voltage, &TIMING, 10.0);
    let forward = forward.expect("the model is complete");
    Compensated::new(Box::new(pi()), forward)
}

fn addc() -> Addc {
    let settings = AddcSettings::new(holding(), 0.15);
    Addc::new(&model(), &linear(), &TIMING, &settings).expect("the plant is an ordinary one")
}

fn mrac() -> Mrac {
    let scales = MracScales { speed_rad_s: 120.0, current_a: 10.0 };
    Mrac::new(&linear(), &TIMING, scales, true).expect("the plant has a back-EMF")
}

fn paper_b() -> PaperB {
    let plant = PaperBPlant::new(0.001, 0.0034, 0.076, 0.926);
    PaperB::new(plant, PaperBSettings::default()).expect("our settings are stable")
}

fn load_observer() -> LoadObserving {
    let settings = LoadObservingSettings::default();
    LoadObserving::new(&model(), &linear(), &TIMING, &settings).expect("our settings are stable")
}

// Records.

const RECORDED: usize = 20_000;

/// A `samples.csv`.
pub(crate) fn text() -> String {
    let layout = layout();
    let mut text = layout.header();
    for k in 0..RECORDED {
        text.push_str(&layout.line(&row(k)));
    }
    text
}

fn row_out() -> Kernel {
    let (layout, rows): (_, Vec<Row>) = (layout(), (0..RECORDED).map(row).collect());
    let work = move || {
        for row in &rows {
            black_box(layout.line(black_box(row)));
        }
    };
    Kernel::new(RECORDED, work)
}

fn run_out() -> Kernel {
    let rows: Vec<Row> = (0..RECORDED).map(row).collect();
    let mut run = Run::new("run", rows.iter().map(|row| row.time_s).collect()).expect("rising");
    for channel in SIGNALS {
        let values = rows.iter().map(|row| row.get(channel).unwrap_or(f64::NAN));
        run.set_column(channel, values.collect(), Origin::Measured).expect("a value for each row");
    }
    let work = move || {
        black_box(write_run(black_box(&run)));
    };
    Kernel::new(RECORDED, work)
}

fn run_in() -> Kernel {
    let text = text();
    let work = move || {
        let read = read_csv(black_box(text.as_bytes()), "run", ReadOptions::default());
        black_box(read.expect("our own table"));
    };
    Kernel::new(RECORDED, work)
}

fn replayed() -> Kernel {
    let text = text();
    let work = move || {
        let text = black_box(text.as_bytes());
        let mut rows = CsvRows::new(text, "run", ReadOptions::default()).expect("our own header");
        let done = replay(|| rows.next_row(), OnlineConfig::default()).map(|done| done.result());
        black_box(done.expect("our own rows"));
    };
    Kernel::new(RECORDED, work)
}
