//! Columns of a table in plain text, each as wide as its widest cell.

/// Width of each column, at least `least`; rows are of equal length.
pub fn widths(rows: &[Vec<String>], least: usize) -> Vec<usize> {
    let count = rows.first().map_or(0, Vec::len);
    let width = |column: usize| {
        let cells = rows.iter().map(|row| row[column].chars().count());
        cells.chain([least]).max().unwrap_or(least)
    };
    (0..count).map(width).collect()
}

/// The cells of a row, filled up to the widths of their columns.
pub fn padded(row: &[String], widths: &[usize]) -> Vec<String> {
    let cells = row.iter().zip(widths);
    cells.map(|(cell, width)| format!("{cell:<width$}")).collect()
}
