//! Instants of the changes of an input that is known at the rows of a record only, by the current of the same rows.
//!
//! ```text
//! rows      u0          u1          a logger writes the voltage that holds as it reads: it changed at an unknown instant
//! voltage   ______,-----------      between two rows, and the current has already followed it for a while
//! current   ______,--'''            in a log of the drive a change acts from its stamp on: the current at u1 is the old one
//! ```
//!
//! The winding predicts the current of a row, `i' = f i + g u + h w + b sgn(i)` with the mean speed as the winding weighs it, by least
//! squares over the intervals without a change, for each time constant. What the current at a change is beyond that prediction decides
//! between the two kinds of records. In a sampled one each instant has the mean and the variance of its posterior, for a uniform prior
//! and the marginal likelihood of the time constant: little of the variance is left where L/R is long, nearly all where it is much
//! shorter than a period.

use super::unknown_input::{Rows, UnknownInput};
use crate::numerics::least_squares::fit_normal;
use crate::numerics::statistics::{extent, largest, mean, median};

/// Places within an interval.
const PLACES: usize = 64;

/// A change of the input: the number of its event, its mean instant, and the interval in which it came.
pub(super) struct Edge {
    pub(super) event: usize,
    pub(super) at_s: f64,
    pub(super) interval: UnknownInput,
}

/// The changes of a sampled input; empty where they are at their stamps, or where the record cannot show it.
pub(super) fn find(record: &Rows<'_>) -> Vec<Edge> {
    let input = record.input;
    let steps: Vec<f64> = input.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    let period_s = median(&steps);
    let (least_v, most_v) = extent(input.iter().map(|event| event.1));
    // The last digit of a reading, and a current below which a drop of voltage may not have reached its level.
    let small_v = 0.01 * (most_v - least_v);
    let small_a = 0.1 * largest(record.measured.iter().map(|row| row[0]));
    let all = (1..input.len()).map(|row| Interval::of(record, row, small_a));
    let (mut held, mut changes): (Vec<Interval>, Vec<Interval>) =
        all.filter(Interval::is_measured).partition(|own| own.change_v.abs() <= small_v);
    // Over lost rows the voltage is unknown in another way.
    changes.retain(|own| own.length_s < 1.5 * period_s && is_step(input, own.row));
    held.retain(|own| own.is_level && (own.length_s / period_s - 1.0).abs() < 0.1);
    // Time constants from a hundredth of the period to ten periods.
    let constants_s = (0..62).map(|step| 0.01 * period_s * 1.12_f64.powi(step));
    let possible = constants_s.filter_map(|constant_s| Winding::of(&held, period_s, constant_s));
    let possible: Vec<Winding> = possible.collect();
    let best = possible.iter().min_by(|a, b| a.error_a2.total_cmp(&b.error_a2));
    let Some(best) = best.filter(|winding| winding.shows_sampling(&changes)) else {
        return Vec::new();
    };
    let shares = shares(&possible, best.error_a2, held.len(), &changes);
    changes.iter().zip(shares).map(|(own, share)| own.edge(record, share)).collect()
}

/// Whether the input steps from a level to another one at a row, and does not run: in the row after a step a battery sags by a quarter
/// of it, and the rows of a ramp change alike.
fn is_step(input: &[(f64, f64)], row: usize) -> bool {
    let change = |row: usize| match (input.get(row.wrapping_sub(1)), input.get(row)) {
        (Some(before), Some(after)) => (after.1 - before.1).abs(),
        _ => 0.0,
    };
    2.0 * change(row - 1).max(change(row + 1)) < change(row)
}

/// The interval before a row.
struct Interval {
    row: usize,
    length_s: f64,
    before_v: f64,
    change_v: f64,
    /// At its begin and at its end.
    current_a: [f64; 2],
    speed: [f64; 2],
    /// Whether the current is large at both, in one direction.
    is_level: bool,
}

impl Interval {
    fn of(record: &Rows<'_>, row: usize, small_a: f64) -> Self {
        let (before, after) = (record.input[row - 1], record.input[row]);
        let [begin, end] = [record.measured[row - 1], record.measured[row]];
        Self {
            row,
            length_s: after.0 - before.0,
            before_v: before.1,
            change_v: after.1 - before.1,
            current_a: [begin[0], end[0]],
            speed: [begin[1], end[1]],
            is_level: begin[0].abs().min(end[0].abs()) > small_a && begin[0] * end[0] > 0.0,
        }
    }

    fn is_measured(&self) -> bool {
        [self.current_a, self.speed].iter().flatten().all(|value| value.is_finite())
    }

    /// The change, where the new voltage held for a share of this mean and variance.
    fn edge(&self, record: &Rows<'_>, (share, variance): (f64, f64)) -> Edge {
        let (from_s, to_s) = (record.input[self.row - 1].0, record.input[self.row].0);
        let mean = self.before_v + share * self.change_v;
        let variance = variance * self.change_v * self.change_v;
        let interval = UnknownInput::of_edge(from_s, to_s, mean, variance);
        Edge { event: self.row, at_s: to_s - share * self.length_s, interval }
    }
}

/// Prediction of the current over an interval.
struct Winding {
    constant_s: f64,
    /// Response to one volt over one period, A.
    response_a: f64,
    /// Voltages of one unit of speed and of the direction of the current.
    by_speed_v: f64,
    drop_v: f64,
    /// Share of a current that is left after one period.
    keeps: f64,
    /// Mean square of its errors in intervals without a change, A2.
    error_a2: f64,
}

impl Winding {
    fn of(held: &[Interval], period_s: f64, constant_s: f64) -> Option<Self> {
        let keeps = (-period_s / constant_s).exp();
        let mut winding = Self {
            constant_s,
            response_a: 1.0,
            by_speed_v: 0.0,
            drop_v: 0.0,
            keeps,
            error_a2: 0.0,
        };
        let row = |own: &Interval| {
            let x = [own.before_v, winding.speed(own), own.current_a[0].signum()];
            let gain = winding.after(own.length_s);
            (x.map(|x| gain * x), own.current_a[1] - winding.left(own.length_s) * own.current_a[0])
        };
        let rows: Vec<([f64; 3], f64)> = held.iter().map(row).collect();
        let [g, h, b] = fit_normal(&rows, 1e-9)?.x;
        (winding.response_a, winding.by_speed_v, winding.drop_v) = (g, h / g, b / g);
        let squares: Vec<f64> = held.iter().map(|own| winding.beyond_a(own).powi(2)).collect();
        winding.error_a2 = mean(&squares).max(f64::MIN_POSITIVE);
        (g > 0.0).then_some(winding)
    }

    /// Share of a current that is left after a time.
    fn left(&self, time_s: f64) -> f64 {
        (-time_s / self.constant_s).exp()
    }

    /// Response to one volt after a time, A.
    fn after(&self, time_s: f64) -> f64 {
        self.response_a * (1.0 - self.left(time_s)) / (1.0 - self.keeps)
    }

    /// Mean of a straight line between the speeds, of which the winding forgets the earlier ones.
    fn speed(&self, own: &Interval) -> f64 {
        let left = self.left(own.length_s);
        let age = self.constant_s / own.length_s - left / (1.0 - left);
        own.speed[1] - age * (own.speed[1] - own.speed[0])
    }

    /// The current at the end of an interval beyond its prediction without the change, A.
    fn beyond_a(&self, own: &Interval) -> f64 {
        let [begin_a, end_a] = own.current_a;
        let drop_v = self.drop_v * begin_a.signum();
        let forced_v = own.before_v + self.by_speed_v * self.speed(own) + drop_v;
        end_a - self.left(own.length_s) * begin_a - self.after(own.length_s) * forced_v
    }

    /// Whether the current has followed the changes by their stamps, each for another time.
    fn shows_sampling(&self, changes: &[Interval]) -> bool {
        let sum = |of: &dyn Fn(&Interval) -> f64| changes.iter().map(of).sum::<f64>();
        let squares_v2 = sum(&|own| own.change_v.powi(2));
        let response = sum(&|own| own.change_v * self.beyond_a(own)) / squares_v2;
        let scatter_a2 = sum(&|own| (self.beyond_a(own) - response * own.change_v).powi(2));
        let more_a2 = scatter_a2 - changes.len() as f64 * self.error_a2;
        // As shares of the response after a whole period: the mean is at least a half in a sampled record and none in one with
        // instants; the scatter is 0.07 to 0.29 where L/R is a hundredth of a period or longer, none where each change is equally late.
        changes.len() >= 10
            && response >= 0.25 * self.response_a
            && more_a2 >= squares_v2 * (0.05 * self.response_a).powi(2)
    }

    /// Log likelihood, and first and second moment of the share of the interval for which the new voltage has acted.
    fn share(&self, own: &Interval, error_a2: f64) -> [f64; 3] {
        let [begin_a, end_a] = own.current_a;
        // A drop changes its sign with the current, soon after the voltage does; below its level it is not known.
        let turned = self.drop_v * (end_a.signum() - begin_a.signum());
        let drop_a = if own.is_level { 0.0 } else { self.response_a * self.drop_v };
        // Error of the form of the predicted response.
        let form_a = 0.05 * self.response_a * own.change_v;
        let variance = error_a2 + drop_a * drop_a + form_a * form_a;
        let beyond_a = self.beyond_a(own);
        let places: [(f64, f64); PLACES] = std::array::from_fn(|place| {
            let share = (place as f64 + 0.5) / PLACES as f64;
            let left = beyond_a - (own.change_v + turned) * self.after(share * own.length_s);
            (share, -0.5 * left * left / variance)
        });
        let most = places.iter().map(|own| own.1).fold(f64::NEG_INFINITY, f64::max);
        let mut moments = [0.0; 3];
        for (share, log) in places {
            let weight = (log - most).exp();
            for (moment, power) in moments.iter_mut().zip([1.0, share, share * share]) {
                *moment += weight * power;
            }
        }
        let [all, first, second] = moments;
        [most + all.ln() - 0.5 * variance.ln(), first / all, second / all]
    }
}

/// Mean and variance of the share of each interval for which the new voltage has acted. The `held` intervals seldom determine a short
/// time constant; the responses at all changes do.
fn shares(
    possible: &[Winding],
    error_a2: f64,
    held: usize,
    changes: &[Interval],
) -> Vec<(f64, f64)> {
    let weighed = possible.iter().map(|winding| {
        let each = changes.iter().map(|own| winding.share(own, error_a2));
        let each: Vec<[f64; 3]> = each.collect();
        let squares = held as f64 * winding.error_a2 / error_a2;
        (each.iter().map(|own| own[0]).sum::<f64>() - 0.5 * squares, each)
    });
    let weighed: Vec<(f64, Vec<[f64; 3]>)> = weighed.collect();
    let most = weighed.iter().map(|own| own.0).fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = weighed.iter().map(|own| (own.0 - most).exp()).collect();
    let total: f64 = weights.iter().sum();
    let moment = |change: usize, power: usize| {
        let terms = weights.iter().zip(&weighed);
        terms.map(|(weight, own)| weight * own.1[change][power]).sum::<f64>() / total
    };
    let share = |change| {
        let share = moment(change, 1);
        // One of the places is not an instant.
        let of_place = (12.0 * (PLACES * PLACES) as f64).recip();
        (share, moment(change, 2) - share * share + of_place)
    };
    (0..changes.len()).map(share).collect()
}

#[cfg(test)]
mod tests {
    use crate::plant::testing::{self, record, with_rows_lost};
    use crate::plant::{Model, Scenario};

    /// The motor of paper A, L/R = 9 ms, after steps at these instants in periods; as a log of its rows.
    fn logged(period_s: f64, instants: impl Iterator<Item = f64>) -> Scenario {
        let values = [1.1, 0.0099, 0.3538, 0.0045, 0.455];
        let model = Model::baseline(testing::motor("m", &values));
        let level = |step: u32| 12.0 * f64::from(step * step % 17) - 90.0;
        let steps = instants.zip(1..).map(|(at, step)| (at * period_s, level(step)));
        let events = std::iter::once((0.0, 0.0)).chain(steps).collect();
        let run =
            with_rows_lost(&record(&model, events, period_s, 1000.0 * period_s, 3), |_| false);
        Scenario::from_run(&run).unwrap()
    }

    /// Begin of the periods in which a step comes.
    fn begins() -> impl Iterator<Item = f64> {
        (1..40_u32).map(|step| f64::from(24 * step + step * step % 7))
    }

    /// Fraction of its period at which a step comes: equidistributed.
    fn fractions() -> impl Iterator<Item = f64> {
        (1..40_u32).map(|step| (f64::from(step) * 0.618_034).fract())
    }

    #[test]
    fn changes_between_rows_are_placed_by_the_current() {
        for (period_s, most) in [(3e-3, 0.1), (9e-3, 0.1), (30e-3, 0.15)] {
            let instants = || begins().zip(fractions()).map(|(begin, share)| begin + share);
            let scenario = logged(period_s, instants());
            assert!(scenario.has_sampled_input(), "{period_s}");
            let edges = &scenario.unknown_input;
            let (mut squares, mut standardised) = (0.0, 0.0);
            for edge in edges {
                let at = |time_s: f64| scenario.input_at(time_s);
                let change_v = at(edge.to_s) - at(edge.from_s);
                let is_within = |at: &f64| (edge.from_s..edge.to_s).contains(&(at * period_s));
                let true_share = edge.to_s / period_s - instants().find(is_within).unwrap();
                let error = (edge.mean - at(edge.from_s)) / change_v - true_share;
                squares += error * error;
                standardised += error * error * change_v * change_v / edge.variance;
            }
            // The others step from a level to the same.
            assert!(edges.len() > 30, "{period_s}: {}", edges.len());
            let count = edges.len() as f64;
            let (rms, of_deviations) = ((squares / count).sqrt(), (standardised / count).sqrt());
            assert!(rms < most, "{period_s}: {rms}");
            assert!((0.3..1.5).contains(&of_deviations), "{period_s}: {of_deviations}");
        }
    }

    #[test]
    fn a_ramp_and_a_supply_that_sags_after_a_step_are_no_steps() {
        let levels = [0.0, 10.0, 8.0, 7.5, 7.5, 9.0, 10.5, 12.0, 12.0, -3.0, -3.0];
        let input: Vec<(f64, f64)> = (0_u32..).map(f64::from).zip(levels).collect();
        let steps: Vec<usize> =
            (1..input.len()).filter(|row| super::is_step(&input, *row)).collect();
        assert_eq!(steps, [1, 9]);
    }

    #[test]
    fn changes_at_their_stamps_or_equally_late_stay_there() {
        for (name, late) in [("at their stamps", 0.0), ("late", 0.3), ("early", -0.2)] {
            let scenario = logged(9e-3, begins().map(|begin| begin + late));
            assert!(!scenario.has_sampled_input() && scenario.unknown_input.is_empty(), "{name}");
            let rows = scenario.sample_time_s.iter();
            let stamps = scenario.events.iter().map(|event| event.0.to_bits());
            assert!(stamps.eq(rows.map(|time_s| time_s.to_bits())), "{name}");
        }
    }
}
