//! The whole frame as a function of the state.

use std::fmt::Write as _;

use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget, Wrap};

use super::guess::Guessing;
use super::panel::{candidates, card, curve, failing, help, ladder, map, next};
use super::state::{Over, State};
use crate::diagnosis::{Diagnosis, DiagnosisVerdict};
use crate::text::lines::{cut, wrapped};
use crate::tui::theme;
use crate::tui::widget::hints::keys_that_fit;

/// The smallest screen that can be read.
const SMALLEST: (u16, u16) = (30, 6);
/// Rungs that are shown; the latest ones where there are more.
const MOST_RUNGS: usize = 5;

pub(super) fn view(state: &State, frame: &mut Frame<'_>) {
    let area = frame.area();
    let buffer = frame.buffer_mut();
    if area.width < SMALLEST.0 || area.height < SMALLEST.1 {
        let text = format!("too small: {}x{}, q = leave", area.width, area.height);
        Line::styled(text, theme::CAREFUL).render(area, buffer);
        return;
    }
    let tall = area.height >= 20;
    let width = usize::from(area.width);
    let verdict_line = verdict_line(state);
    let most = if tall { 3 } else { 1 };
    let verdict_rows = rows_of(&verdict_line.to_string(), width, most);
    let most = match area.height {
        0..=11 => 0,
        12..=19 => 2,
        20..=29 => 6,
        _ => 9,
    };
    let failing_rows = failing::rows(state, area.width).min(most);
    let rungs = state.ladder.len().min(MOST_RUNGS) as u16;
    let change_rows = ladder::change_rows(state, area.width);
    let ladder_rows = match area.height {
        0..=13 => 0,
        _ if rungs == 0 => 0,
        14..=19 => 2 + change_rows.min(1),
        _ => 1 + rungs + change_rows,
    };
    let message = state.message.as_ref().map(|text| format!("> {text}"));
    let bottom_rows = message.as_ref().map_or(1, |text| {
        rows_of(text, width.saturating_sub(1), if tall { 4 } else { 1 })
    });
    let [top, verdict, where_area, list, ladder_area, bottom] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(verdict_rows),
        Constraint::Length(failing_rows),
        Constraint::Fill(1),
        Constraint::Length(ladder_rows),
        Constraint::Length(bottom_rows),
    ])
    .areas(area);
    top_bar(state, top, buffer);
    Paragraph::new(verdict_line)
        .wrap(Wrap { trim: false })
        .render(verdict, buffer);
    let body = Rect {
        height: where_area.height + list.height + ladder_area.height,
        ..where_area
    };
    match state.over {
        Over::Card(line) => card::card(state, line, body, buffer),
        Over::Map(index) => map::map(state, index, body, buffer),
        Over::Next(line) => next::next(state, line, body, buffer),
        Over::Curve(index, line) => curve::curve(state, index, line, body, buffer),
        Over::Nothing | Over::Help(_) => {
            failing::failing(state, where_area, buffer);
            candidates::candidates(state, list, buffer);
            ladder::ladder(state, ladder_area, buffer);
        }
    }
    if let Over::Help(row) = state.over {
        let under_top = Rect {
            y: area.y + 1,
            height: area.height.saturating_sub(1 + bottom_rows),
            ..area
        };
        help::help(row, under_top, buffer);
    }
    hints(state, message, bottom, buffer);
}

fn top_bar(state: &State, area: Rect, buffer: &mut Buffer) {
    let work = match (&state.working, &state.failure) {
        (Some(work), _) => Span::styled(format!(" … {work} "), theme::CAREFUL),
        (None, _) if state.writing => Span::styled(" … writing the model ", theme::CAREFUL),
        (None, Some(_)) => Span::styled(" FAILED ", theme::BAD),
        (None, None) => Span::styled(" ready ", theme::GOOD),
    };
    let width = (work.width() as u16).min(area.width);
    let room = usize::from(area.width - width).saturating_sub(" DIAGNOSIS ".len());
    Line::from(vec![
        Span::styled(" DIAGNOSIS ", theme::BOLD),
        Span::styled(cut(&state.title, room), theme::DIM),
    ])
    .render(area, buffer);
    let right = Rect {
        x: area.right() - width,
        width,
        ..area
    };
    Line::from(work).render(right, buffer);
}

fn verdict_line(state: &State) -> Line<'static> {
    if let Some(failure) = &state.failure {
        return Line::styled(format!(" ERROR: {failure}"), theme::BAD);
    }
    if state.guessing == Guessing::Choosing {
        return Line::styled(guess_first(state), theme::BOLD);
    }
    let Some(diagnosis) = &state.diagnosis else {
        let judged = state.judged.values();
        let screened = judged
            .clone()
            .filter(|judged| judged.share.is_some())
            .count();
        let refitted = judged.filter(|judged| judged.error.is_some()).count();
        let mut text = format!(" {screened} effects screened, {refitted} refitted");
        for (id, error) in &state.taken {
            let _ = write!(text, "; {id} taken, held-out error {error:.2}");
        }
        return Line::styled(text, theme::CAREFUL);
    };
    let (word, style) = word(diagnosis);
    let mut spans = vec![
        Span::styled(format!(" {word} "), style),
        Span::raw(sentence(diagnosis).to_owned()),
    ];
    if matches!(
        diagnosis.verdict,
        DiagnosisVerdict::Effect | DiagnosisVerdict::Ambiguous
    ) && !diagnosis.sufficient
    {
        spans.push(Span::raw("; this is not all: much is still unexplained"));
    }
    if !diagnosis.limits.is_empty() {
        spans.push(Span::raw("; n shows what limits this answer"));
    }
    if !state.curves().is_empty() {
        spans.push(Span::raw("; c shows the curve that it follows, t adds it"));
    }
    Line::from(spans)
}

/// The sentence without what the word before it says.
fn sentence(diagnosis: &Diagnosis) -> &str {
    let sentence = diagnosis.sentence.as_str();
    let said = ["nothing is missing: ", "missing: "];
    let rest = said.iter().find_map(|said| sentence.strip_prefix(said));
    match diagnosis.verdict {
        DiagnosisVerdict::Effect | DiagnosisVerdict::None => rest.unwrap_or(sentence),
        DiagnosisVerdict::Ambiguous | DiagnosisVerdict::Unexplained => sentence,
    }
}

/// Rows that a text takes, at least one and at most `most`.
fn rows_of(text: &str, width: usize, most: usize) -> u16 {
    wrapped(text, width).len().clamp(1, most.max(1)) as u16
}

fn guess_first(state: &State) -> String {
    let best = state
        .judged
        .values()
        .filter_map(|judged| judged.share)
        .fold(f64::NAN, f64::max);
    if let Some(diagnosis) = &state.diagnosis {
        let (before, after) = (diagnosis.holdout_before, diagnosis.holdout_after);
        let times = diagnosis.noise_floor_from.times();
        let found = if diagnosis.effects.is_empty() {
            "and adds nothing".to_owned()
        } else {
            format!("and takes the held-out error from {before:.2} to {after:.2} {times}")
        };
        return format!(" the tool has its answer {found}; what is yours?");
    }
    if best.is_finite() {
        let percent = 100.0 * best.clamp(0.0, 1.0);
        return format!(
            " the tool is at work, its best effect explains {percent:.0} %; what is your guess?"
        );
    }
    " the tool is at work; what is your guess?".to_owned()
}

/// The verdict as a word, which the colour only repeats.
fn word(diagnosis: &Diagnosis) -> (&'static str, ratatui::style::Style) {
    match diagnosis.verdict {
        DiagnosisVerdict::Effect if diagnosis.is_refuted() => {
            ("~ MISSING, NOT CONFIRMED:", theme::CAREFUL)
        }
        DiagnosisVerdict::Effect if diagnosis.sufficient => ("✓ MISSING:", theme::GOOD),
        DiagnosisVerdict::Effect => ("~ MISSING, IN PART:", theme::CAREFUL),
        DiagnosisVerdict::Ambiguous => ("? AMBIGUOUS", theme::CAREFUL),
        DiagnosisVerdict::None if !diagnosis.sufficient => ("? NOTHING FOUND", theme::CAREFUL),
        DiagnosisVerdict::None => ("✓ NOTHING MISSING", theme::GOOD),
        DiagnosisVerdict::Unexplained => ("✗ UNEXPLAINED", theme::BAD),
    }
}

/// The last line: the answer to the last key, else the keys.
fn hints(state: &State, message: Option<String>, area: Rect, buffer: &mut Buffer) {
    if let Some(message) = message {
        let rows = wrapped(&message, usize::from(area.width).saturating_sub(1));
        let style = theme::CAREFUL.patch(theme::BOLD);
        let lines: Vec<Line<'static>> = rows
            .into_iter()
            .map(|row| Line::styled(format!(" {row}"), style))
            .collect();
        Paragraph::new(lines).render(area, buffer);
        return;
    }
    let leave = "? help  q leave";
    let (keys, always): (&[&str], &str) = match state.over {
        Over::Card(_) => (&["Up Down scroll", "a add", "r remove"], "Esc back"),
        Over::Next(_) => (&["Up Down scroll"], "n Esc back"),
        Over::Map(0) => (&["m the other equation"], "Esc back"),
        Over::Map(_) => (&[], "m Esc back"),
        Over::Curve(index, _) if index + 1 < state.curves().len() => (
            &["t add it", "c the next curve", "Up Down scroll"],
            "Esc back",
        ),
        Over::Curve(..) => (&["t add it", "Up Down scroll"], "c Esc back"),
        Over::Help(_) => (&["Up Down scroll"], "any other key closes the help"),
        Over::Nothing if state.guessing == Guessing::Choosing => (
            &[
                "g guess it",
                "Esc show names",
                "Up Down choose",
                "Enter card",
                "m map",
            ],
            leave,
        ),
        Over::Nothing if state.working.is_some() => (
            &["Up Down select", "Enter card", "g guess first", "m map"],
            leave,
        ),
        Over::Nothing if !state.curves().is_empty() => (
            &[
                "c curve",
                "t add it",
                "a add",
                "r remove",
                "w write",
                "n next run",
                "m map",
            ],
            leave,
        ),
        Over::Nothing => (
            &[
                "a add",
                "r remove",
                "w write",
                "Enter card",
                "n next run",
                "m map",
            ],
            leave,
        ),
    };
    let keys = keys_that_fit(keys, always, usize::from(area.width));
    Line::styled(keys, theme::DIM).render(area, buffer);
}
