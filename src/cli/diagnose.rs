//! `diagnose`: which physical effect is missing.

use std::fmt::Write as _;
use std::io::IsTerminal as _;
use std::path::PathBuf;

use super::data::{EvidenceArguments, prepare};
use super::discovery::{self, Shown};
use super::failure::{Failure, INTERRUPTED, USAGE};
use super::next_experiment::NextArguments;
use super::sanity_report::Judging;
use super::{interrupt, output, pages, progress};
use crate::diagnosis::{Candidate, Diagnosis, Options, Peak, Reached, Status, diagnose_with};
use crate::sample::ParameterEstimate;
use crate::workflow::Discovery;

/// Name the physical effect that a model is missing, judged on data the fit has not seen
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench diagnose runs/a --model model.toml --holdout runs/b
  drivebench diagnose runs/a --holdout runs/b --html page.html     the same with every picture
  drivebench diagnose runs/a --next-bench next.toml     and, where two effects are not told apart, the run that would:
  drivebench run next.toml && drivebench diagnose runs/NEW --holdout runs/a
  drivebench diagnose runs/a --holdout runs/b --screen     see where it fails, add the effect with one key
  drivebench diagnose runs/a --holdout runs/b --screen --guess     name it yourself first")]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map
    run: PathBuf,
    /// Model file; without it the run folder's, else a fitted baseline
    #[arg(long)]
    model: Option<PathBuf>,
    /// Go on adding effects until the error is at the noise floor or nothing more pays
    #[arg(long)]
    until_floor: bool,
    #[command(flatten)]
    evidence: EvidenceArguments,
    #[command(flatten)]
    on_screen: ScreenArguments,
    #[command(flatten)]
    next: NextArguments,
    /// Write the page: ladder, where the model fails, every effect that was tried; never overwritten
    #[arg(long, value_name = "PAGE.html")]
    html: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// The diagnosis on the screen.
#[derive(clap::Args)]
struct ScreenArguments {
    /// Work on the screen: see where the model fails, add and remove effects, write the model
    #[arg(long, conflicts_with = "json")]
    screen: bool,
    /// On the screen: no name is shown before you have given one
    #[arg(long, requires = "screen")]
    guess: bool,
    /// On the screen: where the model is written to; never overwritten
    #[arg(long, value_name = "MODEL2.toml", requires = "screen")]
    output: Option<PathBuf>,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let on_screen = &arguments.on_screen;
    if on_screen.screen && !std::io::stdout().is_terminal() {
        return Err(Failure::with_help(
            USAGE,
            "--screen: standard output is not a terminal",
            "leave --screen out: the answer is printed as text",
        ));
    }
    if let Some(path) = &on_screen.output {
        output::refuse_existing(path, "--output")?;
    }
    if let Some(path) = &arguments.html {
        output::refuse_existing(path, "--html")?;
    }
    let mut attended = Some((interrupt::endable()?, progress::begin("diagnose")));
    let prepared = prepare(
        &arguments.run,
        arguments.model.as_ref(),
        &arguments.evidence,
        Judging::Refits,
    )?;
    let place = arguments.next.place(&prepared)?;
    let mut original = prepared.model.file.model.clone();
    let mut by_hand = String::new();
    let mut diagnosis = if on_screen.screen {
        // From here on the screen owns the terminal and hears the signals.
        drop(attended.take());
        let shown = Shown {
            title: prepared.about.title.clone(),
            guess_first: on_screen.guess,
            fitted_on: prepared.run.run.name.clone(),
            history: prepared.model.file.history.clone(),
            output: on_screen.output.clone(),
        };
        let evidence = prepared.evidence.clone();
        let discovery = Discovery::new(original.clone(), evidence, arguments.until_floor)
            .with_limits(place.limits());
        let left = discovery::show(discovery, shown)?;
        attended = Some((interrupt::endable()?, progress::begin("diagnose")));
        // Asked only now: from here on a signal ends the program by itself.
        if left.is_interrupted() {
            return Err(Failure::new(INTERRUPTED, "interrupted"));
        }
        by_hand = left.standing.heading();
        original = left.standing.original;
        left.standing
            .diagnosis
            .ok_or_else(|| Failure::new(INTERRUPTED, "left before there was an answer"))?
    } else {
        let options = Options {
            until_floor: arguments.until_floor,
            progress: &progress::diagnosis,
            ..Options::default()
        };
        diagnose_with(&original, prepared.evidence.clone(), options)?
    };
    progress::stage("looks for the run that would tell more", 0);
    place.recommend(&mut diagnosis, &original, &prepared.evidence)?;
    let _endable = attended.map(|(endable, _)| endable);
    arguments.next.write(&place, &diagnosis, &arguments.run)?;
    if let Some(path) = &arguments.html {
        let page = pages::diagnosis(
            &prepared.about,
            &prepared.run,
            &prepared.evidence,
            &diagnosis,
        )?;
        pages::write(path, &page)?;
    }
    let mut value = serde_json::to_value(&diagnosis).unwrap_or_default();
    value["rows_dropped"] = prepared.run.run.rows_dropped.into();
    value["notes"] = prepared.run.run.notes.clone().into();
    output::result(&value, arguments.json, |_| {
        format!("{by_hand}{}", text(&diagnosis))
    })
}

pub(super) fn text(diagnosis: &Diagnosis) -> String {
    let mut text = format!("{}\n", diagnosis.sentence);
    if !diagnosis.sufficient && diagnosis.effect.is_some() {
        let _ = writeln!(
            text,
            "this is not all: much of the error is still unexplained"
        );
    }
    for candidate in &diagnosis.candidates {
        let _ = writeln!(
            text,
            "{:>2} {:<12} {}",
            candidate.rank,
            status(candidate.status),
            candidate.evidence
        );
        if matches!(candidate.status, Status::Supported | Status::Possible) {
            let _ = writeln!(text, "   {:<12} {}", "", sizes(candidate));
            for peak in candidate.reached.iter().flat_map(Reached::peaks) {
                let _ = writeln!(text, "   {:<12} {}", "", peak_text(&peak));
            }
        }
    }
    for sentence in &diagnosis.equivalences {
        let _ = writeln!(text, "note: {sentence}");
    }
    if let Some(next) = &diagnosis.next_experiment {
        let _ = writeln!(text, "next: {}", next.sentence);
    }
    text
}

const fn status(status: Status) -> &'static str {
    match status {
        Status::Supported => "supported",
        Status::Possible => "possible",
        Status::RuledOut => "ruled out",
        Status::NotExcited => "not excited",
    }
}

fn sizes(candidate: &Candidate) -> String {
    candidate
        .parameters
        .iter()
        .map(parameter_text)
        .collect::<Vec<_>>()
        .join(", ")
}

fn peak_text(peak: &Peak) -> String {
    let std = peak
        .std
        .map_or_else(String::new, |std| format!(" +- {std:.1e}"));
    let share = peak.percent_of_largest;
    let share = share.map_or_else(String::new, |percent| {
        format!(", {percent:.1} % of the largest")
    });
    format!(
        "up to {:.3e}{std} {} in this run{share}",
        peak.value, peak.unit
    )
}

/// `key = value +- std unit`, or why there is no value.
pub(super) fn parameter_text(parameter: &ParameterEstimate) -> String {
    let key = parameter.key.rsplit('.').next().unwrap_or(&parameter.key);
    match (parameter.value, parameter.std) {
        (Some(value), Some(std)) => format!("{key} = {value:.4e} +- {std:.1e} {}", parameter.unit),
        (Some(value), None) => format!(
            "{key} = {value:.4e} {} (uncertainty unknown)",
            parameter.unit
        ),
        (None, _) => format!(
            "{key}: {}",
            parameter.reason.as_deref().unwrap_or("not observable")
        ),
    }
}
