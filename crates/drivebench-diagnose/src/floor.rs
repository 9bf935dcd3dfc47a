//! The noise floor, the share of the error above it that is explained, and what a machine does not repeat from one run of an
//! excitation to the next.

use super::evidence::{Evidence, not_repeated};
use super::joint::Noise;
use super::joint::free_run::{Unpredicted, unpredicted_in};
use super::limits::RepeatUnknown;
use super::location::{FailureLocation, locate_difference};
use super::score::in_noise;
use super::vetoes::CLEAR_FALL_RATIOS;
use drivebench_identify::noise::FloorSource;
use drivebench_identify::output_error::FitError;
use drivebench_model::plant::Model;

/// Share of the explainable error from which a named set is sufficient.
pub(super) const SUFFICIENT_SHARE: f64 = 0.9;
/// The same below which an independent run does not confirm it.
const EXPLAINS_SOMETHING_SHARE: f64 = 0.3;
/// Ratio of the largest error by gaps of a record in one run to their mean error: a few gaps make most of it.
pub(super) const MOST_UNOBSERVED_RATIO: f64 = 2.0;

/// Largest error by stamps that counts as noise, in units of the sensors'. Under a wrong inductance stamps seem to explain anything: 6
/// to 7 floors of a servo; the complete model of a brushed motor with host stamps leaves 3.
const MOST_BY_STAMPS: f64 = 4.0;

/// Noise floor of a free run's error, in units of the sensors' noise.
#[derive(Clone, Copy)]
pub(super) struct Floor<'a> {
    evidence: &'a Evidence,
    /// Root mean squares, in the same units.
    unpredicted: Unpredicted<f64>,
}

impl<'a> Floor<'a> {
    pub(super) const fn new(evidence: &'a Evidence, unpredicted: Unpredicted<f64>) -> Self {
        Self { evidence, unpredicted }
    }

    fn with(self, unobserved: f64) -> f64 {
        if self.evidence.noise.source == FloorSource::None {
            0.0
        } else {
            1.0_f64.hypot(self.unpredicted.stamps.min(MOST_BY_STAMPS)).hypot(unobserved)
        }
    }

    /// Its mean; zero where the noise is not known.
    pub(super) fn expected(self) -> f64 {
        self.with(self.unpredicted.lost_rows)
    }

    /// Its upper bound in one run.
    pub(super) fn highest(self) -> f64 {
        self.with(MOST_UNOBSERVED_RATIO * self.unpredicted.lost_rows)
    }

    /// Whether an error is no more than the noise of sensors and stamps, without an allowance for lost rows.
    pub(super) fn is_noise(self, nrms: f64) -> bool {
        self.evidence.noise.is_at(self.with(0.0), nrms)
    }

    /// Whether an error is no more than the noise.
    pub(super) fn is_reached(self, nrms: f64) -> bool {
        self.evidence.noise.is_at(self.highest(), nrms)
    }

    /// Share of the explainable error that is explained. A model that clearly falls below the expected errors of stamps and lost rows
    /// shows that they are smaller.
    pub(super) fn explained(self, before: f64, after: f64) -> f64 {
        let is_clear = before >= CLEAR_FALL_RATIOS[0] * after;
        let most = if is_clear { after.max(1.0) } else { f64::INFINITY };
        explained(before, after, self.expected().min(most))
    }

    /// Whether a good part of the error above the floor, with its tolerance, is explained.
    pub(super) fn is_explained_in_part(self, before: f64, after: f64) -> bool {
        let highest = self.highest() * self.evidence.noise.tolerance(1.0);
        before <= highest || explained(before, after, highest) >= EXPLAINS_SOMETHING_SHARE
    }
}

/// Share of the explainable error that is explained: `1 - (v^2 - f^2)/(v0^2 - f^2)`; an error below the floor, which is
/// itself an estimate, explains everything and no more.
fn explained(before: f64, after: f64, floor: f64) -> f64 {
    let explainable = before * before - floor * floor;
    if explainable <= 0.0 {
        0.0
    } else {
        (1.0 - (after * after - floor * floor) / explainable).min(1.0)
    }
}

/// Multiple of the sensors' noise by which two runs of the same excitation may differ and still repeat.
const REPEATS_RATIO: f64 = 1.5;

/// Two runs of the same excitation, each with its own fit of one model.
#[derive(Clone, Debug, Default)]
pub(super) struct Repeatability {
    /// Their difference, in units of the sensors' noise.
    pub(super) floor: Option<f64>,
    /// The variables on which the difference depends where it is more than noise; the largest share first.
    pub(super) follows: Vec<FailureLocation>,
    /// Why nothing is known of it, where a run was repeated.
    pub(super) why_not: Option<RepeatUnknown>,
}

impl Repeatability {
    /// Under `model` with the noise of the runs; empty without a repeated run, or where the sensors' noise is
    /// not known at rest. Where lost rows make much of the difference, it is not known whether the machine repeats.
    pub(super) fn of(model: &Model, evidence: &Evidence, noise: Noise) -> Self {
        let is_known = evidence.noise.source == FloorSource::Standstill;
        let Some(repeat) = evidence.repeat.as_ref().filter(|_| is_known) else {
            return Self::default();
        };
        let runs = [evidence.first_run(), repeat];
        let lost_rows = runs.map(|run| {
            let unpredicted = unpredicted_in(run, model, noise, is_known)?;
            Some(unpredicted.in_noise(&evidence.noise)?.lost_rows)
        });
        let [Some(first), Some(second)] = lost_rows else {
            return Self::not_known(RepeatUnknown::NotFollowed);
        };
        let lost_rows = first.hypot(second) / f64::sqrt(2.0);
        let floor = Floor::new(evidence, Unpredicted { lost_rows, stamps: 0.0 });
        if floor.highest() > REPEATS_RATIO {
            return Self::not_known(RepeatUnknown::RowsLost);
        }
        let found = || -> Result<Self, FitError> {
            let floor = in_noise(not_repeated(model, runs, &evidence.noise)?, &evidence.noise);
            let mut found = Self { floor, ..Self::default() };
            if found.repeats() == Some(false) {
                found.follows = locate_difference(model, runs, &evidence.noise)?;
            }
            Ok(found)
        };
        found().unwrap_or_else(|error| Self::not_known(RepeatUnknown::Failed(error.to_string())))
    }

    fn not_known(why: RepeatUnknown) -> Self {
        Self { why_not: Some(why), ..Self::default() }
    }

    /// Whether the difference is little more than the sensors' noise; none where it is not known.
    pub(super) fn repeats(&self) -> Option<bool> {
        self.floor.map(|floor| floor <= REPEATS_RATIO)
    }

    /// Ratio of the sensors' noise in motion to that at rest, as far as a repeated run shows it.
    pub(super) fn in_motion(&self) -> f64 {
        self.floor.map_or(1.0, |floor| floor.clamp(1.0, REPEATS_RATIO))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_model::plant::testing::with_a_fan;

    #[test]
    fn lost_rows_raise_the_floor() {
        let evidence = Evidence::new(with_a_fan(0), Some(with_a_fan(1)), None);
        assert_eq!(evidence.noise.source, FloorSource::Standstill);
        let of = |lost_rows, stamps| Floor::new(&evidence, Unpredicted { lost_rows, stamps });
        let (whole, lossy, stamped) = (of(0.0, 0.0), of(0.75, 0.0), of(0.0, 0.75));
        // Stamps err at every edge: their mean counts, once.
        assert!((stamped.expected() - 1.25).abs() < 1e-12 && !stamped.is_reached(1.6));
        assert!(stamped.is_noise(1.3) && !lossy.is_noise(1.3));
        assert!((lossy.expected() - 1.25).abs() < 1e-12);
        assert!(whole.is_reached(1.05) && !whole.is_reached(1.6) && lossy.is_reached(1.6));
        assert!(!lossy.is_reached(2.2));
        assert!((whole.explained(2.0, 1.25) - 0.8125).abs() < 1e-12);
        assert!((lossy.explained(2.0, 1.25) - 1.0).abs() < 1e-12);
        // Below what stamps were expected to make: by much, or hardly.
        let high = of(0.0, 3.0);
        assert!((high.explained(2.9, 1.9) - 1.0).abs() < 1e-12);
        assert!(high.explained(2.0, 1.9).abs() < 1e-12);
    }
}
