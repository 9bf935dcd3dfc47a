//! `bode`: the frequency response of recorded runs, a model's beside it.

use std::path::PathBuf;

use super::arguments::{MapArguments, run_path};
use super::failure::Failure;
use super::{output, progress, signals};
use crate::app::bode::{Bode, BodeRequest};
use crate::app::by_hand::show_response;
use crate::app::screen::needs_terminal;
use drivebench_identify::frequency_response::Pathway;

/// Frequency response of recorded runs: magnitude, phase, coherence; resonances with their damping; a model's beside it
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench bode runs/latest
  drivebench bode runs/a --model model.toml --svg bode.svg     where model and measurement differ
  drivebench bode runs/a runs/b --csv bode.csv                 of one machine, taken together
A chirp about an offset carries most: bench-configs/benches/zk-22fc-frequency-response.toml.")]
pub(super) struct Arguments {
    /// Run folders, samples.csv, or any CSV with --map, all of one machine
    #[arg(required = true, value_parser = run_path())]
    runs: Vec<PathBuf>,
    /// Model file; without it that of the first run's folder
    #[arg(long, value_parser = run_path())]
    model: Option<PathBuf>,
    /// voltage-to-speed, voltage-to-current or current-to-speed; without it the one that tells most
    #[arg(long, value_parser = pathway)]
    pathway: Option<Pathway>,
    #[command(flatten)]
    map: MapArguments,
    /// Write a row for each point and pathway; never overwritten
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// Write a picture: magnitude, phase, coherence, the model's beside them; never overwritten
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
    /// See it on the screen
    #[arg(long, conflicts_with = "json")]
    screen: bool,
    /// Print all there is to say; without it what fits 100 columns and 30 lines
    #[arg(long)]
    full: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

fn pathway(text: &str) -> Result<Pathway, String> {
    let keys = Pathway::ALL.map(Pathway::key);
    let mut all = Pathway::ALL.into_iter();
    all.find(|own| own.key() == text)
        .ok_or_else(|| format!("allowed: {}", keys.join(", ")))
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    for (path, option) in [(&arguments.csv, "--csv"), (&arguments.svg, "--svg")] {
        path.as_deref()
            .map_or(Ok(()), |path| output::refuse_existing(path, option))?;
    }
    if arguments.screen {
        let help = "leave --screen out: the result is printed as text";
        needs_terminal("--screen", help)?;
    }
    let attended = (signals::endable()?, progress::begin("bode"));
    let found = Bode::of(&BodeRequest {
        runs: &arguments.runs,
        model: arguments.model.as_deref(),
        load: &|path| arguments.map.load(path),
        map_words: arguments.map.words(),
    })?;
    let pathway = found.shown(arguments.pathway)?;
    if let Some(path) = &arguments.csv {
        output::file(path, &found.csv()?)?;
    }
    if let Some(path) = &arguments.svg {
        output::file(path, &found.svg(pathway)?)?;
    }
    // From here on a screen owns the terminal and hears the signals.
    drop(attended);
    if arguments.screen {
        show_response(found.title(), found.compared.clone(), Some(pathway))?;
    }
    let (json, full) = (arguments.json, arguments.full);
    output::document(&found, json, full, &found.document(pathway))?;
    found.check()
}
