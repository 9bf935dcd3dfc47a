//! Keys, and what the panels mean.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Clear, Paragraph, Widget, Wrap};

use crate::tui::keys::HELP;
use crate::tui::theme;

const MEANING: [&str; 5] = [
    "The model runs free under the applied voltage: where it leaves the measurement, it misses something.",
    "A bar is a parameter's standard deviation, 100 % to 0.1 % of its value; it shrinks as the data come in.",
    "searching: still moving. settled: narrow and steady. not observable: these data do not carry it.",
    "lost: requests without a valid reply. late: how long after its deadline a cycle began. missed: cycles left out.",
    "The program's stop is best effort; the drive's watchdog and an emergency stop are behind it.",
];

/// In the middle of the area; the screen beneath stays live, and Space still stops.
pub(crate) fn help(area: Rect, buffer: &mut Buffer) {
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
                Span::styled(format!(" {keys:<11}"), theme::BOLD),
                Span::raw(*meaning),
            ])
        })
        .collect();
    lines.push(Line::default());
    lines.extend(MEANING.iter().map(|text| Line::raw(format!(" {text}"))));
    Paragraph::new(lines)
        .wrap(Wrap { trim: false })
        .block(Block::bordered().title(" help, any key closes it "))
        .render(place, buffer);
}
