//! A page as a list of blocks, and its two forms: HTML in one file, and Markdown for a terminal.

use std::fmt::Write;

use super::plot::{self, Plot};
use drivebench_model::text::lines::{cut, wrapped};
use drivebench_model::text::{columns, number};

/// What is about the pictures, whose own style gives the colours; narrow and printed.
const STYLE: &str = include_str!("page.css");
/// Zoom, pan, legend and a cursor with values for the plots; the page is complete without it.
const SCRIPT: &str = include_str!("page.js");

/// Text made safe inside HTML and SVG, in content and in quoted attributes alike; control characters, which no HTML may
/// hold, become U+FFFD.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\n' | '\t' => out.push(character),
            control if control.is_control() => out.push('\u{fffd}'),
            other => out.push(other),
        }
    }
    out
}

/// How a statement is to be taken; shown by a word and a mark, the colour only repeats it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    Good,
    Attention,
    Bad,
    Plain,
}

impl Tone {
    const fn class(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Attention => "attention",
            Self::Bad => "bad",
            Self::Plain => "plain",
        }
    }
}

/// One cell of a table.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Cell {
    text: String,
    /// Smaller, below the text; not in the plain-text form.
    note: Option<String>,
    code: bool,
}

impl<T: Into<String>> From<T> for Cell {
    fn from(text: T) -> Self {
        Self::text(text)
    }
}

impl Cell {
    pub fn text(text: impl Into<String>) -> Self {
        Self {
            text: text.into(),
            ..Self::default()
        }
    }

    /// A key as it is written in files.
    pub fn code(text: impl Into<String>) -> Self {
        Self {
            code: true,
            ..Self::text(text)
        }
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
        let table = Self {
            head: Vec::new(),
            rows: vec![Vec::new(); rows.len()],
        };
        Columns { rows, table }
    }

    /// Head and rows for a terminal of this width, numbers to the right. Where there is no room for all of it, first the
    /// columns with these heads are left out, one after the other, then cells are cut.
    pub fn fitted(&self, width: usize, spare: &[&str]) -> Vec<String> {
        const GAP: &str = "  ";
        let mut columns: Vec<usize> = (0..self.head.len()).collect();
        let head = self.head.iter().map(|head| (*head).to_owned()).collect();
        let rows = self.rows.iter().map(|row| {
            let cells = padded(row, self.head.len());
            cells.map(|cell| cell.text).collect()
        });
        let rows: Vec<Vec<String>> = std::iter::once(head).chain(rows).collect();
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
            let mut cells = cells.filter(|cell| !matches!(*cell, "" | "-" | number::MISSING));
            cells.all(is_number)
        };
        let right: Vec<bool> = (0..self.head.len()).map(|c| is_of_numbers(&c)).collect();
        let line = |row: &Vec<String>| {
            let cells = columns.iter().map(|column| {
                let (cell, width) = (cut(&row[*column], widths[*column]), widths[*column]);
                if right[*column] {
                    format!("{cell:>width$}")
                } else {
                    format!("{cell:<width$}")
                }
            });
            let cells: Vec<String> = cells.collect();
            cells.join(GAP).trim_end().to_owned()
        };
        rows.iter().map(line).collect()
    }

    /// The same with the notes of each row below it.
    fn with_notes(&self, width: usize) -> Vec<String> {
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

    /// The cells as comma-separated values; notes are left out.
    pub fn csv(&self) -> String {
        let quoted = |text: &str| {
            if text.contains([',', '"', '\n']) {
                format!("\"{}\"", text.replace('"', "\"\""))
            } else {
                text.to_owned()
            }
        };
        let head = self.head.iter().map(|cell| quoted(cell)).collect();
        let rows = self.rows.iter().map(|row| {
            let cells = padded(row, self.head.len());
            cells.map(|cell| quoted(&cell.text)).collect::<Vec<_>>()
        });
        let mut out = String::new();
        for line in std::iter::once(head).chain(rows) {
            let _ = writeln!(out, "{}", line.join(","));
        }
        out
    }
}

/// A table under construction, column by column.
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

#[derive(Clone, Debug)]
enum Block {
    Heading(String),
    Paragraph(String),
    List(Vec<String>),
    Facts(Vec<(String, String)>),
    Table(Table),
    /// SVG from this room, already escaped; the caption is the plain-text form.
    Figure {
        plot: Plot,
        caption: String,
    },
    Notice(String),
}

/// A page under construction. Its text is escaped when it is written out, so callers pass plain text.
#[derive(Clone, Debug)]
pub struct Page {
    title: String,
    subtitle: String,
    about: Vec<(String, String)>,
    lead: Option<(Tone, String, String)>,
    blocks: Vec<Block>,
}

impl Page {
    pub fn new(title: impl Into<String>, subtitle: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            subtitle: subtitle.into(),
            about: Vec::new(),
            lead: None,
            blocks: Vec::new(),
        }
    }

    /// What it is about, above everything else: labels and values.
    pub fn about(&mut self, facts: Vec<(String, String)>) {
        self.about = facts;
    }

    /// The sentence that answers the reader's question, with its one-word verdict.
    pub fn lead(&mut self, tone: Tone, word: impl Into<String>, sentence: impl Into<String>) {
        self.lead = Some((tone, word.into(), sentence.into()));
    }

    pub fn section(&mut self, heading: impl Into<String>) {
        self.blocks.push(Block::Heading(heading.into()));
    }

    pub fn paragraph(&mut self, text: impl Into<String>) {
        self.blocks.push(Block::Paragraph(text.into()));
    }

    /// Sentences, one a line; nothing where there are none.
    pub fn list(&mut self, items: Vec<String>) {
        if !items.is_empty() {
            self.blocks.push(Block::List(items));
        }
    }

    /// Labels and values; nothing where there are none.
    pub fn facts(&mut self, facts: Vec<(String, String)>) {
        if !facts.is_empty() {
            self.blocks.push(Block::Facts(facts));
        }
    }

    pub fn table(&mut self, table: impl Into<Table>) {
        let table = table.into();
        if !table.rows.is_empty() {
            self.blocks.push(Block::Table(table));
        }
    }

    /// A picture made by [`super::plot`]; nothing where it is empty.
    pub fn figure(&mut self, plot: impl Into<Plot>, caption: impl Into<String>) {
        let plot = plot.into();
        if !plot.svg.is_empty() {
            let mut caption = caption.into();
            if let Some(column) = &plot.thinned {
                let _ = write!(
                    caption,
                    " Looked at closely, each {column} has its first, lowest, highest and last value."
                );
            }
            self.blocks.push(Block::Figure { plot, caption });
        }
    }

    pub fn notice(&mut self, text: impl Into<String>) {
        self.blocks.push(Block::Notice(text.into()));
    }

    /// The whole page: one file without external resources. The script only lets one look closer at the plots.
    pub fn html(&self) -> String {
        let mut out = format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <meta name=\"color-scheme\" content=\"light dark\">\n\
             <title>{title}</title>\n<style>{}</style>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n<header>\n<h1>{title}</h1>\n\
             <p class=\"subtitle\">{}</p>\n{}</header>\n",
            plot::STYLE,
            escape(&self.subtitle),
            facts_html(&self.about),
            title = escape(&self.title),
        );
        if let Some((tone, word, sentence)) = &self.lead {
            let _ = writeln!(
                out,
                "<p class=\"lead {}\"><strong>{}</strong> {}</p>",
                tone.class(),
                escape(word),
                escape(sentence)
            );
        }
        let mut open = false;
        for block in &self.blocks {
            if let Block::Heading(heading) = block {
                out.push_str(if open {
                    "</section>\n<section>\n"
                } else {
                    "<section>\n"
                });
                open = true;
                let _ = writeln!(out, "<h2>{}</h2>", escape(heading));
            } else {
                block_html(&mut out, block);
            }
        }
        if open {
            out.push_str("</section>\n");
        }
        let _ = write!(
            out,
            "</main>\n<script>{SCRIPT}</script>\n</body>\n</html>\n"
        );
        out
    }

    /// The blocks for a terminal of this width, without the lead.
    pub fn plain(&self, width: usize) -> Vec<String> {
        let mut rows = Vec::new();
        for block in &self.blocks {
            let item = |text: &str| {
                let lines = wrapped(text, width.saturating_sub(2))
                    .into_iter()
                    .enumerate();
                let line =
                    |(place, line)| format!("{}{line}", if place == 0 { "- " } else { "  " });
                lines.map(line).collect::<Vec<_>>()
            };
            let fact = |(label, value): &(String, String)| item(&format!("{label}: {value}"));
            match block {
                Block::Heading(heading) => rows.extend([String::new(), heading.to_uppercase()]),
                Block::Paragraph(text) | Block::Notice(text) => rows.extend(wrapped(text, width)),
                Block::List(items) => rows.extend(items.iter().flat_map(|text| item(text))),
                Block::Facts(facts) => rows.extend(facts.iter().flat_map(fact)),
                Block::Table(table) => rows.extend(table.with_notes(width)),
                Block::Figure { .. } => {}
            }
        }
        rows
    }

    /// The same in plain text, the verdict first: Markdown whose tables are aligned for a terminal.
    pub fn text(&self) -> String {
        let mut out = String::new();
        if let Some((_, word, sentence)) = &self.lead {
            let _ = writeln!(out, "{}: {sentence}\n", word.to_uppercase());
        }
        let _ = writeln!(out, "# {}\n\n{}", self.title, self.subtitle);
        if !self.about.is_empty() {
            let facts = self.about.iter();
            let facts: Vec<_> = facts
                .map(|(label, value)| format!("{label}: {value}"))
                .collect();
            let _ = writeln!(out, "\n{}", facts.join("; "));
        }
        for block in &self.blocks {
            let item = |line: String| format!("- {line}\n");
            let each = |lines: &mut dyn Iterator<Item = String>| {
                format!("\n{}", lines.map(item).collect::<String>())
            };
            let piece = match block {
                Block::Heading(heading) => format!("\n## {heading}\n"),
                Block::Paragraph(text) => format!("\n{text}\n"),
                Block::Notice(text) => format!("\n> {text}\n"),
                Block::List(items) => each(&mut items.iter().cloned()),
                Block::Facts(facts) => each(
                    &mut facts
                        .iter()
                        .map(|(label, value)| format!("{label}: {value}")),
                ),
                Block::Table(table) => table_text(table),
                Block::Figure { .. } => String::new(),
            };
            out.push_str(&piece);
        }
        out
    }
}

fn facts_html(facts: &[(String, String)]) -> String {
    if facts.is_empty() {
        return String::new();
    }
    let fact = |(label, value): &(String, String)| {
        let (label, value) = (escape(label), escape(value));
        format!("<div><dt>{label}</dt><dd>{value}</dd></div>\n")
    };
    format!(
        "<dl>\n{}</dl>\n",
        facts.iter().map(fact).collect::<String>()
    )
}

fn block_html(out: &mut String, block: &Block) {
    let piece = match block {
        Block::Heading(_) => String::new(),
        Block::Paragraph(text) => format!("<p>{}</p>\n", escape(text)),
        Block::Notice(text) => {
            let text = escape(text);
            format!("<p class=\"notice\"><strong>Safety.</strong> {text}</p>\n")
        }
        Block::List(items) => {
            let item = |item: &String| format!("<li>{}</li>\n", escape(item));
            format!(
                "<ul>\n{}</ul>\n",
                items.iter().map(item).collect::<String>()
            )
        }
        Block::Facts(facts) => facts_html(facts),
        Block::Table(table) => return table_html(out, table),
        Block::Figure { plot, caption } => {
            let points = match plot.points.as_str() {
                "" => String::new(),
                points => {
                    format!("<script type=\"text/plain\" class=\"points\">{points}</script>")
                }
            };
            format!(
                "<figure><div class=\"scroll\">{}</div>{points}<figcaption>{}</figcaption></figure>\n",
                plot.svg,
                escape(caption)
            )
        }
    };
    out.push_str(&piece);
}

fn table_html(out: &mut String, table: &Table) {
    out.push_str("<div class=\"scroll\"><table>\n<thead><tr>");
    for head in &table.head {
        let _ = write!(out, "<th scope=\"col\">{}</th>", escape(head));
    }
    out.push_str("</tr></thead>\n<tbody>\n");
    for row in &table.rows {
        out.push_str("<tr>");
        for cell in padded(row, table.head.len()) {
            let text = escape(&cell.text);
            // Keys may break after their underscores, else they push the numbers off a narrow screen.
            let text = if cell.code {
                let broken = text.replace('.', ".<wbr>").replace('_', "_<wbr>");
                format!("<code>{broken}</code>")
            } else {
                text
            };
            let number = is_number(&cell.text);
            let class = if number { " class=\"number\"" } else { "" };
            let note = cell
                .note
                .map(|note| format!("<small>{}</small>", escape(&note)));
            let note = note.unwrap_or_default();
            let _ = write!(out, "<td{class}>{text}{note}</td>");
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
}

fn table_text(table: &Table) -> String {
    let plain = |text: &str| text.replace('|', "/").replace('\n', " ");
    let head = table.head.iter().map(|head| (*head).to_owned()).collect();
    let rows = table.rows.iter().map(|row| {
        let cells = padded(row, table.head.len());
        cells.map(|cell| plain(&cell.text)).collect()
    });
    let mut rows: Vec<Vec<String>> = std::iter::once(head).chain(rows).collect();
    let widths = columns::widths(&rows, 3);
    let rules = widths.iter().map(|width| "-".repeat(*width)).collect();
    rows.insert(1, rules);
    let line = |row: &Vec<String>| {
        let cells = columns::padded(row, &widths).join(" | ");
        format!("| {cells} |\n")
    };
    format!("\n{}", rows.iter().map(line).collect::<String>())
}

fn padded(row: &[Cell], width: usize) -> impl Iterator<Item = Cell> + '_ {
    row.iter()
        .cloned()
        .chain(std::iter::repeat_with(Cell::default))
        .take(width)
}

/// Whether a cell is to be kept on one line: it begins like a number.
fn is_number(text: &str) -> bool {
    text.trim_start_matches(['-', '(', '+'])
        .starts_with(|c: char| c.is_ascii_digit())
        && text.len() < 40
}
