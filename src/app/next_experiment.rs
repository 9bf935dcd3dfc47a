//! The recommended next run of a diagnosis: whose limits it keeps, and its bench file.

use std::path::Path;

use super::evidence::Prepared;
use super::failure::Failure;
use super::files::read_text;
use super::output;
use crate::bench::{BenchFile, bench_for, experiment_limits, next_bench};
use crate::diagnosis::{Diagnosis, ExperimentLimits, NextExperiment, recommend};
use crate::numerics::statistics::median;
use crate::plant::Scenario;

/// The bench that a recommendation is for, with what it may reach.
pub(crate) struct Place {
    bench: Option<BenchFile>,
    limits: ExperimentLimits,
    rate_hz: f64,
}

impl Place {
    /// Where the next run would be made: on `bench`, else on that of the run folder, else on nothing beyond what the runs
    /// have reached. To be asked before the evidence is used up.
    pub(crate) fn of(bench: Option<&Path>, prepared: &Prepared) -> Result<Self, Failure> {
        let bench = match bench {
            Some(path) => Some(BenchFile::parse(
                &path.display().to_string(),
                &read_text(path)?,
            )?),
            None => recorded_bench(prepared),
        };
        let mut limits = bench.as_ref().map_or_else(
            || ExperimentLimits::seen_in(&prepared.evidence),
            experiment_limits,
        );
        if let Some(amps) = drive_limit_a(prepared) {
            limits.current_a = limits.current_a.min(amps);
        }
        Ok(Self {
            bench,
            limits,
            rate_hz: rate_hz(&prepared.evidence.training),
        })
    }

    /// Writes the bench file, where there is a run to recommend; `run` is what was diagnosed.
    pub(crate) fn write(
        &self,
        path: &Path,
        diagnosis: &Diagnosis,
        run: &Path,
    ) -> Result<(), Failure> {
        let (next, path_text) = (diagnosis.next_experiment.as_ref(), path.display());
        let Some((next, text)) = next.and_then(|next| Some((next, next.bench.as_ref()?))) else {
            output::message(&format!(
                "{path_text} is not written: there is no run to recommend"
            ));
            return Ok(());
        };
        output::file(path, text)?;
        let port = if self.bench.is_some() {
            ""
        } else {
            " --port PORT (the runs do not say on which drive they were made)"
        };
        let diagnose = next.diagnose_command(run);
        output::message(&format!(
            "{path_text} is written: drivebench run {path_text}{port}, then {diagnose}"
        ));
        Ok(())
    }

    /// What the next run may reach.
    pub(crate) const fn limits(&self) -> ExperimentLimits {
        self.limits
    }

    /// Puts the recommended run into the diagnosis.
    pub(crate) fn recommend(
        &self,
        diagnosis: &mut Diagnosis,
        prepared: &Prepared,
    ) -> Result<(), Failure> {
        if let Some(next) = recommend(diagnosis, &prepared.evidence, &self.limits)? {
            self.take_over(diagnosis, next);
        }
        Ok(())
    }

    /// Puts a run that was recommended for it within the same limits into the diagnosis.
    pub(crate) fn take_over(&self, diagnosis: &mut Diagnosis, mut next: NextExperiment) {
        let model = &diagnosis.model.model;
        next.bench = next.recipe.as_ref().map(|recipe| {
            let unknown = || bench_for(model, &self.limits, self.rate_hz);
            let bench = self.bench.clone().unwrap_or_else(unknown);
            next_bench(&bench, recipe, model, &next.sentence)
        });
        diagnosis.next_experiment = Some(next);
    }
}

/// The bench of the run folder, as its manifest keeps it. A bench of another program's version is as good as none.
fn recorded_bench(prepared: &Prepared) -> Option<BenchFile> {
    let manifest = prepared.run.manifest.as_ref()?;
    let text = manifest.configs.get("bench")?;
    match BenchFile::parse("manifest.json: configs.bench", text) {
        Ok(bench) => Some(bench),
        Err(error) => {
            output::message(&format!("warning: the run's bench is not used: {error}"));
            None
        }
    }
}

/// The current limit that the drive of the run said it has.
fn drive_limit_a(prepared: &Prepared) -> Option<f64> {
    let manifest = prepared.run.manifest.as_ref()?;
    manifest.identity.get("current_limit_a")?.as_f64()
}

/// Rows per second, as a bench file may ask for.
fn rate_hz(run: &Scenario) -> f64 {
    let pairs = run.sample_time_s.windows(2);
    let periods: Vec<f64> = pairs.map(|pair| pair[1] - pair[0]).collect();
    (1.0 / median(&periods)).round()
}
