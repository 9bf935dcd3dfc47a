//! Measurement of a torque map: friction over both directions of the speed, cogging over a turn of the shaft.
//!
//! ```text
//! model without the torque that is mapped --> windows: Kt <i> - J <dw/dt> - what the model keeps --> bins of a fixed grid
//!                                                                               mean, 95 % interval, windows of each
//! ```
//!
//! From a cogging map a friction of each direction, `a + b w`, is partialled out: the rest is a torque of the angle alone. The
//! interval of a bin is that of its few windows: one held speed is one block of time, of which a clustered covariance knows no
//! spread.
//!
//! Nothing of the mapped torque's form is taken from the model; its Kt and J are, and an error of them scales what is found.
//! A bin without enough windows has no value.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::regression::partial_regression;
use super::windows::{FEWEST_HALF, Window, Windows};
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error::FitError;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::least_squares;
use drivebench_model::numerics::statistics::{extent, largest, median};
use drivebench_model::plant::{
    Balance, MapBin, MappedTorque, MappedValue, Model, Scenario, TorqueMap,
};

/// Bins of each direction, and of a turn: 5 degrees.
const BINS_EACH_WAY: usize = 12;
const BINS_PER_TURN: usize = 72;
/// Windows without which a bin has no value.
const FEWEST_WINDOWS: usize = 4;
/// Neighbouring windows share half of their samples.
const WINDOWS_EACH: f64 = 2.0;
/// A window may turn through so much, rad: what it averages then is 95 % of a wave of seven periods per turn.
const MOST_TURN_RAD: f64 = 0.3;
/// Windows turn through this share of it at the median speed.
const TURN_SHARE: f64 = 0.8;
/// Share of a bin by which the speed of a window may vary (a standard deviation).
const STEADY_SHARE: f64 = 0.5;
/// Two-sided level of the intervals.
const LEVEL: f64 = 0.95;

/// A map with what it could not use.
#[derive(Clone, Debug)]
pub struct MeasuredMap {
    pub map: TorqueMap,
    /// Runs that were left out, by their index, and the signal that each lacks.
    pub left_out: Vec<(usize, &'static str)>,
}

/// Why there is no map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MapError {
    #[error("no run has a {0}")]
    Missing(&'static str),
    #[error("no bin has {FEWEST_WINDOWS} windows of steady motion")]
    Empty,
}

impl MapError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::Missing(_) => "take runs that record it",
            Self::Empty => {
                "take runs that hold their speeds for some tenths of a second; for cogging a slow one, below 5 rad/s"
            }
        }
    }
}

/// A window's position on the axis, its torque and the standard deviation by noise.
struct WindowTorque {
    place: f64,
    speed_rad_s: f64,
    torque_n_m: f64,
    floor_n_m: f64,
}

fn median_speed(run: &Scenario) -> f64 {
    let speeds = run.speed_rad_s.iter().map(|speed| speed.abs());
    median(&speeds.filter(|speed| *speed > 0.0).collect::<Vec<f64>>())
}

/// The map of a torque from runs with their noise, by the Kt, J and winding of a complete `model`.
pub fn torque_map(
    of: MappedTorque,
    model: &Model,
    runs: &[(Scenario, NoiseFloor)],
) -> Result<Result<MeasuredMap, MapError>, FitError> {
    let rest = of.taken_out_of(model);
    let fastest = largest(runs.iter().flat_map(|(run, _)| run.speed_rad_s.iter().copied()));
    let bins = match of {
        MappedTorque::Friction => grid(-fastest, fastest, 2 * BINS_EACH_WAY),
        MappedTorque::Cogging => grid(0.0, TAU, BINS_PER_TURN),
    };
    let width = bins[0].to - bins[0].from;
    let mut found: Vec<WindowTorque> = Vec::new();
    let mut left_out = Vec::new();
    for (index, (run, noise)) in runs.iter().enumerate() {
        let most_s = match of {
            MappedTorque::Friction => f64::INFINITY,
            MappedTorque::Cogging => TURN_SHARE * MOST_TURN_RAD / median_speed(run),
        };
        let windows = Windows::up_to(most_s, &rest, run, noise, FEWEST_HALF)?;
        let needs_angle = of == MappedTorque::Cogging;
        let angle = needs_angle.then(|| windows.angle_at_samples()).flatten().unwrap_or_default();
        let no_angle = (needs_angle && angle.is_empty()).then_some("angle");
        if let Some(signal) = windows.missing_signal().or(no_angle) {
            left_out.push((index, signal));
            continue;
        }
        for window in windows.of(Balance::Torque) {
            let place = match of {
                MappedTorque::Friction => steady_speed(&windows, window, width),
                MappedTorque::Cogging => {
                    let own = &angle[windows.samples_of(window)];
                    let (low, high) = extent(own.iter());
                    (high - low < MOST_TURN_RAD).then(|| own[own.len() / 2].rem_euclid(TAU))
                }
            };
            // None where the shaft turned too far, or its speed was not steady.
            if let Some(place) = place {
                found.push(WindowTorque {
                    place,
                    speed_rad_s: window.speed_rad_s,
                    torque_n_m: window.error(Balance::Torque),
                    floor_n_m: window.floor(Balance::Torque),
                });
            }
        }
    }
    if let (Some((_, signal)), true) = (left_out.last(), found.is_empty()) {
        return Ok(Err(MapError::Missing(signal)));
    }
    if of == MappedTorque::Cogging {
        take_friction_out(&mut found, &bins);
    }
    let bins = bins.into_iter().map(|bin| filled(bin, &found)).collect();
    let map = TorqueMap { torque: of, bins };
    Ok(if map.known() == 0 { Err(MapError::Empty) } else { Ok(MeasuredMap { map, left_out }) })
}

fn grid(from: f64, to: f64, count: usize) -> Vec<MapBin> {
    let edge = |index: usize| from + (to - from) * index as f64 / count as f64;
    let bin =
        |index: usize| MapBin { from: edge(index), to: edge(index + 1), windows: 0, torque: None };
    (0..count).map(bin).collect()
}

/// Mean speed of a window in which it neither varies nor passes zero.
fn steady_speed(windows: &Windows<'_>, window: &Window, width: f64) -> Option<f64> {
    let own = &windows.scenario.speed_rad_s[windows.samples_of(window)];
    let mean = window.speed_rad_s;
    let (low, high) = extent(own.iter());
    let one_way = low * high > 0.0 && mean.abs() > windows.dead_zone_rad_s;
    let weights = windows.weights_of(window).mean;
    let variance: f64 = weights.iter().zip(own).map(|(w, value)| w * (value - mean).powi(2)).sum();
    (one_way && variance.sqrt() < STEADY_SHARE * width).then_some(mean)
}

/// Takes what depends on the speed out of torques over a turn: a line over the speed of each direction, fitted with the bins.
fn take_friction_out(found: &mut [WindowTorque], bins: &[MapBin]) {
    let width = bins[0].to - bins[0].from;
    let bin_of = |found: &WindowTorque| whole((found.place / width).floor()).min(bins.len() - 1);
    let lines = DMatrix::from_fn(found.len(), 4, |row, at| {
        let speed_rad_s = found[row].speed_rad_s;
        let is_own = (speed_rad_s < 0.0) == (at < 2);
        if is_own { [1.0, speed_rad_s][at % 2] } else { 0.0 }
    });
    let in_bin = |row: usize, bin| f64::from(u8::from(bin_of(&found[row]) == bin));
    let columns = DMatrix::from_fn(found.len(), bins.len(), in_bin);
    let torques = DVector::from_fn(found.len(), |row, _| found[row].torque_n_m);
    let wave = &columns * partial_regression(&lines, &columns, &torques).coefficients;
    let (inverse, _) = least_squares::inverse_where_determined(&lines);
    let friction = &lines * (inverse * lines.tr_mul(&(torques - wave)));
    for (found, friction) in found.iter_mut().zip(&friction) {
        found.torque_n_m -= friction;
    }
}

fn filled(bin: MapBin, found: &[WindowTorque]) -> MapBin {
    let inside = found.iter().filter(|found| found.place >= bin.from && found.place < bin.to);
    let inside: Vec<&WindowTorque> = inside.collect();
    let n = inside.len() as f64;
    let mean = |value: &dyn Fn(&WindowTorque) -> f64| {
        inside.iter().map(|found| value(found)).sum::<f64>() / n
    };
    let torque = (inside.len() >= FEWEST_WINDOWS).then(|| {
        let torque_n_m = mean(&|found| found.torque_n_m);
        let variance = mean(&|found| (found.torque_n_m - torque_n_m).powi(2)) * n / (n - 1.0);
        let floor = mean(&|found| found.floor_n_m.powi(2));
        let std = (variance.max(floor) * WINDOWS_EACH / n).sqrt();
        let half = std * student(n / WINDOWS_EACH - 1.0);
        MappedValue { torque_n_m, low_n_m: torque_n_m - half, high_n_m: torque_n_m + half }
    });
    MapBin { windows: inside.len(), torque, ..bin }
}

/// Half-width of the interval in standard deviations, with so many degrees of freedom (Student).
fn student(freedom: f64) -> f64 {
    let distribution = StudentsT::new(0.0, 1.0, freedom.max(1.0));
    distribution.map_or(f64::NAN, |it| it.inverse_cdf(0.5 * (1.0 + LEVEL)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{held, nameplate, truth as with_effect, with};
    use drivebench_model::plant::{MotorKey, testing};

    fn mapped(
        of: MappedTorque,
        truth: &Model,
        given: &Model,
        levels: &[f64],
        hold_s: f64,
    ) -> TorqueMap {
        let length_s = 0.5 + hold_s * levels.len() as f64;
        let run = testing::record(truth, held(levels, hold_s), 0.005, length_s, 3);
        let noise = NoiseFloor::from_spread(&run);
        let measured = torque_map(of, given, &[(run, noise)]).unwrap().unwrap();
        assert!(measured.left_out.is_empty());
        measured.map
    }

    #[test]
    fn friction_is_found_over_both_directions_without_being_in_the_model() {
        let truth = with_effect("viscous_friction", &[0.002]);
        // The model has another friction.
        let mut given = with_effect("quadratic_load", &[1e-5]);
        given.motor.set(MotorKey::LoadTorque, 0.1);
        let levels = [12.0, 24.0, 36.0, 0.0, -12.0, -24.0, -36.0, 0.0];
        let map = mapped(MappedTorque::Friction, &truth, &given, &levels, 0.8);
        assert!(map.known() >= 6, "{:?}", map.bins);
        for bin in &map.bins {
            let Some(torque) = bin.torque else {
                assert!(bin.windows < FEWEST_WINDOWS);
                continue;
            };
            let speed = bin.middle();
            let half_bin = 0.002 * 0.5 * (bin.to - bin.from);
            let expected = 0.455 * speed.signum() + 0.002 * speed;
            assert!((torque.torque_n_m - expected).abs() < 0.01 + half_bin, "{bin:?} {expected}");
            assert!(torque.low_n_m <= torque.torque_n_m && torque.torque_n_m <= torque.high_n_m);
        }
        assert!(map.known() < map.bins.len(), "not every speed was held");
    }

    #[test]
    fn cogging_over_a_turn_does_not_depend_on_the_friction_of_the_model() {
        // About 5 rad/s.
        let plain = cogging_of(&[("cogging", &[0.0, 0.1, 7.0])], &[3.2, -3.2]);
        // Friction that falls with the speed, which the cogging modulates.
        let falling = [("cogging", &[0.0, 0.1, 7.0][..]), ("stribeck_friction", &[0.16, 10.0])];
        let falling = cogging_of(&falling, &[3.7, -3.7]);
        for map in [plain, falling] {
            assert!(map.differ() > map.known() / 2, "{}", map.differ());
        }
    }

    fn cogging_of(truth: &[(&str, &[f64])], levels: &[f64]) -> TorqueMap {
        let map =
            mapped(MappedTorque::Cogging, &with(nameplate(), truth), &nameplate(), levels, 8.0);
        assert!(map.known() > BINS_PER_TURN / 2, "{}", map.known());
        let mut off = 0.0;
        for bin in &map.bins {
            if let Some(torque) = bin.torque {
                off += (torque.torque_n_m - 0.1 * (7.0 * bin.middle()).cos()).powi(2);
            }
        }
        let rms = (off / map.known() as f64).sqrt();
        assert!(rms < 0.03, "{rms}");
        map
    }
}
