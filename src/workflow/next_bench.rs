//! A recommended run as a bench file that `run` takes as it is.

use drivebench_bench::{BenchFile, Protocol};
use drivebench_diagnose::{ExperimentLimits, Recipe};
use drivebench_model::plant::{Model, MotorKey};
use drivebench_model::text::lines::wrapped;

/// Separates the name of the bench from that of the recommended run.
const NEXT: &str = "-next-";

pub fn experiment_limits(bench: &BenchFile) -> ExperimentLimits {
    let limits = bench.limits();
    ExperimentLimits {
        voltage_v: limits.voltage_v,
        // A drive for this motor gives at most twice its rated current.
        current_a: limits.current_a.min(2.0 * bench.motor.rated_current_a),
        speed_rad_s: limits.speed_rad_s,
        rms_current_a: bench.motor.rated_current_a,
        travel_rad: limits.travel_rad,
        duration_s: limits.time_s,
        // Without a slew limit of the bench the plan of the current limits the slew.
        slew_v_per_s: bench.limits.slew_v_per_s.unwrap_or(f64::INFINITY),
        period_s: bench.link.rate_hz.recip(),
    }
}

/// The bench with the recipe as its sequence, as the text of a file whose head has its purpose. The slew limit is the recipe's.
pub fn next_bench(bench: &BenchFile, recipe: &Recipe, model: &Model, sentence: &str) -> String {
    let mut next = bench.clone();
    let own = bench.name.split(NEXT).next().unwrap_or(&bench.name);
    next.name = format!("{own}{NEXT}{}", recipe.id.replace('_', "-"));
    next.sequence.clone_from(&recipe.segments);
    next.limits.slew_v_per_s = Some(recipe.slew_v_per_s);
    let motor = &mut next.motor;
    let unknown = motor.is_unknown();
    for (cell, key) in [
        (&mut motor.resistance_ohm, MotorKey::Resistance),
        (&mut motor.inductance_h, MotorKey::Inductance),
        (&mut motor.back_emf_v_s_per_rad, MotorKey::BackEmf),
        (&mut motor.inertia_kg_m2, MotorKey::Inertia),
        (&mut motor.load_torque_n_m, MotorKey::LoadTorque),
    ] {
        if (unknown || cell.is_none()) && model.motor.get(key).is_some() {
            *cell = model.motor.get(key);
        }
    }
    // The motor is known now.
    motor.unknown = false;
    format!("{}\n{}", comment(sentence), next.to_toml())
}

/// A bench for runs without a bench file: the embedded one with the identified motor and the ranges of the runs as limits.
/// Its port has to be given.
pub fn bench_for(model: &Model, limits: &ExperimentLimits, rate_hz: f64) -> BenchFile {
    let mut bench = BenchFile::embedded_default();
    let or = |value: f64, other: f64| if value.is_finite() { value } else { other };
    "next".clone_into(&mut bench.name);
    // Its reference is for another motor.
    bench.speed = None;
    // A placeholder that cannot be opened.
    "port-of-your-drive".clone_into(&mut bench.link.port);
    bench.link.rate_hz = rate_hz.clamp(1.0, 2000.0);
    // A rate above that of serial Modbus was recorded over the stream protocol.
    if rate_hz > 120.0 {
        bench.link.protocol = Protocol::Stream;
    }
    let motor = &mut bench.motor;
    if !model.motor.name.is_empty() {
        motor.name.clone_from(&model.motor.name);
    }
    motor.unknown = true;
    motor.rated_voltage_v = limits.voltage_v;
    motor.rated_current_a = or(limits.rms_current_a, motor.rated_current_a);
    motor.rated_speed_rad_s = or(limits.speed_rad_s, motor.rated_speed_rad_s);
    bench.limits.voltage_v = Some(limits.voltage_v);
    bench.limits.current_a = Some(or(limits.current_a, bench.limits().current_a));
    bench.limits.speed_rad_s = Some(or(limits.speed_rad_s, bench.limits().speed_rad_s));
    bench
}

fn comment(sentence: &str) -> String {
    format!("# {}\n", wrapped(sentence, 108).join("\n# "))
}

#[cfg(test)]
mod tests;
