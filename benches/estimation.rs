//! What one sample costs on line, and one fit off line.

mod common;

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use drivebench::identification::noise::NoiseFloor;
use drivebench::identification::online::{Online, OnlineConfig};
use drivebench::identification::output_error;
use drivebench::numerics::recursive_least_squares::RecursiveLeastSquares;
use drivebench::plant::{Model, Motor};
use drivebench::sample::{Channel, Sample};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

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

/// Recursive least squares as paper A prints it, eq. (7)-(9): the plain covariance, which winds up with rows of one
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
            (0..N)
                .map(|row| regressor[row] * self.covariance[row][column])
                .sum()
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

fn guarded<const N: usize>(criterion: &mut Criterion) {
    let rows = rows::<N>();
    let mut group = criterion.benchmark_group("rls");
    group.throughput(Throughput::Elements(ROWS as u64));
    let mut estimator = RecursiveLeastSquares::new([0.0; N], [1.0; N], 1e6, 0.98);
    group.bench_function(format!("guarded_{N}"), |bencher| {
        bencher.iter(|| {
            for (psi, value) in &rows {
                black_box(estimator.update(black_box(psi), *value));
            }
        });
    });
    let mut estimator = PlainRecursiveLeastSquares::new([0.0; N], [1e6; N], 0.98);
    group.bench_function(format!("plain_{N}"), |bencher| {
        bencher.iter(|| {
            for (psi, value) in &rows {
                black_box(estimator.update(black_box(psi), *value));
            }
        });
    });
    group.finish();
}

fn online(criterion: &mut Criterion) {
    let run = common::run_of_12_s();
    let samples: Vec<Sample> = (0..run.sample_time_s.len())
        .map(|k| {
            Sample::at(run.sample_time_s[k])
                .with(Channel::VoltageCmd, run.events[k].1)
                .with(Channel::Current, run.current_a[k])
                .with(Channel::Speed, run.speed_rad_s[k])
        })
        .collect();
    let mut group = criterion.benchmark_group("online");
    group.throughput(Throughput::Elements(samples.len() as u64));
    group.sample_size(40);
    group.bench_function("push", |bencher| {
        bencher.iter(|| {
            let mut online = Online::new(OnlineConfig::default());
            for sample in &samples {
                online.push(black_box(sample));
            }
            online
        });
    });
    group.finish();
}

fn fit(criterion: &mut Criterion) {
    let run = common::run_of_12_s();
    let noise = NoiseFloor::from_standstill(&run).expect("the run begins with a standstill");
    let start =
        drivebench::identification::start::complete(&Model::baseline(Motor::new("unknown")), &run)
            .expect("a rich run gives a start");
    let mut group = criterion.benchmark_group("fit");
    group.sample_size(20);
    group.bench_function("output_error", |bencher| {
        bencher.iter(|| output_error::fit(black_box(std::slice::from_ref(&start)), &run, &noise));
    });
    group.finish();
}

criterion_group! {
    name = benches;
    config = common::settings();
    targets = guarded::<2>, guarded::<4>, online, fit
}
criterion_main!(benches);
