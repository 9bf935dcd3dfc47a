//! Every regulator on the same cases, as one table.

use super::{cells, named, seconds};
use crate::report::page::Cell;
use crate::report::reproduce::Section;
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::loops::{Case, CaseRow, Comparison};

pub(super) fn section(comparison: &Comparison) -> Section {
    let [low, high] = comparison.levels_rad_s;
    Section {
        heading: "Every regulator on the same cases".to_owned(),
        paragraphs: vec![
            format!(
                "Bench: {}; T = {:.0} ms, {:.0} cycles of delay, sensors with noise. Steps: {low:.0} to {high:.0} rad/s and back, each held {} s; where the inertia jumps, the regulators are told nothing and the steps from the second one after the jump count. Start and brake: standstill to {:.0} rad/s and back, in the current limit. Load: {} N.m at {:.0} rad/s.",
                comparison.bench,
                1e3 * comparison.period_s,
                comparison.delay_cycles,
                comparison.half_period_s,
                comparison.start_rad_s,
                comparison.load_n_m,
                0.5 * (low + high)
            ),
            "Overshoot and settling (5 % of the step), both from the speed at the instant of the step: the worst of the steps that count. IAE: integral of the absolute error, mean of those steps; under load over both changes together. Dip and recovery (to 0.5 % of the speed): the worse of load on and load off. Effort: root mean square of the output's change from cycle to cycle.".to_owned(),
        ],
        tables: vec![(
            format!(
                "`pi` is fixed, tuned for the inertia that the model has. `paper-b` has the back-EMF of the reference fed forward, which the paper does not have, W = {}, mu = {} and {} of K3; its design knows no delay, so behind one it must be a slow one.",
                comparison.paper_b.voltage_cost,
                comparison.paper_b.filter_share,
                comparison.paper_b.compensation
            ),
            named(
                "controllers",
                vec![
                    "case",
                    "controller",
                    "overshoot, %",
                    "settling, s",
                    "IAE, rad",
                    "dip, rad/s",
                    "recovery, s",
                    "effort, V",
                ],
                rows(comparison),
            ),
        )],
        ..Section::default()
    }
}

fn rows(comparison: &Comparison) -> Vec<Vec<Cell>> {
    Case::ALL
        .into_iter()
        .flat_map(|case| {
            let of_case = comparison.rows.iter().filter(move |row| row.case == case);
            of_case.map(row)
        })
        .collect()
}

fn row(row: &CaseRow) -> Vec<Cell> {
    let number =
        |value: Option<f64>, decimals| value.map_or_else(|| "-".to_owned(), |v| fixed(v, decimals));
    let time = |time: Option<Option<f64>>| time.map_or_else(|| "-".to_owned(), seconds);
    cells([
        row.case.name().to_owned(),
        row.controller.name().to_owned(),
        number(row.overshoot_percent, 1),
        time(row.settling_s),
        significant(row.absolute_error_rad, 3),
        number(row.dip_rad_s, 2),
        time(row.recovery_s),
        significant(row.effort_v, 3),
    ])
}
