//! The last line: the answer to the last key, else the keys.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::Line;
use ratatui::widgets::Widget;

use crate::tui::model::Model;
use crate::tui::text::keys_that_fit;
use crate::tui::theme;

pub(crate) fn hints(model: &Model, area: Rect, buffer: &mut Buffer) {
    if let Some(message) = &model.message {
        Line::styled(format!(" > {message}"), theme::CAREFUL.patch(theme::BOLD))
            .render(area, buffer);
        return;
    }
    let screens = model.screens();
    let here = screens.iter().position(|screen| *screen == model.screen);
    let next = screens[(here.unwrap_or(0) + 1) % screens.len()].name();
    let next = format!("Tab {next}");
    let next = next.as_str();
    let keys: &[&str] = if model.waits_for_start() {
        &["Enter start", "Space stop", next]
    } else if model.has_report() {
        &["d diagnosis by hand", next, "Up Down scroll"]
    } else if model.is_finished() {
        &[next, "f freeze", "z zoom"]
    } else {
        &["Space stop", next, "f freeze", "z zoom", "m mark"]
    };
    let keys = keys_that_fit(keys, "? help  q quit", usize::from(area.width));
    Line::styled(keys, theme::DIM).render(area, buffer);
}
