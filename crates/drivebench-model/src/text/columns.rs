//! Columns of a table in plain text, each as wide as its widest cell.

/// Width of each column, at least `least`; rows are of equal length.
pub fn widths(rows: &[Vec<String>], least: usize) -> Vec<usize> {
    let count = rows.first().map_or(0, Vec::len);
    let width = |column: usize| {
        rows.iter().map(|row| row[column].chars().count()).chain([least]).max().unwrap_or(least)
    };
    (0..count).map(width).collect()
}

/// The cells of a row, filled up to the widths of their columns.
pub fn padded(row: &[String], widths: &[usize]) -> Vec<String> {
    row.iter().zip(widths).map(|(cell, width)| format!("{cell:<width$}")).collect()
}
