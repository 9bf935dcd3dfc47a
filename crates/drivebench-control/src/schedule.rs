//! Gain scheduling over the inertia: gains and their bounds on a logarithmic grid, tuned before the motor moves and
//! interpolated on line. Each point holds the gains of the rule and the largest proportional gain with a gain margin.

use super::tuning::{NotchUse, Request, Tuning, TuningError, tune_over};
use super::{LinearPlant, LoopTiming, Notch, PiGains};
use drivebench_model::numerics::count::whole;

/// Gains over the ratio of the inertia to the model's.
#[derive(Clone, Debug)]
pub struct Schedule {
    points: Vec<Scheduled>,
    /// Why the rule ends it below and above; none where the grid's reach ends it.
    refused: [Option<TuningError>; 2],
    /// Logarithm of the lowest ratio and of the step.
    lowest: f64,
    step: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scheduled {
    pub gains: PiGains,
    /// Largest proportional gain with margin.
    pub most_proportional: f64,
    pub small_time_s: f64,
}

impl Scheduled {
    pub(super) fn interpolated(&self, other: &Self, share: f64) -> Self {
        let between = |of: fn(&Self) -> f64| of(self) + share * (of(other) - of(self));
        // Where a load is so light that its frequency is out of reach, the other's notch is taken.
        let [low, high] = [self, other].map(|point| point.gains.notch);
        let notch = low.or(high).zip(high.or(low)).map(|(low, high)| Notch {
            frequency_hz: low.frequency_hz + share * (high.frequency_hz - low.frequency_hz),
            ..low
        });
        Self {
            gains: PiGains {
                proportional: between(|point| point.gains.proportional),
                integral_time_s: between(|point| point.gains.integral_time_s),
                reference_filter_s: between(|point| point.gains.reference_filter_s),
                notch,
            },
            most_proportional: between(|point| point.most_proportional),
            small_time_s: between(|point| point.small_time_s),
        }
    }
}

impl Schedule {
    /// The grid around the model's plant; it ends where the rule refuses. Away from the model's nominal inertia only the draws
    /// with the least margins there are checked, and a notch is used where it was found to help there. It is refused as
    /// [`tune_over`] refuses that nominal inertia.
    pub fn new(
        plant: &LinearPlant,
        draws: &[LinearPlant],
        timing: &LoopTiming,
        request: &Request,
    ) -> Result<Self, TuningError> {
        // Twenty points either way from the model's inertia, up to 32 times it.
        let (reach, middle) = (32.0_f64.ln(), 20);
        let step = 2.0 * reach / 40.0;
        let nominal = tune_over(plant, draws, timing, request)?;
        let request = Request {
            notch: nominal.gains.notch.map_or(NotchUse::Off, NotchUse::Like),
            ..*request
        };
        let hardest = nominal.draws.as_ref().map(|draws| draws.hardest.as_slice());
        let at = |index: usize| {
            let ratio = (index as f64 * step - reach).exp();
            let scaled = |plant: &LinearPlant| plant.with_inertia_ratio(ratio);
            let draws: Vec<LinearPlant> = hardest.unwrap_or_default().iter().map(scaled).collect();
            tune_over(&scaled(plant), &draws, timing, &request).map(|tuning| point(&tuning))
        };
        // Away from the middle up to the first that the rule refuses.
        let from = |indices: &mut dyn Iterator<Item = usize>| {
            let mut points = Vec::new();
            for index in indices {
                match at(index) {
                    Ok(point) => points.push(point),
                    Err(error) => return (points, Some(error)),
                }
            }
            (points, None)
        };
        let (mut points, below) = from(&mut (0..middle).rev());
        let first = middle - points.len();
        points.reverse();
        points.push(point(&nominal));
        let (heavier, above) = from(&mut (middle + 1..2 * middle + 1));
        points.extend(heavier);
        Ok(Self { points, refused: [below, above], lowest: first as f64 * step - reach, step })
    }

    /// Smallest and largest ratio of the grid.
    pub fn range(&self) -> (f64, f64) {
        let highest = self.lowest + (self.points.len() - 1) as f64 * self.step;
        (self.lowest.exp(), highest.exp())
    }

    /// Why the rule ends that range below and above.
    pub const fn refused(&self) -> &[Option<TuningError>; 2] {
        &self.refused
    }

    /// Gains for a ratio; beyond the grid those of its end.
    pub fn at(&self, ratio: f64) -> Scheduled {
        let last = self.points.len() - 1;
        let position = ((ratio.ln() - self.lowest) / self.step).clamp(0.0, last as f64);
        let index = whole(position).min(last.saturating_sub(1));
        let (low, high) = (&self.points[index], &self.points[(index + 1).min(last)]);
        low.interpolated(high, position - index as f64)
    }

    /// Gains for an inertia that may be anything between two ratios: those of the middle, but never beyond what the
    /// lightest of them allows.
    pub fn within(&self, low: f64, ratio: f64) -> Scheduled {
        let mut scheduled = self.at(ratio);
        let bound = self.at(low.min(ratio)).most_proportional;
        scheduled.most_proportional = scheduled.most_proportional.min(bound);
        let gains = &mut scheduled.gains;
        gains.proportional = gains.proportional.min(scheduled.most_proportional);
        scheduled
    }
}

/// The largest gain leaves a gain margin of 1.6.
fn point(tuning: &Tuning) -> Scheduled {
    let growth = (tuning.least_gain_margin() / 1.6).max(1.0);
    Scheduled {
        gains: tuning.gains,
        most_proportional: tuning.gains.proportional * growth,
        small_time_s: tuning.small_time_s,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::LoopShape;
    use crate::testing::{assert_close, elastic, slow_machine, timing};
    use crate::tuning::{Rule, tune};

    fn schedule() -> Schedule {
        Schedule::new(&slow_machine(), &[], &timing(2.0), &Request::default()).unwrap()
    }

    #[test]
    fn between_the_points_it_is_what_tuning_gives() {
        let schedule = schedule();
        for ratio in [0.26, 0.5, 1.0, 1.7, 5.0] {
            let plant = slow_machine().with_inertia_ratio(ratio);
            let exact = tune(&plant, &timing(2.0), &Request::default()).unwrap().gains;
            let found = schedule.at(ratio).gains;
            assert_close(found.proportional / exact.proportional, 1.0, 0.02);
            assert_close(found.integral_time_s / exact.integral_time_s, 1.0, 0.02);
        }
    }

    #[test]
    fn no_gain_within_the_bounds_is_unstable() {
        let schedule = schedule();
        for (low, ratio) in [(0.2, 1.0), (0.8, 1.0), (1.0, 4.0), (0.5, 0.6)] {
            let gains = schedule.within(low, ratio).gains;
            for true_ratio in [low, (low * ratio).sqrt(), ratio, 2.0 * ratio] {
                let plant = slow_machine().with_inertia_ratio(true_ratio);
                let shape = LoopShape::new(&plant, &timing(2.0), &gains);
                assert!(shape.radius() < 1.0, "{low} {ratio} {true_ratio}");
            }
        }
    }

    #[test]
    fn behind_a_coupling_every_point_has_its_notch_and_margins() {
        let plant = LinearPlant::current(&elastic(0.5, 0.02), 0.0, 0.002).unwrap();
        let quick = LoopTiming { period_s: 0.002, delay_s: 0.004, filter_s: 0.0 };
        let request = Request { rule: Rule::SymmetricalOptimum, ..Request::default() };
        let schedule = Schedule::new(&plant, &[], &quick, &request).unwrap();
        let (low, high) = schedule.range();
        assert!(low < 0.7 && high > 3.0, "{low} {high}");
        for ratio in [0.7, 0.8, 1.0, 1.3, 2.9] {
            let gains = schedule.at(ratio).gains;
            let scaled = plant.with_inertia_ratio(ratio);
            let hertz = scaled.coupling().unwrap().frequency_hz;
            assert_close(gains.notch.unwrap().frequency_hz / hertz, 1.0, 0.02);
            let margins = LoopShape::new(&scaled, &quick, &gains).margins();
            assert!(margins.radius < 1.0 && margins.gain_margin > 1.6, "{ratio} {margins:?}");
        }
    }

    #[test]
    fn beyond_the_grid_its_ends_hold() {
        let schedule = schedule();
        let (low, high) = schedule.range();
        assert_eq!(schedule.at(1e-9), schedule.at(low));
        let [beyond, end] = [1e9, high].map(|ratio| schedule.at(ratio).gains.proportional);
        assert_close(beyond, end, 1e-9);
    }
}
