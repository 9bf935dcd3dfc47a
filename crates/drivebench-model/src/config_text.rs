//! Strict TOML: an unknown key is an error with its line, its column and the nearest key that exists.

mod wrong_unit;

use serde::de::DeserializeOwned;
use thiserror::Error;

/// A configuration text that cannot be used.
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
        let tail = before.rsplit('\n').next().unwrap_or_default();
        let column = tail.chars().count() + 1;
        Self {
            file: file.to_owned(),
            line,
            column,
            message: message.into(),
            help: help.into(),
        }
    }
}

/// Parses `text` into `T`, whose structs carry `#[serde(deny_unknown_fields)]`. `file` names it in errors.
pub fn parse<T: DeserializeOwned>(file: &str, text: &str) -> Result<T, ConfigError> {
    toml::from_str(text).map_err(|error| {
        let message = error.message().trim().to_owned();
        let help = help_for(&message);
        let headline = match message.split_once(", expected") {
            Some((headline, _)) if message.starts_with("unknown") => headline.to_owned(),
            _ => in_words(&message.replace('\n', " ")),
        };
        let offset = error.span().map_or(0, |span| span.start);
        ConfigError::at(file, text, offset, headline, help)
    })
}

/// Letters of a word to one of which it may be another.
const NEAR: usize = 3;

/// The name in `allowed` that is most like `given`.
pub fn nearest<'a>(given: &str, allowed: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let distance = |name: &str| match name.find(given) {
        Some(0) => 0,
        Some(_) => 1,
        None => {
            // A word that is nearly how a longer name begins.
            let begin: String = name.chars().take(given.chars().count()).collect();
            let (near, whole) = (edit_distance(given, &begin), edit_distance(given, name));
            if NEAR * near <= given.len() {
                whole.min(1 + near)
            } else {
                whole
            }
        }
    };
    let names = allowed.into_iter().filter(|name| !name.is_empty());
    let (distance, name) = names.map(|name| (distance(name), name)).min()?;
    (distance <= name.len().max(given.len()).div_ceil(2)).then_some(name)
}

/// Keys that only one kind of file has at its top: who finds one elsewhere was given another file than was meant.
const OF_A_KIND: [(&str, &str); 9] = [
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
    match OF_A_KIND.iter().find(|(key, _)| *key == given) {
        Some((_, kind)) => format!("`{given}` is a key of {kind}: is it the right file?"),
        None => help_for_unknown(given, allowed),
    }
}

/// One help line for an unknown name: the conversion to our unit, the nearest name, or all of them.
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
    let names = allowed.into_iter();
    let shown = names.map(|name| if name.is_empty() { "\"\"" } else { name });
    format!("allowed: {}", shown.collect::<Vec<_>>().join(", "))
}

/// Types of the language in words of the reader.
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
fn in_words(message: &str) -> String {
    let Some((what, expected)) = message.rsplit_once(", expected ") else {
        return message.to_owned();
    };
    let words = TYPES.iter().find(|(name, _)| *name == expected);
    let words = words.map_or(expected, |(_, words)| words);
    let what = what
        .replace("invalid value: ", "not allowed: ")
        .replace("invalid type: ", "not allowed: ")
        .replace("floating point `", "number `")
        .replace("integer `", "number `");
    format!("{what}, expected {words}")
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

/// Levenshtein distance.
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
    struct Limits {
        #[expect(dead_code, reason = "only the key's name matters here")]
        current_a: f64,
        #[expect(dead_code, reason = "only the key's name matters here")]
        speed_rad_s: Option<f64>,
    }

    #[test]
    fn an_unknown_key_is_named_with_its_place_and_the_nearest_key() {
        let error =
            parse::<Limits>("limits.toml", "current_a = 3.0\nspeed_rads = 5\n").unwrap_err();
        assert_eq!((error.line, error.column), (2, 1));
        assert_eq!(error.message, "unknown field `speed_rads`");
        assert_eq!(error.help, "did you mean `speed_rad_s`?");
    }

    #[test]
    fn a_key_of_another_kind_of_file_asks_for_the_right_file() {
        let error = parse::<Limits>("m.toml", "current_a = 3.0\n[history]\n").unwrap_err();
        assert_eq!(error.message, "unknown field `history`");
        let help = "`history` is a key of model files: is it the right file?";
        assert_eq!(error.help, help);
    }

    #[test]
    fn a_place_within_a_character_is_at_its_beginning() {
        let text = "a = 1\nb\u{b5}\u{3a9} = 2";
        let columns: Vec<usize> = (6..12)
            .map(|offset| ConfigError::at("f", text, offset, "m", "h").column)
            .collect();
        assert_eq!(columns, [1, 2, 2, 3, 3, 4]);
    }

    #[test]
    fn a_wrong_type_and_a_broken_text_have_a_place_too() {
        for (text, line) in [("\n\ncurrent_a = \"x\"\n", 3), ("current_a = = 3\n", 1)] {
            let error = parse::<Limits>("l", text).unwrap_err();
            assert_eq!(error.line, line, "{text}");
        }
    }

    #[test]
    fn a_wrong_type_is_told_in_words_and_a_missing_key_by_its_name() {
        #[derive(Debug, serde::Deserialize)]
        struct Unit {
            #[expect(dead_code, reason = "only the key's type matters here")]
            unit: u8,
        }
        let error = parse::<Unit>("l", "unit = 300").unwrap_err();
        let said = "not allowed: number `300`, expected a whole number from 0 to 255";
        assert_eq!(error.message, said);
        let error = parse::<Unit>("l", "unit = \"x\"").unwrap_err();
        assert!(error.message.ends_with("a whole number from 0 to 255"));
        let error = parse::<Unit>("l", "").unwrap_err();
        assert!(error.help.starts_with("add `unit`"), "{}", error.help);
    }

    #[test]
    fn nothing_is_near_to_something_altogether_different() {
        assert_eq!(nearest("xyzzy", ["resistance_ohm"]), None);
        let near = nearest("inertia", ["inertia_kg_m2", "inductance_h"]);
        assert_eq!(near, Some("inertia_kg_m2"));
        let near = nearest("stribek", ["supply_sag", "stribeck_friction"]);
        assert_eq!(near, Some("stribeck_friction"));
    }
}
