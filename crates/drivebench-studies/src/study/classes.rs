//! Classes of machine besides the reference motor: other time constants, friction, rates, sensors, inputs and logs. A class is a set
//! of ratios to the reference: volts, amperes and rad/s are units, which change no answer (a property test of the diagnosis).

use std::f64::consts::TAU;

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::Serialize;

use super::Excitation;
use super::record::Truth;
use drivebench::emulator::truth::MotorTruth;
use drivebench::numerics::count::whole;
use drivebench::plant::{Motor, MotorKey};
use drivebench::sample::{Channel, Origin};

#[derive(Debug, PartialEq, Serialize)]
pub struct Class {
    pub name: &'static str,
    pub description: &'static str,
    #[serde(skip)]
    pub(super) excitation: Excitation,
    #[serde(skip)]
    pub(super) period_s: f64,
    /// Multiples of the inductance, the inertia and the dry friction of the reference, whose L/R is 9 ms, time constant 40 ms,
    /// friction 1.3 % of the stall torque.
    #[serde(skip)]
    pub(super) motor: [f64; 3],
    #[serde(skip)]
    pub(super) sensors: Sensors,
    #[serde(skip)]
    pub(super) log: Log,
}

/// Noise and steps of current, A, and speed, rad/s, of a motor with a stall current of 100 A and 300 rad/s.
#[derive(Debug, PartialEq)]
pub(super) struct Sensors {
    pub(super) noise: [f64; 2],
    pub(super) step: [f64; 2],
    pub(super) speed: SpeedFrom,
    /// Correlation time of the noise, s; zero for white noise.
    pub(super) memory_s: f64,
}

/// What the recorded speed is.
#[derive(Debug, PartialEq)]
pub(super) enum SpeedFrom {
    Drive,
    /// Difference of so many counts a turn from row to row.
    Counts(f64),
    /// Renewed only every so many s.
    Updates(f64),
}

/// The columns of the log.
#[derive(Debug, PartialEq)]
pub(super) enum Log {
    Whole,
    WithoutCurrent,
    /// The current is the input.
    WithoutVoltage,
}

const SENSORS: Sensors =
    Sensors { noise: [0.03, 0.15], step: [0.01, 0.104_72], speed: SpeedFrom::Drive, memory_s: 0.0 };

const PLAIN: Class = Class {
    name: "",
    description: "",
    excitation: Excitation::Steps,
    period_s: 0.005,
    motor: [1.0; 3],
    sensors: SENSORS,
    log: Log::Whole,
};

/// Sensors of a Dynamixel and of a VESC at 100 A and 300 rad/s: 2.69 mA of 1.4 A and .229 of 60 r/min; 10 mA of 60 A and 1 of
/// 3,000 r/min.
const DYNAMIXEL: Sensors = Sensors { noise: [0.1, 0.4], step: [0.19, 1.15], ..SENSORS };
const VESC: Sensors = Sensors { noise: [0.1, 0.1], step: [0.017, 0.1], ..SENSORS };

/// Every class, in the order of the tables.
pub(super) static CLASSES: [Class; 15] = [
    Class {
        name: "toy motor",
        description: "friction a tenth of the stall torque, L/R a tenth of the period, 10 bits, 100 Hz",
        period_s: 0.01,
        motor: [0.1, 0.5, 8.0],
        sensors: Sensors { noise: [0.1, 0.3], step: [0.2, 0.6], ..SENSORS },
        ..PLAIN
    },
    Class {
        name: "geared servo",
        description: "friction a tenth of the stall torque, quanta of a Dynamixel, 6 ms",
        period_s: 0.006,
        motor: [0.05, 1.0, 8.0],
        sensors: DYNAMIXEL,
        ..PLAIN
    },
    Class {
        name: "hub motor",
        description: "time constant .25 s, quanta of a VESC, 6 ms",
        excitation: Excitation::Rich,
        period_s: 0.006,
        motor: [0.5, 6.0, 1.0],
        sensors: VESC,
        ..PLAIN
    },
    Class {
        name: "wheel",
        description: "time constant .4 s, 20 Hz",
        excitation: Excitation::Rich,
        period_s: 0.05,
        motor: [0.3, 10.0, 3.0],
        ..PLAIN
    },
    Class {
        name: "spindle",
        description: "a run of 25 time constants, 50 Hz",
        period_s: 0.02,
        motor: [1.0, 12.0, 0.5],
        ..PLAIN
    },
    Class {
        name: "fast servo",
        description: "time constant 6 ms, 1 kHz",
        excitation: Excitation::Rich,
        period_s: 0.001,
        motor: [0.3, 0.15, 1.0],
        ..PLAIN
    },
    Class {
        name: "speed from counts",
        description: "2,048 counts a turn, differences at 5 ms: steps of .6 rad/s",
        sensors: Sensors { noise: [0.03, 0.0], speed: SpeedFrom::Counts(2048.0), ..SENSORS },
        ..PLAIN
    },
    Class {
        name: "speed every 20 ms",
        description: "renewed every 20 ms, read every 5 ms",
        sensors: Sensors { speed: SpeedFrom::Updates(0.02), ..SENSORS },
        ..PLAIN
    },
    Class {
        name: "8 bits",
        description: "steps of .8 % of stall current and largest speed, 5 ms",
        excitation: Excitation::Rich,
        sensors: Sensors { noise: [0.2, 0.6], step: [0.8, 2.4], ..SENSORS },
        ..PLAIN
    },
    Class {
        name: "large inductance",
        description: "L/R ten periods and a third of the time constant",
        excitation: Excitation::Prbs,
        motor: [5.0, 3.0, 1.0],
        ..PLAIN
    },
    Class {
        name: "small inductance",
        description: "L/R a twentieth of the period of 10 ms",
        excitation: Excitation::Prbs,
        period_s: 0.01,
        motor: [0.05, 1.0, 1.0],
        ..PLAIN
    },
    Class {
        name: "coloured noise",
        description: "of both sensors, with a memory of 15 ms, 5 ms",
        sensors: Sensors { memory_s: 0.015, ..SENSORS },
        ..PLAIN
    },
    Class {
        name: "one quadrant",
        description: "friction a tenth of the stall torque, positive levels only",
        excitation: Excitation::Unipolar,
        motor: [1.0, 1.0, 8.0],
        ..PLAIN
    },
    Class {
        name: "no current",
        description: "voltage and speed only, 5 ms",
        excitation: Excitation::Rich,
        log: Log::WithoutCurrent,
        ..PLAIN
    },
    Class {
        name: "no voltage",
        description: "current and speed only: the current is the input, 5 ms",
        log: Log::WithoutVoltage,
        ..PLAIN
    },
];

/// A column of a log.
pub(super) type Column = (Channel, Vec<f64>, Origin);

impl Class {
    /// The reference motor as one of this class.
    pub(super) fn of(&self, reference: &MotorTruth) -> MotorTruth {
        let [inductance, inertia, friction] = self.motor;
        let mut motor = reference.clone();
        motor.inductance_h *= inductance;
        motor.inertia_kg_m2 *= inertia;
        motor.load_torque_n_m *= friction;
        motor
    }

    /// What its sensors add: a difference of counts is the speed in the middle of the period before.
    pub(super) fn late(&self) -> Option<Truth> {
        let is_counted = matches!(self.sensors.speed, SpeedFrom::Counts(_));
        is_counted.then(|| Truth::late_speed(0.5 * self.period_s))
    }

    /// Its nameplate; without a voltage with the torque constant of the specimen, of which inertia and friction are multiples.
    pub(super) fn nameplate(&self, reference: &Motor, back_emf_v_s_per_rad: f64) -> Motor {
        let mut reference = reference.clone();
        if self.log == Log::WithoutVoltage {
            reference.set(MotorKey::BackEmf, back_emf_v_s_per_rad);
        }
        let keys = [MotorKey::Inductance, MotorKey::Inertia, MotorKey::LoadTorque];
        let factors = keys.into_iter().zip(self.motor);
        factors.fold(reference, |motor, (key, factor)| {
            let value = motor.get(key).map(|value| factor * value);
            value.map_or_else(|| motor.clone(), |value| motor.clone().with(key, value))
        })
    }

    /// Changes the columns of the reference's log to those of this class.
    pub(super) fn make_log(&self, columns: &mut Vec<Column>, rng: &mut ChaCha8Rng) {
        let of = |columns: &[Column], of: Channel| {
            let mut own = columns.iter().filter(|column| column.0 == of);
            own.next().map_or(vec![], |column| column.1.clone())
        };
        let angle = of(columns, Channel::Angle);
        for (channel, cells, _) in columns.iter_mut() {
            let [of_current, of_speed] = self.sensors.noise;
            let deviation = match channel {
                Channel::Speed => {
                    *cells = self.speeds(std::mem::take(cells), &angle);
                    of_speed
                }
                Channel::Current => of_current,
                _ => 0.0,
            };
            if self.sensors.memory_s > 0.0 {
                self.add_noise(deviation, cells, rng);
            }
        }
        columns.retain(|(channel, ..)| match channel {
            Channel::VoltageCmd => self.log != Log::WithoutVoltage,
            Channel::Current => self.log != Log::WithoutCurrent,
            Channel::Angle => false,
            _ => true,
        });
    }

    /// The speeds of the log: `speed` as the drive has it, `angle` that of the shaft.
    fn speeds(&self, speed: Vec<f64>, angle: &[f64]) -> Vec<f64> {
        match self.sensors.speed {
            SpeedFrom::Drive => speed,
            SpeedFrom::Counts(per_turn) => {
                let unit = TAU / per_turn;
                let counts: Vec<f64> = angle.iter().map(|angle| (angle / unit).floor()).collect();
                let steps = counts.windows(2).map(|two| (two[1] - two[0]) * unit / self.period_s);
                std::iter::once(0.0).chain(steps).collect()
            }
            SpeedFrom::Updates(every_s) => {
                let each = whole((every_s / self.period_s).round()).max(1);
                // What the reader of a log makes of cells that only repeat a value.
                let renewed = |(row, speed)| if row % each == 0 { speed } else { f64::NAN };
                speed.into_iter().enumerate().map(renewed).collect()
            }
        }
    }

    /// Noise of a first-order autoregression with this deviation.
    fn add_noise(&self, deviation: f64, cells: &mut [f64], rng: &mut ChaCha8Rng) {
        let kept = (-self.period_s / self.sensors.memory_s).exp();
        let mut now = deviation * rng.sample::<f64, _>(StandardNormal);
        for cell in cells {
            let new = rng.sample::<f64, _>(StandardNormal);
            now = kept * now + deviation * (1.0 - kept * kept).sqrt() * new;
            *cell += now;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn class(name: &str) -> &'static Class {
        CLASSES.iter().find(|class| class.name == name).unwrap()
    }

    /// The log of a shaft that turns at 10 rad/s.
    fn log(name: &str) -> Vec<Column> {
        let own = class(name);
        let cells = |value: fn(f64) -> f64| {
            (0..4000).map(|row| value(f64::from(row) * own.period_s)).collect::<Vec<f64>>()
        };
        let mut columns = vec![
            (Channel::VoltageCmd, cells(|_| 5.0), Origin::Commanded),
            (Channel::Current, cells(|_| 1.0), Origin::Measured),
            (Channel::Speed, cells(|time_s| time_s), Origin::Measured),
            (Channel::Angle, cells(|time_s| 10.0 * time_s), Origin::Measured),
        ];
        own.make_log(&mut columns, &mut ChaCha8Rng::seed_from_u64(1));
        columns
    }

    #[test]
    fn a_log_has_the_columns_and_the_speed_of_its_class() {
        for (name, channels) in [
            ("8 bits", vec![Channel::VoltageCmd, Channel::Current, Channel::Speed]),
            ("no current", vec![Channel::VoltageCmd, Channel::Speed]),
            ("no voltage", vec![Channel::Current, Channel::Speed]),
        ] {
            let own: Vec<Channel> = log(name).into_iter().map(|column| column.0).collect();
            assert_eq!(own, channels, "{name}");
        }
        let speeds = |name: &str| log(name).pop().unwrap().1;
        let counted = speeds("speed from counts");
        let unit = TAU / 2048.0 / 0.005;
        assert!(counted[1..].iter().all(|speed| (speed - 10.0).abs() < unit));
        assert!((counted[1..].iter().sum::<f64>() / 3999.0 - 10.0).abs() < 0.01);
        let held = speeds("speed every 20 ms");
        assert!(held[7].is_nan() && (held[8] - 0.04).abs() < 1e-12);
        let noisy = &log("coloured noise")[1].1;
        let of = |lag: usize| {
            let pairs = noisy.iter().zip(&noisy[lag..]);
            pairs.map(|(a, b)| (a - 1.0) * (b - 1.0)).sum::<f64>() / 4000.0
        };
        assert!((of(0).sqrt() - 0.03).abs() < 3e-3 && (of(3) / of(0) - 0.368).abs() < 0.1);
    }
}
