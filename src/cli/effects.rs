//! `effects`: the catalogue, or one effect's card.

use serde_json::Value;

use super::failure::Failure;
use super::output;
use crate::app::catalogue::{card_document, card_json, chosen, list_text};

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
    let chosen = chosen(arguments.id.as_deref())?;
    let value: Value = chosen.iter().map(|entry| card_json(*entry)).collect();
    if arguments.id.is_some() {
        return output::document(&value, arguments.json, true, &card_document(chosen[0]));
    }
    output::result(&value, arguments.json, |_| list_text(&chosen))
}
