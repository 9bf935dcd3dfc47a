//! The scope, and beside it parameters and link where there is room.

use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};

use crate::tui::model::Model;
use crate::tui::widget::link_panel::{self, link_panel};
use crate::tui::widget::notices::notices;
use crate::tui::widget::parameters::parameters;
use crate::tui::widget::scope::scope;

/// Below this there is the scope alone; the parameters have their own screen.
const WIDTH_FOR_TWO: u16 = 72;
const HEIGHT_FOR_TWO: u16 = 15;
/// Width of the right side.
const NARROW: u16 = 33;
const WIDE: u16 = 48;

pub(crate) fn live(model: &Model, area: Rect, buffer: &mut Buffer) {
    let snapshot = model.viewed();
    let frozen = model.frozen.is_some();
    let notice_rows = match area.height {
        0..=5 => 0,
        6..=14 => 1,
        15..=29 => 2,
        _ => 4,
    };
    let [body, bottom] =
        Layout::vertical([Constraint::Fill(1), Constraint::Length(notice_rows)]).areas(area);
    notices(&model.snapshot.notices, bottom, buffer);
    if area.width < WIDTH_FOR_TWO || body.height < HEIGHT_FOR_TWO {
        scope(snapshot, model.window_s(), frozen, body, buffer);
        return;
    }
    let side = if area.width >= 110 { WIDE } else { NARROW };
    let [left, right] =
        Layout::horizontal([Constraint::Fill(1), Constraint::Length(side)]).areas(body);
    scope(snapshot, model.window_s(), frozen, left, buffer);
    let count = (snapshot.estimates.len() as u16).min(300);
    let rows_of = |each: u16| count.saturating_mul(each).max(5) + 2;
    let wanted = [3, 2]
        .map(rows_of)
        .into_iter()
        .find(|rows| rows + link_panel::HEIGHT <= body.height)
        .unwrap_or_else(|| rows_of(2));
    let below = body
        .height
        .saturating_sub(wanted)
        .clamp(4, link_panel::HEIGHT);
    let [top, link] =
        Layout::vertical([Constraint::Fill(1), Constraint::Length(below)]).areas(right);
    parameters(&snapshot.estimates, &snapshot.excitation, top, buffer);
    link_panel(&model.snapshot, link, buffer);
}
