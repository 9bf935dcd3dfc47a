//! Units. Each balance holds in any unit of speed or current, so a wrong one shows only against the angle, a torque,
//! a nameplate, or a size that no motor has.

use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;

use super::table::{Activity, Balances, Coefficient, Roles, Table, back_emf_without_current};
use super::{Finding, Kind};
use crate::claims::OF_BACK_EMF as OF_SPEED;
use drivebench_model::numerics::statistics::{largest, median, robust_deviation};
use drivebench_model::plant::{Model, MotorKey};
use drivebench_model::sample::{Channel, Origin, Run};
use drivebench_model::units::{rad_s_from_rpm, rpm_from_rad_s};

const DEGREES: f64 = 180.0 / PI;
/// Factors of the commands that convert a column.
const RAD_S_PER_RPM: &str = "0.104719755";
const RAD_PER_DEGREE: &str = "0.017453293";

/// Units that are taken for rad/s: `column = factor * true value`.
fn speed_units() -> [(f64, &'static str); 4] {
    [
        (rpm_from_rad_s(1.0), "r/min"),
        (DEGREES, "deg/s"),
        (1.0 / TAU, "turns per second"),
        (1e3, "mrad/s"),
    ]
}

/// Refuses a speed in one of those units; `why`: the evidence with its figures.
fn not_rad_s((factor, seems): (f64, &str), why: &str) -> Finding {
    confused("speed_rad_s", [seems, "rad/s"], factor, why)
}

fn confused(key: &str, [seems, instead]: [&str; 2], factor: f64, why: &str) -> Finding {
    let correction = 1.0 / factor;
    Finding::refusal(
        Kind::Unit,
        format!("{key} seems to be in {seems}, not in {instead} (a factor {factor:.4}): {why}"),
        format!("convert it with --map {key}=COLUMN*{correction:.9}"),
    )
}

/// Whether `ratio` is `factor` within a share.
fn near(ratio: f64, factor: f64, tolerance: f64) -> bool {
    (ratio / factor - 1.0).abs() < tolerance
}

/// Integral of the speed over the change of the angle, over windows of ten rows; `None` without both, or where they have no
/// constant ratio.
fn speed_over_angle(run: &Run) -> Option<f64> {
    let is_derived = |channel| run.origin(channel) == Origin::Derived;
    if is_derived(Channel::Speed) || is_derived(Channel::Angle) {
        return None;
    }
    let (angle, speed) = (run.column(Channel::Angle)?, run.column(Channel::Speed)?);
    let rows = run
        .time_s()
        .iter()
        .zip(angle.iter().zip(speed))
        .map(|(time, (angle, speed))| [*time, *angle, *speed]);
    let rows: Vec<[f64; 3]> = rows.filter(|row| row.iter().all(|cell| cell.is_finite())).collect();
    let area = |pair: &[[f64; 3]]| 0.5 * (pair[0][2] + pair[1][2]) * (pair[1][0] - pair[0][0]);
    let window = |chunk: &[[f64; 3]]| {
        let travel: f64 = chunk.windows(2).map(area).sum();
        [travel, chunk[9][1] - chunk[0][1]]
    };
    let windows: Vec<[f64; 2]> = rows.chunks_exact(10).map(window).collect();
    let largest = largest(windows.iter().map(|window| window[0]));
    let ratios: Vec<f64> = windows
        .iter()
        .filter(|[travel, _]| travel.abs() > 0.3 * largest)
        .map(|[travel, turned]| travel / turned)
        .filter(|ratio| ratio.is_finite())
        .collect();
    let middle = median(&ratios);
    (ratios.len() >= 8 && robust_deviation(&ratios) < 0.1 * middle.abs()).then_some(middle)
}

/// The derivative of the angle is the speed.
pub(super) fn against_angle(run: &Run) -> Option<Finding> {
    let ratio = speed_over_angle(run)?;
    if near(ratio, 1.0, 0.05) {
        return None;
    }
    let evidence =
        format!("the integral of speed_rad_s is {ratio:.4} times the change of angle_rad");
    let is = |factor: f64| near(ratio, factor, 0.02);
    let angle_units = [("degrees", 1.0 / DEGREES), ("turns", TAU)];
    for (factor, unit, correction) in [(1e3, "ms", "0.001"), (1e6, "us", "0.000001")] {
        if is(factor) {
            let sentence =
                format!("time_s seems to be in {unit}, not in s (a factor {factor}): {evidence}");
            let help = format!("convert it with --map time_s=COLUMN*{correction}");
            return Some(Finding::refusal(Kind::Unit, sentence, help));
        }
    }
    if let Some(unit) = speed_units().into_iter().find(|unit| is(unit.0)) {
        return Some(not_rad_s(unit, &evidence));
    }
    let both = [rpm_from_rad_s(1.0) / DEGREES, rpm_from_rad_s(1.0) * TAU];
    let mut units = both.into_iter().zip(angle_units);
    if let Some((_, (unit, correction))) = units.find(|(factor, _)| is(*factor)) {
        let sentence = format!(
            "speed_rad_s seems to be in r/min (a factor 9.5493) and angle_rad in {unit}: {evidence}"
        );
        let help = format!(
            "convert them with --map speed_rad_s=COLUMN*{RAD_S_PER_RPM},angle_rad=COLUMN*{correction:.9}"
        );
        return Some(Finding::refusal(Kind::Unit, sentence, help));
    }
    Some(if is(1.0 / DEGREES) || is(TAU) {
        let (unit, correction) = angle_units[usize::from(ratio >= 1.0)];
        let sentence = format!("angle_rad seems to be in {unit}, not in rad: {evidence}");
        let help = format!("convert it with --map angle_rad=COLUMN*{correction:.9}");
        Finding::caution(Kind::Unit, &[], sentence, help)
    } else if is(-1.0) {
        Finding::caution(
            Kind::Reversed,
            &[],
            format!("angle and speed count in opposite directions: {evidence}"),
            "turn one of them with --map angle_rad=COLUMN*-1",
        )
    } else {
        let pairs = ratio.round();
        let guess = if (2.0..=24.0).contains(&pairs) && is(pairs) {
            format!("; is the speed electrical, with {pairs} pole pairs?")
        } else {
            "; one of them is in another unit (counts?), or on the other side of a gear".to_owned()
        };
        let sentence = format!("{evidence}{guess}");
        let help = "map the angle in rad, or leave it out";
        Finding::caution(Kind::Unit, &OF_SPEED, sentence, help)
    })
}

/// Tolerance by which a ratio of back-EMF constants shows a unit; temperature moves it by some per cent.
const BACK_EMF: f64 = 0.15;
/// Electrical time constant that no armature reaches, s.
const LONGEST_ARMATURE_S: f64 = 1.0;

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
        // A declared origin confirms the unit: by a drive's profile, or by the user with --origin.
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
    // Resistances within a ratio of 1.8 may be those of one winding, hot and cold, with its cable.
    let like =
        |factor: f64| winding.is_none_or(|ratio| (factor / 1.8..factor * 1.8).contains(&ratio));
    let ratio = found / given;
    let mut evidence = format!(
        "this run gives a back-EMF constant of {found:.4e} V.s/rad, the model {given:.4e} ({:.3} times as much)",
        given / found
    );
    if let Some((found, given)) = windings {
        let _ = write!(evidence, ", a resistance of {found:.4e} ohm, the model {given:.4e}");
    }
    if like(1.0)
        && let Some(unit) =
            speed_units().into_iter().find(|unit| near(ratio * unit.0, 1.0, BACK_EMF))
    {
        return Some(not_rad_s(unit, &evidence));
    }
    for (factor, current, voltage) in [(1e3, "mA", "mV"), (1e-3, "kA", "kV")] {
        if winding.is_some() && like(1.0 / factor) && near(ratio, 1.0, 3.0 * BACK_EMF) {
            let units = [current, "A"];
            return Some(confused("current_a", units, factor, &evidence));
        }
        if like(factor) && near(ratio, factor, BACK_EMF) {
            let units = [voltage, "V"];
            return Some(confused("voltage_v", units, factor, &evidence));
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
        (0.25, "quadrature edges counted as lines, or electrical speed of four pole pairs (4)"),
        (4.0, "lines counted as quadrature edges (4)"),
    ];
    if let Some(hint) = hints.iter().find(|(factor, _)| near(ratio, *factor, 0.03)) {
        let sentence = format!("{evidence}: has the column {}?", hint.1);
        let help = "check on which basis the nameplate and the columns are given";
        return Some(Finding::caution(Kind::Unit, &OF_SPEED, sentence, help));
    }
    // Two motors of one winding within this ratio are one, more or less magnetised.
    let is_far = !(1.0 / 1.5..1.5).contains(&ratio);
    (is_far && winding.is_some() && like(1.0)).then(|| {
        let (gear, side) = if ratio > 1.0 { (ratio, "slow") } else { (1.0 / ratio, "fast") };
        let sentence = format!(
            "{evidence}, the same winding: does the encoder stand on the {side} side of a gear of {gear:.3}?"
        );
        let help = format!("if so, convert it with --map speed_rad_s=COLUMN*{ratio:.6}");
        Finding::caution(Kind::Unit, &OF_SPEED, sentence, help)
    })
}

/// Kt = Ke in SI: with a torque and a current the factor between them is a unit.
fn against_torque(run: &Run, back_emf: f64) -> Option<Finding> {
    let (torque, current) = (run.column(Channel::Torque)?, run.column(Channel::Current)?);
    let both = torque.iter().zip(current).filter(|(t, i)| t.is_finite() && i.is_finite());
    let power: f64 = both.clone().map(|(_, i)| i * i).sum();
    let constant = both.map(|(t, i)| t * i).sum::<f64>() / power;
    let ratio = constant / back_emf;
    let evidence = format!(
        "torque over current is {constant:.4e} N.m/A, the back-EMF constant {back_emf:.4e} V.s/rad, equal in SI"
    );
    let unit = speed_units().into_iter().find(|unit| near(ratio, unit.0, BACK_EMF))?;
    Some(not_rad_s(unit, &evidence))
}

/// Voltages and currents that hardly any motor has; `confirmed`: by a nameplate. Low voltage ends at 1,000 V, and few motors
/// that are recorded have more; below 200 V few have more than 1,000 A.
fn electrical_sizes(table: &Table, confirmed: bool) -> Vec<Finding> {
    let has_voltage = Activity::of(&table.voltage_v).is_there();
    let [volts, amperes] = [&table.voltage_v, &table.current_a].map(largest);
    let many_volts = volts > 1000.0 && !confirmed;
    let milliamperes = amperes > 1000.0 && has_voltage && (volts < 200.0 || many_volts);
    // More than a megawatt is refused, not only doubted.
    let is_absurd = amperes * volts > 1e6 && milliamperes;
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
            Finding::of_all(Kind::Magnitude, false, sentence, help)
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
    let per_minute = rpm_from_rad_s(1.0);
    let fast = largest(&table.speed_rad_s);
    // 9,549 r/min, or as many degrees per second as that are in r/min.
    let suspected = if by_angle { 1000.0 * DEGREES / per_minute } else { 1000.0 };
    if fast <= suspected || confirmed {
        return None;
    }
    let constant = |factor: f64| {
        back_emf.map_or_else(String::new, |found| {
            let other = found * factor;
            format!(", and the back-EMF constant {other:.4} instead of {found:.4} V.s/rad")
        })
    };
    let reaches =
        format!("speed_rad_s reaches {fast:.0} rad/s, that is {:.0} r/min", rpm_from_rad_s(fast));
    let degrees = format!(
        "in deg/s (a factor {DEGREES:.4}), it is {:.0} rad/s{}",
        fast / DEGREES,
        constant(DEGREES)
    );
    let confirm = "or confirm it with --origin speed_rad_s=measured";
    let (sentence, help);
    if by_angle {
        sentence = format!(
            "{reaches}, and angle_rad is its integral; if the columns are in degrees and {degrees}"
        );
        help = format!(
            "convert them with --map speed_rad_s=COLUMN*{RAD_PER_DEGREE},angle_rad=COLUMN*{RAD_PER_DEGREE}, {confirm}"
        );
    } else {
        sentence = format!(
            "{reaches}; if the column is in r/min (a factor {per_minute:.4}), it is {:.0} rad/s{}; if it is {degrees}",
            rad_s_from_rpm(fast),
            constant(per_minute)
        );
        help = format!(
            "convert it with --map speed_rad_s=COLUMN*{RAD_S_PER_RPM} (r/min) or speed_rad_s=COLUMN*{RAD_PER_DEGREE} (deg/s), {confirm}"
        );
    }
    Some(Finding::caution(Kind::Magnitude, &OF_SPEED, sentence, help))
}

/// The unit in the header of a mapped column: `(target, names of which one stands in the header, unit, factor to the target's)`.
const UNITS: &[(&str, &str, &str, &str)] = &[
    ("speed_rad_s", "krpm", "1000 r/min", "104.719755"),
    (
        "speed_rad_s",
        "rpm r/min u/min rev/min 1/min min-1 min^-1",
        "r/min (a factor 9.5493)",
        "0.104719755",
    ),
    ("speed_rad_s", "deg/s dps \u{b0}/s", "deg/s", "0.01745329252"),
    ("speed_rad_s", "rps rev/s turns/s hz", "turns per second", "6.283185307"),
    ("current_a", "ma milliamp milliamps", "mA", "0.001"),
    ("current_a", "ka", "kA", "1000"),
    ("voltage_v", "mv millivolt millivolts", "mV", "0.001"),
    ("voltage_v", "kv", "kV", "1000"),
    ("voltage_cmd_v", "mv", "mV", "0.001"),
    ("voltage_cmd_v", "kv", "kV", "1000"),
    ("bus_v", "mv", "mV", "0.001"),
    ("time_s", "ms msec millis milliseconds", "ms", "0.001"),
    ("time_s", "us usec micros \u{b5}s \u{3bc}s", "us", "0.000001"),
    ("time_s", "ns nanos", "ns", "0.000000001"),
    ("angle_rad", "deg degrees \u{b0}", "degrees", "0.01745329252"),
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
    fn a_unit_in_the_header_is_refused_unless_a_factor_is_given() {
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
