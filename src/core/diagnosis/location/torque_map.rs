//! A torque as a map over speed or angle, measured: friction over both directions, cogging over a turn of the shaft.
//!
//! ```text
//! model without the torque that is mapped --> windows: Kt <i> - J <dw/dt> - what the model keeps --> bins of a fixed grid
//!                                                                               mean, 95 % interval, windows of each
//! ```
//!
//! Nothing of the mapped torque's form is taken from the model; its Kt and J are, and an error of them scales what is found.
//! A bin without enough windows has no value.

use std::f64::consts::TAU;

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::axis::Search;
use super::windows::{FEWEST_HALF, Window, Windows, own_keys};
use crate::identification::noise::NoiseFloor;
use crate::identification::output_error::FitError;
use crate::numerics::count::whole;
use crate::numerics::statistics::{extent, largest};
use crate::plant::effect::Axis;
use crate::plant::{ActiveEffect, Balance, Model, MotorKey, Scenario};

/// Bins of each direction, and of a turn: 5 degrees.
const BINS_EACH_WAY: usize = 12;
const BINS_PER_TURN: usize = 72;
/// Windows without which a bin has no value.
const FEWEST_WINDOWS: usize = 4;
/// Neighbouring windows share half of their samples.
const WINDOWS_EACH: f64 = 2.0;
/// A window may turn through so much, rad: what it averages then is 95 % of a wave of seven periods per turn.
const MOST_TURN_RAD: f64 = 0.3;
/// Share of a bin by which the speed of a window may wander (a standard deviation).
const STEADY_SHARE: f64 = 0.5;
/// Two-sided level of the intervals.
const LEVEL: f64 = 0.95;

/// The torque that is mapped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MappedTorque {
    /// Everything that depends on the speed alone, over the speed.
    Friction,
    /// What the shaft's position asks for whatever the current is, over one turn.
    Cogging,
}

impl MappedTorque {
    pub const ALL: [Self; 2] = [Self::Friction, Self::Cogging];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Friction => "friction",
            Self::Cogging => "cogging",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|of| of.name() == name)
    }

    /// Key and unit of the axis.
    pub const fn axis(self) -> (&'static str, &'static str) {
        match self {
            Self::Friction => ("speed_rad_s", "rad/s"),
            Self::Cogging => ("angle_rad", "rad"),
        }
    }

    /// The model without it.
    fn taken_out_of(self, model: &Model) -> Model {
        let mut rest = model.clone();
        match self {
            Self::Friction => {
                rest.motor.set(MotorKey::LoadTorque, 0.0);
                let is_it = |active: &ActiveEffect| {
                    active.effect.card().curve == Some((Balance::Torque, Axis::Speed))
                };
                rest.effects.retain(|active| !is_it(active));
            }
            Self::Cogging => {
                let its = ["cogging", "eccentric_load"];
                rest.effects.retain(|active| !its.contains(&active.id()));
            }
        }
        rest
    }
}

/// One bin of the grid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MapBin {
    pub from: f64,
    pub to: f64,
    /// Windows in it.
    pub windows: usize,
    pub torque: Option<MappedValue>,
}

/// Mean torque against positive motion, N.m, with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MappedValue {
    pub torque_n_m: f64,
    pub low_n_m: f64,
    pub high_n_m: f64,
}

impl MapBin {
    pub fn middle(&self) -> f64 {
        0.5 * (self.from + self.to)
    }

    fn value(&self) -> Option<f64> {
        self.torque.map(|torque| torque.torque_n_m)
    }
}

/// A measured torque over an even grid.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TorqueMap {
    pub of: MappedTorque,
    /// Of even width, in the order of their places; those of a friction map meet at zero.
    pub bins: Vec<MapBin>,
    /// Windows that were not used: the shaft turned too far in them, or its speed was not steady.
    pub windows_left_out: usize,
}

impl TorqueMap {
    /// Bins that have a value.
    pub fn known(&self) -> usize {
        self.bins.iter().filter(|bin| bin.torque.is_some()).count()
    }

    /// Between the middles of two bins on their line, where one of them has no value what the place's own bin has; `None`
    /// where that has none, outside the grid, and at rest, where friction is what holds the shaft. Friction does not lead
    /// through zero: within the innermost bins it is theirs.
    pub fn at(&self, place: f64) -> Option<f64> {
        let count = self.bins.len();
        let (first, width) = (self.bins[0].from, self.bins[0].to - self.bins[0].from);
        let turns = self.of == MappedTorque::Cogging;
        let place = if turns { place.rem_euclid(TAU) } else { place };
        let along = (place - first) / width;
        let inside = turns || (along >= 0.0 && along <= count as f64 && place != 0.0);
        if !(inside && along.is_finite()) {
            return None;
        }
        let own = whole(along.floor()).min(count - 1);
        let here = self.bins[own].value()?;
        let off = along - own as f64 - 0.5;
        let towards = if off < 0.0 { -1 } else { 1 };
        let next = own.checked_add_signed(towards);
        let next = match next {
            Some(next) if next < count => Some(next),
            _ if turns => Some((own + count).wrapping_add_signed(towards) % count),
            _ => None,
        };
        let beyond = next.map(|next| self.bins[next]);
        let beyond = beyond.filter(|bin| turns || bin.middle() * place > 0.0);
        let there = beyond.and_then(|bin| bin.value()).unwrap_or(here);
        Some(here + off.abs() * (there - here))
    }
}

/// What stands in the way of a map.
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

/// A window's place on the axis, its torque and the deviation that noise alone gives to it.
struct Found {
    place: f64,
    torque_n_m: f64,
    floor_n_m: f64,
}

/// The map of a torque from runs with their noise, by the Kt, J and winding of a complete `model`.
pub fn torque_map(
    of: MappedTorque,
    model: &Model,
    runs: &[(Scenario, NoiseFloor)],
) -> Result<Result<TorqueMap, MapError>, FitError> {
    let rest = of.taken_out_of(model);
    let fastest = largest(
        runs.iter()
            .flat_map(|(run, _)| run.speed_rad_s.iter().copied()),
    );
    let bins = match of {
        MappedTorque::Friction => grid(-fastest, fastest, 2 * BINS_EACH_WAY),
        MappedTorque::Cogging => grid(0.0, TAU, BINS_PER_TURN),
    };
    let width = bins[0].to - bins[0].from;
    let mut found: Vec<Found> = Vec::new();
    let mut missing = None;
    let mut windows_left_out = 0;
    for (run, noise) in runs {
        let windows = Windows::new(&rest, run, noise, FEWEST_HALF)?;
        if let Some(signal) = windows.missing_signal() {
            missing = Some(signal);
            continue;
        }
        let search = Search {
            windows: &windows,
            equation: Balance::Torque,
            own: own_keys(Balance::Torque).len(),
        };
        let angle = match of {
            MappedTorque::Friction => Vec::new(),
            MappedTorque::Cogging => {
                let Some(angle) = search.angle_at_samples() else {
                    missing = Some("angle");
                    continue;
                };
                angle
            }
        };
        for window in windows.of(Balance::Torque) {
            let place = match of {
                MappedTorque::Friction => steady_speed(&windows, window, width),
                MappedTorque::Cogging => still_angle(&angle[windows.samples_of(window)]),
            };
            match place {
                Some(place) => found.push(Found {
                    place,
                    torque_n_m: window.error(Balance::Torque),
                    floor_n_m: window.floor(Balance::Torque),
                }),
                None => windows_left_out += 1,
            }
        }
    }
    if let Some(signal) = missing.filter(|_| found.is_empty()) {
        return Ok(Err(MapError::Missing(signal)));
    }
    let bins = bins.into_iter().map(|bin| filled(bin, &found)).collect();
    let map = TorqueMap {
        of,
        bins,
        windows_left_out,
    };
    Ok(if map.known() == 0 {
        Err(MapError::Empty)
    } else {
        Ok(map)
    })
}

fn grid(from: f64, to: f64, count: usize) -> Vec<MapBin> {
    let edge = |index: usize| from + (to - from) * index as f64 / count as f64;
    let bin = |index: usize| MapBin {
        from: edge(index),
        to: edge(index + 1),
        windows: 0,
        torque: None,
    };
    (0..count).map(bin).collect()
}

/// Mean speed of a window in which it neither wanders nor passes zero.
fn steady_speed(windows: &Windows<'_>, window: &Window, width: f64) -> Option<f64> {
    let own = &windows.scenario.speed_rad_s[windows.samples_of(window)];
    let mean = window.speed_rad_s;
    let (low, high) = extent(own.iter());
    let one_way = low * high > 0.0 && mean.abs() > windows.dead_zone_rad_s;
    let weights = windows.weights_of(window).mean;
    let squares = weights.iter().zip(own);
    let variance: f64 = squares.map(|(w, value)| w * (value - mean).powi(2)).sum();
    (one_way && variance.sqrt() < STEADY_SHARE * width).then_some(mean)
}

/// Middle angle within a turn of a window in which the shaft turns little, one way.
fn still_angle(own: &[f64]) -> Option<f64> {
    let (low, high) = extent(own.iter());
    (high - low < MOST_TURN_RAD).then(|| own[own.len() / 2].rem_euclid(TAU))
}

fn filled(bin: MapBin, found: &[Found]) -> MapBin {
    let inside = found.iter();
    let inside = inside.filter(|found| found.place >= bin.from && found.place < bin.to);
    let inside: Vec<&Found> = inside.collect();
    let n = inside.len() as f64;
    let mean =
        |value: &dyn Fn(&Found) -> f64| inside.iter().map(|found| value(found)).sum::<f64>() / n;
    let torque = (inside.len() >= FEWEST_WINDOWS).then(|| {
        let torque_n_m = mean(&|found| found.torque_n_m);
        let variance = mean(&|found| (found.torque_n_m - torque_n_m).powi(2)) * n / (n - 1.0);
        let floor = mean(&|found| found.floor_n_m.powi(2));
        let std = (variance.max(floor) * WINDOWS_EACH / n).sqrt();
        let half = std * student(n / WINDOWS_EACH - 1.0);
        MappedValue {
            torque_n_m,
            low_n_m: torque_n_m - half,
            high_n_m: torque_n_m + half,
        }
    });
    MapBin {
        windows: inside.len(),
        torque,
        ..bin
    }
}

/// Standard deviations to either side that hold the level with so many degrees of freedom.
fn student(freedom: f64) -> f64 {
    let distribution = StudentsT::new(0.0, 1.0, freedom.max(1.0));
    distribution.map_or(f64::NAN, |it| it.inverse_cdf(0.5 * (1.0 + LEVEL)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::testing;
    use crate::plant::{Motor, effect};

    fn model(effects: &[(&str, &[f64])]) -> Model {
        let mut model = Model::baseline(Motor::zk_22fc());
        for (id, values) in effects {
            let found = effect::find(id).unwrap();
            model.effects.push(ActiveEffect::with(found, values));
        }
        model
    }

    fn mapped(
        of: MappedTorque,
        truth: &Model,
        given: &Model,
        levels: &[f64],
        hold_s: f64,
    ) -> TorqueMap {
        let hold = levels.iter().enumerate();
        let hold = hold.map(|(step, level)| (0.1 + hold_s * step as f64, *level));
        let events = std::iter::once((0.0, 0.0)).chain(hold).collect();
        let length_s = 0.1 + hold_s * levels.len() as f64;
        let run = testing::record(truth, events, 0.005, length_s, 3);
        let noise = NoiseFloor::from_spread(&run);
        torque_map(of, given, &[(run, noise)]).unwrap().unwrap()
    }

    #[test]
    fn friction_is_found_over_both_directions_without_being_in_the_model() {
        let truth = model(&[("viscous_friction", &[0.002])]);
        // The model believes in another friction altogether.
        let mut given = model(&[("quadratic_load", &[1e-5])]);
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
            assert!(
                (torque.torque_n_m - expected).abs() < 0.01 + half_bin,
                "{bin:?} {expected}"
            );
            assert!(torque.low_n_m <= torque.torque_n_m && torque.torque_n_m <= torque.high_n_m);
        }
        assert!(map.known() < map.bins.len(), "not every speed was held");
    }

    #[test]
    fn cogging_is_found_over_a_turn() {
        let truth = model(&[("cogging", &[0.0, 0.1, 7.0])]);
        // About 5 rad/s.
        let levels = [3.2, -3.2];
        let map = mapped(MappedTorque::Cogging, &truth, &model(&[]), &levels, 8.0);
        assert!(map.known() > BINS_PER_TURN / 2, "{}", map.known());
        let mut off = 0.0;
        for bin in &map.bins {
            if let Some(torque) = bin.torque {
                off += (torque.torque_n_m - 0.1 * (7.0 * bin.middle()).cos()).powi(2);
            }
        }
        let rms = (off / map.known() as f64).sqrt();
        assert!(rms < 0.03, "{rms}");
    }

    #[test]
    fn between_bins_it_is_a_line_and_where_nothing_was_measured_nothing() {
        let mut map = TorqueMap {
            of: MappedTorque::Friction,
            bins: grid(-20.0, 20.0, 4),
            windows_left_out: 0,
        };
        for (bin, value) in map
            .bins
            .iter_mut()
            .zip([None, Some(-1.0), Some(1.0), Some(2.0)])
        {
            bin.torque = value.map(|torque_n_m| MappedValue {
                torque_n_m,
                low_n_m: 0.0,
                high_n_m: 0.0,
            });
        }
        let near = |place, value: f64| {
            let found: f64 = map.at(place).unwrap();
            assert!((found - value).abs() < 1e-12, "{place}: {found}");
        };
        near(10.0, 1.5);
        near(5.0, 1.0);
        near(0.1, 1.0);
        near(-0.1, -1.0);
        near(-9.9, -1.0);
        near(19.0, 2.0);
        for nothing in [0.0, -15.0, 20.1, -30.0, f64::NAN] {
            assert_eq!(map.at(nothing), None, "{nothing}");
        }
        let mut turn = TorqueMap {
            of: MappedTorque::Cogging,
            bins: grid(0.0, TAU, 4),
            windows_left_out: 0,
        };
        for (bin, torque_n_m) in turn.bins.iter_mut().zip([1.0, 2.0, 3.0, 4.0]) {
            bin.torque = Some(MappedValue {
                torque_n_m,
                low_n_m: 0.0,
                high_n_m: 0.0,
            });
        }
        assert!((turn.at(0.0).unwrap() - 2.5).abs() < 1e-12);
        assert!((turn.at(TAU - 1e-9).unwrap() - 2.5).abs() < 1e-6);
        assert!((turn.at(-TAU * 0.125).unwrap() - 4.0).abs() < 1e-12);
    }
}
