//! A mystery revealed: what it hid, against what the tool and the person said.
//!
//! ```text
//! truth (from under the seal) + diagnosis as JSON -> right | wrong | abstained, errors of the sizes
//!                             + guess of a person -> right or wrong, and what in the run would have shown it
//! ```

use serde::{Serialize, Serializer};
use serde_json::Value;

use crate::emulator::mystery::{TrueEffect, TrueValue, Truth};
use crate::plant::{Effect, effect};
use crate::text::number::{fixed, shortest, with_unit};

/// What counts as saying that nothing is missing.
const NONE: &str = "none";
/// What counts as saying that nothing known explains the run.
const UNEXPLAINED: &str = "unexplained";
/// Also the word of a person who abstains.
const AMBIGUOUS: &str = "ambiguous";

/// What somebody says that a machine hides.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Answer {
    /// effect, ambiguous, none or unexplained.
    pub verdict: String,
    /// The first one is the best guess.
    pub effects: Vec<String>,
    /// Effects that the run could not show.
    pub not_excited: Vec<String>,
    /// Fitted values as (effect, key, value).
    #[serde(skip)]
    values: Vec<(String, String, f64)>,
}

impl Answer {
    /// One word: an effect's id, `none`, `unexplained`, or `abstain`.
    pub fn word(word: &str) -> Self {
        let (verdict, effects) = match word {
            NONE => (NONE, Vec::new()),
            UNEXPLAINED => (UNEXPLAINED, Vec::new()),
            "abstain" => (AMBIGUOUS, Vec::new()),
            id => ("effect", vec![id.to_owned()]),
        };
        Self {
            verdict: verdict.to_owned(),
            effects,
            ..Self::default()
        }
    }

    /// The result of `diagnose --json`, or that of `commission --json`, which holds one.
    pub fn from_json(document: &Value) -> Option<Self> {
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
            // Only the best guess is among the effects: what it cannot be told from is left open with it.
            for mut pair in each(&diagnosis["confusable"]).iter().map(list) {
                if pair.iter().any(|id| effects.contains(id)) {
                    pair.retain(|id| !effects.contains(id));
                    effects.extend(pair);
                }
            }
        }
        let mut answer = Self {
            verdict,
            effects,
            ..Self::default()
        };
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
                answer
                    .values
                    .retain(|known| known.0 != id || known.1 != key);
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
}

/// How an answer is scored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    Right,
    Wrong,
    Abstained,
}

/// One true value against the fitted one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Size {
    /// Empty for the motor's own.
    pub effect: String,
    pub key: String,
    pub unit: String,
    #[serde(rename = "true")]
    pub truth: f64,
    pub found: f64,
    /// Of the true value; of the whole wave for its sine and cosine part.
    pub error_percent: f64,
}

/// What a person said before.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Guess {
    pub effect: String,
    pub right: bool,
}

/// The truth and what is to be learned from it.
#[derive(Clone, Debug, Serialize)]
pub struct Revelation {
    #[serde(serialize_with = "with_effects_by_key")]
    pub truth: Truth,
    pub answer: Option<Answer>,
    pub outcome: Option<Outcome>,
    /// Why it is scored so.
    pub reason: Option<String>,
    /// Whether an abstaining answer had the truth as its best guess.
    pub best_guess_right: bool,
    pub sizes: Vec<Size>,
    pub guess: Option<Guess>,
    /// What in a run shows it, and what has to be done for that.
    pub looks_like: Option<String>,
    pub excite: Option<String>,
}

/// Opens the truth against answer and guess.
pub fn reveal(truth: Truth, answer: Option<Answer>, guess: Option<&str>) -> Revelation {
    let hidden = truth.effect();
    let scored = answer.as_ref().map(|answer| score(hidden, answer));
    let card = hidden
        .and_then(|hidden| effect::find(&hidden.id))
        .map(Effect::card);
    let best_guess_right = answer.as_ref().zip(hidden).is_some_and(|(answer, hidden)| {
        answer.effects.first() == Some(&hidden.id) && wrong_order(hidden, answer).is_none()
    });
    Revelation {
        outcome: scored.as_ref().map(|scored| scored.0),
        reason: scored.map(|scored| scored.1),
        best_guess_right,
        sizes: answer
            .as_ref()
            .map_or_else(Vec::new, |answer| sizes(&truth, answer)),
        guess: guess.map(|effect| Guess {
            effect: effect.to_owned(),
            right: score(hidden, &Answer::word(effect)).0 == Outcome::Right,
        }),
        looks_like: card.map(|card| card.looks_like.to_owned()),
        excite: card.map(|card| card.excite.to_owned()),
        answer,
        truth,
    }
}

/// Key of the number of waves in a turn.
pub(super) const ORDER: &str = "order";

/// The order that the answer gives the hidden effect and the true one, where they differ: a wave of another number of
/// cogs is another effect under the same name. Orders are whole numbers.
fn wrong_order(hidden: &TrueEffect, answer: &Answer) -> Option<(f64, f64)> {
    let order = hidden.parameters.iter().find(|one| one.key == ORDER)?.value;
    let found = answer.value(&hidden.id, ORDER)?;
    ((found - order).abs() >= 0.5).then_some((found, order))
}

/// An answer is right if it names what is there and nothing else, or says why it cannot be seen. One that says nothing is
/// wrong only if it claims that there is nothing.
fn score(hidden: Option<&TrueEffect>, answer: &Answer) -> (Outcome, String) {
    use Outcome::{Abstained, Right, Wrong};
    let named = answer.effects.join(", ");
    let verdict = answer.verdict.as_str();
    let Some(hidden) = hidden else {
        return match verdict {
            NONE => (Right, "nothing is hidden, and nothing was named".to_owned()),
            "effect" => (Wrong, format!("nothing is hidden, {named} was named")),
            _ => {
                let reason = "nothing is hidden; the answer left that open";
                (Abstained, reason.to_owned())
            }
        };
    };
    let id = &hidden.id;
    let is_in = answer.effects.contains(id);
    match (verdict, wrong_order(hidden, answer)) {
        ("effect", Some((found, order))) if answer.effects == [id.clone()] => {
            let reason = format!("{id} was named with {found} waves in a turn, it has {order}");
            (Wrong, reason)
        }
        ("effect", _) if answer.effects == [id.clone()] => (Right, format!("{id} was named")),
        ("effect", _) if is_in => {
            let reason = format!("{id} was named, and so was what is not there: {named}");
            (Wrong, reason)
        }
        ("effect", _) if hidden.is_foreign => {
            let reason = format!("{id} is in no catalogue, so that {named} cannot be it");
            (Wrong, reason)
        }
        ("effect", _) => (Wrong, format!("{named} was named instead of {id}")),
        (UNEXPLAINED, _) if hidden.is_foreign => {
            let what = "the answer is that nothing known explains the run";
            (Right, format!("{id} is in no catalogue, and {what}"))
        }
        (NONE, _) if answer.not_excited.contains(id) => {
            let reason = format!("the answer says that this run could not show {id}");
            (Right, reason)
        }
        (NONE, _) => (Wrong, format!("{id} is hidden and was not seen")),
        (AMBIGUOUS, _) if is_in => {
            let reason = format!("{id} is among what the answer left open: {named}");
            (Abstained, reason)
        }
        _ => (Abstained, format!("the answer did not name {id}")),
    }
}

/// Every true value for which the answer has one. A diagnosis has a size for each of its candidates; only of those that it
/// names is it an answer.
fn sizes(truth: &Truth, answer: &Answer) -> Vec<Size> {
    let motor = &truth.motor;
    let kt = motor.torque_constant();
    let own = [
        ("resistance_ohm", motor.resistance_ohm, "ohm"),
        ("inductance_h", motor.inductance_h, "H"),
        (
            "back_emf_v_s_per_rad",
            motor.back_emf_v_s_per_rad,
            "V.s/rad",
        ),
        ("torque_n_m_per_a", kt, "N.m/A"),
        ("inertia_kg_m2", motor.inertia_kg_m2, "kg.m2"),
        ("load_torque_n_m", motor.load_torque_n_m, "N.m"),
    ];
    let size = |effect: &str, key: &str, unit: &str, truth: f64, scale: f64| {
        let found = answer.value(effect, key)?;
        Some(Size {
            effect: effect.to_owned(),
            key: key.to_owned(),
            unit: unit.to_owned(),
            truth,
            found,
            error_percent: 100.0 * (found - truth) / scale.abs(),
        })
    };
    let named = truth.effects.iter();
    let named = named.filter(|effect| answer.effects.contains(&effect.id));
    let of_effects = named.flat_map(|effect| {
        let value = |prefix: &str| {
            let mut parameters = effect.parameters.iter();
            Some(parameters.find(|own| own.key.starts_with(prefix))?.value)
        };
        let wave = value("sin_").zip(value("cos_"));
        effect.parameters.iter().filter_map(move |own| {
            let amplitude = wave.filter(|_| own.key != ORDER);
            let scale = amplitude.map_or(own.value, |(sin, cos)| sin.hypot(cos));
            size(&effect.id, &own.key, &own.unit, own.value, scale)
        })
    });
    let own = own.iter();
    let own = own.filter_map(|(key, value, unit)| size("", key, unit, *value, *value));
    let all = of_effects.chain(own);
    all.filter(|size| size.error_percent.is_finite()).collect()
}

impl Revelation {
    /// For a person.
    pub fn text(&self) -> String {
        let mut lines = Vec::new();
        match self.truth.effect() {
            None => lines.push("hidden: nothing; the five-parameter model is the truth".to_owned()),
            Some(hidden) => {
                let value =
                    |own: &TrueValue| format!("{} = {}", own.key, number(own.value, &own.unit));
                let values: Vec<String> = hidden.parameters.iter().map(value).collect();
                lines.push(format!("hidden: {} ({})", hidden.id, values.join(", ")));
            }
        }
        if let Some(guess) = &self.guess {
            let word = if guess.right { "right" } else { "not it" };
            lines.push(format!("your guess: {}: {word}", guess.effect));
        }
        if let (Some(outcome), Some(reason)) = (self.outcome, &self.reason) {
            let word = match outcome {
                Outcome::Right => "right",
                Outcome::Wrong => "wrong",
                Outcome::Abstained => "abstained",
            };
            lines.push(format!("the tool's answer: {word}: {reason}"));
        }
        for size in &self.sizes {
            let name = if size.effect.is_empty() {
                size.key.clone()
            } else {
                format!("{}.{}", size.effect, size.key)
            };
            let sign = if size.error_percent < 0.0 { "" } else { "+" };
            lines.push(format!(
                "  {name}: true {}, found {} ({sign}{} %)",
                shortest(size.truth, 4),
                number(size.found, &size.unit),
                fixed(size.error_percent, 1)
            ));
        }
        if let (Some(looks_like), Some(excite)) = (&self.looks_like, &self.excite) {
            lines.push(format!("what shows it: {looks_like}"));
            lines.push(format!("what brings it out: {excite}"));
        }
        lines.join("\n")
    }
}

fn number(value: f64, unit: &str) -> String {
    with_unit(&shortest(value, 4), unit)
}

/// The truth with parameters by their key, as every other JSON of the program has them.
fn with_effects_by_key<S: Serializer>(truth: &Truth, serializer: S) -> Result<S::Ok, S::Error> {
    let of_effect = |hidden: &TrueEffect| {
        let parameter = |own: &TrueValue| {
            let value = serde_json::json!({ "value": own.value, "unit": own.unit });
            (own.key.clone(), value)
        };
        let parameters: serde_json::Map<_, _> = hidden.parameters.iter().map(parameter).collect();
        serde_json::json!({
            "effect": hidden.id, "in_catalogue": !hidden.is_foreign, "parameters": parameters,
        })
    };
    let effects: Vec<Value> = truth.effects.iter().map(of_effect).collect();
    serde_json::json!({ "seed": truth.seed, "effects": effects, "motor": truth.motor })
        .serialize(serializer)
}

#[cfg(test)]
#[path = "reveal_tests.rs"]
mod tests;
