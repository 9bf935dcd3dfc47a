//! Decimation of a line to the columns of a picture: the smallest and the largest of each are kept, and so are gaps.

use drivebench_model::numerics::statistics::median_step;

/// A step in time longer than this multiple of the median is a gap: one lost sample makes a step of two.
pub const GAP: f64 = 1.8;

/// Pieces of a line between its gaps.
pub(super) type Pieces = Vec<Vec<(f64, f64)>>;

/// Cuts `(time, value)` where values are missing.
///
/// A cell may be empty because its row belongs to another quantity, so an empty cell alone is no gap: a line is cut
/// where the next value comes later than usual.
pub(super) fn pieces(points: impl IntoIterator<Item = (f64, f64)>) -> Pieces {
    let present: Vec<(f64, f64)> = points
        .into_iter()
        .filter(|(time_s, value)| time_s.is_finite() && value.is_finite())
        .collect();
    let times: Vec<f64> = present.iter().map(|point| point.0).collect();
    let longest = GAP * median_step(&times);
    let mut pieces = Pieces::new();
    for point in present {
        match pieces.last_mut() {
            Some(piece) if piece.last().is_some_and(|last| point.0 - last.0 <= longest) => {
                piece.push(point);
            }
            _ => pieces.push(vec![point]),
        }
    }
    pieces
}

/// A commanded value with its corners: held from each event to the next, the last one until `end_s`.
pub(super) fn held(events: &[(f64, f64)], end_s: f64) -> Pieces {
    let mut line: Vec<(f64, f64)> = Vec::with_capacity(2 * events.len() + 1);
    let present =
        events.iter().copied().filter(|(time_s, value)| time_s.is_finite() && value.is_finite());
    for (time_s, value) in present {
        if let Some(&(_, before)) = line.last()
            && (before - value).abs() > 0.0
        {
            line.push((time_s, before));
        }
        line.push((time_s, value));
    }
    if let Some(&(time_s, value)) = line.last()
        && end_s > time_s
    {
        line.push((end_s, value));
    }
    if line.is_empty() { Pieces::new() } else { vec![line] }
}

/// At most four points per column of the picture, whatever the number of samples: the extremes of every column stay, and
/// gaps narrower than a column, which would not show, are closed.
pub(super) fn decimate(pieces: &Pieces, from: f64, to: f64, columns: usize) -> Pieces {
    let width = (to - from) / columns.max(1) as f64;
    let column = |time: f64| ((time - from) / width).floor();
    let mut out = Pieces::new();
    let mut line = Vec::new();
    let mut last_time = f64::NEG_INFINITY;
    for piece in pieces.iter().filter(|piece| !piece.is_empty()) {
        if piece[0].0 - last_time > width && !line.is_empty() {
            out.push(std::mem::take(&mut line));
        }
        last_time = piece[piece.len() - 1].0;
        let mut rest = piece.as_slice();
        while let Some(first) = rest.first() {
            let number = column(first.0);
            let same = |time: f64| (column(time) - number).abs() < 0.5;
            let (points, after) = rest.split_at(rest.partition_point(|point| same(point.0)));
            push_extremes(&mut line, points, same);
            rest = after;
        }
    }
    if !line.is_empty() {
        out.push(line);
    }
    out
}

/// Adds the smallest and largest point of one column in order of time, and the last one, where the line continues.
/// What the line already holds of the same column, from before a gap that was closed, is merged.
fn push_extremes(line: &mut Vec<(f64, f64)>, points: &[(f64, f64)], same: impl Fn(f64) -> bool) {
    let kept = line.iter().rev().take_while(|point| same(point.0)).count();
    let mut all = line.split_off(line.len() - kept);
    all.extend_from_slice(points);
    let extreme = |better: fn(f64, f64) -> bool| {
        (0..all.len()).fold(
            0,
            |best, index| {
                if better(all[index].1, all[best].1) { index } else { best }
            },
        )
    };
    let mut chosen = [0, extreme(|a, b| a < b), extreme(|a, b| a > b), all.len() - 1];
    chosen.sort_unstable();
    let mut before = None;
    for index in chosen {
        if before != Some(index) {
            line.push(all[index]);
        }
        before = Some(index);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_lost_sample_cuts_the_line_and_an_interleaved_row_does_not() {
        let lost: Vec<(f64, f64)> =
            (0..10).map(|k| (f64::from(k), if k == 4 { f64::NAN } else { 1.0 })).collect();
        assert_eq!(pieces(lost).len(), 2);
        let interleaved: Vec<(f64, f64)> =
            (0..20).map(|k| (f64::from(k), if k % 2 == 0 { f64::NAN } else { 1.0 })).collect();
        assert_eq!(pieces(interleaved).len(), 1);
        assert!(pieces([(0.0, f64::NAN)]).is_empty());
    }

    #[test]
    fn a_command_is_drawn_with_corners_to_the_end() {
        let line = held(&[(0.0, 1.0), (2.0, 3.0), (2.5, f64::NAN)], 4.0);
        assert_eq!(line, [vec![(0.0, 1.0), (2.0, 1.0), (2.0, 3.0), (4.0, 3.0)]]);
        assert!(held(&[], 1.0).is_empty());
    }

    #[test]
    fn gaps_wider_than_a_column_stay() {
        let line = vec![vec![(0.0, 0.0), (1.0, 0.0)], vec![(1.01, 1.0)], vec![(9.0, 1.0)]];
        assert_eq!(decimate(&line, 0.0, 10.0, 10).len(), 2);
    }

    proptest! {
        #[test]
        fn points_are_bounded_and_extremes_stay(
            values in prop::collection::vec(prop_oneof![8 => -5.0..5.0f64, 1 => Just(f64::NAN)], 1..4000),
            columns in 1..60usize,
        ) {
            let n = values.len();
            let cut = pieces(values.iter().enumerate().map(|(k, value)| (k as f64, *value)));
            let out = decimate(&cut, 0.0, n as f64, columns);
            let count: usize = out.iter().map(Vec::len).sum();
            prop_assert!(count <= 8 * (columns + 1), "{count} points in {columns} columns");
            let shown: Vec<f64> = out.iter().flatten().map(|point| point.1).collect();
            let fold = |values: &[f64]| values.iter().copied().filter(|v| v.is_finite())
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
            prop_assert_eq!(fold(&shown), fold(&values));
            prop_assert!(shown.iter().all(|value| value.is_finite()));
            for piece in &out {
                prop_assert!(piece.windows(2).all(|pair| pair[1].0 >= pair[0].0));
            }
        }
    }
}
