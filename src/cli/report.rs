//! `report`: the page of a recorded run, and its pictures as files.

use std::path::PathBuf;

use super::arguments::MapArguments;
use super::failure::Failure;
use super::{output, signals};
use crate::app::report::report;

/// The page of a recorded run, anew where none is kept, and its pictures, as files
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench report runs/a --svg figures          pictures of the page that runs/a keeps
  drivebench report runs/a --output page.html     the page of the record alone, made anew")]
pub(super) struct Arguments {
    /// Run folder, samples.csv, any CSV with --map; or a page, with --svg
    run: PathBuf,
    /// Make the page anew and write it here; never overwritten
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

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(path) = &arguments.output {
        output::refuse_existing(path, "--output")?;
    }
    let _endable = signals::endable()?;
    let load = || arguments.map.load(&arguments.run);
    let (page, pictures) = (arguments.output.as_deref(), arguments.svg.as_deref());
    let done = report(&arguments.run, load, page, pictures)?;
    if arguments.markdown {
        return output::unfolded(&done, arguments.json, |done| done.markdown.clone());
    }
    output::document(&done, arguments.json, true, &done.document())
}
