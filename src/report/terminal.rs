//! A document in a terminal: its card, which fits a screenful, or all of it. The headline, rows behind their labels, the
//! commands that follow, and last the page.
//!
//! ```text
//! Document --card--> at most COLUMNS x LINES: long lists are cut to their most important rows, with a note
//!           |-rows-> all that is meant for a card, for a screen that scrolls
//!           '-full-> everything but the pictures
//! ```

use std::fmt;

use super::document::{Bars, Block, Content, Document};
use super::table::Table;
use drivebench_model::text::lines::{cut, wrapped};

pub const COLUMNS: usize = 100;
pub const LINES: usize = 30;

/// Column of the text after a label; in a narrower card a label has a line of its own.
const LABEL: usize = 10;
const INDENT: usize = 2;
const WIDE: usize = 70;
/// Rows of the headline, and of one sentence of a list.
const MOST_ROWS_OF_A_SENTENCE: usize = 2;
const MARK: char = '…';
/// Width of the figure of a bar.
const FIGURE: usize = 8;

/// A row of a document; the label is as wide as its column.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Row {
    pub label: String,
    pub text: String,
}

impl Row {
    fn of(text: impl Into<String>) -> Self {
        Self { text: text.into(), ..Self::default() }
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(format!("{}{}", self.label, self.text).trim_end())
    }
}

/// Rows under a label, in its column where there is room for one.
fn labelled(label: &str, texts: Vec<String>, width: usize) -> Vec<Row> {
    let (wide, mut rows) = (width >= WIDE, Vec::new());
    if !wide && !label.is_empty() && !texts.is_empty() {
        rows.push(Row { label: cut(label, width), text: String::new() });
    }
    let indent = if wide { LABEL } else { INDENT };
    rows.extend(texts.into_iter().enumerate().map(|(index, text)| {
        let label = if wide && index == 0 { label } else { "" };
        let label = format!("{:<indent$}", cut(label, indent - 1));
        Row { label, text }
    }));
    rows
}

/// Columns of the text next to a label.
const fn room(width: usize) -> usize {
    let room = width.saturating_sub(if width >= WIDE { LABEL } else { INDENT });
    if room > 0 { room } else { 1 }
}

impl Block {
    /// The first `shown` entries on a card, `most` rows of each sentence.
    fn on_card(&self, shown: usize, width: usize, most: usize) -> Vec<Row> {
        let room = room(width);
        let short = |text: &str| shortened(text, room, most);
        let texts = match &self.content {
            Content::List(all) => all.iter().take(shown).flat_map(|text| short(text)).collect(),
            Content::Paragraph(text) => short(text),
            Content::Facts(all) => {
                let shown = all.iter().take(shown);
                let rows = |(label, text): &(String, String)| short(&format!("{label}: {text}"));
                shown.flat_map(rows).collect()
            }
            Content::Bars(bars) => bars_in_cells(bars, shown, room),
            Content::Table { table, spare } => {
                let rows = table.rows[..shown].to_vec();
                Table { head: table.head.clone(), rows }.fitted(room, spare)
            }
            Content::Heading(_) | Content::Figure { .. } | Content::Notice(_) => Vec::new(),
        };
        labelled(&self.label, texts, width)
    }

    fn in_full(&self, width: usize) -> Vec<Row> {
        let item = |text: &str| {
            let rows = wrapped(text, width.saturating_sub(2)).into_iter();
            let mark = |index| if index == 0 { "- " } else { "  " };
            rows.enumerate()
                .map(|(index, row)| Row::of(format!("{}{row}", mark(index))))
                .collect::<Vec<_>>()
        };
        match &self.content {
            Content::Heading(text) => vec![Row::default(), Row::of(text.to_uppercase())],
            Content::Paragraph(text) | Content::Notice(text) => {
                wrapped(text, width).into_iter().map(Row::of).collect()
            }
            Content::List(all) if self.label.is_empty() && self.least.is_none() => {
                all.iter().flat_map(|text| item(text)).collect()
            }
            Content::Figure { text, .. } => text.iter().map(Row::of).collect(),
            Content::Facts(all) => {
                let facts = all.iter();
                let rows = |(label, text): &(String, String)| item(&format!("{label}: {text}"));
                facts.flat_map(rows).collect()
            }
            Content::Table { table, .. } => {
                let label = self.label.as_str();
                let label = (!label.is_empty()).then(|| Row::of(label));
                label.into_iter().chain(table.with_notes(width).into_iter().map(Row::of)).collect()
            }
            _ => self.on_card(self.content.entries(), width, usize::MAX),
        }
    }
}

impl Document {
    /// Everything but the pictures, in rows of this width.
    pub fn full(&self, width: usize) -> Vec<Row> {
        let mut rows = self.headline(width, usize::MAX);
        rows.extend(self.shown().iter().flat_map(|block| block.in_full(width)));
        rows.extend(self.end(width));
        rows
    }

    /// All that is meant for a card, in rows of this width.
    pub fn rows(&self, width: usize) -> Vec<Row> {
        let shown: Vec<usize> = self.of_card().map(|block| block.content.entries()).collect();
        self.with(&shown, width, usize::MAX)
    }

    /// What fits into [`LINES`] rows of at most [`COLUMNS`], or of a terminal that is narrower.
    pub fn card(&self, width: usize) -> String {
        let width = width.min(COLUMNS);
        let least = |block: &Block| block.least.unwrap_or(0);
        let least: Vec<usize> = self.of_card().map(least).collect();
        let mut shown: Vec<usize> = self.of_card().map(|block| block.content.entries()).collect();
        let mut rows = self.with(&shown, width, MOST_ROWS_OF_A_SENTENCE);
        while rows.len() > LINES {
            // The longest list is shortened first, of two the later one.
            let spare = |index: &usize| shown[*index] - least[*index];
            let longest = (0..shown.len()).max_by_key(spare);
            let Some(index) = longest.filter(|index| spare(index) > 0) else {
                // A sentence that is cut is better than one that is missing.
                rows = self.with(&shown, width, 1);
                break;
            };
            shown[index] -= 1;
            rows = self.with(&shown, width, MOST_ROWS_OF_A_SENTENCE);
        }
        let rows: Vec<String> = rows.iter().map(Row::to_string).collect();
        rows.join("\n")
    }

    fn of_card(&self) -> impl Iterator<Item = &Block> {
        self.blocks.iter().filter(|block| block.least.is_some())
    }

    fn headline(&self, width: usize, most: usize) -> Vec<Row> {
        let Some(lead) = &self.lead else {
            return Vec::new();
        };
        let verdict = lead.verdict.to_uppercase();
        let headline = match lead.sentence.as_str() {
            "" => verdict,
            sentence if verdict.is_empty() => sentence.to_owned(),
            sentence => format!("{verdict}: {sentence}"),
        };
        shortened(&headline, width, most).into_iter().map(Row::of).collect()
    }

    fn end(&self, width: usize) -> Vec<Row> {
        let commands = self.commands.iter().flat_map(|text| command(text, room(width))).collect();
        let mut rows = labelled("next", commands, width);
        // Not broken, so that it can be copied.
        rows.extend(self.page.clone().map(Row::of));
        rows
    }

    /// `most` rows of each sentence of a list.
    fn with(&self, shown: &[usize], width: usize, most: usize) -> Vec<Row> {
        let mut rows = self.headline(width, most.max(4));
        let blocks = self.of_card().zip(shown);
        let body: Vec<Row> =
            blocks.flat_map(|(block, shown)| block.on_card(*shown, width, most)).collect();
        let is_cut = body.iter().any(|row| row.text.ends_with(MARK));
        rows.extend(body);
        let all: usize = self.of_card().map(|block| block.content.entries()).sum();
        let more = match all - shown.iter().sum::<usize>() {
            0 if is_cut => Some(format!("{} has the rest of what ends in …", self.rest)),
            0 => None,
            left => Some(format!("{} has {left} more", self.rest)),
        };
        rows.extend(labelled("more", more.into_iter().collect(), width));
        rows.extend(self.end(width));
        rows
    }
}

fn shortened(text: &str, width: usize, most: usize) -> Vec<String> {
    let mut rows = wrapped(text, width);
    if rows.len() > most {
        rows.truncate(most);
        if let Some(last) = rows.last_mut() {
            *last = cut(&format!("{last} {MARK}"), width);
        }
    }
    rows
}

/// A command for a shell, broken before its options where it is too long.
fn command(text: &str, width: usize) -> Vec<String> {
    const MARK: &str = " \\";
    let mut rows: Vec<String> = Vec::new();
    let mut pieces = text.split(" --").enumerate();
    let mut row = pieces.next().map_or_else(String::new, |(_, first)| first.to_owned());
    for (_, piece) in pieces {
        let piece = format!(" --{piece}");
        if row.chars().count() + piece.chars().count() + MARK.len() <= width {
            row.push_str(&piece);
        } else {
            rows.push(row + MARK);
            row = format!("   {piece}");
        }
    }
    rows.push(row);
    rows
}

/// Each bar in cells of the longest, at least one unless it is zero. Their unit is below them.
fn bars_in_cells(all: &Bars, shown: usize, width: usize) -> Vec<String> {
    let lengths = all.bars.iter().map(|bar| bar.1);
    let largest = lengths.filter(|length| length.is_finite()).fold(0.0, f64::max);
    let widest = all.bars.iter().map(|(name, ..)| name.chars().count()).max();
    let name_width = widest.unwrap_or(0).min(width / 2);
    let longest = width.saturating_sub(name_width + FIGURE + 4).min(40);
    let row = |(name, length, figure): &(String, f64, String)| {
        let name = cut(name, name_width);
        let is_reached = |cell: &usize| length * longest as f64 > *cell as f64 * largest;
        let cells = (0..longest).filter(is_reached).count();
        let row = format!("{name:<name_width$}  {figure:>FIGURE$}  {}", "█".repeat(cells));
        cut(row.trim_end(), width)
    };
    all.bars.iter().take(shown).map(row).chain(wrapped(&all.unit, width)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::document::Tone;
    use super::*;

    fn document() -> Document {
        let sentence = "missing: stribeck_friction; held-out error 8.45 -> 1.01 times the noise, 98 % explained";
        let mut document = Document::of(Tone::Good, "Effect found", sentence);
        let bar = |name: &str, error: f64| (name.to_owned(), error, format!("{error:.2}"));
        document.bars(
            "ladder",
            Bars::new(
                vec![bar("baseline", 8.45), bar("+ stribeck_friction", 1.01)],
                "times the noise",
            ),
        );
        document.section("Parameters");
        let rows = (0..40).map(|k| (format!("parameter_{k}_n_m_s_per_rad"), f64::from(k)));
        let table = Table::of(rows)
            .column("parameter", |row| row.0.clone())
            .column("nameplate", |row| format!("{:.3}", row.1))
            .column("before", |row| format!("{:.5} ± 0.00012", row.1))
            .column("after", |row| format!("{:.5} ± 0.00001", row.1))
            .column("verdict", |_| "settled");
        document.table_on_card("motor", table, &["nameplate", "before"], 3);
        document.paragraph("not on the card");
        document.say("remedy", ["grease it, or let the loop dither"], 1);
        document.go_on("drivebench add stribeck_friction --run runs/20260102T030405Z-zk-22fc-emulated-fit --holdout runs/20260102T030420Z-zk-22fc-emulated-select --output model2.toml");
        document.ends_with("runs/20260102T030405Z-zk-22fc-emulated-fit/report.html");
        document
    }

    #[test]
    fn a_printed_card_fits_a_terminal_and_ends_with_its_page() {
        for width in [60, 80, 100, 120] {
            let text = document().card(width);
            let rows: Vec<&str> = text.lines().collect();
            assert_eq!(rows.len(), LINES, "{text}");
            // A path is not broken, whatever the room.
            let broken = rows.iter().filter(|row| !row.contains("runs/"));
            let widest = broken.map(|row| row.chars().count()).max();
            assert!(widest <= Some(width.min(COLUMNS)), "{text}");
            assert!(rows[0].starts_with("EFFECT FOUND: missing"), "{text}");
            assert!(rows[LINES - 1].ends_with("-fit/report.html"), "{text}");
            // The number of rows left out is given, and the result is not among them.
            assert!(text.contains("--full has "), "{text}");
            assert!(text.contains("after") && text.contains("settled"), "{text}");
            assert!(text.contains("± 0.00001"), "{text}");
        }
        insta::assert_snapshot!(document().card(100));
    }

    #[test]
    fn a_screen_shows_the_whole_card_and_full_text_every_block() {
        for width in [78, 118] {
            for (rows, has_all) in [(document().rows(width), false), (document().full(width), true)]
            {
                let rows: Vec<String> = rows.iter().map(Row::to_string).collect();
                let last = rows.iter().find(|row| row.contains("parameter_39_")).unwrap();
                assert!(last.ends_with("settled"), "{last}");
                assert!(last.contains("39.00000 ± 0.00001"), "{last}");
                let has = |part: &str| rows.iter().any(|row| row == part);
                assert_eq!(has("PARAMETERS") && has("not on the card"), has_all);
            }
        }
    }

    #[test]
    fn a_long_command_is_broken_so_that_a_shell_joins_it() {
        let text = "drivebench add x --run a --holdout b";
        assert_eq!(command(text, 80), [text]);
        let rows = command(text, 27);
        assert_eq!(rows, ["drivebench add x --run a \\", "    --holdout b"]);
        let joined = rows.join("\n").replace("\\\n", " ");
        let words = |text: &str| text.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
        assert_eq!(words(&joined), words(text));
    }
}
