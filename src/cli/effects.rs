//! `effects`: the catalogue, or one effect's card.

use std::fmt::Write as _;

use serde_json::{Value, json};

use super::failure::{Failure, USAGE};
use super::output;
use crate::config_text::help_for_unknown;
use crate::plant::{Card, Enters, ParameterSpec, effect};

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

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let catalogue = effect::CATALOGUE
        .iter()
        .map(|effect| (effect.card(), effect.parameters()));
    // What the user or the data define has its parameters in its settings.
    let defined = effect::FAMILIES.iter().map(|card| (*card, &[][..]));
    let mut chosen: Vec<Entry> = catalogue.chain(defined).collect();
    if let Some(id) = &arguments.id {
        let known: Vec<&str> = chosen.iter().map(|(card, _)| card.id).collect();
        let help = help_for_unknown(id, known.iter().copied());
        chosen.retain(|(card, _)| card.id == id);
        if chosen.is_empty() {
            let headline = format!("effect {id:?} is not in the catalogue");
            return Err(Failure::with_help(USAGE, headline, help));
        }
    }
    let value: Value = chosen.iter().map(|entry| card_json(*entry)).collect();
    output::result(&value, arguments.json, |_| {
        if arguments.id.is_some() {
            card_text(chosen[0])
        } else {
            list_text(&chosen)
        }
    })
}

/// A card and the parameters that go with it.
type Entry = (&'static Card, &'static [ParameterSpec]);

fn card_json((card, parameters): Entry) -> Value {
    let parameters: Vec<Value> = parameters
        .iter()
        .map(|spec| json!({"key": spec.key, "unit": spec.unit}))
        .collect();
    json!({
        "id": card.id, "name": card.name, "enters": enters(card.enters), "equation": card.equation,
        "causes": card.causes, "looks_like": card.looks_like, "excite": card.excite, "remedy": card.remedy,
        "parameters": parameters,
    })
}

const fn enters(enters: Enters) -> &'static str {
    match enters {
        Enters::Voltage => "voltage",
        Enters::Torque => "torque",
        Enters::Both => "both",
        Enters::Path => "path",
    }
}

fn list_text(entries: &[Entry]) -> String {
    let mut text = String::new();
    for (card, _) in entries {
        let _ = writeln!(
            text,
            "{:<24} {:<8} {}",
            card.id,
            enters(card.enters),
            card.equation
        );
    }
    text
}

fn card_text((card, parameters): Entry) -> String {
    let mut text = format!("{} ({})\n\n", card.name, card.id);
    for (title, body) in [
        ("equation", card.equation),
        ("enters", enters(card.enters)),
        ("causes", card.causes),
        ("looks like", card.looks_like),
        ("excite it", card.excite),
        ("remedy", card.remedy),
    ] {
        let _ = writeln!(text, "{title:<11} {body}");
    }
    for spec in parameters {
        let _ = writeln!(text, "{:<11} {} [{}]", "parameter", spec.key, spec.unit);
    }
    text
}
