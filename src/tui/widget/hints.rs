//! The last line: the answer to the last key, else the keys.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::Line;
use ratatui::widgets::Widget;

use crate::tui::model::Model;
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
    let keys = if model.waits_for_start() {
        format!(" Enter start  Space stop  q quit  ? help  Tab {next}")
    } else if model.has_report() {
        format!(" d diagnosis by hand  q quit  ? help  Tab {next}  Up Down scroll")
    } else if model.is_finished() {
        format!(" q quit  ? help  Tab {next}  f freeze  z zoom")
    } else {
        format!(" Space stop  ? help  Tab {next}  f freeze  z zoom  m mark  q quit")
    };
    Line::styled(keys, theme::DIM).render(area, buffer);
}
