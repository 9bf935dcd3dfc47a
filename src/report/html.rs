//! A document as a page: HTML in one file without external resources, with inline style and pictures.

use std::fmt::Write;

use super::document::{Block, Content, Document, Tone};
use super::plot::{self, bars};
use super::table::{Table, is_number, padded};

/// Style of the page around the pictures, whose own style has the colours; also for narrow screens and print.
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

const fn class(tone: Tone) -> &'static str {
    match tone {
        Tone::Good => "good",
        Tone::Attention => "attention",
        Tone::Bad => "bad",
        Tone::Plain => "plain",
    }
}

impl Document {
    /// The whole page. The script only zooms the plots.
    pub fn html(&self) -> String {
        let mut out = format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <meta name=\"color-scheme\" content=\"light dark\">\n\
             <title>{title}</title>\n<style>{}</style>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n<header>\n<h1>{title}</h1>\n\
             <p class=\"subtitle\">{}</p>\n{}</header>\n",
            plot::STYLE,
            escape(&self.subtitle),
            facts(&self.about),
            title = escape(&self.title),
        );
        if let Some(lead) = &self.lead {
            let _ = writeln!(
                out,
                "<p class=\"lead {}\"><strong>{}</strong> {}</p>",
                class(lead.tone),
                escape(&lead.verdict),
                escape(&lead.sentence)
            );
        }
        let mut open = false;
        for block in self.shown() {
            if let Content::Heading(heading) = &block.content {
                let end = if open { "</section>\n" } else { "" };
                let _ = writeln!(out, "{end}<section>\n<h2>{}</h2>", escape(heading));
                open = true;
            } else {
                out.push_str(&html(block));
            }
        }
        let end = if open { "</section>\n" } else { "" };
        // Lists that follow each other are one.
        let out = out.replace("</ul>\n<ul>\n", "");
        out + end + &format!("</main>\n<script>{SCRIPT}</script>\n</body>\n</html>\n")
    }
}

fn html(block: &Block) -> String {
    match &block.content {
        Content::Heading(_) => String::new(),
        Content::Paragraph(text) => format!("<p>{}</p>\n", escape(text)),
        Content::Notice(text) => {
            let text = escape(text);
            format!("<p class=\"notice\"><strong>Safety.</strong> {text}</p>\n")
        }
        Content::List(items) => {
            let label = match block.label.as_str() {
                "" => String::new(),
                label => format!("<strong>{}</strong>: ", escape(label)),
            };
            let item = |item: &String| format!("<li>{label}{}</li>\n", escape(item));
            format!("<ul>\n{}</ul>\n", items.iter().map(item).collect::<String>())
        }
        Content::Facts(all) => facts(all),
        Content::Table { table, .. } => table_html(table),
        Content::Bars(own) => {
            let lengths = own.bars.iter();
            let lengths: Vec<_> =
                lengths.map(|(name, length, _)| (name.clone(), *length)).collect();
            let svg = bars(&own.unit, &own.unit, &lengths, own.goal);
            figure(&svg, "", &own.caption)
        }
        Content::Figure { picture, caption, .. } => {
            let plot = picture.plot();
            if plot.svg.is_empty() {
                return String::new();
            }
            let points = match plot.points.as_str() {
                "" => String::new(),
                points => {
                    format!("<script type=\"text/plain\" class=\"points\">{points}</script>")
                }
            };
            let thinned = plot.thinned.as_ref().map_or_else(String::new, |column| {
                format!(
                    " When zoomed, each {column} has its first, lowest, highest and last value."
                )
            });
            figure(&plot.svg, &points, &format!("{caption}{thinned}"))
        }
    }
}

fn figure(svg: &str, points: &str, caption: &str) -> String {
    let caption = escape(caption);
    format!(
        "<figure><div class=\"scroll\">{svg}</div>{points}<figcaption>{caption}</figcaption></figure>\n"
    )
}

fn facts(facts: &[(String, String)]) -> String {
    if facts.is_empty() {
        return String::new();
    }
    let fact = |(label, value): &(String, String)| {
        let (label, value) = (escape(label), escape(value));
        format!("<div><dt>{label}</dt><dd>{value}</dd></div>\n")
    };
    format!("<dl>\n{}</dl>\n", facts.iter().map(fact).collect::<String>())
}

fn table_html(table: &Table) -> String {
    let mut out = "<div class=\"scroll\"><table>\n<thead><tr>".to_owned();
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
            let note = cell.note.as_deref();
            let note = note.map(|note| format!("<small>{}</small>", escape(note)));
            let _ = write!(out, "<td{class}>{text}{}</td>", note.unwrap_or_default());
        }
        out.push_str("</tr>\n");
    }
    out + "</tbody></table></div>\n"
}
