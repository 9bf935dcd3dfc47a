//! The newest sentences of the bench, the newest at the bottom.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::Line;
use ratatui::widgets::Widget;

use crate::bench::{Level, Notice};
use crate::tui::theme;

pub(crate) fn notices(notices: &[Notice], area: Rect, buffer: &mut Buffer) {
    let rows = usize::from(area.height);
    let newest = &notices[notices.len().saturating_sub(rows)..];
    for (notice, row) in newest.iter().zip(area.rows()) {
        let word = match notice.level {
            Level::Info => "note",
            Level::Warning => "WARNING",
            Level::Error => "ERROR",
        };
        Line::styled(
            format!(" {word}: {}", notice.text),
            theme::level(notice.level),
        )
        .render(row, buffer);
    }
}
