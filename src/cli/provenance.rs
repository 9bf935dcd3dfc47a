//! `--origin KEY=WORD,...`: where the signals of a file come from, as the user knows it.

use std::str::FromStr;

use serde_json::{Map, Value, json};

use crate::sample::{Channel, Origin, Run, Side};

/// A parsed `--origin`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Provenance {
    origins: Vec<(Channel, Origin)>,
    sides: Vec<(Channel, Side)>,
}

impl FromStr for Provenance {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut provenance = Self::default();
        for item in text.split(',').map(str::trim).filter(|i| !i.is_empty()) {
            let (key, word) = item
                .split_once('=')
                .ok_or_else(|| format!("{item:?} is not of the form KEY=WORD"))?;
            let (key, word) = (key.trim(), word.trim());
            let channel = Channel::from_key(key).ok_or_else(|| {
                let keys = Channel::ALL.map(Channel::key).join(", ");
                format!("unknown signal {key:?} (allowed: {keys})")
            })?;
            let origin = Origin::ALL.into_iter().find(|origin| origin.name() == word);
            let side = Side::ALL.into_iter().find(|side| side.name() == word);
            let has_sides = matches!(
                channel,
                Channel::Voltage | Channel::VoltageCmd | Channel::Current
            );
            match (origin, side) {
                (Some(origin), _) => provenance.origins.push((channel, origin)),
                (None, Some(side)) if has_sides => provenance.sides.push((channel, side)),
                (None, Some(_)) => {
                    return Err(format!(
                        "{item:?}: only a voltage or a current is of the terminal or the supply side"
                    ));
                }
                (None, None) => {
                    let words: Vec<&str> = Origin::ALL
                        .map(Origin::name)
                        .into_iter()
                        .chain(Side::ALL.map(Side::name))
                        .collect();
                    return Err(format!(
                        "{item:?}: {word:?} is not allowed (allowed: {})",
                        words.join(", ")
                    ));
                }
            }
        }
        Ok(provenance)
    }
}

impl Provenance {
    pub(super) fn apply(&self, run: &mut Run) {
        for &(channel, origin) in &self.origins {
            run.set_origin(channel, origin);
        }
        for &(channel, side) in &self.sides {
            run.set_side(channel, side);
        }
    }
}

/// Origin and side of each signal that the run has, for JSON.
pub(super) fn signals(run: &Run) -> Value {
    let there = |channel: &Channel| run.column(*channel).is_some();
    let entries = Channel::ALL.into_iter().filter(there).map(|channel| {
        let entry = json!({
            "origin": run.origin(channel).name(),
            "side": run.side(channel).map(Side::name),
        });
        (channel.key().to_owned(), entry)
    });
    Value::Object(entries.collect::<Map<_, _>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_set_origin_or_side_and_wrong_ones_are_named() {
        let provenance: Provenance = "voltage_v=commanded, current_a=supply,current_a=measured"
            .parse()
            .unwrap();
        let mut run = Run::new("r", vec![0.0, 1.0]).unwrap();
        run.set_column(Channel::Current, vec![1.0, 2.0], Origin::Unknown)
            .unwrap();
        provenance.apply(&mut run);
        assert_eq!(run.origin(Channel::Voltage), Origin::Commanded);
        assert_eq!(
            signals(&run),
            json!({ "current_a": { "origin": "measured", "side": "supply" } })
        );
        for (text, part) in [
            ("volts=measured", "unknown signal"),
            ("voltage_v", "KEY=WORD"),
            ("voltage_v=guessed", "allowed: measured"),
            ("speed_rad_s=supply", "only a voltage or a current"),
        ] {
            let error = text.parse::<Provenance>().unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
