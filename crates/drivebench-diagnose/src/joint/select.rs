//! Posterior over all sets of effects and forms: spike-and-slab selection (George and McCulloch, J. Am. Stat. Assoc. 88, 1993).
//!
//! Prior: the size of an effect in the set is normal with a deviation of one slab, of an effect outside with the small deviation
//! of a spike. The motor's parameters and the spikes are integrated out first. The log evidence of a set is
//! `b'(G+I)^-1 b / 2 - log det(G+I) / 2`, with `log 2 Phi(m/s)` for effects whose sign is known.
//!
//! The sets are not sampled. From each of the best ones all that differ by one effect added, taken out or exchanged are weighed
//! (the neighbourhood of the shotgun stochastic search of Hans, Dobra and West, J. Am. Stat. Assoc. 102, 2007), down to Occam's
//! window (Madigan and Raftery, J. Am. Stat. Assoc. 89, 1994). The probability of an effect is its share among all sets weighed.

use std::collections::{BTreeSet, HashMap, HashSet};

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use statrs::function::erf::erfc;

use super::regression::{Base, ColumnInformation, Linear, Variant, half_log_det};

/// Deviation of the spike, in slabs: an effect of this size counts as absent.
const SPIKE_SLABS: f64 = 0.004;
/// Sets whose neighbours are weighed, at most, and how far behind the best they may be, nats; how far plausible ones.
const MOST_EXPANDED: usize = 60;
const WINDOW_NATS: f64 = 6.0;
const PLAUSIBLE_NATS: f64 = 7.0;

/// For each candidate, the variant that is in.
pub(super) type Set = Vec<Option<usize>>;

#[derive(Clone, Debug)]
pub(super) struct Posterior {
    pub(super) probability: Vec<f64>,
    pub(super) best: Set,
    /// Log posterior odds of each candidate given the rest of the best set.
    pub(super) log_factor: Vec<f64>,
    /// Plausible sets with their logarithms, the best first.
    pub(super) sets: Vec<(Set, f64)>,
    /// Likeliest variant of each candidate given the best set.
    pub(super) forms: Vec<usize>,
}

/// Sizes of the columns of a set, in slabs.
pub(super) struct Estimate {
    /// Numbers of the columns among all, the nuisances' first.
    pub(super) columns: Vec<usize>,
    pub(super) mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Estimate {
    /// Mean and variance of the size of a column; none where it is not in the set.
    pub(super) fn of(&self, column: usize) -> Option<(f64, f64)> {
        let at = self.columns.iter().position(|own| *own == column)?;
        Some((self.mean[at], self.covariance[(at, at)]))
    }
}

/// All columns given some of them, whose base is `L L'`: the explained part of a product is that of two columns of `half`.
struct Given {
    /// `L^-1` times the products of the given columns with all, transposed.
    half: DMatrix<f64>,
    /// `L^-1` times the right-hand side of the given columns.
    half_right: DVector<f64>,
}

/// The problem with the motor's parameters integrated out.
pub(super) struct Reduced {
    pub(super) linear: Linear,
    gram: DMatrix<f64>,
    right: DVector<f64>,
    squares: f64,
    /// Prior mean of each column, in its slab.
    pub(super) prior: DVector<f64>,
}

impl Reduced {
    /// `excess`: variance of the residual over that of white noise.
    pub(super) fn new(linear: Linear, excess: f64, with_spikes: bool) -> Option<Self> {
        let m = linear.nuisances.len();
        let p = linear.gram.nrows();
        let gram = &linear.gram / excess;
        let right = &linear.right / excess;
        // Always included: the nuisances, and the spike of every effect.
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
        // With the base `L L'` the explained part is `(L^-1 c)' L^-1 c`: one triangular solution instead of two.
        let factor = base.cholesky()?.unpack();
        let b = DVector::from_fn(k, |r, _| right[always[r].0]);
        let half = factor.solve_lower_triangular(&cross)?;
        let half_b = factor.solve_lower_triangular(&b)?;
        let squares = linear.squares / excess - half_b.norm_squared();
        let mut prior = DVector::zeros(p - m);
        for variant in linear.candidates.iter().flat_map(|own| &own.variants) {
            prior[variant.columns[0].at - m] = variant.mean;
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
        variants.flat_map(|variant| self.column_indices(variant)).collect()
    }

    /// Column indices of one form, the nuisances not counted.
    fn column_indices(&self, variant: &Variant) -> Vec<usize> {
        let m = self.linear.nuisances.len();
        variant.numbers().map(|column| column - m).collect()
    }

    fn products(&self, rows: &[usize], columns: &[usize]) -> DMatrix<f64> {
        DMatrix::from_fn(rows.len(), columns.len(), |r, c| self.gram[(rows[r], columns[c])])
    }

    /// Right-hand side of the normal equations of columns, their prior means included.
    fn right_side(&self, columns: &[usize]) -> DVector<f64> {
        DVector::from_fn(columns.len(), |r, _| self.right[columns[r]] + self.prior[columns[r]])
    }

    /// The normal equations of columns under their slabs.
    fn base(&self, columns: &[usize]) -> Option<Base> {
        let mut a = self.products(columns, columns);
        add_identity(&mut a);
        let factor = a.cholesky()?;
        let right = self.right_side(columns);
        Some(Base { factor, right })
    }

    /// Posterior mean and covariance of the sizes in a set.
    pub(super) fn estimate(&self, set: &Set) -> Option<Estimate> {
        let columns = self.columns(set);
        let Base { factor, right } = self.base(&columns)?;
        let m = self.linear.nuisances.len();
        Some(Estimate {
            columns: columns.into_iter().map(|column| column + m).collect(),
            mean: factor.solve(&right),
            covariance: factor.inverse(),
        })
    }

    /// All columns given those of others.
    fn given(&self, others: &[usize]) -> Option<Given> {
        let Base { factor, right } = self.base(others)?;
        let factor = factor.unpack();
        let half_right = factor.solve_lower_triangular(&right)?;
        // Forward substitution for all columns at once, along the long side of the matrix.
        let mut half = self.gram.select_columns(others);
        for own in 0..others.len() {
            let (before, mut rest) = half.columns_range_pair_mut(0..own, own..);
            let mut column = rest.column_mut(0);
            for (earlier, before) in before.column_iter().enumerate() {
                column.axpy(-factor[(own, earlier)], &before, 1.0);
            }
            column /= factor[(own, own)];
        }
        Some(Given { half, half_right })
    }

    /// Log posterior odds of each variant of a candidate against its absence, given the columns of others.
    pub(super) fn conditional(&self, others: &[usize], candidate: usize) -> Vec<f64> {
        self.log_odds_given(self.given(others).as_ref(), candidate)
    }

    /// The same, given others that may have no solution.
    fn log_odds_given(&self, given: Option<&Given>, candidate: usize) -> Vec<f64> {
        let c = &self.linear.candidates[candidate];
        let Some(given) = given else {
            return vec![f64::NEG_INFINITY; c.variants.len()];
        };
        let weigh = |variant: &Variant| {
            let own = self.column_indices(variant);
            let half = given.half.select_rows(&own);
            let mut a = self.products(&own, &own) - &half * half.transpose();
            add_identity(&mut a);
            let right = self.right_side(&own) - half * &given.half_right;
            let Some(schur) = a.cholesky() else {
                return f64::NEG_INFINITY;
            };
            let size = schur.solve(&right);
            if c.exceeds_linear_range(size[0], variant) {
                return f64::NEG_INFINITY;
            }
            let sign = log_sign(variant.positive, &size, &schur);
            0.5 * right.dot(&size) - half_log_det(&schur) + variant.log_prior + c.log_odds + sign
                - 0.5 * variant.mean * variant.mean
        };
        c.variants.iter().map(weigh).collect()
    }

    pub(super) fn log_posterior(&self, set: &Set) -> f64 {
        let Some(Base { factor, right }) = self.base(&self.columns(set)) else {
            return f64::NEG_INFINITY;
        };
        let mean = factor.solve(&right);
        let mut log = 0.5 * right.dot(&mean) - half_log_det(&factor);
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
        let base = self.base(columns);
        base.map_or(f64::NEG_INFINITY, |base| 0.5 * base.right.dot(&base.factor.solve(&base.right)))
    }

    /// Whether every effect of known sign has that sign.
    pub(super) fn signs_are_right(&self, set: &Set) -> bool {
        let Some(estimate) = self.estimate(set) else {
            return false;
        };
        let mut at = 0;
        let mut chosen = set.iter().zip(&self.linear.candidates);
        chosen.all(|(variant, candidate)| {
            let Some(v) = variant else { return true };
            let variant = &candidate.variants[*v];
            let size = estimate.mean[at];
            at += variant.columns.len();
            !variant.positive || size > 0.0
        })
    }

    /// Largest share of the residual sum of squares that a form of a candidate alone explains.
    pub(super) fn share_alone(&self, candidate: usize) -> f64 {
        let explained = |variant: &Variant| {
            let columns = self.column_indices(variant);
            let base = self.base(&columns)?;
            let mean = base.factor.solve(&base.right);
            let parts =
                columns.iter().zip(mean.iter()).map(|(column, mean)| self.right[*column] * mean);
            Some(parts.sum::<f64>())
        };
        let variants = self.linear.candidates[candidate].variants.iter();
        let most = variants.filter_map(explained).fold(0.0, f64::max);
        most / self.squares.max(f64::MIN_POSITIVE)
    }

    /// Information of the first column of a form given others; `unit`: its slab.
    pub(super) fn information(
        &self,
        others: &[usize],
        variant: &Variant,
        unit: f64,
    ) -> ColumnInformation {
        let column = variant.columns[0].at - self.linear.nuisances.len();
        let left = self.base(others).map(|base| {
            let cross = DVector::from_fn(others.len(), |r, _| self.gram[(others[r], column)]);
            base.schur_complement(&cross, self.gram[(column, column)], self.right[column])
        });
        let [information, score] = left.unwrap_or_default();
        ColumnInformation { information, score, unit }
    }

    /// Odds of a form of a set as a function of the size that is injected into the records.
    pub(super) fn injection(&self, set: &Set, candidate: usize) -> Option<Injection> {
        let others = self.columns(&without(set, candidate));
        let candidate = (&self.linear.candidates[candidate], set[candidate]?);
        let (candidate, chosen) = (candidate.0, &candidate.0.variants[candidate.1]);
        let own = self.column_indices(chosen);
        let base = self.base(&others)?;
        let cross = self.products(&others, &own);
        // Information about the form given the others, without and with its prior.
        let left = self.products(&own, &own) - cross.tr_mul(&base.factor.solve(&cross));
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
        let mut set = without(set, candidate);
        for other in &self.linear.candidates[candidate].excludes {
            set[*other] = None;
        }
        set
    }

    /// The set with a form of a candidate instead of all that it excludes.
    pub(super) fn with(&self, set: &Set, candidate: usize, form: usize) -> Set {
        let mut set = self.cleared(set, candidate);
        set[candidate] = Some(form);
        set
    }
}

pub(super) fn without(set: &Set, candidate: usize) -> Set {
    let mut set = set.clone();
    set[candidate] = None;
    set
}

/// Adds the prior precision of slabs.
fn add_identity(a: &mut DMatrix<f64>) {
    for d in 0..a.nrows() {
        a[(d, d)] += 1.0;
    }
}

/// A form given others, with an injected size of it in records without noise.
pub(super) struct Injection {
    left: DMatrix<f64>,
    schur: Cholesky<f64, Dyn>,
    log_prior: f64,
    positive: bool,
}

impl Injection {
    /// Log odds with `size` slabs of each column.
    pub(super) fn log_odds(&self, size: &[f64]) -> f64 {
        let added = DVector::from_fn(self.left.nrows(), |r, _| size.get(r).copied().unwrap_or(0.0));
        let right = &self.left * added;
        let mean = self.schur.solve(&right);
        let sign = log_sign(self.positive, &mean, &self.schur);
        0.5 * right.dot(&mean) - half_log_det(&self.schur) + self.log_prior + sign
    }
}

/// Log normalisation of a form whose first size has a known sign; zero without one.
fn log_sign(positive: bool, mean: &DVector<f64>, precision: &Cholesky<f64, Dyn>) -> f64 {
    if positive { log_positive(mean[0], precision.inverse()[(0, 0)].sqrt()) } else { 0.0 }
}

/// log 2 Phi(mean / sd): normalisation of a normal prior that is truncated to the known sign.
fn log_positive(mean: f64, sd: f64) -> f64 {
    erfc(-mean / sd / std::f64::consts::SQRT_2).max(1e-300).ln()
}

/// Evaluated sets.
struct Explored<'a> {
    reduced: &'a Reduced,
    /// Log posterior of each, exact or by the odds of one more effect than a neighbour.
    weighed: HashMap<Set, f64>,
    /// Those to which every effect was added.
    extended: HashSet<Set>,
    /// Log posterior of the best.
    top: f64,
}

impl Explored<'_> {
    fn exactly(&mut self, set: &Set) -> f64 {
        let log = self.reduced.log_posterior(set);
        self.weighed.insert(set.clone(), log);
        self.top = self.top.max(log);
        log
    }

    /// Evaluates every set that differs from `set` by one effect added, removed or exchanged.
    fn expand(&mut self, set: &Set) {
        let inside = (0..set.len()).filter(|k| set[*k].is_some());
        let bases = std::iter::once(set.clone()).chain(inside.map(|k| without(set, k)));
        for from in bases {
            if self.extended.insert(from.clone()) {
                self.add_one(&from);
            }
        }
        // Exchanges of effects that exclude each other, where one effect excludes several.
        for k in (0..set.len()).filter(|k| set[*k].is_none()) {
            let excluded = |other: &&usize| set[**other].is_some();
            if self.reduced.linear.candidates[k].excludes.iter().filter(excluded).count() > 1 {
                let cleared = self.reduced.cleared(set, k);
                if self.extended.insert(cleared.clone()) {
                    self.add_one(&cleared);
                }
            }
        }
    }

    /// Evaluates every set with one effect more than `from`.
    fn add_one(&mut self, from: &Set) {
        let reduced = self.reduced;
        let log = self.exactly(from);
        let given = reduced.given(&reduced.columns(from));
        for (k, candidate) in reduced.linear.candidates.iter().enumerate() {
            if from[k].is_some() || candidate.excludes.iter().any(|other| from[*other].is_some()) {
                continue;
            }
            for (v, gain) in reduced.log_odds_given(given.as_ref(), k).into_iter().enumerate() {
                let log = log + gain;
                // Of those 25 nats behind the best 10^5 have a share of 10^-6.
                if log > self.top - 25.0 {
                    let mut with = from.clone();
                    with[k] = Some(v);
                    self.weighed.entry(with).or_insert(log);
                    self.top = self.top.max(log);
                }
            }
        }
    }

    /// The best set that was not expanded yet, as long as it is near the best of all.
    fn next(&self) -> Option<Set> {
        let is_open = |(set, log): &(&Set, &f64)| {
            **log > self.top - WINDOW_NATS && !self.extended.contains(*set)
        };
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
        extended: HashSet::new(),
        top: f64::NEG_INFINITY,
    };
    for start in starts {
        explored.exactly(start);
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
    let likeliest = |k: usize| {
        let logs = reduced.conditional(&reduced.columns(&reduced.cleared(&best, k)), k);
        let top = (0..logs.len()).max_by(|a, b| logs[*a].total_cmp(&logs[*b])).unwrap_or(0);
        (logs[top], top)
    };
    let (log_factor, forms) = (0..n).map(likeliest).unzip();
    sets.retain(|s| s.1 > best_log - PLAUSIBLE_NATS);
    Posterior { probability, best, log_factor, sets, forms }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joint::regression::{Candidate, Column};
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
                    columns: vec![Column { at: column, ..Column::of(Some(0), 1.0, 0.0) }],
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
            scales: drivebench_model::plant::RunScales::REFERENCE,
        }
    }

    /// Probabilities of the candidates.
    fn weighed(linear: &Linear, with_spikes: bool) -> Vec<f64> {
        let nothing = vec![None; linear.candidates.len()];
        let reduced = Reduced::new(linear.clone(), 1.0, with_spikes).unwrap();
        select(&reduced, &[nothing]).probability
    }

    #[test]
    fn one_effect_alone_has_the_odds_of_the_closed_form() {
        for (g, b) in [(0.0, 0.0), (50.0, 3.0), (400.0, 60.0), (400.0, 75.0)] {
            let p = weighed(&linear(&[&[g]], &[b]), false)[0];
            let odds = 0.1 / 0.9 * (0.5 * b * b / (g + 1.0)).exp() / (g + 1.0_f64).sqrt();
            let expected = odds / (1.0 + odds);
            assert!((p - expected).abs() < 1e-9, "{g} {b}: {p} {expected}");
        }
    }

    #[test]
    fn collinear_effects_share_what_either_would_have() {
        // The columns are all but one, and the residual lies along both.
        let (g, b) = (1e4, 1e3);
        let found = weighed(&linear(&[&[g, g - 1e-3], &[g - 1e-3, g]], &[b, b]), false);
        assert!((found[0] - found[1]).abs() < 1e-6, "{found:?}");
        // Either alone nearly always, both sometimes: only the prior is against it.
        assert!((0.5..0.6).contains(&found[0]), "{found:?}");
        assert!(weighed(&linear(&[&[g]], &[b]), false)[0] > 0.999);
    }

    #[test]
    fn an_effect_hidden_by_a_strong_one_is_found_beside_it() {
        // Alone the second explains nothing: what it adds lies across what the first leaves.
        let gram: &[&[f64]] = &[&[1e4, 6e3, 0.0], &[6e3, 1e4, 0.0], &[0.0, 0.0, 1e4]];
        let truth = DVector::from_column_slice(&[0.5, -0.3, 0.0]);
        let mut data = linear(gram, &[0.0; 3]);
        data.right = &data.gram * truth;
        assert!(data.right[1].abs() < 1e-9);
        let found = weighed(&data, false);
        assert!(found[0] > 0.999 && found[1] > 0.999 && found[2] < 0.01, "{found:?}");
    }

    #[test]
    fn sign_spike_and_share_of_the_whole_decide_beside_the_evidence() {
        // An effect of fixed size.
        let mean = 1.0 / 0.15;
        let of = |share: f64| (400.0, share * mean * 400.0);
        // Fifty standard deviations from zero, and no more than a thousandth of the slab.
        let (negative, small) = ((400.0, -60.0), (2.5e9, 1e-3 * 2.5e9));
        let (free, positive, whole) = ((false, 0.0), (true, 0.0), (false, mean));
        for (name, (g, b), form, is_in, expected) in [
            ("any sign", negative, free, false, 0.3..1.0),
            ("forbidden sign", negative, positive, false, 0.0..0.01),
            ("no spike", small, free, false, 0.999..1.1),
            ("whole", of(1.0), whole, false, 0.999..1.1),
            ("a fifth of it", of(0.2), whole, false, 0.0..1e-6),
            ("nothing of it", of(0.0), whole, false, 0.0..1e-6),
            ("more than it", of(1.8), whole, false, 0.0..1e-6),
            // Its shapes need another fit.
            ("more, in the model", of(1.8), whole, true, 0.999..1.1),
            ("spike", small, free, false, 0.0..0.1),
        ] {
            let mut data = linear(&[&[g]], &[b]);
            let own = &mut data.candidates[0];
            (own.variants[0].positive, own.variants[0].mean) = form;
            own.in_model = is_in;
            let found = weighed(&data, name == "spike")[0];
            assert!(expected.contains(&found), "{name}: {found}");
        }
    }
}
