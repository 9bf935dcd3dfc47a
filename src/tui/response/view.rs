//! The page of the frequency response as a function of its state.

use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::{ResponsePage, ResponseScreen};
use crate::tui::frame::{help, hint_rows, hints, is_too_small, row, text, titled_with};
use crate::tui::keys::On;
use crate::tui::plot::{Bounds, LABELS, Stroke, Trace, plot, range, round, value_axis};
use crate::tui::theme;
use drivebench_identify::frequency_response::{
    CARRIED, Compared, Departure, PathwayResponse, ResponsePoint,
};
use drivebench_model::text::number::{shortest, significant};

/// Rows from which on phase and coherence have a panel.
const WITH_PHASE: u16 = 12;
const WITH_COHERENCE: u16 = 18;
/// Rows of what is said above the panels at the most, on a tall page and on a low one.
const MOST_SAID: usize = 4;
const TALL: u16 = 20;
/// Columns between two labels of the axis.
const APART: u16 = 2;

const MEANING: [&str; 3] = [
    "Solid: measured, where the excitation carries it; dotted: its 95 % interval. Dashed: the model, by the same estimator.",
    "Coherence: share of what was measured that the voltage explains; below 0.8 a point is not carried.",
    "A resonance is named only where it is known well enough: none named is not none there.",
];

/// What a panel shows.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Shows {
    Magnitude,
    Phase,
    Coherence,
}

impl Shows {
    fn value(self, point: &ResponsePoint) -> f64 {
        match self {
            Self::Magnitude => decibel(point.magnitude),
            Self::Phase => point.phase_deg,
            Self::Coherence => point.coherence,
        }
    }

    /// Ends of the interval; none where there is none.
    fn interval(self, point: &ResponsePoint) -> [f64; 2] {
        match self {
            Self::Magnitude => [point.magnitude_low, point.magnitude_high].map(decibel),
            Self::Phase => {
                let half = point.phase_half_width_deg;
                [point.phase_deg - half, point.phase_deg + half]
            }
            Self::Coherence => [f64::NAN; 2],
        }
    }
}

fn decibel(magnitude: f64) -> f64 {
    20.0 * magnitude.log10()
}

/// The page as a screen of its own.
pub(super) fn screen(screen: &ResponseScreen, frame: &mut Frame<'_>) {
    let area = frame.area();
    let buffer = frame.buffer_mut();
    if is_too_small("frequency response", "q leaves", theme::PLAIN, area, buffer) {
        return;
    }
    let bottom = hint_rows(screen.message.as_deref(), area.width, 2);
    let [top, body, bottom] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Fill(1),
        Constraint::Length(bottom),
    ])
    .areas(area);
    let title = format!(" frequency response: {}", screen.title);
    row(&Line::styled(title, theme::BOLD), top, buffer);
    view(&screen.page, body, buffer);
    if let Some(first) = screen.help {
        let hidden = help(On::Response, &MEANING, first, body, buffer);
        screen.hidden.set(hidden);
    }
    let (keys, always) = if screen.help.is_some() {
        ("Up Down scroll", "any other key closes the help")
    } else {
        (ResponsePage::KEYS, "? help  q leave")
    };
    let keys: Vec<&str> = keys.split('|').collect();
    hints(screen.message.as_deref(), &keys, always, bottom, buffer);
}

/// Draws the page.
pub(in crate::tui) fn view(page: &ResponsePage, area: Rect, buffer: &mut Buffer) {
    let area = area.intersection(buffer.area);
    let Some((compared, own)) = page.shown() else {
        let text = " no frequency response: neither current nor speed was measured";
        row(&Line::styled(text, theme::DIM), area, buffer);
        return;
    };
    let all = compared.measured.pathways.len();
    let place = match all {
        1 => String::new(),
        all => format!("Tab: one of {all} pathways"),
    };
    let inner = titled_with(own.pathway.name(), &place, area, buffer);
    if inner.height < 3 || inner.width < LABELS + 4 {
        return;
    }
    let said = said(compared, own);
    let most = if inner.height >= TALL { MOST_SAID } else { 1 };
    let rows = said.len().min(most) as u16;
    let shown: &[(Shows, u16)] = match inner.height {
        height if height >= WITH_COHERENCE => &[
            (Shows::Magnitude, 4),
            (Shows::Phase, 3),
            (Shows::Coherence, 2),
        ],
        height if height >= WITH_PHASE => &[(Shows::Magnitude, 4), (Shows::Phase, 3)],
        _ => &[(Shows::Magnitude, 1)],
    };
    let mut heights = vec![Constraint::Length(rows)];
    heights.extend(shown.iter().map(|(_, share)| Constraint::Fill(*share)));
    heights.push(Constraint::Length(1));
    let areas = Layout::vertical(heights).split(inner);
    let said = said.into_iter().take(most);
    let said: Vec<Line<'static>> = said
        .map(|(told, style)| Line::styled(format!(" {told}"), style))
        .collect();
    text(said, areas[0], buffer);
    let Some((from, to)) = range(own.points.iter().map(|point| point.frequency_hz.log10())) else {
        return;
    };
    let to = if to > from { to } else { from + 1.0 };
    for ((shows, _), area) in shown.iter().zip(&areas[1..]) {
        panel(page, (compared, own), *shows, (from, to), *area, buffer);
    }
    if let Some(last) = areas.last() {
        frequency_axis((from, to), *last, buffer);
    }
}

/// Modes, then where the model departs, then what limits it: what matters most first.
fn said(compared: &Compared, own: &PathwayResponse) -> Vec<(String, Style)> {
    let measured = &compared.measured;
    let modes = measured.modes_of(own.pathway);
    let mut said = Vec::new();
    if own.bands_hz().is_empty() {
        said.push((
            "the excitation carries no frequency of this pathway".to_owned(),
            theme::CAREFUL,
        ));
    } else if modes.is_empty() {
        said.push((
            "no resonance is named where it is carried".to_owned(),
            theme::PLAIN,
        ));
    }
    said.extend(modes.iter().map(|mode| (mode.text(), theme::BOLD)));
    let bands = compared.departures.iter();
    let bands = bands.filter(|band| band.pathway == own.pathway);
    said.extend(bands.map(|band: &Departure| (band.sentence(), theme::BAD)));
    let cautions = measured.cautions.iter().cloned();
    said.extend(cautions.map(|caution| (caution, theme::CAREFUL)));
    said.push((measured.rate_sentence(), theme::DIM));
    said
}

fn panel(
    page: &ResponsePage,
    (compared, own): (&Compared, &PathwayResponse),
    shows: Shows,
    (from, to): (f64, f64),
    area: Rect,
    buffer: &mut Buffer,
) {
    if area.height < 2 {
        return;
    }
    let beside = compared.model.as_ref();
    let beside = beside.and_then(|model| model.of(own.pathway));
    let beside = beside.filter(|_| shows != Shows::Coherence);
    row(
        &title(page, own, beside, shows),
        Rect { height: 1, ..area },
        buffer,
    );
    let inner = Rect {
        x: area.x + LABELS,
        y: area.y + 1,
        width: area.width - LABELS,
        height: area.height - 1,
    };
    let carried = own.points.iter().filter(|point| point.is_carried);
    let values = carried.flat_map(|point| {
        let [low, high] = shows.interval(point);
        [shows.value(point), low, high]
    });
    let (low, high) = match shows {
        Shows::Coherence => (0.0, 1.0),
        _ => range(values).map_or((-1.0, 1.0), |(low, high)| round(low, high)),
    };
    value_axis(low, high, inner, buffer);
    let bounds = Bounds {
        from,
        to,
        low,
        high,
    };
    for mode in compared.measured.modes_of(own.pathway) {
        vertical(mode.frequency_hz, '╎', bounds, inner, buffer);
    }
    let cursor = page.cursor.and_then(|at| own.points.get(at));
    if let Some(point) = cursor {
        vertical(point.frequency_hz, '┊', bounds, inner, buffer);
    }
    let traces = traces(own, beside, shows, (low, high));
    plot(&traces, bounds, inner, buffer);
}

/// What is not carried, the interval, what is, and the model, later ones over earlier ones.
fn traces(
    own: &PathwayResponse,
    beside: Option<&PathwayResponse>,
    shows: Shows,
    (low, high): (f64, f64),
) -> Vec<Trace> {
    let line = |points: &[ResponsePoint],
                value: &dyn Fn(&ResponsePoint) -> f64,
                keeps: &dyn Fn(&ResponsePoint, f64) -> bool,
                stroke,
                style| {
        let points = points.iter().map(|point| {
            let value = value(point);
            let value = if keeps(point, value) { value } else { f64::NAN };
            (point.frequency_hz.log10(), value)
        });
        Trace {
            points: points.collect(),
            longest_s: f64::INFINITY,
            stroke,
            style,
            beyond: None,
        }
    };
    // What is not carried is drawn where there is room for it, and moves no axis.
    let inside =
        |point: &ResponsePoint, value: f64| !point.is_carried && (low..=high).contains(&value);
    let is_carried = |point: &ResponsePoint, _: f64| point.is_carried;
    let value = |point: &ResponsePoint| shows.value(point);
    let edge = |end: usize| move |point: &ResponsePoint| shows.interval(point)[end];
    let mut traces = vec![
        Trace {
            // Dots by themselves: between two of them nothing is known.
            longest_s: -1.0,
            ..line(&own.points, &value, &inside, Stroke::Solid, theme::DIM)
        },
        line(
            &own.points,
            &edge(0),
            &is_carried,
            Stroke::Dotted,
            theme::DIM,
        ),
        line(
            &own.points,
            &edge(1),
            &is_carried,
            Stroke::Dotted,
            theme::DIM,
        ),
        line(
            &own.points,
            &value,
            &is_carried,
            Stroke::Solid,
            theme::SPEED,
        ),
    ];
    if let Some(beside) = beside {
        // Beyond what the measurement carries there is nothing to be compared.
        let bands = own.bands_hz();
        let (first_hz, last_hz) = match bands.as_slice() {
            [(first, _), .., (_, last)] | [(first, last)] => (*first, *last),
            [] => (f64::INFINITY, 0.0),
        };
        let measured = |point: &ResponsePoint, value: f64| {
            let is_there = (first_hz..=last_hz).contains(&point.frequency_hz);
            is_there && (low..=high).contains(&value)
        };
        traces.push(line(
            &beside.points,
            &value,
            &measured,
            Stroke::Dashed,
            theme::MODEL,
        ));
    }
    traces
}

fn title(
    page: &ResponsePage,
    own: &PathwayResponse,
    beside: Option<&PathwayResponse>,
    shows: Shows,
) -> Line<'static> {
    let name = match shows {
        Shows::Magnitude => format!(" magnitude, dB of 1 {}", own.unit),
        Shows::Phase => " phase, degrees".to_owned(),
        Shows::Coherence => format!(" coherence, carried from {CARRIED}"),
    };
    let mut title = Line::from(Span::styled(name, theme::BOLD));
    let point = page.cursor.and_then(|at| own.points.get(at));
    let reading = |point: Option<&ResponsePoint>| {
        point.map_or_else(String::new, |point| {
            format!(" {}", significant(shows.value(point), 3))
        })
    };
    let legend = format!("  {} measured{}", Stroke::Solid.sample(), reading(point));
    title.push_span(Span::styled(legend, theme::SPEED));
    if let Some(beside) = beside {
        let other = point.and_then(|point| {
            let mut all = beside.points.iter();
            all.find(|other| other.frequency_hz >= point.frequency_hz)
        });
        let legend = format!("  {} model{}", Stroke::Dashed.sample(), reading(other));
        title.push_span(Span::styled(legend, theme::MODEL));
    }
    if let (Shows::Magnitude, Some(point)) = (shows, point) {
        let at = significant(point.frequency_hz, 3);
        let what = if point.is_carried {
            ""
        } else {
            ", not carried"
        };
        title.push_span(format!("  ┊ {at} Hz{what}"));
    }
    title
}

fn vertical(frequency_hz: f64, mark: char, bounds: Bounds, area: Rect, buffer: &mut Buffer) {
    if let Some(x) = bounds.column(frequency_hz.log10(), area) {
        for y in area.y..area.bottom() {
            buffer[(x, y)].set_char(mark).set_style(theme::DIM);
        }
    }
}

/// 1, 2 and 5 times the powers of ten, as many as there is room for, the powers first.
fn frequency_axis((from, to): (f64, f64), area: Rect, buffer: &mut Buffer) {
    let inner = Rect {
        x: area.x + LABELS,
        width: area.width - LABELS,
        ..area
    };
    let bounds = Bounds {
        from,
        to,
        low: 0.0,
        high: 1.0,
    };
    buffer.set_stringn(area.x, area.y, " Hz", usize::from(LABELS), theme::DIM);
    let mut taken: Vec<(u16, u16)> = Vec::new();
    for factor in [1.0, 2.0, 5.0] {
        for power in (from.floor() as i32)..=(to.ceil() as i32) {
            let hertz = factor * 10.0_f64.powi(power);
            let label = shortest(hertz, 2);
            let width = label.chars().count() as u16;
            let Some(column) = bounds.column(hertz.log10(), inner) else {
                continue;
            };
            let first = column.saturating_sub(width / 2).max(inner.x);
            let (first, end) = (first, first + width);
            let is_free = taken
                .iter()
                .all(|own| end + APART <= own.0 || own.1 + APART <= first);
            if is_free && end <= inner.right() {
                buffer.set_string(first, area.y, &label, theme::DIM);
                taken.push((first, end));
            }
        }
    }
}
