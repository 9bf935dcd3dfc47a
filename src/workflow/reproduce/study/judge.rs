//! What an answer is worth.

use serde::{Deserialize, Serialize};

use super::finding::{Finding, findings};
use super::parameters::{self, ParameterFinding};
use super::sizes::{self, BACKGROUND};
use super::truth::Truth;
use super::{Case, Group};
use crate::diagnosis::{Diagnosis, DiagnosisVerdict, Status};
use crate::emulator::truth::MotorTruth;
use crate::plant::{Model, Slot};

/// Names whose effects are the same but for a little: the delay and the filter of one signal, which are the same to first
/// order and told apart only by a quick dither, and drag and fan.
const TWINS: [[&str; 2]; 2] = [
    ["speed_delay", "speed_filter"],
    ["viscous_friction", "quadratic_load"],
];

pub(super) fn twin_of(id: &str) -> Option<&'static str> {
    let pairs = TWINS.into_iter().flat_map(|[a, b]| [(a, b), (b, a)]);
    pairs
        .filter(|(one, _)| *one == id)
        .map(|(_, other)| other)
        .next()
}

/// Whether these are two names for what is the same to first order.
pub(super) fn are_twins(a: &str, b: &str) -> bool {
    a != b && TWINS[0].contains(&a) && TWINS[0].contains(&b)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Every hidden effect is named, nothing else is. Where nothing known is hidden: it is said.
    Right,
    /// The twin of the hidden effect is named.
    Twin,
    /// The answer is a set that cannot be told apart, and all that is hidden is in it.
    Ambiguous,
    /// A part of what is hidden is named, and nothing that is not there; or a part is in a set that cannot be told apart.
    Partial,
    /// Nothing is named, and the run is said not to excite the effect.
    NotExcited,
    /// Nothing is named: no missing effect is visible, or none that is known explains the error.
    Abstained,
    /// Something is named that is not there, or a wave with another number of cogs.
    Wrong,
    /// No answer: the fit or the study failed.
    Failed,
}

/// The answer to one set.
#[derive(Clone, Debug, Serialize)]
pub struct Answer {
    pub group: Group,
    pub excitation: &'static str,
    pub class: String,
    pub seed: u64,
    pub outcome: Outcome,
    pub verdict: Option<DiagnosisVerdict>,
    pub effects: Vec<&'static str>,
    pub sufficient: bool,
    pub holdout_before: Option<f64>,
    pub holdout_after: Option<f64>,
    /// The diagnosis' own sentence, or why there is none.
    pub sentence: String,
    /// Of every effect of the catalogue; none where there is no answer.
    pub findings: Vec<Finding>,
    /// Of the motor's parameters, as far as the runs determine them.
    pub parameters: Vec<ParameterFinding>,
}

impl Answer {
    /// `truths` begin with what is hidden, as [`Case::right`] lists it.
    pub(super) fn of(
        case: &Case,
        truths: &[Truth],
        motor: &MotorTruth,
        diagnosis: &Diagnosis,
    ) -> Self {
        let said = Said::of(diagnosis);
        let orders: Vec<Option<f64>> = truths.iter().map(|truth| truth.order).collect();
        Self {
            outcome: outcome(case, &orders, &said),
            verdict: Some(diagnosis.verdict),
            effects: diagnosis.effects.clone(),
            sufficient: diagnosis.sufficient,
            holdout_before: Some(diagnosis.holdout_before),
            holdout_after: Some(diagnosis.holdout_after),
            findings: findings(truths, &said.orders, diagnosis),
            parameters: parameters::findings(motor, diagnosis),
            ..Self::failed(case, diagnosis.sentence.clone())
        }
    }

    pub(super) fn failed(case: &Case, reason: String) -> Self {
        Self {
            group: case.group,
            excitation: case.excitation.name(),
            class: case.class(),
            seed: case.seed,
            outcome: Outcome::Failed,
            verdict: None,
            effects: vec![],
            sufficient: false,
            holdout_before: None,
            holdout_after: None,
            sentence: reason,
            findings: vec![],
            parameters: vec![],
        }
    }

    /// Held-out error before and after, in units of the noise floor.
    pub fn errors(&self) -> Option<(f64, f64)> {
        Some((self.holdout_before?, self.holdout_after?))
    }

    /// What the answer is called in the confusion matrix.
    pub fn column(&self) -> &'static str {
        match (self.verdict, self.effects.first()) {
            (Some(DiagnosisVerdict::Effect), Some(first)) => first,
            (Some(DiagnosisVerdict::Ambiguous), _) => "(ambiguous)",
            (Some(DiagnosisVerdict::None), _) => "(none)",
            (Some(_), _) => "(unexplained)",
            (None, _) => "(failed)",
        }
    }
}

/// What counts of a diagnosis.
struct Said<'a> {
    verdict: DiagnosisVerdict,
    effects: &'a [&'static str],
    /// Named, or said not to be told from what is named.
    pool: Vec<&'static str>,
    not_excited: Vec<&'static str>,
    /// Waves in a turn of what is named.
    orders: Vec<(&'static str, f64)>,
}

impl<'a> Said<'a> {
    fn of(diagnosis: &'a Diagnosis) -> Self {
        let rivals = diagnosis.confusable.iter().flatten().copied();
        Self {
            verdict: diagnosis.verdict,
            effects: &diagnosis.effects,
            pool: diagnosis.effects.iter().copied().chain(rivals).collect(),
            not_excited: (diagnosis.candidates.iter())
                .filter(|candidate| candidate.status == Status::NotExcited)
                .map(|candidate| candidate.effect)
                .collect(),
            orders: orders(&diagnosis.model.model),
        }
    }

    /// Whether `id` may have this many waves in a turn, as whole numbers.
    fn is_of_order(&self, id: &str, order: Option<f64>) -> bool {
        let mut known = self.orders.iter().filter(|known| known.0 == id);
        known.all(|(_, found)| order.is_none_or(|order| (found - order).abs() < 0.5))
    }
}

fn orders(model: &Model) -> Vec<(&'static str, f64)> {
    let slots = model.slots().into_iter();
    slots
        .filter_map(|slot| match slot {
            Slot::Effect { spec, id, .. } if spec.key == "order" => Some((id, model.get(&slot)?)),
            _ => None,
        })
        .collect()
}

fn outcome(case: &Case, orders: &[Option<f64>], said: &Said<'_>) -> Outcome {
    let nothing_known = case.right.is_empty();
    match said.verdict {
        DiagnosisVerdict::None | DiagnosisVerdict::Unexplained if nothing_known => {
            let expected = match case.group {
                Group::Unknown => DiagnosisVerdict::Unexplained,
                _ => DiagnosisVerdict::None,
            };
            if said.verdict == expected {
                Outcome::Right
            } else {
                Outcome::Abstained
            }
        }
        DiagnosisVerdict::Unexplained => Outcome::Abstained,
        DiagnosisVerdict::None => {
            let excused = |names: &Vec<&str>| names.iter().all(|id| said.not_excited.contains(id));
            if case.right.iter().all(excused) {
                Outcome::NotExcited
            } else {
                Outcome::Abstained
            }
        }
        DiagnosisVerdict::Ambiguous => {
            let inside = |names: &&Vec<&str>| names.iter().any(|id| said.pool.contains(id));
            match case.right.iter().filter(inside).count() {
                0 => Outcome::Wrong,
                all if all == case.right.len() => Outcome::Ambiguous,
                _ => Outcome::Partial,
            }
        }
        DiagnosisVerdict::Effect => named(case, orders, said),
    }
}

fn named(case: &Case, orders: &[Option<f64>], said: &Said<'_>) -> Outcome {
    let effects = said.effects;
    // A wave of another number of cogs is another effect under the same name.
    let orders = orders.iter().copied().chain(std::iter::repeat(None));
    let right: Vec<Vec<&str>> = (case.right.iter().zip(orders))
        .map(|(names, order)| {
            let names = names.iter().copied();
            names.filter(|id| said.is_of_order(id, order)).collect()
        })
        .collect();
    let belongs = |id: &str| {
        let background = case.group.background().is_some() && BACKGROUND.contains(&id);
        background || right.iter().flatten().any(|right| *right == id)
    };
    let strangers: Vec<&str> = effects.iter().copied().filter(|id| !belongs(id)).collect();
    let is_found = |names: &&Vec<&str>| names.iter().any(|id| effects.contains(id));
    let found = right.iter().filter(is_found).count();
    let missed: Vec<&str> = (right.iter().filter(|names| !is_found(names)))
        .flatten()
        .copied()
        .collect();
    // What a background's drag of a per cent does under a load that wanders, a small fan does as well.
    let has_background = case.group.background().is_some();
    let own = BACKGROUND.iter().copied().filter(|_| has_background);
    let unnamed: Vec<&str> = own.filter(|id| !effects.contains(id)).collect();
    let is_twin = |id: &&str| {
        missed.iter().any(|missed| are_twins(id, missed))
            || twin_of(id).is_some_and(|twin| unnamed.contains(&twin))
    };
    match (strangers.is_empty(), found) {
        (true, all) if all == case.right.len() && all > 0 => Outcome::Right,
        (true, 1..) => Outcome::Partial,
        (true, 0) => Outcome::Abstained,
        (false, _) if strangers.iter().all(is_twin) => Outcome::Twin,
        (false, _) => Outcome::Wrong,
    }
}

/// Classes in the order of the tables.
pub(super) fn known() -> impl Iterator<Item = &'static str> {
    sizes::known().into_iter()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::workflow::reproduce::study::Excitation;

    fn case(group: Group, right: &[&[&'static str]]) -> Case {
        Case {
            group,
            excitation: Excitation::Rich,
            hidden: right.iter().map(|names| names[0]).collect(),
            right: right.iter().map(|names| names.to_vec()).collect(),
            seed: 1,
            seconds: 12.0,
        }
    }

    fn said<'a>(verdict: DiagnosisVerdict, effects: &'a [&'static str]) -> Said<'a> {
        Said {
            verdict,
            effects,
            pool: effects.to_vec(),
            not_excited: vec!["constant_load"],
            orders: vec![("cogging", 6.0)],
        }
    }

    #[track_caller]
    fn check(case: &Case, rows: &[(&[&'static str], Outcome)]) {
        for (effects, expected) in rows {
            let verdict = said(DiagnosisVerdict::Effect, effects);
            assert_eq!(outcome(case, &[], &verdict), *expected, "{effects:?}");
        }
    }

    #[test]
    fn a_wave_of_another_order_is_another_effect() {
        let (single, pair) = (
            case(Group::Single, &[&["cogging"]]),
            case(Group::Pair, &[&["backlash"], &["cogging"]]),
        );
        let (one, both): (&[_], &[_]) = (&["cogging"], &["backlash", "cogging"]);
        for (case, orders, effects, expected) in [
            (&single, &[Some(6.0)][..], one, Outcome::Right),
            (&single, &[Some(12.0)], one, Outcome::Wrong),
            (&pair, &[None, Some(6.0)], both, Outcome::Right),
            (&pair, &[None, Some(8.0)], both, Outcome::Wrong),
        ] {
            let said = said(DiagnosisVerdict::Effect, effects);
            assert_eq!(outcome(case, orders, &said), expected, "{orders:?}");
        }
    }

    #[test]
    fn an_open_answer_to_a_pair_has_both_in_it() {
        let pair = case(Group::Pair, &[&["backlash"], &["cogging"]]);
        let rows: [(&[_], _); 3] = [
            (&["supply_sag", "cogging", "backlash"], Outcome::Ambiguous),
            (&["supply_sag", "cogging"], Outcome::Partial),
            (&["supply_sag", "voltage_drop"], Outcome::Wrong),
        ];
        for (effects, expected) in rows {
            let tie = said(DiagnosisVerdict::Ambiguous, effects);
            assert_eq!(outcome(&pair, &[], &tie), expected, "{effects:?}");
        }
    }

    #[test]
    fn a_name_is_right_only_if_it_is_all_that_is_named() {
        check(
            &case(Group::Single, &[&["cogging"]]),
            &[
                (&["cogging"], Outcome::Right),
                (&["cogging", "backlash"], Outcome::Wrong),
                (&["backlash"], Outcome::Wrong),
            ],
        );
        check(
            &case(Group::Pair, &[&["cogging"], &["backlash"]]),
            &[
                (&["backlash", "cogging"], Outcome::Right),
                (&["backlash"], Outcome::Partial),
                (&["backlash", "supply_sag"], Outcome::Wrong),
            ],
        );
        let late = case(Group::Single, &[&["speed_delay"]]);
        check(&late, &[(&["speed_filter"], Outcome::Twin)]);
        check(&case(Group::Null, &[]), &[(&["cogging"], Outcome::Wrong)]);
    }

    #[test]
    fn on_a_messy_bench_the_background_may_be_named_but_is_not_the_answer() {
        check(
            &case(Group::Background { level: 1.0 }, &[&["voltage_drop"]]),
            &[
                (&["voltage_drop", "cogging"], Outcome::Right),
                (&["cogging"], Outcome::Abstained),
                (&["backlash"], Outcome::Wrong),
            ],
        );
    }

    #[test]
    fn silence_is_right_only_where_nothing_known_is_hidden() {
        let (none, unexplained) = (DiagnosisVerdict::None, DiagnosisVerdict::Unexplained);
        let (null, unknown) = (case(Group::Null, &[]), case(Group::Unknown, &[]));
        let hidden = case(Group::Single, &[&["cogging"]]);
        let invisible = case(Group::Single, &[&["constant_load"]]);
        for (case, verdict, expected) in [
            (&null, none, Outcome::Right),
            (&null, unexplained, Outcome::Abstained),
            (&unknown, unexplained, Outcome::Right),
            (&unknown, none, Outcome::Abstained),
            (&hidden, none, Outcome::Abstained),
            (&invisible, none, Outcome::NotExcited),
        ] {
            let found = outcome(case, &[], &said(verdict, &[]));
            assert_eq!(found, expected, "{:?} {verdict:?}", case.group);
        }
        let tie = said(DiagnosisVerdict::Ambiguous, &["cogging", "backlash"]);
        assert_eq!(outcome(&hidden, &[], &tie), Outcome::Ambiguous);
        assert_eq!(outcome(&invisible, &[], &tie), Outcome::Wrong);
    }
}
