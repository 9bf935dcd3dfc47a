//! `simulate`: the free run of a model, written as a CSV of the same form as a recorded run.

use std::fmt::Write as _;
use std::path::PathBuf;

use crate::commands::arguments::{MapArguments, run_path};
use crate::runtime::{Failure, Terminal, read_model};
use drivebench_bench::recording::write_run;
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error;
use drivebench_model::plant::Scenario;
use drivebench_model::sample::{Channel, Origin, Run, RunError};

/// Simulate a model under the voltage of a recorded run and print the result as CSV
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  drivebench simulate --model model.toml --run runs/a > simulated.csv\n  drivebench simulate --model model.toml --run runs/latest --measured > both.csv"
)]
pub(super) struct Arguments {
    /// Model file, complete
    #[arg(long)]
    model: PathBuf,
    /// The run whose voltage and sample times are used: run folder, samples.csv, or any CSV with --map
    #[arg(long, value_parser = run_path())]
    run: PathBuf,
    /// Add the measured signals: columns `measured_current_a` and `measured_speed_rad_s`
    #[arg(long)]
    measured: bool,
    /// Write here instead of to stdout
    #[arg(long, value_name = "FILE.csv")]
    output: Option<PathBuf>,
    #[command(flatten)]
    map: MapArguments,
    /// Print a JSON summary instead of the CSV
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let _endable = terminal.endable()?;
    let model = read_model(&arguments.model)?.model;
    model.require_complete()?;
    let loaded = arguments.map.load(&arguments.run, terminal)?;
    let scenario = Scenario::from_run(&loaded.run)?;
    let noise = NoiseFloor::from_standstill(&scenario)
        .unwrap_or_else(|| NoiseFloor::from_spread(&scenario));
    let trajectory = output_error::predict(&model, &scenario, &noise)?.trajectory;
    let internal = |error: RunError| Failure::internal(error.to_string());
    let mut run = Run::new("simulated", scenario.sample_time_s.clone()).map_err(internal)?;
    let input = scenario.sample_time_s.iter().map(|time_s| scenario.input_at(*time_s));
    let mut columns = vec![
        (scenario.input_channel, input.collect(), Origin::Commanded),
        (Channel::Speed, trajectory.speed_rad_s, Origin::Estimated),
    ];
    if scenario.input_channel != Channel::Current {
        columns.insert(1, (Channel::Current, trajectory.current_a, Origin::Estimated));
    }
    for (channel, values, origin) in columns {
        run.set_column(channel, values, origin).map_err(internal)?;
    }
    let mut csv = write_run(&run);
    if arguments.measured {
        csv = with_measured(&csv, &scenario);
    }
    if let Some(path) = &arguments.output {
        terminal.file(path, &csv)?;
    }
    let summary = serde_json::json!({ "rows": run.rows(), "output": arguments.output });
    match (&arguments.output, arguments.json) {
        (None, false) => terminal.line(csv.trim_end()),
        (_, json) => terminal.result(&summary, json, |_| format!("{} rows simulated", run.rows())),
    }
}

/// The lines of a simulated run with the values measured at the same sample times; a missing value is an empty cell.
fn with_measured(csv: &str, scenario: &Scenario) -> String {
    let cell = |values: &[f64], row: usize| {
        let value = values[row];
        if value.is_finite() { value.to_string() } else { String::new() }
    };
    let mut lines = csv.lines();
    let header = lines.next().unwrap_or_default();
    let mut out = format!("{header},measured_current_a,measured_speed_rad_s\n");
    for (row, line) in lines.enumerate() {
        let current = cell(&scenario.current_a, row);
        let speed = cell(&scenario.speed_rad_s, row);
        let _ = writeln!(out, "{line},{current},{speed}");
    }
    out
}
