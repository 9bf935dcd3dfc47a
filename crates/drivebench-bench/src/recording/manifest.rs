//! `manifest.json`: identity and origin of a run and of its signals.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use drivebench_model::numerics::checksum::{EMPTY, fnv_1a};
use drivebench_model::sample::{Channel, Origin, Side};

/// Everything needed to evaluate or repeat a run. Unknown keys of a newer program are ignored.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Manifest {
    pub program_version: String,
    pub protocol_version: Option<u16>,
    pub name: String,
    /// UTC stamp of the start, as in the folder's name.
    pub stamp: String,
    pub seed: Option<u64>,
    /// Text of each configuration as it was used: `bench`, `drive`, `motor`, `emulator`.
    pub configs: BTreeMap<String, String>,
    /// Machine and system.
    pub host: Value,
    /// Link name: `/dev/ttyUSB0`, `tcp:host:502`, `sim:`.
    pub link: String,
    /// Of the drive.
    pub identity: Value,
    pub link_statistics: Value,
    /// Bytes and frames of the wire, and the histogram of round trips; null where there was none.
    pub wire: Value,
    pub period_asked_s: Option<f64>,
    pub period_achieved_s: Option<f64>,
    pub missed_cycles: Option<u64>,
    /// Median and 99th percentile of the lateness of the cycles, s.
    pub lateness_p50_s: Option<f64>,
    pub lateness_p99_s: Option<f64>,
    /// Controller, delay and gains of a speed loop; null where there was none.
    #[serde(skip_serializing_if = "Value::is_null")]
    pub speed_loop: Value,
    /// Column key to origin: `"voltage_v": "measured"`.
    pub signals: BTreeMap<String, Origin>,
    /// Column key to the side of the power stage on which it is taken: `"current_a": "terminal"`.
    pub sides: BTreeMap<String, Side>,
    /// Column key to sign, side, basis, filter and update time by the drive's profile.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub carried: BTreeMap<String, String>,
    /// What the drive's profile states of the sensors: time constant of the filter of the speed, s, and whether a current is the
    /// mean since the last read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_filter_s: Option<f64>,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub averages_current: bool,
    /// The drive's own ramp of its duty by its profile, as a share of the supply per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duty_ramp_per_s: Option<f64>,
    /// `passed`, `interrupted`, `safety trip: ...`.
    pub outcome: Option<String>,
    /// Stop of the run: cause, times, requests; null where the output was never on.
    #[serde(skip_serializing_if = "Value::is_null")]
    pub stop: Value,
    /// The rows of `samples.csv` that hold the last seconds of a run that tripped or lost its drive; null for any other.
    #[serde(skip_serializing_if = "Value::is_null")]
    pub trip: Value,
    /// Reconnection to a lost drive; null where none was.
    #[serde(skip_serializing_if = "Value::is_null")]
    pub reopened: Value,
    /// Rows of `samples.csv`; set by the recorder.
    pub rows: Option<usize>,
    /// Only true once every row is on the disk; set by the recorder.
    pub finished: bool,
    /// Checks that the user waived.
    pub waivers: Vec<String>,
}

/// Drive and motor of a run; empty where unknown.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    pub drive: String,
    pub drive_serial: String,
    pub motor: String,
}

impl Machine {
    /// Drive and motor are known and equal. Without serial numbers they may be two units of a kind.
    pub fn is_like(&self, other: &Self) -> bool {
        let is_known = |machine: &Self| !machine.drive.is_empty() && !machine.motor.is_empty();
        is_known(self) && self == other
    }
}

impl std::fmt::Display for Machine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let or_unknown = |text: &str| {
            if text.is_empty() { "unknown".to_owned() } else { text.to_owned() }
        };
        let [drive, serial, motor] =
            [&self.drive, &self.drive_serial, &self.motor].map(|text| or_unknown(text));
        write!(f, "motor {motor} on {drive}, serial {serial}")
    }
}

impl Manifest {
    /// Drive and motor; the motor is that of the bench file that was used.
    pub fn machine(&self) -> Machine {
        let text = |key: &str| {
            self.identity.get(key).and_then(Value::as_str).unwrap_or_default().to_owned()
        };
        let bench = self.bench();
        let motor = bench.as_ref().and_then(|bench| bench.get("motor")?.get("name")?.as_str());
        Machine {
            drive: text("product"),
            drive_serial: text("serial_number"),
            motor: motor.unwrap_or_default().to_owned(),
        }
    }

    fn bench(&self) -> Option<toml::Table> {
        self.configs.get("bench")?.parse().ok()
    }

    /// The checksum of the excitation, equal for equal sequences; empty where it is unknown.
    pub fn excitation(&self) -> String {
        let bench = self.bench();
        let sequence = bench.as_ref().and_then(|bench| bench.get("sequence"));
        sequence.map_or_else(String::new, |sequence| {
            format!("{:016x}", fnv_1a(EMPTY, sequence.to_string().bytes()))
        })
    }

    /// Start of the run, UTC as `2026-01-31T23:59:59Z`.
    pub fn began(&self) -> Option<String> {
        let parsed = jiff::fmt::strtime::parse("%Y%m%dT%H%M%SZ", &self.stamp).ok()?;
        let civil = parsed.to_datetime().ok()?;
        Some(format!("{civil}Z"))
    }

    pub fn set_origin(&mut self, channel: Channel, origin: Origin) {
        self.signals.insert(channel.key().to_owned(), origin);
    }

    pub fn origin(&self, channel: Channel) -> Option<Origin> {
        self.signals.get(channel.key()).copied()
    }

    /// Sets the side of the power stage of a voltage or current.
    pub fn set_side(&mut self, channel: Channel, side: Side) {
        self.sides.insert(channel.key().to_owned(), side);
    }

    pub fn side(&self, channel: Channel) -> Option<Side> {
        self.sides.get(channel.key()).copied()
    }

    pub(super) fn text(&self) -> String {
        let mut text = serde_json::to_string_pretty(self)
            .expect("a manifest has string keys only, so it always has a JSON form");
        text.push('\n');
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_manifest_round_trips_and_unknown_keys_are_ignored() {
        let mut manifest = Manifest {
            name: "first".into(),
            seed: Some(7),
            lateness_p99_s: Some(0.0004),
            ..Manifest::default()
        };
        manifest.set_origin(Channel::Voltage, Origin::Measured);
        manifest.set_side(Channel::Current, Side::Supply);
        manifest.configs.insert("bench".into(), "[drive]\nport = \"sim:\"\n".into());
        let text = manifest.text();
        assert!(text.contains("\"voltage_v\": \"measured\""));
        assert!(text.contains("\"current_a\": \"supply\""));
        assert!(text.contains("\"finished\": false"));
        assert_eq!(serde_json::from_str::<Manifest>(&text).unwrap(), manifest);
        let newer = text.replacen('{', "{\"of_tomorrow\": [1],", 1);
        assert_eq!(serde_json::from_str::<Manifest>(&newer).unwrap(), manifest);
    }
}
