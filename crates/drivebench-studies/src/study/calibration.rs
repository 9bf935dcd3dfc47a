//! Calibration of probabilities, bounds and sizes: counts over every effect of every answer; coverage of the motor's
//! parameters: how many 95 % intervals of settled values hold what the machine was made of.

use serde::Serialize;
use statrs::distribution::{Beta, ContinuousCDF};

use super::cases::known;
use super::{Answer, Finding, Group, GroupCount, Outcome};
use crate::lines::KEYS;
use drivebench::diagnosis::{Diagnosis, DiagnosisVerdict, Status};
use drivebench::emulator::truth::MotorTruth;
use drivebench::numerics::statistics::{mean, median};
use drivebench::plant::MotorKey;
use drivebench::sample::Verdict;

/// Edges of the bins of probabilities: fine where something is claimed.
const EDGES: [f64; 7] = [0.0, 0.02, 0.1, 0.5, 0.9, 0.98, 1.0];
/// A bound so far below the true size is false beyond what an estimate of 95 % may miss.
const FALSE_BOUND: f64 = 0.8;

/// Effects that were given a probability between two edges; the upper edge belongs to the last bin only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bin {
    pub from: f64,
    pub to: f64,
    /// Mean of the probabilities given; none where none was.
    pub mean: Option<f64>,
    /// How many of them are there.
    pub there: Bounded,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Calibration {
    pub sets: usize,
    pub bins: Vec<Bin>,
    /// Mean square of the probability's distance from what is so.
    pub brier: Option<f64>,
    /// Of all effects that are there, those that are named, by this or another right name.
    pub recalled: Bounded,
    /// Of those that are not: the finding instead.
    pub missed: Missed,
    /// Of all names, those of what is not there.
    pub false_names: Bounded,
    /// Of the false names: the twin is there; the answer reports it as not distinguished from what is there.
    pub false_twins: usize,
    pub false_but_open: usize,
    /// Of the effects that are there: called ruled out with a bound below 0.8 of the true size.
    pub falsely_ruled_out: Bounded,
    /// Of the effects that are there and have a size: unnamed, though above the reported detectable size.
    pub should_have_shown: Bounded,
    /// Of the effects that are absent and that the runs excite: those that are ruled out.
    pub absent_ruled_out: Bounded,
    /// Of these, the median of the bound over the size that would have been named.
    pub bound_over_detectable: Option<f64>,
    /// Of the bounds of what is there and unnamed: those that hold.
    pub bounds_hold: Bounded,
    /// Of the sizes of right names: those whose 95 % interval holds the truth; their median error.
    pub intervals_hold: Bounded,
    pub size_error: Option<f64>,
    /// Where something is there that the runs excite: that nothing is missing.
    pub false_none: Bounded,
    /// Where nothing is there that no catalogue has, and no other shape: that most stays unexplained.
    pub false_unexplained: Bounded,
}

/// Effects that are there and were not named.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Missed {
    /// The twin is named.
    pub twin: usize,
    /// Reported as not distinguished from what is named.
    pub open: usize,
    pub possible: usize,
    pub ruled_out: usize,
    pub not_excited: usize,
    /// Another wave is named under its name.
    pub other_order: usize,
}

impl Missed {
    fn count(&mut self, finding: &Finding) {
        let place = match finding.status {
            _ if finding.of_other_order => &mut self.other_order,
            _ if finding.twin => &mut self.twin,
            _ if finding.left_open => &mut self.open,
            Status::NotExcited => &mut self.not_excited,
            Status::RuledOut => &mut self.ruled_out,
            Status::Possible | Status::Supported => &mut self.possible,
        };
        *place += 1;
    }
}

impl Calibration {
    pub fn of<'a>(answers: impl IntoIterator<Item = &'a Answer>) -> Self {
        let answers: Vec<&Answer> = answers.into_iter().collect();
        let all: Vec<&Finding> = answers.iter().flat_map(|a| &a.findings).collect();
        let there = || all.iter().filter(|finding| finding.there);
        let missed = || all.iter().filter(|finding| finding.is_missed());
        let named = all.iter().filter(|finding| finding.named);
        let falsely = || all.iter().filter(|finding| finding.is_false());
        let count = |kept: &dyn Fn(&Finding) -> bool| all.iter().filter(|f| kept(f)).count();
        let share = |held: &dyn Fn(&Finding) -> Option<bool>| {
            let held: Vec<bool> = all.iter().filter_map(|finding| held(finding)).collect();
            Bounded::new(held.iter().filter(|held| **held).count(), held.len())
        };
        let ruled_out = |f: &Finding| f.status == Status::RuledOut;
        let excited = |f: &Finding| !f.there && !f.named && f.status != Status::NotExcited;
        let mut instead = Missed::default();
        missed().for_each(|finding| instead.count(finding));
        Self {
            sets: answers.len(),
            bins: bins(&all),
            brier: of_any(
                all.iter().map(|f| {
                    let is_there = f.there && !f.of_other_order;
                    (f.probability - f64::from(u8::from(is_there))).powi(2)
                }),
                mean,
            ),
            recalled: Bounded::new(there().count() - missed().count(), there().count()),
            missed: instead,
            false_names: Bounded::new(falsely().count(), named.count()),
            false_twins: falsely().filter(|finding| finding.twin).count(),
            false_but_open: falsely().filter(|finding| finding.left_open).count(),
            falsely_ruled_out: Bounded::new(
                count(&|finding| finding.is_ruled_out_below(FALSE_BOUND)),
                there().count(),
            ),
            should_have_shown: Bounded::new(
                count(&Finding::should_have_shown),
                count(&|finding| finding.there && finding.true_size.is_some()),
            ),
            absent_ruled_out: share(&|finding| excited(finding).then(|| ruled_out(finding))),
            bound_over_detectable: of_any(
                (all.iter().filter(|f| excited(f) && ruled_out(f)))
                    .filter_map(|finding| Some(finding.upper_bound? / finding.detectable?)),
                median,
            ),
            bounds_hold: share(&Finding::bound_holds),
            intervals_hold: share(&Finding::interval_holds),
            size_error: of_any(all.iter().filter_map(|f| f.size_error()).map(f64::abs), median),
            false_none: verdicts(&answers, DiagnosisVerdict::None, |answer| {
                let shown = |f: &Finding| f.there && f.status != Status::NotExcited;
                answer.group == Group::Unknown || answer.findings.iter().any(shown)
            }),
            false_unexplained: verdicts(&answers, DiagnosisVerdict::Unexplained, |answer| {
                let foreign = matches!(answer.group, Group::Unknown | Group::WrongForm);
                !foreign && answer.group.background().is_none()
            }),
        }
    }
}

/// Sizes of one effect over many answers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sizes {
    pub effect: &'static str,
    /// Those whose 95 % interval holds the truth.
    pub intervals_hold: Bounded,
    /// Median of the error with its sign, as a share of the size.
    pub error: Option<f64>,
}

/// Sizes by effect, in the order of the study; effects that were never named rightly are left out.
pub fn sizes(answers: &[Answer]) -> Vec<Sizes> {
    let known = known().into_iter();
    known
        .filter_map(|effect| {
            let of_effect = || {
                let all = answers.iter().flat_map(|answer| &answer.findings);
                all.filter(|finding| finding.effect == effect)
            };
            let held: Vec<bool> = of_effect().filter_map(Finding::interval_holds).collect();
            (!held.is_empty()).then(|| Sizes {
                effect,
                intervals_hold: Bounded::new(held.iter().filter(|held| **held).count(), held.len()),
                error: of_any(of_effect().filter_map(Finding::size_error), median),
            })
        })
        .collect()
}

fn bins(all: &[&Finding]) -> Vec<Bin> {
    let last = EDGES.len() - 2;
    let edges = EDGES.iter().zip(&EDGES[1..]).enumerate();
    edges
        .map(|(place, (&from, &to))| {
            let inside =
                |f: &&&Finding| f.probability >= from && (f.probability < to || place == last);
            let of_bin: Vec<&Finding> = all.iter().filter(inside).copied().collect();
            let there = of_bin.iter().filter(|f| f.there && !f.of_other_order);
            Bin {
                from,
                to,
                mean: of_any(of_bin.iter().map(|finding| finding.probability), mean),
                there: Bounded::new(there.count(), of_bin.len()),
            }
        })
        .collect()
}

/// How often a verdict was given where it is false.
fn verdicts(
    answers: &[&Answer],
    verdict: DiagnosisVerdict,
    is_false_there: impl Fn(&Answer) -> bool,
) -> Bounded {
    let judged: Vec<_> = (answers.iter().filter(|answer| is_false_there(answer)))
        .filter_map(|answer| answer.verdict)
        .collect();
    let given = judged.iter().filter(|given| **given == verdict);
    Bounded::new(given.count(), judged.len())
}

/// None where there are no values.
fn of_any(values: impl Iterator<Item = f64>, statistic: fn(&[f64]) -> f64) -> Option<f64> {
    let values: Vec<f64> = values.collect();
    (!values.is_empty()).then(|| statistic(&values))
}

#[cfg(test)]
pub(crate) mod by_hand {
    use super::*;
    use crate::study::{Case, Excitation, Outcome};

    /// An effect that is absent and ruled out, at most 2, where 4 would have shown.
    pub(crate) fn absent(effect: &'static str, p: f64) -> Finding {
        Finding {
            effect,
            there: false,
            true_size: None,
            probability: p,
            status: Status::of(p, true),
            upper_bound: Some(2.0),
            detectable: Some(4.0),
            named: false,
            of_other_order: false,
            size: None,
            interval_95: None,
            other_name: None,
            twin: false,
            left_open: false,
        }
    }

    /// An effect that is there with the size 10, and named as 11 +- 2.
    pub(crate) fn named(effect: &'static str, p: f64) -> Finding {
        Finding {
            there: true,
            true_size: Some(10.0),
            named: true,
            size: Some(11.0),
            interval_95: Some([9.0, 13.0]),
            ..absent(effect, p)
        }
    }

    /// The same, but not named.
    pub(crate) fn missed(effect: &'static str, p: f64) -> Finding {
        let change = |own: &mut Finding| {
            (own.named, own.size, own.interval_95) = (false, None, None);
        };
        named(effect, p).with(change)
    }

    impl Finding {
        pub(crate) fn with(mut self, change: impl Fn(&mut Self)) -> Self {
            change(&mut self);
            self
        }
    }

    pub(crate) fn answer(
        group: Group,
        verdict: DiagnosisVerdict,
        findings: Vec<Finding>,
    ) -> Answer {
        let case = Case {
            group,
            excitation: Excitation::Rich,
            hidden: vec!["cogging"],
            right: vec![],
            seed: 1,
            seconds: 12.0,
        };
        Answer {
            outcome: Outcome::Right,
            verdict: Some(verdict),
            sufficient: true,
            findings,
            ..Answer::failed(&case, String::new())
        }
    }
}

/// One parameter of one machine, with every named effect in the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ParameterFinding {
    #[serde(serialize_with = "key")]
    pub parameter: MotorKey,
    pub truth: f64,
    pub value: f64,
    pub std: f64,
    pub verdict: Verdict,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "the signature that serde asks for")]
fn key<S: serde::Serializer>(parameter: &MotorKey, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(parameter.key())
}

/// Standard deviations on either side of a value: its 95 % interval.
pub(super) const INTERVAL_SIGMAS: f64 = 1.96;

impl ParameterFinding {
    /// By how many of its standard deviations the value is off.
    fn sigmas(&self) -> f64 {
        (self.value - self.truth) / self.std
    }
}

/// What a motor was made of.
pub(super) const fn truths(motor: &MotorTruth) -> [(MotorKey, f64); 5] {
    [
        (MotorKey::Resistance, motor.resistance_ohm),
        (MotorKey::Inductance, motor.inductance_h),
        (MotorKey::BackEmf, motor.back_emf_v_s_per_rad),
        (MotorKey::Inertia, motor.inertia_kg_m2),
        (MotorKey::LoadTorque, motor.load_torque_n_m),
    ]
}

/// The motor's parameters in a diagnosis; none that the runs leave undetermined.
pub(super) fn parameters_of(motor: &MotorTruth, diagnosis: &Diagnosis) -> Vec<ParameterFinding> {
    let found = truths(motor).into_iter().filter_map(|(parameter, truth)| {
        let estimates = &diagnosis.model.parameters;
        let own = estimates.iter().find(|own| own.key == parameter.key())?;
        Some(ParameterFinding {
            parameter,
            truth,
            value: own.value?,
            std: own.std?,
            verdict: own.verdict,
        })
    });
    found.collect()
}

/// What the settled values of one parameter are worth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Coverage {
    #[serde(serialize_with = "key")]
    pub parameter: MotorKey,
    /// Intervals that hold the truth, of those of settled values.
    pub hold: Bounded,
    /// Machines on which it was not settled.
    pub not_settled: usize,
    /// Root mean square of the errors in their standard deviations: one where the intervals are right.
    pub spread: Option<f64>,
    /// Medians of the error and of its standard deviation, %.
    pub error_percent: Option<f64>,
    pub std_percent: Option<f64>,
}

pub fn coverage(answers: &[&Answer]) -> Vec<Coverage> {
    let all = answers.iter().flat_map(|answer| &answer.parameters);
    coverage_of(&all.collect::<Vec<_>>())
}

/// The same over what was found, of whatever machines.
pub fn coverage_of(found: &[&ParameterFinding]) -> Vec<Coverage> {
    let of_parameter = |parameter: MotorKey| {
        let (settled, open): (Vec<&ParameterFinding>, Vec<&ParameterFinding>) = found
            .iter()
            .copied()
            .filter(|own| own.parameter == parameter)
            .partition(|own| own.verdict == Verdict::Settled && own.std > 0.0);
        let holds = |own: &&&ParameterFinding| own.sigmas().abs() <= INTERVAL_SIGMAS;
        let squares: f64 = settled.iter().map(|own| own.sigmas().powi(2)).sum();
        let is_some = !settled.is_empty();
        let share = |of: fn(&ParameterFinding) -> f64| {
            let shares = settled.iter().map(|own| 100.0 * of(own) / own.truth);
            is_some.then(|| median(&shares.collect::<Vec<_>>()))
        };
        Coverage {
            parameter,
            hold: Bounded::new(settled.iter().filter(holds).count(), settled.len()),
            not_settled: open.len(),
            spread: is_some.then(|| (squares / settled.len() as f64).sqrt()),
            error_percent: share(|own| (own.value - own.truth).abs()),
            std_percent: share(|own| own.std),
        }
    };
    KEYS.into_iter().map(of_parameter).collect()
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Tally {
    pub sets: usize,
    pub right: usize,
    pub twin: usize,
    pub ambiguous: usize,
    pub partial: usize,
    pub not_excited: usize,
    pub abstained: usize,
    pub wrong: usize,
    pub failed: usize,
}

impl Tally {
    pub fn of<'a>(answers: impl IntoIterator<Item = &'a Answer>) -> Self {
        Self::of_outcomes(answers.into_iter().map(|answer| answer.outcome))
    }

    pub fn of_outcomes(outcomes: impl IntoIterator<Item = Outcome>) -> Self {
        let mut tally = Self::default();
        for outcome in outcomes {
            tally.sets += 1;
            *match outcome {
                Outcome::Right => &mut tally.right,
                Outcome::Twin => &mut tally.twin,
                Outcome::Ambiguous => &mut tally.ambiguous,
                Outcome::Partial => &mut tally.partial,
                Outcome::NotExcited => &mut tally.not_excited,
                Outcome::Abstained => &mut tally.abstained,
                Outcome::Wrong => &mut tally.wrong,
                Outcome::Failed => &mut tally.failed,
            } += 1;
        }
        tally
    }

    pub fn wrong_share(self) -> Bounded {
        Bounded::new(self.wrong, self.sets)
    }
}

/// A share with the bound that the count allows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bounded {
    pub count: usize,
    pub of: usize,
    /// One-sided 95 % bounds of Clopper and Pearson, %. None of n still allows about 3/n.
    pub lower_percent: f64,
    pub upper_percent: f64,
}

impl Bounded {
    pub fn new(count: usize, of: usize) -> Self {
        let beta = |a: usize, b: usize, p: f64| {
            Beta::new(a as f64, b as f64).map_or(f64::NAN, |beta| 100.0 * beta.inverse_cdf(p))
        };
        let lower = |count: usize| beta(count, of + 1 - count, 0.05);
        let upper = |count: usize| beta(count + 1, of - count, 0.95);
        Self {
            count,
            of,
            lower_percent: if count == 0 { 0.0 } else { lower(count) },
            upper_percent: if count >= of { 100.0 } else { upper(count) },
        }
    }
}

/// What there is, once each, in the order in which it comes.
pub fn distinct<T: PartialEq>(all: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut found = Vec::new();
    for one in all {
        if !found.contains(&one) {
            found.push(one);
        }
    }
    found
}

/// Counts of every group and excitation, in the order in which they come.
pub(super) fn counts(answers: &[Answer]) -> Vec<GroupCount> {
    let cells = distinct(answers.iter().map(|a| (a.group, a.excitation))).into_iter();
    let count = |(group, excitation): (Group, &'static str)| {
        let of_cell = |a: &&Answer| a.group == group && a.excitation == excitation;
        GroupCount { group, excitation, tally: Tally::of(answers.iter().filter(of_cell)) }
    };
    cells.map(count).collect()
}

/// Medians of the held-out error before and after, in units of the noise floor; none without answers.
pub fn median_errors(errors: impl IntoIterator<Item = (f64, f64)>) -> Option<(f64, f64)> {
    let (before, after): (Vec<f64>, Vec<f64>) = errors.into_iter().unzip();
    (!before.is_empty()).then(|| (median(&before), median(&after)))
}

/// Rows: what was hidden. Columns: what was answered.
#[derive(Clone, Debug, Serialize)]
pub struct Matrix {
    pub rows: Vec<String>,
    pub columns: Vec<&'static str>,
    pub counts: Vec<Vec<usize>>,
}

/// Of the single effects, of nothing, and of what is in no catalogue.
pub fn matrix(answers: &[Answer]) -> Matrix {
    let counts = |a: &&Answer| matches!(a.group, Group::Single | Group::Null | Group::Unknown);
    let counted: Vec<&Answer> = answers.iter().filter(counts).collect();
    let rows = distinct(counted.iter().map(|answer| answer.class.clone()));
    let columns = distinct(known().into_iter().chain(counted.iter().map(|answer| answer.column())));
    let count = |row: &String, column: &str| {
        let is = |answer: &&&Answer| answer.class == *row && answer.column() == column;
        counted.iter().filter(is).count()
    };
    let of_row = |row| columns.iter().map(|column| count(row, column)).collect();
    let counts = rows.iter().map(of_row).collect();
    Matrix { rows, columns, counts }
}

#[cfg(test)]
mod tests {
    use super::super::Group;
    use super::by_hand::{absent, answer, missed, named};
    use super::*;
    use drivebench::diagnosis::DiagnosisVerdict;

    fn of(findings: Vec<Finding>) -> Calibration {
        Calibration::of(&[answer(Group::Single, DiagnosisVerdict::Effect, findings)])
    }

    fn counts(share: Bounded) -> (usize, usize) {
        (share.count, share.of)
    }

    #[test]
    fn bins_hold_what_was_given_between_their_edges() {
        let all = of(vec![
            absent("backlash", 0.0),
            absent("supply_sag", 0.019),
            absent("constant_load", 0.02),
            named("viscous_friction", 0.9),
            named("cogging", 0.98),
            named("eccentric_load", 1.0),
        ]);
        let found: Vec<_> = all.bins.iter().map(|bin| counts(bin.there)).collect();
        assert_eq!(found, [(0, 2), (0, 1), (0, 0), (0, 0), (1, 1), (2, 2)]);
        assert!((all.bins[0].mean.unwrap() - 0.0095).abs() < 1e-12);
        assert_eq!(all.bins[2].mean, None);
        // Squares of 0, 0.019, 0.02, 0.1, 0.02, 0.
        let squares = 0.019_f64.powi(2) + 2.0 * 0.02_f64.powi(2) + 0.01;
        assert!((all.brier.unwrap() - squares / 6.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_there_and_unnamed_is_counted_by_what_was_said_of_it() {
        let missed = |p: f64, upper_bound, detectable| {
            missed("cogging", p).with(|own| {
                (own.upper_bound, own.detectable) = (upper_bound, detectable);
            })
        };
        let shows = Some(4.0);
        let all = of(vec![
            // 10 is there: at most 2, 4 would have shown.
            missed(0.01, Some(2.0), shows),
            // At most 9 is too little, and no more than an estimate may miss.
            missed(0.05, Some(9.0), None),
            missed(0.3, Some(12.0), Some(15.0)),
            missed(0.4, None, shows).with(|own| own.twin = true),
            missed(0.4, None, shows).with(|own| own.left_open = true),
            missed(0.1, None, None).with(|own| own.status = Status::NotExcited),
            // Named under the other right name: nothing was missed.
            missed(0.01, Some(2.0), shows).with(|own| own.other_name = Some("viscous_friction")),
            named("cogging", 0.99).with(|own| own.of_other_order = true),
            named("eccentric_load", 0.99),
        ]);
        assert_eq!(counts(all.recalled), (2, 9));
        let instead =
            Missed { twin: 1, open: 1, possible: 1, ruled_out: 2, not_excited: 1, other_order: 1 };
        assert_eq!(all.missed, instead);
        assert_eq!(counts(all.falsely_ruled_out), (1, 9));
        // Four bounds: the wave of another order has one too.
        assert_eq!(counts(all.bounds_hold), (1, 4));
        // The first, the twin, what was left open and the other wave, each with 4 that would have shown.
        assert_eq!(counts(all.should_have_shown), (4, 9));
        // The wave of another order is no effect that is there under its probability.
        assert_eq!(counts(all.bins[5].there), (1, 2));
        assert_eq!(counts(all.false_names), (1, 2));
    }

    #[test]
    fn false_names_and_twins_among_them_are_counted() {
        let falsely = || absent("quadratic_load", 0.8).with(|own| own.named = true);
        let all = of(vec![
            falsely(),
            falsely().with(|own| own.twin = true),
            falsely().with(|own| (own.twin, own.left_open) = (true, true)),
            named("viscous_friction", 0.95),
        ]);
        assert_eq!(counts(all.false_names), (3, 4));
        assert_eq!((all.false_twins, all.false_but_open), (2, 1));
    }

    #[test]
    fn bounds_of_what_is_absent_and_sizes_of_what_is_named() {
        let all = of(vec![
            absent("backlash", 0.01),
            absent("supply_sag", 0.2),
            absent("load_step", 0.1).with(|own| own.status = Status::NotExcited),
            named("cogging", 0.99),
            named("eccentric_load", 0.99).with(|own| own.interval_95 = Some([10.5, 11.5])),
            named("elastic_coupling", 0.99).with(|own| own.true_size = None),
        ]);
        assert_eq!(counts(all.absent_ruled_out), (1, 2));
        assert!((all.bound_over_detectable.unwrap() - 0.5).abs() < 1e-12);
        assert_eq!(counts(all.intervals_hold), (1, 2));
        assert!((all.size_error.unwrap() - 0.1).abs() < 1e-12);
    }

    #[test]
    fn sizes_are_those_of_right_names_by_effect_with_their_sign() {
        let smaller = || {
            named("cogging", 0.99).with(|own| {
                (own.size, own.interval_95) = (Some(8.0), Some([7.0, 9.0]));
            })
        };
        let answer = |group, findings| answer(group, DiagnosisVerdict::Effect, findings);
        let both = vec![named("cogging", 1.0), absent("backlash", 0.0)];
        let answers = [
            answer(Group::Single, both),
            answer(Group::Harsh, vec![smaller()]),
            answer(Group::Harsh, vec![smaller()]),
        ];
        let [only] = &sizes(&answers)[..] else {
            panic!("backlash has no size");
        };
        assert_eq!((only.effect, counts(only.intervals_hold)), ("cogging", (1, 3)));
        assert!((only.error.unwrap() + 0.2).abs() < 1e-12);
    }

    #[test]
    fn a_verdict_is_false_only_where_it_could_be_otherwise() {
        let hidden = || vec![named("cogging", 0.05).with(|own| own.named = false)];
        let unseen = named("cogging", 0.05).with(|own| {
            (own.named, own.status) = (false, Status::NotExcited);
        });
        let absent = || vec![absent("cogging", 0.0)];
        let (none, unexplained) = (DiagnosisVerdict::None, DiagnosisVerdict::Unexplained);
        let all = Calibration::of(&[
            answer(Group::Single, none, hidden()),
            answer(Group::Single, none, vec![unseen]),
            answer(Group::Null, none, absent()),
            answer(Group::Unknown, none, absent()),
            answer(Group::Unknown, unexplained, absent()),
            answer(Group::Harsh, unexplained, hidden()),
            answer(Group::Pair, unexplained, hidden()),
        ]);
        // The first and the unknown, of those with a detectable effect; the pair, of those that the catalogue explains.
        assert_eq!(counts(all.false_none), (2, 5));
        assert_eq!(counts(all.false_unexplained), (1, 4));
        assert_eq!(all.sets, 7);
    }

    #[test]
    fn only_settled_values_count_and_each_by_its_own_interval() {
        let found = |value: f64, verdict: Verdict| ParameterFinding {
            parameter: MotorKey::Inertia,
            truth: 2.0,
            value,
            std: 0.1,
            verdict,
        };
        // 1 and 3 standard deviations off, and 50 with an estimate that is not settled.
        let answer = Answer {
            parameters: vec![
                found(2.1, Verdict::Settled),
                found(1.7, Verdict::Settled),
                found(7.0, Verdict::Searching),
            ],
            ..answer(Group::Single, DiagnosisVerdict::Effect, vec![])
        };
        let all = coverage(&[&answer]);
        let own = all.iter().find(|own| own.parameter == MotorKey::Inertia);
        let own = own.unwrap();
        assert_eq!((own.hold.count, own.hold.of, own.not_settled), (1, 2, 1));
        assert!((own.spread.unwrap() - 5_f64.sqrt()).abs() < 1e-9);
        assert!((own.std_percent.unwrap() - 5.0).abs() < 1e-9);
        assert!(all[0].spread.is_none() && all[0].hold.of == 0);
    }

    #[test]
    fn none_of_many_bounds_as_the_rule_of_three() {
        let none = Bounded::new(0, 240);
        // 1 - 0.05^(1/240)
        assert!((none.upper_percent - 1.240).abs() < 2e-3, "{none:?}");
        assert!(none.lower_percent.abs() < 1e-12);
        let all = Bounded::new(240, 240);
        assert!((all.lower_percent - (100.0 - none.upper_percent)).abs() < 1e-6);
        assert!((all.upper_percent - 100.0).abs() < 1e-12);
    }

    #[test]
    fn bounds_agree_with_the_binomial_sum() {
        // The upper bound is the share at which 3 or fewer of 20 come in 5 % of cases.
        let share = Bounded::new(3, 20).upper_percent / 100.0;
        let choose = [1.0, 20.0, 190.0, 1140.0];
        let ways = (0..).zip(choose);
        let sum: f64 =
            ways.map(|(k, ways)| ways * share.powi(k) * (1.0 - share).powi(20 - k)).sum();
        assert!((sum - 0.05).abs() < 1e-6, "{sum}");
    }
}
