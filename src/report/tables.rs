//! Tables and lines that the reports share.

use super::page::{Cell, Page, Table};
use super::{Context, Facts, SAFETY_NOTICE};
use drivebench_link::drive_name;
use drivebench_model::plant::Model;
use drivebench_model::sample::ParameterEstimate;
use drivebench_model::text::number;

/// What the nameplate says of a parameter.
fn given(nameplate: Option<&Model>, key: &str) -> Option<f64> {
    let model = nameplate?;
    let slot = model.slots().into_iter().find(|slot| slot.key() == key)?;
    model.get(&slot)
}

fn given_in_words(nameplate: Option<&Model>, key: &str) -> String {
    given(nameplate, key).map_or_else(|| "-".to_owned(), |v| number::significant(v, 4))
}

/// Parameters side by side, keyed by `after`'s order; `before` may be empty.
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
    let of = |all: &'_ [ParameterEstimate], key: &str| all.iter().find(|p| p.key == key).cloned();
    let unit = |key: &str| of(after, key).or(of(before, key)).map_or("", |p| p.unit);
    let mut table = Table::of(keys)
        .column("parameter", |key| Cell::code(*key))
        .column("unit", |key| unit(key));
    if nameplate.is_some() {
        table = table.column("nameplate", |key| given_in_words(nameplate, key));
    }
    let models: &[_] = if before.is_empty() {
        &[("estimate ± std", "verdict", after)]
    } else {
        &[
            ("before ± std", "verdict before", before),
            ("after ± std", "verdict after", after),
        ]
    };
    for (value, verdict, found) in models {
        table = table
            .column(value, |key| {
                estimate(of(found, key), given(nameplate, key))[0].clone()
            })
            .column(verdict, |key| {
                estimate(of(found, key), given(nameplate, key))[1].clone()
            });
    }
    table.into()
}

/// The same for a card: keys carry their unit, and of the model before only the value is told. Heads that a narrow card goes
/// without, the first first, are [`SPARE`].
pub(crate) fn of_card(
    nameplate: Option<&Model>,
    before: &[ParameterEstimate],
    after: &[ParameterEstimate],
) -> Table {
    let is_alone = |own: &&ParameterEstimate| {
        let short = short_key(&own.key);
        let same = after.iter().filter(|other| short_key(&other.key) == short);
        same.count() == 1
    };
    let mut table = Table::of(after).column("parameter", |own| {
        let key = own.key.as_str();
        let key = if is_alone(own) { short_key(key) } else { key };
        key.to_owned()
    });
    if nameplate.is_some() {
        table = table.column("nameplate", |own| given_in_words(nameplate, &own.key));
    }
    if !before.is_empty() {
        table = table.column("before", |own| {
            let old = ParameterEstimate::find(before, &own.key);
            old.map_or("-".to_owned(), |old| old.number(1.0))
        });
    }
    let head = if before.is_empty() {
        "found ± std"
    } else {
        "after ± std"
    };
    table
        .column(head, |own| own.number(1.0))
        .column("verdict", |own| own.verdict.name())
        .into()
}

/// What a narrow card leaves out of it.
pub(crate) const SPARE: &[&str] = &["nameplate", "before"];

/// An effect's parameter by its own key.
fn short_key(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or(key)
}

/// Value and verdict; a model that does not have the parameter gives two dashes.
fn estimate(parameter: Option<ParameterEstimate>, nameplate: Option<f64>) -> [Cell; 2] {
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
        let when = if two { when } else { "" };
        let verdict = parameter.verdict_text();
        let sentence = format!("{}{when}: {verdict}", parameter.key);
        parameter.reason.is_some().then_some(sentence)
    };
    let old = before.iter().filter_map(|p| reason(" (before)", p));
    let new = after.iter().filter_map(|p| reason(" (after)", p));
    page.list(old.chain(new).collect());
}

/// Date, drive, serial number and motor, at the start of every report; what is not told is said to be so.
pub(super) fn about(page: &mut Page, context: &Context) {
    let identity = |key: &str| {
        let mut facts = context.identity.iter();
        let fact = facts.find(|(label, _)| label == key);
        fact.map(|(_, value)| value.trim()).unwrap_or_default()
    };
    let drive = drive_name(identity("vendor"), identity("product"));
    let told = |text: &str| if text.is_empty() { "not told" } else { text }.to_owned();
    let facts = [
        ("date", context.date.as_str()),
        ("drive", &drive),
        ("serial number", identity("serial number")),
        ("motor", &context.motor),
    ];
    page.about(
        facts
            .map(|(label, value)| (label.to_owned(), told(value)))
            .into(),
    );
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
        .as_ref()
        .map_or("none".to_owned(), u64::to_string);
    let mut facts: Facts = vec![("seed".to_owned(), seed)];
    facts.extend(context.versions.iter().cloned());
    for (position, folder) in context.run_folders.iter().enumerate() {
        facts.push((format!("run {}", position + 1), folder.clone()));
    }
    page.facts(facts);
    page.notice(SAFETY_NOTICE);
}
