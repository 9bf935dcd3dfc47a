//! A frame of the screen of a run, into a terminal in memory: the cells are polled, and everything is drawn.

use std::sync::Arc;
use std::sync::mpsc::channel;

use criterion::{Criterion, criterion_group, criterion_main};
use drivebench::bench::{Phase, Snapshot, SnapshotCell, TracePoint};
use drivebench::sample::ParameterEstimate;
use drivebench::tui::{LiveScreen, LiveSources, Screen, WorkerCell};
use drivebench::workflow::RankingCell;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

/// As many as a run keeps for its scope.
const POINTS: u32 = 1200;

fn point(row: u32) -> TracePoint {
    let time_s = f64::from(row) / 60.0;
    TracePoint {
        time_s,
        voltage_v: 60.0 * time_s.sin(),
        current_a: 2.0 * (7.0 * time_s).sin(),
        speed_rad_s: 150.0 * (time_s - 0.1).sin(),
        model_speed_rad_s: 152.0 * (time_s - 0.1).sin(),
        reference_rad_s: f64::NAN,
        command_v: 60.0 * time_s.sin(),
        applied_s: time_s,
    }
}

fn frame(criterion: &mut Criterion) {
    let estimates = [("resistance_ohm", "ohm"), ("inertia_kg_m2", "kg.m2")];
    let found = estimates.map(|(key, unit)| ParameterEstimate::found(key, unit, 1.1, 0.01, None));
    let snapshot = Snapshot {
        name: "bench".to_owned(),
        phase: Some(Phase::Running),
        elapsed_s: 20.0,
        total_s: 24.0,
        trace: Arc::new((0..POINTS).map(point).collect()),
        estimates: Arc::new(found.to_vec()),
        ..Snapshot::default()
    };
    let snapshots = SnapshotCell::default();
    let mut screen = LiveScreen::new(LiveSources {
        snapshots: snapshots.reader(),
        ranking: RankingCell::default(),
        workflow: None,
        followed_by: None,
        intents: channel().0,
        worker: WorkerCell::default(),
        stop_requested: Arc::default(),
        hang_up: Arc::default(),
    });
    let mut group = criterion.benchmark_group("screen");
    for (columns, lines) in [(80, 24), (200, 50)] {
        let mut terminal = Terminal::new(TestBackend::new(columns, lines)).expect("in memory");
        group.bench_function(format!("frame_{columns}x{lines}"), |bencher| {
            bencher.iter(|| {
                snapshots.publish(snapshot.clone());
                screen.poll();
                terminal.draw(|frame| screen.draw(frame)).expect("in memory");
            });
        });
    }
    group.finish();
}

criterion_group!(benches, frame);
criterion_main!(benches);
