//! Where a model fails, as blocks of a page: lights with their bands, balances, shares, the map.

use super::page::{Cell, Page, Table};
use super::plot::MapChart;
use crate::diagnosis::{Comparison, ResidualLights};
use crate::text::lines::capitalised;
use crate::text::number::{share, significant};

/// The residual lights of each model, in multiples of their 99 % band.
pub(super) fn lights(page: &mut Page, models: &[(&str, &ResidualLights)]) {
    let mut rows = Vec::new();
    for (label, residual) in models {
        for (signal, lights) in residual.named() {
            let mut row = vec![Cell::text(signal), Cell::text(*label)];
            row.extend(lights.named().map(|(_, light)| {
                Cell::text(format!(
                    "{} {}",
                    significant(light.largest_over_band, 2),
                    if light.passes { "ok" } else { "outside" }
                ))
            }));
            row.push(Cell::text(format!(
                "{} of {}",
                significant(lights.ljung_box, 3),
                significant(lights.ljung_box_limit, 3)
            )));
            rows.push(row);
        }
    }
    if rows.is_empty() {
        return;
    }
    page.paragraph(
        "Residual lights, lags 0 to 25: the largest correlation over its 99 % band. A right model stays near 1; a wrong one \
         shows 18 to 42 in the first column.",
    );
    page.table(Table {
        head: vec![
            "signal",
            "model",
            "whiteness",
            "input",
            "input squared",
            "squares",
            "error x input",
            "Ljung-Box (of 99 % limit)",
        ],
        rows,
    });
}

/// What each equation lacks, with its share of the error.
pub(super) fn balances(page: &mut Page, comparison: &Comparison) {
    let rows = comparison.balances.iter().map(|balance| {
        let figure = |value: Option<f64>| {
            value.map_or_else(|| "not known".to_owned(), |value| significant(value, 3))
        };
        let percent = |part: Option<f64>| part.map_or_else(|| "-".to_owned(), share);
        vec![
            Cell::text(balance.equation).with_note(capitalised(&balance.sentence)),
            Cell::text(format!("{} {}", significant(balance.rms, 3), balance.unit)),
            Cell::text(figure(balance.nres)),
            Cell::text(figure(balance.nres_refitted)),
            Cell::text(percent(balance.share_of_error)),
            Cell::text(percent(balance.forward_share_of_error)).with_note(format!(
                "{} of the time",
                percent(balance.forward_share_of_time)
            )),
        ]
    });
    page.table(Table {
        head: vec![
            "equation",
            "what it lacks, rms",
            "times its noise",
            "with its values free",
            "share of the error",
            "forward",
        ],
        rows: rows.collect(),
    });
}

/// The map of the equation that fails worse; nothing where none fails.
pub(super) fn map(page: &mut Page, comparison: &Comparison) {
    let (Some(map), Some(worst)) = (
        &comparison.map,
        comparison.balances.first().filter(|balance| balance.fails),
    ) else {
        return;
    };
    let values = if worst.equation == "torque" {
        &map.torque_rms_n_m
    } else {
        &map.voltage_rms_v
    };
    let chart = MapChart {
        title: format!("{} error, {}", worst.equation, worst.unit),
        across: ("current, A", &map.current_edges_a),
        upwards: ("speed, rad/s", &map.speed_edges_rad_s),
        values,
        counts: &map.count,
    };
    let svg = chart.svg("error of the model over speed and current");
    if svg.is_empty() {
        return;
    }
    page.figure(
        svg,
        format!(
            "Root mean square of what the {} equation lacks, over speed and current, on the held-out run. Where there is no \
             cell the run never was.",
            worst.equation
        ),
    );
}
