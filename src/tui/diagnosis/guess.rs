//! The teaching flow: guess first, then see. What a person may guess, and the guess beside the answer.

use crate::diagnosis::{Candidate, Diagnosis, DiagnosisVerdict, Status};
use crate::plant::effect;
use crate::text::number::probability;

/// What a person may take to be missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Guess {
    Effect(&'static str),
    Nothing,
    /// Something that no effect of the catalogue describes.
    Unknown,
}

impl Guess {
    /// Everything that can be guessed of a model that has the effects `present`.
    pub(super) fn all(present: &[&'static str]) -> impl Iterator<Item = Self> {
        let effects = effect::CATALOGUE.iter().map(|effect| effect.card().id);
        let absent = effects.filter(|id| !present.contains(id));
        let none = [Self::Nothing, Self::Unknown].into_iter();
        none.chain(absent.map(Self::Effect))
    }

    pub(super) const fn key(self) -> &'static str {
        match self {
            Self::Effect(id) => id,
            Self::Nothing => "nothing is missing",
            Self::Unknown => "nothing of the catalogue",
        }
    }
}

/// How far the teaching flow is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Guessing {
    #[default]
    Off,
    Choosing,
    Guessed(Guess),
}

/// The guess beside the answer, in one sentence that says why.
pub(super) fn compared(guess: Guess, diagnosis: &Diagnosis) -> String {
    let answer = answer(diagnosis);
    let same = match (guess, diagnosis.verdict) {
        (Guess::Nothing, DiagnosisVerdict::None) => diagnosis.sufficient,
        (Guess::Unknown, DiagnosisVerdict::Unexplained) => true,
        (Guess::Effect(id), _) => diagnosis.effects.contains(&id),
        _ => false,
    };
    if same {
        let more = match (guess, diagnosis.effects.len()) {
            (Guess::Effect(_), 2..) => format!(", which is part of the answer: {answer}"),
            _ => String::new(),
        };
        return format!("right: you and the tool say {}{more}", guess.key());
    }
    let Guess::Effect(id) = guess else {
        return format!("you: {}. The tool: {answer}", guess.key());
    };
    if diagnosis
        .confusable
        .iter()
        .flatten()
        .any(|rival| *rival == id)
    {
        return format!("as good: this run cannot tell your {id} from the tool's answer: {answer}");
    }
    let times = diagnosis.noise_floor_from.times();
    let mut candidates = diagnosis.candidates.iter();
    let why = match candidates.find(|candidate| candidate.effect == id) {
        Some(candidate) => format!("{id} is {}", reason(candidate, times)),
        None => format!("{id} was not judged on this run"),
    };
    format!("you: {id}. The tool: {answer}; {why}")
}

fn answer(diagnosis: &Diagnosis) -> String {
    match diagnosis.verdict {
        DiagnosisVerdict::None if !diagnosis.sufficient => diagnosis.sentence.clone(),
        DiagnosisVerdict::None => diagnosis.answer().name().to_lowercase(),
        DiagnosisVerdict::NotFitted => "the model does not fit the runs".to_owned(),
        DiagnosisVerdict::Unexplained if diagnosis.search_was_cut => {
            "not all effects were tried together".to_owned()
        }
        DiagnosisVerdict::Unexplained => "no effect of the catalogue explains it".to_owned(),
        DiagnosisVerdict::Effect | DiagnosisVerdict::Ambiguous => diagnosis.effects.join(" and "),
    }
}

fn reason(candidate: &Candidate, times: &str) -> String {
    let before = candidate.holdout_before;
    let there = probability(candidate.probability);
    match (candidate.status, candidate.holdout_after) {
        (Status::Supported, _) => "supported".to_owned(),
        (Status::Possible, None) => format!("possible, with {there}"),
        (Status::Possible, Some(after)) => {
            format!("possible, but leaves more: {before:.2} -> {after:.2} {times}")
        }
        (Status::RuledOut, None) => format!("ruled out: there with {there}"),
        (Status::RuledOut, Some(after)) => {
            format!("ruled out: held-out error {before:.2} -> {after:.2} {times}")
        }
        (Status::NotExcited, _) if candidate.is_open => "left open by the search".to_owned(),
        (Status::NotExcited, _) => "not to be seen in this run".to_owned(),
    }
}
