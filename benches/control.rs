//! What one cycle of each speed controller costs.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use drivebench::control::tuning::{Request, tune};
use drivebench::control::{
    Actuator, Addc, AddcSettings, AntiWindup, Compensated, FeedForward, Holding, LinearPlant,
    LoadObserving, LoadObservingSettings, LoopTiming, Measured, Mrac, MracScales, PaperB,
    PaperBPlant, PaperBSettings, Pi, SpeedController,
};
use drivebench::plant::{Model, Motor, MotorKey};

const CYCLES: usize = 4096;
const PERIOD_S: f64 = 0.01;

/// A shaft that follows a square wave as a lag, so that no controller sees a dead signal.
fn samples() -> Vec<(f64, Measured)> {
    let mut speed = 0.0;
    (0..CYCLES)
        .map(|n| {
            let reference = if (n / 200) % 2 == 0 { 60.0 } else { 120.0 };
            let current = 0.2 * (reference - speed);
            speed += 0.1 * (reference - speed);
            let now = Measured {
                current_a: Some(current),
                ..Measured::at(speed)
            };
            (reference, now)
        })
        .collect()
}

fn cycle(criterion: &mut Criterion, name: &str, mut controller: impl SpeedController) {
    let samples = samples();
    let mut group = criterion.benchmark_group("control");
    group.throughput(Throughput::Elements(CYCLES as u64));
    group.bench_function(name, |bencher| {
        bencher.iter(|| {
            for (reference, now) in &samples {
                let output = controller.step(*reference, black_box(now), PERIOD_S);
                controller.applied(black_box(output).clamp(-110.0, 110.0));
            }
        });
    });
    group.finish();
}

fn controllers(criterion: &mut Criterion) {
    let model = Model::baseline(Motor::zk_22fc().with(MotorKey::Inertia, 0.0228));
    let plant = LinearPlant::voltage(&model, 0.0).expect("the model is complete");
    let timing = LoopTiming {
        period_s: PERIOD_S,
        delay_s: 2.0 * PERIOD_S,
        filter_s: 0.0,
    };
    let holding = Holding::of(&model, Actuator::Voltage, 0.0);
    let tuning = tune(&plant, &timing, &Request::default()).expect("the plant is an ordinary one");
    let pi = || Pi::new(tuning.gains, AntiWindup::Hold, holding);
    cycle(criterion, "pi", pi());
    let forward = FeedForward::new(&model, Actuator::Voltage).expect("the model is complete");
    let compensated = Compensated::new(Box::new(pi()), forward);
    cycle(criterion, "pi_with_feed_forward", compensated);
    let settings = AddcSettings::new(holding, 0.15);
    let addc = Addc::new(&model, &plant, &timing, &settings).expect("the plant is an ordinary one");
    cycle(criterion, "addc", addc);
    let scales = MracScales {
        speed_rad_s: 120.0,
        current_a: 10.0,
    };
    let mrac = Mrac::new(&plant, &timing, scales, true).expect("the plant has a back-EMF");
    cycle(criterion, "mrac", mrac);
    let paper = PaperBPlant::new(0.001, 0.0034, 0.076, 0.926);
    let paper = PaperB::new(paper, PaperBSettings::default()).expect("our settings are stable");
    cycle(criterion, "paper_b", paper);
    let settings = LoadObservingSettings::default();
    let observer = LoadObserving::new(&model, &plant, &timing, &settings);
    let observer = observer.expect("our settings are stable");
    cycle(criterion, "load_observer", observer);
}

criterion_group!(benches, controllers);
criterion_main!(benches);
