//! Lag of a measured speed behind the measured angle of the same shaft: moments of the impulse response of the speed's sensor, by
//! least squares (a moment expansion as in Åström & Hägglund, *PID Controllers*, 1995, ch. 2).
//!
//! ```text
//! sensor             G(s) = 1 - m1 s + m2 s^2/2 - ...       of a delay d and a filter T: m1 = d + T, m2 - m1^2 = T^2
//! angle - integral of the speed  =  m1 w + (m1^2 - m2/2) dw/dt + scale . angle        over some samples each
//! ```
//!
//! The angle has no lag of its own where a counter is read. No model of the motor is needed.

use drivebench_model::numerics::least_squares::fit_normal;
use drivebench_model::numerics::statistics::{largest, median_step};
use drivebench_model::plant::{Input, Model, Motor, Scenario};
use drivebench_model::sample::{Channel, Run, Sensors, SpeedLag};

use crate::noise::NoiseFloor;
use crate::{output_error, start};

/// A lag, zero where none is significant, and the standard deviation of its total.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundLag {
    pub lag: SpeedLag,
    pub std_s: f64,
}

/// The lag of the speed; `None` where the run has no angle of its own, or does not determine the lag.
pub fn by_angle(run: &Run) -> Option<FoundLag> {
    // Of one row: over more, an error of the speed's scale grows; over fewer, the last count of the angle does.
    let samples = 10;
    let column = |channel| run.column(channel);
    let (speeds, angles) = (column(Channel::Speed)?, column(Channel::Angle)?);
    let times = run.time_s();
    let both = |row: &usize| speeds[*row].is_finite() && angles[*row].is_finite();
    let rows: Vec<usize> = (0..run.rows()).filter(both).collect();
    let at: Vec<f64> = rows.iter().map(|row| times[*row]).collect();
    let period_s = median_step(&at);
    let speed: Vec<f64> = rows.iter().map(|row| speeds[*row]).collect();
    let angle: Vec<f64> = rows.iter().map(|row| angles[*row]).collect();
    // Near standstill friction bends the speed within a sample, and an observer follows another law.
    let least_rad_s = 0.1 * largest(speed.iter().copied());
    let is_row = |first: &usize| {
        let steps = at[*first - 1..=*first + samples + 1].windows(2);
        let is_regular = steps.map(|pair| pair[1] - pair[0]).all(|step_s| step_s < 1.5 * period_s);
        let speeds = &speed[*first - 1..=*first + samples + 1];
        is_regular && speeds.iter().all(|speed| speed.abs() > least_rad_s)
    };
    let rate = |k: usize| (speed[k + 1] - speed[k - 1]) / (at[k + 1] - at[k - 1]);
    // The trapezoidal rule with its first correction (Euler and Maclaurin).
    let travelled = |k: usize| {
        let step_s = at[k + 1] - at[k];
        let curved = step_s * step_s / 12.0 * (rate(k + 1) - rate(k));
        0.5 * step_s * (speed[k] + speed[k + 1]) - curved
    };
    let row = |first: usize| {
        let last = first + samples;
        let turned = angle[last] - angle[first];
        let integral: f64 = (first..last).map(travelled).sum();
        ([speed[last] - speed[first], rate(last) - rate(first), turned], turned - integral)
    };
    let last = at.len().checked_sub(samples + 1)?;
    let rows: Vec<([f64; 3], f64)> = (1..last).step_by(samples).filter(is_row).map(row).collect();
    // A run of some seconds.
    if rows.len() < 30 {
        return None;
    }
    let fit = fit_normal(&rows, 1e-4)?;
    let [total_s, curvature, _] = fit.x;
    let std_s = fit.std[0];
    // Beyond the length of a row the expansion has no meaning.
    let most_s = samples as f64 * period_s;
    if total_s.abs() > most_s || std_s > 0.1 * most_s {
        return None;
    }
    // Shorter ones are errors of the stamps, which every fit takes into account.
    if total_s < (5.0 * std_s).max(0.1 * period_s) {
        return Some(FoundLag { lag: SpeedLag::default(), std_s });
    }
    let variance_s2 = (total_s * total_s - 2.0 * curvature).clamp(0.0, total_s * total_s);
    let filter_s = variance_s2.sqrt();
    Some(FoundLag { lag: SpeedLag { delay_s: total_s - filter_s, filter_s }, std_s })
}

/// Whether the five-parameter model follows a run that a voltage drives no worse with what is known of its sensors than with `instead`;
/// `None` where it cannot be fitted.
pub fn is_supported(run: &Run, instead: Sensors) -> Option<bool> {
    let error = |run: &Run| {
        let scenario = Scenario::from_run(run).ok().filter(|own| own.input == Input::Voltage)?;
        let start = start::complete(&Model::baseline(Motor::new("lag")), &scenario).ok()?;
        Some(output_error::fit(&[start], &scenario, &NoiseFloor::from_spread(&scenario)).ok()?.nrms)
    };
    let mut other = run.clone();
    other.set_sensors(instead);
    Some(error(run)? <= error(&other)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_model::numerics::count::whole;
    use drivebench_model::plant::testing::run_of;
    use drivebench_model::plant::{State, testing::record};
    use drivebench_model::sample::Origin;

    /// A shaft between steps of its speed, of a time constant of 20 ms, read at 100 Hz as counts and by a speed of that lag.
    fn run(lag: SpeedLag, scale: f64) -> Run {
        let (step_s, decay_s) = (1e-4, 0.02);
        let (mut wanted, mut speed, mut filtered, mut angle) = (0.0_f64, 0.0, 0.0, 0.0_f64);
        let mut past = vec![];
        let mut seed = 1_u32;
        let (mut times, mut angles, mut speeds) = (vec![], vec![], vec![]);
        for step in 0..200_000_u32 {
            if step % 2_130 == 0 {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                wanted = f64::from(seed >> 16) / 6_554.0 - 5.0;
            }
            speed += step_s / decay_s * (wanted - speed);
            angle += step_s * speed;
            past.push(speed);
            let late = past.len().saturating_sub(1 + whole((lag.delay_s / step_s).round()));
            if lag.filter_s > 0.0 {
                filtered += step_s / lag.filter_s * (past[late] - filtered);
            } else {
                filtered = past[late];
            }
            if step % 100 == 0 {
                times.push(f64::from(step) * step_s);
                angles.push((angle / 0.001_534).round() * 0.001_534);
                speeds.push(scale * (filtered / 0.024).round() * 0.024);
            }
        }
        let columns = [
            (Channel::Angle, angles, Origin::Measured),
            (Channel::Speed, speeds, Origin::Measured),
        ];
        run_of("r", times, columns)
    }

    #[test]
    fn delay_and_filter_are_told_apart_by_the_angle() {
        for (delay_s, filter_s) in [(0.0, 0.012), (0.012, 0.0), (0.004, 0.008), (0.0, 0.066)] {
            let lag = SpeedLag { delay_s, filter_s };
            for scale in [1.0, 0.97] {
                let found = by_angle(&run(lag, scale)).unwrap();
                let total_s = lag.total_s();
                let off_s = (found.lag.total_s() - total_s).abs();
                assert!(off_s < 0.03 * total_s + 3.0 * found.std_s, "{lag:?} {scale}: {found:?}");
                let filter_off_s = (found.lag.filter_s - filter_s).abs();
                assert!(filter_off_s < 0.15 * total_s, "{lag:?} {scale}: {found:?}");
            }
        }
    }

    #[test]
    fn a_stated_filter_that_the_record_does_not_have_is_not_supported() {
        use drivebench_model::plant::Plant;
        let stated =
            Sensors { speed: SpeedLag { delay_s: 0.0, filter_s: 0.066 }, ..Sensors::default() };
        let events = vec![(0.0, 0.0), (0.3, 40.0), (0.9, -30.0), (1.5, 60.0), (2.1, 20.0)];
        let model = Model::baseline(Motor::zk_22fc());
        let mut scenario = record(&model, events.clone(), 0.01, 3.0, 1);
        for has_filter in [false, true] {
            scenario.sensors = if has_filter { stated } else { Sensors::default() };
            let mut plant = Plant::new(&model, Input::Voltage).unwrap();
            let found = plant.simulate(&scenario, State::default());
            let held = |time_s: &f64| drivebench_model::signal::held(&events, *time_s).unwrap();
            let columns = [
                (
                    Channel::VoltageCmd,
                    scenario.sample_time_s.iter().map(held).collect(),
                    Origin::Commanded,
                ),
                (Channel::Current, found.current_a, Origin::Measured),
                (Channel::Speed, found.speed_rad_s, Origin::Measured),
            ];
            let mut run = run_of("r", scenario.sample_time_s.clone(), columns);
            run.set_sensors(stated);
            assert_eq!(is_supported(&run, Sensors::default()), Some(has_filter));
        }
    }

    #[test]
    fn a_speed_without_a_lag_has_none() {
        let found = by_angle(&run(SpeedLag::default(), 1.0)).unwrap();
        assert_eq!(found.lag, SpeedLag::default(), "{found:?}");
        let whole = run(SpeedLag { delay_s: 0.0, filter_s: 0.012 }, 1.0);
        assert_eq!(by_angle(&whole.without(Channel::Angle)), None);
    }
}
