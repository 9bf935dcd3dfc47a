//! Straight lines of voltage over time, of which every program is made.

/// A straight line from `from_v` at `start_s` to `to_v` at `end_s`; the end belongs to the next piece.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    pub start_s: f64,
    pub end_s: f64,
    pub from_v: f64,
    pub to_v: f64,
}

impl Piece {
    pub const fn line((start_s, from_v): (f64, f64), (end_s, to_v): (f64, f64)) -> Self {
        Self { start_s, end_s, from_v, to_v }
    }

    pub const fn level(start_s: f64, end_s: f64, volts: f64) -> Self {
        Self::line((start_s, volts), (end_s, volts))
    }

    pub fn slope_v_per_s(&self) -> f64 {
        (self.to_v - self.from_v) / (self.end_s - self.start_s)
    }

    pub fn value(&self, time_s: f64) -> f64 {
        let share = (time_s - self.start_s) / (self.end_s - self.start_s);
        self.from_v + share * (self.to_v - self.from_v)
    }

    #[must_use]
    pub const fn shifted(self, by_s: f64) -> Self {
        Self { start_s: self.start_s + by_s, end_s: self.end_s + by_s, ..self }
    }
}

/// The set-point of one excitation over its own time, which begins at 0.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// Pieces that follow each other without gaps; the voltage may jump between them.
    Voltage(Vec<Piece>),
    /// Output off: the motor runs free.
    Coast,
}

/// Levels that last equally long, from time 0.
pub(super) fn levels(hold_s: f64, values_v: impl IntoIterator<Item = f64>) -> Vec<Piece> {
    let mut start_s = 0.0;
    let mut pieces = Vec::new();
    for (index, volts) in values_v.into_iter().enumerate() {
        let end_s = (index + 1) as f64 * hold_s;
        pieces.push(Piece::level(start_s, end_s, volts));
        start_s = end_s;
    }
    pieces
}

/// Chords of a curve from time 0 through `ends` to `last_s`.
pub(super) fn chords(
    ends: impl Iterator<Item = f64>,
    last_s: f64,
    value_v: impl Fn(f64) -> f64,
) -> Vec<Piece> {
    let mut from = (0.0, value_v(0.0));
    let corners = ends.chain([last_s]).map(|end_s| (end_s, value_v(end_s)));
    corners.map(|to| Piece::line(std::mem::replace(&mut from, to), to)).collect()
}

/// Makes the pieces end at `end_s`: later ones are removed, and the last one is shortened or extended.
pub(super) fn cut(pieces: &mut Vec<Piece>, end_s: f64) {
    while pieces.last().is_some_and(|piece| piece.start_s >= end_s) {
        pieces.pop();
    }
    if let Some(last) = pieces.last_mut() {
        last.to_v = last.value(end_s);
        last.end_s = end_s;
    }
}
