//! Three charts over one time axis: voltage; current; speed, measured and of the model, or with a loop its reference.
//! Below them the lines of dots in Braille: every column shows the smallest and the largest value that fell into it.

use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::Widget;

use crate::bench::{Snapshot, TracePoint};
use crate::sample::Channel;
use crate::text::number::{MISSING, shortest, significant};
use crate::tui::theme;
use crate::units::rpm_from_rad_s;

/// Columns of the axis labels, with the axis.
const LABELS: u16 = 7;
/// Rows of a chart at least: its title and two rows of dots.
const SMALLEST: u16 = 3;
/// From this width on the legend is written out.
const WIDE: u16 = 62;
/// The model may stretch the axis of the speed by this share of the measured span, no further.
const STRETCH: f64 = 0.5;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Chart {
    Voltage,
    Current,
    Speed,
}

impl Chart {
    const fn look(self) -> (Channel, Style) {
        match self {
            Self::Voltage => (Channel::Voltage, theme::VOLTAGE),
            Self::Current => (Channel::Current, theme::CURRENT),
            Self::Speed => (Channel::Speed, theme::SPEED),
        }
    }

    const fn value(self, point: &TracePoint) -> f64 {
        match self {
            Self::Voltage => point.voltage_v,
            Self::Current => point.current_a,
            Self::Speed => point.speed_rad_s,
        }
    }
}

/// Draws the last `window_s` seconds; where there is little room, the speed comes first.
pub(super) fn scope(
    snapshot: &Snapshot,
    window_s: f64,
    frozen: bool,
    area: Rect,
    buffer: &mut Buffer,
) {
    let area = area.intersection(buffer.area);
    if area.height < 2 || area.width < LABELS + 2 {
        return;
    }
    let charts: &[Chart] = match (area.height - 1) / SMALLEST {
        0 | 1 => &[Chart::Speed],
        2 => &[Chart::Current, Chart::Speed],
        _ => &[Chart::Voltage, Chart::Current, Chart::Speed],
    };
    let (from_s, to_s) = window(&snapshot.trace, window_s);
    let trace = &snapshot.trace;
    let first = trace.partition_point(|point| point.time_s < from_s);
    // One point before the left edge, so that the line enters the chart and does not begin in it.
    let points = trace.get(first.saturating_sub(1)..).unwrap_or_default();
    let mut rows = vec![Constraint::Fill(1); charts.len()];
    rows.push(Constraint::Length(1));
    let areas = Layout::vertical(rows).split(area);
    for (chart, place) in charts.iter().zip(areas.iter()) {
        draw(*chart, snapshot, points, (from_s, to_s), *place, buffer);
    }
    if let Some(place) = areas.last() {
        time_axis(from_s, to_s, frozen, *place, buffer);
    }
}

/// The time axis grows from the first point and then runs along. What is no longer kept is not shown as empty.
fn window(points: &[TracePoint], wanted_s: f64) -> (f64, f64) {
    let times = points.iter().map(|point| point.time_s);
    let times = times.filter(|time_s| time_s.is_finite());
    let (first, last) = times.fold((f64::NAN, f64::NAN), |(first, last): (f64, f64), time_s| {
        (first.min(time_s), last.max(time_s))
    });
    if !first.is_finite() {
        return (0.0, wanted_s);
    }
    let kept_s = last - first;
    let length_s = if first > 0.0 && kept_s > 0.0 && kept_s < wanted_s {
        kept_s
    } else {
        wanted_s
    };
    let from_s = (last - length_s).max(first);
    (from_s, from_s + length_s)
}

fn draw(
    chart: Chart,
    snapshot: &Snapshot,
    points: &[TracePoint],
    (from_s, to_s): (f64, f64),
    area: Rect,
    buffer: &mut Buffer,
) {
    if area.height < 2 {
        return;
    }
    let trace = |value: &dyn Fn(&TracePoint) -> f64| -> Vec<(f64, f64)> {
        let pairs = points.iter().map(|point| (point.time_s, value(point)));
        pairs.collect()
    };
    let measured = trace(&|point| chart.value(point));
    // A loop is held against its reference; the model knows nothing of a load that changes meanwhile.
    let follows = points.iter().any(|point| point.reference_rad_s.is_finite());
    let model = match chart {
        Chart::Speed if follows => trace(&|point| point.reference_rad_s),
        Chart::Speed => trace(&|point| point.model_speed_rad_s),
        _ => Vec::new(),
    };
    let (low, high) = bounds(&measured, &model);
    let newest = measured.last().map_or(f64::NAN, |point| point.1);
    title(chart, snapshot, follows, newest, area.width).render(Rect { height: 1, ..area }, buffer);

    let plot_area = Rect {
        x: area.x + LABELS,
        y: area.y + 1,
        width: area.width - LABELS,
        height: area.height - 1,
    };
    value_axis(low, high, plot_area, buffer);
    let traces = [
        Trace {
            points: model,
            dashed: true,
            style: theme::MODEL,
        },
        Trace {
            points: measured,
            dashed: false,
            style: chart.look().1,
        },
    ];
    let bounds = Bounds {
        from_s,
        to_s,
        low,
        high,
    };
    plot(&traces, bounds, plot_area, buffer);
}

fn title(
    chart: Chart,
    snapshot: &Snapshot,
    follows: bool,
    newest: f64,
    width: u16,
) -> Line<'static> {
    let (channel, style) = chart.look();
    let head = format!("{} {} ", channel.name(), channel.unit());
    let mut line = Line::from(Span::styled(head, theme::BOLD));
    line.push_span(Span::styled(reading(newest), style));
    if chart == Chart::Speed {
        let rpm = rpm_from_rad_s(newest);
        line.push_span(if rpm.is_finite() && rpm.abs() < 1e6 {
            format!(", {rpm:.0} r/min")
        } else {
            format!(", {MISSING} r/min")
        });
        let (measured, dashed) = match (width < WIDE, follows, snapshot.model_is_identified) {
            (true, true, _) => (" ⣀⣀meas", " ⣀ ⣀ref"),
            (true, false, _) => (" ⣀⣀meas", " ⣀ ⣀model"),
            (false, true, _) => ("  ⣀⣀ measured", "  ⣀ ⣀ reference"),
            (false, false, true) => ("  ⣀⣀ measured", "  ⣀ ⣀ model, identified"),
            (false, false, false) => ("  ⣀⣀ measured", "  ⣀ ⣀ model, nameplate"),
        };
        line.push_span(Span::styled(measured, style));
        line.push_span(Span::styled(dashed, theme::MODEL));
    }
    line
}

/// Two decimals, so that the digits do not dance.
fn reading(value: f64) -> String {
    if value.abs() < 1e5 {
        format!("{value:.2}")
    } else {
        significant(value, 4)
    }
}

/// Round bounds that hold the measurement and zero; a model that runs away does not squeeze the measurement.
fn bounds(measured: &[(f64, f64)], model: &[(f64, f64)]) -> (f64, f64) {
    let range = |points: &[(f64, f64)]| {
        let values = points.iter().map(|point| point.1);
        values
            .filter(|value| value.is_finite() && value.abs() < 1e15)
            .fold(None, |range: Option<(f64, f64)>, value| {
                let (low, high) = range.unwrap_or((value, value));
                Some((low.min(value), high.max(value)))
            })
    };
    let (mut low, mut high) = match (range(measured), range(model)) {
        (Some((low, high)), Some((model_low, model_high))) => {
            let room = STRETCH * (high.max(0.0) - low.min(0.0));
            (
                low.min(model_low.max(low - room)),
                high.max(model_high.min(high + room)),
            )
        }
        (Some(range), None) | (None, Some(range)) => range,
        (None, None) => (0.0, 1.0),
    };
    (low, high) = (low.min(0.0), high.max(0.0));
    if high - low < 1e-9 {
        high = low + 1.0;
    }
    let step = nice_step((high - low) / 8.0);
    ((low / step).floor() * step, (high / step).ceil() * step)
}

/// 1, 2, 2.5 or 5 times a power of ten, not below `rough`.
fn nice_step(rough: f64) -> f64 {
    let power = 10_f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 2.5, 5.0]
        .into_iter()
        .find(|factor| factor * power >= rough)
        .unwrap_or(10.0);
    factor * power
}

fn value_axis(low: f64, high: f64, plot_area: Rect, buffer: &mut Buffer) {
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
        let label = format!("{label:>width$}{mark}");
        buffer.set_string(plot_area.x - LABELS, y, label, theme::DIM);
        if row == zero && low < 0.0 {
            for x in plot_area.x..plot_area.right() {
                buffer[(x, y)].set_char('·').set_style(theme::DIM);
            }
        }
    }
}

fn time_axis(from_s: f64, to_s: f64, frozen: bool, area: Rect, buffer: &mut Buffer) {
    let width = usize::from(area.width.saturating_sub(LABELS));
    let left = format!("{} s", seconds(from_s));
    let right = format!("{} s", seconds(to_s));
    let middle = if frozen {
        "FROZEN, f = go on".to_owned()
    } else {
        format!("{} s", seconds(f64::midpoint(from_s, to_s)))
    };
    let used = left.chars().count() + right.chars().count() + middle.chars().count();
    let free = width.saturating_sub(used);
    let line = format!(
        "{left}{:free_left$}{middle}{:free_right$}{right}",
        "",
        "",
        free_left = free / 2,
        free_right = free - free / 2,
    );
    let x = area.x + LABELS.min(area.width);
    let style = if frozen { theme::CAREFUL } else { theme::DIM };
    buffer.set_stringn(x, area.y, line, width, style);
}

fn seconds(time_s: f64) -> String {
    if time_s.abs() < 1e6 {
        format!("{time_s:.1}")
    } else {
        tick(time_s)
    }
}

/// A round number in the width of the axis.
fn tick(value: f64) -> String {
    let text = shortest(value, 3);
    if text.len() < usize::from(LABELS) {
        text
    } else {
        format!("{value:.0e}")
    }
}

/// Dots of one cell.
const DOTS_X: usize = 2;
const DOTS_Y: usize = 4;
/// Bits of the dots of a cell, by row and column (Unicode, Braille patterns).
const BITS: [[u8; DOTS_X]; DOTS_Y] = [[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]];
/// A step in time longer than so many usual ones is a gap.
const GAP_FACTOR: f64 = 1.75;

/// One line of a chart. A value that is not finite, and a missing row, is a gap.
struct Trace {
    /// Time and value, oldest first.
    points: Vec<(f64, f64)>,
    dashed: bool,
    style: Style,
}

/// What the corners of the area stand for.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    from_s: f64,
    to_s: f64,
    low: f64,
    high: f64,
}

/// Draws the traces, later ones over earlier ones.
fn plot(traces: &[Trace], bounds: Bounds, area: Rect, buffer: &mut Buffer) {
    let area = area.intersection(buffer.area);
    let (width, height) = (usize::from(area.width), usize::from(area.height));
    let mut cells = vec![(0_u8, Style::new()); width * height];
    for trace in traces {
        let columns = columns(&trace.points, bounds, width * DOTS_X);
        for (x, span) in columns.into_iter().enumerate() {
            // Whole cells on and off: a dash of single dots would look like noise.
            let Some((low, high)) =
                span.filter(|_| !trace.dashed || (x / DOTS_X).is_multiple_of(2))
            else {
                continue;
            };
            let (top, bottom) = (row(high, bounds, height), row(low, bounds, height));
            for y in top..=bottom {
                let cell = &mut cells[(y / DOTS_Y) * width + x / DOTS_X];
                cell.0 |= BITS[y % DOTS_Y][x % DOTS_X];
                cell.1 = trace.style;
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
    let share = ((bounds.high - value) / (bounds.high - bounds.low)).clamp(0.0, 1.0);
    ((share * dots as f64) as usize).min(dots.saturating_sub(1))
}

/// Smallest and largest value per column of dots, with straight lines between neighbours that have no gap between them.
fn columns(points: &[(f64, f64)], bounds: Bounds, count: usize) -> Vec<Option<(f64, f64)>> {
    let mut columns = vec![None; count];
    let span_s = bounds.to_s - bounds.from_s;
    if count == 0 || !(span_s > 0.0 && span_s.is_finite()) {
        return columns;
    }
    let position = |time_s: f64| (time_s - bounds.from_s) / span_s * count as f64;
    let mut put = |column: f64, value: f64| {
        if (0.0..count as f64).contains(&column) {
            let span: &mut Option<(f64, f64)> = &mut columns[(column as usize).min(count - 1)];
            let (low, high) = span.unwrap_or((value, value));
            *span = Some((low.min(value), high.max(value)));
        }
    };
    let longest_s = GAP_FACTOR * usual_step_s(points);
    let mut before: Option<(f64, f64)> = None;
    for &(time_s, value) in points {
        if !(time_s.is_finite() && value.is_finite()) {
            before = None;
            continue;
        }
        let here = position(time_s);
        // The last instant belongs to the last column.
        put(here.min(here.floor().max(count as f64 - 1.0)), value);
        if let Some((last_s, last)) = before
            && (0.0..=longest_s).contains(&(time_s - last_s))
        {
            let there = position(last_s);
            let first = there.max(0.0).floor() + 1.0;
            for edge in first as usize..=(here.min(count as f64).max(0.0) as usize) {
                let edge = edge as f64;
                let share = ((edge - there) / (here - there)).clamp(0.0, 1.0);
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

/// Median step of time, s; infinite where there are not two points.
fn usual_step_s(points: &[(f64, f64)]) -> f64 {
    let mut steps: Vec<f64> = points
        .windows(2)
        .map(|pair| pair[1].0 - pair[0].0)
        .filter(|step| step.is_finite())
        .collect();
    if steps.is_empty() {
        return f64::INFINITY;
    }
    let middle = steps.len() / 2;
    *steps.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Bounds = Bounds {
        from_s: 0.0,
        to_s: 10.0,
        low: -1.0,
        high: 1.0,
    };

    #[test]
    fn a_spike_of_one_row_is_seen_however_many_rows_a_column_holds() {
        let points: Vec<_> = (0..10_000)
            .map(|row| (f64::from(row) * 1e-3, if row == 4321 { 0.9 } else { 0.0 }))
            .collect();
        let columns = columns(&points, BOUNDS, 20);
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
        let columns = columns(&points, BOUNDS, 20);
        let seen: String = columns
            .iter()
            .map(|column| if column.is_some() { '#' } else { '.' })
            .collect();
        assert_eq!(seen, "#######...###.....#.");
    }

    #[test]
    fn the_top_is_the_high_bound() {
        let area = Rect::new(0, 0, 4, 2);
        let mut buffer = Buffer::empty(area);
        let line = |value, dashed| Trace {
            points: (0..=100).map(|k| (f64::from(k) * 0.1, value)).collect(),
            dashed,
            style: Style::new(),
        };
        let lines = [line(1.0, false), line(-1.0, true)];
        plot(&lines, BOUNDS, area, &mut buffer);
        let text: Vec<String> = (0..2)
            .map(|y| (0..4).map(|x| buffer[(x, y)].symbol()).collect())
            .collect();
        assert_eq!(text, ["⠉⠉⠉⠉", "⣀ ⣀ "]);
    }

    #[test]
    fn bounds_are_round_hold_zero_and_are_not_squeezed_by_a_runaway_model() {
        let measured: Vec<_> = (0..=100).map(|k| (f64::from(k), f64::from(k))).collect();
        assert_eq!(bounds(&measured, &[]), (0.0, 100.0));
        let runaway = [(0.0, -1e9), (1.0, 1e12), (2.0, f64::INFINITY)];
        assert_eq!(bounds(&measured, &runaway), (-50.0, 150.0));
        assert_eq!(bounds(&[], &[]), (0.0, 1.0));
        assert_eq!(bounds(&[(0.0, 0.0)], &[(0.0, f64::NAN)]), (0.0, 1.0));
    }

    #[test]
    fn the_window_grows_then_runs_and_a_short_memory_is_shown_whole() {
        let point = |time_s| TracePoint {
            time_s,
            voltage_v: 0.0,
            current_a: 0.0,
            speed_rad_s: 0.0,
            model_speed_rad_s: 0.0,
            reference_rad_s: f64::NAN,
        };
        assert_eq!(window(&[], 10.0), (0.0, 10.0));
        assert_eq!(window(&[point(0.0), point(3.0)], 10.0), (0.0, 10.0));
        assert_eq!(window(&[point(0.0), point(30.0)], 10.0), (20.0, 30.0));
        assert_eq!(window(&[point(28.0), point(30.0)], 10.0), (28.0, 30.0));
    }
}
