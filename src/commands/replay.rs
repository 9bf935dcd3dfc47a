//! `replay`: the on-line estimators over a log, row by row; what the live run said must come out again to the bit.

use std::path::PathBuf;

use serde_json::Value;

use crate::commands::arguments::run_path;
use crate::commands::identify::{Replayed, replayed};
use crate::runtime::failure::{Failure, REFUSED};
use crate::runtime::{output, progress, signals};
use drivebench_bench::Difference;
use drivebench_bench::recording::ColumnMap;

/// Run the on-line estimators over a log again and compare with what they said live
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench replay runs/20260131T120000Z-first      exit status 1 where it differs from the live estimates
  drivebench replay log.csv --map time_s=t,voltage_cmd_v=u,current_a=i,speed_rad_s=w")]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map
    #[arg(value_parser = run_path())]
    run: PathBuf,
    /// Columns of a foreign CSV: 'target=header[*factor][+offset],...', as time_s=t,speed_rad_s=rpm*0.104719755
    #[arg(long, value_name = "MAP")]
    #[expect(clippy::doc_markdown, reason = "the help in a terminal shows backticks as they are")]
    map: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let _endable = signals::endable()?;
    let map = arguments.map.as_deref().map(str::parse::<ColumnMap>);
    let shown = progress::begin("replay");
    progress::stage("runs the estimators over the record", 0);
    let result = replayed(&arguments.run, map.transpose()?.as_ref())?;
    drop(shown);
    output::result(&result, arguments.json, text)?;
    let Some(Difference { key, live, replayed }) = &result.first_difference else {
        return Ok(());
    };
    Err(Failure::with_help(
        REFUSED,
        format!(
            "the replay differs from the live estimates, first in {key}: live {live}, replayed {replayed}"
        ),
        "the samples were changed after the run, or another version of the program recorded it: compare program_version in manifest.json",
    ))
}

fn text(result: &Replayed) -> String {
    let mut lines = vec![format!("{}: {} rows replayed", result.run, result.online.rows)];
    for (key, estimate) in &result.online.parameters {
        lines.push(estimate_line(key, estimate));
    }
    lines.push(match (result.identical, &result.not_compared_because) {
        (Some(true), _) => "identical to the live estimates, to the bit".to_owned(),
        (Some(false), _) => "not identical to the live estimates".to_owned(),
        (None, Some(because)) => format!("nothing to compare with: {because}"),
        (None, None) => "nothing to compare with".to_owned(),
    });
    lines.join("\n")
}

/// Every digit: two replays are compared by eye as well.
fn estimate_line(key: &str, estimate: &Value) -> String {
    let word = |name: &str| estimate[name].as_str().unwrap_or_default();
    match (estimate["value"].as_f64(), estimate["std"].as_f64()) {
        (Some(value), Some(std)) => {
            format!("{:<16} {key} = {value} +- {std:.2e} {}", word("verdict"), word("unit"))
        }
        (Some(value), None) => format!("{:<16} {key} = {value} {}", word("verdict"), word("unit")),
        _ => format!("{:<16} {key}: {}", word("verdict"), word("reason")),
    }
}
