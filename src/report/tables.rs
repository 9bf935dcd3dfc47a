//! Tables and lines that the reports share.

use super::wording::nameplate;
use super::{Cell, Context, Document, Facts, SAFETY_NOTICE, Table};
use drivebench_identify::nameplate::{Comparison, Fits};
use drivebench_link::drive_name;
use drivebench_model::plant::Model;
use drivebench_model::sample::ParameterEstimate;
use drivebench_model::text::number;

fn given(nameplate: Option<&Model>, key: &str) -> Option<f64> {
    let model = nameplate?;
    let slot = model.slots().into_iter().find(|slot| slot.key() == key)?;
    model.get(&slot)
}

/// Parameters side by side, in the order of `after`; `before` may be empty. An effect's parameter goes by its own key where
/// no other one has it.
fn parameters(
    nameplate: Option<&Model>,
    before: &[ParameterEstimate],
    after: &[ParameterEstimate],
) -> Table {
    let mut keys: Vec<&str> = Vec::new();
    for parameter in after.iter().chain(before) {
        if !keys.contains(&&parameter.key[..]) {
            keys.push(&parameter.key);
        }
    }
    let shown = |key: &str| {
        let is_alone = keys.iter().filter(|other| short_key(other) == short_key(key)).count() == 1;
        Cell::code(if is_alone { short_key(key) } else { key })
    };
    let found = |all: &[ParameterEstimate], key: &str| {
        ParameterEstimate::find(all, key).map_or("", |found| found.unit)
    };
    let unit = |key: &str| match found(after, key) {
        "" => found(before, key),
        unit => unit,
    };
    let mut table = Table::of(keys.clone())
        .column("parameter", |key| shown(key))
        .column("unit", |key| unit(key));
    if nameplate.is_some() {
        table = table.column("nameplate", |key| {
            given(nameplate, key).map_or_else(|| "-".to_owned(), |v| number::significant(v, 4))
        });
    }
    let models: &[_] = if before.is_empty() {
        &[("found ± std", "verdict", after)]
    } else {
        &[("before ± std", "verdict before", before), ("after ± std", "verdict", after)]
    };
    for (value, verdict, found) in models {
        let cells =
            |key: &str| estimate(ParameterEstimate::find(found, key), given(nameplate, key));
        table = table
            .column(value, |key| cells(key)[0].clone())
            .column(verdict, |key| cells(key)[1].clone());
    }
    table.into()
}

/// Columns that are left out on a narrow terminal, in this order.
const SPARE: &[&str] = &["verdict before", "unit", "nameplate", "before ± std"];

fn short_key(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or(key)
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
        && parameter.verdict != drivebench_model::sample::Verdict::Fixed
    {
        let difference = number::fixed(100.0 * (found / given - 1.0), 1);
        value = value.with_note(format!("{difference} % from the nameplate"));
    }
    [value, Cell::text(parameter.verdict.name())]
}

/// Parameters with their verdicts on the card, under `label`, and below them the reason of every verdict that has one.
pub(crate) fn parameter_section(
    document: &mut Document,
    label: &str,
    nameplate: Option<&Model>,
    before: &[ParameterEstimate],
    after: &[ParameterEstimate],
    least: usize,
) {
    document.section("Parameters");
    document.table_on_card(label, parameters(nameplate, before, after), SPARE, least);
    let two = !before.is_empty();
    let reason = |when: &str, parameter: &ParameterEstimate| {
        let when = if two { when } else { "" };
        let reason = parameter.reason.as_ref()?;
        Some(format!("{}{when}: {reason}", parameter.key))
    };
    let old = before.iter().filter_map(|p| reason(" (before)", p));
    document.say("", old.chain(after.iter().filter_map(|p| reason(" (after)", p))), 0);
}

/// Whether the nameplate fits, what differs and why; the values that fit are not on the card.
pub(crate) fn nameplate_section(document: &mut Document, nameplate: Option<&Comparison>) {
    let Some(nameplate) = nameplate else { return };
    let differences = nameplate.differences().map(nameplate::row);
    let causes = nameplate.causes.iter().map(|own| format!("likely: {}", nameplate::cause(own)));
    let verdict = std::iter::once(nameplate::nameplate(nameplate));
    document.say("plate", verdict.chain(differences).chain(causes), 1);
    let others = nameplate.rows.iter().filter(|row| row.fits != Fits::No);
    document.labelled("", others.map(nameplate::row));
}

/// Date, drive, serial number and motor, at the start of every report.
pub(super) fn about(document: &mut Document, context: &Context) {
    let identity = |key: &str| {
        let fact = context.identity.iter().find(|(label, _)| label == key);
        fact.map(|(_, value)| value.trim()).unwrap_or_default()
    };
    let drive = drive_name(identity("vendor"), identity("product"));
    let stated = |text: &str| if text.is_empty() { "not stated" } else { text }.to_owned();
    let facts = [
        ("date", context.date.as_str()),
        ("drive", &drive),
        ("serial number", identity("serial number")),
        ("motor", &context.motor),
    ];
    document.about(facts.map(|(label, value)| (label.to_owned(), stated(value))).into());
}

/// Notes on the data, before the figures; nothing where there is none.
pub(super) fn data_notes(document: &mut Document, context: &Context) {
    let mut notes = context.notes.clone();
    if context.rows_dropped > 0 {
        notes.push(format!("Rows of the file that were dropped: {}.", context.rows_dropped));
    }
    document.section("About the data");
    document.say("note", notes, 1);
}

pub(super) fn conditions(document: &mut Document, context: &Context) {
    document.section("Drive and link");
    let mut facts = vec![("target".to_owned(), context.target.name().to_owned())];
    facts.extend(context.identity.iter().cloned());
    facts.extend(context.link.iter().cloned());
    document.facts(facts);
    if !context.plan.is_empty() {
        document.section("Plan and limits");
        document.facts(context.plan.clone());
    }
    document.section("Repeat this");
    let seed = context.seed.as_ref().map_or("none".to_owned(), u64::to_string);
    let mut facts: Facts = vec![("seed".to_owned(), seed)];
    facts.extend(context.versions.iter().cloned());
    for (position, folder) in context.run_folders.iter().enumerate() {
        facts.push((format!("run {}", position + 1), folder.clone()));
    }
    document.facts(facts);
    document.notice(SAFETY_NOTICE);
}
