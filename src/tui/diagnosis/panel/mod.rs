//! One file per panel, each a function of the state and an area; every one copes with any size.

pub(super) mod candidates;
pub(super) mod card;
pub(super) mod failing;
pub(super) mod help;
pub(super) mod ladder;
pub(super) mod map;

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::widgets::{Block, Borders, Widget};

use crate::tui::theme;

/// A rule with a title above a panel; returns what is left below it.
fn titled(title: &str, area: Rect, buffer: &mut Buffer) -> Rect {
    let block = Block::new()
        .borders(Borders::TOP)
        .border_style(theme::DIM)
        .title(format!(" {title} "));
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
