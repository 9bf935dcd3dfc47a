//! The report of a reproduction: a page, and each of its figures and tables as a file of its own.

use std::fmt::{Display, Write as _};

use super::page::{Cell, Page, Table, Tone};
use super::plot::{Panel, Plot, Style, TIME, stacked, standalone};

/// Points behind a picture that its page keeps; a page of a paper has ten of them.
const MOST_POINTS: usize = 20_000;

/// A picture with the name of its file, without ending.
#[derive(Clone, Debug)]
pub struct Picture {
    pub name: &'static str,
    pub plot: Plot,
    pub caption: String,
}

/// A table with the name of its file, without ending, and the sentence above it.
#[derive(Clone, Debug)]
pub struct NamedTable {
    pub name: String,
    pub sentence: String,
    pub table: Table,
}

/// A column of a table: its head, and what it shows of a row.
pub type Column<'a, T> = (&'static str, &'a dyn Fn(&T) -> String);

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
        Self {
            axis: TIME,
            column: "time_s",
            at: time_s,
            panels: Vec::new(),
            columns: Vec::new(),
        }
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

/// One part of the reproduction: what is shown, under which assumptions.
#[derive(Clone, Debug, Default)]
pub struct Section {
    pub heading: String,
    pub paragraphs: Vec<String>,
    pub pictures: Vec<Picture>,
    pub tables: Vec<NamedTable>,
    /// Series behind a picture, `(file name, comma-separated values)`: too long for the page.
    pub data: Vec<(String, String)>,
}

impl Section {
    pub fn new(heading: impl Into<String>) -> Self {
        Self {
            heading: heading.into(),
            ..Self::default()
        }
    }

    #[must_use]
    pub fn say(mut self, paragraph: impl Into<String>) -> Self {
        self.paragraphs.push(paragraph.into());
        self
    }

    #[must_use]
    pub fn picture(
        mut self,
        name: &'static str,
        plot: impl Into<Plot>,
        caption: impl Into<String>,
    ) -> Self {
        self.pictures.push(Picture {
            name,
            plot: plot.into(),
            caption: caption.into(),
        });
        self
    }

    /// Panels as a picture, and the series behind it as a file.
    #[must_use]
    pub fn figure(
        self,
        name: &'static str,
        description: &str,
        caption: impl Into<String>,
        figure: &Figure,
    ) -> Self {
        let plot = stacked(description, figure.axis, &figure.panels, MOST_POINTS);
        let section = self.picture(name, plot, caption);
        if figure.columns.is_empty() {
            return section;
        }
        section.series(name, csv(figure.column, &figure.at, &figure.columns))
    }

    /// A table whose columns are known beforehand.
    #[must_use]
    pub fn table<T>(
        self,
        name: impl Into<String>,
        sentence: impl Into<String>,
        rows: impl IntoIterator<Item = T>,
        columns: &[Column<'_, T>],
    ) -> Self {
        let head = columns.iter().map(|(head, _)| *head).collect();
        let row = |row: T| columns.iter().map(|(_, cell)| cell(&row)).collect();
        self.grid(name, sentence, head, rows.into_iter().map(row))
    }

    /// A table whose columns follow from what was found.
    #[must_use]
    pub fn grid(
        mut self,
        name: impl Into<String>,
        sentence: impl Into<String>,
        head: Vec<&'static str>,
        rows: impl IntoIterator<Item = Vec<String>>,
    ) -> Self {
        let cells = |row: Vec<String>| row.into_iter().map(Cell::text).collect();
        let rows = rows.into_iter().map(cells).collect();
        self.tables.push(NamedTable {
            name: name.into(),
            sentence: sentence.into(),
            table: Table { head, rows },
        });
        self
    }

    /// The series behind the picture of this name.
    #[must_use]
    pub fn series(mut self, name: &str, values: String) -> Self {
        self.data.push((format!("{name}-series.csv"), values));
        self
    }
}

/// Everything that a reproduction shows.
#[derive(Clone, Debug)]
pub struct Reproduction {
    pub title: String,
    pub subtitle: String,
    /// One word and a sentence.
    pub lead: (String, String),
    pub sections: Vec<Section>,
}

impl Reproduction {
    pub fn html(&self) -> String {
        self.page().html()
    }

    /// The same for a terminal; its pictures are in the files.
    pub fn text(&self) -> String {
        self.page().text()
    }

    /// The text as a page of the documentation: the title first, the answer as its first section, the pictures as files
    /// beside it.
    pub fn markdown(&self) -> String {
        let mut page = Page::new(&self.title, &self.subtitle);
        page.section(&self.lead.0);
        page.paragraph(&self.lead.1);
        let mut beside = self.clone();
        for section in &mut beside.sections {
            let pictures = section.pictures.iter().filter(|p| !p.plot.svg.is_empty());
            let links = pictures
                .map(|p| format!("![{}]({}.svg)\n\n{}", section.heading, p.name, p.caption));
            section.paragraphs.extend(links);
        }
        beside.fill(page).text()
    }

    fn page(&self) -> Page {
        let mut page = Page::new(&self.title, &self.subtitle);
        page.lead(Tone::Plain, &self.lead.0, &self.lead.1);
        self.fill(page)
    }

    fn fill(&self, mut page: Page) -> Page {
        for section in &self.sections {
            page.section(&section.heading);
            for paragraph in &section.paragraphs {
                page.paragraph(paragraph);
            }
            for picture in &section.pictures {
                page.figure(picture.plot.clone(), &picture.caption);
            }
            for named in &section.tables {
                page.paragraph(&named.sentence);
                page.table(named.table.clone());
            }
        }
        page
    }

    /// `(name, content)` of every file: the page, pictures, tables, series.
    pub fn files(&self) -> Vec<(String, String)> {
        let mut files = vec![("report.html".to_owned(), self.html())];
        for section in &self.sections {
            let pictures = section.pictures.iter().filter(|p| !p.plot.svg.is_empty());
            files.extend(pictures.map(|p| (format!("{}.svg", p.name), standalone(&p.plot.svg))));
            let tables = section.tables.iter();
            files.extend(tables.map(|t| (format!("{}.csv", t.name), t.table.csv())));
            files.extend(section.data.iter().cloned());
        }
        files
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_and_table_is_a_file_of_its_own() {
        let figure = Figure::over_time(vec![0.0, 1.0])
            .panel(Panel::new("TM", "s"))
            .series("a", "a", Style::After, &[1.0, 2.0])
            .column("b", &[f64::NAN]);
        let section = Section::new("Figure 2")
            .figure("figure-2", "TM over the samples", "TM", &figure)
            .table(
                "table-1",
                "Values.",
                [("8", "1,5")],
                &[
                    ("N", &|row| row.0.to_owned()),
                    ("a, b", &|row| row.1.to_owned()),
                ],
            );
        let report = Reproduction {
            title: "paper".into(),
            subtitle: "of 1980".into(),
            lead: ("Met".into(), "nearly".into()),
            sections: vec![section],
        };
        let files = report.files();
        let content = |name: &str| &files.iter().find(|file| file.0 == name).unwrap().1;
        assert_eq!(files.len(), 4);
        assert_eq!(content("table-1.csv"), "N,\"a, b\"\n8,\"1,5\"\n");
        assert_eq!(content("figure-2-series.csv"), "time_s,a,b\n0,1,\n1,2,\n");
        let svg = content("figure-2.svg");
        assert!(svg.starts_with("<?xml") && svg.contains("xmlns=") && svg.contains("<style>"));
        assert_eq!(svg.matches("<style>").count(), 1);
        let (page, text) = (report.markdown(), report.text());
        assert!(
            page.starts_with("# paper\n\nof 1980\n\n## Met\n\nnearly\n"),
            "{page}"
        );
        let link = "\n## Figure 2\n\n![Figure 2](figure-2.svg)\n\nTM\n";
        assert!(page.contains(link) && !text.contains("!["), "{page}");
        assert!(text.contains("Figure 2") && content("report.html").contains("<svg"));
    }
}
