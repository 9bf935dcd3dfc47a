//! `simulate`: the free run of a model, written as a CSV of the same form as a recorded run.

use std::path::PathBuf;

use super::data::{MapArguments, read_model};
use super::failure::{Failure, INTERNAL};
use super::{output, signals};
use crate::identification::noise::NoiseFloor;
use crate::identification::output_error;
use crate::plant::Scenario;
use crate::recording::write_run;
use crate::sample::{Channel, Origin, Run};

/// Simulate a model under the voltage of a recorded run and print the result as CSV
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  drivebench simulate --model model.toml --run runs/a > simulated.csv"
)]
pub(super) struct Arguments {
    /// Model file, complete
    #[arg(long)]
    model: PathBuf,
    /// The run whose voltage and sample times are used: run folder, samples.csv, or any CSV with --map
    #[arg(long)]
    run: PathBuf,
    /// Write here instead of to stdout
    #[arg(long, value_name = "FILE.csv")]
    output: Option<PathBuf>,
    #[command(flatten)]
    map: MapArguments,
    /// Print a JSON summary instead of the CSV
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let _endable = signals::endable()?;
    let model = read_model(&arguments.model)?.model;
    model.require_complete()?;
    let loaded = arguments.map.load(&arguments.run)?;
    let scenario = Scenario::from_run(&loaded.run)?;
    let noise = NoiseFloor::from_standstill(&scenario)
        .unwrap_or_else(|| NoiseFloor::from_spread(&scenario));
    let trajectory = output_error::predict(&model, &scenario, &noise)?.trajectory;
    let held = |time_s: f64| {
        scenario.events[scenario
            .events
            .partition_point(|event| event.0 <= time_s)
            .max(1)
            - 1]
        .1
    };
    let internal = |error: crate::sample::RunError| Failure::new(INTERNAL, error.to_string());
    let mut run = Run::new("simulated", scenario.sample_time_s.clone()).map_err(internal)?;
    let input = scenario
        .sample_time_s
        .iter()
        .map(|time_s| held(*time_s))
        .collect();
    run.set_column(scenario.input_channel, input, Origin::Commanded)
        .map_err(internal)?;
    if scenario.input_channel != Channel::Current {
        run.set_column(Channel::Current, trajectory.current_a, Origin::Estimated)
            .map_err(internal)?;
    }
    run.set_column(Channel::Speed, trajectory.speed_rad_s, Origin::Estimated)
        .map_err(internal)?;
    let csv = write_run(&run);
    if let Some(path) = &arguments.output {
        output::file(path, &csv)?;
    }
    let summary = serde_json::json!({ "rows": run.rows(), "output": arguments.output });
    match (&arguments.output, arguments.json) {
        (None, false) => output::line(csv.trim_end()),
        (_, json) => output::result(&summary, json, |_| format!("{} rows simulated", run.rows())),
    }
}
