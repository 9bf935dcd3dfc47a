//! `reproduce`: a paper's figures and tables, computed again beside what the paper prints.

use std::fs;
use std::path::{Path, PathBuf};

use clap::ValueEnum;

use super::failure::{Failure, USAGE};
use super::output;
use crate::report::reproduce::Reproduction;
use crate::workflow::reproduce;

/// Compute a paper's figures and tables again: text on stdout, page, pictures and tables in a folder
#[derive(clap::Args)]
#[command(after_help = "Example:\n  drivebench reproduce paper-a --out paper-a")]
pub(super) struct Arguments {
    /// Which paper
    #[arg(value_enum, value_name = "PAPER")]
    paper: Paper,
    /// Folder for report.html, figure-2.svg .., table-1.csv ..; it must be new or empty (default: reproduce-PAPER, with --json none)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Paper {
    /// On-line identification of a DC motor (Ma, Feng, Shi): schemes 1 and 2
    PaperA,
}

impl Paper {
    const fn folder(self) -> &'static str {
        match self {
            Self::PaperA => "reproduce-paper-a",
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
    let Paper::PaperA = arguments.paper;
    let found = reproduce::paper_a(|part| output::message(&format!("{part} ...")));
    let report = found.report();
    if let Some(folder) = &out {
        write(folder, &report)?;
        output::message(&format!("written to {}", folder.display()));
    }
    output::result(&found, arguments.json, |_| report.text())
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

fn write(folder: &Path, report: &Reproduction) -> Result<(), Failure> {
    let failed = |path: &Path, error: &std::io::Error| {
        Failure::with_help(
            USAGE,
            format!("{}: cannot write: {error}", path.display()),
            "check the folder",
        )
    };
    fs::create_dir_all(folder).map_err(|error| failed(folder, &error))?;
    for (name, content) in report.files() {
        let path = folder.join(name);
        fs::write(&path, content).map_err(|error| failed(&path, &error))?;
    }
    Ok(())
}
