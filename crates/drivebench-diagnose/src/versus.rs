//! Comparison of two models on the same held-out run: the better one, the difference, and its significance.
//!
//! Their errors are compared sample by sample (a paired test). Neighbouring errors of a model that lacks
//! an effect are correlated, so that samples are not independent: the run is cut into blocks, and each block is one
//! observation.

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::evidence::Evidence;
use super::mechanical::Balance;
use super::score::Score;
use drivebench_identify::noise::FloorSource;
use drivebench_identify::output_error::FitError;
use drivebench_model::findings;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::{extent, mean, variance};
use drivebench_model::plant::{Input, Model};

/// Blocks into which the held-out run is cut.
const BLOCKS: usize = 20;
/// Confidence of the test.
const CONFIDENCE: f64 = 0.99;

/// Which of two models is significantly better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Better {
    First,
    Second,
    /// The difference is not significant.
    NotToldApart,
}

/// Root mean square errors of both models in one signal, on the hold-out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SignalVersus {
    pub signal: &'static str,
    pub unit: &'static str,
    pub rmse: [f64; 2],
    pub fit_percent: [f64; 2],
}

/// The comparison of two models.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Versus {
    pub better: Better,
    pub signals: Vec<SignalVersus>,
    /// Errors of both on the hold-out, in units of the noise floor, or of the baseline's error where none is known.
    pub holdout_rmse: [f64; 2],
    pub noise_floor_from: FloorSource,
    /// Mean over the blocks of the first model's squared error less the second's, in squared units of the noise, and its
    /// standard error. Null with fewer than two blocks.
    pub difference: Option<f64>,
    pub difference_std: Option<f64>,
    pub blocks: usize,
    /// Standard errors beyond which a difference is significant.
    pub limit: f64,
    #[serde(rename = "code")]
    pub finding: VersusFinding,
}

findings! {
    /// Result of the comparison of two models.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum VersusFinding {
        FirstBetter = "first_is_better",
        SecondBetter = "second_is_better",
        NotToldApart = "not_told_apart",
        Same = "both_are_the_same",
        TooShort = "holdout_too_short",
    }
}

/// Compares two complete models as they are on the hold-out.
pub fn versus(models: [&Model; 2], evidence: &Evidence) -> Result<Versus, FitError> {
    let (scores, levels, source) = if evidence.training.input == Input::Voltage {
        let noise = &evidence.noise;
        let score = |model| Score::of(model, &evidence.holdout, noise);
        let scores = [score(models[0])?, score(models[1])?];
        (scores, [noise.current_a, noise.speed_rad_s, f64::NAN], noise.source)
    } else {
        let (balance, _) = Balance::new(models[0], evidence)?;
        let score = |model| balance.score(model, &balance.sides.holdout);
        let scores = [score(models[0]), score(models[1])];
        (scores, [f64::NAN, f64::NAN, balance.unit_n_m], balance.source)
    };
    let ByBlocks { better, difference, difference_std, blocks, limit } =
        ByBlocks::of([&scores[0], &scores[1]], levels);
    Ok(Versus {
        better,
        signals: signals(&scores),
        holdout_rmse: scores.each_ref().map(|score| score.nrms),
        noise_floor_from: source,
        difference,
        difference_std,
        blocks,
        limit,
        finding: match (difference, better) {
            (None, _) => VersusFinding::TooShort,
            (_, Better::First) => VersusFinding::FirstBetter,
            (_, Better::Second) => VersusFinding::SecondBetter,
            (Some(0.0), Better::NotToldApart) => VersusFinding::Same,
            (_, Better::NotToldApart) => VersusFinding::NotToldApart,
        },
    })
}

/// Paired comparison of two models over the blocks of a run.
pub(super) struct ByBlocks {
    pub(super) better: Better,
    difference: Option<f64>,
    difference_std: Option<f64>,
    blocks: usize,
    limit: f64,
}

impl ByBlocks {
    /// `levels`: units of the errors of current, speed and torque; not finite where a signal is not judged.
    pub(super) fn of(scores: [&Score; 2], levels: [f64; 3]) -> Self {
        let blocks = blocks(scores, levels);
        let limit = StudentsT::new(0.0, 1.0, (blocks.len().max(2) - 1) as f64)
            .map_or(f64::INFINITY, |t| t.inverse_cdf(0.5 + 0.5 * CONFIDENCE));
        let counted = blocks.len() >= 2;
        let difference = counted.then(|| mean(&blocks));
        let difference_std = counted.then(|| (variance(&blocks) / blocks.len() as f64).sqrt());
        // Averaged over signals and blocks in two ways: where these do not agree neither model is called the better.
        let agrees = |difference: f64| difference * (scores[0].nrms - scores[1].nrms) > 0.0;
        let is_significant =
            |(difference, std): &(f64, f64)| difference.abs() > limit * std && agrees(*difference);
        let better = match difference.zip(difference_std).filter(is_significant) {
            Some((difference, _)) if difference > 0.0 => Better::Second,
            Some(_) => Better::First,
            None => Better::NotToldApart,
        };
        Self { better, difference, difference_std, blocks: blocks.len(), limit }
    }
}

/// Mean of the first model's squared errors less the second's over each block, in units of the noise.
fn blocks(scores: [&Score; 2], levels: [f64; 3]) -> Vec<f64> {
    let [first, second] = scores;
    let pairs = [
        (&first.current_residual, &second.current_residual, levels[0]),
        (&first.speed_residual, &second.speed_residual, levels[1]),
        (&first.torque_residual, &second.torque_residual, levels[2]),
    ];
    let judged = || pairs.iter().filter(|pair| pair.2.is_finite());
    let times: Vec<f64> = judged().flat_map(|pair| pair.0.iter().map(|point| point.0)).collect();
    let (begin_s, end_s) = extent(&times);
    if times.is_empty() || end_s <= begin_s {
        return Vec::new();
    }
    let block_s = (end_s - begin_s) / BLOCKS as f64;
    let mut sums = vec![(0.0, 0_usize); BLOCKS];
    for (one, other, level) in judged() {
        let mut others = other.iter().peekable();
        for (time_s, error) in *one {
            while others.next_if(|point| point.0 < *time_s).is_some() {}
            let same = others.peek().filter(|point| point.0 <= *time_s);
            let Some((_, rival)) = same else { continue };
            let block = whole((time_s - begin_s) / block_s).min(BLOCKS - 1);
            sums[block].0 += (error * error - rival * rival) / (level * level);
            sums[block].1 += 1;
        }
    }
    sums.into_iter().filter(|sum| sum.1 > 0).map(|(sum, count)| sum / count as f64).collect()
}

fn signals(scores: &[Score; 2]) -> Vec<SignalVersus> {
    let [first, second] = scores;
    let pairs = [
        ("speed_rad_s", "rad/s", first.speed, second.speed),
        ("current_a", "A", first.current, second.current),
        ("torque_n_m", "N.m", first.torque, second.torque),
    ];
    let both = pairs.into_iter().filter_map(|(signal, unit, first, second)| {
        let both = [first?, second?];
        let (rmse, fit_percent) = (both.map(|own| own.rmse), both.map(|own| own.fit_percent));
        Some(SignalVersus { signal, unit, rmse, fit_percent })
    });
    both.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{nameplate, truth};
    use drivebench_model::plant::testing::{held, record};
    use drivebench_model::plant::{Motor, MotorKey};

    fn evidence(model: &Model) -> Evidence {
        let events = || held([0.0, 0.5, 1.5, 2.5, 3.5], [0.0, 40.0, -30.0, 15.0, 0.0]);
        let run = |seed| record(model, events(), 0.002, 4.5, seed);
        Evidence::new(run(1), Some(run(2)), None)
    }

    #[test]
    fn the_true_model_is_better_in_either_order() {
        let truth = truth("viscous_friction", &[8e-4]);
        let evidence = evidence(&truth);
        let bare = nameplate();
        let found = versus([&bare, &truth], &evidence).unwrap();
        assert_eq!(found.better, Better::Second, "{found:?}");
        assert_eq!(found.finding, VersusFinding::SecondBetter);
        assert!((found.holdout_rmse[1] - 1.0).abs() < 0.1, "{found:?}");
        let swapped = versus([&truth, &bare], &evidence).unwrap();
        assert_eq!(swapped.better, Better::First);
        let sum = found.difference.unwrap() + swapped.difference.unwrap();
        assert!(sum.abs() < 1e-9, "{sum}");
    }

    #[test]
    fn a_difference_below_the_noise_is_not_significant() {
        let truth = nameplate();
        let evidence = evidence(&truth);
        let inertia =
            |share: f64| Model::baseline(Motor::zk_22fc().with(MotorKey::Inertia, 0.0045 * share));
        let found = versus([&inertia(1.0 + 2e-5), &inertia(1.0 - 2e-5)], &evidence).unwrap();
        assert_eq!(found.better, Better::NotToldApart, "{found:?}");
        assert_eq!(found.finding, VersusFinding::NotToldApart);
        let same = versus([&truth, &truth], &evidence).unwrap();
        assert_eq!(same.better, Better::NotToldApart);
        assert_eq!(same.finding, VersusFinding::Same);
    }
}
