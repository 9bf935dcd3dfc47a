//! Records of sound machines, also by coarse, slow and one-way sensors, pass without a finding; each fault is named by its kind
//! with what mends it.

use std::f64::consts::{PI, TAU};

use super::*;
use crate::testing::{held, paper, put, record, run_of, unknown};
use drivebench_model::plant::Motor;
use drivebench_model::sample::Origin;

#[derive(Clone)]
struct Columns {
    time_s: Vec<f64>,
    voltage: Vec<f64>,
    current: Vec<f64>,
    speed: Vec<f64>,
    angle: Vec<f64>,
}

type Change = fn(&mut Columns);

fn levels() -> Vec<(f64, f64)> {
    let levels = [0.0, 20.0, -25.0, 60.0, -10.0, 35.0, -50.0, 15.0, 30.0];
    levels.into_iter().enumerate().map(|(step, volts)| (0.5 * step as f64, volts)).collect()
}

/// Levels in both directions, and the angle that the speed makes.
fn columns(period_s: f64, seed: u64) -> Columns {
    let mut columns = Columns::of(record(&paper(), levels(), period_s, 4.5, seed));
    let (mut turned, mut before) = (0.0, None);
    for w in &columns.speed {
        turned += before.map_or(0.0, |before| 0.5 * period_s * (w + before));
        before = Some(w);
        columns.angle.push(turned);
    }
    columns
}

/// Steps between the same two levels, each held until everything stands, by sensors of these quanta.
fn square(period_s: f64, current_quantum: f64, speed_quantum: f64) -> Columns {
    let levels = (0..16).map(|step| (0.5 * step as f64, [0.0, 50.0, 0.0, -50.0][step % 4]));
    let mut columns = Columns::of(record(&paper(), levels.collect(), period_s, 8.0, 11));
    columns.round(current_quantum, speed_quantum);
    columns
}

fn scale(values: &mut [f64], factor: f64) {
    for value in values {
        *value *= factor;
    }
}

fn round(values: &mut [f64], quantum: f64) {
    for value in values {
        *value = (*value / quantum).round() * quantum;
    }
}

fn every_41st(values: &mut [f64], code: f64) {
    values.iter_mut().step_by(41).for_each(|value| *value = code);
}

fn hold(values: &mut [f64], rows: std::ops::Range<usize>) {
    let first = values[rows.start];
    values[rows].fill(first);
}

impl Columns {
    fn of(scenario: Scenario) -> Self {
        Self {
            voltage: Table::new(&scenario).voltage_v,
            time_s: scenario.sample_time_s,
            current: scenario.current_a,
            speed: scenario.speed_rad_s,
            angle: Vec::new(),
        }
    }

    /// The run of the columns that are there, of which nobody has declared the origin.
    fn run(&self) -> Run {
        let signals = [
            (Channel::Voltage, &self.voltage),
            (Channel::Current, &self.current),
            (Channel::Speed, &self.speed),
        ];
        let columns = signals.map(|(channel, values)| (channel, values.clone()));
        let mut run = run_of(self.time_s.clone(), columns);
        for (channel, _) in signals {
            run.set_origin(channel, Origin::Unknown);
        }
        run
    }

    fn with_angle(&self) -> Run {
        let mut run = self.run();
        put(&mut run, Channel::Angle, self.angle.clone());
        run.set_origin(Channel::Angle, Origin::Unknown);
        run
    }

    fn signals(&mut self) -> [&mut Vec<f64>; 3] {
        [&mut self.voltage, &mut self.current, &mut self.speed]
    }

    fn round(&mut self, current_quantum: f64, speed_quantum: f64) {
        round(&mut self.current, current_quantum);
        round(&mut self.speed, speed_quantum);
    }

    /// A speed as edges of `lines` a turn counted over each period.
    fn count_edges(&mut self, lines: f64) {
        let step = TAU / lines;
        let period_s = self.time_s[1] - self.time_s[0];
        let mut before = 0.0;
        for (speed, angle) in self.speed.iter_mut().zip(&self.angle) {
            let count = (angle / step).floor();
            *speed = (count - before) * step / period_s;
            before = count;
        }
    }

    fn renew(&mut self, rows: usize) {
        for values in [&mut self.current, &mut self.speed] {
            for row in 0..values.len() {
                values[row] = values[row - row % rows];
            }
        }
    }

    /// A speed by a counter that overflows to the other sign.
    fn overflow(&mut self, quantum: f64, counts: f64) {
        round(&mut self.speed, quantum);
        let wrap =
            |value: &mut f64| *value -= (*value / (quantum * counts)).round() * quantum * counts;
        self.speed.iter_mut().for_each(wrap);
    }
}

/// What was masked, and what was found in the rest.
fn judged(mut run: Run, model: &Model) -> (Vec<Masked>, Vec<Finding>) {
    let masked = mask(&mut run);
    (masked, examine(&run, &Scenario::from_run(&run).unwrap(), model))
}

#[track_caller]
fn assert_sound(name: &str, run: Run, model: &Model) {
    let (masked, findings) = judged(run, model);
    assert!(masked.is_empty() && findings.is_empty(), "{name}: {masked:?} {findings:#?}");
}

/// Whether a text has all parts, which bars separate.
fn has_parts(text: &str, parts: &str) -> bool {
    parts.split('|').all(|part| text.contains(part))
}

/// The first finding, which has this kind and these parts in its fault, separated by bars.
#[track_caller]
fn assert_finds(run: Run, model: &Model, kind: Kind, parts: &str) -> Vec<Finding> {
    let (masked, findings) = judged(run, model);
    let Some(first) = findings.first() else {
        panic!("{parts}: nothing found, {masked:?}");
    };
    let is_it = first.kind == kind && has_parts(&format!("{:?}", first.fault), parts);
    assert!(is_it, "{parts}: {findings:#?}");
    findings
}

#[track_caller]
fn assert_refused(run: Run, model: &Model, kind: Kind, parts: &str) {
    let findings = assert_finds(run, model, kind, parts);
    assert!(findings[0].refuses, "{parts}: {findings:#?}");
}

/// One caution and nothing else.
#[track_caller]
fn assert_doubted(run: Run, model: &Model, kind: Kind, parts: &str) -> Finding {
    let mut findings = assert_finds(run, model, kind, parts);
    assert!(findings.len() == 1 && !findings[0].refuses, "{parts}: {findings:#?}");
    findings.remove(0)
}

#[test]
fn sound_records_pass_without_a_finding() {
    for (period_s, seed) in [0.001, 0.005, 0.01].iter().flat_map(|s| (0..4).map(|k| (*s, k))) {
        let columns = columns(period_s, seed);
        for run in [columns.run(), columns.with_angle()] {
            for model in [unknown(), paper()] {
                assert_sound(&format!("{period_s} {seed}"), run.clone(), &model);
            }
        }
    }
    let cases: [(&str, Change); 11] = [
        ("eight bits", |it| it.round(50.0 / 128.0, 200.0 / 128.0)),
        ("12 bits", |it| it.round(50.0 / 2048.0, 200.0 / 2048.0)),
        ("48 edges a turn", |it| it.count_edges(48.0)),
        ("500 lines", |it| it.count_edges(500.0)),
        ("14 edges a turn, 50 Hz", |it| {
            *it = columns(0.02, 24);
            it.count_edges(14.0);
        }),
        ("settled", |it| *it = square(0.005, 0.5, 2.0)),
        ("settled, 20 Hz", |it| *it = square(0.05, 0.2, 1.0)),
        ("20 Hz", |it| *it = columns(0.05, 26)),
        ("no current", |it| {
            it.current.fill(f64::NAN);
            it.round(1.0, 3.0);
        }),
        ("a shaft that sticks for long", |it| {
            it.voltage[700..1100].fill(5.0);
            it.current[700..1100].fill(5.0 / 1.1);
            it.speed[700..1100].fill(0.0);
        }),
        ("a load that grows with the speed", |it| {
            // Speeds near the largest fall behind what a line through the rest expects.
            *it = square(0.002, 1e-9, 1e-9);
            it.speed.iter_mut().for_each(|w| *w -= 3e-4 * *w * w.abs());
            it.round(1e-9, 2.0);
        }),
    ];
    for (name, change) in cases {
        let mut it = columns(0.002, 21);
        change(&mut it);
        assert_sound(name, it.run(), &unknown());
    }
    let one_way = levels().into_iter().map(|(at_s, u)| (at_s, u.abs()));
    let mut one_way = Columns::of(record(&paper(), one_way.collect(), 0.005, 4.5, 11));
    one_way.round(1e-9, 1.0);
    assert_sound("one way", one_way.run(), &unknown());
}

#[test]
fn exchanged_and_reversed_columns_are_named() {
    let none = unknown();
    for (a, b) in [(0, 1), (1, 2), (0, 2)] {
        for period_s in [0.002, 0.01] {
            let mut it = columns(period_s, 3);
            let mut signals = it.signals();
            let (first, second) = signals.split_at_mut(b);
            std::mem::swap(first[a], second[0]);
            let mut place = [0, 1, 2];
            place.swap(a, b);
            assert_refused(it.run(), &none, Kind::Swapped, &format!("Exchanged|place: {place:?}"));
        }
    }
    for signal in 0..3 {
        let mut it = columns(0.005, 5);
        scale(it.signals()[signal], -1.0);
        let reversed = format!("SignReversed|reversed: Some({signal})");
        assert_refused(it.run(), &none, Kind::Reversed, &reversed);
        let mut it = columns(0.002, 9);
        it.signals()[signal].iter_mut().for_each(|x| *x = x.abs());
        assert_refused(it.run(), &none, Kind::Unsigned, "SignLost");
    }
}

#[test]
fn units_are_named_with_their_factor() {
    const PER_MINUTE: f64 = 9.549_296_585;
    let (none, known) = (unknown(), paper());
    let changed = |change: Change| {
        let mut it = columns(0.005, 2);
        change(&mut it);
        it
    };
    let cases: [(&Model, &str, Change); 5] = [
        (&none, "Amperes", |it| scale(&mut it.current, 1e3)),
        (&none, "Armature|\"ms\"", |it| scale(&mut it.time_s, 1e3)),
        (&known, "\"mA\"|factor: 1000.0", |it| scale(&mut it.current, 1e3)),
        (&known, "\"r/min\"|factor: 9.549", |it| scale(&mut it.speed, PER_MINUTE)),
        (&known, "\"turns/s\"|factor: 0.159", |it| scale(&mut it.speed, 1.0 / TAU)),
    ];
    for (model, parts, change) in cases {
        assert_refused(changed(change).run(), model, Kind::Unit, parts);
    }
    let fast = changed(|it| scale(&mut it.speed, PER_MINUTE));
    assert_refused(fast.with_angle(), &none, Kind::Unit, "\"r/min\"|factor: 9.549|Angle");
    let mut run = fast.run();
    let torque = fast.current.iter().map(|i| 0.3538 * i).collect();
    run.set_column(Channel::Torque, torque, Origin::Estimated).unwrap();
    assert_refused(run, &none, Kind::Unit, "\"r/min\"|Torque");
    let degrees = changed(|it| scale(&mut it.speed, 180.0 / PI));
    assert_refused(degrees.with_angle(), &none, Kind::Unit, "\"deg/s\"|factor: 57.29");
    let degrees = changed(|it| scale(&mut it.angle, 180.0 / PI));
    assert_doubted(degrees.with_angle(), &none, Kind::Unit, "Angle { unit: \"degrees\"");
    // Where nothing refutes the unit, a size that hardly any motor has is doubted, and a plain factor against a model.
    let doubts = |model: &Model, kind, cases: &[(&str, Change)]| {
        for (parts, change) in cases {
            let found = assert_doubted(changed(*change).run(), model, kind, parts);
            assert!(found.doubts.contains(&MotorKey::BackEmf), "{parts}");
        }
    };
    let sizes: [(&str, Change); 3] = [
        ("by_angle: false", |it| scale(&mut it.speed, PER_MINUTE)),
        ("Fast|back_emf: Some", |it| scale(&mut it.speed, 180.0 / PI)),
        ("Volts|\"voltage_v\"", |it| scale(&mut it.voltage, 1e3)),
    ];
    doubts(&none, Kind::Magnitude, &sizes);
    let factors: [(&str, Change); 4] = [
        ("EdgesForLines", |it| scale(&mut it.speed, 4.0)),
        ("LinesForEdges", |it| scale(&mut it.speed, 0.25)),
        ("Gear|ratio: ", |it| scale(&mut it.speed, 0.05)),
        ("Gear|ratio: 0.14", |it| scale(&mut it.speed, 7.0)),
    ];
    doubts(&known, Kind::Unit, &factors);
    // Speed and angle in degrees agree with each other; an origin that is declared confirms the unit.
    let both = changed(|it| {
        scale(&mut it.speed, 100.0 * 180.0 / PI);
        scale(&mut it.angle, 100.0 * 180.0 / PI);
    });
    assert_doubted(both.with_angle(), &none, Kind::Magnitude, "Fast|by_angle: true");
    let mut run = both.with_angle();
    run.set_origin(Channel::Speed, Origin::Measured);
    assert_sound("declared", run, &none);
}

#[test]
fn signals_that_do_not_move_are_distinguished() {
    let good = columns(0.005, 7);
    let rows = good.time_s.len();
    // The noise of the leading standstill, over and over.
    let noise = |from: &[f64], level: f64| (0..rows).map(|row| level + from[row % 90]).collect();
    let of = |voltage: Option<f64>, current: Option<Vec<f64>>, speed: Option<Vec<f64>>| Columns {
        voltage: voltage.map_or_else(|| good.voltage.clone(), |volts| vec![volts; rows]),
        current: current.unwrap_or_else(|| good.current.clone()),
        speed: speed.unwrap_or_else(|| good.speed.clone()),
        ..good.clone()
    };
    let with_noise = |volts, amperes, rad_s| {
        of(Some(volts), Some(noise(&good.current, amperes)), Some(noise(&good.speed, rad_s)))
    };
    let (still, steady) = (with_noise(0.0, 0.0, 0.0), with_noise(24.0, 1.29, 63.8));
    let coasting = good.time_s.iter().map(|t| 150.0 - 30.0 * t).collect();
    let open = of(Some(0.0), Some(vec![0.0; rows]), Some(coasting));
    // No shaft and no winding stands still between jumps.
    let held = good.voltage.iter().map(|volts| 2.5 * volts).collect();
    for (it, kind, parts) in [
        (still, Kind::Standstill, "AtRest"),
        (steady, Kind::Steady, "OperatingPoint|mean: 24.0"),
        (open, Kind::OpenCircuit, "CoastDown {"),
        (of(None, None, Some(held)), Kind::Swapped, "HeldLikeACommand|speed"),
        (of(None, Some(vec![1.5; rows]), None), Kind::Frozen, "level_a: 1.5, rows: 900"),
        (of(None, None, Some(vec![0.0; rows])), Kind::Frozen, "SpeedZero"),
        (of(None, None, Some(vec![30.0; rows])), Kind::Frozen, "level_rad_s: 30.0"),
    ] {
        assert_refused(it.run(), &unknown(), kind, parts);
    }
    // A locked rotor keeps resistance and inductance.
    let locked = Model::baseline(Motor::zk_22fc().with(MotorKey::LoadTorque, 1e4));
    let locked = Columns::of(record(&locked, levels(), 0.002, 4.5, 4));
    let found = assert_doubted(locked.run(), &unknown(), Kind::Standstill, "");
    assert!(!found.doubts.contains(&MotorKey::Resistance));
}

#[test]
fn a_stretch_with_open_terminals_is_found_within_a_record() {
    let mut it = columns(0.002, 6);
    // From 2.6 s on the drive lets go: the shaft coasts, nothing flows, and 0 V was written down.
    let begin = it.speed[1300];
    for row in 1300..it.time_s.len() {
        it.voltage[row] = 0.0;
        it.current[row] = it.current[row % 200];
        it.speed[row] = begin * (1.0 - 0.4 * (it.time_s[row] - it.time_s[1300]));
    }
    assert_refused(it.run(), &unknown(), Kind::OpenCircuit, "CoastDownInside|from_s: 2.6");
    // Shorted terminals brake: zero volt at speed is a level like any other.
    let mut levels = levels();
    levels.push((4.2, 0.0));
    let shorted = Columns::of(record(&paper(), levels, 0.002, 4.6, 6));
    assert_sound("shorted", shorted.run(), &unknown());
}

#[test]
fn cells_that_are_no_measurement_are_masked_and_counted() {
    let cases: [(&str, Change); 10] = [
        ("channel: Speed, value: -9999.0, rows: 55, of: 2250", |it| {
            every_41st(&mut it.speed, -9999.0);
        }),
        ("value: 327.67", |it| every_41st(&mut it.current, 327.67)),
        ("value: 65535.0", |it| every_41st(&mut it.speed, 65535.0)),
        ("value: -200.0", |it| every_41st(&mut it.current, -200.0)),
        ("channel: Voltage, value: 655.35", |it| every_41st(&mut it.voltage, 655.35)),
        ("value: 0.0", |it| every_41st(&mut it.speed, 0.0)),
        ("rows: 1, of: 2250, first_s: 0.0", |it| it.speed[0] = 32767.0),
        ("value: -999.0, rows: 60", |it| it.speed[900..960].fill(-999.0)),
        ("SampledAndHeld|every_s: 0.0", |it| it.renew(10)),
        ("[Voltage, Current, Speed], stretches: 3, longest_s: 0.39|from_s: 1.4|rows: 597", |it| {
            for begin in [700, 1300, 1800] {
                it.signals().into_iter().for_each(|values| hold(values, begin..begin + 200));
            }
        }),
    ];
    for (parts, change) in cases {
        let mut it = columns(0.002, 31);
        change(&mut it);
        let (masked, findings) = judged(it.run(), &unknown());
        let text = format!("{masked:?}");
        assert!(has_parts(&text, parts) && findings.is_empty(), "{parts}: {text} {findings:#?}");
    }
    // A telemetry that froze is a hole of the record.
    let mut it = columns(0.002, 32);
    it.signals().into_iter().for_each(|values| hold(values, 1300..1500));
    let mut run = it.run();
    assert_eq!(mask(&mut run).len(), 1);
    let holes = Scenario::from_run(&run).unwrap().unknown_input;
    assert_eq!(holes.iter().map(|hole| hole.lost_rows).collect::<Vec<_>>(), [199]);
    // A motor at rest stands still with all its signals, and nothing froze.
    let mut it = columns(0.002, 32);
    it.speed[..200].fill(0.0);
    it.current[..200].fill(0.0);
    assert!(mask(&mut it.run()).is_empty());
}

#[test]
fn failing_sensors_are_named() {
    use Kind::{Clipped, Frozen, Outlier, Overflow};
    let cases: [(Kind, &str, Change); 9] = [
        (Overflow, "counts: Some(32768.0)|jump: 131.0", |it| it.overflow(0.004, 32768.0)),
        (Overflow, "counts: Some(256.0)|jump: 230.", |it| it.overflow(0.9, 256.0)),
        (Frozen, "Froze { key: \"speed_rad_s\"", |it| {
            it.count_edges(500.0);
            hold(&mut it.speed, 700..1100);
        }),
        (Frozen, "rows: 600, from_s: 1.4", |it| hold(&mut it.speed, 700..1300)),
        (Frozen, "Froze { key: \"current_a\"", |it| hold(&mut it.current, 700..900)),
        (Clipped, "levels: [70.0]", |it| it.speed.iter_mut().for_each(|w| *w = w.min(70.0))),
        (Clipped, "levels: [9.0, -9.0]", |it| {
            it.current.iter_mut().for_each(|i| *i = i.clamp(-9.0, 9.0));
        }),
        (Clipped, "CutOff|8.0", |it| it.current.iter_mut().for_each(|i| *i = i.clamp(-8.0, 8.0))),
        (Outlier, "Outlier", |it| it.speed[700] += 900.0),
    ];
    for (kind, parts, change) in cases {
        let mut it = columns(0.002, 33);
        change(&mut it);
        assert_refused(it.run(), &unknown(), kind, parts);
    }
}

#[test]
fn a_frozen_encoder_is_neither_open_terminals_nor_rest() {
    let events = held([0.0, 0.3, 1.0, 1.8, 2.6, 3.2], [0.0, 40.0, 70.0, -50.0, 60.0, 0.0]);
    let scenario = record(&paper(), events, 0.001, 4.0, 5);
    for (at, parts) in
        [(97.125, "Froze { key: \"speed_rad_s\", value: 97.125"), (0.0, "SpeedDead { from_s: 1.4")]
    {
        let mut it = Columns::of(scenario.clone());
        it.speed[it.time_s.partition_point(|time_s| *time_s < 1.4)..].fill(at);
        assert_refused(it.run(), &paper(), Kind::Frozen, parts);
    }
    // A shaft that sticks under a small voltage reads exactly zero too, rightly.
    let mut sticks = columns(0.001, 7);
    for (time_s, speed) in sticks.time_s.iter().zip(&mut sticks.speed) {
        if *time_s < 0.5 || speed.abs() < 1.0 {
            *speed = 0.0;
        }
    }
    assert_sound("sticks", sticks.run(), &paper());
}

#[test]
fn a_supply_that_sags_is_no_exchanged_column() {
    // A throttle that steps, a battery that sags with the current it gives, and a propeller.
    let (mut w, mut it) = (0.0_f64, columns(0.01, 3));
    it.time_s = (0..1200).map(|row| 0.02 * f64::from(row)).collect();
    it.signals().into_iter().for_each(Vec::clear);
    for row in 0..1200_usize {
        let throttle = [0.0, 0.3, 0.6, 0.9, 0.5, 0.2][(row / 100) % 6];
        let current = (12.0 * throttle - 0.01 * w).max(0.0) / 0.2;
        w += 0.02 * (0.01 * current - 1e-6 * w * w) / 2e-5 * 0.05;
        let drawn = current * throttle;
        let wave = 0.001 * (row * 7 % 11) as f64;
        it.voltage.push(24.0 - 0.05 * drawn + wave);
        it.current.push(drawn + wave);
        it.speed.push(w);
    }
    let (_, findings) = judged(it.run(), &unknown());
    let is_wrong = |found: &Finding| found.refuses || found.kind == Kind::Swapped;
    assert!(!findings.iter().any(is_wrong), "{findings:#?}");
    // Declared as the supply's, the current enters no balance.
    let mut run = it.run();
    run.set_side(Channel::Current, Side::Supply);
    let (_, findings) = judged(run, &unknown());
    assert!(findings.is_empty(), "{findings:#?}");
}

#[test]
fn a_shaft_that_a_torque_turns_round_within_a_row_is_no_counter() {
    // Slow rows: the speed goes from end to end between two of them, as the torque in the other direction shows.
    let times: Vec<f64> = (0..400).map(|row| 0.1 * f64::from(row)).collect();
    let sign = |row: usize| if (row / 40).is_multiple_of(2) { 1.0 } else { -1.0 };
    let wave = |row: usize| 0.2 * (row * 7 % 11) as f64;
    let speeds = (0..400).map(|row| sign(row) * (100.0 + wave(row))).collect();
    let run_with = |torques: Vec<f64>| {
        let mut run = Run::new("slow", times.clone()).unwrap();
        put(&mut run, Channel::Torque, torques);
        put(&mut run, Channel::Speed, Vec::clone(&speeds));
        run
    };
    let is_overflow = |torques| {
        judged(run_with(torques), &unknown()).1.iter().any(|found| found.kind == Kind::Overflow)
    };
    assert!(!is_overflow((0..400).map(|row| sign(row) * 0.2).collect()));
    assert!(is_overflow((0..400).map(|row: usize| 0.2 + 0.1 * (row / 150) as f64).collect()));
}
