//! Pages over the screen: the card of an effect, the curve that the error follows, the map of the error, the next run.

use std::fmt::Write as _;

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget};

use super::state::{Guessing, Row, State};
use super::view::{at_most, detectable, status};
use crate::diagnosis::Reached;
use crate::sample::TWO_SIDED_95;
use crate::text::lines::wrapped;
use crate::text::number::{probability, shortest, significant, with_std};
use crate::tui::frame::{page, paragraph, titled, titled_with};
use crate::tui::theme;

/// The card of the selected effect, and what this run says of it.
pub(super) fn card(state: &State, first: usize, area: Rect, buffer: &mut Buffer) {
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
        lines.push(paragraph("here", format!("{word}: {}", candidate.evidence)));
        for parameter in &candidate.parameters {
            let key = parameter.key.rsplit('.').next().unwrap_or(&parameter.key);
            let reason = parameter.reason.as_deref();
            let reason = reason.map_or_else(String::new, |reason| format!(" ({reason})"));
            let text = format!("{}{reason}, 95 % interval", parameter.text(TWO_SIDED_95));
            lines.push(paragraph(key, text));
        }
        lines.extend(at_most(candidate).map(|text| paragraph("size", text)));
        lines.extend(detectable(candidate).map(|text| paragraph("visible", text)));
        for peak in candidate.reached.iter().flat_map(Reached::peaks) {
            lines.push(paragraph("reached", peak.text(TWO_SIDED_95)));
        }
        let is_named = !candidate.parameters.is_empty();
        let widened = candidate.widened().filter(|_| is_named);
        lines.extend(widened.map(|text| paragraph("intervals", text)));
        let there = probability(candidate.probability);
        let mut text = format!("{}; there with {there}", candidate.rank);
        if let Some(after) = candidate.error_after {
            let before = candidate.error_before;
            let _ = write!(text, "; training error {before:.2} -> {after:.2}");
        }
        lines.push(paragraph("rank", text));
    }
    for (title, text) in [
        ("equation", card.equation),
        ("causes", card.causes),
        ("looks like", card.looks_like),
        ("excite it", card.excite),
        ("remedy", card.remedy),
    ] {
        lines.push(paragraph(title, text));
    }
    page(lines, first, inner, buffer);
}

/// Longest half of a bar.
const LONGEST: usize = 30;
/// Columns of a knot and its value.
const FIGURES: usize = 34;

/// What the error follows where no effect explains it: its curve along one axis, knot by knot. `index` counts the curves,
/// the clearest first; `first` is the first knot in sight.
pub(super) fn curve(state: &State, index: usize, first: usize, area: Rect, buffer: &mut Buffer) {
    let curves = state.curves();
    let Some((_, map)) = curves.get(index) else {
        return;
    };
    let equation = map.equation;
    let unit = if equation == "voltage" { "V" } else { "N.m" };
    let axis = match map.axis {
        "speed_rad_s" => "speed, rad/s",
        "current_a" => "current, A",
        "voltage_v" => "voltage, V",
        "angle_rad" => "angle, rad",
        _ => "time, s",
    };
    let title = format!("what the {equation} equation lacks, {unit}, over {axis}");
    let place = format!("{} of {}", index + 1, curves.len());
    let inner = titled_with(&title, &place, area, buffer);
    let width = usize::from(inner.width);
    let mut lines: Vec<Line<'static>> = wrapped(&map.sentence, width.saturating_sub(1))
        .into_iter()
        .map(|row| Line::styled(format!(" {row}"), theme::BOLD))
        .collect();
    let room = usize::from(inner.height).saturating_sub(lines.len());
    let finite = map.values.iter().filter(|value| value.is_finite());
    let largest = finite.fold(0.0, |most: f64, value| most.max(value.abs()));
    let half = (width.saturating_sub(FIGURES + 1) / 2).clamp(1, LONGEST);
    let first = first.min(map.knots.len().saturating_sub(room));
    for knot in (first..map.knots.len()).take(room) {
        let (value, std) = (map.values[knot], map.std.get(knot).copied());
        let (left, right) = bars(value / largest, half);
        // What its own uncertainty could be is not a finding.
        let is_told = std.is_none_or(|std| value.abs() > CERTAIN * std);
        let style = if is_told { theme::CAREFUL } else { theme::DIM };
        let (knot, value) = (significant(map.knots[knot], 3), with_std(value, std));
        lines.push(Line::from(vec![
            Span::raw(format!(" {knot:>9} {value:>20} ")),
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

/// Digit of the largest error.
const LARGEST: f64 = 9.0;

/// The error of one equation over speed x current, as digits: readable without colour. `index` 0 is the equation that
/// fails worse.
pub(super) fn map(state: &State, index: usize, area: Rect, buffer: &mut Buffer) {
    let compared = state.comparison.as_ref();
    let Some((comparison, map)) = compared.and_then(|found| Some((found, found.map.as_ref()?)))
    else {
        return;
    };
    let worse = comparison.balances.first();
    let torque_first = worse.is_none_or(|balance| balance.equation == "torque");
    let (equation, unit, cells) = if torque_first == (index == 0) {
        ("torque", "N.m", &map.torque_rms_n_m)
    } else {
        ("voltage", "V", &map.voltage_rms_v)
    };
    let values = cells.iter().flatten().flatten().copied();
    let largest = values.filter(|value| value.is_finite()).fold(0.0, f64::max);
    let nine = significant(largest, 3);
    let title = format!("{equation} error over speed x current: 9 is {nine} {unit}, · never there");
    let inner = titled(&title, area, buffer);
    let room = usize::from(inner.height).saturating_sub(1);
    let columns = map.current_edges_a.len().saturating_sub(1).max(1);
    let cell_width = (usize::from(inner.width).saturating_sub(14) / columns).clamp(1, 6);
    // Two rows for each speed where there is room, so that the map is nearly square.
    let repeat = (room / cells.len().max(1)).clamp(1, 2);
    let mut lines = Vec::new();
    for (row, values) in cells.iter().enumerate().rev() {
        let edges = map.speed_edges_rad_s.get(row..row + 2);
        let middle = edges.map_or(f64::NAN, |edges| 0.5 * (edges[0] + edges[1]));
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
        let axis = format!("{:13}{from}{to:>gap$}", "");
        lines.push(Line::styled(axis, theme::DIM));
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

/// What these runs do not tell, and the run that would.
pub(super) fn next(state: &State, first: usize, area: Rect, buffer: &mut Buffer) {
    let Some(diagnosis) = &state.diagnosis else {
        return;
    };
    let inner = titled("what these runs do not tell", area, buffer);
    let mut lines = Vec::new();
    for [one, other] in &diagnosis.confusable {
        lines.push(paragraph("not told apart", format!("{one} and {other}")));
    }
    for sentence in &diagnosis.limits {
        lines.push(paragraph("limit", sentence.clone()));
    }
    for sentence in &diagnosis.equivalences {
        lines.push(paragraph("by no run", *sentence));
    }
    for map in &diagnosis.axis_map {
        lines.push(paragraph("the error", map.sentence.clone()));
    }
    if let Some(next) = &state.next {
        lines.push(paragraph("next run", next.sentence.clone()));
        if !next.menu.is_empty() {
            let text = "expected separation of each run, and from which on that run tells";
            lines.push(paragraph("compared", text));
        }
        for entry in &next.menu {
            let is_told = entry.is_told();
            let (mark, style) = if is_told {
                ("✓", theme::GOOD)
            } else {
                ("·", theme::DIM)
            };
            let [expected, needed] =
                [entry.expected_separation, entry.needed].map(|value| significant(value, 2));
            let text = format!("{mark} {:<20} {expected:>10} of {needed}", entry.program);
            lines.push(Line::styled(text, style));
        }
    }
    if lines.is_empty() {
        let none = "none is asked for: these runs tell what they can";
        lines.push(paragraph("next run", none));
    }
    page(lines, first, inner, buffer);
}
