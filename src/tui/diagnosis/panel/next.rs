//! What these runs do not tell, and the run that would.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::Line;

use super::{block, page, titled};
use crate::text::number::significant;
use crate::tui::diagnosis::state::State;
use crate::tui::theme;

pub(in crate::tui::diagnosis) fn next(
    state: &State,
    first: usize,
    area: Rect,
    buffer: &mut Buffer,
) {
    let (Some(diagnosis), false) = (&state.diagnosis, area.height == 0) else {
        return;
    };
    let inner = titled("what these runs do not tell", area, buffer);
    let mut lines = Vec::new();
    for [one, other] in &diagnosis.confusable {
        lines.push(block("not told apart", format!("{one} and {other}")));
    }
    for sentence in &diagnosis.limits {
        lines.push(block("limit", sentence.clone()));
    }
    for sentence in &diagnosis.equivalences {
        lines.push(block("by no run", *sentence));
    }
    for map in &diagnosis.axis_map {
        lines.push(block("the error", map.sentence.clone()));
    }
    if let Some(next) = &state.next {
        lines.push(block("next run", next.sentence.clone()));
        if !next.menu.is_empty() {
            let text = "expected separation of each run, and from which on that run tells";
            lines.push(block("compared", text));
        }
        for entry in &next.menu {
            let (mark, style) = if entry.is_told() {
                ("✓", theme::GOOD)
            } else {
                ("·", theme::DIM)
            };
            let text = format!(
                "{mark} {:<20} {:>10} of {}",
                entry.program,
                significant(entry.expected_separation, 2),
                significant(entry.needed, 2)
            );
            lines.push(Line::styled(text, style));
        }
    }
    if lines.is_empty() {
        lines.push(block(
            "next run",
            "none is asked for: these runs tell what they can",
        ));
    }
    page(lines, first, inner, buffer);
}
