//! The report of a reproduction: a page, and each of its figures and tables as a file of its own.

use super::page::{Page, Table, Tone};
use super::plot::standalone;

/// A picture with the name of its file, without ending.
#[derive(Clone, Debug)]
pub struct Picture {
    pub name: &'static str,
    pub svg: String,
    pub caption: String,
}

/// A table with the name of its file, without ending.
#[derive(Clone, Debug)]
pub struct NamedTable {
    pub name: String,
    pub table: Table,
}

/// One part of the reproduction: what is shown, under which assumptions.
#[derive(Clone, Debug, Default)]
pub struct Section {
    pub heading: String,
    pub paragraphs: Vec<String>,
    pub pictures: Vec<Picture>,
    /// `(sentence above it, table)`.
    pub tables: Vec<(String, NamedTable)>,
    /// Series behind a picture, `(file name, comma-separated values)`: too long for the page.
    pub data: Vec<(String, String)>,
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
            let pictures = section.pictures.iter().filter(|p| !p.svg.is_empty());
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
                page.figure(picture.svg.clone(), &picture.caption);
            }
            for (sentence, named) in &section.tables {
                page.paragraph(sentence);
                page.table(named.table.clone());
            }
        }
        page
    }

    /// `(name, content)` of every file: the page, pictures, tables, series.
    pub fn files(&self) -> Vec<(String, String)> {
        let mut files = vec![("report.html".to_owned(), self.html())];
        for section in &self.sections {
            let pictures = section.pictures.iter().filter(|p| !p.svg.is_empty());
            files.extend(pictures.map(|p| (format!("{}.svg", p.name), standalone(&p.svg))));
            let tables = section.tables.iter().map(|(_, named)| named);
            files.extend(tables.map(|t| (format!("{}.csv", t.name), t.table.csv())));
            files.extend(section.data.iter().cloned());
        }
        files
    }
}

#[cfg(test)]
mod tests {
    use super::super::page::Cell;
    use super::super::plot::{Panel, PanelPlot, Series, Style};
    use super::*;

    #[test]
    fn every_figure_and_table_is_a_file_of_its_own() {
        let series = Series::sampled("a", Style::After, &[0.0, 1.0], &[1.0, 2.0]);
        let plot = PanelPlot::default().with(Panel::new("TM", "s").with(series));
        let report = Reproduction {
            title: "paper".into(),
            subtitle: "of 1980".into(),
            lead: ("Met".into(), "nearly".into()),
            sections: vec![Section {
                heading: "Figure 2".into(),
                pictures: vec![Picture {
                    name: "figure-2",
                    svg: plot.svg("TM over the samples"),
                    caption: "TM".into(),
                }],
                tables: vec![(
                    "Values.".into(),
                    NamedTable {
                        name: "table-1".into(),
                        table: Table {
                            head: vec!["N", "a, b"],
                            rows: vec![vec![Cell::text("8"), Cell::text("1,5")]],
                        },
                    },
                )],
                data: vec![("figure-2-series.csv".into(), "k\n1\n".into())],
                ..Section::default()
            }],
        };
        let files = report.files();
        let content = |name: &str| &files.iter().find(|file| file.0 == name).unwrap().1;
        assert_eq!(files.len(), 4);
        assert_eq!(content("table-1.csv"), "N,\"a, b\"\n8,\"1,5\"\n");
        let svg = content("figure-2.svg");
        assert!(svg.starts_with("<?xml") && svg.contains("xmlns=") && svg.contains("<style>"));
        assert_eq!(svg.matches("<style>").count(), 1);
        assert!(
            report
                .markdown()
                .starts_with("# paper\n\nof 1980\n\n## Met\n\nnearly\n"),
            "{}",
            report.markdown()
        );
        let link = "\n## Figure 2\n\n![Figure 2](figure-2.svg)\n\nTM\n";
        assert!(
            report.markdown().contains(link) && !report.text().contains("!["),
            "{}",
            report.markdown()
        );
        assert!(report.text().contains("Figure 2") && content("report.html").contains("<svg"));
    }
}
