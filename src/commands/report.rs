//! `report`: the page of a recorded run, from its folder or generated from the record, and the pictures of any of our pages as
//! files.

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Map, Value};

use crate::commands::arguments::MapArguments;
use crate::commands::{identify, pages};
use crate::report::{Document, EarlyEnd, RunReport, Tone, plot};
use crate::runtime::{Failure, Form, Terminal, estimates, output, read_text};
use drivebench_bench::recording::{LoadedRun, Manifest, RunFile, RunFolder};
use drivebench_bench::{BenchFile, LastSeconds, Stop};
use drivebench_model::plant::Model;
use drivebench_model::sample::ParameterEstimate;

/// Write the page of a recorded run, where its folder has none, and its pictures as files
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench report runs/a --svg figures          pictures of the page in runs/a
  drivebench report runs/a --output page.html     a new page, from the record alone")]
pub(super) struct Arguments {
    /// Run folder, samples.csv, any CSV with --map; or a page, with --svg
    run: PathBuf,
    /// Make a new page and write it here; never overwritten
    #[arg(long, value_name = "PAGE.html")]
    output: Option<PathBuf>,
    /// Write every picture of the page into this folder
    #[arg(long, value_name = "DIR")]
    svg: Option<PathBuf>,
    /// Print the page of the record as Markdown
    #[arg(long, conflicts_with = "json")]
    markdown: bool,
    #[command(flatten)]
    map: MapArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    output::refuse_existing(&arguments.output, "--output")?;
    let _endable = terminal.endable()?;
    let done = report(arguments, terminal)?;
    if arguments.markdown {
        return terminal.line(done.markdown.trim_end());
    }
    terminal.document(&done, Form::full(arguments.json), &done.document())
}

#[derive(Default, Serialize)]
struct Reported {
    /// Null, as what follows, where a page was named and no run.
    run: Option<String>,
    rows: Option<usize>,
    rows_dropped: Option<usize>,
    duration_s: Option<f64>,
    /// How the run ended, by its manifest.
    outcome: Option<String>,
    /// How it was stopped, and which rows hold the last seconds before a trip.
    stop: Option<Stop>,
    trip: Option<LastSeconds>,
    /// Final values of the live estimators.
    parameters: Map<String, Value>,
    page: Option<PathBuf>,
    pictures: Vec<PathBuf>,
    #[serde(skip)]
    markdown: String,
}

impl Reported {
    fn document(&self) -> Document {
        let mut document = Document::new("", "");
        if let (Some(run), Some(rows), Some(duration_s)) = (&self.run, self.rows, self.duration_s) {
            document.say("run", [format!("{run}: {rows} rows over {duration_s:.3} s")], 1);
        }
        document.say("outcome", self.outcome.as_deref(), 1);
        document.say("stopped", self.stop.as_ref().map(Stop::sentence), 1);
        document.say("last 2 s", self.trip.map(last_rows), 1);
        document.say("picture", self.pictures.iter().map(|path| path.display().to_string()), 1);
        match &self.page {
            Some(page) => document.ends_with(page.display().to_string()),
            None => document.say("page", ["none: name one with --output PAGE.html"], 1),
        }
        document
    }
}

/// Which rows of a record a page shows enlarged.
pub(crate) fn last_rows(last: LastSeconds) -> String {
    let (from, to) = (last.from_row, last.to_row);
    format!("rows {from} to {to} of samples.csv; the page shows them enlarged")
}

/// Writes the page under `--output`, else into the run's folder where there is none yet, and its pictures into the folder of
/// `--svg`. Of a page that is named itself only the pictures are written.
fn report(arguments: &Arguments, terminal: &Terminal) -> Result<Reported, Failure> {
    let path = arguments.run.as_path();
    let (output, pictures) = (arguments.output.as_deref(), arguments.svg.as_deref());
    if path.extension().is_some_and(|ending| ending == "html") {
        let Some(folder) = pictures.filter(|_| output.is_none()) else {
            let headline = format!("{}: is a page already", path.display());
            let help = "name a folder for its pictures with --svg DIR, or a run";
            return Err(Failure::usage(headline, help));
        };
        return Ok(Reported {
            pictures: write_pictures(&read_text(path)?, folder, terminal)?,
            page: Some(path.to_owned()),
            ..Reported::default()
        });
    }
    let loaded = arguments.map.load(path, terminal)?;
    let kept = kept_estimates(&loaded);
    let page = page(&loaded, &kept);
    let folder = loaded.folder.as_ref().map(RunFolder::existing);
    let existing = folder.as_ref().map(|folder| folder.file(RunFile::Report));
    let existing = existing.filter(|path| output.is_none() && path.exists());
    let html = match &existing {
        Some(path) => read_text(path)?,
        None => page.html(),
    };
    let path = match (output, existing, folder) {
        (Some(path), ..) => {
            terminal.file(path, &html)?;
            Some(path.to_owned())
        }
        (None, Some(path), _) => Some(path),
        (None, None, Some(folder)) => Some(folder.write(RunFile::Report, &html)?),
        (None, None, None) => None,
    };
    let run = &loaded.run;
    let times = run.time_s();
    Ok(Reported {
        run: Some(run.name.clone()),
        rows: Some(run.rows()),
        rows_dropped: Some(run.rows_dropped),
        duration_s: times.first().zip(times.last()).map(|(first, last)| last - first),
        outcome: loaded.manifest.as_ref().and_then(|m| m.outcome.clone()),
        stop: loaded.manifest.as_ref().and_then(pages::stop),
        trip: loaded.manifest.as_ref().and_then(|m| serde_json::from_value(m.trip.clone()).ok()),
        parameters: identify::estimates(&kept),
        page: path,
        pictures: pictures
            .map_or(Ok(Vec::new()), |folder| write_pictures(&html, folder, terminal))?,
        markdown: page.markdown(),
    })
}

/// Every picture of a page as a file of its own, in their order: `figure-1.svg`, ...
fn write_pictures(html: &str, folder: &Path, terminal: &Terminal) -> Result<Vec<PathBuf>, Failure> {
    std::fs::create_dir_all(folder).map_err(|error| output::cannot_write(folder, &error))?;
    let paths = (1..).map(|number| folder.join(format!("figure-{number}.svg")));
    let pictures: Vec<_> = paths.zip(plot::pictures(html)).collect();
    // All of them or none.
    output::refuse_existing(pictures.iter().map(|(path, _)| path), "--svg (a folder)")?;
    for (path, svg) in &pictures {
        terminal.file(path, svg)?;
    }
    Ok(pictures.into_iter().map(|(path, _)| path).collect())
}

fn page(loaded: &LoadedRun, estimates: &[ParameterEstimate]) -> Document {
    let none = Manifest::default();
    let manifest = loaded.manifest.as_ref().unwrap_or(&none);
    let bench = manifest.configs.get("bench");
    let bench = bench.and_then(|text| BenchFile::parse("manifest.json", text).ok());
    let nameplate = bench.map(|bench| Model::baseline(bench.motor.motor()));
    let mut context = pages::context(manifest, &loaded.folder.iter().collect::<Vec<_>>());
    context.notes.clone_from(&loaded.warnings);
    let facts = pages::table(&manifest.speed_loop);
    let has_loop = !facts.is_empty();
    let mut speed_loop = Document::new("", "");
    speed_loop.facts(facts);
    let outcome = manifest.outcome.as_deref();
    let report = RunReport {
        title: if manifest.name.is_empty() { &loaded.run.name } else { &manifest.name },
        context: &context,
        run: &loaded.run,
        nameplate: nameplate.as_ref(),
        parameters: estimates,
        timing: &pages::timing(manifest),
        early_end: outcome.filter(|outcome| *outcome != "passed").map(|outcome| EarlyEnd {
            tone: Tone::Attention,
            title: "Ended early",
            reason: outcome.to_owned(),
        }),
        last_seconds: pages::last_seconds(manifest),
        speed_loop: has_loop.then_some(&speed_loop),
    };
    report.document()
}

/// Values of the live estimators, as the run's folder keeps them.
fn kept_estimates(loaded: &LoadedRun) -> Vec<ParameterEstimate> {
    let folder = loaded.folder.as_ref().map(RunFolder::existing);
    let text = folder.and_then(|folder| read_text(&folder.file(RunFile::Result)).ok());
    let result: Value = text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default();
    estimates(&result["online"]["parameters"])
}
