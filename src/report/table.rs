//! Tables: rows under a head, built column by column, and their forms for a terminal and as comma-separated values.

use drivebench_model::text::lines::{cut, wrapped};
use drivebench_model::text::{columns, number};

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Cell {
    pub(super) text: String,
    /// Smaller, below the text; not in the plain-text form.
    pub(super) note: Option<String>,
    pub(super) code: bool,
}

impl<T: Into<String>> From<T> for Cell {
    fn from(text: T) -> Self {
        Self::text(text)
    }
}

impl Cell {
    pub fn text(text: impl Into<String>) -> Self {
        Self { text: text.into(), ..Self::default() }
    }

    /// A key as it is written in files.
    pub fn code(text: impl Into<String>) -> Self {
        Self { code: true, ..Self::text(text) }
    }

    #[must_use]
    pub fn with_note(mut self, note: impl Into<String>) -> Self {
        self.note = Some(note.into());
        self
    }
}

/// Rows under a head; every row is filled up or cut to the width of the head.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Table {
    pub head: Vec<&'static str>,
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// One row for each of these; the columns are still to come.
    pub fn of<T>(rows: impl IntoIterator<Item = T>) -> Columns<T> {
        let rows: Vec<T> = rows.into_iter().collect();
        let table = Self { head: Vec::new(), rows: vec![Vec::new(); rows.len()] };
        Columns { rows, table }
    }

    /// Head and rows without notes.
    pub(super) fn texts(&self) -> Vec<Vec<String>> {
        let head = self.head.iter().map(|head| (*head).to_owned()).collect();
        let text = |row: &Vec<Cell>| padded(row, self.head.len()).map(|cell| cell.text).collect();
        std::iter::once(head).chain(self.rows.iter().map(text)).collect()
    }

    /// Head and rows for a terminal of this width, numbers to the right. Where there is no room for all of it, first the
    /// columns with these heads are left out, one after the other, then cells are cut.
    pub fn fitted(&self, width: usize, spare: &[&str]) -> Vec<String> {
        const GAP: &str = "  ";
        let mut columns: Vec<usize> = (0..self.head.len()).collect();
        let rows = self.texts();
        let widths = columns::widths(&rows, 1);
        let total = |columns: &[usize], widths: &[usize]| {
            let cells: usize = columns.iter().map(|column| widths[*column]).sum();
            cells + GAP.len() * columns.len().saturating_sub(1)
        };
        for head in spare {
            if total(&columns, &widths) > width {
                columns.retain(|column| self.head[*column] != *head);
            }
        }
        let mut widths = widths;
        while total(&columns, &widths) > width {
            let widest = columns.iter().copied().max_by_key(|column| widths[*column]);
            let Some(widest) = widest.filter(|column| widths[*column] > 1) else {
                break;
            };
            widths[widest] -= 1;
        }
        let is_of_numbers = |column: &usize| {
            let cells = rows[1..].iter().map(|row| row[*column].as_str());
            cells.filter(|cell| !matches!(*cell, "" | "-" | number::MISSING)).all(is_number)
        };
        let right: Vec<bool> = (0..self.head.len()).map(|c| is_of_numbers(&c)).collect();
        let line = |row: &Vec<String>| {
            let cells = columns.iter().map(|column| {
                let (cell, width) = (cut(&row[*column], widths[*column]), widths[*column]);
                if right[*column] { format!("{cell:>width$}") } else { format!("{cell:<width$}") }
            });
            let cells: Vec<String> = cells.collect();
            cells.join(GAP).trim_end().to_owned()
        };
        rows.iter().map(line).collect()
    }

    /// The same with the notes of each row below it.
    pub(super) fn with_notes(&self, width: usize) -> Vec<String> {
        let mut fitted = self.fitted(width, &[]).into_iter();
        let mut lines: Vec<String> = fitted.next().into_iter().collect();
        for (line, row) in fitted.zip(&self.rows) {
            lines.push(line);
            let notes = row.iter().filter_map(|cell| cell.note.as_deref());
            let notes = notes.map(|note| format!("    {note}"));
            lines.extend(notes.flat_map(|note| wrapped(&note, width)));
        }
        lines
    }

    pub fn csv(&self) -> String {
        let quoted = |text: &String| {
            if text.contains([',', '"', '\n']) {
                format!("\"{}\"", text.replace('"', "\"\""))
            } else {
                text.clone()
            }
        };
        let line = |row: &Vec<String>| row.iter().map(quoted).collect::<Vec<_>>().join(",") + "\n";
        self.texts().iter().map(line).collect()
    }
}

pub struct Columns<T> {
    rows: Vec<T>,
    table: Table,
}

impl<T> Columns<T> {
    /// A column: its head, and what it shows of a row.
    #[must_use]
    pub fn column<C: Into<Cell>>(mut self, head: &'static str, cell: impl Fn(&T) -> C) -> Self {
        self.table.head.push(head);
        for (cells, row) in self.table.rows.iter_mut().zip(&self.rows) {
            cells.push(cell(row).into());
        }
        self
    }
}

impl<T> From<Columns<T>> for Table {
    fn from(columns: Columns<T>) -> Self {
        columns.table
    }
}

pub(super) fn padded(row: &[Cell], width: usize) -> impl Iterator<Item = Cell> + '_ {
    row.iter().cloned().chain(std::iter::repeat_with(Cell::default)).take(width)
}

/// Whether a cell begins like a number, and is kept on one line.
pub(super) fn is_number(text: &str) -> bool {
    text.trim_start_matches(['-', '(', '+']).starts_with(|c: char| c.is_ascii_digit())
        && text.len() < 40
}
