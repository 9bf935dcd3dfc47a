//! Enable sequence of a drive: the control words of its enable command are stages that are passed in order.

use drivebench_link::register_map::{Condition, RegisterMap, Step};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Turn {
    Off,
    /// To rest, and then off.
    Down,
    On,
}

/// One word of the enable command, and what the status shows from then on.
struct Stage {
    word: Word,
    shows: Vec<Condition>,
}

#[derive(Clone, Debug, PartialEq)]
struct Word {
    set_point: String,
    value: i64,
    mask: Option<u16>,
}

pub(super) struct EnableSequence {
    /// What the status shows before the first word.
    at_rest: Vec<Condition>,
    stages: Vec<Stage>,
    stops: Vec<Word>,
    coasts: Vec<Word>,
    resets: Vec<Word>,
    reached: usize,
    ramping: bool,
}

impl EnableSequence {
    pub(super) fn new(map: &RegisterMap) -> Self {
        let mut stages: Vec<Stage> = Vec::new();
        let mut at_rest = Vec::new();
        for step in &map.commands.enable {
            match (step, words(map, std::slice::from_ref(step)).pop()) {
                (_, Some(word)) => stages.push(Stage { word, shows: Vec::new() }),
                (Step::Wait { condition, .. }, None) => {
                    if let Some(stage) = stages.last_mut() {
                        stage.shows.push(condition.clone());
                    } else if is_shown_at_rest(map, condition) {
                        at_rest.push(condition.clone());
                    }
                }
                _ => {}
            }
        }
        // What a drive shows behind a stop it shows before the first enable as well.
        for step in &map.commands.stop {
            if let Step::Wait { condition, .. } = step
                && is_shown_at_rest(map, condition)
            {
                at_rest.push(condition.clone());
            }
        }
        let stops = words(map, &map.commands.stop);
        let coasts = words(map, &map.commands.coast);
        let all = words(map, &map.commands.reset);
        // The word that no other command has is the one that resets.
        let elsewhere = |word: &Word| {
            stages.iter().any(|stage| stage.word == *word)
                || stops.contains(word)
                || coasts.contains(word)
        };
        let mut resets: Vec<Word> = all.iter().filter(|word| !elsewhere(word)).cloned().collect();
        if resets.is_empty() {
            resets = all.last().cloned().into_iter().collect();
        }
        Self { at_rest, stages, stops, coasts, resets, reached: 0, ramping: false }
    }

    pub(super) const fn is_running(&self) -> bool {
        self.reached == self.stages.len()
    }

    /// Neither enabled in part nor coming to rest.
    pub(super) const fn is_at_rest(&self) -> bool {
        self.reached == 0 && !self.ramping
    }

    /// While it comes to rest a drive still reports that it runs.
    pub(super) const fn shows_running(&self) -> bool {
        (self.is_running() && !self.stages.is_empty()) || self.ramping
    }

    /// Ramps down, as after a stop command.
    pub(super) const fn stop(&mut self) {
        self.reached = 0;
        self.ramping = true;
    }

    pub(super) const fn fall(&mut self) {
        self.reached = 0;
        self.ramping = false;
    }

    /// What the motor is to do; `stands`: the shaft has come to rest.
    pub(super) const fn turn(&mut self, stands: bool) -> Turn {
        self.ramping &= !stands;
        if self.is_running() {
            Turn::On
        } else if self.ramping {
            Turn::Down
        } else {
            Turn::Off
        }
    }

    /// Takes a word; returns whether it resets a fault.
    pub(super) fn take(
        &mut self,
        map: &RegisterMap,
        set_point: &str,
        number: f64,
        in_fault: bool,
    ) -> bool {
        #[expect(clippy::cast_possible_truncation, reason = "words are whole numbers of 32 bits")]
        let number = number as i64;
        // Bits that only carry a sign are no command.
        let signs = map.set_points.iter().filter_map(|point| point.keys.sign.as_ref());
        let sign_bits = signs
            .filter(|sign| sign.set_point == set_point)
            .fold(0, |bits, sign| bits | i64::from(sign.mask));
        // Any time of the watchdog arms it.
        let time = map.set_point(set_point).zip(map.watchdog.time.as_ref());
        let is_time = time.is_some_and(|(point, (at, _))| {
            (point.location.table, point.location.address) == (at.table, at.address)
        });
        let is = |word: &Word| {
            if is_time {
                return word.set_point == set_point && (number != 0) == (word.value != 0);
            }
            let mask = word.mask.map_or(!sign_bits, i64::from);
            word.set_point == set_point && (number ^ word.value) & mask == 0
        };
        if in_fault {
            return self.resets.iter().any(is);
        }
        let was_running = self.is_running();
        let next = self.stages.get(self.reached).is_some_and(|stage| is(&stage.word));
        let below = self.stages[..self.reached].iter().rposition(|stage| is(&stage.word));
        if next {
            self.reached += 1;
        } else if let Some(stage) = below {
            self.reached = stage + 1;
        } else if self.coasts.iter().any(is) && !self.stops.iter().any(is) {
            self.fall();
            return false;
        } else if self.stops.iter().any(is) {
            self.reached = 0;
        }
        self.ramping |= was_running && !self.is_running();
        self.ramping &= !self.is_running();
        false
    }

    /// Bits of a signal that the stages show.
    pub(super) fn shown(&self, signal: &str) -> u32 {
        let reached = if self.shows_running() { self.stages.len() } else { self.reached };
        let passed = self.stages[..reached].iter().flat_map(|stage| &stage.shows);
        self.at_rest
            .iter()
            .chain(passed)
            .filter(|condition| condition.signal == signal)
            .fold(0, |bits, condition| (bits & !condition.mask) | condition.pattern)
    }
}

/// Whether a drive that does not run and is not in fault can show this, as one that is ready does.
fn is_shown_at_rest(map: &RegisterMap, condition: &Condition) -> bool {
    ["running", "fault", "comm_loss", "local", "sto"]
        .into_iter()
        .filter_map(|name| map.state(name))
        .filter(|state| state.signal == condition.signal && state.mask & condition.mask != 0)
        .all(|state| !state.holds(condition.pattern))
}

/// The words that steps write; references are none.
fn words(map: &RegisterMap, steps: &[Step]) -> Vec<Word> {
    let word = |step: &Step| match step {
        Step::Write(write)
            if map
                .set_point(&write.set_point)
                .is_some_and(drivebench_link::register_map::SetPoint::is_word) =>
        {
            Some(Word {
                set_point: write.set_point.clone(),
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "words are whole numbers of 32 bits"
                )]
                value: write.value as i64,
                mask: write.mask,
            })
        }
        _ => None,
    };
    steps.iter().filter_map(word).collect()
}
