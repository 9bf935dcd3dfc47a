//! What is reported of each candidate.

use super::score::{Score, first_rank_shares, z};
use super::search::{Found, explained};
use super::sides::{Scale, Sides};
use super::trial::{Judged, Of, Trial};
use crate::diagnosis::candidates::{Candidate, Status};

/// Every candidate as it stood when nothing had been added yet, those of the answer first; of several in the answer each
/// with its size beside the others.
pub(super) fn describe(
    base: &Score,
    error_before: f64,
    scale: &Scale,
    sides: &Sides,
    found: &Found,
) -> Vec<Candidate> {
    let mut order: Vec<usize> = (0..found.first_round.len()).collect();
    let place = |index: usize| {
        let id = found.first_round[index].of.id();
        let accepted = found.accepted.iter().position(|other| *other == id);
        accepted.unwrap_or_else(|| {
            let in_set = found.first_set.iter().position(|member| *member == index);
            in_set.map_or(usize::MAX, |place| found.accepted.len() + place)
        })
    };
    order.sort_by(|&a, &b| {
        let error = |index: usize| found.first_round[index].held_out_rmse();
        place(a).cmp(&place(b)).then(error(a).total_cmp(&error(b)))
    });
    let ordered: Vec<&Trial<'_>> = order
        .iter()
        .map(|index| &found.first_round[*index])
        .collect();
    let accepted = |trial: &Trial<'_>| found.accepted.contains(&trial.of.id());
    let mut candidates = of_trials(&ordered, &accepted, base, error_before, scale, sides);
    if found.accepted.len() > 1 {
        let named = |candidate: &&mut Candidate| found.accepted.contains(&candidate.effect);
        for candidate in candidates.iter_mut().filter(named) {
            let prefix = format!("{}.", candidate.effect);
            let own = found.fit.parameters.iter();
            let own = own.filter(|parameter| parameter.key.starts_with(&prefix));
            candidate.parameters = own.cloned().collect();
            candidate
                .evidence
                .push_str(" alone; its size is from the fit of the whole answer");
        }
    }
    candidates
}

/// The same for any trials, in their order; `accepted` says which are supported.
pub(super) fn of_trials(
    trials: &[&Trial<'_>],
    accepted: &dyn Fn(&Trial<'_>) -> bool,
    base: &Score,
    error_before: f64,
    scale: &Scale,
    sides: &Sides,
) -> Vec<Candidate> {
    let scores: Vec<&Score> = trials
        .iter()
        .filter_map(|trial| trial.found.as_ref().ok().map(|judged| &judged.holdout))
        .collect();
    let mut shares = first_rank_shares(&scores).into_iter();
    let one = |(rank, trial): (usize, &&Trial<'_>)| {
        let probability = if trial.found.is_ok() {
            shares.next().unwrap_or(0.0)
        } else {
            0.0
        };
        let status = status(trial, accepted(trial), base, sides);
        let judged = trial.found.as_ref().ok();
        let share = judged.map_or(0.0, |judged| {
            explained(base, &judged.holdout, scale.floor() * scale.unit_n_m)
        });
        Candidate {
            effect: trial.of.id(),
            rank: rank + 1,
            status,
            probability,
            parameters: trial.parameters(),
            interval_factor: 1.0,
            reached: None,
            error_before,
            error_after: judged.map(|judged| judged.fit.rms() / scale.unit_n_m),
            holdout_before: base.rmse / scale.unit_n_m,
            holdout_after: judged.map(|judged| judged.holdout.rmse / scale.unit_n_m),
            explained_percent: judged.map(|_| 100.0 * share),
            upper_bound: None,
            detectable: judged
                .map(|judged| judged.minimum_detectable)
                .filter(|size| size.is_finite()),
            evidence: evidence(trial, status, base, share, sides),
        }
    };
    trials.iter().enumerate().map(one).collect()
}

fn status(trial: &Trial<'_>, accepted: bool, base: &Score, sides: &Sides) -> Status {
    let Ok(judged) = &trial.found else {
        return Status::NotExcited;
    };
    if accepted {
        Status::Supported
    } else if trial.pays(base, sides) {
        Status::Possible
    } else if judged.minimum_detectable > judged.typical_size {
        Status::NotExcited
    } else {
        Status::RuledOut
    }
}

fn evidence(trial: &Trial<'_>, status: Status, base: &Score, share: f64, sides: &Sides) -> String {
    let name = trial.of.name();
    let judged = match &trial.found {
        Ok(judged) => judged,
        Err(reason) => return format!("{name} cannot be judged from this run: {reason}"),
    };
    let (before, after) = (base.relative_percent, judged.holdout.relative_percent);
    let z = z(base, &judged.holdout, sides.settings.block);
    let change = format!("held-out torque error {before:.2} -> {after:.2} % (z {z:.1})");
    match status {
        Status::Supported | Status::Possible => format!(
            "{name}: {change}, explains {:.0} % of what can be explained",
            100.0 * share
        ),
        Status::NotExcited if !judged.minimum_detectable.is_finite() => format!(
            "{name} cannot be told from the rest of the model in this run: {}",
            excite(trial.of)
        ),
        Status::NotExcited => format!(
            "{name} {} would not show in this run: {}",
            size(trial.of, judged),
            excite(trial.of)
        ),
        Status::RuledOut => judged.refused.as_ref().map_or_else(
            || {
                format!(
                    "{name} does not pay: {change}, {} asked; {} would have shown",
                    sides.settings.significant,
                    size(trial.of, judged)
                )
            },
            |reason| format!("{name}: {reason} ({change})"),
        ),
    }
}

fn size(of: Of<'_>, judged: &Judged) -> String {
    match of {
        Of::Effect(effect) => format!(
            "of {:.2e} {}",
            judged.minimum_detectable,
            effect.parameters()[0].unit
        ),
        Of::Extra(_) => format!("of {:.2e}", judged.minimum_detectable),
    }
}

fn excite(of: Of<'_>) -> &'static str {
    match of {
        Of::Effect(effect) => effect.card().excite,
        Of::Extra(_) => "it is not in the catalogue",
    }
}

impl Trial<'_> {
    pub(super) fn held_out_rmse(&self) -> f64 {
        let judged = self.found.as_ref();
        judged.map_or(f64::INFINITY, |judged| judged.holdout.rmse)
    }
}
