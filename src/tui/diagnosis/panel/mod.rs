//! One file per panel, each a function of the state and an area; every one copes with any size.

pub(super) mod candidates;
pub(super) mod card;
pub(super) mod curve;
pub(super) mod failing;
pub(super) mod help;
pub(super) mod ladder;
pub(super) mod map;
pub(super) mod next;

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Borders, Paragraph, Widget, Wrap};

use crate::text::lines::cut;
use crate::tui::theme;

/// A rule with a title above a panel; returns what is left below it.
fn titled(title: &str, area: Rect, buffer: &mut Buffer) -> Rect {
    titled_with(title, "", area, buffer)
}

/// The same with a word at the right end, where there is room for it.
fn titled_with(title: &str, right: &str, area: Rect, buffer: &mut Buffer) -> Rect {
    let title = cut(title, usize::from(area.width).saturating_sub(2));
    let needed = title.chars().count() + right.chars().count() + 5;
    let mut block = Block::new()
        .borders(Borders::TOP)
        .border_style(theme::DIM)
        .title(format!(" {title} "));
    if !right.is_empty() && needed <= usize::from(area.width) {
        block = block.title(Line::from(format!(" {right} ")).right_aligned());
    }
    let inner = block.inner(area);
    block.render(area, buffer);
    inner
}

/// A bar of `length` cells.
fn bar(share: f64, length: usize) -> (String, String) {
    let share = if share.is_finite() {
        share.clamp(0.0, 1.0)
    } else {
        0.0
    };
    let full = ((share * length as f64).round() as usize).min(length);
    ("█".repeat(full), "░".repeat(length - full))
}

/// A title and its text as one paragraph of a page.
fn block(title: &str, text: impl Into<String>) -> Line<'static> {
    Line::from(vec![
        Span::styled(format!("{title}: "), theme::BOLD),
        Span::raw(text.into()),
    ])
}

/// Paragraphs from row `first` on; the last page stays full.
fn page(lines: Vec<Line<'static>>, first: usize, area: Rect, buffer: &mut Buffer) {
    let width = usize::from(area.width).max(1);
    // Counted generously, as words are not broken between rows.
    let rows: usize = lines
        .iter()
        .map(|line| 1 + line.width() * 5 / (4 * width))
        .sum();
    let hidden = rows.saturating_sub(usize::from(area.height));
    let offset = u16::try_from(first.min(hidden)).unwrap_or(u16::MAX);
    Paragraph::new(lines)
        .wrap(Wrap { trim: true })
        .scroll((offset, 0))
        .render(area, buffer);
}
