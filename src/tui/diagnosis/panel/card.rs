//! The card of the selected effect, and what this run says of it.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;

use super::candidates::{at_most, detectable, status};
use super::{block, page, titled};
use crate::diagnosis::Reached;
use crate::sample::TWO_SIDED_95;
use crate::text::number::probability;
use crate::tui::diagnosis::guess::Guessing;
use crate::tui::diagnosis::state::{Row, State};

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
    let Some(effect) = rows.get(state.selected(&rows)).and_then(Row::effect) else {
        return;
    };
    let card = effect.card();
    let inner = titled(&format!("{} ({})", card.name, card.id), area, buffer);
    let mut lines = Vec::new();
    // While the person is guessing, what the run says of an effect would give the answer away.
    if state.guessing != Guessing::Choosing
        && let Some(candidate) = state.candidate(card.id)
    {
        let word = status(candidate.status).0;
        lines.push(block("here", format!("{word}: {}", candidate.evidence)));
        for parameter in &candidate.parameters {
            let key = parameter.key.rsplit('.').next().unwrap_or(&parameter.key);
            let reason = parameter.reason.as_deref();
            let reason = reason.map_or_else(String::new, |reason| format!(" ({reason})"));
            let text = format!("{}{reason}, 95 % interval", parameter.text(TWO_SIDED_95));
            lines.push(block(key, text));
        }
        lines.extend(at_most(candidate).map(|text| block("size", text)));
        lines.extend(detectable(candidate).map(|text| block("visible", text)));
        for peak in candidate.reached.iter().flat_map(Reached::peaks) {
            lines.push(block("reached", peak.text(TWO_SIDED_95)));
        }
        if let Some(text) = candidate
            .widened()
            .filter(|_| !candidate.parameters.is_empty())
        {
            lines.push(block("intervals", text));
        }
        let error = candidate.error_after.map_or_else(String::new, |after| {
            format!(
                "; training error {:.2} -> {after:.2}",
                candidate.error_before
            )
        });
        let text = format!(
            "{}; there with {}{error}",
            candidate.rank,
            probability(candidate.probability),
        );
        lines.push(block("rank", text));
    }
    for (title, text) in [
        ("equation", card.equation),
        ("causes", card.causes),
        ("looks like", card.looks_like),
        ("excite it", card.excite),
        ("remedy", card.remedy),
    ] {
        lines.push(block(title, text));
    }
    page(lines, first, inner, buffer);
}
