//! `manifest.json`: what a run is, how it was made and where each of its signals comes from.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use drivebench_model::numerics::checksum::{EMPTY, fnv_1a};
use drivebench_model::sample::{Channel, Origin, Side};

/// Everything that is needed to judge or repeat a run. Keys that a newer program may have added are read past.
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
    /// What the drive says it is.
    pub identity: Value,
    pub link_statistics: Value,
    /// Bytes and frames that the wire carried, and the histogram of round trips; null where there was none.
    pub wire: Value,
    pub period_asked_s: Option<f64>,
    pub period_achieved_s: Option<f64>,
    pub missed_cycles: Option<u64>,
    /// Median and 99th percentile of how late the cycles began, s.
    pub lateness_p50_s: Option<f64>,
    pub lateness_p99_s: Option<f64>,
    /// Controller, delay and gains of a speed loop; null where there was none.
    #[serde(skip_serializing_if = "Value::is_null")]
    pub speed_loop: Value,
    /// Column key to origin: `"voltage_v": "measured"`.
    pub signals: BTreeMap<String, Origin>,
    /// Column key to the side of the power stage on which it is taken: `"current_a": "terminal"`.
    pub sides: BTreeMap<String, Side>,
    /// Column key to what its number stands for: sign, side, basis, filter and update time, as the drive's profile says.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub carried: BTreeMap<String, String>,
    /// `passed`, `interrupted`, `safety trip: ...`.
    pub outcome: Option<String>,
    /// How soon the run was stopped: cause, times, requests; null where the output was never on.
    #[serde(skip_serializing_if = "Value::is_null")]
    pub stop: Value,
    /// The rows of `samples.csv` that hold the last seconds of a run that tripped or lost its drive; null for any other.
    #[serde(skip_serializing_if = "Value::is_null")]
    pub trip: Value,
    /// How a drive that was lost was found again; null where none was.
    #[serde(skip_serializing_if = "Value::is_null")]
    pub reopened: Value,
    /// Rows of `samples.csv`; set by the recorder.
    pub rows: Option<usize>,
    /// Only true once every row is on the disk; set by the recorder.
    pub finished: bool,
    /// Checks that the user waived.
    pub waivers: Vec<String>,
}

/// Which drive and which motor a run is of; empty words where the run does not say.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    pub drive: String,
    pub drive_serial: String,
    pub motor: String,
}

impl Machine {
    /// Whether nothing that both say of themselves differs, and both say something. Without serial numbers they may be two
    /// units of a kind.
    pub fn is_like(&self, other: &Self) -> bool {
        let is_known = |machine: &Self| !machine.drive.is_empty() && !machine.motor.is_empty();
        is_known(self) && self == other
    }
}

impl std::fmt::Display for Machine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let or_unknown = |word: &str| {
            if word.is_empty() { "unknown".to_owned() } else { word.to_owned() }
        };
        let [drive, serial, motor] =
            [&self.drive, &self.drive_serial, &self.motor].map(|word| or_unknown(word));
        write!(f, "motor {motor} on {drive}, serial {serial}")
    }
}

impl Manifest {
    /// Drive and motor; the motor is that of the bench file that was used.
    pub fn machine(&self) -> Machine {
        let said = |key: &str| {
            self.identity.get(key).and_then(Value::as_str).unwrap_or_default().to_owned()
        };
        let bench = self.configs.get("bench").and_then(|text| text.parse::<toml::Table>().ok());
        let motor = bench.as_ref().and_then(|bench| bench.get("motor")?.get("name")?.as_str());
        Machine {
            drive: said("product"),
            drive_serial: said("serial_number"),
            motor: motor.unwrap_or_default().to_owned(),
        }
    }

    /// The checksum of the excitation: two runs that were excited alike have the same. Empty where the manifest does not say.
    pub fn excitation(&self) -> String {
        let bench = self.configs.get("bench").and_then(|text| text.parse::<toml::Table>().ok());
        let sequence = bench.as_ref().and_then(|bench| bench.get("sequence"));
        sequence.map_or_else(String::new, |sequence| {
            format!("{:016x}", fnv_1a(EMPTY, sequence.to_string().bytes()))
        })
    }

    /// When the run began, UTC as `2026-01-31T23:59:59Z`; none where the manifest does not say.
    pub fn began(&self) -> Option<String> {
        let parsed = jiff::fmt::strtime::parse("%Y%m%dT%H%M%SZ", &self.stamp).ok()?;
        let civil = parsed.to_datetime().ok()?;
        Some(format!("{civil}Z"))
    }

    /// Says where a signal comes from.
    pub fn set_origin(&mut self, channel: Channel, origin: Origin) {
        self.signals.insert(channel.key().to_owned(), origin);
    }

    pub fn origin(&self, channel: Channel) -> Option<Origin> {
        self.signals.get(channel.key()).copied()
    }

    /// Says on which side of the power stage a voltage or current is taken.
    pub fn set_side(&mut self, channel: Channel, side: Side) {
        self.sides.insert(channel.key().to_owned(), side);
    }

    pub fn side(&self, channel: Channel) -> Option<Side> {
        self.sides.get(channel.key()).copied()
    }

    /// The text of `manifest.json`.
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
    fn a_manifest_comes_back_and_newer_keys_are_read_past() {
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
