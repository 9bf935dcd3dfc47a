//! Lines of dots in Braille: every column shows the smallest and the largest value that fell into it.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;

/// Dots of one cell.
const DOTS_X: usize = 2;
const DOTS_Y: usize = 4;
/// Bits of the dots of a cell, by row and column (Unicode, Braille patterns).
const BITS: [[u8; DOTS_X]; DOTS_Y] = [[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]];
/// A step in time longer than so many usual ones is a gap.
const GAP_FACTOR: f64 = 1.75;

/// One line of a chart. A value that is not finite, and a missing row, is a gap.
pub(super) struct Trace {
    /// Time and value, oldest first.
    pub(super) points: Vec<(f64, f64)>,
    pub(super) dashed: bool,
    pub(super) style: Style,
}

/// What the corners of the area stand for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    pub(super) low: f64,
    pub(super) high: f64,
}

/// Draws the traces, later ones over earlier ones.
pub(super) fn draw(traces: &[Trace], bounds: Bounds, area: Rect, buffer: &mut Buffer) {
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
        let position = (
            area.x + (index % width) as u16,
            area.y + (index / width) as u16,
        );
        let symbol = char::from_u32(0x2800 + u32::from(bits)).unwrap_or('?');
        buffer[position].set_char(symbol).set_style(style);
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
        draw(
            &[line(1.0, false), line(-1.0, true)],
            BOUNDS,
            area,
            &mut buffer,
        );
        let text: Vec<String> = (0..2)
            .map(|y| (0..4).map(|x| buffer[(x, y)].symbol()).collect())
            .collect();
        assert_eq!(text, ["⠉⠉⠉⠉", "⣀ ⣀ "]);
    }
}
