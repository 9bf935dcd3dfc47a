//! Machines that have what the baseline has and nothing else, behind poor sensors.

use std::f64::consts::TAU;

use super::bench::{Chance, Coloured, Dry, Levels, Log, Run, counts, quantised};
use super::judge::{Case, Truth};

/// A motor that is nothing but the baseline: current by its exact exponential, dry friction by Karnopp (1985).
struct Plain {
    resistance_ohm: f64,
    inductance_h: f64,
    constant_v_s: f64,
    inertia_kg_m2: f64,
    dry_n_m: f64,
    current_a: f64,
    speed_rad_s: f64,
    angle_rad: f64,
}

impl Plain {
    /// At rest.
    const fn of(parameters: [f64; 5]) -> Self {
        let [resistance_ohm, inductance_h, constant_v_s, inertia_kg_m2, dry_n_m] = parameters;
        Self {
            resistance_ohm,
            inductance_h,
            constant_v_s,
            inertia_kg_m2,
            dry_n_m,
            current_a: 0.0,
            speed_rad_s: 0.0,
            angle_rad: 0.0,
        }
    }

    fn step(&mut self, voltage_v: f64, step_s: f64) {
        let driving_v = voltage_v - self.constant_v_s * self.speed_rad_s;
        let goal_a = driving_v / self.resistance_ohm;
        let fades = (-step_s * self.resistance_ohm / self.inductance_h).exp();
        let before_a = self.current_a;
        self.current_a = goal_a + (before_a - goal_a) * fades;
        let drive_n_m = self.constant_v_s * 0.5 * (before_a + self.current_a);
        let dry = Dry { level_n_m: self.dry_n_m, band_rad_s: 1e-4 };
        let direction = dry.direction(self.speed_rad_s, drive_n_m);
        let before_rad_s = self.speed_rad_s;
        let rate =
            direction.map_or(0.0, |sign| (drive_n_m - self.dry_n_m * sign) / self.inertia_kg_m2);
        self.speed_rad_s = Dry::settled(direction, before_rad_s + step_s * rate);
        self.angle_rad += 0.5 * step_s * (before_rad_s + self.speed_rad_s);
    }
}

/// Toy gear motor with a small flywheel and an encoder of 48 counts a turn; the speed is the difference of counts.
///
/// The difference is taken from the count before to the count after each row, so that it is late by nothing; one count is some
/// 13 rad/s, and its error is neither white nor normal, zero at rest and a beat at constant speed (Kavanagh and Murphy 1998).
/// The program's own drive measures a speed with normal noise.
pub(crate) const TOY: Case = Case {
    name: "coarse encoder, nothing else",
    map: "time_s=millis*0.001,voltage_v=volts,current_a=mA*0.001,speed_rad_s=counts_per_s*0.130899694",
    nameplate: None,
    truth: Truth::Nothing,
    record: toy,
};

fn toy(seed: u64, run: Run) -> Log {
    let mut own = Chance::of_specimen(seed ^ 0x707);
    let mut motor = Plain::of([
        own.near(2.6, 0.1),
        0.0012,
        own.near(0.0095, 0.1),
        own.near(9e-6, 0.2),
        own.near(1.2e-3, 0.2),
    ]);
    let mut chance = Chance::of_run(seed ^ 0x707, run);
    let (step_s, every, period_s) = (5e-5, 100_u32, 5e-3);
    let command = Levels::steps(0.5, 9.0, [0.4, 1.1], &mut chance, |chance, n| {
        let back = if n % 3 == 2 { -1.0 } else { 1.0 };
        back * quantised(chance.between(2.0, 12.0), 12.0 / 255.0)
    });
    let (mut u, mut rows, mut seen) = (0.0, Vec::new(), Vec::new());
    for n in 0..180_000_u32 {
        if n % every == 0 {
            let time_s = f64::from(n) * step_s;
            u = command.value(time_s);
            let current_ma = quantised(1e3 * motor.current_a + 8.0 * chance.normal(), 4.0);
            rows.push([1e3 * time_s, u, current_ma]);
            seen.push(counts(motor.angle_rad, 48.0));
        }
        motor.step(u, step_s);
    }
    let mut log = Log::new("millis,volts,mA,counts_per_s");
    for (row, around) in rows[1..].iter().zip(seen.windows(3)) {
        let counts_per_s = (around[2] - around[0]) / (2.0 * period_s);
        log.row(&[row[0], row[1], row[2], counts_per_s]);
    }
    log
}

/// Drive of a scooter on a stand: duty and the sagging battery are both logged, and the current sensor's noise is coloured.
///
/// ```text
/// u = duty (E - R0 duty i - v1)           C1 v1' = duty i - v1/R1
/// ```
///
/// A Thevenin cell model (Plett 2015): the supply falls at once and creeps afterwards. It is in the log, so that nothing is missing.
/// The Hall sensor's noise remembers itself for 15 ms (an autoregression), where the program's drive has white noise.
pub(crate) const SCOOTER: Case = Case {
    name: "sagging battery in the log, coloured noise",
    map: "time_s=t,voltage_v=duty*v_bat,current_a=i_motor,speed_rad_s=rpm*0.104719755",
    nameplate: None,
    truth: Truth::Nothing,
    record: scooter,
};

fn scooter(seed: u64, run: Run) -> Log {
    let mut own = Chance::of_specimen(seed ^ 0x5C00);
    let mut motor = Plain::of([
        own.near(0.25, 0.1),
        4e-4,
        own.near(0.085, 0.1),
        own.near(0.005, 0.2),
        own.near(0.25, 0.2),
    ]);
    let (open_v, series_ohm) = (own.near(25.5, 0.03), own.near(0.06, 0.2));
    let (creep_ohm, creep_s) = (own.near(0.05, 0.2), own.near(1.2, 0.2));
    let mut chance = Chance::of_run(seed ^ 0x5C00, run);
    let (step_s, every, period_s) = (5e-5, 40_u32, 2e-3);
    let command = Levels::steps(0.5, 7.5, [0.5, 1.0], &mut chance, |chance, n| match n % 3 {
        2 => -chance.between(0.15, 0.5),
        _ => chance.between(0.2, 0.95),
    })
    .along(2.5);
    let mut noise = Coloured::new(0.35, 0.015, period_s);
    let mut log = Log::new("t,duty,v_bat,i_motor,rpm");
    let (mut duty, mut creep_v) = (0.0, 0.0);
    for n in 0..150_000_u32 {
        if n % every == 0 {
            let time_s = f64::from(n) * step_s;
            duty = command.value(time_s);
            let battery_v = open_v - series_ohm * duty * motor.current_a - creep_v;
            let current_a = quantised(motor.current_a + noise.next(&mut chance), 0.05);
            let rpm = motor.speed_rad_s * 60.0 / TAU + 4.0 * chance.normal();
            let told_v = quantised(battery_v + 0.01 * chance.normal(), 0.01);
            log.row(&[time_s, duty, told_v, current_a, rpm]);
        }
        let drawn_a = duty * motor.current_a;
        let battery_v = open_v - series_ohm * drawn_a - creep_v;
        creep_v += step_s * (creep_ohm * drawn_a - creep_v) / creep_s;
        motor.step(duty * battery_v, step_s);
    }
    log
}
