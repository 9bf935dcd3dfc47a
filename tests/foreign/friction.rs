//! Shafts whose friction has a memory of its own.

use super::bench::{Chance, Levels, Log, Run, quantised};
use super::judge::{Case, Truth};

/// Spindle of a small lathe on plain bearings, driven without a gear.
///
/// ```text
/// L i' = u - R i - K w                    J w' = K i - F
/// z' = w - s0 |w| z / g(w)                F = s0 z + s1 z' + s2 w
/// g(w) = Fc + (Fs - Fc) exp(-(w/ws)^2)
/// ```
///
/// The `LuGre` model: Canudas de Wit, Olsson, Astrom and Lischinsky (1995), IEEE TAC 40, 419. Friction is a state, the
/// deflection of bristles, which the catalogue has not: there is pre-sliding below a milliradian, a break-away that is lower the
/// faster the torque rises, and friction that lags behind the speed. Its steady curve is a Stribeck curve with a viscous part.
/// Semi-implicit Euler at 20 us: bristle and current each by their own exact denominator.
pub(crate) const SPINDLE: Case = Case {
    name: "LuGre spindle",
    map: "time_s=t_s,voltage_v=u,current_a=i,speed_rad_s=w",
    nameplate: None,
    truth: Truth::Effects { missing: &[&["stribeck_friction"]], also: &["viscous_friction"] },
    record: spindle,
};

fn spindle(seed: u64, run: Run) -> Log {
    let mut own = Chance::of_specimen(seed);
    let (r, l, k, j) = (own.near(0.8, 0.15), 0.002, own.near(0.15, 0.15), own.near(5e-4, 0.2));
    let [coulomb_n_m, static_n_m] = [own.near(0.06, 0.1), own.near(0.13, 0.1)];
    let stribeck_rad_s = own.near(7.0, 0.2);
    let (s0, s1, s2) = (80.0, 0.12, own.near(4e-4, 0.1));
    let mut chance = Chance::of_run(seed, run);
    let (step_s, every, length_s) = (2e-5, 200_u32, 8.0);
    // A slow swing through standstill in the first half, as one that looks for stick-slip would do it; steps in the second.
    let swing_hz = chance.between(0.6, 0.9);
    let swing_v = chance.between(2.2, 2.8);
    let steps = Levels::steps(4.0, length_s, [0.35, 0.6], &mut chance, |chance, n| {
        let back = if n % 2 == 0 { 1.0 } else { -1.0 };
        back * chance.between(2.0, 16.0)
    });
    let mut log = Log::new("t_s,u,i,w");
    let (mut i, mut w, mut z, mut u) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0);
    for n in 0..400_000_u32 {
        if n % every == 0 {
            let time_s = f64::from(n) * step_s;
            u = if time_s < 0.5 {
                0.0
            } else if time_s < 4.0 {
                swing_v * (std::f64::consts::TAU * swing_hz * (time_s - 0.5)).sin()
            } else {
                steps.value(time_s)
            };
            u = quantised(u, 0.01);
            let measured =
                [quantised(i + 0.02 * chance.normal(), 0.005), w + 0.08 * chance.normal()];
            log.row(&[time_s, u, measured[0], measured[1]]);
        }
        let g = coulomb_n_m + (static_n_m - coulomb_n_m) * (-(w / stribeck_rad_s).powi(2)).exp();
        let before = z;
        z = (z + step_s * w) / (1.0 + step_s * s0 * w.abs() / g);
        let friction_n_m = s0 * z + s1 * (z - before) / step_s + s2 * w;
        i = (i + step_s * (u - k * w) / l) / (1.0 + step_s * r / l);
        w += step_s * (k * i - friction_n_m) / j;
    }
    log
}

/// Ball screw with felt wipers behind a servo motor.
///
/// ```text
/// L i' = u - R i - K w                    J w' = K i - T
/// T' = (Tc/d) w (1 - (T/Tc) sgn(w))
/// ```
///
/// Dahl (1968), here with a reversal distance d of a good part of a radian, as rolling contacts and wipers have it
/// (Armstrong-Helouvry 1991, ch. 3): after each reversal the friction grows over an angle, and the shaft springs back when it is
/// let go. No effect of the catalogue has this hysteresis: right is that something is there that it does not know. A second mass
/// behind a spring comes near to it, being the element of Jenkins where nearly all friction and hardly any mass is behind the
/// spring (Iwan 1966). Runge-Kutta at 50 us, the bristle's torque among the states.
pub(crate) const BALL_SCREW: Case = Case {
    name: "hysteresis in a ball screw",
    map: "time_s=t_ms*0.001,voltage_v=volt,current_a=amp,speed_rad_s=rpm*0.104719755",
    nameplate: Some([1.2, 0.006, 0.3, 0.002, 0.5]),
    truth: Truth::Unknown { akin: &["elastic_coupling"] },
    record: ball_screw,
};

fn ball_screw(seed: u64, run: Run) -> Log {
    let mut own = Chance::of_specimen(seed ^ 0xBA11);
    let (r, l, k, j) = (own.near(1.2, 0.1), 0.006, own.near(0.3, 0.1), own.near(0.002, 0.2));
    let (level_n_m, distance_rad) = (own.near(0.6, 0.15), own.near(0.4, 0.2));
    let mut chance = Chance::of_run(seed ^ 0xBA11, run);
    let (step_s, every) = (5e-5, 40_u32);
    let command = Levels::steps(0.5, 7.0, [0.15, 0.4], &mut chance, |chance, n| {
        let back = if n % 2 == 0 { 1.0 } else { -1.0 };
        match n % 5 {
            4 => 0.0,
            _ => back * chance.between(2.0, 9.0),
        }
    });
    let mut log = Log::new("t_ms,volt,amp,rpm");
    let (mut state, mut u) = ([0.0_f64; 3], 0.0);
    for n in 0..140_000_u32 {
        if n % every == 0 {
            let time_s = f64::from(n) * step_s;
            u = command.value(time_s);
            let current_a = quantised(state[0] + 0.02 * chance.normal(), 0.01);
            let rpm = state[1] * 60.0 / std::f64::consts::TAU + 0.8 * chance.normal();
            log.row(&[1e3 * time_s, u, current_a, rpm]);
        }
        state = super::bench::rk4(state, step_s, |&[i, w, torque_n_m]| {
            let grows = 1.0 - torque_n_m / level_n_m * w.signum();
            [
                (u - r * i - k * w) / l,
                (k * i - torque_n_m) / j,
                level_n_m / distance_rad * w * grows,
            ]
        });
    }
    log
}
