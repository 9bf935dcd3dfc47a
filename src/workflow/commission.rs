//! State machine of the commissioning: its tasks, the stages that find an unknown motor, the analysis of the runs, the
//! progress for a screen, and the result.

use std::path::Path;
use std::sync::Arc;

use serde::Serialize;

use super::burst::BurstResult;
use super::discovery::Discovery;
use super::guide::{CommandContext, Role, Step};
use super::keyed::with_keys;
use super::next_bench::{experiment_limits, next_bench};
use super::truth::Truth;
use crate::report::Document;
use crate::report::wording::next_run::next_run;
use crate::report::wording::{self, json, location};
use drivebench_bench::{
    BenchFile, CheckReport, Design, Nameplate, Plan, Refusal, Scaled, bounds, loop_timing, scale,
};
use drivebench_control::Actuator;
use drivebench_diagnose::{
    self as diagnosis, Diagnosis, ErrorOf, Evidence, Recipe, Rung, compare, diagnose_with,
    recommend,
};
use drivebench_emulator::mystery::TrueEffect;
use drivebench_identify::escalation::{Ending, Escalation, Outcome, Stage, StageResult};
use drivebench_identify::nameplate::{self, Comparison};
use drivebench_identify::output_error::FitError;
use drivebench_identify::start;
use drivebench_model::plant::{FittedValue, Model, ModelError, Motor, Scenario, ScenarioError};
use drivebench_model::sample::{ParameterEstimate, Run};
use drivebench_model::text::shell::quoted;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// Open the link, identify the drive, prove the watchdog.
    Check,
    Escalate,
    Plan,
    Record(Role),
    /// Call [`Commission::analyse`], which takes seconds.
    Analyse,
    Save,
    Finished,
}

/// The commissioning with its data so far.
pub struct Commission {
    nameplate: Model,
    steps: Vec<StepView>,
    task: Task,
    scenarios: Vec<Scenario>,
    runs: Vec<RunRecord>,
    online: Vec<ParameterEstimate>,
    result: Option<CommissionResult>,
    /// The hidden effects of the emulator, for scoring the diagnosis at the end; not used by the analysis.
    truth: Option<Vec<TrueEffect>>,
    /// The bench, also of the recommended run.
    bench: BenchFile,
    discovery: Option<Discovery>,
    /// The nameplate, whatever the fits start from.
    nameplate_motor: Motor,
    escalation: Option<EscalationResult>,
    /// A burst of the first run, and where it is kept.
    burst: Option<(Scenario, String)>,
    /// Whether the loop could not be tuned.
    lacks_gains: bool,
    context: CommandContext,
}

impl Commission {
    /// `nameplate` is where the fits start; what it leaves out is found from the data. An `unknown` motor is found from
    /// small steps before the plan. A next run is recommended for the `bench` where one would help; the
    /// diagnosis is scored by the `truth` of an emulator. `context` is for the commands of the single steps.
    pub fn new(
        nameplate: Model,
        unknown: bool,
        bench: BenchFile,
        truth: Option<Vec<TrueEffect>>,
        context: CommandContext,
    ) -> Self {
        let steps = Step::all(unknown);
        let mut commission = Self {
            nameplate_motor: nameplate.motor.clone(),
            escalation: None,
            burst: None,
            nameplate,
            steps: steps.into_iter().map(StepView::new).collect(),
            task: Task::Check,
            scenarios: Vec::new(),
            runs: Vec::new(),
            online: Vec::new(),
            result: None,
            truth,
            bench,
            discovery: None,
            lacks_gains: false,
            context,
        };
        commission.set_step(Step::Connect, StepState::Active, "");
        commission
    }

    pub const fn task(&self) -> Task {
        self.task
    }

    pub fn progress(&self) -> Progress {
        let steps = self
            .steps
            .iter()
            .map(|step| StepView { command: step.step.command(&self.context), ..step.clone() });
        Progress { steps: steps.collect(), report: None, finished: self.task == Task::Finished }
    }

    pub const fn result(&self) -> Option<&CommissionResult> {
        self.result.as_ref()
    }

    /// The runs for a diagnosis by hand; none before the analysis.
    pub const fn discovery(&self) -> Option<&Discovery> {
        self.discovery.as_ref()
    }

    /// Everything recorded so far, in the order of [`Role::ALL`].
    pub fn scenarios(&self) -> &[Scenario] {
        &self.scenarios
    }

    /// The drive has replied: a failure from here on is one of its checks.
    pub fn answered(&mut self, name: &str) {
        self.step_done(Step::Connect, name, Task::Check);
    }

    pub fn checked(&mut self, report: &CheckReport) {
        let watchdog = report.watchdog_proven_s.map_or_else(
            || "watchdog not proven".to_owned(),
            |s| format!("watchdog proven within {:.0} ms", 1e3 * s),
        );
        let waived = if report.waived.is_empty() {
            String::new()
        } else {
            format!(", WAIVED: {}", report.waived.join(", "))
        };
        let line = format!(
            "{}, round trip {:.1} ms, {:.0} Hz reachable",
            report.identity.name(),
            1e3 * report.round_trip_p50_s,
            report.reachable_rate_hz,
        );
        self.step_done(Step::Connect, &line, Task::Check);
        let passed = report.items.len() - report.waived.len();
        let line = format!("{passed} of {} passed, {watchdog}{waived}", report.items.len());
        let is_unknown = self.steps.iter().any(|step| step.step == Step::Find);
        self.step_done(Step::Safety, &line, if is_unknown { Task::Escalate } else { Task::Plan });
    }

    pub fn escalating(&mut self, line: &str) {
        self.set_step(Step::Find, StepState::Active, line);
    }

    /// The motor was found: the next steps use it.
    pub fn escalated(&mut self, found: Motor, result: EscalationResult) {
        self.found(found, &result.sentence);
        self.escalation = Some(result);
    }

    /// The same with a sentence about the search.
    pub fn found(&mut self, found: Motor, sentence: &str) {
        self.nameplate = Model::baseline(found);
        self.step_done(Step::Find, sentence, Task::Plan);
    }

    pub fn planned(&mut self, plan: &Plan) {
        let line = format!(
            "peak {:.1} A ({:.1} times rated), {:.0} rad/s, {:.0} turns of travel, {:.1} s each run",
            plan.peak_current_a,
            plan.peak_current_ratio,
            plan.peak_speed_rad_s,
            drivebench_model::units::turns_from_rad(plan.travel_rad),
            plan.duration_s,
        );
        self.step_done(Step::Plan, &line, Task::Record(Role::Fit));
    }

    pub fn recorded(
        &mut self,
        role: Role,
        scenario: Scenario,
        run: RunRecord,
        online: Vec<ParameterEstimate>,
    ) {
        let index = role as usize;
        let line = format!(
            "{} rows at {:.1} Hz, {} cycles missed",
            run.rows, run.rate_hz, run.missed_cycles
        );
        if role == Role::Fit {
            self.online = online;
        }
        self.scenarios.push(scenario);
        self.context.runs.extend(run.folder.clone());
        self.runs.push(run);
        let next = Role::ALL.get(index + 1).map_or(Task::Analyse, |role| Task::Record(*role));
        self.step_done(Step::Record(role), &line, next);
    }

    /// The drive recorded a burst within a run; `capture` is where it is kept.
    pub fn captured(&mut self, burst: Scenario, capture: String) {
        self.burst = Some((burst, capture));
    }

    /// Identify, compare, diagnose and add, on what was recorded. Pure; `publish` is called after each step, and
    /// `diagnosing` receives the progress of the diagnosis.
    pub fn analyse(
        &mut self,
        mut publish: impl FnMut(Progress),
        diagnosing: diagnosis::Progress<'_>,
    ) -> Result<(), FitError> {
        let [fit, select, confirm, repeat] = &self.scenarios[..] else {
            return Err(FitError::TooFewRuns {
                runs: self.scenarios.len(),
                needed: Role::ALL.len(),
            });
        };
        let nameplate = start::complete(&self.nameplate, fit)?;
        let of = |(burst, kept): &(_, String)| BurstResult::of(&nameplate, burst, kept.clone());
        let burst = self.burst.as_ref().map(of);
        let nameplate = match &burst {
            Some(burst) => burst.improve(nameplate),
            None => nameplate,
        };
        let evidence = Evidence::new(fit.clone(), Some(select.clone()), Some(confirm.clone()));
        let (evidence, baseline) = evidence.with_baseline(&nameplate)?;
        let evidence = evidence.with_repeat(&baseline.model, repeat.clone())?;
        let confirming = Evidence { holdout: confirm.clone(), ..evidence.clone() };
        let line = format!(
            "{} of {} parameters, {} iterations",
            baseline.parameters.iter().filter(|p| p.value.is_some()).count(),
            baseline.parameters.len(),
            baseline.iterations
        );
        self.step_done(Step::Identify, &line, Task::Analyse);
        publish(self.progress());

        let before = compare(&baseline.model, &confirming, ErrorOf::Structure)?;
        self.step_done(Step::Compare, &location::failure(&before), Task::Analyse);
        publish(self.progress());

        let mut diagnosis = diagnose_with(&nameplate, evidence.clone(), diagnosing)?;
        let limits = experiment_limits(&self.bench);
        let mut next = recommend(&diagnosis, &evidence, &limits)?;
        if let Some(next) = &mut next {
            let (model, words) = (&diagnosis.model.model, next_run(next));
            let file = |recipe: &Recipe| next_bench(&self.bench, recipe, model, &words);
            next.bench = next.recipe.as_ref().map(file);
        }
        diagnosis.next_experiment = next;
        // The diagnosis by hand begins with this result.
        let discovery = Discovery::new(nameplate, evidence).with_answer(diagnosis.clone());
        self.discovery = Some(discovery.with_limits(limits));
        self.context.effect = diagnosis.effect;
        let sentence = wording::diagnosis::diagnosis(&diagnosis);
        self.step_done(Step::Diagnose, &sentence, Task::Analyse);
        publish(self.progress());

        let confirming = confirming.moved_as(&diagnosis.limits);
        let before = compare(&baseline.model, &confirming, ErrorOf::Structure)?;
        let after = compare(&diagnosis.model.model, &confirming, ErrorOf::Structure)?;
        let confirmed = diagnosis.rungs_on(&confirming.holdout, &confirming.noise)?;
        let line = if diagnosis.effects.is_empty() {
            "no effect is added".to_owned()
        } else {
            format!(
                "error on the confirming run {:.2} -> {:.2} {}",
                confirmed[0].holdout_rmse,
                confirmed[1].holdout_rmse,
                wording::times(diagnosis.noise_floor_from)
            )
        };
        self.step_done(Step::Ladder, &line, Task::Analyse);
        publish(self.progress());

        let tuned = self.tuned(&diagnosis);
        self.lacks_gains = tuned.is_err();
        let line = match &tuned {
            Ok(reasons) => reasons.first().cloned().unwrap_or_default(),
            Err(reason) => format!("no gains: {reason}"),
        };
        self.step_done(Step::Tune, &line, Task::Save);
        publish(self.progress());
        self.result = Some(CommissionResult {
            sentence,
            parameters_before: diagnosis.baseline.parameters.clone(),
            parameters: diagnosis.model.parameters.clone(),
            online: self.online.clone(),
            nameplate: compared(&self.nameplate_motor, &diagnosis.model.parameters),
            escalation: self.escalation.clone(),
            burst: burst.map(|burst| burst.with_diagnosis(&diagnosis)),
            ladder: diagnosis.ladder.clone(),
            truth: (self.truth.as_ref()).map(|hidden| Truth::of(hidden, &diagnosis)),
            runs: self.runs.clone(),
            diagnosis,
            before,
            after,
            confirmed,
        });
        Ok(())
    }

    /// Reasons of the gains of the bench's speed loop for the identified model, with one cycle of delay.
    fn tuned(&self, diagnosis: &Diagnosis) -> Result<Vec<String>, String> {
        let section = self.bench.speed.as_ref().ok_or("the bench file has no [speed]")?;
        let reference = self.bench.reference(section).map_err(|error| error.to_string())?;
        let model = &diagnosis.model.model;
        let motor = self.bench.motor.with_found(&model.motor).ok_or("the model lacks a value")?;
        let period_s = self.bench.period_s();
        let limits = self.bench.limits();
        let fitted = FittedValue::all(&diagnosis.model.parameters);
        let design = Design {
            model,
            fitted: &fitted,
            motor: &motor,
            limits: &limits,
            section,
            maps: &[],
            actuator: section.actuator.unwrap_or(Actuator::Voltage),
            timing: loop_timing(model, period_s, period_s + limits.dead_time_s),
            noise_rad_s: Some(diagnosis.model.noise.speed_rad_s)
                .filter(|noise| noise.is_finite())
                .unwrap_or_default(),
            peak_reference_rad_s: reference.peak_rad_s(),
        };
        design.regulator().map_or_else(|error| Err(error.to_string()), |found| Ok(found.reasons))
    }

    /// Everything is written. The steps on request are offered.
    pub fn saved(&mut self, line: &str) {
        self.step_done(Step::Report, line, Task::Finished);
        let next = self.result.as_ref().and_then(|result| result.diagnosis.next_experiment.clone());
        let words = next.as_ref().map(next_run);
        let offer = match (&next, words.as_deref()) {
            (Some(next), Some(words)) if next.bench.is_some() => Ok(words),
            (Some(_), Some(words)) => Err(words),
            _ => Err("none is recommended for these runs"),
        };
        self.offered(Step::Experiment, offer);
        let is_unknown = self.bench.motor.is_unknown();
        let refused = self.bench.check_speed("the bench file", "").err();
        let refused = refused.map(|error| error.to_string());
        let offer = match refused.as_deref() {
            _ if is_unknown => Err("write the values that were found into [motor] first"),
            _ if self.lacks_gains => Err("there are no gains"),
            Some(refused) => Err(refused),
            _ => Ok("with the identified model"),
        };
        self.offered(Step::SpeedLoop, offer);
    }

    fn offered(&mut self, step: Step, offer: Result<&str, &str>) {
        match offer {
            Ok(line) => self.set_step(step, StepState::Offered, line),
            Err(reason) => self.set_step(step, StepState::Withheld, reason),
        }
    }

    /// The active step failed; nothing follows.
    pub fn failed(&mut self, reason: &str) {
        if let Some(step) = self.steps.iter_mut().find(|step| step.state == StepState::Active) {
            step.state = StepState::Failed;
            reason.clone_into(&mut step.line);
        }
        self.task = Task::Finished;
    }

    fn set_step(&mut self, step: Step, state: StepState, line: &str) {
        if let Some(own) = self.steps.iter_mut().find(|own| own.step == step) {
            own.state = state;
            line.clone_into(&mut own.line);
        }
    }

    fn step_done(&mut self, step: Step, line: &str, next: Task) {
        self.set_step(step, StepState::Done, line);
        let index = self.steps.iter().position(|own| own.step == step);
        if let Some(following) = index.and_then(|index| self.steps.get_mut(index + 1)) {
            following.state = StepState::Active;
        }
        self.task = next;
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepState {
    Waiting,
    Active,
    Done,
    Failed,
    /// It can follow, on request.
    Offered,
    /// It cannot follow, for the reason in its line.
    Withheld,
}

/// One step with its figure, or its reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StepView {
    pub step: Step,
    pub state: StepState,
    pub line: String,
    pub command: Option<String>,
}

impl StepView {
    pub const fn new(step: Step) -> Self {
        Self { step, state: StepState::Waiting, line: String::new(), command: None }
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Progress {
    pub steps: Vec<StepView>,
    pub report: Option<Arc<Document>>,
    pub finished: bool,
}

impl Progress {
    /// Whether this step can follow now; the reason where not.
    pub fn is_offered(&self, step: Step) -> Result<(), &str> {
        match self.steps.iter().find(|own| own.step == step) {
            Some(own) if own.state == StepState::Offered => Ok(()),
            // A speed loop may be repeated, and so may a run that could not be judged. Without a command there is no run
            // left to make.
            Some(own)
                if matches!(own.state, StepState::Done | StepState::Failed)
                    && step.is_on_request()
                    && own.command.is_some() =>
            {
                Ok(())
            }
            Some(own) if self.finished && !own.line.is_empty() => Err(&own.line),
            _ => Err("not yet: it follows the report"),
        }
    }

    /// Sets the bench file with which a step can be repeated; `None` where it cannot.
    pub fn follows(&mut self, step: Step, file: Option<&Path>) {
        if let Some(own) = self.steps.iter_mut().find(|own| own.step == step) {
            own.command = file.map(|file| format!("drivebench run {}", quoted(file)));
        }
    }

    /// Records the result of a step that was done on request.
    pub fn done_on_request(&mut self, step: Step, outcome: Result<String, String>) {
        if let Some(own) = self.steps.iter_mut().find(|own| own.step == step) {
            (own.state, own.line) = match outcome {
                Ok(line) => (StepState::Done, line),
                Err(reason) => (StepState::Failed, reason),
            };
        }
    }
}

#[derive(Clone, Debug, Serialize)]
pub struct RunRecord {
    pub role: &'static str,
    /// Run folder; none where nothing is written.
    pub folder: Option<String>,
    pub rows: u64,
    pub rate_hz: f64,
    pub missed_cycles: u64,
}

#[derive(Clone, Debug, Serialize)]
pub struct CommissionResult {
    pub sentence: String,
    #[serde(serialize_with = "json::with_sentences")]
    pub diagnosis: Diagnosis,
    /// The refitted baseline and the model with the named effects, on the confirming run.
    #[serde(serialize_with = "json::compared")]
    pub before: diagnosis::Comparison,
    #[serde(serialize_with = "json::compared")]
    pub after: diagnosis::Comparison,
    #[serde(serialize_with = "with_keys")]
    pub parameters_before: Vec<ParameterEstimate>,
    #[serde(serialize_with = "with_keys")]
    pub parameters: Vec<ParameterEstimate>,
    /// The on-line estimates at the end of the fit run.
    #[serde(serialize_with = "with_keys")]
    pub online: Vec<ParameterEstimate>,
    /// The found values compared with the nameplate, where there is one.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "json::plate")]
    pub nameplate: Option<Comparison>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub escalation: Option<EscalationResult>,
    /// The result of a burst, where the exchanges are slower than the current.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub burst: Option<BurstResult>,
    /// Errors on the selecting run, one rung for each model.
    pub ladder: Vec<Rung>,
    pub confirmed: [Rung; 2],
    pub runs: Vec<RunRecord>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truth: Option<Truth>,
}

#[derive(Clone, Debug, Serialize)]
pub struct StageRecord {
    #[serde(flatten)]
    pub stage: StageResult,
    /// Why the stage was as large as it was.
    pub reason: String,
    pub folder: Option<String>,
}

#[derive(Clone, Debug)]
pub struct Escalate {
    escalation: Escalation,
    nameplate_motor: Motor,
    records: Vec<StageRecord>,
}

#[derive(Clone, Debug, Default, Serialize)]
pub struct EscalationResult {
    /// `found`, or the name of the reason why not.
    pub outcome: &'static str,
    pub sentence: String,
    pub stages: Vec<StageRecord>,
    #[serde(serialize_with = "with_keys")]
    pub parameters: Vec<ParameterEstimate>,
    /// The found values compared with the nameplate; none where it has no value or nothing was found.
    #[serde(serialize_with = "json::plate")]
    pub nameplate: Option<Comparison>,
    pub ending: Option<Ending>,
    /// The sequence as it was scaled to the motor.
    pub scaled: Option<Scaled>,
    #[serde(skip)]
    pub motor: Option<Motor>,
}

impl Escalate {
    pub fn new(bench: &BenchFile) -> Self {
        Self {
            escalation: Escalation::new(bounds(bench)),
            nameplate_motor: bench.motor.motor(),
            records: Vec::new(),
        }
    }

    /// What is to be run next; `None`: it is over.
    pub const fn stage(&self) -> Option<&Stage> {
        self.escalation.stage()
    }

    pub fn ran(&mut self, run: &Run, folder: Option<String>) -> Result<StageRecord, ScenarioError> {
        let reason = self.stage().map(|stage| stage.reason.clone());
        self.escalation.learn(run)?;
        let stage = self.escalation.history().last().cloned();
        let record = StageRecord {
            stage: stage.unwrap_or_default(),
            reason: reason.unwrap_or_default(),
            folder,
        };
        self.records.push(record.clone());
        Ok(record)
    }

    pub fn result(&self) -> EscalationResult {
        let mut result = EscalationResult {
            outcome: "running",
            stages: self.records.clone(),
            ..EscalationResult::default()
        };
        match self.escalation.outcome() {
            None => {}
            Some(Outcome::Named(ending)) => {
                result.outcome = ending.name();
                result.sentence = ending.sentence();
                result.ending = Some(ending.clone());
            }
            Some(Outcome::Found(found)) => {
                result.outcome = "found";
                result.nameplate = compared(&self.nameplate_motor, &found.parameters);
                let nameplate_motor = match &result.nameplate {
                    None => "",
                    Some(comparison) if comparison.fits => ", its nameplate fits",
                    Some(_) => ", its nameplate does NOT fit",
                };
                let stages = self.records.len();
                result.sentence =
                    format!("the motor was found in {stages} stages{nameplate_motor}");
                result.parameters.clone_from(&found.parameters);
                result.motor = Some(found.motor.clone());
            }
        }
        result
    }
}

impl EscalationResult {
    /// The nameplate with which the next steps are planned.
    pub fn found(&self, bench: &BenchFile) -> Option<Nameplate> {
        bench.motor.with_found(self.motor.as_ref()?)
    }

    /// Scales the bench's sequence to the motor that was found; the refusal where even the smallest exceeds a limit.
    pub fn scale(
        &mut self,
        bench: &BenchFile,
        drive_current_limit_a: Option<f64>,
    ) -> Result<Option<Refusal>, ModelError> {
        let Some(found) = self.found(bench) else {
            return Ok(None);
        };
        Ok(match scale(bench, &found, drive_current_limit_a)? {
            Ok(scaled) => {
                self.scaled = Some(scaled);
                None
            }
            Err(refusal) => Some(refusal),
        })
    }

    /// Puts the result under a label, and its stages, which are not on the card.
    pub fn put(&self, label: &str, document: &mut Document) {
        document.say(label, [self.sentence.as_str()], 1);
        let stages = self.stages.iter().enumerate().map(|(index, StageRecord { stage, .. })| {
            format!("{}. {}: {}", index + 1, stage.kind.name(), stage.line)
        });
        document.labelled("stages", stages);
        let refused = self.scaled.as_ref().filter(|scaled| scaled.refusal.is_some());
        document.labelled("sequence", refused.map(scaled_sentence));
    }
}

/// Why and how far the sequence was made smaller.
pub fn scaled_sentence(scaled: &Scaled) -> String {
    match &scaled.refusal {
        None => "the sequence of the bench file fits the motor unchanged".to_owned(),
        Some(refusal) => format!(
            "the sequence is run at {:.0} % of its voltages and {:.0} V/s: unchanged it would cross a limit ({refusal})",
            100.0 * scaled.factor,
            scaled.slew_v_per_s
        ),
    }
}

/// The comparison with the nameplate, where it has a value.
pub fn compared(nameplate_motor: &Motor, found: &[ParameterEstimate]) -> Option<Comparison> {
    let comparison = nameplate::compare(nameplate_motor, found);
    comparison.rows.iter().any(|row| row.nameplate.is_some()).then_some(comparison)
}
