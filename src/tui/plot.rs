//! Charts drawn with cells: lines of Braille dots, of which every column shows the smallest and the largest value in it, with
//! round axes.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::Line;

use super::frame::row as title_row;
use super::theme;
use crate::report::plot::GAP;
use crate::report::plot::axis::Domain;
use drivebench_model::text::number::shortest;

/// Columns of the axis labels, with the axis.
pub(super) const LABELS: u16 = 7;

/// The range of the values that a chart can show; none where there is none.
pub(super) fn range(values: impl Iterator<Item = f64>) -> Option<Domain> {
    Domain::of(values.filter(|value| value.abs() < 1e15))
}

/// A chart's title, and below it the axis of its values; returns the area of its lines.
pub(super) fn framed(title: &Line<'_>, values: Domain, area: Rect, buffer: &mut Buffer) -> Rect {
    title_row(title, Rect { height: 1, ..area }, buffer);
    let inner = Rect {
        x: area.x + LABELS,
        y: area.y + 1,
        width: area.width.saturating_sub(LABELS),
        height: area.height.saturating_sub(1),
    };
    value_axis(values, inner, buffer);
    inner
}

/// Labels of the top, the bottom and zero, and a dotted line there.
fn value_axis(values: Domain, plot_area: Rect, buffer: &mut Buffer) {
    let (low, high) = (values.from, values.to);
    let rows = f64::from(plot_area.height);
    let last = plot_area.height.saturating_sub(1);
    let zero = ((high / (high - low) * rows) as u16).min(last);
    for row in 0..plot_area.height {
        let label = match row {
            0 => tick(high),
            _ if row == last => tick(low),
            _ if row == zero && low < 0.0 && high > 0.0 => tick(0.0),
            _ => String::new(),
        };
        let mark = if label.is_empty() { '│' } else { '┤' };
        let width = usize::from(LABELS - 1);
        let label: String = label.chars().take(width).collect();
        let y = plot_area.y + row;
        buffer.set_string(plot_area.x - LABELS, y, format!("{label:>width$}{mark}"), theme::DIM);
        if row == zero && low < 0.0 {
            for x in plot_area.x..plot_area.right() {
                buffer[(x, y)].set_char('·').set_style(theme::DIM);
            }
        }
    }
}

/// Three labels under a chart: at its left end, in the middle where there is room, at its right end.
pub(super) fn across(
    [left, middle, right]: [&str; 3],
    style: Style,
    area: Rect,
    buffer: &mut Buffer,
) {
    let width = usize::from(area.width.saturating_sub(LABELS));
    let length = |labels: &[&str]| labels.iter().map(|label| label.chars().count()).sum::<usize>();
    let fits = length(&[left, middle, right]) + 2 <= width;
    let middle = if fits { middle } else { "" };
    let free = width.saturating_sub(length(&[left, middle, right]));
    let line = format!(
        "{left}{:free_left$}{middle}{:free_right$}{right}",
        "",
        "",
        free_left = free / 2,
        free_right = free - free / 2,
    );
    buffer.set_stringn(area.x + LABELS.min(area.width), area.y, line, width, style);
}

/// A round number in the width of the axis.
pub(super) fn tick(value: f64) -> String {
    let text = shortest(value, 3);
    if text.len() < usize::from(LABELS) { text } else { format!("{value:.0e}") }
}

/// Dots of one cell.
const DOTS_X: usize = 2;
const DOTS_Y: usize = 4;
/// Bits of the dots of a cell, by row and column (Unicode, Braille patterns).
const BITS: [[u8; DOTS_X]; DOTS_Y] = [[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]];

/// What distinguishes lines without colour: the cells that a line leaves out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stroke {
    Solid,
    /// Whole cells on and off: a dash of single dots would look like noise.
    Dashed,
    Dotted,
}

impl Stroke {
    const fn draws(self, x: usize) -> bool {
        let cell = x / DOTS_X;
        match self {
            Self::Solid => true,
            Self::Dashed => cell.is_multiple_of(2),
            Self::Dotted => cell.is_multiple_of(4),
        }
    }

    pub(super) const fn sample(self) -> &'static str {
        match self {
            Self::Solid => "⣀⣀⣀",
            Self::Dashed => "⣀ ⣀",
            Self::Dotted => "⣀  ",
        }
    }
}

/// One line of a chart. A value that is not finite, and a step longer than `longest_s`, is a gap.
pub(super) struct Trace {
    /// Place and value, in order.
    pub(super) points: Vec<(f64, f64)>,
    pub(super) longest_s: f64,
    pub(super) stroke: Stroke,
    pub(super) style: Style,
    /// Columns with a value that is larger than this, whatever its sign, have this style.
    pub(super) beyond: Option<(f64, Style)>,
}

impl Trace {
    /// A line whose gaps are values that are not finite.
    pub(super) const fn new(points: Vec<(f64, f64)>, stroke: Stroke, style: Style) -> Self {
        Self { points, longest_s: f64::INFINITY, stroke, style, beyond: None }
    }
}

/// The ranges of an area: across and upwards.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub(super) x: Domain,
    pub(super) y: Domain,
}

impl Bounds {
    /// The cell of a place on the lower axis; `None` outside.
    pub(super) fn column(&self, at: f64, area: Rect) -> Option<u16> {
        let share = (at - self.x.from) / (self.x.to - self.x.from);
        (0.0..=1.0).contains(&share).then(|| {
            let cell = (share * f64::from(area.width)) as u16;
            area.x + cell.min(area.width.saturating_sub(1))
        })
    }

    /// The cell of a value; those outside stick to the edge.
    pub(super) fn row(&self, value: f64, area: Rect) -> u16 {
        let cell = row(value, *self, usize::from(area.height)) / DOTS_Y;
        area.y + cell as u16
    }
}

/// Marks a place on the lower axis over the whole height.
pub(super) fn vertical(at: f64, mark: char, bounds: Bounds, area: Rect, buffer: &mut Buffer) {
    if let Some(x) = bounds.column(at, area) {
        for y in area.y..area.bottom() {
            buffer[(x, y)].set_char(mark).set_style(theme::DIM);
        }
    }
}

pub(super) fn plot(traces: &[Trace], bounds: Bounds, area: Rect, buffer: &mut Buffer) {
    let area = area.intersection(buffer.area);
    let (width, height) = (usize::from(area.width), usize::from(area.height));
    if width == 0 || height == 0 {
        return;
    }
    let mut cells = vec![(0_u8, Style::new()); width * height];
    for trace in traces {
        let columns = columns(&trace.points, trace.longest_s, bounds, width * DOTS_X);
        for (x, span) in columns.into_iter().enumerate() {
            let Some((low, high)) = span.filter(|_| trace.stroke.draws(x)) else {
                continue;
            };
            let is_beyond = |limit: f64| low < -limit || high > limit;
            let beyond = trace.beyond.filter(|(limit, _)| is_beyond(*limit));
            let (top, bottom) = (row(high, bounds, height), row(low, bounds, height));
            for y in top..=bottom {
                let cell = &mut cells[(y / DOTS_Y) * width + x / DOTS_X];
                cell.0 |= BITS[y % DOTS_Y][x % DOTS_X];
                cell.1 = beyond.map_or(trace.style, |(_, style)| style);
            }
        }
    }
    for (index, (bits, style)) in cells.into_iter().enumerate().filter(|(_, cell)| cell.0 > 0) {
        let (x, y) = ((index % width) as u16, (index / width) as u16);
        let symbol = char::from_u32(0x2800 + u32::from(bits)).unwrap_or('?');
        let cell = &mut buffer[(area.x + x, area.y + y)];
        cell.set_char(symbol).set_style(style);
    }
}

/// Row of dots of a value, the top one being 0; values outside stick to the edge.
fn row(value: f64, bounds: Bounds, height: usize) -> usize {
    let dots = height * DOTS_Y;
    let share = ((bounds.y.to - value) / (bounds.y.to - bounds.y.from)).clamp(0.0, 1.0);
    ((share * dots as f64) as usize).min(dots.saturating_sub(1))
}

/// Smallest and largest value per column of dots, with straight lines between neighbours that have no gap between them.
fn columns(
    points: &[(f64, f64)],
    longest_s: f64,
    bounds: Bounds,
    count: usize,
) -> Vec<Option<(f64, f64)>> {
    let mut columns = vec![None; count];
    let span_s = bounds.x.to - bounds.x.from;
    if count == 0 || !(span_s > 0.0 && span_s.is_finite()) {
        return columns;
    }
    let position = |time_s: f64| (time_s - bounds.x.from) / span_s * count as f64;
    let mut put = |column: f64, value: f64| {
        if (0.0..count as f64).contains(&column) {
            let span: &mut Option<(f64, f64)> = &mut columns[(column as usize).min(count - 1)];
            let (low, high) = span.unwrap_or((value, value));
            *span = Some((low.min(value), high.max(value)));
        }
    };
    let mut before: Option<(f64, f64)> = None;
    for &(time_s, value) in points {
        if !(time_s.is_finite() && value.is_finite()) {
            before = None;
            continue;
        }
        let at = position(time_s);
        // The last instant belongs to the last column.
        put(at.min(at.floor().max(count as f64 - 1.0)), value);
        if let Some((last_s, last)) = before
            && (0.0..=longest_s).contains(&(time_s - last_s))
        {
            let last_at = position(last_s);
            let first = last_at.max(0.0).floor() + 1.0;
            for edge in first as usize..=(at.min(count as f64).max(0.0) as usize) {
                let edge = edge as f64;
                let share = ((edge - last_at) / (at - last_at)).clamp(0.0, 1.0);
                if share.is_finite() {
                    let between = last + share * (value - last);
                    put(edge - 0.5, between);
                    put(edge, between);
                }
            }
        }
        before = Some((time_s, value));
    }
    columns
}

/// Step of time from which on there is a gap: so many times the median one of up to 2000; infinite where there are not
/// two points. `at` gives the time of each of `count` points.
pub(super) fn longest_step_s(count: usize, at: impl Fn(usize) -> f64) -> f64 {
    let steps = (1..count).step_by(count.div_ceil(2000).max(1)).map(|k| at(k) - at(k - 1));
    let mut steps: Vec<f64> = steps.filter(|step| step.is_finite()).collect();
    if steps.is_empty() {
        return f64::INFINITY;
    }
    let middle = steps.len() / 2;
    GAP * *steps.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn longest(points: &[(f64, f64)]) -> f64 {
        longest_step_s(points.len(), |k| points[k].0)
    }

    const BOUNDS: Bounds =
        Bounds { x: Domain { from: 0.0, to: 10.0 }, y: Domain { from: -1.0, to: 1.0 } };

    #[test]
    fn a_spike_of_one_row_is_drawn_however_many_rows_a_column_has() {
        let points: Vec<_> = (0..10_000)
            .map(|row| (f64::from(row) * 1e-3, if row == 4321 { 0.9 } else { 0.0 }))
            .collect();
        let columns = columns(&points, longest(&points), BOUNDS, 20);
        assert_eq!(columns[8], Some((0.0, 0.9)));
        assert_eq!(columns.iter().flatten().count(), 20);
        assert_eq!(columns[3], Some((0.0, 0.0)));
    }

    #[test]
    fn a_gap_stays_a_gap_and_neighbours_are_joined() {
        // One point a second, two columns a second; the values of 4 s and the rows of 7 and 8 s are missing.
        let points: Vec<_> = (0..10)
            .filter(|second| !(7..9).contains(second))
            .map(|second| (f64::from(second), if second == 4 { f64::NAN } else { 0.5 }))
            .collect();
        let columns = columns(&points, longest(&points), BOUNDS, 20);
        let drawn: String =
            columns.iter().map(|column| if column.is_some() { '#' } else { '.' }).collect();
        assert_eq!(drawn, "#######...###.....#.");
    }

    #[test]
    fn the_top_is_the_high_bound() {
        let area = Rect::new(0, 0, 4, 2);
        let mut buffer = Buffer::empty(area);
        let line = |value, stroke| {
            let points = (0..=100).map(|k| (f64::from(k) * 0.1, value));
            Trace::new(points.collect(), stroke, Style::new())
        };
        let lines = [line(1.0, Stroke::Solid), line(-1.0, Stroke::Dashed)];
        plot(&lines, BOUNDS, area, &mut buffer);
        let text: Vec<String> =
            (0..2).map(|y| (0..4).map(|x| buffer[(x, y)].symbol()).collect()).collect();
        assert_eq!(text, ["⠉⠉⠉⠉", "⣀ ⣀ "]);
    }
}
