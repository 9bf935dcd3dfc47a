//! The list of effects: what its rows stand for, which one is selected, and how it is drawn: bars while they are judged,
//! then status, share explained, size with interval.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::state::State;
use crate::report::wording::candidate::{at_most, detectable_from};
use crate::tui::frame::{bar, row as render_row, rows as render_rows, titled_with};
use crate::tui::live::parameter_name;
use crate::tui::theme;
use drivebench_diagnose::{Candidate, Status};
use drivebench_model::plant::effect;
use drivebench_model::sample::{ParameterEstimate, TWO_SIDED_95};
use drivebench_model::text::lines::cut;

/// An effect while the search is under way.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Judged {
    /// Share of the unexplained error, to first order.
    pub(super) share: Option<f64>,
    /// Training error after the refit, in units of the noise.
    pub(super) error: Option<f64>,
}

/// A row of the list.
#[derive(Clone, Copy, Debug)]
pub(super) enum Row<'a> {
    Present(&'static str),
    Judged(&'static str, Judged),
    Candidate(&'a Candidate),
}

impl Row<'_> {
    /// The id by which the row is selected.
    pub(super) const fn key(&self) -> &'static str {
        match self {
            Self::Present(id) | Self::Judged(id, _) => id,
            Self::Candidate(candidate) => candidate.effect,
        }
    }

    pub(super) fn effect(&self) -> Option<&'static dyn drivebench_model::plant::Effect> {
        effect::find(self.key())
    }
}

impl State {
    pub(super) fn rows(&self) -> Vec<Row<'_>> {
        let mut rows: Vec<Row<'_>> = self.present.iter().map(|id| Row::Present(id)).collect();
        if let Some(diagnosis) = &self.diagnosis {
            rows.extend(diagnosis.candidates.iter().map(Row::Candidate));
            return rows;
        }
        let mut judged: Vec<_> = self.judged.iter().collect();
        let share = |judged: &Judged| judged.share.unwrap_or(f64::NEG_INFINITY);
        judged.sort_by(|a, b| share(b.1).total_cmp(&share(a.1)));
        let judged = judged.into_iter();
        rows.extend(judged.map(|(id, judged)| Row::Judged(id, *judged)));
        rows
    }

    /// The index of the selected row; at first that of the first effect that is not in the model.
    fn selected(&self, rows: &[Row<'_>]) -> Option<usize> {
        let chosen = |key| rows.iter().position(|row| row.key() == key);
        let first =
            || rows.iter().position(|row: &Row<'_>| !matches!(row, Row::Present(_))).or(Some(0));
        self.selected.and_then(chosen).or_else(first).filter(|_| !rows.is_empty())
    }

    pub(super) fn row(&self) -> Option<Row<'_>> {
        let rows = self.rows();
        rows.get(self.selected(&rows)?).copied()
    }

    /// Selects the row that is so many below the one that is selected.
    pub(super) fn select_by(&mut self, by: i32) {
        let rows = self.rows();
        let last = rows.len().saturating_sub(1);
        let next = match self.selected(&rows) {
            Some(at) => at.saturating_add_signed(by as isize).min(last),
            None if by < 0 => last,
            None => 0,
        };
        self.selected = rows.get(next).map(Row::key);
    }

    /// Selects the row that is drawn so many rows below the top of its area; whether there is one.
    pub(super) fn select_drawn(&mut self, below: u16, area: Rect) -> bool {
        let rows = self.rows();
        let at = usize::from(below).checked_sub(1);
        let at = at.map(|at| at + first_drawn(self.selected(&rows), area));
        let key = at.and_then(|at| rows.get(at)).map(Row::key);
        self.selected = key.or(self.selected);
        key.is_some()
    }
}

const BAR: usize = 8;
/// From this width on there is room for the name of the size, and for the detectable size.
const WIDE: usize = 110;

/// The first row that is drawn, so that the selected one stays in sight.
fn first_drawn(selected: Option<usize>, area: Rect) -> usize {
    selected.map_or(0, |selected| (selected + 1).saturating_sub(room(area)))
}

fn room(area: Rect) -> usize {
    usize::from(area.height.saturating_sub(1)).max(1)
}

/// The effects: bars while they are judged, then status, share explained, size with interval.
pub(super) fn candidates(state: &State, area: Rect, buffer: &mut Buffer) {
    if area.height == 0 {
        return;
    }
    let title = if state.diagnosis.is_none() {
        "effects being judged: share of the error explained, to first order"
    } else {
        "effects: status, probability, size ± 95 %"
    };
    let rows = state.rows();
    let selected = state.selected(&rows);
    let room = room(area);
    let first = first_drawn(selected, area);
    let range = if rows.len() <= room {
        String::new()
    } else {
        format!("{}-{} of {}", first + 1, first + room, rows.len())
    };
    let inner = titled_with(title, &range, area, buffer);
    if rows.is_empty() {
        render_row(&Line::styled(" none yet", theme::DIM), inner, buffer);
        return;
    }
    let lines = rows.iter().enumerate().skip(first).take(room).map(|(index, row)| {
        let is_selected = Some(index) == selected;
        let mut line = Line::raw(if is_selected { "▶ " } else { "  " });
        line.extend(spans(row, usize::from(inner.width), state.is_floor_known()));
        line.style(if is_selected { theme::BOLD } else { theme::PLAIN })
    });
    render_rows(&lines.collect::<Vec<_>>(), inner, buffer);
}

fn spans(row: &Row<'_>, width: usize, floor: bool) -> Vec<Span<'static>> {
    match row {
        Row::Present(id) => {
            vec![Span::styled("+ in the model ", theme::GOOD), Span::raw((*id).to_owned())]
        }
        Row::Judged(id, judged) => {
            let mut spans = vec![Span::raw(format!("{id:<25} "))];
            spans.extend(share(judged.share, BAR));
            if let Some(error) = judged.error {
                // Without a floor the title of the ladder has the unit.
                let unit = if floor { " x noise" } else { "" };
                spans.push(Span::raw(format!("  refitted: {error:.2}{unit}")));
            }
            spans
        }
        Row::Candidate(candidate) => {
            let (text, style) = status(candidate);
            let text = if width < 70 {
                text.chars().take(1).chain([' ']).collect()
            } else {
                format!("{text:<13} ")
            };
            let mut spans =
                vec![Span::styled(text, style), Span::raw(format!("{:<24} ", candidate.effect))];
            // The probability of an effect that is not detectable is the prior one, and is not shown.
            let is_detectable = candidate.status != Status::NotExcited;
            let bar_length = match width {
                WIDE.. => BAR,
                86.. => 4,
                _ => 0,
            };
            spans.extend(share(Some(candidate.probability).filter(|_| is_detectable), bar_length));
            let is_named = !candidate.parameters.is_empty();
            let text = if is_named {
                size(candidate, width >= WIDE)
            } else if is_detectable {
                at_most(candidate)
            } else {
                None
            };
            spans.push(Span::raw(format!("  {}", text.unwrap_or_default())));
            if let Some(other) = candidate.as_good_as {
                let used: usize = spans.iter().map(Span::width).sum();
                let text = cut(&format!(" as good as {other}"), width.saturating_sub(used + 2));
                spans.push(Span::styled(text, theme::CAREFUL));
            }
            if let (true, Some(text)) = (width >= WIDE && is_detectable, detectable_from(candidate))
            {
                let used: usize = spans.iter().map(Span::width).sum();
                // A text cut within its unit would show another unit.
                if used + text.chars().count() + 4 <= width {
                    spans.push(Span::styled(format!("  {text}"), theme::DIM));
                }
            }
            spans
        }
    }
}

fn share(share: Option<f64>, length: usize) -> Vec<Span<'static>> {
    let Some(share) = share.filter(|share| share.is_finite()) else {
        return vec![Span::raw(" ".repeat(length + 6))];
    };
    let (full, empty) = bar(share, length);
    let percent = (100.0 * share.clamp(-9.0, 1.0)).round() + 0.0;
    vec![Span::raw(full), Span::styled(empty, theme::DIM), Span::raw(format!("{percent:>4.0} %"))]
}

/// The status with its mark, and its colour.
const fn status(candidate: &Candidate) -> (&'static str, Style) {
    match candidate.status {
        Status::Supported => ("✓ supported", theme::GOOD),
        Status::Possible => ("~ possible", theme::CAREFUL),
        Status::RuledOut => ("✗ ruled out", theme::DIM),
        Status::NotExcited if candidate.is_open => ("· left open", theme::DIM),
        Status::NotExcited => ("· not excited", theme::DIM),
    }
}

/// The parameter that gives the effect its size.
fn size(candidate: &Candidate, with_name: bool) -> Option<String> {
    let effect = effect::find(candidate.effect)?;
    let key = effect.parameters().get(effect.size_index())?.key;
    let mut found = candidate.parameters.iter();
    let of_size = |p: &&ParameterEstimate| p.key.rsplit('.').next() == Some(key);
    let parameter = found.clone().find(of_size).or_else(|| found.next())?;
    let text = parameter.text(TWO_SIDED_95);
    Some(if with_name { format!("{} {text}", parameter_name(&parameter.key).0) } else { text })
}
