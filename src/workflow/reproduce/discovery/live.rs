//! What the whole program makes of a mystery drive in real time: one answer for each seed and link.
//!
//! Recorded by whoever starts the program (`cli`): this is the sheet that is filled in, and its marking.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::judge::are_twins;
use super::{Outcome, Tally};
use crate::emulator::mystery::{Truth, draw};
use crate::workflow::reveal::{self, Answer as Said, reveal};

/// A link and its rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LiveLink {
    ModbusRtu,
    Stream,
}

impl LiveLink {
    pub const ALL: [Self; 2] = [Self::ModbusRtu, Self::Stream];

    /// The protocol's name in a bench file.
    pub const fn protocol(self) -> &'static str {
        match self {
            Self::ModbusRtu => "modbus-rtu",
            Self::Stream => "stream",
        }
    }

    /// Exchanges asked for in a second, and the bits a second of the line.
    pub const fn pace(self) -> (f64, u32) {
        match self {
            Self::ModbusRtu => (100.0, 115_200),
            // As over USB, where the baud rate bounds nothing.
            Self::Stream => (1000.0, 12_000_000),
        }
    }
}

/// What the commands said about one mystery.
#[derive(Clone, Debug, Default)]
pub struct Heard {
    /// `diagnose --json`.
    pub diagnosis: Value,
    /// `add --json` of the last named effect, on the model with those before it.
    pub last_add: Option<Value>,
    /// Rows a second that the fit run has.
    pub rows_per_s: f64,
}

/// One mystery from `run` to `add`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LiveAnswer {
    pub link: LiveLink,
    pub seed: u64,
    /// Id of the hidden effect; `(nothing)`.
    pub hidden: String,
    pub verdict: String,
    pub effects: Vec<String>,
    pub outcome: Outcome,
    /// Why it is marked so, or what failed.
    pub reason: String,
    pub rows_per_s: Option<f64>,
    /// Held-out error in units of the noise: of the five-parameter model, and after `add`.
    pub holdout_before: Option<f64>,
    pub holdout_after: Option<f64>,
    /// Largest error among the hidden effect's sizes, %.
    pub size_error_percent: Option<f64>,
}

/// Named in tables where nothing is hidden.
const NOTHING: &str = "(nothing)";

impl LiveAnswer {
    /// Marks what was heard against what the seed hides.
    pub fn of(link: LiveLink, seed: u64, heard: &Heard) -> Self {
        let truth = draw(seed).truth;
        let Some(said) = Said::from_json(&heard.diagnosis) else {
            return Self::failed(link, seed, "the diagnosis has no verdict".to_owned());
        };
        let outcome = outcome(&truth, &said);
        let revelation = reveal(truth, Some(said.clone()), None);
        let sizes = revelation
            .sizes
            .iter()
            .filter(|size| !size.effect.is_empty());
        let ladder = (heard.last_add.as_ref())
            .map(|add| &add["ladder"])
            .and_then(Value::as_array);
        let rung = |rung: Option<&Value>| rung.and_then(|rung| rung["holdout_rmse"].as_f64());
        Self {
            link,
            seed,
            hidden: hidden(&revelation.truth),
            verdict: said.verdict,
            effects: said.effects,
            outcome,
            reason: revelation.reason.unwrap_or_default(),
            rows_per_s: Some(heard.rows_per_s),
            holdout_before: heard.diagnosis["holdout_before"].as_f64(),
            holdout_after: rung(ladder.and_then(|ladder| ladder.last())),
            size_error_percent: sizes
                .map(|size| size.error_percent.abs())
                .max_by(f64::total_cmp),
        }
    }

    /// A mystery for which a command gave no answer.
    pub fn failed(link: LiveLink, seed: u64, reason: String) -> Self {
        Self {
            link,
            seed,
            hidden: hidden(&draw(seed).truth),
            verdict: String::new(),
            effects: Vec::new(),
            outcome: Outcome::Failed,
            reason,
            rows_per_s: None,
            holdout_before: None,
            holdout_after: None,
            size_error_percent: None,
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

impl Tally {
    /// Counts of the live answers over one link.
    pub fn of_live<'a>(answers: impl IntoIterator<Item = &'a LiveAnswer>) -> Self {
        let mut tally = Self::default();
        for answer in answers {
            tally.count(answer.outcome);
        }
        tally
    }
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

    #[track_caller]
    fn outcome_of(id: &str, verdict: &str, effects: &[&str], not_excited: &[&str]) -> Outcome {
        let candidates: Vec<Value> = not_excited
            .iter()
            .map(|id| json!({"effect": id, "status": "not_excited"}))
            .collect();
        let heard = Heard {
            diagnosis: json!({"verdict": verdict, "effects": effects, "candidates": candidates}),
            ..Heard::default()
        };
        LiveAnswer::of(LiveLink::ModbusRtu, seed_of(id), &heard).outcome
    }

    #[test]
    fn the_marks_are_those_of_the_study() {
        assert_eq!(
            outcome_of("cogging", "effect", &["cogging"], &[]),
            Outcome::Right
        );
        assert_eq!(
            outcome_of("cogging", "effect", &["backlash"], &[]),
            Outcome::Wrong
        );
        assert_eq!(
            outcome_of("cogging", "effect", &["cogging", "backlash"], &[]),
            Outcome::Wrong
        );
        assert_eq!(
            outcome_of("speed_delay", "effect", &["speed_filter"], &[]),
            Outcome::Twin
        );
        assert_eq!(outcome_of("cogging", "none", &[], &[]), Outcome::Abstained);
        assert_eq!(
            outcome_of("cogging", "none", &[], &["cogging"]),
            Outcome::NotExcited
        );
        assert_eq!(
            outcome_of("cogging", "unexplained", &[], &[]),
            Outcome::Abstained
        );
        assert_eq!(
            outcome_of("cogging", "ambiguous", &["cogging", "eccentric_load"], &[]),
            Outcome::Ambiguous
        );
        for hidden in ["cogging", NOTHING, "random_load"] {
            let others = ["backlash", "eccentric_load"];
            assert_eq!(
                outcome_of(hidden, "ambiguous", &others, &[]),
                Outcome::Wrong
            );
        }
        assert_eq!(outcome_of(NOTHING, "none", &[], &[]), Outcome::Right);
        assert_eq!(
            outcome_of(NOTHING, "effect", &["cogging"], &[]),
            Outcome::Wrong
        );
    }

    #[test]
    fn a_set_is_all_that_the_answer_leaves_open() {
        let heard = Heard {
            diagnosis: json!({
                "verdict": "ambiguous", "effects": ["speed_filter"], "candidates": [],
                "confusable": [["speed_filter", "speed_delay"]]
            }),
            ..Heard::default()
        };
        let answer = LiveAnswer::of(LiveLink::Stream, seed_of("speed_delay"), &heard);
        assert_eq!(answer.outcome, Outcome::Ambiguous);
    }

    #[test]
    fn the_error_after_is_that_of_the_last_rung() {
        let heard = Heard {
            diagnosis: json!({"verdict": "effect", "effects": ["cogging"], "holdout_before": 5.0, "candidates": []}),
            last_add: Some(json!({"ladder": [{"holdout_rmse": 5.0}, {"holdout_rmse": 1.02}]})),
            rows_per_s: 99.0,
        };
        let answer = LiveAnswer::of(LiveLink::Stream, seed_of("cogging"), &heard);
        assert_eq!(answer.holdout_before, Some(5.0));
        assert_eq!(answer.holdout_after, Some(1.02));
    }
}
