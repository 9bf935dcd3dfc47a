//! Keys, and what the words mean.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Clear, Paragraph, Widget, Wrap};

use crate::tui::diagnosis::keys::HELP;
use crate::tui::theme;

const MEANING: [&str; 5] = [
    "Errors: free-running model, a run that the fit has not seen, in units of the noise.",
    "supported: pays on the held-out run and is in the answer. possible: pays, but less, or is not told apart.",
    "ruled out: would have shown and does not pay. not excited: this run would not show it.",
    "seen from: the smallest size that this run would have shown.",
    "A name is an equation, not a cause: the card lists causes that share it.",
];

pub(in crate::tui::diagnosis) fn help(area: Rect, buffer: &mut Buffer) {
    let (width, height) = (area.width.min(76), area.height.min(24));
    let place = Rect {
        x: area.x + (area.width - width) / 2,
        y: area.y + (area.height - height) / 2,
        width,
        height,
    };
    Clear.render(place, buffer);
    let mut lines: Vec<Line<'static>> = HELP
        .iter()
        .map(|(keys, meaning)| {
            Line::from(vec![
                Span::styled(format!(" {keys:<9}"), theme::BOLD),
                Span::raw(*meaning),
            ])
        })
        .collect();
    lines.extend(MEANING.iter().map(|text| Line::raw(format!(" {text}"))));
    Paragraph::new(lines)
        .wrap(Wrap { trim: false })
        .block(Block::bordered().title(" help, any key closes it "))
        .render(place, buffer);
}
