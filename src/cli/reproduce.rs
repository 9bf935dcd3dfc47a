//! `reproduce`: a paper's figures and tables, computed again beside what the paper prints; or the study of the diagnosis.

use std::fs;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use serde::Serialize;

use super::failure::{Failure, INTERRUPTED, USAGE};
use super::{mysteries, output, progress, signals};
use crate::report::reproduce::Reproduction;
use crate::workflow::reproduce;
use crate::workflow::reproduce::study::{self, Answer, Outcome, Size, Study, files, records};

/// Compute a paper's figures and tables again, or how often the diagnosis is right: text on stdout, page, pictures and tables in a folder
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  drivebench reproduce paper-a --out paper-a\n  drivebench reproduce lines --out lines\n  drivebench reproduce discovery --sets 2 --out validation\n  drivebench reproduce discovery --sets 0 --mysteries 40 --out mysteries"
)]
pub(super) struct Arguments {
    /// Which paper, or `discovery`: the diagnosis on machines whose truth is known
    #[arg(value_enum, value_name = "PAPER")]
    paper: Paper,
    /// With `discovery`: machines for each effect and excitation (default 1: some 730 machines in all; 0: none); with `lines`: records of each line (default 60)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..=100))]
    sets: Option<u64>,
    /// With `discovery`: so many mystery drives beside them, commissioned by the whole program (default 160)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..=10_000))]
    mysteries: Option<u64>,
    /// With `discovery`: a folder with public records of real machines, of which the page then tells too: `emps/DATA_EMPS.csv`, `sar_bldc/time_constant_2023-12-16.csv`
    #[arg(long, value_name = "DIR")]
    records: Option<PathBuf>,
    /// With `discovery` and `lines`: another seed makes other machines (default 1)
    #[arg(long, value_name = "SEED")]
    seed: Option<u64>,
    /// Folder for report.html, figure-2.svg .., table-1.csv ..; it must be new or empty (default: reproduce-PAPER, with --json none)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Records of each kind of line, by themselves and beside the study of the diagnosis.
const LINE_RUNS: u64 = 60;
const LINE_RUNS_BESIDE: usize = 40;
const MYSTERIES: u64 = 160;

#[derive(Clone, Copy, ValueEnum)]
enum Paper {
    /// On-line identification and adaptive control of a DC motor (Ma, Feng, Shi)
    PaperA,
    /// Optimal state feedback of a brushless motor (Wang, Cai, Jiang, Wang): Kalman filter, adaptive compensation
    PaperB,
    /// How often the diagnosis is right, on emulated machines whose truth is known
    Discovery,
    /// What a line does to a measurement: stamps, late and lost replies against parameter error and coverage
    Lines,
}

impl Paper {
    const fn folder(self) -> &'static str {
        match self {
            Self::PaperA => "reproduce-paper-a",
            Self::PaperB => "reproduce-paper-b",
            Self::Discovery => "reproduce-discovery",
            Self::Lines => "reproduce-lines",
        }
    }
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let out = arguments.out.clone().or_else(|| {
        let default = || PathBuf::from(arguments.paper.folder());
        (!arguments.json).then(default)
    });
    // Before the work, not after it.
    if let Some(folder) = &out {
        require_empty(folder)?;
    }
    match arguments.paper {
        Paper::PaperA | Paper::PaperB
            if arguments.sets.is_some()
                || arguments.seed.is_some()
                || arguments.mysteries.is_some()
                || arguments.records.is_some() =>
        {
            Err(Failure::with_help(
                USAGE,
                "--sets, --seed, --mysteries and --records belong to `reproduce discovery`: a paper's figures have fixed seeds",
                "leave them out",
            ))
        }
        Paper::PaperA => {
            let _endable = signals::endable()?;
            let shown = progress::begin("reproduce");
            let found = reproduce::paper_a(|part| progress::stage(part, 0));
            drop(shown);
            finish(arguments, out.as_deref(), &found, &found.report(), None)
        }
        Paper::PaperB => {
            let _endable = signals::endable()?;
            let shown = progress::begin("reproduce");
            let found = reproduce::paper_b(|part| progress::stage(part, 0));
            drop(shown);
            finish(arguments, out.as_deref(), &found, &found.report(), None)
        }
        Paper::Lines if arguments.records.is_some() || arguments.mysteries.is_some() => {
            Err(Failure::with_help(
                USAGE,
                "--records and --mysteries belong to `reproduce discovery`",
                "leave it out",
            ))
        }
        Paper::Lines => {
            let _endable = signals::endable()?;
            let shown = progress::begin("reproduce");
            let runs = usize::try_from(arguments.sets.unwrap_or(LINE_RUNS).max(1)).unwrap_or(1);
            let found = reproduce::lines::line_study(runs, arguments.seed.unwrap_or(1));
            drop(shown);
            let page = Some("lines.md");
            finish(arguments, out.as_deref(), &found, &found.report(), page)
        }
        Paper::Discovery => {
            let shown = progress::begin("reproduce");
            let real = real_records(arguments)?;
            let found = study(arguments);
            drop(shown);
            let mut found = found?;
            found.records = real;
            let page = Some("validation.md");
            finish(arguments, out.as_deref(), &found, &found.report(), page)
        }
    }
}

/// What the diagnosis says of the records in the folder that was given; before the study, which takes long.
fn real_records(arguments: &Arguments) -> Result<Vec<study::RecordAnswer>, Failure> {
    let Some(folder) = &arguments.records else {
        return Ok(Vec::new());
    };
    let found = records(folder);
    if found.is_empty() {
        let files: Vec<&str> = files().collect();
        return Err(Failure::with_help(
            USAGE,
            format!(
                "--records {}: none of the records is there",
                folder.display()
            ),
            format!("put one of these files into it: {}", files.join(", ")),
        ));
    }
    Ok(found)
}

/// Runs the study with its progress on stderr; a signal ends it after the sets that are under way.
fn study(arguments: &Arguments) -> Result<Study, Failure> {
    let size = Size {
        sets: arguments.sets.unwrap_or(1),
        seed: arguments.seed.unwrap_or(1),
        reduced: false,
    };
    let mysteries = arguments.mysteries.unwrap_or(MYSTERIES);
    if size.sets == 0 && mysteries == 0 {
        return Err(Failure::with_help(
            USAGE,
            "--sets 0 --mysteries 0 leaves nothing to study",
            "give one of them a number of at least 1",
        ));
    }
    let interrupted = signals::flag()?;
    let ended = || {
        Failure::with_help(
            INTERRUPTED,
            "interrupted: a part of the machines is not the study, so no page was written",
            "start it again, with a smaller --sets where it takes too long",
        )
    };
    output::message(&format!(
        "{} machines are excited and diagnosed, {mysteries} mystery drives are commissioned; Ctrl-C ends it",
        size.machines()
    ));
    progress::stage("excites and diagnoses machines", size.machines());
    let mut found = study::run(size, &interrupted, tell).ok_or_else(ended)?;
    if size.sets > 0 {
        progress::stage("asks what lines do to a measurement", 0);
        found.lines = Some(reproduce::lines::line_study(LINE_RUNS_BESIDE, size.seed));
    }
    if mysteries > 0 {
        found.mysteries =
            mysteries::commission(mysteries, size.seed, &interrupted)?.ok_or_else(ended)?;
    }
    Ok(found)
}

/// How far it is, and every wrong name at once.
fn tell(done: usize, _of: usize, answer: &Answer) {
    if matches!(answer.outcome, Outcome::Wrong | Outcome::Failed) {
        output::message(&format!(
            "{} ({}), hidden {}: {}",
            answer.group.name(),
            answer.excitation,
            answer.class,
            answer.sentence
        ));
    }
    progress::at(done);
}

/// Writes the files and prints what was found; `page` is the name of the page as Markdown, where there is one.
fn finish(
    arguments: &Arguments,
    out: Option<&Path>,
    found: &impl Serialize,
    report: &Reproduction,
    page: Option<&str>,
) -> Result<(), Failure> {
    if let Some(folder) = out {
        let mut files = report.files();
        files.extend(page.map(|name| (name.to_owned(), report.markdown())));
        write(folder, &files)?;
        output::message(&format!("written to {}", folder.display()));
    }
    output::result(found, arguments.json, |_| report.text())
}

fn require_empty(folder: &Path) -> Result<(), Failure> {
    let occupied = match fs::read_dir(folder) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => folder.exists(),
    };
    if occupied {
        return Err(Failure::with_help(
            USAGE,
            format!(
                "{}: exists already, and results are never overwritten",
                folder.display()
            ),
            "give another folder with --out, or move this one away",
        ));
    }
    Ok(())
}

fn cannot_write(path: &Path, error: &std::io::Error) -> Failure {
    Failure::with_help(
        USAGE,
        format!("{}: cannot write: {error}", path.display()),
        "check the folder",
    )
}

fn create(folder: &Path) -> Result<(), Failure> {
    fs::create_dir_all(folder).map_err(|error| cannot_write(folder, &error))
}

fn write(folder: &Path, files: &[(String, String)]) -> Result<(), Failure> {
    let _whole = signals::writing();
    create(folder)?;
    for (name, content) in files {
        let path = folder.join(name);
        fs::write(&path, content).map_err(|error| cannot_write(&path, &error))?;
    }
    Ok(())
}
