//! The speed reference of a closed-loop run: a piecewise linear function of time.
//!
//! ```text
//! [[speed.reference]] parts --check--> Reference: value_at(t), steps(): the jumps to a level that then holds
//! ```

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The longest run, s: a day.
const LONGEST_S: f64 = 86_400.0;

/// One part of a reference, as it stands in a bench file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum ReferencePart {
    Constant {
        speed_rad_s: f64,
        seconds: f64,
    },
    /// In the order in which they come.
    Steps {
        levels_rad_s: Vec<f64>,
        hold_s: f64,
    },
    /// Begins with the high level.
    Square {
        low_rad_s: f64,
        high_rad_s: f64,
        half_period_s: f64,
        periods: u32,
    },
    Ramp {
        from_rad_s: f64,
        to_rad_s: f64,
        seconds: f64,
    },
    /// Corners `[time_s, speed_rad_s]`; times since the part's begin, the first of them 0.
    Polyline {
        points: Vec<[f64; 2]>,
    },
}

#[derive(Clone, Debug, Error, PartialEq)]
#[error(
    "speed.reference part {number} ({kind}): {key} = {value} is not allowed (expected {allowed})"
)]
pub struct ReferenceError {
    /// Position in the list, from 1.
    pub number: usize,
    pub kind: &'static str,
    pub key: &'static str,
    pub value: f64,
    pub allowed: String,
}

/// A straight line; the end belongs to the next one.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Line {
    end_s: f64,
    from: f64,
    to: f64,
}

/// A jump of the reference to a level that then holds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ReferenceStep {
    pub at_s: f64,
    pub until_s: f64,
    pub from_rad_s: f64,
    pub to_rad_s: f64,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reference {
    lines: Vec<Line>,
    /// Name and end of each part.
    parts: Vec<(String, f64)>,
    /// Begin and end of each pass over the whole list.
    passes: Vec<(f64, f64)>,
}

impl ReferencePart {
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Constant { .. } => "constant",
            Self::Steps { .. } => "steps",
            Self::Square { .. } => "square",
            Self::Ramp { .. } => "ramp",
            Self::Polyline { .. } => "polyline",
        }
    }

    /// Its speeds, with their keys.
    fn speeds(&self) -> Vec<(&'static str, f64)> {
        match self {
            Self::Constant { speed_rad_s, .. } => vec![("speed_rad_s", *speed_rad_s)],
            Self::Steps { levels_rad_s, .. } => {
                levels_rad_s.iter().map(|level| ("levels_rad_s", *level)).collect()
            }
            Self::Square { low_rad_s, high_rad_s, .. } => {
                vec![("low_rad_s", *low_rad_s), ("high_rad_s", *high_rad_s)]
            }
            Self::Ramp { from_rad_s, to_rad_s, .. } => {
                vec![("from_rad_s", *from_rad_s), ("to_rad_s", *to_rad_s)]
            }
            Self::Polyline { points } => points.iter().map(|point| ("points", point[1])).collect(),
        }
    }

    /// The first value that is not allowed, whatever the motor: `(key, value, allowed)`.
    fn refused(&self) -> Option<(&'static str, f64, &'static str)> {
        let time = |key, value: f64| {
            let is_allowed = value > 0.0 && value <= LONGEST_S;
            (!is_allowed).then_some((key, value, "more than 0 s, up to 86400 s"))
        };
        let count = |key, number: usize, least: usize| {
            let is_allowed = (least..=10_000).contains(&number);
            (!is_allowed).then_some((key, number as f64, "enough of them, at most 10000"))
        };
        let mut speeds = self.speeds().into_iter();
        if let Some((key, value)) = speeds.find(|(_, speed)| !speed.is_finite()) {
            return Some((key, value, "a finite number"));
        }
        match self {
            Self::Constant { seconds, .. } | Self::Ramp { seconds, .. } => {
                time("seconds", *seconds)
            }
            Self::Steps { levels_rad_s, hold_s } => {
                count("number of levels_rad_s", levels_rad_s.len(), 1)
                    .or_else(|| time("hold_s", *hold_s))
            }
            Self::Square { half_period_s, periods, .. } => time("half_period_s", *half_period_s)
                .or_else(|| count("periods", *periods as usize, 1)),
            Self::Polyline { points } => {
                let start = points.first().map_or(0.0, |first| first[0]);
                let is_back = |pair: &&[[f64; 2]]| pair[1][0].is_nan() || pair[1][0] <= pair[0][0];
                let back = points.windows(2).find(is_back);
                let last = points.last().map_or(0.0, |last| last[0]);
                count("number of points", points.len(), 2)
                    .or_else(|| (start != 0.0).then_some(("points", start, "0 as the first time")))
                    .or_else(|| back.map(|pair| ("points", pair[1][0], "times that grow")))
                    .or_else(|| time("points", last))
            }
        }
    }

    /// Lines `(length, from, to)`.
    fn lines(&self) -> Vec<(f64, f64, f64)> {
        let level_for = |level: &f64, seconds: f64| (seconds, *level, *level);
        match self {
            Self::Constant { speed_rad_s, seconds } => vec![level_for(speed_rad_s, *seconds)],
            Self::Steps { levels_rad_s, hold_s } => {
                levels_rad_s.iter().map(|level| level_for(level, *hold_s)).collect()
            }
            Self::Square { low_rad_s, high_rad_s, half_period_s, periods } => {
                let period = [high_rad_s, low_rad_s].map(|level| level_for(level, *half_period_s));
                period.repeat(*periods as usize)
            }
            Self::Ramp { from_rad_s, to_rad_s, seconds } => {
                vec![(*seconds, *from_rad_s, *to_rad_s)]
            }
            Self::Polyline { points } => {
                let line = |pair: &[[f64; 2]]| (pair[1][0] - pair[0][0], pair[0][1], pair[1][1]);
                points.windows(2).map(line).collect()
            }
        }
    }
}

impl Reference {
    /// # Errors
    /// The first value of the parts that is not allowed, or a speed beyond `limit_rad_s`, which `limit_is` names.
    pub fn new(
        parts: &[ReferencePart],
        limit_rad_s: f64,
        limit_is: &str,
    ) -> Result<Self, ReferenceError> {
        let mut reference = Self::default();
        let mut end_s = 0.0;
        for (index, part) in parts.iter().enumerate() {
            let refuse = |key, value, allowed| ReferenceError {
                number: index + 1,
                kind: part.kind(),
                key,
                value,
                allowed,
            };
            if let Some((key, value, allowed)) = part.refused() {
                return Err(refuse(key, value, allowed.to_owned()));
            }
            let mut speeds = part.speeds().into_iter();
            if let Some((key, speed)) = speeds.find(|(_, speed)| speed.abs() > limit_rad_s) {
                let allowed = format!("-{limit_rad_s:.4} to {limit_rad_s:.4} rad/s: {limit_is}");
                return Err(refuse(key, speed, allowed));
            }
            for (seconds, from, to) in part.lines() {
                end_s += seconds;
                reference.lines.push(Line { end_s, from, to });
            }
            let earlier = parts[..index].iter();
            let name = match earlier.filter(|other| other.kind() == part.kind()).count() {
                0 => part.kind().to_owned(),
                n => format!("{} {}", part.kind(), n + 1),
            };
            reference.parts.push((name, end_s));
        }
        if !(end_s > 0.0 && end_s <= LONGEST_S) {
            return Err(ReferenceError {
                number: parts.len(),
                kind: parts.last().map_or("none", ReferencePart::kind),
                key: "length of the whole reference",
                value: end_s,
                allowed: "more than 0 s, up to 86400 s".to_owned(),
            });
        }
        reference.passes.push((0.0, end_s));
        Ok(reference)
    }

    /// `times` passes, each after `lead_in_s` at the first level.
    #[must_use]
    pub fn repeated(&self, times: usize, lead_in_s: f64) -> Self {
        let mut all = Self::default();
        let first = self.value_at(0.0);
        let mut now_s = 0.0;
        for pass in 1..=times {
            now_s += lead_in_s;
            all.lines.push(Line { end_s: now_s, from: first, to: first });
            all.parts.push((format!("lead-in, pass {pass}"), now_s));
            let later = |line: &Line| Line { end_s: now_s + line.end_s, ..*line };
            all.lines.extend(self.lines.iter().map(later));
            let named =
                |(name, end_s): &(String, f64)| (format!("{name}, pass {pass}"), now_s + end_s);
            all.parts.extend(self.parts.iter().map(named));
            all.passes.push((now_s, now_s + self.duration_s()));
            now_s += self.duration_s();
        }
        all
    }

    /// Begin and end of each pass over the list, s; a lead-in belongs to none.
    pub fn passes(&self) -> &[(f64, f64)] {
        &self.passes
    }

    /// The pass at `time_s`; its lead-in counts as its own.
    pub fn pass_at(&self, time_s: f64) -> usize {
        let after = self.passes.partition_point(|(_, end_s)| *end_s <= time_s);
        after.min(self.passes.len().saturating_sub(1))
    }

    pub fn duration_s(&self) -> f64 {
        self.lines.last().map_or(0.0, |line| line.end_s)
    }

    /// The reference at `time_s`, rad/s; before the beginning as at it, from the end on as at the end.
    pub fn value_at(&self, time_s: f64) -> f64 {
        let after = self.lines.partition_point(|line| line.end_s <= time_s);
        let Some(line) = self.lines.get(after) else {
            return self.lines.last().map_or(0.0, |line| line.to);
        };
        let start_s = self.start_of(after);
        let share = ((time_s - start_s) / (line.end_s - start_s)).clamp(0.0, 1.0);
        line.from + share * (line.to - line.from)
    }

    pub fn peak_rad_s(&self) -> f64 {
        let ends = self.lines.iter().flat_map(|line| [line.from, line.to]);
        ends.fold(0.0, |peak, speed| speed.abs().max(peak))
    }

    /// The largest speed backwards, rad/s; `None`: it goes one way only.
    pub fn reverse_rad_s(&self) -> Option<f64> {
        let ends = self.lines.iter().flat_map(|line| [line.from, line.to]);
        Some(ends.fold(0.0, f64::min)).filter(|least| *least < 0.0)
    }

    pub fn part_at(&self, time_s: f64) -> usize {
        let after = self.parts.partition_point(|(_, end_s)| *end_s <= time_s);
        after.min(self.parts.len().saturating_sub(1))
    }

    pub fn part_name(&self, index: usize) -> &str {
        self.parts.get(index).map_or("", |(name, _)| name)
    }

    /// The jumps to levels that then hold; the run begins at rest.
    pub fn steps(&self) -> Vec<ReferenceStep> {
        let mut steps: Vec<ReferenceStep> = Vec::new();
        let mut before = 0.0;
        for (index, line) in self.lines.iter().enumerate() {
            let is_level = (line.to - line.from).abs() <= f64::EPSILON * line.from.abs();
            let jumps = (line.from - before).abs() > 0.0;
            if is_level && jumps {
                steps.push(ReferenceStep {
                    at_s: self.start_of(index),
                    until_s: line.end_s,
                    from_rad_s: before,
                    to_rad_s: line.to,
                });
            } else if let Some(last) = steps.last_mut()
                && is_level
                && (last.until_s - self.start_of(index)).abs() < f64::EPSILON * last.until_s
            {
                // The same level goes on.
                last.until_s = line.end_s;
            }
            before = line.to;
        }
        steps
    }

    fn start_of(&self, index: usize) -> f64 {
        let before = index.checked_sub(1);
        before.map_or(0.0, |before| self.lines[before].end_s)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::testing::{has, near};

    /// A part as it stands in a bench file.
    fn part(kind: &str, keys: &str) -> ReferencePart {
        let text = format!("part.{kind} = {{ {keys} }}");
        let file: BTreeMap<String, ReferencePart> = toml::from_str(&text).unwrap();
        file["part"].clone()
    }

    fn parts() -> Vec<ReferencePart> {
        let square = "low_rad_s = -10.0, high_rad_s = 10.0, half_period_s = 0.5, periods = 2";
        vec![
            part("constant", "speed_rad_s = 50.0, seconds = 1.0"),
            part("constant", "speed_rad_s = 50.0, seconds = 1.0"),
            part("square", square),
            part("ramp", "from_rad_s = -10.0, to_rad_s = 30.0, seconds = 4.0"),
            part("polyline", "points = [[0.0, 30.0], [1.0, 30.0], [3.0, 0.0]]"),
            part("steps", "levels_rad_s = [5.0, 6.0], hold_s = 1.0"),
        ]
    }

    #[test]
    fn values_parts_and_steps_are_those_of_the_list() {
        let reference = Reference::new(&parts(), 100.0, "limits").unwrap();
        for (time_s, expected) in [
            (-1.0, 50.0),
            (0.0, 50.0),
            (1.99, 50.0),
            (2.0, 10.0),
            (2.5, -10.0),
            (3.99, -10.0),
            (5.0, 0.0),
            (8.5, 30.0),
            (10.0, 15.0),
            (11.0, 5.0),
            (12.5, 6.0),
            (99.0, 6.0),
        ] {
            near(reference.value_at(time_s), expected, 1e-9);
        }
        near(reference.duration_s(), 13.0, 1e-12);
        near(reference.peak_rad_s(), 50.0, 1e-12);
        assert_eq!(reference.part_name(reference.part_at(1.5)), "constant 2");
        assert_eq!(reference.part_name(reference.part_at(99.0)), "steps");
        let steps = reference.steps().into_iter();
        let steps = steps.map(|step| [step.at_s, step.until_s, step.from_rad_s, step.to_rad_s]);
        let found: Vec<[f64; 4]> = steps.collect();
        assert_eq!(
            found,
            [
                [0.0, 2.0, 0.0, 50.0],
                [2.0, 2.5, 50.0, 10.0],
                [2.5, 3.0, 10.0, -10.0],
                [3.0, 3.5, -10.0, 10.0],
                [3.5, 4.0, 10.0, -10.0],
                [11.0, 12.0, 0.0, 5.0],
                [12.0, 13.0, 5.0, 6.0],
            ]
        );
    }

    #[test]
    fn a_value_that_makes_no_reference_is_named_with_its_part() {
        let refused = |part: ReferencePart| {
            let list = [parts()[0].clone(), part];
            let error = Reference::new(&list, 100.0, "limits.speed_rad_s").unwrap_err();
            assert_eq!(error.number, 2);
            error.to_string()
        };
        let beyond = "part 2 (constant): speed_rad_s = 120 is not allowed (expected -100.0000 to 100.0000 rad/s: limits.speed_rad_s)";
        let back = "points = 1 is not allowed (expected times that grow)";
        let ramp = "from_rad_s = 0.0, to_rad_s = 1.0, seconds = 0.0";
        let square = "low_rad_s = 0.0, high_rad_s = 1.0, half_period_s = 1.0, periods = 0";
        let corners = "points = [[0.0, 0.0], [1.0, 0.0], [1.0, 5.0]]";
        let late = "points = [[0.5, 0.0], [1.0, 0.0]]";
        let none = "levels_rad_s = [], hold_s = 1.0";
        for (kind, keys, expected) in [
            ("constant", "speed_rad_s = 120.0, seconds = 1.0", beyond),
            ("constant", "speed_rad_s = nan, seconds = 1.0", "speed_rad_s = NaN"),
            ("ramp", ramp, "seconds = 0"),
            ("steps", none, "number of levels_rad_s = 0"),
            ("square", square, "periods = 0"),
            ("polyline", corners, back),
            ("polyline", late, "points = 0.5"),
        ] {
            has(refused(part(kind, keys)), expected);
        }
        assert!(Reference::new(&[], 100.0, "limits").is_err());
    }
}
