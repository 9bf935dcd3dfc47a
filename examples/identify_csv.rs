//! Identifies a motor from a CSV of another program: columns become quantities of a scenario, whose signals select the scheme.
//!
//! ```sh
//! cargo run --release --example identify_csv -- record.csv time_s=t,voltage_v=u,current_a=i,speed_rad_s=w
//! ```
#![expect(clippy::print_stdout, reason = "the output of an example")]

use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;

use drivebench::identification::scheme::{self, Data};
use drivebench::plant::{Model, Motor, Scenario};
use drivebench::recording::{ColumnMap, ReadOptions, open_run};

/// One line for each parameter: its key, value and standard deviation.
pub fn identify(path: &Path, map: &ColumnMap) -> Result<String, Box<dyn Error>> {
    let run = open_run(path, ReadOptions::mapped(map))?.run;
    let scenario = Scenario::from_run(&run)?;
    let model = Model::baseline(Motor::new("unknown"));
    let found = scheme::default_for(&scenario).identify(&Data {
        run: &run,
        scenario: &scenario,
        model: &model,
    })?;
    let mut lines = String::new();
    for one in found.parameters {
        match (one.value, one.std) {
            (Some(value), Some(std)) => writeln!(lines, "{} = {value:.4e} ± {std:.1e}", one.key)?,
            _ => writeln!(lines, "{} is not observable in this run", one.key)?,
        }
    }
    Ok(lines)
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(path), Some(map)) = (arguments.next(), arguments.next()) else {
        return Err("give a file and its columns: record.csv time_s=t,voltage_v=u,current_a=i,speed_rad_s=w".into());
    };
    print!("{}", identify(path.as_ref(), &map.parse()?)?);
    Ok(())
}
