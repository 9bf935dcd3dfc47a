//! An unknown motor on the bench: a stage of the escalation as a guarded session, and the bench's own sequence fitted to
//! the motor that was found.
//!
//! ```text
//! BenchFile -> Bounds -> drivebench_identify::escalation -> Stage -> Session with slew, goals and winding limit of the stage
//! found motor + sequence -> scale -> the same sequence, reduced until the plan keeps every limit
//! ```

use serde::Serialize;

use super::bench_file::{BenchFile, cells};
use super::guard::Guard;
use super::limits::{Limits, Nameplate};
use super::plan::{Plan, Refusal, plan};
use super::session::Session;
use drivebench_identify::escalation::{Bounds, Escalation, Stage};
use drivebench_model::excitation::{self, ExcitationError};
use drivebench_model::plant::ModelError;
use drivebench_model::sample::Channel;

/// Factors of inertia, resistance and back-EMF constant within which the plan has to hold: the parameters of the found motor
/// have an uncertainty.
const MARGINS: [(f64, f64, f64); 3] = [(1.0, 1.0, 1.0), (1.05, 0.95, 0.95), (0.95, 0.95, 0.95)];

pub fn bounds(bench: &BenchFile) -> Bounds {
    let limits = bench.limits();
    Bounds {
        rated_voltage_v: bench.motor.rated_voltage_v,
        rated_current_a: bench.motor.rated_current_a,
        current_limit_a: limits.current_a,
        speed_limit_rad_s: limits.speed_rad_s,
        voltage_limit_v: limits.voltage_v,
        period_s: bench.period_s(),
    }
}

/// The identification of an unknown motor, as far as it is known before the first small step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EscalationPlan {
    /// The first stage; every later one follows from the measurements.
    pub first: Stage,
    pub duration_s: f64,
    /// Limits that hold in every stage.
    pub current_limit_a: f64,
    pub speed_limit_rad_s: f64,
    pub voltage_limit_v: f64,
    pub link_silence_s: f64,
    /// The stages that may follow, in sentences.
    pub next: Vec<String>,
}

pub fn plan_escalation(bench: &BenchFile) -> Result<Option<EscalationPlan>, ExcitationError> {
    let escalation = Escalation::new(bounds(bench));
    let Some(first) = escalation.stage() else {
        return Ok(None);
    };
    let session = excitation::Program::new(&first.segments, first.slew_v_per_s)?;
    let limits = bench.limits();
    Ok(Some(EscalationPlan {
        duration_s: session.duration_s(),
        current_limit_a: limits.current_a,
        speed_limit_rad_s: limits.speed_rad_s,
        voltage_limit_v: limits.voltage_v,
        link_silence_s: limits.link_silence_s,
        next: Escalation::outlook(),
        first: first.clone(),
    }))
}

/// A session over one stage: every limit of the bench in force, and the goals that end the stage early.
pub fn stage_session(bench: &BenchFile, stage: &Stage) -> Result<Session, ExcitationError> {
    // A slew limit of the bench file bounds that of the stage.
    let slew_v_per_s = stage.slew_v_per_s.min(bench.limits.slew_v_per_s.unwrap_or(f64::INFINITY));
    let limits = Limits { slew_v_per_s, ..bench.limits() };
    let program = excitation::Program::new(&stage.segments, slew_v_per_s)?;
    let guard = Guard::for_unknown_motor(limits, stage.winding_v, stage.back_emf_v_s_per_rad)
        .with_period(bench.period_s());
    Ok(Session::new(Box::new(program), guard).until(vec![
        (Channel::Current, stage.stop_current_a),
        (Channel::Speed, stage.stop_speed_rad_s),
    ]))
}

/// The bench with a found motor, and its changes.
#[derive(Clone, Debug, Serialize)]
pub struct Scaled {
    #[serde(skip)]
    pub bench: BenchFile,
    /// Factor of every voltage of the sequence; 1: as it stands in the bench file.
    pub factor: f64,
    pub slew_v_per_s: f64,
    pub plan: Plan,
    /// The limit that the unchanged sequence exceeds.
    pub refusal: Option<Refusal>,
}

/// Fits the bench's sequence to the found motor. `Ok(Err(refusal))`: even the smallest exceeds a limit.
pub fn scale(
    bench: &BenchFile,
    found: &Nameplate,
    drive_current_limit_a: Option<f64>,
) -> Result<Result<Scaled, Refusal>, ModelError> {
    let mut bench = bench.clone();
    bench.motor = found.into();
    let found_slew = Limits::for_motor(found, bench.link.rate_hz).slew_v_per_s;
    let given_slew = bench.limits.slew_v_per_s.unwrap_or(found_slew);
    let scaled_by = |factor: f64, slew_v_per_s: f64| -> Result<Option<Scaled>, ModelError> {
        let mut scaled = bench.clone();
        scaled.limits.slew_v_per_s = Some(slew_v_per_s);
        for volts in scaled.sequence.iter_mut().flat_map(|segment| cells(segment).volts) {
            *volts *= factor;
        }
        let Ok(mut program) = scaled.program(scaled.runs.fit) else {
            return Ok(None);
        };
        let limits = scaled.limits();
        let rate_hz = scaled.link.rate_hz;
        let mut first = None;
        for (inertia, resistance, back_emf) in MARGINS {
            let mut motor = found.clone();
            motor.inertia_kg_m2 *= inertia;
            motor.resistance_ohm *= resistance;
            motor.back_emf_v_s_per_rad *= back_emf;
            let plan = plan(&mut program, &motor, &limits, rate_hz, drive_current_limit_a)?;
            if plan.is_refused() {
                first = Some(plan);
                break;
            }
            first.get_or_insert(plan);
        }
        Ok(first.map(|plan| Scaled { bench: scaled, factor, slew_v_per_s, plan, refusal: None }))
    };
    let full = scaled_by(1.0, given_slew)?;
    let first_refusal = |scaled: &Scaled| scaled.plan.refusals.first().cloned();
    let mut refusal = full.as_ref().and_then(first_refusal);
    if let Some(full) = full.filter(|_| refusal.is_none()) {
        return Ok(Ok(full));
    }
    let unchanged = refusal.clone();
    let mut factor: f64 = 1.0;
    while factor >= 0.03 {
        // The given slew belongs to another motor; that of the found motor draws two rated currents. Where that exceeds a
        // limit, smaller voltages are reached in the same time.
        let slew = given_slew.min(found_slew);
        for slew_v_per_s in [slew, slew * factor.max(0.3)] {
            if let Some(mut scaled) = scaled_by(factor, slew_v_per_s)? {
                refusal = first_refusal(&scaled);
                if refusal.is_none() {
                    scaled.refusal = unchanged;
                    return Ok(Ok(scaled));
                }
            }
        }
        factor *= 0.9;
    }
    Ok(Err(refusal.unwrap_or(Refusal {
        segment: "sequence".to_owned(),
        quantity: "slew",
        predicted: given_slew,
        limit: found_slew,
        unit: "V/s",
    })))
}

#[cfg(test)]
mod tests;
