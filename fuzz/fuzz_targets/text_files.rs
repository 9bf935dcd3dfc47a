//! Any text as every file that a user writes or records: read, or refused with an error.
#![no_main]

use drivebench::bench::BenchFile;
use drivebench::drive::DriveProfile;
use drivebench::emulator::EmulatorConfig;
use drivebench::plant::ModelFile;
use drivebench::recording::{ReadOptions, read_csv};
use drivebench::workflow::suite::Suite;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let _ = BenchFile::parse("bench.toml", text);
    let _ = DriveProfile::parse("drive.toml", text);
    let _ = EmulatorConfig::parse("emulator.toml", text);
    let _ = ModelFile::parse("model.toml", text);
    let _ = Suite::parse("suite.toml", text, |_| vec!["holdout".to_owned()]);
    let _ = read_csv(text.as_bytes(), "samples.csv", ReadOptions::default());
});
