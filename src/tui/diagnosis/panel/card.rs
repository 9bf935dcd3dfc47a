//! The card of the selected effect, and what this run says of it.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget, Wrap};

use super::candidates::{detectable, status, value};
use super::titled;
use crate::tui::diagnosis::guess::Guessing;
use crate::tui::diagnosis::state::State;
use crate::tui::theme;

pub(in crate::tui::diagnosis) fn card(
    state: &State,
    first: usize,
    area: Rect,
    buffer: &mut Buffer,
) {
    if area.height == 0 {
        return;
    }
    let rows = state.rows();
    let Some(effect) = rows
        .get(state.selected(&rows))
        .and_then(super::super::state::Row::effect)
    else {
        return;
    };
    let card = effect.card();
    let inner = titled(&format!("{} ({})", card.name, card.id), area, buffer);
    let mut lines = Vec::new();
    let mut block = |title: &str, text: String| {
        lines.push(Line::from(vec![
            Span::styled(format!(" {title}: "), theme::BOLD),
            Span::raw(text),
        ]));
    };
    // While the person is guessing, what the run says of an effect would give the answer away.
    if state.guessing != Guessing::Choosing
        && let Some(candidate) = state.candidate(card.id)
    {
        block(
            "here",
            format!("{}: {}", status(candidate.status).0, candidate.evidence),
        );
        for parameter in &candidate.parameters {
            let key = parameter.key.rsplit('.').next().unwrap_or(&parameter.key);
            let reason = parameter
                .reason
                .as_deref()
                .map(|reason| format!(" ({reason})"));
            block(
                key,
                format!("{}{}", value(parameter), reason.unwrap_or_default()),
            );
        }
        if let Some(text) = detectable(candidate) {
            block("visible", text);
        }
        block(
            "rank",
            format!(
                "{}; first in {:.0} % of the bootstraps of the hold-out; training error {:.2} -> {:.2}",
                candidate.rank,
                100.0 * candidate.probability,
                candidate.error_before,
                candidate.error_after
            ),
        );
    }
    for (title, text) in [
        ("equation", card.equation),
        ("causes", card.causes),
        ("looks like", card.looks_like),
        ("excite it", card.excite),
        ("remedy", card.remedy),
    ] {
        block(title, text.to_owned());
    }
    let paragraph = Paragraph::new(lines.clone()).wrap(Wrap { trim: true });
    // The last page stays full: rows are counted generously, as words are broken between lines.
    let width = usize::from(inner.width).max(1);
    let rows: usize = lines
        .iter()
        .map(|line| 1 + line.width() * 5 / (4 * width))
        .sum();
    let hidden = rows.saturating_sub(usize::from(inner.height));
    let offset = u16::try_from(first.min(hidden)).unwrap_or(u16::MAX);
    paragraph.scroll((offset, 0)).render(inner, buffer);
}
