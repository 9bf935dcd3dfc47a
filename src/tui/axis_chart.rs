//! The charts of a document in a terminal: panels one under the other over one axis, with a cursor.

use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::plot::{Bounds, LABELS, Stroke, Trace, across, framed, plot, tick, vertical};
use super::theme;
use crate::report::plot::axis::{Domain, plain, powers};
use crate::report::plot::{AxisChart, AxisPanel, Drawn, Place, PointSet, Style as Drawing};
use drivebench_model::text::number::significant;

/// Bounds of the values where only columns are computed.
const UNUSED: Domain = Domain { from: 0.0, to: 1.0 };

/// Draws the panels that have room. A panel that is alone has no title: the page has it.
pub(super) fn axis_chart(chart: &AxisChart, cursor: Option<f64>, area: Rect, buffer: &mut Buffer) {
    let Some(across) = spanned(chart) else { return };
    if area.height < 3 || area.width < LABELS + 4 {
        return;
    }
    let room = usize::from((area.height - 1) / 5).max(1);
    let panels = &chart.panels[..room.min(chart.panels.len())];
    let heights = panels.iter().map(|panel| Constraint::Fill(panel.height as u16));
    let areas = Layout::vertical(heights.chain([Constraint::Length(1)])).split(area);
    for (index, (panel, area)) in panels.iter().zip(areas.iter()).enumerate() {
        let Some(values) = panel.values().filter(|_| area.height > 1) else {
            continue;
        };
        let title = title(chart, panel, cursor, index == 0);
        let bounds = Bounds { x: across, y: values.rounded() };
        draw(chart, panel, bounds, cursor, framed(&title, bounds.y, *area, buffer), buffer);
    }
    if let Some(last) = areas.last() {
        axis(chart, across, *last, buffer);
    }
}

fn spanned(chart: &AxisChart) -> Option<Domain> {
    let across = chart.across()?;
    Some(if chart.is_logarithmic { across } else { across.padded(0.02) })
}

fn plot_area(area: Rect) -> Rect {
    Rect { x: area.x + LABELS, width: area.width.saturating_sub(LABELS), ..area }
}

/// The point of the first set that is drawn nearest to this column.
pub(super) fn point_at(chart: &AxisChart, column: u16, area: Rect) -> Option<usize> {
    let bounds = Bounds { x: spanned(chart)?, y: UNUSED };
    let points = chart.panels.first()?.sets.first()?.points.iter().enumerate();
    let columns = points.filter_map(|(index, point)| {
        Some((bounds.column(point.at, plot_area(area))?.abs_diff(column), index))
    });
    columns.min().map(|(_, index)| index)
}

/// The dot of a point with its style, and the stroke and style of a curve.
const fn look(set: &PointSet) -> (char, Style, Stroke, Style) {
    match set.style {
        Drawing::After => ('○', theme::GOOD, Stroke::Solid, theme::GOOD),
        Drawing::Before => ('●', theme::CAREFUL, Stroke::Dashed, theme::MODEL),
        Drawing::Measured | Drawing::Command => ('●', theme::PLAIN, Stroke::Solid, theme::SPEED),
    }
}

fn title(chart: &AxisChart, panel: &AxisPanel, cursor: Option<f64>, first: bool) -> Line<'static> {
    let mut line = Line::default();
    if chart.panels.len() > 1 {
        line.push_span(Span::styled(format!(" {}", panel.title), theme::BOLD));
    }
    let (name, points) = &panel.line;
    for set in panel.sets.iter().filter(|set| set.drawn != Drawn::Faint) {
        let (mark, of_mark, stroke, of_stroke) = look(set);
        let (sample, style) = if set.drawn == Drawn::Curve {
            (stroke.sample().to_owned(), of_stroke)
        } else {
            (mark.to_string(), of_mark)
        };
        let label = match set.label.as_str() {
            "" => "error of the model",
            label => label,
        };
        let reading = cursor.filter(|_| set.drawn == Drawn::Curve);
        let reading = reading.map_or_else(String::new, |at| reading_at(set, at));
        line.push_span(Span::styled(format!("  {sample} {label}{reading}"), style));
    }
    if !points.is_empty() {
        let sample = Stroke::Solid.sample();
        line.push_span(Span::styled(format!("  {sample} {name}"), theme::SPEED));
    }
    if panel.sets.iter().any(|set| set.drawn != Drawn::Curve && set.drawn != Drawn::Faint) {
        line.push_span(Span::styled("  │ 95 %", theme::DIM));
    }
    if let Some(at) = cursor.filter(|_| first && chart.is_logarithmic) {
        line.push_span(format!("  ┊ {} {}", significant(at, 3), chart.unit));
    }
    line
}

/// The value of a curve at the cursor, with a space before it.
fn reading_at(set: &PointSet, at: f64) -> String {
    let point = set.points.iter().find(|point| point.at >= at);
    let value = point.filter(|point| point.is_known());
    value.map_or_else(
        || " not carried".to_owned(),
        |point| format!(" {}", significant(point.value, 3)),
    )
}

fn draw(
    chart: &AxisChart,
    panel: &AxisPanel,
    bounds: Bounds,
    cursor: Option<f64>,
    inner: Rect,
    buffer: &mut Buffer,
) {
    let abscissa = |at: f64| if chart.is_logarithmic { at.log10() } else { at };
    for (_, at) in &chart.marks {
        vertical(abscissa(*at), '╎', bounds, inner, buffer);
    }
    if let Some(at) = cursor {
        vertical(abscissa(at), '┊', bounds, inner, buffer);
    }
    let sets = panel.sets.iter().flat_map(|set| curves(set, abscissa, bounds));
    let line = Trace::new(panel.line.1.clone(), Stroke::Solid, theme::SPEED);
    let traces: Vec<Trace> = sets.chain([line]).collect();
    plot(&traces, bounds, inner, buffer);
    let dots = panel.sets.iter().rev();
    for set in dots.filter(|set| matches!(set.drawn, Drawn::Apart | Drawn::Knots)) {
        let (mark, style, ..) = look(set);
        for point in set.known() {
            dot(point, mark, style, bounds, inner, buffer);
        }
    }
}

/// The lines of a set; for measured points the ends of their intervals first.
fn curves(set: &PointSet, abscissa: impl Fn(f64) -> f64, bounds: Bounds) -> Vec<Trace> {
    let line = |value: &dyn Fn(&Place) -> f64, stroke, style| {
        let points = set.points.iter().map(|point| {
            (abscissa(point.at), if point.is_known() { value(point) } else { f64::NAN })
        });
        Trace::new(points.collect(), stroke, style)
    };
    let (.., stroke, style) = look(set);
    match set.drawn {
        Drawn::Apart | Drawn::Knots => Vec::new(),
        Drawn::Faint => {
            // In the panel and each by itself: between two of them nothing is known.
            let inside = |point: &Place| {
                let is_inside = (bounds.y.from..=bounds.y.to).contains(&point.value);
                if is_inside { point.value } else { f64::NAN }
            };
            vec![Trace { longest_s: -1.0, ..line(&inside, Stroke::Solid, theme::DIM) }]
        }
        Drawn::Curve if set.style == Drawing::Measured => vec![
            line(&|point| point.low, Stroke::Dotted, theme::DIM),
            line(&|point| point.high, Stroke::Dotted, theme::DIM),
            line(&|point| point.value, stroke, style),
        ],
        Drawn::Curve => vec![line(&|point| point.value, stroke, style)],
    }
}

fn dot(point: &Place, mark: char, style: Style, bounds: Bounds, area: Rect, buffer: &mut Buffer) {
    let Some(x) = bounds.column(point.at, area) else {
        return;
    };
    let y = bounds.row(point.value, area);
    let [top, bottom] = [point.high, point.low].map(|end| bounds.row(end, area));
    for at in (top..=bottom).filter(|at| *at != y && point.high > point.low) {
        buffer[(x, at)].set_char('│').set_style(theme::DIM);
    }
    buffer[(x, y)].set_char(mark).set_style(style);
}

/// Labels of the axis: both ends and the middle, or as many powers of ten as there is room for.
fn axis(chart: &AxisChart, spanned: Domain, area: Rect, buffer: &mut Buffer) {
    let unit = chart.unit;
    if !chart.is_logarithmic {
        let Domain { from, to } = spanned;
        let labels = [from, f64::midpoint(from, to), to].map(tick);
        let [left, middle, right] = &labels;
        let right = format!("{right} {unit}");
        return across([left, middle, &right], theme::DIM, area, buffer);
    }
    let inner = plot_area(area);
    let bounds = Bounds { x: spanned, y: UNUSED };
    buffer.set_stringn(area.x, area.y, format!(" {unit}"), usize::from(LABELS), theme::DIM);
    let mut free = inner.x;
    for value in powers(spanned) {
        let label = plain(value);
        let width = label.chars().count() as u16;
        let Some(column) = bounds.column(value.log10(), inner) else {
            continue;
        };
        let first = column.saturating_sub(width / 2).max(inner.x);
        if first >= free && first + width <= inner.right() {
            buffer.set_string(first, area.y, &label, theme::DIM);
            free = first + width + 2;
        }
    }
}
