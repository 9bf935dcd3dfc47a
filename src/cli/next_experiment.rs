//! The recommended next run of `diagnose`: whose limits it keeps, and its bench file.

use std::path::{Path, PathBuf};

use clap::Args;

use super::data::{Prepared, read_text};
use super::failure::Failure;
use super::output;
use crate::bench::{BenchFile, bench_for, experiment_limits, next_bench};
use crate::diagnosis::{Diagnosis, Evidence, ExperimentLimits, NextExperiment, recommend};
use crate::numerics::statistics::median;
use crate::plant::Scenario;

#[derive(Args, Clone, Debug)]
pub(super) struct NextArguments {
    /// Bench whose drive, motor and limits the recommended next run keeps; without it that of the run folder, else
    /// nothing beyond what the runs have reached
    #[arg(long, value_name = "BENCH.toml")]
    bench: Option<PathBuf>,
    /// Write the bench file of the recommended next run
    #[arg(long, value_name = "FILE")]
    next_bench: Option<PathBuf>,
}

/// The bench that a recommendation is for, with what it may reach.
pub(super) struct Place {
    bench: Option<BenchFile>,
    limits: ExperimentLimits,
    rate_hz: f64,
}

impl NextArguments {
    /// Where the next run would be made; to be asked before the evidence is used up.
    pub(super) fn place(&self, prepared: &Prepared) -> Result<Place, Failure> {
        if let Some(path) = &self.next_bench {
            output::refuse_existing(path, "--next-bench")?;
        }
        let bench = match &self.bench {
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
        Ok(Place {
            bench,
            limits,
            rate_hz: rate_hz(&prepared.evidence.training),
        })
    }

    /// Writes the bench file, where one is asked for and there is one; `run` is what was diagnosed.
    pub(super) fn write(
        &self,
        place: &Place,
        diagnosis: &Diagnosis,
        run: &Path,
    ) -> Result<(), Failure> {
        let Some(path) = &self.next_bench else {
            return Ok(());
        };
        let next = diagnosis.next_experiment.as_ref();
        let Some((next, text)) = next.and_then(|next| Some((next, next.bench.as_ref()?))) else {
            output::message(&format!(
                "{} is not written: there is no run to recommend",
                path.display()
            ));
            return Ok(());
        };
        output::file(path, text)?;
        let port = if place.bench.is_some() {
            ""
        } else {
            " --port PORT (the runs do not say on which drive they were made)"
        };
        output::message(&format!(
            "{0} is written: drivebench run {0}{port}, then {1}",
            path.display(),
            next.diagnose_command(run)
        ));
        Ok(())
    }
}

impl Place {
    /// What the next run may reach.
    pub(super) const fn limits(&self) -> ExperimentLimits {
        self.limits
    }

    /// Puts the recommended run into the diagnosis.
    pub(super) fn recommend(
        &self,
        diagnosis: &mut Diagnosis,
        evidence: &Evidence,
    ) -> Result<(), Failure> {
        if let Some(next) = recommend(diagnosis, evidence, &self.limits)? {
            self.take_over(diagnosis, next);
        }
        Ok(())
    }

    /// Puts a run that was recommended for it within the same limits into the diagnosis.
    pub(super) fn take_over(&self, diagnosis: &mut Diagnosis, mut next: NextExperiment) {
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
    let periods: Vec<f64> = run
        .sample_time_s
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .collect();
    (1.0 / median(&periods)).round()
}
