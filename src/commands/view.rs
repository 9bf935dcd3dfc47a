//! `view` and `compare --screen`: a recorded run on the screen, measured and model over time.

use std::io::IsTerminal as _;
use std::path::PathBuf;

use crate::commands::arguments::{EvidenceArguments, run_path};
use crate::commands::by_hand::{self, ScreenResult};
use crate::commands::evidence::{Judging, Prepared, RecommendationBench};
use crate::report::wording::diagnosis as words;
use crate::runtime::{Failure, Terminal};
use crate::tui::Opens;
use drivebench_diagnose::ErrorOf;

/// Show a recorded run on the screen: measured and model over time, where the model fails, and why
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench view runs/a
  drivebench view runs/a --model model.toml --holdout runs/b     another run, not used in the fit, is shown first")]
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

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    needs_terminal("view", "`drivebench compare RUN` prints the same as text")?;
    let attended = (terminal.endable()?, terminal.progress("view"));
    let model = arguments.model.as_deref();
    let (run, judging) = (&arguments.run, Judging::of(model));
    let mut prepared = arguments.evidence.prepare(run, model, judging, true, terminal)?;
    let judged = prepared.judge_as_diagnose(model.is_some(), terminal)?;
    // From here on the screen uses the terminal and handles the signals.
    drop(attended);
    let result = show(&prepared, judged.error_of, terminal)?;
    result.heading().lines().for_each(|line| terminal.message(line));
    if let Some(diagnosis) = &result.diagnosis {
        terminal.message(&words::diagnosis(diagnosis));
    }
    terminal.message(&format!("next: {}", arguments.evidence.diagnose(run, model)));
    Ok(())
}

/// A screen needs a terminal; `help` names what works without one.
pub(crate) fn needs_terminal(what: &str, help: &str) -> Result<(), Failure> {
    if std::io::stdout().is_terminal() {
        return Ok(());
    }
    Err(Failure::usage(format!("{what}: standard output is not a terminal"), help))
}

/// Shows the complete model with its runs until the screen is left.
pub(crate) fn show(
    prepared: &Prepared,
    error_of: ErrorOf,
    terminal: &Terminal,
) -> Result<ScreenResult, Failure> {
    let target = RecommendationBench::of(None, prepared, terminal)?;
    let opens = Opens::Comparison(error_of);
    by_hand::show_prepared(prepared, &target, opens, None, terminal)?.left("interrupted")
}
