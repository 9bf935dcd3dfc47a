//! Earlier runs, or earlier results of the suite, with which the steps that identify are compared: what has drifted since.
//!
//! ```text
//! --baseline RUN          identified by the command of the step itself  --.
//! --baseline result.json  what the same step of the same case found     --+--> estimates before --> drift since
//! the step                what it found now                             --'
//! ```

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;

use serde_json::Value;

use super::process::{self, End};
use crate::report::wording::drift as words;
use crate::runtime::{Failure, estimates, read_text};
use crate::workflow::suite::{IdentifiedStep, SuiteOutcome};
use drivebench_bench::recording::{Machine, Manifest, RunFile, RunFolder};
use drivebench_identify::drift::{Drift, DriftCaution, between};
use drivebench_model::sample::ParameterEstimate;

pub(super) struct Baseline {
    sources: Vec<Source>,
    /// Another machine is accepted.
    any_machine: bool,
}

enum Source {
    Run { path: PathBuf, manifest: Box<Manifest> },
    Result { path: PathBuf, result: Value },
}

impl Baseline {
    /// Reads what is named; none where nothing is.
    pub(super) fn read(paths: &[PathBuf], any_machine: bool) -> Result<Option<Self>, Failure> {
        let sources: Vec<Source> =
            paths.iter().map(|path| source(path)).collect::<Result<_, _>>()?;
        Ok((!sources.is_empty()).then_some(Self { sources, any_machine }))
    }

    /// Compares what a step found on a machine with what was found before; `identify` does to an earlier run what the step
    /// did.
    pub(super) fn drift(
        &self,
        (case, step): (&str, &str),
        found: &IdentifiedStep,
        mut identify: impl FnMut(&Path) -> Result<Value, String>,
    ) -> Result<Drift, String> {
        let mut before: Vec<Vec<ParameterEstimate>> = Vec::new();
        let (mut since, mut others) = (Vec::new(), Vec::new());
        let (mut is_alike, mut is_unit_known) = (true, !found.machine.drive_serial.is_empty());
        let (mut runs, mut repeated) = (Vec::new(), 0);
        for source in &self.sources {
            let earlier = match source {
                Source::Run { path, manifest } => {
                    let machine = manifest.machine();
                    if !self.is_same(&machine, &found.machine) {
                        others.push(format!("{}: {machine}", path.display()));
                        continue;
                    }
                    is_unit_known &= !machine.drive_serial.is_empty();
                    is_alike &= manifest.excitation() == found.excitation;
                    let run = (&manifest.stamp, manifest.seed, machine);
                    if !manifest.stamp.is_empty() && runs.contains(&run) {
                        repeated += 1;
                        continue;
                    }
                    runs.push(run);
                    let parameters = identify(path)?;
                    vec![(parameters, manifest.began().unwrap_or_default())]
                }
                Source::Result { result, .. } => {
                    let steps = steps_of(result, case, step);
                    let began = result["began"].as_str().unwrap_or_default().to_owned();
                    let is_same =
                        |step: &&IdentifiedStep| self.is_same(&step.machine, &found.machine);
                    if let Some(other) = steps.iter().find(|step| !is_same(step)) {
                        others.push(format!("{}: {}", source.name(), other.machine));
                    }
                    let same = steps.iter().filter(is_same);
                    is_unit_known &= same.clone().all(|step| !step.machine.drive_serial.is_empty());
                    is_alike &= same.clone().all(|step| step.excitation == found.excitation);
                    same.map(|step| (step.parameters.clone(), began.clone())).collect()
                }
            };
            for (parameters, began) in earlier {
                let parameters = estimates(&parameters);
                // The same run under another path, or in the result of the suite that made it, counts once.
                if before.iter().any(|known| is_identical(&parameters, known)) {
                    repeated += 1;
                    continue;
                }
                before.push(parameters);
                since.push(began.get(..10).unwrap_or("an unknown date").to_owned());
            }
        }
        let Some(first) = since.into_iter().min() else {
            return Err(if others.is_empty() {
                format!("no baseline has the step {step:?} of the case {case:?} with what it found")
            } else {
                format!(
                    "the baseline is not known to be of this machine, which is {}: {}; --any-machine compares nevertheless",
                    found.machine,
                    others.join("; ")
                )
            });
        };
        let now = estimates(&found.parameters);
        let is_itself = before.iter().any(|known| is_identical(&now, known));
        let mut drift = between(&before, &[now], &first);
        let cautions = [
            (!is_alike).then_some(DriftCaution::OtherExcitation),
            (!is_unit_known).then_some(DriftCaution::UnknownUnit),
            is_itself.then_some(DriftCaution::SameFigures),
            (repeated > 0).then_some(DriftCaution::RepeatedRuns { count: repeated }),
        ];
        drift.cautions.extend(cautions.into_iter().flatten());
        Ok(drift)
    }

    fn is_same(&self, before: &Machine, now: &Machine) -> bool {
        self.any_machine || before.is_like(now)
    }
}

/// What a step found on which machine and, where there is a baseline, what has drifted since.
pub(super) fn found(
    baseline: Option<&Baseline>,
    names: (&str, &str),
    result: &Value,
    run: Option<&Path>,
    identify: impl FnMut(&Path) -> Result<Value, String>,
) -> Result<IdentifiedStep, String> {
    let manifest = run.and_then(manifest_of).unwrap_or_default();
    let mut found = IdentifiedStep {
        machine: manifest.machine(),
        excitation: manifest.excitation(),
        parameters: result["parameters"].clone(),
        drift: None,
    };
    if let Some(baseline) = baseline {
        found.drift = Some(baseline.drift(names, &found, identify)?);
    }
    Ok(found)
}

/// The parameters that the command of a step finds in an earlier run.
pub(super) fn identified(
    command: Command,
    [stdout, stderr]: [PathBuf; 2],
    timeout_s: f64,
    stop: &AtomicBool,
) -> Result<Value, String> {
    let done = process::finish(command, &stdout, &stderr, timeout_s, stop)
        .map_err(|error| error.to_string())?;
    if done.end != End::Status(0) {
        let reason = process::error_message(&stderr);
        let reason = reason.unwrap_or_else(|| "it did not end in time".to_owned());
        return Err(format!("the baseline cannot be identified: {reason}"));
    }
    let text = std::fs::read_to_string(&stdout).unwrap_or_default();
    let result: Value = serde_json::from_str(&text).unwrap_or_default();
    Ok(result["parameters"].clone())
}

impl Source {
    fn name(&self) -> String {
        let (Self::Run { path, .. } | Self::Result { path, .. }) = self;
        path.display().to_string()
    }
}

/// A run, the folder of a suite, or its result.
fn source(path: &Path) -> Result<Source, Failure> {
    if let Some(manifest) = manifest_of(path) {
        let (path, manifest) = (path.to_owned(), Box::new(manifest));
        return Ok(Source::Run { path, manifest });
    }
    let file = if path.is_dir() { path.join(RunFile::Result.name()) } else { path.to_owned() };
    let result: Option<Value> = serde_json::from_str(&read_text(&file)?).ok();
    let Some(result) = result.filter(|result| result["cases"].is_array()) else {
        let headline =
            format!("--baseline {}: neither a run nor the result of a suite", path.display());
        let help = "give a run folder, or result.json of an earlier suite, as suites/*/result.json";
        return Err(Failure::usage(headline, help));
    };
    Ok(Source::Result { path: path.to_owned(), result })
}

/// The manifest of a run folder that has samples.
fn manifest_of(run: &Path) -> Option<Manifest> {
    let folder = RunFolder::existing(run);
    if !folder.samples().is_file() {
        return None;
    }
    let text = std::fs::read_to_string(folder.file(RunFile::Manifest)).ok()?;
    serde_json::from_str(&text).ok()
}

/// What a step found in the runs of an earlier suite; none where an older version has not recorded it.
fn steps_of(result: &Value, case: &str, step: &str) -> Vec<IdentifiedStep> {
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    list(&result["cases"])
        .into_iter()
        .filter(|of_case| of_case["name"] == case)
        .flat_map(|of_case| list(&of_case["steps"]))
        .filter(|of_step| of_step["name"] == step)
        .filter_map(|of_step| serde_json::from_value(of_step["identified"].clone()).ok())
        .collect()
}

/// Whether what was found is the same to the last digit, as two measurements never are.
fn is_identical(one: &[ParameterEstimate], other: &[ParameterEstimate]) -> bool {
    let carried = |all: &[ParameterEstimate]| -> Vec<(String, u64)> {
        all.iter().filter_map(|own| Some((own.key.clone(), own.carried()?.0.to_bits()))).collect()
    };
    let figures = carried(one);
    !figures.is_empty() && figures == carried(other)
}

/// The figures of a comparison, for limits: none of them where nothing was compared, and a text, which no limit of a number or
/// `none` accepts, where it is not known.
pub(super) fn figures(drift: &Drift) -> Vec<(&'static str, Value)> {
    if drift.changes.is_empty() {
        return Vec::new();
    }
    let keys: Vec<&str> = drift.in_question().map(|change| change.key.as_str()).collect();
    let lost: Vec<String> = drift
        .lost()
        .map(|own| format!("{} not compared: {}", own.key, words::not_compared(own)))
        .collect();
    let drifted = if lost.is_empty() {
        keys.into()
    } else {
        keys.into_iter().map(str::to_owned).chain(lost).collect::<Vec<_>>().join("; ").into()
    };
    let percent = |percent: Option<f64>| percent.map_or("not known".into(), Value::from);
    vec![
        ("drift", drifted),
        ("drift_percent", percent(drift.largest_percent())),
        ("drift_open_percent", percent(drift.open_percent())),
    ]
}

/// The drift of each step as lines for a person.
pub(crate) fn lines(outcome: &SuiteOutcome) -> Vec<String> {
    let mut lines = Vec::new();
    for case in &outcome.cases {
        for drift in case.steps.iter().filter_map(|step| step.identified.as_ref()?.drift.as_ref()) {
            lines.push(format!("{} [seed {}]: {}", case.name, case.seed, words::drift(drift)));
            lines.extend(
                drift.in_question().map(|own| format!("  {}", words::change(own, &drift.since))),
            );
            let not_compared = drift.not_compared.iter();
            lines.extend(not_compared.map(|own| {
                format!("  {} not compared: {}", words::name(&own.key), words::not_compared(own))
            }));
            lines.extend(words::caution(drift).map(|caution| format!("  {caution}")));
        }
    }
    lines
}
