//! Link, punctuality and recorder: every exchange accounted for.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Paragraph, Widget};

use crate::bench::Snapshot;
use crate::text::number::shortest;
use crate::tui::theme;

/// Rows with the frame.
pub(crate) const HEIGHT: u16 = 7;

pub(crate) fn link_panel(snapshot: &Snapshot, area: Rect, buffer: &mut Buffer) {
    let block = Block::bordered().title(" link and record ");
    let inner = block.inner(area);
    block.render(area, buffer);
    let link = &snapshot.link_statistics;
    let timing = &snapshot.timing;
    let mut lines = vec![
        counts(&[
            ("sent", link.sent, false),
            ("ok", link.ok, false),
            ("missed", timing.missed_cycles, true),
        ]),
        counts(&[
            ("timeout", link.timeout, true),
            ("crc", link.crc, true),
            ("stale", link.stale, true),
        ]),
        counts(&[
            ("mismatch", link.mismatch, true),
            ("exception", link.exception, true),
            ("io", link.aborted, true),
        ]),
        Line::raw(format!(
            "late p50 {} ms p99 {} ms",
            shortest(1e3 * timing.lateness_p50_s, 3),
            shortest(1e3 * timing.lateness_p99_s, 3)
        )),
    ];
    lines.push(match &snapshot.recorder_error {
        Some(error) => Line::styled(format!("NOT RECORDED: {error}"), theme::BAD),
        None => Line::raw(format!("rows {} recorded", snapshot.rows)),
    });
    if let Some(text) = &snapshot.reopening {
        lines.insert(0, Line::styled(text.clone(), theme::CAREFUL));
    }
    if snapshot.reopening.is_none() && inner.height < lines.len() as u16 {
        // What was not recorded matters more than what was late.
        lines.rotate_right(1);
    }
    Paragraph::new(lines).render(inner, buffer);
}

fn counts(items: &[(&'static str, u64, bool)]) -> Line<'static> {
    let mut spans = Vec::new();
    for (name, count, is_loss) in items {
        let style = if *is_loss && *count > 0 {
            theme::CAREFUL
        } else {
            Style::new()
        };
        spans.push(Span::styled(format!("{name} {count}  "), style));
    }
    Line::from(spans)
}
