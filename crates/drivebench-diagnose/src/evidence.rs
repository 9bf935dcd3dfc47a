//! The runs of a diagnosis, and the noise floor below which no error is observable.

use std::borrow::Cow;

use serde::Serialize;

use super::limits::{Limit, LongRun, SearchedPart, SetAside, Unjudged};
use super::score::{Score, SignalScore, varies};
use drivebench_identify::noise::{FEWEST_BESIDE, FloorSource, NoiseFloor, samples_at_rest};
use drivebench_identify::output_error::{self, Fit, FitError};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::{finite, variance};
use drivebench_model::plant::{Effect, Input, Model, Scenario, effect};

/// Shares of a run that train when there is no second run, the preferred one first; the rest is held out as one block, which
/// has to move as well as what trains.
const TRAINING_SHARES: [f64; 4] = [0.6, 0.5, 0.4, 0.3];
/// Deviation of a signal in a part of a run, as a share of that in the whole of it, from which on the part moves: a step
/// response has died down to it after three time constants.
const MOVES_SHARE: f64 = 0.05;
/// The same in units of the sensors' noise, where that is known.
const MOVES_RATIO: f64 = 2.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum HoldoutFrom {
    Run,
    Split,
}

/// Fit on `training`, select on `holdout`, repeat the answer on `confirm` where there is one.
#[derive(Clone, Debug)]
pub struct Evidence {
    pub training: Scenario,
    pub holdout: Scenario,
    pub confirm: Option<Scenario>,
    pub holdout_from: HoldoutFrom,
    pub noise: NoiseFloor,
    /// A run of the same excitation as the first that is fitted.
    pub repeat: Option<Scenario>,
    /// The runs that are concatenated in `training`, where it is more than one.
    pub parts: Vec<Scenario>,
    /// When each of them begins there, s after its first input.
    pub begins_s: Vec<f64>,
}

/// The part of a run that trains and the one that is held out: by the first share at which both move.
fn split(run: &Scenario, noise: &NoiseFloor) -> (Scenario, Scenario) {
    let parts = TRAINING_SHARES.map(|share| run.split(share));
    let mut both = parts.iter();
    let both =
        both.find(|(fitted, held_out)| moves(fitted, run, noise) && moves(held_out, run, noise));
    both.unwrap_or(&parts[0]).clone()
}

/// Whether a signal changes in the scored part of a run, compared with what it does in `all` of it and with its noise.
fn moves(part: &Scenario, all: &Scenario, noise: &NoiseFloor) -> bool {
    let is_known = noise.source != FloorSource::None;
    let changes = |signal: Signal, level: f64| {
        let deviation = |values: &[f64]| variance(&finite(values)).sqrt();
        let own = deviation(&signal(part)[part.scored.clone()]);
        let least = MOVES_SHARE * deviation(signal(all));
        own > least && (!is_known || !level.is_finite() || own > MOVES_RATIO * level)
    };
    changes(|run| &run.speed_rad_s, noise.speed_rad_s)
        || changes(|run| &run.current_a, noise.current_a)
}

impl Evidence {
    /// Takes the noise floor from the standstills of the fit run and the hold-out, else leaves the signals scaled by their
    /// spread until a baseline is fitted ([`Evidence::with_baseline`]). The confirming run has no part in anything that is
    /// decided, hence none in the floor.
    pub fn new(fit_run: Scenario, holdout: Option<Scenario>, confirm: Option<Scenario>) -> Self {
        let rests: Vec<NoiseFloor> = [Some(&fit_run), holdout.as_ref()]
            .into_iter()
            .flatten()
            .filter_map(NoiseFloor::from_standstill)
            .collect();
        let noise = NoiseFloor::pooled(&rests).unwrap_or_else(|| NoiseFloor::from_spread(&fit_run));
        let (training, holdout, holdout_from) = if let Some(holdout) = holdout {
            (fit_run, holdout, HoldoutFrom::Run)
        } else {
            let (training, holdout) = split(&fit_run, &noise);
            (training, holdout, HoldoutFrom::Split)
        };
        Self {
            training,
            holdout,
            confirm,
            holdout_from,
            noise,
            repeat: None,
            parts: Vec::new(),
            begins_s: vec![0.0],
        }
    }

    /// Of one run that is fitted and held out as a whole, with this noise.
    pub(super) fn of_one(run: &Scenario, noise: NoiseFloor) -> Self {
        Self {
            training: run.clone(),
            holdout: run.clone(),
            confirm: None,
            holdout_from: HoldoutFrom::Split,
            noise,
            repeat: None,
            parts: Vec::new(),
            begins_s: vec![0.0],
        }
    }

    /// The same with one run more to fit, appended to those that are fitted.
    #[must_use]
    pub fn with_run(mut self, run: Scenario) -> Self {
        if self.parts.is_empty() {
            self.parts.push(self.training.clone());
        }
        self.begins_s.push(self.training.whole_s());
        self.training = self.training.followed_by(&run);
        self.parts.push(run);
        self
    }

    /// The same with the first of the fitted runs only.
    #[must_use]
    pub(super) fn first_run_only(mut self) -> Self {
        if !self.parts.is_empty() {
            self.training = self.parts.swap_remove(0);
            self.parts = Vec::new();
            self.begins_s = vec![0.0];
        }
        self
    }

    /// The same for a fit of these effects: where one of them is an event, counts from the first command of a run or has a
    /// state, the runs cannot be concatenated; then the first run only, with the runs that were set aside.
    #[must_use]
    pub fn fitted_with(&self, effects: &[&'static str]) -> (Cow<'_, Self>, Option<SetAside>) {
        let goes_on = |id: &&&str| effect::find(id).is_none_or(Effect::goes_on_over_runs);
        let ids: Vec<&'static str> = effects.iter().filter(goes_on).copied().collect();
        if ids.is_empty() || self.parts.len() < 2 {
            return (Cow::Borrowed(self), None);
        }
        let aside = SetAside {
            later: self.parts.iter().skip(1).map(|part| part.name.clone()).collect(),
            effects: ids,
            first: self.first_run().name.clone(),
        };
        (Cow::Owned(self.clone().first_run_only()), Some(aside))
    }

    /// The run that is fitted, the first of several.
    pub fn first_run(&self) -> &Scenario {
        self.parts.first().unwrap_or(&self.training)
    }

    /// All runs as recorded, the fitted one first, and the index of the one that is held
    /// out. A split run is whole.
    pub(super) fn recorded_runs(&self) -> (Vec<&Scenario>, usize) {
        let later = self.parts.iter().skip(1);
        match self.holdout_from {
            HoldoutFrom::Run => {
                let first = std::iter::once(self.first_run());
                let mut runs: Vec<&Scenario> = first.chain(later).collect();
                runs.push(&self.holdout);
                let held_out = runs.len() - 1;
                (runs, held_out)
            }
            HoldoutFrom::Split => (std::iter::once(&self.holdout).chain(later).collect(), 0),
        }
    }

    /// The same with runs longer than a search can hold shortened to their beginning, and the parts that are searched. The
    /// rest is the confirming run where there is no other.
    pub(super) fn shortened(mut self) -> (Self, Option<Limit>) {
        if self.training.input != Input::Voltage {
            return (self, None);
        }
        if self.parts.len() > 1 && self.training.samples() > MOST_SAMPLES {
            let most = MOST_SAMPLES / self.parts.len();
            let mut parts = Vec::new();
            let mut later = std::mem::take(&mut self.parts).into_iter();
            let first = later.next();
            self.begins_s = vec![0.0];
            let most_of_first = match self.holdout_from {
                HoldoutFrom::Run => most,
                // Its training share is then `most`.
                HoldoutFrom::Split => whole(most as f64 / TRAINING_SHARES[0]),
            };
            self.training = first.unwrap_or(self.training);
            match self.holdout_from {
                HoldoutFrom::Run => {
                    let name = LongRun::Named(self.training.name.clone());
                    let cut = shorten(&mut self.training, most_of_first, name);
                    parts.extend(cut.map(|cut| cut.searched));
                    let holdout = shorten(&mut self.holdout, MOST_SAMPLES, LongRun::Holdout);
                    parts.extend(holdout.map(|cut| cut.searched));
                }
                HoldoutFrom::Split => {
                    let cut = self.shorten_split(most_of_first);
                    parts.extend(cut.map(|cut| cut.searched));
                }
            }
            if let Some(repeat) = &mut self.repeat {
                shorten(repeat, most_of_first, LongRun::Repeat);
            }
            let several = later.fold(self, |evidence, mut run| {
                let name = LongRun::Named(run.name.clone());
                parts.extend(shorten(&mut run, most, name).map(|cut| cut.searched));
                evidence.with_run(run)
            });
            let is_cut = !parts.is_empty();
            let limit = is_cut.then_some(Limit::PartSearched { parts, rest_confirms: false });
            return (several, limit);
        }
        let cuts = match self.holdout_from {
            HoldoutFrom::Run => [
                shorten(&mut self.training, MOST_SAMPLES, LongRun::Fit),
                shorten(&mut self.holdout, MOST_SAMPLES, LongRun::Holdout),
            ],
            HoldoutFrom::Split => [None, self.shorten_split(MOST_SAMPLES_OF_ONE)],
        };
        let mut behind = None;
        let mut parts = Vec::new();
        for cut in cuts.into_iter().flatten() {
            behind = cut.behind;
            parts.push(cut.searched);
        }
        if parts.is_empty() {
            return (self, None);
        }
        if let Some(repeat) = &mut self.repeat {
            // As the run that it repeats, so that both begin at the same time.
            let most = match self.holdout_from {
                HoldoutFrom::Run => MOST_SAMPLES,
                HoldoutFrom::Split => MOST_SAMPLES_OF_ONE,
            };
            shorten(repeat, most, LongRun::Repeat);
        }
        let rest_confirms = self.confirm.is_none() && behind.is_some();
        self.confirm = self.confirm.or(behind);
        (self, Some(Limit::PartSearched { parts, rest_confirms }))
    }

    /// Shortens one run of which a part is held out to so many samples, and splits it anew.
    fn shorten_split(&mut self, most: usize) -> Option<Cut> {
        let mut whole = self.holdout.clone();
        whole.scored = 0..whole.samples();
        if let Some(name) = whole.part_of.pop() {
            whole.name = name;
        }
        let cut = shorten(&mut whole, most, LongRun::Only);
        if cut.is_some() {
            (self.training, self.holdout) = split(&whole, &self.noise);
        }
        cut
    }

    /// Share of a run that is held out where no other run is.
    pub fn held_out_share(&self) -> f64 {
        self.holdout.scored.len() as f64 / self.holdout.samples().max(1) as f64
    }

    /// Whether a signal of the held-out part changes: a constant predicts a steady one as well, so that nothing can be
    /// concluded from it.
    pub(super) fn holdout_moves(&self) -> bool {
        let all = match self.holdout_from {
            HoldoutFrom::Run => &self.training,
            HoldoutFrom::Split => &self.holdout,
        };
        moves(&self.holdout, all, &self.noise)
    }

    /// Measured signals that are not judged, each with the reason, of runs that a voltage drives (the others are
    /// judged by their torque balance); and a hold-out that does not change.
    pub fn unjudged(&self) -> Vec<Limit> {
        let still = (!self.holdout_moves()).then_some(Limit::HoldoutStill);
        if self.training.input != Input::Voltage {
            return still.into_iter().collect();
        }
        let (current, speed): (Signal, Signal) = (|run| &run.current_a, |run| &run.speed_rad_s);
        let signals =
            [("current", current, self.noise.current_a), ("speed", speed, self.noise.speed_rad_s)];
        let unjudged = signals.into_iter().filter_map(|(signal, of, level)| {
            Some(Limit::SignalUnjudged { signal, why: self.why_unjudged(of, level)? })
        });
        unjudged.chain(still).collect()
    }

    /// Of a signal whose noise is `level`, infinite where that is not known.
    fn why_unjudged(&self, signal: Signal, level: f64) -> Option<Unjudged> {
        let [fitted, held_out] = [&self.training, &self.holdout].map(|run| {
            signal(run)[run.scored.clone()].iter().filter(|value| value.is_finite()).count()
        });
        if fitted == 0 {
            return (held_out > 0).then_some(Unjudged::OnlyInHoldout);
        }
        if level.is_finite() {
            return (held_out == 0).then_some(Unjudged::NotInHoldout);
        }
        if !varies(signal(&self.training)) {
            return Some(Unjudged::Constant);
        }
        Some(match self.noise.source {
            FloorSource::Standstill => {
                let runs = [&self.training, &self.holdout].into_iter();
                let most = runs.map(|run| samples_at_rest(run, signal(run))).max();
                Unjudged::FewAtRest { samples: most.unwrap_or(0), needed: FEWEST_BESIDE }
            }
            FloorSource::Repeat => Unjudged::FewRepeated { needed: FEWEST_DIFFERENCES },
            FloorSource::None => Unjudged::NothingLeft,
        })
    }

    /// Fits `model` on the training run. Where no noise floor is known, the residual of this first fit becomes the
    /// scale of everything that follows.
    pub fn with_baseline(mut self, model: &Model) -> Result<(Self, Fit), FitError> {
        let mut fit = output_error::fit(std::slice::from_ref(model), &self.training, &self.noise)?;
        if self.noise.source == FloorSource::None {
            let score = Score::of(&fit.model, &self.training, &self.noise)?;
            let level = |signal: Option<SignalScore>| {
                signal.map(|signal| signal.rmse).filter(|rmse| *rmse > 0.0).unwrap_or(f64::INFINITY)
            };
            self.noise.current_a = level(score.current);
            self.noise.speed_rad_s = level(score.speed);
            fit = output_error::fit(std::slice::from_ref(&fit.model), &self.training, &self.noise)?;
        }
        Ok((self, fit))
    }

    /// The same with the inputs of the other runs at the instants that `model`, fitted to the training run, gives them, and by how
    /// much each was moved, s.
    pub(super) fn aligned(mut self, model: &Model) -> (Self, Vec<(String, f64)>) {
        let mut offsets = Vec::new();
        let noise = self.noise;
        let mut align = |run: &mut Scenario| {
            if let Some(offset_s) = output_error::offset_in(model, run, &noise) {
                *run = run.with_input_later(offset_s);
                offsets.push((run.name.clone(), offset_s));
            }
        };
        if self.holdout_from == HoldoutFrom::Run {
            align(&mut self.holdout);
        }
        self.confirm.iter_mut().chain(&mut self.repeat).for_each(align);
        (self, offsets)
    }

    /// The same with the inputs where a diagnosis of these runs has moved them.
    #[must_use]
    pub fn moved_as(mut self, limits: &[Limit]) -> Self {
        let mut others: Vec<&mut Scenario> = vec![&mut self.holdout];
        others.extend(self.confirm.iter_mut().chain(&mut self.repeat));
        for run in others {
            let offset_s = limits.iter().find_map(|limit| match limit {
                Limit::OffsetOfRun { run: name, offset_s } if *name == run.name => Some(*offset_s),
                _ => None,
            });
            if let Some(offset_s) = offset_s {
                *run = run.with_input_later(offset_s);
            }
        }
        self
    }

    /// Takes in a run of the same excitation as `training`. Where the sensors' noise is not known at rest, what the two do
    /// not repeat is the floor.
    pub fn with_repeat(mut self, model: &Model, repeat: Scenario) -> Result<Self, FitError> {
        if self.noise.source != FloorSource::Standstill {
            let [current, speed] = not_repeated(model, [&self.training, &repeat], &self.noise)?;
            if current.is_some() || speed.is_some() {
                self.noise = NoiseFloor {
                    current_a: current.unwrap_or(f64::INFINITY),
                    speed_rad_s: speed.unwrap_or(f64::INFINITY),
                    source: FloorSource::Repeat,
                    samples: self.training.samples().min(repeat.samples()),
                    memory: [0.0; 2],
                };
            }
        }
        self.repeat = Some(repeat);
        Ok(self)
    }
}

/// Samples of a run that are searched for what is missing, at most: time and memory grow with them, and what a minute at
/// 1 kHz does not show is of no practical size. Of one run that is split as many train.
const MOST_SAMPLES: usize = 60_000;
const MOST_SAMPLES_OF_ONE: usize = 100_000;
/// One part in so many of them is the most that a leading standstill takes, from which the noise is estimated.
const AT_REST_DIVISOR: usize = 10;

/// What was cut from a long run.
struct Cut {
    /// The run from the same begin, of which only the part after the searched one is scored.
    behind: Option<Scenario>,
    searched: SearchedPart,
}

/// Cuts a run to so many samples from shortly before it moves on; none where it is no longer than that.
fn shorten(run: &mut Scenario, most: usize, role: LongRun) -> Option<Cut> {
    let samples = run.samples();
    if samples <= most {
        return None;
    }
    let first = run.leading_standstill().end.saturating_sub(most / AT_REST_DIVISOR);
    let end = (first + most).min(samples);
    let behind = (end < samples).then(|| {
        let mut behind = run.stretch(first..samples);
        behind.scored = end - first..behind.samples();
        behind
    });
    let since_begin = |sample: usize| run.sample_time_s[sample] - run.sample_time_s[0];
    let searched = SearchedPart {
        run: role,
        from_s: since_begin(first),
        to_s: since_begin(end - 1),
        whole_s: since_begin(samples - 1),
        rows: end - first,
        of_rows: samples,
    };
    *run = run.stretch(first..end);
    Some(Cut { behind, searched })
}

/// A signal of a run that errors are judged by.
type Signal = fn(&Scenario) -> &Vec<f64>;

/// Standard deviations of current, A, and speed, rad/s, that differ between two runs of the same excitation: half the
/// variance of the difference of their residuals. Residuals are compared, not signals, so that runs whose samples fell at
/// other instants can be subtracted; and each run's are those of its own fit, so that a winding that was warmer in the
/// second, or an event that came at another time, does not count as noise.
pub(super) fn not_repeated(
    model: &Model,
    [first, second]: [&Scenario; 2],
    noise: &NoiseFloor,
) -> Result<[Option<f64>; 2], FitError> {
    let residuals = |run: &Scenario| -> Result<Score, FitError> {
        let fit = output_error::fit(std::slice::from_ref(model), run, noise)?;
        Score::of(&fit.model, run, noise)
    };
    let (a, b) = (residuals(first)?, residuals(second)?);
    let (begin_a_s, begin_b_s) = (first.events[0].0, second.events[0].0);
    let differs = |a: &[(f64, f64)], b: &[(f64, f64)]| {
        let difference = |&(time_s, value): &(f64, f64)| {
            Some(value - nearest_in_time(b, time_s - begin_a_s + begin_b_s)?)
        };
        let differences: Vec<f64> = a.iter().filter_map(difference).collect();
        let mean_square =
            differences.iter().map(|d| d * d).sum::<f64>() / differences.len().max(1) as f64;
        (differences.len() >= FEWEST_DIFFERENCES && mean_square > 0.0)
            .then(|| (mean_square / 2.0).sqrt())
    };
    Ok([
        differs(&a.current_residual, &b.current_residual),
        differs(&a.speed_residual, &b.speed_residual),
    ])
}

/// Pairs of samples below which two runs do not give a floor.
const FEWEST_DIFFERENCES: usize = 100;

/// How far apart two samples may be and still be of the same instant, s: a few samples of a serial line.
const SAME_INSTANT_S: f64 = 0.05;

/// Value of the point nearest to `time_s`, if it is of the same instant.
fn nearest_in_time(points: &[(f64, f64)], time_s: f64) -> Option<f64> {
    let after = points.partition_point(|point| point.0 < time_s);
    let around = points[after.saturating_sub(1)..].iter().take(2);
    let apart_s = |point: &&(f64, f64)| (point.0 - time_s).abs();
    let nearest = around.min_by(|a, b| apart_s(a).total_cmp(&apart_s(b)))?;
    ((nearest.0 - time_s).abs() < SAME_INSTANT_S).then_some(nearest.1)
}

// Whether two runs are the same record: a hold-out that has been fitted validates nothing.

/// Samples below which equal ones may be chance.
const FEWEST_MOVING: usize = 20;
/// Times that differ by less are one, s: stamps carry rounding.
const SAME_TIME_S: f64 = 1e-6;

/// Share of `other`'s moving samples that are also in `run`, number by number, at the same time or at the same time
/// after the beginning. Two measurements of one motion differ in their noise.
pub fn shared_samples(run: &Scenario, other: &Scenario) -> f64 {
    let begins_s = other.sample_time_s[0] - run.sample_time_s[0];
    f64::max(shared(run, other, 0.0), shared(run, other, begins_s))
}

fn shared(run: &Scenario, other: &Scenario, later_s: f64) -> f64 {
    let (mut equal, mut compared, mut at) = (0_usize, 0_usize, 0);
    let mut before = [0.0; 2];
    for (sample, time_s) in other.sample_time_s.iter().enumerate() {
        let values = [other.current_a[sample], other.speed_rad_s[sample]];
        // A constant reading, as at rest, does not identify the record.
        let moves = values
            .iter()
            .zip(&before)
            .any(|(value, before)| value.is_finite() && (value - before).abs() > 0.0);
        before = values;
        if !moves {
            continue;
        }
        compared += 1;
        let sought_s = time_s - later_s;
        let is_before = |there_s: &f64| *there_s < sought_s - SAME_TIME_S;
        at += run.sample_time_s[at..].iter().take_while(|there_s| is_before(there_s)).count();
        let there_s = run.sample_time_s.get(at);
        if there_s.is_none_or(|there_s| (there_s - sought_s).abs() > SAME_TIME_S) {
            continue;
        }
        let there = [run.current_a[at], run.speed_rad_s[at]];
        let mut pairs = values
            .iter()
            .zip(&there)
            .filter(|(value, there)| value.is_finite() && there.is_finite())
            .peekable();
        #[expect(clippy::float_cmp, reason = "the very same number is what is sought")]
        if pairs.peek().is_some() && pairs.all(|(value, there)| value == there) {
            equal += 1;
        }
    }
    if compared < FEWEST_MOVING { 0.0 } else { equal as f64 / compared as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::nameplate;
    use drivebench_model::plant::testing::record;

    /// At rest for so long, then steps every two seconds, at 1 kHz.
    fn run(at_rest_s: f64, seconds: f64) -> (Model, Scenario) {
        let model = nameplate();
        let steps = (0..1000).map(|k| 2.0 * f64::from(k)).map_while(|time_s| {
            let time_s = at_rest_s + time_s;
            (time_s < seconds).then_some((time_s, 20.0 + (7.0 * time_s) % 31.0))
        });
        let events = std::iter::once((0.0, 0.0)).chain(steps).collect();
        (model.clone(), record(&model, events, 1e-3, seconds, 5))
    }

    fn holds_out(evidence: &Evidence, share: f64) -> bool {
        (evidence.held_out_share() - share).abs() < 0.005
    }

    /// Seconds and rows of the parts that are searched, and whether the rest confirms.
    fn searched(limit: Option<&Limit>) -> (Vec<[usize; 5]>, bool) {
        let Some(Limit::PartSearched { parts, rest_confirms }) = limit else {
            return (Vec::new(), false);
        };
        let figures = parts.iter().map(|part| {
            let [from_s, to_s, whole_s] =
                [part.from_s, part.to_s, part.whole_s].map(|time_s| whole(time_s.round()));
            [from_s, to_s, whole_s, part.rows, part.of_rows]
        });
        (figures.collect(), *rest_confirms)
    }

    #[test]
    fn the_held_out_part_moves_where_the_run_does() {
        let model = nameplate();
        let of = |events: &[(f64, f64)]| {
            Evidence::new(record(&model, events.to_vec(), 4e-3, 10.0, 5), None, None)
        };
        // Steps throughout; steps in the first half only; one step at the beginning.
        let all = of(&[(0.0, 0.0), (1.0, 40.0), (4.0, 80.0), (7.0, 20.0)]);
        assert!(all.holdout_moves() && holds_out(&all, 0.4));
        let early = of(&[(0.0, 0.0), (1.0, 40.0), (3.5, 80.0), (4.5, 20.0)]);
        assert!(early.holdout_moves() && holds_out(&early, 0.6), "{}", early.held_out_share());
        let step = of(&[(0.0, 0.0), (1.0, 40.0)]);
        assert!(!step.holdout_moves() && holds_out(&step, 0.4));
        assert!(step.unjudged().contains(&Limit::HoldoutStill));
    }

    #[test]
    fn of_a_long_run_the_begin_is_searched_and_the_rest_confirms() {
        let (model, long) = run(30.0, 150.0);
        let (evidence, limit) = Evidence::new(long.clone(), None, None).shortened();
        let whole = searched(limit.as_ref());
        assert_eq!(whole, (vec![[20, 120, 150, 100_000, 150_000]], true), "{limit:?}");
        assert_eq!(evidence.training.samples(), 60_000);
        assert_eq!(evidence.holdout.scored, 60_000..100_000);
        let confirm = evidence.confirm.as_ref().unwrap();
        assert_eq!(confirm.scored.start, 100_000);
        assert_eq!(confirm.sample_time_s.last(), long.sample_time_s.last());
        for part in [&evidence.training, &evidence.holdout, confirm] {
            let nrms = Score::of(&model, part, &evidence.noise).unwrap().nrms;
            assert!((nrms - 1.0).abs() < 0.05, "{}: {nrms}", part.name);
        }
    }

    #[test]
    fn of_several_long_runs_nothing_that_is_fitted_is_held_out() {
        let (model, long) = run(30.0, 100.0);
        let (_, later) = run(0.5, 40.0);
        let mut evidence = Evidence::new(long.clone(), None, None);
        evidence.repeat = Some(long.clone());
        let evidence = evidence.with_run(later);
        assert!(evidence.training.samples() > MOST_SAMPLES);
        let (evidence, limit) = evidence.shortened();
        let rows = searched(limit.as_ref()).0.into_iter().map(|part| (part[3], part[4]));
        assert_eq!(rows.collect::<Vec<_>>(), [(50_000, 100_000), (30_000, 40_000)], "{limit:?}");
        assert_eq!(evidence.first_run().samples(), 30_000);
        assert_eq!(evidence.holdout.scored, 30_000..50_000);
        assert_eq!(evidence.training.samples(), 60_000);
        let begin_s = evidence.training.begin_s() + evidence.begins_s[1];
        assert!((evidence.training.sample_time_s[30_000] - begin_s).abs() < 1e-9);
        // The repeated run begins where the first does.
        let repeat = evidence.repeat.as_ref().unwrap();
        let first = evidence.first_run();
        assert_eq!(repeat.sample_time_s[..30_000], first.sample_time_s[..]);
        for part in [&evidence.training, &evidence.holdout] {
            let nrms = Score::of(&model, part, &evidence.noise).unwrap().nrms;
            assert!((nrms - 1.0).abs() < 0.05, "{}: {nrms}", part.name);
        }
    }

    #[test]
    fn a_third_run_is_appended_with_its_begin() {
        let (_, first) = run(0.5, 4.0);
        let slow =
            drivebench_model::plant::testing::record(&nameplate(), vec![(0.0, 30.0)], 0.05, 5.0, 3);
        let evidence = Evidence::new(first.clone(), Some(slow.clone()), None);
        let evidence = evidence.with_run(slow.clone()).with_run(first.clone());
        let training = &evidence.training;
        let places = [0, first.samples(), first.samples() + slow.samples()];
        for (place, begin_s) in places.into_iter().zip(&evidence.begins_s) {
            let there_s = training.sample_time_s[place] - training.begin_s();
            let behind_s = if place == first.samples() { &slow } else { &first };
            let behind_s = behind_s.sample_time_s[0] - behind_s.begin_s();
            assert!((there_s - begin_s - behind_s).abs() < 1e-9, "{place}");
        }
        let alone = evidence.first_run_only();
        assert_eq!(alone.training.samples(), first.samples());
        assert_eq!(alone.begins_s, [0.0]);
    }

    #[test]
    fn a_short_run_is_not_cut() {
        let (_, short) = run(0.5, 20.0);
        let (evidence, limit) = Evidence::new(short.clone(), Some(short), None).shortened();
        assert!(limit.is_none() && evidence.confirm.is_none());
        assert_eq!(evidence.training.scored, evidence.holdout.scored);
    }

    #[test]
    fn a_confirming_run_is_not_replaced() {
        let (_, long) = run(0.5, 70.0);
        let (_, short) = run(0.5, 20.0);
        let evidence = Evidence::new(long, Some(short.clone()), Some(short.clone()));
        let (evidence, limit) = evidence.shortened();
        let (parts, rest_confirms) = searched(limit.as_ref());
        assert!(parts[0][3] == 60_000 && !rest_confirms, "{limit:?}");
        assert_eq!(evidence.training.samples(), 60_000);
        assert_eq!(evidence.holdout.samples(), short.samples());
        assert_eq!(evidence.confirm.unwrap().name, short.name);
    }

    fn step(seed: u64) -> Scenario {
        record(&nameplate(), vec![(0.0, 0.0), (0.4, 40.0)], 1e-3, 2.0, seed)
    }

    #[test]
    fn a_copy_a_part_and_a_later_copy_are_the_same_run_and_a_repetition_is_not() {
        let (first, repeated) = (step(1), step(2));
        let mut part = first.clone();
        part.sample_time_s.drain(..500);
        part.current_a.drain(..500);
        part.speed_rad_s.drain(..500);
        let mut later = first.clone();
        for time_s in &mut later.sample_time_s {
            *time_s += 7.0;
        }
        for other in [&first, &part, &later] {
            assert!(shared_samples(&first, other) > 0.99);
        }
        assert!(shared_samples(&first, &repeated) < 0.01);
    }

    #[test]
    fn zeros_alone_are_no_copy() {
        let mut still = step(1);
        still.current_a.fill(0.0);
        still.speed_rad_s.fill(0.0);
        assert!(shared_samples(&still, &still).abs() < 1e-12);
    }
}
