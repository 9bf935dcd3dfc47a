//! The page of traces as a function of its state: one panel under the other, one time axis below them.

use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Clear, Paragraph, Widget};

use super::{Panel, Shows, TracesPage, first_panels};
use crate::report::plot::axis::Domain;
use crate::tui::frame::{centred, row, titled_with};
use crate::tui::plot::{
    Bounds, LABELS, Stroke, Trace, across, framed, longest_step_s, plot, range, vertical,
};
use crate::tui::theme;
use drivebench_diagnose::{Quantity, RunTraces, SignalTrace};
use drivebench_model::sample::Channel;
use drivebench_model::text::lines::cut;
use drivebench_model::text::number::{MISSING, significant};

/// Standard deviations of the noise that the band holds, and from which on a residual is marked.
const BAND_SIGMAS: f64 = 2.0;
/// The axis of a panel without a value.
const NOTHING: Domain = Domain { from: 0.0, to: 1.0 };

pub(in crate::tui) fn view(page: &TracesPage, area: Rect, buffer: &mut Buffer) {
    let area = area.intersection(buffer.area);
    let Some(run) = page.run() else {
        row(&Line::styled(" no traces yet: the model is being fitted", theme::DIM), area, buffer);
        return;
    };
    let runs = page.traces.as_ref().map_or(1, |traces| traces.runs.len());
    let place = if runs > 1 { format!("run {} of {runs}", page.run + 1) } else { String::new() };
    let title = format!("{}: {}", run.part.name(), run.run);
    let inner = titled_with(&title, &place, area, buffer);
    panels(page, run, inner, buffer);
    if let Some(at) = page.choosing {
        chooser(page, run, at, inner, buffer);
    }
}

/// Measured and model of the first signal alone, as a part of another page.
pub(in crate::tui) fn strip(page: &TracesPage, area: Rect, buffer: &mut Buffer) {
    let area = area.intersection(buffer.area);
    if let Some(run) = page.run() {
        let title = format!("{}: {}", run.part.name(), run.run);
        panels(page, run, titled_with(&title, "v traces", area, buffer), buffer);
    }
}

/// The panels that fit; before a choice no signal without its residual.
fn fitting(page: &TracesPage, height: u16) -> Vec<Panel> {
    let all = page.panels();
    let mut shown = page.chosen.clone().unwrap_or_else(|| first_panels(&all));
    let smallest = if height < 10 { 3 } else { 5 };
    shown.truncate(usize::from((height / smallest).max(1)));
    if page.chosen.is_none()
        && shown.len() > 1
        && let Some((place, Shows::Both)) = shown.last()
        && all.contains(&(*place, Shows::Residual))
    {
        shown.pop();
    }
    shown
}

fn panels(page: &TracesPage, run: &RunTraces, area: Rect, buffer: &mut Buffer) {
    if area.height < 2 || area.width < LABELS + 4 {
        return;
    }
    let shown = fitting(page, area.height - 1);
    let mut rows: Vec<Constraint> = shown
        .iter()
        .map(|(_, shows)| Constraint::Fill(if *shows == Shows::Both { 4 } else { 3 }))
        .collect();
    rows.push(Constraint::Length(1));
    let areas = Layout::vertical(rows).split(area);
    for ((place, shows), area) in shown.iter().zip(areas.iter()) {
        if let Some(signal) = run.signals.get(*place) {
            panel(page, run, (signal, *shows), *area, buffer);
        }
    }
    if let Some(area) = areas.last() {
        let (from_s, to_s) = page.window_s();
        let [from, to] =
            [from_s, to_s].map(|time_s| format!("{} s", seconds(time_s, to_s - from_s)));
        let middle = page.cursor_s.map_or_else(
            || "time from the run's start".to_owned(),
            |at_s| format!("cursor at {} s", seconds(at_s, to_s - from_s)),
        );
        across([&from, &middle, &to], theme::DIM, *area, buffer);
    }
}

fn seconds(time_s: f64, window_s: f64) -> String {
    let decimals = if window_s < 0.2 {
        4
    } else if window_s < 5.0 {
        3
    } else {
        2
    };
    format!("{time_s:.decimals$}")
}

/// The points of a signal in the window, with one on either side, so that lines enter and leave the chart.
fn window_points(
    signal: &SignalTrace,
    values: &mut dyn Iterator<Item = f64>,
    (from_s, to_s): (f64, f64),
) -> Vec<(f64, f64)> {
    let times = &signal.time_s;
    let first = times.partition_point(|t| *t < from_s).saturating_sub(1);
    let count = (times.partition_point(|t| *t <= to_s) + 1).min(times.len()).saturating_sub(first);
    let points = times.iter().skip(first).copied().zip(values.skip(first)).take(count);
    if !signal.is_held {
        return points.collect();
    }
    let mut steps: Vec<(f64, f64)> = Vec::with_capacity(2 * count + 1);
    for (time_s, value) in points {
        if let Some((_, held)) = steps.last().copied() {
            steps.push((time_s, held));
        }
        steps.push((time_s, value));
    }
    // The last value is held to the end of the window.
    if let Some((_, held)) = steps.last().copied() {
        steps.push((to_s, held));
    }
    steps
}

/// The value at the cursor: of the last sample before it, held or the nearest.
fn at_cursor(signal: &SignalTrace, values: &[f64], at_s: f64) -> f64 {
    let times = &signal.time_s;
    let after = times.partition_point(|t| *t <= at_s);
    let before = after.saturating_sub(1);
    let nearest = match (times.get(before), times.get(after)) {
        (Some(left), Some(right)) if !signal.is_held && right - at_s < at_s - left => after,
        _ => before,
    };
    values.get(nearest).copied().unwrap_or(f64::NAN)
}

fn reading(value: f64) -> String {
    if value.is_finite() { significant(value, 4) } else { MISSING.to_owned() }
}

const fn style_of(quantity: Quantity) -> Style {
    match quantity {
        Quantity::Channel(Channel::Current | Channel::Torque) => theme::CURRENT,
        Quantity::Channel(Channel::Speed | Channel::Reference | Channel::Angle) => theme::SPEED,
        Quantity::Channel(_) => theme::VOLTAGE,
        Quantity::Estimate(_) => theme::PLAIN,
    }
}

struct Drawn {
    title: Line<'static>,
    values: Domain,
    /// Later ones over earlier ones.
    traces: Vec<Trace>,
    /// Half the width of the band of the noise.
    band: Option<f64>,
}

/// One panel: title with legend and readings, axis of values, marks, lines.
fn panel(
    page: &TracesPage,
    run: &RunTraces,
    (signal, shows): (&SignalTrace, Shows),
    area: Rect,
    buffer: &mut Buffer,
) {
    let is_wide = area.width >= 76;
    let Drawn { title, values, traces, band } = match shows {
        Shows::Both => both(page, signal, is_wide),
        Shows::Residual => residual(page, signal, is_wide),
    };
    let (from, to) = page.window_s();
    let bounds = Bounds { x: Domain { from, to }, y: values.rounded() };
    let inner = framed(&title, bounds.y, area, buffer);
    for edge in band.into_iter().flat_map(|band| [-band, band]) {
        let y = bounds.row(edge, inner);
        for x in (inner.x..inner.right()).filter(|_| inner.height > 2) {
            buffer[(x, y)].set_char('┈').set_style(theme::GOOD);
        }
    }
    // On the time axis that all panels have: where the hold-out begins, and the cursor.
    for (at_s, mark) in [(run.held_out_from_s, '╎'), (page.cursor_s, '┊')] {
        if let Some(at_s) = at_s {
            vertical(at_s, mark, bounds, inner, buffer);
        }
    }
    plot(&traces, bounds, inner, buffer);
}

/// A line through points, with gaps unless the signal is held between samples.
fn line(signal: &SignalTrace, points: Vec<(f64, f64)>, stroke: Stroke, style: Style) -> Trace {
    let longest_s = if signal.is_held {
        f64::INFINITY
    } else {
        longest_step_s(signal.time_s.len(), |k| signal.time_s[k])
    };
    Trace { longest_s, ..Trace::new(points, stroke, style) }
}

/// The time up to which the new model is drawn while a change is shown; beyond it is the old one.
fn border_s(page: &TracesPage) -> f64 {
    let (from_s, to_s) = page.window_s();
    from_s + page.drawn_share() * (to_s - from_s)
}

fn both(page: &TracesPage, signal: &SignalTrace, is_wide: bool) -> Drawn {
    let window_points =
        |values: &mut dyn Iterator<Item = f64>| window_points(signal, values, page.window_s());
    let measured = window_points(&mut signal.measured.iter().copied());
    let mut model = window_points(&mut signal.model.iter().copied());
    let old = page.signal_before(signal);
    let before = old.map_or_else(Vec::new, |old| {
        self::window_points(old, &mut old.model.iter().copied(), page.window_s())
    });
    if page.is_moving() {
        model.retain(|point| point.0 <= border_s(page));
    }
    let edge = |sigmas: f64| {
        window_points(
            &mut signal.measured.iter().zip(&signal.std).map(|(value, std)| value + sigmas * std),
        )
    };
    let values = [&measured, &model, &before].into_iter().flatten();
    let values = range(values.map(|point| point.1)).unwrap_or(NOTHING);

    let style = style_of(signal.quantity);
    let head = format!(" {}, {}", signal.quantity.name(), signal.quantity.unit());
    let mut title = Line::from(Span::styled(head, theme::BOLD));
    let cursor = |values: &[f64]| {
        page.cursor_s.map_or_else(String::new, |at_s| {
            format!(" {}", reading(at_cursor(signal, values, at_s)))
        })
    };
    let label = |long: &'static str, short: &'static str| if is_wide { long } else { short };
    let mut legend = |stroke: Stroke, name: &str, values: &[f64], style| {
        let text = format!("  {} {name}{}", stroke.sample(), cursor(values));
        title.push_span(Span::styled(text, style));
    };
    let measured_label = match signal.quantity {
        Quantity::Channel(channel) if channel.is_commanded() => label("commanded", "cmd"),
        Quantity::Channel(_) => label("measured", "meas"),
        Quantity::Estimate(_) => label("estimated on line", "est"),
    };
    legend(Stroke::Solid, measured_label, &signal.measured, style);
    if !signal.std.is_empty() {
        let half: Vec<f64> = signal.std.iter().map(|std| BAND_SIGMAS * std).collect();
        legend(Stroke::Dotted, "± 2 std", &half, theme::DIM);
    }
    if signal.has_model() {
        legend(Stroke::Dashed, "model", &signal.model, theme::MODEL);
        if let Some(old) = old {
            let name = if page.is_before {
                label("model after the change", "after")
            } else {
                label("model before the change", "before")
            };
            legend(Stroke::Dotted, name, &old.model, theme::DIM);
        }
    }
    let traces = [
        (edge(-BAND_SIGMAS), Stroke::Dotted, theme::DIM),
        (edge(BAND_SIGMAS), Stroke::Dotted, theme::DIM),
        (before, Stroke::Dotted, theme::DIM),
        (measured, Stroke::Solid, style),
        (model, Stroke::Dashed, theme::MODEL),
    ];
    let traces = traces.map(|(points, stroke, style)| line(signal, points, stroke, style));
    Drawn { title, values, traces: traces.into(), band: None }
}

fn residual(page: &TracesPage, signal: &SignalTrace, is_wide: bool) -> Drawn {
    let before = page.signal_before(signal);
    let mut points = window_points(signal, &mut signal.residual(), page.window_s());
    if let (true, Some(before)) = (page.is_moving(), before) {
        let border_s = border_s(page);
        points.retain(|point| point.0 <= border_s);
        let old = window_points(before, &mut before.residual(), page.window_s());
        points.extend(old.into_iter().filter(|point| point.0 > border_s));
    }
    let band = signal.noise.map(|noise| BAND_SIGMAS * noise);
    // Of both models, so that the axis stands still while a change is drawn.
    let old = before.filter(|_| page.is_moving()).into_iter().flat_map(SignalTrace::residual);
    let values = points.iter().map(|point| point.1).chain(old);
    let ends = values.flat_map(|value| [value, -value]);
    let least = band.into_iter().flat_map(|band| [-1.5 * band, 1.5 * band]);
    let values = range(ends.chain(least)).unwrap_or(NOTHING);

    let known = points.iter().map(|point| point.1).filter(|r| r.is_finite());
    let (squares, count) = known.fold((0.0, 0.0), |(sum, n), r| (sum + r * r, n + 1.0));
    let rms = f64::sqrt(squares / count);
    let unit = signal.quantity.unit();
    let head = if is_wide {
        format!(" {}: measured - model, {unit}", signal.quantity.name())
    } else {
        format!(" {} residual, {unit}", signal.quantity.name())
    };
    let mut title = Line::from(Span::styled(head, theme::BOLD));
    if let Some(at_s) = page.cursor_s {
        let [measured, model] =
            [&signal.measured, &signal.model].map(|values| at_cursor(signal, values, at_s));
        title.push_span(format!("  ┊ {}", reading(measured - model)));
    }
    // Of two models at once it would be of neither.
    if rms.is_finite() && !page.is_moving() {
        let text = match signal.noise {
            Some(noise) if is_wide => format!(
                "  rms {} = {:.2} x noise; ┈ {BAND_SIGMAS} x noise",
                significant(rms, 3),
                rms / noise
            ),
            Some(noise) => format!("  rms {:.1} x noise", rms / noise),
            None => format!("  rms {}, no noise is known", significant(rms, 3)),
        };
        title.push_span(Span::styled(text, theme::DIM));
    }
    let marked = signal.noise.map(|noise| (3.0 * noise, theme::BAD));
    let trace = Trace { beyond: marked, ..line(signal, points, Stroke::Solid, theme::PLAIN) };
    Drawn { title, values, traces: vec![trace], band: band.filter(|band| *band > 0.0) }
}

/// The list of everything that can be shown, over the middle of the page.
fn chooser(page: &TracesPage, run: &RunTraces, at: usize, area: Rect, buffer: &mut Buffer) {
    let all = page.panels();
    let shown = page.chosen.clone().unwrap_or_else(|| first_panels(&all));
    let name = |(place, shows): &Panel| {
        let name = run.signals.get(*place).map_or("", |own| own.quantity.name());
        match shows {
            Shows::Both => match run.signals.get(*place).map(|own| own.quantity) {
                Some(Quantity::Estimate(_)) => format!("estimate: {name}"),
                _ => name.to_owned(),
            },
            Shows::Residual => format!("{name}: residual"),
        }
    };
    let height = area.height.min(u16::try_from(all.len() + 2).unwrap_or(u16::MAX));
    let width = area.width.min(44);
    let place = centred(width, height, area);
    let room = usize::from(height.saturating_sub(2)).max(1);
    let rows = all.iter().enumerate().skip((at + 1).saturating_sub(room)).take(room);
    let rows = rows.map(|(index, panel)| {
        let mark = if shown.contains(panel) { "✓" } else { " " };
        let arrow = if index == at { "▶" } else { " " };
        let text = format!("{arrow} {mark} {}", name(panel));
        let text = cut(&text, usize::from(width.saturating_sub(2)));
        Line::styled(text, if index == at { theme::BOLD } else { theme::PLAIN })
    });
    Clear.render(place, buffer);
    let block = Block::bordered().title(" Enter shows or hides, Esc closes ");
    Paragraph::new(rows.collect::<Vec<_>>()).block(block).render(place, buffer);
}
