//! The whole frame of the diagnosis as a function of the state: verdict, where it fails, candidates, ladder, keys; and the
//! pages over it: the card of an effect, the curve that the error follows, the map of the error, the next run.

use std::fmt::Write as _;

use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Position, Rect};
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::charts;
use super::list::candidates;
use super::state::{Over, State, Step};
use crate::report::wording::{self, change as change_words, diagnosis as words, location};
use crate::report::{
    Tone, comparison_document, effect_document, error_changes, open_questions, tone,
};
use crate::tui::frame::{
    document, document_lines, hint_rows, hints, is_too_small, row, rows, text, titled,
};
use crate::tui::keys::On;
use crate::tui::response::{self, ResponsePage};
use crate::tui::theme;
use crate::tui::traces::{self, TracesPage};
use drivebench_diagnose::{AddResult, Answer, Diagnosis, DiagnosisVerdict};
use drivebench_model::text::lines::{cut, wrapped};

const MEANING: [&str; 5] = [
    "Errors: free-running model, on a run not used in the fit, in units of the noise.",
    "Per cent: probability of the effect, computed together with all the others.",
    "supported: 90 % and more. possible: 10 to 90 %. ruled out: less; the size is an upper bound.",
    "not excited: this run would not show it. detectable from: the smallest size that would have been named.",
    "A name is an equation, not a cause: the card lists causes that share it.",
];

struct Areas {
    top: Rect,
    verdict: Rect,
    failing: Rect,
    strip: Rect,
    list: Rect,
    ladder: Rect,
    bottom: Rect,
}

impl Areas {
    /// All between the verdict and the keys: the area of a page over it.
    fn body(&self) -> Rect {
        let parts = [self.failing, self.strip, self.list, self.ladder];
        Rect { height: parts.iter().map(|part| part.height).sum(), ..self.failing }
    }
}

fn areas(state: &State, area: Rect) -> Areas {
    let tall = area.height >= 20;
    let verdict_room = usize::from(area.width).saturating_sub(1);
    let most_rows = usize::from(state.stopped.is_some()) + if tall { 3 } else { 1 };
    let verdict_rows = verdict_lines(state)
        .iter()
        .map(|line| wrapped(&line.to_string(), verdict_room).len())
        .sum::<usize>();
    let most = match area.height {
        0..=11 => 0,
        12..=19 => 4,
        20..=29 => 8,
        _ => 9,
    };
    let failing_rows = failing_lines(state, area.width).len() as u16 + 1;
    let failing_rows = failing_rows.min(most);
    let rungs = state.ladder.len().min(5) as u16;
    let change_rows = u16::try_from(changes(state, area.width).len()).unwrap_or(0);
    let strip_rows = strip_rows(state, area);
    let ladder_rows = match area.height {
        0..=13 => 0,
        _ if rungs == 0 => 0,
        14..=19 => 2 + change_rows.min(1),
        _ => 1 + rungs + change_rows,
    };
    let bottom_rows = hint_rows(state.message.as_deref(), area.width, if tall { 4 } else { 2 });
    let [top, verdict, failing, strip, list, ladder, bottom] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(verdict_rows.clamp(1, most_rows) as u16),
        Constraint::Length(failing_rows),
        Constraint::Length(strip_rows),
        Constraint::Fill(1),
        Constraint::Length(ladder_rows),
        Constraint::Length(bottom_rows),
    ])
    .areas(area);
    Areas { top, verdict, failing, strip, list, ladder, bottom }
}

/// Selects the row or sets the cursor of traces or curve at the click; else a message says that there is nothing.
pub(super) fn click(state: &mut State, at: Position, area: Rect) {
    let areas = areas(state, area);
    let body = areas.body();
    let is_taken = match state.over {
        _ if state.help.first.is_some() => false,
        _ if !body.contains(at) => false,
        Over::Traces => state.traces.click(at.x, body),
        Over::Curve(index, _) => {
            let point = charts::point_at(state, index, at.x, body);
            state.over = Over::Curve(index, point);
            point.is_some()
        }
        Over::Nothing if state.only_compares() => {
            areas.list.contains(at) && state.traces.click(at.x, areas.list)
        }
        Over::Nothing if areas.strip.contains(at) => state.traces.click(at.x, areas.strip),
        Over::Nothing => {
            areas.list.contains(at) && state.select_drawn(at.y - areas.list.y, areas.list)
        }
        _ => false,
    };
    state.message = (!is_taken).then(|| "there is nothing to select there".to_owned());
}

pub(super) fn view(state: &State, frame: &mut Frame<'_>) {
    let area = frame.area();
    let buffer = frame.buffer_mut();
    if is_too_small("too small", "q = leave", theme::CAREFUL, area, buffer) {
        return;
    }
    let areas = areas(state, area);
    let body = areas.body();
    top_bar(state, areas.top, buffer);
    text(verdict_lines(state), inset(areas.verdict), buffer);
    match state.over {
        Over::Nothing => {
            failing(state, areas.failing, buffer);
            if state.only_compares() {
                traces::view(&state.traces, areas.list, buffer);
            } else {
                traces::strip(&state.traces, areas.strip, buffer);
                candidates(state, areas.list, buffer);
            }
            ladder(state, areas.ladder, buffer);
        }
        _ if body.height == 0 => {}
        Over::Card(line) => card(state, line, body, buffer),
        Over::Map(index) => charts::map(state, index, body, buffer),
        Over::Traces => traces::view(&state.traces, body, buffer),
        Over::Response => response::view(&state.response, body, buffer),
        Over::Next(line) => next(state, line, body, buffer),
        Over::Curve(index, cursor) => charts::curve(state, index, cursor, body, buffer),
    }
    let under_top =
        Rect { y: area.y + 1, height: area.height.saturating_sub(1 + areas.bottom.height), ..area };
    state.help.draw(On::Diagnosis, &MEANING, under_top, buffer);
    let (keys, always) = keys(state);
    hints(state.message.as_deref(), &keys, always, areas.bottom, buffer);
}

/// Rows of the traces on the page itself, where it is large.
fn strip_rows(state: &State, area: Rect) -> u16 {
    if state.traces.is_empty() || state.only_compares() || area.height < 36 {
        return 0;
    }
    (area.height / 4).min(14)
}

fn top_bar(state: &State, area: Rect, buffer: &mut Buffer) {
    let work = match (&state.working, &state.failure) {
        (Some(work), _) => Span::styled(format!(" … {work} "), theme::CAREFUL),
        (None, _) if state.writing => Span::styled(" … writing the model ", theme::CAREFUL),
        (None, Some(_)) => Span::styled(" FAILED ", theme::BAD),
        (None, None) => Span::styled(" ready ", theme::GOOD),
    };
    let width = (work.width() as u16).min(area.width);
    let screen = if state.is_a_comparison() { " COMPARISON " } else { " DIAGNOSIS " };
    let room = usize::from(area.width - width).saturating_sub(screen.len());
    let title = Line::from(vec![
        Span::styled(screen, theme::BOLD),
        Span::styled(cut(&state.title, room), theme::DIM),
    ]);
    row(&title, area, buffer);
    row(&Line::from(work), Rect { x: area.right() - width, width, ..area }, buffer);
}

/// How the run was stopped, where it did not go to its end, and the verdict.
fn verdict_lines(state: &State) -> Vec<Line<'static>> {
    let stopped = state.stopped.iter().map(|text| Line::styled(text.clone(), theme::BAD));
    stopped.chain([verdict_line(state)]).collect()
}

fn verdict_line(state: &State) -> Line<'static> {
    if let Some(failure) = &state.failure {
        return Line::styled(format!("ERROR: {failure}"), theme::BAD);
    }
    if let (true, Some(comparison)) = (state.only_compares(), &state.comparison) {
        return Line::styled(location::failure(comparison), theme::BOLD);
    }
    let Some(diagnosis) = &state.diagnosis else {
        let judged = state.judged.values();
        let screened = judged.clone().filter(|judged| judged.share.is_some());
        let refitted = judged.filter(|judged| judged.error.is_some());
        let (screened, refitted) = (screened.count(), refitted.count());
        let mut text = format!("{screened} effects screened, {refitted} refitted");
        for (id, error) in &state.accepted {
            let _ = write!(text, "; {id} accepted, held-out error {error:.2}");
        }
        return Line::styled(text, theme::CAREFUL);
    };
    let (verdict_label, style) = verdict_label(diagnosis);
    let rest = words::after_name(diagnosis);
    let colon = if rest.is_empty() { "" } else { ": " };
    let mut line = Line::from(Span::styled(format!("{verdict_label}{colon}"), style));
    line.push_span(rest);
    let names_effects =
        matches!(diagnosis.verdict, DiagnosisVerdict::Effect | DiagnosisVerdict::Ambiguous);
    if names_effects && !diagnosis.sufficient {
        line.push_span("; not sufficient: more than noise is unexplained");
    }
    if !diagnosis.limits.is_empty() {
        line.push_span("; n shows the limits of this diagnosis");
    }
    if !state.curves().is_empty() {
        line.push_span("; c shows the curve of the error, t adds it");
    }
    line
}

/// One column in from the left.
fn inset(area: Rect) -> Rect {
    Rect { x: area.x + area.width.min(1), width: area.width.saturating_sub(1), ..area }
}

/// The verdict as on page and card, with a mark that the colour only repeats.
fn verdict_label(diagnosis: &Diagnosis) -> (String, Style) {
    let answer = diagnosis.answer();
    let (mark, style) = match (tone(answer), answer) {
        (Tone::Good, _) => ("✓", theme::GOOD),
        (Tone::Bad, _) => ("✗", theme::BAD),
        (_, Answer::Ambiguous | Answer::NothingFound) => ("?", theme::CAREFUL),
        _ => ("~", theme::CAREFUL),
    };
    (format!("{mark} {}", words::answer(answer).to_uppercase()), style)
}

/// The keys that act now, by priority, and those that are always shown.
fn keys(state: &State) -> (Vec<&'static str>, &'static str) {
    const LEAVE: &str = "? help  q leave";
    let followed = state.curves().len();
    let drawn = state.drawn().len();
    let (keys, always) = match state.over {
        _ if state.help.first.is_some() => ("Up Down scroll", "any other key closes the help"),
        Over::Traces if state.traces.is_choosing() => ("Up Down select|Enter show", "Esc back"),
        Over::Traces => (TracesPage::KEYS, "v Esc back"),
        Over::Response => (ResponsePage::KEYS, "g Esc back"),
        Over::Card(_) => ("Up Down scroll|a add|r remove", "Esc back"),
        Over::Next(_) => ("Up Down scroll", "n Esc back"),
        Over::Map(0) => ("e the other equation", "Esc back"),
        Over::Map(_) => ("", "e Esc back"),
        Over::Curve(index, _) if index + 1 < drawn => {
            ("c the next curve|Left Right cursor|t add curve", "Esc back")
        }
        Over::Curve(..) if followed > 0 => ("Left Right cursor|t add curve", "c Esc back"),
        Over::Curve(..) => ("Left Right cursor|a add|r remove", "c Esc back"),
        Over::Nothing if state.failure.is_some() && state.diagnosis.is_none() => {
            let keys = match (state.traces.is_empty(), state.has_map()) {
                (false, true) => "v traces|e map",
                (false, false) => "v traces",
                (true, true) => "e map",
                (true, false) => "",
            };
            (keys, LEAVE)
        }
        Over::Nothing if state.only_compares() => {
            ("d diagnose|v traces|j worst place|c curve|g frequency|e map", LEAVE)
        }
        Over::Nothing if state.working.is_some() => {
            ("v traces|Up Down select|Enter card|e map", LEAVE)
        }
        Over::Nothing if followed > 0 => {
            ("c curve|t add it|v traces|a add|r remove|w write|n next run|e map", LEAVE)
        }
        Over::Nothing if state.ladder.len() > 1 => (
            "a add|v traces|c curve|r remove|u undo|b before|w write|n next run|Enter card|e map",
            LEAVE,
        ),
        Over::Nothing => {
            ("a add|v traces|c curve|r remove|w write|Enter card|n next run|e map", LEAVE)
        }
    };
    (keys.split('|').filter(|key| !key.is_empty()).collect(), always)
}

/// How good the model is and where it fails: figures, lights, places.
fn failing(state: &State, area: Rect, buffer: &mut Buffer) {
    if area.height == 0 {
        return;
    }
    let title = if state.before {
        "BEFORE the last change, held-out run: fit, error, where it failed"
    } else {
        "held-out run: fit, error, where it fails"
    };
    let inner = titled(title, area, buffer);
    let lines = failing_lines(state, inner.width);
    rows(&lines, inner, buffer);
}

fn failing_lines(state: &State, width: u16) -> Vec<Line<'static>> {
    let Some(comparison) = state.compared() else {
        return vec![Line::styled(" comparing ...", theme::DIM)];
    };
    let document = comparison_document(comparison);
    document_lines(document.rows(usize::from(width.saturating_sub(2)))).collect()
}

const NAME: usize = 26;

/// The ladder: the held-out error of every model so far, with the noise floor.
fn ladder(state: &State, area: Rect, buffer: &mut Buffer) {
    if area.height == 0 {
        return;
    }
    let floor = state.is_floor_known();
    let title = if floor {
        "ladder: held-out error, times the noise (│ = noise floor)"
    } else {
        "ladder: held-out error, times the baseline's residual (no floor is known)"
    };
    let inner = titled(title, area, buffer);
    let mut lines = changes(state, inner.width);
    let room = usize::from(inner.height).saturating_sub(lines.len());
    let errors = state.ladder.iter().map(|step| step.error);
    let largest = errors.filter(|error| error.is_finite()).fold(1.0, f64::max);
    let hidden = state.ladder.len().saturating_sub(room);
    let width = usize::from(inner.width);
    let before = std::iter::once(None).chain(state.ladder.iter().map(Some));
    lines.extend(before.zip(&state.ladder).enumerate().skip(hidden).map(
        |(index, (before, step))| {
            // The bar of the last change moves from the length of the one above it; the figure is final at once.
            let is_last = index + 1 == state.ladder.len();
            let from = before.filter(|_| is_last).map_or(step.error, |before| before.error);
            rung(step, from + state.fallen_share() * (step.error - from), largest, floor, width)
        },
    ));
    rows(&lines, inner, buffer);
}

/// Result of the last change, in up to three rows.
fn changes(state: &State, width: u16) -> Vec<Line<'static>> {
    let Some((added, result)) = &state.change else {
        return Vec::new();
    };
    let (text, style) = change(*added, result);
    let rows = wrapped(&text, usize::from(width).saturating_sub(1)).into_iter().take(3);
    rows.map(|row| Line::styled(format!(" {row}"), style)).collect()
}

fn rung(step: &Step, bar: f64, largest: f64, floor: bool, width: usize) -> Line<'static> {
    let length = width.saturating_sub(NAME + 26).clamp(4, 60);
    // The floor has a cell of its own, also when the error is at it.
    let cell = |error: f64| ((error / largest).clamp(0.0, 1.0) * length as f64).round() as usize;
    let (full, mark) = (cell(bar), floor.then(|| cell(1.0)));
    let bar: String = (0..=length)
        .map(|at| match (Some(at) == mark, at < full) {
            (true, _) => '│',
            (false, true) => '█',
            (false, false) => ' ',
        })
        .collect();
    let (style, verdict_label) =
        if step.at_floor { (theme::GOOD, " at the floor") } else { (theme::CAREFUL, "") };
    Line::from(vec![
        Span::raw(format!(" {:<NAME$} ", cut(&step.name, NAME))),
        Span::styled(bar, style),
        Span::styled(format!(" {:>6.2}", step.error), theme::BOLD),
        Span::raw(verdict_label),
    ])
}

/// Result of the last change: before and after, or why it was refused.
fn change(added: bool, result: &AddResult) -> (String, Style) {
    let reason = || change_words::change(result);
    if !result.accepted {
        return (format!("✗ refused: {}", reason()), theme::CAREFUL);
    }
    if result.forced {
        return (format!("~ {}: {}", result.effect, reason()), theme::CAREFUL);
    }
    let verdict_label = if added { "added" } else { "removed" };
    let figures = error_changes(result);
    let mut text = format!("✓ {verdict_label} {}: {figures}", result.effect);
    if let Some([before, after]) = &result.confirm {
        let (before, after) = (before.holdout_rmse, after.holdout_rmse);
        let times = wording::times(result.before.noise_floor_from);
        let _ = write!(text, "; confirming run {before:.2} -> {after:.2} {times}");
    }
    (text, theme::GOOD)
}

fn card(state: &State, first: usize, area: Rect, buffer: &mut Buffer) {
    let Some(effect) = state.row().and_then(|row| row.effect()) else {
        return;
    };
    let card = effect_document(effect, state.candidate(effect.card().id));
    state.hidden.set(document(&card, first, area, buffer));
}

fn next(state: &State, first: usize, area: Rect, buffer: &mut Buffer) {
    let Some(diagnosis) = &state.diagnosis else {
        return;
    };
    let none = match (state.next_pending, &state.failure) {
        (true, _) => Some("being computed"),
        (false, Some(_)) if state.next.is_none() => Some("none is known"),
        _ => None,
    };
    let questions = open_questions(diagnosis, state.next.as_deref(), none);
    state.hidden.set(document(&questions, first, area, buffer));
}
