//! The shaft's encoder, as it may be broken: wired the wrong way round, or stuck from an instant on.

use crate::config::FaultsConfig;
use crate::truth::Reading;

pub(super) struct Encoder {
    is_reversed: bool,
    frozen_from_s: Option<f64>,
    /// Speed and angle as they were when it stuck.
    frozen: Option<(f64, f64)>,
}

impl Encoder {
    pub(super) const fn new(faults: FaultsConfig) -> Self {
        Self {
            is_reversed: faults.encoder_reversed,
            frozen_from_s: faults.encoder_frozen_from_s,
            frozen: None,
        }
    }

    pub(super) fn read(&mut self, time_s: f64, mut reading: Reading) -> Reading {
        if self.is_reversed {
            reading.speed_rad_s = -reading.speed_rad_s;
            reading.angle_rad = -reading.angle_rad;
        }
        if self.frozen_from_s.is_some_and(|from_s| time_s >= from_s) {
            let now = (reading.speed_rad_s, reading.angle_rad);
            (reading.speed_rad_s, reading.angle_rad) = *self.frozen.get_or_insert(now);
        } else {
            self.frozen = None;
        }
        reading
    }
}
