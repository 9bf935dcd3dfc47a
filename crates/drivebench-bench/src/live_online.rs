//! On-line identification on exactly the rows that are recorded, so that a replay of the file is the live run again.
//!
//! ```text
//! live:    commands, samples -> Record  -> Row -\
//!                                                +-> RowEstimator -> OnlineResult
//! replay:  samples.csv       -> RunRows -> Row -/
//! ```
//!
//! Beside the rows the estimators are given their configuration and nothing else; it is kept in the manifest.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::limits::MODEL_KEYS;
use crate::recording::Row;
use drivebench_identify::online::{Frozen, Online, OnlineConfig};
use drivebench_identify::recursive::{Memory, StartValues};
use drivebench_model::plant::MotorKey;
use drivebench_model::sample::{Channel, ParameterEstimate, Sample, Sensors, SpeedLag};

/// Persistence of excitation of each parameter by key, 0 to 1: share of its prior variance that the data have removed.
pub type Excitation = BTreeMap<&'static str, f64>;

/// The on-line estimators, fed with rows of the record: the one wiring of live run and replay.
pub struct RowEstimator {
    online: Online,
    rows: u64,
}

impl RowEstimator {
    pub fn new(config: OnlineConfig) -> Self {
        Self { online: Online::new(config), rows: 0 }
    }

    pub const fn online(&self) -> &Online {
        &self.online
    }

    pub fn push(&mut self, row: &Row) {
        let mut sample = Sample::at(row.time_s);
        for channel in Channel::ALL {
            if let Some(value) = row.get(channel) {
                sample.set(channel, value);
            }
        }
        sample.limited = row.is_limited();
        sample.is_unconfirmed = row.is_unconfirmed();
        self.online.push(&sample);
        self.rows += 1;
    }

    pub fn excitation(&self) -> Excitation {
        // Mechanics are linear in Kt/J and Mc/J: their excitation is that of J and Mc.
        MODEL_KEYS.map(MotorKey::key).into_iter().zip(self.online.excitation()).collect()
    }

    pub fn result(&self) -> OnlineResult {
        OnlineResult {
            rows: self.rows,
            parameters: keyed(&self.online.estimates()),
            scheme_2: keyed(&self.online.scheme_2()),
            innovation: self.online.innovation(),
            excitation: self.online.excitation(),
            frozen: self.online.frozen(),
        }
    }
}

#[derive(Clone, Debug, Serialize)]
pub struct OnlineResult {
    pub rows: u64,
    /// Scheme 3, by key.
    pub parameters: Map<String, Value>,
    /// Scheme 2, by key.
    pub scheme_2: Map<String, Value>,
    /// Of the last block: current, A, and speed, rad/s.
    pub innovation: Option<(f64, f64)>,
    /// Persistence of excitation of R, L, Ke, Kt/J, Mc/J.
    pub excitation: [f64; 5],
    /// Rows that were left out because the drive limited.
    pub frozen: Frozen,
}

fn keyed(estimates: &[ParameterEstimate]) -> Map<String, Value> {
    let value = |estimate| serde_json::to_value(estimate).unwrap_or_default();
    estimates.iter().map(|estimate| (estimate.key.clone(), value(estimate))).collect()
}

/// The estimators' configuration as the manifest keeps it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OnlineSettings {
    pub electrical_forgetting: f64,
    pub mechanical_forgetting: f64,
    pub torque_n_m_per_a: Option<f64>,
    #[serde(default)]
    pub speed_filter_s: f64,
    #[serde(default)]
    pub averages_current: bool,
    pub start: Option<StartValues>,
}

impl OnlineSettings {
    /// Where the manifest's `configs` keep it.
    pub const NAME: &str = "online";

    /// TOML; every number reads back to the same bits.
    #[expect(
        clippy::missing_panics_doc,
        reason = "numbers in named fields always have a TOML form"
    )]
    pub fn text(&self) -> String {
        toml::to_string(self).expect("numbers in named fields always have a TOML form")
    }
}

impl From<OnlineConfig> for OnlineSettings {
    fn from(config: OnlineConfig) -> Self {
        // Taken apart in full: what is added to the configuration has to be kept as well.
        let OnlineConfig { memory, torque_n_m_per_a, start, sensors } = config;
        Self {
            electrical_forgetting: memory.electrical,
            mechanical_forgetting: memory.mechanical,
            torque_n_m_per_a,
            start,
            speed_filter_s: sensors.speed.filter_s,
            averages_current: sensors.averages_current,
        }
    }
}

impl From<OnlineSettings> for OnlineConfig {
    fn from(settings: OnlineSettings) -> Self {
        Self {
            memory: Memory {
                electrical: settings.electrical_forgetting,
                mechanical: settings.mechanical_forgetting,
            },
            torque_n_m_per_a: settings.torque_n_m_per_a,
            start: settings.start,
            sensors: Sensors {
                speed: SpeedLag { delay_s: 0.0, filter_s: settings.speed_filter_s },
                averages_current: settings.averages_current,
                ..Sensors::default()
            },
        }
    }
}

/// The on-line estimators over recorded rows, one at a time: the same arithmetic in the same order as in the live run,
/// in memory that does not grow.
pub fn replay<E>(
    mut next_row: impl FnMut() -> Result<Option<Row>, E>,
    config: OnlineConfig,
) -> Result<RowEstimator, E> {
    let mut estimator = RowEstimator::new(config);
    while let Some(row) = next_row()? {
        estimator.push(&row);
    }
    Ok(estimator)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_settings_come_back_from_their_text_to_the_bit() {
        let full = OnlineConfig {
            memory: Memory { electrical: 0.1 + 0.2, mechanical: 1.0 - 1.0 / 3.0 },
            torque_n_m_per_a: Some(1.0 / 7.0),
            start: Some(StartValues {
                resistance_ohm: 1e-7 / 3.0,
                inductance_h: 0.0099_f64.next_up(),
                back_emf_v_s_per_rad: 2.0_f64.sqrt(),
            }),
            sensors: Sensors {
                speed: SpeedLag { delay_s: 0.0, filter_s: 1.0 / 15.0 },
                averages_current: true,
                ..Sensors::default()
            },
        };
        for config in [OnlineConfig::default(), full] {
            let settings = OnlineSettings::from(config);
            let back: OnlineSettings = toml::from_str(&settings.text()).unwrap();
            assert_eq!(back, settings);
            assert_eq!(OnlineSettings::from(OnlineConfig::from(back)), settings);
        }
    }
}
