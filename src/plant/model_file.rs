//! The model file: `[motor]`, `[[effect]]`, and what a fit writes back beside them.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use super::effect;
use super::model::{ActiveEffect, Model, Slot};
use super::motor::{Motor, MotorKey};
use crate::config_text::{ConfigError, help_for_unknown, nearest};

/// Standard deviation of one fitted value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FittedValue {
    pub key: String,
    pub std: f64,
}

/// What a fit leaves behind: the runs it used and the ladder that led here.
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
        for (key, value) in &root {
            match key.as_str() {
                "motor" => reader.motor(value, &mut model)?,
                "effect" => reader.effects(value, &mut model)?,
                "history" => {
                    history = value.clone().try_into().map_err(|error: toml::de::Error| {
                        reader.error(0, "history", error.message())
                    })?;
                }
                other => return Err(reader.unknown(0, other, &["motor", "effect", "history"])),
            }
        }
        model
            .validate()
            .map_err(|error| reader.error(0, error.key(), &error.to_string()))?;
        Ok(Self { model, history })
    }

    /// The text of the file: what `parse` reads back to the same model.
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
                let _ = writeln!(
                    text,
                    "{} = {}{}",
                    key.key(),
                    number(value),
                    self.comment(&Slot::Motor(key))
                );
            }
        }
        if !self.model.fixed.is_empty() {
            let quoted: Vec<String> = self
                .model
                .fixed
                .iter()
                .map(|key| format!("{key:?}"))
                .collect();
            let _ = writeln!(text, "fixed = [{}]", quoted.join(", "));
        }
        for (index, active) in self.model.effects.iter().enumerate() {
            let _ = write!(text, "\n[[effect]]\nid = {:?}\n", active.id());
            for (parameter, spec) in active.effect.parameters().iter().enumerate() {
                if let Some(value) = active.values[parameter] {
                    let slot = Slot::Effect {
                        index,
                        parameter,
                        spec,
                        id: active.id(),
                    };
                    let _ = writeln!(
                        text,
                        "{} = {}{}",
                        spec.key,
                        number(value),
                        self.comment(&slot)
                    );
                }
            }
        }
        if self.history != FileHistory::default() {
            let table =
                toml::Table::try_from(&self.history).expect("strings and numbers always serialise");
            let root = toml::Table::from_iter([("history".to_owned(), toml::Value::Table(table))]);
            let _ = write!(text, "\n{root}");
        }
        text
    }

    /// The standard deviation and unit beside a value, for the human reader.
    fn comment(&self, slot: &Slot) -> String {
        let key = slot.key();
        match self.history.fitted.iter().find(|fitted| fitted.key == key) {
            Some(fitted) => format!("  # +- {} {}", number(fitted.std), slot.unit()),
            None => String::new(),
        }
    }
}

/// Shortest text that reads back to the same number, with a decimal point where TOML needs one.
fn number(value: f64) -> String {
    format!("{value:?}")
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
    /// An error at the first place at or after byte `from` where a line assigns `key`.
    fn error(&self, from: usize, key: &str, message: &str) -> ConfigError {
        let offset = self.find(from, key);
        ConfigError::at(
            self.file,
            self.text,
            offset,
            message,
            "see bench-configs/motors for a commented example",
        )
    }

    fn unknown(&self, from: usize, key: &str, allowed: &[&str]) -> ConfigError {
        let help = help_for_unknown(key, allowed.iter().copied());
        ConfigError::at(
            self.file,
            self.text,
            self.find(from, key),
            format!("unknown key `{key}`"),
            help,
        )
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
            #[expect(
                clippy::cast_precision_loss,
                reason = "no physical quantity is a large integer"
            )]
            toml::Value::Integer(number) => Ok(*number as f64),
            other => Err(self.error(
                from,
                key,
                &format!("{key} is a {}, expected a number", other.type_str()),
            )),
        }
    }

    fn motor(&self, value: &toml::Value, model: &mut Model) -> Result<(), ConfigError> {
        let Some(table) = value.as_table() else {
            return Err(self.error(0, "motor", "motor must be a table: [motor]"));
        };
        model.motor = Motor::new("");
        for (key, value) in table {
            match key.as_str() {
                "name" => {
                    let name = value
                        .as_str()
                        .ok_or_else(|| self.error(0, key, "name must be a string"))?;
                    name.clone_into(&mut model.motor.name);
                }
                "fixed" => model.fixed = self.strings(key, value)?,
                _ => {
                    let Some(known) = MotorKey::from_key(key) else {
                        let mut allowed: Vec<&str> =
                            MotorKey::ALL.iter().map(|known| known.key()).collect();
                        allowed.extend(["name", "fixed"]);
                        return Err(self.unknown(0, key, &allowed));
                    };
                    model.motor.set(known, self.number(0, key, value)?);
                }
            }
        }
        Ok(())
    }

    fn strings(&self, key: &str, value: &toml::Value) -> Result<Vec<String>, ConfigError> {
        value
            .as_array()
            .and_then(|items| {
                items
                    .iter()
                    .map(|item| item.as_str().map(str::to_owned))
                    .collect()
            })
            .ok_or_else(|| self.error(0, key, &format!("{key} must be a list of strings")))
    }

    fn effects(&self, value: &toml::Value, model: &mut Model) -> Result<(), ConfigError> {
        let Some(tables) = value.as_array() else {
            return Err(self.error(0, "effect", "effects are written as [[effect]] tables"));
        };
        let mut from = 0;
        for table in tables {
            from = self.text[from..]
                .find("[[effect]]")
                .map_or(from, |offset| from + offset + 1);
            let table = table
                .as_table()
                .ok_or_else(|| self.error(from, "", "an effect must be a table"))?;
            let Some(id) = table.get("id").and_then(toml::Value::as_str) else {
                return Err(self.error(
                    from,
                    "id",
                    "an effect needs an id, as id = \"viscous_friction\"",
                ));
            };
            let Some(found) = effect::find(id) else {
                let known = effect::CATALOGUE.iter().map(|effect| effect.card().id);
                let mut error = self.error(
                    from,
                    "id",
                    &format!("effect {id:?} is not in the catalogue"),
                );
                error.help = nearest(id, known).map_or_else(
                    || "`drivebench effects` lists the catalogue".to_owned(),
                    |name| format!("did you mean {name:?}?"),
                );
                return Err(error);
            };
            if model.has(id) {
                return Err(self.error(from, "id", &format!("effect {id:?} stands twice")));
            }
            let mut active = ActiveEffect::new(found);
            for (key, value) in table.iter().filter(|(key, _)| *key != "id") {
                let Some(at) = found.parameters().iter().position(|spec| spec.key == key) else {
                    let mut allowed: Vec<&str> =
                        found.parameters().iter().map(|spec| spec.key).collect();
                    allowed.push("id");
                    return Err(self.unknown(from, key, &allowed));
                };
                active.values[at] = Some(self.number(from, key, value)?);
            }
            model.effects.push(active);
        }
        Ok(())
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

    #[test]
    fn what_is_written_reads_back_to_the_same_model() {
        let mut file = ModelFile::parse("m.toml", TEXT).unwrap();
        file.history.fitted_on.push("runs/x \"quoted\"".to_owned());
        file.history.fitted.push(FittedValue {
            key: "inertia_kg_m2".into(),
            std: 2e-6,
        });
        let again = ModelFile::parse("m.toml", &file.to_toml()).unwrap();
        assert_eq!(again.model.motor, file.model.motor);
        assert_eq!(again.model.fixed, file.model.fixed);
        assert_eq!(again.history, file.history);
        assert_eq!(again.model.effects[1].values, vec![Some(0.2), None]);
        assert!(
            file.to_toml()
                .contains("inertia_kg_m2 = 0.0045  # +- 2e-6 kg.m2")
        );
    }

    #[test]
    fn a_misspelt_key_is_named_with_place_and_nearest() {
        let error =
            ModelFile::parse("m.toml", &TEXT.replace("inertia_kg_m2", "inertia_kgm2")).unwrap_err();
        assert_eq!((error.line, error.column), (6, 1));
        assert_eq!(error.help, "did you mean `inertia_kg_m2`?");
        let error =
            ModelFile::parse("m.toml", &TEXT.replace("stribeck_n_m", "stribek_n_m")).unwrap_err();
        assert_eq!(error.line, 15);
        let error = ModelFile::parse(
            "m.toml",
            &TEXT.replace("\"viscous_friction\"", "\"viscous\""),
        )
        .unwrap_err();
        assert_eq!(
            (error.line, error.help.as_str()),
            (11, "did you mean \"viscous_friction\"?")
        );
    }

    #[test]
    fn values_out_of_range_and_of_the_wrong_type_are_refused() {
        for (from, to) in [
            ("0.0045", "-0.0045"),
            ("0.0045", "\"0.0045\""),
            ("0.0045", "nan"),
            ("[motor]", "motor = 3"),
        ] {
            assert!(
                ModelFile::parse("m.toml", &TEXT.replace(from, to)).is_err(),
                "{to}"
            );
        }
    }
}
