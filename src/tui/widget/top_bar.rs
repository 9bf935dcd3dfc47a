//! What one must always see: software or copper, phase, link, and the key that stops.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::Widget;

use crate::bench::{Phase, Snapshot};
use crate::tui::theme;

const STOP: &str = " Space = STOP ";

/// One line; what has no room is left out from the right, the stop key never.
pub(crate) fn top_bar(snapshot: &Snapshot, area: Rect, buffer: &mut Buffer) {
    let stop_width = (STOP.len() as u16).min(area.width);
    let room = usize::from(area.width - stop_width);
    let mut spans: Vec<Span<'static>> = Vec::new();
    let mut used = 0;
    for span in items(snapshot).into_iter().filter(|span| span.width() > 0) {
        let separator = usize::from(spans.len() > 1) * 3;
        let width = span.width() + separator;
        if used + width > room {
            break;
        }
        if separator > 0 {
            spans.push(Span::styled(" | ", theme::DIM));
        }
        used += width;
        spans.push(span);
    }
    Line::from(spans).render(area, buffer);
    let stop = Rect {
        x: area.right() - stop_width,
        width: stop_width,
        ..area
    };
    Line::styled(STOP, theme::STOP_KEY).render(stop, buffer);
}

fn items(snapshot: &Snapshot) -> Vec<Span<'static>> {
    let (phase, style) = phase(snapshot.phase);
    let timing = &snapshot.timing;
    // Before anything has answered, neither word would be true.
    let (target, target_style) = if snapshot.phase.is_none() && snapshot.link.is_empty() {
        (" NO DRIVE YET ".to_owned(), theme::BOLD)
    } else {
        (
            format!(" {} ", snapshot.target.name()),
            theme::target(snapshot.target),
        )
    };
    let lost = snapshot
        .link_statistics
        .sent
        .saturating_sub(snapshot.link_statistics.ok);
    let share = timing.rate_achieved_hz / timing.rate_asked_hz;
    vec![
        Span::styled(target, target_style),
        Span::styled(format!(" {phase}"), style),
        Span::raw(format!(
            "drive {}",
            snapshot.drive_state.map_or("-", |state| state.name())
        )),
        Span::styled(
            format!(
                "{:.0}/{:.0} Hz",
                timing.rate_achieved_hz, timing.rate_asked_hz
            ),
            if share < 0.95 {
                theme::CAREFUL
            } else {
                theme::PLAIN
            },
        ),
        Span::styled(
            format!("lost {lost}"),
            if lost > 0 {
                theme::CAREFUL
            } else {
                theme::PLAIN
            },
        ),
        Span::raw(snapshot.link.clone()),
        Span::styled(snapshot.name.clone(), theme::DIM),
    ]
}

fn phase(phase: Option<Phase>) -> (String, Style) {
    let Some(phase) = phase else {
        return ("STARTING".to_owned(), theme::DIM);
    };
    let style = match phase {
        Phase::Tripped | Phase::LinkLost => theme::ALARM,
        phase if phase.is_recorded() => theme::CAREFUL.patch(theme::BOLD),
        Phase::Safe | Phase::Done | Phase::Stopped => theme::GOOD,
        _ => theme::DIM,
    };
    (phase.name().to_uppercase(), style)
}
