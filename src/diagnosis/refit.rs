//! Refits of the candidates with everything else free, as few as an honest answer needs.
//!
//! ```text
//! screen --(gain)--> promising: refit from the screen's start --(none at the floor)--> and from a second start
//!                    hopeful                                  --(none at the floor)--> refit from the screen's start
//!                    hopeless: one linear step, scored as it is
//! ```

use rayon::prelude::*;

use super::candidates::Refit;
use super::decide::{AT_THE_FLOOR, Settings, condensed};
use super::evidence::Evidence;
use super::family::related;
use super::progress::{Event, Progress, Stage};
use super::score::Score;
use super::screen::{Screen, Screened};
use super::search::Limits;
use crate::identification::output_error::{self, Fit, FitError};
use crate::numerics::levenberg_marquardt::Options;
use crate::plant::{ActiveEffect, Effect, Model, effect};

/// Candidates that the screen puts first and that are refitted whatever their gain.
const MOST_PROMISING: usize = 8;
/// Share of the best gain from which a candidate is refitted too.
const WORTH_A_REFIT: f64 = 0.2;

/// Share of the unexplained error below which the screen rules a candidate out: it would have to explain four times as
/// much to be worth its place, and the screen is not as wrong as that.
const HOPELESS: f64 = 0.005;
/// How many times as much as the screen says a candidate may explain after all.
const SCREEN_IS_WRONG_BY: f64 = 4.0;

/// How many candidates are refitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Thoroughness {
    /// Those that the screen puts first; all that it does not rule out where none of those explains the run to its noise.
    Promising,
    /// Every candidate, from two starts each.
    Everything,
}

/// Screens every effect that `baseline` does not have and refits what may be the answer. `original` is the model before
/// any fit: a second start, because a missing effect distorts the baseline's fit (DISCOVERY.md, pitfall 7). Of the error
/// above the noise a candidate must explain `asked` to be of use.
pub(super) fn refit_all(
    evidence: &Evidence,
    baseline: &Fit,
    original: &Model,
    asked: f64,
    limits: Limits<'_>,
) -> Result<Vec<Refit>, FitError> {
    let progress = limits.progress;
    let on = On {
        evidence,
        settings: limits.settings,
        progress,
    };
    let effects: Vec<&'static dyn Effect> = effect::CATALOGUE
        .iter()
        .copied()
        .filter(|effect| {
            let id = effect.card().id;
            let mut present = baseline.model.effects.iter();
            !present.any(|active| active.id() == id || related(active.id(), id))
        })
        .collect();
    let screen = Screen::new(baseline, &evidence.training);
    let mut screened = screen.all(&effects, progress);
    screened.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    let best_gain = screened.first().map_or(0.0, |first| first.gain);
    let everything = limits.thoroughness == Thoroughness::Everything;
    let above_noise = 1.0
        - (evidence.noise.tolerance(1.0) / baseline.nrms)
            .powi(2)
            .min(1.0);
    let least = (asked * above_noise / SCREEN_IS_WRONG_BY).max(HOPELESS);
    let hopeful = |candidate: &Screened| everything || candidate.gain >= least * screen.error();
    let promising = |rank: usize, candidate: &Screened| {
        let first = rank < MOST_PROMISING || candidate.gain > WORTH_A_REFIT * best_gain;
        everything || (first && hopeful(candidate))
    };
    let from_screen = |candidate: &Screened, fitted: bool| {
        let options = if fitted {
            Options::thrifty()
        } else {
            AS_SCREENED
        };
        on.refit(candidate, &candidate.start, options)
    };
    let fitted = screened.iter().enumerate();
    let fitted = fitted.filter(|(rank, candidate)| promising(*rank, candidate));
    progress(Event::Begun {
        stage: Stage::Refit,
        of: fitted.count(),
    });
    let first: Vec<Result<Refit, FitError>> = screened
        .par_iter()
        .enumerate()
        .map(|(rank, candidate)| from_screen(candidate, promising(rank, candidate)))
        .collect();
    let at_floor = evidence.noise.tolerance(AT_THE_FLOOR) * evidence.floor();
    let is_solved =
        |refit: &Result<Refit, FitError>| refit.as_ref().is_ok_and(|r| r.fit.nrms < at_floor);
    if first.iter().any(is_solved) && !everything {
        return finished(first);
    }
    let unsolved = screened
        .iter()
        .zip(&first)
        .filter(|(candidate, first)| !is_solved(first) && hopeful(candidate));
    progress(Event::Begun {
        stage: Stage::Refit,
        of: unsolved.count(),
    });
    let second: Vec<Result<Refit, FitError>> = screened
        .par_iter()
        .zip(first)
        .enumerate()
        .map(|(rank, (candidate, first))| {
            if is_solved(&first) || !hopeful(candidate) {
                return first;
            }
            if !promising(rank, candidate) {
                return from_screen(candidate, true);
            }
            let Some(start) = second_start(candidate, baseline, original) else {
                return first;
            };
            better(first, on.refit(candidate, &start, Options::thrifty()))
        })
        .collect();
    finished(second)
}

/// One effect from both starts, to the full.
pub(super) fn refit_one(
    evidence: &Evidence,
    baseline: &Fit,
    original: &Model,
    effect: &'static dyn Effect,
    settings: Settings,
) -> Result<Refit, FitError> {
    let candidate = Screen::new(baseline, &evidence.training).effect(effect)?;
    let options = Options::default();
    On::quiet(evidence, settings).of_both_starts(baseline, original, &candidate, options)
}

/// A screened effect from both starts, as well as is needed to compare it; [`polished`] carries the fit on.
pub(super) fn refit_screened(
    evidence: &Evidence,
    baseline: &Fit,
    original: &Model,
    candidate: &Screened,
    settings: Settings,
) -> Result<Refit, FitError> {
    let options = Options::thrifty();
    On::quiet(evidence, settings).of_both_starts(baseline, original, candidate, options)
}

/// The same candidate fitted to the end, for its uncertainties.
pub(super) fn polished(
    evidence: &Evidence,
    refit: &Refit,
    settings: Settings,
) -> Result<Refit, FitError> {
    let fit = output_error::fit(
        std::slice::from_ref(&refit.fit.model),
        &evidence.training,
        &evidence.noise,
    )?;
    let holdout = Score::of(&fit.model, &evidence.holdout, &evidence.noise)?;
    Ok(Refit {
        holdout: condensed(holdout, settings),
        fit,
        refitted: true,
        ..refit.clone()
    })
}

/// The screen's linear step as it is.
const AS_SCREENED: Options = Options {
    most_iterations: 0,
    relative_cost: 0.0,
    longest_step: 0.0,
    carry_jacobian: false,
    one_of_many: true,
};

/// The model as it was given, with what has been accepted since and the effect as the screen found its shape.
fn second_start(candidate: &Screened, baseline: &Fit, original: &Model) -> Option<Model> {
    original.require_complete().ok()?;
    let mut start = original.clone();
    for active in &baseline.model.effects {
        if !start.has(active.id()) {
            start.effects.push(active.clone());
        }
    }
    let screened = candidate.start.effects.last()?;
    let specs = candidate.effect.parameters();
    let values = screened
        .values
        .iter()
        .zip(specs)
        .map(|(value, spec)| if spec.is_coefficient() { None } else { *value })
        .collect();
    start.effects.push(ActiveEffect {
        effect: candidate.effect,
        values,
    });
    Some(start)
}

/// What every refit of one search has in common.
#[derive(Clone, Copy)]
struct On<'a> {
    evidence: &'a Evidence,
    settings: Settings,
    progress: Progress<'a>,
}

impl<'a> On<'a> {
    fn quiet(evidence: &'a Evidence, settings: Settings) -> Self {
        Self {
            evidence,
            settings,
            progress: &super::progress::silent,
        }
    }

    fn of_both_starts(
        self,
        baseline: &Fit,
        original: &Model,
        candidate: &Screened,
        options: Options,
    ) -> Result<Refit, FitError> {
        let from = |start: &Model| self.refit(candidate, start, options);
        match second_start(candidate, baseline, original) {
            Some(second) => {
                let (a, b) = rayon::join(|| from(&candidate.start), || from(&second));
                better(a, b)
            }
            None => from(&candidate.start),
        }
    }

    fn refit(
        self,
        candidate: &Screened,
        start: &Model,
        options: Options,
    ) -> Result<Refit, FitError> {
        let Self {
            evidence,
            settings,
            progress,
        } = self;
        let fit = output_error::fit_with(
            std::slice::from_ref(start),
            &evidence.training,
            &evidence.noise,
            options,
        )?;
        let refitted = options.most_iterations > 0;
        if refitted {
            progress(Event::Refitted {
                effect: candidate.effect.card().id,
                error: fit.nrms,
            });
        }
        let holdout = Score::of(&fit.model, &evidence.holdout, &evidence.noise)?;
        // Many are kept until one is chosen, and that one is fitted again (`polished`).
        let fit = Fit {
            minimum: fit.minimum.brief(),
            ..fit
        };
        Ok(Refit {
            effect: candidate.effect,
            holdout: condensed(holdout, settings),
            detectable: candidate.detectable,
            visible: candidate.visible,
            free_parameters: fit.free.len(),
            refitted,
            screened_share: candidate.share,
            fit,
        })
    }
}

fn better(a: Result<Refit, FitError>, b: Result<Refit, FitError>) -> Result<Refit, FitError> {
    match (a, b) {
        (Ok(a), Ok(b)) if b.fit.minimum.cost < a.fit.minimum.cost => Ok(b),
        (Ok(a), _) => Ok(a),
        (Err(_), b) => b,
    }
}

/// One effect that cannot be simulated on this motor must not hide the others; if none can, that is the answer.
fn finished(refits: Vec<Result<Refit, FitError>>) -> Result<Vec<Refit>, FitError> {
    let mut failure = None;
    let mut done = Vec::new();
    for refit in refits {
        match refit {
            Ok(refit) => done.push(refit),
            Err(error) => failure = Some(error),
        }
    }
    match failure {
        Some(error) if done.is_empty() => Err(error),
        _ => Ok(done),
    }
}
