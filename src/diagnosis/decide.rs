//! The decision: paired block log-ratio test on the hold-out, blocks that are mended, share explained, rivals
//! (DISCOVERY.md 2.8).

use super::bootstrap;
use super::evidence::Evidence;
use super::score::Score;
use crate::identification::noise::FloorSource;

/// z above which one model beats another.
pub(super) const SIGNIFICANT: f64 = 3.0;
/// Smallest reduction of the held-out error that is worth an effect.
pub(super) const WORTHWHILE: f64 = 0.01;
/// Error in units of the floor below which a model explains the run to the noise.
pub(super) const AT_THE_FLOOR: f64 = 1.1;
/// Shares of the explainable error from which a named set is sufficient, and below which nothing is named.
pub(super) const SUFFICIENT: f64 = 0.9;
pub(super) const EXPLAINS_SOMETHING: f64 = 0.3;

/// What a test may turn by a fifth: the answer must not depend on it (DISCOVERY.md, rule 6).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Length of the blocks of the paired test in units of the usual one.
    pub block: f64,
    /// z above which one model beats another.
    pub significant: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            block: 1.0,
            significant: SIGNIFICANT,
        }
    }
}

const BLOCK_S: f64 = 0.2;
const FEWEST_BLOCKS: usize = 20;
/// Blocks below which their spread says nothing, so that nothing is significant.
const TOO_FEW: usize = 4;

/// Correlation of neighbouring blocks from which on they are not taken for independent.
const CORRELATED: f64 = 0.3;

/// Mean log-ratio of the blocks' squared errors of `worse` over `better`, in its standard errors. Blocks grow until
/// neighbours are independent, or until there are only twenty: an effect that grows over the run makes them alike itself,
/// so that what correlation is left then is no reason against it.
pub(super) fn z(worse: &Score, better: &Score, settings: Settings) -> f64 {
    let mut block_s = shortest_block_s(worse, settings);
    loop {
        let ratios = log_ratios(worse, better, block_s);
        let n = ratios.len() as f64;
        if ratios.len() < TOO_FEW {
            return 0.0;
        }
        let mean = ratios.iter().sum::<f64>() / n;
        let squares: f64 = ratios.iter().map(|ratio| (ratio - mean).powi(2)).sum();
        let neighbours: f64 = ratios
            .windows(2)
            .map(|pair| (pair[0] - mean) * (pair[1] - mean))
            .sum();
        let is_correlated = squares > 0.0 && neighbours / squares > CORRELATED;
        if is_correlated && worse.duration_s() / (2.0 * block_s) >= FEWEST_BLOCKS as f64 {
            block_s *= 2.0;
            continue;
        }
        if squares <= 0.0 {
            return if mean > 0.0 { f64::INFINITY } else { 0.0 };
        }
        return mean / (squares / (n - 1.0) / n).sqrt();
    }
}

fn shortest_block_s(score: &Score, settings: Settings) -> f64 {
    (settings.block * BLOCK_S)
        .min(score.duration_s() / FEWEST_BLOCKS as f64)
        .max(f64::MIN_POSITIVE)
}

/// Blocks of far fewer samples than the others, as the last one of a run, would count as much as those.
fn log_ratios(worse: &Score, better: &Score, block_s: f64) -> Vec<f64> {
    let blocks = worse
        .counted_blocks(block_s)
        .into_iter()
        .zip(better.counted_blocks(block_s));
    let blocks: Vec<_> = blocks.collect();
    let fullest = blocks.iter().map(|((_, count), _)| *count).max();
    blocks
        .into_iter()
        .filter(|((_, count), _)| 2 * count > fullest.unwrap_or(0))
        .filter(|((worse, _), (better, _))| *worse > 0.0 && *better > 0.0)
        .map(|((worse, _), (better, _))| (worse / better).ln())
        .collect()
}

/// Share of the explainable error that is explained: `1 - (v^2 - f^2)/(v0^2 - f^2)`; an error below the floor, which is
/// itself an estimate, explains everything and no more.
pub(super) fn explained(before: f64, after: f64, floor: f64) -> f64 {
    let explainable = before * before - floor * floor;
    if explainable <= 0.0 {
        0.0
    } else {
        (1.0 - (after * after - floor * floor) / explainable).min(1.0)
    }
}

/// The floor, raised by what it is uncertain by, because it was estimated from few samples.
fn highest_floor(evidence: &Evidence) -> f64 {
    evidence.floor() * evidence.noise.tolerance(1.0)
}

/// Share of the error above the highest floor that `now` explains of what `before` leaves.
pub(super) fn explained_beyond_doubt(evidence: &Evidence, before: &Score, now: &Score) -> f64 {
    explained(before.nrms, now.nrms, highest_floor(evidence))
}

/// Whether an error is no more than the noise.
pub(super) fn at_the_floor(evidence: &Evidence, nrms: f64) -> bool {
    nrms < evidence.floor() * evidence.noise.tolerance(AT_THE_FLOOR)
}

/// Whether a set of effects explains enough to be named: one of it alone a good part, or all of them nearly everything.
/// Several that each explain a little of an error that is none of them are not an answer.
pub(super) fn explains(evidence: &Evidence, base: &Score, alone: &Score, all: &Score) -> bool {
    let floor = highest_floor(evidence);
    let share = |score: &Score| explained_beyond_doubt(evidence, base, score);
    share(alone) >= EXPLAINS_SOMETHING && share(all) >= EXPLAINS_SOMETHING
        || share(all) >= SUFFICIENT
        || base.nrms <= floor
}

/// Whether `candidate` pays on the hold-out.
pub(super) fn pays(base: &Score, candidate: &Score, settings: Settings) -> bool {
    falls(base, candidate)
        && (z(base, candidate, settings) >= settings.significant
            || mends(base, candidate, settings))
}

/// Whether the held-out error falls with `candidate` by what is worth an effect, chance or not.
fn falls(base: &Score, candidate: &Score) -> bool {
    candidate.nrms <= (1.0 - WORTHWHILE) * base.nrms
}

/// Standard deviations by which a block must leave the noise to count as failed, and blocks that must be mended.
const FAILED: f64 = 5.0;
const FEWEST_MENDED: usize = 3;
/// The same as a multiple of what a candidate leaves that explains nearly everything, but not to the noise.
const FAR_ABOVE: f64 = 4.0;

/// Whether the candidate explains the run to its noise, or nearly, while the base fails in several blocks, and fails in
/// none that the base explains. An effect that shows for a short time only, as at a passage through zero or at a start,
/// leaves most blocks as they are; their mean says little however plain the few are. Needs a known noise.
fn mends(base: &Score, candidate: &Score, settings: Settings) -> bool {
    let noise = candidate.noise();
    let to_the_noise = candidate.nrms < noise.tolerance(AT_THE_FLOOR);
    let nearly = explained(base.nrms, candidate.nrms, noise.tolerance(1.0)) >= SUFFICIENT;
    if noise.source == FloorSource::None || !(to_the_noise || nearly) {
        return false;
    }
    let level = if to_the_noise {
        1.0
    } else {
        FAR_ABOVE * candidate.nrms.powi(2)
    };
    let block_s = settings.block * BLOCK_S;
    let (mut mended, mut spoilt) = (0, 0);
    let blocks = base
        .counted_blocks(block_s)
        .into_iter()
        .zip(candidate.counted_blocks(block_s));
    for ((before, count), (after, _)) in blocks {
        if count == 0 {
            continue;
        }
        let noise_limit = noise.tolerance(1.0).powi(2) + FAILED * (2.0 / count as f64).sqrt();
        let limit = level * noise_limit;
        match (before / count as f64 > limit, after / count as f64 > limit) {
            (true, false) => mended += 1,
            (false, true) => spoilt += 1,
            _ => {}
        }
    }
    mended >= FEWEST_MENDED && spoilt == 0
}

/// How much smaller the held-out error of `after` is than that of `before`, and how sure that is, in words. What is asked
/// stands behind, so that a refusal can be understood.
pub(super) fn fall_in_words(
    before: &Score,
    after: &Score,
    times: &str,
    settings: Settings,
) -> String {
    let blocks = [before, after].map(|score| score.blocks(BLOCK_S));
    let better = bootstrap::first_rank_shares(&blocks)[1];
    fall(
        [before.nrms, after.nrms].map(|nrms| format!("{nrms:.2}")),
        1.0 - after.nrms / before.nrms,
        &format!(" {times}"),
        Certainty {
            better,
            z: z(before, after, settings),
            asked: settings.significant,
        },
    )
}

/// How sure a fall of the error is.
#[derive(Clone, Copy)]
pub(super) struct Certainty {
    /// Share of the redraws of the hold-out's blocks in which the error falls.
    pub(super) better: f64,
    pub(super) z: f64,
    pub(super) asked: f64,
}

/// A fall (negative: a rise) of the error between two figures, in words.
pub(super) fn fall(
    [before, after]: [String; 2],
    share: f64,
    unit: &str,
    certainty: Certainty,
) -> String {
    let Certainty { better, z, asked } = certainty;
    let (word, percent) = if share >= 0.0 {
        ("falls", 100.0 * share)
    } else {
        ("rises", -100.0 * share)
    };
    let sure = 100.0 * better;
    format!(
        "the held-out error {word} by {percent:.1} %, from {before} to {after}{unit}; it would fall in {sure:.0} of 100 \
         hold-outs like this one (z {z:.1}; {:.0} % and z {asked} are asked)",
        100.0 * WORTHWHILE
    )
}
