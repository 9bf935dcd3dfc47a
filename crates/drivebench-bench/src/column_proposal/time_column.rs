//! The column of the time: by its name, and by values that rise.

use super::Confidence;
use super::known::{Factor, Quantity};
use super::reading::{Reading, UnitFrom};
use crate::recording::{Preview, PreviewColumn};
use drivebench_model::numerics::statistics::{finite, median, robust_deviation};
use drivebench_model::text::number::{percent, shortest};

pub(super) struct TimeColumn {
    pub column: usize,
    /// The column of the date, where the clock has none.
    pub date: Option<usize>,
    pub factor: Factor,
    pub confidence: Confidence,
    pub reasons: Vec<String>,
    pub doubts: Vec<String>,
    /// The stamps of the rows that are kept, s from the first; a hole counts as one.
    pub time_s: Vec<f64>,
}

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
        let share = |is: fn(&f64) -> bool| {
            steps.iter().copied().filter(is).count() as f64 / steps.len() as f64
        };
        let middle = median(&steps);
        Some(Self {
            rising: share(|step| *step > 0.0),
            falling: share(|step| *step < 0.0),
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

/// The time of the file, or what is missing.
pub(super) fn time_column(preview: &Preview, readings: &[Reading]) -> Result<TimeColumn, String> {
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
    if let Some((reading, steps)) = named.first() {
        let others: Vec<&str> =
            named[1..].iter().map(|(other, _)| &*preview.headers[other.column]).collect();
        return Ok(by_name(preview, reading, steps, &others));
    }
    let fails = of(Quantity::Time).filter(|reading| reading.is_named).find_map(|reading| {
        let header = &preview.headers[reading.column];
        match steps_of(reading.column) {
            None => Some(format!("{header:?} holds no numbers")),
            Some(steps) if !steps.is_of_a_clock() => Some(format!(
                "{header:?} is no clock: {} of its steps rise and {} fall",
                percent(100.0 * steps.rising),
                percent(100.0 * steps.falling)
            )),
            Some(_) => None,
        }
    });
    if let Some(reading) = of(Quantity::Index)
        .find(|reading| steps_of(reading.column).is_some_and(|steps| steps.is_of_a_clock()))
    {
        return Ok(by_count(preview, reading));
    }
    let is_free = |column: &usize| {
        readings.iter().all(|reading| {
            reading.column != *column || matches!(reading.quantity, Quantity::Channel)
        })
    };
    let rises = |column: &usize| {
        steps_of(*column).is_some_and(|steps| steps.is_of_a_clock() && steps.spread < 0.5)
    };
    let is_named = |column: &usize| !preview.headers[*column].is_empty();
    let mut columns = (0..preview.headers.len()).filter(is_named);
    let found = columns.find(|column| is_free(column) && rises(column));
    match (found, fails) {
        (Some(column), _) => Ok(by_content(preview, column, steps_of(column).as_ref())),
        (None, Some(fails)) => Err(format!("a time ({fails})")),
        (None, None) => {
            Err("a time (no column has its name, and none rises from row to row)".into())
        }
    }
}

fn by_name(preview: &Preview, reading: &Reading, steps: &Steps, others: &[&str]) -> TimeColumn {
    let mut reasons = vec![reading.reason.clone(), rises(steps)];
    let mut doubts = Vec::new();
    let (factor, confidence) = match reading.unit_from {
        _ if preview.columns[reading.column].is_clock => {
            reasons.push("its cells are clocks, which are read as seconds".to_owned());
            (Factor::Known(1.0), Confidence::Sure)
        }
        UnitFrom::Stated => {
            reasons.push(format!("its unit is {}", reading.unit));
            let confidence = if reading.is_named { Confidence::Sure } else { Confidence::Likely };
            (reading.factor.clone(), confidence)
        }
        _ => unit_by_values(steps, &mut reasons, &mut doubts),
    };
    if !others.is_empty() {
        reasons.push(format!("{} rises too", others.join(", ")));
    }
    column_of(preview, reading.column, factor, confidence, (reasons, doubts))
}

fn by_count(preview: &Preview, reading: &Reading) -> TimeColumn {
    let mut reasons = vec![reading.reason.clone(), "no other column is a clock".to_owned()];
    // Below this header of an oscilloscope stands the period.
    let mut under = preview.headers.iter().zip(&preview.units);
    let period = under.find(|(header, _)| header.eq_ignore_ascii_case("increment"));
    if let Some(period) = period.and_then(|(_, cell)| cell.parse::<f64>().ok()) {
        reasons.push(format!("{period} s pass from row to row, as the row of units says"));
        let factor = Factor::Known(period);
        let parts = (reasons, Vec::new());
        return column_of(preview, reading.column, factor, Confidence::Sure, parts);
    }
    let doubts = vec!["the time from row to row does not stand in the file".to_owned()];
    let factor = Factor::Hole("PERIOD_S".to_owned());
    column_of(preview, reading.column, factor, Confidence::Likely, (reasons, doubts))
}

fn by_content(preview: &Preview, column: usize, steps: Option<&Steps>) -> TimeColumn {
    let mut reasons = vec!["its name is unknown".to_owned()];
    let mut doubts = vec!["it may be any quantity that rises".to_owned()];
    let mut factor = Factor::Known(1.0);
    if let Some(steps) = steps {
        reasons.push(rises(steps));
        factor = unit_by_values(steps, &mut reasons, &mut doubts).0;
    }
    column_of(preview, column, factor, Confidence::Unsure, (reasons, doubts))
}

fn rises(steps: &Steps) -> String {
    format!(
        "it rises in {} of the rows, by {} as a rule",
        percent(100.0 * steps.rising),
        shortest(steps.step, 4)
    )
}

/// The unit of a clock without one: stamps of an epoch by their size, others by a period that a log of a motor can have.
fn unit_by_values(
    steps: &Steps,
    reasons: &mut Vec<String>,
    doubts: &mut Vec<String>,
) -> (Factor, Confidence) {
    // Seconds since 1970 of the years from 2001 to 2033.
    let epochs = [(1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns")];
    let epoch = epochs.iter().find(|(factor, _)| (1e9..2e9).contains(&(steps.first * factor)));
    if let Some((factor, unit)) = epoch {
        reasons.push(format!("its values are {unit} since 1970"));
        return (Factor::Known(*factor), Confidence::Sure);
    }
    // From 1982 to 2064, with fractions.
    if (30_000.0..60_000.0).contains(&steps.first) && !steps.is_whole && steps.step < 1e-3 {
        reasons.push("its values are the days of a spreadsheet".to_owned());
        return (Factor::Known(86_400.0), Confidence::Likely);
    }
    let is_period = |factor: f64| (2e-5..=0.5).contains(&(steps.step * factor));
    let mut possible: Vec<(f64, &str)> =
        epochs[..3].iter().copied().filter(|(factor, _)| is_period(*factor)).collect();
    // A clock of whole numbers counts; one with fractions is in s.
    if steps.is_whole {
        possible.retain(|(_, unit)| *unit != "s");
    } else {
        possible.truncate(1);
    }
    match possible.as_slice() {
        [] => {
            doubts.push(format!(
                "no unit is written, and steps of {} are no usual period in s, ms or us",
                shortest(steps.step, 4)
            ));
            (Factor::Known(1.0), Confidence::Unsure)
        }
        [(factor, unit)] => {
            let period = shortest(1e3 * steps.step * factor, 4);
            reasons.push(format!("no unit is written; in {unit} its period is {period} ms"));
            (Factor::Known(*factor), Confidence::Likely)
        }
        [(factor, unit), others @ ..] => {
            let period = shortest(1e3 * steps.step * factor, 4);
            let others: Vec<String> = others
                .iter()
                .map(|(factor, unit)| {
                    format!("{unit} ({} ms)", shortest(1e3 * steps.step * factor, 4))
                })
                .collect();
            doubts.push(format!(
                "no unit is written: taken as {unit} (a period of {period} ms), and {} is as usual",
                others.join(", ")
            ));
            (Factor::Known(*factor), Confidence::Unsure)
        }
    }
}

fn column_of(
    preview: &Preview,
    column: usize,
    factor: Factor,
    confidence: Confidence,
    (reasons, doubts): (Vec<String>, Vec<String>),
) -> TimeColumn {
    let scale = match factor {
        Factor::Known(factor) => factor,
        Factor::Hole(_) => 1.0,
    };
    let numbers = &preview.columns[column].numbers;
    let first = numbers.iter().copied().find(|value| value.is_finite()).unwrap_or_default();
    let time_s = numbers.iter().map(|value| (value - first) * scale).collect();
    let is_clock = preview.columns[column].is_clock;
    let date = preview.columns.iter().position(|other| other.is_date).filter(|_| is_clock);
    TimeColumn { column, date, factor, confidence, reasons, doubts, time_s }
}

/// Rows at which the time rises, and is there.
pub(super) fn rising_rows(time_s: &[f64]) -> Vec<usize> {
    let mut last = f64::NEG_INFINITY;
    let is_later = |row: &usize| {
        let later = time_s[*row] > last;
        if later {
            last = time_s[*row];
        }
        later
    };
    (0..time_s.len()).filter(is_later).collect()
}
