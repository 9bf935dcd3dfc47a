//! The whole frame as a function of the model.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::{Line, Span};
use ratatui::widgets::Widget;

use super::model::{Model, Screen};
use super::screen::{help, live, parameters, steps};
use super::theme;
use super::widget::banner::Banner;
use super::widget::hints::hints;
use super::widget::progress_bar::progress_bar;
use super::widget::top_bar::top_bar;
use crate::workflow::StepState;

/// The smallest screen that can be read.
const SMALLEST: (u16, u16) = (30, 6);

pub(super) fn view(model: &Model, frame: &mut Frame<'_>) {
    let area = frame.area();
    let buffer = frame.buffer_mut();
    if area.width < SMALLEST.0 || area.height < SMALLEST.1 {
        too_small(model, area, buffer);
        return;
    }
    let banner = Banner::of(model);
    let step_rows = u16::from(model.workflow.is_some() && area.height >= 12);
    let banner_rows = banner
        .as_ref()
        .map_or(0, |banner| banner.height(area.width));
    let [top, progress, step, box_area, body, bottom] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(1),
        Constraint::Length(step_rows),
        Constraint::Length(banner_rows.min(area.height - 3)),
        Constraint::Fill(1),
        Constraint::Length(1),
    ])
    .areas(area);
    top_bar(&model.snapshot, top, buffer);
    progress_bar(&model.snapshot, progress, buffer);
    if step_rows > 0 {
        step_line(model).render(step, buffer);
    }
    if let Some(banner) = banner {
        banner.render(box_area, buffer);
    }
    match model.screen {
        Screen::Live => live::live(model, body, buffer),
        Screen::Parameters => parameters::parameters(model, body, buffer),
        Screen::Steps => steps::steps(model, body, buffer),
    }
    hints(model, bottom, buffer);
    if model.help {
        let under_top = Rect {
            y: area.y + 1,
            height: area.height - 1,
            ..area
        };
        help::help(model.help_row, under_top, buffer);
    }
}

fn step_line(model: &Model) -> Line<'static> {
    let Some(view) = &model.workflow else {
        return Line::default();
    };
    let active = view
        .steps
        .iter()
        .enumerate()
        .find(|(_, step)| step.state == StepState::Active);
    match active {
        Some((index, step)) => Line::from(vec![
            Span::styled(
                format!(
                    " step {} of {}: {} ",
                    index + 1,
                    view.steps.len(),
                    step.title
                ),
                theme::BOLD,
            ),
            Span::raw(format!(" {}", step.line)),
        ]),
        None => Line::styled(
            if view.report.is_empty() {
                " no step is active"
            } else {
                " all steps are over: the verdict is on the steps screen"
            },
            theme::DIM,
        ),
    }
}

/// One line that still names what matters.
fn too_small(model: &Model, area: Rect, buffer: &mut ratatui::buffer::Buffer) {
    let text = if model.snapshot.trip.is_some() {
        "TRIP! too small"
    } else {
        "too small"
    };
    Line::styled(
        format!("{text}: {}x{}, Space = STOP", area.width, area.height),
        theme::ALARM,
    )
    .render(area, buffer);
}
