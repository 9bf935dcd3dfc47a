//! `reveal`: opens a mystery's sealed truth and scores the answer.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::arguments::run_path;
use super::failure::Failure;
use super::output;
use crate::app::files::read_text;
use crate::config_text::help_for_unknown;
use crate::emulator::mystery::Truth;
use crate::plant::effect;
use crate::workflow::{Answer, Revelation, reveal};

/// Words that are an answer beside the ids of effects.
const WORDS: [&str; 3] = ["none", "unexplained", "abstain"];

/// An empty line is no guess.
const QUESTION: &str = "what do you think it is? (an effect of `drivebench effects`, none, unexplained; empty: no guess)\n";

/// Open a mystery's sealed truth and score the answer
#[derive(clap::Args)]
#[command(after_help = "Example:
  drivebench commission --headless --port sim: --mystery 7
  drivebench reveal runs/mystery-7.sealed.json --run runs/...-fit --guess cogging
  drivebench reveal mystery-7.sealed.json --answer stribeck_friction")]
pub(super) struct Arguments {
    /// Sealed file that `emulate`, `run` or `commission` wrote with --mystery
    file: PathBuf,
    /// The answer: an effect's id, none, unexplained or abstain
    #[arg(long, value_name = "EFFECT", conflicts_with_all = ["diagnosis", "run"])]
    answer: Option<String>,
    /// The answer as `diagnose --json` or `commission --json` printed it
    #[arg(long, value_name = "FILE", conflicts_with = "run")]
    diagnosis: Option<PathBuf>,
    /// The answer that a run folder of `commission` holds
    #[arg(long, value_name = "RUN", value_parser = run_path())]
    run: Option<PathBuf>,
    /// What you think it is, before you look; left out at a terminal, it is asked for before anything is shown
    #[arg(long, value_name = "EFFECT")]
    guess: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let name = arguments.file.display().to_string();
    let truth = Truth::open(&name, &read_text(&arguments.file)?)?;
    let answer = match (&arguments.answer, &arguments.diagnosis, &arguments.run) {
        (Some(word), ..) => Some(Answer::word(known(word)?)),
        (_, Some(file), _) => Some(diagnosis(file)?),
        (.., Some(folder)) => Some(diagnosis(&result_file(folder))?),
        _ => None,
    };
    let guess = match &arguments.guess {
        Some(word) => Some(known(word)?.to_owned()),
        // Before anything is shown. Who gives the answer by hand has guessed.
        None if arguments.answer.is_none() && !arguments.json => {
            let line = output::ask(QUESTION).unwrap_or_default();
            let word = Some(line.trim()).filter(|word| !word.is_empty());
            word.map(|word| known(word).map(str::to_owned))
                .transpose()?
        }
        None => None,
    };
    let revealed = reveal(truth, answer, guess.as_deref());
    output::result(&revealed, arguments.json, Revelation::text)
}

/// The result of a run folder; a file is taken as it is.
fn result_file(run: &Path) -> PathBuf {
    if run.is_dir() {
        run.join("result.json")
    } else {
        run.to_owned()
    }
}

fn diagnosis(file: &Path) -> Result<Answer, Failure> {
    let name = file.display();
    let help = "give what `drivebench diagnose --json` printed, or a run folder of `drivebench commission`";
    let document: Value = serde_json::from_str(&read_text(file)?)
        .map_err(|error| Failure::usage(format!("{name}: no JSON: {error}"), help))?;
    let none = || Failure::usage(format!("{name}: holds no verdict"), help);
    Answer::from_json(&document).ok_or_else(none)
}

/// Refuses what neither the catalogue nor the words have.
fn known(word: &str) -> Result<&str, Failure> {
    let allowed = || {
        let ids = effect::CATALOGUE.iter().map(|effect| effect.card().id);
        ids.chain(WORDS)
    };
    if allowed().any(|known| known == word) {
        return Ok(word);
    }
    let headline = format!("{word:?} is no effect of the catalogue");
    Err(Failure::usage(headline, help_for_unknown(word, allowed())))
}
