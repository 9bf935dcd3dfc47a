//! The whole frame of a run as a function of the model: bars, banner, pages, notices, keys.

use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, BorderType, Clear, Paragraph, Widget, Wrap};

use super::model::{Model, Page};
use super::parameters::{LINK_HEIGHT, link_panel, parameters, table};
use super::scope::scope;
use crate::bench::{Level, Notice, Phase, Snapshot};
use crate::text::lines::wrapped;
use crate::tui::frame::{bar_spans, help, hints, is_too_small};
use crate::tui::keys::On;
use crate::tui::theme;
use crate::workflow::{Progress, StepState};

const STOP: &str = " Space = STOP ";
/// Longest bar of the progress.
const LONGEST: usize = 40;
/// Below this there is the scope alone; the parameters have their own page.
const WIDTH_FOR_TWO: u16 = 72;
const HEIGHT_FOR_TWO: u16 = 15;
/// Width of the right side.
const NARROW: u16 = 33;
const WIDE: u16 = 48;

const MEANING: [&str; 5] = [
    "The model runs free under the applied voltage: where it leaves the measurement, it misses something.",
    "A bar is a parameter's standard deviation, 100 % to 0.1 % of its value; it shrinks as the data come in.",
    "searching: still moving. settled: narrow and steady. not observable: these data do not carry it.",
    "lost: requests without a valid reply. late: how long after its deadline a cycle began. missed: cycles left out.",
    "The program's stop is best effort; the drive's watchdog and an emergency stop are behind it.",
];

pub(super) fn view(model: &Model, frame: &mut Frame<'_>) {
    let area = frame.area();
    let buffer = frame.buffer_mut();
    let tripped = model.snapshot.trip.is_some();
    let word = if tripped {
        "TRIP! too small"
    } else {
        "too small"
    };
    if is_too_small(word, "Space = STOP", theme::ALARM, area, buffer) {
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
    if let Some(workflow) = model.workflow.as_ref().filter(|_| step_rows > 0) {
        step_line(workflow).render(step, buffer);
    }
    if let Some(banner) = banner {
        banner.render(box_area, buffer);
    }
    match model.page {
        Page::Live => live_page(model, body, buffer),
        Page::Parameters => parameters_page(model, body, buffer),
        Page::Steps => steps_page(model, body, buffer),
    }
    let next = format!("Tab {}", model.neighbour(1).name());
    let next = next.as_str();
    let keys: &[&str] = if model.waits_for_start() {
        &["s start", "Space stop", next]
    } else if model.has_report() {
        &["d diagnosis by hand", next, "Up Down scroll"]
    } else if model.is_finished() {
        &[next, "f freeze", "z zoom"]
    } else {
        &["Space stop", next, "f freeze", "z zoom", "m mark"]
    };
    hints(
        model.message.as_deref(),
        keys,
        "? help  q quit",
        bottom,
        buffer,
    );
    if let Some(row) = model.help {
        let under_top = Rect {
            y: area.y + 1,
            height: area.height - 1,
            ..area
        };
        help(On::Live, &MEANING, row, under_top, buffer);
    }
}

/// What one must always see: software or copper, phase, link, and the key that stops. What has no room is left out from
/// the right, the stop key never.
fn top_bar(snapshot: &Snapshot, area: Rect, buffer: &mut Buffer) {
    let stop_width = (STOP.len() as u16).min(area.width);
    let room = usize::from(area.width - stop_width);
    let mut spans: Vec<Span<'static>> = Vec::new();
    let mut used = 0;
    for span in items(snapshot).into_iter().filter(|span| span.width() > 0) {
        let separator = usize::from(spans.len() > 1) * 3;
        used += span.width() + separator;
        if used > room {
            break;
        }
        if separator > 0 {
            spans.push(Span::styled(" | ", theme::DIM));
        }
        spans.push(span);
    }
    Line::from(spans).render(area, buffer);
    let stop = Rect {
        x: area.right() - stop_width,
        width: stop_width,
        ..area
    };
    Line::styled(STOP, theme::ALARM).render(stop, buffer);
}

fn items(snapshot: &Snapshot) -> Vec<Span<'static>> {
    let (timing, link) = (&snapshot.timing, &snapshot.link_statistics);
    let (phase, phase_style) = match snapshot.phase {
        None => ("STARTING".to_owned(), theme::DIM),
        Some(phase) => (phase.name().to_uppercase(), phase_style(phase)),
    };
    // Before anything has answered, neither word would be true.
    let (target, target_style) = if snapshot.phase.is_none() && snapshot.link.is_empty() {
        ("NO DRIVE YET", theme::BOLD)
    } else {
        (snapshot.target.name(), theme::target(snapshot.target))
    };
    let lost = link.sent.saturating_sub(link.ok);
    let careful = |is: bool| if is { theme::CAREFUL } else { theme::PLAIN };
    let (achieved_hz, asked_hz) = (timing.rate_achieved_hz, timing.rate_asked_hz);
    let drive = snapshot.drive_state.map_or("-", |state| state.name());
    vec![
        Span::styled(format!(" {target} "), target_style),
        Span::styled(format!(" {phase}"), phase_style),
        Span::raw(format!("drive {drive}")),
        Span::styled(
            format!("{achieved_hz:.0}/{asked_hz:.0} Hz"),
            careful(achieved_hz / asked_hz < 0.95),
        ),
        Span::styled(format!("lost {lost}"), careful(lost > 0)),
        Span::raw(snapshot.link.clone()),
        Span::styled(snapshot.name.clone(), theme::DIM),
    ]
}

fn phase_style(phase: Phase) -> Style {
    match phase {
        Phase::Tripped | Phase::LinkLost => theme::ALARM,
        phase if phase.is_recorded() => theme::CAREFUL.patch(theme::BOLD),
        Phase::Safe | Phase::Done | Phase::Stopped => theme::GOOD,
        _ => theme::DIM,
    }
}

/// How far the run is: a bar, the seconds, the segment.
fn progress_bar(snapshot: &Snapshot, area: Rect, buffer: &mut Buffer) {
    let (elapsed_s, total_s) = (snapshot.elapsed_s, snapshot.total_s);
    let share = if total_s > 0.0 {
        elapsed_s / total_s
    } else {
        0.0
    };
    let segment = snapshot.segment.as_deref().unwrap_or("no segment yet");
    let mut line = Line::raw(" ");
    line.extend(bar_spans(
        share,
        (usize::from(area.width) / 3).min(LONGEST),
        theme::GOOD,
    ));
    line.push_span(format!(" {elapsed_s:.1} / {total_s:.1} s  "));
    line.push_span(Span::styled(segment, theme::BOLD));
    line.render(area, buffer);
}

/// The step of the workflow that is under way.
fn step_line(workflow: &Progress) -> Line<'static> {
    let steps = &workflow.steps;
    let active = steps
        .iter()
        .position(|step| step.state == StepState::Active);
    let Some(index) = active else {
        let text = if workflow.report.is_empty() {
            " no step is active"
        } else {
            " all steps are over: the verdict is on the steps screen"
        };
        return Line::styled(text, theme::DIM);
    };
    let step = &steps[index];
    let head = format!(" step {} of {}: {} ", index + 1, steps.len(), step.title);
    Line::from(vec![
        Span::styled(head, theme::BOLD),
        Span::raw(format!(" {}", step.line)),
    ])
}

/// The newest sentences of the bench, the newest at the bottom.
fn notices(notices: &[Notice], area: Rect, buffer: &mut Buffer) {
    let newest = &notices[notices.len().saturating_sub(usize::from(area.height))..];
    for (notice, row) in newest.iter().zip(area.rows()) {
        let word = match notice.level {
            Level::Info => "note",
            Level::Warning => "WARNING",
            Level::Error => "ERROR",
        };
        let text = format!(" {word}: {}", notice.text);
        Line::styled(text, theme::level(notice.level)).render(row, buffer);
    }
}

/// The scope, and beside it parameters and link where there is room.
fn live_page(model: &Model, area: Rect, buffer: &mut Buffer) {
    let snapshot = model.viewed();
    let frozen = model.frozen.is_some();
    let notice_rows = match area.height {
        0..=5 => 0,
        6..=14 => 1,
        15..=29 => 2,
        _ => 4,
    };
    let [body, bottom] =
        Layout::vertical([Constraint::Fill(1), Constraint::Length(notice_rows)]).areas(area);
    notices(&model.snapshot.notices, bottom, buffer);
    if area.width < WIDTH_FOR_TWO || body.height < HEIGHT_FOR_TWO {
        scope(snapshot, model.window_s(), frozen, body, buffer);
        return;
    }
    let side = if area.width >= 110 { WIDE } else { NARROW };
    let [left, right] =
        Layout::horizontal([Constraint::Fill(1), Constraint::Length(side)]).areas(body);
    scope(snapshot, model.window_s(), frozen, left, buffer);
    let count = (snapshot.estimates.len() as u16).min(300);
    let rows_of = |each: u16| count.saturating_mul(each).max(5) + 2;
    let has_room = |rows: &u16| rows + LINK_HEIGHT <= body.height;
    let wanted = Some(rows_of(3)).filter(has_room).unwrap_or(rows_of(2));
    let below = body.height.saturating_sub(wanted).clamp(4, LINK_HEIGHT);
    let [top, link] =
        Layout::vertical([Constraint::Fill(1), Constraint::Length(below)]).areas(right);
    parameters(snapshot, top, buffer);
    link_panel(&model.snapshot, link, buffer);
}

/// Parameters with their reasons in full, and the link.
fn parameters_page(model: &Model, area: Rect, buffer: &mut Buffer) {
    let (link_rows, notice_rows) = if area.height >= 18 {
        (LINK_HEIGHT, 2)
    } else {
        (0, 0)
    };
    let [top, link, bottom] = Layout::vertical([
        Constraint::Fill(1),
        Constraint::Length(link_rows),
        Constraint::Length(notice_rows),
    ])
    .areas(area);
    table(model.viewed(), top, buffer);
    if link_rows > 0 {
        link_panel(&model.snapshot, link, buffer);
    }
    notices(&model.snapshot.notices, bottom, buffer);
}

/// The steps of a workflow, then what it found; the last page stays full.
fn steps_page(model: &Model, area: Rect, buffer: &mut Buffer) {
    let Some(workflow) = &model.workflow else {
        return;
    };
    let lines = step_lines(workflow, usize::from(area.width));
    let hidden = lines.len().saturating_sub(usize::from(area.height));
    let shown = lines.into_iter().skip(model.scroll.min(hidden));
    Paragraph::new(shown.collect::<Vec<_>>()).render(area, buffer);
}

fn step_lines(workflow: &Progress, width: usize) -> Vec<Line<'static>> {
    let widest = workflow.steps.iter().map(|step| step.title.chars().count());
    let title_width = widest.max().unwrap_or(0).min(width / 3);
    let steps = workflow.steps.iter().map(|step| {
        let (mark, name, style) = match step.state {
            StepState::Waiting => ("·", "waiting", theme::DIM),
            StepState::Active => ("▶", "active", theme::CAREFUL),
            StepState::Done => ("✓", "done", theme::GOOD),
            StepState::Failed => ("✗", "failed", theme::BAD),
        };
        Line::from(vec![
            Span::styled(format!(" {mark} {name:<8}"), style),
            Span::styled(format!("{:<title_width$}  ", step.title), theme::BOLD),
            Span::raw(step.line.clone()),
        ])
    });
    let mut lines: Vec<Line<'static>> = steps.collect();
    if !workflow.report.is_empty() {
        lines.push(Line::default());
    }
    for text in &workflow.report {
        // Sentences go on in the next line; the row of a table is cut, so that columns stay columns.
        let rows = if text.starts_with('|') {
            vec![text.clone()]
        } else {
            wrapped(text, width.saturating_sub(2))
        };
        lines.extend(rows.into_iter().map(|row| Line::raw(format!(" {row}"))));
    }
    lines
}

/// The box that cannot be overlooked: a trip, the end, or a question.
struct Banner {
    title: String,
    text: String,
    style: Style,
}

impl Banner {
    /// The most urgent thing there is to say, if any.
    fn of(model: &Model) -> Option<Self> {
        let snapshot = &model.snapshot;
        let (is_over, is_lost) = (model.is_finished(), snapshot.phase == Some(Phase::LinkLost));
        let end = if is_over {
            " Output off, q = quit."
        } else {
            ""
        };
        let (title, text, style) = if model.confirm_start {
            let text = "A real motor is about to turn. Shaft clear? y = start, any other key = no";
            ("HARDWARE", text.to_owned(), theme::ALARM)
        } else if let Some(text) = &snapshot.reopening {
            let end = if is_over { " q = quit." } else { "" };
            let is_safe = snapshot.phase == Some(Phase::Safe);
            let title = if is_safe { "SAFE" } else { "LINK LOST" };
            let style = if is_safe {
                theme::CAREFUL
            } else {
                theme::ALARM
            };
            (title, format!("{text}.{end}"), style)
        } else if let Some(trip) = &snapshot.trip {
            (
                "SAFETY TRIP",
                format!("{}.{end}", trip.reason),
                theme::ALARM,
            )
        } else if is_lost {
            let mut last = snapshot.notices.iter().rev();
            let error = last.find(|notice| notice.level == Level::Error);
            let reason = error.map(|notice| notice.text.as_str());
            let reason = reason.unwrap_or("the drive does not answer any more");
            ("LINK LOST", format!("{reason}.{end}"), theme::ALARM)
        } else {
            let (title, text, style) = match snapshot.outcome.filter(|_| is_over)? {
                "done" => ("DONE", "The run went to its end.", theme::GOOD),
                "stopped" => ("STOPPED", "The run was stopped.", theme::CAREFUL),
                "interrupted" => ("INTERRUPTED", "The run was interrupted.", theme::CAREFUL),
                other => (other, "The run has ended.", theme::CAREFUL),
            };
            (title, format!("{text}{end}"), style)
        };
        let title = format!(" {title} ");
        Some(Self { title, text, style })
    }

    /// Rows that it takes, with its frame, in a screen of this width.
    fn height(&self, width: u16) -> u16 {
        let inner = usize::from(width.saturating_sub(2)).max(1);
        let (mut rows, mut used) = (1_usize, 1);
        for word in self.text.split(' ') {
            let length = word.chars().count();
            if used + length > inner {
                rows += 1;
                used = 0;
            }
            used += length + 1;
        }
        2 + (rows.clamp(1, 4) as u16)
    }

    fn render(&self, area: Rect, buffer: &mut Buffer) {
        Clear.render(area, buffer);
        let block = Block::bordered()
            .border_type(BorderType::Double)
            .title(self.title.as_str())
            .style(self.style);
        Paragraph::new(format!(" {}", self.text))
            .wrap(Wrap { trim: false })
            .block(block)
            .render(area, buffer);
    }
}
