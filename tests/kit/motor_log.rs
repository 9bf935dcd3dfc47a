//! A log of the motor of paper A as a foreign program would write it: simulated, sampled, with the noise of sensors.

use std::fmt::Write as _;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub(crate) const L_H: f64 = 0.0099;
pub(crate) const J: f64 = 0.0045;
pub(crate) const MC: f64 = 0.455;
/// Heads of the first four cells of a row.
pub(crate) const COLUMNS: &str = "time_s,voltage_v,current_a,speed_rad_s";

/// Time, voltage, current, speed, angle.
pub(crate) type Row = [f64; 5];

/// Uniform noise, each value of the standard deviation that is asked for.
pub(crate) fn noise(seed: u64) -> impl FnMut(f64) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let most = 3_f64.sqrt();
    move |deviation| deviation * rng.random_range(-most..most)
}

/// What is recorded.
#[derive(Clone, Copy)]
pub(crate) struct Bench {
    pub(crate) resistance_ohm: f64,
    pub(crate) ke: f64,
    /// What the bridge takes, against the current.
    pub(crate) drop_v: f64,
    /// Speed of the shaft at the beginning.
    pub(crate) turning: f64,
    /// The shaft may turn.
    pub(crate) free: bool,
    pub(crate) seed: u64,
}

impl Bench {
    pub(crate) const PAPER_A: Self =
        Self { resistance_ohm: 1.1, ke: 0.3538, drop_v: 0.0, turning: 0.0, free: true, seed: 7 };

    /// 8 s at 5 ms under this voltage.
    pub(crate) fn record(self, volts: impl Fn(f64) -> f64) -> Vec<Row> {
        let (step_s, every) = (1e-4, 50);
        let mut noise = noise(self.seed);
        let (mut i, mut w, mut angle) = (0.0_f64, self.turning, 0.0_f64);
        let mut rows = Vec::new();
        for step in 0..80_000_u32 {
            let time_s = f64::from(step) * step_s;
            let u = volts(time_s);
            if step % every == 0 {
                rows.push([time_s, u, i + noise(0.03), w + noise(0.15), angle]);
            }
            let torque = self.ke * i;
            let lost_v = if i == 0.0 { 0.0 } else { self.drop_v.copysign(i) };
            i += step_s * (u - lost_v - self.resistance_ohm * i - self.ke * w) / L_H;
            if self.free {
                let next = coulomb_step(w, torque, [MC, 0.0, J], step_s);
                angle += 0.5 * step_s * (w + next);
                w = next;
            }
        }
        rows
    }
}

/// Speed after a step under a force or torque, against dry and viscous friction of a mass or inertia; through zero it stops
/// before it turns.
pub(crate) fn coulomb_step(
    speed: f64,
    drive: f64,
    [dry, viscous, mass]: [f64; 3],
    step_s: f64,
) -> f64 {
    let rests = speed == 0.0;
    if rests && drive.abs() <= dry {
        return 0.0;
    }
    let direction = if rests { drive } else { speed }.signum();
    let next = speed + step_s * (drive - dry * direction - viscous * speed) / mass;
    if speed * next < 0.0 { 0.0 } else { next }
}

/// After half a second at rest another voltage every second.
pub(crate) fn steps(time_s: f64) -> f64 {
    let levels = [20.0, -25.0, 60.0, -10.0, 35.0, -50.0, 15.0, -40.0];
    if time_s < 0.5 {
        return 0.0;
    }
    let whole = time_s.floor();
    let place = levels.iter().zip(0_u32..).find(|(_, n)| f64::from(*n) >= whole);
    place.map_or(0.0, |(volts, _)| *volts)
}

/// A row of the file.
pub(crate) fn push(text: &mut String, cells: &[f64]) {
    let cells: Vec<String> = cells.iter().map(f64::to_string).collect();
    let _ = writeln!(text, "{}", cells.join(","));
}

/// The file: these columns, each row changed.
pub(crate) fn csv(header: &str, rows: &[Row], change: impl Fn(&mut Row)) -> String {
    let columns = header.split(',').count();
    let mut text = format!("{header}\n");
    for row in rows {
        let mut row = *row;
        change(&mut row);
        push(&mut text, &row[..columns]);
    }
    text
}
