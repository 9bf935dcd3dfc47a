//! Acceptance limits: what a figure or a word of a result has to be.
//!
//! ```text
//! [1.0, 1.3]                          within, both ends included
//! "< 1.5", "<= 1.5", "> 0", ">= 0"     beyond one bound
//! 1.1, "none", true                   equal; for a list of words: exactly this one, or empty for "none"
//! ["cogging", "supply_sag"]           a list of exactly these words, in any order
//! "~ locked"                          a text, or a word of a list, that has this in it, capitals aside
//! { value = 1.1, within = 0.05 }      absolute tolerance
//! { value = 1.1, within_percent = 5 } relative tolerance
//! ```
//!
//! The figure of a list is the number of its entries.

use serde_json::Value;

use super::Answered;
use drivebench_model::text::number::significant;

/// What a figure or a word has to be.
#[derive(Clone, Debug, PartialEq)]
pub enum Limit {
    Within {
        least: f64,
        most: f64,
    },
    /// `<`, `<=`, `>` or `>=` the bound.
    Beyond {
        sign: &'static str,
        bound: f64,
    },
    Word(String),
    /// A list of these words, in their order.
    Words(Vec<String>),
    /// A text, or a list of words one of them, with this in it, in small letters.
    Has(String),
    Flag(bool),
    /// A list without an entry, or a key without a value.
    Nothing,
}

/// The forms of a limit, in words.
const FORMS: &str = "[least, most], \"< 1.5\", a number, a word, a list of words, \"~ part of a text\", true or false, { value, within } or { value, within_percent }";

impl Limit {
    /// A limit as the suite file writes it; the error has what is wrong and what is allowed.
    pub fn parse(value: &toml::Value) -> Result<Self, (String, String)> {
        let wrong = |what: String| Err((what, format!("allowed: {FORMS}")));
        match value {
            toml::Value::Boolean(flag) => Ok(Self::Flag(*flag)),
            toml::Value::String(text) => Self::parse_text(text),
            toml::Value::Array(words)
                if words.iter().all(toml::Value::is_str) && words.len() > 1 =>
            {
                let words = words.iter().filter_map(toml::Value::as_str);
                let mut words: Vec<String> = words.map(str::to_owned).collect();
                words.sort();
                Ok(Self::Words(words))
            }
            toml::Value::Array(ends) => match ends.iter().map(number).collect::<Vec<_>>()[..] {
                [Some(least), Some(most)] if least <= most => Ok(Self::Within { least, most }),
                [Some(least), Some(most)] => {
                    wrong(format!("[{least}, {most}] has its larger end first"))
                }
                _ => wrong(format!("{value} is not a pair of numbers")),
            },
            toml::Value::Table(table) => Self::parse_tolerance(table),
            toml::Value::Datetime(_) => wrong(format!("{value} is a date")),
            toml::Value::Integer(_) | toml::Value::Float(_) => match number(value) {
                Some(exact) => Ok(Self::Within { least: exact, most: exact }),
                None => wrong(format!("{value} is not a number")),
            },
        }
    }

    fn parse_text(text: &str) -> Result<Self, (String, String)> {
        let text = text.trim();
        if let Some(part) = text.strip_prefix('~') {
            if part.trim().is_empty() {
                return Err((
                    format!("{text:?} has no text after ~: every text has that in it"),
                    "write a part of the text, as in \"~ locked\"".to_owned(),
                ));
            }
            return Ok(Self::Has(part.trim().to_lowercase()));
        }
        for sign in ["<=", ">=", "<", ">"] {
            let Some(rest) = text.strip_prefix(sign) else {
                continue;
            };
            let bound = rest.trim().parse().ok().filter(|bound: &f64| bound.is_finite());
            let Some(bound) = bound else {
                return Err((
                    format!("{text:?} has no number after {sign}"),
                    "write the number without a unit: the key has it".to_owned(),
                ));
            };
            return Ok(Self::Beyond { sign, bound });
        }
        Ok(match text {
            "none" => Self::Nothing,
            word => Self::Word(word.to_owned()),
        })
    }

    fn parse_tolerance(table: &toml::Table) -> Result<Self, (String, String)> {
        const HELP: &str =
            "write { value = 1.1, within = 0.05 } or { value = 1.1, within_percent = 5 }";
        let entry = |key: &str| table.get(key).and_then(number);
        let known = ["value", "within", "within_percent"];
        if let Some(key) = table.keys().find(|key| !known.contains(&key.as_str())) {
            return Err((format!("unknown key `{key}` of a limit"), HELP.to_owned()));
        }
        let around = entry("value");
        let by = match (entry("within"), entry("within_percent")) {
            (Some(by), None) => Some(by),
            (None, Some(percent)) => around.map(|value| value.abs() * percent / 100.0),
            _ => None,
        };
        match (around, by) {
            (Some(value), Some(by)) if by >= 0.0 => {
                Ok(Self::Within { least: value - by, most: value + by })
            }
            _ => Err((
                "a tolerance needs a value and one width, not negative".to_owned(),
                HELP.to_owned(),
            )),
        }
    }

    /// The text of a failure: what was found, and what it has to be. A key that is not in the result fails every limit.
    pub fn fails(&self, found: Option<&Value>) -> Option<String> {
        let in_words = found.map_or_else(|| "not in the result".to_owned(), in_words);
        let holds = match (self, found) {
            (Self::Nothing, Some(Value::Null)) => true,
            (Self::Nothing, Some(Value::Array(list))) => list.is_empty(),
            (Self::Nothing, Some(Value::String(word))) => word == "none",
            (Self::Word(word), Some(Value::String(found))) => word == found,
            (Self::Has(part), Some(Value::String(found))) => found.to_lowercase().contains(part),
            (Self::Has(part), Some(Value::Array(list))) => {
                list.iter().filter_map(Value::as_str).any(|word| word.to_lowercase().contains(part))
            }
            (Self::Word(word), Some(Value::Array(list))) => {
                matches!(&list[..], [Value::String(only)] if only == word)
            }
            (Self::Words(words), Some(Value::Array(list))) => {
                let mut found: Vec<&str> = list.iter().filter_map(Value::as_str).collect();
                found.sort_unstable();
                found.len() == list.len() && found == *words
            }
            (Self::Flag(flag), Some(Value::Bool(found))) => flag == found,
            (limit, Some(found)) => figure(found).is_some_and(|figure| limit.holds(figure)),
            (_, None) => false,
        };
        (!holds).then(|| format!("{in_words}, has to be {self}"))
    }

    fn holds(&self, figure: f64) -> bool {
        match *self {
            Self::Within { least, most } => (least..=most).contains(&figure),
            Self::Beyond { sign: "<", bound } => figure < bound,
            Self::Beyond { sign: "<=", bound } => figure <= bound,
            Self::Beyond { sign: ">", bound } => figure > bound,
            Self::Beyond { bound, .. } => figure >= bound,
            Self::Word(_) | Self::Words(_) | Self::Has(_) | Self::Flag(_) | Self::Nothing => false,
        }
    }
}

impl std::fmt::Display for Limit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Within { least, most } if least.to_bits() == most.to_bits() => {
                write!(f, "{least}")
            }
            Self::Within { least, most } => {
                write!(f, "{} to {}", significant(*least, 6), significant(*most, 6))
            }
            Self::Beyond { sign, bound } => write!(f, "{sign} {bound}"),
            Self::Word(word) => write!(f, "{word}"),
            Self::Words(words) => write!(f, "{}", words.join(", ")),
            Self::Has(part) => write!(f, "a text with {part:?}"),
            Self::Flag(flag) => write!(f, "{flag}"),
            Self::Nothing => write!(f, "none"),
        }
    }
}

fn number(value: &toml::Value) -> Option<f64> {
    let number = match value {
        toml::Value::Integer(whole) => *whole as f64,
        toml::Value::Float(number) => *number,
        _ => return None,
    };
    number.is_finite().then_some(number)
}

/// A found value in the words of a line.
fn in_words(value: &Value) -> String {
    match value {
        Value::Null => "nothing".to_owned(),
        Value::String(word) => word.clone(),
        Value::Number(figure) => match (figure.as_i64(), figure.as_f64()) {
            (None, Some(figure)) => significant(figure, 4),
            _ => figure.to_string(),
        },
        Value::Array(list) if list.is_empty() => "none".to_owned(),
        Value::Array(list) => list.iter().map(in_words).collect::<Vec<_>>().join(", "),
        other => other.to_string(),
    }
}

/// The number in a result, or the number of entries of a list.
pub fn figure(found: &Value) -> Option<f64> {
    match found {
        Value::Array(list) => Some(list.len() as f64),
        found => found.as_f64(),
    }
}

/// The value of `key` in the JSON of a command: the path that its dots name, in the result or in its diagnosis; else the
/// parameter of that name; else what one of the short names stands for:
///
/// * `missing`: the effects that the diagnosis named; empty only where its verdict is "none" without reservation; else
///   the verdict as text;
/// * `not_shown`: the effects that the runs neither named nor ruled out;
/// * `held_out_error`: with all that was found, in noise floors.
pub fn find(result: &Value, key: &str) -> Option<Value> {
    let path = |path: &str| {
        let at = |from: &'static [&str]| {
            let steps = from.iter().copied().chain(path.split('.'));
            steps.into_iter().try_fold(result, |at, step| match at {
                Value::Array(list) => step.parse::<usize>().ok().and_then(|index| list.get(index)),
                other => other.get(step),
            })
        };
        at(&[]).or_else(|| at(&["diagnosis"]))
    };
    let parameter = || {
        let lists = ["parameters", "estimates", "online"].into_iter().filter_map(&path);
        lists.into_iter().find_map(|list| entry(list, key)?.get("value"))
    };
    match key {
        "missing" => missing(path("verdict")?.as_str()?, &path),
        "not_shown" => path("candidates").map(|list| not_shown(list).into()),
        "held_out_error" => path("holdout_after").or_else(|| path("holdout_rmse")).cloned(),
        _ => path(key).or_else(parameter).cloned(),
    }
}

/// Missing effects of a diagnosis. A run that excites little rules out little: that is not `none`.
fn missing<'a>(verdict: &str, path: &impl Fn(&str) -> Option<&'a Value>) -> Option<Value> {
    let effects = path("effects").cloned();
    let is_refuted = path("confirm.confirmed") == Some(&Value::Bool(false));
    let is_sufficient = path("sufficient") == Some(&Value::Bool(true));
    let not_shown = path("candidates").map_or_else(Vec::new, not_shown);
    match verdict {
        "effect" if is_refuted => Some(format!("{}, not confirmed", in_words(&effects?)).into()),
        "effect" => effects,
        "none" if !is_sufficient => Some("nothing found, but an error is left".into()),
        "none" if not_shown.is_empty() => effects,
        "none" => {
            let names: Vec<&str> = not_shown.iter().map(String::as_str).collect();
            Some(
                format!("nothing that these runs could show ({} not ruled out)", names.join(", "))
                    .into(),
            )
        }
        verdict => Some(verdict.into()),
    }
}

/// The hidden and the diagnosed effects, where the result has both.
pub fn answered(result: &Value) -> Option<Answered> {
    let hidden = words(result.pointer("/truth/effects")?);
    let verdict = find(result, "verdict")?;
    let missing = find(result, "missing")?;
    let named = match (verdict.as_str()?, words(&missing)) {
        ("effect", Some(named)) => named,
        ("effect", None) => "(not confirmed)".to_owned(),
        ("none", None) if missing.is_string() => "(none shown)".to_owned(),
        (verdict, _) => format!("({verdict})"),
    };
    Some(Answered { hidden: hidden.unwrap_or_else(|| "(nothing)".to_owned()), named })
}

/// The words of a list that has any, in one order.
fn words(list: &Value) -> Option<String> {
    let mut words: Vec<&str> = list.as_array()?.iter().filter_map(Value::as_str).collect();
    words.sort_unstable();
    (!words.is_empty()).then(|| words.join(" + "))
}

/// The effects of a table of candidates that are neither named nor ruled out.
fn not_shown(candidates: &Value) -> Vec<String> {
    let candidates = candidates.as_array().into_iter().flatten();
    let open = candidates.filter(|own| match own["status"].as_str() {
        Some("supported") => false,
        Some("ruled_out") => own.get("as_good_as").is_some_and(|other| !other.is_null()),
        _ => true,
    });
    open.filter_map(|own| own["effect"].as_str()).map(str::to_owned).collect()
}

/// The row of a parameter in a table of parameters, in either of its two forms.
pub fn entry<'a>(table: &'a Value, key: &str) -> Option<&'a Value> {
    match table {
        Value::Array(rows) => {
            rows.iter().find(|row| row.get("key").and_then(Value::as_str) == Some(key))
        }
        rows => rows.get(key),
    }
}

#[cfg(test)]
mod tests {
    use std::iter::repeat;

    use super::*;
    use serde_json::json;

    fn limit(text: &str) -> Result<Limit, (String, String)> {
        let table: toml::Table = toml::from_str(&format!("limit = {text}")).unwrap();
        Limit::parse(&table["limit"])
    }

    fn holds(text: &str, found: &Value) -> bool {
        limit(text).unwrap().fails(Some(found)).is_none()
    }

    #[test]
    fn each_form_takes_what_it_names_and_nothing_else() {
        let names = json!(["cogging", "backlash"]);
        let locked = json!("the rotor is locked");
        for (text, holding, failing) in [
            ("[1.0, 1.3]", vec![json!(1.0), json!(1.3)], vec![json!(1.3001), json!("1.2")]),
            ("[0, 1]", vec![], vec![json!(null)]),
            ("\"< 1.5\"", vec![json!(1.4)], vec![json!(1.5), json!(null)]),
            ("\"<=1.5\"", vec![json!(1.5)], vec![json!(1.6)]),
            ("\">= 2\"", vec![json!(2)], vec![json!(1.9)]),
            ("\">2\"", vec![json!(3)], vec![json!(2)]),
            ("4", vec![json!(4)], vec![json!(5)]),
            ("{ value = 2.0, within = 0.5 }", vec![json!(2.5)], vec![json!(2.6)]),
            ("{ value = 2.0, within_percent = 10 }", vec![json!(1.9)], vec![json!(2.3)]),
            ("{ value = -2.0, within_percent = 10 }", vec![json!(-1.9)], vec![json!(-2.3)]),
            ("true", vec![json!(true)], vec![json!("true")]),
            ("\"none\"", vec![json!([]), json!(null)], vec![json!(["cogging"])]),
            ("\"cogging\"", vec![json!(["cogging"]), json!("cogging")], vec![names.clone()]),
            ("\"~ back\"", vec![names.clone()], vec![json!(["cogging"])]),
            ("\"~ Locked\"", vec![locked.clone()], vec![json!("open"), json!(1)]),
            ("[\"b\", \"a\"]", vec![json!(["a", "b"])], vec![json!(["a"]), json!(["a", "b", "c"])]),
        ] {
            for (found, is_held) in
                holding.iter().zip(repeat(true)).chain(failing.iter().zip(repeat(false)))
            {
                assert_eq!(holds(text, found), is_held, "{text}: {found}");
            }
            assert!(limit(text).unwrap().fails(None).is_some(), "{text}: no result");
        }
    }

    #[test]
    fn a_wrong_limit_names_the_allowed_forms() {
        for (text, word) in [
            ("[2, 1]", "larger end first"),
            ("[1]", "pair"),
            ("\"< x\"", "no number"),
            ("\"< nan\"", "no number"),
            ("\"~ \"", "no text after ~"),
            ("nan", "not a number"),
            ("{ value = 1 }", "one width"),
            ("{ value = 1, within = -1 }", "not negative"),
            ("{ value = 1, within = 1, within_percent = 1 }", "one width"),
            ("{ valeu = 1 }", "unknown key `valeu`"),
            ("1979-05-27", "date"),
        ] {
            let (what, help) = limit(text).unwrap_err();
            assert!(what.contains(word), "{text}: {what}");
            assert!(!help.is_empty());
        }
    }

    #[test]
    fn a_failure_has_the_found_and_the_required_value() {
        for (text, found, expected) in [
            ("[1.0, 1.3]", json!(1.512_345), "1.512, has to be 1.00000 to 1.30000"),
            ("\"none\"", json!(["backlash"]), "backlash, has to be none"),
        ] {
            assert_eq!(limit(text).unwrap().fails(Some(&found)).unwrap(), expected);
        }
    }

    #[test]
    fn figures_are_found_by_path_parameter_and_short_name() {
        let result = json!({
            "diagnosis": {
                "verdict": "effect", "effects": ["cogging"], "holdout_after": 1.2, "list": [ { "a": 3 } ],
            },
            "parameters": [ { "key": "resistance_ohm", "value": 1.1 } ],
        });
        let identified = json!({ "parameters": { "inertia_kg_m2": { "value": 0.004 } } });
        for (result, key, expected) in [
            (&result, "missing", json!(["cogging"])),
            (&result, "held_out_error", json!(1.2)),
            (&result, "resistance_ohm", json!(1.1)),
            (&result, "diagnosis.list.0.a", json!(3)),
            (&identified, "inertia_kg_m2", json!(0.004)),
        ] {
            assert_eq!(find(result, key), Some(expected), "{key}");
        }
        assert_eq!(find(&result, "inertia_kg_m2"), None);
        assert_eq!(find(&identified, "missing"), None);
    }

    #[test]
    fn nothing_is_missing_only_where_that_is_stated_without_reserve() {
        let of = |status: &str, sufficient: bool| {
            json!({ "diagnosis": {
                "verdict": "none", "effects": [], "sufficient": sufficient,
                "candidates": [
                    { "effect": "cogging", "status": "ruled_out", "as_good_as": null },
                    { "effect": "backlash", "status": status },
                ],
            } })
        };
        let none = limit("\"none\"").unwrap();
        let judged = |result: &Value| none.fails(find(result, "missing").as_ref());
        assert_eq!(judged(&of("ruled_out", true)), None);
        let weak = of("not_excited", true);
        assert_eq!(
            judged(&weak).unwrap(),
            "nothing that these runs could show (backlash not ruled out), has to be none"
        );
        assert!(judged(&of("possible", true)).is_some());
        assert!(judged(&of("ruled_out", false)).unwrap().contains("an error is left"));
        assert!(judged(&json!({ "verdict": "none", "effects": [] })).is_some());
        for verdict in ["unexplained", "ambiguous"] {
            let result = json!({ "verdict": verdict, "effects": [] });
            assert_eq!(find(&result, "missing"), Some(json!(verdict)));
        }
        // The confirming run contradicts the name.
        for (confirmed, missing) in
            [(true, json!(["cogging"])), (false, json!("cogging, not confirmed"))]
        {
            let confirm = json!({ "confirmed": confirmed });
            let result = json!({ "verdict": "effect", "effects": ["cogging"], "confirm": confirm });
            assert_eq!(find(&result, "missing"), Some(missing));
        }
        // What it does prove can be required.
        assert!(holds("\"none\"", &find(&weak, "verdict").unwrap()));
        assert!(holds("\"<= 1\"", &find(&weak, "not_shown").unwrap()));
        assert!(!holds("\"< 1\"", &find(&weak, "not_shown").unwrap()));
        assert!(holds("\"backlash\"", &find(&weak, "not_shown").unwrap()));
    }

    #[test]
    fn a_diagnosis_is_counted_where_the_truth_is_known() {
        let of = |verdict: &str, effects: &[&str], hidden: &[&str]| {
            let result = json!({
                "diagnosis": { "verdict": verdict, "effects": effects, "sufficient": true, "candidates": [] },
                "truth": { "effects": hidden },
            });
            let answered = answered(&result).unwrap();
            format!("{}: {}", answered.hidden, answered.named)
        };
        assert_eq!(of("effect", &["cogging"], &["cogging"]), "cogging: cogging");
        assert_eq!(of("effect", &["a", "b"], &["a", "c"]), "a + c: a + b");
        assert_eq!(of("none", &[], &[]), "(nothing): (none)");
        assert_eq!(of("unexplained", &[], &["shaker"]), "shaker: (unexplained)");
        assert_eq!(of("ambiguous", &["a"], &["a"]), "a: (ambiguous)");
        let without_truth = json!({ "diagnosis": { "verdict": "none", "effects": [] } });
        assert_eq!(answered(&without_truth), None);
        let mut weak = json!({ "verdict": "none", "effects": [], "truth": { "effects": [] } });
        assert_eq!(answered(&weak).unwrap().named, "(none shown)");
        weak["verdict"] = json!("effect");
        weak["effects"] = json!(["cogging"]);
        weak["confirm"] = json!({ "confirmed": false });
        assert_eq!(answered(&weak).unwrap().named, "(not confirmed)");
    }
}
