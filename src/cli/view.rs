//! `view`: a recorded run on the screen, measured and model over time.

use std::path::PathBuf;

use super::arguments::{EvidenceArguments, model_words, run_path};
use super::failure::Failure;
use super::{output, progress, signals};
use crate::app::evidence::Judging;
use crate::app::screen;

/// Look at a recorded run on the screen: measured and model over time, where the model fails, and why
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench view runs/a
  drivebench view runs/a --model model.toml --holdout runs/b     another run, which the fit has not seen, comes first")]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map
    #[arg(value_parser = run_path())]
    run: PathBuf,
    /// Model file; without it the run folder's, else a fitted baseline
    #[arg(long)]
    model: Option<PathBuf>,
    #[command(flatten)]
    evidence: EvidenceArguments,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let help = "`drivebench compare RUN` prints the same as text";
    screen::needs_terminal("view", help)?;
    let attended = (signals::endable()?, progress::begin("view"));
    let model = arguments.model.as_deref();
    let (run, judging) = (&arguments.run, Judging::of(model));
    let mut prepared = arguments.evidence.prepare_for_screen(run, model, judging)?;
    let judged = prepared.judge_as_diagnose(model.is_some())?;
    // From here on the screen owns the terminal and hears the signals.
    drop(attended);
    let left = screen::show(&prepared, judged.error_of)?;
    left.standing.heading().lines().for_each(output::message);
    if let Some(diagnosis) = &left.standing.diagnosis {
        output::message(&diagnosis.sentence);
    }
    let (run, words) = (output::quoted(run), arguments.evidence.words());
    let model = model_words(model);
    output::message(&format!("next: drivebench diagnose {run}{model}{words}"));
    Ok(())
}
