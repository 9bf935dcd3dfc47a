//! The pictures of the diagnosis: the curve of an effect over its axis, and the signed map of the error.

use std::fmt::Write as _;

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::state::State;
use crate::report::curve_chart;
use crate::report::wording::location;
use crate::tui::axis_chart;
use crate::tui::frame::{in_rows, rows, titled_with};
use crate::tui::theme;
use drivebench_diagnose::{CurvePoint, EffectCurve, MapCell, MapDigits, Off};
use drivebench_model::text::lines::wrapped;
use drivebench_model::text::number::{shortest, significant, with_std};

/// The error over its axis, with the curve of the effect. `index` selects the curve; the cursor is on a point.
pub(super) fn curve(
    state: &State,
    index: usize,
    cursor: Option<usize>,
    area: Rect,
    buffer: &mut Buffer,
) {
    let drawn = state.drawn();
    let Some((curve, _)) = drawn.get(index) else {
        return;
    };
    let title = format!("{}, over {}", location::curve_title(curve), location::axis_label(curve));
    let number =
        if drawn.len() > 1 { format!("{} of {}", index + 1, drawn.len()) } else { String::new() };
    let inner = titled_with(&title, &number, area, buffer);
    let width = usize::from(inner.width);
    let most = if inner.height >= 16 { 4 } else { 1 };
    let room = width.saturating_sub(1).max(1);
    // A map of an unexplained error has a sentence, and no figures of windows.
    let figures = (!curve.is_unexplained()).then(|| location::curve(curve));
    let texts = figures.into_iter().chain(location::why_axis(curve));
    let texts = in_rows(texts.flat_map(|text| wrapped(&text, room)).collect(), most);
    let styled = texts.iter().map(|row| Line::styled(format!(" {row}"), theme::BOLD));
    let mut lines: Vec<Line<'static>> = styled.collect();
    let cursor = cursor.and_then(|at| Some((at, curve.points.get(at)?)));
    lines.extend(cursor.map(|point| at_cursor(curve, point)));
    let head = u16::try_from(lines.len()).unwrap_or(u16::MAX);
    rows(&lines, inner, buffer);
    let below = Rect {
        y: inner.y + head.min(inner.height),
        height: inner.height.saturating_sub(head),
        ..inner
    };
    axis_chart::axis_chart(&curve_chart(curve), cursor.map(|(_, point)| point.at), below, buffer);
}

fn at_cursor(curve: &EffectCurve, (at, point): (usize, &CurvePoint)) -> Line<'static> {
    let (at_axis, axis, unit) = (significant(point.at, 3), curve.axis_unit, curve.unit);
    let mut text = format!(" ┊ {at_axis} {axis}: {} {unit}", with_std(point.mean, Some(point.std)));
    if let Some(with) = curve.with_it.get(at) {
        let _ = write!(text, ", with it {}", with_std(with.mean, Some(with.std)));
    }
    if point.count > 0 {
        let _ = write!(text, ", {} windows", point.count);
    }
    Line::styled(text, theme::BOLD)
}

/// The point of a curve that is drawn nearest to this column of the page.
pub(super) fn point_at(state: &State, index: usize, column: u16, area: Rect) -> Option<usize> {
    axis_chart::point_at(&curve_chart(&state.drawn().get(index)?.0), column, area)
}

/// The signed error of one equation over speed x current: digits, letters and shades that need no colour. `index` 0 is
/// the equation that fails worse.
pub(super) fn map(state: &State, index: usize, area: Rect, buffer: &mut Buffer) {
    let compared = state.compared();
    let Some((comparison, map)) = compared.and_then(|found| Some((found, found.map.as_ref()?)))
    else {
        return;
    };
    let worse = comparison.balances.first();
    let torque_first = worse.is_none_or(|balance| balance.equation == "torque");
    let (equation, unit) =
        if torque_first == (index == 0) { ("torque", "N.m") } else { ("voltage", "V") };
    let MapDigits { largest, rows: speeds } = map.digits(equation);
    let nine = significant(largest, 3);
    let title = format!("{equation} error over speed x current: 9 and i are {nine} {unit}");
    let inner = titled_with(&title, "", area, buffer);
    let room = usize::from(inner.height).saturating_sub(2);
    let columns = map.current_edges_a.len().saturating_sub(1).max(1);
    let cell_width = (usize::from(inner.width).saturating_sub(14) / columns).clamp(1, 6);
    // Two rows for each speed where there is room, so that the map is nearly square.
    let repeat = (room / speeds.len().max(1)).clamp(1, 2);
    let mut lines = vec![Line::from(vec![
        Span::styled(" 1-9 model too low", shade(Off::TooLow)),
        Span::styled("  a-i too high", shade(Off::TooHigh)),
        Span::styled("  ░▒▓ both signs", shade(Off::BothWays)),
        Span::styled("  · no data", theme::DIM),
    ])];
    // Where there are fewer rows than speeds, some of them over the whole range.
    let step = speeds.len().div_ceil(room.max(1)).max(1);
    for (middle, cells) in speeds.iter().skip(step / 2).step_by(step) {
        for copy in 0..repeat {
            let label = if copy == 0 { format!("{middle:>6.0} rad/s ") } else { " ".repeat(13) };
            let mut line = Line::from(Span::styled(label, theme::DIM));
            line.extend(cells.iter().map(|cell| {
                let mark = cell.map_or('·', MapCell::glyph);
                let is_off = cell.filter(|cell| cell.digit > 0);
                let style = is_off.map_or(theme::DIM, |cell| shade(cell.off));
                Span::styled(mark.to_string().repeat(cell_width), style)
            }));
            lines.push(line);
        }
    }
    lines.truncate(room + 1);
    if let (Some(from), Some(to)) = (map.current_edges_a.first(), map.current_edges_a.last()) {
        let [from, to] = [from, to].map(|edge| format!("{} A", shortest(*edge, 3)));
        let gap = (columns * cell_width).saturating_sub(from.chars().count());
        let left_out = if step > 1 { format!("1 row of {step}") } else { String::new() };
        lines.push(Line::styled(format!(" {left_out:<12}{from}{to:>gap$}"), theme::DIM));
    }
    rows(&lines, inner, buffer);
}

const fn shade(off: Off) -> Style {
    match off {
        Off::TooLow => theme::TOO_LOW,
        Off::TooHigh => theme::TOO_HIGH,
        Off::BothWays => theme::CAREFUL,
    }
}
