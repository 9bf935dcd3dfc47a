//! The steps of a workflow, then what it found.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget};

use crate::text::lines::wrapped;
use crate::tui::model::Model;
use crate::tui::theme;
use crate::workflow::{Progress, StepState};

pub(crate) fn steps(model: &Model, area: Rect, buffer: &mut Buffer) {
    let Some(view) = &model.workflow else {
        return;
    };
    let lines = lines(view, area.width);
    // The last page stays full.
    let hidden = lines.len().saturating_sub(usize::from(area.height));
    let first = model.scroll.min(hidden);
    let shown: Vec<Line<'static>> = lines.into_iter().skip(first).collect();
    Paragraph::new(shown).render(area, buffer);
}

fn lines(view: &Progress, width: u16) -> Vec<Line<'static>> {
    let widest = view.steps.iter().map(|step| step.title.chars().count());
    let title_width = widest.max().unwrap_or(0).min(usize::from(width) / 3);
    let mut lines: Vec<Line<'static>> = view
        .steps
        .iter()
        .map(|step| {
            let (mark, style) = look(step.state);
            Line::from(vec![
                Span::styled(format!(" {mark} {:<8}", name(step.state)), style),
                Span::styled(format!("{:<title_width$}  ", step.title), theme::BOLD),
                Span::raw(step.line.clone()),
            ])
        })
        .collect();
    if !view.report.is_empty() {
        lines.push(Line::default());
        let room = usize::from(width).saturating_sub(2);
        let rows = view.report.iter().flat_map(|text| rows(text, room));
        lines.extend(rows.map(|text| Line::raw(format!(" {text}"))));
    }
    lines
}

/// Sentences go on in the next line; the row of a table is cut, so that columns stay columns.
fn rows(text: &str, room: usize) -> Vec<String> {
    if text.starts_with('|') {
        return vec![text.to_owned()];
    }
    wrapped(text, room)
}

const fn name(state: StepState) -> &'static str {
    match state {
        StepState::Waiting => "waiting",
        StepState::Active => "active",
        StepState::Done => "done",
        StepState::Failed => "failed",
    }
}

const fn look(state: StepState) -> (&'static str, Style) {
    match state {
        StepState::Waiting => ("·", theme::DIM),
        StepState::Active => ("▶", theme::CAREFUL),
        StepState::Done => ("✓", theme::GOOD),
        StepState::Failed => ("✗", theme::BAD),
    }
}
