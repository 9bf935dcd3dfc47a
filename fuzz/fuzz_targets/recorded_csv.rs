//! Any bytes as a CSV log, with our own headers and with a map: read in order, or refused.
#![no_main]

use std::sync::LazyLock;

use drivebench::recording::{ColumnMap, MissingValues, ReadOptions, read_csv};
use libfuzzer_sys::fuzz_target;

static MAP: LazyLock<ColumnMap> =
    LazyLock::new(|| "time_s=t,voltage_v=u*b,current_a=i*2+1".parse().expect("a map"));
static DATE_AND_CLOCK: LazyLock<ColumnMap> =
    LazyLock::new(|| "time_s=Date+Time,current_a=i".parse().expect("a map"));
static MISSING: LazyLock<MissingValues> =
    LazyLock::new(|| "#N/A,-9999".parse().expect("missing values"));

fuzz_target!(|bytes: &[u8]| {
    let Some((options, bytes)) = bytes.split_first() else { return };
    let map = match options % 4 {
        0 => None,
        1 => Some(&*DATE_AND_CLOCK),
        _ => Some(&*MAP),
    };
    let options = ReadOptions {
        map,
        skip: (options & 4 > 0).then_some(usize::from(options / 64)),
        missing: (options & 8 > 0).then_some(&*MISSING),
        in_run_folder: options & 48 == 48,
    };
    if let Ok((run, _)) = read_csv(bytes, "log.csv", options) {
        assert!(run.time_s().windows(2).all(|pair| pair[0] < pair[1]));
    }
});
