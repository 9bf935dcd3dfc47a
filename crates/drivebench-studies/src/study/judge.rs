//! Assessment of an answer: for each effect of the catalogue the finding and the truth, and the outcome of the whole.

use drivebench::tabulated;
use serde::{Deserialize, Serialize};

use super::calibration::{INTERVAL_SIGMAS, ParameterFinding, parameters_of};
use super::cases::BACKGROUND;
use super::record::Truth;
use super::{Case, Group};
use drivebench::diagnosis::{Candidate, Diagnosis, DiagnosisVerdict, Status};
use drivebench::emulator::truth::MotorTruth;
use drivebench::plant::{Model, Slot};
use drivebench::report::wording::diagnosis as words;
use drivebench::sample::ParameterEstimate;
use drivebench::workflow::ORDER;

/// Names whose effects are the same but for a little: the delay and the filter of one signal, which are the same to first
/// order and distinguished only by a quick dither, and drag and fan.
const TWINS: [[&str; 2]; 2] =
    [["speed_delay", "speed_filter"], ["viscous_friction", "quadratic_load"]];

pub(super) fn twin_of(id: &str) -> Option<&'static str> {
    let pairs = TWINS.into_iter().flat_map(|[a, b]| [(a, b), (b, a)]);
    pairs.filter(|(one, _)| *one == id).map(|(_, other)| other).next()
}

/// Whether these are two names for what is the same to first order.
pub(super) fn are_twins(a: &str, b: &str) -> bool {
    a != b && TWINS[0].contains(&a) && TWINS[0].contains(&b)
}

tabulated! {
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Outcome {
        /// Every hidden effect is named, nothing else is. Where nothing known is hidden: the verdict is so.
        Right = "the answer is what is hidden, and nothing else",
        /// The twin of the hidden effect is named.
        Twin = "the twin of what is hidden was named",
        /// The answer is a set of effects that explain the run alike, and all that is hidden is in it.
        Ambiguous = "what is hidden is in the set that the answer leaves open",
        /// A part of what is hidden is named, and nothing that is not there; or a part is in an ambiguous set.
        Partial = "a part of what is hidden was named, and nothing that is not there",
        /// Nothing is named, and the effect is reported as not excited.
        NotExcited = "what is hidden was reported as not excited",
        /// Nothing is named: no missing effect is visible, or none that is known explains the error.
        Abstained = "what is hidden was not named, and nothing else was",
        /// Something is named that is not there, or a wave with another number of cogs.
        Wrong = "what was named is not there, or has another number of waves",
        /// No answer: the fit or the study failed.
        #[default]
        Failed = "there is no answer",
    }
    pub(super) const fn reason(self) -> &'static str;
}

#[derive(Clone, Debug, Default, Serialize)]
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
        let claims = Claims::of(diagnosis);
        let orders: Vec<Option<f64>> = truths.iter().map(|truth| truth.order).collect();
        Self {
            outcome: outcome(case.group, &case.right, &orders, &claims),
            verdict: Some(diagnosis.verdict),
            effects: diagnosis.effects.clone(),
            sufficient: diagnosis.sufficient,
            holdout_before: Some(diagnosis.holdout_before),
            holdout_after: Some(diagnosis.holdout_after),
            findings: findings(truths, &claims.orders, diagnosis),
            parameters: parameters_of(motor, diagnosis),
            ..Self::failed(case, words::diagnosis(diagnosis))
        }
    }

    pub(super) fn failed(case: &Case, reason: String) -> Self {
        Self {
            group: case.group,
            excitation: case.excitation.name(),
            class: case.class(),
            seed: case.seed,
            sentence: reason,
            ..Self::default()
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

/// What counts of an answer.
pub(super) struct Claims<'a> {
    pub(super) verdict: DiagnosisVerdict,
    pub(super) effects: Vec<&'a str>,
    /// Named, or reported as not distinguished from what is named.
    pub(super) pool: Vec<&'a str>,
    pub(super) not_excited: Vec<&'a str>,
    /// Waves in a turn of what is named.
    pub(super) orders: Vec<(&'a str, f64)>,
}

impl<'a> Claims<'a> {
    fn of(diagnosis: &'a Diagnosis) -> Self {
        let rivals = diagnosis.confusable.iter().flatten().copied();
        Self {
            verdict: diagnosis.verdict,
            effects: diagnosis.effects.clone(),
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
            Slot::Effect { spec, id, .. } if spec.key == ORDER => Some((id, model.get(&slot)?)),
            _ => None,
        })
        .collect()
}

/// Marks what an answer claims: `right` has for each hidden effect the names that are right, `orders` its waves in a turn.
pub(super) fn outcome(
    group: Group,
    right: &[Vec<&str>],
    orders: &[Option<f64>],
    claims: &Claims<'_>,
) -> Outcome {
    let nothing_known = right.is_empty();
    match claims.verdict {
        DiagnosisVerdict::None | DiagnosisVerdict::Unexplained if nothing_known => {
            let expected = match group {
                Group::Unknown => DiagnosisVerdict::Unexplained,
                _ => DiagnosisVerdict::None,
            };
            if claims.verdict == expected { Outcome::Right } else { Outcome::Abstained }
        }
        DiagnosisVerdict::Unexplained | DiagnosisVerdict::NotFitted => Outcome::Abstained,
        DiagnosisVerdict::None => {
            let excused =
                |names: &Vec<&str>| names.iter().all(|id| claims.not_excited.contains(id));
            if right.iter().all(excused) { Outcome::NotExcited } else { Outcome::Abstained }
        }
        DiagnosisVerdict::Ambiguous => {
            let inside = |names: &&Vec<&str>| names.iter().any(|id| claims.pool.contains(id));
            match right.iter().filter(inside).count() {
                0 => Outcome::Wrong,
                all if all == right.len() => Outcome::Ambiguous,
                _ => Outcome::Partial,
            }
        }
        DiagnosisVerdict::Effect => named(group, right, orders, claims),
    }
}

fn named(
    group: Group,
    right: &[Vec<&str>],
    orders: &[Option<f64>],
    claims: &Claims<'_>,
) -> Outcome {
    let effects = &claims.effects;
    let all = right.len();
    // A wave of another number of cogs is another effect under the same name.
    let orders = orders.iter().copied().chain(std::iter::repeat(None));
    let right: Vec<Vec<&str>> = (right.iter().zip(orders))
        .map(|(names, order)| {
            let names = names.iter().copied();
            names.filter(|id| claims.is_of_order(id, order)).collect()
        })
        .collect();
    let has_background = group.background().is_some();
    let belongs = |id: &str| {
        (has_background && BACKGROUND.contains(&id))
            || right.iter().flatten().any(|right| *right == id)
    };
    let absent: Vec<&str> = effects.iter().copied().filter(|id| !belongs(id)).collect();
    let is_found = |names: &&Vec<&str>| names.iter().any(|id| effects.contains(id));
    let found = right.iter().filter(is_found).count();
    let missed: Vec<&str> =
        (right.iter().filter(|names| !is_found(names))).flatten().copied().collect();
    // What a background's drag of a per cent does under a load that wanders, a small fan does as well.
    let own = BACKGROUND.iter().copied().filter(|_| has_background);
    let unnamed: Vec<&str> = own.filter(|id| !effects.contains(id)).collect();
    let is_twin = |id: &&str| {
        missed.iter().any(|missed| are_twins(id, missed))
            || twin_of(id).is_some_and(|twin| unnamed.contains(&twin))
    };
    match (absent.is_empty(), found) {
        (true, 1..) if found == all => Outcome::Right,
        (true, 1..) => Outcome::Partial,
        (true, 0) => Outcome::Abstained,
        (false, _) if absent.iter().all(is_twin) => Outcome::Twin,
        (false, _) => Outcome::Wrong,
    }
}

/// One effect of the catalogue in one set.
#[derive(Clone, Debug, Serialize)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "a line of a sheet with a column for each question, not the state of something"
)]
pub struct Finding {
    pub effect: &'static str,
    pub there: bool,
    /// In the unit of its first parameter, an amplitude for waves, at the reference condition.
    pub true_size: Option<f64>,
    pub probability: f64,
    pub status: Status,
    pub upper_bound: Option<f64>,
    pub detectable: Option<f64>,
    pub named: bool,
    /// It is named, with another number of waves than what is there has.
    pub of_other_order: bool,
    /// As it was estimated, with its 95 % interval.
    pub size: Option<f64>,
    pub interval_95: Option<[f64; 2]>,
    /// Another right name of the same thing is named: no size of its own then has a truth.
    pub other_name: Option<&'static str>,
    /// Its twin is named in its place; of a false name: its twin is there.
    pub twin: bool,
    /// Reported as not distinguished from what is named; of a false name: from what is there.
    pub left_open: bool,
}

impl Finding {
    /// Whether it is there and named.
    pub const fn is_recalled(&self) -> bool {
        self.there && self.named && !self.of_other_order
    }

    /// Whether it is named and not there, or another wave is there.
    pub const fn is_false(&self) -> bool {
        self.named && (!self.there || self.of_other_order)
    }

    /// Whether it is there, and neither it nor another name of the same thing is named.
    pub const fn is_missed(&self) -> bool {
        self.there && !self.is_recalled() && self.other_name.is_none()
    }

    /// Whether it was called ruled out with a bound below `share` of its true size.
    pub fn is_ruled_out_below(&self, share: f64) -> bool {
        let sizes = self.upper_bound.zip(self.true_size);
        let is_below = sizes.is_some_and(|(bound, size)| bound < share * size.abs());
        self.is_missed() && self.status == Status::RuledOut && is_below
    }

    /// Whether its size is above the reported detectable one, and it was not named.
    pub fn should_have_shown(&self) -> bool {
        let sizes = self.detectable.zip(self.true_size);
        self.is_missed() && sizes.is_some_and(|(least, size)| least < size.abs())
    }

    /// Whether "at most" holds of what is there and was not named; none where there is no bound.
    pub fn bound_holds(&self) -> Option<bool> {
        let (bound, size) = self.upper_bound.zip(self.true_size)?;
        (self.is_missed()).then_some(bound >= size.abs())
    }

    /// Whether the interval of a right name holds its size.
    pub fn interval_holds(&self) -> Option<bool> {
        let ([low, high], size) = self.interval_95.zip(self.true_size)?;
        (self.is_recalled()).then_some((low..=high).contains(&size))
    }

    /// Error of the size of a right name, as a share of it; negative where it is too small.
    pub fn size_error(&self) -> Option<f64> {
        let (found, size) = self.size.zip(self.true_size)?;
        (self.is_recalled()).then(|| found / size - 1.0)
    }
}

/// Every effect of the diagnosis; `orders` are the waves in a turn of what is named.
pub(super) fn findings(
    truths: &[Truth],
    orders: &[(&str, f64)],
    diagnosis: &Diagnosis,
) -> Vec<Finding> {
    let of = |candidate| Finding::of(candidate, truths, orders, diagnosis);
    diagnosis.candidates.iter().map(of).collect()
}

impl Finding {
    fn of(
        candidate: &Candidate,
        truths: &[Truth],
        orders: &[(&str, f64)],
        diagnosis: &Diagnosis,
    ) -> Self {
        let id = candidate.effect;
        let named = &diagnosis.effects;
        let is_named = named.contains(&id);
        let is_there = |id: &str| truths.iter().any(|truth| truth.is(id));
        let own: Vec<&Truth> = truths.iter().filter(|truth| truth.is(id)).collect();
        // A wave is compared with the true wave of its own order.
        let waves: Vec<f64> =
            (orders.iter().filter(|(other, _)| *other == id)).map(|(_, order)| *order).collect();
        let has_order = |truth: &&&Truth| {
            let close = |order: f64| waves.iter().any(|found| (found - order).abs() < 0.5);
            truth.order.is_none_or(close)
        };
        let meant: Vec<&Truth> = own.iter().filter(has_order).copied().collect();
        // Of one thing under two names neither size is the whole of it.
        let mut names = own.iter().flat_map(|truth| &truth.names).map(|name| name.0);
        let other_name = names.find(|name| *name != id && named.contains(name));
        let twin = twin_of(id);
        let mut open = diagnosis.confusable.iter();
        let (size, interval_95) = estimate(&candidate.parameters);
        Self {
            effect: id,
            there: !own.is_empty(),
            true_size: true_size(if meant.is_empty() { &own } else { &meant }, id)
                .filter(|_| other_name.is_none()),
            probability: candidate.probability,
            status: candidate.status,
            upper_bound: candidate.upper_bound,
            detectable: candidate.detectable,
            named: is_named,
            of_other_order: is_named && !own.is_empty() && meant.is_empty(),
            size,
            interval_95,
            other_name: names.filter(|_| !is_named).find(|name| named.contains(name)),
            twin: twin.is_some_and(|twin| {
                if is_named { own.is_empty() && is_there(twin) } else { named.contains(&twin) }
            }),
            left_open: open.any(|[first, rival]| {
                if is_named {
                    *first == id && own.is_empty() && is_there(rival)
                } else {
                    *rival == id
                }
            }),
        }
    }
}

impl Truth {
    fn is(&self, id: &str) -> bool {
        self.names.iter().any(|(name, _)| *name == id)
    }
}

/// Of one kind the sum, of waves of several orders the largest.
fn true_size(truths: &[&Truth], id: &str) -> Option<f64> {
    let mut sizes = truths.iter().map(|truth| {
        let mut own = truth.names.iter().filter(|(name, _)| *name == id);
        own.next().and_then(|(_, size)| *size)
    });
    let are_waves = truths.iter().any(|truth| truth.order.is_some());
    let first = sizes.next()??;
    Some(sizes.flatten().fold(
        first,
        |all, size| {
            if are_waves { all.max(size) } else { all + size }
        },
    ))
}

/// Size and 95 % interval of the first parameter, or of the amplitude of the first two.
fn estimate(parameters: &[ParameterEstimate]) -> (Option<f64>, Option<[f64; 2]>) {
    let Some(first) = parameters.first() else {
        return (None, None);
    };
    let is_wave = first.key.contains(".sin_");
    let (true, Some(second)) = (is_wave, parameters.get(1)) else {
        return (first.value, first.interval_95());
    };
    let Some((sine, cosine)) = first.value.zip(second.value) else {
        return (None, None);
    };
    let size = sine.hypot(cosine);
    let half = (first.std.zip(second.std))
        .map(|(of_sine, of_cosine)| (sine * of_sine).hypot(cosine * of_cosine) / size)
        .map(|std| INTERVAL_SIGMAS * std);
    (Some(size), half.map(|half| [size - half, size + half]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::Excitation;

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

    fn mark(case: &Case, orders: &[Option<f64>], claims: &Claims<'_>) -> Outcome {
        outcome(case.group, &case.right, orders, claims)
    }

    fn claims(verdict: DiagnosisVerdict, effects: &[&'static str]) -> Claims<'static> {
        Claims {
            verdict,
            effects: effects.to_vec(),
            pool: effects.to_vec(),
            not_excited: vec!["constant_load"],
            orders: vec![("cogging", 6.0)],
        }
    }

    #[track_caller]
    fn check(case: &Case, rows: &[(&[&'static str], Outcome)]) {
        for (effects, expected) in rows {
            let verdict = claims(DiagnosisVerdict::Effect, effects);
            assert_eq!(mark(case, &[], &verdict), *expected, "{effects:?}");
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
            let claims = claims(DiagnosisVerdict::Effect, effects);
            assert_eq!(mark(case, orders, &claims), expected, "{orders:?}");
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
            let tie = claims(DiagnosisVerdict::Ambiguous, effects);
            assert_eq!(mark(&pair, &[], &tie), expected, "{effects:?}");
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
    fn the_background_may_be_named_but_is_not_the_answer() {
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
            let found = mark(case, &[], &claims(verdict, &[]));
            assert_eq!(found, expected, "{:?} {verdict:?}", case.group);
        }
        let tie = claims(DiagnosisVerdict::Ambiguous, &["cogging", "backlash"]);
        assert_eq!(mark(&hidden, &[], &tie), Outcome::Ambiguous);
        assert_eq!(mark(&invisible, &[], &tie), Outcome::Wrong);
    }
}
