//! Posterior over all sets of effects and forms: spike-and-slab selection (George and McCulloch, J. Am. Stat. Assoc. 88, 1993).
//!
//! Beforehand the size of an effect that is in a set is normal with a deviation of one slab, that of one that is out with the
//! small deviation of a spike. The motor's parameters and the spikes are integrated out first. A set's log evidence is
//! `b'(G+I)^-1 b / 2 - log det(G+I) / 2`, with `log 2 Phi(m/s)` for effects whose sign is known.
//!
//! The sets are not sampled. From each of the best ones all that differ by one effect added, taken out or exchanged are weighed
//! (the neighbourhood of the shotgun stochastic search of Hans, Dobra and West, J. Am. Stat. Assoc. 102, 2007), down to Occam's
//! window (Madigan and Raftery, J. Am. Stat. Assoc. 89, 1994). The probability of an effect is its share among all sets weighed.

use std::collections::{BTreeSet, HashMap};

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use statrs::function::erf::erfc;

use super::columns::{ColumnInformation, Linear, Variant};

/// Deviation of the spike, in slabs: below, an effect counts as not there.
const SPIKE_SLABS: f64 = 0.004;
/// Sets from which neighbours are looked at, at most, and how far behind the best they may be, nats.
const MOST_EXPANDED: usize = 60;
const WINDOW_NATS: f64 = 6.0;

/// How far behind the best a set may be and still be plausible, nats.
const PLAUSIBLE_NATS: f64 = 7.0;

/// For each candidate, the variant that is in.
pub(super) type Set = Vec<Option<usize>>;

#[derive(Clone, Debug)]
pub(super) struct Posterior {
    pub probability: Vec<f64>,
    pub best: Set,
    /// Log of the odds of each candidate given the rest of the best set.
    pub log_factor: Vec<f64>,
    /// Plausible sets with their logarithms, the best first.
    pub sets: Vec<(Set, f64)>,
    /// Likeliest variant of each candidate beside the best set.
    pub forms: Vec<usize>,
}

/// The problem with the motor's parameters integrated out.
pub(super) struct Reduced {
    pub linear: Linear,
    pub gram: DMatrix<f64>,
    pub right: DVector<f64>,
    pub squares: f64,
    /// Prior mean of each column, in its slab.
    pub prior: DVector<f64>,
}

impl Reduced {
    /// `excess` is how many times as large as expected the variance of what the model leaves is.
    pub(super) fn new(linear: Linear, excess: f64, with_spikes: bool) -> Option<Self> {
        let m = linear.nuisances.len();
        let p = linear.gram.nrows();
        let gram = &linear.gram / excess;
        let right = &linear.right / excess;
        // What is always in: the nuisances, and the spike of every effect, since none is exactly zero.
        let nuisances = (0..m).map(|column| (column, linear.precision(column)));
        let mut always: Vec<(usize, f64)> = nuisances.collect();
        for candidate in &linear.candidates {
            if with_spikes && !candidate.is_unknown() {
                // Forms of an event share columns.
                let variants = candidate.variants.iter();
                let columns: BTreeSet<usize> = variants.flat_map(Variant::numbers).collect();
                let spike = 1.0 / (SPIKE_SLABS * SPIKE_SLABS);
                always.extend(columns.into_iter().map(|column| (column, spike)));
            }
        }
        let k = always.len();
        let mut base = DMatrix::from_fn(k, k, |r, c| gram[(always[r].0, always[c].0)]);
        for (d, own) in always.iter().enumerate() {
            base[(d, d)] += own.1;
        }
        let cross = DMatrix::from_fn(k, p - m, |r, c| gram[(always[r].0, m + c)]);
        // With `L L'` the base, what it explains of others is `(L^-1 c)' L^-1 c`: half of a solution.
        let factor = base.cholesky()?.unpack();
        let b = DVector::from_fn(k, |r, _| right[always[r].0]);
        let half = factor.solve_lower_triangular(&cross)?;
        let half_b = factor.solve_lower_triangular(&b)?;
        let squares = linear.squares / excess - half_b.norm_squared();
        let mut prior = DVector::zeros(p - m);
        for candidate in &linear.candidates {
            for variant in &candidate.variants {
                prior[variant.columns[0].at - m] = variant.mean;
            }
        }
        Some(Self {
            prior,
            gram: gram.view((m, m), (p - m, p - m)) - half.transpose() * &half,
            right: right.rows(m, p - m) - half.tr_mul(&half_b),
            squares,
            linear,
        })
    }

    /// The columns of a set, the nuisances not counted.
    pub(super) fn columns(&self, set: &Set) -> Vec<usize> {
        let chosen = set.iter().zip(&self.linear.candidates);
        let variants = chosen.filter_map(|(form, own)| Some(&own.variants[(*form)?]));
        variants.flat_map(|variant| self.own(variant)).collect()
    }

    /// The same of one form.
    fn own(&self, variant: &Variant) -> Vec<usize> {
        let m = self.linear.nuisances.len();
        variant.numbers().map(|column| column - m).collect()
    }

    /// Products of columns with each other.
    fn products(&self, rows: &[usize], columns: &[usize]) -> DMatrix<f64> {
        DMatrix::from_fn(rows.len(), columns.len(), |r, c| {
            self.gram[(rows[r], columns[c])]
        })
    }

    /// Right-hand side of the normal equations of columns, their prior means included.
    fn right_side(&self, columns: &[usize]) -> DVector<f64> {
        DVector::from_fn(columns.len(), |r, _| {
            self.right[columns[r]] + self.prior[columns[r]]
        })
    }

    fn factor(&self, columns: &[usize]) -> Option<(Cholesky<f64, Dyn>, DVector<f64>)> {
        let mut a = self.products(columns, columns);
        for d in 0..columns.len() {
            a[(d, d)] += 1.0;
        }
        Some((a.cholesky()?, self.right_side(columns)))
    }

    /// Mean and covariance of the columns of a set, in slabs.
    pub(super) fn sizes(&self, columns: &[usize]) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let (factor, b) = self.factor(columns)?;
        Some((factor.solve(&b), factor.inverse()))
    }

    /// Log of (evidence times prior) of each variant of a candidate beside the columns of others, relative to none of it.
    pub(super) fn conditional(&self, others: &[usize], candidate: usize) -> Vec<f64> {
        let count = self.linear.candidates[candidate].variants.len();
        let Some((factor, b)) = self.factor(others) else {
            return vec![f64::NEG_INFINITY; count];
        };
        let mean = factor.solve(&b);
        self.beside(others, &factor, &mean, candidate)
    }

    fn beside(
        &self,
        others: &[usize],
        factor: &Cholesky<f64, Dyn>,
        mean: &DVector<f64>,
        candidate: usize,
    ) -> Vec<f64> {
        let c = &self.linear.candidates[candidate];
        let weigh = |variant: &Variant| {
            let own = self.own(variant);
            let cross = self.products(others, &own);
            let mut a = self.products(&own, &own) - cross.tr_mul(&factor.solve(&cross));
            for d in 0..own.len() {
                a[(d, d)] += 1.0;
            }
            let right = self.right_side(&own) - cross.tr_mul(mean);
            let Some(schur) = a.cholesky() else {
                return f64::NEG_INFINITY;
            };
            let size = schur.solve(&right);
            if c.exceeds_linear_range(size[0], variant) {
                return f64::NEG_INFINITY;
            }
            let log_det: f64 = schur.l().diagonal().iter().map(|d| d.ln()).sum();
            let sign = if variant.positive {
                log_positive(size[0], schur.inverse()[(0, 0)].sqrt())
            } else {
                0.0
            };
            0.5 * right.dot(&size) - log_det + variant.log_prior + c.log_odds + sign
                - 0.5 * variant.mean * variant.mean
        };
        c.variants.iter().map(weigh).collect()
    }

    pub(super) fn log_posterior(&self, set: &Set) -> f64 {
        let columns = self.columns(set);
        let Some((factor, b)) = self.factor(&columns) else {
            return f64::NEG_INFINITY;
        };
        let mean = factor.solve(&b);
        let log_det: f64 = factor.l().diagonal().iter().map(|d| d.ln()).sum();
        let mut log = 0.5 * b.dot(&mean) - log_det;
        let mut inverse: Option<DMatrix<f64>> = None;
        let mut at = 0;
        for (variant, candidate) in set.iter().zip(&self.linear.candidates) {
            let Some(v) = variant else { continue };
            let variant = &candidate.variants[*v];
            if candidate.exceeds_linear_range(mean[at], variant) {
                return f64::NEG_INFINITY;
            }
            log += candidate.log_odds + variant.log_prior - 0.5 * variant.mean * variant.mean;
            if variant.positive {
                let inverse = inverse.get_or_insert_with(|| factor.inverse());
                log += log_positive(mean[at], inverse[(at, at)].sqrt());
            }
            at += variant.columns.len();
        }
        log
    }

    /// Log likelihood of the best sizes of these columns, relative to none.
    pub(super) fn log_likelihood(&self, columns: &[usize]) -> f64 {
        let Some((factor, b)) = self.factor(columns) else {
            return f64::NEG_INFINITY;
        };
        0.5 * b.dot(&factor.solve(&b))
    }

    /// Whether no effect of the set would need a size that physics does not allow.
    pub(super) fn signs_are_right(&self, set: &Set) -> bool {
        let Some((mean, _)) = self.sizes(&self.columns(set)) else {
            return false;
        };
        let mut at = 0;
        let mut chosen = set.iter().zip(&self.linear.candidates);
        chosen.all(|(variant, candidate)| {
            let Some(v) = variant else { return true };
            let variant = &candidate.variants[*v];
            let size = mean[at];
            at += variant.columns.len();
            !variant.positive || size > 0.0
        })
    }

    /// Share of the squares that the best form of a candidate alone would take away.
    pub(super) fn share_alone(&self, candidate: usize) -> f64 {
        let explained = |variant: &Variant| {
            let columns = self.own(variant);
            let (mean, _) = self.sizes(&columns)?;
            let parts = columns.iter().zip(mean.iter());
            let parts = parts.map(|(column, mean)| self.right[*column] * mean);
            Some(parts.sum::<f64>())
        };
        let variants = self.linear.candidates[candidate].variants.iter();
        let most = variants.filter_map(explained).fold(0.0, f64::max);
        most / self.squares.max(f64::MIN_POSITIVE)
    }

    /// What the runs say of one column, a slab of which is `unit`, beside others.
    pub(super) fn information(
        &self,
        others: &[usize],
        column: usize,
        unit: f64,
    ) -> ColumnInformation {
        let Some((factor, b)) = self.factor(others) else {
            return ColumnInformation {
                information: 0.0,
                score: 0.0,
                unit,
            };
        };
        let cross = DVector::from_fn(others.len(), |r, _| self.gram[(others[r], column)]);
        let solved = factor.solve(&cross);
        ColumnInformation {
            information: self.gram[(column, column)] - cross.dot(&solved),
            score: self.right[column] - b.dot(&solved),
            unit,
        }
    }

    /// What the odds of a form beside others would be if more of it were in the records.
    pub(super) fn injection(
        &self,
        others: &[usize],
        candidate: usize,
        variant: usize,
    ) -> Option<Injection> {
        let candidate = &self.linear.candidates[candidate];
        let chosen = &candidate.variants[variant];
        let own = self.own(chosen);
        let (factor, _) = self.factor(others)?;
        let cross = self.products(others, &own);
        // Of the form's own information what the others leave, without and with its prior.
        let left = self.products(&own, &own) - cross.tr_mul(&factor.solve(&cross));
        let schur = (&left + DMatrix::identity(own.len(), own.len())).cholesky()?;
        Some(Injection {
            left,
            schur,
            log_prior: chosen.log_prior + candidate.log_odds,
            positive: chosen.positive,
        })
    }

    /// The set without a candidate and without all that it excludes.
    pub(super) fn cleared(&self, set: &Set, candidate: usize) -> Set {
        let mut set = set.clone();
        set[candidate] = None;
        for other in &self.linear.candidates[candidate].excludes {
            set[*other] = None;
        }
        set
    }
}

/// A form beside others, with a given size of it in the records and no noise.
pub(super) struct Injection {
    left: DMatrix<f64>,
    schur: Cholesky<f64, Dyn>,
    log_prior: f64,
    positive: bool,
}

impl Injection {
    /// Log odds with `size` slabs of each column.
    pub(super) fn log_odds(&self, size: &[f64]) -> f64 {
        let added = DVector::from_fn(self.left.nrows(), |r, _| {
            size.get(r).copied().unwrap_or(0.0)
        });
        let right = &self.left * added;
        let mean = self.schur.solve(&right);
        let log_det: f64 = self.schur.l().diagonal().iter().map(|d| d.ln()).sum();
        let sign = if self.positive {
            log_positive(mean[0], self.schur.inverse()[(0, 0)].sqrt())
        } else {
            0.0
        };
        0.5 * right.dot(&mean) - log_det + self.log_prior + sign
    }
}

/// log 2 Phi(mean / sd): how much of a normal density lies on the side that physics allows.
fn log_positive(mean: f64, sd: f64) -> f64 {
    erfc(-mean / sd / std::f64::consts::SQRT_2).max(1e-300).ln()
}

/// The sets that were looked at.
struct Explored<'a> {
    reduced: &'a Reduced,
    /// Log posterior of each, where it is only reckoned from a neighbour's also.
    weighed: HashMap<Set, f64>,
    /// Log posterior of those whose own was worked out.
    exact: HashMap<Set, f64>,
}

impl Explored<'_> {
    fn exactly(&mut self, set: &Set) -> f64 {
        let reduced = self.reduced;
        *self
            .exact
            .entry(set.clone())
            .or_insert_with(|| reduced.log_posterior(set))
    }

    /// Weighs every set that differs from `set` by one effect put in, taken out or exchanged.
    fn expand(&mut self, set: &Set) {
        let mut bases: Vec<Set> = vec![set.clone()];
        for k in 0..set.len() {
            if set[k].is_some() {
                let mut without = set.clone();
                without[k] = None;
                bases.push(without);
            }
        }
        for from in &bases {
            let log = self.exactly(from);
            self.weighed.insert(from.clone(), log);
            self.put_in(from, log);
        }
    }

    /// Weighs every set with one effect more than `from`, whose log posterior is `log`.
    fn put_in(&mut self, from: &Set, log: f64) {
        let reduced = self.reduced;
        let columns = reduced.columns(from);
        let Some((factor, b)) = reduced.factor(&columns) else {
            return;
        };
        let mean = factor.solve(&b);
        for (k, candidate) in reduced.linear.candidates.iter().enumerate() {
            if from[k].is_some() {
                continue;
            }
            let excludes = candidate.excludes.iter().any(|o| from[*o].is_some());
            let (next, log, logs) = if excludes {
                let cleared = reduced.cleared(from, k);
                let log = self.exactly(&cleared);
                let logs = reduced.conditional(&reduced.columns(&cleared), k);
                (cleared, log, logs)
            } else {
                let logs = reduced.beside(&columns, &factor, &mean, k);
                (from.clone(), log, logs)
            };
            for (v, gain) in logs.iter().enumerate() {
                let mut with = next.clone();
                with[k] = Some(v);
                self.weighed.entry(with).or_insert(log + gain);
            }
        }
    }

    /// The best set that was not expanded yet, as long as it is near the best of all.
    fn next(&self) -> Option<Set> {
        let logs = self.weighed.values().copied();
        let top = logs.fold(f64::NEG_INFINITY, f64::max);
        let is_open =
            |(set, log): &(&Set, &f64)| **log > top - WINDOW_NATS && !self.exact.contains_key(*set);
        let open = self.weighed.iter().filter(is_open);
        let best = open.max_by(|a, b| a.1.total_cmp(b.1).then_with(|| b.0.cmp(a.0)));
        best.map(|(set, _)| set.clone())
    }
}

/// Finds the plausible sets, from each of `starts` on.
pub(super) fn select(reduced: &Reduced, starts: &[Set]) -> Posterior {
    let n = reduced.linear.candidates.len();
    let mut explored = Explored {
        reduced,
        weighed: HashMap::new(),
        exact: HashMap::new(),
    };
    for start in starts {
        let log = explored.exactly(start);
        explored.weighed.insert(start.clone(), log);
    }
    let mut queue: Vec<Set> = starts.to_vec();
    for _ in 0..MOST_EXPANDED {
        let Some(set) = queue.pop().or_else(|| explored.next()) else {
            break;
        };
        explored.expand(&set);
    }
    let mut sets: Vec<(Set, f64)> = explored.weighed.into_iter().collect();
    sets.sort_by(|a, b| b.1.total_cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
    let (best, best_log) = sets[0].clone();
    let total: f64 = sets.iter().map(|s| (s.1 - best_log).exp()).sum();
    let mut probability = vec![0.0; n];
    for (set, log) in &sets {
        let share = (log - best_log).exp() / total;
        for (probability, chosen) in probability.iter_mut().zip(set) {
            if chosen.is_some() {
                *probability += share;
            }
        }
    }
    let mut log_factor = Vec::with_capacity(n);
    let mut forms = Vec::with_capacity(n);
    for k in 0..n {
        let others = reduced.cleared(&best, k);
        let logs = reduced.conditional(&reduced.columns(&others), k);
        let top = (0..logs.len()).max_by(|a, b| logs[*a].total_cmp(&logs[*b]));
        let top = top.unwrap_or(0);
        log_factor.push(logs[top]);
        forms.push(top);
    }
    sets.retain(|s| s.1 > best_log - PLAUSIBLE_NATS);
    Posterior {
        probability,
        best,
        log_factor,
        sets,
        forms,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joint::columns::{Candidate, Column};
    use drivebench_model::plant::effect;

    /// One column for each candidate, with this normal matrix and these products with the residual.
    fn linear(gram: &[&[f64]], right: &[f64]) -> Linear {
        let n = right.len();
        let candidate = |column: usize| {
            let id = ["viscous_friction", "quadratic_load", "voltage_drop"][column];
            Candidate {
                id,
                effect: effect::find(id),
                log_odds: (0.1_f64 / 0.9).ln(),
                variants: vec![Variant {
                    columns: vec![Column {
                        at: column,
                        ..Column::of(Some(0), 1.0, 0.0)
                    }],
                    values: vec![1.0],
                    ..Variant::default()
                }],
                ..Candidate::default()
            }
        };
        Linear {
            nuisances: vec![],
            candidates: (0..n).map(candidate).collect(),
            gram: DMatrix::from_fn(n, n, |r, c| gram[r][c]),
            right: DVector::from_column_slice(right),
            squares: 1000.0,
            columns: vec![],
            present: DVector::zeros(n),
        }
    }

    fn weighed(linear: &Linear) -> Posterior {
        let nothing = vec![None; linear.candidates.len()];
        let reduced = Reduced::new(linear.clone(), 1.0, false).unwrap();
        select(&reduced, &[nothing])
    }

    #[test]
    fn one_effect_alone_has_the_odds_of_the_closed_form() {
        for (g, b) in [(0.0, 0.0), (50.0, 3.0), (400.0, 60.0), (400.0, 75.0)] {
            let found = weighed(&linear(&[&[g]], &[b]));
            let odds = 0.1 / 0.9 * (0.5 * b * b / (g + 1.0)).exp() / (g + 1.0_f64).sqrt();
            let expected = odds / (1.0 + odds);
            let p = found.probability[0];
            assert!((p - expected).abs() < 1e-9, "{g} {b}: {p} {expected}");
        }
    }

    #[test]
    fn two_that_say_the_same_share_what_either_would_have() {
        // The columns are all but one, and the residual lies along both.
        let (g, b) = (1e4, 1e3);
        let found = weighed(&linear(&[&[g, g - 1e-3], &[g - 1e-3, g]], &[b, b]));
        let [one, other] = [found.probability[0], found.probability[1]];
        assert!((one - other).abs() < 1e-6, "{one} {other}");
        // Either alone nearly always, both sometimes: nothing speaks against it but the prior.
        assert!((0.5..0.6).contains(&one), "{one}");
        let alone = weighed(&linear(&[&[g]], &[b]));
        assert!(alone.probability[0] > 0.999);
    }

    #[test]
    fn what_a_strong_effect_would_hide_is_found_beside_it() {
        // Judged alone the second has nothing to say: what it adds lies across what the first leaves.
        let gram: &[&[f64]] = &[&[1e4, 6e3, 0.0], &[6e3, 1e4, 0.0], &[0.0, 0.0, 1e4]];
        let truth = DVector::from_column_slice(&[0.5, -0.3, 0.0]);
        let mut data = linear(gram, &[0.0; 3]);
        data.right = &data.gram * truth;
        assert!(data.right[1].abs() < 1e-9);
        let found = weighed(&data);
        assert!(found.probability[0] > 0.999 && found.probability[1] > 0.999);
        assert!(found.probability[2] < 0.01, "{:?}", found.probability);
    }

    #[test]
    fn a_sign_that_physics_forbids_takes_its_odds() {
        let mut data = linear(&[&[400.0]], &[-60.0]);
        assert!(weighed(&data).probability[0] > 0.3);
        data.candidates[0].variants[0].positive = true;
        assert!(weighed(&data).probability[0] < 0.01);
    }

    #[test]
    fn a_hair_of_everything_is_no_effect() {
        // Fifty standard deviations from zero, and yet no more than a thousandth of its slab.
        let g = 2.5e9;
        let data = linear(&[&[g]], &[1e-3 * g]);
        let bare = Reduced::new(data.clone(), 1.0, false).unwrap();
        assert!(select(&bare, &[vec![None]]).probability[0] > 0.999);
        let real = Reduced::new(data, 1.0, true).unwrap();
        assert!(select(&real, &[vec![None]]).probability[0] < 0.1);
    }

    #[test]
    fn what_the_model_has_wholly_is_not_thrown_out_because_its_shape_is_off() {
        let (mean, g) = (1.0 / 0.15, 400.0);
        let mut data = linear(&[&[g]], &[1.8 * mean * g]);
        data.candidates[0].variants[0].mean = mean;
        assert!(weighed(&data).probability[0] < 1e-6);
        // Its shapes bend what they do: what asks for more than all of it asks for another fit.
        data.candidates[0].in_model = true;
        assert!(weighed(&data).probability[0] > 0.999);
    }

    #[test]
    fn what_is_there_wholly_or_not_at_all_is_not_there_by_halves() {
        let mean = 1.0 / 0.15;
        let at = |share: f64| {
            let g = 400.0;
            let mut data = linear(&[&[g]], &[share * mean * g]);
            data.candidates[0].variants[0].mean = mean;
            weighed(&data).probability[0]
        };
        assert!(at(1.0) > 0.999, "{}", at(1.0));
        assert!(at(0.2) < 1e-6, "{}", at(0.2));
        assert!(at(0.0) < 1e-6);
    }
}
