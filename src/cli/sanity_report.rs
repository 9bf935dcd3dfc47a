//! What is wrong with the data, on stderr and in the result.

use serde_json::{Map, Value, json};

use super::failure::{Failure, NOT_IDENTIFIABLE, USAGE};
use super::output;
use super::provenance;
use crate::identification::sanity::{self, Finding, Kind};
use crate::plant::{Model, Scenario, Slot};
use crate::recording::ColumnMap;
use crate::sample::{ParameterEstimate, Run, Verdict};

/// A header that names another unit than its target's, with no factor in the map.
pub(super) fn headers(map: Option<&ColumnMap>) -> Result<(), Failure> {
    let items = map.map(ColumnMap::items).unwrap_or_default();
    let finding = items.iter().find_map(|item| {
        let target = item.target.map_or("time_s", |channel| channel.key());
        sanity::of_header(target, &item.header, item.scaled)
    });
    match finding {
        Some(finding) => Err(Failure::with_help(USAGE, finding.sentence, finding.help)),
        None => Ok(()),
    }
}

/// Looks at the data before `identify` does. What forbids an answer ends the command, with a result in which every
/// parameter is null; cautions go to stderr and to the notes of the run.
pub(super) fn before_identify(
    run: &mut Run,
    scenario: &Scenario,
    model: &Model,
    require: &[String],
    json: bool,
) -> Result<Vec<Finding>, Failure> {
    let findings = sanity::examine(run, scenario, model);
    let Some(refusal) = findings.iter().find(|finding| finding.refuses) else {
        caution(run, &findings);
        return Ok(findings);
    };
    let parameters: Map<String, Value> = model
        .slots()
        .iter()
        .map(|slot| {
            let value = serde_json::to_value(unanswered(slot, model, refusal));
            (slot.key(), value.unwrap_or_default())
        })
        .collect();
    let value = json!({
        "scheme": null,
        "parameters": parameters,
        "rows": run.rows(),
        "rows_used": scenario.samples(),
        "rows_dropped": run.rows_dropped,
        "input": scenario.input_channel.key(),
        "signals": provenance::signals(run),
        "findings": findings,
        "notes": notes(run, &findings),
    });
    if json {
        output::result(&value, true, |_| String::new())?;
    }
    output::warn(
        &findings
            .iter()
            .filter(|finding| *finding != refusal)
            .map(|finding| finding.sentence.clone())
            .collect::<Vec<_>>(),
    );
    let mut what = "nothing".to_owned();
    if !require.is_empty() {
        what = require.join(", ");
    }
    Err(failure(&what, refusal))
}

/// What a command that judges a model does with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Judging {
    /// Compares the model as given.
    AsGiven,
    /// Refits the given model: a record that excites nothing still has the verdict that nothing can be said.
    Refits,
    /// Has no model but the one that it fits to the data.
    FitsFirst,
}

/// Looks at the data before a command that judges a model; what cannot be judged ends it, the rest is cautions.
pub(super) fn before_judging(
    run: &mut Run,
    scenario: &Scenario,
    model: &Model,
    judging: Judging,
) -> Result<(), Failure> {
    let findings = sanity::examine(run, scenario, model);
    let forbids = |finding: &&Finding| {
        let excites_nothing = matches!(finding.kind, Kind::Steady | Kind::Standstill);
        finding.refuses
            && match judging {
                Judging::AsGiven => false,
                Judging::Refits => !excites_nothing,
                Judging::FitsFirst => true,
            }
    };
    if let Some(refusal) = findings.iter().find(forbids) {
        return Err(failure("nothing", refusal));
    }
    caution(run, &findings);
    Ok(())
}

fn failure(what: &str, refusal: &Finding) -> Failure {
    let can = if what == "nothing" { "can" } else { "cannot" };
    Failure::with_help(
        NOT_IDENTIFIABLE,
        format!("{what} {can} be identified: {}", refusal.sentence),
        &refusal.help,
    )
}

fn notes(run: &Run, findings: &[Finding]) -> Vec<String> {
    let found = findings.iter().map(|finding| finding.sentence.clone());
    run.notes.iter().cloned().chain(found).collect()
}

fn caution(run: &mut Run, findings: &[Finding]) {
    for finding in findings {
        output::warn(&[format!("{}; {}", finding.sentence, finding.help)]);
    }
    run.notes = notes(run, findings);
}

/// No value, with the reason; what the user fixed stays as given.
fn unanswered(slot: &Slot, model: &Model, refusal: &Finding) -> ParameterEstimate {
    let key = slot.key();
    match model.get(slot) {
        Some(value) if model.fixed.contains(&key) => ParameterEstimate {
            key,
            value: Some(value),
            std: Some(0.0),
            unit: slot.unit(),
            verdict: Verdict::Fixed,
            reason: None,
        },
        _ => ParameterEstimate::not_observable(&key, slot.unit(), refusal.sentence.clone()),
    }
}
