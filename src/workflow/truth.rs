//! The hidden effects of a software drive, compared with the diagnosis.

use std::fmt::Write as _;

use serde::Serialize;

use drivebench_diagnose::{Diagnosis, DiagnosisVerdict};
use drivebench_emulator::mystery::TrueEffect;
use drivebench_model::text::number::{fixed, shortest, with_unit};

/// Key of the order of a harmonic: periods in a turn.
pub const ORDER: &str = "order";

/// The hidden effects of an emulator, for scoring the diagnosis; a real drive has none.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Truth {
    pub effects: Vec<String>,
    pub named_correctly: bool,
    pub sizes: Vec<Size>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Size {
    pub effect: String,
    pub key: String,
    pub unit: String,
    #[serde(rename = "true")]
    pub truth: f64,
    pub found: Option<f64>,
    /// Of the true value; for the sine and cosine part of a harmonic, of its amplitude.
    pub error_percent: Option<f64>,
}

impl Truth {
    /// Compares the hidden effects with those that the diagnosis names, and with the values of its model.
    pub fn of(hidden: &[TrueEffect], diagnosis: &Diagnosis) -> Self {
        let model = &diagnosis.model.parameters;
        let found = |id: &str, key: &str| {
            let own = |name: &str| name.split_once('.') == Some((id, key));
            model.iter().find(|one| own(&one.key))?.value
        };
        let sizes = sizes(hidden, found);
        let mut effects: Vec<String> = hidden.iter().map(|effect| effect.id.clone()).collect();
        effects.sort();
        let known = hidden.iter().filter(|effect| !effect.is_foreign);
        let mut known: Vec<&str> = known.map(|effect| effect.id.as_str()).collect();
        let mut named = diagnosis.effects.clone();
        known.sort_unstable();
        named.sort_unstable();
        let is_explained = diagnosis.verdict != DiagnosisVerdict::Unexplained;
        let is_foreign = known.len() < hidden.len();
        let has_other_order = sizes.iter().any(Size::is_of_another_order);
        Self {
            named_correctly: named == known && !(is_foreign && is_explained) && !has_other_order,
            effects,
            sizes,
        }
    }

    /// The hidden effects, whether the diagnosis is right, and each true value with the one that was found.
    pub fn sentence(&self) -> String {
        let hidden = match self.effects.as_slice() {
            [] => "no hidden effect".to_owned(),
            effects => effects.join(", "),
        };
        let verdict = if self.named_correctly { "right" } else { "wrong" };
        let mut sentence = format!("the emulator has {hidden}: the diagnosis is {verdict}");
        for size in &self.sizes {
            let effect =
                if self.effects.len() > 1 { format!("{}.", size.effect) } else { String::new() };
            let _ = write!(sentence, "; {effect}{}", size.text());
        }
        sentence
    }
}

impl Size {
    fn is_of_another_order(&self) -> bool {
        let error = self.found.map(|found| (found - self.truth).abs());
        // Orders are whole numbers: a harmonic of another order is another effect under the same name.
        self.key == ORDER && error.is_some_and(|error| error >= 0.5)
    }

    fn text(&self) -> String {
        let number = |value: f64| with_unit(&shortest(value, 4), &self.unit);
        let (key, truth) = (&self.key, number(self.truth));
        let found = self
            .found
            .map_or_else(|| "not found".to_owned(), |found| format!("found {}", number(found)));
        let error = self.error_percent.map_or_else(String::new, |percent| {
            let sign = if percent < 0.0 { "" } else { "+" };
            format!(" ({sign}{} %)", fixed(percent, 1))
        });
        format!("{key}: true {truth}, {found}{error}")
    }
}

/// Every parameter of the hidden effects, with the value that `found` has for the id of the effect and the key.
pub fn sizes<'a>(
    hidden: impl IntoIterator<Item = &'a TrueEffect>,
    found: impl Fn(&str, &str) -> Option<f64>,
) -> Vec<Size> {
    let mut sizes = Vec::new();
    for effect in hidden {
        let value = |prefix: &str| {
            Some(effect.parameters.iter().find(|own| own.key.starts_with(prefix))?.value)
        };
        let wave = value("sin_").zip(value("cos_"));
        for own in &effect.parameters {
            let amplitude = wave.filter(|_| own.key != ORDER);
            let scale = amplitude.map_or(own.value, |(sin, cos)| sin.hypot(cos));
            let found = found(&effect.id, &own.key);
            let error = found.map(|found| 100.0 * (found - own.value) / scale.abs());
            sizes.push(Size {
                effect: effect.id.clone(),
                key: own.key.clone(),
                unit: own.unit.clone(),
                truth: own.value,
                found,
                error_percent: error.filter(|error| error.is_finite()),
            });
        }
    }
    sizes
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_emulator::mystery::{TrueValue, draw};

    fn hidden(id: &str) -> TrueEffect {
        let mut drawn = (0..2000).filter_map(|seed| draw(seed).truth.effects.pop());
        drawn.find(|effect| effect.id == id).unwrap()
    }

    #[test]
    fn an_error_is_of_the_true_value_or_of_the_amplitude() {
        let cogging = hidden("cogging");
        let value = |key: &str| {
            cogging.parameters.iter().find(|one: &&TrueValue| one.key == key).unwrap().value
        };
        let amplitude = value("sin_n_m").hypot(value("cos_n_m"));
        let found = |id: &str, key: &str| {
            assert_eq!(id, "cogging");
            match key {
                "order" => Some(2.0 * value("order")),
                "cos_n_m" => Some(value("cos_n_m") + 0.1 * amplitude),
                _ => None,
            }
        };
        let sizes = sizes([&cogging], found);
        let percent = |key: &str| {
            sizes.iter().find(|size| size.key == key).unwrap().error_percent.map(f64::round)
        };
        assert_eq!(["order", "cos_n_m", "sin_n_m"].map(percent), [Some(100.0), Some(10.0), None]);
        assert!(sizes.iter().any(Size::is_of_another_order));
    }

    #[test]
    fn a_size_without_a_unit_has_none_and_may_be_not_found() {
        let ratio = hidden("load_dependent_friction");
        let text = |found: Option<f64>| sizes([&ratio], |_, _| found)[0].text();
        let lines = [text(None), text(Some(0.9 * ratio.parameters[0].value))];
        assert!(lines[0].starts_with("ratio: true 0."));
        assert!(lines[0].ends_with(", not found"), "{}", lines[0]);
        assert!(lines[1].ends_with(" (-10.0 %)"), "{}", lines[1]);
        assert!(!lines[1].contains(" - "), "{}", lines[1]);
    }
}
