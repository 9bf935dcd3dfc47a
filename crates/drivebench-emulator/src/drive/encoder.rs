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

#[cfg(test)]
mod tests {
    use super::*;

    fn at(speed_rad_s: f64) -> Reading {
        Reading {
            speed_rad_s,
            angle_rad: 2.0 * speed_rad_s,
            current_a: speed_rad_s,
            ..Reading::default()
        }
    }

    #[test]
    fn it_sticks_until_the_next_start_and_may_be_reversed() {
        let mut encoder = Encoder::new(FaultsConfig {
            encoder_frozen_from_s: Some(1.0),
            ..FaultsConfig::default()
        });
        assert_eq!(encoder.read(0.9, at(5.0)), at(5.0));
        encoder.read(1.0, at(6.0));
        // The current is another sensor.
        let with_current = |current_a: f64, reading| Reading { current_a, ..reading };
        assert_eq!(encoder.read(2.0, at(9.0)), with_current(9.0, at(6.0)));
        assert_eq!(encoder.read(0.0, at(3.0)), at(3.0));
        let mut reversed =
            Encoder::new(FaultsConfig { encoder_reversed: true, ..FaultsConfig::default() });
        assert_eq!(reversed.read(0.0, at(5.0)), with_current(5.0, at(-5.0)));
    }
}
