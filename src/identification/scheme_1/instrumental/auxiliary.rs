//! The auxiliary model: free run from the voltage, and where to start it.

use super::{Series, root_mean_square};
use crate::identification::scheme_1::inverse::{Dynamics, Form};
use crate::identification::scheme_1::recursive::Scheme1;
use crate::identification::scheme_1::rows::Reading;
use crate::numerics::statistics::{mean, variance};
use crate::plant::{Input, Model, Motor, MotorKey, Plant, Scenario, State};
use crate::sample::Channel;

/// Share of the auxiliary model's largest speed below which it counts as standing.
const DEAD_ZONE: f64 = 0.02;
/// Samples at the begin whose mean gives the speed there.
const FIRST_SAMPLES: usize = 4;
/// Strides of the rows of the first models, in samples: over a longer stride noise counts less.
const STRIDES: [usize; 6] = [1, 2, 4, 8, 16, 32];

/// A model's free run under the voltage of a series.
pub(super) struct Auxiliary {
    pub(super) readings: Vec<Reading>,
    /// Root mean square of measured less simulated speed, rad/s.
    pub(super) error_rad_s: f64,
}

impl Auxiliary {
    pub(super) fn of(series: &Series<'_>, model: &Dynamics) -> Self {
        let samples = series.voltage_v.len();
        let time = |k: usize| k as f64 * series.period_s;
        // The resistance cancels in the speed: one ohm serves.
        let motor = Motor::new("auxiliary")
            .with(MotorKey::Resistance, 1.0)
            .with(MotorKey::Inductance, model.ta_s)
            .with(MotorKey::BackEmf, model.ke)
            .with(MotorKey::Inertia, model.tm_s * model.ke * model.ke)
            .with(MotorKey::LoadTorque, (model.load_v * model.ke).max(0.0));
        let scenario = Scenario {
            name: String::new(),
            input: Input::Voltage,
            input_channel: Channel::Voltage,
            events: (1..samples)
                .map(|k| (time(k - 1), series.voltage_v[k]))
                .collect(),
            sample_time_s: (0..samples).map(time).collect(),
            current_a: Vec::new(),
            speed_rad_s: Vec::new(),
            angle: Vec::new(),
            time_half_width_s: Vec::new(),
            unknown_input: vec![],
            scored: 0..samples,
        };
        let speed = Plant::new(&Model::baseline(motor), Input::Voltage)
            .map(|mut plant| plant.simulate(&scenario, start(series, model)).speed_rad_s)
            .unwrap_or_default();
        let zone = DEAD_ZONE * speed.iter().fold(0.0, |most, w| f64::max(most, w.abs()));
        let misses: Vec<f64> = speed
            .iter()
            .zip(series.speed_rad_s)
            .map(|(simulated, measured)| measured - simulated)
            .collect();
        Self {
            readings: speed
                .iter()
                .zip(series.voltage_v)
                .map(|(&speed_rad_s, &voltage_v)| Reading {
                    voltage_v,
                    speed_rad_s,
                    direction: i8::from(speed_rad_s > zone) - i8::from(speed_rad_s < -zone),
                })
                .collect(),
            error_rad_s: root_mean_square(&misses),
        }
    }
}

/// State at the first sample: the mean speed of the first few, and the current that carries the load; at rest where the
/// noise leaves that open.
fn start(series: &Series<'_>, model: &Dynamics) -> State {
    let first: Vec<f64> = series
        .speed_rad_s
        .iter()
        .copied()
        .filter(|speed| speed.is_finite())
        .take(FIRST_SAMPLES)
        .collect();
    let speed = mean(&first);
    let noise = (variance(&first) / first.len() as f64).sqrt();
    let largest = series
        .speed_rad_s
        .iter()
        .fold(0.0, |most, w| f64::max(most, w.abs()));
    if speed.abs() > (3.0 * noise).max(DEAD_ZONE * largest) {
        State::at(model.load_v.max(0.0) * speed.signum(), speed)
    } else {
        State::default()
    }
}

/// First models from the data, the one with the smallest error of its free run first: least squares in both forms over
/// several strides, then a rough one with the static gain.
pub(super) fn first_models(
    series: &Series<'_>,
    direction: &[i8],
    given: Option<Dynamics>,
) -> Vec<Dynamics> {
    let mut models: Vec<Dynamics> = given.into_iter().collect();
    for stride in STRIDES {
        for form in [Form::Exact, Form::Printed] {
            models.extend(over_stride(series, direction, form, stride));
        }
    }
    let ke = root_mean_square(series.voltage_v) / root_mean_square(series.speed_rad_s);
    if ke.is_finite() && ke > 0.0 {
        models.push(Dynamics {
            ta_s: 2.0 * series.period_s,
            tm_s: 10.0 * series.period_s,
            ke,
            load_v: 0.0,
        });
    }
    let mut ranked: Vec<(f64, Dynamics)> = models
        .into_iter()
        .map(|model| (Auxiliary::of(series, &model).error_rad_s, model))
        .collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    ranked.into_iter().map(|(_, model)| model).collect()
}

/// Least squares on every `stride`-th sample with the mean voltage between them, all phases together.
fn over_stride(
    series: &Series<'_>,
    direction: &[i8],
    form: Form,
    stride: usize,
) -> Option<Dynamics> {
    let mut scheme = Scheme1::new(form, series.period_s * stride as f64, 1.0);
    let samples = series.voltage_v.len();
    for phase in 0..stride {
        scheme.push(f64::NAN, f64::NAN, 0);
        for k in (phase..samples).step_by(stride) {
            let voltages = &series.voltage_v[(k + 1).saturating_sub(stride)..=k];
            let mean = voltages.iter().sum::<f64>() / voltages.len() as f64;
            let sign = direction.get(k).copied().unwrap_or(0);
            scheme.push(mean, series.speed_rad_s[k], sign);
        }
    }
    scheme.dynamics().ok()
}
