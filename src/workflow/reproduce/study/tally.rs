//! Counts of outcomes with Clopper-Pearson bounds, and the confusion matrix.

use serde::Serialize;
use statrs::distribution::{Beta, ContinuousCDF};

use super::judge::known;
use super::{Answer, Group, GroupCount, Outcome};
use crate::numerics::statistics::median;

/// Counts of outcomes.
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
    let mut seen = Vec::new();
    for one in all {
        if !seen.contains(&one) {
            seen.push(one);
        }
    }
    seen
}

/// Counts of every group and excitation, in the order in which they come.
pub(super) fn counts(answers: &[Answer]) -> Vec<GroupCount> {
    let cells = distinct(answers.iter().map(|a| (a.group, a.excitation))).into_iter();
    let count = |(group, excitation): (Group, &'static str)| {
        let of_cell = |a: &&Answer| a.group == group && a.excitation == excitation;
        GroupCount {
            group,
            excitation,
            tally: Tally::of(answers.iter().filter(of_cell)),
        }
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
    let columns = distinct(known().chain(counted.iter().map(|answer| answer.column())));
    let count = |row: &String, column: &str| {
        let is = |answer: &&&Answer| answer.class == *row && answer.column() == column;
        counted.iter().filter(is).count()
    };
    let of_row = |row| columns.iter().map(|column| count(row, column)).collect();
    let counts = rows.iter().map(of_row).collect();
    Matrix {
        rows,
        columns,
        counts,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let sum: f64 = ways
            .map(|(k, ways)| ways * share.powi(k) * (1.0 - share).powi(20 - k))
            .sum();
        assert!((sum - 0.05).abs() < 1e-6, "{sum}");
    }
}
