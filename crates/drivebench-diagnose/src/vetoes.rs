//! Vetoes: reasons not to name an effect, whatever its posterior probability.
//!
//! A posterior compares sets of effects under a linearised model. Whether the refitted model with an effect is a better one is
//! a matter of the ladder: the effect has to have a size, to lower the error on data that the fit has not used by more than
//! chance, and to leave an inertia above zero. A veto halves the distance of a probability to the prior.

use super::diagnose::CONFIRMED_SIGMAS;
use super::evidence::Evidence;
use super::joint::answer::Inference;
use super::joint::free_run::likelier;
use super::ladder::{AS_GOOD, Bench, SIGNIFICANT_SIGMAS, Standing};
use super::limits::WhyOpen;
use super::residual::FEWEST_SAMPLES;
use super::score::Score;
use super::versus::{Better, ByBlocks};
use drivebench_identify::noise::FloorSource;
use drivebench_model::findings;
use drivebench_model::plant::effect::Path;
use drivebench_model::plant::{ActiveEffect, Model, MotorKey, ParameterRole, Scenario, effect};

/// Largest fall of a deviance by chance, with a free size at a free time.
const BY_CHANCE_DEVIANCE: f64 = 10.0;

/// Ratio of the errors before and after from which a fall is significant without the block test, a third of the squares; and
/// where the samples are too few to show whether errors are alike, or no posterior stands, three quarters of them.
pub(super) const CLEAR_FALL_RATIOS: [f64; 2] = [1.25, 2.0];

/// Most by which an effect that is there raises the held-out error of a model that has others, as a ratio: alone it was 1.007 in 976
/// machines of the study.
const MOST_RISE: f64 = 1.01;

/// Share of the squares that effects explain which the difference between their forms and those of the machine leaves: a harmonic of a
/// ripple with a seventh of its amplitude.
const FORM_SQUARES: f64 = 0.02;

/// An effect that is not named, and why.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Veto {
    pub(super) effect: &'static str,
    pub(super) reason: VetoReason,
}

findings! {
    /// Why an effect is not named.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub enum VetoReason {
        /// More than `most` effects would be named.
        Surplus { most: usize } = "too_many_effects",
        HoldoutStill = "holdout_still",
        /// The free run of the model with it diverges.
        Diverges = "free_run_diverges",
        /// Its refit does not halve the held-out error, which alone counts where the search was cut.
        SearchCut = "search_ended_by_budget",
        FrequencyTooHigh { found_hz: f64, highest_hz: f64 } = "frequency_above_half_the_sampling_rate",
        FrequencyUnknown { found_hz: f64, std_hz: f64 } = "frequency_not_determined",
        /// A parameter of its shape ends at a bound of the search, and an error is left: it is another shape.
        ShapeAtBound { key: &'static str, bound: f64 } = "shape_at_bound",
        SizeMayBeZero = "size_may_be_zero",
        /// The same by the balance of torques.
        SizeMayBeZeroInBalance = "size_may_be_zero_in_the_balance",
        /// Lags are known to this time only.
        ShortLag { known_s: f64 } = "lag_within_a_period",
        NoInertia = "no_inertia_left",
        ByChance = "no_better_than_chance",
        /// Most stays unexplained with all of them.
        Unexplained(WhyUnexplained) = "most_stays_unexplained",
        /// The held-out error before and after.
        NotLower { before: f64, after: f64, floor: FloorSource } = "held_out_error_not_lower",
    }
}

/// Why the probabilities are those of a model without predictive power.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhyUnexplained {
    Open(WhyOpen),
    SeveralTimesTheNoise,
    NotWhite,
}

/// Most effects of one diagnosis: more of them are an overfit.
const MOST_NAMED: usize = 8;

/// Those beyond that number, which explain least.
pub(super) fn surplus(inference: &Inference) -> Vec<Veto> {
    let beyond = inference.named.iter().skip(MOST_NAMED);
    let reason = VetoReason::Surplus { most: MOST_NAMED };
    beyond.map(|effect| Veto { effect, reason }).collect()
}

/// The first effect of those that `named` adds to the baseline, one on each of the further `rungs`, that may not be named; the
/// last of the ladder first.
pub(super) fn first(
    bench: &Bench,
    inference: &Inference,
    named: &[&'static str],
    rungs: &[Standing],
) -> Option<Veto> {
    let errors: Vec<f64> = rungs.iter().map(|rung| rung.score.nrms).collect();
    still(bench, named)
        .or_else(|| unsearched(inference.is_cut(), named, &errors))
        .or_else(|| unresolved(bench, named, rungs))
        .or_else(|| at_bound(bench, inference, named, rungs))
        .or_else(|| without_size(named, rungs))
        .or_else(|| short_lag(bench, inference, named, rungs))
        .or_else(|| without_inertia(bench, named, rungs))
        .or_else(|| by_chance(bench, inference, named, rungs))
        .or_else(|| without_use(bench, inference, named, rungs))
        .or_else(|| without_weight(bench, inference, named, rungs))
}

/// Any named effect where the hold-out does not change: its error is a constant, which every
/// effect with a size can remove.
fn still(bench: &Bench, named: &[&'static str]) -> Option<Veto> {
    let last = *named.last()?;
    let veto = Veto { effect: last, reason: VetoReason::HoldoutStill };
    (!bench.evidence.holdout_moves()).then_some(veto)
}

/// The last named effect whose rung does not halve the held-out error, where the search was ended by its budget: no set of effects
/// was confirmed, so that only the fall of the error counts. `errors` are those of the rungs.
fn unsearched(is_cut: bool, named: &[&'static str], errors: &[f64]) -> Option<Veto> {
    let [_, clear] = CLEAR_FALL_RATIOS;
    let is_clear = |pair: &[f64]| pair[0] >= clear * pair[1];
    let mut steps = errors.windows(2).zip(named).rev();
    let (_, effect) = steps.find(|(pair, _)| is_cut && !is_clear(pair))?;
    Some(Veto { effect, reason: VetoReason::SearchCut })
}

/// The last named effect with an unresolved oscillation: its frequency lies above half the sampling rate, or is
/// not distinguishable from zero.
fn unresolved(bench: &Bench, named: &[&'static str], rungs: &[Standing]) -> Option<Veto> {
    let fit = &rungs.last()?.fit;
    let most_hz = 0.5 / bench.evidence.training.mean_period_s();
    let of = |id: &'static str| {
        let mut specs = effect::find(id)?.parameters().iter();
        let key = format!("{id}.{}", specs.find(|spec| spec.unit == "Hz")?.key);
        let own = fit.parameters.iter().find(|own| own.key == key)?;
        let (value, std) = (own.value?, own.std.unwrap_or(0.0));
        let reason = if value > most_hz {
            VetoReason::FrequencyTooHigh { found_hz: value, highest_hz: most_hz }
        } else if value < std {
            VetoReason::FrequencyUnknown { found_hz: value, std_hz: std }
        } else {
            return None;
        };
        Some(Veto { effect: id, reason })
    };
    named.iter().rev().find_map(|id| of(id))
}

/// The last named effect with a parameter of its shape at a bound of its range, where the error stays above the floor; an event at the
/// begin of the run in any case.
fn at_bound(
    bench: &Bench,
    inference: &Inference,
    named: &[&'static str],
    rungs: &[Standing],
) -> Option<Veto> {
    let last = rungs.last()?;
    let is_reached = inference.floor(&bench.evidence).is_reached(last.score.nrms);
    named.iter().rev().find_map(|id| {
        let active = last.fit.model.effects.iter().find(|active| active.id() == *id)?;
        if is_reached && !happens_once(id) {
            return None;
        }
        let is_shared = inference.confusable.iter().any(|pair| pair[0] == *id);
        let reason = bound_reached(active, &bench.evidence.training, is_shared)?;
        Some(Veto { effect: id, reason })
    })
}

/// A parameter of the shape of an effect within 2 % of a bound that tells it from another effect: its limit, unless it shares its
/// probability with the simpler effect there, or a share of the run's length. At other bounds a shape may no longer change: a
/// winding that cools in an hour warms in proportion to the heat in every shorter run.
fn bound_reached(active: &ActiveEffect, run: &Scenario, is_shared: bool) -> Option<VetoReason> {
    let limit = active.effect.card().limit.filter(|_| !is_shared);
    let mut shapes = active.effect.parameters().iter().zip(active.values_or_guess()).enumerate();
    shapes.find_map(|(k, (spec, value))| {
        let limit = limit.filter(|own| own.parameter == k);
        let least = limit.map(|own| own.least_in(active.effect, run));
        let most = spec.most_of_length.is_finite().then(|| spec.in_run(&run.scales).max);
        let below = least.filter(|least| value < 1.02 * least);
        // Before the shaft turns nothing was measured: what has begun by then was always there, or holds the shaft at rest.
        let begin_s = first_motion_s(run) + 0.02 * run.scales.length_s;
        let at_begin = spec.role == ParameterRole::EventTime && value < begin_s;
        let below = below.or(at_begin.then_some(begin_s));
        let bound = below.or(most.filter(|most| 1.02 * value > *most))?;
        Some(VetoReason::ShapeAtBound { key: spec.key, bound })
    })
}

/// The first sample with a fiftieth of the largest speed, s after the first command.
fn first_motion_s(run: &Scenario) -> f64 {
    let moves = |speed_rad_s: &f64| speed_rad_s.abs() > 0.02 * run.scales.speed_rad_s;
    let first = run.speed_rad_s.iter().position(moves).unwrap_or(0);
    (run.sample_time_s[first] - run.begin_s()).max(0.0)
}

/// The last named effect whose size is not significant in the fit with all of them: to two standard deviations of an event, since it
/// is the largest of those at all times, and of an effect of which hardly a fall of the error shows that the forms of those before it
/// do not make it; to three where they explain a thousand times as much.
fn without_size(named: &[&'static str], rungs: &[Standing]) -> Option<Veto> {
    let fit = &rungs.last()?.fit;
    let is_without = |(pair, id): &(&[Standing], &&'static str)| {
        let errors = [&rungs[0], &pair[0], &pair[1]].map(|rung| rung.score.nrms);
        let share = share_of_forms(errors);
        let sigmas = if share < FORM_SQUARES / 20.0 {
            3.0
        } else if is_faint(pair, AS_GOOD) && share < FORM_SQUARES || happens_once(id) {
            2.0
        } else {
            1.0
        };
        fit.is_significant(id, sigmas * SIGNIFICANT_SIGMAS) == Some(false)
    };
    let (_, effect) = rungs.windows(2).zip(named).rev().find(is_without)?;
    Some(Veto { effect, reason: VetoReason::SizeMayBeZero })
}

/// The last named lag that is too short for its kind to be known; a filter of the current that clearly lowers the error is none, and no
/// delay of the command that both readings show.
fn short_lag(
    bench: &Bench,
    inference: &Inference,
    named: &[&'static str],
    rungs: &[Standing],
) -> Option<Veto> {
    let Standing { fit, score, .. } = rungs.last()?;
    let is_reached = inference.floor(&bench.evidence).is_reached(score.nrms);
    rungs.windows(2).zip(named).rev().find_map(|(pair, id)| {
        let active = fit.model.effects.iter().find(|active| active.id() == *id)?;
        let path = active.effect.terms(&active.values_or_guess()).path();
        let is_clear = pair[0].score.nrms >= CLEAR_FALL_RATIOS[0] * pair[1].score.nrms;
        let of_period = within_a_period(active, &bench.evidence.training)
            .filter(|_| path.current_filter_s == 0.0 || !is_clear);
        let within_a_filter = || within_a_filter(path, &fit.model, pair, is_reached);
        let reason = of_period.or_else(within_a_filter)?;
        Some(Veto { effect: id, reason })
    })
}

/// Share of the time constant of a reading's filter up to which a delay may be what its form differs by from the first order. To second
/// order a mean over a window is a filter of 0.29 and a delay of 0.21 of it, and two equal filters in a row are one of 1.41 and a
/// delay of 0.59 of either.
const FORM_OF_FILTER: f64 = 0.75;

/// A delay of the command with a named filter of one reading that may be of the form of this filter, unless it clearly lowers the error
/// of the other reading, which the filter does not touch, and nothing is left of another form.
fn within_a_filter(
    own: Path,
    model: &Model,
    pair: &[Standing],
    is_reached: bool,
) -> Option<VetoReason> {
    let paths =
        model.effects.iter().map(|other| other.effect.terms(&other.values_or_guess()).path());
    let filters = paths.map(|path| [path.current_filter_s, path.speed_filter_s]);
    let [of_current_s, of_speed_s] =
        filters.fold([0.0_f64; 2], |all, own| [all[0].max(own[0]), all[1].max(own[1])]);
    let rmse = |rung: &Standing| {
        [rung.score.current, rung.score.speed].map(|own| own.map_or(f64::NAN, |own| own.rmse))
    };
    let [before, after] = [&pair[0], &pair[1]].map(rmse);
    let falls = |reading: usize| before[reading] >= CLEAR_FALL_RATIOS[0] * after[reading];
    let is_shown = is_reached && (of_speed_s == 0.0 && falls(1) || of_current_s == 0.0 && falls(0));
    let known_s = FORM_OF_FILTER * of_current_s.max(of_speed_s);
    let is_within = own.command_delay_s > 0.0 && own.command_delay_s <= known_s;
    (is_within && !is_shown).then_some(VetoReason::ShortLag { known_s })
}

/// A lag of a reading below a seventh of the lag that it is known to have, to which its time and its kind are known, or of the period
/// between two readings, within which an inductance, or another form of an effect, does the same; or a delay after a rest below the same
/// part of that period, to which the instants of a command, and friction at rest, are not known.
fn within_a_period(active: &ActiveEffect, run: &Scenario) -> Option<VetoReason> {
    let period_s = run.mean_period_s() / 7.0;
    let of_speed_s = period_s.max(run.sensors.speed.total_s() / 7.0);
    let path = active.effect.terms(&active.values_or_guess()).path();
    let others_s = path.current_filter_s.max(path.start_delay_s).max(path.restart_delay_s);
    let lags = [(path.speed_delay_s + path.speed_filter_s, of_speed_s), (others_s, period_s)];
    let known = lags.into_iter().find(|(lag_s, known_s)| *lag_s > 0.0 && lag_s <= known_s);
    known.map(|(_, known_s)| VetoReason::ShortLag { known_s })
}

/// The effect with which the estimated inertia of a balance is no longer positive: its column is collinear with the balance
/// itself. An event has none to act on: of a commanded torque that steps it is the step itself.
fn without_inertia(bench: &Bench, named: &[&'static str], rungs: &[Standing]) -> Option<Veto> {
    if !bench.fits_at_once() {
        return None;
    }
    let has_inertia = |rung: &Standing| {
        let key = MotorKey::Inertia.key();
        let own = rung.fit.parameters.iter().find(|own| own.key == key);
        own.and_then(|own| own.value).is_some_and(|value| value > 0.0)
    };
    let mut steps = rungs.windows(2).zip(named);
    let (_, effect) = steps
        .find(|(pair, id)| !has_inertia(&pair[1]) && (has_inertia(&pair[0]) || happens_once(id)))?;
    Some(Veto { effect, reason: VetoReason::NoInertia })
}

/// The last named effect that lowers the errors on both runs by no more than chance, where those before it leave an
/// error at the floor: any, where the baseline is at the floor, and besides others one that is not detectable in these runs.
fn by_chance(
    bench: &Bench,
    inference: &Inference,
    named: &[&'static str],
    rungs: &[Standing],
) -> Option<Veto> {
    let evidence = &bench.evidence;
    let floor = inference.floor(evidence);
    let left = rungs.iter().position(|rung| floor.is_reached(rung.score.nrms));
    let left = left.filter(|left| !bench.fits_at_once() && left + 1 < rungs.len())?;
    let on_both = |rung: &Standing| {
        let fitted = Score::of(&rung.fit.model, &evidence.training, &evidence.noise).ok()?;
        let noise = &evidence.noise;
        Some(fitted.deviance(noise) + rung.score.deviance(noise))
    };
    let deviances = rungs[left..].iter().map(on_both);
    let steps = by_chance_steps(&deviances.collect::<Option<Vec<f64>>>()?);
    let mut named = steps.into_iter().rev().map(|step| named[left + step]);
    let is_excited = |id: &str| inference.of(id).is_some_and(|own| own.excited);
    let effect = named.find(|id| left == 0 || !is_excited(id))?;
    Some(Veto { effect, reason: VetoReason::ByChance })
}

/// What an effect explains, as a share of the squares that those before it explain; errors without any, before and with it. Infinite
/// for the first.
fn share_of_forms([base, before, after]: [f64; 3]) -> f64 {
    let explained = base * base - before * before;
    if explained > 0.0 { (before * before - after * after) / explained } else { f64::INFINITY }
}

/// The last named effect where all of them together explain hardly anything, and no linear solution of the search is valid, the
/// innovations are not white, or several times the noise is left: the probabilities of a model without predictive power.
fn without_weight(
    bench: &Bench,
    inference: &Inference,
    named: &[&'static str],
    rungs: &[Standing],
) -> Option<Veto> {
    let effect = *named.last()?;
    let floor = inference.floor(&bench.evidence);
    let [base, last] = [&rungs[0], rungs.last()?].map(|rung| rung.score.nrms);
    let much_is_left = floor.expected() > 0.0 && last > 3.0 * floor.expected();
    let is_valid = inference.why_open().is_none() && inference.is_nearly_white();
    if is_valid && !much_is_left || floor.is_explained_in_part(base, last) {
        return None;
    }
    let why = match inference.why_open() {
        Some(why) => WhyUnexplained::Open(why),
        None if inference.is_nearly_white() => WhyUnexplained::SeveralTimesTheNoise,
        None => WhyUnexplained::NotWhite,
    };
    Some(Veto { effect, reason: VetoReason::Unexplained(why) })
}

/// The last named effect that does not improve the prediction where the error stays above the floor with all of them: it is
/// fitted to another cause. On its rung it does not lower the held-out error by more than chance: neighbouring errors of a model
/// that lacks an effect are correlated, so that a small fall is judged by the blocks of the run. An event need not
/// occur in the hold-out: it may leave that error unchanged where it explains a good part of the fitted run's.
fn without_use(
    bench: &Bench,
    inference: &Inference,
    named: &[&'static str],
    rungs: &[Standing],
) -> Option<Veto> {
    let floor = inference.floor(&bench.evidence);
    let last = rungs.last()?.score.nrms;
    let not_lower = |effect: &'static str, pair: &[Standing]| {
        let [before, after] = [pair[0].score.nrms, pair[1].score.nrms];
        let floor = bench.evidence.noise.source;
        Veto { effect, reason: VetoReason::NotLower { before, after, floor } }
    };
    if floor.is_reached(last) {
        // A balance of torques with an error below the floor has systematic errors of its sensors, which are no noise: only a clear
        // fall is an effect (0.30 to 0.28 floors, of a current by a few thousandths, is none). An error of a free run that unknown
        // commands explain, and the noise does not, hides what an effect does; it must not rise, and
        // an event, which need not occur in the hold-out, must be clear in some run. At the noise an event after other effects must
        // show at all: their forms differ from those of the machine, to which an event of a few percent was fitted.
        let is_noise = floor.is_noise(last);
        let clear = CLEAR_FALL_RATIOS[0];
        let is_none = |(pair, id): &(&[Standing], &&str)| {
            let [before, after] = [pair[0].score.nrms, pair[1].score.nrms];
            if bench.fits_at_once() {
                let is_below = before < floor.expected() && before < clear * after;
                is_below || is_faint_event(id, pair, clear)
            } else {
                let is_of_sensors = bench.evidence.noise.is_at_the_floor(last);
                let ratio = if is_of_sensors { AS_GOOD } else { clear };
                let is_alone = pair[0].fit.model.effects.is_empty();
                let may_be_faint = is_of_sensors && is_alone;
                // A filter of the current that was not there, next to a voltage drop, raised it by 1.2 %.
                let most = if is_alone { 1.0 } else { MOST_RISE };
                let rises = after > most * before && !happens_once(id);
                let is_no_lower = rises || !is_noise && before <= after;
                is_no_lower || !may_be_faint && is_faint_event(id, pair, ratio)
            }
        };
        let mut steps = rungs.windows(2).zip(named).rev();
        return steps.find(is_none).map(|(pair, id)| not_lower(id, pair));
    }
    let is_of_no_use = |id: &str, pair: &[Standing]| {
        let held_out = [pair[0].score.nrms, pair[1].score.nrms];
        if happens_once(id) {
            let fitted = [pair[0].fit.nrms, pair[1].fit.nrms];
            let explains = |[before, after]: [f64; 2]| {
                !floor.is_reached(before) && floor.is_explained_in_part(before, after)
            };
            let is_as_good = held_out[1] <= AS_GOOD * held_out[0];
            bench.fits_at_once() && is_faint_event(id, pair, CLEAR_FALL_RATIOS[0])
                || !(explains(held_out) || explains(fitted) && is_as_good)
        } else {
            // Where the innovations are white with a known noise, the posterior accounts for the drift of the free run.
            let is_known = bench.evidence.noise.source != FloorSource::None;
            let is_white = is_known && inference.is_nearly_white() && !inference.is_cut();
            let samples = pair[1].score.samples();
            let clear = CLEAR_FALL_RATIOS[usize::from(samples < FEWEST_SAMPLES)];
            let is_little = held_out[0] < clear * held_out[1];
            // Errors of stamps decide the blocks of a free run; the innovations are weighted by them.
            let by_stamps = !bench.evidence.noise.is_at_the_floor(floor.expected());
            let by_chance = || {
                if by_stamps || bench.fits_at_once() && inference.is_nearly_white() {
                    return !is_likelier(bench, inference, pair);
                }
                let scores = [&pair[0].score, &pair[1].score];
                ByBlocks::of(scores, bench.levels()).better != Better::Second
            };
            !lowers(held_out, samples) || is_little && !is_white && by_chance()
        }
    };
    let mut named = rungs.windows(2).enumerate().rev().map(|(step, pair)| (named[step], pair));
    named.find(|(id, pair)| is_of_no_use(id, pair)).map(|(effect, pair)| not_lower(effect, pair))
}

/// Whether an event does not lower the error of any run by this ratio.
fn is_faint_event(id: &str, pair: &[Standing], ratio: f64) -> bool {
    happens_once(id) && is_faint(pair, ratio)
}

/// Whether the error of no run falls by this ratio.
fn is_faint(pair: &[Standing], ratio: f64) -> bool {
    let is_clear = |[before, after]: [f64; 2]| before >= ratio * after;
    let held_out = [pair[0].score.nrms, pair[1].score.nrms];
    let fitted = [pair[0].fit.nrms, pair[1].fit.nrms];
    !is_clear(held_out) && !is_clear(fitted)
}

/// Whether the hold-out is significantly likelier with the second of two models. The rows of a balance are means over long windows, of
/// which a slow record has too few for blocks.
fn is_likelier(bench: &Bench, inference: &Inference, pair: &[Standing]) -> bool {
    let Evidence { holdout, noise, .. } = &bench.evidence;
    let models = [&pair[0].fit.model, &pair[1].fit.model];
    let starts = [pair[0].fit.start, pair[1].fit.start];
    let is_known = noise.source != FloorSource::None;
    let found = likelier(models, starts, holdout, inference.noise, is_known);
    found.is_some_and(|(z, _)| z >= CONFIRMED_SIGMAS)
}

/// Whether an error of so many readings falls by more than chance: by the ratio of the likelihoods of normal errors of these
/// deviations.
fn lowers([before, after]: [f64; 2], samples: usize) -> bool {
    let fall = (before * before - after * after) / (after * after).max(f64::MIN_POSITIVE);
    samples as f64 * fall > BY_CHANCE_DEVIANCE
}

/// Whether an effect begins at an instant of a run.
pub(super) fn happens_once(id: &str) -> bool {
    let parameters = effect::find(id).map_or(&[][..], |found| found.card().parameters);
    parameters.iter().map(|own| own.role).any(|role| role == ParameterRole::EventTime)
}

/// The steps of a ladder that lower the deviance by no more than chance.
fn by_chance_steps(deviances: &[f64]) -> Vec<usize> {
    let steps = deviances.windows(2).enumerate();
    steps.filter(|(_, pair)| pair[0] - pair[1] < BY_CHANCE_DEVIANCE).map(|(step, _)| step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{active, nameplate, record};

    #[test]
    fn steps_by_chance_are_found() {
        // 2,400 readings: an error of 1.0007 floors that becomes 1.0005, and one of 1.02 that becomes 1.
        let of = |nrms: f64| 2400.0 * nrms * nrms;
        for (errors, expected) in [
            (&[1.0007, 1.0005][..], &[0][..]),
            (&[1.02, 1.0], &[]),
            (&[1.05, 1.0499, 1.02, 1.0199], &[0, 2]),
            (&[1.05, 1.06, 1.02], &[0]),
            (&[1.0], &[]),
        ] {
            let deviances: Vec<f64> = errors.iter().map(|nrms| of(*nrms)).collect();
            assert_eq!(by_chance_steps(&deviances), expected, "{errors:?}");
        }
    }

    #[test]
    fn what_a_strong_effect_leaves_may_be_of_its_form() {
        for (errors, hides) in [
            // Flux saturation of a geared servo, and what its form left, as an inductance saturation.
            ([5.48, 1.112, 1.110], true),
            // A torque ripple with harmonics, and Stribeck friction that is not there.
            ([1.507, 1.1455, 1.1398], true),
            ([1.06, 1.04, 1.03], false),
            ([5.48, 1.4, 1.1], false),
            // The first has no other before it.
            ([1.5, 1.5, 1.495], false),
        ] {
            assert_eq!(share_of_forms(errors) < FORM_SQUARES, hides, "{errors:?}");
        }
    }

    #[test]
    fn a_shape_at_the_bound_of_its_range_is_another_shape() {
        // A lag of more than a sixth of the run does not die out.
        let run = record(&nameplate(), 0, 1);
        let longest_s = run.scales.length_s / 6.0;
        let (lag, gaps) = ("lagged_drag", "discontinuous_conduction");
        let limit_a = 0.9 * run.scales.current_a / 100.0;
        for (id, values, is_shared, expected) in [
            (lag, [4e-4, 0.99 * longest_s], false, Some("time_constant_s")),
            (lag, [4e-4, 0.3], false, None),
            (gaps, [1.0, limit_a], false, Some("boundary_a")),
            (gaps, [1.0, limit_a], true, None),
            (gaps, [1.0, 1.1 * limit_a], false, None),
            ("winding_heating", [2e-3, 1e6], false, None),
            ("cogging", [-0.1, 0.1], false, None),
            // An event at the begin of the run was always there.
            ("friction_onset", [8e-4, 0.01 * run.scales.length_s], false, Some("time_s")),
            ("friction_onset", [8e-4, 0.3 * run.scales.length_s], false, None),
        ] {
            let key = match bound_reached(&active(id, &values), &run, is_shared) {
                Some(VetoReason::ShapeAtBound { key, .. }) => Some(key),
                _ => None,
            };
            assert_eq!(key, expected, "{id} {values:?}");
        }
    }

    #[test]
    fn a_lag_within_a_period_has_no_kind() {
        let mut run = record(&nameplate(), 0, 1);
        let period_s = run.mean_period_s();
        for (id, periods, known_s, is_short) in [
            ("current_filter", 0.13, 0.0, true),
            ("current_filter", 0.2, 0.0, false),
            ("speed_delay", 0.13, 0.0, true),
            ("speed_delay", 0.2, 0.0, false),
            ("speed_filter", 0.2, 2.0, true),
            ("current_filter", 0.2, 2.0, false),
            ("restart_delay", 0.1, 0.0, true),
            ("command_delay", 0.1, 0.0, false),
            ("viscous_friction", 0.1, 0.0, false),
        ] {
            run.sensors.speed.filter_s = known_s * period_s;
            let found = within_a_period(&active(id, &[periods * period_s]), &run);
            assert_eq!(found.is_some(), is_short, "{id} {periods} {known_s}");
        }
    }

    #[test]
    fn a_cut_search_names_effects_that_halve_the_error() {
        let named = ["backlash", "speed_delay"];
        let of =
            |is_cut, errors: &[f64]| unsearched(is_cut, &named, errors).map(|veto| veto.effect);
        assert_eq!(of(true, &[3.48, 1.24, 1.14]), Some("speed_delay"));
        assert_eq!(of(true, &[3.48, 2.0, 0.99]), Some("backlash"));
        assert_eq!(of(true, &[3.48, 1.24, f64::NAN]), Some("speed_delay"));
        assert_eq!(of(true, &[4.0, 2.0, 1.0]), None);
        assert_eq!(of(false, &[3.48, 1.24, 1.14]), None);
    }

    #[test]
    fn an_error_falls_by_more_than_chance_or_not() {
        for (errors, samples, falls) in [
            ([1.88, 17.83], 60, false),
            ([5.0, 5.0], 10_000, false),
            ([5.0, 4.999], 10_000, false),
            ([5.0, 4.99], 10_000, true),
            ([5.0, 4.9], 20, false),
            ([5.0, 2.0], 20, true),
            ([5.0, 0.0], 20, true),
            ([5.0, f64::NAN], 20, false),
        ] {
            assert_eq!(lowers(errors, samples), falls, "{errors:?} {samples}");
        }
    }
}
