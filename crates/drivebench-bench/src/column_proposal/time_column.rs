//! The column of the time: by its name, and by values that rise.

use std::collections::BTreeMap;

use super::Confidence;
use super::finding::{Doubt, Missing, Reason};
use super::known::{Factor, Quantity};
use super::reading::{Reading, UnitFrom};
use super::source::Source;
use crate::recording::{Preview, PreviewColumn};
use drivebench_identify::sanity::unit_of_stamps;
use drivebench_model::numerics::statistics::{finite, median, robust_deviation};

/// The steps from row to row of one column.
struct Steps {
    rising: f64,
    falling: f64,
    /// Median step from one row of the file to the next.
    step: f64,
    /// Robust deviation of the steps over their median.
    spread: f64,
    first: f64,
    is_whole: bool,
}

impl Steps {
    fn of(column: &PreviewColumn, stride: usize) -> Option<Self> {
        let values = finite(&column.numbers);
        if values.len() < 3 || 2 * values.len() < column.numbers.len() {
            return None;
        }
        let steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let share =
            |is: fn(&&f64) -> bool| steps.iter().filter(is).count() as f64 / steps.len() as f64;
        let middle = median(&steps);
        Some(Self {
            rising: share(|step| **step > 0.0),
            falling: share(|step| **step < 0.0),
            step: middle / stride as f64,
            spread: robust_deviation(&steps) / middle,
            first: values[0],
            is_whole: values.iter().all(|value| value.fract() == 0.0),
        })
    }

    /// Most steps rise and hardly any falls; a counter that rolls over falls now and then.
    fn is_of_a_clock(&self) -> bool {
        self.rising > 0.5 && self.falling < 0.02 && self.step > 0.0
    }
}

/// The time of the file; its values are s from the first row that is kept, a number that the file does not contain counted
/// as one.
pub(super) fn time_column(
    preview: &Preview,
    readings: &[Reading],
    given: &BTreeMap<String, f64>,
) -> Result<Source, Missing> {
    let mut time = found(preview, readings)?;
    time.factor = time.factor.filled(given);
    let column = &preview.columns[time.columns[0]];
    let numbers = column.numbers.iter();
    let first = numbers.clone().copied().find(|value| value.is_finite()).unwrap_or_default();
    time.values = numbers.map(|value| (value - first) * time.factor.value).collect();
    if column.is_clock {
        let date = preview.columns.iter().position(|other| other.is_date);
        time.columns.splice(0..0, date);
    }
    Ok(time)
}

fn found(preview: &Preview, readings: &[Reading]) -> Result<Source, Missing> {
    let steps_of = |column: usize| Steps::of(&preview.columns[column], preview.stride);
    let of = |quantity| readings.iter().filter(move |reading| reading.quantity == quantity);
    let mut named: Vec<(&Reading, Steps)> = of(Quantity::Time)
        .filter_map(|reading| Some((reading, steps_of(reading.column)?)))
        .filter(|(_, steps)| steps.is_of_a_clock())
        .collect();
    // The clock of the drive is more regular than that of a host; else the first column.
    let preference = |(reading, steps): &(&Reading, Steps)| {
        (!reading.is_named, reading.rank, steps.spread > 0.05, reading.column)
    };
    named.sort_by_key(preference);
    if let Some(((reading, steps), others)) = named.split_first() {
        let mut time = by_name(preview, reading, steps);
        if !others.is_empty() {
            let others = others.iter().map(|(other, _)| preview.headers[other.column].clone());
            time.reasons.push(Reason::OthersRise(others.collect()));
        }
        return Ok(time);
    }
    let is_clock = |column: usize| steps_of(column).is_some_and(|steps| steps.is_of_a_clock());
    if let Some(reading) = of(Quantity::Index).find(|reading| is_clock(reading.column)) {
        return Ok(by_count(preview, reading));
    }
    let is_free = |column: &usize| {
        let mut own = readings.iter().filter(|reading| reading.column == *column);
        own.all(|reading| reading.quantity == Quantity::Channel)
    };
    let named = (0..preview.headers.len()).filter(|column| !preview.headers[*column].is_empty());
    let mut clocks = named
        .filter(is_free)
        .filter_map(|column| Some((column, steps_of(column)?)))
        .filter(|(_, steps): &(usize, Steps)| steps.is_of_a_clock() && steps.spread < 0.5);
    if let Some((column, steps)) = clocks.next() {
        let mut time = Source::new(column, vec![Reason::NameUnknown, rises(&steps)]);
        time.doubts.push(Doubt::AnyRising);
        time.settle_unit(&steps);
        time.confidence = Confidence::Unsure;
        return Ok(time);
    }
    Err(of(Quantity::Time).find(|reading| reading.is_named).map_or(Missing::Time, |reading| {
        let header = preview.headers[reading.column].clone();
        match steps_of(reading.column) {
            None => Missing::TimeWithoutNumbers { header },
            Some(Steps { rising, falling, .. }) => Missing::NoClock { header, rising, falling },
        }
    }))
}

fn by_name(preview: &Preview, reading: &Reading, steps: &Steps) -> Source {
    let mut time = Source::new(reading.column, reading.reasons.clone());
    if preview.columns[reading.column].is_clock {
        time.reasons.push(Reason::Clocks);
        time.reasons.dedup();
        time.reasons.push(rises(steps));
        return time;
    }
    time.reasons.push(rises(steps));
    let Some(unit) = reading.unit.filter(|_| reading.unit_from == UnitFrom::Stated) else {
        time.settle_unit(steps);
        return time;
    };
    time.factor = reading.factor;
    time.reasons.push(Reason::Unit(unit.name));
    time.confidence = if reading.is_named { Confidence::Sure } else { Confidence::Likely };
    time
}

fn by_count(preview: &Preview, reading: &Reading) -> Source {
    let mut time = Source::new(reading.column, reading.reasons.clone());
    time.reasons.push(Reason::OnlyClock);
    // Below this header of an oscilloscope stands the period.
    let mut under = preview.headers.iter().zip(&preview.units);
    let period = under.find(|(header, _)| header.eq_ignore_ascii_case("increment"));
    if let Some(period) = period.and_then(|(_, cell)| cell.parse::<f64>().ok()) {
        time.reasons.push(Reason::Period(period));
        time.factor = Factor::of(period);
    } else {
        time.doubts.push(Doubt::Period);
        time.factor = Factor::ONE.times("PERIOD_S");
        time.confidence = Confidence::Likely;
    }
    time
}

fn rises(steps: &Steps) -> Reason {
    Reason::Rises { share: steps.rising, step: steps.step }
}

impl Source {
    /// The unit of a clock without one: stamps of an epoch by their size, others by a period that a log of a motor can have.
    fn settle_unit(&mut self, steps: &Steps) {
        // From the year 2000 on, in one row a second or more.
        let is_epoch = |factor: f64| (9.4e8..4.2e9).contains(&(steps.first * factor));
        let of_stamps = unit_of_stamps(steps.first, steps.step);
        let of_stamps = of_stamps.map(|unit| (unit.name, unit.factor.parse().unwrap_or(1.0)));
        let seconds = (is_epoch(1.0) && steps.step <= 1.0).then_some(("s since 1970", 1.0));
        if let Some((name, factor)) = of_stamps.or(seconds) {
            self.reasons.push(Reason::Stamps(name));
            self.factor = Factor::of(factor);
            let is_sure = is_epoch(factor) && factor <= 1.0;
            self.confidence = if is_sure { Confidence::Sure } else { Confidence::Likely };
            return;
        }
        let units = [("s", 1.0), ("ms", 1e-3), ("us", 1e-6)];
        let is_period = |factor: f64| (2e-5..=0.5).contains(&(steps.step * factor));
        let mut possible: Vec<(&'static str, f64)> =
            units.into_iter().filter(|(_, factor)| is_period(*factor)).collect();
        // A clock of whole numbers counts; one with fractions is in s.
        if steps.is_whole {
            possible.retain(|(unit, _)| *unit != "s");
        } else {
            possible.truncate(1);
        }
        let Some((unit, factor)) = possible.first().copied() else {
            self.doubts.push(Doubt::NoUsualPeriod { step: steps.step });
            self.confidence = Confidence::Unsure;
            return;
        };
        self.factor = Factor::of(factor);
        let period = |factor: f64| 1e3 * steps.step * factor;
        if possible.len() == 1 {
            self.reasons.push(Reason::UsualPeriod { unit, period_ms: period(factor) });
            self.confidence = Confidence::Likely;
        } else {
            let units = possible.into_iter().map(|(unit, factor)| (unit, period(factor)));
            self.doubts.push(Doubt::TimeUnit { units: units.collect() });
            self.confidence = Confidence::Unsure;
        }
    }
}

/// Rows at which the time rises, and is there.
pub(super) fn rising_rows(time_s: &[f64]) -> Vec<usize> {
    let mut last = f64::NEG_INFINITY;
    let is_later = |row: &usize| {
        let before = last;
        last = last.max(time_s[*row]);
        time_s[*row] > before
    };
    (0..time_s.len()).filter(is_later).collect()
}
