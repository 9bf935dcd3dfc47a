//! `effects`: the catalogue, or one effect's card.

use std::fmt::Write as _;

use serde_json::{Value, json};

use super::failure::{Failure, USAGE};
use super::output;
use crate::config_text::help_for_unknown;
use crate::plant::{Effect, Enters, effect};

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
    let chosen = match &arguments.id {
        None => effect::CATALOGUE.to_vec(),
        Some(id) => vec![effect::find(id).ok_or_else(|| {
            let known: Vec<&str> = effect::CATALOGUE
                .iter()
                .map(|effect| effect.card().id)
                .collect();
            let help = help_for_unknown(id, known.iter().copied());
            Failure::with_help(
                USAGE,
                format!("effect {id:?} is not in the catalogue"),
                help,
            )
        })?],
    };
    let value: Value = chosen.iter().map(|effect| card_json(*effect)).collect();
    output::result(&value, arguments.json, |_| {
        if arguments.id.is_some() {
            card_text(chosen[0])
        } else {
            list_text(&chosen)
        }
    })
}

fn card_json(effect: &dyn Effect) -> Value {
    let card = effect.card();
    let parameters: Vec<Value> = effect
        .parameters()
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

fn list_text(effects: &[&'static dyn Effect]) -> String {
    let mut text = String::new();
    for effect in effects {
        let card = effect.card();
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

fn card_text(effect: &dyn Effect) -> String {
    let card = effect.card();
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
    for spec in effect.parameters() {
        let _ = writeln!(text, "{:<11} {} [{}]", "parameter", spec.key, spec.unit);
    }
    text
}
