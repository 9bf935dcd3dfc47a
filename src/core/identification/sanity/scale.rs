//! Units. Each balance holds in any unit of speed or current, so a wrong one shows only against the angle, a torque,
//! a nameplate, or a size that no motor has.

use std::fmt::Write as _;

use super::table::{Activity, Balances, Coefficient, Roles, Table, back_emf_without_current};
use super::{Finding, Kind};
use crate::identification::claims::OF_BACK_EMF as OF_SPEED;
use crate::numerics::statistics::{largest, median, robust_deviation};
use crate::plant::{Model, MotorKey};
use crate::sample::{Channel, Origin, Run};
use crate::units::{rad_s_from_rpm, rpm_from_rad_s};

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
/// Electrical time constant that no armature reaches, s.
const LONGEST_ARMATURE_S: f64 = 1.0;
/// Speed above which r/min are suspected, rad/s: 9,549 r/min.
const FAST_RAD_S: f64 = 1000.0;
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
        let confirmed = nameplate.is_some()
            || run.origin(Channel::Speed) != Origin::Unknown
            || speed_over_angle(run).is_some_and(|ratio| near(ratio, 1.0, ANGLE_AGREES));
        findings.extend(sizes(table, confirmed, back_emf));
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
    // Phase against line, peak against r.m.s., electrical against mechanical speed: near one, so only a hint.
    let hints = [
        (3f64.sqrt(), "line for phase values (sqrt 3)"),
        (1.0 / 3f64.sqrt(), "phase for line values (sqrt 3)"),
        (2f64.sqrt(), "peak for r.m.s. values (sqrt 2)"),
        (1.0 / 2f64.sqrt(), "r.m.s. for peak values (sqrt 2)"),
        (0.5, "electrical speed of two pole pairs (2)"),
        (1.0 / 3.0, "electrical speed of three pole pairs (3)"),
        (0.25, "electrical speed of four pole pairs (4)"),
    ];
    let hint = hints
        .iter()
        .find(|(factor, _)| near(ratio, *factor, 0.03))?;
    Some(Finding::caution(
        Kind::Unit,
        &OF_SPEED,
        format!("{seen}: has the column {}?", hint.1),
        "check on which basis the nameplate and the columns are given",
    ))
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

/// Sizes that hardly any motor has; `confirmed`: the unit of the speed is known otherwise.
fn sizes(table: &Table, confirmed: bool, back_emf: Option<f64>) -> Vec<Finding> {
    let [voltage, current, speed] =
        [&table.voltage_v, &table.current_a, &table.speed_rad_s].map(|values| Activity::of(values));
    let mut findings = Vec::new();
    let many = current.is_there() && current.largest() > MANY_AMPERES;
    if many && voltage.is_there() && voltage.largest() < LOW_VOLTAGE_V {
        let sentence = format!(
            "current_a reaches {:.0} A at {:.1} V: if it is in mA, it is 1000 times too large",
            current.largest(),
            voltage.largest()
        );
        let help = "convert it with --map current_a=COLUMN*0.001";
        let peak_w = current.largest() * voltage.largest();
        findings.push(if peak_w > LARGEST_POWER_W {
            Finding::refusal(Kind::Unit, sentence, help)
        } else {
            let touched = [
                MotorKey::Resistance,
                MotorKey::Inductance,
                MotorKey::TorqueConstant,
                MotorKey::Inertia,
                MotorKey::LoadTorque,
            ];
            Finding::caution(Kind::Magnitude, &touched, sentence, help)
        });
    }
    if speed.is_there() && speed.largest() > FAST_RAD_S && !confirmed {
        let fast = speed.largest();
        let constant = back_emf.map_or_else(String::new, |found| {
            format!(
                ", and the back-EMF constant {:.4} instead of {found:.4} V.s/rad",
                found / rad_s_from_rpm(1.0)
            )
        });
        findings.push(Finding::caution(
            Kind::Magnitude,
            &OF_SPEED,
            format!(
                "speed_rad_s reaches {fast:.0} rad/s, that is {:.0} r/min; if the column is in r/min (a factor 9.5493), it is \
                 {:.0} rad/s{constant}",
                rpm_from_rad_s(fast),
                rad_s_from_rpm(fast)
            ),
            "convert it with --map speed_rad_s=COLUMN*0.104719755, or confirm it with --origin speed_rad_s=measured",
        ));
    }
    findings
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
