//! Records of sound machines by coarse, slow and one-way sensors pass without a word; sensors that fail are named as what
//! they are.

use super::tests::{Columns, LEVELS, columns, scaled, unknown};
use super::*;
use crate::testing::record;
use drivebench_model::plant::Motor;
use drivebench_model::sample::Origin;

/// What is said of a run: what was masked, and what was found in the rest.
fn judged(mut run: Run, motor: Motor) -> (Vec<String>, Vec<Finding>) {
    let masked = mask(&mut run);
    let scenario = Scenario::from_run(&run).unwrap();
    let findings = examine(&run, &scenario, &Model::baseline(motor));
    (masked, findings)
}

fn rounded(values: &mut [f64], quantum: f64) {
    for value in values {
        *value = (*value / quantum).round() * quantum;
    }
}

/// A speed as edges of `lines` a turn counted over each period.
fn counted(columns: &mut Columns, lines: f64) {
    let step = std::f64::consts::TAU / lines;
    let period_s = columns.time_s[1] - columns.time_s[0];
    let mut before = 0.0;
    for (speed, angle) in columns.speed.iter_mut().zip(&columns.angle) {
        let count = (angle / step).floor();
        *speed = (count - before) * step / period_s;
        before = count;
    }
}

/// A signal that takes a new value every so many rows.
fn renewed(values: &mut [f64], rows: usize) {
    for row in 0..values.len() {
        values[row] = values[row - row % rows];
    }
}

fn of_levels(levels: Vec<(f64, f64)>, period_s: f64, seconds: f64) -> Columns {
    let truth = Model::baseline(Motor::zk_22fc());
    Columns::of(record(&truth, levels, period_s, seconds, 11))
}

/// Steps between the same two levels, each held until everything stands.
fn square(period_s: f64) -> Columns {
    let levels = (0..16).map(|step| {
        let volts = [0.0, 50.0, 0.0, -50.0][step % 4];
        (0.5 * step as f64, volts)
    });
    of_levels(levels.collect(), period_s, 8.0)
}

type Change = fn(&mut Columns);
type Case = (&'static str, fn() -> Columns, Change);

#[test]
fn sound_records_of_coarse_and_slow_sensors_pass_without_a_word() {
    let cases: [Case; 12] = [
        (
            "eight bits",
            || columns(0.002, 21),
            |it| {
                rounded(&mut it.current, 50.0 / 128.0);
                rounded(&mut it.speed, 200.0 / 128.0);
            },
        ),
        (
            "twelve bits",
            || columns(0.002, 22),
            |it| {
                rounded(&mut it.current, 50.0 / 2048.0);
                rounded(&mut it.speed, 200.0 / 2048.0);
            },
        ),
        (
            "48 edges a turn",
            || columns(0.002, 23),
            |it| counted(it, 48.0),
        ),
        (
            "14 edges a turn, 50 Hz",
            || columns(0.02, 24),
            |it| {
                counted(it, 14.0);
            },
        ),
        ("500 lines", || columns(0.001, 25), |it| counted(it, 500.0)),
        (
            "settled at the same levels",
            || square(0.005),
            |it| {
                rounded(&mut it.current, 0.5);
                rounded(&mut it.speed, 2.0);
            },
        ),
        (
            "settled, 20 Hz",
            || square(0.05),
            |it| {
                rounded(&mut it.current, 0.2);
                rounded(&mut it.speed, 1.0);
            },
        ),
        ("20 Hz", || columns(0.05, 26), |_| ()),
        (
            "no current",
            || columns(0.005, 27),
            |it| {
                rounded(&mut it.speed, 3.0);
                it.current.fill(f64::NAN);
            },
        ),
        (
            "one way",
            || {
                let levels = LEVELS.map(|(at_s, volts)| (at_s, volts.abs()));
                of_levels(levels.to_vec(), 0.005, 4.5)
            },
            |it| rounded(&mut it.speed, 1.0),
        ),
        (
            "a shaft that sticks for long",
            || columns(0.002, 28),
            |it| {
                for row in 700..1100 {
                    it.voltage[row] = 5.0;
                    it.current[row] = 5.0 / 1.1;
                    it.speed[row] = 0.0;
                }
            },
        ),
        (
            "a load that grows with the speed",
            || square(0.002),
            |it| {
                // Speeds near the largest fall behind what a line through the rest expects.
                for speed in &mut it.speed {
                    *speed -= 3e-4 * *speed * speed.abs();
                }
                rounded(&mut it.speed, 2.0);
            },
        ),
    ];
    for (name, record, change) in cases {
        let mut it = record();
        change(&mut it);
        let (masked, findings) = judged(it.run(), unknown());
        assert!(
            masked.is_empty() && findings.is_empty(),
            "{name}: {masked:?} {findings:#?}"
        );
    }
}

#[test]
fn cells_that_are_no_measurement_are_made_missing_and_counted() {
    fn every_41st(values: &mut [f64], code: f64) {
        values
            .iter_mut()
            .step_by(41)
            .for_each(|value| *value = code);
    }
    let cases: [(&str, Change, &[&str]); 10] = [
        (
            "nines",
            |it| every_41st(&mut it.speed, -9999.0),
            &["speed_rad_s reads exactly -9999 in 55 rows of 2250"],
        ),
        (
            "all ones",
            |it| every_41st(&mut it.current, 327.67),
            &["current_a reads exactly 327.67 in 55"],
        ),
        (
            "of 16 bits",
            |it| every_41st(&mut it.speed, 65535.0),
            &["65535"],
        ),
        (
            "near the others",
            |it| every_41st(&mut it.current, -200.0),
            &["-200"],
        ),
        (
            "in the voltage",
            |it| every_41st(&mut it.voltage, 655.35),
            &["voltage_v reads exactly 655.35"],
        ),
        (
            "zeros",
            |it| every_41st(&mut it.speed, 0.0),
            &["speed_rad_s reads exactly 0", "between values that agree"],
        ),
        (
            "once, in the first row",
            |it| it.speed[0] = 32767.0,
            &["in 1 row of 2250 (first at 0.0000 s)"],
        ),
        (
            "in one block",
            |it| it.speed[900..960].fill(-999.0),
            &["-999 in 60 rows"],
        ),
        (
            "renewed every 20 ms",
            |it| {
                renewed(&mut it.speed, 10);
                renewed(&mut it.current, 10);
            },
            &["every 0.0200 s", "sampled and held"],
        ),
        (
            "a telemetry that froze",
            |it| {
                for begin in [700, 1300, 1800] {
                    for signal in 0..3 {
                        let value = it.signal(signal)[begin];
                        it.signal(signal)[begin..begin + 200].fill(value);
                    }
                }
            },
            &[
                "voltage_v, current_a, speed_rad_s stand exactly still in 3 stretches of up to 0.398 s (first from 1.400 s on)",
                "597 rows",
            ],
        ),
    ];
    for (name, change, parts) in cases {
        let mut it = columns(0.002, 31);
        change(&mut it);
        let (masked, findings) = judged(it.run(), unknown());
        let text = masked.join(" ");
        assert!(
            parts.iter().all(|part| text.contains(part)),
            "{name}: {text}"
        );
        assert!(findings.is_empty(), "{name}: {findings:#?}");
    }
}

#[test]
fn a_telemetry_that_froze_is_a_hole_of_the_record() {
    let mut it = columns(0.002, 32);
    for signal in 0..3 {
        let value = it.signal(signal)[1300];
        it.signal(signal)[1300..1500].fill(value);
    }
    let mut run = it.run();
    assert_eq!(mask(&mut run).len(), 1);
    let scenario = Scenario::from_run(&run).unwrap();
    let lost: Vec<usize> = scenario
        .unknown_input
        .iter()
        .map(|hole| hole.lost_rows)
        .collect();
    assert_eq!(lost, [199]);
    // A motor at rest stands still with all its signals, and nothing froze.
    let mut it = columns(0.002, 32);
    let rest = 0..200;
    it.speed[rest.clone()].fill(0.0);
    it.current[rest].fill(0.0);
    assert!(mask(&mut it.run()).is_empty());
}

#[test]
fn what_a_failing_sensor_does_is_named() {
    fn wrapped(values: &mut [f64], period: f64) {
        for value in values {
            *value -= (*value / period).round() * period;
        }
    }
    let cases: [(&str, Change, Kind, &[&str]); 7] = [
        (
            "16 bits of speed",
            |it| {
                rounded(&mut it.speed, 0.004);
                wrapped(&mut it.speed, 0.004 * 65536.0 / 2.0);
            },
            Kind::Overflow,
            &["overflows to the other sign", "32768 counts", "131.0"],
        ),
        (
            "eight bits of speed",
            |it| {
                rounded(&mut it.speed, 0.9);
                wrapped(&mut it.speed, 0.9 * 256.0);
            },
            Kind::Overflow,
            &["256 counts", "230.4"],
        ),
        (
            "frozen, coarse",
            |it| {
                counted(it, 500.0);
                let value = it.speed[700];
                it.speed[700..1100].fill(value);
            },
            Kind::Frozen,
            &["speed_rad_s repeats", "its source froze"],
        ),
        (
            "frozen among its noise",
            |it| {
                let value = it.current[700];
                it.current[700..900].fill(value);
            },
            Kind::Frozen,
            &["current_a repeats"],
        ),
        (
            "cut off above",
            |it| {
                it.speed.iter_mut().for_each(|w| *w = w.min(70.0));
            },
            Kind::Clipped,
            &["stands at exactly 70.000000 in", "would go further"],
        ),
        (
            "cut off peaks",
            |it| {
                it.current.iter_mut().for_each(|i| *i = i.clamp(-9.0, 9.0));
            },
            Kind::Clipped,
            &["9.000000", "-9.000000"],
        ),
        (
            "a wild value",
            |it| it.speed[700] += 900.0,
            Kind::Outlier,
            &["no machine moves like that"],
        ),
    ];
    for (name, change, kind, parts) in cases {
        let mut it = columns(0.002, 33);
        change(&mut it);
        let (masked, findings) = judged(it.run(), unknown());
        let first = findings
            .first()
            .unwrap_or_else(|| panic!("{name}: nothing, {masked:?}"));
        assert!(first.kind == kind && first.refuses, "{name}: {findings:#?}");
        let text = format!("{} {}", first.sentence, first.help);
        assert!(
            parts.iter().all(|part| text.contains(part)),
            "{name}: {text}"
        );
    }
}

#[test]
fn a_supply_that_sags_is_no_exchanged_column() {
    // A throttle that steps, a battery that sags with the current it gives, and a propeller.
    let rows = 1200_u32;
    let (mut speed, mut it) = (0.0_f64, columns(0.01, 3));
    it.time_s = (0..rows).map(|row| 0.02 * f64::from(row)).collect();
    let mut cells = [Vec::new(), Vec::new(), Vec::new()];
    for row in 0..rows {
        let throttle = [0.0, 0.3, 0.6, 0.9, 0.5, 0.2][(row as usize / 100) % 6];
        let load = 1e-6 * speed * speed;
        let current = (12.0 * throttle - 0.01 * speed).max(0.0) / 0.2;
        speed += 0.02 * (0.01 * current - load) / 2e-5 * 0.05;
        let drawn = current * throttle;
        let wave = 0.001 * f64::from(row * 7 % 11);
        cells[0].push(24.0 - 0.05 * drawn + wave);
        cells[1].push(drawn + wave);
        cells[2].push(speed);
    }
    [it.voltage, it.current, it.speed] = cells;
    let (_, findings) = judged(it.run(), unknown());
    assert!(
        findings
            .iter()
            .all(|found| !found.refuses && found.kind != Kind::Swapped),
        "{findings:#?}"
    );
    // Declared as the supply's, the current enters no balance.
    let mut run = it.run();
    run.set_side(Channel::Current, Side::Supply);
    let (_, findings) = judged(run, unknown());
    assert!(findings.is_empty(), "{findings:#?}");
}

#[test]
fn factors_that_no_motor_has_are_named_with_the_map_that_mends_them() {
    let known = Motor::zk_22fc();
    let cases: [(&str, Change, Motor, bool, &[&str]); 7] = [
        (
            "mV",
            |it| it.voltage = scaled(&it.voltage, 1e3),
            unknown(),
            false,
            &["in mV", "voltage_v=COLUMN*0.001"],
        ),
        (
            "deg/s",
            |it| it.speed = scaled(&it.speed, 57.295_78),
            unknown(),
            false,
            &["deg/s", "*0.017453293"],
        ),
        (
            "turns",
            |it| it.speed = scaled(&it.speed, 1.0 / std::f64::consts::TAU),
            known.clone(),
            true,
            &["turns per second", "*6.283185307"],
        ),
        (
            "edges",
            |it| it.speed = scaled(&it.speed, 4.0),
            known.clone(),
            false,
            &["quadrature edges counted as lines"],
        ),
        (
            "lines",
            |it| it.speed = scaled(&it.speed, 0.25),
            known.clone(),
            false,
            &["lines counted as quadrature edges"],
        ),
        (
            "a gear",
            |it| it.speed = scaled(&it.speed, 0.05),
            known.clone(),
            false,
            &["slow side of a gear of", "speed_rad_s=COLUMN*"],
        ),
        (
            "a gear the other way",
            |it| it.speed = scaled(&it.speed, 7.0),
            known,
            false,
            &["fast side of a gear of"],
        ),
    ];
    for (name, change, motor, refuses, parts) in cases {
        let mut it = columns(0.005, 34);
        change(&mut it);
        let (_, findings) = judged(it.run(), motor);
        assert_eq!(findings.len(), 1, "{name}: {findings:#?}");
        let first = &findings[0];
        let text = format!("{} {}", first.sentence, first.help);
        assert!(
            first.refuses == refuses && parts.iter().all(|part| text.contains(part)),
            "{name}: {text}"
        );
        assert!(first.doubts.contains(&MotorKey::BackEmf), "{name}");
    }
}

#[test]
fn a_speed_and_an_angle_in_degrees_agree_and_are_doubted_by_their_size() {
    let mut it = columns(0.005, 35);
    it.speed = scaled(&it.speed, 100.0 * 180.0 / std::f64::consts::PI);
    it.angle = scaled(&it.angle, 100.0 * 180.0 / std::f64::consts::PI);
    let (_, findings) = judged(it.with_angle(), unknown());
    assert_eq!(findings.len(), 1, "{findings:#?}");
    assert!(
        findings[0].help.contains("angle_rad=COLUMN*0.017453293"),
        "{findings:#?}"
    );
    let mut run = it.with_angle();
    run.set_origin(Channel::Speed, Origin::Measured);
    assert!(judged(run, unknown()).1.is_empty());
}
