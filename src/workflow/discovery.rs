//! The diagnosis by hand: search for missing effects, add or remove one, search again.
//!
//! ```text
//! Order -> Discovery::carry_out -> News, published as it comes, from any thread
//! ```
//!
//! Pure: a model and its evidence, without thread, file or screen. An error without a known cause can be described by a
//! fitted curve, as an effect of the model.

use drivebench_diagnose::{
    self as diagnosis, AddResult, AxisMap, Comparison, Diagnosis, EffectCurve, ErrorOf, Event,
    Evidence, ExperimentLimits, Fitted, HoldoutFrom, NextExperiment, RecordedChannels, Rung,
    Traces, compare, diagnose_with, effect_curve, error_curve, recommend,
};
use drivebench_identify::frequency_response::{Compared, compared, of_model};
use drivebench_identify::output_error::FitError;
use drivebench_model::plant::effect::{self, Axis, DefinitionError, ParameterRole};
use drivebench_model::plant::{Effect, Input, Model, Scenario, Slot};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Compares the present model with the runs, without a search for effects.
    Compare(ErrorOf),
    Diagnose,
    Add(&'static str),
    /// The same where the runs do not need it.
    Force(&'static str),
    Remove(&'static str),
    Undo,
    /// The curve of the error, by its index in the diagnosis' axis map, as a table effect.
    AddCurve(usize),
    Respond,
    /// Write the model; carried out by the owner of the files.
    Write,
}

#[derive(Clone, Debug)]
pub enum News {
    Progress(Event),
    /// The fitted model compared with the hold-out: how good it is and where it fails.
    Compared(Box<Comparison>),
    /// Every signal, measured and of the present model.
    Traced(Box<Traces>),
    /// The curves of the effects in the model and of the candidates that have a size; one without an effect is the error
    /// alone.
    Curves(Vec<EffectCurve>),
    Diagnosed(Box<Diagnosis>),
    /// The recommended run; none where none is needed.
    Recommended(Option<Box<NextExperiment>>),
    Added(Box<AddResult>),
    Removed(Box<AddResult>),
    /// The last change was undone: the changed effect, and the effects that the model has now.
    Undone {
        effect: &'static str,
        present: Vec<&'static str>,
    },
    /// The frequency response of the run, with that of the model where it is complete; or why there is none.
    Responded(Result<Box<Compared>, String>),
    Written(String),
    NotWritten(String),
    Failed(String),
}

/// Called from several threads, in no order.
pub type Publish<'a> = &'a (dyn Fn(News) + Sync);

/// A model on its way to the noise floor.
#[derive(Clone, Debug)]
pub struct Discovery {
    model: Model,
    evidence: Evidence,
    limits: Option<ExperimentLimits>,
    fitted: Option<Fitted>,
    ladder: Vec<Rung>,
    /// The axis maps of the error of the present model.
    curves: Vec<AxisMap>,
    /// A diagnosis that is known already; used for the first order.
    known: Option<Box<Diagnosis>>,
    /// Channels of the runs besides the signals of the model.
    recorded: RecordedChannels,
    /// The traces of the present model have been published.
    is_traced: bool,
    /// The diagnosis of the present model, with its recommended run.
    latest: Option<Box<Diagnosis>>,
    /// An effect that was added, with one that these runs do not distinguish from it.
    rivals: Vec<[&'static str; 2]>,
    /// The state before each change, the latest last.
    past: Vec<SavedState>,
}

#[derive(Clone, Debug)]
struct SavedState {
    changed: &'static str,
    model: Model,
    fitted: Option<Fitted>,
    rungs: usize,
    rivals: Vec<[&'static str; 2]>,
    answer: Option<Box<Diagnosis>>,
}

impl Discovery {
    /// `model` is where the fits start.
    pub fn new(model: Model, evidence: Evidence) -> Self {
        Self {
            model,
            evidence,
            limits: None,
            fitted: None,
            ladder: Vec::new(),
            curves: Vec::new(),
            known: None,
            recorded: RecordedChannels::default(),
            is_traced: false,
            latest: None,
            rivals: Vec::new(),
            past: Vec::new(),
        }
    }

    #[must_use]
    pub fn with_recorded(mut self, recorded: RecordedChannels) -> Self {
        self.recorded = recorded;
        self
    }

    /// The first diagnosis is this one, of the same model, evidence and limits, with its recommended run.
    #[must_use]
    pub fn with_answer(mut self, diagnosis: Diagnosis) -> Self {
        self.known = Some(Box::new(diagnosis));
        self
    }

    /// The same with one more run, which is fitted together with the others.
    #[must_use]
    pub fn with_run(&self, run: Scenario) -> Self {
        let evidence = self.evidence.clone().with_run(run);
        Self { limits: self.limits, ..Self::new(self.model.clone(), evidence) }
    }

    pub const fn evidence(&self) -> &Evidence {
        &self.evidence
    }

    #[must_use]
    pub const fn with_limits(mut self, limits: ExperimentLimits) -> Self {
        self.limits = Some(limits);
        self
    }

    pub const fn limits(&self) -> Option<&ExperimentLimits> {
        self.limits.as_ref()
    }

    /// The model that the next fit starts from.
    pub const fn model(&self) -> &Model {
        &self.model
    }

    /// The present model, fitted with the effects that were added; none before the first diagnosis.
    pub const fn fitted(&self) -> Option<&Fitted> {
        self.fitted.as_ref()
    }

    /// Every model so far with its held-out error, the first one first.
    pub fn ladder(&self) -> &[Rung] {
        &self.ladder
    }

    /// Carries out `order`. After an effect was added or removed, the next search begins at once.
    pub fn carry_out(&mut self, order: Order, publish: Publish<'_>) {
        let done = match order {
            Order::Compare(error_of) => self.compare(error_of, publish),
            Order::Diagnose => self.diagnose(publish),
            Order::Add(id) => self.change(id, Change::Add, publish),
            Order::Force(id) => self.change(id, Change::Force, publish),
            Order::Remove(id) => self.change(id, Change::Remove, publish),
            Order::Undo => self.undo(publish),
            Order::AddCurve(index) => self.add_curve(index, publish),
            Order::Respond => {
                publish(News::Responded(self.response().map(Box::new)));
                Ok(())
            }
            Order::Write => Ok(()),
        };
        if let Err(error) = done {
            publish(News::Failed(format!("{error}; {}", error.help())));
        }
    }

    fn diagnose(&mut self, publish: Publish<'_>) -> Result<(), FitError> {
        let is_electrical = self.evidence.training.input == Input::Voltage;
        if is_electrical {
            // Where the model fails is known long before its cause is.
            let (evidence, _) = self.evidence.fitted_with(&self.model.effect_ids());
            let (evidence, fit) = evidence.into_owned().with_baseline(&self.model)?;
            publish(News::Compared(Box::new(compare(&fit.model, &evidence, ErrorOf::Structure)?)));
            self.trace(&fit.model, &evidence, publish);
            let curve = error_curve(&fit.model, &evidence.holdout, &evidence.noise);
            publish(News::Curves(curve.ok().flatten().into_iter().collect()));
        }
        let known = self.known.take();
        let is_known = known.is_some();
        let progress = |event| publish(News::Progress(event));
        let mut diagnosis = if let Some(known) = known {
            *known
        } else {
            let mut found = diagnose_with(&self.model, self.evidence.clone(), &progress)?;
            found.mark_rivals(&self.rivals);
            found
        };
        self.evidence = self.evidence.clone().moved_as(&diagnosis.limits);
        if !is_electrical {
            let compared = compare(&diagnosis.baseline.model, &self.evidence, ErrorOf::Structure)?;
            publish(News::Compared(Box::new(compared)));
            self.trace(&diagnosis.baseline.model, &self.evidence.clone(), publish);
        }
        let known_next = diagnosis.next_experiment.take();
        if self.ladder.is_empty() {
            self.ladder.push(Rung {
                effects: self.model.effect_ids(),
                holdout_rmse: diagnosis.holdout_before,
            });
        }
        // A model that was changed by hand keeps the sizes that were published with the change.
        let ids = diagnosis.baseline.model.effect_ids();
        if self.fitted.as_ref().is_none_or(|fitted| fitted.model.effect_ids() != ids) {
            self.fitted = Some(diagnosis.baseline.clone());
        }
        self.curves.clone_from(&diagnosis.axis_map);
        self.latest = Some(Box::new(diagnosis.clone()));
        publish(News::Diagnosed(Box::new(diagnosis.clone())));
        publish(News::Curves(self.curves_of(&diagnosis)));
        let next = match &self.limits {
            _ if is_known => known_next,
            Some(limits) => recommend(&diagnosis, &self.evidence, limits)?,
            None => None,
        };
        if let Some(latest) = &mut self.latest {
            latest.next_experiment.clone_from(&next);
        }
        publish(News::Recommended(next.map(Box::new)));
        Ok(())
    }

    /// Compares the given model; where values are missing it is fitted first.
    fn compare(&mut self, error_of: ErrorOf, publish: Publish<'_>) -> Result<(), FitError> {
        let (mut evidence, mut model) = (self.evidence.clone(), self.model.clone());
        if model.require_complete().is_err() {
            let fit;
            (evidence, fit) = evidence.with_baseline(&model)?;
            model = fit.model;
        }
        let compared = compare(&model, &evidence, error_of)?;
        let noise = compared.noise;
        publish(News::Compared(Box::new(compared)));
        self.is_traced = false;
        self.trace(&model, &evidence, publish);
        let mut curves = Vec::new();
        curves.extend(error_curve(&model, &evidence.holdout, &noise).ok().flatten());
        for id in model.effect_ids() {
            curves.extend(effect_curve(&model, id, &evidence.holdout, &noise).ok().flatten());
        }
        publish(News::Curves(curves));
        Ok(())
    }

    /// Publishes the traces of a model once; the diagnosis does not depend on them.
    fn trace(&mut self, model: &Model, evidence: &Evidence, publish: Publish<'_>) {
        let is_fitted = std::mem::take(&mut self.is_traced);
        let (evidence, _) = evidence.fitted_with(&model.effect_ids());
        if let (false, Ok(traces)) = (is_fitted, Traces::of(model, &evidence, &self.recorded)) {
            publish(News::Traced(Box::new(traces)));
        }
    }

    /// The error alone, then the effects in the model, the named ones and the candidates that have a size; left out where they
    /// fail.
    fn curves_of(&self, diagnosis: &Diagnosis) -> Vec<EffectCurve> {
        let present = diagnosis.baseline.model.effect_ids().into_iter();
        let named = diagnosis.effects.iter().copied();
        let candidates = diagnosis.candidates.iter();
        let sized = candidates.filter(|candidate| !candidate.parameters.is_empty());
        let mut ids: Vec<&'static str> = Vec::new();
        for id in present.chain(named).chain(sized.map(|own| own.effect)) {
            if !ids.contains(&id) {
                ids.push(id);
            }
        }
        let samples = self.evidence.holdout.samples().max(1);
        // Each curve is a simulation of the run.
        let ids = ids.into_iter().take((1_000_000 / samples).clamp(1, 8)).map(Some);
        // For events, the first run without the later ones.
        let effects = diagnosis.model.model.effect_ids();
        let (evidence, _) = self.evidence.fitted_with(&effects);
        let mut curves = Vec::new();
        for id in std::iter::once(None).chain(ids) {
            // An event is in the fit run.
            let effect = id.and_then(effect::find);
            let happens_once = effect.is_some_and(|effect| {
                effect.parameters().iter().any(|spec| spec.role == ParameterRole::EventTime)
            });
            let run = if happens_once { &evidence.training } else { &evidence.holdout };
            curves.extend(diagnosis.curve_of(id, run, &diagnosis.baseline.noise).ok().flatten());
        }
        curves
    }

    /// Of the whole run, also where its last part is held out.
    fn response(&self) -> Result<Compared, String> {
        let evidence = &self.evidence;
        let run = if evidence.holdout_from == HoldoutFrom::Split {
            &evidence.holdout
        } else {
            evidence.first_run()
        };
        let runs = [run.clone()];
        let model = self.fitted.as_ref().map_or(&self.model, |own| &own.model);
        let is_complete = model.require_complete().is_ok() && run.input == Input::Voltage;
        let predicted = is_complete.then(|| of_model(model, &runs)).transpose();
        let predicted = predicted.map_err(|error| format!("{error}; {}", error.help()))?;
        compared(&runs, predicted.as_deref()).map_err(|error| format!("{error}; {}", error.help()))
    }

    fn undo(&mut self, publish: Publish<'_>) -> Result<(), FitError> {
        let Some(past) = self.past.pop() else {
            publish(News::Failed("there is no change by hand to undo".to_owned()));
            return Ok(());
        };
        (self.model, self.fitted) = (past.model, past.fitted);
        self.ladder.truncate(past.rungs);
        (self.rivals, self.known) = (past.rivals, past.answer);
        publish(News::Undone { effect: past.changed, present: self.model.effect_ids() });
        self.diagnose(publish)
    }

    fn change(
        &mut self,
        id: &'static str,
        change: Change,
        publish: Publish<'_>,
    ) -> Result<(), FitError> {
        let present = self.model.effects.iter().find(|active| active.id() == id);
        let Some(effect) = present.map(|active| active.effect).or_else(|| effect::find(id)) else {
            publish(News::Failed(format!("effect {id:?} is not in the catalogue")));
            return Ok(());
        };
        let evidence = self.evidence.clone();
        let mut result = if change == Change::Remove {
            self.model.without_effect(id)?;
            diagnosis::remove(effect, &self.model, evidence)?
        } else {
            self.model.with_effect(id)?;
            diagnosis::add(effect, &self.model, evidence)?
        };
        if change == Change::Force {
            result.force();
        }
        self.changed(result, change != Change::Remove, publish)
    }

    /// Adds an axis map as a table effect.
    fn add_curve(&mut self, index: usize, publish: Publish<'_>) -> Result<(), FitError> {
        let map = self.curves.get(index);
        let Some((map, axis)) = map.and_then(|map| Some((map, Axis::from_key(map.axis)?))) else {
            publish(News::Failed("the error depends on no axis of a table".to_owned()));
            return Ok(());
        };
        let axis_name = axis.key().split('_').next().unwrap_or_default();
        let id = format!("table_{}_{axis_name}", map.equation);
        if self.model.has(&id) {
            let reason = format!("{id} is in the model already: remove it to fit the curve anew");
            publish(News::Failed(reason));
            return Ok(());
        }
        let knots: Vec<f64> = map.knots.iter().copied().map(four_digits).collect();
        let effect = match curve_table(&id, map.equation, axis, &knots) {
            Ok(effect) => effect,
            Err(error) => {
                publish(News::Failed(format!("{error}; {}", error.help)));
                return Ok(());
            }
        };
        let mut model = self.model.clone();
        if let Some(fitted) = &self.fitted {
            hold_collinear_parameter(&mut model, &fitted.model, &id, map.equation, axis);
        }
        self.changed(diagnosis::add(effect, &model, self.evidence.clone())?, true, publish)
    }

    /// Keeps the state before a change, and the effects from which the changed one is not distinguished.
    fn remember(&mut self, id: &'static str, adds: bool) {
        self.past.push(SavedState {
            changed: id,
            model: self.model.clone(),
            fitted: self.fitted.clone(),
            rungs: self.ladder.len(),
            rivals: self.rivals.clone(),
            answer: self.latest.take(),
        });
        let answer = self.past.last().and_then(|past| past.answer.as_ref());
        if adds {
            let pairs = answer.iter().flat_map(|found| &found.confusable);
            let of_it = pairs.filter(|pair| pair.contains(&id));
            let other = |pair: &[&'static str; 2]| if pair[0] == id { pair[1] } else { pair[0] };
            self.rivals.extend(of_it.map(|pair| [id, other(pair)]));
        } else {
            self.rivals.retain(|pair| pair[0] != id);
        }
    }

    /// Takes over an accepted change, and searches again.
    fn changed(
        &mut self,
        result: AddResult,
        adds: bool,
        publish: Publish<'_>,
    ) -> Result<(), FitError> {
        let accepted = result.accepted;
        if accepted {
            self.remember(result.effect, adds);
            self.model = result.fit.model.clone();
            self.fitted = Some(result.fit.clone());
            self.ladder.extend(result.ladder.last().cloned());
        }
        let result = Box::new(result);
        let model = result.fit.model.clone();
        publish(if adds { News::Added(result) } else { News::Removed(result) });
        if accepted {
            // The change is shown before the next search, which takes longer.
            self.is_traced = false;
            self.trace(&model, &self.evidence.clone(), publish);
            self.is_traced = true;
            self.diagnose(publish)?;
        }
        Ok(())
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Change {
    Add,
    Force,
    Remove,
}

/// A table over these knots, its values yet to be fitted.
///
/// # Errors
/// Knots that do not rise, or too few or too many of them.
pub fn curve_table(
    id: &str,
    equation: &str,
    axis: Axis,
    knots: &[f64],
) -> Result<&'static dyn Effect, DefinitionError> {
    let knots = knots.iter().copied().map(toml::Value::from).collect();
    let settings = [
        ("equation", equation.into()),
        ("axis", axis.key().into()),
        ("knots", toml::Value::Array(knots)),
    ];
    let settings = toml::Table::from_iter(settings.map(|(key, value)| (key.to_owned(), value)));
    effect::define(id, &settings).map(|(effect, _)| effect)
}

/// A knot that a person can read in a model file.
pub fn four_digits(knot: f64) -> f64 {
    format!("{knot:.3e}").parse().unwrap_or(knot)
}

/// A curve over the current contains a resistance, one over the speed a back-EMF: the parameter is collinear with the curve
/// and cannot be identified, so that it is fixed at the value of the baseline's fit as long as the curve `id` is in the
/// model. Returns its key where that was done.
pub fn hold_collinear_parameter(
    model: &mut Model,
    fitted: &Model,
    id: &str,
    equation: &str,
    axis: Axis,
) -> Option<&'static str> {
    let held = match (equation, axis) {
        ("voltage", Axis::Current) => "resistance_ohm",
        ("voltage", Axis::Speed) => "back_emf_v_s_per_rad",
        _ => return None,
    };
    if model.fixed.iter().any(|key| key == held) {
        model.hold(id, held);
        return None;
    }
    let slot = fitted.slots().into_iter().find(|slot: &Slot| slot.key() == held)?;
    model.set(&slot, fitted.get(&slot)?);
    model.hold(id, held);
    Some(held)
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use drivebench_diagnose::{Answer, DiagnosisVerdict, Recommendation, Status};
    use drivebench_model::plant::testing::{self, with_a_fan};
    use drivebench_model::plant::{ActiveEffect, Motor};

    fn news_of(discovery: &mut Discovery, order: Order) -> Vec<News> {
        let news = Mutex::new(Vec::new());
        discovery.carry_out(order, &|item| news.lock().unwrap().push(item));
        news.into_inner().unwrap()
    }

    /// The answer with which the news end.
    #[track_caller]
    fn answer(news: &[News]) -> &Diagnosis {
        match news {
            [.., News::Diagnosed(diagnosis), News::Curves(_), News::Recommended(None)] => diagnosis,
            other => panic!("no answer: {other:?}"),
        }
    }

    /// Whether the only news is that the order was refused.
    fn is_refused(news: &[News]) -> bool {
        let [News::Added(result) | News::Removed(result)] = news else {
            return false;
        };
        !result.accepted
    }

    fn errors(discovery: &Discovery) -> Vec<f64> {
        discovery.ladder().iter().map(|rung| rung.holdout_rmse).collect()
    }

    fn of_a_fan() -> (Model, Evidence) {
        (Model::baseline(Motor::zk_22fc()), Evidence::new(with_a_fan(0), Some(with_a_fan(1)), None))
    }

    #[test]
    fn an_unexplained_error_is_described_by_its_curve() {
        let mut truth = Model::baseline(Motor::zk_22fc());
        let settings =
            "equation = \"torque\"\nexpression = \"a*exp(-((w-118)/15)^2)\"\nparameters = [\"a\"]";
        let (bump, _) = effect::define("custom", &settings.parse().unwrap()).unwrap();
        truth
            .effects
            .push(drivebench_model::plant::ActiveEffect { effect: bump, values: vec![Some(0.18)] });
        let levels = [30.0, 60.0, 45.0, 20.0, 52.0, 70.0, -30.0, 38.0];
        let record = |shift: usize| {
            let step = |step: usize| {
                let (level, begin_s) = (levels[(step + shift) % 8], 0.5 + 0.25 * step as f64);
                [(begin_s, level), (begin_s + 0.12, level + 5.0)]
            };
            let events = std::iter::once((0.0, 0.0)).chain((0..22).flat_map(step));
            testing::record(&truth, events.collect(), 0.002, 6.0, shift as u64 + 1)
        };
        let evidence = Evidence::new(record(0), Some(record(3)), None);
        let mut discovery = Discovery::new(Model::baseline(Motor::zk_22fc()), evidence);
        let nothing = news_of(&mut discovery, Order::AddCurve(0));
        assert!(matches!(&nothing[..], [News::Failed(_)]), "{nothing:?}");
        let news = news_of(&mut discovery, Order::Diagnose);
        let diagnosis = answer(&news);
        assert_eq!(diagnosis.verdict, DiagnosisVerdict::Unexplained);
        // No effect is supported where none is named.
        let mut statuses = diagnosis.candidates.iter().map(|found| found.status);
        assert!(statuses.all(|status| status != diagnosis::Status::Supported));
        assert_eq!(diagnosis.axis_map[0].axis, "speed_rad_s");
        let first = &news_of(&mut discovery, Order::AddCurve(0))[0];
        assert!(matches!(first, News::Added(result) if result.accepted), "{first:?}");
        let errors = errors(&discovery);
        assert!(errors.len() == 2 && errors[1] < 0.6 * errors[0], "{errors:?}");
        assert_eq!(discovery.ladder()[1].effects, ["table_torque_speed"]);
        assert!(is_refused(&news_of(&mut discovery, Order::Remove("table_torque_speed"))));
    }

    #[test]
    fn an_effect_takes_the_error_to_the_floor_or_is_refused() {
        let (model, evidence) = of_a_fan();
        let mut discovery = Discovery::new(model, evidence);
        let news = news_of(&mut discovery, Order::Diagnose);
        assert!(matches!(news[0], News::Compared(_)), "{:?}", news[0]);
        let is_screened = |item: &&News| matches!(item, News::Progress(Event::Screened { .. }));
        assert!(news.iter().filter(is_screened).count() > 5);
        assert_eq!(answer(&news).effect, Some("quadratic_load"));
        assert_eq!(discovery.ladder().len(), 1);

        let refused = news_of(&mut discovery, Order::Add("current_offset"));
        assert!(is_refused(&refused), "{refused:?}");
        assert!(discovery.fitted().unwrap().model.effects.is_empty());

        let news = news_of(&mut discovery, Order::Add("quadratic_load"));
        assert!(matches!(&news[0], News::Added(result) if result.accepted));
        // What is missing now: nothing.
        assert_eq!(answer(&news).verdict, DiagnosisVerdict::None);
        let errors = errors(&discovery);
        // The floor is known from 200 samples at rest.
        assert!(errors.len() == 2 && errors[0] > 1.5 && errors[1] < 1.15, "{errors:?}");

        let again = news_of(&mut discovery, Order::Add("quadratic_load"));
        assert!(matches!(&again[..], [News::Failed(_)]), "{again:?}");
        let needed = news_of(&mut discovery, Order::Remove("quadratic_load"));
        assert!(is_refused(&needed), "{needed:?}");
        assert_eq!(discovery.fitted().unwrap().model.effect_ids(), ["quadratic_load"]);

        // After the undo the former diagnosis is used, without a search.
        let news = news_of(&mut discovery, Order::Undo);
        let undone = |item: &News| matches!(item, News::Undone { effect, present } if *effect == "quadratic_load" && present.is_empty());
        assert!(undone(&news[0]), "{:?}", news[0]);
        assert!(!news.iter().any(|item| matches!(item, News::Progress(_))));
        assert_eq!(answer(&news).effect, Some("quadratic_load"));
        assert_eq!(discovery.ladder().len(), 1);
        assert!(discovery.model().effects.is_empty());
        let nothing = news_of(&mut discovery, Order::Undo);
        assert!(matches!(&nothing[..], [News::Failed(_)]), "{nothing:?}");
    }

    #[test]
    fn a_refused_effect_can_be_forced_and_is_marked() {
        let (model, evidence) = of_a_fan();
        let mut discovery = Discovery::new(model, evidence);
        news_of(&mut discovery, Order::Diagnose);
        let news = news_of(&mut discovery, Order::Force("current_offset"));
        let News::Added(result) = &news[0] else {
            panic!("{:?}", news[0]);
        };
        assert!(result.accepted && result.forced);

        assert_eq!(discovery.model().effect_ids(), ["current_offset"]);
        assert_eq!(discovery.ladder().len(), 2);
    }

    #[test]
    fn a_rival_of_what_was_added_stays_on_the_list() {
        let mut diagnosis = crate::report::testing::diagnosis();
        diagnosis.verdict = DiagnosisVerdict::None;
        diagnosis.candidates.retain(|own| own.status == Status::RuledOut);
        assert_eq!(diagnosis.answer(), Answer::NothingMissing);
        diagnosis.mark_rivals(&[
            ["quadratic_load", "viscous_friction"],
            ["quadratic_load", "no_candidate"],
        ]);
        assert_eq!(diagnosis.candidates[0].as_good_as, Some("quadratic_load"));
        assert_eq!(diagnosis.answer(), Answer::NothingThatShows);
        let sentence = crate::report::wording::diagnosis::diagnosis(&diagnosis);
        assert!(!sentence.contains("nothing is missing"), "{sentence}");
        assert!(
            sentence.ends_with("does not distinguish quadratic_load from viscous_friction"),
            "{sentence}"
        );
        assert_eq!(
            diagnosis.candidates[0].status,
            Status::RuledOut,
            "the wording changes no status"
        );
    }

    #[test]
    fn a_known_diagnosis_is_not_computed_again() {
        let (model, evidence) = of_a_fan();
        let found = diagnosis::diagnose(&model, evidence.clone()).unwrap();
        let next = NextExperiment {
            finding: Recommendation::ShowsNothingMore,
            bench: None,
            pair: None,
            pairs: Vec::new(),
            reveals: Vec::new(),
            hidden: Vec::new(),
            expected_separation: 0.0,
            menu: Vec::new(),
            peaks: None,
            recipe: None,
        };
        let known = Diagnosis { next_experiment: Some(next), ..found };
        let limits = ExperimentLimits::seen_in(&evidence);
        let mut discovery = Discovery::new(model, evidence).with_limits(limits).with_answer(known);
        let news = news_of(&mut discovery, Order::Diagnose);
        let [
            News::Compared(_),
            News::Traced(traces),
            News::Curves(before),
            News::Diagnosed(diagnosis),
            News::Curves(curves),
            News::Recommended(Some(next)),
        ] = &news[..]
        else {
            panic!("{news:?}");
        };
        assert_eq!(diagnosis.effect, Some("quadratic_load"));
        assert_eq!((traces.runs.len(), before.len()), (2, 1));
        let drawn: Vec<_> = curves.iter().map(|curve| curve.effect).collect();
        assert_eq!(drawn, [None, Some("quadratic_load")]);
        // The error alone is that of the present model, which lacks the fan.
        assert_eq!((curves[0].equation, curves[0].axis), ("torque", "speed_rad_s"));
        assert_eq!(next.finding, Recommendation::ShowsNothingMore);
        // Of a changed model there is none yet.
        let news = news_of(&mut discovery, Order::Add("quadratic_load"));
        assert!(news.iter().any(|item: &News| matches!(item, News::Progress(_))), "{news:?}");
    }

    #[test]
    fn a_curve_over_the_current_takes_the_resistance_out_of_the_fit() {
        let fitted = Model::baseline(Motor::zk_22fc());
        let mut model = fitted.clone();
        for (id, equation, axis, held) in [
            ("table_i", "voltage", Axis::Current, Some("resistance_ohm")),
            ("table_i", "voltage", Axis::Current, None),
            ("table_w", "torque", Axis::Speed, None),
        ] {
            let found = hold_collinear_parameter(&mut model, &fitted, id, equation, axis);
            assert_eq!(found, held, "{id}");
            assert_eq!(model.fixed, ["resistance_ohm"], "{id}");
        }
        let curve = curve_table("table_i", "voltage", Axis::Current, &[-1.0, 0.0, 1.0]).unwrap();
        model.effects.push(ActiveEffect::new(curve));
        let without = model.without_effect("table_i").unwrap();
        assert!(without.fixed.is_empty(), "{:?}", without.fixed);
    }
}
