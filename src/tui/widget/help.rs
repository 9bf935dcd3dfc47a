//! Keys and the meaning of words, over the middle of a screen.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Clear, Paragraph, Widget};

use crate::text::lines::wrapped;
use crate::tui::theme;

/// Widest box, with its frame.
const WIDEST: u16 = 78;
/// Column of the keys.
const KEYS: usize = 11;

/// Draws the help from row `first` on; the last page stays full. The screen beneath stays live.
pub(crate) fn help(
    keys: &[(&str, &str)],
    meanings: &[&str],
    first: usize,
    area: Rect,
    buffer: &mut Buffer,
) {
    let width = area.width.min(WIDEST);
    let lines = lines(keys, meanings, usize::from(width.saturating_sub(4)));
    let height = area
        .height
        .min(u16::try_from(lines.len() + 2).unwrap_or(u16::MAX));
    let place = Rect {
        x: area.x + (area.width - width) / 2,
        y: area.y + (area.height - height) / 2,
        width,
        height,
    };
    let room = usize::from(height.saturating_sub(2));
    let hidden = lines.len().saturating_sub(room);
    let first = first.min(hidden);
    let title = if hidden > 0 {
        " help: Up Down scroll, any other key closes it "
    } else {
        " help, any key closes it "
    };
    Clear.render(place, buffer);
    let shown: Vec<Line<'static>> = lines.into_iter().skip(first).take(room).collect();
    let mut block = Block::bordered().title(title);
    if first < hidden {
        block = block.title_bottom(Line::from(" more below ").right_aligned());
    }
    Paragraph::new(shown).block(block).render(place, buffer);
}

fn lines(keys: &[(&str, &str)], meanings: &[&str], width: usize) -> Vec<Line<'static>> {
    let mut lines = Vec::new();
    for (keys, meaning) in keys {
        let text = wrapped(meaning, width.saturating_sub(KEYS).max(1));
        for (row, text) in text.into_iter().enumerate() {
            let keys = if row == 0 { *keys } else { "" };
            lines.push(Line::from(vec![
                Span::styled(format!(" {keys:<KEYS$}"), theme::BOLD),
                Span::raw(text),
            ]));
        }
    }
    lines.push(Line::default());
    for meaning in meanings {
        let text = wrapped(meaning, width.saturating_sub(2).max(1));
        for (row, text) in text.into_iter().enumerate() {
            let indent = if row == 0 { " " } else { "   " };
            lines.push(Line::raw(format!("{indent}{text}")));
        }
    }
    lines
}
