//! Messy records: the emulator's machine, whose forms are not the catalogue's, with a realistic background that no model
//! of the tests has, under an excitation that moves everything.
//!
//! Background at level 1 (the study's): a coloured torque of 0.75 % of the rated one (remembered for 50 ms), a little
//! drag, cogging of 7 periods, 0.4 ms of delay, 50 mohm of sag. Noise 0.15 rad/s and 30 mA, steps of 1 r/min and 10 mA.

use std::f64::consts::TAU;

use drivebench::emulator::truth::effect::{HiddenEffect, Site};
use drivebench::emulator::truth::{
    MotorTruth, NoiseConfig, Plant, QuantisationConfig, Reading, Sensors, Terminals,
};
use drivebench::plant::{Model, Motor, MotorKey, Scenario};
use drivebench::sample::{Channel, Origin, Run};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub(crate) const PERIOD_S: f64 = 0.004;
pub(crate) const DURATION_S: f64 = 10.0;
const TICK_S: f64 = 1e-4;
const REST_S: f64 = 0.4;
const SLEW_V_PER_S: f64 = 340.0;
/// What the nameplate may be off by.
const TOLERANCE: f64 = 0.1;

/// The motor of paper A as its nameplate has it.
fn nameplate_truth() -> MotorTruth {
    MotorTruth {
        name: "ZK-22FC".to_owned(),
        rated_voltage_v: 110.0,
        rated_current_a: 5.7,
        rated_speed_rad_s: 293.2,
        resistance_ohm: 1.1,
        inductance_h: 0.0085,
        back_emf_v_s_per_rad: 0.3538,
        torque_n_m_per_a: None,
        inertia_kg_m2: 0.0045,
        load_torque_n_m: 0.35,
    }
}

/// What a user starts from.
pub(crate) fn nameplate() -> Model {
    let truth = nameplate_truth();
    Model::baseline(
        Motor::new(truth.name)
            .with(MotorKey::Resistance, truth.resistance_ohm)
            .with(MotorKey::Inductance, truth.inductance_h)
            .with(MotorKey::BackEmf, truth.back_emf_v_s_per_rad)
            .with(MotorKey::Inertia, truth.inertia_kg_m2)
            .with(MotorKey::LoadTorque, truth.load_torque_n_m),
    )
}

/// One run of a specimen with `hidden` and `mess` times the study's background. `machine` draws the specimen, `run` the
/// excitation, the noise and the coloured torque.
pub(crate) fn record(
    hidden: &[HiddenEffect],
    mess: f64,
    machine: u64,
    run: u64,
    duration_s: f64,
) -> Scenario {
    let motor = nameplate_truth().specimen(TOLERANCE, machine);
    let site = Site { bus_v: motor.rated_voltage_v, motor, seed: 1000 * machine + run };
    let mut effects = hidden.to_vec();
    if mess > 0.0 {
        effects.extend(HiddenEffect::new("messy", &[("scale", mess)]));
    }
    let mut plant = Plant::on_site(site, &effects);
    plant.start();
    let path = *plant.path();
    let mut sensors = Sensors::new(
        NoiseConfig { current_a: 0.03, speed_rad_s: 0.15, ..NoiseConfig::default() },
        QuantisationConfig {
            current_a: 0.01,
            speed_rad_s: TAU / 60.0,
            ..QuantisationConfig::default()
        },
        7000 * machine + run,
    )
    .behind(path, TICK_S);
    let volts = excitation(1_000_003 * machine + run, duration_s);
    let ticks_per_row = (PERIOD_S / TICK_S).round();
    let time_s = |tick: f64| tick * TICK_S;
    let mut columns = [const { Vec::new() }; 5];
    let (mut tick, mut reads) = (0.0, 0_u64);
    for (row, command_v) in volts.iter().enumerate() {
        let end = (row + 1) as f64 * ticks_per_row;
        let now_s = row as f64 * PERIOD_S;
        let read = sensors.read(
            reads,
            Reading {
                current_a: plant.current_a(),
                speed_rad_s: plant.speed_rad_s(),
                angle_rad: plant.angle_rad(),
                ..Reading::default()
            },
        );
        reads += 1;
        for (column, value) in columns.iter_mut().zip([
            now_s,
            *command_v,
            read.current_a,
            read.speed_rad_s,
            read.angle_rad,
        ]) {
            column.push(value);
        }
        while tick < end - 0.5 {
            // The command that is in force after the delay; a delay ends within a tick at most.
            let of_s = time_s(tick) - path.command_delay_s + 1e-9;
            let held = volts
                .get((of_s.max(0.0) / PERIOD_S).floor() as usize)
                .filter(|_| of_s >= 0.0)
                .copied()
                .unwrap_or(0.0);
            plant.advance(Terminals::Voltage(held), TICK_S);
            sensors.follow(plant.current_a(), plant.speed_rad_s());
            tick += 1.0;
        }
    }
    let [times, commands, currents, speeds, angles] = columns;
    let mut run = Run::new("messy", times).unwrap();
    for (channel, origin, values) in [
        (Channel::VoltageCmd, Origin::Commanded, commands),
        (Channel::Current, Origin::Measured, currents),
        (Channel::Speed, Origin::Measured, speeds),
        (Channel::Angle, Origin::Measured, angles),
    ] {
        run.set_column(channel, values, origin).unwrap();
    }
    Scenario::from_run(&run).unwrap()
}

/// Standstill, bipolar steps with dither, a slow ramp through zero, steps of many levels, a slow sine through zero.
fn excitation(seed: u64, duration_s: f64) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rows = (duration_s / PERIOD_S).round() as usize;
    let part = |share: f64| REST_S + share * (duration_s - REST_S);
    let (first, second) = (rng.random_range(75.0..105.0), rng.random_range(55.0..105.0));
    let sign = if rng.random() { 1.0 } else { -1.0 };
    let sine_hz = rng.random_range(0.9..1.2);
    let (mut level, mut until_s) = (0.0, REST_S);
    let (mut dither, mut dither_until_s) = (0.0, 0.0);
    let mut volts = 0.0_f64;
    (0..rows)
        .map(|row| {
            let time_s = row as f64 * PERIOD_S;
            if time_s < REST_S {
                return 0.0;
            }
            let mut slew = SLEW_V_PER_S;
            let mut added = 0.0;
            let target: f64 = if time_s < part(0.32) {
                if time_s >= until_s {
                    until_s = time_s + rng.random_range(0.28..0.55);
                    level = if rng.random::<f64>() < 0.2 {
                        0.0
                    } else {
                        rng.random_range(-100.0..105.0)
                    };
                }
                if time_s >= dither_until_s {
                    dither_until_s = time_s + rng.random_range(0.02..0.05);
                    dither = if rng.random() { 5.0 } else { -5.0 };
                }
                added = dither;
                level
            } else if time_s < part(0.64) {
                let x = 4.0 * (time_s - part(0.32)) / (part(0.64) - part(0.32));
                sign * match x {
                    _ if x < 1.0 => first * x,
                    _ if x < 2.0 => first * (2.0 - x),
                    _ if x < 3.0 => -second * (x - 2.0),
                    _ => -second * (4.0 - x),
                }
            } else if time_s < part(0.85) {
                slew = 500.0;
                if time_s >= until_s {
                    until_s = time_s + 0.04 * f64::from(rng.random_range(1..5_u8));
                    level = rng.random_range(-60.0..60.0);
                }
                level
            } else {
                slew = 500.0;
                12.0 * (TAU * sine_hz * (time_s - part(0.85))).sin()
            };
            let step = slew * PERIOD_S;
            volts += (target - volts).clamp(-step, step);
            (100.0 * (volts + added).clamp(-110.0, 110.0)).round() / 100.0
        })
        .collect()
}
