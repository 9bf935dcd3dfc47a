//! How far the run is: a bar, the seconds, the segment.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::Widget;

use crate::bench::Snapshot;
use crate::tui::theme;

const LONGEST: usize = 40;

pub(crate) fn progress_bar(snapshot: &Snapshot, area: Rect, buffer: &mut Buffer) {
    let (elapsed_s, total_s) = (snapshot.elapsed_s, snapshot.total_s);
    let share = if total_s > 0.0 {
        (elapsed_s / total_s).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let length = (usize::from(area.width) / 3).min(LONGEST);
    let full = (share * length as f64).round() as usize;
    let segment = snapshot.segment.as_deref().unwrap_or("no segment yet");
    Line::from(vec![
        Span::raw(" "),
        Span::styled("█".repeat(full), theme::GOOD),
        Span::styled("░".repeat(length.saturating_sub(full)), theme::DIM),
        Span::raw(format!(" {elapsed_s:.1} / {total_s:.1} s  ")),
        Span::styled(segment.to_owned(), theme::BOLD),
    ])
    .render(area, buffer);
}
