//! Tables and lines that the reports share.

use super::page::{Cell, Page, Table};
use super::{Context, Facts, SAFETY_NOTICE};
use crate::plant::Model;
use crate::sample::ParameterEstimate;
use crate::text::number;

/// Parameters side by side, keyed by `after`'s order; `before` may be empty.
fn parameters(
    nameplate: Option<&Model>,
    before: &[ParameterEstimate],
    after: &[ParameterEstimate],
) -> Table {
    let given = |key: &str| {
        let model = nameplate?;
        let slot = model.slots().into_iter().find(|slot| slot.key() == key)?;
        model.get(&slot)
    };
    let mut keys: Vec<&str> = after.iter().map(|p| p.key.as_str()).collect();
    keys.extend(before.iter().map(|p| p.key.as_str()));
    let mut head = vec!["parameter", "unit"];
    if nameplate.is_some() {
        head.push("nameplate");
    }
    if before.is_empty() {
        head.extend(["estimate ± std", "verdict"]);
    } else {
        head.extend([
            "before ± std",
            "verdict before",
            "after ± std",
            "verdict after",
        ]);
    }
    let mut rows = Vec::new();
    for (position, key) in keys.iter().enumerate() {
        if keys[..position].contains(key) {
            continue;
        }
        let old = before.iter().find(|p| p.key == *key);
        let new = after.iter().find(|p| p.key == *key);
        let unit = new.or(old).map_or("", |p| p.unit);
        let mut row = vec![Cell::code(*key), Cell::text(unit)];
        if nameplate.is_some() {
            row.push(Cell::text(
                given(key).map_or("-".to_owned(), |v| number::significant(v, 4)),
            ));
        }
        if !before.is_empty() {
            row.extend(estimate(old, given(key)));
        }
        row.extend(estimate(new, given(key)));
        rows.push(row);
    }
    Table { head, rows }
}

/// Value and verdict; a model that does not have the parameter gives two dashes.
fn estimate(parameter: Option<&ParameterEstimate>, nameplate: Option<f64>) -> [Cell; 2] {
    let Some(parameter) = parameter else {
        return [Cell::text("-"), Cell::text("not in this model")];
    };
    let mut value = Cell::text(parameter.number(1.0));
    if let (Some(found), Some(given)) = (parameter.value, nameplate)
        && given.abs() > 0.0
        && found.is_finite()
        && parameter.verdict != crate::sample::Verdict::Fixed
    {
        let difference = number::fixed(100.0 * (found / given - 1.0), 1);
        value = value.with_note(format!("{difference} % off the nameplate"));
    }
    [value, Cell::text(parameter.verdict.name())]
}

/// Parameters with their verdicts, and below them the reason of every verdict that has one.
pub(super) fn parameter_section(
    page: &mut Page,
    nameplate: Option<&Model>,
    before: &[ParameterEstimate],
    after: &[ParameterEstimate],
) {
    page.section("Parameters");
    page.table(parameters(nameplate, before, after));
    let two = !before.is_empty();
    let reason = |when: &str, parameter: &ParameterEstimate| {
        let when = if two {
            format!(" ({when})")
        } else {
            String::new()
        };
        let verdict = parameter.verdict_text();
        parameter
            .reason
            .as_ref()
            .map(|_| format!("{}{when}: {verdict}", parameter.key))
    };
    let mut reasons: Vec<String> = before.iter().filter_map(|p| reason("before", p)).collect();
    reasons.extend(after.iter().filter_map(|p| reason("after", p)));
    page.list(reasons);
}

/// What is to be known of the data before any figure is believed; nothing where there is nothing.
pub(super) fn data_notes(page: &mut Page, context: &Context) {
    let mut notes = context.notes.clone();
    if context.rows_dropped > 0 {
        notes.push(format!(
            "Rows of the file that were dropped: {}.",
            context.rows_dropped
        ));
    }
    if !notes.is_empty() {
        page.section("About the data");
        page.list(notes);
    }
}

/// Conditions of the measurement, at the end of every report.
pub(super) fn conditions(page: &mut Page, context: &Context) {
    page.section("Drive and link");
    let mut facts = vec![("target".to_owned(), context.target.name().to_owned())];
    facts.extend(context.identity.iter().cloned());
    facts.extend(context.link.iter().cloned());
    page.facts(facts);
    if !context.plan.is_empty() {
        page.section("Plan and limits");
        page.facts(context.plan.clone());
    }
    page.section("Repeat this");
    let seed = context
        .seed
        .map_or("none".to_owned(), |seed| seed.to_string());
    let mut facts: Facts = vec![("seed".to_owned(), seed)];
    facts.extend(context.versions.iter().cloned());
    for (position, folder) in context.run_folders.iter().enumerate() {
        facts.push((format!("run {}", position + 1), folder.clone()));
    }
    page.facts(facts);
    page.notice(SAFETY_NOTICE);
}
