//! The result of a suite: a verdict for each case and repeat, the figures that were judged with their spread, and the exit
//! status.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Case;
use crate::report::wording::json;
use drivebench_bench::recording::Machine;
use drivebench_identify::drift::Drift;
use drivebench_model::numerics::statistics::{extent, mean, variance};

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "verdict", content = "reason", rename_all = "snake_case")]
pub enum Verdict {
    Passed,
    /// A limit, or an exit status, was not what it has to be.
    Failed(String),
    /// It could not be judged: a step did not end in its time, or failed in itself.
    Error(String),
    Skipped(String),
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    pub key: String,
    /// `null` where it is no number.
    pub value: Option<f64>,
    /// What was found and what it has to be, where it is not that.
    pub failure: Option<String>,
}

/// What a step that identifies found, for suites that are compared with this one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IdentifiedStep {
    pub machine: Machine,
    /// Checksum of the excitation; empty where it is not known.
    pub excitation: String,
    /// As `identify --json` has them.
    pub parameters: Value,
    /// What has changed since the baseline; null where there is none.
    #[serde(skip_deserializing, serialize_with = "json::drifted")]
    pub drift: Option<Drift>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepOutcome {
    pub name: String,
    /// The command as a shell takes it; empty where the step is none.
    pub command: String,
    pub status: Option<u8>,
    pub took_s: f64,
    pub checks: Vec<Check>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub identified: Option<IdentifiedStep>,
}

/// The hidden and the diagnosed effects of one case.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Answered {
    pub hidden: String,
    pub named: String,
}

/// Confusion matrix: hidden effects (rows) against diagnosed ones (columns).
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Confusion {
    /// What was hidden, in the order of the cases.
    pub rows: Vec<String>,
    /// What was named: what is also a row, in that order, then the rest as it came.
    pub columns: Vec<String>,
    /// Answers, row by row.
    pub counts: Vec<Vec<usize>>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CaseOutcome {
    pub name: String,
    pub seed: u64,
    pub tags: Vec<String>,
    #[serde(flatten)]
    pub verdict: Verdict,
    pub took_s: f64,
    /// Exit status of the step that ended it, where it was not expected.
    pub status: Option<u8>,
    /// Folder with its files.
    pub evidence: Option<String>,
    pub steps: Vec<StepOutcome>,
    /// Of each diagnosis of a machine whose truth is known.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub answers: Vec<Answered>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Spread {
    pub case: String,
    pub key: String,
    pub count: usize,
    pub mean: f64,
    /// Sample standard deviation; `null` for one.
    pub std: Option<f64>,
    pub least: f64,
    pub most: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SuiteOutcome {
    pub suite: String,
    pub began: String,
    pub machine: String,
    pub took_s: f64,
    pub passed: usize,
    pub failed: usize,
    pub errors: usize,
    pub skipped: usize,
    pub cases: Vec<CaseOutcome>,
    pub spread: Vec<Spread>,
    #[serde(skip_serializing_if = "Confusion::is_empty")]
    pub confusion: Confusion,
}

impl Confusion {
    fn of(answers: &[&Answered]) -> Self {
        let mut rows: Vec<String> = Vec::new();
        let mut others: Vec<String> = Vec::new();
        let note = |names: &mut Vec<String>, name: &String| {
            if !names.contains(name) {
                names.push(name.clone());
            }
        };
        for answer in answers {
            note(&mut rows, &answer.hidden);
        }
        for answer in answers.iter().filter(|own| !rows.contains(&own.named)) {
            note(&mut others, &answer.named);
        }
        let is_named = |row: &&String| answers.iter().any(|own| own.named == **row);
        let columns: Vec<String> = rows.iter().filter(is_named).cloned().chain(others).collect();
        let count = |row: &String, column: &String| {
            let is_here = |own: &&&Answered| own.hidden == *row && own.named == *column;
            answers.iter().filter(is_here).count()
        };
        let counts =
            rows.iter().map(|row| columns.iter().map(|column| count(row, column)).collect());
        Self { counts: counts.collect(), rows, columns }
    }

    pub const fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// What was hidden, and how often what was named for it: the row's own name first, then the most frequent.
    pub fn named(&self) -> impl Iterator<Item = (&str, Vec<(&str, usize)>)> {
        self.rows.iter().zip(&self.counts).map(|(row, counts)| {
            let columns = self.columns.iter().map(String::as_str);
            let mut named: Vec<(&str, usize)> = columns.zip(counts.iter().copied()).collect();
            named.retain(|(_, count)| *count > 0);
            named.sort_by_key(|(name, count)| (name != row, std::cmp::Reverse(*count)));
            (row.as_str(), named)
        })
    }

    pub fn csv(&self) -> String {
        let line = |first: &str, cells: &mut dyn Iterator<Item = String>| {
            let cells: Vec<String> = cells.collect();
            format!("{first},{}\n", cells.join(","))
        };
        let mut text = line("hidden", &mut self.columns.iter().cloned());
        for (row, counts) in self.rows.iter().zip(&self.counts) {
            text.push_str(&line(row, &mut counts.iter().map(usize::to_string)));
        }
        text
    }
}

impl CaseOutcome {
    pub fn skipped(case: &Case, seed: u64, reason: impl Into<String>) -> Self {
        Self {
            name: case.name.clone(),
            seed,
            tags: case.tags.clone(),
            verdict: Verdict::Skipped(reason.into()),
            took_s: 0.0,
            status: None,
            evidence: None,
            steps: Vec::new(),
            answers: Vec::new(),
        }
    }

    fn figures(&self) -> impl Iterator<Item = (&str, f64)> {
        let checks = self.steps.iter().flat_map(|step| &step.checks);
        checks.filter_map(|check| Some((check.key.as_str(), check.value?)))
    }
}

impl SuiteOutcome {
    pub fn of(
        suite: &str,
        began: String,
        machine: String,
        took_s: f64,
        cases: Vec<CaseOutcome>,
    ) -> Self {
        let count =
            |is: fn(&Verdict) -> bool| cases.iter().filter(|case| is(&case.verdict)).count();
        Self {
            suite: suite.to_owned(),
            began,
            machine,
            took_s,
            passed: count(|verdict| *verdict == Verdict::Passed),
            failed: count(|verdict| matches!(verdict, Verdict::Failed(_))),
            errors: count(|verdict| matches!(verdict, Verdict::Error(_))),
            skipped: count(|verdict| matches!(verdict, Verdict::Skipped(_))),
            spread: spread(&cases),
            confusion: Confusion::of(
                &cases.iter().flat_map(|case| &case.answers).collect::<Vec<_>>(),
            ),
            cases,
        }
    }

    /// 0 where no case failed; the status of the steps that ended cases in error, where it is the same for all; else 1.
    pub fn exit_status(&self) -> u8 {
        if self.failed + self.errors == 0 {
            return 0;
        }
        if self.failed > 0 {
            return 1;
        }
        let in_error = self.cases.iter().filter(|case| matches!(case.verdict, Verdict::Error(_)));
        let mut statuses = in_error.map(|case| case.status.unwrap_or(1));
        let first = statuses.next().unwrap_or(1);
        if statuses.all(|status| status == first) { first } else { 1 }
    }
}

/// In the order in which cases and figures first come.
fn spread(cases: &[CaseOutcome]) -> Vec<Spread> {
    let mut figures: Vec<(&str, &str, Vec<f64>)> = Vec::new();
    for case in cases {
        for (key, value) in case.figures() {
            let same =
                |(name, at, _): &&mut (&str, &str, Vec<f64>)| *name == case.name && *at == key;
            match figures.iter_mut().find(same) {
                Some((.., values)) => values.push(value),
                None => figures.push((&case.name, key, vec![value])),
            }
        }
    }
    let summed = |(case, key, values): (&str, &str, Vec<f64>)| {
        let count = values.len();
        let (least, most) = extent(&values);
        Spread {
            case: case.to_owned(),
            key: key.to_owned(),
            count,
            mean: mean(&values),
            std: (count > 1).then(|| variance(&values).sqrt()),
            least,
            most,
        }
    };
    figures.into_iter().map(summed).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(name: &str, verdict: Verdict, status: Option<u8>, value: Option<f64>) -> CaseOutcome {
        CaseOutcome {
            name: name.into(),
            seed: 1,
            tags: Vec::new(),
            verdict,
            took_s: 1.0,
            status,
            evidence: None,
            steps: vec![StepOutcome {
                name: "assert".into(),
                command: String::new(),
                status: None,
                took_s: 0.0,
                checks: vec![Check { key: "resistance_ohm".into(), value, failure: None }],
                identified: None,
            }],
            answers: Vec::new(),
        }
    }

    fn outcome(cases: Vec<CaseOutcome>) -> SuiteOutcome {
        SuiteOutcome::of("s", String::new(), String::new(), 1.0, cases)
    }

    #[test]
    fn the_status_distinguishes_a_limit_from_a_link() {
        let passed = || case("a", Verdict::Passed, None, None);
        let failed = || case("b", Verdict::Failed("high".into()), Some(0), None);
        let error = |status| case("c", Verdict::Error("no answer".into()), Some(status), None);
        let skipped = || case("d", Verdict::Skipped("sim:".into()), None, None);
        for (cases, status) in [
            (vec![passed(), skipped()], 0),
            (vec![], 0),
            (vec![passed(), failed(), error(3)], 1),
            (vec![passed(), error(3), error(3)], 3),
            (vec![error(3), error(4)], 1),
        ] {
            assert_eq!(outcome(cases).exit_status(), status);
        }
        let all = outcome(vec![passed(), failed(), error(3), skipped()]);
        assert_eq!((all.passed, all.failed, all.errors, all.skipped), (1, 1, 1, 1));
    }

    #[test]
    fn repeats_have_a_spread_and_a_single_case_has_none() {
        let of = |name, value| case(name, Verdict::Passed, None, Some(value));
        let found = outcome(vec![of("a", 1.0), of("b", 5.0), of("a", 3.0)]).spread;
        assert_eq!(found.len(), 2);
        let a = &found[0];
        assert_eq!((a.count, a.mean, a.least, a.most), (2, 2.0, 1.0, 3.0));
        assert_eq!(a.std, Some(std::f64::consts::SQRT_2));
        assert_eq!(found[1].std, None);
    }

    #[test]
    fn answers_are_counted_by_what_was_hidden_and_what_was_named() {
        let mut cases = Vec::new();
        for (hidden, named) in [
            ("cogging", "cogging"),
            ("backlash", "(ambiguous)"),
            ("cogging", "torque_ripple"),
            ("cogging", "cogging"),
            ("torque_ripple", "torque_ripple"),
        ] {
            let mut one = case(hidden, Verdict::Passed, None, None);
            let (hidden, named) = (hidden.to_owned(), named.to_owned());
            one.answers.push(Answered { hidden, named });
            cases.push(one);
        }
        let found = outcome(cases).confusion;
        assert_eq!(
            found.csv(),
            "hidden,cogging,torque_ripple,(ambiguous)\ncogging,2,1,0\nbacklash,0,0,1\ntorque_ripple,0,1,0\n"
        );
        let rows: Vec<_> = found.named().collect();
        assert_eq!(rows[0], ("cogging", vec![("cogging", 2), ("torque_ripple", 1)]));
        assert_eq!(rows[1], ("backlash", vec![("(ambiguous)", 1)]));
        assert!(outcome(vec![case("a", Verdict::Passed, None, None)]).confusion.is_empty());
    }
}
