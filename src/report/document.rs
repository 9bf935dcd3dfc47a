//! A result as one document: its headline, labelled sentences and facts, tables, charts and lists, and the commands that
//! follow. A command builds it once; `html`, `markdown`, `terminal` and the screens print it.

use std::sync::{Arc, LazyLock};

use super::Facts;
use super::plot::Plot;
use super::table::Table;

/// The rating of a statement; shown by a text and a mark, the colour only repeats it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    Good,
    Attention,
    Bad,
    Plain,
}

/// The verdict in a word or two, and the sentence of the result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Lead {
    pub(super) tone: Tone,
    pub(super) verdict: String,
    pub(super) sentence: String,
}

/// Horizontal bars, as those of the ladder of models.
#[derive(Clone, Debug, PartialEq)]
pub struct Bars {
    pub bars: Vec<(String, f64, String)>,
    pub unit: String,
    /// Name and length of a line that the bars should reach; drawn on a page.
    pub goal: Option<(&'static str, f64)>,
    pub caption: String,
}

impl Bars {
    pub fn new(bars: Vec<(String, f64, String)>, unit: impl Into<String>) -> Self {
        Self { bars, unit: unit.into(), goal: None, caption: String::new() }
    }
}

type Draw = Box<dyn FnOnce() -> Plot + Send>;

/// A picture that is drawn by the first page that shows it: a card needs none.
#[derive(Clone, Debug)]
pub(super) struct Picture(Arc<LazyLock<Plot, Draw>>);

impl Picture {
    pub(super) fn plot(&self) -> &Plot {
        &self.0
    }
}

impl PartialEq for Picture {
    fn eq(&self, other: &Self) -> bool {
        self.plot() == other.plot()
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Content {
    Heading(String),
    Paragraph(String),
    List(Vec<String>),
    Facts(Facts),
    Table {
        table: Table,
        /// Columns that are left out on a narrow terminal, in this order.
        spare: &'static [&'static str],
    },
    Bars(Bars),
    Figure {
        picture: Picture,
        caption: String,
        /// The picture in rows of characters; empty where a terminal shows nothing of it.
        text: Vec<String>,
    },
    Notice(String),
}

impl Content {
    /// Entries that a card can leave out one by one.
    pub(super) const fn entries(&self) -> usize {
        match self {
            Self::List(items) => items.len(),
            Self::Facts(facts) => facts.len(),
            Self::Table { table, .. } => table.rows.len(),
            Self::Bars(bars) => bars.bars.len(),
            Self::Heading(_) | Self::Paragraph(_) | Self::Figure { .. } | Self::Notice(_) => 1,
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Block {
    pub(super) label: String,
    /// Entries that a card keeps whatever the room; `None` where the block is not on the card.
    pub(super) least: Option<usize>,
    pub(super) content: Content,
}

/// A result. Text is plain: each form escapes it for itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Document {
    pub(super) title: String,
    pub(super) subtitle: String,
    pub(super) about: Facts,
    pub(super) lead: Option<Lead>,
    pub(super) blocks: Vec<Block>,
    pub(super) commands: Vec<String>,
    pub(super) page: Option<String>,
    /// Where the entries are that a card leaves out.
    pub(super) rest: &'static str,
}

impl Document {
    pub fn new(title: impl Into<String>, subtitle: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            subtitle: subtitle.into(),
            about: Facts::new(),
            lead: None,
            blocks: Vec::new(),
            commands: Vec::new(),
            page: None,
            rest: "--full",
        }
    }

    /// A result that has no page: the verdict, and the sentence behind it.
    pub fn of(tone: Tone, verdict: impl Into<String>, sentence: impl Into<String>) -> Self {
        let mut document = Self::new("", "");
        document.lead(tone, verdict, sentence);
        document
    }

    pub fn title(&self) -> &str {
        &self.title
    }

    /// Labels and values above everything else of a page.
    pub fn about(&mut self, facts: Facts) {
        self.about = facts;
    }

    pub fn lead(&mut self, tone: Tone, verdict: impl Into<String>, sentence: impl Into<String>) {
        self.lead = Some(Lead { tone, verdict: verdict.into(), sentence: sentence.into() });
    }

    /// A heading; one with nothing below it is left out.
    pub fn section(&mut self, heading: impl Into<String>) {
        if let Some(Content::Heading(_)) = self.blocks.last().map(|block| &block.content) {
            self.blocks.pop();
        }
        self.push(Content::Heading(heading.into()));
    }

    pub fn paragraph(&mut self, text: impl Into<String>) {
        self.push(Content::Paragraph(text.into()));
    }

    pub fn notice(&mut self, text: impl Into<String>) {
        self.push(Content::Notice(text.into()));
    }

    pub fn list<T: Into<String>>(&mut self, items: impl IntoIterator<Item = T>) {
        self.push(Content::List(items.into_iter().map(Into::into).collect()));
    }

    /// Sentences with a label, not on the card.
    pub fn labelled<T: Into<String>>(
        &mut self,
        label: impl Into<String>,
        sentences: impl IntoIterator<Item = T>,
    ) {
        self.list_as(label.into(), sentences, None);
    }

    /// The same on the card, where `least` of them are kept whatever the room.
    pub fn say<T: Into<String>>(
        &mut self,
        label: impl Into<String>,
        sentences: impl IntoIterator<Item = T>,
        least: usize,
    ) {
        self.list_as(label.into(), sentences, Some(least));
    }

    fn list_as<T: Into<String>>(
        &mut self,
        label: String,
        sentences: impl IntoIterator<Item = T>,
        least: Option<usize>,
    ) {
        let sentences = sentences.into_iter().map(Into::into);
        let sentences = sentences.filter(|sentence: &String| !sentence.is_empty());
        self.put(label, least, Content::List(sentences.collect()));
    }

    /// Labels and values; nothing where there are none.
    pub fn facts(&mut self, facts: Facts) {
        self.push(Content::Facts(facts));
    }

    pub fn table(&mut self, table: impl Into<Table>) {
        let (table, spare) = (table.into(), &[][..]);
        self.push(Content::Table { table, spare });
    }

    /// A table that is on the card as well, which a narrow terminal shows without the columns with these heads, the first
    /// first.
    pub fn table_on_card(
        &mut self,
        label: impl Into<String>,
        table: impl Into<Table>,
        spare: &'static [&'static str],
        least: usize,
    ) {
        self.put(label.into(), Some(least), Content::Table { table: table.into(), spare });
    }

    pub fn bars(&mut self, label: impl Into<String>, bars: Bars) {
        self.put(label.into(), Some(2), Content::Bars(bars));
    }

    /// A picture made by [`super::plot`], drawn where a page shows it.
    pub fn figure<P: Into<Plot>>(
        &mut self,
        draw: impl FnOnce() -> P + Send + 'static,
        caption: impl Into<String>,
    ) {
        self.figure_with_text(draw, caption, Vec::new());
    }

    /// The same with the rows of characters that a terminal shows in its place.
    pub(super) fn figure_with_text<P: Into<Plot>>(
        &mut self,
        draw: impl FnOnce() -> P + Send + 'static,
        caption: impl Into<String>,
        text: Vec<String>,
    ) {
        let picture = Picture(Arc::new(LazyLock::new(Box::new(|| draw().into()))));
        self.push(Content::Figure { picture, caption: caption.into(), text });
    }

    pub fn append(&mut self, other: Self) {
        self.blocks.extend(other.blocks);
    }

    fn push(&mut self, content: Content) {
        self.put(String::new(), None, content);
    }

    fn put(&mut self, label: String, least: Option<usize>, content: Content) {
        if content.entries() > 0 {
            let least = least.map(|least| least.min(content.entries()));
            self.blocks.push(Block { label, least, content });
        }
    }

    pub fn go_on(&mut self, command: impl Into<String>) {
        self.commands.push(command.into());
    }

    /// The page that has the rest: the last line of a card.
    pub fn ends_with(&mut self, page: impl Into<String>) {
        self.page = Some(page.into());
    }

    /// What a card leaves out is on the page: the command with `--full` would turn the motor again.
    pub fn rest_is_on_page(&mut self) {
        self.rest = "the page below";
    }

    /// The blocks without a heading that has nothing below it.
    pub(super) fn shown(&self) -> &[Block] {
        match self.blocks.split_last() {
            Some((last, before)) if matches!(last.content, Content::Heading(_)) => before,
            _ => &self.blocks,
        }
    }
}
