//! Units. Each balance holds in any unit of speed or current, so a wrong one shows only against the angle, a torque,
//! a nameplate, or a size that no motor has.

use std::fmt::Write as _;

use super::table::{Activity, Balances, Coefficient, Roles, Table, back_emf_without_current};
use super::{Finding, Kind};
use crate::claims::OF_BACK_EMF as OF_SPEED;
use drivebench_model::numerics::statistics::{largest, median, robust_deviation};
use drivebench_model::plant::{Model, MotorKey};
use drivebench_model::sample::{Channel, Origin, Run};
use drivebench_model::units::{rad_s_from_rpm, rpm_from_rad_s};

/// A unit that is taken for another: `column = factor * true value`.
struct Confusion {
    factor: f64,
    /// Key of the column, its unit as it seems, and its unit as it should be.
    key: &'static str,
    seems: &'static str,
    instead: &'static str,
}

const DEGREES: f64 = 180.0 / std::f64::consts::PI;
const TAU: f64 = std::f64::consts::TAU;

const fn confused(
    factor: f64,
    key: &'static str,
    seems: &'static str,
    instead: &'static str,
) -> Confusion {
    Confusion {
        factor,
        key,
        seems,
        instead,
    }
}

fn speed_units() -> [Confusion; 4] {
    let confusion = |factor, seems| confused(factor, "speed_rad_s", seems, "rad/s");
    [
        confusion(rpm_from_rad_s(1.0), "r/min"),
        confusion(DEGREES, "deg/s"),
        confusion(1.0 / TAU, "turns per second"),
        confusion(1e3, "mrad/s"),
    ]
}

impl Confusion {
    /// `why`: the evidence with its figures.
    fn refusal(&self, why: &str) -> Finding {
        let correction = 1.0 / self.factor;
        Finding::refusal(
            Kind::Unit,
            format!(
                "{} seems to be in {}, not in {} (a factor {:.4}): {why}",
                self.key, self.seems, self.instead, self.factor
            ),
            format!("convert it with --map {}=COLUMN*{correction:.9}", self.key),
        )
    }
}

/// Whether `ratio` is `factor` within a share.
fn near(ratio: f64, factor: f64, tolerance: f64) -> bool {
    (ratio / factor - 1.0).abs() < tolerance
}

/// Agreement of angle and speed that confirms both, and by which a factor is recognised.
const ANGLE_AGREES: f64 = 0.05;
const ANGLE_FACTOR: f64 = 0.02;
/// Rows over which speed is integrated, windows that are needed, and their spread about the median.
const ANGLE_ROWS: usize = 10;
const ANGLE_WINDOWS: usize = 8;
const ANGLE_SPREAD: f64 = 0.1;

/// Integral of the speed over the change of the angle; `None` without both, or where they have no constant ratio.
fn speed_over_angle(run: &Run) -> Option<f64> {
    if run.origin(Channel::Speed) == Origin::Derived
        || run.origin(Channel::Angle) == Origin::Derived
    {
        return None;
    }
    let (angle, speed) = (run.column(Channel::Angle)?, run.column(Channel::Speed)?);
    let rows = run.time_s().iter().zip(angle.iter().zip(speed));
    let rows = rows.map(|(time, (angle, speed))| [*time, *angle, *speed]);
    let rows: Vec<[f64; 3]> = rows
        .filter(|row| row.iter().all(|cell| cell.is_finite()))
        .collect();
    let area = |pair: &[[f64; 3]]| 0.5 * (pair[0][2] + pair[1][2]) * (pair[1][0] - pair[0][0]);
    let window = |chunk: &[[f64; 3]]| {
        let travel: f64 = chunk.windows(2).map(area).sum();
        [travel, chunk[ANGLE_ROWS - 1][1] - chunk[0][1]]
    };
    let windows: Vec<[f64; 2]> = rows.chunks_exact(ANGLE_ROWS).map(window).collect();
    let travels: Vec<f64> = windows.iter().map(|window| window[0]).collect();
    let largest = largest(&travels);
    let ratios: Vec<f64> = windows
        .iter()
        .filter(|[travel, _]| travel.abs() > 0.3 * largest)
        .map(|[travel, turned]| travel / turned)
        .filter(|ratio| ratio.is_finite())
        .collect();
    let middle = median(&ratios);
    (ratios.len() >= ANGLE_WINDOWS && robust_deviation(&ratios) < ANGLE_SPREAD * middle.abs())
        .then_some(middle)
}

/// The angle's derivative is the speed, whatever the motor.
pub(super) fn against_angle(run: &Run) -> Option<Finding> {
    let ratio = speed_over_angle(run)?;
    if near(ratio, 1.0, ANGLE_AGREES) {
        return None;
    }
    let seen = format!("the integral of speed_rad_s is {ratio:.4} times the change of angle_rad");
    let is = |factor: f64| near(ratio, factor, ANGLE_FACTOR);
    let angle_help = "map the angle in rad, or leave it out";
    let speed_and_angle = |units: &str, correction: f64| {
        Finding::refusal(
            Kind::Unit,
            format!(
                "speed_rad_s seems to be in r/min (a factor 9.5493) and angle_rad in {units}: {seen}"
            ),
            format!(
                "convert them with --map speed_rad_s=COLUMN*0.104719755,angle_rad=COLUMN*{correction:.9}"
            ),
        )
    };
    for (factor, unit, correction) in [(1e3, "ms", "0.001"), (1e6, "us", "0.000001")] {
        if is(factor) {
            let sentence =
                format!("time_s seems to be in {unit}, not in s (a factor {factor}): {seen}");
            let help = format!("convert it with --map time_s=COLUMN*{correction}");
            return Some(Finding::refusal(Kind::Unit, sentence, help));
        }
    }
    if let Some(confusion) = speed_units().iter().find(|unit| is(unit.factor)) {
        return Some(confusion.refusal(&seen));
    }
    if is(rpm_from_rad_s(1.0) / DEGREES) {
        return Some(speed_and_angle("degrees", 1.0 / DEGREES));
    }
    if is(rpm_from_rad_s(1.0) * TAU) {
        return Some(speed_and_angle("turns", TAU));
    }
    Some(if is(1.0 / DEGREES) || is(TAU) {
        let (unit, correction) = if ratio < 1.0 {
            ("degrees", 1.0 / DEGREES)
        } else {
            ("turns", TAU)
        };
        let sentence = format!("angle_rad seems to be in {unit}, not in rad: {seen}");
        let help = format!("convert it with --map angle_rad=COLUMN*{correction:.9}");
        Finding::caution(Kind::Unit, &[], sentence, help)
    } else if is(-1.0) {
        Finding::caution(
            Kind::Reversed,
            &[],
            format!("angle and speed count in opposite directions: {seen}"),
            "turn one of them with --map angle_rad=COLUMN*-1",
        )
    } else {
        let pairs = ratio.round();
        let guess = if (2.0..=24.0).contains(&pairs) && is(pairs) {
            format!("; is the speed electrical, with {pairs} pole pairs?")
        } else {
            "; one of them is in another unit (counts?), or on the other side of a gear".to_owned()
        };
        let sentence = format!("{seen}{guess}");
        Finding::caution(Kind::Unit, &OF_SPEED, sentence, angle_help)
    })
}

/// Tolerance by which a ratio of back-EMF constants shows a unit; temperature moves it by some per cent.
const BACK_EMF: f64 = 0.15;
/// Resistances within this ratio are the same winding, hot or cold, with its cable.
const SAME_WINDING: f64 = 1.8;
/// Ratio of back-EMF constants up to which two motors of the same winding are one, more or less magnetised.
const SAME_MACHINE: f64 = 1.5;
/// Electrical time constant that no armature reaches, s.
const LONGEST_ARMATURE_S: f64 = 1.0;
/// Speed above which r/min are suspected, rad/s: 9,549 r/min.
const FAST_RAD_S: f64 = 1000.0;
/// Voltage above which millivolts are suspected: low voltage ends there, and few motors that are recorded have more.
const MANY_VOLTS: f64 = 1000.0;
/// Current above which, below such a voltage, milliamperes are suspected; and the power that settles it, W.
const MANY_AMPERES: f64 = 1000.0;
const LOW_VOLTAGE_V: f64 = 200.0;
const LARGEST_POWER_W: f64 = 1e6;

/// Against the model's values, a torque, and what motors are like.
pub(super) fn against_model(run: &Run, table: &Table, model: &Model) -> Vec<Finding> {
    let roles = Roles::of(table);
    let balances = Balances::of(&roles);
    let mut findings = Vec::new();
    let back_emf = balances
        .map(|found| found.back_emf)
        .or_else(|| back_emf_without_current(&roles))
        .filter(Coefficient::is_positive)
        .map(|found| found.value);
    if let Some(found) = &balances
        && found.inductance.is_positive()
        && found.resistance.is_positive()
        && found.inductance.value > LONGEST_ARMATURE_S * found.resistance.value
    {
        let time_constant_s = found.inductance.value / found.resistance.value;
        findings.push(Finding::refusal(
            Kind::Unit,
            format!(
                "time_s seems to be in ms, not in s (a factor 1000): the rows are {:.4} s apart and the armature would have \
                 a time constant L/R of {time_constant_s:.2} s, while none exceeds {LONGEST_ARMATURE_S} s",
                table.period_s()
            ),
            "convert it with --map time_s=COLUMN*0.001",
        ));
    }
    let resistance = balances.map(|found| found.resistance.value);
    let nameplate = model.motor.get(MotorKey::BackEmf);
    if let (Some(found), Some(given)) = (back_emf, nameplate) {
        let windings = resistance.zip(model.motor.get(MotorKey::Resistance));
        findings.extend(against_nameplate(found, given, windings));
    }
    if let Some(found) = back_emf {
        findings.extend(against_torque(run, found));
    }
    if findings.is_empty() {
        // Who says where the speed comes from has looked at it: a drive's profile, or the user with --origin.
        let confirmed = nameplate.is_some() || run.origin(Channel::Speed) != Origin::Unknown;
        let by_angle = speed_over_angle(run).is_some();
        findings.extend(electrical_sizes(table, nameplate.is_some()));
        findings.extend(fast(table, confirmed, by_angle, back_emf));
    }
    findings
}

/// `windings`: resistance found and given.
fn against_nameplate(found: f64, given: f64, windings: Option<(f64, f64)>) -> Option<Finding> {
    let winding = windings.map(|(found, given)| found / given);
    let like = |factor: f64| {
        winding.is_none_or(|ratio| (factor / SAME_WINDING..factor * SAME_WINDING).contains(&ratio))
    };
    let ratio = found / given;
    let mut seen = format!(
        "this run gives a back-EMF constant of {found:.4e} V.s/rad, the model {given:.4e} ({:.3} times as much)",
        given / found
    );
    if let Some((found, given)) = windings {
        let _ = write!(
            seen,
            ", a resistance of {found:.4e} ohm, the model {given:.4e}"
        );
    }
    if like(1.0)
        && let Some(unit) = speed_units()
            .iter()
            .find(|unit| near(ratio * unit.factor, 1.0, BACK_EMF))
    {
        return Some(unit.refusal(&seen));
    }
    for (factor, current, voltage) in [(1e3, "mA", "mV"), (1e-3, "kA", "kV")] {
        if winding.is_some() && like(1.0 / factor) && near(ratio, 1.0, 3.0 * BACK_EMF) {
            return Some(confused(factor, "current_a", current, "A").refusal(&seen));
        }
        if like(factor) && near(ratio, factor, BACK_EMF) {
            return Some(confused(factor, "voltage_v", voltage, "V").refusal(&seen));
        }
    }
    // Phase against line, peak against r.m.s., electrical against mechanical speed, edges against lines, a gear: each is a
    // plain number, so only a hint.
    let hints = [
        (3f64.sqrt(), "line for phase values (sqrt 3)"),
        (1.0 / 3f64.sqrt(), "phase for line values (sqrt 3)"),
        (2f64.sqrt(), "peak for r.m.s. values (sqrt 2)"),
        (1.0 / 2f64.sqrt(), "r.m.s. for peak values (sqrt 2)"),
        (0.5, "electrical speed of two pole pairs (2)"),
        (1.0 / 3.0, "electrical speed of three pole pairs (3)"),
        (
            0.25,
            "quadrature edges counted as lines, or electrical speed of four pole pairs (4)",
        ),
        (4.0, "lines counted as quadrature edges (4)"),
    ];
    if let Some(hint) = hints.iter().find(|(factor, _)| near(ratio, *factor, 0.03)) {
        let sentence = format!("{seen}: has the column {}?", hint.1);
        let help = "check on which basis the nameplate and the columns are given";
        return Some(Finding::caution(Kind::Unit, &OF_SPEED, sentence, help));
    }
    let is_far = !(1.0 / SAME_MACHINE..SAME_MACHINE).contains(&ratio);
    (is_far && winding.is_some() && like(1.0)).then(|| {
        let gear = if ratio > 1.0 { ratio } else { 1.0 / ratio };
        let side = if ratio > 1.0 { "slow" } else { "fast" };
        let sentence = format!(
            "{seen}, the same winding: does the encoder stand on the {side} side of a gear of {gear:.3}?"
        );
        let help = format!("if so, convert it with --map speed_rad_s=COLUMN*{ratio:.6}");
        Finding::caution(Kind::Unit, &OF_SPEED, sentence, help)
    })
}

/// Kt = Ke in SI: with a torque and a current the factor between them is a unit.
fn against_torque(run: &Run, back_emf: f64) -> Option<Finding> {
    let (torque, current) = (run.column(Channel::Torque)?, run.column(Channel::Current)?);
    let both = || {
        torque
            .iter()
            .zip(current)
            .filter(|(t, i)| t.is_finite() && i.is_finite())
    };
    let power: f64 = both().map(|(_, i)| i * i).sum();
    let constant = both().map(|(t, i)| t * i).sum::<f64>() / power;
    let ratio = constant / back_emf;
    let seen = format!(
        "torque over current is {constant:.4e} N.m/A, the back-EMF constant {back_emf:.4e} V.s/rad, equal in SI"
    );
    let unit = speed_units()
        .into_iter()
        .find(|unit| near(ratio, unit.factor, BACK_EMF))?;
    Some(unit.refusal(&seen))
}

/// Voltages and currents that hardly any motor has; `confirmed`: by a nameplate.
fn electrical_sizes(table: &Table, confirmed: bool) -> Vec<Finding> {
    let [voltage, current] =
        [&table.voltage_v, &table.current_a].map(|values| Activity::of(values));
    let peak = |signal: &Activity| {
        if signal.is_there() {
            signal.largest()
        } else {
            0.0
        }
    };
    let (volts, amperes) = (peak(&voltage), peak(&current));
    let many_volts = volts > MANY_VOLTS && !confirmed;
    let milliamperes =
        amperes > MANY_AMPERES && voltage.is_there() && (volts < LOW_VOLTAGE_V || many_volts);
    let is_absurd = amperes * volts > LARGEST_POWER_W && milliamperes;
    let judged = |sentence: String, help: &str| {
        let touched = [
            MotorKey::Resistance,
            MotorKey::Inductance,
            MotorKey::TorqueConstant,
            MotorKey::Inertia,
            MotorKey::LoadTorque,
        ];
        if is_absurd {
            Finding::refusal(Kind::Unit, sentence, help)
        } else if many_volts {
            Finding::caution(Kind::Magnitude, &MotorKey::ALL, sentence, help)
        } else {
            Finding::caution(Kind::Magnitude, &touched, sentence, help)
        }
    };
    let mut findings = Vec::new();
    if many_volts {
        let key = table.voltage_key;
        findings.push(judged(
            format!("{key} reaches {volts:.0} V: if it is in mV, it is 1000 times too large"),
            &format!("convert it with --map {key}=COLUMN*0.001"),
        ));
    }
    if milliamperes {
        findings.push(judged(
            format!(
                "current_a reaches {amperes:.0} A at {volts:.1} V: if it is in mA, it is 1000 times too large"
            ),
            "convert it with --map current_a=COLUMN*0.001",
        ));
    }
    findings
}

/// Speeds that hardly any motor has; `confirmed`: the unit is known otherwise, `by_angle`: an angle is its integral, so that
/// both may be in degrees, and not in r/min.
fn fast(table: &Table, confirmed: bool, by_angle: bool, back_emf: Option<f64>) -> Option<Finding> {
    let speed = Activity::of(&table.speed_rad_s);
    let fast = speed.largest();
    let suspected = if by_angle {
        FAST_RAD_S * DEGREES / rpm_from_rad_s(1.0)
    } else {
        FAST_RAD_S
    };
    if !speed.is_there() || fast <= suspected || confirmed {
        return None;
    }
    let constant = |factor: f64| {
        back_emf.map_or_else(String::new, |found| {
            format!(
                ", and the back-EMF constant {:.4} instead of {found:.4} V.s/rad",
                found * factor
            )
        })
    };
    let per_minute = rpm_from_rad_s(1.0);
    let reaches = format!(
        "speed_rad_s reaches {fast:.0} rad/s, that is {:.0} r/min",
        rpm_from_rad_s(fast)
    );
    let degrees = format!(
        "in deg/s (a factor {DEGREES:.4}), it is {:.0} rad/s{}",
        fast / DEGREES,
        constant(DEGREES)
    );
    let confirm = "or confirm it with --origin speed_rad_s=measured";
    let (sentence, help) = if by_angle {
        (
            format!(
                "{reaches}, and angle_rad is its integral; if the columns are in degrees and {degrees}"
            ),
            format!(
                "convert them with --map speed_rad_s=COLUMN*0.017453293,angle_rad=COLUMN*0.017453293, {confirm}"
            ),
        )
    } else {
        (
            format!(
                "{reaches}; if the column is in r/min (a factor {per_minute:.4}), it is {:.0} rad/s{}; if it is {degrees}",
                rad_s_from_rpm(fast),
                constant(per_minute)
            ),
            format!(
                "convert it with --map speed_rad_s=COLUMN*0.104719755 (r/min) or speed_rad_s=COLUMN*0.017453293 (deg/s), {confirm}"
            ),
        )
    };
    Some(Finding::caution(Kind::Magnitude, &OF_SPEED, sentence, help))
}

// What the header of a mapped column says about its unit.

/// `(target, words of which one stands in the header, its unit, factor to the target's unit)`.
const UNITS: &[(&str, &str, &str, &str)] = &[
    ("speed_rad_s", "krpm", "1000 r/min", "104.719755"),
    (
        "speed_rad_s",
        "rpm r/min u/min rev/min 1/min min-1 min^-1",
        "r/min (a factor 9.5493)",
        "0.104719755",
    ),
    (
        "speed_rad_s",
        "deg/s dps \u{b0}/s",
        "deg/s",
        "0.01745329252",
    ),
    (
        "speed_rad_s",
        "rps rev/s turns/s hz",
        "turns per second",
        "6.283185307",
    ),
    ("current_a", "ma milliamp milliamps", "mA", "0.001"),
    ("current_a", "ka", "kA", "1000"),
    ("voltage_v", "mv millivolt millivolts", "mV", "0.001"),
    ("voltage_v", "kv", "kV", "1000"),
    ("voltage_cmd_v", "mv", "mV", "0.001"),
    ("voltage_cmd_v", "kv", "kV", "1000"),
    ("bus_v", "mv", "mV", "0.001"),
    ("time_s", "ms msec millis milliseconds", "ms", "0.001"),
    (
        "time_s",
        "us usec micros \u{b5}s \u{3bc}s",
        "us",
        "0.000001",
    ),
    ("time_s", "ns nanos", "ns", "0.000000001"),
    (
        "angle_rad",
        "deg degrees \u{b0}",
        "degrees",
        "0.01745329252",
    ),
    ("angle_rad", "rev turns revs", "turns", "6.283185307"),
    ("torque_n_m", "mnm nmm mn.m n.mm", "mN.m", "0.001"),
    ("torque_n_m", "ncm n.cm", "N.cm", "0.01"),
];

/// The unit that a header names where it is not the target's. `scaled`: the map gives a factor, so somebody thought of it.
pub fn of_header(target: &str, header: &str, scaled: bool) -> Option<Finding> {
    if scaled {
        return None;
    }
    let header_lower = header.to_lowercase();
    let words: Vec<&str> = header_lower
        .split(|letter: char| letter.is_whitespace() || "_,;:()[]{}|\"".contains(letter))
        .collect();
    let (_, _, unit, factor) = UNITS.iter().find(|(of, names, ..)| {
        *of == target && names.split(' ').any(|name| words.contains(&name))
    })?;
    Some(Finding::refusal(
        Kind::Unit,
        format!("--map {target}={header}: the header names {unit}, and no factor is given"),
        format!(
            "write {target}={header}*{factor}; if the column is in the unit of {target} all the same, write {target}={header}*1"
        ),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_in_the_header_is_seen_unless_a_factor_was_given() {
        for (target, header, part) in [
            ("speed_rad_s", "rpm", "9.5493"),
            ("speed_rad_s", "Motor speed [RPM]", "*0.104719755"),
            ("speed_rad_s", "n (1/min)", "r/min"),
            ("current_a", "i mA", "*0.001"),
            ("time_s", "t_ms", "*0.001"),
            ("angle_rad", "pos (deg)", "degrees"),
        ] {
            let found = of_header(target, header, false).expect(header);
            let text = format!("{} {}", found.sentence, found.help);
            assert!(text.contains(part) && found.refuses, "{text}");
            assert_eq!(of_header(target, header, true), None);
        }
        for (target, header) in [
            ("speed_rad_s", "speed_rad_s"),
            ("speed_rad_s", "omega"),
            ("current_a", "ima"),
            ("current_a", "rpm"),
            ("time_s", "time (s)"),
        ] {
            assert_eq!(of_header(target, header, false), None, "{header}");
        }
    }
}
