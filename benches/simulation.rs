//! Free runs of 12 s at 1 kHz: the baseline, and the baseline with each effect of the catalogue.

mod common;

use common::records;
use criterion::{Criterion, criterion_group, criterion_main};
use drivebench::plant::effect::CATALOGUE;
use drivebench::plant::{Input, Model, Motor, Plant, Scenario, State, Trajectory};

fn free_run(criterion: &mut Criterion, name: &str, model: &Model, run: &Scenario) {
    let mut plant = Plant::new(model, Input::Voltage).expect("a complete model");
    let mut out = Trajectory::default();
    let mut group = criterion.benchmark_group("free_run");
    group.bench_function(name, |bencher| {
        bencher.iter(|| plant.simulate_into(run, State::default(), &mut out));
    });
    group.finish();
}

fn simulation(criterion: &mut Criterion) {
    let run = records::run_of_12_s();
    let baseline = Model::baseline(Motor::zk_22fc());
    free_run(criterion, "baseline", &baseline, &run);
    for effect in CATALOGUE {
        let id = effect.card().id;
        let mut model = baseline.with_effect(id).expect("an effect of the catalogue");
        for active in &mut model.effects {
            active.values = active.values_or_guess().into_iter().map(Some).collect();
        }
        free_run(criterion, id, &model, &run);
    }
    // Commands applied at time stamps between the samples: no two steps have the same length.
    let mut stamped = run;
    for (k, event) in stamped.events.iter_mut().enumerate().skip(1) {
        event.0 += 1e-3 * (0.1 + 0.8 * ((k as f64) * 0.618_034).fract());
    }
    free_run(criterion, "baseline_stamped_commands", &baseline, &stamped);
}

criterion_group! {
    name = benches;
    config = common::settings();
    targets = simulation
}
criterion_main!(benches);
