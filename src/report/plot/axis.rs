//! Axes of pictures and of charts in a terminal: the range that is shown, and round tick values with their labels.

use drivebench_model::text::number::{exponent_of, places};

/// The range of values along an axis; always finite and wider than nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Domain {
    pub from: f64,
    pub to: f64,
}

impl Domain {
    /// The range of the finite values, widened where it is a single value; `None` where nothing is finite.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        // Values so large that their span would overflow count as missing.
        let (from, to) = values
            .into_iter()
            .filter(|value| value.abs() < 1e300)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(from, to), value| {
                (from.min(value), to.max(value))
            });
        if from > to {
            return None;
        }
        let size = from.abs().max(to.abs());
        Some(if to - from > 1e-9 * size {
            Self { from, to }
        } else {
            let pad = if size > 1e-300 { 0.1 * size } else { 1.0 };
            Self { from: from - pad, to: to + pad }
        })
    }

    /// Wider by `share` of its length at both ends, so that lines do not touch the frame.
    #[must_use]
    pub fn padded(self, share: f64) -> Self {
        let pad = share * (self.to - self.from);
        Self { from: self.from - pad, to: self.to + pad }
    }

    /// Wider, to the next round values at both ends: the axis of a chart that grows moves seldom.
    #[must_use]
    pub fn rounded(self) -> Self {
        let rough = (self.to - self.from) / 8.0;
        let power = 10_f64.powf(rough.log10().floor());
        let factor = [1.0, 2.0, 2.5, 5.0].into_iter().find(|factor| factor * power >= rough);
        let step = factor.unwrap_or(10.0) * power;
        Self { from: (self.from / step).floor() * step, to: (self.to / step).ceil() * step }
    }

    #[must_use]
    pub const fn with(self, values: [f64; 2]) -> Self {
        Self { from: self.from.min(values[0]), to: self.to.max(values[1]) }
    }

    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self { from: self.from * factor, to: self.to * factor }
    }
}

/// Share of a step that is rounding, not distance.
const ROUNDING: f64 = 1e-7;
/// Digits that distinguish any two doubles, and digits without rounding errors.
const ALL_DIGITS: usize = 17;
const SAFE_DIGITS: usize = 7;

/// Round values (1, 2 or 5 times a power of ten apart) inside the domain, at most `most` of them.
pub fn ticks(domain: Domain, most: usize) -> Vec<f64> {
    let span = domain.to - domain.from;
    let most = most.max(2);
    if !(span.is_finite() && span > 0.0) {
        return Vec::new();
    }
    let power = exponent_of(span / most as f64, ALL_DIGITS);
    for (factor, power) in
        [(1.0, power), (2.0, power), (5.0, power), (1.0, power + 1), (2.0, power + 1)]
    {
        let multiple = |k: f64| {
            // Dividing by a whole power of ten gives the nearest double to the decimal number.
            if power < 0 { k * factor / 10f64.powi(-power) } else { k * factor * 10f64.powi(power) }
        };
        let step = multiple(1.0);
        let first = (domain.from / step - ROUNDING).ceil();
        let last = (domain.to / step + ROUNDING).floor();
        if last - first + 1.0 <= most as f64 {
            // Beyond this, neighbouring multiples are no longer different numbers.
            if step <= 0.0 || first.abs().max(last.abs()) > 1e12 {
                return Vec::new();
            }
            let whole = std::iter::successors(Some(first), |k| Some(k + 1.0));
            return whole.take_while(|k| *k <= last).map(|k| multiple(k) + 0.0).collect();
        }
    }
    Vec::new()
}

/// Labels of ticks, all with the same number of decimals.
pub fn labels(ticks: &[f64]) -> Vec<String> {
    let step = ticks.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
    let size = ticks.iter().fold(0.0f64, |size, tick| size.max(tick.abs()));
    let step = if step.is_finite() { step } else { size.max(1e-300) };
    let last = exponent_of(step, SAFE_DIGITS);
    if last < -4 || size >= 1e6 {
        // Enough digits that the last one is that of the step.
        let digits = places(exponent_of(size.max(step), SAFE_DIGITS) - last);
        let label = |tick: &f64| match *tick {
            0.0 => "0".to_owned(),
            tick => format!("{tick:.digits$e}"),
        };
        return ticks.iter().map(label).collect();
    }
    let decimals = places(-last);
    ticks.iter().map(|tick: &f64| format!("{tick:.decimals$}")).collect()
}

/// Powers of ten inside a domain of exponents, and 2 and 5 times them where there are few.
pub fn powers(domain: Domain) -> Vec<f64> {
    let Domain { from, to } = domain;
    let few = to - from < 4.0;
    let factors: &[f64] = if few { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let all = (-30..=30).flat_map(|power| factors.iter().map(move |f| f * 10f64.powi(power)));
    all.filter(|tick| (from - 1e-9..=to + 1e-9).contains(&tick.log10())).collect()
}

/// A tick without an exponent where it is short.
pub fn plain(value: f64) -> String {
    if (1e-3..1e4).contains(&value) { format!("{value}") } else { format!("{value:e}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn domain(from: f64, to: f64) -> Domain {
        Domain { from, to }
    }

    #[test]
    fn well_known_ranges_have_the_expected_ticks() {
        assert_eq!(ticks(domain(0.0, 7.5), 8), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        assert_eq!(
            labels(&ticks(domain(-0.31, 0.29), 7)),
            ["-0.3", "-0.2", "-0.1", "0.0", "0.1", "0.2", "0.3"][..6]
        );
        assert_eq!(labels(&ticks(domain(-98.0, 98.0), 6)), ["-50", "0", "50"]);
        assert_eq!(labels(&ticks(domain(0.0, 4e-6), 6)), ["0", "1e-6", "2e-6", "3e-6", "4e-6"]);
    }

    #[test]
    fn a_single_value_and_no_value_are_handled() {
        assert_eq!(Domain::of([]), None);
        assert_eq!(Domain::of([f64::NAN, f64::INFINITY]), None);
        assert_eq!(Domain::of([0.0, f64::NAN]), Some(domain(-1.0, 1.0)));
        assert_eq!(Domain::of([10.0]), Some(domain(9.0, 11.0)));
    }

    proptest! {
        #[test]
        fn ticks_are_round_inside_increasing_and_few(
            place in -1e6..1e6f64, power in -12..12i32, mantissa in 1.0..10.0f64, most in 6..15usize,
        ) {
            let span = mantissa * 10f64.powi(power);
            let from = place * span;
            let range = domain(from, from + span);
            let found = ticks(range, most);
            prop_assert!(found.len() >= 2 && found.len() <= most, "{found:?}");
            let step = found[1] - found[0];
            let rounding = 1e-6 * step + 1e-15 * from.abs();
            for pair in found.windows(2) {
                prop_assert!(pair[1] > pair[0]);
                prop_assert!((pair[1] - pair[0] - step).abs() <= 4.0 * rounding);
            }
            prop_assert!(found[0] >= range.from - rounding && found[found.len() - 1] <= range.to + rounding);
            // No tick is missing at either end.
            prop_assert!(found[0] - step < range.from + rounding);
            prop_assert!(found[found.len() - 1] + step > range.to - rounding);
            for (label, tick) in labels(&found).iter().zip(&found) {
                prop_assert!((label.parse::<f64>().unwrap() - tick).abs() <= 0.01 * step, "{label} {tick}");
            }
        }
    }
}
