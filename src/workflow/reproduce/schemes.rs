//! One emulated record, and what each scheme of the catalogue makes of it.
//!
//! A scheme is given what the paper gives it and nothing more: schemes 1 the resistance, schemes 2 the torque constant,
//! every other one nothing at all.

use rand::Rng as _;
use serde::Serialize;

use super::LEVELS_V;
use super::machine::{driven, simulated, stamps, value};
use super::signal::{SignalToNoise, random, white, with_noise};
use crate::identification::scheme::{CATALOGUE, Data, Scheme};
use crate::numerics::count::whole;
use crate::plant::{Model, Motor, MotorKey, Scenario, State};
use crate::sample::{Channel, Origin, ParameterEstimate, Run};

/// Error of each parameter, per cent of the truth; `None` where the scheme does not give it or the data do not carry it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Errors {
    pub electrical_time_constant: Option<f64>,
    pub mechanical_time_constant: Option<f64>,
    pub back_emf: Option<f64>,
    pub inertia: Option<f64>,
    pub load_torque: Option<f64>,
}

impl Errors {
    pub const COUNT: usize = 5;

    pub const fn to_array(self) -> [Option<f64>; Self::COUNT] {
        [
            self.electrical_time_constant,
            self.mechanical_time_constant,
            self.back_emf,
            self.inertia,
            self.load_torque,
        ]
    }

    /// Of what was found, in the order of [`Errors::to_array`].
    pub(super) fn between(found: [Option<f64>; Self::COUNT], truth: &Motor) -> Self {
        let truth = figures(truth);
        let error = |which: usize| Some(100.0 * (found[which]? / truth[which]? - 1.0));
        Self::from_array(std::array::from_fn(error))
    }

    pub(super) const fn from_array(values: [Option<f64>; Self::COUNT]) -> Self {
        let [
            electrical_time_constant,
            mechanical_time_constant,
            back_emf,
            inertia,
            load_torque,
        ] = values;
        Self {
            electrical_time_constant,
            mechanical_time_constant,
            back_emf,
            inertia,
            load_torque,
        }
    }
}

/// Names of the errors in the order of [`Errors::to_array`].
pub const NAMES: [&str; Errors::COUNT] = ["Ta", "TM", "Ke", "J", "Mc"];

/// What all schemes see.
pub(super) struct Record {
    motor: Motor,
    run: Run,
    scenario: Scenario,
}

/// Samples at rest before the first step: enough to tell the noise.
const REST_SAMPLES: usize = 30;

/// From rest under two voltages in turn, each held between Ta and 3 TM; noise on current and speed where `noise` says.
pub(super) fn record(
    motor: &Motor,
    period_s: f64,
    samples: usize,
    seed: u64,
    noise: Option<SignalToNoise>,
) -> Record {
    let time = |time_s: Option<f64>| time_s.expect("the motors of the figures are complete");
    let (ta_s, tm_s) = (
        time(motor.electrical_time_constant_s()),
        time(motor.mechanical_time_constant_s()),
    );
    let mut rng = random(seed, 1);
    let mut volts = vec![0.0; REST_SAMPLES];
    let mut high = true;
    // Between the time constants, but never the same length again and again: that would excite one frequency only.
    let shortest = whole(ta_s / period_s).max(1);
    let longest = whole(3.0 * tm_s / period_s).max(shortest + 3);
    while volts.len() < samples {
        let length = rng
            .random_range(shortest..=longest)
            .min(samples - volts.len());
        volts.extend(std::iter::repeat_n(LEVELS_V[usize::from(high)], length));
        high = !high;
    }
    let times = stamps(period_s, samples);
    let events = times.iter().copied().zip(volts.iter().copied()).collect();
    let name = format!("period {period_s} s, seed {seed}");
    let mut scenario = driven(name, Channel::VoltageCmd, events, times.clone());
    let clean = simulated(motor, &scenario, State::default());
    let sensor = |clean: Vec<f64>, purpose: u64| match noise {
        None => clean,
        Some(ratio) => {
            let deviation = ratio.noise_beside(&clean[REST_SAMPLES..]);
            let noise = white(&mut random(seed, purpose), samples);
            with_noise(&clean, &noise, deviation)
        }
    };
    scenario.current_a = sensor(clean.current_a, 2);
    scenario.speed_rad_s = sensor(clean.speed_rad_s, 3);
    let mut run = Run::new(scenario.name.clone(), times).expect("stamps increase");
    let (current, speed) = (scenario.current_a.clone(), scenario.speed_rad_s.clone());
    for (channel, cells, origin) in [
        (Channel::VoltageCmd, volts, Origin::Commanded),
        (Channel::Current, current, Origin::Measured),
        (Channel::Speed, speed, Origin::Measured),
    ] {
        run.set_column(channel, cells, origin)
            .expect("every column has one cell per stamp");
    }
    Record {
        motor: motor.clone(),
        run,
        scenario,
    }
}

/// The schemes that take part: all that read these records.
pub(super) fn taking_part() -> impl Iterator<Item = &'static Scheme> {
    // Inverse dynamics filters, which takes many samples per time constant; a step response takes one long step.
    CATALOGUE
        .iter()
        .copied()
        .filter(|scheme| !["inverse-dynamics", "step-response"].contains(&scheme.id()))
}

/// What the paper lets a scheme know.
fn known(scheme: &Scheme, truth: &Motor) -> Model {
    let mut motor = Motor::new("sought");
    let mut fixed = Vec::new();
    let mut give = |key: MotorKey, value: f64| {
        motor.set(key, value);
        fixed.push(key.key().to_owned());
    };
    match scheme.id().split('-').next() {
        Some("1") => give(MotorKey::Resistance, value(truth, MotorKey::Resistance)),
        Some("2") => give(MotorKey::TorqueConstant, value(truth, MotorKey::BackEmf)),
        _ => {}
    }
    let mut model = Model::baseline(motor);
    model.fixed = fixed;
    model
}

/// What `scheme` finds in `record`.
pub(super) fn errors(scheme: &Scheme, record: &Record) -> Errors {
    let model = known(scheme, &record.motor);
    let data = Data {
        run: &record.run,
        scenario: &record.scenario,
        model: &model,
    };
    match scheme.identify(&data) {
        Ok(found) => errors_of(&found.parameters, &model.motor, &record.motor),
        Err(_) => Errors::default(),
    }
}

fn errors_of(found: &[ParameterEstimate], known: &Motor, truth: &Motor) -> Errors {
    let told = |key: MotorKey| {
        found
            .iter()
            .find(|parameter| parameter.key == key.key())
            .and_then(|parameter| parameter.value)
            .or_else(|| known.get(key))
    };
    let mut all = Motor::new("found");
    for key in MotorKey::ALL {
        if let Some(value) = told(key) {
            all.set(key, value);
        }
    }
    Errors::between(figures(&all), truth)
}

/// Ta, TM, Ke, J and Mc of a motor, as far as it has them.
fn figures(motor: &Motor) -> [Option<f64>; Errors::COUNT] {
    [
        motor.electrical_time_constant_s(),
        motor.mechanical_time_constant_s(),
        motor.get(MotorKey::BackEmf),
        motor.get(MotorKey::Inertia),
        motor.get(MotorKey::LoadTorque),
    ]
}
