//! Loops, filters and drives that log in their own way.

use std::f64::consts::TAU;

use super::bench::{Chance, Coloured, Dry, Levels, Log, Run, quantised, rk4};
use super::judge::{Case, Truth};

/// Motor of a laboratory with an oil-filled bearing, driven by a script over USB.
///
/// ```text
/// L i' = u - R i - K w                    J w' = K i - B w - Tc sgn(w)
/// ```
///
/// The loop is as long as the operating system makes it: a log-normal time of about 11 ms, and a pause of up to 60 ms now and
/// then. A sample is taken and the next voltage set at the same instant. The catalogue has the equation, its emulator has neither
/// the loop nor the integrator. Runge-Kutta with steps cut to the loop.
pub(crate) const SCRIPT: Case = Case {
    name: "irregular loop with oil drag",
    map: "time_s=unix_s,voltage_v=psu_v,current_a=psu_a,speed_rad_s=tacho",
    nameplate: None,
    truth: Truth::Effects { missing: &[&["viscous_friction"]], also: &[] },
    record: script,
};

fn script(seed: u64, run: Run) -> Log {
    let mut own = Chance::of_specimen(seed ^ 0x5C4);
    let (r, l, k) = (own.near(1.8, 0.1), 0.0015, own.near(0.055, 0.1));
    let (j, viscous) = (own.near(1.2e-4, 0.2), own.near(1.1e-4, 0.15));
    let dry = Dry { level_n_m: own.near(0.006, 0.2), band_rad_s: 1e-4 };
    let mut chance = Chance::of_run(seed ^ 0x5C4, run);
    let command = Levels::steps(0.7, 10.0, [0.25, 0.8], &mut chance, |chance, n| {
        let back = if n % 3 == 1 { -1.0 } else { 1.0 };
        back * quantised(chance.between(3.0, 24.0), 0.1)
    });
    let mut log = Log::new("unix_s,psu_v,psu_a,tacho");
    let (mut state, mut time_s) = ([0.0_f64; 2], 0.0);
    while time_s < 10.0 {
        let u = command.value(time_s);
        let current_a = quantised(state[0] + 0.01 * chance.normal(), 0.005);
        log.row(&[time_s, u, current_a, state[1] + 0.5 * chance.normal()]);
        let pause_s =
            if chance.between(0.0, 1.0) < 0.01 { chance.between(0.02, 0.05) } else { 0.0 };
        let loop_s = 0.006 + 0.004 * (0.6 * chance.normal()).exp() + pause_s;
        // Whole microseconds, as the stamps have them.
        let loop_s = quantised(loop_s, 1e-6);
        let steps = (loop_s / 4e-5).ceil();
        let step_s = loop_s / steps;
        let mut done = 0.0;
        while done < steps {
            let direction = dry.direction(state[1], k * state[0]);
            state = rk4(state, step_s, |&[i, w]| {
                let against = direction.map_or(k * i, |sign| viscous * w + dry.level_n_m * sign);
                [(u - r * i - k * w) / l, (k * i - against) / j]
            });
            state[1] = Dry::settled(direction, state[1]);
            done += 1.0;
        }
        time_s += loop_s;
    }
    log
}

/// Fan on a frequency converter that logs its estimate of the torque and the speed at 50 Hz.
///
/// ```text
/// J w' = T - k w |w| - Tc tanh(w/v0)      T = PI(w reference - w), limited, behind a lag of 8 ms
/// ```
///
/// No voltage and no current: an induction motor behind a vector drive. The fan's law of similarity (quadratic torque), dry
/// friction of bearings and seals with a slope; the estimate of the torque wanders slowly. Runge-Kutta at 1 ms.
pub(crate) const FAN: Case = Case {
    name: "fan by torque",
    map: "time_s=Zeit,torque_n_m=Moment,speed_rad_s=Drehzahl*0.104719755",
    nameplate: None,
    truth: Truth::Effects { missing: &[&["quadratic_load"]], also: &[] },
    record: fan,
};

fn fan(seed: u64, run: Run) -> Log {
    let mut own = Chance::of_specimen(seed ^ 0xFA4);
    let (inertia_kg_m2, dry_n_m) = (own.near(0.06, 0.2), own.near(0.5, 0.2));
    let quadratic = own.near(1.1e-4, 0.15);
    let mut chance = Chance::of_run(seed ^ 0xFA4, run);
    let wanted = Levels::steps(0.8, 10.0, [0.7, 1.5], &mut chance, |chance, n| {
        let back = if n % 4 == 3 { -0.5 } else { 1.0 };
        back * chance.between(60.0, 300.0)
    })
    .along(400.0);
    let mut noise = Coloured::new(0.08, 0.06, 0.02);
    let mut log = Log::new("Zeit,Moment,Drehzahl");
    // Torque, speed.
    let (mut state, mut held_n_m, mut goal_n_m) = ([0.0_f64; 2], 0.0_f64, 0.0);
    let step_s = 1e-3;
    for n in 0..10_000_u32 {
        let time_s = f64::from(n) * step_s;
        if n % 2 == 0 && time_s > 0.7 {
            let error = wanted.value(time_s) - state[1];
            goal_n_m = (held_n_m + 1.2 * error).clamp(-30.0, 30.0);
            if goal_n_m.abs() < 30.0 {
                held_n_m += 6.0 * error * 2.0 * step_s;
            }
        }
        if n % 20 == 0 {
            let torque_n_m = quantised(state[0] + noise.next(&mut chance), 0.01);
            let rpm = state[1] * 60.0 / TAU + 1.0 * chance.normal();
            log.row(&[time_s, torque_n_m, rpm]);
        }
        state = rk4(state, step_s, |&[torque_n_m, w]| {
            let against = quadratic * w * w.abs() + dry_n_m * (w / 0.5).tanh();
            [(goal_n_m - torque_n_m) / 0.008, (torque_n_m - against) / inertia_kg_m2]
        });
    }
    log
}

/// Servo motor of 1 kW whose drive shows the speed through a smoothing filter of second order.
///
/// ```text
/// L i' = u - R i - K w                    J w' = K i - Tc tanh(w/v0)
/// y'' = wf^2 (w - y) - sqrt(2) wf y'
/// ```
///
/// A Butterworth filter of 12 Hz, as monitor outputs have it, whose group delay is sqrt(2)/wf at low frequencies. The catalogue has a
/// first-order lag and a pure delay; either is the right name of it. The excitation is a pseudo-random binary sequence about changing
/// levels. Runge-Kutta at 50 us.
pub(crate) const FILTERED: Case = Case {
    name: "speed through a slow filter",
    map: "time_s=t,voltage_v=u,current_a=i,speed_rad_s=w_mon",
    nameplate: Some([0.9, 0.004, 0.35, 0.008, 0.3]),
    truth: Truth::Effects { missing: &[&["speed_filter", "speed_delay"]], also: &[] },
    record: filtered,
};

fn filtered(seed: u64, run: Run) -> Log {
    let mut own = Chance::of_specimen(seed ^ 0xF117);
    let (r, l, k) = (own.near(0.9, 0.1), 0.004, own.near(0.35, 0.1));
    let (j, dry_n_m) = (own.near(0.008, 0.2), own.near(0.3, 0.2));
    let filter_rad_s = TAU * own.near(12.0, 0.2);
    let mut chance = Chance::of_run(seed ^ 0xF117, run);
    let (step_s, every) = (5e-5, 40_u32);
    let base = Levels::steps(0.5, 6.0, [0.5, 1.0], &mut chance, |chance, _| {
        chance.sign() * chance.between(5.0, 45.0)
    });
    let binary =
        Levels::steps(0.5, 6.0, [0.03, 0.15], &mut chance, |chance, _| 10.0 * chance.sign());
    let mut log = Log::new("t,u,i,w_mon");
    let (mut state, mut u) = ([0.0_f64; 4], 0.0);
    for n in 0..120_000_u32 {
        if n % every == 0 {
            let time_s = f64::from(n) * step_s;
            u = base.value(time_s) + binary.value(time_s);
            let current_a = quantised(state[0] + 0.05 * chance.normal(), 0.01);
            log.row(&[time_s, u, current_a, state[2] + 0.05 * chance.normal()]);
        }
        state = rk4(state, step_s, |&[i, w, shown, rate]| {
            [
                (u - r * i - k * w) / l,
                (k * i - dry_n_m * (w / 0.1).tanh()) / j,
                rate,
                filter_rad_s * (filter_rad_s * (w - shown) - std::f64::consts::SQRT_2 * rate),
            ]
        });
    }
    log
}
