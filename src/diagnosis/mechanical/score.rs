//! How well a torque balance holds on rows that the fit has not seen, and whether one holds better than another.

use crate::diagnosis::bootstrap;
use crate::identification::torque_rows::TorqueRows;
use crate::numerics::count::whole;
use crate::numerics::statistics;

/// Shortest block, s, and the fewest blocks (DISCOVERY.md, rule 3).
const BLOCK_S: f64 = 0.2;
const FEWEST_BLOCKS: f64 = 20.0;
/// Blocks below which nothing is said.
const TOO_FEW: usize = 8;
/// Fine blocks over which the correlation time of the log ratio is found.
const FINE: f64 = 200.0;
/// Correlation times in a block.
const CORRELATION_TIMES: f64 = 5.0;

/// Residuals of a torque balance.
#[derive(Clone, Debug)]
pub(super) struct Score {
    pub(super) time_s: Vec<f64>,
    pub(super) residual: Vec<f64>,
    /// Root mean square of the residual, N.m.
    pub(super) rmse: f64,
    /// Over that of the motor torque, per cent.
    pub(super) relative_percent: f64,
    /// `100 (1 - |e| / |y - mean y|)`.
    pub(super) fit_percent: f64,
}

impl Score {
    pub(super) fn of(predicted: &[f64], rows: &TorqueRows) -> Self {
        let residual: Vec<f64> = rows
            .left
            .iter()
            .zip(predicted)
            .map(|(left, predicted)| left - predicted)
            .collect();
        let rms = |values: &[f64]| {
            (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
        };
        let mean = statistics::mean(&rows.left);
        let spread: Vec<f64> = rows.left.iter().map(|left| left - mean).collect();
        let rmse = rms(&residual);
        Self {
            rmse,
            relative_percent: 100.0 * rmse / rms(&rows.left).max(f64::MIN_POSITIVE),
            fit_percent: 100.0 * (1.0 - rmse / rms(&spread).max(f64::MIN_POSITIVE)),
            time_s: rows.time_s.clone(),
            residual,
        }
    }

    fn duration_s(&self) -> f64 {
        self.time_s.last().unwrap_or(&0.0) - self.time_s.first().unwrap_or(&0.0)
    }

    /// Sums of squares in blocks; a block without rows is zero.
    pub(super) fn blocks(&self, block_s: f64) -> Vec<f64> {
        let Some(first) = self.time_s.first() else {
            return Vec::new();
        };
        let mut blocks = vec![0.0; whole(self.duration_s() / block_s) + 1];
        for (time_s, residual) in self.time_s.iter().zip(&self.residual) {
            blocks[whole((time_s - first) / block_s)] += residual * residual;
        }
        blocks
    }
}

/// Time over which a series remembers itself: half of `1 + 2 sum rho`, in seconds; the sum stops where the correlation
/// is lost in chance.
pub(super) fn correlation_time_s(time_s: &[f64], values: &[f64]) -> f64 {
    let n = values.len();
    if n < TOO_FEW {
        return 0.0;
    }
    let period_s = (time_s[time_s.len() - 1] - time_s[0]) / (n - 1) as f64;
    0.5 * period_s * correlation_sum(values)
}

/// `1 + 2 sum rho` up to the first lag within chance.
fn correlation_sum(values: &[f64]) -> f64 {
    let chance = 2.0 / (values.len() as f64).sqrt();
    let sum: f64 = statistics::autocorrelation(values, values.len() / 4)
        .into_iter()
        .take_while(|rho| *rho > chance)
        .sum();
    1.0 + 2.0 * sum
}

fn log_ratios(worse: &Score, better: &Score, block_s: f64) -> Vec<f64> {
    worse
        .blocks(block_s)
        .into_iter()
        .zip(better.blocks(block_s))
        .filter(|(worse, better)| *worse > 0.0 && *better > 0.0)
        .map(|(worse, better)| (worse / better).ln())
        .collect()
}

/// Length of the blocks of the paired test: five correlation times of the log ratio, never fewer than twenty blocks.
fn block_s(worse: &Score, better: &Score, stretch: f64) -> f64 {
    let duration_s = worse.duration_s();
    let fine_s = (duration_s / FINE).max(f64::MIN_POSITIVE);
    let memory_s = 0.5 * fine_s * correlation_sum(&log_ratios(worse, better, fine_s));
    (stretch * BLOCK_S.max(CORRELATION_TIMES * memory_s))
        .min(duration_s / FEWEST_BLOCKS)
        .max(f64::MIN_POSITIVE)
}

/// Mean log-ratio of the blocks' squared errors of `worse` over `better`, in its standard errors (DISCOVERY.md 2.8).
/// Where twenty blocks are not yet independent their correlation widens the standard error.
pub(super) fn z(worse: &Score, better: &Score, stretch: f64) -> f64 {
    let ratios = log_ratios(worse, better, block_s(worse, better, stretch));
    let n = ratios.len();
    if n < TOO_FEW {
        return 0.0;
    }
    let mean = statistics::mean(&ratios);
    let variance = statistics::variance(&ratios) * correlation_sum(&ratios);
    if variance <= 0.0 {
        return if mean > 0.0 { f64::INFINITY } else { 0.0 };
    }
    mean / (variance / n as f64).sqrt()
}

/// Share of block bootstraps of the hold-out in which each score has the smallest error.
pub(super) fn first_rank_shares(scores: &[&Score]) -> Vec<f64> {
    let block_s = scores.first().map_or(BLOCK_S, |score| {
        BLOCK_S.min(score.duration_s() / FEWEST_BLOCKS)
    });
    let blocks: Vec<Vec<f64>> = scores
        .iter()
        .map(|score| score.blocks(block_s.max(f64::MIN_POSITIVE)))
        .collect();
    bootstrap::first_rank_shares(&blocks)
}
