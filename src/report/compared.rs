//! Models beside a measurement as blocks of a page: figures of each signal, lights, places where they fail.

use super::failing;
use super::page::{Cell, Page, Table};
use crate::diagnosis::{Comparison, FailureLocation, SignalComparison};
use crate::text::lines::capitalised;
use crate::text::number::{percent, r_min, share, significant};
use crate::units::rpm_from_rad_s;

/// Places that are worth a line each.
const MOST_PLACES: usize = 4;

/// A comparison with what its model is called.
pub(super) type Named<'a> = (&'static str, Option<&'a Comparison>);

type Get = fn(&Comparison) -> (String, Option<SignalComparison>);
const SIGNALS: [(&str, Get); 2] = [
    ("rad/s", |comparison| {
        let signals = &comparison.signals;
        (signals.speed_name(), signals.speed_rad_s)
    }),
    ("A", |comparison| {
        ("current".to_owned(), comparison.signals.current_a)
    }),
];

fn signal_row(name: &str, unit: &str, label: &str, signal: &SignalComparison) -> Vec<Cell> {
    let figure = |value: f64| {
        let cell = Cell::text(format!("{} {unit}", significant(value, 3)));
        if unit == "rad/s" && value.is_finite() {
            cell.with_note(r_min(value))
        } else {
            cell
        }
    };
    vec![
        Cell::text(name),
        Cell::text(label),
        Cell::text(percent(signal.holdout.fit_percent)),
        figure(signal.holdout.rmse),
        signal.noise_floor.map_or(Cell::text("not known"), figure),
        Cell::text(percent(signal.fit_percent)),
        figure(signal.rmse),
        figure(signal.one_step_rmse),
    ]
}

/// A row of the torque of a run without a voltage.
fn torque_row(label: &str, comparison: &Comparison) -> Option<Vec<Cell>> {
    let torque = comparison.signals.torque_n_m.as_ref()?;
    let figure = |value: f64| Cell::text(format!("{} N.m", significant(value, 3)));
    Some(vec![
        Cell::text("torque"),
        Cell::text(label),
        Cell::text(percent(torque.holdout.fit_percent)),
        figure(torque.holdout.rmse),
        torque.noise_floor.map_or(Cell::text("not known"), figure),
        Cell::text(percent(torque.fit_percent)),
        figure(torque.rmse),
        Cell::text("-"),
    ])
}

/// Fit and error of every signal, what is left in the residual, and its lights.
pub(super) fn figures(page: &mut Page, comparisons: &[Named<'_>]) {
    let mut rows = Vec::new();
    for (unit, get) in SIGNALS {
        for (label, comparison) in comparisons {
            if let Some((name, Some(signal))) = comparison.map(get) {
                rows.push(signal_row(&name, unit, label, &signal));
            }
        }
    }
    for (label, comparison) in comparisons {
        rows.extend(comparison.and_then(|comparison| torque_row(label, comparison)));
    }
    page.table(Table {
        head: vec![
            "signal",
            "model",
            "held-out fit",
            "held-out rms error",
            "noise floor",
            "training fit",
            "training rms error",
            "one-step rms error",
        ],
        rows,
    });
    let known: Vec<(&str, &Comparison)> = comparisons
        .iter()
        .filter_map(|(label, comparison)| Some((*label, (*comparison)?)))
        .collect();
    let residual = |(label, comparison): &(&str, &Comparison)| {
        let residual = comparison.residual;
        if !residual.enough_samples {
            return format!(
                "Residual of the {label}: too few samples to say whether only noise is left."
            );
        }
        let white = if residual.white {
            "it is white, as noise is"
        } else {
            "there is more than noise in it"
        };
        format!(
            "Residual of the {label}: {white} ({} of the autocorrelation lags lie outside their 99 % band; 1 % is \
             chance).",
            share(residual.autocorrelation_outside_99_percent)
        )
    };
    page.list(known.iter().map(residual).collect());
    let lights: Vec<_> = known
        .iter()
        .map(|(label, comparison)| (*label, &comparison.residual))
        .collect();
    failing::lights(page, &lights);
}

/// Where each model fails: sentences, balances, the map.
pub(super) fn places(page: &mut Page, comparisons: &[Named<'_>]) {
    page.section("Where the model fails");
    for (label, comparison) in comparisons {
        let Some(comparison) = comparison else {
            continue;
        };
        let label = capitalised(label);
        if comparison.locations.is_empty() {
            page.paragraph(format!(
                "{label}: the error follows no speed, current, angle or time."
            ));
        } else {
            let undecided = comparison.undecided().unwrap_or_default();
            page.paragraph(format!("{label}: {undecided}").trim_end().to_owned());
            let places = comparison.locations.iter().take(MOST_PLACES);
            page.list(places.map(place).collect());
        }
        failing::balances(page, comparison);
        failing::map(page, comparison);
        let limits = comparison.limits.iter();
        page.list(limits.map(|limit| capitalised(limit)).collect());
    }
}

/// A place's sentence; r/min is added where it lies along the speed.
fn place(location: &FailureLocation) -> String {
    let sentence = capitalised(&location.sentence);
    if location.variable == "speed_rad_s" {
        format!(
            "{sentence} [{} to {}]",
            significant(rpm_from_rad_s(location.from), 3),
            r_min(location.to)
        )
    } else {
        sentence
    }
}
