//! Findings in words and figures for a person.

use super::candidates::{Candidate, Refit, Status};
use super::decide::{self, Settings, explained, first_rank_shares, pays, z};
use super::diagnose::{Diagnosis, DiagnosisVerdict};
use super::evidence::Evidence;
use super::reached;
use super::score::Score;
use super::screen::{DETECTION_SIGMA, Detectable};
use super::search::Found;
use crate::identification::noise::FloorSource;
use crate::identification::output_error::Fit;
use crate::plant::Effect;

/// Every candidate, those of the answer first: these with their sizes beside each other, from the fit of the whole answer;
/// their errors and the others as they stood alone, when nothing had been added yet. `named`: whether there is an answer.
pub(super) fn describe(
    base: &Score,
    error_before: f64,
    evidence: &Evidence,
    found: &Found,
    named: bool,
) -> Vec<Candidate> {
    let (refits, set) = (&found.first_round, &found.first_set);
    let floor = evidence.floor();
    let shares = first_rank_shares(refits);
    let answer = |index: usize| {
        let id = refits[index].id();
        let place = found.accepted.iter().position(|other| other.id == id);
        place.filter(|_| named)
    };
    let fits: Vec<Option<&Fit>> = (0..refits.len())
        .map(|index| match answer(index) {
            Some(_) => Some(&found.best.fit),
            None => refits[index].refitted.then_some(&refits[index].fit),
        })
        .collect();
    let reached = reached::of_fits(refits, &fits, &evidence.training);
    let pays_on_holdout: Vec<bool> = refits
        .iter()
        .map(|r| pays(base, &r.holdout, found.settings))
        .collect();
    // A linear step that pays has earned its figures: a fit would only be better.
    let computed = |index: usize| refits[index].refitted || pays_on_holdout[index];
    let mut order: Vec<usize> = (0..refits.len()).collect();
    order.sort_by(|&a, &b| {
        let place = |index: usize| {
            let in_set = set.iter().position(|member| *member == index);
            let in_set = in_set.map(|place| found.accepted.len() + place);
            let place = answer(index).or(in_set);
            place.unwrap_or(usize::MAX - usize::from(computed(index)))
        };
        let error = |index: usize| {
            if computed(index) {
                refits[index].holdout.nrms
            } else {
                -refits[index].screened_share
            }
        };
        place(a).cmp(&place(b)).then(error(a).total_cmp(&error(b)))
    });
    order
        .into_iter()
        .enumerate()
        .map(|(rank, index)| {
            let refit = &refits[index];
            let (pays, computed) = (pays_on_holdout[index], computed(index));
            let against_base = z(base, &refit.holdout, found.settings);
            let in_answer = found
                .accepted
                .iter()
                .any(|accepted| accepted.id == refit.id());
            let status = if in_answer {
                Status::Supported
            } else if pays {
                Status::Possible
            } else if refit.visible < DETECTION_SIGMA || shows_too_little(evidence, base, refit) {
                Status::NotExcited
            } else {
                Status::RuledOut
            };
            let share = explained(base.nrms, refit.holdout.nrms, floor);
            Candidate {
                effect: refit.id(),
                rank: rank + 1,
                status,
                probability: shares[index],
                refitted: fits[index].is_some(),
                parameters: answer(index)
                    .map_or_else(|| refit.parameters(), |_| refit.own(&found.best.fit)),
                interval_factor: fits[index].unwrap_or(&refit.fit).interval_factor,
                reached: reached[index],
                error_before,
                error_after: computed.then_some(refit.fit.nrms),
                holdout_before: base.nrms,
                holdout_after: computed.then_some(refit.holdout.nrms),
                explained_percent: computed.then_some(100.0 * share),
                minimum_detectable: refit.detectable.smallest(),
                detectable_below_hz: refit.detectable.softer_than_hz(),
                evidence: evidence_sentence(
                    refit,
                    base,
                    against_base,
                    share,
                    status,
                    found.settings,
                    evidence.noise.source.times(),
                ) + &answer(index)
                    .map_or_else(String::new, |place| beside_others(found, place)),
            }
        })
        .collect()
}

/// Whether the error is at the floor without it and yet falls with it, though not beyond chance: the few moments in which
/// the run would show the effect decide nothing, neither for it nor against it.
fn shows_too_little(evidence: &Evidence, base: &Score, refit: &Refit) -> bool {
    let (before, after) = (base.nrms, refit.holdout.nrms);
    refit.refitted
        && decide::at_the_floor(evidence, base)
        && decide::falls(base, &refit.holdout)
        && explained(before, after, evidence.floor()) >= decide::EXPLAINS_SOMETHING
}

/// Said of one of several: its error is its own, its size is not.
fn beside_others(found: &Found, place: usize) -> String {
    let named = found.accepted.iter().enumerate();
    let others: Vec<&str> = named
        .filter(|(other, _)| *other != place)
        .map(|(_, accepted)| accepted.id)
        .collect();
    if others.is_empty() {
        String::new()
    } else {
        format!(
            " alone; its size is that beside {}, from the fit of the whole answer",
            others.join(" and ")
        )
    }
}

fn evidence_sentence(
    refit: &Refit,
    base: &Score,
    z: f64,
    share: f64,
    status: Status,
    settings: Settings,
    times: &str,
) -> String {
    let asked = settings.significant;
    let card = refit.effect.card();
    let (before, after) = (base.nrms, refit.holdout.nrms);
    let unit = unit_of_size(refit.effect);
    let (hidden, shown) = match refit.detectable {
        Detectable::From(size) => (
            format!("of less than {size:.2e} {unit}"),
            format!("more than {size:.2e} {unit}"),
        ),
        Detectable::SofterThan(frequency_hz) => (
            format!("stiffer than {frequency_hz:.1} Hz"),
            format!("one softer than {frequency_hz:.1} Hz"),
        ),
    };
    match status {
        Status::NotExcited if refit.detectable.is_never() => format!(
            "{} touches nothing that this run measures: {}",
            card.name, card.excite
        ),
        Status::NotExcited if refit.visible >= DETECTION_SIGMA => format!(
            "{} would take the held-out error from {before:.2} to {after:.2} {times}, not beyond chance (z {z:.1}, \
             {asked} is asked): this run shows too little of it; {}",
            card.name, card.excite
        ),
        Status::NotExcited => format!(
            "{} {hidden} would not show in this run: {}",
            card.name, card.excite
        ),
        Status::RuledOut if !refit.refitted => format!(
            "{} explains {:.1} % of the error to first order and is not worth a refit; {shown} would have shown",
            card.name,
            100.0 * refit.screened_share.max(0.0),
        ),
        Status::RuledOut => format!(
            "{} leaves the held-out error at {after:.2} of {before:.2} {times} (z {z:.1}, {asked} is \
             asked); {shown} would have shown",
            card.name
        ),
        Status::Supported | Status::Possible => format!(
            "{} takes the held-out error from {before:.2} to {after:.2} {times} (z {z:.1}) and explains \
             {:.0} % of what can be explained",
            card.name,
            100.0 * share
        ),
    }
}

pub(super) fn sentence(diagnosis: &Diagnosis) -> String {
    let names = diagnosis.effects.join(" and ");
    let (before, after) = (diagnosis.holdout_before, diagnosis.holdout_after);
    let times = diagnosis.noise_floor_from.times();
    match diagnosis.verdict {
        DiagnosisVerdict::None if diagnosis.noise_floor_from == FloorSource::None => {
            "nothing in the catalogue pays on the hold-out; without a noise floor it cannot be said whether anything \
             is missing"
                .to_owned()
        }
        DiagnosisVerdict::None if !diagnosis.sufficient => {
            "this run would not show any effect of the catalogue: nothing can be said".to_owned()
        }
        DiagnosisVerdict::None => format!("nothing is missing: held-out error {before:.2} {times}"),
        DiagnosisVerdict::Unexplained => {
            format!("held-out error {before:.2} {times}, and no effect of the catalogue explains it")
        }
        DiagnosisVerdict::Ambiguous => format!(
            "behaves like {names}, which this run cannot tell from {}",
            diagnosis.confusable.iter().map(|pair| pair[1]).collect::<Vec<_>>().join(", ")
        ),
        DiagnosisVerdict::Effect => format!(
            "missing: {names}; held-out error {before:.2} -> {after:.2} {times}, {:.0} % explained",
            diagnosis.explained_percent
        ),
    }
}

/// Unit of the parameter that gives the effect its size, in words that can stand behind a number.
fn unit_of_size(effect: &dyn Effect) -> &'static str {
    let specs = effect.parameters();
    let size = specs.iter().find(|spec| spec.is_coefficient());
    match size.unwrap_or(&specs[0]).unit {
        "-" => "(a ratio)",
        unit => unit,
    }
}
