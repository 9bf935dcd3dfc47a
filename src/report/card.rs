//! The card of a result: what a command prints for a person in a hurry, and what a screen ends with. The sentence, labelled
//! rows, the commands that go on, and last the page.
//!
//! ```text
//! Card --text--> at most COLUMNS x LINES: long lists are cut to their most important rows, which is said
//!       '-rows-> all of it, for a screen that scrolls
//! ```

use super::page::{Table, Tone};
use drivebench_model::text::lines::{cut, wrapped};

/// What a printed card fits into.
pub const COLUMNS: usize = 100;
pub const LINES: usize = 30;

/// Column in which what stands behind a label begins; in a narrower card a label has a line of its own.
const LABEL: usize = 10;
const INDENT: usize = 2;
const WIDE: usize = 96;
/// Rows of the headline, and of one sentence of a list.
const MOST_ROWS: usize = 4;
const MOST_ROWS_OF_A_SENTENCE: usize = 2;
/// Where a sentence breaks off.
const MARK: char = '…';
/// Longest bar, and the room that name and figure need beside it.
const LONGEST: usize = 40;
const FIGURE: usize = 8;

/// A result in a few lines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Card {
    pub tone: Tone,
    headline: String,
    parts: Vec<Part>,
    commands: Vec<String>,
    page: Option<String>,
    /// What has the rest of it.
    rest: &'static str,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Part {
    label: &'static str,
    body: Body,
    /// Entries that are kept when the card is too long.
    least: usize,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Body {
    Sentences(Vec<String>),
    /// Name, its cells of the longest bar, figure.
    Bars(Vec<(String, usize, String)>),
    Table {
        table: Table,
        /// Columns that a narrow card goes without, the first first.
        spare: &'static [&'static str],
    },
}

impl Body {
    const fn entries(&self) -> usize {
        match self {
            Self::Sentences(all) => all.len(),
            Self::Bars(all) => all.len(),
            Self::Table { table, .. } => table.rows.len(),
        }
    }

    /// The first `shown` entries.
    fn rows(&self, shown: usize, width: usize, most: usize) -> Vec<String> {
        match self {
            Self::Sentences(all) => {
                let shown = all.iter().take(shown);
                let rows = |text: &String| shortened(text, width, most);
                shown.flat_map(rows).collect()
            }
            Self::Bars(all) => bars(&all[..shown], width),
            Self::Table { table, spare } => {
                let shown = Table {
                    head: table.head.clone(),
                    rows: table.rows[..shown].to_vec(),
                };
                shown.fitted(width, spare)
            }
        }
    }
}

impl Card {
    /// `word` is the verdict, the sentence what it is about.
    pub fn new(tone: Tone, word: &str, sentence: &str) -> Self {
        let word = word.to_uppercase();
        Self {
            tone,
            headline: match sentence {
                "" => word,
                sentence => format!("{word}: {sentence}"),
            },
            parts: Vec::new(),
            commands: Vec::new(),
            page: None,
            rest: "--full",
        }
    }

    /// Sentences of which `least` are kept whatever the room; nothing where there are none.
    pub fn say<T: Into<String>>(
        &mut self,
        label: &'static str,
        sentences: impl IntoIterator<Item = T>,
        least: usize,
    ) {
        let sentences = sentences.into_iter().map(Into::into).collect();
        self.put(label, Body::Sentences(sentences), least);
    }

    /// Lengths in the unit of the largest of them, and below them what they are of.
    pub fn bars(&mut self, label: &'static str, bars: Vec<(String, f64, String)>, unit: &str) {
        let finite = bars
            .iter()
            .map(|bar| bar.1)
            .filter(|value| value.is_finite());
        let largest = finite.fold(0.0, f64::max);
        // What is there has a cell of its own, however short.
        let cells = |value: f64| {
            (0..LONGEST)
                .filter(|cell| value * LONGEST as f64 > *cell as f64 * largest)
                .count()
        };
        let bars: Vec<_> = bars
            .into_iter()
            .map(|(name, value, figure)| (name, cells(value), figure))
            .collect();
        let least = bars.len().min(2);
        self.put(label, Body::Bars(bars), least);
        self.say("", [unit], 1);
    }

    /// `spare`: heads of the columns that a narrow card goes without, the first first.
    pub fn table(
        &mut self,
        label: &'static str,
        table: impl Into<Table>,
        spare: &'static [&'static str],
        least: usize,
    ) {
        let table = table.into();
        self.put(label, Body::Table { table, spare }, least);
    }

    fn put(&mut self, label: &'static str, body: Body, least: usize) {
        if body.entries() > 0 {
            let least = least.min(body.entries());
            self.parts.push(Part { label, body, least });
        }
    }

    /// A command that goes on from here.
    pub fn go_on(&mut self, command: impl Into<String>) {
        self.commands.push(command.into());
    }

    /// The page that has the rest: the last line.
    pub fn ends_with(&mut self, page: impl Into<String>) {
        self.page = Some(page.into());
    }

    /// To be told again it would turn the motor again: what is left out stands on the page.
    pub fn is_of_a_motion(&mut self) {
        self.rest = "the page below";
    }

    /// All of it, in rows of this width.
    pub fn rows(&self, width: usize) -> Vec<String> {
        let shown: Vec<usize> = self.parts.iter().map(|part| part.body.entries()).collect();
        self.with(&shown, width, usize::MAX)
    }

    /// What fits into [`LINES`] rows of at most [`COLUMNS`], or of a terminal that is narrower.
    pub fn text(&self, width: usize) -> String {
        let width = width.min(COLUMNS);
        let mut shown: Vec<usize> = self.parts.iter().map(|part| part.body.entries()).collect();
        let mut rows = self.with(&shown, width, MOST_ROWS_OF_A_SENTENCE);
        while rows.len() > LINES {
            // The longest list gives way first, of two the later one.
            let spare = |place: &usize| shown[*place] - self.parts[*place].least;
            let longest = (0..shown.len()).max_by_key(spare);
            let Some(place) = longest.filter(|place| spare(place) > 0) else {
                // Rather a sentence that breaks off than one that is missing.
                rows = self.with(&shown, width, 1);
                break;
            };
            shown[place] -= 1;
            rows = self.with(&shown, width, MOST_ROWS_OF_A_SENTENCE);
        }
        rows.join("\n")
    }

    /// `most` rows of each sentence of a list.
    fn with(&self, shown: &[usize], width: usize, most: usize) -> Vec<String> {
        let wide = width >= WIDE;
        let indent = if wide { LABEL } else { INDENT };
        let room = width.saturating_sub(indent).max(1);
        let mut rows = shortened(&self.headline, width, most.max(MOST_ROWS));
        let labelled = |rows: &mut Vec<String>, label: &str, body: Vec<String>| {
            if !wide && !label.is_empty() && !body.is_empty() {
                rows.push(cut(label, width));
            }
            for (place, row) in body.into_iter().enumerate() {
                let lead = if wide && place == 0 { label } else { "" };
                let lead = cut(lead, indent.saturating_sub(1));
                rows.push(format!("{lead:<indent$}{row}").trim_end().to_owned());
            }
        };
        let mut breaks_off = false;
        for (part, shown) in self.parts.iter().zip(shown) {
            let body = part.body.rows(*shown, room, most);
            breaks_off |= body.iter().any(|row| row.ends_with(MARK));
            labelled(&mut rows, part.label, body);
        }
        let all: usize = self.parts.iter().map(|part| part.body.entries()).sum();
        let more = match all - shown.iter().sum::<usize>() {
            0 if breaks_off => Some(format!("{} has the rest of what ends in …", self.rest)),
            0 => None,
            left => Some(format!("{} has {left} more", self.rest)),
        };
        labelled(&mut rows, "more", more.into_iter().collect());
        let commands = self.commands.iter();
        let commands: Vec<String> = commands.flat_map(|text| command(text, room)).collect();
        if !commands.is_empty() {
            labelled(&mut rows, "next", commands);
        }
        // To be copied: it is not broken.
        rows.extend(self.page.clone());
        rows
    }
}

/// A text in a few rows, the rest of it left out.
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

/// A command that a shell takes as it stands, broken before its options where it is too long.
fn command(text: &str, width: usize) -> Vec<String> {
    const MARK: &str = " \\";
    let mut rows: Vec<String> = Vec::new();
    let mut pieces = text.split(" --").enumerate();
    let mut row = pieces
        .next()
        .map_or_else(String::new, |(_, first)| first.to_owned());
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

fn bars(all: &[(String, usize, String)], width: usize) -> Vec<String> {
    let widest = all.iter().map(|(name, ..)| name.chars().count()).max();
    let name_width = widest.unwrap_or(0).min(width / 2);
    let length = width.saturating_sub(name_width + FIGURE + 4).min(LONGEST);
    let row = |(name, cells, figure): &(String, usize, String)| {
        let name = cut(name, name_width);
        let row = format!(
            "{name:<name_width$}  {figure:>FIGURE$}  {}",
            "█".repeat((length * cells).div_ceil(LONGEST))
        );
        cut(row.trim_end(), width)
    };
    all.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn card() -> Card {
        let sentence = "missing: stribeck_friction; held-out error 8.45 -> 1.01 times the noise, 98 % explained";
        let mut card = Card::new(Tone::Good, "Effect found", sentence);
        let bar = |name: &str, error: f64| (name.to_owned(), error, format!("{error:.2}"));
        card.bars(
            "ladder",
            vec![bar("baseline", 8.45), bar("+ stribeck_friction", 1.01)],
            "times the noise",
        );
        let rows = (0..40).map(|k| (format!("parameter_{k}_n_m_s_per_rad"), f64::from(k)));
        let table = Table::of(rows)
            .column("parameter", |row| row.0.clone())
            .column("nameplate", |row| format!("{:.3}", row.1))
            .column("before", |row| format!("{:.5} ± 0.00012", row.1))
            .column("after", |row| format!("{:.5} ± 0.00001", row.1))
            .column("verdict", |_| "settled");
        card.table("motor", table, &["nameplate", "before"], 3);
        card.say("remedy", ["grease it, or let the loop dither"], 1);
        card.go_on("drivebench add stribeck_friction --run runs/20260102T030405Z-zk-22fc-emulated-fit --holdout runs/20260102T030420Z-zk-22fc-emulated-select --output model2.toml");
        card.ends_with("runs/20260102T030405Z-zk-22fc-emulated-fit/report.html");
        card
    }

    #[test]
    fn a_printed_card_fits_a_terminal_and_ends_with_its_page() {
        for width in [60, 80, 100, 120] {
            let text = card().text(width);
            let rows: Vec<&str> = text.lines().collect();
            assert_eq!(rows.len(), LINES, "{text}");
            // A path is not broken, whatever the room.
            let broken = rows.iter().filter(|row| !row.contains("runs/"));
            let widest = broken.map(|row| row.chars().count()).max();
            assert!(widest <= Some(width.min(COLUMNS)), "{text}");
            assert!(rows[0].starts_with("EFFECT FOUND: missing"), "{text}");
            assert!(rows[LINES - 1].ends_with("-fit/report.html"), "{text}");
            // What was left out is told, and the answer is not among it.
            assert!(text.contains("--full has "), "{text}");
            assert!(text.contains("after") && text.contains("settled"), "{text}");
            assert!(text.contains("± 0.00001"), "{text}");
        }
        insta::assert_snapshot!(card().text(100));
    }

    #[test]
    fn a_card_on_a_screen_is_whole_and_keeps_what_came_after() {
        for width in [78, 118] {
            let rows = card().rows(width);
            assert!(
                rows.iter().any(|row| row.contains("parameter_39")),
                "{rows:?}"
            );
            let last = rows
                .iter()
                .find(|row| row.contains("parameter_39_"))
                .unwrap();
            assert!(last.ends_with("settled"), "{last}");
            assert!(last.contains("39.00000 ± 0.00001"), "{last}");
        }
    }

    #[test]
    fn a_long_command_is_broken_where_a_shell_goes_on() {
        let text = "drivebench add x --run a --holdout b";
        assert_eq!(command(text, 80), [text]);
        let rows = command(text, 27);
        assert_eq!(rows, ["drivebench add x --run a \\", "    --holdout b"]);
        let joined = rows.join("\n").replace("\\\n", " ");
        let words = |text: &str| {
            text.split_whitespace()
                .map(str::to_owned)
                .collect::<Vec<_>>()
        };
        assert_eq!(words(&joined), words(text));
    }
}
