//! `effects`: the catalogue of effects, one line for each, or the card of one effect.

use serde_json::{Value, json};

use crate::report::{Document, Tone, card_facts};
use crate::runtime::{Failure, Form, Terminal};
use drivebench_model::config_text::help_for_unknown;
use drivebench_model::plant::{Card, Enters, Measure, ParameterRole, ParameterSpec, effect};
use drivebench_model::text::lines::wrapped;
use drivebench_model::text::number::with_digits;

/// List the physical effects the program can name, or show one effect's card
#[derive(clap::Args)]
#[command(after_help = "Example:\n  drivebench effects stribeck_friction")]
pub(super) struct Arguments {
    /// Id of one effect
    id: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let chosen = chosen(arguments.id.as_deref())?;
    let value: Value = chosen.iter().map(|entry| card_json(*entry)).collect();
    if arguments.id.is_some() {
        return terminal.document(&value, Form::full(arguments.json), &card_document(chosen[0]));
    }
    terminal.result(&value, arguments.json, |_| list_text(&chosen))
}

/// A card and the parameters that go with it.
type Entry = (&'static Card, &'static [ParameterSpec]);

fn chosen(id: Option<&str>) -> Result<Vec<Entry>, Failure> {
    let catalogue = effect::CATALOGUE.iter().map(|effect| (effect.card(), effect.parameters()));
    // An effect that the user or the data define has its parameters in its settings.
    let defined = effect::FAMILIES.iter().map(|card| (*card, &[][..]));
    let mut chosen: Vec<Entry> = catalogue.chain(defined).collect();
    if let Some(id) = id {
        chosen.retain(|(card, _)| card.id == id);
        if chosen.is_empty() {
            return Err(unknown_effect(id));
        }
    }
    Ok(chosen)
}

pub(super) fn unknown_effect(id: &str) -> Failure {
    let families = effect::FAMILIES.iter().map(|card| card.id);
    let effects = effect::CATALOGUE.iter().map(|effect| effect.card().id);
    let help = help_for_unknown(id, effects.chain(families));
    Failure::usage(format!("effect {id:?} is not in the catalogue"), help)
}

fn card_json((card, parameters): Entry) -> Value {
    let parameters: Vec<Value> = parameters.iter().map(parameter_json).collect();
    json!({
        "id": card.id, "name": card.name, "enters": enters(card.enters), "equation": card.equation,
        "causes": card.causes, "looks_like": card.looks_like, "excite": card.excite, "remedy": card.remedy,
        "needs_angle": card.needs_angle, "parameters": parameters,
    })
}

/// A bound in multiples of the run's scale; infinite, it is null.
fn bound(value: f64, spec: &ParameterSpec) -> Option<f64> {
    (value.abs() < f64::MAX).then(|| in_scales(value, spec))
}

fn in_scales(value: f64, spec: &ParameterSpec) -> f64 {
    match spec.of {
        Measure::Absolute => value,
        of => with_digits(value / of.reference(), 3),
    }
}

fn parameter_json(spec: &ParameterSpec) -> Value {
    let tried: Vec<f64> = spec.shapes.iter().map(|shape| in_scales(*shape, spec)).collect();
    json!({
        "key": spec.key, "unit": spec.unit, "found_as": role(spec.role),
        "relative_to": spec.of.names().0,
        "min": bound(spec.min, spec), "max": bound(spec.max, spec), "tried": tried,
    })
}

const fn role(role: ParameterRole) -> &'static str {
    match role {
        ParameterRole::Coefficient => "coefficient",
        ParameterRole::Shape => "shape",
        ParameterRole::Choice => "choice",
        ParameterRole::EventTime => "event_time",
    }
}

const fn enters(enters: Enters) -> &'static str {
    match enters {
        Enters::Voltage => "voltage",
        Enters::Torque => "torque",
        Enters::Both => "both",
        Enters::Path => "path",
    }
}

/// Longest line, in columns.
const WIDTH: usize = 96;

/// `text` under `title`, whose column is `room` wide, broken between words.
fn block(title: &str, room: usize, text: &str) -> String {
    let rows = wrapped(text, WIDTH - room);
    format!("{title:<room$}{}\n", rows.join(&format!("\n{:room$}", "")))
}

fn list_text(entries: &[Entry]) -> String {
    let longest = |of: fn(&Card) -> usize| entries.iter().map(|(card, _)| of(card)).max();
    let ids = longest(|card| card.id.len()).unwrap_or(0) + 2;
    let balances = longest(|card| enters(card.enters).len()).unwrap_or(0) + 2;
    entries
        .iter()
        .map(|(card, _)| {
            let title = format!("{:<ids$}{:<balances$}", card.id, enters(card.enters));
            block(&title, ids + balances, card.equation)
        })
        .collect()
}

fn card_document((card, parameters): Entry) -> Document {
    let mut document = Document::of(Tone::Plain, "", format!("{} ({})", card.name, card.id));
    let enters = match card.enters {
        Enters::Voltage => "the voltage balance, subtracted from the voltage applied",
        Enters::Torque => "the torque balance, subtracted from the torque of the motor",
        Enters::Both if effect::family(card.id).is_some() => {
            "the voltage or the torque balance, by its settings"
        }
        Enters::Both => "the voltage and the torque balance",
        Enters::Path => "neither balance: it is in the path of the command or of the measurement",
    };
    document.labelled("enters", [enters]);
    card_facts(&mut document, card);
    let angle = "needed: as measured, else integrated from the speed, with unknown start and drift";
    document.labelled("angle", card.needs_angle.then_some(angle));
    document.labelled("parameter", parameters.iter().map(parameter_text));
    document
}

fn parameter_text(spec: &ParameterSpec) -> String {
    let end = |value: f64| bound(value, spec).map(|value| value.to_string());
    let bounds = match (end(spec.min), end(spec.max)) {
        (Some(min), Some(max)) => format!("{min} to {max}"),
        (Some(min), None) => format!("{min} or more"),
        (None, _) => "any value".to_owned(),
    };
    let tried = spec.shapes.iter().map(|shape| in_scales(*shape, spec).to_string());
    let tried: Vec<String> = tried.collect();
    let of = match spec.of.names().1 {
        "" => String::new(),
        scale => format!(" {scale}"),
    };
    let how = match spec.role {
        ParameterRole::Coefficient => format!("{bounds}{of}"),
        ParameterRole::Shape => {
            format!("{bounds}{of}; not given, it is fitted from {}", tried.join(", "))
        }
        ParameterRole::Choice => {
            let (first, last) = (&tried[0], &tried[tried.len() - 1]);
            format!("{bounds}; not given, it is chosen from {first} to {last}")
        }
        ParameterRole::EventTime => {
            "since the run's first command; found anew in each run, unless it is fixed".to_owned()
        }
    };
    format!("{} [{}]: {how}", spec.key, spec.unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn list_and_cards_keep_to_the_width_and_are_complete() {
        let entries: Vec<Entry> =
            effect::CATALOGUE.iter().map(|effect| (effect.card(), effect.parameters())).collect();
        let list = list_text(&entries);
        for (card, parameters) in entries {
            let rows = card_document((card, parameters)).full(WIDTH);
            let rows: Vec<String> = rows.iter().map(ToString::to_string).collect();
            let text = rows.join("\n");
            for line in text.lines().chain(list.lines()) {
                assert!(line.chars().count() <= WIDTH, "{line}");
                assert_eq!(line, line.trim_end());
            }
            let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
            let (text, list) = (words(&text), words(&list));
            for body in [card.causes, card.looks_like, card.excite, card.remedy] {
                assert!(text.contains(body), "{}: {body}", card.id);
            }
            assert!(list.contains(card.equation), "{}", card.id);
            for spec in parameters {
                assert!(text.contains(&format!("{} [{}]", spec.key, spec.unit)));
            }
        }
    }
}
