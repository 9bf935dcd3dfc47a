//! Units. Each balance holds in any unit of speed or current, so a wrong one shows only against the angle, a torque,
//! a nameplate, or a size that no motor has.

use std::f64::consts::{PI, TAU};

use super::table::{Activity, Balances, Coefficient, Roles, Table, back_emf_without_current};
use super::{Basis, Evidence, Fault, Finding, Kind, UnitFault};
use crate::claims::OF_BACK_EMF as OF_SPEED;
use drivebench_model::numerics::statistics::{largest, median, robust_deviation};
use drivebench_model::plant::{Model, MotorKey};
use drivebench_model::sample::{Channel, Origin, Run};
use drivebench_model::units::rpm_from_rad_s;

const DEGREES: f64 = 180.0 / PI;

/// Units that are taken for rad/s: `column = factor * true value`.
fn speed_units() -> [(f64, &'static str); 4] {
    [
        (rpm_from_rad_s(1.0), "r/min"),
        (DEGREES, "deg/s"),
        (1.0 / TAU, "turns per second"),
        (1e3, "mrad/s"),
    ]
}

/// Refuses a speed in one of those units.
fn not_rad_s((factor, seems): (f64, &'static str), evidence: Evidence) -> Finding {
    confused("speed_rad_s", [seems, "rad/s"], factor, evidence)
}

fn confused(
    key: &'static str,
    [seems, instead]: [&'static str; 2],
    factor: f64,
    evidence: Evidence,
) -> Finding {
    let fault = UnitFault::OtherUnit { key, seems, instead, factor, evidence };
    Finding::refusal(Kind::Unit, Fault::Unit(fault))
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
    let over_angle = speed_over_angle(run)?;
    if near(over_angle, 1.0, 0.05) {
        return None;
    }
    let is = |factor: f64| near(over_angle, factor, 0.02);
    let angle_units = [("degrees", 1.0 / DEGREES), ("turns", TAU)];
    if let Some((factor, unit)) = [(1e3, "ms"), (1e6, "us")].into_iter().find(|own| is(own.0)) {
        let fault = UnitFault::OtherTimeUnit { unit, factor, over_angle };
        return Some(Finding::refusal(Kind::Unit, Fault::Unit(fault)));
    }
    if let Some(unit) = speed_units().into_iter().find(|unit| is(unit.0)) {
        return Some(not_rad_s(unit, Evidence::Angle { over_angle }));
    }
    let both = [rpm_from_rad_s(1.0) / DEGREES, rpm_from_rad_s(1.0) * TAU];
    let mut units = both.into_iter().zip(angle_units);
    if let Some((_, (unit, to_rad))) = units.find(|(factor, _)| is(*factor)) {
        let fault = UnitFault::SpeedAndAngle { unit, to_rad, over_angle };
        return Some(Finding::refusal(Kind::Unit, Fault::Unit(fault)));
    }
    Some(if is(1.0 / DEGREES) || is(TAU) {
        let (unit, to_rad) = angle_units[usize::from(over_angle >= 1.0)];
        Finding::caution(
            Kind::Unit,
            &[],
            Fault::Unit(UnitFault::Angle { unit, to_rad, over_angle }),
        )
    } else if is(-1.0) {
        Finding::caution(Kind::Reversed, &[], Fault::Unit(UnitFault::AngleReversed { over_angle }))
    } else {
        let pairs = over_angle.round();
        let pole_pairs = ((2.0..=24.0).contains(&pairs) && is(pairs)).then_some(pairs);
        let fault = UnitFault::AngleDisagrees { over_angle, pole_pairs };
        Finding::caution(Kind::Unit, &OF_SPEED, Fault::Unit(fault))
    })
}

/// Tolerance by which a ratio of back-EMF constants shows a unit; temperature moves it by some per cent.
const BACK_EMF: f64 = 0.15;
/// Electrical time constant that no armature reaches, s.
pub const LONGEST_ARMATURE_S: f64 = 1.0;

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
        let fault = UnitFault::TimeInMs { period_s: table.period_s(), time_constant_s };
        findings.push(Finding::refusal(Kind::Unit, Fault::Unit(fault)));
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
    let evidence = Evidence::Model { back_emf: (found, given), resistance: windings };
    if like(1.0)
        && let Some(unit) =
            speed_units().into_iter().find(|unit| near(ratio * unit.0, 1.0, BACK_EMF))
    {
        return Some(not_rad_s(unit, evidence));
    }
    for (factor, current, voltage) in [(1e3, "mA", "mV"), (1e-3, "kA", "kV")] {
        if winding.is_some() && like(1.0 / factor) && near(ratio, 1.0, 3.0 * BACK_EMF) {
            return Some(confused("current_a", [current, "A"], factor, evidence));
        }
        if like(factor) && near(ratio, factor, BACK_EMF) {
            return Some(confused("voltage_v", [voltage, "V"], factor, evidence));
        }
    }
    // Phase against line, peak against r.m.s., electrical against mechanical speed, edges against lines, a gear: each is a
    // plain number, so only a hint.
    let hints = [
        (3f64.sqrt(), Basis::LineForPhase),
        (1.0 / 3f64.sqrt(), Basis::PhaseForLine),
        (2f64.sqrt(), Basis::PeakForRms),
        (1.0 / 2f64.sqrt(), Basis::RmsForPeak),
        (0.5, Basis::TwoPolePairs),
        (1.0 / 3.0, Basis::ThreePolePairs),
        (0.25, Basis::EdgesForLines),
        (4.0, Basis::LinesForEdges),
    ];
    if let Some((_, basis)) = hints.into_iter().find(|hint| near(ratio, hint.0, 0.03)) {
        let fault = UnitFault::OtherBasis { evidence, basis };
        return Some(Finding::caution(Kind::Unit, &OF_SPEED, Fault::Unit(fault)));
    }
    // Two motors of one winding within this ratio are one, more or less magnetised.
    let is_far = !(1.0 / 1.5..1.5).contains(&ratio);
    (is_far && winding.is_some() && like(1.0)).then(|| {
        Finding::caution(Kind::Unit, &OF_SPEED, Fault::Unit(UnitFault::Gear { evidence, ratio }))
    })
}

/// Kt = Ke in SI: with a torque and a current the factor between them is a unit.
fn against_torque(run: &Run, back_emf: f64) -> Option<Finding> {
    let (torque, current) = (run.column(Channel::Torque)?, run.column(Channel::Current)?);
    let both = torque.iter().zip(current).filter(|(t, i)| t.is_finite() && i.is_finite());
    let power: f64 = both.clone().map(|(_, i)| i * i).sum();
    let n_m_per_a = both.map(|(t, i)| t * i).sum::<f64>() / power;
    let ratio = n_m_per_a / back_emf;
    let unit = speed_units().into_iter().find(|unit| near(ratio, unit.0, BACK_EMF))?;
    Some(not_rad_s(unit, Evidence::Torque { n_m_per_a, back_emf }))
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
    let judged = |fault: UnitFault| {
        let touched = [
            MotorKey::Resistance,
            MotorKey::Inductance,
            MotorKey::TorqueConstant,
            MotorKey::Inertia,
            MotorKey::LoadTorque,
        ];
        if is_absurd {
            Finding::refusal(Kind::Unit, Fault::Unit(fault))
        } else if many_volts {
            Finding::of_all(Kind::Magnitude, false, Fault::Unit(fault))
        } else {
            Finding::caution(Kind::Magnitude, &touched, Fault::Unit(fault))
        }
    };
    let mut findings = Vec::new();
    if many_volts {
        findings.push(judged(UnitFault::Volts { key: table.voltage_key, volts }));
    }
    if milliamperes {
        findings.push(judged(UnitFault::Amperes { amperes, volts }));
    }
    findings
}

/// Speeds that hardly any motor has; `confirmed`: the unit is known otherwise, `by_angle`: an angle is its integral, so that
/// both may be in degrees, and not in r/min.
fn fast(table: &Table, confirmed: bool, by_angle: bool, back_emf: Option<f64>) -> Option<Finding> {
    let rad_s = largest(&table.speed_rad_s);
    // 9,549 r/min, or as many degrees per second as that are in r/min.
    let suspected = if by_angle { 1000.0 * DEGREES / rpm_from_rad_s(1.0) } else { 1000.0 };
    let fault = UnitFault::Fast { rad_s, by_angle, back_emf };
    (rad_s > suspected && !confirmed)
        .then(|| Finding::caution(Kind::Magnitude, &OF_SPEED, Fault::Unit(fault)))
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
    let (target, header) = (target.to_owned(), header.to_owned());
    Some(Finding::refusal(
        Kind::Unit,
        Fault::Unit(UnitFault::Header { target, header, unit, factor }),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_in_the_header_is_refused_unless_a_factor_is_given() {
        for (target, header, part) in [
            ("speed_rad_s", "rpm", "9.5493"),
            ("speed_rad_s", "Motor speed [RPM]", "\"0.104719755\""),
            ("speed_rad_s", "n (1/min)", "r/min"),
            ("current_a", "i mA", "\"0.001\""),
            ("time_s", "t_ms", "\"0.001\""),
            ("angle_rad", "pos (deg)", "degrees"),
        ] {
            let found = of_header(target, header, false).expect(header);
            let text = format!("{:?}", found.fault);
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
