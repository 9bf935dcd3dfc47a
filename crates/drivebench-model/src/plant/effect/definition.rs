//! Definitions of effects: errors, settings, and interning.
//!
//! The rest of the program takes effects as `&'static dyn Effect`. A definition is therefore kept for the life of the
//! process, once: the same definition gives the same reference. That is bounded, because definitions come only from model
//! files, command lines and axis maps; fits, bootstraps and simulations change values, which are no part of a definition.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use thiserror::Error;

use super::{Balance, Effect};
use crate::config_text::help_for_unknown;

#[derive(Clone, Debug, Error, PartialEq)]
#[error("{message}")]
pub struct DefinitionError {
    pub key: String,
    /// Byte within the setting's text, where the position of the mistake is known.
    pub offset: Option<usize>,
    pub message: String,
    pub help: String,
}

impl DefinitionError {
    pub(super) fn new(key: &str, message: impl Into<String>, help: impl Into<String>) -> Self {
        Self { key: key.to_owned(), offset: None, message: message.into(), help: help.into() }
    }
}

/// An effect that settings define, with the values that stand there too.
pub(super) type Defined = Result<(&'static dyn Effect, Vec<Option<f64>>), DefinitionError>;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// A key for each.
    Keys,
    /// All in one list under this key.
    List(&'static str),
    /// In a table of this name.
    Table(&'static str),
}

/// The effect with this key, made the first time.
pub(super) fn interned(key: &str, make: impl FnOnce() -> Box<dyn Effect>) -> &'static dyn Effect {
    static KNOWN: Mutex<Option<HashMap<String, &'static dyn Effect>>> = Mutex::new(None);
    // A poisoned lock is harmless: entries are inserted complete.
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    *known.get_or_insert_default().entry(key.to_owned()).or_insert_with(|| Box::leak(make()))
}

/// A text that lives as long as the effect that it belongs to.
pub(super) fn leaked(text: &str) -> &'static str {
    Box::leak(text.to_owned().into_boxed_str())
}

pub(super) fn unknown_key(key: &str, allowed: &[&str]) -> DefinitionError {
    let help = help_for_unknown(key, allowed.iter().copied());
    DefinitionError::new(key, format!("unknown key `{key}`"), help)
}

pub(super) fn text_of<'a>(
    settings: &'a toml::Table,
    key: &str,
    example: &str,
) -> Result<&'a str, DefinitionError> {
    let (at, message) = match settings.get(key) {
        Some(toml::Value::String(text)) => return Ok(text),
        Some(other) => (key, format!("{key} is a {}, expected a text", other.type_str())),
        None => ("id", format!("{key} is missing")),
    };
    Err(DefinitionError::new(at, message, format!("as {key} = {example:?}")))
}

pub(super) fn balance_of(settings: &toml::Table) -> Result<Balance, DefinitionError> {
    match text_of(settings, "equation", "torque")? {
        "torque" => Ok(Balance::Torque),
        "voltage" => Ok(Balance::Voltage),
        other => {
            let message = format!("equation {other:?} is not known");
            Err(DefinitionError::new("equation", message, "torque or voltage"))
        }
    }
}

pub(super) fn number_of(key: &str, value: &toml::Value) -> Result<f64, DefinitionError> {
    let (message, help) = match value.as_float().or(value.as_integer().map(|whole| whole as f64)) {
        Some(number) if number.is_finite() => return Ok(number),
        Some(number) => (format!("{key} = {number} is not allowed"), "a finite number"),
        None => (format!("{key} is a {}, expected a number", value.type_str()), "as 0.02"),
    };
    Err(DefinitionError::new(key, message, help))
}
