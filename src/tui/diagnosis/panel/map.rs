//! The error of one equation over speed x current, as digits: readable without colour.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget};

use super::titled;
use crate::text::number::{shortest, significant};
use crate::tui::diagnosis::state::State;
use crate::tui::theme;

/// Digit of the largest error.
const LARGEST: f64 = 9.0;

/// `index` 0 is the equation that fails worse.
pub(in crate::tui::diagnosis) fn map(state: &State, index: usize, area: Rect, buffer: &mut Buffer) {
    let Some(comparison) = state.comparison.as_ref() else {
        return;
    };
    let (Some(map), false) = (&comparison.map, area.height == 0) else {
        return;
    };
    let torque_first = comparison
        .balances
        .first()
        .is_none_or(|balance| balance.equation == "torque");
    let (equation, unit, cells) = if torque_first == (index == 0) {
        ("torque", "N.m", &map.torque_rms_n_m)
    } else {
        ("voltage", "V", &map.voltage_rms_v)
    };
    let largest = cells
        .iter()
        .flatten()
        .flatten()
        .copied()
        .filter(|value| value.is_finite())
        .fold(0.0, f64::max);
    let title = format!(
        "{equation} error over speed x current: 9 is {} {unit}, · never there",
        significant(largest, 3)
    );
    let inner = titled(&title, area, buffer);
    let room = usize::from(inner.height).saturating_sub(1);
    let columns = map.current_edges_a.len().saturating_sub(1).max(1);
    let cell_width = (usize::from(inner.width).saturating_sub(14) / columns).clamp(1, 6);
    // Two rows for each speed where there is room, so that the map is nearly square.
    let repeat = (room / cells.len().max(1)).clamp(1, 2);
    let mut lines = Vec::new();
    for (row, values) in cells.iter().enumerate().rev() {
        let edges = map
            .speed_edges_rad_s
            .get(row)
            .zip(map.speed_edges_rad_s.get(row + 1));
        let middle = edges.map_or(f64::NAN, |(from, to)| 0.5 * (from + to));
        for copy in 0..repeat {
            let label = if copy == 0 {
                format!("{middle:>6.0} rad/s ")
            } else {
                " ".repeat(13)
            };
            let mut line = Line::from(Span::styled(label, theme::DIM));
            line.extend(values.iter().map(|value| {
                let (mark, style) = digit(*value, largest);
                Span::styled(mark.to_string().repeat(cell_width), style)
            }));
            lines.push(line);
        }
    }
    lines.truncate(room);
    if let (Some(from), Some(to)) = (map.current_edges_a.first(), map.current_edges_a.last()) {
        let [from, to] = [from, to].map(|edge| format!("{} A", shortest(*edge, 3)));
        let gap = (columns * cell_width).saturating_sub(from.chars().count());
        lines.push(Line::styled(
            format!("{:13}{from}{to:>gap$}", ""),
            theme::DIM,
        ));
    }
    Paragraph::new(lines).render(inner, buffer);
}

fn digit(value: Option<f64>, largest: f64) -> (char, Style) {
    let Some(value) = value.filter(|value| value.is_finite() && largest > 0.0) else {
        return ('·', theme::DIM);
    };
    let digit = (LARGEST * value / largest).round().clamp(0.0, LARGEST) as u32;
    let style = match digit {
        0..=2 => theme::GOOD,
        3..=5 => theme::CAREFUL,
        _ => theme::BAD,
    };
    (char::from_digit(digit, 10).unwrap_or('?'), style)
}
