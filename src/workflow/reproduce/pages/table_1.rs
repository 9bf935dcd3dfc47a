//! Figure 4, the transient, and Table 1 on the page.

use super::{cells, csv, milli, percent};
use crate::report::page::Table;
use crate::report::plot::{Panel, PanelPlot, Series, Style};
use crate::report::reproduce::{NamedTable, Picture, Section};
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::{Figure4, Table1};

pub(super) fn transient(figure: &Figure4) -> Section {
    let panel = |title: &str, unit: &str, fine: &[f64], sampled: &[f64]| {
        Panel::new(title, unit)
            .with(Series::sampled(
                "motor",
                Style::Measured,
                &figure.fine.time_s,
                fine,
            ))
            .with(Series::sampled(
                "samples",
                Style::Before,
                &figure.time_s,
                sampled,
            ))
    };
    let plot = PanelPlot::default()
        .with(panel(
            "current",
            "A",
            &figure.fine.current_a,
            &figure.current_a,
        ))
        .with(panel(
            "speed",
            "rad/s",
            &figure.fine.speed_rad_s,
            &figure.speed_rad_s,
        ));
    let columns = [
        ("current_a".to_owned(), figure.current_a.as_slice()),
        ("speed_rad_s".to_owned(), figure.speed_rad_s.as_slice()),
    ];
    Section {
        heading: "Figure 4: the transient, emulated".to_owned(),
        paragraphs: vec![format!(
            "{} from rest at {:.0} V, sampled every {:.0} ms; noise of the sensors {} rad/s and {} A (standard deviations).",
            figure.motor,
            figure.voltage_v,
            1e3 * figure.period_s,
            figure.speed_noise_rad_s,
            figure.current_noise_a
        )],
        pictures: vec![Picture {
            name: "figure-4",
            svg: plot.svg("current and speed of the start"),
            caption: "The paper's Figure 4 is a measured curve without numbers; this is the start that takes its place.".to_owned(),
        }],
        tables: Vec::new(),
        data: vec![("figure-4-series.csv".to_owned(), csv("time_s", &figure.time_s, &columns))],
    }
}

pub(super) fn section(table: &Table1) -> Section {
    let truth = table.truth;
    let error = |value: f64| percent(100.0 * (value / truth.inertia_kg_m2 - 1.0));
    Section {
        heading: "Table 1: scheme 2 after N samples".to_owned(),
        paragraphs: vec![
            format!(
                "J in 1e-6 kg.m2, Mc in N.m. The paper's columns come from its measured transient, ours from the emulated one, whose truth is J = {} and Mc = {}; the paper's catalogue says J = {}, and its settled values lie 6 % above that. T = {:.0} ms = {} Ta, beta = {}, Ke known.",
                milli(truth.inertia_kg_m2),
                fixed(truth.load_torque_n_m, 3),
                milli(table.catalogue_inertia_kg_m2),
                1e3 * table.period_s,
                significant(table.period_s / table.electrical_time_constant_s, 2),
                table.forgetting
            ),
            format!(
                "The left rectangle is what the paper prints. While the current still rises it makes J too large, at T = 1 ms by {} after 20 samples: the sign and about the size of the paper's excess over the catalogue.",
                error(table.by_period.first().map_or(f64::NAN, |row| row.rectangle.inertia_kg_m2))
            ),
        ],
        tables: vec![
            (
                format!("Rectangle and trapezoid without noise; with noise: trapezoid, mean and standard deviation over {} seeds, error of the mean, and how many of the 95 % intervals of J hold the truth.", table.seeds),
                NamedTable { name: "table-1".to_owned(), table: by_n(table) },
            ),
            (
                "Error of J by the period. Sampled fast, twenty samples end before the current has peaked and the noise weighs more; sampled at half of Ta, the trapezoid's own half per cent is larger than the noise; the interval has it from a second estimate on every second sample.".to_owned(),
                NamedTable { name: "table-1-by-period".to_owned(), table: by_period(table) },
            ),
        ],
        ..Section::default()
    }
}

fn by_n(table: &Table1) -> Table {
    let truth = table.truth;
    let error = |value: f64| percent(100.0 * (value / truth.inertia_kg_m2 - 1.0));
    let rows = table.rows.iter().map(|row| {
        let (j, mc) = (row.inertia_with_noise, row.load_torque_with_noise);
        cells([
            row.n.to_string(),
            milli(row.paper.inertia_kg_m2),
            fixed(row.paper.load_torque_n_m, 4),
            format!(
                "{} ({})",
                milli(row.rectangle.inertia_kg_m2),
                error(row.rectangle.inertia_kg_m2)
            ),
            format!(
                "{} ({})",
                milli(row.trapezoid.inertia_kg_m2),
                error(row.trapezoid.inertia_kg_m2)
            ),
            fixed(row.trapezoid.load_torque_n_m, 4),
            format!(
                "{} ± {} ({})",
                milli(j.mean),
                milli(j.std),
                percent(j.error_percent)
            ),
            format!("{} %", fixed(j.coverage_percent, 0)),
            if mc.told_percent < 50.0 {
                format!("told by {} %", fixed(mc.told_percent, 0))
            } else {
                format!("{} ± {}", fixed(mc.mean, 3), fixed(mc.std, 3))
            },
        ])
    });
    Table {
        head: vec![
            "N",
            "paper J",
            "paper Mc",
            "rectangle J",
            "trapezoid J",
            "trapezoid Mc",
            "with noise J",
            "95 % covers",
            "with noise Mc",
        ],
        rows: rows.collect(),
    }
}

fn by_period(table: &Table1) -> Table {
    let truth = table.truth;
    let error = |value: f64| percent(100.0 * (value / truth.inertia_kg_m2 - 1.0));
    let rows = table.by_period.iter().map(|row| {
        let j = row.inertia_with_noise;
        cells([
            format!("{} ms", significant(1e3 * row.period_s, 2)),
            significant(row.period_s / table.electrical_time_constant_s, 2),
            row.n.to_string(),
            error(row.rectangle.inertia_kg_m2),
            error(row.trapezoid.inertia_kg_m2),
            percent(j.error_percent),
            format!("{} %", significant(100.0 * j.std / truth.inertia_kg_m2, 2)),
            format!("{} %", fixed(j.coverage_percent, 0)),
        ])
    });
    Table {
        head: vec![
            "T",
            "T/Ta",
            "N",
            "rectangle",
            "trapezoid",
            "mean with noise",
            "spread",
            "95 % covers",
        ],
        rows: rows.collect(),
    }
}
