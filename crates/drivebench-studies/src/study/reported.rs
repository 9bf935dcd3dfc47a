//! What `commission --json` reports of a mystery drive, and why that is right or wrong.

use serde_json::Value;

use drivebench::emulator::mystery::TrueEffect;
use drivebench::workflow::ORDER;

/// Verdict that nothing is missing.
const NONE: &str = "none";
/// Verdict that no effect of the catalogue explains the run.
const UNEXPLAINED: &str = "unexplained";
/// Verdict that several effects explain the run alike.
const AMBIGUOUS: &str = "ambiguous";

/// The answer of a commissioning.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Reported {
    /// effect, ambiguous, none or unexplained.
    pub(super) verdict: String,
    /// The most probable first.
    pub(super) effects: Vec<String>,
    /// Effects that the run could not show.
    pub(super) not_excited: Vec<String>,
    /// Fitted values as (effect, key, value).
    values: Vec<(String, String, f64)>,
}

impl Reported {
    /// The result of `diagnose --json`, or that of `commission --json`, which holds one.
    pub(super) fn from_json(document: &Value) -> Option<Self> {
        let diagnosis = document.get("diagnosis").unwrap_or(document);
        let verdict = diagnosis.get("verdict")?.as_str()?.to_owned();
        let text = |value: &Value| value.as_str().map(str::to_owned);
        let each = |value: &'_ Value| value.as_array().cloned().unwrap_or_default();
        let list = |value: &Value| each(value).iter().filter_map(text).collect::<Vec<_>>();
        let mut effects = list(&diagnosis["effects"]);
        if effects.is_empty() {
            effects.extend(text(&diagnosis["effect"]));
        }
        if verdict == AMBIGUOUS {
            // Only the most probable one is among the effects; those that explain the run alike stay possible.
            for mut pair in each(&diagnosis["confusable"]).iter().map(list) {
                if pair.iter().any(|id| effects.contains(id)) {
                    pair.retain(|id| !effects.contains(id));
                    effects.extend(pair);
                }
            }
        }
        let mut answer = Self { verdict, effects, ..Self::default() };
        for candidate in &each(&diagnosis["candidates"]) {
            let Some(id) = text(&candidate["effect"]) else {
                continue;
            };
            if candidate["status"] == "not_excited" {
                answer.not_excited.push(id.clone());
            }
            let parameters = candidate["parameters"].as_object();
            for (key, parameter) in parameters.into_iter().flatten() {
                if let Some(value) = parameter["value"].as_f64() {
                    answer.values.push((id.clone(), key.clone(), value));
                }
            }
        }
        // What a commissioning ends with is fitted with every accepted effect, so it counts more.
        for parameter in &each(&document["parameters"]) {
            let value = parameter["value"].as_f64();
            if let Some((key, value)) = parameter["key"].as_str().zip(value) {
                let (id, key) = key.split_once('.').unwrap_or(("", key));
                answer.values.retain(|known| known.0 != id || known.1 != key);
                answer.values.push((id.to_owned(), key.to_owned(), value));
            }
        }
        Some(answer)
    }

    pub(super) fn value(&self, id: &str, key: &str) -> Option<f64> {
        let mut values = self.values.iter();
        let found = values.find(|known| known.0 == id && known.1 == key)?;
        Some(found.2)
    }

    /// Why the answer is right, wrong or open where `hidden` is the only effect.
    pub(super) fn reason(&self, hidden: Option<&TrueEffect>) -> String {
        let named = self.effects.join(", ");
        let verdict = self.verdict.as_str();
        let Some(hidden) = hidden else {
            return match verdict {
                NONE => "nothing is hidden, and nothing was named".to_owned(),
                "effect" => format!("nothing is hidden, {named} was named"),
                _ => "nothing is hidden; the answer left that open".to_owned(),
            };
        };
        let id = &hidden.id;
        let is_in = self.effects.contains(id);
        match (verdict, wrong_order(hidden, self)) {
            ("effect", Some((found, order))) if self.effects == [id.clone()] => {
                format!("{id} was named with {found} waves in a turn, it has {order}")
            }
            ("effect", _) if self.effects == [id.clone()] => format!("{id} was named"),
            ("effect", _) if is_in => {
                format!("{id} was named, and so was what is not there: {named}")
            }
            ("effect", _) if hidden.is_foreign => {
                format!("{id} is in no catalogue, so that {named} cannot be it")
            }
            ("effect", _) => format!("{named} was named instead of {id}"),
            (UNEXPLAINED, _) if hidden.is_foreign => {
                let what = "the answer is that nothing known explains the run";
                format!("{id} is in no catalogue, and {what}")
            }
            (NONE, _) if self.not_excited.contains(id) => {
                format!("the answer says that this run could not show {id}")
            }
            (NONE, _) => format!("{id} is hidden and was not seen"),
            (AMBIGUOUS, _) if is_in => {
                format!("{id} is among what the answer left open: {named}")
            }
            _ => format!("the answer did not name {id}"),
        }
    }
}

/// The order that the answer gives the hidden effect and the true one, where they differ: a wave of another number of
/// cogs is another effect under the same name. Orders are whole numbers.
fn wrong_order(hidden: &TrueEffect, answer: &Reported) -> Option<(f64, f64)> {
    let order = hidden.parameters.iter().find(|one| one.key == ORDER)?.value;
    let found = answer.value(&hidden.id, ORDER)?;
    ((found - order).abs() >= 0.5).then_some((found, order))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use drivebench::emulator::mystery::draw;

    fn hidden(id: &str) -> TrueEffect {
        let mut drawn = (0..2000).filter_map(|seed| draw(seed).truth.effects.pop());
        drawn.find(|effect| effect.id == id).unwrap()
    }

    #[test]
    fn a_reason_lists_what_was_claimed() {
        let answer_of = |verdict: &str, effects: &[&str], not_excited: &str| {
            let json = json!({
                "verdict": verdict, "effects": effects,
                "candidates": [{ "effect": not_excited, "status": "not_excited" }],
            });
            Reported::from_json(&json).unwrap()
        };
        let (drop, shaker) = (hidden("voltage_drop"), hidden("shaker"));
        for (hidden, verdict, effects, not_excited, expected) in [
            (None, "none", &[][..], "", "nothing was named"),
            (None, "effect", &["cogging"], "", "cogging was named"),
            (None, "unexplained", &[], "", "left that open"),
            (Some(&drop), "effect", &["voltage_drop"], "", "voltage_drop was named"),
            (Some(&drop), "effect", &["supply_sag"], "", "instead of voltage_drop"),
            (Some(&drop), "effect", &["voltage_drop", "cogging"], "", "what is not there"),
            (Some(&drop), "none", &[], "", "was not seen"),
            (Some(&drop), "none", &[], "voltage_drop", "could not show voltage_drop"),
            (Some(&drop), "unexplained", &[], "", "did not name voltage_drop"),
            (Some(&shaker), "unexplained", &[], "", "nothing known explains"),
            (Some(&shaker), "effect", &["cogging"], "", "cannot be it"),
        ] {
            let reason = answer_of(verdict, effects, not_excited).reason(hidden);
            assert!(reason.contains(expected), "{verdict} {effects:?}: {reason}");
        }
    }

    #[test]
    fn rivals_of_the_most_probable_are_left_open() {
        let diagnosis = json!({
            "verdict": "ambiguous", "effect": "speed_filter", "effects": ["speed_filter"],
            "confusable": [["speed_filter", "speed_delay"], ["cogging", "backlash"]], "candidates": [],
        });
        let answer = Reported::from_json(&diagnosis).unwrap();
        assert_eq!(answer.effects, ["speed_filter", "speed_delay"]);
        let reason = answer.reason(Some(&hidden("speed_delay")));
        assert!(reason.contains("left open: speed_filter, speed_delay"), "{reason}");
    }

    #[test]
    fn a_wave_of_another_order_is_not_what_is_hidden() {
        let hidden = hidden("cogging");
        let mut orders = hidden.parameters.iter();
        let order = orders.find(|one| one.key == ORDER).unwrap().value;
        for (found, is_right) in [(order, true), (2.0 * order, false)] {
            let json = json!({
                "verdict": "effect", "effects": ["cogging"],
                "candidates": [{ "effect": "cogging", "parameters": { "order": { "value": found } } }],
            });
            let reason = Reported::from_json(&json).unwrap().reason(Some(&hidden));
            assert_eq!(reason.contains("waves in a turn"), !is_right, "{reason}");
        }
    }

    #[test]
    fn values_of_a_commissioning_take_precedence() {
        let document = json!({
            "diagnosis": {
                "verdict": "effect", "effects": ["cogging"],
                "candidates": [{ "effect": "cogging", "parameters": {
                    "sin_n_m": { "value": 99.0 }, "cos_n_m": { "value": 2.0 },
                } }],
            },
            "parameters": [{ "key": "cogging.sin_n_m", "value": 1.0 }],
        });
        let answer = Reported::from_json(&document).unwrap();
        let value = |key| answer.value("cogging", key);
        assert_eq!([value("sin_n_m"), value("cos_n_m")], [Some(1.0), Some(2.0)]);
        assert_eq!(Reported::from_json(&json!({ "signals": {} })), None);
    }
}
