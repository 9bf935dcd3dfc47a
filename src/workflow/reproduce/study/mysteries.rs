//! Mystery drives, commissioned by the whole program: one marked answer for each seed.
//!
//! Recorded by whoever starts the program (`cli`): this is the sheet that is filled in, and its marking.

use serde::Serialize;
use serde_json::Value;

use super::Outcome;
use super::judge::are_twins;
use super::parameters::{ParameterFinding, truths};
use crate::emulator::mystery::{Truth, draw};
use crate::sample::Verdict;
use crate::workflow::reveal::{self, Answer as Said, reveal};

/// One mystery, commissioned.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MysteryAnswer {
    pub seed: u64,
    /// Id of the hidden effect; `(nothing)`.
    pub hidden: String,
    pub verdict: String,
    pub effects: Vec<String>,
    pub outcome: Outcome,
    /// Why it is marked so, or what failed.
    pub reason: String,
    /// Held-out error in units of the noise: of the five-parameter model, and with all that was named.
    pub holdout_before: Option<f64>,
    pub holdout_after: Option<f64>,
    /// Largest error among the hidden effect's sizes, %.
    pub size_error_percent: Option<f64>,
    /// The motor's parameters with their intervals.
    pub parameters: Vec<ParameterFinding>,
}

/// Named in tables where nothing is hidden.
const NOTHING: &str = "(nothing)";

impl MysteryAnswer {
    /// Marks what `commission --json` said against what the seed hides.
    pub fn of(seed: u64, commissioned: &Value) -> Self {
        let truth = draw(seed).truth;
        let Some(said) = Said::from_json(commissioned) else {
            return Self::failed(seed, "the answer has no verdict".to_owned());
        };
        let outcome = outcome(&truth, &said);
        let revelation = reveal(truth, Some(said.clone()), None);
        let sizes = revelation.sizes.iter();
        let sizes = sizes.filter(|size| !size.effect.is_empty());
        let diagnosis = &commissioned["diagnosis"];
        Self {
            verdict: said.verdict,
            effects: said.effects,
            outcome,
            reason: revelation.reason.unwrap_or_default(),
            holdout_before: diagnosis["holdout_before"].as_f64(),
            holdout_after: diagnosis["holdout_after"].as_f64(),
            size_error_percent: sizes
                .map(|size| size.error_percent.abs())
                .max_by(f64::total_cmp),
            parameters: parameters(&revelation.truth, commissioned),
            ..Self::failed(seed, String::new())
        }
    }

    /// A mystery for which the program gave no answer.
    pub fn failed(seed: u64, reason: String) -> Self {
        Self {
            seed,
            hidden: hidden(&draw(seed).truth),
            verdict: String::new(),
            effects: Vec::new(),
            outcome: Outcome::Failed,
            reason,
            holdout_before: None,
            holdout_after: None,
            size_error_percent: None,
            parameters: Vec::new(),
        }
    }

    /// What the answer is called in the confusion matrix.
    pub fn column(&self) -> String {
        match self.verdict.as_str() {
            "effect" => self.effects.join(" + "),
            "" => "(failed)".to_owned(),
            verdict => format!("({verdict})"),
        }
    }
}

/// What the commissioned model says of the motor beside what the drive was made of.
fn parameters(truth: &Truth, commissioned: &Value) -> Vec<ParameterFinding> {
    let estimates = commissioned["parameters"].as_array();
    let found = truths(&truth.motor)
        .into_iter()
        .filter_map(|(parameter, truth)| {
            let mut estimates = estimates?.iter();
            let own = estimates.find(|own| own["key"] == parameter.key())?;
            Some(ParameterFinding {
                parameter,
                truth,
                value: own["value"].as_f64()?,
                std: own["std"].as_f64()?,
                verdict: if own["verdict"] == "settled" {
                    Verdict::Settled
                } else {
                    Verdict::Searching
                },
            })
        });
    found.collect()
}

fn hidden(truth: &Truth) -> String {
    truth
        .effect()
        .map_or_else(|| NOTHING.to_owned(), |effect| effect.id.clone())
}

fn outcome(truth: &Truth, said: &Said) -> Outcome {
    let id = truth.effect().map(|effect| effect.id.as_str());
    match reveal(truth.clone(), Some(said.clone()), None).outcome {
        Some(reveal::Outcome::Right) if said.verdict == "none" && id.is_some() => {
            Outcome::NotExcited
        }
        Some(reveal::Outcome::Right) => Outcome::Right,
        Some(reveal::Outcome::Wrong) => match (id, said.effects.as_slice()) {
            (Some(id), [only]) if are_twins(id, only) => Outcome::Twin,
            // It claims too little; nothing is named that is not there.
            (Some(_), []) => Outcome::Abstained,
            _ => Outcome::Wrong,
        },
        _ if said.verdict == "ambiguous" => {
            if id.is_some_and(|id| said.effects.iter().any(|named| named == id)) {
                Outcome::Ambiguous
            } else {
                Outcome::Wrong
            }
        }
        _ => Outcome::Abstained,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn seed_of(id: &str) -> u64 {
        let hides = |seed: &u64| hidden(&draw(*seed).truth) == id;
        (0..2000).find(hides).unwrap()
    }

    #[test]
    fn the_marks_are_those_of_the_study() {
        let others: &[_] = &["backlash", "eccentric_load"];
        for (id, verdict, effects, not_excited, expected) in [
            ("cogging", "effect", &["cogging"][..], None, Outcome::Right),
            ("cogging", "effect", &["backlash"], None, Outcome::Wrong),
            (
                "cogging",
                "effect",
                &["cogging", "backlash"],
                None,
                Outcome::Wrong,
            ),
            (
                "speed_delay",
                "effect",
                &["speed_filter"],
                None,
                Outcome::Twin,
            ),
            ("cogging", "none", &[], None, Outcome::Abstained),
            ("cogging", "none", &[], Some("cogging"), Outcome::NotExcited),
            ("cogging", "unexplained", &[], None, Outcome::Abstained),
            (
                "cogging",
                "ambiguous",
                &["cogging", "eccentric_load"],
                None,
                Outcome::Ambiguous,
            ),
            ("cogging", "ambiguous", others, None, Outcome::Wrong),
            (NOTHING, "ambiguous", others, None, Outcome::Wrong),
            ("random_load", "ambiguous", others, None, Outcome::Wrong),
            (NOTHING, "none", &[], None, Outcome::Right),
            (NOTHING, "effect", &["cogging"], None, Outcome::Wrong),
        ] {
            let candidates: Vec<Value> = not_excited
                .iter()
                .map(|id| json!({"effect": id, "status": "not_excited"}))
                .collect();
            let said = json!({
                "diagnosis": {"verdict": verdict, "effects": effects, "candidates": candidates}
            });
            let found = MysteryAnswer::of(seed_of(id), &said).outcome;
            assert_eq!(found, expected, "{id}: {verdict} {effects:?}");
        }
    }

    #[test]
    fn a_set_is_all_that_the_answer_leaves_open() {
        let said = json!({
            "diagnosis": {
                "verdict": "ambiguous", "effects": ["speed_filter"], "candidates": [],
                "confusable": [["speed_filter", "speed_delay"]]
            }
        });
        let answer = MysteryAnswer::of(seed_of("speed_delay"), &said);
        assert_eq!(answer.outcome, Outcome::Ambiguous);
    }

    #[test]
    fn parameters_are_held_against_the_specimen() {
        let seed = seed_of("cogging");
        let truth = draw(seed).truth.motor.resistance_ohm;
        let said = json!({
            "diagnosis": {"verdict": "effect", "effects": ["cogging"], "candidates": [],
                "holdout_before": 5.0, "holdout_after": 1.02},
            "parameters": [
                {"key": "resistance_ohm", "value": 1.01 * truth, "std": 0.02, "verdict": "settled"},
                {"key": "inertia_kg_m2", "value": null, "std": null, "verdict": "not_observable"}
            ]
        });
        let answer = MysteryAnswer::of(seed, &said);
        let [own] = answer.parameters.as_slice() else {
            panic!("{:?}", answer.parameters)
        };
        assert_eq!(own.verdict, Verdict::Settled);
        assert!((own.value / own.truth - 1.01).abs() < 1e-12);
        assert_eq!(answer.holdout_after, Some(1.02));
    }
}
