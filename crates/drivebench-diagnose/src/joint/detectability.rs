//! Detectability of effects: posterior standard deviation of the size, smallest size that would be named with a power of 95 %, and
//! upper bound of the size of an event.

use std::f64::consts::{FRAC_PI_4, SQRT_2};

use statrs::function::erf::erfc;

use super::regression::{ColumnInformation, Variant};
use super::select::{Reduced, Set, without};
use drivebench_model::numerics::count::whole;
use drivebench_model::plant::Effect;

/// Posterior standard deviation, in slabs, from which on an effect is not detectable.
pub(super) const UNDETECTABLE_SLABS: f64 = 0.5;
/// Distance, in standard deviations, that an effect of fixed size must make to be detected.
const FIXED_SIZE_DETECTED_SIGMAS: f64 = 5.0;
/// Standard deviations above the mean of an upper bound: 1.645 for 95 %, and a margin for the uncertainty of the set.
pub(super) const BOUND_SIGMAS: f64 = 1.75;
/// The quantile of 95 % of a normal distribution.
const NAMED_IN_95_SIGMAS: f64 = 1.645;

/// Posterior standard deviation, in slabs, of the size of a candidate in one form, given a set. For an event it is the one that
/// nine of ten event times do not exceed, because every run holds times near its end at which nothing is detectable; for a start
/// delay likewise over its lengths.
pub(super) fn posterior_sd_slabs(
    reduced: &Reduced,
    best: &Set,
    excess: f64,
    [k, form]: [usize; 2],
) -> Option<f64> {
    let candidate = &reduced.linear.candidates[k];
    let variant = &candidate.variants[form];
    if candidate.is_event() && !candidate.in_model {
        let event_times = event_information(reduced, best, excess, k);
        let information = event_times.iter().map(|own| own.information.max(0.0));
        return Some((lower_decile(information.collect())? + 1.0).sqrt().recip());
    }
    if variant.mean > 0.0 {
        // Effect of fixed size: detected by its distance in standard deviations of the noise.
        let lengths = distances_of_lengths(reduced, best, k);
        let most = lengths.and_then(|all| lower_decile(all.iter().map(|own| own.1).collect()));
        let square = most.unwrap_or_else(|| fixed_size_distance(reduced, best, k, variant));
        return (square > 0.0)
            .then(|| UNDETECTABLE_SLABS * FIXED_SIZE_DETECTED_SIGMAS / square.sqrt());
    }
    let (_, sd) = size_in(reduced, &reduced.with(best, k, form), k)?;
    Some(sd / variant.columns[0].unit)
}

/// Squared distance, in standard deviations, between presence and absence of an effect of fixed size.
fn fixed_size_distance(reduced: &Reduced, best: &Set, k: usize, variant: &Variant) -> f64 {
    let columns = reduced.columns(&without(best, k));
    reduced.information(&columns, variant, 1.0).information * variant.mean.powi(2)
}

/// Lower decile: the value that nine of ten reach.
fn lower_decile(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(|a, b| b.total_cmp(a));
    let enough = whole((0.9 * values.len() as f64).ceil());
    values.get(enough.checked_sub(1)?).copied()
}

/// Smallest size that would be named if it were added to these records, for every sign or phase, reduced by 1.645 standard
/// deviations `sd` of the noise: a power of 95 %.
pub(super) fn detectable(reduced: &Reduced, with: &Set, k: usize, sd: f64) -> Option<f64> {
    let candidate = &reduced.linear.candidates[k];
    let variant = &candidate.variants[with[k]?];
    let wave = is_amplitude(candidate.effect);
    let directions: Vec<(f64, f64)> = if wave {
        let eighths = (0..8).map(|n| f64::from(n) * FRAC_PI_4);
        eighths.map(f64::sin_cos).collect()
    } else {
        let signs = [(1.0, 0.0), (-1.0, 0.0)];
        signs[..if variant.positive { 1 } else { 2 }].to_vec()
    };
    let unit = variant.columns[0].unit;
    let injection = reduced.injection(with, k)?;
    let is_named = |size: f64| {
        let against = (size - NAMED_IN_95_SIGMAS * sd).max(0.0) / unit;
        let named = |(a, b): &(f64, f64)| {
            let added = [against * a, if wave { against * b } else { 0.0 }];
            injection.log_odds(&added) > 0.0
        };
        directions.iter().all(named)
    };
    let (mut low, mut high) = (0.0, unit);
    for _ in 0..12 {
        if is_named(high) {
            break;
        }
        low = high;
        high *= 2.0;
    }
    if !is_named(high) {
        return None;
    }
    for _ in 0..12 {
        let middle = 0.5 * (low + high);
        *(if is_named(middle) { &mut high } else { &mut low }) = middle;
    }
    Some(high)
}

/// Each length of a start delay with its squared distance; `None` for effects with other shapes and for those that the model has.
/// Without it the shortest length would stand for all, which the voltage of one command may explain. A length that the first sixth
/// of the run refuted has no form any more: its distance is infinite.
fn distances_of_lengths(reduced: &Reduced, best: &Set, k: usize) -> Option<Vec<(f64, f64)>> {
    let candidate = &reduced.linear.candidates[k];
    let specs = candidate.effect?.parameters();
    let [length] = specs else { return None };
    if candidate.in_model || !candidate.has_fixed_size() {
        return None;
    }
    let distance = |length_s: f64| {
        let mut forms = candidate.variants.iter();
        let own = forms.find(|form| form.values[0].to_bits() == length_s.to_bits());
        let square = own.map(|form| fixed_size_distance(reduced, best, k, form));
        (length_s, square.unwrap_or(f64::INFINITY))
    };
    Some(length.in_run(&reduced.linear.scales).shapes().map(distance).collect())
}

/// Shortest start delay from which on all lengths would have been detected.
pub(super) fn shortest_detectable(reduced: &Reduced, best: &Set, k: usize) -> Option<f64> {
    let lengths = distances_of_lengths(reduced, best, k)?;
    let least = FIXED_SIZE_DETECTED_SIGMAS * FIXED_SIZE_DETECTED_SIGMAS;
    let detected = lengths.iter().rev().take_while(|own| own.1 >= least);
    detected.last().map(|own| own.0)
}

/// Fisher information of an event at each time of each run, given a set; `excess` is that of the residuals.
pub(super) fn event_information(
    reduced: &Reduced,
    best: &Set,
    excess: f64,
    k: usize,
) -> Vec<ColumnInformation> {
    let candidate = &reduced.linear.candidates[k];
    if !candidate.event_information.is_empty() {
        let wider = |own: &ColumnInformation| ColumnInformation {
            information: own.information / excess,
            score: own.score / excess,
            ..*own
        };
        return candidate.event_information.iter().map(wider).collect();
    }
    let others = reduced.columns(&reduced.cleared(best, k));
    let alone = candidate.variants.iter().filter(|variant| variant.columns.len() == 1);
    alone.map(|variant| reduced.information(&others, variant, variant.columns[0].unit)).collect()
}

/// Upper 95 % bound of the size of an event of unknown time: the quantile of the mixture over the event times, weighted by their
/// evidence; at times without information the prior of the size remains.
pub(super) fn event_bound(event_times: &[ColumnInformation]) -> f64 {
    let size = |own: &ColumnInformation| {
        let precision = own.information.max(0.0) + 1.0;
        let log = 0.5 * own.score * own.score / precision - 0.5 * precision.ln();
        let mean = (own.score / precision).abs() * own.unit;
        let sd = BOUND_SIGMAS / NAMED_IN_95_SIGMAS / precision.sqrt() * own.unit;
        (log, mean, sd)
    };
    let sizes: Vec<(f64, f64, f64)> = event_times.iter().map(size).collect();
    let logs = sizes.iter().map(|size| size.0);
    let most = logs.fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = sizes.iter().map(|size| (size.0 - most).exp()).sum();
    let beyond = |bound: f64| -> f64 {
        let weighted_tail = |(log, mean, sd): &(f64, f64, f64)| {
            let tail = 0.5 * erfc((bound - mean) / sd / SQRT_2);
            (log - most).exp() * tail
        };
        sizes.iter().map(weighted_tail).sum::<f64>() / total
    };
    // Bisection from four standard deviations down.
    let mut low = 0.0;
    let mut high = sizes.iter().fold(0.0, |high, (_, mean, sd)| f64::max(high, mean + 4.0 * sd));
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        *(if beyond(middle) > 1.0 - 0.95 { &mut low } else { &mut high }) = middle;
    }
    high
}

/// Size of candidate `k` in a set and its standard deviation, in the unit of its first parameter.
pub(super) fn size_in(reduced: &Reduced, set: &Set, k: usize) -> Option<(f64, f64)> {
    let candidate = &reduced.linear.candidates[k];
    let variant = &candidate.variants[set[k]?];
    let estimate = reduced.estimate(set)?;
    let second = variant.columns.get(1);
    let is_wave = second.is_some_and(|own| own.unit > 0.0 && own.parameter == Some(1))
        && is_amplitude(candidate.effect);
    let (mut square, mut variance) = (0.0, 0.0_f64);
    for column in variant.columns.iter().take(if is_wave { 2 } else { 1 }) {
        let (mean, own) = estimate.of(column.at)?;
        let size = mean * column.unit;
        square += size * size;
        variance = variance.max(own * column.unit * column.unit);
    }
    Some((square.sqrt(), variance.sqrt()))
}

/// Whether an effect's first two parameters are sine and cosine.
fn is_amplitude(effect: Option<&'static dyn Effect>) -> bool {
    let first = effect.and_then(|effect| effect.parameters().first());
    first.is_some_and(|spec| spec.key.starts_with("sin_"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nine_of_ten_have_more_than_the_least() {
        let ten = [3.0, 1.0, 9.0, 4.0, 8.0, 7.0, 6.0, 5.0, 2.0, 10.0];
        for (values, expected) in [(&ten[..], Some(2.0)), (&ten[..2], Some(1.0)), (&[], None)] {
            assert_eq!(lower_decile(values.to_vec()), expected, "{values:?}");
        }
    }

    #[test]
    fn an_event_is_below_its_bound_whenever_it_happened() {
        let event_time = |precision: f64, score: f64| ColumnInformation {
            information: precision - 1.0,
            score,
            unit: 2.0,
        };
        let sharp = BOUND_SIGMAS * 2.0 / 20.0;
        let (open, there) = (event_time(1.0, 0.0), event_time(400.0, 200.0));
        for (name, count, other, expected) in [
            ("equal", 10, event_time(400.0, 0.0), 0.999 * sharp..1.001 * sharp),
            // A quarter leaves it open: it may be nearly as large as is plausible at all.
            ("open", 10, open, 2.0..f64::INFINITY),
            // One in which it is there counts, and the others hardly do.
            ("there", 1, there, 1.1..1.25),
        ] {
            let mut event_times = vec![event_time(400.0, 0.0); 40 - count];
            event_times.extend(vec![other; count]);
            let bound = event_bound(&event_times);
            assert!(expected.contains(&bound), "{name}: {bound}");
        }
    }
}
