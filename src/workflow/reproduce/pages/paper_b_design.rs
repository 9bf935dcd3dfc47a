//! Paper B's design on the page: where the iterations stop, what Q/R does, what K3 and mu do.

use super::{cells, csv, named, seconds};
use crate::report::page::Cell;
use crate::report::plot::{CurveChart, CurvePanel};
use crate::report::reproduce::{Picture, Section};
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::paper_b::Design;

pub(super) fn convergence(design: &Design) -> Section {
    let curve = |changes: &[f64]| -> Vec<(f64, f64)> {
        changes
            .iter()
            .enumerate()
            .map(|(n, change)| ((n + 1) as f64, *change))
            .collect()
    };
    let chart = CurveChart {
        axis: "iteration".to_owned(),
        labels: vec![
            "K (Kalman filter)".to_owned(),
            "gamma (feedback)".to_owned(),
        ],
        panels: vec![CurvePanel {
            title: "relative change of the gain".to_owned(),
            curves: vec![
                curve(&design.filter_changes),
                curve(&design.feedback_changes),
            ],
        }],
        decades: (-9, 0),
    };
    let rows = design.stops.iter().map(|stop| {
        cells([
            format!("{:.0e}", stop.tolerance),
            stop.filter_iterations.to_string(),
            stop.feedback_iterations.to_string(),
        ])
    });
    let length = design
        .filter_changes
        .len()
        .max(design.feedback_changes.len());
    let iterations: Vec<f64> = (1..=length).map(|n| n as f64).collect();
    Section {
        heading: "Where the iterations of K and gamma stop".to_owned(),
        paragraphs: vec![format!(
            "Steady gains: K = {}, {}; gamma G = {}, {} V per rad/s. The loop's largest eigenvalue with them and the compensation is {}.",
            significant(design.filter_gain[0], 4),
            significant(design.filter_gain[1], 4),
            significant(design.feedback_gain[0], 4),
            significant(design.feedback_gain[1], 4),
            fixed(design.radius, 4)
        )],
        pictures: vec![Picture {
            name: "convergence",
            svg: chart.svg("relative change of both gains over the iterations"),
            caption: "From P(0) = 1 and V alone.".to_owned(),
        }],
        tables: vec![(
            "Iterations until the relative change is below the set value.".to_owned(),
            named(
                "convergence",
                vec!["set value", "K", "gamma"],
                rows.collect(),
            ),
        )],
        data: vec![(
            "convergence-series.csv".to_owned(),
            csv(
                "iteration",
                &iterations,
                &[
                    ("filter_change".to_owned(), &design.filter_changes[..]),
                    ("feedback_change".to_owned(), &design.feedback_changes[..]),
                ],
            ),
        )],
    }
}

pub(super) fn ratio(design: &Design) -> Section {
    let rows = design.ratios.iter().map(|row| {
        cells([
            significant(row.factor, 1),
            significant(row.process_noise, 2),
            significant(row.filter_gain[0], 3),
            significant(row.filter_gain[1], 3),
            row.iterations.to_string(),
            fixed(row.overshoot_percent, 1),
            seconds(row.settling_s),
            significant(row.speed_std_rad_s, 3),
            significant(row.effort_v, 3),
            fixed(row.lasting_rad_s, 2),
        ])
    });
    Section {
        heading: "What Q/R does".to_owned(),
        paragraphs: vec!["Q is changed, R stays what the sensor has; without compensation. A small Q trusts the model: the voltage is quiet, and what the model does not know (friction) is hardly believed, so that it leaves a larger error. A large Q believes the sensor, and its noise goes to the motor. A step without noise and friction does not depend on Q: the filter knows the model exactly there, and the gains of filter and feedback are designed apart.".to_owned()],
        tables: vec![(
            "Factor 1 is what was chosen. Overshoot and settling: a step from 50 to 51 rad/s without noise; deviation and effort: 100 rad/s with both noises and friction.".to_owned(),
            named(
                "q-over-r",
                vec![
                    "factor", "Q, V^2", "K1", "K2", "iterations", "overshoot, %", "settling, s",
                    "speed deviation, rad/s", "effort, V", "lasting error, rad/s",
                ],
                rows.collect(),
            ),
        )],
        ..Section::default()
    }
}

pub(super) fn radii(design: &Design) -> Section {
    let table = |values: &[Vec<f64>], decimals| -> Vec<Vec<Cell>> {
        let row = |(share, values): (&f64, &Vec<f64>)| {
            let mut row = vec![Cell::text(share.to_string())];
            row.extend(
                values
                    .iter()
                    .map(|value| Cell::text(fixed(*value, decimals))),
            );
            row
        };
        design.radii.shares.iter().zip(values).map(row).collect()
    };
    let head = || vec!["share of K3", "mu = 0.02", "0.05", "0.1", "0.2", "1"];
    Section {
        heading: "K3 and mu".to_owned(),
        paragraphs: vec!["The predictor works on measured speeds and is fed u*: so the compensation is a loop of its own beside filter and feedback, an integrator behind the smoothing. The slower the smoothing, the less of K3 it bears before it swings: with the whole K3 and mu = 0.1 its damping is a tenth.".to_owned()],
        tables: vec![
            (
                "Damping ratio of the compensation. Rows: share of K3 = 1/(A+B); columns: mu. 1: it does not swing.".to_owned(),
                named("k3-and-mu-damping", head(), table(&design.radii.damping, 2)),
            ),
            (
                "Largest eigenvalue of the whole loop on its own plant: below 1 it is stable.".to_owned(),
                named("k3-and-mu-radius", head(), table(&design.radii.radius, 4)),
            ),
        ],
        ..Section::default()
    }
}
