//! Whether the torque of a row is held from its stamp on, as a command, or is that of the instant, as a reading.
//!
//! ```text
//! T_k = J a_k + c sgn(w) + b w + d w |w| + share x period x dT/dt
//! ```
//!
//! A held torque comes half a period before the motion that it makes: its share is a half, that of a reading is zero. Least squares
//! at the rows, with central differences and with the rate of the *fitted* torque, whose noise is not that of the reading.

use super::restored_speed::LONGEST_PERIODS;
use super::run_scales::REVERSAL_SHARE;
use crate::numerics::least_squares::fit_normal;
use crate::numerics::statistics::{largest_but_outliers, median_step};
use crate::sample::{Channel, Run};
use crate::signal::{self, Point};

/// Least share of a held torque, halfway between both kinds.
const LEAST_SHARE: f64 = 0.25;

/// The torque `(time, N.m)` as it acted: a reading from halfway to its neighbours. Where a record does not show its kind, as it is.
pub(super) fn applied(run: &Run, held: Vec<Point>) -> Vec<Point> {
    if held_share(run, &held).is_none_or(|share| share >= LEAST_SHARE) {
        return held;
    }
    let first = held.first().copied();
    let middles = held.windows(2).map(|pair| (f64::midpoint(pair[0].0, pair[1].0), pair[1].1));
    first.into_iter().chain(middles).collect()
}

/// Part of a period by which the torque comes before the motion that it makes; `None` where that is not known to a quarter.
fn held_share(run: &Run, torque: &[Point]) -> Option<f64> {
    let speeds: Vec<Point> = run.points(Channel::Speed).collect();
    let times: Vec<f64> = torque.iter().map(|point| point.0).collect();
    let period_s = median_step(&times);
    let speed: Vec<f64> = times.iter().map(|time_s| signal::line(&speeds, *time_s)).collect();
    let slow_rad_s = REVERSAL_SHARE * largest_but_outliers(&speed);
    // Regressors at a row; none where it or a neighbour is slow, or a row is missing between them.
    let regressors = |row: usize| -> Option<[f64; 4]> {
        let around = row.checked_sub(1)?..row + 2;
        let (w, t) = (speed.get(around.clone())?, &times[around]);
        let near = t.windows(2).all(|pair| pair[1] - pair[0] <= LONGEST_PERIODS * period_s);
        let one_way = w.iter().all(|own| own * w[1].signum() > slow_rad_s);
        let rate = (w[2] - w[0]) / (t[2] - t[0]);
        (near && one_way).then(|| [rate, w[1].signum(), w[1], w[1] * w[1].abs()])
    };
    let rows: Vec<Option<[f64; 4]>> = (0..times.len()).map(regressors).collect();
    let known = rows.iter().zip(torque).filter_map(|(row, point)| Some(((*row)?, point.1)));
    // That of a drag at nearly one speed is 1e-5, and only the rate of the torque has to be determined.
    let least_tolerance = 1e-9;
    let plain = fit_normal(&known.collect::<Vec<_>>(), least_tolerance)?;
    let fitted = |row: &Option<[f64; 4]>| {
        row.map_or(f64::NAN, |row| row.iter().zip(plain.x).map(|(cell, x)| cell * x).sum())
    };
    let fitted: Vec<f64> = rows.iter().map(fitted).collect();
    let late = (1..times.len().saturating_sub(1)).filter_map(|row| {
        let [rate, sign, linear, square] = rows[row]?;
        let over_s = times[row + 1] - times[row - 1];
        let change = period_s * (fitted[row + 1] - fitted[row - 1]) / over_s;
        Some(([rate, sign, linear, square, change], torque[row].1))
    });
    let found = fit_normal(&late.collect::<Vec<_>>(), least_tolerance)?;
    (found.std[4] < LEAST_SHARE).then_some(found.x[4])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Origin;

    /// A shaft under `2 + sin(3 t) + sin(7.3 t)`, turning one way, logged every 20 ms with the torque `share` of a period early.
    fn logged(share: f64, noise: f64) -> Run {
        let times: Vec<f64> = (0..800).map(|row| 0.02 * f64::from(row)).collect();
        let speed = |t: f64| 40.0 - (3.0 * t).cos() * 4.0 - (7.3 * t).cos() * 3.0;
        let torque = |t: f64| {
            let rate = 12.0 * (3.0 * t).sin() + 21.9 * (7.3 * t).sin();
            0.01 * rate + 0.1 + 0.002 * speed(t)
        };
        let mut state = 1_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f64 / f64::from(1 << 24) - 0.5
        };
        let torques = times.iter().map(|t| torque(t + 0.02 * share) + noise * random()).collect();
        let speeds = times.iter().map(|t| speed(*t)).collect();
        let mut run = Run::new("geared", times).unwrap();
        run.set_column(Channel::Torque, torques, Origin::Measured).unwrap();
        run.set_column(Channel::Speed, speeds, Origin::Measured).unwrap();
        run
    }

    #[test]
    fn a_reading_differs_from_a_held_torque_beside_its_noise() {
        for (share, noise) in [(0.0, 0.0), (0.5, 0.0), (0.0, 0.05), (0.5, 0.05)] {
            let run = logged(share, noise);
            let torque: Vec<Point> = run.points(Channel::Torque).collect();
            let found = held_share(&run, &torque).unwrap();
            assert!((found - share).abs() < 0.1, "{share} {noise}: {found}");
            let is_held = applied(&run, torque.clone()) == torque;
            assert_eq!(is_held, share > 0.0);
        }
    }

    #[test]
    fn what_a_record_does_not_show_stays_held() {
        let run = logged(0.0, 1e4);
        let torque: Vec<Point> = run.points(Channel::Torque).collect();
        assert_eq!(held_share(&run, &torque), None);
        assert_eq!(applied(&run, torque.clone()), torque);
        assert!(applied(&run, Vec::new()).is_empty());
    }
}
