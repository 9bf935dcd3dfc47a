//! What the paper does not show, on the page: errors against the period and against the noise.

use super::{cells, percent};
use crate::report::page::{Cell, Table};
use crate::report::plot::{CurveChart, CurvePanel};
use crate::report::reproduce::{NamedTable, Picture, Section};
use crate::text::number::significant;
use crate::workflow::reproduce::{Curve, NAMES, NoiseSweep, Sampling, Sweep};

/// Which errors are drawn and tabled: Ta, TM, Ke, J (Mc is in the JSON).
const SHOWN: [usize; 4] = [0, 1, 2, 3];

pub(super) fn sampling(sampling: &Sampling) -> Section {
    let mut section = Section {
        heading: "Not in the paper: how slowly each scheme may sample".to_owned(),
        paragraphs: vec!["Noise-free. One motor is sampled with ever longer periods; schemes 1 know the resistance, schemes 2 the torque constant, the others nothing. A dash: not given by this scheme, or not carried by the data.".to_owned()],
        ..Section::default()
    };
    for (sweep, name) in sampling.sweeps.iter().zip(["sampling-ta", "sampling-tm"]) {
        section.pictures.push(Picture {
            name,
            svg: chart(sweep.against, &sweep.ratios, &sweep.curves, (-4, 3)).svg("errors of each scheme against the period"),
            caption: format!(
                "Size of the error against {}; TM/Ta = {}, Ta = {} ms. Below 1e-4 % it is drawn at the lower edge.",
                sweep.against,
                sweep.tm_over_ta,
                significant(1e3 * sweep.electrical_time_constant_s, 2)
            ),
        });
        for which in SHOWN {
            section.tables.push((
                format!(
                    "Error of {} against {} at TM/Ta = {}.",
                    NAMES[which], sweep.against, sweep.tm_over_ta
                ),
                NamedTable {
                    name: format!("{name}-{}", NAMES[which].to_lowercase()),
                    table: errors_table(sweep.against, &ratios(sweep), &sweep.curves, which),
                },
            ));
        }
    }
    let rows = sampling.at_ta.iter().map(|row| {
        let [ta, tm, ke, ..] = row.printed.to_array();
        let largest = row
            .exact
            .to_array()
            .into_iter()
            .map(|error| error.map_or(f64::NAN, f64::abs));
        let show = |error: Option<f64>| percent(error.unwrap_or(f64::NAN));
        cells([
            row.tm_over_ta.to_string(),
            show(ta),
            show(tm),
            show(ke),
            format!("{:.0e} %", largest.fold(0.0, f64::max)),
        ])
    });
    section.tables.push((
        "Scheme 1 at T = Ta: the printed form, and the largest error of any parameter of the exact one.".to_owned(),
        NamedTable {
            name: "scheme-1-at-ta".to_owned(),
            table: Table {
                head: vec!["TM/Ta", "printed Ta", "printed TM", "printed Ke", "exact"],
                rows: rows.collect(),
            },
        },
    ));
    section
}

fn ratios(sweep: &Sweep) -> Vec<String> {
    sweep
        .ratios
        .iter()
        .map(|ratio| format!("{ratio}"))
        .collect()
}

pub(super) fn noise(sweep: &NoiseSweep) -> Section {
    let labels: Vec<String> = sweep
        .signal_to_noise
        .iter()
        .map(|ratio| format!("{ratio:e}"))
        .collect();
    let tables = SHOWN.map(|which| {
        (
            format!("Error of {} against S/N (power).", NAMES[which]),
            NamedTable {
                name: format!("noise-{}", NAMES[which].to_lowercase()),
                table: errors_table("S/N", &labels, &sweep.curves, which),
            },
        )
    });
    let long = sweep.long.curves.iter().map(|curve| {
        let errors = curve.errors.first().copied().unwrap_or_default().to_array();
        let shown = errors.map(|error| error.map_or_else(|| "-".to_owned(), percent));
        std::iter::once(Cell::text(label(curve.scheme)))
            .chain(shown.map(Cell::text))
            .collect()
    });
    let long = (
        format!(
            "Schemes 1 on {} samples at S/N {} (power), median of {} seeds: more samples do not mend the bias of least squares. A dash: fewer than half of the seeds give a motor at all.",
            sweep.long.samples, sweep.long.signal_to_noise, sweep.long.seeds
        ),
        NamedTable {
            name: "noise-long-record".to_owned(),
            table: Table {
                head: std::iter::once("scheme").chain(NAMES).collect(),
                rows: long.collect(),
            },
        },
    );
    Section {
        heading: "Not in the paper: error against signal-to-noise".to_owned(),
        paragraphs: vec![format!(
            "White noise on the sensors of speed and current, S/N of power. Ta = {} s, TM = {} s, T = {:.0} ms, {} samples, median of {} seeds, no forgetting beyond each scheme's own.",
            sweep.electrical_time_constant_s,
            sweep.mechanical_time_constant_s,
            1e3 * sweep.period_s,
            sweep.samples,
            sweep.seeds
        )],
        pictures: vec![Picture {
            name: "noise",
            svg: chart(
                "S/N of power",
                &sweep.signal_to_noise,
                &sweep.curves,
                (-3, 3),
            )
            .svg("errors of each scheme against signal-to-noise"),
            caption: "Size of the median error against the signal-to-noise ratio of the sensors."
                .to_owned(),
        }],
        tables: tables.into_iter().chain([long]).collect(),
        data: Vec::new(),
    }
}

fn chart(axis: &str, at: &[f64], curves: &[Curve], decades: (i32, i32)) -> CurveChart {
    let panels = SHOWN.map(|which| CurvePanel {
        title: format!("{}: size of the error, %", NAMES[which]),
        curves: curves
            .iter()
            .map(|curve| {
                let errors = curve.errors.iter().map(|errors| errors.to_array()[which]);
                at.iter()
                    .zip(errors)
                    .map(|(at, error)| (*at, error.map_or(f64::NAN, f64::abs)))
                    .collect()
            })
            .collect(),
    });
    CurveChart {
        axis: axis.to_owned(),
        labels: curves.iter().map(|curve| label(curve.scheme)).collect(),
        panels: panels.into(),
        decades,
    }
}

/// `scheme 1-iv`, but `output-error`.
fn label(scheme: &str) -> String {
    if scheme.starts_with(|first: char| first.is_ascii_digit()) {
        format!("scheme {scheme}")
    } else {
        scheme.to_owned()
    }
}

/// One row to a ratio, one column to a scheme that gives this parameter at all.
fn errors_table(against: &'static str, ratios: &[String], curves: &[Curve], which: usize) -> Table {
    let giving: Vec<&Curve> = curves
        .iter()
        .filter(|curve| {
            curve
                .errors
                .iter()
                .any(|errors| errors.to_array()[which].is_some())
        })
        .collect();
    let rows = ratios.iter().enumerate().map(|(row, ratio)| {
        let errors = giving.iter().map(|curve| {
            let error = curve.errors[row].to_array()[which];
            Cell::text(error.map_or_else(|| "-".to_owned(), percent))
        });
        std::iter::once(Cell::text(ratio)).chain(errors).collect()
    });
    Table {
        head: std::iter::once(against)
            .chain(giving.iter().map(|curve| curve.scheme))
            .collect(),
        rows: rows.collect(),
    }
}
