//! How much is random in a run: by marginal likelihood with every effect in under its slab.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::columns::{Around, Linear};
use super::follow::{Deviation, Noise, corrected, jump_of, predicted, Passage, P, VOLTAGE_S};
use super::select::Reduced;
use crate::plant::Input;

/// Interval over which samples are averaged, s: the disturbance is slower.
const BLOCK_S: f64 = 6e-3;

/// One run in averages, whatever noise it was whitened with.
struct Averaged {
    passages: Vec<(Passage, bool)>,
    /// Samples that were averaged: current, speed.
    counts: Vec<[f64; 2]>,
    /// Block by block: current and speed of every column, the residual last.
    values: Vec<Vec<[f64; 2]>>,
}

/// Columns that stand for all: the motor's, and each candidate's likeliest form.
fn representatives(linear: &Linear, reduced: &Reduced<'_>, likeliest: &[usize]) -> Vec<usize> {
    let _ = reduced;
    let mut columns: Vec<usize> = (0..linear.nuisances.len()).collect();
    for (candidate, variant) in linear.candidates.iter().zip(likeliest) {
        columns.extend(&candidate.variants[*variant].columns);
    }
    columns
}

fn averaged(run: &Around<'_>, whitened: &DMatrix<f64>, present: &DVector<f64>, columns: &[usize]) -> Averaged {
    let n = run.scenario.samples();
    let times = &run.scenario.sample_time_s;
    let period_s = (times[n - 1] - times[0]) / (n - 1) as f64;
    let size = ((BLOCK_S / period_s).floor() as usize).max(1);
    let blocks = n.div_ceil(size);
    let mut counts = vec![[0.0; 2]; blocks];
    for sample in 0..n {
        let update = &run.follower.updates[sample];
        counts[sample / size][0] += f64::from(u8::from(update.current[4] > 0.0));
        counts[sample / size][1] += f64::from(u8::from(update.speed[4] > 0.0));
    }
    let mut passages = Vec::with_capacity(blocks);
    for block in 0..blocks {
        let range = block * size..((block + 1) * size).min(n);
        let mut kept = 1.0;
        let mut form = [0.0; 2];
        let mut interval_s = 0.0;
        let mut jumps = false;
        let mut direction = 0.0;
        for sample in range {
            let passage = &run.follower.passages[sample];
            kept *= passage.kept;
            for k in 0..2 { form[k] += passage.form[k] / size as f64; }
            interval_s += passage.interval_s;
            let last = if sample > 0 { run.followed.direction[sample - 1] } else { 0.0 };
            jumps |= passage.direction != 0.0 && passage.direction != last && sample > 0;
            direction = passage.direction;
        }
        passages.push((
            Passage {
                propagator: run.dynamics.over(interval_s, direction == 0.0),
                interval_s,
                direction,
                kept,
                form,
                voltage_keeps: (-interval_s / VOLTAGE_S).exp(),
            },
            jumps,
        ));
    }
    let shift: DVector<f64> = whitened * present;
    let turn = |value: &dyn Fn(usize) -> [f64; 2]| -> Vec<[f64; 2]> {
        let mut sums = vec![[0.0; 2]; blocks];
        let mut track = Deviation::default();
        for sample in 0..n {
            let passage = &run.follower.passages[sample];
            if passage.interval_s > 0.0 {
                track.pass(passage, [0.0; 2], run.follower.forgets[sample], &run.dynamics);
            }
            let z = track.colour(&run.follower.updates[sample], value(sample));
            let update = &run.follower.updates[sample];
            if update.current[4] > 0.0 { sums[sample / size][0] += z[0]; }
            if update.speed[4] > 0.0 { sums[sample / size][1] += z[1]; }
        }
        for (sum, count) in sums.iter_mut().zip(&counts) {
            for k in 0..2 {
                if count[k] > 0.0 { sum[k] /= count[k]; }
            }
        }
        sums
    };
    let mut each: Vec<Vec<[f64; 2]>> = columns
        .par_iter()
        .map(|c| turn(&|sample| [whitened[(2 * sample, *c)], whitened[(2 * sample + 1, *c)]]))
        .collect();
    each.push(turn(&|sample| {
        let white = run.followed.white[sample];
        [white[0] + shift[2 * sample], white[1] + shift[2 * sample + 1]]
    }));
    let values = (0..blocks).map(|block| each.iter().map(|column| column[block]).collect()).collect();
    Averaged { passages, counts, values }
}

impl Averaged {
    /// Adds to the normal matrix (residual last) and returns the sum of the logarithms of the variances.
    fn filter(&self, run: &Around<'_>, noise: &Noise, sums: &mut DMatrix<f64>) -> f64 {
        let k = self.values[0].len();
        let jump = jump_of(run.scenario);
        let mut states = vec![Deviation::default(); k];
        let mut p: P = [[0.0; 4]; 4];
        let stationary = noise.disturbance_n_m.powi(2);
        p[2][2] = stationary;
        p[3][3] = noise.voltage_v.powi(2);
        let mut log = 0.0;
        let mut rows = vec![[0.0; 2]; k];
        let mut buffer: Vec<f64> = Vec::with_capacity(256 * k);
        let mut flush = |buffer: &mut Vec<f64>, sums: &mut DMatrix<f64>| {
            let m = DMatrix::from_column_slice(k, buffer.len() / k, buffer);
            let t = m.transpose();
            sums.gemm(1.0, &m, &t, 1.0);
            buffer.clear();
        };
        for (block, (passage, jumps)) in self.passages.iter().enumerate() {
            let forget = (-passage.interval_s / noise.correlation_s).exp();
            p = predicted(&p, passage, &run.dynamics, noise, forget);
            if *jumps { p[1][1] += jump; }
            if passage.direction == 0.0 {
                for j in 0..4 { p[1][j] = 0.0; p[j][1] = 0.0; }
            }
            for state in &mut states {
                state.pass(passage, [0.0; 2], forget, &run.dynamics);
            }
            let counts = self.counts[block];
            for signal in 0..2 {
                if counts[signal] == 0.0 {
                    for row in &mut rows { row[signal] = 0.0; }
                    continue;
                }
                let sigma = if signal == 0 { noise.current_a } else { noise.speed_rad_s };
                let s = p[signal][signal] + sigma * sigma / counts[signal];
                let gain = [p[0][signal] / s, p[1][signal] / s, p[2][signal] / s, p[3][signal] / s];
                p = corrected(&p, &gain, signal);
                log += s.ln();
                let over = 1.0 / s.sqrt();
                for ((state, value), row) in states.iter_mut().zip(&self.values[block]).zip(&mut rows) {
                    let e = value[signal] - state.0[signal];
                    for (state, gain) in state.0.iter_mut().zip(gain) { *state += gain * e; }
                    row[signal] = e * over;
                }
            }
            for signal in 0..2 {
                if counts[signal] > 0.0 { buffer.extend(rows.iter().map(|row| row[signal])); }
            }
            if buffer.len() >= 256 * k { flush(&mut buffer, sums); }
        }
        flush(&mut buffer, sums);
        log
    }
}

/// The noise that makes the runs likeliest, from `start` on; `floor` is what the sensors show at rest.
pub fn likeliest(runs: &[Around<'_>], linear: &Linear, reduced: &Reduced<'_>, forms: &[usize], floor: &Noise, start: Noise) -> Noise {
    let columns = representatives(linear, reduced, forms);
    let m = linear.nuisances.len();
    let data: Vec<Averaged> = runs.iter().zip(&linear.columns).map(|(run, w)| averaged(run, w, &linear.present, &columns)).collect();
    let k = columns.len();
    let voltage_driven = runs[0].scenario.input == Input::Voltage;
    let log_likelihood = |noise: &Noise| -> f64 {
        let parts: Vec<(f64, DMatrix<f64>)> = runs
            .par_iter()
            .zip(&data)
            .map(|(run, data)| {
                let mut sums = DMatrix::zeros(k + 1, k + 1);
                let log = data.filter(run, noise, &mut sums);
                (log, sums)
            })
            .collect();
        let mut sums = DMatrix::zeros(k + 1, k + 1);
        let mut log = 0.0;
        for (l, s) in parts { log += l; sums += s; }
        let mut a = sums.view((0, 0), (k, k)).into_owned();
        for d in 0..k { a[(d, d)] += if d < m { 1.0 / linear.nuisances[d].powi(2) } else { 1.0 }; }
        let mut b = sums.view((0, k), (k, 1)).column(0).into_owned();
        for (b, column) in b.iter_mut().zip(&columns) {
            if *column >= m { *b += reduced.prior[*column - m]; }
        }
        let Some(factor) = a.cholesky() else { return f64::NEG_INFINITY };
        let explained = b.dot(&factor.solve(&b));
        let det: f64 = factor.l().diagonal().iter().map(|d| d.ln()).sum();
        let prior = -0.5 * ((noise.current_a / floor.current_a).ln() / 0.1).powi(2) - 0.5 * ((noise.speed_rad_s / floor.speed_rad_s).ln() / 0.1).powi(2)
            - 0.5 * ((noise.correlation_s / 0.5).ln() / 0.8).powi(2);
        -0.5 * (sums[(k, k)] - explained) - det - 0.5 * log + prior
    };
    let mut now = start;
    let mut best = log_likelihood(&now);
    let mut step = 0.8;
    let change = |noise: &Noise, which: usize, by: f64| -> Noise {
        let mut n = *noise;
        match which {
            0 => n.disturbance_n_m = (n.disturbance_n_m * by.exp()).max(1e-6 * floor.disturbance_n_m),
            1 => n.voltage_v = (n.voltage_v * by.exp()).max(1e-6),
            2 => n.correlation_s = (n.correlation_s * by.exp()).clamp(0.02, 3.0),
            3 => n.current_a = (n.current_a * (0.1 * by).exp()).clamp(0.9 * floor.current_a, 1.1 * floor.current_a),
            _ => n.speed_rad_s = (n.speed_rad_s * (0.1 * by).exp()).clamp(0.9 * floor.speed_rad_s, 1.1 * floor.speed_rad_s),
        }
        n
    };
    while step > 0.15 {
        let mut moved = false;
        for which in 0..5 {
            if !voltage_driven && (which == 1 || which == 3) { continue; }
            for sign in [1.0, -1.0] {
                let mut stride = sign * step;
                loop {
                    let next = change(&now, which, stride);
                    let log = log_likelihood(&next);
                    if log > best + 0.05 {
                        best = log;
                        now = next;
                        moved = true;
                        stride *= 1.6;
                    } else { break; }
                }
            }
        }
        if !moved { step *= 0.4; }
    }
    now
}
