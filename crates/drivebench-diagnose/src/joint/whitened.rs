//! Whitened regressor columns of one run, and their Gram matrix in cache-sized blocks.

use std::ops::{Mul, Range};

use nalgebra::{DMatrix, DMatrixView, DVector};
use rayon::prelude::*;

/// Whitened innovations of each column: current and speed, sample by sample; one that ends early is zero beyond. Single
/// precision halves what a long run needs; its rounding is like white noise of 1e-7 of the column. Sums are in double precision.
#[derive(Clone, Debug, Default)]
pub(super) struct Whitened {
    pub columns: Vec<Vec<f32>>,
    rows: usize,
}

/// Rows that are multiplied at once.
const ROWS: usize = 256;
/// Parts of a run that are summed in parallel, whatever the number of threads: sums are the same to the bit.
const PARTS: usize = 8;
/// Columns of one block of a product; blocks below the diagonal are skipped.
const BLOCK: usize = 32;

impl Whitened {
    pub(super) const fn new(columns: Vec<Vec<f32>>, rows: usize) -> Self {
        Self { columns, rows }
    }

    /// The first rows of all columns.
    pub(super) fn beginning(&self, rows: usize) -> Self {
        let columns = self.columns.iter();
        let first = columns.map(|column| column[..rows.min(column.len())].to_vec());
        Self::new(first.collect(), rows)
    }

    /// Products of another column with each of these, with itself, and with the residual.
    pub(super) fn products(&self, other: &[f32], residual: &[[f64; 2]]) -> DVector<f64> {
        let dot = |column: &[f32]| -> f64 {
            column.iter().zip(other).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
        };
        let pairs = residual.iter().flatten().zip(other);
        let rest: f64 = pairs.map(|(a, b)| a * f64::from(*b)).sum();
        let each = self.columns.iter().map(|column| dot(column));
        DVector::from_iterator(self.columns.len() + 2, each.chain([dot(other), rest]))
    }

    /// One number of a column.
    pub(super) fn at(&self, column: usize, row: usize) -> f64 {
        let value = self.columns[column].get(row);
        value.map_or(0.0, |value| f64::from(*value))
    }

    /// `w' w` with `w` these columns and `last` behind them.
    pub(super) fn gram(&self, last: &[[f64; 2]]) -> DMatrix<f64> {
        let p = self.columns.len() + 1;
        // In parts that do not depend on the threads: sums come out the same every time.
        let part = self.rows.div_ceil(PARTS).next_multiple_of(ROWS);
        let sum_of = |number: usize| {
            let mut sum = DMatrix::zeros(p, p);
            // Columns that are not zero in these rows (those of later events are); they change seldom.
            let mut there: Vec<usize> = Vec::new();
            let mut own = DMatrix::zeros(1, 1);
            let mut buffer = Vec::with_capacity(p * ROWS);
            let end = ((number + 1) * part).min(self.rows);
            for first in (number * part..end).step_by(ROWS) {
                let range = first..(first + ROWS).min(end);
                let is_there = |column: &usize| self.is_there(*column, range.clone());
                let now: Vec<usize> = (0..p - 1).filter(is_there).collect();
                if now != there {
                    add_at(&mut sum, &own, &there);
                    own = DMatrix::zeros(now.len() + 1, now.len() + 1);
                    there = now;
                }
                buffer.clear();
                for column in &there {
                    self.extend(*column, range.clone(), &mut buffer);
                }
                buffer.extend(range.clone().map(|row| last[row / 2][row % 2]));
                let w = DMatrixView::from_slice(&buffer, range.len(), own.ncols());
                add_upper(&mut own, &w, &turned(&buffer, range.len()).as_view());
            }
            add_at(&mut sum, &own, &there);
            sum
        };
        let parts = (0..self.rows.div_ceil(part)).into_par_iter().with_max_len(1);
        let sums: Vec<DMatrix<f64>> = parts.map(sum_of).collect();
        // In the order of the parts, so that the sum is the same to the bit on any number of threads.
        let mut gram = sums.into_iter().fold(DMatrix::zeros(p, p), |sum, part| sum + part);
        gram.fill_lower_triangle_with_upper_triangle();
        gram
    }

    /// Whether a column is anything but zero in these rows.
    fn is_there(&self, column: usize, rows: Range<usize>) -> bool {
        let column = &self.columns[column];
        let rows = rows.start.min(column.len())..rows.end.min(column.len());
        column[rows].iter().any(|value| *value != 0.0)
    }

    fn extend(&self, column: usize, rows: Range<usize>, buffer: &mut Vec<f64>) {
        let column = &self.columns[column];
        let there = &column[rows.start.min(column.len())..rows.end.min(column.len())];
        buffer.extend(there.iter().map(|value| f64::from(*value)));
        buffer.extend((there.len()..rows.len()).map(|_| 0.0));
    }
}

/// Adds the upper triangle of products of these columns, and of one behind all others.
fn add_at(sum: &mut DMatrix<f64>, own: &DMatrix<f64>, columns: &[usize]) {
    let last = sum.ncols() - 1;
    let place = |k: usize| columns.get(k).copied().unwrap_or(last);
    for column in 0..own.ncols() {
        for row in 0..=column {
            sum[(place(row), place(column))] += own[(row, column)];
        }
    }
}

/// Rows and columns that are turned at once: both sides stay in the nearest cache.
const TILE: usize = 16;

/// The transpose of a matrix of so many rows, column by column.
pub(super) fn turned(w: &[f64], rows: usize) -> DMatrix<f64> {
    let columns = w.len() / rows;
    let mut turned = DMatrix::zeros(columns, rows);
    let to = turned.as_mut_slice();
    for from in (0..columns).step_by(TILE) {
        for above in (0..rows).step_by(TILE) {
            for column in from..(from + TILE).min(columns) {
                for row in above..(above + TILE).min(rows) {
                    to[row * columns + column] = w[column * rows + row];
                }
            }
        }
    }
    turned
}

/// Adds the blocks on and above the diagonal of `w' w`, of which both factors are given.
pub(super) fn add_upper(
    sum: &mut DMatrix<f64>,
    w: &DMatrixView<'_, f64>,
    turned: &DMatrixView<'_, f64>,
) {
    let p = sum.ncols();
    for from in (0..p).step_by(BLOCK) {
        let width = BLOCK.min(p - from);
        let right = w.columns(from, p - from);
        let mut block = sum.view_mut((from, from), (width, p - from));
        block.gemm(1.0, &turned.rows(from, width), &right, 1.0);
    }
}

/// The columns' sum with these weights.
impl Mul<&DVector<f64>> for &Whitened {
    type Output = DVector<f64>;

    fn mul(self, weights: &DVector<f64>) -> DVector<f64> {
        let mut sum = DVector::zeros(self.rows);
        for (column, weight) in self.columns.iter().zip(weights.iter()) {
            if *weight != 0.0 {
                for (sum, value) in sum.iter_mut().zip(column) {
                    *sum += weight * f64::from(*value);
                }
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_of_columns_that_end_early_or_begin_late() {
        let rows = 2 * ROWS + 38;
        let column = |(k, rows): (usize, usize)| -> Vec<f32> {
            let value = |row: usize| ((row * (k + 3)) % 17) as f32 - 8.0;
            (0..rows).map(value).collect()
        };
        let lengths = [rows, 0, ROWS + 5, rows, 7].into_iter().enumerate();
        let mut each: Vec<Vec<f32>> = lengths.map(column).collect();
        // Zero before a late begin.
        each[3][..ROWS + 10].fill(0.0);
        let whitened = Whitened::new(each.clone(), rows);
        let last: Vec<[f64; 2]> = (0..rows / 2).map(|k| [k as f64 % 5.0, -1.0]).collect();
        let mut w = DMatrix::zeros(rows, 6);
        for (k, column) in each.iter().enumerate() {
            for (row, value) in column.iter().enumerate() {
                w[(row, k)] = f64::from(*value);
                assert!((whitened.at(k, row) - w[(row, k)]).abs() < 1e-12);
            }
        }
        for (row, value) in last.iter().flatten().enumerate() {
            w[(row, 5)] = *value;
        }
        let expected = w.tr_mul(&w);
        assert!((whitened.gram(&last) - &expected).amax() < 1e-6);
        let products = whitened.products(&each[3], &last);
        for k in 0..5 {
            assert!((products[k] - expected[(3, k)]).abs() < 1e-6);
        }
        assert!((products[5] - expected[(3, 3)]).abs() < 1e-6);
        assert!((products[6] - expected[(3, 5)]).abs() < 1e-6);
        let none = Whitened::new(vec![vec![]], rows).gram(&last);
        assert!((none[(1, 1)] - expected[(5, 5)]).abs() < 1e-6 && none[(0, 0)] == 0.0);
        let weights = DVector::from_vec(vec![1.0, 2.0, -0.5, 0.0, 3.0]);
        assert!((&whitened * &weights - w.columns(0, 5) * &weights).amax() < 1e-6);
    }
}
