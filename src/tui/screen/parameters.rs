//! Parameters with their reasons in full, and the link.

use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};

use crate::tui::model::Model;
use crate::tui::widget::link_panel::{self, link_panel};
use crate::tui::widget::notices::notices;
use crate::tui::widget::parameters::table;

pub(crate) fn parameters(model: &Model, area: Rect, buffer: &mut Buffer) {
    let snapshot = model.viewed();
    let roomy = area.height >= 18;
    let [top, link, bottom] = Layout::vertical([
        Constraint::Fill(1),
        Constraint::Length(if roomy { link_panel::HEIGHT } else { 0 }),
        Constraint::Length(if roomy { 2 } else { 0 }),
    ])
    .areas(area);
    table(&snapshot.estimates, &snapshot.excitation, top, buffer);
    if roomy {
        link_panel(&model.snapshot, link, buffer);
    }
    notices(&model.snapshot.notices, bottom, buffer);
}
