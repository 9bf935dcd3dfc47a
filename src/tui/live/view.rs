//! The whole frame of a run as a function of the model: bars, banner, pages, notices, keys.

use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, BorderType, Clear, Padding, Paragraph, Widget, Wrap};

use super::model::{Model, Page};
use super::scope::scope;
use crate::tui::frame::{
    bar_spans, document_lines, hint_rows, hints, is_too_small, labelled, row, rows, scrolling, text,
};
use crate::tui::keys::On;
use crate::tui::theme;
use crate::workflow::{Progress, Step, StepState, StepView};
use drivebench_bench::{Level, Notice, Phase, Snapshot};
use drivebench_model::sample::{DriveState, ParameterEstimate, Verdict};
use drivebench_model::text::lines::{cut, wrapped};
use drivebench_model::text::number::{fixed, shortest};

const STOP: &str = " Space = STOP ";

const MEANING: [&str; 5] = [
    "The model runs free under the applied voltage: where it departs from the measurement, an effect is missing.",
    "A bar is a parameter's standard deviation, 100 % to 0.1 % of its value; it shrinks as the data come in.",
    "searching: still changing. settled: precise and steady. not observable: these data do not determine it.",
    "lost: requests without a valid reply. late: how long after its deadline a cycle began. missed: cycles left out.",
    "The program's stop is best effort; the drive's watchdog and an emergency stop are the protection.",
];

pub(super) fn view(model: &Model, frame: &mut Frame<'_>) {
    let area = frame.area();
    let buffer = frame.buffer_mut();
    let label = if model.snapshot.trip.is_some() { "TRIP! too small" } else { "too small" };
    let (stop, style) = stop_label(model);
    if is_too_small(label, stop.trim(), style, area, buffer) {
        return;
    }
    let banner = Banner::of(model);
    let step_rows = u16::from(model.workflow.is_some() && area.height >= 12);
    let most_rows = (area.height / 8).clamp(1, 3);
    let message_rows = hint_rows(model.message.as_deref(), area.width, most_rows.into());
    let banner_rows = banner.as_ref().map_or(0, |banner| banner.height(area.width));
    let [top, progress, step, box_area, body, bottom] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(1),
        Constraint::Length(step_rows),
        Constraint::Length(banner_rows.min(area.height - 3)),
        Constraint::Fill(1),
        Constraint::Length(message_rows),
    ])
    .areas(area);
    top_bar(model, top, buffer);
    progress_bar(&model.snapshot, progress, buffer);
    if let Some(workflow) = model.workflow.as_ref().filter(|_| step_rows > 0) {
        row(&step_line(workflow), step, buffer);
    }
    if let Some(banner) = banner {
        banner.render(box_area, buffer);
    }
    match model.page {
        Page::Live => live_page(model, body, buffer),
        Page::Parameters => parameters_page(model, body, buffer),
        Page::Steps => steps_page(model, body, buffer),
    }
    let quit = format!("? help  q {}", model.quit_label());
    let next = &format!("Tab {}", model.neighbour(1).name())[..];
    let offers = offers(model, next);
    let is_faulted = model.snapshot.drive_state == Some(DriveState::Fault);
    let keys: &[&str] = if is_faulted && !model.is_finished() {
        &["k acknowledge the fault", "Space stop", next]
    } else if model.waits_for_start() {
        &["s start", "Space stop", next]
    } else if model.can_diagnose() {
        &offers
    } else if model.is_finished() {
        &[next, "f freeze", "z zoom"]
    } else {
        &["Space stop", next, "f freeze", "z zoom", "m mark"]
    };
    hints(model.message.as_deref(), keys, &quit, bottom, buffer);
    let under_top = Rect { y: area.y + 1, height: area.height - 1, ..area };
    model.help.draw(On::Live, &MEANING, under_top, buffer);
}

/// Always visible: software or hardware, phase, link, and the stop key. Items that do not fit are left out from the right,
/// the stop key never.
fn top_bar(model: &Model, area: Rect, buffer: &mut Buffer) {
    let snapshot = &model.snapshot;
    let (stop_label, stop_style) = stop_label(model);
    let stop_width = (stop_label.len() as u16).min(area.width);
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
    let stop = Rect { x: area.right() - stop_width, width: stop_width, ..area };
    Line::styled(stop_label, stop_style).render(stop, buffer);
}

/// The key that stops, for as long as there is anything to stop.
fn stop_label(model: &Model) -> (&'static str, Style) {
    match (model.is_finished(), &model.snapshot.stop_error) {
        (false, _) => (STOP, theme::ALARM),
        (true, Some(_)) => (" Stop NOT confirmed ", theme::ALARM),
        (true, None) => (" output off ", theme::GOOD),
    }
}

fn items(snapshot: &Snapshot) -> Vec<Span<'static>> {
    let (timing, link) = (&snapshot.timing, &snapshot.link_statistics);
    let (phase, phase_style) = match snapshot.phase {
        None => ("STARTING".to_owned(), theme::DIM),
        Some(phase) => (phase.name().to_uppercase(), phase_style(phase)),
    };
    // Before a drive has answered, the target is not known.
    let (target, target_style) = if snapshot.phase.is_none() && snapshot.link.is_empty() {
        ("NO DRIVE YET", theme::BOLD)
    } else {
        (snapshot.target.name(), theme::target(snapshot.target))
    };
    let lost = link.sent.saturating_sub(link.ok);
    let careful = |is_poor: bool| if is_poor { theme::CAREFUL } else { theme::PLAIN };
    let (achieved_hz, requested_hz) = (timing.rate_achieved_hz, timing.rate_asked_hz);
    let drive = snapshot.drive_state.map_or("-", |state| state.name());
    vec![
        Span::styled(format!(" {target} "), target_style),
        Span::styled(format!(" {phase}"), phase_style),
        Span::raw(format!("drive {drive}")),
        Span::styled(
            format!("{achieved_hz:.0}/{requested_hz:.0} Hz"),
            careful(achieved_hz / requested_hz < 0.95),
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

fn progress_bar(snapshot: &Snapshot, area: Rect, buffer: &mut Buffer) {
    let (elapsed_s, total_s) = (snapshot.elapsed_s, snapshot.total_s);
    let share = if total_s > 0.0 { elapsed_s / total_s } else { 0.0 };
    let segment = snapshot.segment.as_deref().unwrap_or("no segment yet");
    let mut line = Line::raw(" ");
    line.extend(bar_spans(share, (usize::from(area.width) / 3).min(40), theme::GOOD));
    line.push_span(format!(" {elapsed_s:.1} / {total_s:.1} s  "));
    line.push_span(Span::styled(segment, theme::BOLD));
    row(&line, area, buffer);
}

fn step_line(workflow: &Progress) -> Line<'static> {
    let steps = &workflow.steps;
    let active = steps.iter().position(|step| step.state == StepState::Active);
    let Some(index) = active else {
        let text = if workflow.report.is_none() {
            " no step is active"
        } else {
            " all steps are over: the verdict is on the steps screen"
        };
        return Line::styled(text, theme::DIM);
    };
    let step = &steps[index];
    let (number, title) = (index + 1, step.step.title());
    let head = format!(" step {number} of {}: {title} ", steps.len());
    Line::from(vec![Span::styled(head, theme::BOLD), Span::raw(format!(" {}", step.line))])
}

/// The newest notices of the bench, the last at the bottom.
fn notices(notices: &[Notice], area: Rect, buffer: &mut Buffer) {
    let newest = &notices[notices.len().saturating_sub(usize::from(area.height))..];
    for (notice, place) in newest.iter().zip(area.rows()) {
        let label = match notice.level {
            Level::Info => "note",
            Level::Warning => "WARNING",
            Level::Error => "ERROR",
        };
        let text = format!(" {label}: {}", notice.text);
        row(&Line::styled(text, theme::level(notice.level)), place, buffer);
    }
}

fn live_page(model: &Model, area: Rect, buffer: &mut Buffer) {
    let snapshot = model.viewed();
    let halted = match (model.frozen.is_some(), model.is_finished()) {
        (true, _) => Some("FROZEN, f = continue"),
        (false, true) => Some("ENDED"),
        (false, false) => None,
    };
    let notice_rows = match area.height {
        0..=5 => 0,
        6..=14 => 1,
        15..=29 => 2,
        _ => 4,
    };
    // A provisional ranking is not a result of the run.
    let is_recorded = !model.is_finished() && model.snapshot.phase.is_some_and(Phase::is_recorded);
    let [body, ranking, bottom] = Layout::vertical([
        Constraint::Fill(1),
        Constraint::Length(u16::from(is_recorded && area.height >= 9)),
        Constraint::Length(notice_rows),
    ])
    .areas(area);
    if model.ranking.seconds > 0.0 {
        row(&Line::styled(format!(" {}", model.ranking.line()), theme::CAREFUL), ranking, buffer);
    }
    notices(&model.snapshot.notices, bottom, buffer);
    if area.width < 72 || body.height < 15 {
        scope(snapshot, model.window_s(), halted, body, buffer);
        return;
    }
    let side = if area.width >= 110 { 48 } else { 33 };
    let [left, right] =
        Layout::horizontal([Constraint::Fill(1), Constraint::Length(side)]).areas(body);
    scope(snapshot, model.window_s(), halted, left, buffer);
    let count = (snapshot.estimates.len() as u16).min(300);
    let rows_of = |each: u16| count.saturating_mul(each).max(5) + 2;
    let has_room = |rows: &u16| rows + LINK_HEIGHT <= body.height;
    let wanted = Some(rows_of(3)).filter(has_room).unwrap_or(rows_of(2));
    let below = body.height.saturating_sub(wanted).clamp(4, LINK_HEIGHT);
    let [top, link] =
        Layout::vertical([Constraint::Fill(1), Constraint::Length(below)]).areas(right);
    parameters(model, top, buffer);
    link_panel(&model.snapshot, link, buffer);
}

fn parameters_page(model: &Model, area: Rect, buffer: &mut Buffer) {
    let (link_rows, notice_rows) = if area.height >= 18 { (LINK_HEIGHT, 2) } else { (0, 0) };
    let [top, link, bottom] = Layout::vertical([
        Constraint::Fill(1),
        Constraint::Length(link_rows),
        Constraint::Length(notice_rows),
    ])
    .areas(area);
    table(model, top, buffer);
    if link_rows > 0 {
        link_panel(&model.snapshot, link, buffer);
    }
    notices(&model.snapshot.notices, bottom, buffer);
}

/// What a workflow found, where it is over, and its steps; the last page stays full.
fn steps_page(model: &Model, area: Rect, buffer: &mut Buffer) {
    let Some(workflow) = &model.workflow else {
        return;
    };
    let lines = step_lines(model, workflow, usize::from(area.width));
    model.hidden.set(scrolling(&lines, model.scroll, area, buffer));
}

/// What a step needs, what it makes possible and which command does the same.
fn explained(step: &StepView, indent: usize, width: usize) -> Vec<Line<'static>> {
    let own = step.step;
    let key = match own {
        Step::Experiment => "x runs it",
        Step::SpeedLoop => "l runs it",
        _ => "",
    };
    let command = step.command.as_deref().unwrap_or("part of every run");
    let facts =
        [("press", key), ("needs", own.needs()), ("unlocks", own.unlocks()), ("command", command)];
    let facts = facts.into_iter().filter(|(_, text)| !text.is_empty());
    let room = width.saturating_sub(indent + 9).max(10);
    let lines = facts.flat_map(|(label, text)| {
        labelled(label, text, room).map(move |(label, text)| {
            Line::styled(format!("{:indent$}{label:<8} {text}", ""), theme::DIM)
        })
    });
    lines.collect()
}

/// The keys at the end of a commissioning: what can follow.
fn offers<'a>(model: &Model, next: &'a str) -> Vec<&'a str> {
    let offered = |step| {
        let workflow = model.workflow.as_ref();
        workflow.is_some_and(|workflow| workflow.is_offered(step).is_ok())
    };
    let mut keys = vec!["d diagnosis by hand", "v traces"];
    keys.extend(offered(Step::Experiment).then_some("x next experiment"));
    keys.extend(offered(Step::SpeedLoop).then_some("l speed loop"));
    keys.push(next);
    if model.page == Page::Steps {
        keys.extend(["Enter explain", "Up Down scroll"]);
    }
    keys
}

fn step_lines(model: &Model, workflow: &Progress, width: usize) -> Vec<Line<'static>> {
    let steps = workflow.steps.iter();
    let widest = steps.map(|step| step.step.title().chars().count());
    let title_width = widest.max().unwrap_or(0).min(width / 3);
    let steps = workflow.steps.iter().flat_map(|step| {
        let (mark, name, style) = match step.state {
            StepState::Waiting => ("·", "waiting", theme::DIM),
            StepState::Active => ("▶", "active", theme::CAREFUL),
            StepState::Done => ("✓", "done", theme::GOOD),
            StepState::Failed => ("✗", "failed", theme::BAD),
            StepState::Offered => ("+", "possible", theme::CAREFUL),
            StepState::Withheld => ("-", "none", theme::DIM),
        };
        let title = step.step.title();
        let mut head = vec![
            Span::styled(format!(" {mark} {name:<8} "), style),
            Span::styled(format!("{title:<title_width$}  "), theme::BOLD),
        ];
        let is_narrow = width < 60;
        let head_width: usize = head.iter().map(Span::width).sum();
        // In a narrow list the figure of a step is below its title.
        let indent = if is_narrow { 4 } else { head_width };
        let room = width.saturating_sub(indent).max(10);
        let line = Some(&step.line).filter(|text| !text.is_empty());
        let mut lines = line.map_or_else(Vec::new, |text| wrapped(text, room)).into_iter();
        if !is_narrow {
            head.extend(lines.next().map(Span::raw));
        }
        let below = lines.map(move |text| Line::raw(format!("{:indent$}{text}", "")));
        let is_open = matches!(step.state, StepState::Active | StepState::Offered);
        let more = (is_open || model.explains).then(|| explained(step, indent, width));
        let head = std::iter::once(Line::from(head)).chain(below);
        head.chain(more.into_iter().flatten()).collect::<Vec<_>>()
    });
    let mut lines = Vec::new();
    if let Some(document) = &workflow.report {
        lines.extend(document_lines(document.rows(width.saturating_sub(2))));
        // The result, then the steps.
        lines.push(Line::default());
    }
    lines.extend(steps);
    lines
}

/// The box that cannot be overlooked: a trip, the end, or a question.
struct Banner {
    title: String,
    text: String,
    style: Style,
}

impl Banner {
    /// The most urgent message, if any.
    fn of(model: &Model) -> Option<Self> {
        let snapshot = &model.snapshot;
        let (is_over, is_lost) = (model.is_finished(), snapshot.phase == Some(Phase::LinkLost));
        let quit = model.quit_label();
        let end = match (is_over, &snapshot.stop_error) {
            (false, _) => String::new(),
            (true, None) if model.can_diagnose() && model.followed_by.is_none() => {
                format!(" Output off. d = diagnosis by hand, q = {quit}.")
            }
            (true, None) => format!(" Output off, q = {quit}."),
            (true, Some(_)) => {
                format!(" Stop NOT confirmed: see that the shaft stands still. q = {quit}.")
            }
        };
        let stop = snapshot.stop.as_ref().filter(|_| is_over);
        let at = stop.and_then(|stop| stop.at_s);
        let at = at.map_or_else(String::new, |at_s| format!(" at {at_s:.2} s"));
        let confirmed = stop.and_then(|stop| stop.confirmed_after_ms);
        let confirmed =
            confirmed.map_or_else(String::new, |ms| format!("; zero confirmed after {ms:.0} ms"));
        // The reason, and when and how the output was switched off.
        let stopped = |reason: &str| {
            let head = if at.is_empty() { String::new() } else { format!("stopped{at}: ") };
            format!("{head}{reason}{confirmed}.{end}")
        };
        let (title, text, style) = if model.confirm_start {
            let text = "A real motor is about to turn. Shaft clear? y = start, any other key = no";
            ("HARDWARE", text.to_owned(), theme::ALARM)
        } else if let Some(text) = &snapshot.reopening {
            let end = if is_over { format!(" q = {quit}.") } else { String::new() };
            let is_safe = snapshot.phase == Some(Phase::Safe);
            let title = if is_safe { "SAFE" } else { "LINK LOST" };
            (title, format!("{text}.{end}"), if is_safe { theme::CAREFUL } else { theme::ALARM })
        } else if let Some(trip) = &snapshot.trip {
            ("SAFETY TRIP", stopped(&trip.reason), theme::ALARM)
        } else if is_lost {
            let error = snapshot.notices.iter().rev().find(|notice| notice.level == Level::Error);
            let reason = error.map(|notice| notice.text.as_str());
            let reason = reason.unwrap_or("the drive does not answer any more");
            ("LINK LOST", stopped(reason), theme::ALARM)
        } else {
            let (title, text, style) = match snapshot.outcome.filter(|_| is_over)? {
                // The page has the result of the commissioning, its top bar the output.
                "done" if model.shows_report() && snapshot.stop_error.is_none() => return None,
                "done" => ("DONE", "The run was completed", theme::GOOD),
                "stopped" => ("STOPPED", "The run was stopped", theme::CAREFUL),
                "interrupted" => ("INTERRUPTED", "The run was interrupted", theme::CAREFUL),
                "not_started" => ("NOT STARTED", "The run was not started", theme::CAREFUL),
                other => (other, "The run has ended", theme::CAREFUL),
            };
            let how = match snapshot.outcome {
                Some("stopped" | "interrupted") => format!("{at}{confirmed}"),
                _ => String::new(),
            };
            let style = if snapshot.stop_error.is_none() { style } else { theme::ALARM };
            (title, format!("{text}{how}.{end}"), style)
        };
        Some(Self { title: format!(" {title} "), text, style })
    }

    /// Rows that it takes, with its frame, in a screen of this width.
    fn height(&self, width: u16) -> u16 {
        let rows = wrapped(&self.text, usize::from(width.saturating_sub(4)).max(1)).len();
        2 + (rows.clamp(1, 6) as u16)
    }

    fn render(&self, area: Rect, buffer: &mut Buffer) {
        Clear.render(area, buffer);
        let block = Block::bordered()
            .border_type(BorderType::Double)
            .title(self.title.as_str())
            .padding(Padding::horizontal(1))
            .style(self.style);
        Paragraph::new(self.text.as_str())
            .wrap(Wrap { trim: false })
            .block(block)
            .render(area, buffer);
    }
}

/// From this width on names are written out.
const WIDE_PANEL: u16 = 44;
/// Longest bar, and the room for its percentage, in a panel.
const BAR: usize = 20;
const PERCENT: usize = 7;

/// Blocks of one cell, from nothing to all.
const BLOCKS: [&str; 8] = ["▁", "▂", "▃", "▄", "▅", "▆", "▇", "█"];

/// Panel with a frame; three rows for each parameter, two or one where there is no room.
fn parameters(model: &Model, area: Rect, buffer: &mut Buffer) {
    let (estimates, excitation) = (model.parameters(), &model.viewed().excitation);
    let inner_height = usize::from(area.height.saturating_sub(2));
    let three_rows = estimates.len() * 3 <= inner_height && !excitation.is_empty();
    let two_rows = estimates.len() * 2 <= inner_height;
    let block = Block::bordered().title(match (area.width >= WIDE_PANEL, three_rows) {
        (true, true) => " parameters  (bars: uncertainty, excitation) ",
        (true, false) => " parameters (bar: uncertainty, 100 to 0.1 %) ",
        (false, false) if !excitation.is_empty() => " parameters (▁ to █: excited) ",
        (false, _) => " parameters ",
    });
    let block = match frozen_text(model, area.width > WIDE_PANEL) {
        Some(text) => block.title_bottom(Line::styled(text, theme::CAREFUL)),
        None => block,
    };
    let inner = block.inner(area);
    block.render(area, buffer);
    if estimates.is_empty() {
        row(&Line::styled("no estimates yet", theme::DIM), inner, buffer);
        return;
    }
    let mut lines: Vec<Line<'static>> = Vec::new();
    for estimate in &estimates {
        let share = excitation.get(estimate.key.as_str()).copied();
        let value = value_line(estimate, inner.width);
        if three_rows {
            lines.push(value);
            lines.push(verdict_line(estimate, inner.width));
            lines.push(excitation_line(share, inner.width));
        } else if two_rows {
            lines.push(with_block(value, share, inner.width));
            lines.push(verdict_line(estimate, inner.width));
        } else {
            lines.push(with_block(short_line(estimate), share, inner.width));
        }
    }
    rows(&lines, inner, buffer);
}

/// That the estimates are frozen, and for how long.
fn frozen_text(model: &Model, is_wide: bool) -> Option<String> {
    let frozen = model.viewed().frozen;
    frozen.since_s?;
    let (seconds, rows) = (fixed(frozen.seconds, 1), frozen.rows);
    Some(if is_wide {
        format!(" frozen: the drive limits, {seconds} s, {rows} rows ")
    } else {
        format!(" frozen: drive limits {seconds} s ")
    })
}

fn table(model: &Model, area: Rect, buffer: &mut Buffer) {
    let mut lines = Vec::new();
    for estimate in &model.parameters() {
        let share = model.viewed().excitation.get(estimate.key.as_str()).copied();
        lines.push(with_bar(value_line(estimate, area.width), share, area.width));
        lines.push(match &estimate.reason {
            None => verdict_line(estimate, area.width),
            Some(reason) => Line::from(vec![
                Span::raw("   "),
                verdict_span(estimate),
                Span::raw(format!(": {reason}")),
            ]),
        });
    }
    if lines.is_empty() {
        lines.push(Line::styled("no estimates yet", theme::DIM));
    }
    text(lines, area, buffer);
}

fn excitation_style(share: f64) -> Style {
    if share >= 0.7 { theme::GOOD } else { theme::CAREFUL }
}

/// One block at the right edge; left out where the text needs the room.
fn with_block(mut line: Line<'static>, share: Option<f64>, width: u16) -> Line<'static> {
    let gap = usize::from(width).checked_sub(line.width() + 1);
    if let (Some(share), Some(gap)) = (share, gap) {
        let at = (share.clamp(0.0, 1.0) * (BLOCKS.len() - 1) as f64).round() as usize;
        line.push_span(" ".repeat(gap));
        line.push_span(Span::styled(BLOCKS[at], excitation_style(share)));
    }
    line
}

/// A bar with its percentage at the right edge, or one block.
fn with_bar(mut line: Line<'static>, share: Option<f64>, width: u16) -> Line<'static> {
    const LENGTH: usize = 10;
    // `excited `, the bar, ` 100 %`.
    const ROOM: usize = 8 + LENGTH + 6;
    let gap = usize::from(width).saturating_sub(line.width() + ROOM);
    match share {
        Some(share) if gap > 0 => {
            line.push_span(" ".repeat(gap));
            line.push_span("excited ");
            line.extend(excitation_bar(share, LENGTH));
            line
        }
        _ => with_block(line, share, width),
    }
}

/// The third row: how well the data determine the parameter.
fn excitation_line(share: Option<f64>, width: u16) -> Line<'static> {
    // In one column with the bar of the uncertainty.
    const HEAD: &str = "   excited   ";
    let length = usize::from(width).saturating_sub(HEAD.len() + PERCENT);
    let mut line = Line::raw(HEAD);
    line.extend(share.into_iter().flat_map(|share| excitation_bar(share, length.min(BAR))));
    line
}

fn excitation_bar(share: f64, length: usize) -> [Span<'static>; 3] {
    let share = share.clamp(0.0, 1.0);
    let [full, empty] = bar_spans(share, length, excitation_style(share));
    [full, empty, Span::raw(format!(" {:3.0} %", 100.0 * share))]
}

fn verdict_span(estimate: &ParameterEstimate) -> Span<'static> {
    Span::styled(estimate.verdict.name(), theme::verdict(estimate.verdict))
}

fn value_line(estimate: &ParameterEstimate, width: u16) -> Line<'static> {
    let (symbol, name) = name(&estimate.key);
    let head = match (width + 2 >= WIDE_PANEL, estimate.key.contains('.')) {
        (true, false) => format!("{symbol:<3}{name:<16}"),
        (true, true) => format!("{name:<19}"),
        (false, _) => format!("{symbol:<3}"),
    };
    Line::from(vec![
        Span::styled(head, theme::BOLD),
        Span::raw(estimate.number(1.0)),
        Span::styled(format!(" {}", estimate.unit), theme::DIM),
    ])
}

fn verdict_line(estimate: &ParameterEstimate, width: u16) -> Line<'static> {
    const INDENT: usize = 3;
    let mut verdict = verdict_span(estimate);
    if estimate.reason.is_none() {
        // Bars begin in one column.
        verdict.content = format!("{:<9}", verdict.content).into();
    }
    let room = usize::from(width).saturating_sub(INDENT + verdict.width() + 1);
    let mut line = Line::from(vec![Span::raw(" ".repeat(INDENT)), verdict, Span::raw(" ")]);
    if let Some(reason) = &estimate.reason {
        line.push_span(Span::styled(cut(reason, room), theme::DIM));
    } else if let Some(share) = relative_std(estimate) {
        let length = room.saturating_sub(PERCENT).min(BAR);
        line.extend(bar_spans(uncertainty(share), length, theme::verdict(estimate.verdict)));
        line.push_span(format!(" {}", percent(share)));
    }
    line
}

fn short_line(estimate: &ParameterEstimate) -> Line<'static> {
    Line::from(vec![
        Span::styled(format!("{:<3}", name(&estimate.key).0), theme::BOLD),
        Span::raw(format!("{} {} ", estimate.number(1.0), estimate.unit)),
        verdict_span(estimate),
    ])
}

fn relative_std(estimate: &ParameterEstimate) -> Option<f64> {
    let share = (estimate.std? / estimate.value?).abs();
    (share.is_finite() && estimate.verdict != Verdict::Fixed).then_some(share)
}

/// Length of the bar, 0 to 1, on a logarithmic scale from 0.1 % to 100 %.
fn uncertainty(share: f64) -> f64 {
    ((share / 1e-3).log10() / 3.0).clamp(0.0, 1.0)
}

/// Symbol and name of a parameter by its key; an effect's parameter goes by its own key without the unit.
pub(crate) fn name(key: &str) -> (&str, String) {
    let known = match key {
        "resistance_ohm" => ("R", "resistance"),
        "inductance_h" => ("L", "inductance"),
        "back_emf_v_s_per_rad" => ("Ke", "back-EMF"),
        "torque_n_m_per_a" => ("Kt", "torque constant"),
        "inertia_kg_m2" => ("J", "inertia"),
        "load_torque_n_m" => ("Tl", "load torque"),
        _ => {
            let own = key.rsplit('.').next().unwrap_or(key);
            return (own.split('_').next().unwrap_or(own), own.replace('_', " "));
        }
    };
    (known.0, known.1.to_owned())
}

fn percent(share: f64) -> String {
    match share * 100.0 {
        1000.0.. => ">999 %".to_owned(),
        percent @ 10.0.. => format!("{percent:.0} %"),
        percent @ 0.1.. => format!("{percent:.1} %"),
        _ => "<0.1 %".to_owned(),
    }
}

pub(super) const LINK_HEIGHT: u16 = 7;

pub(super) fn link_panel(snapshot: &Snapshot, area: Rect, buffer: &mut Buffer) {
    let block = Block::bordered().title(" link and record ");
    let inner = block.inner(area);
    block.render(area, buffer);
    let (link, timing) = (&snapshot.link_statistics, &snapshot.timing);
    let mut lines = vec![
        Line::raw(format!("sent {}  ok {}  ", link.sent, link.ok)),
        counts(&[("timeout", link.timeout), ("crc", link.crc), ("stale", link.stale)]),
        counts(&[("mismatch", link.mismatch), ("exception", link.exception), ("io", link.aborted)]),
        Line::raw(format!(
            "late p50 {} ms p99 {} ms",
            shortest(1e3 * timing.lateness_p50_s, 3),
            shortest(1e3 * timing.lateness_p99_s, 3)
        )),
    ];
    lines[0].extend(counts(&[("missed", timing.missed_cycles)]));
    lines.push(match &snapshot.recorder_error {
        Some(error) => Line::styled(format!("NOT RECORDED: {error}"), theme::BAD),
        None => Line::raw(format!("rows {} recorded", snapshot.rows)),
    });
    if let Some(text) = &snapshot.reopening {
        lines.insert(0, Line::styled(text.clone(), theme::CAREFUL));
    } else if inner.height < lines.len() as u16 {
        // What was not recorded matters more than what was late.
        lines.rotate_right(1);
    }
    rows(&lines, inner, buffer);
}

/// Losses by their names, those that there are in colour.
fn counts(losses: &[(&'static str, u64)]) -> Line<'static> {
    let spans = losses.iter().map(|(name, count)| {
        let style = if *count > 0 { theme::CAREFUL } else { theme::PLAIN };
        Span::styled(format!("{name} {count}  "), style)
    });
    spans.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bar_is_logarithmic_from_a_thousandth_to_the_whole() {
        for (share, expected) in
            [(10.0, 1.0), (1.0, 1.0), (0.01, 1.0 / 3.0), (1e-3, 0.0), (0.0, 0.0)]
        {
            assert!((uncertainty(share) - expected).abs() < 1e-12, "{share}");
        }
    }
}
