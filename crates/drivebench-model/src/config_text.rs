//! Strict TOML: an unknown key is an error with its line, its column and the nearest key that exists.

mod wrong_unit;

use serde::de::DeserializeOwned;
use thiserror::Error;

#[derive(Clone, Debug, Error, PartialEq)]
#[error("{file}:{line}:{column}: {message}")]
pub struct ConfigError {
    pub file: String,
    pub line: usize,
    pub column: usize,
    pub message: String,
    pub help: String,
}

impl ConfigError {
    /// An error at a byte offset of the text; within a character it is at its beginning.
    pub fn at(
        file: &str,
        text: &str,
        offset: usize,
        message: impl Into<String>,
        help: impl Into<String>,
    ) -> Self {
        let mut end = offset.min(text.len());
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        let before = &text[..end];
        let line = before.matches('\n').count() + 1;
        let column = before.rsplit('\n').next().unwrap_or_default().chars().count() + 1;
        Self { file: file.to_owned(), line, column, message: message.into(), help: help.into() }
    }
}

/// Parses `text` into `T`, whose structs carry `#[serde(deny_unknown_fields)]`. `file` names it in errors.
pub fn parse<T: DeserializeOwned>(file: &str, text: &str) -> Result<T, ConfigError> {
    toml::from_str(text).map_err(|error| {
        let message = error.message().trim().to_owned();
        let help = help_for(&message);
        let headline = match message.split_once(", expected") {
            Some((headline, _)) if message.starts_with("unknown") => headline.to_owned(),
            _ => without_types(&message.replace('\n', " ")),
        };
        let offset = error.span().map_or(0, |span| span.start);
        ConfigError::at(file, text, offset, headline, help)
    })
}

/// The name in `allowed` that is most like `given`.
pub fn nearest<'a>(given: &str, allowed: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let distance_to = |name: &str| match name.find(given) {
        Some(0) => 0,
        Some(_) => 1,
        None => {
            // A misspelt beginning of a longer name: one letter in three may be wrong.
            let prefix: String = name.chars().take(given.chars().count()).collect();
            let (to_prefix, to_name) = (edit_distance(given, &prefix), edit_distance(given, name));
            let is_prefix = 3 * to_prefix <= given.len();
            to_name.min(if is_prefix { 1 + to_prefix } else { to_name })
        }
    };
    let names = allowed.into_iter().filter(|name| !name.is_empty());
    let (distance, name) = names.map(|name| (distance_to(name), name)).min()?;
    (distance <= name.len().max(given.len()).div_ceil(2)).then_some(name)
}

/// Keys that only one kind of file has at its top: elsewhere they show that it is the wrong file.
const KEYS_OF_FILES: [(&str, &str); 9] = [
    ("capabilities", "drive profiles"),
    ("case", "suites"),
    ("drive", "bench files"),
    ("effect", "model files"),
    ("hidden", "software drives (--emulator)"),
    ("history", "model files"),
    ("link", "bench files"),
    ("quantisation", "software drives (--emulator)"),
    ("sequence", "bench files"),
];

/// One help line for an unknown key of a file: the kind of file that has it, else as for any name.
pub fn help_for_unknown_key<'a>(
    given: &str,
    allowed: impl IntoIterator<Item = &'a str> + Clone,
) -> String {
    match KEYS_OF_FILES.iter().find(|(key, _)| *key == given) {
        Some((_, kind)) => format!("`{given}` is a key of {kind}: is it the right file?"),
        None => help_for_unknown(given, allowed),
    }
}

/// One help line for an unknown name: the conversion to the expected unit, the nearest name, or all of them.
pub fn help_for_unknown<'a>(
    given: &str,
    allowed: impl IntoIterator<Item = &'a str> + Clone,
) -> String {
    if let Some(help) = wrong_unit::help(given, &allowed) {
        return help;
    }
    if let Some(name) = nearest(given, allowed.clone()) {
        return format!("did you mean `{name}`?");
    }
    let shown = allowed.into_iter().map(|name| if name.is_empty() { "\"\"" } else { name });
    format!("allowed: {}", shown.collect::<Vec<_>>().join(", "))
}

/// Types of the parser and what a user can write for them.
const TYPES: [(&str, &str); 9] = [
    ("u8", "a whole number from 0 to 255"),
    ("u16", "a whole number from 0 to 65535"),
    ("u32", "a whole number from 0 to 4294967295"),
    ("u64", "a whole number from 0"),
    ("usize", "a whole number from 0"),
    ("i8", "a whole number from -128 to 127"),
    ("i32", "a whole number"),
    ("i64", "a whole number"),
    ("f64", "a number"),
];

/// A message of the parser without the names of types.
fn without_types(message: &str) -> String {
    let Some((what, expected)) = message.rsplit_once(", expected ") else {
        return message.to_owned();
    };
    let expected =
        TYPES.iter().find(|(name, _)| *name == expected).map_or(expected, |(_, text)| text);
    let what = what
        .replace("invalid value: ", "not allowed: ")
        .replace("invalid type: ", "not allowed: ")
        .replace("floating point `", "number `")
        .replace("integer `", "number `");
    format!("{what}, expected {expected}")
}

fn help_for(message: &str) -> String {
    let mut quoted = message.split('`').skip(1).step_by(2);
    match (message.starts_with("unknown"), quoted.next()) {
        (true, Some(given)) => help_for_unknown_key(given, quoted),
        (false, Some(name)) if message.starts_with("missing field") => {
            format!("add `{name}`; bench-configs/ has commented examples")
        }
        _ => "see the commented examples in bench-configs/".to_owned(),
    }
}

/// Levenshtein distance, row by row of its table (Wagner and Fischer 1974).
fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, from) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, to) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(from != *to);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only names and types of the keys matter here")]
    struct Limits {
        current_a: f64,
        speed_rad_s: Option<f64>,
        unit: Option<u8>,
    }

    #[test]
    fn an_error_has_its_line_its_reason_and_a_help() {
        let byte = "expected a whole number from 0 to 255";
        let history = "`history` is a key of model files: is it the right file?";
        for (text, line, message, help) in [
            ("speed_rads = 5", 2, "unknown field `speed_rads`", "did you mean `speed_rad_s`?"),
            ("[history]", 2, "unknown field `history`", history),
            ("\nspeed_rad_s = \"x\"", 3, "not allowed: string \"x\"", "see"),
            ("speed_rad_s = = 3", 2, "", "see"),
            ("unit = 300", 2, "not allowed: number `300`, ", "see"),
            ("unit = 300", 2, byte, "see"),
            ("unit = \"x\"", 2, byte, "see"),
        ] {
            let error = parse::<Limits>("l", &format!("current_a = 3.0\n{text}\n")).unwrap_err();
            assert_eq!((error.line, &error.help[..help.len()]), (line, help), "{text}");
            assert!(error.message.contains(message), "{text}: {error}");
        }
        assert!(parse::<Limits>("l", "").unwrap_err().help.starts_with("add `current_a`"));
    }

    #[test]
    fn an_offset_within_a_character_is_at_its_beginning() {
        let text = "a = 1\nb\u{b5}\u{3a9} = 2";
        let column = |offset| ConfigError::at("f", text, offset, "m", "h").column;
        assert_eq!([6, 7, 8, 9, 10, 11].map(column), [1, 2, 2, 3, 3, 4]);
    }

    #[test]
    fn the_nearest_name_is_one_that_begins_alike_or_none() {
        assert_eq!(nearest("xyzzy", ["resistance_ohm"]), None);
        let near = nearest("inertia", ["inertia_kg_m2", "inductance_h"]);
        assert_eq!(near, Some("inertia_kg_m2"));
        let near = nearest("stribek", ["supply_sag", "stribeck_friction"]);
        assert_eq!(near, Some("stribeck_friction"));
    }
}
