//! Fixed snapshots.

use std::sync::Arc;

use ratatui::Terminal;
use ratatui::backend::TestBackend;

use crate::bench::{
    Excitation, Level, Notice, Phase, Snapshot, Target, Timing, TracePoint, Trip, TripKind,
};
use crate::drive::LinkStatistics;
use crate::sample::{DriveState, ParameterEstimate, Verdict};
use crate::tui::live::model::{Event, Model};
use crate::tui::live::view::view;
use crate::workflow::{Progress, StepState, StepView};

fn estimate(
    key: &str,
    value: f64,
    std: f64,
    unit: &'static str,
    verdict: Verdict,
) -> ParameterEstimate {
    ParameterEstimate {
        key: key.to_owned(),
        value: Some(value),
        std: Some(std),
        unit,
        verdict,
        reason: None,
    }
}

/// A voltage that steps every two seconds, a first-order speed, a model that is 10 % too fast, and a gap at 6 s.
fn trace(seconds: f64) -> Vec<TracePoint> {
    let mut speed = 0.0;
    let mut voltage = 0.0;
    (0..(seconds * 100.0) as u32)
        .map(|row| {
            let time_s = f64::from(row) * 0.01;
            voltage = [0.0, 60.0, -60.0, 97.0][(row / 200) as usize % 4];
            let settled = voltage / 0.4;
            speed += (settled - speed) * 0.03;
            let gap = (6.0..6.6).contains(&time_s);
            let measured = |value: f64| if gap { f64::NAN } else { value };
            TracePoint {
                time_s,
                voltage_v: measured(voltage),
                current_a: measured((settled - speed) * 0.02 + 1.3 * voltage.signum()),
                speed_rad_s: measured(speed),
                model_speed_rad_s: speed * 1.1,
                reference_rad_s: f64::NAN,
            }
        })
        .collect()
}

fn notice(level: Level, text: &str) -> Notice {
    let text = text.to_owned();
    Notice { level, text }
}

pub(super) fn running() -> Snapshot {
    use Verdict::{Searching, Settled};
    let estimates = vec![
        estimate("resistance_ohm", 1.103_28, 0.021, "ohm", Settled),
        estimate("inductance_h", 0.009_87, 0.000_31, "H", Searching),
        estimate("back_emf_v_s_per_rad", 0.354_1, 0.000_4, "V.s/rad", Settled),
        estimate("inertia_kg_m2", 0.004_6, 0.001_9, "kg.m2", Searching),
        ParameterEstimate::not_observable(
            "load_torque_n_m",
            "N.m",
            "the shaft has not turned both ways",
        ),
    ];
    Snapshot {
        name: "zk-22fc-emulated".to_owned(),
        link: "modbus-rtu /dev/pts/7".to_owned(),
        target: Target::Sim,
        phase: Some(Phase::Running),
        drive_state: Some(DriveState::Running),
        elapsed_s: 8.4,
        total_s: 24.0,
        segment: Some("prbs".to_owned()),
        trace: Arc::new(trace(8.4)),
        estimates: Arc::new(estimates),
        excitation: Arc::new(Excitation::from([
            ("resistance_ohm", 0.98),
            ("inductance_h", 0.81),
            ("back_emf_v_s_per_rad", 1.0),
            ("inertia_kg_m2", 0.42),
            ("load_torque_n_m", 0.05),
        ])),
        link_statistics: LinkStatistics {
            sent: 845,
            ok: 841,
            timeout: 3,
            crc: 1,
            ..LinkStatistics::default()
        },
        timing: Timing {
            rate_asked_hz: 100.0,
            rate_achieved_hz: 99.6,
            lateness_p50_s: 0.000_12,
            lateness_p99_s: 0.001_9,
            lateness_max_s: 0.004,
            cycles: 845,
            missed_cycles: 3,
        },
        rows: 840,
        notices: vec![
            notice(
                Level::Info,
                "watchdog proven: output off 98 ms after silence",
            ),
            notice(Level::Warning, "voltage limited by the guard in 12 cycles"),
        ],
        ..Snapshot::default()
    }
}

pub(super) fn hardware() -> Snapshot {
    Snapshot {
        target: Target::Hardware,
        phase: Some(Phase::Safe),
        drive_state: Some(DriveState::Ready),
        trace: Arc::default(),
        estimates: Arc::default(),
        excitation: Arc::default(),
        elapsed_s: 0.0,
        segment: None,
        link: "/dev/ttyUSB0".to_owned(),
        ..running()
    }
}

pub(super) fn tripped() -> Snapshot {
    let reason = "over-current: current 11.8200 A, limit 11.4000 A";
    let mut notices = running().notices;
    notices.push(notice(Level::Error, reason));
    Snapshot {
        phase: Some(Phase::Tripped),
        drive_state: Some(DriveState::Disabled),
        trip: Some(Trip {
            kind: TripKind::OverCurrent,
            at_s: 8.4,
            value: 11.82,
            limit: 11.4,
            reason: reason.to_owned(),
        }),
        notices,
        recorder_error: Some("no space left on device".to_owned()),
        outcome: Some("tripped"),
        ..running()
    }
}

pub(super) fn done() -> Snapshot {
    Snapshot {
        phase: Some(Phase::Done),
        drive_state: Some(DriveState::Disabled),
        elapsed_s: 24.0,
        outcome: Some("done"),
        model_is_identified: true,
        ..running()
    }
}

/// Only the speed comes in, with nothing else known.
pub(super) fn missing() -> Snapshot {
    let trace = trace(3.0).into_iter().map(|point| TracePoint {
        voltage_v: f64::NAN,
        current_a: f64::NAN,
        model_speed_rad_s: f64::NAN,
        ..point
    });
    Snapshot {
        phase: Some(Phase::Running),
        trace: Arc::new(trace.collect()),
        ..Snapshot::default()
    }
}

pub(super) fn workflow(finished: bool) -> Progress {
    use StepState::{Active, Done, Failed, Waiting};
    let step = |(title, state, line): &(&str, StepState, &str)| StepView {
        title: (*title).to_owned(),
        state: *state,
        line: (*line).to_owned(),
    };
    let checked = ("check the drive", Done, "watchdog proven in 98 ms");
    let found = "quadratic_load, probability 0.99";
    let (steps, report) = if finished {
        let steps = [
            checked,
            ("excite (fit)", Done, "2,400 rows"),
            ("diagnose", Done, found),
            ("confirm", Failed, "the third run was stopped"),
        ];
        let report = [
            "verdict: quadratic_load (a fan or a pump)",
            "ladder: baseline 5.10 -> + quadratic_load 1.03 (floor 1.00)",
        ];
        (steps, report.map(str::to_owned).to_vec())
    } else {
        let steps = [
            checked,
            ("excite (fit)", Active, "8.4 of 24 s"),
            ("diagnose", Waiting, ""),
            ("confirm", Waiting, ""),
        ];
        (steps, Vec::new())
    };
    Progress {
        steps: steps.iter().map(step).collect(),
        report,
        finished,
    }
}

pub(super) fn model(snapshot: Snapshot) -> Model {
    let mut model = Model::new(None);
    model.update(Event::Snapshot(Arc::new(snapshot)));
    model
}

pub(super) fn terminal(model: &Model, width: u16, height: u16) -> Terminal<TestBackend> {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| view(model, frame)).unwrap();
    terminal
}

pub(super) fn text(model: &Model, width: u16, height: u16) -> String {
    terminal(model, width, height).backend().to_string()
}
