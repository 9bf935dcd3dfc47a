//! `reproduce`: names the program with the papers' figures and the study of the diagnosis.

use crate::runtime::Failure;

/// Moved to the program drivebench-studies
#[derive(clap::Args)]
pub(super) struct Arguments {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true, value_name = "STUDY")]
    words: Vec<String>,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let words = arguments.words.join(" ");
    let called = format!("reproduce {words}");
    let study = if words.is_empty() { "--help" } else { &words };
    Err(Failure::usage(
        format!(
            "`{}`: the papers and the study of the diagnosis are not in this program (allowed: the program drivebench-studies)",
            called.trim_end()
        ),
        format!("in the repository: cargo run --release -p drivebench-studies -- {study}"),
    ))
}
