//! Which effect the torque balance misses.

use std::fmt::Write as _;

use super::Settings;
use super::candidate::{describe, of_trials};
use super::regression::BalanceFit;
use super::score::{Score, z};
use super::search::{EXPLAINS_SOMETHING, Found, SUFFICIENT, explained, search};
use super::sides::{Scale, Sides};
use super::terms::Extra;
use super::trial::{self, Trial};
use crate::diagnosis::candidates::{Candidate, Status};
use crate::diagnosis::confirmation::{Repeated, confirmation};
use crate::diagnosis::diagnose::{Diagnosis, DiagnosisVerdict};
use crate::diagnosis::equivalences;
use crate::diagnosis::evidence::Evidence;
use crate::diagnosis::fitted::Fitted;
use crate::diagnosis::ladder::Rung;
use crate::identification::noise::FloorSource;
use crate::identification::output_error::FitError;
use crate::plant::Model;

/// Error in units of the floor below which a model explains the run to the noise.
const AT_THE_FLOOR: f64 = 1.1;

/// Refits `model` as the baseline of the torque balance and searches for what it misses, as
/// [`crate::diagnosis::diagnose`] does for runs with a voltage.
pub fn diagnose(
    model: &Model,
    evidence: &Evidence,
    until_floor: bool,
) -> Result<Diagnosis, FitError> {
    diagnose_with(model, evidence, until_floor, Settings::default())
}

/// The same with other settings.
pub(super) fn diagnose_with(
    model: &Model,
    evidence: &Evidence,
    until_floor: bool,
    settings: Settings,
) -> Result<Diagnosis, FitError> {
    let start = Start::new(model, evidence, settings)?;
    let Start {
        sides,
        baseline,
        scale,
    } = &start;
    let floor_n_m = scale.floor() * scale.unit_n_m;
    let base = sides.held_out(baseline, None);
    let mut found = search(baseline, sides, &evidence.training, floor_n_m, until_floor);
    let eta = explained(&base, &found.score, floor_n_m);
    let verdict = verdict(&base, scale, &found, eta);
    let nothing = matches!(
        verdict,
        DiagnosisVerdict::None | DiagnosisVerdict::Unexplained
    );
    if nothing {
        found.accepted.clear();
        found.rungs.truncate(1);
        (found.fit, found.score) = (baseline.clone(), base.clone());
    }
    let unit = scale.unit_n_m;
    let candidates = describe(&base, baseline.rms() / unit, scale, sides, &found);
    let excited = candidates
        .iter()
        .any(|candidate| candidate.status != Status::NotExcited);
    let effect = found.accepted.first().copied();
    let ids = |index: &usize| found.first_round[*index].of.id();
    let confusable = match found.first_set.split_first() {
        Some((first, rivals)) if !nothing => rivals
            .iter()
            .map(|rival| [ids(first), ids(rival)])
            .collect(),
        _ => Vec::new(),
    };
    let fitted = |fit: &BalanceFit| start.fitted(fit, evidence);
    let mut diagnosis = Diagnosis {
        verdict,
        effect,
        effects: found.accepted.clone(),
        sufficient: match verdict {
            DiagnosisVerdict::None => scale.source != FloorSource::None && excited,
            _ => effect.is_some() && eta >= SUFFICIENT,
        },
        noise_floor_from: scale.source,
        holdout_from: evidence.holdout_from,
        explained_percent: if effect.is_some() { 100.0 * eta } else { 0.0 },
        holdout_before: base.rmse / unit,
        holdout_after: found.score.rmse / unit,
        candidates,
        confusable,
        ladder: found
            .rungs
            .iter()
            .map(|(effects, rmse)| Rung {
                effects: effects.clone(),
                holdout_rmse: rmse / unit,
            })
            .collect(),
        confirm: None,
        sentence: String::new(),
        limits: Vec::new(),
        equivalences: found
            .accepted
            .iter()
            .flat_map(|id| equivalences(id))
            .copied()
            .collect(),
        next_experiment: None,
        unknown: Vec::new(),
        axis_map: Vec::new(),
        baseline: fitted(baseline),
        model: fitted(&found.fit),
        rivals: Vec::new(),
        sensor_floor: None,
        repeat_floor: None,
        repeats: None,
    };
    diagnosis.confirm = sides.confirm.as_ref().map(|rows| {
        let on = |fit: &BalanceFit| Sides::score(fit, None, rows);
        let (before, after) = (on(baseline), on(&found.fit));
        let share = explained(&before, &after, floor_n_m);
        let repeated = Repeated {
            before: before.rmse / unit,
            after: after.rmse / unit,
            z: z(&before, &after, settings.block),
            share,
            holds: trial::pays(&before, &after, sides) && share >= EXPLAINS_SOMETHING,
            at_the_floor: scale.source != FloorSource::None && before.rmse < AT_THE_FLOOR * unit,
        };
        confirmation(verdict, scale.source, &diagnosis.effects, &repeated)
    });
    diagnosis.sentence = sentence(&diagnosis, &base, &found, sides);
    Ok(diagnosis)
}

/// How terms that are not in the catalogue stand beside the refitted model: as candidates of a first round, each alone.
/// One that pays is `supported`.
pub fn judge_extras(
    model: &Model,
    evidence: &Evidence,
    extras: &[Extra],
    settings: Settings,
) -> Result<Vec<Candidate>, FitError> {
    let start = Start::new(model, evidence, settings)?;
    let (sides, scale) = (&start.sides, &start.scale);
    let base = sides.held_out(&start.baseline, None);
    let trials: Vec<Trial<'_>> = extras
        .iter()
        .map(|extra| trial::of_extra(extra, &start.baseline, sides, &evidence.training))
        .collect();
    let paying = |trial: &Trial<'_>| trial.pays(&base, sides);
    let trials: Vec<&Trial<'_>> = trials.iter().collect();
    let before = start.baseline.rms() / scale.unit_n_m;
    Ok(of_trials(&trials, &paying, &base, before, scale, sides))
}

/// The rows with the refitted baseline.
pub(super) struct Start {
    pub(super) sides: Sides,
    pub(super) baseline: BalanceFit,
    pub(super) scale: Scale,
}

impl Start {
    pub(super) fn new(
        model: &Model,
        evidence: &Evidence,
        settings: Settings,
    ) -> Result<Self, FitError> {
        let sides = Sides::weak_form(model, evidence, settings)?;
        let baseline = sides.fit(model).ok_or_else(|| FitError::CannotSimulate {
            run: evidence.training.name.clone(),
        })?;
        let scale = Scale::of(model, &evidence.training, &sides.training, &baseline);
        Ok(Self {
            sides,
            baseline,
            scale,
        })
    }

    pub(super) fn fitted(&self, fit: &BalanceFit, evidence: &Evidence) -> Fitted {
        Fitted {
            model: fit.model.clone(),
            parameters: fit.parameters.clone(),
            nrms: fit.rms() / self.scale.unit_n_m,
            noise: self.scale.of_noise(&evidence.noise),
        }
    }
}

fn verdict(base: &Score, scale: &Scale, found: &Found, eta: f64) -> DiagnosisVerdict {
    let floor_known = scale.source != FloorSource::None;
    let above = base.rmse >= AT_THE_FLOOR * scale.unit_n_m;
    if found.accepted.is_empty() {
        return if floor_known && above {
            DiagnosisVerdict::Unexplained
        } else {
            DiagnosisVerdict::None
        };
    }
    let first = found.accepted.first();
    let tied = found.first_set.len() > 1
        && found.accepted.len() == 1
        && found
            .first_set
            .first()
            .map(|index| found.first_round[*index].of.id())
            == first.copied();
    if eta < EXPLAINS_SOMETHING {
        DiagnosisVerdict::Unexplained
    } else if tied {
        DiagnosisVerdict::Ambiguous
    } else {
        DiagnosisVerdict::Effect
    }
}

fn sentence(diagnosis: &Diagnosis, base: &Score, found: &Found, sides: &Sides) -> String {
    let names = diagnosis.effects.join(" and ");
    let (before, after) = (base.relative_percent, found.score.relative_percent);
    let mut text = match diagnosis.verdict {
        DiagnosisVerdict::None if diagnosis.noise_floor_from == FloorSource::None => format!(
            "nothing in the catalogue passes on the hold-out (torque error {before:.2} %); without a noise floor it \
             cannot be said whether anything is missing"
        ),
        DiagnosisVerdict::None if !diagnosis.sufficient => {
            "this run would not show any effect of the catalogue: nothing can be said".to_owned()
        }
        DiagnosisVerdict::None => format!(
            "nothing is missing: held-out torque error {:.2} times the noise floor",
            diagnosis.holdout_before
        ),
        DiagnosisVerdict::Unexplained => format!(
            "the torque balance misses {before:.2} % on the hold-out, and no effect of the catalogue explains it"
        ),
        DiagnosisVerdict::Ambiguous => format!(
            "behaves like {names}, which this run cannot tell from {}; held-out torque error {before:.2} -> {after:.2} %",
            diagnosis
                .confusable
                .iter()
                .map(|pair| pair[1])
                .collect::<Vec<_>>()
                .join(", ")
        ),
        DiagnosisVerdict::Effect => format!(
            "missing: {names}; held-out torque error {before:.2} -> {after:.2} %, {:.0} % explained",
            diagnosis.explained_percent
        ),
    };
    for id in &found.superfluous {
        text.push_str(&superfluous_sentence(id));
    }
    let _ = write!(text, " ({})", sides.training.sentence);
    text
}

/// Said of an effect of the given model that is not needed any more.
pub(super) fn superfluous_sentence(id: &str) -> String {
    format!(
        "; {id} is superfluous now: without it the held-out error does not rise by more than 1 % or chance"
    )
}
