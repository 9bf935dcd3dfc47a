//! The result of a diagnosis in one sentence, and its confirmation on another run.

use super::candidate::happening;
use super::limits::trivial;
use super::location::location;
use super::times;
use drivebench_diagnose::{
    Answer, CONFIRMED_SIGMAS, Candidate, Confirmation, ConfirmationFinding, Diagnosis,
    DiagnosisVerdict, Status, Unknown, UnknownKind, WindingDrop,
};
use drivebench_identify::noise::FloorSource;
use drivebench_model::plant::effect;
use drivebench_model::text::number::{probability, with_std};
use std::fmt::Write as _;

/// Most effects that are listed by name where these runs would not show them.
const FEW: usize = 4;

/// The answer in a word or two.
pub const fn answer(answer: Answer) -> &'static str {
    match answer {
        Answer::Found => "Effect found",
        Answer::NotConfirmed => "Effect found, not confirmed",
        Answer::InPart => "Effect found, not sufficient",
        Answer::Ambiguous => "Ambiguous",
        Answer::NoErrorLeft => "No error left to explain",
        Answer::NothingMissing => "Nothing missing",
        Answer::NothingThatShows => "Nothing missing that these runs could show",
        Answer::NothingFound => "Nothing found",
        Answer::Unexplained => "Unexplained",
        Answer::NotFitted => "Not fitted",
    }
}

pub fn diagnosis(found: &Diagnosis) -> String {
    let (begin, rest) = parts(found);
    format!("{begin}{rest}")
}

/// The same without the name of the answer.
pub fn after_name(found: &Diagnosis) -> String {
    parts(found).1
}

/// The begin of the sentence for this answer, and its rest.
fn parts(found: &Diagnosis) -> (&'static str, String) {
    let (begin, mut rest) = body(found);
    for id in &found.superfluous {
        let _ = write!(rest, "; {id} is superfluous now");
    }
    (begin, rest + &not_distinguished(&found.added_rivals))
}

fn body(found: &Diagnosis) -> (&'static str, String) {
    let names = names(found);
    let (before, after) = (found.holdout_before, found.holdout_after);
    let times = times(found.noise_floor_from);
    let cut = "the search was ended by its budget of work before all effects were tried together";
    let begin = match found.verdict {
        DiagnosisVerdict::None if found.is_all_judged() => "nothing is missing: ",
        DiagnosisVerdict::None => "nothing missing that these runs could show: ",
        DiagnosisVerdict::Effect | DiagnosisVerdict::Ambiguous if found.has_no_error() => {
            "no error left to explain: "
        }
        DiagnosisVerdict::Effect => "missing: ",
        _ => "",
    };
    let rest = match found.verdict {
        DiagnosisVerdict::None if found.noise_floor_from == FloorSource::None => {
            let missing = "without a noise floor it is not known whether an effect is missing";
            let nothing = if found.search_was_cut {
                format!("no effect that was found lowers the held-out error; {cut}, and {missing}")
            } else {
                format!("no effect of the catalogue lowers the held-out error; {missing}")
            };
            return ("", nothing);
        }
        DiagnosisVerdict::None if found.is_refuted() => {
            let refuted = format!(
                "the held-out error is {before:.2} {times}, but on the confirming run it is {:.2}: something is missing that \
                 only that run shows",
                found.confirm.as_ref().and_then(|confirm| confirm.error_before).unwrap_or(f64::NAN)
            );
            return ("", refuted);
        }
        DiagnosisVerdict::None if !found.sufficient => {
            let nothing =
                "this run would not show any effect of the catalogue: no conclusion is possible";
            return ("", nothing.to_owned());
        }
        DiagnosisVerdict::None => format!("held-out error {before:.2} {times}{}", unseen(found)),
        DiagnosisVerdict::Effect | DiagnosisVerdict::Ambiguous if found.has_no_error() => format!(
            "held-out error {before:.2} {times}; still likely: {names} ({before:.2} -> {after:.2}){}{}",
            not_distinguished(&found.confusable),
            unconfirmed(found)
        ),
        DiagnosisVerdict::Unexplained => {
            let known = if names.is_empty() && found.search_was_cut {
                format!("nothing that was found explains it; {cut}")
            } else if names.is_empty() {
                "no effect of the catalogue explains it".to_owned()
            } else {
                format!(
                    "{names} may be part of it, but most stays unexplained ({:.0} % explained)",
                    found.explained_percent
                )
            };
            let parts = found.unknown.iter().map(|part| format!("; {}", unknown(part)));
            let parts: String = parts.collect();
            format!(
                "held-out error {before:.2} {times}, and {known}{parts}{}",
                not_repeating(found)
            )
        }
        DiagnosisVerdict::NotFitted => format!(
            "{}; the residual of such a model is no evidence: no effect is named and none is ruled out",
            found.reason.as_ref().map_or_else(String::new, trivial)
        ),
        DiagnosisVerdict::Ambiguous => {
            format!(
                "behaves like {names}{}{}",
                not_distinguished(&found.confusable),
                unconfirmed(found)
            )
        }
        DiagnosisVerdict::Effect if found.winding_drop.is_some() && found.effects.len() == 1 => {
            format!(
                "{names}{}; held-out error of the torques {before:.2} {times}{}",
                drop(found),
                unconfirmed(found)
            )
        }
        DiagnosisVerdict::Effect => format!(
            "{names}; held-out error {before:.2} -> {after:.2} {times}, {:.0} % explained{}{}{}",
            found.explained_percent,
            drop(found),
            not_distinguished(&found.confusable),
            unconfirmed(found)
        ),
    };
    (begin, rest)
}

/// A drop that the voltage balance names.
fn drop(found: &Diagnosis) -> String {
    found.winding_drop.as_ref().map_or_else(String::new, |drop| {
        let volts = with_std(drop.drop_v, Some(drop.std_v));
        format!("; with a drop of {volts} V {}", fall_of_voltage(drop))
    })
}

/// What a drop does to the held-out voltage.
pub(super) fn fall_of_voltage(drop: &WindingDrop) -> String {
    let (before, after) = (drop.holdout_before_v, drop.holdout_after_v);
    format!("the held-out error of the voltage falls from {before:.3} to {after:.3} V")
}

/// The effects of a diagnosis, each with its time if it is an event.
fn names(found: &Diagnosis) -> String {
    let when = |id: &str| {
        let candidate = found.candidates.iter().find(|candidate| candidate.effect == id)?;
        happening(effect::find(id)?, &candidate.onsets, found.holdout_from)
    };
    let named = |id: &&'static str| match when(id) {
        Some(when) => format!("{id} ({when})"),
        None => (*id).to_owned(),
    };
    found.effects.iter().map(named).collect::<Vec<_>>().join(" and ")
}

/// Effects of a diagnosis that may as well be others, each with its rivals.
fn not_distinguished(confusable: &[[&'static str; 2]]) -> String {
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
    format!("; this run does not distinguish {}", words.join(" nor "))
}

fn unconfirmed(found: &Diagnosis) -> &'static str {
    if found.is_refuted() { "; NOT confirmed on the confirming run" } else { "" }
}

/// Effects for which "nothing is missing" is not known.
fn unseen(found: &Diagnosis) -> String {
    let with = |status: Status| found.candidates.iter().filter(move |own| own.status == status);
    // An effect with a probability above 50 % that is not named was not confirmed by a refit.
    let (refuted, possible): (Vec<&Candidate>, Vec<&Candidate>) =
        with(Status::Possible).partition(|own| own.is_not_confirmed_by_refit());
    let possible = possible.into_iter();
    let possible: Vec<String> =
        possible.map(|own| format!("{} ({})", own.effect, probability(own.probability))).collect();
    let mut text = String::new();
    if !possible.is_empty() {
        text = format!("; possible: {}", possible.join(", "));
    }
    if !refuted.is_empty() {
        let names: Vec<&str> = refuted.iter().map(|own| own.effect).collect();
        text += "; not confirmed by a refit: ";
        text += &names.join(", ");
    }
    let unseen: Vec<&str> = with(Status::NotExcited).map(|own| own.effect).collect();
    let names = match unseen.len() {
        0 => return text,
        1..=FEW => unseen.join(", "),
        many => format!("{} and {} more", unseen[..FEW - 1].join(", "), many - FEW + 1),
    };
    text + "; not shown: " + &names
}

/// The share of the error that differs from run to run where a machine does not repeat, and what it follows.
fn not_repeating(found: &Diagnosis) -> String {
    let Some(floor) = found.repeat_floor.filter(|_| found.repeats == Some(false)) else {
        return String::new();
    };
    let share = (floor * floor - 1.0) / (found.holdout_before.powi(2) - 1.0);
    let percent = 100.0 * share.clamp(0.0, 1.0);
    let follows = found.repeat_follows.first().map_or_else(
        || "the difference follows neither speed, current, angle nor time".to_owned(),
        |first| format!("of the difference, {}", location(first)),
    );
    format!(
        "; this machine does not repeat: {percent:.0} % of the error is different each time (two runs of the same excitation \
         differ by {floor:.2} times the sensors' noise); {follows}"
    )
}

pub fn unknown(part: &Unknown) -> String {
    let axis = match part.kind {
        UnknownKind::TorqueOverAngle => "the angle of the shaft",
        UnknownKind::VoltageOverCurrent => "the current",
        UnknownKind::TorqueOverSpeed => "the speed",
        UnknownKind::TorqueOverPastSpeed => "the past of the speed",
    };
    let percent = 100.0 * part.share_of_error;
    format!("{percent:.0} % of the error: an unknown {} that follows {axis}", part.equation)
}

pub fn confirmation(found: &Diagnosis, confirm: &Confirmation) -> String {
    let times = times(found.noise_floor_from);
    let before = confirm.error_before.unwrap_or(f64::NAN);
    let finding = match &confirm.finding {
        ConfirmationFinding::Effects { explains_it } => format!(
            "there {} takes the error from {before:.2} to {:.2} {times} and explains {:.0} % of what can be explained \
             (z {:.1}, {CONFIRMED_SIGMAS} is needed){}",
            found.effects.join(" and "),
            confirm.error_after.unwrap_or(f64::NAN),
            confirm.explained_percent.unwrap_or(f64::NAN),
            confirm.z.unwrap_or(f64::NAN),
            if *explains_it { "" } else { "; what is left there is more than noise" }
        ),
        ConfirmationFinding::NoNoiseFloor => format!(
            "the error there is {before:.2} {times}, and without a noise floor its allowed size is not known"
        ),
        ConfirmationFinding::AtTheFloorToo | ConfirmationFinding::UnexplainedToo => {
            format!("the error is {before:.2} {times} there too")
        }
        ConfirmationFinding::MissingThere => format!(
            "the error there is {before:.2} {times}: something is missing that only this run shows"
        ),
        ConfirmationFinding::ExplainedThere => {
            format!("there the model explains the run to the noise ({before:.2} {times})")
        }
        ConfirmationFinding::NothingConcluded => "nothing is concluded".to_owned(),
        ConfirmationFinding::NotJudged(message) => {
            return format!(
                "the confirming run cannot be judged, so that nothing is confirmed: {message}"
            );
        }
    };
    let drop = found.winding_drop.as_ref().map_or_else(String::new, |drop| match drop.confirm_z {
        Some(z) => format!("; the voltage drop there is {z:.1} times its deviation"),
        None => "; there is no voltage that would show the drop".to_owned(),
    });
    let word = match confirm.confirmed {
        Some(true) => "confirmed",
        Some(false) => "NOT confirmed",
        None => "neither confirmed nor refuted",
    };
    format!("{word} on the confirming run: {finding}{drop}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;
    use drivebench_diagnose::ConfirmationFinding;

    #[test]
    fn each_name_has_its_own_rivals() {
        let pairs = [
            ["quadratic_load", "load_step"],
            ["viscous_friction", "load_step"],
            ["quadratic_load", "constant_load"],
        ];
        assert_eq!(
            not_distinguished(&pairs),
            "; this run does not distinguish quadratic_load from load_step, constant_load nor viscous_friction from load_step"
        );
        let many = ["a", "b", "c", "d", "e"].map(|rival| ["cogging", rival]);
        let text = "; this run does not distinguish cogging from a, b and 3 others";
        assert_eq!(not_distinguished(&many), text);
    }

    #[test]
    fn the_sentence_is_the_name_of_the_answer_and_the_rest() {
        let effect = testing::diagnosis();
        let confirm = |confirmed, error| Confirmation {
            confirmed: Some(confirmed),
            error_before: Some(error),
            finding: ConfirmationFinding::MissingThere,
            ..Confirmation::default()
        };
        let with = |change: &dyn Fn(&mut Diagnosis)| {
            let mut found = effect.clone();
            change(&mut found);
            diagnosis(&found)
        };
        let none = |found: &mut Diagnosis| {
            (found.verdict, found.holdout_before) = (DiagnosisVerdict::None, 1.0);
            (found.effect, found.effects) = (None, Vec::new());
        };
        for (found, begin, end) in [
            (
                with(&|_| {}),
                "missing: stribeck_friction; held-out error 5.10 -> 1.03 times the noise floor, 100 % explained",
                "explained",
            ),
            (
                with(&|found| (found.holdout_before, found.holdout_after) = (0.95, 0.72)),
                "no error left to explain: held-out error 0.95 times the noise floor; still likely: stribeck",
                "(0.95 -> 0.72)",
            ),
            (
                with(&none),
                "nothing missing that these runs could show: held-out error 1.00 times the noise floor; possible: cogging",
                "; not shown: inductance_saturation",
            ),
            (
                with(&|found| {
                    none(found);
                    found.candidates.retain(|own| own.status == Status::RuledOut);
                }),
                "nothing is missing: held-out error 1.00 times the noise floor",
                "floor",
            ),
            (
                with(&|found| {
                    none(found);
                    (found.sufficient, found.confirm) = (false, Some(confirm(false, 3.0)));
                }),
                "the held-out error is 1.00 times the noise floor, but on the confirming run it is 3.00",
                "only that run shows",
            ),
        ] {
            assert!(found.starts_with(begin) && found.ends_with(end), "{found}");
        }
    }
}
