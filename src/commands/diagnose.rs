//! `diagnose`: which physical effect is missing.

use std::path::{Path, PathBuf};

use crate::commands::arguments::{EvidenceArguments, MoreRuns, model_words, run_path};
use crate::commands::evidence::{Judging, RecommendationBench};
use crate::commands::{by_hand, pages, view};
use crate::report::Document;
use crate::report::wording::json;
use crate::runtime::{Failure, Form, Terminal, output};
use crate::tui::Opens;
use drivebench_diagnose::{Diagnosis, DiagnosisVerdict, diagnose_with};
use drivebench_model::plant::effect::Axis;

/// Name the physical effect that a model is missing, judged on data that the fit has not used
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench diagnose runs/a --model model.toml --holdout runs/b
  drivebench diagnose runs/a --holdout runs/b --html page.html     the same with every picture
  drivebench diagnose runs/a --next-bench next.toml     and the run that separates effects that look alike:
  drivebench run next.toml && drivebench diagnose runs/a --with runs/NEW
  drivebench diagnose runs/a --holdout runs/b --screen     see where it fails, add the effect with one key

Answers:
  EFFECT FOUND    these effects lower the held-out error; NOT SUFFICIENT where more than noise is left
  AMBIGUOUS       several effects explain the runs equally well
  NOTHING FOUND   no effect of the catalogue lowers the held-out error
  UNEXPLAINED     something is missing, and no effect of the catalogue explains it
  NOT FITTED      the model predicts the hold-out no better than its mean, its last value or a first-order lag:
                  nothing is named; `identify --full` shows how well the run determines each parameter")]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map
    #[arg(value_parser = run_path())]
    run: PathBuf,
    #[command(flatten)]
    more: MoreRuns,
    /// Model file; without it the run folder's, else a fitted baseline
    #[arg(long)]
    model: Option<PathBuf>,
    /// Name every effect that the runs need: the default, this option has no effect and is kept for scripts
    #[arg(long)]
    until_floor: bool,
    #[command(flatten)]
    evidence: EvidenceArguments,
    #[command(flatten)]
    on_screen: ScreenArguments,
    /// Bench whose drive, motor and limits the recommended next run keeps; without it that of the run folder, else
    /// the ranges that the runs have reached
    #[arg(long, value_name = "BENCH.toml")]
    bench: Option<PathBuf>,
    /// Write the bench file of the recommended next run
    #[arg(long, value_name = "FILE")]
    next_bench: Option<PathBuf>,
    /// Write the page: ladder, where the model fails, every effect that was tried; never overwritten
    #[arg(long, value_name = "PAGE.html")]
    html: Option<PathBuf>,
    #[command(flatten)]
    form: Form,
}

/// The diagnosis on the screen.
#[derive(clap::Args)]
struct ScreenArguments {
    /// Work on the screen: see where the model fails, add and remove effects, write the model
    #[arg(long, conflicts_with = "json")]
    screen: bool,
    /// On the screen: where the model is written to; never overwritten
    #[arg(long, value_name = "MODEL2.toml", requires = "screen")]
    output: Option<PathBuf>,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    arguments.more.refuse()?;
    let on_screen = &arguments.on_screen;
    if on_screen.screen {
        view::needs_terminal("--screen", "leave --screen out: the answer is printed as text")?;
    }
    output::refuse_existing(&on_screen.output, "--output")?;
    output::refuse_existing(&arguments.html, "--html")?;
    let mut attended = Some((terminal.endable()?, terminal.progress("diagnose")));
    let (model, judging) = (arguments.model.as_deref(), Judging::Refits);
    let (evidence, run) = (&arguments.evidence, &arguments.run);
    let prepared = evidence.prepare(run, model, judging, on_screen.screen, terminal)?;
    output::refuse_existing(&arguments.next_bench, "--next-bench")?;
    let target = RecommendationBench::of(arguments.bench.as_deref(), &prepared, terminal)?;
    let (mut by_hand, mut written, mut known_next) = (String::new(), None, None);
    let mut diagnosis = if on_screen.screen {
        // From here on the screen uses the terminal and handles the signals.
        drop(attended.take());
        let output = on_screen.output.as_deref();
        let closed = by_hand::show_prepared(&prepared, &target, Opens::Search, output, terminal)?;
        attended = Some((terminal.endable()?, terminal.progress("diagnose")));
        // Checked only now: from here on a signal ends the program.
        let result = closed.left("interrupted")?;
        by_hand = result.heading();
        written = result.model().map(str::to_owned);
        known_next = result.next;
        let no_answer = || Failure::interrupted("left before the diagnosis was done");
        result.diagnosis.ok_or_else(no_answer)?
    } else {
        let (model, evidence) = (&prepared.model.file.model, prepared.evidence.clone());
        diagnose_with(model, evidence, &|event| terminal.diagnosis(event))?
    };
    if let Some(next) = known_next {
        target.take_over(&mut diagnosis, next);
    } else {
        terminal.stage("designs the next run", 0);
        target.recommend(&mut diagnosis, &prepared)?;
    }
    let _endable = attended.map(|(endable, _)| endable);
    if let Some(path) = &arguments.next_bench {
        target.write(path, &diagnosis, &after_new_run(arguments), terminal)?;
    }
    let form = arguments.form;
    let result = prepared.result(&json::diagnosis(&diagnosis));
    if form.json && arguments.html.is_none() {
        return terminal.json(&result);
    }
    let is_whole = arguments.html.is_some() || form.full;
    let mut document = pages::diagnosis(&prepared, &diagnosis, is_whole)?;
    pages::write(&mut document, arguments.html.as_deref(), terminal)?;
    document.say("by hand", by_hand.lines(), 1);
    if by_hand.is_empty() {
        let model = written.as_deref().map(Path::new);
        let model = model.or(arguments.model.as_deref());
        let from = written.as_deref().unwrap_or(&prepared.model.from);
        go_on(&mut document, arguments, (model, from), &diagnosis);
    } else if let Some(model) = &written {
        let model = output::quoted_word(model);
        document.go_on(format!("drivebench tune --model {model}"));
    } else {
        document.go_on(format!("{} --screen", evidence.diagnose(run, None)));
    }
    terminal.document(&result, form, &document)
}

/// The same diagnosis with the run that was recommended, once it is made.
fn after_new_run(arguments: &Arguments) -> String {
    let again = arguments.evidence.diagnose(&arguments.run, arguments.model.as_deref());
    format!("{again}{} --with NEW_RUN", bench_words(arguments))
}

/// The bench whose limits the recommended run keeps, with a space before it.
fn bench_words(arguments: &Arguments) -> String {
    let bench = arguments.bench.as_deref().map(output::quoted);
    bench.map_or_else(String::new, |bench| format!(" --bench {bench}"))
}

/// The next commands: add the effect that was found, or make the recommended run.
fn go_on(
    document: &mut Document,
    arguments: &Arguments,
    (model, from): (Option<&Path>, &str),
    diagnosis: &Diagnosis,
) {
    let run = output::quoted(&arguments.run);
    let of = format!("{} --run {run}{}", model_words(model), arguments.evidence.words());
    let curve = diagnosis.axis_map.first();
    let curve = curve.filter(|map| map.is_followed() && Axis::from_key(map.axis).is_some());
    if let Some(effect) = diagnosis.effect {
        document.go_on(format!("drivebench add {effect}{of} --output model2.toml"));
    } else if let Some(map) = curve {
        let (equation, axis) = (map.equation, map.axis);
        let table = format!("drivebench add table --equation {equation} --axis {axis}");
        document.go_on(format!("{table}{of} --output model2.toml"));
    }
    let next = diagnosis.next_experiment.as_ref();
    if next.is_some_and(|next| next.recipe.is_some()) {
        if let Some(path) = &arguments.next_bench {
            document.go_on(format!("drivebench run {}", output::quoted(path)));
            document.go_on(after_new_run(arguments));
        } else if diagnosis.effect.is_none() {
            let again = arguments.evidence.diagnose(&arguments.run, model);
            let bench = bench_words(arguments);
            document.go_on(format!("{again}{bench} --next-bench next.toml"));
        }
    }
    if diagnosis.verdict == DiagnosisVerdict::NotFitted {
        let map = arguments.evidence.map_words();
        document.go_on(format!("drivebench identify {run}{map} --full"));
    }
    if diagnosis.effect.is_none() && diagnosis.verdict == DiagnosisVerdict::None {
        document.go_on(if from == "baseline" {
            format!(
                "drivebench identify {run}{} --output model.toml",
                arguments.evidence.map_words()
            )
        } else {
            format!("drivebench tune --model {}", output::quoted_word(from))
        });
    }
}
