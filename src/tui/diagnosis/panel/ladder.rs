//! The ladder: the held-out error of every model so far, beside the noise floor.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget};

use super::titled;
use crate::diagnosis::{AddResult, Comparison};
use crate::text::lines::{cut, wrapped};
use crate::text::number::significant;
use crate::tui::diagnosis::state::{State, Step};
use crate::tui::theme;

/// Longest bar.
const LONGEST: usize = 60;
const NAME: usize = 26;
const MOST_ROWS_OF_A_CHANGE: usize = 3;

pub(in crate::tui::diagnosis) fn ladder(state: &State, area: Rect, buffer: &mut Buffer) {
    if area.height == 0 {
        return;
    }
    let floor = state.is_floor_known();
    let title = if floor {
        "ladder: held-out error, times the noise (│ = noise floor)"
    } else {
        "ladder: held-out error, times the baseline's residual (no floor is known)"
    };
    let inner = titled(title, area, buffer);
    let mut lines = Vec::new();
    lines.extend(changes(state, inner.width));
    let room = usize::from(inner.height).saturating_sub(lines.len());
    let largest = state
        .ladder
        .iter()
        .map(|step| step.error)
        .filter(|error| error.is_finite())
        .fold(1.0, f64::max);
    let hidden = state.ladder.len().saturating_sub(room);
    let steps = state.ladder.iter().skip(hidden);
    lines.extend(steps.map(|step| rung(step, largest, floor, usize::from(inner.width))));
    Paragraph::new(lines).render(inner, buffer);
}

/// What the last key did, in as many rows as that takes.
fn changes(state: &State, width: u16) -> Vec<Line<'static>> {
    let Some((added, result)) = &state.change else {
        return Vec::new();
    };
    let line = change(*added, result);
    let rows = wrapped(
        line.to_string().trim_start(),
        usize::from(width).saturating_sub(1),
    );
    let most = rows.len().min(MOST_ROWS_OF_A_CHANGE);
    let rows = rows.into_iter().take(most);
    rows.map(|row| Line::styled(format!(" {row}"), line.style))
        .collect()
}

/// Rows that the last change takes.
pub(in crate::tui::diagnosis) fn change_rows(state: &State, width: u16) -> u16 {
    u16::try_from(changes(state, width).len()).unwrap_or(0)
}

fn rung(step: &Step, largest: f64, floor: bool, width: usize) -> Line<'static> {
    let length = width.saturating_sub(NAME + 26).clamp(4, LONGEST);
    // The floor has a cell of its own, also when the error is at it.
    let cell = |error: f64| ((error / largest).clamp(0.0, 1.0) * length as f64).round() as usize;
    let (full, mark) = (cell(step.error), floor.then(|| cell(1.0)));
    let bar: String = (0..=length)
        .map(|at| match (Some(at) == mark, at < full) {
            (true, _) => '│',
            (false, true) => '█',
            (false, false) => ' ',
        })
        .collect();
    let at_floor = step.at_floor;
    let name = cut(&step.name, NAME);
    Line::from(vec![
        Span::raw(format!(" {name:<NAME$} ")),
        Span::styled(
            bar,
            if at_floor {
                theme::GOOD
            } else {
                theme::CAREFUL
            },
        ),
        Span::styled(format!(" {:>6.2}", step.error), theme::BOLD),
        Span::raw(if at_floor { " at the floor" } else { "" }),
    ])
}

/// What the last key did: before and after, or why it was refused.
fn change(added: bool, result: &AddResult) -> Line<'static> {
    let word = match (result.accepted, added) {
        (true, true) => "added",
        (true, false) => "removed",
        (false, _) => {
            return Line::styled(format!(" ✗ refused: {}", result.reason), theme::CAREFUL);
        }
    };
    let of = |comparison: &Comparison| {
        let signals = &comparison.signals;
        [
            (signals.torque_n_m.as_ref().map(|s| s.holdout.rmse), "N.m"),
            (signals.speed_rad_s.map(|s| s.holdout.rmse), "rad/s"),
            (signals.current_a.map(|s| s.holdout.rmse), "A"),
        ]
    };
    let figures: Vec<String> = of(&result.before)
        .into_iter()
        .zip(of(&result.after))
        .filter_map(|((before, unit), (after, _))| {
            let (before, after) = (significant(before?, 3), significant(after?, 3));
            Some(format!("{before} -> {after} {unit}"))
        })
        .collect();
    let confirmed = result
        .confirm
        .as_ref()
        .map_or_else(String::new, |[before, after]| {
            format!(
                "; confirming run {:.2} -> {:.2} {}",
                before.holdout_rmse,
                after.holdout_rmse,
                result.before.noise_floor_from.times()
            )
        });
    Line::styled(
        format!(
            " ✓ {word} {}: {}{confirmed}",
            result.effect,
            figures.join(", ")
        ),
        theme::GOOD,
    )
}
