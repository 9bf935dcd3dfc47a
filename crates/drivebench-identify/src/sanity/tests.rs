//! Good records pass without a word; each kind of bad one is named.

use super::*;
use crate::testing::{put, record, run_of};
use drivebench_model::plant::Motor;
use drivebench_model::sample::{Channel, Origin};

pub(super) const LEVELS: [(f64, f64); 9] = [
    (0.0, 0.0),
    (0.5, 20.0),
    (1.0, -25.0),
    (1.5, 60.0),
    (2.0, -10.0),
    (2.5, 35.0),
    (3.0, -50.0),
    (3.5, 15.0),
    (4.0, 30.0),
];

/// Columns of a bench record: voltage, current, speed, angle.
pub(super) struct Columns {
    pub(super) time_s: Vec<f64>,
    pub(super) voltage: Vec<f64>,
    pub(super) current: Vec<f64>,
    pub(super) speed: Vec<f64>,
    pub(super) angle: Vec<f64>,
}

pub(super) fn columns(period_s: f64, seed: u64) -> Columns {
    let model = Model::baseline(Motor::zk_22fc());
    let mut columns = Columns::of(record(&model, LEVELS.to_vec(), period_s, 4.5, seed));
    let (mut turned, mut before) = (0.0, None);
    for w in &columns.speed {
        turned += before.map_or(0.0, |before| 0.5 * period_s * (w + before));
        before = Some(w);
        columns.angle.push(turned);
    }
    columns
}

impl Columns {
    /// Those of a scenario, without an angle.
    pub(super) fn of(scenario: Scenario) -> Self {
        Self {
            voltage: Table::new(&scenario).voltage_v,
            time_s: scenario.sample_time_s,
            current: scenario.current_a,
            speed: scenario.speed_rad_s,
            angle: Vec::new(),
        }
    }

    pub(super) fn run(&self) -> Run {
        let columns = [
            (Channel::Voltage, self.voltage.clone()),
            (Channel::Current, self.current.clone()),
            (Channel::Speed, self.speed.clone()),
        ];
        let mut run = run_of(self.time_s.clone(), columns);
        for channel in [Channel::Voltage, Channel::Current, Channel::Speed] {
            run.set_origin(channel, Origin::Unknown);
        }
        run
    }

    pub(super) fn with_angle(&self) -> Run {
        let mut run = self.run();
        put(&mut run, Channel::Angle, self.angle.clone());
        run.set_origin(Channel::Angle, Origin::Unknown);
        run
    }

    /// Voltage, current, speed.
    pub(super) fn signal(&mut self, index: usize) -> &mut Vec<f64> {
        [&mut self.voltage, &mut self.current, &mut self.speed]
            .into_iter()
            .nth(index)
            .unwrap()
    }
}

pub(super) fn scaled(values: &[f64], factor: f64) -> Vec<f64> {
    values.iter().map(|value| value * factor).collect()
}

fn examined(run: &Run, motor: Motor) -> Vec<Finding> {
    let scenario = Scenario::from_run(run).unwrap();
    examine(run, &scenario, &Model::baseline(motor))
}

#[track_caller]
fn refused(run: &Run, motor: Motor, kind: Kind, parts: &[&str]) {
    let findings = examined(run, motor);
    let first = findings.first().expect("a finding");
    assert!(first.refuses && first.kind == kind, "{findings:#?}");
    let text = format!("{} {}", first.sentence, first.help);
    for part in parts {
        assert!(text.contains(part), "{part:?} not in {text}");
    }
}

pub(super) fn unknown() -> Motor {
    Motor::new("?")
}

#[test]
fn a_good_record_passes_without_a_word() {
    for period_s in [0.001, 0.005, 0.01] {
        for seed in 0..4 {
            let columns = columns(period_s, seed);
            for run in [columns.run(), columns.with_angle()] {
                for motor in [unknown(), Motor::zk_22fc()] {
                    let findings = examined(&run, motor);
                    assert!(findings.is_empty(), "{period_s} {seed}: {findings:#?}");
                }
            }
        }
    }
}

#[test]
fn signals_in_each_others_columns_are_named_whatever_the_pair() {
    for (a, b, names) in [
        (0, 1, "voltage and current are swapped"),
        (1, 2, "current and speed are swapped"),
        (0, 2, "voltage and speed are swapped"),
    ] {
        for period_s in [0.002, 0.01] {
            let mut bad = columns(period_s, 3);
            let first = std::mem::take(bad.signal(a));
            let second = std::mem::replace(bad.signal(b), first);
            *bad.signal(a) = second;
            refused(&bad.run(), unknown(), Kind::Swapped, &[names, "--map"]);
        }
    }
}

#[test]
fn a_reversed_sign_is_named_for_each_signal() {
    for (signal, name) in ["voltage", "current", "speed"].into_iter().enumerate() {
        let mut bad = columns(0.005, 5);
        *bad.signal(signal) = scaled(bad.signal(signal), -1.0);
        let says = format!("the sign of the {name} is reversed");
        refused(&bad.run(), unknown(), Kind::Reversed, &[&says, "*-1"]);
    }
}

#[test]
fn revolutions_per_minute_show_against_the_angle_and_the_nameplate() {
    let mut bad = columns(0.005, 1);
    bad.speed = scaled(&bad.speed, 9.549_296_585);
    let parts = ["r/min", "9.5493", "speed_rad_s=COLUMN*0.1047197"];
    refused(&bad.with_angle(), unknown(), Kind::Unit, &parts);
    refused(&bad.run(), Motor::zk_22fc(), Kind::Unit, &parts);
    // With nothing to compare with, the size is all there is, and it says so.
    let mut fast = columns(0.005, 1);
    fast.speed = scaled(&fast.speed, 9.549_296_585);
    let findings = examined(&fast.run(), unknown());
    assert_eq!(findings.len(), 1, "{findings:#?}");
    assert!(!findings[0].refuses && findings[0].sentence.contains("9.5493"));
    assert!(findings[0].doubts.contains(&MotorKey::BackEmf));
}

#[test]
fn other_units_are_named_with_their_factor() {
    let good = || columns(0.005, 2);
    let mut bad = good();
    bad.current = scaled(&bad.current, 1e3);
    let parts = ["mA", "1000", "*0.001"];
    refused(&bad.run(), Motor::zk_22fc(), Kind::Unit, &parts);
    refused(&bad.run(), unknown(), Kind::Unit, &["mA", "*0.001"]);
    let mut bad = good();
    bad.time_s = scaled(&bad.time_s, 1e3);
    let parts = ["ms", "time_s=COLUMN*0.001"];
    refused(&bad.run(), unknown(), Kind::Unit, &parts);
    let mut bad = good();
    bad.speed = scaled(&bad.speed, 180.0 / std::f64::consts::PI);
    let parts = ["deg/s", "57.29"];
    refused(&bad.with_angle(), unknown(), Kind::Unit, &parts);
    let mut odd = good();
    odd.angle = scaled(&odd.angle, 180.0 / std::f64::consts::PI);
    let findings = examined(&odd.with_angle(), unknown());
    assert!(findings.len() == 1 && !findings[0].refuses, "{findings:#?}");
    assert!(findings[0].sentence.contains("degrees"));
}

#[test]
fn torque_over_current_shows_the_unit_of_the_speed() {
    let mut bad = columns(0.005, 2);
    bad.speed = scaled(&bad.speed, 9.549_296_585);
    let mut run = bad.run();
    let torque = scaled(&bad.current, 0.3538);
    run.set_column(Channel::Torque, torque, Origin::Estimated)
        .unwrap();
    refused(&run, unknown(), Kind::Unit, &["r/min", "N.m/A"]);
}

#[test]
fn what_does_not_move_is_told_apart() {
    let good = columns(0.005, 7);
    let rows = good.time_s.len();
    let noise = |from: &[f64], level: f64| -> Vec<f64> {
        // The noise of the leading standstill, over and over.
        (0..rows).map(|row| level + from[row % 90]).collect()
    };
    let still = Columns {
        time_s: good.time_s.clone(),
        voltage: vec![0.0; rows],
        current: noise(&good.current, 0.0),
        speed: noise(&good.speed, 0.0),
        angle: vec![0.0; rows],
    };
    refused(&still.run(), unknown(), Kind::Standstill, &["stands still"]);
    let steady = Columns {
        voltage: vec![24.0; rows],
        current: noise(&good.current, 1.29),
        speed: noise(&good.speed, 63.8),
        ..still
    };
    let parts = ["24", "operating point"];
    refused(&steady.run(), unknown(), Kind::Steady, &parts);
    let dead = Columns {
        current: vec![1.5; rows],
        voltage: good.voltage.clone(),
        speed: good.speed.clone(),
        ..steady
    };
    let parts = ["1.5 A in all 900 rows"];
    refused(&dead.run(), unknown(), Kind::Frozen, &parts);
    let blind = Columns {
        current: good.current.clone(),
        speed: vec![0.0; rows],
        ..dead
    };
    let parts = ["speed is not measured"];
    refused(&blind.run(), unknown(), Kind::Frozen, &parts);
    let stuck = Columns {
        speed: vec![30.0; rows],
        ..blind
    };
    refused(&stuck.run(), unknown(), Kind::Frozen, &["30 rad/s"]);
}

#[test]
fn a_locked_rotor_keeps_resistance_and_inductance() {
    let motor = Motor::zk_22fc().with(MotorKey::LoadTorque, 1e4);
    let scenario = record(&Model::baseline(motor), LEVELS.to_vec(), 0.002, 4.5, 4);
    let findings = examined(&Columns::of(scenario).run(), unknown());
    assert_eq!(findings.len(), 1, "{findings:#?}");
    assert!(!findings[0].refuses && findings[0].kind == Kind::Standstill);
    assert!(!findings[0].doubts.contains(&MotorKey::Resistance));
}

#[test]
fn a_signal_that_contradicts_itself_is_named() {
    let good = || columns(0.002, 9);
    let mut bad = good();
    bad.current.iter_mut().for_each(|i| *i = i.clamp(-8.0, 8.0));
    let parts = ["8.000000", "cut off"];
    refused(&bad.run(), unknown(), Kind::Clipped, &parts);
    let mut bad = good();
    let held = bad.speed[700];
    bad.speed[700..1300].fill(held);
    let parts = ["for 600 rows", "1.400"];
    refused(&bad.run(), unknown(), Kind::Frozen, &parts);
    for signal in 0..3 {
        let mut bad = good();
        bad.signal(signal).iter_mut().for_each(|x| *x = x.abs());
        refused(&bad.run(), unknown(), Kind::Unsigned, &["lost its sign"]);
    }
}

#[test]
fn a_coast_down_with_open_terminals_is_no_shorted_one() {
    let rows = 600_u32;
    let times: Vec<f64> = (0..rows).map(|row| f64::from(row) * 0.005).collect();
    let open = Columns {
        voltage: vec![0.0; 600],
        current: vec![0.0; 600],
        speed: times.iter().map(|t| 100.0 - 30.0 * t).collect(),
        angle: Vec::new(),
        time_s: times,
    };
    let parts = ["terminals are open"];
    refused(&open.run(), unknown(), Kind::OpenCircuit, &parts);
}

#[test]
fn a_stretch_with_open_terminals_is_seen_within_a_record() {
    let mut bad = columns(0.002, 6);
    // From 2.6 s on the drive lets go: the shaft coasts, nothing flows, and 0 V was written down.
    let from = 1300;
    let begin = bad.speed[from];
    for row in from..bad.time_s.len() {
        let time_s = bad.time_s[row] - bad.time_s[from];
        bad.voltage[row] = 0.0;
        bad.current[row] = bad.current[row % 200];
        bad.speed[row] = begin * (1.0 - 0.4 * time_s);
    }
    let parts = ["terminals are open", "2.600 s"];
    refused(&bad.run(), unknown(), Kind::OpenCircuit, &parts);
    // A shorted one brakes, and that is a record like any other: the levels hold zero volt at speed.
    let mut levels = LEVELS.to_vec();
    levels.push((4.2, 0.0));
    let scenario = record(&Model::baseline(Motor::zk_22fc()), levels, 0.002, 4.6, 6);
    assert!(examined(&Columns::of(scenario).run(), unknown()).is_empty());
}

#[test]
fn a_frozen_encoder_is_named_and_neither_open_terminals_nor_rest() {
    let events = [
        (0.0, 0.0),
        (0.3, 40.0),
        (1.0, 70.0),
        (1.8, -50.0),
        (2.6, 60.0),
        (3.2, 0.0),
    ];
    let truth = Model::baseline(Motor::zk_22fc());
    let scenario = record(&truth, events.to_vec(), 0.001, 4.0, 5);
    let frozen = |at: f64| {
        let mut columns = Columns::of(scenario.clone());
        let row = columns.time_s.partition_point(|time_s| *time_s < 1.4);
        columns.speed[row..].fill(at);
        columns
    };
    let (whole, dead) = (frozen(97.125).run(), frozen(0.0).run());
    let parts = ["speed_rad_s repeats 97.125"];
    refused(&whole, Motor::zk_22fc(), Kind::Frozen, &parts);
    let parts = ["exactly 0 from 1.4", "its sensor is dead"];
    refused(&dead, Motor::zk_22fc(), Kind::Frozen, &parts);
    // A shaft that sticks under a small voltage reads exactly zero too, rightly.
    let mut sticks = columns(0.001, 7);
    for (row, speed) in sticks.speed.iter_mut().enumerate() {
        if sticks.time_s[row] < 0.5 || speed.abs() < 1.0 {
            *speed = 0.0;
        }
    }
    assert!(examined(&sticks.run(), Motor::zk_22fc()).is_empty());
}

#[test]
fn a_held_signal_is_no_measurement() {
    let mut bad = columns(0.005, 8);
    bad.speed = scaled(&bad.voltage, 2.5);
    let findings = examined(&bad.run(), unknown());
    assert!(findings[0].refuses, "{findings:#?}");
    assert!(findings[0].sentence.contains("speed"), "{findings:#?}");
}
