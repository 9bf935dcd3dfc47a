//! The sequence of a new bench file: the rich excitation, as large as the limits allow, and a reference for `speed`.

use super::limits::set_point;
use super::{InitError, InitRequest, InitUse, Reasoned};
use crate::bench_file::{BenchFile, Cells, SPEED_ENDS_S, cells};
use crate::currents::{CurrentsSection, TURNS};
use crate::escalate::scale;
use crate::limits::{Nameplate, short};
use crate::plan::{Plan, Refusal, plan_run};
use crate::speed::{ControllerKind, ReferencePart, SpeedSection};
use drivebench_link::register_map::Quantity;
use drivebench_model::excitation::{self, Dither, Prbs, Ramp, Segment, Standstill, Steps};

/// Least periods of a level: a shorter one is not sampled well enough.
const LEVEL_PERIODS: f64 = 10.0;
/// Levels of the reference, as shares of the reachable speed.
const LEVELS: [f64; 4] = [0.3, 0.6, 0.3, 0.0];

pub(super) struct Fitted {
    pub(super) reasons: Vec<Reasoned>,
    pub(super) remarks: Vec<String>,
    pub(super) plan: Option<Plan>,
}

pub(super) fn fit(
    bench: &mut BenchFile,
    request: &InitRequest<'_>,
    purpose: InitUse,
) -> Result<Fitted, InitError> {
    let mut fitted = Fitted { reasons: Vec::new(), remarks: Vec::new(), plan: None };
    let nameplate = bench.nameplate();
    match purpose {
        InitUse::SpeedLoop => {
            bench.sequence = vec![Segment::Standstill(Standstill { seconds: 1.0 })];
        }
        InitUse::Voltages => voltages(bench, request, nameplate.as_ref(), &mut fitted)?,
        InitUse::Currents => currents(bench, request, nameplate.as_ref(), &mut fitted)?,
    }
    if let Some(nameplate) = &nameplate {
        let speed = speed_section(bench, request, nameplate, purpose);
        let hold_s = match speed.reference.first() {
            Some(ReferencePart::Steps { hold_s, .. }) => *hold_s,
            _ => 2.0,
        };
        let why = format!("{LEVELS:?} of what the limits reach; a level lasts {hold_s} s");
        fitted.reasons.push(Reasoned::new("speed.reference", None, why));
        bench.speed = Some(speed);
    } else {
        fitted.remarks.push(
            "the motor is not known: `run` finds it from small steps first and makes the sequence fit it; `speed` needs it known"
                .to_owned(),
        );
    }
    let sequence_s = match &bench.currents {
        // The sequence that is fitted to an unknown motor takes a minute.
        Some(currents) if nameplate.is_none() => currents.duration_s().max(70.0),
        Some(currents) => currents.duration_s(),
        None => bench.program(bench.runs.fit)?.duration_s(),
    };
    let reference_s = bench
        .speed
        .as_ref()
        .map_or(0.0, |speed| speed.reference.iter().map(length_s).sum::<f64>() + SPEED_ENDS_S);
    let time_s = (sequence_s.max(reference_s) * 1.25 / 5.0).ceil() * 5.0;
    bench.limits.time_s = Some(time_s);
    fitted.reasons.push(Reasoned::new("limits.time_s", Some(time_s), format!(
            "the longer of sequence ({sequence_s:.1} s) and reference with its ends ({reference_s:.1} s), and a quarter of it as room"
        )));
    Ok(fitted)
}

fn length_s(part: &ReferencePart) -> f64 {
    match part {
        ReferencePart::Steps { levels_rad_s, hold_s } => levels_rad_s.len() as f64 * hold_s,
        _ => 0.0,
    }
}

/// The sequence, and the slew under which its current stays in bounds.
fn voltages(
    bench: &mut BenchFile,
    request: &InitRequest<'_>,
    nameplate: Option<&Nameplate>,
    fitted: &mut Fitted,
) -> Result<(), InitError> {
    let limits = bench.limits();
    let voltage_v = 0.85 * limits.voltage_v;
    let period_s = bench.period_s();
    let one_way = set_point(request, Quantity::Voltage).is_some_and(|(low, _)| low >= 0.0);
    let Some(nameplate) = nameplate else {
        bench.sequence = paced(sequence(voltage_v, limits.slew_v_per_s, one_way), period_s);
        fitted.reasons.push(Reasoned::new("limits.slew_v_per_s", None, "follows from the motor when it has been found; until then each stage has its own, smaller one"));
        return Ok(());
    };
    let load_a = nameplate.load_torque_n_m / nameplate.back_emf_v_s_per_rad;
    // Acceleration and load together draw 70 % of the limit: a motor 15 % off its nameplate stays below.
    let accelerating_a = (0.7 * limits.current_a - load_a).max(0.2 * limits.current_a);
    let back_emf = nameplate.back_emf_v_s_per_rad;
    let slew_v_per_s = short(accelerating_a * back_emf * back_emf / nameplate.inertia_kg_m2);
    bench.sequence = paced(sequence(voltage_v, slew_v_per_s, one_way), period_s);
    bench.limits.slew_v_per_s = Some(slew_v_per_s);
    // While the sequence is fitted its length does not matter.
    bench.limits.time_s = Some(3600.0);
    let scaled = scale(bench, nameplate, request.readback.current_limit_a)
        .map_err(|error| wrong_nameplate(&error))?
        .map_err(|refusal| too_much("even the smallest sequence", &refusal))?;
    bench.sequence = scaled.bench.sequence.into_iter().map(rounded).collect();
    bench.limits.slew_v_per_s = Some(short(scaled.slew_v_per_s));
    fitted.plan = Some(planned(bench, request, nameplate)?);
    fitted.reasons.push(Reasoned::new("limits.slew_v_per_s", bench.limits.slew_v_per_s, format!(
            "while the voltage rises at s, the back-EMF lags by s R J/Ke^2: with the load of {load_a:.2} A that draws {:.1} A, {:.0} % of limits.current_a",
            load_a + accelerating_a,
            100.0 * (load_a + accelerating_a) / limits.current_a
        )));
    if scaled.factor < 1.0 {
        let why = scaled.refusal.map(|refusal| refusal.to_string());
        fitted.remarks.push(format!(
            "the sequence was made smaller ({:.0} % of the voltages): {}",
            100.0 * scaled.factor,
            why.as_deref().unwrap_or("limits")
        ));
    }
    Ok(())
}

/// Levels of current that accelerate beyond the friction, and the speeds at which they reverse; small ones that rise for a motor that
/// is not known.
fn currents(
    bench: &mut BenchFile,
    request: &InitRequest<'_>,
    nameplate: Option<&Nameplate>,
    fitted: &mut Fitted,
) -> Result<(), InitError> {
    let (limits, period_s) = (bench.limits(), bench.period_s());
    let Some(nameplate) = nameplate else {
        bench.currents = Some(CurrentsSection::search(&bench.motor, &limits, period_s));
        let why = "from small to large, until the motor is found; then it is made to fit the motor";
        fitted.reasons.push(Reasoned::new("currents", None, why));
        return Ok(());
    };
    let section = CurrentsSection::for_motor(nameplate, &limits, period_s);
    fitted.reasons.push(Reasoned::new("currents", None, format!(
        "{:.3} A against the friction of the nameplate; the levels accelerate beyond it, and reverse at {TURNS:?} of the reachable speed",
        nameplate.load_torque_n_m / nameplate.back_emf_v_s_per_rad
    )));
    bench.currents = Some(section);
    // While the length is not set.
    bench.limits.time_s = Some(3600.0);
    let planned = planned(bench, request, nameplate)?;
    if let Some(refusal) = planned.refusals.first() {
        return Err(too_much("the sequence of currents", refusal));
    }
    fitted.plan = Some(planned);
    Ok(())
}

fn planned(
    bench: &BenchFile,
    request: &InitRequest<'_>,
    nameplate: &Nameplate,
) -> Result<Plan, InitError> {
    let own_limit_a = request.readback.current_limit_a;
    plan_run(bench, bench.runs.fit, nameplate, bench.link.rate_hz, own_limit_a)
        .map_err(|error| wrong_nameplate(&error))
}

fn wrong_nameplate(error: &impl ToString) -> InitError {
    InitError::new(error.to_string(), "correct the nameplate")
}

fn too_much(sequence: &str, refusal: &Refusal) -> InitError {
    InitError::new(
        format!("{sequence} is too much for this motor: {refusal}"),
        "check the nameplate against the motor, and its load",
    )
}

/// The rich sequence, or one without negative voltages. After the standstill comes a small level, which breaks few shafts away:
/// a drive that starts late starts in it, and not in a fast step, where its own current limit would cut off a part of the
/// voltage that would then count as an effect of the motor.
fn sequence(voltage_v: f64, slew_v_per_s: f64, one_way: bool) -> Vec<Segment> {
    let mut sequence = if one_way {
        without_negative_voltages(voltage_v, slew_v_per_s)
    } else {
        excitation::rich(voltage_v, slew_v_per_s, 1)
    };
    let level_v = 0.01 * voltage_v;
    let level = Ramp { from_v: level_v, to_v: level_v, seconds: 0.5, dither: None };
    sequence.insert(1, Segment::Ramp(level));
    sequence
}

fn without_negative_voltages(voltage_v: f64, slew_v_per_s: f64) -> Vec<Segment> {
    let levels_v = [0.9, 0.3, 0.6, 0.15, 0.45].map(|share| share * voltage_v);
    let hold_s = (voltage_v / slew_v_per_s + 0.15).max(0.5);
    vec![
        Segment::Standstill(Standstill { seconds: 0.5 }),
        Segment::Steps(Steps {
            levels_v: levels_v.to_vec(),
            hold_s,
            dither: Some(Dither { amplitude_v: 0.1 * voltage_v, clock_s: 0.05, seed: 1 }),
        }),
        Segment::Prbs(Prbs {
            amplitude_v: 0.4 * voltage_v,
            clock_s: (0.4 * voltage_v / slew_v_per_s).max(0.04),
            seconds: 3.0,
            seed: 2,
            offset_v: 0.5 * voltage_v,
            levels: 5,
        }),
        Segment::Standstill(Standstill { seconds: 0.5 }),
    ]
}

/// Slowed down to the rate of the link, every number short.
fn paced(sequence: Vec<Segment>, period_s: f64) -> Vec<Segment> {
    let random_level_s = 3.0 * period_s;
    let pace = |mut segment: Segment| {
        match &mut segment {
            Segment::Steps(steps) => {
                steps.hold_s = steps.hold_s.max(LEVEL_PERIODS * period_s);
                if let Some(dither) = &mut steps.dither {
                    dither.clock_s = dither.clock_s.max(random_level_s);
                }
            }
            Segment::Prbs(prbs) => {
                prbs.clock_s = prbs.clock_s.max(random_level_s);
                prbs.seconds = prbs.seconds.max(15.0 * prbs.clock_s);
            }
            Segment::Ramp(ramp) => ramp.seconds = ramp.seconds.max(2.0 * LEVEL_PERIODS * period_s),
            Segment::Sine(sine) => {
                sine.seconds = sine.seconds.max(2.0 * LEVEL_PERIODS * period_s);
                sine.frequency_hz = sine.seconds.recip();
            }
            Segment::Standstill(_)
            | Segment::Staircase(_)
            | Segment::Chirp(_)
            | Segment::CoastDown(_) => {}
        }
        rounded(segment)
    };
    sequence.into_iter().map(pace).collect()
}

/// Voltages to 0.01 V towards zero, times up to the next millisecond.
fn rounded(mut segment: Segment) -> Segment {
    let Cells { volts, times_s, .. } = cells(&mut segment);
    for volts in volts {
        // A level of 0 V has no sign.
        *volts = volts.signum() * (volts.abs() * 100.0 + 1e-6).floor() / 100.0 + 0.0;
    }
    for time_s in times_s {
        *time_s = (*time_s * 1000.0 - 1e-6).ceil() / 1000.0;
    }
    segment
}

/// Levels within what speed limit and voltage limit reach.
fn speed_section(
    bench: &BenchFile,
    request: &InitRequest<'_>,
    nameplate: &Nameplate,
    purpose: InitUse,
) -> SpeedSection {
    let limits = bench.limits();
    let mut top_rad_s = nameplate.rated_speed_rad_s.min(0.8 * limits.speed_rad_s);
    if purpose != InitUse::SpeedLoop {
        top_rad_s = top_rad_s.min(0.7 * limits.voltage_v / nameplate.back_emf_v_s_per_rad);
    }
    let capabilities = &request.profile.capabilities;
    let is_outer = !capabilities.voltage_command && !capabilities.current_command;
    SpeedSection {
        controller: if capabilities.voltage_command {
            ControllerKind::Addc
        } else {
            ControllerKind::Pi
        },
        // Not measured yet.
        drive_lag_s: is_outer.then_some(0.1),
        reference: vec![ReferencePart::Steps {
            levels_rad_s: LEVELS.map(|share| short(share * top_rad_s)).to_vec(),
            hold_s: (2.0 * LEVEL_PERIODS * bench.period_s()).max(2.0),
        }],
        ..SpeedSection::default()
    }
}
