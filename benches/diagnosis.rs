//! Time of one fit, and of whole diagnoses: 12 s at 1 kHz with a second run of
//! the same length held out.

mod common;

use std::hint::black_box;
use std::time::Duration;

use common::records;
use criterion::{Criterion, criterion_group, criterion_main};
use drivebench::diagnosis::{Evidence, diagnose};
use drivebench::identification::noise::NoiseFloor;
use drivebench::identification::{output_error, start};
use drivebench::plant::{Model, Motor};

/// Name of the case and its two runs.
fn cases() -> [(&'static str, Evidence); 2] {
    let baseline = Model::baseline(Motor::zk_22fc());
    let mut rubbing =
        baseline.with_effect("stribeck_friction").expect("an effect of the catalogue");
    for active in &mut rubbing.effects {
        active.values = vec![Some(0.1), Some(12.0)];
    }
    let evidence = |run, truth: &Model| Evidence::new(run, Some(records::record(truth, 2)), None);
    [
        ("nothing_missing", evidence(records::run_of_12_s(), &baseline)),
        ("stribeck_missing", evidence(records::record(&rubbing, 1), &rubbing)),
    ]
}

/// A nameplate with errors of some per cent.
fn nameplate() -> Model {
    let mut model = Model::baseline(Motor::zk_22fc());
    let off = [1.08, 0.93, 1.04, 0.95, 1.1];
    for (slot, factor) in model.slots().iter().zip(off) {
        if let Some(value) = model.get(slot) {
            model.set(slot, value * factor);
        }
    }
    model
}

fn diagnosed(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("diagnose");
    group.sample_size(12).measurement_time(Duration::from_secs(8));
    for (name, evidence) in cases() {
        group.bench_function(name, |bencher| {
            bencher.iter(|| diagnose(&nameplate(), black_box(evidence.clone())));
        });
    }
    group.finish();
}

fn fit(criterion: &mut Criterion) {
    let run = records::run_of_12_s();
    let noise = NoiseFloor::from_standstill(&run).expect("the run begins with a standstill");
    let start = start::complete(&Model::baseline(Motor::new("unknown")), &run)
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
    targets = fit, diagnosed
}
criterion_main!(benches);
