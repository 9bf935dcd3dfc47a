//! Which effect is missing: the search's findings weighed into one answer.

use serde::Serialize;

use super::axis_map::{AxisMap, axis_map};
use super::candidates::{Candidate, Status};
use super::confirmation::{self, Confirmation};
use super::decide::{self, Settings, explained};
use super::describe::{describe, sentence};
use super::evidence::{Evidence, HoldoutFrom};
use super::family::curve_of;
use super::fitted::Fitted;
use super::ladder::Rung;
use super::mechanical;
use super::next_experiment::{NextExperiment, equivalences};
use super::progress::{Event, Progress, Stage, silent};
use super::refit::Thoroughness;
use super::search::{Accepted, Found, Limits, search};
use crate::identification::noise::FloorSource;
use crate::identification::output_error::FitError;
use crate::plant::{Input, Model};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DiagnosisVerdict {
    Effect,
    Ambiguous,
    None,
    Unexplained,
}

/// The answer, as `diagnose --json` prints it.
#[derive(Clone, Debug, Serialize)]
pub struct Diagnosis {
    pub verdict: DiagnosisVerdict,
    pub effect: Option<&'static str>,
    pub effects: Vec<&'static str>,
    pub sufficient: bool,
    pub noise_floor_from: FloorSource,
    pub holdout_from: HoldoutFrom,
    /// Of the whole accepted set, on the hold-out.
    pub explained_percent: f64,
    pub holdout_before: f64,
    pub holdout_after: f64,
    pub candidates: Vec<Candidate>,
    /// Pairs that these runs do not tell apart, the one in the answer first.
    pub confusable: Vec<[&'static str; 2]>,
    pub ladder: Vec<Rung>,
    /// Along which axis the error runs, and as what curve, where no effect explains it; the clearest first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub axis_map: Vec<AxisMap>,
    /// The answer on a run that had no part in it, where there is one: the headline.
    pub confirm: Option<Confirmation>,
    /// One sentence for a person.
    pub sentence: String,
    /// What could not be asked of these runs, and why.
    pub limits: Vec<String>,
    /// What the named effects cannot be told from by any run.
    pub equivalences: Vec<&'static str>,
    /// The run that would tell more; left to those who know the bench ([`recommend`](super::recommend)).
    pub next_experiment: Option<NextExperiment>,
    /// The refitted baseline and the model with every accepted effect.
    #[serde(skip)]
    pub baseline: Fitted,
    #[serde(skip)]
    pub model: Fitted,
    /// Fitted models with a rival of the only effect in its place, where the search has kept them.
    #[serde(skip)]
    pub rivals: Vec<(&'static str, Model)>,
}

/// How a diagnosis is done.
#[derive(Clone, Copy)]
pub struct Options<'a> {
    /// Goes on until the error is at the floor or nothing more pays; else until the named effects are sufficient and the
    /// floor is near.
    pub until_floor: bool,
    pub thoroughness: Thoroughness,
    pub settings: Settings,
    pub progress: Progress<'a>,
}

impl Default for Options<'_> {
    fn default() -> Self {
        Self {
            until_floor: false,
            thoroughness: Thoroughness::Promising,
            settings: Settings::default(),
            progress: &silent,
        }
    }
}

/// Refits `model` as the baseline and searches for what it misses, with nobody watching.
pub fn diagnose(
    model: &Model,
    evidence: Evidence,
    until_floor: bool,
) -> Result<Diagnosis, FitError> {
    let options = Options {
        until_floor,
        ..Options::default()
    };
    diagnose_with(model, evidence, options)
}

/// Refits `model` as the baseline and searches for what it misses.
pub fn diagnose_with(
    model: &Model,
    evidence: Evidence,
    options: Options<'_>,
) -> Result<Diagnosis, FitError> {
    if evidence.training.input != Input::Voltage {
        return mechanical::diagnose(model, &evidence, options.until_floor);
    }
    (options.progress)(Event::Begun {
        stage: Stage::Baseline,
        of: 0,
    });
    let (evidence, baseline) = evidence.with_baseline(model)?;
    let limits = Limits {
        until_floor: options.until_floor,
        settings: options.settings,
        thoroughness: options.thoroughness,
        progress: options.progress,
    };
    let found = search(&evidence, baseline, model, limits)?;
    Ok(answer(&evidence, found))
}

fn answer(evidence: &Evidence, found: Found) -> Diagnosis {
    let floor = evidence.floor();
    let base = &found.baseline.score;
    let verdict = if wrong_curve(evidence, &found) {
        DiagnosisVerdict::Unexplained
    } else {
        verdict(evidence, &found)
    };
    let axis_map = if verdict == DiagnosisVerdict::Unexplained {
        // The maps are a help; without them the verdict stands.
        let model = &found.baseline.fit.model;
        axis_map(model, &evidence.training, &evidence.noise).unwrap_or_default()
    } else {
        Vec::new()
    };
    let named = matches!(
        verdict,
        DiagnosisVerdict::Effect | DiagnosisVerdict::Ambiguous
    );
    let error_before = found.baseline.fit.nrms;
    let mut candidates = describe(base, error_before, evidence, &found, named);
    if !named {
        // What pays although nothing is named is not in the answer.
        for candidate in &mut candidates {
            if candidate.status == Status::Supported {
                candidate.status = Status::Possible;
            }
        }
    }
    let rivals = match &found.accepted[..] {
        [only] => found
            .first_set
            .iter()
            .map(|&index| &found.first_round[index])
            .filter(|refit| only.rivals.contains(&refit.id()))
            .map(|refit| (refit.id(), refit.fit.model.clone()))
            .collect(),
        _ => Vec::new(),
    };
    let (accepted, best) = if named {
        (found.accepted, &found.best)
    } else {
        (Vec::new(), &found.baseline)
    };
    let eta = explained(base.nrms, best.score.nrms, floor);
    let settled = decide::at_the_floor(evidence, &best.score);
    let excited = candidates
        .iter()
        .any(|candidate| candidate.status != Status::NotExcited);
    let mut diagnosis = Diagnosis {
        verdict,
        effect: accepted.first().map(|accepted| accepted.id),
        effects: accepted.iter().map(|accepted| accepted.id).collect(),
        sufficient: match verdict {
            // Without a floor, or in a run that would show nothing, nobody knows whether something is missing.
            DiagnosisVerdict::None => evidence.noise.source != FloorSource::None && excited,
            _ => named && (eta >= decide::SUFFICIENT || settled),
        },
        noise_floor_from: evidence.noise.source,
        holdout_from: evidence.holdout_from,
        explained_percent: if named { 100.0 * eta } else { 0.0 },
        holdout_before: base.nrms,
        holdout_after: best.score.nrms,
        candidates,
        confusable: accepted.iter().flat_map(pairs).collect(),
        axis_map,
        ladder: if named {
            found.ladder
        } else {
            found.ladder.into_iter().take(1).collect()
        },
        confirm: None,
        sentence: String::new(),
        limits: evidence.unjudged(),
        equivalences: Vec::new(),
        next_experiment: None,
        baseline: Fitted::from(&found.baseline.fit),
        model: Fitted::from(&best.fit),
        rivals,
    };
    diagnosis.confirm = confirmation::of_models(
        evidence,
        [&diagnosis.baseline.model, &diagnosis.model.model],
        verdict,
        &diagnosis.effects,
        found.settings,
    );
    diagnosis.sentence = sentence(&diagnosis);
    let named = diagnosis.effects.iter();
    diagnosis.equivalences = named.flat_map(|id| equivalences(id)).copied().collect();
    diagnosis
}

fn pairs(accepted: &Accepted) -> Vec<[&'static str; 2]> {
    accepted
        .rivals
        .iter()
        .map(|rival| [accepted.id, rival])
        .collect()
}

/// Share of an error at the floor that may be left where it is to be given a name all the same.
const NO_HAIR: f64 = 0.95;
/// Share of the error that must be explained for a form to be believed although its own axis still shows the error.
const BELIEVED: f64 = 0.6;
/// Share of the remaining error that follows an axis and says so.
const FOLLOWS: f64 = 0.4;

/// Whether what remains of a large error still runs along the very axis of an effect that is to be named: something is
/// there, of another form than any known, and the effect only leans on it.
fn wrong_curve(evidence: &Evidence, found: &Found) -> bool {
    let (base, best) = (&found.baseline.score, &found.best);
    if explained(base.nrms, best.score.nrms, evidence.floor()) >= BELIEVED
        || decide::at_the_floor(evidence, &best.score)
    {
        return false;
    }
    let Ok(maps) = axis_map(&best.fit.model, &evidence.training, &evidence.noise) else {
        return false;
    };
    let curves: Vec<(&str, &str)> = found
        .accepted
        .iter()
        .filter_map(|accepted| curve_of(accepted.id))
        .collect();
    maps.iter()
        .any(|map| map.r2 >= FOLLOWS && curves.contains(&(map.equation, map.axis)))
}

fn verdict(evidence: &Evidence, found: &Found) -> DiagnosisVerdict {
    let base = &found.baseline.score;
    let nothing_to_explain =
        evidence.noise.source == FloorSource::None || decide::at_the_floor(evidence, base);
    let best = &found.best.score;
    let alone = found.best_alone.as_ref();
    let explains = alone.is_some_and(|alone| decide::explains(evidence, base, alone, best));
    // A hair above the floor is explained by whatever resembles it.
    let hair = nothing_to_explain
        && evidence.noise.source != FloorSource::None
        && best.nrms > NO_HAIR * base.nrms;
    let open = found
        .accepted
        .iter()
        .any(|accepted| !accepted.rivals.is_empty());
    // Several that explain the same part of an error, and no more than a part, all lean on something else.
    let leans = open
        && explained(base.nrms, best.nrms, evidence.floor()) < BELIEVED
        && !decide::at_the_floor(evidence, best);
    if explains && !hair && !leans {
        if open {
            DiagnosisVerdict::Ambiguous
        } else {
            DiagnosisVerdict::Effect
        }
    } else if nothing_to_explain {
        DiagnosisVerdict::None
    } else {
        DiagnosisVerdict::Unexplained
    }
}
