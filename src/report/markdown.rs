//! A document as Markdown, the verdict first, with tables that are aligned for a terminal.

use std::fmt::Write;

use super::document::{Block, Content, Document};
use super::table::Table;
use drivebench_model::text::columns;

impl Document {
    pub fn markdown(&self) -> String {
        let mut out = String::new();
        if let Some(lead) = &self.lead {
            let (verdict, sentence) = (lead.verdict.to_uppercase(), &lead.sentence);
            let _ = writeln!(out, "{verdict}: {sentence}\n");
        }
        let _ = writeln!(out, "# {}\n\n{}", self.title, self.subtitle);
        if !self.about.is_empty() {
            let facts: Vec<String> = self.about.iter().map(fact).collect();
            let _ = writeln!(out, "\n{}", facts.join("; "));
        }
        let mut follows_list = false;
        for block in self.shown() {
            let text = markdown(block);
            // Lists that follow each other are one.
            let is_list = matches!(block.content, Content::List(_) | Content::Facts(_));
            let is_joined = follows_list && is_list;
            out.push_str(if is_joined { text.trim_start() } else { &text });
            follows_list = is_list;
        }
        out
    }
}

fn fact((label, value): &(String, String)) -> String {
    format!("{label}: {value}")
}

fn items(items: impl Iterator<Item = String>) -> String {
    items.fold("\n".to_owned(), |list, item| list + "- " + &item + "\n")
}

fn markdown(block: &Block) -> String {
    match &block.content {
        Content::Heading(heading) => format!("\n## {heading}\n"),
        Content::Paragraph(text) => format!("\n{text}\n"),
        Content::Notice(text) => format!("\n> {text}\n"),
        Content::List(all) if block.label.is_empty() => items(all.iter().cloned()),
        Content::List(all) => items(all.iter().map(|item| format!("{}: {item}", block.label))),
        Content::Facts(facts) => items(facts.iter().map(fact)),
        Content::Table { table, .. } => table_text(table),
        Content::Bars(_) | Content::Figure { .. } => String::new(),
    }
}

fn table_text(table: &Table) -> String {
    let mut rows = table.texts();
    for text in rows.iter_mut().flatten() {
        *text = text.replace('|', "/").replace('\n', " ");
    }
    let widths = columns::widths(&rows, 3);
    rows.insert(1, widths.iter().map(|width| "-".repeat(*width)).collect());
    let line = |row: &Vec<String>| {
        let cells = columns::padded(row, &widths).join(" | ");
        format!("| {cells} |\n")
    };
    format!("\n{}", rows.iter().map(line).collect::<String>())
}
