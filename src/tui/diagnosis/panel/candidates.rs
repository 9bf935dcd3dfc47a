//! The effects: bars while they are judged, then status, share explained, size with interval.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget};

use super::{bar, titled_with};
use crate::diagnosis::{Candidate, Status};
use crate::plant::Effect;
use crate::sample::{ParameterEstimate, TWO_SIDED_95};
use crate::text::number::{significant, with_unit};
use crate::tui::diagnosis::guess::Guessing;
use crate::tui::diagnosis::state::{Row, State};
use crate::tui::theme;
use crate::tui::widget::parameters::parameter as parameter_name;

const BAR: usize = 8;
const NARROW_BAR: usize = 4;
/// Below this width a share is a number alone, and below the next a status is its mark alone.
const NARROW: usize = 86;
const SLIM: usize = 70;
/// From this width on there is room for the name of the size, and for what would have been seen.
const WIDE: usize = 110;

pub(in crate::tui::diagnosis) fn candidates(state: &State, area: Rect, buffer: &mut Buffer) {
    if area.height == 0 {
        return;
    }
    let title = if state.guessing == Guessing::Choosing {
        "what is missing? your guess"
    } else if state.diagnosis.is_none() {
        "effects being judged: share of the error explained, to first order"
    } else {
        "effects: status, probability, size ± 95 %"
    };
    let rows = state.rows();
    let inner = titled_with(title, &place(state, &rows, area), area, buffer);
    if rows.is_empty() {
        Line::styled(" none yet", theme::DIM).render(inner, buffer);
        return;
    }
    let selected = state.selected(&rows);
    // The selected row stays in sight.
    let room = usize::from(inner.height).max(1);
    let first = (selected + 1).saturating_sub(room);
    let lines: Vec<Line<'static>> = rows
        .iter()
        .enumerate()
        .skip(first)
        .take(room)
        .map(|(index, row)| {
            let mark = if index == selected { "▶ " } else { "  " };
            let mut line = Line::from(Span::raw(mark));
            line.extend(spans(row, usize::from(inner.width), state.is_floor_known()));
            if index == selected {
                line = line.style(theme::BOLD);
            }
            line
        })
        .collect();
    Paragraph::new(lines).render(inner, buffer);
}

fn spans(row: &Row<'_>, width: usize, floor: bool) -> Vec<Span<'static>> {
    match row {
        Row::Choice(guess) => {
            let name = row.effect().map_or("", |effect| effect.card().name);
            vec![
                Span::raw(format!("{:<25} ", guess.key())),
                Span::styled(name.to_owned(), theme::DIM),
            ]
        }
        Row::Present(id) => vec![
            Span::styled("+ in the model ", theme::GOOD),
            Span::raw((*id).to_owned()),
        ],
        Row::Judged(id, judged) => {
            let mut spans = vec![Span::raw(format!("{id:<25} "))];
            spans.extend(share(judged.share, BAR));
            if let Some(error) = judged.error {
                // What a multiple is of without a floor, the ladder says.
                let unit = if floor { " x noise" } else { "" };
                spans.push(Span::raw(format!("  refitted: {error:.2}{unit}")));
            }
            spans
        }
        Row::Candidate(candidate) => {
            let (word, style) = status(candidate.status);
            let word = if width < SLIM {
                word.chars().take(1).chain([' ']).collect()
            } else {
                format!("{word:<13} ")
            };
            let mut spans = vec![
                Span::styled(word, style),
                Span::raw(format!("{:<24} ", candidate.effect)),
            ];
            // What would not have shown has no probability but that of before.
            let is_seen = candidate.status != Status::NotExcited;
            let bar_length = match width {
                WIDE.. => BAR,
                NARROW.. => NARROW_BAR,
                _ => 0,
            };
            let probability = Some(candidate.probability).filter(|_| is_seen);
            spans.extend(share(probability, bar_length));
            let is_named = !candidate.parameters.is_empty();
            let text = if is_named {
                size(candidate, width >= WIDE)
            } else if is_seen {
                at_most(candidate)
            } else {
                None
            };
            spans.push(Span::raw(format!("  {}", text.unwrap_or_default())));
            if let (true, Some(text)) = (width >= WIDE && is_seen, detectable(candidate)) {
                let used: usize = spans.iter().map(Span::width).sum();
                // Half a unit would be another unit.
                if used + text.chars().count() + 4 <= width {
                    spans.push(Span::styled(format!("  {text}"), theme::DIM));
                }
            }
            spans
        }
    }
}

/// Which rows of how many are in sight, where not all are.
fn place(state: &State, rows: &[Row<'_>], area: Rect) -> String {
    let room = usize::from(area.height.saturating_sub(1)).max(1);
    if rows.len() <= room {
        return String::new();
    }
    let first = (state.selected(rows) + 1).saturating_sub(room);
    format!("{}-{} of {}", first + 1, first + room, rows.len())
}

fn share(share: Option<f64>, length: usize) -> Vec<Span<'static>> {
    let Some(share) = share.filter(|share| share.is_finite()) else {
        return vec![Span::raw(" ".repeat(length + 6))];
    };
    let (full, empty) = bar(share, length);
    vec![
        Span::raw(full),
        Span::styled(empty, theme::DIM),
        Span::raw(format!(
            "{:>4.0} %",
            (100.0 * share.clamp(-9.0, 1.0)).round() + 0.0
        )),
    ]
}

pub(super) const fn status(status: Status) -> (&'static str, Style) {
    match status {
        Status::Supported => ("✓ supported", theme::GOOD),
        Status::Possible => ("~ possible", theme::CAREFUL),
        Status::RuledOut => ("✗ ruled out", theme::DIM),
        Status::NotExcited => ("· not excited", theme::DIM),
    }
}

/// The parameter that gives the effect its size.
fn size(candidate: &Candidate, with_name: bool) -> Option<String> {
    let effect = crate::plant::effect::find(candidate.effect)?;
    let key = size_key(effect);
    let found = candidate.parameters.iter();
    let of_size = |p: &&ParameterEstimate| p.key.rsplit('.').next() == Some(key);
    let parameter = found
        .clone()
        .find(of_size)
        .or_else(|| found.clone().next())?;
    let name = if with_name {
        format!("{} ", parameter_name(&parameter.key).0)
    } else {
        String::new()
    };
    Some(format!("{name}{}", parameter.text(TWO_SIDED_95)))
}

fn size_key(effect: &dyn Effect) -> &'static str {
    let specs = effect.parameters();
    let of_size = specs.iter().find(|spec| spec.is_coefficient());
    of_size
        .or_else(|| specs.first())
        .map_or("", |spec| spec.key)
}

/// A size in the unit of the parameter that gives the effect its size.
fn in_words(candidate: &Candidate, lead: &str, size: Option<f64>) -> Option<String> {
    let effect = crate::plant::effect::find(candidate.effect)?;
    let key = size_key(effect);
    let specs = effect.parameters().iter();
    let unit = specs.clone().find(|spec| spec.key == key)?.unit;
    let size = size.filter(|size| size.is_finite())?;
    let size = with_unit(&significant(size, 2), unit);
    Some(format!("{lead} {size}"))
}

/// What its size is below.
pub(super) fn at_most(candidate: &Candidate) -> Option<String> {
    in_words(candidate, "at most", candidate.upper_bound)
}

/// The smallest size that would have been named.
pub(super) fn detectable(candidate: &Candidate) -> Option<String> {
    in_words(candidate, "seen from", candidate.detectable)
}
