//! Motors with something between them and their load.

use std::f64::consts::TAU;

use super::bench::{Chance, Coloured, Dry, Levels, Log, Run, counts, quantised, rk4};
use super::judge::{Case, Truth};

/// Motor with a planetary gear of poor efficiency before a flywheel.
///
/// ```text
/// L i' = u - R i - K w
/// Jm w' = K i - Tg                          at the motor's side of the teeth
/// Jl w' = Tg - (Tc + m |Tg|) sgn(w)         behind them, at the motor's speed
/// ```
///
/// What the teeth lose is in proportion to the torque that they transmit, m |Tg|, whichever way the power flows (Pelchen,
/// Schweiger and Otter 2002). The catalogue takes the share of the whole torque of the motor instead, and knows no implicit
/// equation: Tg stands on both sides and is solved for with its sign. Semi-implicit Euler at 50 us with stick by Karnopp.
pub(crate) const PLANETARY: Case = Case {
    name: "mesh loss of a gear",
    map: "time_s=time,voltage_v=motor_voltage,current_a=motor_current,speed_rad_s=motor_speed",
    nameplate: None,
    truth: Truth::Effects { missing: &[&["load_dependent_friction"]], also: &[] },
    record: planetary,
};

fn planetary(seed: u64, run: Run) -> Log {
    let mut own = Chance::of_specimen(seed ^ 0x6EA5);
    let (r, l, k) = (own.near(1.1, 0.1), 0.0015, own.near(0.07, 0.1));
    let (motor_kg_m2, load_kg_m2) = (4e-5, own.near(5e-4, 0.2));
    let (dry_n_m, share) = (own.near(0.02, 0.2), own.near(0.25, 0.15));
    let mut chance = Chance::of_run(seed ^ 0x6EA5, run);
    let (step_s, every) = (5e-5, 80_u32);
    let command = Levels::steps(0.6, 8.0, [0.3, 0.9], &mut chance, |chance, n| {
        let back = if n % 3 == 1 { -1.0 } else { 1.0 };
        back * chance.between(4.0, 24.0)
    });
    let mut log = Log::new("time,motor_voltage,motor_current,motor_speed");
    let (mut i, mut w, mut u) = (0.0_f64, 0.0_f64, 0.0);
    for n in 0..160_000_u32 {
        if n % every == 0 {
            let time_s = f64::from(n) * step_s;
            u = command.value(time_s);
            let current_a = quantised(i + 0.03 * chance.normal(), 0.01);
            log.row(&[time_s, u, current_a, w + 0.3 * chance.normal()]);
        }
        i = (i + step_s * (u - k * w) / l) / (1.0 + step_s * r / l);
        let drive_n_m = k * i;
        let dry = Dry { level_n_m: dry_n_m / (1.0 - share), band_rad_s: 1e-3 };
        let direction = dry.direction(w, drive_n_m);
        if let Some(direction) = direction {
            // The acceleration for either sign of the transmitted torque; one of them agrees with itself.
            let of = |sign: f64| {
                let through = 1.0 - share * sign * direction;
                let rate = (drive_n_m * through - dry_n_m * direction)
                    / (motor_kg_m2 * through + load_kg_m2);
                (rate, drive_n_m - motor_kg_m2 * rate)
            };
            let (forward, backward) = (of(1.0), of(-1.0));
            let rate = if forward.1 >= 0.0 { forward.0 } else { backward.0 };
            w += step_s * rate;
        }
        w = Dry::settled(direction, w);
    }
    log
}

/// Lower arm of a robot behind a strain wave gear, its joint angle and the motor's torque at the joint in the log.
///
/// ```text
/// J q'' = T - m g l sin(q - q0) - B q' - Tc tanh(q'/v0)
/// T = PD(q reference - q), limited; q reference a sum of sines
/// ```
///
/// The excitation of Swevers et al. (1997) and the friction that robotics uses. Torque is the only input and there is no
/// speed: the owner has an encoder. The catalogue's dry friction has a jump where this one has a slope.
/// Runge-Kutta at 0.25 ms, the loop at 1 kHz, the log at 200 Hz.
pub(crate) const ARM: Case = Case {
    name: "geared arm by torque",
    map: "time_s=stamp,torque_n_m=tau,angle_rad=q",
    nameplate: None,
    truth: Truth::Effects { missing: &[&["eccentric_load"]], also: &["viscous_friction"] },
    record: arm,
};

fn arm(seed: u64, run: Run) -> Log {
    let mut own = Chance::of_specimen(seed ^ 0xA53);
    let inertia_kg_m2 = own.near(1.2, 0.2);
    let (gravity_n_m, tilt_rad) = (own.near(16.0, 0.2), own.between(-0.2, 0.2));
    let (viscous, dry_n_m) = (own.near(3.0, 0.2), own.near(4.0, 0.2));
    let mut chance = Chance::of_run(seed ^ 0xA53, run);
    let sines: Vec<[f64; 3]> = (1..=5_u8)
        .map(|n| {
            let hz = 0.1 * f64::from(n);
            [chance.near(0.5, 0.5) / f64::from(n).sqrt(), hz, chance.between(0.0, TAU)]
        })
        .collect();
    let sum = |time_s: f64| -> f64 {
        let each = sines.iter();
        each.map(|[size, hz, phase]| size * ((TAU * hz * time_s + phase).sin() - phase.sin())).sum()
    };
    let mut noise = Coloured::new(0.12, 0.004, 0.005);
    let mut log = Log::new("stamp,tau,q");
    let (mut state, mut torque_n_m) = ([tilt_rad, 0.0], 0.0);
    let step_s = 2.5e-4;
    for n in 0..40_000_u32 {
        let time_s = f64::from(n) * step_s;
        if n % 4 == 0 {
            let [q, rate] = state;
            // Eased in from rest over the first second.
            let ease = (time_s - 0.5).clamp(0.0, 1.0);
            let ease = ease * ease * (3.0 - 2.0 * ease);
            let wanted = tilt_rad + ease * sum(time_s - 0.5);
            torque_n_m = (400.0 * (wanted - q) - 40.0 * rate).clamp(-80.0, 80.0);
        }
        if n % 20 == 0 {
            let angle_rad = counts(state[0], 65_536.0) * TAU / 65_536.0;
            let told_n_m = torque_n_m + noise.next(&mut chance);
            log.row(&[time_s, told_n_m, angle_rad]);
        }
        state = rk4(state, step_s, |&[q, rate]| {
            let against = gravity_n_m * (q - tilt_rad).sin()
                + viscous * rate
                + dry_n_m * (rate / 0.01).tanh();
            [rate, (torque_n_m - against) / inertia_kg_m2]
        });
    }
    log
}

/// Winder: servo motor, long shaft, reel.
///
/// ```text
/// L i' = u - R i - K w1
/// J1 w1' = K i - k (q1 - q2) - d (w1 - w2) - T1 tanh(w1/v0)
/// J2 w2' = k (q1 - q2) + d (w1 - w2) - T2 tanh(w2/v0)
/// ```
///
/// The two-mass system of any text book of drives (Schroeder 2009, ch. 19), here with smooth dry friction on either side and a
/// stiffness and two inertias where the catalogue has a frequency and ratios. Runge-Kutta at 50 us.
pub(crate) const WINDER: Case = Case {
    name: "two masses of a winder",
    map: "time_s=t,voltage_v=u_a,current_a=i_a,speed_rad_s=n_rpm*0.104719755",
    nameplate: Some([0.6, 0.003, 0.4, 0.006, 0.4]),
    truth: Truth::Effects { missing: &[&["elastic_coupling"]], also: &[] },
    record: winder,
};

fn winder(seed: u64, run: Run) -> Log {
    let mut own = Chance::of_specimen(seed ^ 0x2EE1);
    let (r, l, k) = (own.near(0.6, 0.1), 0.003, own.near(0.4, 0.1));
    let (motor_kg_m2, reel_kg_m2) = (own.near(0.0018, 0.1), own.near(0.004, 0.2));
    let stiffness = reel_kg_m2 * (TAU * own.near(14.0, 0.15)).powi(2);
    let damping = 2.0 * 0.03 * (stiffness * reel_kg_m2).sqrt();
    let dry_n_m = [own.near(0.15, 0.2), own.near(0.25, 0.2)];
    let mut chance = Chance::of_run(seed ^ 0x2EE1, run);
    let (step_s, every) = (5e-5, 40_u32);
    let command = Levels::steps(0.5, 5.0, [0.06, 0.5], &mut chance, |chance, n| {
        let back = if n % 4 == 3 { -0.6 } else { 1.0 };
        back * chance.between(6.0, 40.0)
    });
    let mut log = Log::new("t,u_a,i_a,n_rpm");
    let (mut state, mut u) = ([0.0_f64; 4], 0.0);
    for n in 0..100_000_u32 {
        if n % every == 0 {
            let time_s = f64::from(n) * step_s;
            u = command.value(time_s);
            let rpm = state[1] * 60.0 / TAU + 1.5 * chance.normal();
            let current_a = quantised(state[0] + 0.06 * chance.normal(), 0.02);
            log.row(&[time_s, u, current_a, rpm]);
        }
        state = rk4(state, step_s, |&[i, motor, reel, twist]| {
            let shaft_n_m = stiffness * twist + damping * (motor - reel);
            let dry = |level: f64, speed: f64| level * (speed / 0.1).tanh();
            [
                (u - r * i - k * motor) / l,
                (k * i - shaft_n_m - dry(dry_n_m[0], motor)) / motor_kg_m2,
                (shaft_n_m - dry(dry_n_m[1], reel)) / reel_kg_m2,
                motor - reel,
            ]
        });
    }
    log
}
