//! The model file: `[motor]`, `[[effect]]`, and the `[history]` that a fit adds.

use std::borrow::Cow;
use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use super::effect::{self, DefinitionError, Layout};
use super::model::{ActiveEffect, Model, Slot};
use super::motor::{Motor, MotorKey};
use crate::config_text::{ConfigError, help_for_unknown_key, nearest};
use crate::sample::ParameterEstimate;

/// Key of an effect with the list of the motor's parameters that are fixed while it is in the model.
const HOLDS: &str = "holds";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FittedValue {
    pub key: String,
    pub std: f64,
}

impl FittedValue {
    /// Those of the parameters of a fit that have a standard deviation.
    pub fn all(parameters: &[ParameterEstimate]) -> Vec<Self> {
        let fitted = |parameter: &ParameterEstimate| {
            let std = parameter.std.filter(|std| *std > 0.0)?;
            Some(Self { key: parameter.key.clone(), std })
        };
        parameters.iter().filter_map(fitted).collect()
    }
}

/// Record of the fit: the runs that it used, its standard deviations, and the ladder of models up to this one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileHistory {
    /// Runs that the values were fitted on.
    #[serde(default)]
    pub fitted_on: Vec<String>,
    #[serde(default)]
    pub serial_number: Option<String>,
    /// One line for each rung: effects and held-out error.
    #[serde(default)]
    pub ladder: Vec<String>,
    #[serde(default)]
    pub fitted: Vec<FittedValue>,
}

impl FileHistory {
    /// Whether the values come from runs of other benches than the one of this name, by the folders of the runs, such as
    /// `20261126T073220Z-NAME`.
    pub fn is_of_another_bench(&self, name: &str) -> bool {
        let is_foreign = |run: &String| {
            let parts = run.rsplit('/').next().unwrap_or_default().split_once("Z-");
            parts.is_some_and(|(stamp, bench)| stamp.len() == 15 && !bench.starts_with(name))
        };
        !self.fitted_on.is_empty() && self.fitted_on.iter().all(is_foreign)
    }
}

/// A model with its history, as it stands in a file.
#[derive(Clone, Debug, Default)]
pub struct ModelFile {
    pub model: Model,
    pub history: FileHistory,
}

impl ModelFile {
    /// Reads a model file; `file` names it in errors.
    pub fn parse(file: &str, text: &str) -> Result<Self, ConfigError> {
        let root: toml::Table = crate::config_text::parse(file, text)?;
        let reader = Reader { file, text };
        let mut model = Model::default();
        let mut history = FileHistory::default();
        let mut held = Vec::new();
        for (key, value) in &root {
            match key.as_str() {
                "motor" => reader.motor(value, &mut model)?,
                "effect" => reader.effects(value, &mut model, &mut held)?,
                "history" => {
                    history = value.clone().try_into().map_err(|error: toml::de::Error| {
                        reader.error(0, "history", error.message())
                    })?;
                }
                "link" => model.input_delay_s = reader.link(value)?,
                other => {
                    return Err(reader.unknown(0, other, &["motor", "effect", "history", "link"]));
                }
            }
        }
        // After `fixed`: a parameter in both lists is fixed independently of the effect.
        for (id, key) in &held {
            model.hold(id, key);
        }
        model.validate().map_err(|error| reader.error(0, error.key(), &error.to_string()))?;
        Ok(Self { model, history })
    }

    /// The text of the file: what `parse` reads back to the same model. A number is the shortest text that reads back to it
    /// (`{:?}`), with a decimal point where TOML needs one.
    #[expect(
        clippy::missing_panics_doc,
        reason = "the history is strings and numbers, which TOML can always hold"
    )]
    pub fn to_toml(&self) -> String {
        let mut text = String::from("[motor]\n");
        let motor = &self.model.motor;
        let _ = writeln!(text, "name = {}", toml::Value::String(motor.name.clone()));
        for key in MotorKey::ALL {
            if let Some(value) = motor.get(key) {
                let comment = self.comment(&Slot::Motor(key));
                let _ = writeln!(text, "{} = {value:?}{comment}", key.key());
            }
        }
        let is_held = |key: &&String| self.model.held.iter().any(|held| held.key == **key);
        let fixed = self.model.fixed.iter().filter(|key| !is_held(key));
        write_list(&mut text, "fixed", fixed);
        for (index, active) in self.model.effects.iter().enumerate() {
            self.write_effect(&mut text, index, active);
        }
        if let Some(delay_s) = self.model.input_delay_s {
            let what = "s: commands act later than the stamps of the host";
            let _ = write!(text, "\n[link]\n{COMMANDS_LATE} = {delay_s:?}  # {what}\n");
        }
        if self.history != FileHistory::default() {
            let table =
                toml::Table::try_from(&self.history).expect("strings and numbers always serialise");
            let root = toml::Table::from_iter([("history".to_owned(), toml::Value::Table(table))]);
            let _ = write!(text, "\n{root}");
        }
        text
    }

    fn write_effect(&self, text: &mut String, index: usize, active: &ActiveEffect) {
        let _ = write!(text, "\n[[effect]]\nid = {:?}\n", active.id());
        let held = self.model.held.iter().filter(|held| held.effect == active.id());
        write_list(text, HOLDS, held.map(|held| &held.key));
        for (key, value) in active.effect.settings() {
            let _ = writeln!(text, "{key} = {value}");
        }
        let values: Option<Vec<f64>> = active.values.iter().copied().collect();
        match (active.effect.layout(), values) {
            (Layout::List(key), Some(values)) => {
                let _ = writeln!(text, "{key} = {values:?}");
                return;
            }
            (Layout::Table(name), _) => {
                let _ = writeln!(text, "\n[effect.{name}]");
            }
            _ => {}
        }
        for (parameter, spec) in active.effect.parameters().iter().enumerate() {
            if let Some(value) = active.effect.written(parameter, active.values[parameter]) {
                let slot = Slot::Effect { index, parameter, spec, id: active.id() };
                let value = match value {
                    toml::Value::Float(value) => format!("{value:?}"),
                    other => other.to_string(),
                };
                let comment = self.comment(&slot);
                let _ = writeln!(text, "{} = {value}{comment}", key_of(spec.key));
            }
        }
    }

    /// Standard deviation and unit of a value as a comment.
    fn comment(&self, slot: &Slot) -> String {
        let key = slot.key();
        let fitted = self.history.fitted.iter().find(|fitted| fitted.key == key);
        fitted.map_or_else(String::new, |fitted| format!("  # +- {:?} {}", fitted.std, slot.unit()))
    }
}

const COMMANDS_LATE: &str = "commands_late_s";

/// A list of texts under `key`, if there is anything in it.
fn write_list<'a>(text: &mut String, key: &str, items: impl Iterator<Item = &'a String>) {
    let items: Vec<String> = items.map(|item| quoted(item)).collect();
    if !items.is_empty() {
        let _ = writeln!(text, "{key} = [{}]", items.join(", "));
    }
}

fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

/// A key as TOML reads it: letters beyond ASCII need quotes.
fn key_of(key: &str) -> Cow<'_, str> {
    let is_bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if !key.is_empty() && key.chars().all(is_bare) {
        Cow::Borrowed(key)
    } else {
        Cow::Owned(quoted(key))
    }
}

/// Whether a line begins with this key and not with a longer one.
fn assigns(line: &str, key: &str) -> bool {
    line.strip_prefix(key)
        .is_some_and(|rest| !rest.starts_with(|next: char| next.is_alphanumeric() || next == '_'))
}

struct Reader<'a> {
    file: &'a str,
    text: &'a str,
}

impl Reader<'_> {
    /// An error at the first line from byte `from` on that assigns `key`.
    fn error(&self, from: usize, key: &str, message: &str) -> ConfigError {
        self.at(self.find(from, key), message, "see bench-configs/motors for a commented example")
    }

    fn at(&self, offset: usize, message: &str, help: impl Into<String>) -> ConfigError {
        ConfigError::at(self.file, self.text, offset, message, help)
    }

    fn unknown(&self, from: usize, key: &str, allowed: &[&str]) -> ConfigError {
        let help = help_for_unknown_key(key, allowed.iter().copied());
        self.at(self.find(from, key), &format!("unknown key `{key}`"), help)
    }

    fn find(&self, from: usize, key: &str) -> usize {
        let mut offset = 0;
        for line in self.text.split_inclusive('\n') {
            let body = line.trim_start().trim_start_matches(['[', '"']);
            if offset + line.len() > from && !key.is_empty() && assigns(body, key) {
                return offset + (line.len() - line.trim_start().len());
            }
            offset += line.len();
        }
        from
    }

    fn number(&self, from: usize, key: &str, value: &toml::Value) -> Result<f64, ConfigError> {
        match value {
            toml::Value::Float(number) => Ok(*number),
            toml::Value::Integer(number) => Ok(*number as f64),
            other => {
                let message = format!("{key} is a {}, expected a number", other.type_str());
                Err(self.error(from, key, &message))
            }
        }
    }

    fn link(&self, value: &toml::Value) -> Result<Option<f64>, ConfigError> {
        let Some(table) = value.as_table() else {
            return Err(self.error(0, "link", "link must be a table: [link]"));
        };
        let mut delay_s = None;
        for (key, value) in table {
            if key != COMMANDS_LATE {
                return Err(self.unknown(0, key, &[COMMANDS_LATE]));
            }
            let number = self.number(0, key, value)?;
            if !number.is_finite() {
                let message = format!("{key} is {number}, expected a finite number of seconds");
                return Err(self.error(0, key, &message));
            }
            delay_s = Some(number);
        }
        Ok(delay_s)
    }

    fn motor(&self, value: &toml::Value, model: &mut Model) -> Result<(), ConfigError> {
        let Some(table) = value.as_table() else {
            return Err(self.error(0, "motor", "motor must be a table: [motor]"));
        };
        model.motor = Motor::new("");
        for (key, value) in table {
            match key.as_str() {
                "name" => {
                    let Some(name) = value.as_str() else {
                        return Err(self.error(0, key, "name must be a string"));
                    };
                    name.clone_into(&mut model.motor.name);
                }
                "fixed" => model.fixed = self.strings(key, value)?,
                _ => {
                    let Some(known) = MotorKey::from_key(key) else {
                        let keys = MotorKey::ALL.map(MotorKey::key);
                        let allowed = [&keys[..], &["name", "fixed"]].concat();
                        return Err(self.unknown(0, key, &allowed));
                    };
                    model.motor.set(known, self.number(0, key, value)?);
                }
            }
        }
        Ok(())
    }

    fn strings(&self, key: &str, value: &toml::Value) -> Result<Vec<String>, ConfigError> {
        let texts = value.clone().try_into();
        texts.map_err(|_| self.error(0, key, &format!("{key} must be a list of strings")))
    }

    /// Reads the effects into `model`, and the parameters that each of them fixes, as `(id, key)`, into `held`.
    fn effects(
        &self,
        value: &toml::Value,
        model: &mut Model,
        held: &mut Vec<(String, String)>,
    ) -> Result<(), ConfigError> {
        let Some(tables) = value.as_array() else {
            return Err(self.error(0, "effect", "effects are written as [[effect]] tables"));
        };
        let mut from = 0;
        for table in tables {
            from = self.text[from..].find("[[effect]]").map_or(from, |offset| from + offset + 1);
            let Some(table) = table.as_table() else {
                return Err(self.error(from, "", "an effect must be a table"));
            };
            let Some(id) = table.get("id").and_then(toml::Value::as_str) else {
                let message = "an effect needs an id, as id = \"viscous_friction\"";
                return Err(self.error(from, "id", message));
            };
            if model.has(id) {
                return Err(self.error(from, "id", &format!("effect {id:?} is in the file twice")));
            }
            let mut table = table.clone();
            if let Some(value) = table.remove(HOLDS) {
                let keys = self.strings(HOLDS, &value)?.into_iter();
                held.extend(keys.map(|key| (id.to_owned(), key)));
            }
            let active = if effect::family(id).is_some() {
                let (effect, values) =
                    effect::define(id, &table).map_err(|error| self.misdefined(from, &error))?;
                ActiveEffect { effect, values }
            } else {
                self.of_catalogue(from, id, &table)?
            };
            model.effects.push(active);
        }
        Ok(())
    }

    fn of_catalogue(
        &self,
        from: usize,
        id: &str,
        table: &toml::Table,
    ) -> Result<ActiveEffect, ConfigError> {
        let Some(found) = effect::find(id) else {
            let catalogue = effect::CATALOGUE.iter().map(|effect| effect.card());
            let known = catalogue.chain(effect::FAMILIES).map(|card| card.id);
            let help = nearest(id, known).map_or_else(
                || "`drivebench effects` lists the catalogue".to_owned(),
                |name| format!("did you mean {name:?}?"),
            );
            let message = format!("effect {id:?} is not in the catalogue");
            return Err(self.at(self.find(from, "id"), &message, help));
        };
        let mut active = ActiveEffect::new(found);
        for (key, value) in table.iter().filter(|(key, _)| *key != "id") {
            let keys = found.parameters().iter().map(|spec| spec.key);
            let Some(at) = keys.clone().position(|known| known == key) else {
                let allowed: Vec<&str> = keys.chain(["id"]).collect();
                return Err(self.unknown(from, key, &allowed));
            };
            active.values[at] = Some(self.number(from, key, value)?);
        }
        Ok(active)
    }

    /// An error in the settings of an effect, at its position within the text of a setting where it has one.
    fn misdefined(&self, from: usize, error: &DefinitionError) -> ConfigError {
        // A parameter may stand within `parameters = { .. }`, on no line of its own.
        let mut at = self.find(from, &error.key);
        if at == from {
            at = self.find(from, "parameters");
        }
        let line = self.text[at..].lines().next().unwrap_or_default();
        let begin = line.find(['"', '\'']).map_or(0, |quote| quote + 1);
        at += error.offset.map_or(0, |offset| begin + offset);
        self.at(at, &error.message, error.help.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"[motor]
name = "ZK-22FC"
resistance_ohm = 1.1
inductance_h = 0.0099
back_emf_v_s_per_rad = 0.3538
inertia_kg_m2 = 0.0045
load_torque_n_m = 0.455
fixed = ["resistance_ohm"]

[[effect]]
id = "viscous_friction"

[[effect]]
id = "stribeck_friction"
stribeck_n_m = 0.2
"#;

    #[track_caller]
    fn parsed(text: &str) -> ModelFile {
        ModelFile::parse("m.toml", text).unwrap()
    }

    #[test]
    fn a_written_file_reads_back_to_the_same_model() {
        let mut file = parsed(TEXT);
        file.history.fitted_on.push("runs/x \"quoted\"".to_owned());
        file.history.fitted.push(FittedValue { key: "inertia_kg_m2".into(), std: 2e-6 });
        file.model.input_delay_s = Some(-6.9e-4);
        let again = parsed(&file.to_toml());
        assert_eq!(again.model.input_delay_s, Some(-6.9e-4));
        for (link, message) in [
            ("late_s = 1.0", "unknown key `late_s`"),
            ("commands_late_s = nan", "commands_late_s is NaN"),
            ("commands_late_s = \"1\"", "commands_late_s is a string"),
        ] {
            let error = ModelFile::parse("m.toml", &format!("{TEXT}[link]\n{link}\n")).unwrap_err();
            assert!(error.to_string().contains(message), "{error}");
        }
        assert_eq!(again.model.motor, file.model.motor);
        assert_eq!(again.model.fixed, file.model.fixed);
        assert_eq!(again.history, file.history);
        assert_eq!(again.model.effects[1].values, vec![Some(0.2), None]);
        assert!(file.to_toml().contains("inertia_kg_m2 = 0.0045  # +- 2e-6 kg.m2"));
    }

    const DEFINED: &str = r#"[motor]
name = "ZK-22FC"

[[effect]]
id = "custom"
equation = "torque"
expression = "a*abs(w)*w + b*exp(-(w/ws)^2)*sgn(w)"
parameters = { a = 1e-6, b = {}, ws = { value = 9.0, guess = 8.0, unit = "rad/s" } }

[[effect]]
id = "custom_drop"
equation = "voltage"
expression = "d*tanh(i/0.1)"
parameters = ["d"]

[[effect]]
id = "table"
equation = "torque"
axis = "speed_rad_s"
knots = [-100.0, 0.0, 100.0]
values = [0.1, 0.0, 0.2]

[[effect]]
id = "table_time"
equation = "voltage"
axis = "time_s"
knots = [0.0, 5.0]
value_2 = 1.5
"#;

    #[test]
    fn effects_that_the_user_defines_read_back_to_the_same_effects() {
        let mut file = parsed(DEFINED);
        file.history.fitted.push(FittedValue { key: "custom.a".into(), std: 1e-8 });
        file.model.fixed = vec!["inertia_kg_m2".to_owned()];
        assert!(file.model.hold("table_time", "resistance_ohm"));
        let text = file.to_toml();
        let again = parsed(&text);
        assert_eq!(again.model.effect_ids(), file.model.effect_ids());
        for (one, other) in file.model.effects.iter().zip(&again.model.effects) {
            assert!(std::ptr::addr_eq(one.effect, other.effect), "{text}");
            assert_eq!(one.values, other.values);
        }
        assert_eq!(again.to_toml(), text);
        let values = &again.model.effects[0].values;
        assert_eq!(*values, [Some(1e-6), None, Some(9.0)], "coefficients first");
        for line in [
            "a = 1e-6  # +- 1e-8",
            "values = [0.1, 0.0, 0.2]",
            "\nvalue_2 = 1.5",
            "holds = [\"resistance_ohm\"]",
        ] {
            assert!(text.contains(line), "{line}: {text}");
        }
        assert_eq!(again.model.fixed, ["inertia_kg_m2", "resistance_ohm"]);
        assert_eq!(again.model.held, file.model.held);
        assert_eq!(again.model.without_effect("table_time").unwrap().fixed, ["inertia_kg_m2"]);
    }

    #[test]
    fn a_parameter_may_have_any_letters() {
        let text = DEFINED.replace("a = 1e-6", "\"\u{b5}\" = 1e-6").replace("a*abs", "\u{b5}*abs");
        let mut file = parsed(&text);
        file.model.fixed = vec!["custom.\u{b5}".to_owned()];
        let again = parsed(&file.to_toml());
        assert_eq!(again.model.fixed, file.model.fixed);
        assert_eq!(again.model.effects[0].values, [None, Some(1e-6), Some(9.0)]);
        // An escape is longer than its character, so that an offset after it may fall within another letter.
        let wrong = text.replace("\"\u{b5}*abs", "\"\\u00b5*\u{b5}\u{b5}\u{b5}q*abs");
        let error = ModelFile::parse("m.toml", &wrong).unwrap_err();
        assert_eq!(error.line, 7, "{error}");
    }

    #[test]
    fn mistakes_are_named_with_line_and_column() {
        for (text, from, to, line, column) in [
            (TEXT, "inertia_kg_m2", "inertia_kgm2", 6, 1),
            (TEXT, "stribeck_n_m", "stribek_n_m", 15, 1),
            (TEXT, "\"viscous_friction\"", "\"viscous\"", 11, 1),
            (TEXT, "0.0045", "-0.0045", 6, 1),
            (TEXT, "0.0045", "\"0.0045\"", 6, 1),
            (TEXT, "0.0045", "nan", 6, 1),
            (TEXT, "[motor]\nname = \"ZK-22FC\"", "[[motor]]", 1, 1),
            (DEFINED, "abs(w)*w", "abs(w)*ww", 7, 24),
            (DEFINED, "tanh(i/0.1)", "tanh(i/0.1", 13, 21),
            (DEFINED, "[\"d\"]", "[\"d\", \"e\"]", 14, 1),
            (DEFINED, "ws = { value", "ws = { valeu", 8, 1),
            (DEFINED, "a = 1e-6", "a = \"x\"", 8, 1),
            (DEFINED, "equation = \"voltage\"\nexpression", "expression", 11, 1),
            (DEFINED, "0.0, 100.0]", "0.0, -1.0]", 20, 1),
            (DEFINED, "value_2", "value_3", 28, 1),
            (DEFINED, "value_2 = 1.5", "holds = [\"resistance\"]", 1, 1),
            (DEFINED, "\"custom_drop\"", "\"custom\"", 11, 1),
            (DEFINED, "\"custom_drop\"", "\"custom-drop\"", 11, 1),
        ] {
            let error = ModelFile::parse("m.toml", &text.replace(from, to)).unwrap_err();
            assert_eq!((error.line, error.column), (line, column), "{to}: {error}");
            assert!(!error.help.is_empty());
        }
        for (from, to, nearest) in [
            ("inertia_kg_m2", "inertia_kgm2", "`inertia_kg_m2`"),
            ("\"viscous_friction\"", "\"viscous\"", "\"viscous_friction\""),
        ] {
            let error = ModelFile::parse("m.toml", &TEXT.replace(from, to)).unwrap_err();
            assert_eq!(error.help, format!("did you mean {nearest}?"));
        }
    }
}
