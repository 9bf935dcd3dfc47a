//! Effects that are defined by settings in a model file.
//!
//! ```text
//! id = "custom", "custom_NAME"   ->  custom::define ----.
//! id = "table",  "table_NAME"    ->  table::define  ----+--> interned --> &'static dyn Effect
//! ```

use super::definition::{Defined, DefinitionError};
use super::{Card, custom, table};

/// Families of effects whose settings stand in the model.
pub const FAMILIES: [&Card; 2] = [&custom::CARD, &table::CARD];

/// The family that this id belongs to: `custom`, `custom_pump`, `table`, `table_speed`.
pub fn family(id: &str) -> Option<&'static Card> {
    FAMILIES.into_iter().find(|card| {
        id.strip_prefix(card.id).is_some_and(|rest| {
            rest.is_empty()
                || (rest.len() > 1
                    && rest.starts_with('_')
                    && rest.chars().all(|c| c == '_' || c.is_ascii_alphanumeric()))
        })
    })
}

/// The effect that `settings` define, as they stand in an `[[effect]]` of a model file, with the values given there.
pub fn define(id: &str, settings: &toml::Table) -> Defined {
    match family(id).map(|card| card.id) {
        Some("custom") => custom::define(id, settings),
        Some("table") => table::define(id, settings),
        _ => {
            let message = format!("effect {id:?} is not defined by settings");
            let help = "ids that are: custom, custom_NAME, table, table_NAME";
            Err(DefinitionError::new("id", message, help))
        }
    }
}
