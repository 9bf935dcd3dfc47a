//! The `parameters` of a custom effect, as they are declared in a file or on the command line.
//!
//! `a = 1e-6` a value; `a = {}` to be fitted; `b = { value = 9.0, guess = 10.0, min = 1.0, max = 40.0, unit = "rad/s" }`
//! whatever is known; `["a", "b"]` a list of names to be fitted.

use super::expression::VARIABLES;
use crate::plant::effect::definition::{DefinitionError, leaked, number_of, unknown_key};
use crate::plant::effect::grammar::{FUNCTIONS, PI};
use crate::plant::effect::{ParameterRole, ParameterSpec};
use crate::plant::run_scales::Measure;

#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Declared {
    pub(super) name: String,
    pub(super) value: Option<f64>,
    pub(super) is_coefficient: bool,
    guess: Option<f64>,
    min: Option<f64>,
    max: Option<f64>,
    unit: Option<String>,
}

/// Reads the declarations, in the order of their names.
pub(super) fn read(value: Option<&toml::Value>) -> Result<Vec<Declared>, DefinitionError> {
    let wrong_form = || {
        let help = "as parameters = { a = 1e-6, b = {} } or parameters = [\"a\", \"b\"]";
        let message = "parameters must be a table or a list of names";
        DefinitionError::new("parameters", message, help)
    };
    let nothing = toml::Value::Table(toml::Table::new());
    let declared: Vec<Declared> = match value {
        None => Vec::new(),
        Some(toml::Value::Array(names)) => (names.iter())
            .map(|name| one(name.as_str().ok_or_else(wrong_form)?, &nothing))
            .collect::<Result<_, _>>()?,
        Some(toml::Value::Table(table)) => {
            (table.iter()).map(|(name, value)| one(name, value)).collect::<Result<_, _>>()?
        }
        Some(_) => return Err(wrong_form()),
    };
    for (index, one) in declared.iter().enumerate() {
        if declared[..index].iter().any(|other| other.name == one.name) {
            let message = format!("parameter `{}` stands twice", one.name);
            return Err(DefinitionError::new("parameters", message, "each name once"));
        }
    }
    Ok(declared)
}

fn one(name: &str, value: &toml::Value) -> Result<Declared, DefinitionError> {
    let is_first = |c: char| c == '_' || c.is_alphabetic();
    let is_name =
        name.starts_with(is_first) && name.chars().all(|c| is_first(c) || c.is_alphanumeric());
    if !is_name {
        let message = format!("{name:?} is not a name for a parameter");
        let help = "letters, digits and _, the first not a digit";
        return Err(DefinitionError::new(name, message, help));
    }
    if VARIABLES.contains(&name) || FUNCTIONS.contains(&name) || name == PI {
        let message = format!("`{name}` has a meaning already and cannot name a parameter");
        let (variables, functions) = (VARIABLES.join(", "), FUNCTIONS.join(", "));
        let help = format!("taken: {variables}, {PI}, {functions}");
        return Err(DefinitionError::new(name, message, help));
    }
    let mut declared = Declared { name: name.to_owned(), ..Declared::default() };
    let toml::Value::Table(table) = value else {
        declared.value = Some(number_of(name, value)?);
        return Ok(declared);
    };
    for (key, value) in table {
        let number = || number_of(name, value).map(Some);
        match key.as_str() {
            "value" => declared.value = number()?,
            "guess" => declared.guess = number()?,
            "min" => declared.min = number()?,
            "max" => declared.max = number()?,
            "unit" => {
                let unit = value.as_str().ok_or_else(|| {
                    let message = format!("unit of `{name}` is not a text");
                    DefinitionError::new(name, message, "as \"N.m\"")
                })?;
                declared.unit = Some(unit.to_owned());
            }
            other => {
                let mut error = unknown_key(other, &["value", "guess", "min", "max", "unit"]);
                name.clone_into(&mut error.key);
                return Err(error);
            }
        }
    }
    Ok(declared)
}

impl Declared {
    /// Completes a shape: a guess, and bounds at a hundredth and at a hundred times the guess.
    pub(super) fn complete(&mut self) -> Result<(), DefinitionError> {
        let name = &self.name;
        let refuse = |message: String, help: &str| Err(DefinitionError::new(name, message, help));
        if !self.is_coefficient {
            let middle = || Some(0.5 * (self.min? + self.max?));
            let Some(guess) = self.guess.or(self.value).or_else(middle) else {
                let message =
                    format!("the expression is not linear in `{name}`, so it needs a guess");
                return refuse(
                    message,
                    &format!("as {name} = {{ guess = 10.0, min = 1.0, max = 40.0 }}"),
                );
            };
            if guess == 0.0 && (self.min.is_none() || self.max.is_none()) {
                let message = format!("`{name}` is guessed as 0, which gives no size");
                return refuse(message, "give min and max");
            }
            let ends = (guess / 100.0, guess * 100.0);
            self.min.get_or_insert(f64::min(ends.0, ends.1));
            self.max.get_or_insert(f64::max(ends.0, ends.1));
            self.guess = Some(guess);
        }
        let (min, max) = self.bounds();
        for (what, value) in [("value", self.value), ("guess", self.guess)] {
            if let Some(value) = value.filter(|value| !(min..=max).contains(value)) {
                let message = format!("{what} of `{name}` is {value}, outside of {min} to {max}");
                return refuse(message, "widen min and max");
            }
        }
        if min < max {
            return Ok(());
        }
        refuse(format!("min of `{name}` is {min} and max {max}"), "min must be below max")
    }

    fn bounds(&self) -> (f64, f64) {
        (self.min.unwrap_or(-f64::MAX), self.max.unwrap_or(f64::MAX))
    }

    /// The identity of the declaration, without its value.
    pub(super) fn key(&self) -> String {
        let (guess, min, max, unit) = (self.guess, self.min, self.max, &self.unit);
        format!("|{} {guess:?} {min:?} {max:?} {unit:?}", self.name)
    }

    pub(super) fn spec(&self) -> ParameterSpec {
        let (min, max) = self.bounds();
        let key = leaked(&self.name);
        let unit = leaked(self.unit.as_deref().unwrap_or("-"));
        if self.is_coefficient {
            let size = self.guess.filter(|guess| *guess != 0.0);
            return ParameterSpec {
                min,
                max,
                ..ParameterSpec::coefficient(key, unit, size.map_or(1.0, f64::abs))
            };
        }
        let guess = self.guess.unwrap_or(0.5 * (min + max));
        let logarithmic = min > 0.0;
        let (grid, scale) = if logarithmic {
            ([guess / 3.0, guess, guess * 3.0], guess)
        } else {
            let size = guess.abs().max(1e-9);
            let grid = [0.5 * (guess + min), guess, 0.5 * (guess + max)];
            (grid, 0.1 * (max - min).min(10.0 * size))
        };
        let grid: Vec<f64> = grid.iter().map(|shape| shape.clamp(min, max)).collect();
        ParameterSpec {
            key,
            unit,
            of: Measure::Absolute,
            min,
            max,
            most_of_length: f64::INFINITY,
            scale,
            role: ParameterRole::Shape,
            logarithmic,
            shapes: grid.leak(),
        }
    }

    /// The declaration with a value, as a file holds it.
    pub(super) fn written(&self, value: Option<f64>) -> toml::Value {
        let keys: [(&str, Option<toml::Value>); 5] = [
            ("value", value.map(Into::into)),
            ("guess", self.guess.map(Into::into)),
            ("min", self.min.map(Into::into)),
            ("max", self.max.map(Into::into)),
            ("unit", self.unit.clone().map(Into::into)),
        ];
        let given = keys.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?)));
        let table: toml::Table = given.collect();
        match value {
            Some(value) if table.len() == 1 => value.into(),
            _ => toml::Value::Table(table),
        }
    }
}
