//! Machines whose voltage or resistance is not what the log says.

use std::f64::consts::{FRAC_PI_3, TAU};

use super::bench::{Chance, Dry, Levels, Log, Run, quantised, rk4};
use super::judge::{Case, Truth};

/// Servo motor of 5 kW under field-oriented control; the drive's trace has voltage, current and speed of the q axis.
///
/// ```text
/// Ld id' = ud - R id + we Lq iq           we = p w
/// Lq iq' = uq - R iq - we (Ld id + psi)
/// J w' = 1.5 p (psi + (Ld - Lq) id) iq - Tc sgn(w)
/// each phase: u = command - Vd sat(i/ith), Vd = dead time x switching frequency x bus voltage
/// ```
///
/// Dead time of an inverter: Jeong and Park (1991), IEEE TIE 38, 108. Three phases that change their sign one after the other
/// make a drop along q that is nearly constant, with a ripple of six times the electrical frequency; none of that is the
/// catalogue's equation, whose torque constant is not 1.5 times the other either. Current controllers at 2 kHz, a speed loop with a
/// limited current over them, decoupling as usual. Runge-Kutta at 25 us.
pub(crate) const SERVO: Case = Case {
    name: "dq servo with dead time",
    map: "time_s=t_ms*0.001,voltage_v=uq_ref,current_a=iq,speed_rad_s=n_act*0.104719755",
    nameplate: None,
    truth: Truth::Effects { missing: &[&["voltage_drop"]], also: &[] },
    record: servo,
};

struct Windings {
    resistance_ohm: f64,
    d_h: f64,
    q_h: f64,
    flux_v_s: f64,
    pole_pairs: f64,
}

/// What dead time takes from a command along d and q: of each phase by the direction of its own current.
fn dead_time_v(current_a: [f64; 2], electrical_rad: f64, level_v: f64) -> [f64; 2] {
    let mut lost_v = [0.0; 2];
    for phase in [0.0, 1.0, 2.0] {
        let (sin, cos) = (electrical_rad - 2.0 * FRAC_PI_3 * phase).sin_cos();
        let of_phase = current_a[0] * cos - current_a[1] * sin;
        let lost = level_v * (of_phase / 0.3).clamp(-1.0, 1.0);
        lost_v[0] += 2.0 / 3.0 * lost * cos;
        lost_v[1] -= 2.0 / 3.0 * lost * sin;
    }
    lost_v
}

fn servo(seed: u64, run: Run) -> Log {
    let mut own = Chance::of_specimen(seed ^ 0x5E40);
    let motor = Windings {
        resistance_ohm: own.near(0.35, 0.15),
        d_h: 0.003,
        q_h: own.near(0.004, 0.1),
        flux_v_s: own.near(0.2, 0.1),
        pole_pairs: 4.0,
    };
    let (inertia_kg_m2, dry_n_m) = (own.near(0.02, 0.2), own.near(1.0, 0.2));
    let level_v = own.near(6.0, 0.2);
    let mut chance = Chance::of_run(seed ^ 0x5E40, run);
    let (step_s, every) = (2.5e-5, 20_u32);
    let period_s = 20.0 * step_s;
    let wanted = Levels::steps(0.3, 2.2, [0.15, 0.35], &mut chance, |chance, n| {
        let back = if n % 2 == 0 { 1.0 } else { -1.0 };
        back * chance.between(20.0, 200.0)
    })
    .along(1500.0);
    let friction = Dry { level_n_m: dry_n_m, band_rad_s: 1e-3 };
    let mut log = Log::new("t_ms,uq_ref,iq,n_act");
    let (mut state, mut command_v) = ([0.0_f64; 4], [0.0_f64; 2]);
    // Speed, d and q: what the integrators of the controllers hold.
    let mut held = [0.0_f64; 3];
    for n in 0..88_000_u32 {
        let [d_a, q_a, w, angle_rad] = state;
        if n % every == 0 {
            let time_s = f64::from(n) * step_s;
            let told_a = q_a + 0.04 * chance.normal();
            let told_rad_s = w + 0.15 * chance.normal();
            if time_s > 0.25 {
                let electrical_rad_s = motor.pole_pairs * told_rad_s;
                let error = wanted.value(time_s) - told_rad_s;
                let limited = (held[0] + 0.8 * error).clamp(-25.0, 25.0);
                if limited.abs() < 25.0 {
                    held[0] += 12.0 * error * period_s;
                }
                let wish_a = [-d_a, limited - told_a];
                held[1] += 100.0 * wish_a[0] * period_s;
                held[2] += 100.0 * wish_a[1] * period_s;
                command_v = [
                    3.0 * wish_a[0] + held[1] - electrical_rad_s * motor.q_h * told_a,
                    4.0 * wish_a[1]
                        + held[2]
                        + electrical_rad_s * (motor.d_h * d_a + motor.flux_v_s),
                ];
            }
            let rpm = told_rad_s * 60.0 / TAU;
            log.row(&[1e3 * time_s, quantised(command_v[1], 0.01), quantised(told_a, 0.01), rpm]);
        }
        let torque_n_m = |d_a: f64, q_a: f64| {
            1.5 * motor.pole_pairs * (motor.flux_v_s + (motor.d_h - motor.q_h) * d_a) * q_a
        };
        let direction = friction.direction(w, torque_n_m(d_a, q_a));
        let lost_v = dead_time_v([d_a, q_a], motor.pole_pairs * angle_rad, level_v);
        state = rk4(state, step_s, |&[d_a, q_a, w, _]| {
            let electrical = motor.pole_pairs * w;
            let d_v = command_v[0] - lost_v[0] - motor.resistance_ohm * d_a;
            let q_v = command_v[1] - lost_v[1] - motor.resistance_ohm * q_a;
            let against = direction.map_or_else(|| torque_n_m(d_a, q_a), |sign| dry_n_m * sign);
            [
                (d_v + electrical * motor.q_h * q_a) / motor.d_h,
                (q_v - electrical * (motor.d_h * d_a + motor.flux_v_s)) / motor.q_h,
                (torque_n_m(d_a, q_a) - against) / inertia_kg_m2,
                w,
            ]
        });
        state[2] = Dry::settled(direction, state[2]);
    }
    log
}

/// Small motor with a heavy disc, reversed without a pause until its winding is hot.
///
/// ```text
/// L i' = u - R0 (1 + a (T1 - T0)) i - K w         J w' = K i - Tc sgn(w)
/// C1 T1' = R i^2 - (T1 - T2)/R12                  C2 T2' = (T1 - T2)/R12 - (T2 - T0)/R20
/// ```
///
/// Two bodies, winding and housing (Mellor, Roberts and Turner 1991), copper by its own coefficient; the catalogue has one body
/// and no temperature. Semi-implicit Euler at 50 us.
pub(crate) const HOT: Case = Case {
    name: "winding that warms up",
    map: "time_s=time,voltage_v=u,current_a=i,speed_rad_s=omega",
    nameplate: Some([0.5, 6e-4, 0.03, 3e-4, 0.01]),
    truth: Truth::Effects { missing: &[&["winding_heating"]], also: &[] },
    record: hot,
};

fn hot(seed: u64, run: Run) -> Log {
    let mut own = Chance::of_specimen(seed ^ 0x407);
    let (cold_ohm, l, k) = (own.near(0.5, 0.1), 6e-4, own.near(0.03, 0.1));
    let (j, dry_n_m) = (own.near(4e-4, 0.2), own.near(0.012, 0.2));
    let (winding_j_per_k, housing_j_per_k) = (own.near(12.0, 0.2), 120.0);
    let (between_k_per_w, out_k_per_w) = (own.near(1.0, 0.2), 4.0);
    let mut chance = Chance::of_run(seed ^ 0x407, run);
    let (step_s, every) = (5e-5, 100_u32);
    let command = Levels::steps(0.6, 10.0, [0.25, 0.55], &mut chance, |chance, n| {
        let back = if n % 2 == 0 { 1.0 } else { -1.0 };
        back * chance.between(5.0, 11.0)
    });
    let dry = Dry { level_n_m: dry_n_m, band_rad_s: 1e-3 };
    let mut log = Log::new("time,u,i,omega");
    let (mut i, mut w, mut u) = (0.0_f64, 0.0_f64, 0.0);
    // Of winding and housing above the room, K.
    let mut warmer = [0.0_f64; 2];
    for n in 0..200_000_u32 {
        if n % every == 0 {
            let time_s = f64::from(n) * step_s;
            u = command.value(time_s);
            let current_a = quantised(i + 0.03 * chance.normal(), 0.01);
            log.row(&[time_s, u, current_a, w + 0.3 * chance.normal()]);
        }
        let resistance_ohm = cold_ohm * (1.0 + 0.00393 * warmer[0]);
        i = (i + step_s * (u - k * w) / l) / (1.0 + step_s * resistance_ohm / l);
        let direction = dry.direction(w, k * i);
        if let Some(direction) = direction {
            w += step_s * (k * i - dry_n_m * direction) / j;
        }
        w = Dry::settled(direction, w);
        let flow_w = (warmer[0] - warmer[1]) / between_k_per_w;
        warmer[0] += step_s * (resistance_ohm * i * i - flow_w) / winding_j_per_k;
        warmer[1] += step_s * (flow_w - warmer[1] / out_k_per_w) / housing_j_per_k;
    }
    log
}
