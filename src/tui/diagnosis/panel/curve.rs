//! What the error follows where no effect explains it: its curve along one axis, knot by knot.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget};

use super::titled_with;
use crate::text::lines::wrapped;
use crate::text::number::{significant, with_std};
use crate::tui::diagnosis::state::State;
use crate::tui::theme;

/// Longest half of a bar.
const LONGEST: usize = 30;
/// Columns of a knot and its value.
const FIGURES: usize = 34;

/// `index` counts the curves, the clearest first; `first` is the first knot in sight.
pub(in crate::tui::diagnosis) fn curve(
    state: &State,
    index: usize,
    first: usize,
    area: Rect,
    buffer: &mut Buffer,
) {
    let curves = state.curves();
    let (Some((_, map)), false) = (curves.get(index), area.height == 0) else {
        return;
    };
    let unit = if map.equation == "voltage" {
        "V"
    } else {
        "N.m"
    };
    let axis = match map.axis {
        "speed_rad_s" => "speed, rad/s",
        "current_a" => "current, A",
        "voltage_v" => "voltage, V",
        "angle_rad" => "angle, rad",
        _ => "time, s",
    };
    let title = format!(
        "what the {} equation lacks, {unit}, over {axis}",
        map.equation
    );
    let place = format!("{} of {}", index + 1, curves.len());
    let inner = titled_with(&title, &place, area, buffer);
    let width = usize::from(inner.width);
    let mut lines: Vec<Line<'static>> = wrapped(&map.sentence, width.saturating_sub(1))
        .into_iter()
        .map(|row| Line::styled(format!(" {row}"), theme::BOLD))
        .collect();
    let room = usize::from(inner.height).saturating_sub(lines.len());
    let largest = map
        .values
        .iter()
        .filter(|value| value.is_finite())
        .fold(0.0, |most: f64, value| most.max(value.abs()));
    let half = (width.saturating_sub(FIGURES + 1) / 2).clamp(1, LONGEST);
    let first = first.min(map.knots.len().saturating_sub(room));
    for knot in (first..map.knots.len()).take(room) {
        let (value, std) = (map.values[knot], map.std.get(knot).copied());
        let (left, right) = bars(value / largest, half);
        // What its own uncertainty could be is not a finding.
        let is_told = std.is_none_or(|std| value.abs() > CERTAIN * std);
        let style = if is_told { theme::CAREFUL } else { theme::DIM };
        lines.push(Line::from(vec![
            Span::raw(format!(
                " {:>9} {:>20} ",
                significant(map.knots[knot], 3),
                with_std(value, std)
            )),
            Span::styled(left, style),
            Span::raw("│"),
            Span::styled(right, style),
        ]));
    }
    Paragraph::new(lines).render(inner, buffer);
}

/// Standard deviations from which on a value is told from zero.
const CERTAIN: f64 = 2.6;

/// Both halves of a bar around zero.
fn bars(share: f64, half: usize) -> (String, String) {
    let share = if share.is_finite() { share } else { 0.0 };
    let cells = ((share.abs().min(1.0) * half as f64).round() as usize).min(half);
    let (full, empty) = ("█".repeat(cells), " ".repeat(half - cells));
    if share < 0.0 {
        (empty + &full, " ".repeat(half))
    } else {
        (" ".repeat(half), full + &empty)
    }
}
