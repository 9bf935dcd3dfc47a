//! The on-line schemes over a recorded run, wired as the live bench wires them.

use super::{Data, Identified, IdentifyError, Scheme, motor_alone};
use crate::kalman::{self, KnownEffects};
use crate::noise::NoiseFloor;
use crate::online::{Online, OnlineConfig};
use crate::recursive::{CurrentIntegral, Scheme2};
use drivebench_model::plant::{ActiveEffect, Input, Scenario};
use drivebench_model::sample::{Channel, ParameterEstimate, Reason, Run, RunError, Verdict};

/// Paper A's scheme 2 with the trapezoid: inertia and load torque from current and speed.
pub(super) const SCHEME_2: Scheme = Scheme {
    id: "2",
    summary: "on line, current and speed, trapezoid: inertia and load torque (torque constant known)",
    identify: |id, data| Ok(motors_own(id, data, over_run(data).scheme_2())),
};

/// Scheme 3: resistance, inductance, back-EMF, inertia and load torque from voltage, current and speed together.
pub(super) const SCHEME_3: Scheme = Scheme {
    id: "3",
    summary: "on line, voltage, current and speed: everything, as the bench shows it live",
    identify: |id, data| Ok(motors_own(id, data, over_run(data).estimates())),
};

/// Paper A's scheme 2 as printed: the left rectangle on every pair of samples.
pub(super) const RECTANGLE: Scheme = Scheme {
    id: "2-rectangle",
    summary: "scheme 2 as paper A prints it: left rectangle on every pair of samples (torque constant known)",
    identify: rectangle,
};

/// The extended Kalman filter over a recorded run.
pub(super) const EKF: Scheme = Scheme {
    id: "ekf",
    summary: "on line, extended Kalman filter over state and parameters; then again over the whole run",
    identify: ekf,
};

fn over_run(data: &Data<'_>) -> Online {
    let sensors = data.scenario.sensors;
    let mut online = Online::new(OnlineConfig { sensors, ..OnlineConfig::from_model(data.model) });
    for sample in data.run_as_used().samples() {
        online.push(&sample);
    }
    online
}

fn motors_own(id: &'static str, data: &Data<'_>, found: Vec<ParameterEstimate>) -> Identified {
    Identified::new(id, data.model, found).leaving_out(data.model, motor_alone)
}

fn ekf(id: &'static str, data: &Data<'_>) -> Result<Identified, IdentifyError> {
    if data.scenario.input != Input::Voltage {
        let help = "use --scheme weak-form, or map a voltage with --map voltage_v=HEADER";
        return Err(data.refused(id, "it has no voltage to predict the current from", help));
    }
    let found = kalman::identify(data.model, &data.run_as_used());
    let identified = Identified::new(id, data.model, found.estimates());
    let (_, left_out) = KnownEffects::of(data.model);
    let why = |active: &ActiveEffect| {
        left_out.contains(&active.id()).then_some(
            "the filter subtracts effects whose values are all given, and that depend on voltage, current and speed alone",
        )
    };
    Ok(identified.with_note(found.summary()).leaving_out(data.model, why))
}

fn rectangle(id: &'static str, data: &Data<'_>) -> Result<Identified, IdentifyError> {
    let motor = &data.model.motor;
    let Some(torque_constant) = motor.torque_constant() else {
        let help = "give torque_n_m_per_a or back_emf_v_s_per_rad in the model file";
        return Err(data.refused(id, "the torque constant is not known", help));
    };
    let floor = NoiseFloor::from_standstill(data.scenario).map(|floor| floor.speed_rad_s);
    let by = |integral: CurrentIntegral| {
        // No forgetting over a recorded run: every row counts alike.
        let mut scheme = Scheme2::new(integral, 1.0, 0.0);
        if let Some(noise_rad_s) = floor.filter(|noise| noise.is_finite()) {
            scheme.set_speed_noise(noise_rad_s);
        }
        for sample in data.run.samples() {
            let measured = [Channel::Current, Channel::Speed].map(|channel| sample.get(channel));
            if let [Some(current), Some(speed)] = measured {
                scheme.push(sample.time_s, current, speed);
            }
        }
        scheme.estimates(Some((torque_constant, 0.0)))
    };
    let mut parameters = by(CurrentIntegral::Rectangle);
    for (parameter, better) in parameters.iter_mut().zip(by(CurrentIntegral::Trapezoid)) {
        doubt(parameter, &better);
    }
    let found = Identified::new(id, data.model, parameters).with_note(
        "left rectangle as printed: it lags the current by half a period; scheme 2 takes the trapezoid",
    );
    Ok(found.leaving_out(data.model, motor_alone))
}

/// A rectangle that is 2 % off the trapezoid is not called settled.
fn doubt(parameter: &mut ParameterEstimate, better: &ParameterEstimate) {
    let (Some(value), Some(other)) = (parameter.value, better.value) else { return };
    let off = value / other - 1.0;
    if off.abs() <= 0.02 {
        return;
    }
    let off = format!(
        "the left rectangle is {:+.1} % off the trapezoid ({other:.4e} {}) on the same rows",
        100.0 * off,
        parameter.unit
    );
    if parameter.verdict == Verdict::Settled {
        parameter.verdict = Verdict::Searching;
    }
    parameter.code = Some(Reason::MethodBiased);
    parameter.reason = Some(match parameter.reason.take() {
        Some(reason) => format!("{off}; {reason}"),
        None => off,
    });
}

/// The record with the estimates of its lost voltages as rows of their own, for schemes that take it row by row; an error
/// where they do not fit between the others.
pub(super) fn with_lost_voltages(run: &Run, scenario: &Scenario) -> Result<Run, RunError> {
    let (times, holes) = (run.time_s(), &scenario.unknown_input);
    let is_new =
        |time_s: f64| !times[times.partition_point(|time| *time < time_s)..].starts_with(&[time_s]);
    let mut rows: Vec<(f64, Option<usize>)> = times.iter().copied().zip((0..).map(Some)).collect();
    rows.extend(holes.iter().map(|hole| (hole.from_s, None)).filter(|row| is_new(row.0)));
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    let place = |time_s: f64| rows.partition_point(|row| row.0 < time_s);
    let mut whole = Run::new(run.name.clone(), rows.iter().map(|row| row.0).collect())?;
    (whole.rows_dropped, whole.notes) = (run.rows_dropped, run.notes.clone());
    for channel in Channel::ALL {
        let Some(column) = run.column(channel) else { continue };
        let mut cells: Vec<f64> =
            (rows.iter()).map(|(_, row)| row.map_or(f64::NAN, |row| column[row])).collect();
        if channel == scenario.input_channel {
            for hole in holes {
                cells[place(hole.from_s)] = hole.mean;
            }
        }
        whole.set_column(channel, cells, run.origin(channel))?;
        if let Some(side) = run.side(channel) {
            whole.set_side(channel, side);
        }
    }
    let begun_again = holes.iter().filter(|hole| hole.restart.is_some());
    let mut limited: Vec<usize> = (run.limited_rows().iter().map(|row| place(times[*row])))
        .chain(begun_again.map(|hole| place(hole.to_s)))
        .collect();
    limited.sort_unstable();
    limited.dedup();
    whole.set_limited_rows(limited);
    Ok(whole)
}
