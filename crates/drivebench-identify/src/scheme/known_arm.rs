//! Voltage and angle with a known weight on an arm, which gives the scale of the torques: no current and no speed is needed.
//!
//! The armature circuit is quicker than an arm, so that the current can be eliminated (quasi-static winding):
//!
//! ```text
//! u = Ke w + (R/Kt) (J w' + Mc sgn(w) + A sin(q - q0)) + m |u - Ke w| sgn(w)
//! ```
//!
//! This is a balance of torques in volts: the weak form fits its coefficients from `u` as the torque and the difference quotient of
//! the angle as the speed. The known amplitude `A` of the weight turns volts into torques. With `Kt = Ke`.

use super::{Data, Identified, IdentifyError, Scheme};
use crate::balance::has_both_power_flows;
use crate::speed_from_angle::slopes;
use crate::verdict::{judge, unknown};
use crate::weak_form;
use drivebench_model::plant::effect::TermKind;
use drivebench_model::plant::{
    ActiveEffect, Input, Model, ModelError, Motor, MotorKey, Scenario, Slot,
};
use drivebench_model::sample::{ParameterEstimate, Reason};
use drivebench_model::signal;

pub(super) const KNOWN_ARM: Scheme = Scheme {
    id: "known-arm",
    summary: "voltage and angle alone, with a weight of known torque on the arm (--known-arm)",
    identify,
};

/// The drag in volts per speed is the back-EMF constant. Of the weight the model knows the amplitude; where it hangs down is found.
/// Without the friction that grows with the load, as in the gear of a servo, a resistance is found a third too large.
const DRAG: TermKind = TermKind::Drag;
const WEIGHT: TermKind = TermKind::Weight;
const OF_LOAD: TermKind = TermKind::FrictionOfLoad;

/// Standard deviations from which on the friction that grows with the load is there.
const SIGNIFICANT_SIGMAS: f64 = 2.0;

fn identify(id: &'static str, data: &Data<'_>) -> Result<Identified, IdentifyError> {
    let (model, scenario) = (data.model, data.scenario);
    let weight = model.effects.iter().find(|active| active.id() == WEIGHT.id());
    let amplitude_n_m = weight.map_or(0.0, |own| {
        own.values.iter().map(|value| value.unwrap_or(0.0).powi(2)).sum::<f64>().sqrt()
    });
    if amplitude_n_m <= 0.0 {
        let reason = "the model has no weight of known torque";
        let help = "give --known-arm KG,M: the mass and its distance from the shaft";
        return Err(data.refused(id, reason, help));
    }
    if scenario.input != Input::Voltage || scenario.angle.len() < 5 {
        let reason = "it needs a voltage and a measured angle";
        return Err(data.refused(id, reason, "map both columns, as voltage_v=u,angle_rad=q"));
    }
    let run = in_volts(scenario);
    let plain = balance(&[DRAG, WEIGHT], &run)?;
    let ke = back_emf(&plain);
    let rows = run.events.iter().zip(&run.speed_rad_s);
    let brakes = has_both_power_flows(rows.map(|(event, speed)| (event.1 - ke * speed) * speed));
    let with_gear = if brakes { balance(&[DRAG, WEIGHT, OF_LOAD], &run)? } else { Vec::new() };
    let ratio = of(&with_gear, &key(OF_LOAD, 0));
    let is_geared = ratio.is_some_and(|[ratio, std]| ratio > SIGNIFICANT_SIGMAS * std);
    // A gear that locks itself is no answer: both sides of the balance are then the drive.
    let most = OF_LOAD.effect().parameters()[0].max;
    let is_open =
        !brakes || ratio.is_some_and(|[ratio, std]| ratio + SIGNIFICANT_SIGMAS * std > most);
    let found = if is_geared && !is_open { &with_gear } else { &plain };
    Ok(in_torques(id, model, scenario, found, amplitude_n_m, is_open))
}

fn key(kind: TermKind, parameter: usize) -> String {
    format!("{}.{}", kind.id(), kind.effect().parameters()[parameter].key)
}

/// Value and standard deviation of a coefficient that was found.
fn of(found: &[ParameterEstimate], key: &str) -> Option<[f64; 2]> {
    let own = found.iter().find(|own| own.key == key)?;
    Some([own.value?, own.std?])
}

fn back_emf(found: &[ParameterEstimate]) -> f64 {
    of(found, &key(DRAG, 0)).map_or(0.0, |own| own[0])
}

/// The run with the voltage as its torque and the difference quotient of the angle as its speed.
fn in_volts(scenario: &Scenario) -> Scenario {
    let volts = scenario.held_means();
    let times = &scenario.sample_time_s;
    let angles = scenario.angle.iter().zip(slopes(&scenario.angle, 1));
    let speeds: Vec<(f64, f64)> = angles.map(|(point, speed)| (point.0, speed)).collect();
    let mut run = scenario.clone();
    run.input = Input::Torque;
    // None where the voltage is not known.
    let is_lost = |time_s: f64| {
        scenario.unknown_input.iter().any(|own| (own.from_s..own.to_s).contains(&time_s))
    };
    let speed =
        |time_s: &f64| if is_lost(*time_s) { f64::NAN } else { signal::line(&speeds, *time_s) };
    run.speed_rad_s = times.iter().map(speed).collect();
    run.events = times.iter().copied().zip(volts).collect();
    run.find_scales();
    run
}

/// Coefficients of the balance in volts; the torque that passes the gear follows from the back-EMF constant.
fn balance(effects: &[TermKind], run: &Scenario) -> Result<Vec<ParameterEstimate>, ModelError> {
    let mut motor = Motor::new("volts");
    motor.set(MotorKey::TorqueConstant, 1.0);
    let mut model = Model::baseline(motor);
    for kind in effects {
        model = model.with_effect(kind.id())?;
    }
    let mut run = run.clone();
    let mut found = Vec::new();
    // Each pass leaves a tenth of the error.
    for _ in 0..if effects.contains(&OF_LOAD) { 12 } else { 1 } {
        let own = back_emf(&found);
        let rows = run.events.iter().zip(&run.speed_rad_s);
        run.current_a = rows.map(|(event, speed)| event.1 - own * speed).collect();
        found = weak_form::fit(&model, &run).into_iter().flat_map(|own| own.parameters).collect();
    }
    Ok(found)
}

/// The motor by the amplitude of its weight.
fn in_torques(
    id: &'static str,
    model: &Model,
    scenario: &Scenario,
    found: &[ParameterEstimate],
    amplitude_n_m: f64,
    is_open: bool,
) -> Identified {
    let waves = [0, 1].map(|parameter| of(found, &key(WEIGHT, parameter)));
    let scale = waves[0].zip(waves[1]).map(|(sin, cos)| {
        let volts = sin[0].hypot(cos[0]);
        let std = (sin[0] * sin[1]).hypot(cos[0] * cos[1]) / volts;
        ([volts / amplitude_n_m, std / volts], [sin[0] / volts, cos[0] / volts])
    });
    // Else the arm has not moved through angles at which its weight changes.
    let scale = scale.filter(|([_, share], _)| *share < 0.2);
    let back_emf = of(found, &key(DRAG, 0));
    // Value and relative deviation of a product or a ratio.
    let of_volts = |own: Option<[f64; 2]>, power: i32| {
        let ([value, std], ([ohm_per_kt, share], _)) = own.zip(scale)?;
        let out = value * ohm_per_kt.powi(power);
        Some((out, (out * share).hypot(std * ohm_per_kt.powi(power))))
    };
    let volts = |key: MotorKey| of(found, key.key());
    let mut model = model.clone();
    let mut parameters = Vec::new();
    for key in [MotorKey::Resistance, MotorKey::BackEmf, MotorKey::Inertia, MotorKey::LoadTorque] {
        let value = match key {
            MotorKey::Resistance => of_volts(back_emf, 1),
            MotorKey::BackEmf => back_emf.map(|[value, std]| (value, std)),
            _ => of_volts(volts(key), -1),
        };
        parameters.push(value.map_or_else(
            || {
                let reason =
                    "the arm hardly moves, or never through an angle at which its weight changes";
                unknown(key, Reason::NotExcited, reason)
            },
            |(value, std)| judge(&Slot::Motor(key), value, Some(std), scenario.mean_period_s()),
        ));
        if let Some(own) = parameters.last_mut().filter(|_| is_open && key != MotorKey::BackEmf) {
            own.unsettle(
                Reason::NotExcited,
                "the load hardly drives the motor: friction that grows with the load is not distinguished from it, and R is then too \
                 large",
            );
        }
    }
    let reason = "an arm is slower than the armature circuit: it is taken as settled";
    parameters.insert(1, unknown(MotorKey::Inductance, Reason::SampledTooSlowly, reason));
    if let Some((_, wave)) = scale {
        let sizes = wave.map(|share| amplitude_n_m * share);
        model.effects.retain(|active| active.id() != WEIGHT.id());
        model.effects.push(ActiveEffect::with(WEIGHT.effect(), &sizes));
        let fixed = sizes.iter().enumerate().map(|(parameter, size)| {
            ParameterEstimate::fixed(key(WEIGHT, parameter), "N.m", *size)
        });
        parameters.extend(fixed);
    }
    if let Some(ratio) = found.iter().find(|own| own.key == key(OF_LOAD, 0)) {
        model.effects.retain(|active| active.id() != OF_LOAD.id());
        model.effects.push(ActiveEffect::with(OF_LOAD.effect(), &[ratio.value.unwrap_or(0.0)]));
        parameters.push(ratio.clone());
    }
    let why_not = |active: &ActiveEffect| {
        let is_term = [WEIGHT, OF_LOAD].map(TermKind::id).contains(&active.id());
        (!is_term)
            .then_some("this scheme has the weight and the friction that grows with the load only")
    };
    let found = Identified::new(id, &model, parameters).leaving_out(&model, why_not);
    found.with_note(
        "the weight gives the scale of the torques, with Kt = Ke; a viscous friction B counts into Ke as B R/Kt: voltage, angle and \
         a weight do not distinguish them",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::speed_from_angle;
    use crate::testing::{assert_near, identify, run_of};
    use drivebench_model::sample::{Channel, Run, Verdict};

    /// R, Ke, J, Mc.
    const MOTOR: [f64; 4] = [3.0, 0.4, 0.007, 0.03];
    const WEIGHT_N_M: f64 = 0.48;

    /// An arm behind a gear that loses the share `lost` of the load, which a proportional controller moves to `goal`: explicit Euler
    /// steps of 20 us with stiction, rows of 5 ms, an angle of 12 bits.
    fn servo(goal: impl Fn(f64) -> f64, lost: f64) -> Run {
        let [ohm, ke, inertia, coulomb] = MOTOR;
        let (mut angle, mut speed, mut volts) = (0.0_f64, 0.0_f64, 0.0);
        let mut rows = [vec![], vec![], vec![]];
        let step_s = 2e-5;
        for step in 0..500_000_u32 {
            let time_s = f64::from(step) * step_s;
            if step % 250 == 0 {
                volts = (20.0 * (goal(time_s) - angle)).clamp(-7.0, 7.0);
                let quantum = std::f64::consts::TAU / 4096.0;
                let row = [time_s, volts, (angle / quantum).round() * quantum];
                rows.iter_mut().zip(row).for_each(|(column, cell)| column.push(cell));
            }
            let drive = ke * (volts - ke * speed) / ohm;
            let torque = drive - WEIGHT_N_M * angle.sin();
            let friction = coulomb + lost * drive.abs();
            let direction = if speed == 0.0 { torque.signum() } else { speed.signum() };
            let next = speed + step_s * (torque - friction * direction) / inertia;
            let sticks = torque.abs() < friction && next * direction <= 0.0;
            speed = if sticks || speed == 0.0 && torque.abs() < friction { 0.0 } else { next };
            angle += step_s * speed;
        }
        let [times, volts, angles] = rows;
        let run = run_of(times, [(Channel::Voltage, volts), (Channel::Angle, angles)]);
        speed_from_angle::complete(&run).unwrap()
    }

    fn swings(time_s: f64) -> f64 {
        1.5 * (2.1 * time_s).sin() + 0.8 * (6.3 * time_s).sin().signum()
    }

    fn arm() -> Model {
        let mut model = Model::baseline(Motor::new("?"));
        model.effects.push(ActiveEffect::with(WEIGHT.effect(), &[WEIGHT_N_M, 0.0]));
        model
    }

    #[test]
    fn a_weight_gives_the_motor_behind_a_gear() {
        for lost in [0.0, 0.25] {
            let found = identify("known-arm", &servo(swings, lost), &arm()).unwrap();
            let keys = [MotorKey::Resistance, MotorKey::BackEmf, MotorKey::Inertia];
            for (key, truth) in keys.into_iter().zip(MOTOR) {
                assert_near(found.model.motor.get(key).unwrap(), truth, 0.05);
            }
            let gear = found.model.effects.iter().find(|own| own.id() == OF_LOAD.id());
            let ratio = gear.map_or(0.0, |own| own.values[0].unwrap());
            assert!((ratio - lost).abs() < 0.03, "{ratio}");
        }
    }

    #[test]
    fn what_a_run_does_not_show_is_open() {
        // It only lifts.
        let lifts = identify("known-arm", &servo(|time_s| 0.12 * time_s, 0.25), &arm()).unwrap();
        let of_torque = lifts.parameters.iter().filter(|own| own.key != MotorKey::BackEmf.key());
        assert!(of_torque.clone().all(|own| own.verdict != Verdict::Settled), "{lifts:?}");
        let without_weight = Model::baseline(Motor::new("?"));
        assert!(identify("known-arm", &servo(swings, 0.0), &without_weight).is_err());
    }
}
