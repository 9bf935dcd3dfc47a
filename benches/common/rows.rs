//! Rows of a run at 1 kHz.

use drivebench::recording::{Layout, Row};
use drivebench::sample::Channel;

/// The twelve columns of our own drive: these and `time_s`, `host_time_s`, `seq`, `status`, `quality`.
pub(crate) const SIGNALS: [Channel; 7] = [
    Channel::VoltageCmd,
    Channel::Voltage,
    Channel::Current,
    Channel::Speed,
    Channel::Angle,
    Channel::Bus,
    Channel::Temperature,
];

/// A row of a run at 1 kHz: values of the drive have its resolution, computed values have all digits.
pub(crate) fn row(k: usize) -> Row {
    let time_s = 1e-3 * k as f64;
    let mut row = Row::at(time_s);
    row.host_time_s = Some(time_s + 3.712_345_678e-4);
    row.seq = Some(k as u64);
    "running".clone_into(&mut row.status);
    let level_v = if (k / 40).is_multiple_of(2) { 30.0 } else { -12.5 };
    let wave = |hz: f64| (hz * time_s).sin();
    for (channel, value) in SIGNALS.into_iter().zip([
        level_v,
        level_v + 0.1 * wave(911.0),
        4.0 * wave(71.0),
        (100.0 * wave(7.0) / 0.01).round() * 0.01,
        0.1 * k as f64,
        140.0 + (10.0 * wave(3.0)).round() * 0.1,
        31.5,
    ]) {
        row.set(channel, Some(value));
    }
    row
}

pub(crate) fn layout() -> Layout {
    Layout::of_drive(&SIGNALS)
}
