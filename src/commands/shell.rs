//! `completions` and `man`: generated from the command line itself.

use std::fs;
use std::path::PathBuf;

use clap::CommandFactory;

use crate::runtime::{Failure, Terminal, output};

/// Print the completions of a shell
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench completions bash > ~/.local/share/bash-completion/completions/drivebench
  drivebench completions zsh > ~/.zfunc/_drivebench
  drivebench completions fish > ~/.config/fish/completions/drivebench.fish")]
pub(super) struct Completions {
    shell: clap_complete::Shell,
}

/// Write the manual: the page of the program, and one of every command
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  drivebench man --out ~/.local/share/man/man1 && man drivebench-diagnose"
)]
pub(super) struct Man {
    /// A folder for all pages, which is made; without it the page of the program is printed
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

pub(super) fn execute_completions(
    arguments: &Completions,
    terminal: &Terminal,
) -> Result<(), Failure> {
    let mut text = Vec::new();
    let mut command = super::Arguments::command();
    clap_complete::generate(arguments.shell, &mut command, "drivebench", &mut text);
    terminal.line(String::from_utf8_lossy(&text).trim_end())
}

pub(super) fn execute_man(arguments: &Man, terminal: &Terminal) -> Result<(), Failure> {
    let command = super::Arguments::command();
    let Some(folder) = &arguments.out else {
        return terminal.line(rendered(command)?.trim_end());
    };
    fs::create_dir_all(folder).map_err(|error| {
        let headline = format!("{}: cannot make the folder: {error}", folder.display());
        Failure::usage(headline, "name a folder that exists or can be made")
    })?;
    // Pages of another version are replaced: they are generated, and no result.
    clap_mangen::generate_to(command, folder)
        .map_err(|error| output::cannot_write(folder, &error))?;
    terminal.text(&format!("manual pages in {}", folder.display()))
}

fn rendered(page: clap::Command) -> Result<String, Failure> {
    let mut text = Vec::new();
    let written = clap_mangen::Man::new(page).render(&mut text);
    written.map_err(|error| Failure::internal(format!("the manual cannot be written: {error}")))?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}
