//! The true machine against the host's catalogue: the same effect, the same values, another form.

use firmware_protocol::{Control, DriveCommand};

use super::SoftDrive;
use crate::EmulatorConfig;
use crate::truth::effect::HiddenEffect;
use crate::truth::{NoiseConfig, QuantisationConfig};
use drivebench_identify::noise::{FloorSource, NoiseFloor};
use drivebench_identify::output_error;
use drivebench_model::plant::{Input, Model, Motor, Plant, Scenario, State};
use drivebench_model::sample::{Channel, Origin, Run};

/// Noise of the usual sensors: it weighs current against speed.
const CURRENT_A: f64 = 0.03;
const SPEED_RAD_S: f64 = 0.15;

/// Standstill, steps of both signs under a slew limit with a dither on top, and a slow passage through zero.
fn voltage(time_s: f64) -> f64 {
    const KNOTS: [(f64, f64); 15] = [
        (0.0, 0.0),
        (0.3, 0.0),
        (0.5, 40.0),
        (0.9, 40.0),
        (1.2, 100.0),
        (1.7, 100.0),
        (2.3, -30.0),
        (2.7, -30.0),
        (3.05, -100.0),
        (3.5, -100.0),
        (4.0, 12.0),
        (4.5, -8.0),
        (5.0, 8.0),
        (5.4, 70.0),
        (6.0, 0.0),
    ];
    let at = KNOTS.partition_point(|knot| knot.0 <= time_s).clamp(1, KNOTS.len() - 1);
    let ((t0, u0), (t1, u1)) = (KNOTS[at - 1], KNOTS[at]);
    let base = u0 + (u1 - u0) * ((time_s - t0) / (t1 - t0)).clamp(0.0, 1.0);
    let clock = (time_s / 0.03).floor();
    let dither = if time_s < 0.3 {
        0.0
    } else if (clock * 0.618_034).fract() < 0.5 {
        5.0
    } else {
        -5.0
    };
    base + dither
}

fn recorded(hidden: &[HiddenEffect]) -> Scenario {
    let mut config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    config.tolerance = 0.0;
    config.noise = NoiseConfig::default();
    config.quantisation = QuantisationConfig::default();
    config.limits.current_limit_a = 40.0;
    config.hidden = hidden.to_vec();
    let mut drive = SoftDrive::new(&config, 1);
    let mut rows: [Vec<f64>; 5] = std::array::from_fn(|_| Vec::new());
    for k in 0..6000_u16 {
        let time_s = f64::from(k) * 1e-3;
        drive.advance_to(time_s);
        drive.command(DriveCommand::new(k, Control::Voltage(voltage(time_s))));
        let t = drive.telemetry();
        let row = [drive.time_s(), t.voltage_cmd_v, t.current_a, t.speed_rad_s, t.angle_rad];
        for (column, value) in rows.iter_mut().zip(row) {
            column.push(value);
        }
    }
    let [time_s, volts, current, speed, angle] = rows;
    let mut run = Run::new("truth", time_s).unwrap();
    for (channel, values, origin) in [
        (Channel::VoltageCmd, volts, Origin::Commanded),
        (Channel::Current, current, Origin::Measured),
        (Channel::Speed, speed, Origin::Measured),
        (Channel::Angle, angle, Origin::Measured),
    ] {
        run.set_column(channel, values, origin).unwrap();
    }
    Scenario::from_run(&run).unwrap()
}

/// Mean square of the errors in units of the noise.
fn error(model: &Model, scenario: &Scenario) -> f64 {
    let out = Plant::new(model, Input::Voltage).unwrap().simulate(scenario, State::default());
    let square = |measured: &[f64], simulated: &[f64], scale: f64| {
        let sum: f64 = measured.iter().zip(simulated).map(|(m, s)| ((m - s) / scale).powi(2)).sum();
        sum / measured.len() as f64
    };
    square(&scenario.current_a, &out.current_a, CURRENT_A)
        + square(&scenario.speed_rad_s, &out.speed_rad_s, SPEED_RAD_S)
}

#[test]
fn the_hosts_form_with_true_values_explains_each_effect() {
    let baseline = Model::baseline(Motor::zk_22fc());
    let mut misfits = Vec::new();
    let effects = HiddenEffect::one_of_each().into_iter();
    for effect in effects.filter(|effect| !effect.is_foreign()) {
        let id = effect.id();
        let mut model = baseline.with_effect(id).unwrap();
        for (at, spec) in model.effects[0].effect.parameters().iter().enumerate() {
            model.effects[0].values[at] = Some(effect.value(spec.key).unwrap());
        }
        let scenario = recorded(&[effect]);
        if id == "backlash" {
            // A small difference moves the instants at which the flanks meet: only a fit finds the motion again.
            let noise = NoiseFloor {
                current_a: CURRENT_A,
                speed_rad_s: SPEED_RAD_S,
                source: FloorSource::Standstill,
                samples: 300,
                memory: [0.0; 2],
            };
            model = output_error::fit(&[model], &scenario, &noise).unwrap().model;
        }
        let (with, without) = (error(&model, &scenario), error(&baseline, &scenario));
        // Share of an effect's work that its form may leave to the host's form with the true values, before any fit (for
        // backlash: after one).
        if with > 0.05 * without {
            misfits.push((id, with / without));
        }
    }
    assert!(misfits.is_empty(), "{misfits:?}");
}
