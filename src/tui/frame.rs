//! Frame of all screens: the line of keys, the help, rules above panels, bars.

use std::cell::Cell;

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Borders, Clear, Paragraph, Widget, Wrap};

use super::keys::{self, On, Press};
use super::theme;
use crate::report::Document;
use crate::report::terminal::Row;
use drivebench_model::text::lines::{cut, wrapped};

const SMALLEST: (u16, u16) = (30, 6);
const KEYS: usize = 11;

/// Whether the area is too small for the page; then one line has `label` and the most important key.
pub(super) fn is_too_small(
    label: &str,
    key: &str,
    style: Style,
    area: Rect,
    buffer: &mut Buffer,
) -> bool {
    let is_too_small = area.width < SMALLEST.0 || area.height < SMALLEST.1;
    if is_too_small {
        let text = format!("{label}: {}x{}, {key}", area.width, area.height);
        row(&Line::styled(text, style), area, buffer);
    }
    is_too_small
}

/// One row of text; a row that is cut ends with an ellipsis.
pub(super) fn row(line: &Line<'_>, area: Rect, buffer: &mut Buffer) {
    let area = area.intersection(buffer.area);
    line.render(area, buffer);
    if !area.is_empty() && line.width() > usize::from(area.width) {
        buffer[(area.right() - 1, area.y)].set_char('…');
    }
}

/// Rows of text one under the other, each as [`row`]; those that have no room below are left out.
pub(super) fn rows(lines: &[Line<'_>], area: Rect, buffer: &mut Buffer) {
    for (line, area) in lines.iter().zip(area.rows()) {
        row(line, area, buffer);
    }
}

/// Text that is broken between words; a text that is cut ends with an ellipsis.
pub(super) fn text(lines: Vec<Line<'static>>, area: Rect, buffer: &mut Buffer) {
    let area = area.intersection(buffer.area);
    if area.is_empty() {
        return;
    }
    let width = usize::from(area.width);
    let broken = lines.into_iter().flat_map(|line| match &line.spans[..] {
        // The next rows keep the indentation of the first row.
        [only] => {
            let style = line.style.patch(only.style);
            wrapped(&only.content, width).into_iter().map(|row| Line::styled(row, style)).collect()
        }
        _ => vec![line],
    });
    let lines: Vec<_> = broken.collect();
    let needed = lines.iter().map(|line| wrapped(&line.to_string(), width).len());
    let is_cut = needed.sum::<usize>() > usize::from(area.height);
    Paragraph::new(lines).wrap(Wrap { trim: false }).render(area, buffer);
    if is_cut {
        let y = area.bottom() - 1;
        let last = (area.x..area.right()).rfind(|x| buffer[(*x, y)].symbol() != " ");
        buffer[(last.map_or(area.x, |x| (x + 1).min(area.right() - 1)), y)].set_char('…');
    }
}

/// The last lines: the message of the last key, else the keys that fit, of which `always` is kept.
pub(super) fn hints(
    message: Option<&str>,
    keys: &[&str],
    always: &str,
    area: Rect,
    buffer: &mut Buffer,
) {
    let width = usize::from(area.width);
    if let Some(message) = message {
        let style = theme::CAREFUL.patch(theme::BOLD);
        let lines = in_rows(message_rows(message, width), usize::from(area.height).max(1));
        let styled = lines.iter().map(|row| Line::styled(format!(" {row}"), style));
        rows(&styled.collect::<Vec<_>>(), area, buffer);
    } else {
        Line::styled(keys_that_fit(keys, always, width), theme::DIM).render(area, buffer);
    }
}

/// At most `most` rows: the others join the last, which [`row`] cuts.
pub(super) fn in_rows(mut rows: Vec<String>, most: usize) -> Vec<String> {
    if rows.len() > most {
        let rest = rows.split_off(most.saturating_sub(1)).join(" ");
        rows.push(rest);
    }
    rows
}

fn message_rows(message: &str, width: usize) -> Vec<String> {
    wrapped(&format!("> {message}"), width.saturating_sub(1))
}

/// Rows of the message, at most `most`; the keys take one.
pub(super) fn hint_rows(message: Option<&str>, width: u16, most: usize) -> u16 {
    let rows = message.map_or(1, |message| message_rows(message, usize::from(width)).len());
    rows.clamp(1, most.max(1)) as u16
}

/// The keys that fit into a row, by priority; `always` is kept.
fn keys_that_fit(keys: &[&str], always: &str, width: usize) -> String {
    let length = |text: &str| text.chars().count();
    let mut room = width.saturating_sub(1 + length(always));
    let mut shown = String::from(" ");
    for key in keys {
        let needed = length(key) + 2;
        if needed > room {
            break;
        }
        room -= needed;
        shown.push_str(key);
        shown.push_str("  ");
    }
    shown + always
}

/// The middle of an area that is at least as large.
pub(super) const fn centred(width: u16, height: u16, area: Rect) -> Rect {
    let (x, y) = (area.x + (area.width - width) / 2, area.y + (area.height - height) / 2);
    Rect { x, y, width, height }
}

/// The help over a screen.
#[derive(Clone, Debug, Default)]
pub(super) struct Help {
    /// First row, where the help is open.
    pub(super) first: Option<usize>,
    /// Rows that did not fit when it was drawn: the limit of scrolling.
    hidden: Cell<usize>,
}

impl Help {
    /// Scrolls or closes the help; whether it was open.
    pub(super) fn press(&mut self, press: Press) -> bool {
        let is_open = self.first.is_some();
        self.first = match press {
            Press::Move(rows) | Press::Wheel(rows) => {
                self.first.map(|first| scrolled(first, rows, self.hidden.get()))
            }
            _ => None,
        };
        is_open
    }

    /// Keys and the meaning of terms over the middle of a screen, which stays live.
    pub(super) fn draw(&self, on: On, meanings: &[&str], area: Rect, buffer: &mut Buffer) {
        if let Some(first) = self.first {
            self.hidden.set(help(on, meanings, first, area, buffer));
        }
    }
}

/// The last page stays full. Returns the number of rows that do not fit.
fn help(on: On, meanings: &[&str], first: usize, area: Rect, buffer: &mut Buffer) -> usize {
    let width = area.width.min(78);
    let lines = help_lines(on, meanings, usize::from(width.saturating_sub(4)));
    let height = area.height.min(u16::try_from(lines.len() + 2).unwrap_or(u16::MAX));
    let area = centred(width, height, area);
    let room = usize::from(height.saturating_sub(2));
    let hidden = lines.len().saturating_sub(room);
    let first = first.min(hidden);
    let title = if hidden > 0 {
        " help: Up Down scroll, any other key closes it "
    } else {
        " help, any key closes it "
    };
    let title = cut(title, usize::from(width.saturating_sub(2)));
    Clear.render(area, buffer);
    let shown: Vec<Line<'static>> = lines.into_iter().skip(first).take(room).collect();
    let mut block = Block::bordered().title(title);
    if first < hidden {
        block = block.title_bottom(Line::from(" more below ").right_aligned());
    }
    Paragraph::new(shown).block(block).render(area, buffer);
    hidden
}

/// Text in rows with its label in the first of them.
pub(super) fn labelled<'a>(
    label: &'a str,
    text: &str,
    room: usize,
) -> impl Iterator<Item = (&'a str, String)> {
    let rows = wrapped(text, room.max(1)).into_iter().enumerate();
    rows.map(move |(row, text)| (if row == 0 { label } else { "" }, text))
}

fn help_lines(on: On, meanings: &[&str], width: usize) -> Vec<Line<'static>> {
    let mut lines = Vec::new();
    for (keys, meaning) in keys::help(on) {
        lines.extend(labelled(keys, meaning, width.saturating_sub(KEYS)).map(|(keys, text)| {
            let keys = Span::styled(format!(" {keys:<KEYS$}"), theme::BOLD);
            Line::from(vec![keys, Span::raw(text)])
        }));
    }
    lines.push(Line::default());
    for meaning in meanings {
        lines.extend(labelled(" ", meaning, width.saturating_sub(2)).map(|(mark, text)| {
            let indent = if mark.is_empty() { "   " } else { mark };
            Line::raw(format!("{indent}{text}"))
        }));
    }
    lines
}

/// A rule with a title above a panel; returns what is left below it.
pub(super) fn titled(title: &str, area: Rect, buffer: &mut Buffer) -> Rect {
    titled_with(title, "", area, buffer)
}

/// The same with a text at the right end, where there is room for it.
pub(super) fn titled_with(title: &str, right: &str, area: Rect, buffer: &mut Buffer) -> Rect {
    let title = cut(title, usize::from(area.width).saturating_sub(2));
    let needed = title.chars().count() + right.chars().count() + 5;
    let mut block =
        Block::new().borders(Borders::TOP).border_style(theme::DIM).title(format!(" {title} "));
    if !right.is_empty() && needed <= usize::from(area.width) {
        block = block.title(Line::from(format!(" {right} ")).right_aligned());
    }
    let inner = block.inner(area);
    block.render(area, buffer);
    inner
}

/// The full and the empty part of a bar of `length` cells.
pub(super) fn bar(share: f64, length: usize) -> (String, String) {
    let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
    let full = ((share * length as f64).round() as usize).min(length);
    ("█".repeat(full), "░".repeat(length - full))
}

pub(super) fn bar_spans(share: f64, length: usize, style: Style) -> [Span<'static>; 2] {
    let (full, empty) = bar(share, length);
    [Span::styled(full, style), Span::styled(empty, theme::DIM)]
}

/// The first row after a move by `by` rows; `hidden` rows do not fit.
pub(super) fn scrolled(first: usize, by: i32, hidden: usize) -> usize {
    first.min(hidden).saturating_add_signed(by as isize)
}

pub(super) fn document_lines(rows: Vec<Row>) -> impl Iterator<Item = Line<'static>> {
    rows.into_iter().map(|row| {
        Line::from(vec![Span::styled(format!(" {}", row.label), theme::BOLD), Span::raw(row.text)])
    })
}

/// A whole document under its title, from row `first` on. Returns the number of rows that do not fit.
pub(super) fn document(
    document: &Document,
    first: usize,
    area: Rect,
    buffer: &mut Buffer,
) -> usize {
    let inner = titled(document.title(), area, buffer);
    let rows = document.full(usize::from(inner.width.saturating_sub(2)));
    let lines: Vec<_> = document_lines(rows).collect();
    scrolling(&lines, first, inner, buffer)
}

/// Rows from `first` on; the last page stays full. Returns the number of rows that do not fit.
pub(super) fn scrolling(
    lines: &[Line<'_>],
    first: usize,
    area: Rect,
    buffer: &mut Buffer,
) -> usize {
    let hidden = lines.len().saturating_sub(usize::from(area.height));
    let first = first.min(hidden);
    rows(&lines[first..], area, buffer);
    if first < hidden {
        let more = Line::styled(" … ▼ Down: more ", theme::CAREFUL).right_aligned();
        let last = area.rows().next_back().unwrap_or(area);
        Clear.render(
            Rect {
                x: last.right().saturating_sub(more.width() as u16).max(last.x),
                width: (more.width() as u16).min(last.width),
                ..last
            },
            buffer,
        );
        row(&more, last, buffer);
    }
    hidden
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_keys_that_matter_are_never_cut_off() {
        let keys = ["a add", "r remove", "e map"];
        for width in 16..60 {
            let shown = keys_that_fit(&keys, "? help  q leave", width);
            assert!(shown.chars().count() <= width && shown.ends_with("q leave"), "{shown}");
        }
        assert!(keys_that_fit(&keys, "q", 60).starts_with(" a add  r remove  e map  q"));
    }
}
