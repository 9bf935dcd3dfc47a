//! Of effects with many forms those that a run could tell of: the others get no column.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use super::columns::{Around, Part, Source};
use super::tangent::{LANES, Lane, Tangent, carry};
use super::whitened::Whitened;

/// Forms of one effect that are kept.
const KEPT: usize = 6;

/// Forms that are carried side by side, and what they have in common with the base, the residual and each other.
struct Group {
    part: usize,
    forms: Vec<usize>,
    products: Vec<Lane>,
}

/// Leaves of each part with many forms those that explain most of what the model leaves, beside the `base` columns with
/// the `precision` that they have beforehand. What the forms share beforehand is not touched: who drops out takes his
/// share along.
pub(super) fn keep_likeliest(parts: &mut [Part], runs: &[Around<'_>], base: &[Whitened], precision: &[f64]) {
    let mut groups = Vec::new();
    for (number, part) in parts.iter().enumerate() {
        let many = part.sources.len() > KEPT;
        let tangents = part.sources.iter().flatten().all(|source| !matches!(source, Source::Difference { .. }));
        if many && tangents {
            let width = part.sources[0].len();
            let forms: Vec<usize> = (0..part.sources.len()).collect();
            groups.extend(forms.chunks(LANES / width).map(|forms| Group { part: number, forms: forms.to_vec(), products: vec![] }));
        }
    }
    let Some((factor, right)) = base_of(runs, base, precision) else { return };
    groups.par_iter_mut().with_max_len(1).for_each(|group| {
        let sources: Vec<&Source> = group.forms.iter().flat_map(|form| &parts[group.part].sources[*form]).collect();
        group.products = vec![[0.0; LANES]; precision.len() + 1 + LANES];
        for (number, (run, base)) in runs.iter().zip(base).enumerate() {
            let tangents: Vec<&Tangent> = sources.iter().filter_map(|source| source.tangent(number)).collect();
            if tangents.len() == sources.len() {
                add_products(run, base, &tangents, &mut group.products);
            }
        }
    });
    for number in 0..parts.len() {
        let mut gains: Vec<(usize, f64)> = Vec::new();
        for group in groups.iter().filter(|group| group.part == number) {
            let width = parts[number].sources[0].len();
            for (place, form) in group.forms.iter().enumerate() {
                gains.push((*form, gain(&factor, &right, &group.products, place * width, width)));
            }
        }
        if gains.is_empty() {
            continue;
        }
        gains.sort_by(|a, b| b.1.total_cmp(&a.1));
        gains.truncate(KEPT);
        let mut form = 0..;
        let mut kept = || form.next().is_some_and(|form| gains.iter().any(|gain| gain.0 == form));
        let keep: Vec<bool> = parts[number].sources.iter().map(|_| kept()).collect();
        let mut each = keep.iter();
        parts[number].sources.retain(|_| each.next().is_some_and(|keep| *keep));
        let mut each = keep.iter();
        parts[number].candidate.variants.retain(|_| each.next().is_some_and(|keep| *keep));
    }
}

/// The normal equations of the base.
fn base_of(runs: &[Around<'_>], base: &[Whitened], precision: &[f64]) -> Option<(Cholesky<f64, Dyn>, DVector<f64>)> {
    let k = precision.len();
    let mut products = DMatrix::zeros(k + 1, k + 1);
    for (run, base) in runs.iter().zip(base) {
        products += base.gram(&run.followed.white);
    }
    let mut gram = products.view((0, 0), (k, k)).into_owned();
    for (d, precision) in precision.iter().enumerate() {
        gram[(d, d)] += precision;
    }
    Some((gram.cholesky()?, products.view((0, k), (k, 1)).column(0).into_owned()))
}

/// Products of the tangents with the base's columns, with the residual, and with each other.
fn add_products(run: &Around<'_>, base: &Whitened, tangents: &[&Tangent], products: &mut [Lane]) {
    let (with_base, others) = products.split_at_mut(base.columns.len());
    let Some((with_rest, with_each)) = others.split_first_mut() else { return };
    carry(run, tangents, |first, white| {
        for (sum, column) in with_base.iter_mut().zip(&base.columns) {
            let mut part = [0.0; LANES];
            for (value, row) in column[2 * first..].iter().zip(white) {
                let value = f64::from(*value);
                for k in 0..LANES {
                    part[k] += value * row[k];
                }
            }
            for k in 0..LANES {
                sum[k] += part[k];
            }
        }
        for (values, rows) in run.followed.white[first..].iter().zip(white.chunks_exact(2)) {
            for (value, row) in values.iter().zip(rows) {
                for k in 0..LANES {
                    with_rest[k] += value * row[k];
                }
            }
        }
        for (lane, sum) in with_each.iter_mut().enumerate() {
            let mut part = [0.0; LANES];
            for row in white {
                for k in 0..LANES {
                    part[k] += row[lane] * row[k];
                }
            }
            for k in 0..LANES {
                sum[k] += part[k];
            }
        }
    });
}

/// Log of the evidence of the form in these lanes, beside the base.
fn gain(factor: &Cholesky<f64, Dyn>, right: &DVector<f64>, products: &[Lane], lane: usize, width: usize) -> f64 {
    let m = right.len();
    let cross = DMatrix::from_fn(m, width, |r, c| products[r][lane + c]);
    let solved = factor.solve(&cross);
    let own = DMatrix::from_fn(width, width, |r, c| products[m + 1 + lane + r][lane + c] + f64::from(u8::from(r == c)));
    let rest = DVector::from_fn(width, |r, _| products[m][lane + r]) - solved.tr_mul(right);
    let Some(schur) = (own - cross.tr_mul(&solved)).cholesky() else { return f64::NEG_INFINITY };
    let log_det: f64 = schur.l().diagonal().iter().map(|d| d.ln()).sum();
    0.5 * rest.dot(&schur.solve(&rest)) - log_det
}
