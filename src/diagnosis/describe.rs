//! Findings in words and figures for a person.

use super::candidates::{Candidate, Onset, RunOf, Status};
use super::diagnose::{Diagnosis, DiagnosisVerdict, Standing};
use super::evidence::{Evidence, HoldoutFrom};
use super::explained::Floor;
use super::joint::answer::{Inference, Inferred};
use super::reached;
use crate::identification::noise::FloorSource;
use crate::plant::{Effect, effect};
use crate::sample::{ParameterEstimate, TWO_SIDED_95, Verdict};
use crate::text::number::{probability, significant};

/// Every candidate, those of the answer first, in the order in which they join the model: each with the fall of the
/// held-out error on its own rung of the ladder and its size beside the others.
pub(super) fn describe(
    evidence: &Evidence,
    floor: Floor<'_>,
    inference: &Inference,
    rungs: &[Standing],
) -> Vec<Candidate> {
    let (base, best) = (&rungs[0], &rungs[rungs.len() - 1]);
    let floor = floor.expected();
    let place = |effect: &Inferred| {
        let id = effect.effect.card().id;
        inference.named.iter().position(|named| *named == id)
    };
    let missing = |effect: &&Inferred| !effect.given;
    let mut order: Vec<&Inferred> = inference.effects.iter().filter(missing).collect();
    order.sort_by(|a, b| {
        let named = |effect: &Inferred| place(effect).unwrap_or(usize::MAX);
        named(a)
            .cmp(&named(b))
            .then(b.probability.total_cmp(&a.probability))
            .then(b.log_odds.total_cmp(&a.log_odds))
    });
    order
        .into_iter()
        .enumerate()
        .map(|(rank, inferred)| {
            let id = inferred.effect.card().id;
            let status = Status::of(inferred.probability, inferred.excited);
            let rung = place(inferred).map(|place| (&rungs[place], &rungs[place + 1]));
            let prefix = format!("{id}.");
            let parameters = match rung {
                Some(_) => best
                    .fit
                    .parameters
                    .iter()
                    .filter(|p| p.key.starts_with(&prefix))
                    .cloned()
                    .collect(),
                None => Vec::new(),
            };
            let onsets = match rung {
                Some(_) => inference.onsets(id),
                None => Vec::new(),
            };
            // Of what did not happen in the fit run its fit knows nothing.
            let elsewhere = onsets.first().filter(|onset| onset.run == RunOf::Holdout);
            let parameters = match elsewhere {
                Some(onset) => of_holdout(inferred.effect, onset),
                None => parameters,
            };
            let share = rung.map(|(before, after)| {
                let whole = base.score.nrms.powi(2) - floor * floor;
                let fall = before.score.nrms.powi(2) - after.score.nrms.powi(2);
                if whole > 0.0 {
                    100.0 * fall / whole
                } else {
                    0.0
                }
            });
            Candidate {
                effect: id,
                rank: rank + 1,
                status,
                probability: inferred.probability,
                parameters,
                onsets,
                interval_factor: best.fit.interval_factor,
                reached: rung
                    .and_then(|_| reached::of_fit(&best.fit, inferred.effect, &evidence.training)),
                error_before: rung.map_or(base, |rung| rung.0).fit.nrms,
                error_after: rung.map(|(_, after)| after.fit.nrms),
                holdout_before: rung.map_or(base, |rung| rung.0).score.nrms,
                holdout_after: rung.map(|(_, after)| after.score.nrms),
                explained_percent: share,
                // The size of what is named has an interval, and one bound is enough.
                upper_bound: inferred.upper_bound.filter(|_| rung.is_none()),
                detectable: inferred.detectable,
                evidence: evidence_sentence(
                    inferred,
                    status,
                    rung,
                    evidence.noise.source.times(),
                    happening(
                        inferred.effect,
                        &inference.onsets(id),
                        evidence.holdout_from,
                    ),
                ),
            }
        })
        .collect()
}

/// Parameters of what happened in the hold-out only.
fn of_holdout(effect: &dyn Effect, onset: &Onset) -> Vec<ParameterEstimate> {
    let id = effect.card().id;
    let [low, high] = onset.interval_95_s;
    let specs = effect.parameters().iter();
    specs
        .map(|spec| {
            let (value, std) = if spec.is_coefficient() {
                (onset.size, onset.size_std)
            } else {
                (onset.time_s, (high - low) / (2.0 * TWO_SIDED_95))
            };
            ParameterEstimate {
                key: format!("{id}.{}", spec.key),
                value: Some(value),
                std: Some(std),
                unit: spec.unit,
                verdict: Verdict::Settled,
                reason: Some("it happened in the hold-out only".to_owned()),
            }
        })
        .collect()
}

/// What an event changes, in words that can stand before a signed size.
const CHANGES: &[(&str, &str)] = &[
    ("inertia_change", "inertia"),
    ("load_step", "friction"),
    ("one_sided_load", "load"),
    ("friction_onset", "drag"),
];

/// When something that happens once did so, and what it changed.
pub(super) fn happening(
    effect: &dyn Effect,
    onsets: &[Onset],
    from: HoldoutFrom,
) -> Option<String> {
    let id = effect.card().id;
    let change = CHANGES.iter().find(|(known, _)| *known == id);
    let change = change.map_or(effect.card().name, |(_, change)| change);
    let size = |onset: &Onset| match unit_of_size(effect) {
        "(a ratio)" => format!("{change} {:+.0} %", 100.0 * onset.size),
        unit if onset.size.abs() < 0.01 => format!("{change} {:+.2e} {unit}", onset.size),
        unit => format!("{change} {:+.3} {unit}", onset.size),
    };
    let when = |onset: &Onset| format!("from {:.2} s on, {}", onset.time_s, size(onset));
    match onsets {
        [] => None,
        [one] if from == HoldoutFrom::Split => Some(when(one)),
        [one] if one.run == RunOf::Holdout => Some(format!("in the hold-out only, {}", when(one))),
        [one] => Some(format!("in the fit run only, {}", when(one))),
        [one, other, ..] => Some(format!("{}; in the hold-out {}", when(one), when(other))),
    }
}

fn evidence_sentence(
    inferred: &Inferred,
    status: Status,
    rung: Option<(&Standing, &Standing)>,
    times: &str,
    happening: Option<String>,
) -> String {
    let card = inferred.effect.card();
    let unit = unit_of_size(inferred.effect);
    let percent = probability(inferred.probability);
    let size = |size: f64| format!("{} {unit}", significant(size, 2));
    let most = inferred
        .upper_bound
        .map_or_else(String::new, |bound| format!("; at most {}", size(bound)));
    let shown = inferred.detectable.map_or_else(String::new, |least| {
        format!("; {} would have shown", size(least))
    });
    if let Some(reason) = inferred.why_not {
        return format!("{} cannot be judged from this run: {reason}", card.name);
    }
    match (status, rung) {
        (Status::NotExcited, _) => format!(
            "{}: these runs would not show it; {}",
            card.name, card.excite
        ),
        (_, Some((before, after))) => format!(
            "{} is there with {percent}{}; with it the held-out error goes from {:.2} to {:.2} {times}",
            card.name,
            happening.map_or_else(String::new, |when| format!(" ({when})")),
            before.score.nrms,
            after.score.nrms
        ),
        (Status::RuledOut, None) => format!("{} is there with {percent}{most}{shown}", card.name),
        (_, None) => format!("{} may be there, with {percent}{most}", card.name),
    }
}

pub(super) fn sentence(diagnosis: &Diagnosis) -> String {
    let with_onset = |candidate: &Candidate| {
        let known = effect::find(candidate.effect);
        let when =
            known.and_then(|known| happening(known, &candidate.onsets, diagnosis.holdout_from));
        when.map(|when| format!("{} ({when})", candidate.effect))
    };
    let named = |id: &&'static str| {
        let mut candidates = diagnosis.candidates.iter();
        let candidate = candidates.find(|candidate| candidate.effect == *id);
        candidate
            .and_then(with_onset)
            .unwrap_or_else(|| (*id).to_owned())
    };
    let names: Vec<String> = diagnosis.effects.iter().map(named).collect();
    let names = names.join(" and ");
    let (before, after) = (diagnosis.holdout_before, diagnosis.holdout_after);
    let times = diagnosis.noise_floor_from.times();
    match diagnosis.verdict {
        DiagnosisVerdict::None if diagnosis.noise_floor_from == FloorSource::None => {
            "nothing in the catalogue pays on the hold-out; without a noise floor it cannot be said whether anything \
             is missing"
                .to_owned()
        }
        DiagnosisVerdict::None if diagnosis.is_refuted() => {
            let there = diagnosis.confirm.as_ref().and_then(|confirm| confirm.error_before);
            format!(
                "the held-out error is {before:.2} {times}, but on the confirming run it is {:.2}: something is missing that \
                 only that run shows",
                there.unwrap_or(f64::NAN)
            )
        }
        DiagnosisVerdict::None if !diagnosis.sufficient => {
            "this run would not show any effect of the catalogue: nothing can be said".to_owned()
        }
        DiagnosisVerdict::None => format!(
            "nothing is missing: held-out error {before:.2} {times}{}",
            unseen(diagnosis)
        ),
        DiagnosisVerdict::Unexplained => {
            let known = if names.is_empty() {
                "no effect of the catalogue explains it".to_owned()
            } else {
                format!(
                    "{names} may be part of it, but most stays unexplained ({:.0} % explained)",
                    diagnosis.explained_percent
                )
            };
            let parts = diagnosis.unknown.iter().fold(String::new(), |parts, part| parts + "; " + &part.sentence);
            format!("held-out error {before:.2} {times}, and {known}{parts}{}", not_repeating(diagnosis))
        }
        DiagnosisVerdict::Ambiguous => format!(
            "behaves like {names}, which this run cannot tell from {}{}",
            rivals(&diagnosis.confusable).join(", "),
            unconfirmed(diagnosis)
        ),
        DiagnosisVerdict::Effect => format!(
            "missing: {names}; held-out error {before:.2} -> {after:.2} {times}, {:.0} % explained{}",
            diagnosis.explained_percent,
            unconfirmed(diagnosis)
        ),
    }
}

/// What the first of each pair cannot be told from, each once.
fn rivals(confusable: &[[&'static str; 2]]) -> Vec<&'static str> {
    let mut rivals: Vec<&'static str> = Vec::new();
    for [_, rival] in confusable {
        if !rivals.contains(rival) {
            rivals.push(rival);
        }
    }
    rivals
}

/// Said where the run that had no part in the answer speaks against it.
fn unconfirmed(diagnosis: &Diagnosis) -> &'static str {
    if diagnosis.is_refuted() {
        "; NOT confirmed on the run that had no part in the answer"
    } else {
        ""
    }
}

/// Effects that are named one by one where these runs would not show them.
const FEW: usize = 4;

/// Said beside "nothing is missing": of what it is not said.
fn unseen(diagnosis: &Diagnosis) -> String {
    let with = |status: Status| {
        let candidates = diagnosis.candidates.iter();
        candidates.filter(move |candidate| candidate.status == status)
    };
    let possible: Vec<String> = with(Status::Possible)
        .map(|candidate| {
            format!(
                "{} ({})",
                candidate.effect,
                probability(candidate.probability)
            )
        })
        .collect();
    let mut said = String::new();
    if !possible.is_empty() {
        said = format!("; possible: {}", possible.join(", "));
    }
    let unseen: Vec<&str> = with(Status::NotExcited).map(|c| c.effect).collect();
    let names = match unseen.len() {
        0 => return said,
        1..=FEW => unseen.join(", "),
        many => format!("{many} effects of the catalogue"),
    };
    said + "; these runs would not show " + &names
}

/// Said where the machine does not do the same twice: how much of the error that is, and what it follows.
fn not_repeating(diagnosis: &Diagnosis) -> String {
    let Some(floor) = diagnosis
        .repeat_floor
        .filter(|_| diagnosis.repeats == Some(false))
    else {
        return String::new();
    };
    let share = (floor * floor - 1.0) / (diagnosis.holdout_before.powi(2) - 1.0);
    let percent = 100.0 * share.clamp(0.0, 1.0);
    let follows = diagnosis.repeat_follows.first().map_or_else(
        || "what differs follows neither speed, current, angle nor time".to_owned(),
        |location| format!("of what differs, {}", location.sentence),
    );
    format!(
        "; this machine does not repeat: {percent:.0} % of the error is different each time (two runs of the same excitation \
         differ by {floor:.2} times the sensors' noise); {follows}"
    )
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

/// What the model had and does not need any more, as the end of a sentence.
pub(super) fn superfluous(inference: &Inference) -> String {
    let ids = inference.superfluous.iter();
    let words: Vec<String> = ids.map(|id| format!("; {id} is superfluous now")).collect();
    words.concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rival_of_two_names_is_listed_once() {
        let pairs = [
            ["quadratic_load", "load_step"],
            ["quadratic_load", "constant_load"],
            ["viscous_friction", "load_step"],
        ];
        assert_eq!(rivals(&pairs), ["load_step", "constant_load"]);
    }
}
