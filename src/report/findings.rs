//! What a diagnosis found, as blocks of a page: cards, curves, candidates, the next run.

use super::page::{Cell, Page, Table};
use super::plot::AxisChart;
use crate::diagnosis::{AxisMap, Candidate, Diagnosis, Reached, Status};
use crate::plant::effect;
use crate::sample::{ParameterEstimate, TWO_SIDED_95};
use crate::text::lines::capitalised;
use crate::text::number::{fixed, probability, share, significant, with_unit};

/// Pictures of curves that an error follows, at most.
const MOST_CURVES: usize = 3;

/// Card of each effect that was named, and what it cannot be told from.
pub(super) fn effects(page: &mut Page, diagnosis: &Diagnosis) {
    let named: Vec<_> = diagnosis
        .effects
        .iter()
        .filter_map(|id| effect::find(id))
        .collect();
    if named.is_empty() {
        return;
    }
    page.section("What was found");
    for effect in named {
        let card = effect.card();
        page.paragraph(format!(
            "{} ({}): {}",
            capitalised(card.name),
            card.id,
            card.equation
        ));
        page.list(vec![
            format!("Possible causes: {}.", card.causes),
            format!("Looks like: {}.", card.looks_like),
            format!("Remedy: {}.", card.remedy),
        ]);
    }
    let mut rivals: Vec<String> = diagnosis
        .confusable
        .iter()
        .map(|[name, rival]| format!("{name} and {rival} cannot be told apart by these runs."))
        .collect();
    let never = diagnosis.equivalences.iter();
    rivals.extend(never.map(|sentence| format!("{}.", capitalised(sentence))));
    page.list(rivals);
}

/// The curves that an unexplained error follows.
pub(super) fn curves(page: &mut Page, diagnosis: &Diagnosis) {
    if diagnosis.axis_map.is_empty() {
        return;
    }
    page.section("What the error follows");
    let (followed, rest): (Vec<&AxisMap>, Vec<&AxisMap>) = diagnosis
        .axis_map
        .iter()
        .partition(|map| map.is_followed() && map.knots.len() > 1);
    for map in followed.iter().take(MOST_CURVES) {
        let unit = if map.equation == "voltage" {
            "V"
        } else {
            "N.m"
        };
        let chart = AxisChart {
            title: format!("what the {} equation lacks, {unit}", map.equation),
            axis: axis_name(map.axis),
            knots: &map.knots,
            values: &map.values,
            std: &map.std,
        };
        page.figure(
            chart.svg(&format!(
                "{} error over {}",
                map.equation,
                axis_name(map.axis)
            )),
            format!(
                "{}. The band is the 95 % interval; a loss is positive.",
                capitalised(&map.sentence)
            ),
        );
    }
    let others = followed.into_iter().skip(MOST_CURVES).chain(rest);
    page.list(
        others
            .map(|map| format!("{}.", capitalised(&map.sentence)))
            .collect(),
    );
    page.paragraph(
        "No effect of the catalogue has this form. The curve can be added as it is, with the command drivebench add table, so that the \
         error falls while its cause is looked for.",
    );
}

const fn axis_name(axis: &str) -> &'static str {
    match axis.as_bytes() {
        b"speed_rad_s" => "speed, rad/s",
        b"current_a" => "current, A",
        b"voltage_v" => "voltage, V",
        b"angle_rad" => "angle, rad",
        b"time_s" => "time, s",
        _ => "frequency, Hz",
    }
}

/// Every effect that was tried: status, error, share, size with interval, what it reached.
pub(super) fn candidates(page: &mut Page, diagnosis: &Diagnosis) {
    page.section("Effects that were tried");
    let mut named = diagnosis
        .candidates
        .iter()
        .filter(|c| has_paid(c) && !c.parameters.is_empty());
    if let Some(words) = named.find_map(Candidate::widened) {
        page.paragraph(format!("Intervals of sizes: {words}."));
    }
    page.table(Table {
        head: vec![
            "rank",
            "effect",
            "status",
            "held-out error",
            "explains",
            "probability",
            "size ± 95 %, evidence",
        ],
        rows: diagnosis.candidates.iter().map(row).collect(),
    });
}

const fn has_paid(candidate: &Candidate) -> bool {
    matches!(candidate.status, Status::Supported | Status::Possible)
}

fn row(candidate: &Candidate) -> Vec<Cell> {
    let dash = || "-".to_owned();
    // A size is worth showing only where the effect pays; else the evidence says what would have been seen.
    let sizes: Vec<String> = candidate
        .parameters
        .iter()
        .filter(|_| has_paid(candidate))
        .map(size)
        .chain(
            candidate
                .reached
                .iter()
                .filter(|_| has_paid(candidate))
                .flat_map(Reached::peaks)
                .map(|peak| peak.text(TWO_SIDED_95)),
        )
        .collect();
    vec![
        Cell::text(candidate.rank.to_string()),
        Cell::code(candidate.effect),
        Cell::text(candidate.status.name()),
        Cell::text(candidate.holdout_after.map_or_else(dash, |after| {
            format!(
                "{} -> {}",
                fixed(candidate.holdout_before, 2),
                fixed(after, 2)
            )
        })),
        Cell::text(
            candidate
                .explained_percent
                .map_or_else(dash, |percent| share(percent / 100.0)),
        ),
        Cell::text(match candidate.status {
            Status::NotExcited => dash(),
            _ => probability(candidate.probability),
        }),
        Cell::text(if sizes.is_empty() {
            at_most(candidate).unwrap_or_else(dash)
        } else {
            sizes.join("; ")
        })
        .with_note(capitalised(&candidate.evidence)),
    ]
}

/// What the size of an effect that is not named is below.
fn at_most(candidate: &Candidate) -> Option<String> {
    let spec = effect::find(candidate.effect)?.parameters().first()?;
    let bound = with_unit(&significant(candidate.upper_bound?, 2), spec.unit);
    Some(format!("at most {bound}"))
}

/// Key, value with its 95 % interval, unit.
fn size(parameter: &ParameterEstimate) -> String {
    let key = parameter.key.rsplit('.').next().unwrap_or(&parameter.key);
    format!("{key} {}", parameter.text(TWO_SIDED_95))
}

/// The run that would tell more.
pub(super) fn next_run(page: &mut Page, diagnosis: &Diagnosis) {
    let Some(next) = &diagnosis.next_experiment else {
        return;
    };
    page.section("Next run");
    page.paragraph(format!(
        "{}.",
        capitalised(next.sentence.trim_end_matches('.'))
    ));
    if next.menu.is_empty() {
        return;
    }
    page.paragraph(
        "Every run that the limits allow, with the separation that is expected of it, and from which on that run tells.",
    );
    let rows = next.menu.iter().map(|entry| {
        vec![
            Cell::code(entry.program),
            Cell::text(significant(entry.expected_separation, 2)),
            Cell::text(significant(entry.needed, 2)),
            Cell::text(if entry.is_told() { "tells" } else { "does not" }),
        ]
    });
    page.table(Table {
        head: vec!["run", "expected separation", "tells from", "verdict"],
        rows: rows.collect(),
    });
}
