//! Time of one cycle of a whole closed-loop session: guard, on-line identification, controller, record, snapshot.
//!
//! The drive is a shaft without delay and time is virtual, so that nothing else is measured.

use std::sync::atomic::AtomicBool;
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use drivebench::bench::{
    Bench, BenchFile, Design, Guard, PilotSettings, RowEstimator, RunOptions, Session,
    SnapshotCell, SpeedPilot, Target, layout, loop_timing, run,
};
use drivebench::drive::{DriveLink, Identity, LinkError, LinkName, LinkStatistics};
use drivebench::emulator::VirtualClock;
use drivebench::identification::online::OnlineConfig;
use drivebench::plant::Model;
use drivebench::recording::{Manifest, Recorder, RunFolder};
use drivebench::sample::{Applied, Channel, Command, Demand, DriveState, Sample};

const PERIOD_S: f64 = 0.01;
const SIGNALS: [Channel; 4] =
    [Channel::VoltageCmd, Channel::Voltage, Channel::Current, Channel::Speed];

/// A motor without inductance: enough for a closed loop.
struct Shaft {
    time_s: f64,
    speed_rad_s: f64,
    exchanges: u64,
}

impl DriveLink for Shaft {
    fn name(&self) -> LinkName {
        LinkName("sim:".to_owned())
    }

    fn identify(&mut self) -> Result<Identity, LinkError> {
        unreachable!("the session does not identify the drive")
    }

    fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
        self.time_s += PERIOD_S;
        self.exchanges += 1;
        let volts = command.demand.voltage_v().unwrap_or(0.0);
        let amps = (volts - 0.3538 * self.speed_rad_s) / 1.1;
        let torque = 0.3538 * amps - 0.455 * (self.speed_rad_s / 2.0).clamp(-1.0, 1.0);
        self.speed_rad_s += PERIOD_S * torque / 0.0228;
        let mut sample = Sample::at(self.time_s)
            .with(Channel::VoltageCmd, volts)
            .with(Channel::Voltage, volts)
            .with(Channel::Current, amps)
            .with(Channel::Speed, self.speed_rad_s);
        sample.seq = Some(command.seq);
        sample.state = Some(match command.demand {
            Demand::Voltage(_) => DriveState::Running,
            _ => DriveState::Disabled,
        });
        sample.applied = Some(Applied { seq: command.seq, time_s: self.time_s });
        Ok(sample)
    }

    fn stop(&mut self) -> Result<(), LinkError> {
        Ok(())
    }

    fn statistics(&self) -> LinkStatistics {
        LinkStatistics { sent: self.exchanges, ..LinkStatistics::default() }
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        None
    }
}

fn session(bench: &BenchFile) -> Session {
    let motor = bench.nameplate().expect("the embedded bench has one");
    let limits = bench.limits();
    let model = Model::baseline(motor.motor());
    let section = bench.speed.as_ref().expect("the embedded bench has one");
    let reference = bench.reference(section).expect("a test checks it");
    let actuator = drivebench::control::Actuator::Voltage;
    let regulator = Design {
        model: &model,
        fitted: &[],
        motor: &motor,
        limits: &limits,
        section,
        maps: &[],
        actuator,
        timing: loop_timing(&model, PERIOD_S, PERIOD_S),
        noise_rad_s: 0.15,
        peak_reference_rad_s: reference.peak_rad_s(),
    }
    .regulator()
    .expect("a test checks it");
    let settings = PilotSettings {
        slew_v_per_s: section.slew_v_per_s(&motor, &limits, PERIOD_S),
        silence_s: limits.link_silence_s,
        hold: 0.0,
    };
    let pilot = SpeedPilot::new(regulator, reference, settings);
    Session::new(Box::new(pilot), Guard::new(limits, &motor, Some(11.4)))
}

/// The time that `run` takes for one whole session, and its cycles.
#[expect(clippy::disallowed_methods, reason = "a benchmark measures time")]
fn once(bench: &BenchFile, folder: &RunFolder) -> (Duration, u64) {
    let manifest = Manifest::default();
    let layout = layout(&[Channel::Reference, Channel::VoltageCmd], &SIGNALS);
    let mut recorder =
        Recorder::create(folder.clone(), layout, &manifest, 100).expect("a new folder");
    let config = OnlineConfig::from_model(&Model::baseline(bench.motor.motor()));
    let mut online = RowEstimator::new(config);
    let mut link = Shaft { time_s: 0.0, speed_rad_s: 0.0, exchanges: 0 };
    let mut clock = VirtualClock::new();
    let (_sender, intents) = channel();
    let options = RunOptions {
        name: "session".to_owned(),
        target: Target::Sim,
        rate_hz: 1.0 / PERIOD_S,
        motor: bench.nameplate(),
        auto_start: true,
    };
    let session = session(bench);
    let begun = Instant::now();
    let summary = run(
        session,
        Bench {
            link: &mut link,
            clock: &mut clock,
            recorder: &mut recorder,
            estimator: Some(&mut online),
            intents: &intents,
            interrupted: &AtomicBool::new(false),
            snapshots: &SnapshotCell::default(),
        },
        &options,
    );
    let took = begun.elapsed();
    assert!(summary.speed.is_some_and(|report| report.steps.len() == 6));
    assert_eq!(recorder.finish(&manifest).error, None);
    (took, link.exchanges)
}

fn sessions(criterion: &mut Criterion) {
    let bench = BenchFile::embedded_default();
    let out = tempfile::tempdir().expect("a place for temporary files");
    let mut number = 0_u32;
    let mut next = || {
        number += 1;
        RunFolder::create(out.path(), "20260101T000000Z", &number.to_string()).expect("a new name")
    };
    let cycles = once(&bench, &next()).1;
    let mut group = criterion.benchmark_group("session");
    group.throughput(Throughput::Elements(cycles));
    group.sample_size(20);
    group.bench_function("addc", |bencher| {
        bencher.iter_custom(|times| (0..times).map(|_| once(&bench, &next()).0).sum());
    });
    group.finish();
}

criterion_group!(benches, sessions);
criterion_main!(benches);
