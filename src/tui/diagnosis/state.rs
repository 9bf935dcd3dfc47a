//! What the screen knows, and nothing else.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::guess::{Guess, Guessing};
use crate::diagnosis::{AddResult, AxisMap, Candidate, Comparison, Diagnosis, NextExperiment};
use crate::identification::noise::{FloorSource, NoiseFloor};
use crate::plant::effect::{self, Axis};

/// An effect while the search is under way.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Judged {
    /// Share of the unexplained error, to first order.
    pub(super) share: Option<f64>,
    /// Training error after the refit, in units of the noise.
    pub(super) error: Option<f64>,
}

/// One model on the way and how it came about.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Step {
    pub(super) name: String,
    /// Held-out error in units of the noise.
    pub(super) error: f64,
    /// Within what chance leaves above a floor that was itself estimated.
    pub(super) at_floor: bool,
}

impl Step {
    pub(super) fn new(name: String, error: f64, noise: &NoiseFloor) -> Self {
        Self {
            name,
            error,
            at_floor: noise.is_at_the_floor(error),
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Over {
    #[default]
    Nothing,
    /// The card of the selected effect, from this line on.
    Card(usize),
    /// The map of the worse equation, or of the other one.
    Map(usize),
    /// What these runs do not tell, and the run that would, from this line on.
    Next(usize),
    /// The curve that the error follows along this axis of [`State::curves`], from this row on.
    Curve(usize, usize),
    /// From this row on.
    Help(usize),
}

/// What a row of the list stands for.
#[derive(Clone, Copy, Debug)]
pub(super) enum Row<'a> {
    /// Already in the model.
    Present(&'static str),
    Judged(&'static str, Judged),
    Candidate(&'a Candidate),
    Choice(Guess),
}

impl Row<'_> {
    /// What the row is selected by.
    pub(super) const fn key(&self) -> &'static str {
        match self {
            Self::Present(id) | Self::Judged(id, _) => id,
            Self::Candidate(candidate) => candidate.effect,
            Self::Choice(guess) => guess.key(),
        }
    }

    /// The effect it stands for, if any.
    pub(super) fn effect(&self) -> Option<&'static dyn crate::plant::Effect> {
        effect::find(self.key())
    }
}

/// The state of the screen.
#[derive(Clone, Debug)]
pub(super) struct State {
    pub(super) title: String,
    /// What the worker is doing.
    pub(super) working: Option<String>,
    pub(super) comparison: Option<Arc<Comparison>>,
    pub(super) judged: BTreeMap<&'static str, Judged>,
    /// Effects that the search has taken so far, with the held-out error then.
    pub(super) taken: Vec<(&'static str, f64)>,
    /// None while the search is under way.
    pub(super) diagnosis: Option<Arc<Diagnosis>>,
    /// The run that would tell more.
    pub(super) next: Option<Arc<NextExperiment>>,
    /// Effects of the model as it stands.
    pub(super) present: Vec<&'static str>,
    pub(super) ladder: Vec<Step>,
    /// What came of the last effect that was added or removed.
    pub(super) change: Option<(bool, Arc<AddResult>)>,
    /// The row selected; none before the person has moved.
    pub(super) selected: Option<&'static str>,
    pub(super) over: Over,
    pub(super) guessing: Guessing,
    /// A model that is to be written is not in its file yet.
    pub(super) writing: bool,
    /// To be left as soon as it is.
    pub(super) leaving: bool,
    /// Answer to the last key.
    pub(super) message: Option<String>,
    pub(super) failure: Option<String>,
}

impl State {
    /// `guess_first`: no name is shown before the person has given one.
    pub(super) fn new(title: String, guess_first: bool) -> Self {
        Self {
            title,
            working: Some("fitting the model".to_owned()),
            comparison: None,
            judged: BTreeMap::new(),
            taken: Vec::new(),
            diagnosis: None,
            next: None,
            present: Vec::new(),
            ladder: Vec::new(),
            change: None,
            selected: None,
            over: Over::Nothing,
            guessing: if guess_first {
                Guessing::Choosing
            } else {
                Guessing::Off
            },
            writing: false,
            leaving: false,
            message: None,
            failure: None,
        }
    }

    /// The rows of the list, in the order in which they are shown.
    pub(super) fn rows(&self) -> Vec<Row<'_>> {
        if self.guessing == Guessing::Choosing {
            return Guess::all(&self.present).map(Row::Choice).collect();
        }
        let mut rows: Vec<Row<'_>> = self.present.iter().map(|id| Row::Present(id)).collect();
        if let Some(diagnosis) = &self.diagnosis {
            rows.extend(diagnosis.candidates.iter().map(Row::Candidate));
            return rows;
        }
        let mut judged: Vec<(&'static str, Judged)> = self
            .judged
            .iter()
            .map(|(id, judged)| (*id, *judged))
            .collect();
        let share = |judged: &Judged| judged.share.unwrap_or(f64::NEG_INFINITY);
        judged.sort_by(|a, b| share(&b.1).total_cmp(&share(&a.1)));
        rows.extend(
            judged
                .into_iter()
                .map(|(id, judged)| Row::Judged(id, judged)),
        );
        rows
    }

    /// The selected row: before the person has moved, the first that is not in the model.
    pub(super) fn selected(&self, rows: &[Row<'_>]) -> usize {
        let chosen = self
            .selected
            .and_then(|key| rows.iter().position(|row| row.key() == key));
        let first = || {
            rows.iter()
                .position(|row| !matches!(row, Row::Present(_)))
                .unwrap_or(0)
        };
        chosen.unwrap_or_else(first)
    }

    /// What the unexplained error follows, where it follows anything that a table can hold, each with its place in the
    /// diagnosis; the clearest first.
    pub(super) fn curves(&self) -> Vec<(usize, &AxisMap)> {
        let maps = self.diagnosis.iter().flat_map(|found| &found.axis_map);
        maps.enumerate()
            .filter(|(_, map)| map.is_followed() && Axis::from_key(map.axis).is_some())
            .collect()
    }

    pub(super) fn is_floor_known(&self) -> bool {
        let from = self
            .diagnosis
            .as_ref()
            .map(|diagnosis| diagnosis.noise_floor_from)
            .or_else(|| self.comparison.as_ref().map(|found| found.noise_floor_from));
        from.is_some_and(|from| from != FloorSource::None)
    }

    /// The candidate of this effect in the answer.
    pub(super) fn candidate(&self, id: &str) -> Option<&Candidate> {
        let diagnosis = self.diagnosis.as_ref()?;
        diagnosis
            .candidates
            .iter()
            .find(|candidate| candidate.effect == id)
    }
}
