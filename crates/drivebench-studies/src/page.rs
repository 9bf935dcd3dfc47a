//! Figures and tables: what a study found (JSON, pictures, grids) on a page that is laid out in Markdown.
//!
//! ```text
//! layouts/*.md + Findings (JSON of the study, pictures, grids) -> FiguresAndTables -> report::Document -> HTML, text, Markdown
//!                                                                            '-> a file of each picture, table, series
//! ```
//!
//! A layout has one block a line; `{..}` in it is a value of the JSON:
//!
//! ```text
//! # title, the subtitle below it    > lead: one more sentence    ## section    any other line: a paragraph
//! ![picture] caption
//! [table NAME ROWS] sentence; on the next lines `| head | head |` and `| cell | cell |`, filled for each of the rows
//! [grid NAME] sentence              a table that the study has made itself
//! [each PATH]                       a paragraph for each text of a list
//! [name KEY] text                   what `{path:name}` shows for the key
//! {a.b.0}  {a/b*100:FORMAT}         a path from the row, or else from the root; quotient and factor; format
//! ```
//!
//! Formats: `2` two decimals, `n2` the same with n/a where there is none, `~3` three significant digits, with `%` behind them
//! per cent; `e` a power of ten, `%` a signed error in per cent, `off` the distance of a quotient from 1 as such an error;
//! `time` (null: never), `yes`, `dot` (0: a dot), `name`; `range` of a spread; `counted`, `share`, `allowed` of a count. What is
//! null is a dash. A path that does not exist is an error, but for one that ends with `?`.

use std::fmt::{Display, Write as _};

use drivebench::report::plot::{Panel, Plot, Style, TIME, stacked, standalone};
use drivebench::report::{Cell, Document, Table, Tone};
use drivebench::text::number::{fixed, significant};
use serde::Serialize;
use serde_json::Value;

/// Points behind a picture that its page keeps; a page of a paper has ten of them.
const MOST_POINTS: usize = 20_000;

/// Series over one axis: drawn in panels, written into a file beside the picture, or both.
#[derive(Clone, Debug)]
pub struct Figure {
    axis: (&'static str, &'static str),
    /// Head of the axis in the file.
    column: &'static str,
    at: Vec<f64>,
    panels: Vec<Panel>,
    columns: Vec<(String, Vec<f64>)>,
}

impl Figure {
    pub const fn over_time(time_s: Vec<f64>) -> Self {
        Self { axis: TIME, column: "time_s", at: time_s, panels: Vec::new(), columns: Vec::new() }
    }

    pub fn over_samples(count: usize) -> Self {
        Self {
            axis: ("sample k", ""),
            column: "k",
            ..Self::over_time((0..count).map(|k| k as f64).collect())
        }
    }

    /// The next panel; lines are drawn in the latest one.
    #[must_use]
    pub fn panel(mut self, panel: Panel) -> Self {
        self.panels.push(panel);
        self
    }

    /// Drawn only.
    #[must_use]
    pub fn line(mut self, label: &str, style: Style, values: &[f64]) -> Self {
        if let Some(panel) = self.panels.pop() {
            let drawn = panel.sampled(label, style, &self.at, values);
            self.panels.push(drawn);
        }
        self
    }

    /// Written only.
    #[must_use]
    pub fn column(mut self, name: impl Into<String>, values: &[f64]) -> Self {
        self.columns.push((name.into(), values.to_vec()));
        self
    }

    /// Drawn, and written under this name.
    #[must_use]
    pub fn series(self, name: &str, label: &str, style: Style, values: &[f64]) -> Self {
        self.line(label, style, values).column(name, values)
    }
}

/// Columns beside an axis; what is not there is an empty cell.
pub fn csv<N: Display>(axis: &str, at: &[f64], columns: &[(N, Vec<f64>)]) -> String {
    let mut out = axis.to_owned();
    for (name, _) in columns {
        let _ = write!(out, ",{name}");
    }
    for (row, at) in at.iter().enumerate() {
        let _ = write!(out, "\n{at}");
        for (_, values) in columns {
            out.push(',');
            if let Some(value) = values.get(row).filter(|value| value.is_finite()) {
                let _ = write!(out, "{value}");
            }
        }
    }
    out.push('\n');
    out
}

/// A table that a study makes itself: name, head, rows.
pub type Grid<N = &'static str> = (N, Vec<&'static str>, Vec<Vec<String>>);

/// What a study has found, for its layout.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    values: Value,
    pictures: Vec<(&'static str, Plot)>,
    grids: Vec<(String, Table)>,
    /// Series behind a picture, `(file name, comma-separated values)`: too long for the page.
    series: Vec<(String, String)>,
}

/// A JSON object with the members of another beside its own.
pub fn with(own: impl Serialize, more: Value) -> Value {
    // Only a map with keys that are no text has no JSON form, and no study has one.
    let mut value = serde_json::to_value(own).unwrap_or_default();
    if let (Value::Object(own), Value::Object(more)) = (&mut value, more) {
        own.extend(more);
    }
    value
}

impl Findings {
    /// The study's own JSON, with what its page needs beside it.
    pub fn new(study: &impl Serialize, more: Value) -> Self {
        Self { values: with(study, more), ..Self::default() }
    }

    #[must_use]
    pub fn picture(mut self, name: &'static str, plot: impl Into<Plot>) -> Self {
        self.pictures.push((name, plot.into()));
        self
    }

    /// Panels as a picture, and the series behind it as a file.
    #[must_use]
    pub fn figure(self, name: &'static str, description: &str, figure: &Figure) -> Self {
        let plot = stacked(description, figure.axis, &figure.panels, MOST_POINTS);
        let findings = self.picture(name, plot);
        if figure.columns.is_empty() {
            return findings;
        }
        findings.series(name, csv(figure.column, &figure.at, &figure.columns))
    }

    /// The series behind the picture of this name.
    #[must_use]
    pub fn series(mut self, name: &str, values: String) -> Self {
        self.series.push((format!("{name}-series.csv"), values));
        self
    }

    /// A table whose columns follow from what was found.
    #[must_use]
    pub fn grid(mut self, (name, head, rows): Grid<impl Into<String>>) -> Self {
        self.grids.push((name.into(), table(head, rows)));
        self
    }

    /// More values beside those of the study.
    #[must_use]
    pub fn and(self, more: Value) -> Self {
        let values = with(&self.values, more);
        Self { values, ..self }
    }

    /// The page that these layouts make of it, one after the other.
    pub fn on(self, layouts: &[&'static str]) -> Result<FiguresAndTables, String> {
        let mut page =
            FiguresAndTables { series: self.series.clone(), ..FiguresAndTables::default() };
        for &layout in layouts {
            let lines = || layout.lines().filter(|line| !line.is_empty());
            let names = lines().filter_map(|line| line.strip_prefix("[name ")?.split_once("] "));
            let scope =
                Scope { root: &self.values, row: &self.values, names: &names.collect::<Vec<_>>() };
            let mut lines = lines();
            while let Some(line) = lines.next() {
                let filled = self.block(&mut page, &scope, line, &mut lines);
                filled.map_err(|error| format!("{error}, in {line:?}"))?;
            }
        }
        Ok(page)
    }

    fn block(
        &self,
        page: &mut FiguresAndTables,
        scope: &Scope<'_>,
        line: &'static str,
        more: &mut impl Iterator<Item = &'static str>,
    ) -> Result<(), String> {
        if let Some(title) = line.strip_prefix("# ") {
            page.title = scope.fill(title)?;
            page.subtitle = scope.fill(more.next().unwrap_or_default())?;
        } else if let Some(lead) = line.strip_prefix("> ") {
            let (word, sentence) = lead.split_once(": ").ok_or("a lead (`> `) without `: `")?;
            let sentence = [std::mem::take(&mut page.lead.1), scope.fill(sentence)?].join(" ");
            page.lead = (word.to_owned(), sentence.trim_start().to_owned());
        } else if let Some(heading) = line.strip_prefix("## ") {
            page.blocks.push(Block::Heading(scope.fill(heading)?));
        } else if let Some((name, caption)) = directive(line, "![") {
            let found = self.pictures.iter().find(|picture| picture.0 == name);
            let (name, plot) = found.ok_or_else(|| format!("no picture {name}"))?;
            let caption = scope.fill(caption)?;
            page.blocks.push(Block::Picture(name, plot.clone(), caption));
        } else if let Some((name, sentence)) = directive(line, "[grid ") {
            let found = self.grids.iter().find(|grid| grid.0 == name);
            let (_, table) = found.ok_or_else(|| format!("no grid {name}"))?;
            page.table(name, scope.fill(sentence)?, table.clone());
        } else if let Some((what, sentence)) = directive(line, "[table ") {
            let (name, rows) = what.split_once(' ').ok_or("a table without rows")?;
            let cells = |row: Option<&'static str>| {
                let inner = row.and_then(|row| row.strip_prefix("| ")?.strip_suffix(" |"));
                inner.map(|inner| inner.split(" | ").collect::<Vec<_>>())
            };
            let head = cells(more.next()).ok_or("a table without a head")?;
            let cells = cells(more.next()).ok_or("a table without cells")?;
            let rows = scope.find(rows)?.as_array().ok_or("rows that are no list")?;
            let row = |row: &Value| -> Result<Vec<String>, String> {
                let (root, names) = (scope.root, scope.names);
                let scope = Scope { root, row, names };
                cells.iter().map(|cell| scope.fill(cell)).collect()
            };
            let rows: Result<Vec<Vec<String>>, String> = rows.iter().map(row).collect();
            page.table(name, scope.fill(sentence)?, table(head, rows?));
        } else if let Some((path, _)) = directive(line, "[each ") {
            let texts = scope.find(path)?.as_array().ok_or("texts that are no list")?;
            let texts = texts.iter().map(|text| Block::Paragraph(plain(text)));
            page.blocks.extend(texts);
        } else if !line.starts_with("[name ") {
            page.blocks.push(Block::Paragraph(scope.fill(line)?));
        }
        Ok(())
    }
}

/// What stands between an opening and `]`, and what follows.
fn directive(line: &'static str, opening: &str) -> Option<(&'static str, &'static str)> {
    let (inner, text) = line.strip_prefix(opening)?.split_once(']')?;
    Some((inner, text.trim_start()))
}

fn table(head: Vec<&'static str>, rows: impl IntoIterator<Item = Vec<String>>) -> Table {
    let cells = |row: Vec<String>| row.into_iter().map(Cell::text).collect();
    let rows = rows.into_iter().map(cells).collect();
    Table { head, rows }
}

static NOTHING: Value = Value::Null;

fn member<'a>(value: &'a Value, name: &str) -> Option<&'a Value> {
    match value {
        Value::Array(list) => list.get(name.parse::<usize>().ok()?),
        value => value.get(name),
    }
}

/// Where paths begin: the row of a table, and the whole.
#[derive(Clone, Copy)]
struct Scope<'a> {
    root: &'a Value,
    row: &'a Value,
    names: &'a [(&'static str, &'static str)],
}

impl Scope<'_> {
    /// A text with every `{..}` filled.
    fn fill(&self, text: &str) -> Result<String, String> {
        let mut parts = text.split('{');
        let mut out = parts.next().unwrap_or_default().to_owned();
        for part in parts {
            let (expression, rest) = part.split_once('}').ok_or("a brace that stays open")?;
            let (what, format) = expression.split_once(':').unwrap_or((expression, ""));
            out.push_str(&self.shown(&self.value(what)?, format)?);
            out.push_str(rest);
        }
        Ok(out)
    }

    fn find(&self, path: &str) -> Result<&Value, String> {
        let mut parts = path.trim_end_matches('?').split('.');
        let first = parts.next().unwrap_or_default();
        let begin = member(self.row, first).or_else(|| member(self.root, first));
        let found = begin.and_then(|begin| parts.try_fold(begin, member));
        let found = found.or(path.ends_with('?').then_some(&NOTHING));
        found.ok_or_else(|| format!("no value {path}"))
    }

    /// What a path leads to, or a number made of one or two of them.
    fn value(&self, what: &str) -> Result<Value, String> {
        let (of, factor) = what.split_once('*').unwrap_or((what, "1"));
        let (one, over) = of.split_once('/').unwrap_or((of, ""));
        let value = self.find(one)?;
        if one == what {
            return Ok(value.clone());
        }
        let divisor = match over {
            "" => Some(1.0),
            over => self.find(over)?.as_f64(),
        };
        let factor: f64 = factor.parse().map_err(|_| format!("no factor {factor}"))?;
        let numbers = value.as_f64().zip(divisor);
        Ok(numbers.map_or(Value::Null, |(value, divisor)| Value::from(factor * value / divisor)))
    }

    fn shown(&self, value: &Value, format: &str) -> Result<String, String> {
        let number = value.as_f64();
        let of = |key: &str| value[key].as_f64();
        let digits = |text: &str| text.parse::<usize>().map_err(|_| unknown(format));
        Ok(match (format, number) {
            ("time", _) if value.is_null() => "never".to_owned(),
            ("range", _) => range(of("median"), of("low"), of("high")),
            ("counted" | "share" | "allowed", _) => share(value, format),
            _ if format.starts_with('n') && format != "name" => {
                fixed(number.unwrap_or(f64::NAN), digits(&format[1..])?)
            }
            _ if value.is_null() => "-".to_owned(),
            ("name", _) => {
                let plain = plain(value);
                let name = self.names.iter().find(|name| name.0 == plain);
                name.map_or(plain, |name| name.1.to_owned())
            }
            ("yes", _) => (if value == true { "yes" } else { "no" }).to_owned(),
            ("dot", Some(count)) if count.abs() < 0.5 => ".".to_owned(),
            ("", _) | ("dot", Some(_)) => plain(value),
            ("time", Some(time_s)) => fixed(time_s, 3),
            ("e", Some(value)) => format!("{value:.0e}"),
            ("%", Some(value)) => percent(value),
            ("off", Some(quotient)) => percent(100.0 * (quotient - 1.0)),
            (_, Some(number)) => match (format.strip_suffix('%'), format.strip_prefix('~')) {
                (Some(format), _) => self.shown(value, format)? + " %",
                (None, Some(text)) => significant(number, digits(text)?),
                (None, None) => fixed(number, digits(format)?),
            },
            _ => return Err(unknown(format)),
        })
    }
}

fn unknown(format: &str) -> String {
    format!("no format {format:?} for this value")
}

/// As Rust prints it.
fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Number(number) if number.is_f64() => number.as_f64().unwrap_or(f64::NAN).to_string(),
        other => other.to_string(),
    }
}

/// `0.221 [0.170 to 0.301]`.
fn range(median: Option<f64>, low: Option<f64>, high: Option<f64>) -> String {
    match [median, low, high].map(|value| significant(value.unwrap_or(f64::NAN), 3)) {
        _ if median.is_none() => "none".to_owned(),
        [median, low, high] => format!("{median} [{low} to {high}]"),
    }
}

/// A count of so many: `93 of 96 (96.9 %)`, its share, or the shares that it allows.
pub fn share(bounded: &Value, format: &str) -> String {
    let of = |key: &str| bounded[key].as_f64().unwrap_or_default();
    let (count, all) = (of("count"), of("of"));
    let share = format!("{} %", fixed(100.0 * count / all, 1));
    match format {
        _ if all <= 0.0 => "-".to_owned(),
        "counted" => format!("{count} of {all} ({share})"),
        "share" => share,
        _ => {
            let [lower, upper] = ["lower_percent", "upper_percent"].map(|key| fixed(of(key), 1));
            format!("{lower} to {upper} %")
        }
    }
}

/// A signed error in per cent with as many digits as are of interest.
pub fn percent(value: f64) -> String {
    let decimals = match value.abs() {
        size if size.is_nan() => return "-".to_owned(),
        size if size >= 1000.0 => {
            let (sign, than) = if value > 0.0 { ("+", '>') } else { ("-", '<') };
            return format!("{than} {sign}1000 %");
        }
        size if size >= 20.0 => 0,
        size if size >= 0.095 => 1,
        size if size >= 0.000_95 => 3,
        _ => return "< 0.001 %".to_owned(),
    };
    let sign = if value > 0.0 { "+" } else { "" };
    format!("{sign}{} %", fixed(value, decimals))
}

#[derive(Clone, Debug)]
enum Block {
    Heading(String),
    Paragraph(String),
    /// With the name of its file, without ending, and its caption.
    Picture(&'static str, Plot, String),
    /// With the name of its file, without ending.
    Table(String, Table),
}

#[derive(Clone, Debug, Default)]
pub struct FiguresAndTables {
    title: String,
    subtitle: String,
    /// One word and a sentence.
    lead: (String, String),
    blocks: Vec<Block>,
    series: Vec<(String, String)>,
}

impl FiguresAndTables {
    fn table(&mut self, name: &str, sentence: String, table: Table) {
        self.blocks.push(Block::Paragraph(sentence));
        self.blocks.push(Block::Table(name.to_owned(), table));
    }

    pub fn html(&self) -> String {
        self.page().html()
    }

    /// The same for a terminal; its pictures are in the files.
    pub fn text(&self) -> String {
        self.page().markdown()
    }

    fn page(&self) -> Document {
        let mut page = Document::new(&self.title, &self.subtitle);
        page.lead(Tone::Plain, &self.lead.0, &self.lead.1);
        self.fill(page, |page, _, plot, caption| {
            let plot = plot.clone();
            page.figure(|| plot, caption);
        })
    }

    /// The text as a page of the documentation: the title first, the answer as its first section, the pictures as files
    /// beside it.
    pub fn markdown(&self) -> String {
        let mut page = Document::new(&self.title, &self.subtitle);
        page.section(&self.lead.0);
        page.paragraph(&self.lead.1);
        let page = self.fill(page, |page, [heading, name], _, caption| {
            page.paragraph(format!("![{heading}]({name}.svg)\n\n{caption}"));
        });
        page.markdown()
    }

    fn fill(
        &self,
        mut page: Document,
        picture: impl Fn(&mut Document, [&str; 2], &Plot, &str),
    ) -> Document {
        let mut heading = "";
        for block in &self.blocks {
            match block {
                Block::Heading(text) => {
                    heading = text;
                    page.section(text);
                }
                Block::Paragraph(text) => page.paragraph(text),
                Block::Picture(name, plot, caption) if !plot.svg.is_empty() => {
                    picture(&mut page, [heading, *name], plot, caption);
                }
                Block::Picture(..) => {}
                Block::Table(_, table) => page.table(table.clone()),
            }
        }
        page
    }

    /// `(name, content)` of every file: the page, as Markdown under this name too, pictures, tables, series.
    pub fn files(&self, markdown: &str) -> Vec<(String, String)> {
        let mut files =
            vec![("report.html".to_owned(), self.html()), (markdown.to_owned(), self.markdown())];
        files.extend(self.blocks.iter().filter_map(|block| match block {
            Block::Picture(name, plot, _) if !plot.svg.is_empty() => {
                Some((format!("{name}.svg"), standalone(&plot.svg)))
            }
            Block::Table(name, table) => Some((format!("{name}.csv"), table.csv())),
            _ => None,
        }));
        files.extend(self.series.iter().cloned());
        files
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    const LAYOUT: &str = "# paper\nof {year}\n\n> Met: nearly\n\n## Figure {n}\n\n![figure-2] TM\n[table table-1 rows] Values.\n| N | a, b | off |\n| {n} | {b:name} | {x/truth:off} |\n[name 1] one, two\n";

    fn findings() -> Findings {
        let figure = Figure::over_time(vec![0.0, 1.0])
            .panel(Panel::new("TM", "s"))
            .series("a", "a", Style::After, &[1.0, 2.0])
            .column("b", &[f64::NAN]);
        let values = json!({"year": 1980, "n": 2, "truth": 2.0, "rows": [{"n": 8, "b": 1, "x": 2.1}, {"b": 3, "x": null}]});
        Findings::new(&values, Value::Null).figure("figure-2", "TM over the samples", &figure)
    }

    #[test]
    fn every_figure_and_table_is_a_file_of_its_own() {
        let page = findings().on(&[LAYOUT]).unwrap();
        let files = page.files("validation.md");
        let content = |name: &str| &files.iter().find(|file| file.0 == name).unwrap().1;
        assert_eq!(files.len(), 5);
        let table = "N,\"a, b\",off\n8,\"one, two\",+5.0 %\n2,3,-\n";
        assert_eq!(content("table-1.csv"), table);
        assert_eq!(content("figure-2-series.csv"), "time_s,a,b\n0,1,\n1,2,\n");
        let svg = content("figure-2.svg");
        assert!(svg.starts_with("<?xml") && svg.contains("xmlns=") && svg.contains("<style>"));
        let (page, text) = (content("validation.md"), page.text());
        let head = "# paper\n\nof 1980\n\n## Met\n\nnearly\n";
        assert!(page.starts_with(head), "{page}");
        let link = "\n## Figure 2\n\n![Figure 2](figure-2.svg)\n\nTM\n";
        assert!(page.contains(link) && !text.contains("!["), "{page}");
        assert!(text.contains("Figure 2") && content("report.html").contains("<svg"));
    }

    #[test]
    fn a_layout_that_asks_for_what_is_not_there_is_an_error() {
        for (layout, error) in [
            ("{month}", "no value month"),
            ("{year:~x}", "no format"),
            ("{year", "stays open"),
            ("![figure-3] none", "no picture figure-3"),
            ("[grid a] none", "no grid a"),
            ("[table a year] none\n| a |\n| b |", "no list"),
        ] {
            let found = findings().on(&[layout]).unwrap_err();
            assert!(found.contains(error), "{found}");
        }
        assert!(findings().on(&["{month?}"]).is_ok());
    }
}
