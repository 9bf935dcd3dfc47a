//! The page of the frequency response as a function of its state.

use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::text::Line;

use super::{ResponsePage, ResponseScreen};
use crate::report::response_chart;
use crate::tui::axis_chart;
use crate::tui::frame::{hint_rows, hints, is_too_small, row, text, titled_with};
use crate::tui::keys::On;
use crate::tui::plot::LABELS;
use crate::tui::theme;
use drivebench_identify::frequency_response::{Compared, Departure, PathwayResponse};

const MEANING: [&str; 3] = [
    "Solid: measured, where it is carried; dotted: its 95 % interval. Dashed: the model, by the same estimator.",
    "Coherence: share of the measured signal that the voltage explains. A point is carried (used) from 0.8 on.",
    "A resonance is listed only where it is significant: there may be others.",
];

pub(super) fn screen(screen: &ResponseScreen, frame: &mut Frame<'_>) {
    let area = frame.area();
    let buffer = frame.buffer_mut();
    if is_too_small("frequency response", "q leaves", theme::PLAIN, area, buffer) {
        return;
    }
    let bottom = hint_rows(screen.message.as_deref(), area.width, 2);
    let [top, body, bottom] =
        Layout::vertical([Constraint::Length(1), Constraint::Fill(1), Constraint::Length(bottom)])
            .areas(area);
    row(&Line::styled(format!(" frequency response: {}", screen.title), theme::BOLD), top, buffer);
    view(&screen.page, body, buffer);
    screen.help.draw(On::Response, &MEANING, body, buffer);
    let (keys, always) = if screen.help.first.is_some() {
        ("Up Down scroll", "any other key closes the help")
    } else {
        (ResponsePage::KEYS, "? help  q leave")
    };
    let keys: Vec<&str> = keys.split('|').collect();
    hints(screen.message.as_deref(), &keys, always, bottom, buffer);
}

pub(in crate::tui) fn view(page: &ResponsePage, area: Rect, buffer: &mut Buffer) {
    let area = area.intersection(buffer.area);
    let Some((compared, own)) = page.shown() else {
        let text = " no frequency response: neither current nor speed was measured";
        row(&Line::styled(text, theme::DIM), area, buffer);
        return;
    };
    let all = compared.measured.pathways.len();
    let choice = match all {
        1 => String::new(),
        all => format!("Tab: one of {all} pathways"),
    };
    let inner = titled_with(own.pathway.name(), &choice, area, buffer);
    if inner.height < 3 || inner.width < LABELS + 4 {
        return;
    }
    let findings = findings(compared, own);
    let most = if inner.height >= 20 { 4 } else { 1 };
    let rows = findings.len().min(most) as u16;
    let [above, below] =
        Layout::vertical([Constraint::Length(rows), Constraint::Fill(1)]).areas(inner);
    let lines = findings.into_iter().take(most);
    let lines = lines.map(|(text, style)| Line::styled(format!(" {text}"), style)).collect();
    text(lines, above, buffer);
    let cursor = page.cursor.and_then(|at| own.points.get(at)).map(|point| point.frequency_hz);
    let chart = response_chart(compared, own.pathway);
    axis_chart::axis_chart(&chart, cursor, below, buffer);
}

/// Modes, then departures of the model, then cautions.
fn findings(compared: &Compared, own: &PathwayResponse) -> Vec<(String, Style)> {
    let measured = &compared.measured;
    let modes = measured.modes_of(own.pathway);
    let mut texts = Vec::new();
    if own.bands_hz().is_empty() {
        texts.push((
            "no frequency of this pathway has sufficient coherence".to_owned(),
            theme::CAREFUL,
        ));
    } else if modes.is_empty() {
        texts.push(("no resonance at sufficient coherence".to_owned(), theme::PLAIN));
    }
    texts.extend(modes.iter().map(|mode| (mode.text(), theme::BOLD)));
    let bands = compared.departures.iter().filter(|band| band.pathway == own.pathway);
    texts.extend(bands.map(|band: &Departure| (band.sentence(), theme::BAD)));
    texts.extend(measured.cautions.iter().cloned().map(|caution| (caution, theme::CAREFUL)));
    texts.push((measured.rate_sentence(), theme::DIM));
    texts
}
