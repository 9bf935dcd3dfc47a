//! A measured torque as a table: friction over both directions of the speed, or cogging over a turn of the shaft.

use crate::tabulated;
use std::f64::consts::TAU;
use std::fmt::Write as _;

use serde::Serialize;

use super::effect::Axis;
use super::{ActiveEffect, Balance, Model, MotorKey};
use crate::numerics::count::whole;
use crate::numerics::statistics::largest;

/// Columns behind the axis.
const COLUMNS: &str = "torque_n_m,torque_low_n_m,torque_high_n_m,windows";

tabulated! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "snake_case")]
    pub enum MappedTorque {
        /// Everything that depends on the speed alone, over the speed.
        Friction = "friction",
        /// The part that depends on the angle and not on the current, over one turn.
        Cogging = "cogging",
    }
    pub const fn name(self) -> &'static str;
}

impl MappedTorque {
    /// Key and unit of the axis.
    pub const fn axis(self) -> (&'static str, &'static str) {
        match self {
            Self::Friction => ("speed_rad_s", "rad/s"),
            Self::Cogging => ("angle_rad", "rad"),
        }
    }

    /// Whether the torque contains this effect: a curve over its axis.
    pub fn holds(self, active: &ActiveEffect) -> bool {
        let axis = match self {
            Self::Friction => Axis::Speed,
            Self::Cogging => Axis::Angle,
        };
        active.effect.card().curve == Some((Balance::Torque, axis))
    }

    /// The model without the parts that the torque contains.
    pub fn taken_out_of(self, model: &Model) -> Model {
        let mut rest = model.clone();
        if self == Self::Friction {
            rest.motor.set(MotorKey::LoadTorque, 0.0);
        }
        rest.effects.retain(|active| !self.holds(active));
        rest
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MapBin {
    pub from: f64,
    pub to: f64,
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

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TorqueMap {
    pub torque: MappedTorque,
    /// Of even width, in ascending order; zero is an edge in a friction map.
    pub bins: Vec<MapBin>,
}

impl TorqueMap {
    pub fn known(&self) -> usize {
        self.bins.iter().filter(|bin| bin.torque.is_some()).count()
    }

    /// Bins whose torque is known not to be zero.
    pub fn differ(&self) -> usize {
        let known = self.bins.iter().filter_map(|bin| bin.torque);
        let differs = |it: &MappedValue| it.low_n_m > 0.0 || it.high_n_m < 0.0;
        known.filter(differs).count()
    }

    /// As CSV: a row for each bin at its middle, its cells empty where nothing was measured.
    pub fn to_csv(&self) -> String {
        let mut text = format!("{},{COLUMNS}\n", self.torque.axis().0);
        for bin in &self.bins {
            let torque = bin.torque.map_or_else(
                || ",,".to_owned(),
                |it| format!("{:?},{:?},{:?}", it.torque_n_m, it.low_n_m, it.high_n_m),
            );
            let _ = writeln!(text, "{:?},{torque},{}", bin.middle(), bin.windows);
        }
        text
    }

    /// What [`to_csv`](Self::to_csv) wrote.
    pub fn from_csv(text: &str) -> Result<Self, MapTextError> {
        let refused = |line: usize, found: &str, allowed| MapTextError {
            line,
            found: found.chars().take(80).collect(),
            allowed,
        };
        let mut lines = (1..).zip(text.lines());
        let header = lines.next().map_or("", |(_, line)| line.trim());
        let has_header = |torque: &MappedTorque| header == format!("{},{COLUMNS}", torque.axis().0);
        let torque = (MappedTorque::ALL.into_iter().find(has_header))
            .ok_or_else(|| refused(1, header, "the header of a friction or cogging map"))?;
        let mut rows = Vec::new();
        for (line, text) in lines.filter(|(_, text)| !text.trim().is_empty()) {
            rows.push((line, text, row(text).map_err(|allowed| refused(line, text, allowed))?));
            if rows.len() > 10_000 {
                return Err(refused(line, text, "at most 10000 bins"));
            }
        }
        let (first, width) = match rows.as_slice() {
            [(.., (first, ..)), (.., (second, ..)), ..] => (*first, second - first),
            _ => (f64::NAN, f64::NAN),
        };
        let mut bins = Vec::with_capacity(rows.len());
        for (index, (line, text, (middle, torque, windows))) in rows.into_iter().enumerate() {
            let even = first + width * index as f64;
            if !(width > 0.0 && (middle - even).abs() < 1e-3 * width) {
                return Err(refused(line, text, "rising bins of one width"));
            }
            bins.push(MapBin { from: even - 0.5 * width, to: even + 0.5 * width, windows, torque });
        }
        let turn = width * bins.len() as f64;
        let is_whole = match torque {
            MappedTorque::Friction => bins.len().is_multiple_of(2),
            MappedTorque::Cogging => (turn - TAU).abs() < 1e-3 * TAU,
        };
        if bins.len() < 2 || !is_whole {
            let found = format!("the end after {} bins", bins.len());
            let allowed = "as many bins on both sides of zero, or one whole turn";
            return Err(refused(bins.len() + 1, &found, allowed));
        }
        Ok(Self { torque, bins })
    }

    pub fn largest_n_m(&self) -> f64 {
        largest(self.bins.iter().filter_map(MapBin::value))
    }

    /// Linear interpolation between the middles of two bins; the value of the bin alone where its neighbour has none, or lies on
    /// the other side of zero speed. `None` in a bin without a value, outside the grid, and at zero speed (stiction).
    pub fn at(&self, abscissa: f64) -> Option<f64> {
        let count = self.bins.len();
        let (first, width) = (self.bins[0].from, self.bins[0].to - self.bins[0].from);
        let is_periodic = self.torque == MappedTorque::Cogging;
        let abscissa = if is_periodic { abscissa.rem_euclid(TAU) } else { abscissa };
        let bins = (abscissa - first) / width;
        let inside = is_periodic || (bins >= 0.0 && bins <= count as f64 && abscissa != 0.0);
        if !(inside && bins.is_finite()) {
            return None;
        }
        let index = whole(bins.floor()).min(count - 1);
        let value = self.bins[index].value()?;
        let off_middle = bins - index as f64 - 0.5;
        let step = if off_middle < 0.0 { -1 } else { 1 };
        let neighbour = match index.checked_add_signed(step) {
            Some(neighbour) if neighbour < count => Some(neighbour),
            _ if is_periodic => Some((index + count).wrapping_add_signed(step) % count),
            _ => None,
        };
        let neighbour = neighbour.map(|neighbour| self.bins[neighbour]);
        let usable = neighbour.filter(|bin| is_periodic || bin.middle() * abscissa > 0.0);
        let neighbour_value = usable.and_then(|bin| bin.value()).unwrap_or(value);
        Some(value + off_middle.abs() * (neighbour_value - value))
    }
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {found:?} is not allowed (expected {allowed})")]
pub struct MapTextError {
    line: usize,
    found: String,
    allowed: &'static str,
}

fn row(line: &str) -> Result<(f64, Option<MappedValue>, usize), &'static str> {
    const ALLOWED: &str = "a speed or angle, three torques or none, and a count";
    let cells: Vec<&str> = line.trim().split(',').collect();
    let [middle, torques @ .., windows] = cells.as_slice() else { return Err(ALLOWED) };
    let number = |cell: &str| {
        let value = cell.trim().parse().ok();
        value.filter(|value: &f64| value.is_finite()).ok_or(ALLOWED)
    };
    let torque = match torques {
        ["", "", ""] => None,
        [mean, low, high] => {
            let (torque_n_m, low_n_m, high_n_m) = (number(mean)?, number(low)?, number(high)?);
            if !(low_n_m <= torque_n_m && torque_n_m <= high_n_m) {
                return Err("a torque inside its interval");
            }
            Some(MappedValue { torque_n_m, low_n_m, high_n_m })
        }
        _ => return Err(ALLOWED),
    };
    Ok((number(middle)?, torque, windows.trim().parse().map_err(|_| ALLOWED)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    fn map(torque: MappedTorque, from: f64, to: f64, torques: [Option<f64>; 4]) -> TorqueMap {
        let width = 0.25 * (to - from);
        let bin = |(index, value): (usize, &Option<f64>)| MapBin {
            from: from + width * index as f64,
            to: from + width * (index + 1) as f64,
            windows: index,
            torque: value.map(|torque_n_m| MappedValue {
                torque_n_m,
                low_n_m: torque_n_m - 0.25,
                high_n_m: torque_n_m + 0.25,
            }),
        };
        let bins = torques.iter().enumerate().map(bin).collect();
        TorqueMap { torque, bins }
    }

    fn friction() -> TorqueMap {
        map(MappedTorque::Friction, -20.0, 20.0, [None, Some(-1.0), Some(1.0), Some(2.0)])
    }

    fn cogging() -> TorqueMap {
        map(MappedTorque::Cogging, 0.0, TAU, [1.0, 2.0, 3.0, 4.0].map(Some))
    }

    #[test]
    fn values_are_interpolated_between_bins_and_missing_elsewhere() {
        let (map, turn) = (friction(), cogging());
        for (map, place, value) in [
            (&map, 10.0, 1.5),
            (&map, 5.0, 1.0),
            (&map, 0.1, 1.0),
            (&map, -0.1, -1.0),
            (&map, -9.9, -1.0),
            (&map, 19.0, 2.0),
            (&turn, 0.0, 2.5),
            (&turn, TAU - 1e-9, 2.5),
            (&turn, -TAU * 0.125, 4.0),
        ] {
            let found = map.at(place).unwrap();
            assert!((found - value).abs() < 1e-6, "{place}: {found}");
        }
        for nothing in [0.0, -15.0, 20.1, -30.0, f64::NAN] {
            assert_eq!(map.at(nothing), None, "{nothing}");
        }
        assert_eq!((map.known(), map.differ(), map.largest_n_m()), (3, 3, 2.0));
    }

    #[test]
    fn a_written_map_reads_back_and_other_texts_are_refused() {
        for map in [friction(), cogging()] {
            let again = TorqueMap::from_csv(&map.to_csv()).unwrap();
            assert_eq!((again.torque, again.bins.len()), (map.torque, 4));
            for (read, written) in again.bins.iter().zip(&map.bins) {
                assert!((read.from - written.from).abs() < 1e-12);
                assert_eq!((read.torque, read.windows), (written.torque, written.windows));
            }
        }
        let good = friction().to_csv();
        for (from, to, words) in [
            (&good[..], "", "line 1: \"\""),
            ("speed_rad_s,", "time_s,", "header of a friction"),
            ("-5.0,", "-6.0,", "rising bins"),
            ("-1.0,-1.25", "1e999,-1.25", "line 3"),
            ("-1.0,-1.25", "-3.0,-1.25", "inside its interval"),
            ("\n15.0,2.0,1.75,2.25,3", "", "the end after 3 bins"),
            (",2.25,3", ",2.25,3,4", "three torques"),
        ] {
            let error = TorqueMap::from_csv(&good.replace(from, to)).unwrap_err();
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
