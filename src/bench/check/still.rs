//! Whether a shaft stands still where nothing is asked of it: with the output off, and where the drive runs at zero.
//!
//! Figures are shares of the bench's limits, or a multiple of what the sensors show at rest where that is more.

use super::NoiseFloor;
use super::pulse::Kind;
use crate::bench::limits::Limits;
use crate::sample::{Channel, Sample};

/// Mean and standard deviation at rest may be so large with the output off, as shares of the bench's limits.
const REST_SPEED_SHARE: f64 = 0.01;
const REST_SHARE: f64 = 0.05;
/// A single sample may be so many times that.
const SINGLE_FACTOR: f64 = 3.0;
/// Where the drive runs at zero: shares of the limits, and standard deviations at rest.
const ZERO_SPEED_SHARE: f64 = 0.01;
const ZERO_SHARE: f64 = 0.15;
const NOISE_FACTOR: f64 = 8.0;
/// A shaft that turned so far between two looks has moved, rad.
const ZERO_ANGLE_RAD: f64 = 3.0;

/// What is looked at, with the bench's limit of each.
fn watched(limits: &Limits) -> [(Channel, f64, f64); 3] {
    [
        (Channel::Speed, limits.speed_rad_s, REST_SPEED_SHARE),
        (Channel::Current, limits.current_a, REST_SHARE),
        (Channel::Voltage, limits.voltage_v, REST_SHARE),
    ]
}

fn figure(channel: Channel, what: &str, value: f64, most: f64) -> String {
    let (name, unit) = (channel.name(), channel.unit());
    format!("{name} {what}{value:.4} {unit}, at most {most:.4} {unit}")
}

/// What one sample with the output off shows beyond rest; `settled`: as close as a mean has to be.
pub(super) fn unrest(sample: &Sample, limits: &Limits, settled: bool) -> Option<String> {
    let factor = if settled { 1.0 } else { SINGLE_FACTOR };
    watched(limits)
        .into_iter()
        .find_map(|(channel, limit, share)| {
            let (value, most) = (sample.get(channel)?, factor * share * limit);
            (value.abs() > most).then(|| figure(channel, "", value, most))
        })
}

/// What the mean or the spread of samples with the output off shows beyond rest.
pub(super) fn unrest_of_all(noise: &[NoiseFloor], limits: &Limits) -> Option<String> {
    watched(limits)
        .into_iter()
        .find_map(|(channel, limit, share)| {
            let floor = noise.iter().find(|floor| floor.channel == channel)?;
            let most = share * limit;
            if floor.mean.abs() > most {
                return Some(figure(channel, "mean ", floor.mean, most));
            }
            (floor.std > most).then(|| figure(channel, "spread ", floor.std, most))
        })
}

/// Speed, current and voltage of a sample in words.
pub(super) fn told(sample: &Sample) -> String {
    let figures: Vec<String> = [Channel::Speed, Channel::Current, Channel::Voltage]
        .into_iter()
        .filter_map(|channel| {
            let value = sample.get(channel)?;
            Some(format!("{} {value:.2} {}", channel.name(), channel.unit()))
        })
        .collect();
    if figures.is_empty() {
        "it tells no speed, current or voltage".to_owned()
    } else {
        figures.join(", ")
    }
}

/// What a drive that runs at zero may show.
#[derive(Clone, Debug)]
pub(super) struct Still {
    /// Mean at rest and the most beside it.
    bounds: [(Channel, f64, f64); 3],
    /// The angle where it began.
    angle_rad: Option<f64>,
}

impl Still {
    /// `hold`: what holds a load, in the unit of the quantity that is commanded, and as current.
    pub(super) fn of(noise: &[NoiseFloor], limits: &Limits, kind: Kind, hold: (f64, f64)) -> Self {
        let bounds = watched(limits).map(|(channel, limit, _)| {
            let floor = noise.iter().find(|floor| floor.channel == channel);
            let (mean, std) = floor.map_or((0.0, 0.0), |floor| (floor.mean, floor.std));
            let most = match (channel, kind) {
                (Channel::Speed, _) => ZERO_SPEED_SHARE * limit,
                // A drive that holds the speed zero does so with the voltage and current that it takes.
                (_, Kind::Speed) => limit,
                (Channel::Current, _) => ZERO_SHARE * limit + hold.1.abs(),
                (_, Kind::Voltage) => ZERO_SHARE * limit + hold.0.abs(),
                (_, Kind::Current) => limit,
            };
            (channel, mean, most.max(NOISE_FACTOR * std))
        });
        Self {
            bounds,
            angle_rad: None,
        }
    }

    /// What moves in this sample, or has moved since the first one.
    pub(super) fn moved(&mut self, sample: &Sample) -> Option<String> {
        for (channel, mean, most) in self.bounds {
            if let Some(value) = sample.get(channel)
                && (value - mean).abs() > most
            {
                return Some(figure(channel, "", value, most));
            }
        }
        let angle_rad = sample.get(Channel::Angle)?;
        let turned_rad = angle_rad - *self.angle_rad.get_or_insert(angle_rad);
        (turned_rad.abs() > ZERO_ANGLE_RAD)
            .then(|| figure(Channel::Angle, "by ", turned_rad, ZERO_ANGLE_RAD))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::limits::Nameplate;

    fn limits() -> Limits {
        Limits::for_motor(&Nameplate::zk_22fc(), 100.0)
    }

    fn sample(speed_rad_s: f64, current_a: f64, voltage_v: f64) -> Sample {
        Sample::at(0.0)
            .with(Channel::Speed, speed_rad_s)
            .with(Channel::Current, current_a)
            .with(Channel::Voltage, voltage_v)
    }

    #[test]
    fn a_braking_that_averages_to_nothing_is_no_noise() {
        let floor = |channel, mean, std| NoiseFloor {
            channel,
            mean,
            std,
            samples: 50,
        };
        // As a drive showed that was stopped while it turned at 105 rad/s.
        let braking = [
            floor(Channel::Speed, 2.1551, 11.3723),
            floor(Channel::Current, -0.4720, 2.0936),
        ];
        let text = unrest_of_all(&braking, &limits()).unwrap();
        assert!(text.contains("spread 11.37"), "{text}");
        let quiet = [
            floor(Channel::Speed, 0.02, 0.15),
            floor(Channel::Current, 0.1, 0.03),
        ];
        assert_eq!(unrest_of_all(&quiet, &limits()), None);
        assert!(unrest(&sample(30.0, 0.0, 0.0), &limits(), false).is_some());
        assert_eq!(unrest(&sample(0.5, 0.2, 0.5), &limits(), true), None);
    }

    #[test]
    fn a_drive_at_zero_that_moves_or_drives_a_current_is_seen() {
        let still = || Still::of(&[], &limits(), Kind::Voltage, (0.0, 0.0));
        assert_eq!(still().moved(&sample(0.5, 0.3, 1.0)), None);
        for (moving, words) in [
            (sample(10.2, 0.0, 0.0), "speed 10.2"),
            (sample(0.0, 11.2, 0.0), "current 11.2"),
            (sample(0.0, 0.0, 60.0), "voltage 60.0"),
        ] {
            let text = still().moved(&moving).unwrap();
            assert!(text.contains(words), "{text}");
        }
        let mut still = still();
        let at = |angle| sample(0.0, 0.0, 0.0).with(Channel::Angle, angle);
        assert_eq!(still.moved(&at(7.0)), None);
        let text = still.moved(&at(12.0)).unwrap();
        assert!(text.contains("by 5.0"), "{text}");
        // A load is held with what holds it; a speed is held with what it takes.
        let mut held = Still::of(&[], &limits(), Kind::Voltage, (2.5, 2.3));
        assert_eq!(held.moved(&sample(0.0, 2.3, 2.5)), None);
        let mut at_speed = Still::of(&[], &limits(), Kind::Speed, (0.0, 0.0));
        assert_eq!(at_speed.moved(&sample(0.0, 3.0, 30.0)), None);
        assert!(at_speed.moved(&sample(10.2, 3.0, 30.0)).is_some());
    }
}
