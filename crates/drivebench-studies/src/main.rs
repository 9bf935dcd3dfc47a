//! `drivebench-studies`: the papers' figures and tables, computed again and compared; what a line does to a
//! measurement; how often the diagnosis is right.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use serde::Serialize;

use drivebench::runtime::{Failure, Terminal};
use drivebench_studies::page::FiguresAndTables;
use drivebench_studies::study::commission;
use drivebench_studies::{PaperA, PaperB, lines, paper_a, paper_b, study};

/// The papers' figures and tables, and how often the diagnosis is right: text on stdout; page, pictures and tables in a folder
#[derive(clap::Parser)]
#[command(
    name = "drivebench-studies",
    version,
    after_help = "Examples:\n  drivebench-studies paper-a --out paper-a\n  drivebench-studies lines --out lines\n  drivebench-studies discovery --sets 2 --out validation\n  drivebench-studies discovery --sets 0 --mysteries 40 --out mysteries"
)]
struct Arguments {
    #[command(subcommand)]
    study: Study,
}

#[derive(clap::Subcommand)]
enum Study {
    /// On-line identification and adaptive control of a DC motor (Ma, Feng, Shi)
    PaperA(Destination),
    /// Optimal state feedback of a brushless motor (Wang, Cai, Jiang, Wang): Kalman filter, adaptive compensation
    PaperB(Destination),
    /// How often the diagnosis is right, on emulated machines whose truth is known
    Discovery(Discovery),
    /// What a line does to a measurement: stamps, late and lost replies against parameter error and coverage
    Lines(Lines),
}

#[derive(clap::Args)]
struct Destination {
    /// Folder for report.html, figure-2.svg .., table-1.csv ..; it must be new or empty (default: reproduce-STUDY, with --json none)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args)]
struct Discovery {
    /// Machines for each effect and excitation (1: some 730 machines in all; 0: none)
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(0..=100))]
    sets: u64,
    /// Number of mystery drives that the whole program commissions
    #[arg(long, value_name = "N", default_value_t = 160, value_parser = clap::value_parser!(u64).range(0..=10_000))]
    mysteries: u64,
    /// A folder with public records of real machines, which are diagnosed too: `emps/DATA_EMPS.csv`, `sar_bldc/time_constant_2023-12-16.csv`
    #[arg(long, value_name = "DIR")]
    records: Option<PathBuf>,
    /// Another seed makes other machines
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    destination: Destination,
}

#[derive(clap::Args)]
struct Lines {
    /// Records of each line
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u64).range(0..=100))]
    sets: u64,
    /// Another seed makes other machines
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    destination: Destination,
}

fn main() -> ExitCode {
    // Mystery drives are commissioned by the program itself, which this binary is under that name.
    let name = std::env::args_os().next();
    if name.is_some_and(|name| name == commission::PROGRAM) {
        return drivebench::commands::main();
    }
    drivebench::commands::program(|arguments: Arguments, terminal| {
        execute(&arguments.study, terminal)
    })
}

impl Destination {
    /// Where the files go, if anywhere.
    fn folder(&self, study: &str) -> Option<PathBuf> {
        let default = (!self.json).then(|| PathBuf::from(format!("reproduce-{study}")));
        self.out.clone().or(default)
    }

    /// Runs a study, writes its files and prints what was found.
    fn fill<T: Serialize>(
        &self,
        terminal: &Terminal,
        name: &str,
        study: impl FnOnce() -> Result<T, Failure>,
        page: impl FnOnce(&T) -> Result<FiguresAndTables, String>,
    ) -> Result<(), Failure> {
        let folder = self.folder(name);
        // Before the work, not after it.
        folder.as_deref().map_or(Ok(()), prepare)?;
        let shown = terminal.progress("studies");
        let found = study()?;
        drop(shown);
        let page = page(&found).map_err(|error| Failure::internal(format!("{name}: {error}")))?;
        if let Some(folder) = folder {
            // The page of the diagnosis is docs/validation/tables.md.
            let markdown = match name {
                "discovery" => "tables.md".to_owned(),
                name => format!("{name}.md"),
            };
            write(&folder, &page.files(&markdown), terminal)?;
            terminal.message(&format!("written to {}", folder.display()));
        }
        terminal.result(&found, self.json, |_| page.text())
    }
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
    let help = "name a folder that is there or can be made with --out";
    Failure::usage(headline, help)
}

fn write(folder: &Path, files: &[(String, String)], terminal: &Terminal) -> Result<(), Failure> {
    let _whole = terminal.writing();
    fs::create_dir_all(folder).map_err(|error| cannot_write(folder, &error))?;
    for (name, content) in files {
        let path = folder.join(name);
        fs::write(&path, content).map_err(|error| cannot_write(&path, &error))?;
    }
    Ok(())
}

fn execute(study: &Study, terminal: &Terminal) -> Result<(), Failure> {
    // The study of the diagnosis puts down what is under way; all else ends at once.
    let ends_at_once = !matches!(study, Study::Discovery(_));
    let _endable = ends_at_once.then(|| terminal.endable()).transpose()?;
    let stage = |part: &str| terminal.stage(part, 0);
    match study {
        Study::PaperA(own) => own.fill(terminal, "paper-a", || Ok(paper_a(stage)), PaperA::report),
        Study::PaperB(own) => own.fill(terminal, "paper-b", || Ok(paper_b(stage)), PaperB::report),
        Study::Lines(own) => {
            let found = || {
                let runs = usize::try_from(own.sets.max(1)).unwrap_or(1);
                terminal.stage("records and identifies", lines::KINDS);
                Ok(lines::line_study(runs, own.seed, |done| terminal.at(done)))
            };
            let destination = &own.destination;
            destination.fill(terminal, "lines", found, lines::LineStudy::report)
        }
        Study::Discovery(own) => {
            let records = own.records.as_deref();
            let found = || commission::study(own.sets, own.mysteries, own.seed, records, terminal);
            let destination = &own.destination;
            destination.fill(terminal, "discovery", found, study::Study::report)
        }
    }
}
