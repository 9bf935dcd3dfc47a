//! The reproduction as pictures, tables and sentences.
//!
//! ```text
//! PaperA -> figure_2, figure_3, table_1 (with Figure 4), beyond (period and noise), adaptive (Figures 5, 6), rivals (7) \
//! PaperB -> paper_b (Figures 4, 5), paper_b_design, paper_b_beyond (noise, Hall edges, back-EMF) ------------------------> Section
//!           comparison: every regulator on the same cases -------------------------------------------------------------/   |
//!                                                                                                 Reproduction (report) <--'
//! ```

mod adaptive;
mod beyond;
mod calibration;
mod comparison;
mod discovery;
mod figure_2;
mod figure_3;
mod lines;
mod mysteries;
mod paper_b;
mod paper_b_beyond;
mod paper_b_design;
mod rivals;
mod table_1;

use std::fmt::Write as _;

use super::{Method, NoiseModel, PaperA, RatioOf, Spread};
use crate::control::TrialPoint;
use crate::report::page::{Cell, Table};
use crate::report::plot::{Panel, Series, Style};
use crate::report::reproduce::{NamedTable, Reproduction, Section};
use crate::text::number::{fixed, significant};

impl PaperA {
    /// The page with its pictures and tables.
    pub fn report(&self) -> Reproduction {
        let mut lead = self.in_short();
        lead.push(' ');
        lead.push_str(&adaptive::in_short(&self.adaptive));
        Reproduction {
            title: "Paper A, computed again".to_owned(),
            subtitle: self.title.to_owned(),
            lead: ("In short".to_owned(), lead),
            sections: vec![
                Section {
                    heading: "What the paper leaves open, and what was chosen".to_owned(),
                    paragraphs: self.chosen.clone(),
                    ..Section::default()
                },
                figure_2::section(&self.figure_2),
                figure_3::section(&self.figure_3),
                table_1::transient(&self.figure_4),
                table_1::section(&self.table_1),
                beyond::sampling(&self.sampling),
                beyond::noise(&self.noise),
                adaptive::figure_5(&self.adaptive.figure_5),
                adaptive::figure_6(&self.adaptive.figure_6),
                rivals::saturation(&self.adaptive.figure_7),
                rivals::adaptation(&self.adaptive.figure_7),
                comparison::section(&self.adaptive.comparison),
                Section {
                    heading: "Time per iteration".to_owned(),
                    paragraphs: vec![format!(
                        "The paper's own figures on its {}: less than {} ms for scheme 1, less than {} ms for scheme 2. Ours are measured by the benchmarks of the repository (cargo bench, in benches/), not here.",
                        self.paper_iteration_time.computer,
                        self.paper_iteration_time.scheme_1_ms,
                        self.paper_iteration_time.scheme_2_ms
                    )],
                    ..Section::default()
                },
            ],
        }
    }

    fn in_short(&self) -> String {
        let error = |noise, of, method| {
            let found = self.figure_2.case(noise, of, method);
            found.map_or(f64::NAN, |case| {
                case.before.electrical_time_constant_s.error_percent
            })
        };
        let (equation, sensor) = (NoiseModel::EquationError, NoiseModel::Sensor);
        let last = self.table_1.rows.last();
        format!(
            "Figure 2 can be met with noise as equation error (S/N 10 in power: Ta {}, TM follows its doubling), not with the same noise on the speed sensor (Ta {}); instrumental variables over all samples take that bias away (Ta {}). Table 1: with the trapezoid J lies {} from the truth at N = 50 without noise, {} in the mean with it.",
            percent(error(equation, RatioOf::Power, Method::Printed)),
            percent(error(sensor, RatioOf::Power, Method::Printed)),
            percent(error(sensor, RatioOf::Power, Method::InstrumentalVariables)),
            percent(last.map_or(f64::NAN, |row| 100.0
                * (row.trapezoid.inertia_kg_m2 / self.table_1.truth.inertia_kg_m2 - 1.0))),
            percent(last.map_or(f64::NAN, |row| row.inertia_with_noise.error_percent)),
        )
    }
}

/// A signed error in per cent with as many digits as are of interest.
fn percent(value: f64) -> String {
    let decimals = match value.abs() {
        size if size.is_nan() => return "-".to_owned(),
        size if size >= 1000.0 => {
            let (sign, than) = if value > 0.0 { ("+", '>') } else { ("-", '<') };
            return format!("{than} {sign}1000 %");
        }
        size if size >= 20.0 => 0,
        size if size >= 0.095 => 1,
        size if size >= 0.000_95 => 3,
        _ => return "< 0.001 %".to_owned(),
    };
    let sign = if value > 0.0 { "+" } else { "" };
    format!("{sign}{} %", fixed(value, decimals))
}

fn cells<const N: usize>(texts: [String; N]) -> Vec<Cell> {
    texts.into_iter().map(Cell::text).collect()
}

/// `0.221 [0.170 to 0.301]`.
fn range(spread: &Spread) -> String {
    if spread.median.is_finite() {
        let [low, median, high] =
            [spread.low, spread.median, spread.high].map(|value| significant(value, 3));
        format!("{median} [{low} to {high}]")
    } else {
        "none".to_owned()
    }
}

fn milli(value: f64) -> String {
    fixed(1e6 * value, 0)
}

/// The samples as the axis of a picture.
fn samples(count: usize) -> Vec<f64> {
    (0..count).map(|k| k as f64).collect()
}

/// Values inside the frame; the line is cut elsewhere.
fn inside(values: &[f64], frame: std::ops::RangeInclusive<f64>) -> Vec<f64> {
    let keep = |value: &f64| {
        if frame.contains(value) {
            *value
        } else {
            f64::NAN
        }
    };
    values.iter().map(keep).collect()
}

/// Columns beside an axis; what is not there is an empty cell.
fn csv(axis: &str, at: &[f64], columns: &[(String, &[f64])]) -> String {
    let mut out = axis.to_owned();
    for (name, _) in columns {
        let _ = write!(out, ",{name}");
    }
    for (row, at) in at.iter().enumerate() {
        let _ = write!(out, "\n{at}");
        for (_, values) in columns {
            out.push(',');
            if let Some(value) = values.get(row).filter(|value| value.is_finite()) {
                let _ = write!(out, "{value}");
            }
        }
    }
    out.push('\n');
    out
}

/// The times of a trace.
fn times(trace: &[TrialPoint]) -> Vec<f64> {
    trace.iter().map(|point| point.time_s).collect()
}

/// One column of a trace.
fn of(trace: &[TrialPoint], column: fn(&TrialPoint) -> f64) -> Vec<f64> {
    trace.iter().map(column).collect()
}

/// Reference and speed of a trial.
fn speed_panel(title: String, trace: &[TrialPoint]) -> Panel {
    let t = times(trace);
    let series = |label: &str, style, column: fn(&TrialPoint) -> f64| {
        Series::sampled(label, style, &t, &of(trace, column))
    };
    Panel::new(title, "rad/s")
        .with(series("reference", Style::Command, |p| p.reference_rad_s))
        .with(series("speed", Style::After, |p| p.speed_rad_s))
}

/// A time that may never come.
fn seconds(time_s: Option<f64>) -> String {
    time_s.map_or_else(|| "never".to_owned(), |s| fixed(s, 3))
}

fn named(name: &str, head: Vec<&'static str>, rows: Vec<Vec<Cell>>) -> NamedTable {
    NamedTable {
        name: name.to_owned(),
        table: Table { head, rows },
    }
}
