//! Charts over one time axis: voltage; current; speed, measured and of the model, or with a loop its reference; and the
//! innovation of the on-line estimators.
//! Lines are drawn with Braille dots: every column shows the smallest and the largest value in it.

use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use crate::report::plot::axis::Domain;
use crate::tui::plot::{
    self, Bounds, LABELS, Stroke, Trace, across, framed, longest_step_s, range, tick,
};
use crate::tui::theme;
use drivebench_bench::{Snapshot, TracePoint};
use drivebench_model::sample::Channel;
use drivebench_model::text::number::{MISSING, significant};
use drivebench_model::units::rpm_from_rad_s;

/// From this width on the legend is written out.
const WIDE: u16 = 62;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Chart {
    Voltage,
    Current,
    Speed,
    /// What the on-line estimators add to their prediction of the speed.
    Innovation,
}

impl Chart {
    const fn look(self) -> (Channel, Style) {
        match self {
            Self::Voltage => (Channel::Voltage, theme::VOLTAGE),
            Self::Current => (Channel::Current, theme::CURRENT),
            Self::Speed | Self::Innovation => (Channel::Speed, theme::SPEED),
        }
    }

    const fn value(self, point: &TracePoint) -> f64 {
        match self {
            Self::Voltage => point.voltage_v,
            Self::Current => point.current_a,
            Self::Speed => point.speed_rad_s,
            Self::Innovation => f64::NAN,
        }
    }
}

/// Draws the last `window_s` seconds; where there is little room, the speed comes first. `halted`: why the view does not move.
pub(super) fn scope(
    snapshot: &Snapshot,
    window_s: f64,
    halted: Option<&str>,
    area: Rect,
    buffer: &mut Buffer,
) {
    let area = area.intersection(buffer.area);
    if area.height < 2 || area.width < LABELS + 2 {
        return;
    }
    let has_innovations = snapshot.innovations.iter().any(|p| p.speed_rad_s.is_finite());
    let charts: &[Chart] = match (area.height - 1) / 3 {
        0 | 1 => &[Chart::Speed],
        2 => &[Chart::Current, Chart::Speed],
        _ if !has_innovations || area.height <= 16 => {
            &[Chart::Voltage, Chart::Current, Chart::Speed]
        }
        _ => &[Chart::Voltage, Chart::Current, Chart::Speed, Chart::Innovation],
    };
    let (from_s, to_s) = window(&snapshot.trace, window_s);
    let trace = &snapshot.trace;
    let first = trace.partition_point(|point| point.time_s < from_s);
    // One point before the left edge, so that the line enters the chart and does not begin in it.
    let points = trace.get(first.saturating_sub(1)..).unwrap_or_default();
    let mut rows = vec![Constraint::Fill(1); charts.len()];
    rows.push(Constraint::Length(1));
    let areas = Layout::vertical(rows).split(area);
    for (chart, chart_area) in charts.iter().zip(areas.iter()) {
        draw(*chart, snapshot, points, (from_s, to_s), *chart_area, buffer);
    }
    if let Some(chart_area) = areas.last() {
        time_axis(from_s, to_s, halted, *chart_area, buffer);
    }
}

/// The time axis grows from the first point and then scrolls. Points that are not kept any more leave no empty part.
fn window(points: &[TracePoint], wanted_s: f64) -> (f64, f64) {
    let times = points.iter().map(|point| point.time_s).filter(|time_s| time_s.is_finite());
    let (first, last) = times.fold((f64::NAN, f64::NAN), |(first, last): (f64, f64), time_s| {
        (first.min(time_s), last.max(time_s))
    });
    if !first.is_finite() {
        return (0.0, wanted_s);
    }
    let kept_s = last - first;
    let length_s = if first > 0.0 && kept_s > 0.0 && kept_s < wanted_s { kept_s } else { wanted_s };
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
        points.iter().map(|point| (point.time_s, value(point))).collect()
    };
    let innovations = snapshot.innovations.iter();
    let measured = match chart {
        Chart::Innovation => innovations.map(|point| (point.time_s, point.speed_rad_s)).collect(),
        _ => trace(&|point| chart.value(point)),
    };
    // A speed loop is compared with its reference: the model does not have a load that changes.
    let follows = points.iter().any(|point| point.reference_rad_s.is_finite());
    let model = match chart {
        Chart::Speed if follows => trace(&|point| point.reference_rad_s),
        Chart::Speed => trace(&|point| point.model_speed_rad_s),
        _ => Vec::new(),
    };
    let values = bounds(&measured, &model);
    let newest = measured.last().map_or(f64::NAN, |point| point.1);
    let title = title(chart, snapshot, follows, newest, area.width);
    let plot_area = framed(&title, values, area, buffer);
    let line = |points: Vec<(f64, f64)>, stroke, style| Trace {
        longest_s: longest_step_s(points.len(), |k| points[k].0),
        ..Trace::new(points, stroke, style)
    };
    let traces =
        [line(model, Stroke::Dashed, theme::MODEL), line(measured, Stroke::Solid, chart.look().1)];
    let (from, to) = (from_s, to_s);
    plot::plot(&traces, Bounds { x: Domain { from, to }, y: values }, plot_area, buffer);
}

fn title(
    chart: Chart,
    snapshot: &Snapshot,
    follows: bool,
    newest: f64,
    width: u16,
) -> Line<'static> {
    let (channel, style) = chart.look();
    let name = match chart {
        Chart::Innovation if width < WIDE => "innovation of the speed,",
        Chart::Innovation => "innovation: speed less its prediction,",
        _ => channel.name(),
    };
    let mut line = Line::from(Span::styled(format!("{name} {} ", channel.unit()), theme::BOLD));
    line.push_span(Span::styled(reading(newest), style));
    if chart == Chart::Speed {
        let rpm = rpm_from_rad_s(newest);
        let rpm = if rpm.is_finite() && rpm.abs() < 1e6 {
            format!(", {rpm:.0} r/min")
        } else {
            format!(", {MISSING} r/min")
        };
        // The names of the lines come first.
        line.extend((width >= 46).then(|| Span::raw(rpm)));
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

/// Two decimals, so that the digits keep their places.
fn reading(value: f64) -> String {
    if value.abs() < 1e5 { format!("{value:.2}") } else { significant(value, 4) }
}

/// Round bounds that contain the measurement and zero; a diverging model does not compress the measurement.
fn bounds(measured: &[(f64, f64)], model: &[(f64, f64)]) -> Domain {
    let values = |points: &[(f64, f64)]| range(points.iter().map(|point| point.1));
    let both = match (values(measured), values(model)) {
        (Some(own), Some(model)) => {
            let room = 0.5 * (own.to.max(0.0) - own.from.min(0.0));
            own.with([model.from.max(own.from - room), model.to.min(own.to + room)])
        }
        (Some(range), None) | (None, Some(range)) => range,
        (None, None) => Domain { from: 0.0, to: 1.0 },
    };
    both.with([0.0, 0.0]).rounded()
}

fn time_axis(from_s: f64, to_s: f64, halted: Option<&str>, area: Rect, buffer: &mut Buffer) {
    let middle =
        halted.map_or_else(|| format!("{} s", seconds(f64::midpoint(from_s, to_s))), str::to_owned);
    let [left, right] = [from_s, to_s].map(|time_s| format!("{} s", seconds(time_s)));
    let style = if halted.is_some() { theme::CAREFUL } else { theme::DIM };
    across([&left, &middle, &right], style, area, buffer);
}

fn seconds(time_s: f64) -> String {
    if time_s.abs() < 1e6 { format!("{time_s:.1}") } else { tick(time_s) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_round_hold_zero_and_ignore_a_runaway_model() {
        let measured: Vec<_> = (0..=100).map(|k| (f64::from(k), f64::from(k))).collect();
        let runaway = [(0.0, -1e9), (1.0, 1e12), (2.0, f64::INFINITY)];
        for (measured, model, (from, to)) in [
            (&measured[..], &[][..], (0.0, 100.0)),
            (&measured[..], &runaway[..], (-50.0, 150.0)),
            (&[][..], &[][..], (0.0, 1.0)),
            (&[(0.0, 0.0)][..], &[(0.0, f64::NAN)][..], (-1.0, 1.0)),
        ] {
            assert_eq!(bounds(measured, model), Domain { from, to });
        }
    }

    #[test]
    fn the_window_grows_then_scrolls_and_few_points_fill_it() {
        let point = |time_s| TracePoint {
            time_s,
            voltage_v: 0.0,
            current_a: 0.0,
            speed_rad_s: 0.0,
            model_speed_rad_s: 0.0,
            reference_rad_s: f64::NAN,
            command_v: f64::NAN,
            applied_s: f64::NAN,
        };
        assert_eq!(window(&[], 10.0), (0.0, 10.0));
        assert_eq!(window(&[point(0.0), point(3.0)], 10.0), (0.0, 10.0));
        assert_eq!(window(&[point(0.0), point(30.0)], 10.0), (20.0, 30.0));
        assert_eq!(window(&[point(28.0), point(30.0)], 10.0), (28.0, 30.0));
    }
}
