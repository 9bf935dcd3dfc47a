//! What each event does in each state. Pure: it returns what the loop must do.

use std::sync::Arc;

use crossterm::event::KeyEvent;

use super::guess::{Guessing, compared};
use super::keys::{self, Press};
use super::state::{Over, Row, State, Step};
use crate::diagnosis::{AddResult, Diagnosis, Event as Found};
use crate::tui::Exit;
use crate::workflow::{News, Order};

const GUESS_FIRST: &str = "guess first: g takes the selected row, Esc shows the names";
const LEAVING: &str =
    "leaves when the model is written; Esc stays, Ctrl-C leaves at once without it";

#[derive(Clone, Debug)]
pub(super) enum Event {
    Key(KeyEvent),
    News(News),
    /// The worker has ended and carries nothing out any more.
    WorkerGone,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Effect {
    Order(Order),
    Leave(Exit),
}

impl State {
    pub(super) fn update(&mut self, event: Event) -> Option<Effect> {
        match event {
            Event::Key(key) => return self.press(keys::press(key)?),
            Event::News(news) => self.hear(news),
            Event::WorkerGone => {
                let is_lost = std::mem::take(&mut self.writing);
                if self.working.take().is_some() {
                    self.failure = Some("the analysis has ended without an answer".to_owned());
                }
                if is_lost {
                    self.leaving = false;
                    self.failure =
                        Some("the analysis has ended: the model is NOT WRITTEN".to_owned());
                }
            }
        }
        (self.leaving && !self.writing).then(|| Effect::Leave(self.exit()))
    }

    fn hear(&mut self, news: News) {
        match news {
            News::Progress(found) => self.found(found),
            News::Compared(comparison) => self.comparison = Some(Arc::from(comparison)),
            News::Diagnosed(diagnosis) => self.diagnosed(*diagnosis),
            News::Recommended(next) => self.next = Some(Arc::from(next)),
            News::Added(result) => self.changed(true, *result),
            News::Removed(result) => self.changed(false, *result),
            News::Written(text) => {
                self.writing = false;
                self.message = Some(text);
            }
            News::NotWritten(reason) => {
                // Who leaves would lose the model without having seen why.
                (self.writing, self.leaving) = (false, false);
                self.message = Some(format!("NOT WRITTEN: {reason}"));
            }
            News::Failed(reason) => {
                self.working = None;
                self.failure = Some(reason);
            }
        }
    }

    fn found(&mut self, found: Found) {
        match found {
            Found::Begun { .. } => {}
            Found::Screened { effect, share } => {
                self.judged.entry(effect).or_default().share = Some(share);
                self.working = Some("screening: one simulation for each effect".to_owned());
            }
            Found::Refitted { effect, error } => {
                self.judged.entry(effect).or_default().error = Some(error);
                self.working = Some("refitting with each effect that may pay".to_owned());
            }
            Found::Accepted { effect, holdout } => {
                self.taken.push((effect, holdout));
                // The next round judges them beside the enlarged model.
                self.judged.clear();
                self.working = Some("searching for more".to_owned());
            }
        }
    }

    fn diagnosed(&mut self, diagnosis: Diagnosis) {
        self.working = None;
        self.present = diagnosis.baseline.model.effect_ids();
        if self.ladder.is_empty() {
            let effects = &self.present;
            let name = if effects.is_empty() {
                "baseline".to_owned()
            } else {
                effects.join(" + ")
            };
            let noise = &diagnosis.baseline.noise;
            self.ladder
                .push(Step::new(name, diagnosis.holdout_before, noise));
        }
        if let Guessing::Guessed(guess) = self.guessing {
            self.message = Some(compared(guess, &diagnosis));
        }
        self.diagnosis = Some(Arc::new(diagnosis));
    }

    fn changed(&mut self, added: bool, result: AddResult) {
        self.working = None;
        if result.accepted {
            let sign = if added { '+' } else { '-' };
            let noise = &result.fit.noise;
            self.ladder.extend(result.ladder.last().map(|rung| {
                Step::new(
                    format!("{sign} {}", result.effect),
                    rung.holdout_rmse,
                    noise,
                )
            }));
            self.present = result.fit.model.effect_ids();
            self.comparison = Some(Arc::new(result.after.clone()));
            // What is missing now is searched anew.
            self.search_begins();
        }
        self.change = Some((added, Arc::new(result)));
    }

    fn search_begins(&mut self) {
        self.diagnosis = None;
        self.next = None;
        self.judged.clear();
        self.taken.clear();
        self.selected = None;
        if let Guessing::Guessed(_) = self.guessing {
            // It was a guess at what was missing then.
            self.guessing = Guessing::Off;
        }
        self.working = Some("searching what is missing now".to_owned());
    }

    fn press(&mut self, press: Press) -> Option<Effect> {
        self.message = None;
        match press {
            Press::Interrupt => return Some(Effect::Leave(Exit::Interrupted)),
            Press::Back if self.leaving => self.leaving = false,
            _ if self.leaving => self.say(LEAVING),
            Press::Quit if self.over != Over::Nothing => self.over = Over::Nothing,
            Press::Quit if self.writing => {
                self.leaving = true;
                self.say(LEAVING);
            }
            Press::Quit => return Some(Effect::Leave(self.exit())),
            Press::Move(rows) => self.go(rows),
            _ if matches!(self.over, Over::Help(_)) => self.over = Over::Nothing,
            Press::Open => self.open(),
            Press::Add => return self.add(),
            Press::Remove => return self.remove(),
            Press::Map => self.map(),
            Press::Next => self.next(),
            Press::Guess => self.guess(),
            Press::Write => return self.write(),
            Press::Curve => self.curve(),
            Press::Table => return self.table(),
            Press::Help => self.over = Over::Help(0),
            Press::Back => self.back(),
            Press::Other => {}
        }
        None
    }

    fn exit(&self) -> Exit {
        if self.working.is_some() {
            Exit::Quit
        } else {
            Exit::Finished
        }
    }

    fn say(&mut self, text: impl Into<String>) {
        self.message = Some(text.into());
    }

    fn go(&mut self, by: i32) {
        let by = isize::try_from(by).unwrap_or(0);
        if let Over::Card(line) | Over::Next(line) | Over::Help(line) | Over::Curve(_, line) =
            &mut self.over
        {
            *line = line.saturating_add_signed(by);
            return;
        }
        let rows = self.rows();
        let last = rows.len().saturating_sub(1);
        let next = self.selected(&rows).saturating_add_signed(by).min(last);
        let key = rows.get(next).map(Row::key);
        self.selected = key;
    }

    fn open(&mut self) {
        if let Over::Card(_) = self.over {
            self.over = Over::Nothing;
            return;
        }
        let rows = self.rows();
        let row = rows.get(self.selected(&rows));
        let (key, is_effect) = (
            row.map(Row::key),
            row.is_some_and(|row| row.effect().is_some()),
        );
        if is_effect {
            // The list may be put in another order while the card is read.
            self.selected = key;
            self.over = Over::Card(0);
        } else {
            self.say("no effect is selected");
        }
    }

    /// The effect that `a` and `r` are about, with whether it is in the model; the reason where there is none.
    fn chosen(&self) -> Result<(&'static str, bool), String> {
        if let Some(work) = &self.working {
            return Err(format!("not yet: {work}"));
        }
        if self.guessing == Guessing::Choosing {
            return Err(GUESS_FIRST.to_owned());
        }
        let rows = self.rows();
        match rows.get(self.selected(&rows)) {
            Some(Row::Present(id)) => Ok((id, true)),
            Some(Row::Candidate(candidate)) => Ok((candidate.effect, false)),
            _ => Err("no effect is selected".to_owned()),
        }
    }

    fn add(&mut self) -> Option<Effect> {
        match self.chosen() {
            Err(reason) => self.say(reason),
            Ok((id, true)) => self.say(format!("{id} is in the model already: r removes it")),
            Ok((id, false)) => {
                self.order(format!("refitting with {id}"));
                return Some(Effect::Order(Order::Add(id)));
            }
        }
        None
    }

    fn remove(&mut self) -> Option<Effect> {
        match self.chosen() {
            Err(reason) => self.say(reason),
            Ok((_, false)) if self.present.is_empty() => self.say("the model has no effect yet"),
            Ok((id, false)) => self.say(format!("{id} is not in the model: a adds it")),
            Ok((id, true)) => {
                self.order(format!("refitting without {id}"));
                return Some(Effect::Order(Order::Remove(id)));
            }
        }
        None
    }

    fn order(&mut self, work: String) {
        self.over = Over::Nothing;
        self.failure = None;
        self.working = Some(work);
    }

    fn map(&mut self) {
        let has_map = self
            .comparison
            .as_ref()
            .is_some_and(|found| found.map.is_some());
        self.over = match self.over {
            _ if !has_map => {
                self.say("there is no map: speed or current did not vary, or was not measured");
                Over::Nothing
            }
            Over::Map(0) => Over::Map(1),
            Over::Map(_) => Over::Nothing,
            _ => Over::Map(0),
        };
    }

    fn next(&mut self) {
        self.over = match self.over {
            Over::Next(_) => Over::Nothing,
            _ if self.guessing == Guessing::Choosing => {
                self.say(GUESS_FIRST);
                Over::Nothing
            }
            _ if self.diagnosis.is_none() => {
                self.say("not yet: there is no answer that a run could add to");
                self.over
            }
            _ => Over::Next(0),
        };
    }

    /// Goes through the curves that the error follows.
    fn curve(&mut self) {
        let curves = self.curves().len();
        self.over = match self.over {
            _ if self.guessing == Guessing::Choosing => {
                self.say(GUESS_FIRST);
                Over::Nothing
            }
            _ if self.diagnosis.is_none() => {
                self.say("not yet: the curve is drawn where no effect explains the error");
                self.over
            }
            _ if curves == 0 => {
                self.say("there is no curve: the error is explained, or follows no axis");
                Over::Nothing
            }
            Over::Curve(index, _) if index + 1 < curves => Over::Curve(index + 1, 0),
            Over::Curve(..) => Over::Nothing,
            _ => Over::Curve(0, 0),
        };
    }

    /// Adds the curve in sight, else the clearest.
    fn table(&mut self) -> Option<Effect> {
        if let Some(work) = &self.working {
            let text = format!("not yet: {work}");
            self.say(text);
            return None;
        }
        let index = if let Over::Curve(index, _) = self.over {
            index
        } else {
            0
        };
        let curve = self
            .curves()
            .get(index)
            .map(|(place, map)| (*place, map.equation, map.axis));
        let Some((place, equation, axis)) = curve.filter(|_| self.guessing != Guessing::Choosing)
        else {
            self.curve();
            return None;
        };
        self.order(format!(
            "fitting the curve of the {equation} error over {axis}"
        ));
        Some(Effect::Order(Order::AddCurve(place)))
    }

    fn guess(&mut self) {
        match self.guessing {
            Guessing::Choosing => {
                let rows = self.rows();
                let Some(Row::Choice(guess)) = rows.get(self.selected(&rows)).copied() else {
                    return;
                };
                self.guessing = Guessing::Guessed(guess);
                self.over = Over::Nothing;
                self.selected = None;
                let sentence = match &self.diagnosis {
                    Some(diagnosis) => compared(guess, diagnosis),
                    None => format!("you: {}. The tool has not answered yet", guess.key()),
                };
                self.say(sentence);
            }
            _ if self.diagnosis.is_some() => {
                self.say("too late to guess: the answer has been shown");
            }
            _ => {
                self.guessing = Guessing::Choosing;
                self.selected = None;
                self.over = Over::Nothing;
            }
        }
    }

    fn write(&mut self) -> Option<Effect> {
        if self.guessing == Guessing::Choosing {
            self.say(GUESS_FIRST);
        } else if self.writing {
            self.say("not yet: the model is being written");
        } else if let Some(work) = &self.working {
            let text = format!("not yet: {work}");
            self.say(text);
        } else if self.ladder.is_empty() {
            self.say("there is no fitted model to write");
        } else {
            // The worker may still look for the next run: the file comes after that.
            self.writing = true;
            self.say("the model will be written as soon as the analysis is at rest");
            return Some(Effect::Order(Order::Write));
        }
        None
    }

    fn back(&mut self) {
        if self.over != Over::Nothing {
            self.over = Over::Nothing;
        } else if self.guessing == Guessing::Choosing {
            self.guessing = Guessing::Off;
            self.selected = None;
        }
    }
}
