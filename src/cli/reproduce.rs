//! `reproduce`: a paper's figures and tables, computed again beside what the paper prints; or the study of the diagnosis.

use std::fs;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use serde::Serialize;

use super::failure::Failure;
use super::{output, progress, signals};
use crate::app::study::study;
use crate::report::reproduce::Reproduction;
use crate::workflow::reproduce;

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

/// Records of each kind of line, and mystery drives of the study of the diagnosis.
const LINE_RUNS: u64 = 60;
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

impl Arguments {
    /// Where the files go, if anywhere.
    fn folder(&self) -> Option<PathBuf> {
        let paper = self.paper.to_possible_value();
        let default = paper.map(|paper| PathBuf::from(format!("reproduce-{}", paper.get_name())));
        self.out.clone().or(default.filter(|_| !self.json))
    }
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let of_study = arguments.records.is_some() || arguments.mysteries.is_some();
    let of_seeds = arguments.sets.is_some() || arguments.seed.is_some();
    match arguments.paper {
        Paper::PaperA | Paper::PaperB if of_study || of_seeds => {
            return Err(Failure::usage(
                "--sets, --seed, --mysteries and --records belong to `reproduce discovery`: a paper's figures have fixed seeds",
                "leave them out",
            ));
        }
        Paper::Lines if of_study => {
            return Err(Failure::usage(
                "--records and --mysteries belong to `reproduce discovery`",
                "leave it out",
            ));
        }
        _ => {}
    }
    // Before the work, not after it.
    if let Some(folder) = &arguments.folder() {
        prepare(folder)?;
    }
    // A study puts down what is under way; all else ends at once.
    let is_study = matches!(arguments.paper, Paper::Discovery);
    let _endable = (!is_study).then(signals::endable).transpose()?;
    let shown = progress::begin("reproduce");
    let stage = |part: &str| progress::stage(part, 0);
    let seed = arguments.seed.unwrap_or(1);
    match arguments.paper {
        Paper::PaperA => {
            let found = reproduce::paper_a(stage);
            finish(arguments, shown, &found, &found.report(), None)
        }
        Paper::PaperB => {
            let found = reproduce::paper_b(stage);
            finish(arguments, shown, &found, &found.report(), None)
        }
        Paper::Lines => {
            let runs = usize::try_from(arguments.sets.unwrap_or(LINE_RUNS).max(1)).unwrap_or(1);
            progress::stage("records and identifies", reproduce::lines::KINDS);
            let found = reproduce::lines::line_study(runs, seed, progress::at);
            let page = Some("lines.md");
            finish(arguments, shown, &found, &found.report(), page)
        }
        Paper::Discovery => {
            let sets = arguments.sets.unwrap_or(1);
            let mysteries = arguments.mysteries.unwrap_or(MYSTERIES);
            let found = study(sets, mysteries, seed, arguments.records.as_deref())?;
            let page = Some("validation.md");
            finish(arguments, shown, &found, &found.report(), page)
        }
    }
}

/// Writes the files and prints what was found; `page` is the name of the page as Markdown, where there is one.
fn finish(
    arguments: &Arguments,
    shown: progress::Shown,
    found: &impl Serialize,
    report: &Reproduction,
    page: Option<&str>,
) -> Result<(), Failure> {
    drop(shown);
    if let Some(folder) = arguments.folder() {
        let mut files = report.files();
        files.extend(page.map(|name| (name.to_owned(), report.markdown())));
        write(&folder, &files)?;
        output::message(&format!("written to {}", folder.display()));
    }
    output::result(found, arguments.json, |_| report.text())
}

/// Refuses a folder that holds anything, and one that cannot be made or written to: it is tried.
fn prepare(folder: &Path) -> Result<(), Failure> {
    let occupied = match fs::read_dir(folder) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => folder.exists(),
    };
    if occupied {
        let folder = folder.display();
        let headline = format!("{folder}: exists already, and results are never overwritten");
        let help = "give another folder with --out, or move this one away";
        return Err(Failure::usage(headline, help));
    }
    let is_made = |path: &&Path| !path.as_os_str().is_empty() && !path.exists();
    let made: Vec<&Path> = folder.ancestors().take_while(is_made).collect();
    // A folder that is there may not be one that takes files.
    let trial = folder.join(".drivebench");
    let tried = fs::create_dir_all(folder)
        .and_then(|()| fs::write(&trial, ""))
        .and_then(|()| fs::remove_file(&trial));
    // Work that is interrupted leaves nothing behind; what cannot be removed again is an empty folder.
    for path in made {
        let _ = fs::remove_dir(path);
    }
    tried.map_err(|error| cannot_write(folder, &error))
}

fn cannot_write(path: &Path, error: &std::io::Error) -> Failure {
    let headline = format!("{}: cannot write: {error}", path.display());
    Failure::usage(
        headline,
        "name a folder that is there or can be made with --out",
    )
}

fn write(folder: &Path, files: &[(String, String)]) -> Result<(), Failure> {
    let _whole = signals::writing();
    fs::create_dir_all(folder).map_err(|error| cannot_write(folder, &error))?;
    for (name, content) in files {
        let path = folder.join(name);
        fs::write(&path, content).map_err(|error| cannot_write(&path, &error))?;
    }
    Ok(())
}
