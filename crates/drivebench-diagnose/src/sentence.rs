//! An answer in one sentence for a person.

use super::candidates::{Candidate, Status, happening};
use super::diagnose::{Diagnosis, DiagnosisVerdict};
use drivebench_identify::noise::FloorSource;
use drivebench_model::plant::effect;
use drivebench_model::text::number::probability;

/// How the sentence begins where every effect is ruled out, and where some may hide.
pub(super) const NOTHING_IS_MISSING: &str = "nothing is missing";
pub(super) const NOTHING_THAT_SHOWS: &str = "nothing missing that these runs could show";
/// Effects that are named one by one where these runs would not show them.
const FEW: usize = 4;

/// The answer in one sentence for a person.
pub(super) fn sentence(diagnosis: &Diagnosis) -> String {
    let when = |id: &str| {
        let mut candidates = diagnosis.candidates.iter();
        let onsets = &candidates.find(|candidate| candidate.effect == id)?.onsets;
        happening(effect::find(id)?, onsets, diagnosis.holdout_from)
    };
    let named = |id: &&'static str| {
        let when = when(id).map(|when| format!("{id} ({when})"));
        when.unwrap_or_else(|| (*id).to_owned())
    };
    let names: Vec<String> = diagnosis.effects.iter().map(named).collect();
    let names = names.join(" and ");
    let (before, after) = (diagnosis.holdout_before, diagnosis.holdout_after);
    let times = diagnosis.noise_floor_from.times();
    let cut = "the search was ended by its budget of work before all effects were tried together";
    match diagnosis.verdict {
        DiagnosisVerdict::None if diagnosis.noise_floor_from == FloorSource::None => {
            let missing = "without a noise floor it cannot be said whether anything is missing";
            if diagnosis.search_was_cut {
                format!("nothing that was found pays on the hold-out; {cut}, and {missing}")
            } else {
                format!("nothing in the catalogue pays on the hold-out; {missing}")
            }
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
            "{}: held-out error {before:.2} {times}{}",
            if diagnosis.is_all_judged() { NOTHING_IS_MISSING } else { NOTHING_THAT_SHOWS },
            unseen(diagnosis)
        ),
        DiagnosisVerdict::Effect | DiagnosisVerdict::Ambiguous if diagnosis.has_no_error() => {
            format!(
                "no error left to explain: held-out error {before:.2} {times}; likely there all the same: {names} ({before:.2} -> \
             {after:.2}){}{}",
                not_told(&diagnosis.confusable),
                unconfirmed(diagnosis)
            )
        }
        DiagnosisVerdict::Unexplained => {
            let known = if names.is_empty() && diagnosis.search_was_cut {
                format!("nothing that was found explains it; {cut}")
            } else if names.is_empty() {
                "no effect of the catalogue explains it".to_owned()
            } else {
                format!(
                    "{names} may be part of it, but most stays unexplained ({:.0} % explained)",
                    diagnosis.explained_percent
                )
            };
            let parts = diagnosis
                .unknown
                .iter()
                .fold(String::new(), |parts, part| parts + "; " + &part.sentence);
            format!(
                "held-out error {before:.2} {times}, and {known}{parts}{}",
                not_repeating(diagnosis)
            )
        }
        DiagnosisVerdict::NotFitted => diagnosis.reason.clone().unwrap_or_default(),
        DiagnosisVerdict::Ambiguous => format!(
            "behaves like {names}{}{}",
            not_told(&diagnosis.confusable),
            unconfirmed(diagnosis)
        ),
        DiagnosisVerdict::Effect => format!(
            "missing: {names}; held-out error {before:.2} -> {after:.2} {times}, {:.0} % explained{}{}",
            diagnosis.explained_percent,
            not_told(&diagnosis.confusable),
            unconfirmed(diagnosis)
        ),
    }
}

/// Said where effects of an answer may as well be others: which, each with all that it may be instead.
pub(super) fn not_told(confusable: &[[&'static str; 2]]) -> String {
    let mut each: Vec<(&str, Vec<&str>)> = Vec::new();
    for [id, rival] in confusable {
        match each.iter_mut().find(|(known, _)| known == id) {
            Some((_, rivals)) => rivals.push(rival),
            None => each.push((id, vec![rival])),
        }
    }
    if each.is_empty() {
        return String::new();
    }
    let words = each.into_iter().map(|(id, rivals)| match rivals.as_slice() {
        [first, second, _, _, ..] => {
            let more = rivals.len() - 2;
            format!("{id} from {first}, {second} and {more} others")
        }
        few => format!("{id} from {}", few.join(", ")),
    });
    let words: Vec<String> = words.collect();
    format!("; this run cannot tell {}", words.join(" nor "))
}

/// Said where the run that had no part in the answer speaks against it.
fn unconfirmed(diagnosis: &Diagnosis) -> &'static str {
    if diagnosis.is_refuted() {
        "; NOT confirmed on the run that had no part in the answer"
    } else {
        ""
    }
}

/// Said beside "nothing is missing": of what it is not said.
fn unseen(diagnosis: &Diagnosis) -> String {
    let with = |status: Status| {
        let candidates = diagnosis.candidates.iter();
        candidates.filter(move |candidate| candidate.status == status)
    };
    // What is likelier there than not and has no name was put to a refit, which did not find it.
    let (refuted, possible): (Vec<&Candidate>, Vec<&Candidate>) =
        with(Status::Possible).partition(|candidate| candidate.is_not_borne_out());
    let possible: Vec<String> = possible
        .into_iter()
        .map(|candidate| format!("{} ({})", candidate.effect, probability(candidate.probability)))
        .collect();
    let mut said = String::new();
    if !possible.is_empty() {
        said = format!("; possible: {}", possible.join(", "));
    }
    if !refuted.is_empty() {
        let names: Vec<&str> = refuted.iter().map(|own| own.effect).collect();
        said += "; not borne out by a refit: ";
        said += &names.join(", ");
    }
    let unseen: Vec<&str> = with(Status::NotExcited).map(|c| c.effect).collect();
    let names = match unseen.len() {
        0 => return said,
        1..=FEW => unseen.join(", "),
        many => format!("{} and {} more", unseen[..FEW - 1].join(", "), many - FEW + 1),
    };
    said + "; not shown: " + &names
}

/// Said where the machine does not do the same twice: how much of the error that is, and what it follows.
fn not_repeating(diagnosis: &Diagnosis) -> String {
    let Some(floor) = diagnosis.repeat_floor.filter(|_| diagnosis.repeats == Some(false)) else {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_name_has_its_own_rivals() {
        let pairs = [
            ["quadratic_load", "load_step"],
            ["viscous_friction", "load_step"],
            ["quadratic_load", "constant_load"],
        ];
        assert_eq!(
            not_told(&pairs),
            "; this run cannot tell quadratic_load from load_step, constant_load nor viscous_friction from load_step"
        );
        let many = ["a", "b", "c", "d", "e"].map(|rival| ["cogging", rival]);
        let told = "; this run cannot tell cogging from a, b and 3 others";
        assert_eq!(not_told(&many), told);
    }
}
