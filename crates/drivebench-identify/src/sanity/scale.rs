//! Units. Each balance holds in any unit of speed or current, so a wrong one shows only against the angle, a torque,
//! a nameplate, or a size that no motor has.

use std::f64::consts::TAU;

use super::table::{Activity, Balances, Coefficient, Roles, Table, back_emf_without_current};
use super::{Basis, Evidence, Fault, Finding, Kind, UnitFault};
use crate::belief::{DEGREES, Range, Scaled, Settings, nearest, speed_units};
use crate::claims::OF_BACK_EMF as OF_SPEED;
use drivebench_model::numerics::statistics::{largest, median, robust_deviation};
use drivebench_model::plant::{Model, MotorKey};
use drivebench_model::sample::{Channel, Origin, Run};
use drivebench_model::units::rpm_from_rad_s;

/// Refuses a speed in one of the units of [`speed_units`].
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

fn near(ratio: f64, factor: f64, tolerance: f64) -> bool {
    (ratio / factor - 1.0).abs() < tolerance
}

/// Integral of the speed over the change of the angle, over windows of ten rows; `None` without both, or where they have no
/// constant ratio.
pub fn speed_over_angle(run: &Run) -> Option<f64> {
    let is_derived = |channel| run.origin(channel) == Origin::Derived;
    if is_derived(Channel::Speed) || is_derived(Channel::Angle) {
        return None;
    }
    let (angle, speed) = (run.column(Channel::Angle)?, run.column(Channel::Speed)?);
    let rows = run.time_s().iter().zip(angle).zip(speed);
    let rows = rows.map(|((time, angle), speed)| [*time, *angle, *speed]);
    let rows: Vec<[f64; 3]> = rows.filter(|row| row.iter().all(|cell| cell.is_finite())).collect();
    let area = |pair: &[[f64; 3]]| 0.5 * (pair[0][2] + pair[1][2]) * (pair[1][0] - pair[0][0]);
    let window = |chunk: &[[f64; 3]]| {
        let travel: f64 = chunk.windows(2).map(area).sum();
        [travel, chunk[9][1] - chunk[0][1]]
    };
    let windows: Vec<[f64; 2]> = rows.chunks_exact(10).map(window).collect();
    let largest = largest(windows.iter().map(|window| window[0]));
    let turning = windows.iter().filter(|[travel, _]| travel.abs() > 0.3 * largest);
    let ratios = turning.map(|[travel, turned]| travel / turned);
    let ratios: Vec<f64> = ratios.filter(|ratio| ratio.is_finite()).collect();
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
        let fault = UnitFault::Angle { unit, to_rad, over_angle };
        Finding::caution(Kind::Unit, &[], Fault::Unit(fault))
    } else if is(-1.0) {
        Finding::caution(Kind::Reversed, &[], Fault::Unit(UnitFault::AngleReversed { over_angle }))
    } else {
        let pairs = over_angle.round();
        let pole_pairs = ((2.0..=24.0).contains(&pairs) && is(pairs)).then_some(pairs);
        let fault = UnitFault::AngleDisagrees { over_angle, pole_pairs };
        Finding::caution(Kind::Unit, &OF_SPEED, Fault::Unit(fault))
    })
}

/// Electrical time constant L/R that no armature reaches, s.
pub const LONGEST_ARMATURE_S: f64 = 1.0;

/// A time axis in another unit, which shows in the time constant of the armature.
fn time_unit(found: &Balances, period_s: f64) -> Option<Finding> {
    let time_constant_s = found.inductance.value / found.resistance.value;
    let are_positive = found.inductance.is_positive() && found.resistance.is_positive();
    if !are_positive || time_constant_s <= LONGEST_ARMATURE_S {
        return None;
    }
    // Rows of a motor are 0.1 s apart at most, and in the unit before that they would be at least 10 s apart.
    let (unit, factor) = if period_s < 100.0 && time_constant_s < 1e3 {
        ("ms", 1e3)
    } else if period_s < 1e5 && time_constant_s < 1e6 {
        ("us", 1e6)
    } else {
        ("ns", 1e9)
    };
    let fault = UnitFault::Armature { unit, factor, period_s, time_constant_s };
    Some(Finding::refusal(Kind::Unit, Fault::Unit(fault)))
}

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
    findings.extend(balances.as_ref().and_then(|found| time_unit(found, table.period_s())));
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
    let ratio = found / given;
    let evidence = Evidence::Model { back_emf: (found, given), resistance: windings };
    let ratio_of = |key| match key {
        MotorKey::Resistance => winding,
        MotorKey::BackEmf => Some(ratio),
        _ => None,
    };
    let explains = |scaled: Scaled, factor: f64| {
        let within = |key| match (key, scaled) {
            // Resistances within this ratio may be those of one winding, hot and cold, with its cable.
            (MotorKey::Resistance, _) => Settings::ANY_FACTOR.high.ln(),
            // A current shows in the resistance; a back-EMF constant need only be that of another specimen.
            (_, Scaled::Current) => Settings::FLUX_FACTOR.high.ln(),
            _ => Settings::UNIT,
        };
        scaled.explains(factor, ratio_of, within).is_some()
    };
    if let Some(unit) = speed_units().into_iter().find(|unit| explains(Scaled::Speed, unit.0)) {
        return Some(not_rad_s(unit, evidence));
    }
    for (factor, current, voltage) in [(1e3, "mA", "mV"), (1e-3, "kA", "kV")] {
        if winding.is_some() && explains(Scaled::Current, factor) {
            return Some(confused("current_a", [current, "A"], factor, evidence));
        }
        if explains(Scaled::Voltage, factor) {
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
    if let Some((_, basis)) = nearest(ratio, &hints, 0.03) {
        let fault = UnitFault::OtherBasis { evidence, basis };
        return Some(Finding::caution(Kind::Unit, &OF_SPEED, Fault::Unit(fault)));
    }
    // Two motors of one winding within this ratio are one, more or less magnetised.
    let is_far = !(1.0 / 1.5..1.5).contains(&ratio);
    let is_like = winding.is_some_and(|ratio| Settings::ANY_FACTOR.gap(Range::at(ratio)) <= 0.0);
    (is_far && is_like).then(|| {
        Finding::caution(Kind::Unit, &OF_SPEED, Fault::Unit(UnitFault::Gear { evidence, ratio }))
    })
}

/// Kt = Ke in SI: with a torque and a current the factor between them is a unit.
fn against_torque(run: &Run, back_emf: f64) -> Option<Finding> {
    let (torque, current) = (run.column(Channel::Torque)?, run.column(Channel::Current)?);
    let both = torque.iter().zip(current).filter(|(t, i)| t.is_finite() && i.is_finite());
    let power: f64 = both.clone().map(|(_, i)| i * i).sum();
    let n_m_per_a = both.map(|(t, i)| t * i).sum::<f64>() / power;
    let unit = nearest(n_m_per_a / back_emf, &speed_units(), Settings::UNIT)?;
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
        use MotorKey::{Inductance, Inertia, LoadTorque, Resistance, TorqueConstant};
        let of_current = [Resistance, Inductance, TorqueConstant, Inertia, LoadTorque];
        let fault = Fault::Unit(fault);
        match (is_absurd, many_volts) {
            (true, _) => Finding::refusal(Kind::Unit, fault),
            (_, true) => Finding::of_all(Kind::Magnitude, false, fault),
            _ => Finding::caution(Kind::Magnitude, &of_current, fault),
        }
    };
    let of_volts = many_volts.then_some(UnitFault::Volts { key: table.voltage_key, volts });
    let of_amperes = milliamperes.then_some(UnitFault::Amperes { amperes, volts });
    of_volts.into_iter().chain(of_amperes).map(judged).collect()
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

type Entry = (&'static str, &'static str, &'static str, &'static str);

/// Units of columns: `(target, names without blanks, unit, factor to the target's)`. The target's own unit has the factor 1. A
/// word in capitals stands for a number that no file contains. A linear axis has force, travel and m/s.
const UNITS: &[Entry] = &[
    // Of no target, and before all others: a frequency is a speed only where a map takes it for one.
    (
        "",
        "w watt watts kw mw hz khz g m/s2 m/s^2 m/s\u{b2} km/h mph kgf gf kg \u{b0}f ohm gf/w ips in bar pa",
        "of another quantity",
        "1",
    ),
    ("duty", "% percent prozent pourcent", "%", "0.01"),
    ("speed_rad_s", "krpm", "1000 r/min", "104.719755"),
    (
        "speed_rad_s",
        "rpm r/min u/min rev/min revolutions/minute rotations/minute 1/min min-1 min^-1 min\u{207b}\u{b9} tr/min giri/min",
        "r/min",
        "0.104719755",
    ),
    (
        "speed_rad_s",
        "deg/s deg/sec deg/second dps degrees/s degrees/sec degrees/second \u{b0}/s \u{b0}/sec",
        "deg/s",
        "0.01745329252",
    ),
    (
        "speed_rad_s",
        "rps rev/s revs/s turn/s turns/s turns/sec turns/second rotations/s rotations/sec rotations/second revolutions/second r/s hz",
        "turns/s",
        "6.283185307",
    ),
    ("speed_rad_s", "mrad/s", "mrad/s", "0.001"),
    ("speed_rad_s", "m/s m/sec", "m/s", "1"),
    ("speed_rad_s", "mm/s mm/sec", "mm/s", "0.001"),
    (
        "speed_rad_s",
        "count/s counts/s cnt/s cnts/s inc/s incs/s tick/s ticks/s pulse/s pulses/s step/s steps/s qc/s",
        "counts/s",
        "6.283185307/COUNTS_PER_TURN",
    ),
    ("current_a", "ma milliamp milliamps milliampere", "mA", "0.001"),
    ("current_a", "ka", "kA", "1000"),
    ("voltage_v", "mv millivolt millivolts", "mV", "0.001"),
    ("voltage_v", "kv", "kV", "1000"),
    ("time_s", "ms msec millis millisecond milliseconds", "ms", "0.001"),
    ("time_s", "us usec micros microseconds \u{b5}s \u{3bc}s", "us", "0.000001"),
    ("time_s", "ns nsec nanos nanoseconds", "ns", "0.000000001"),
    ("time_s", "min minutes", "min", "60"),
    ("angle_rad", "deg degree degrees \u{b0}", "degrees", "0.01745329252"),
    ("angle_rad", "rev revs turn turns", "turns", "6.283185307"),
    ("angle_rad", "mrad", "mrad", "0.001"),
    ("angle_rad", "m meter meters metre metres", "m", "1"),
    ("angle_rad", "mm", "mm", "0.001"),
    (
        "angle_rad",
        "count counts cnt cnts inc incs tick ticks pulse pulses step steps qc",
        "counts",
        "6.283185307/COUNTS_PER_TURN",
    ),
    ("torque_n_m", "mnm nmm mn.m n.mm", "mN.m", "0.001"),
    ("torque_n_m", "ncm n.cm", "N.cm", "0.01"),
    ("torque_n_m", "kgcm kg.cm kgfcm kgf.cm kg*cm", "kgf.cm", "0.0980665"),
    ("torque_n_m", "ozin oz.in oz-in ozfin ozf.in", "ozf.in", "0.007061552"),
    ("torque_n_m", "lbin lb.in lb-in lbfin lbf.in in.lbf", "lbf.in", "0.112984829"),
    ("torque_n_m", "lbft lb.ft lb-ft ftlb ft.lb lbfft lbf.ft", "lbf.ft", "1.355817948"),
    ("torque_n_m", "n newton newtons", "N", "1"),
    ("torque_n_m", "permille \u{2030}", "per mille of the rated torque", "0.001*RATED_TORQUE_N_M"),
    (
        "speed_rad_s",
        "rad/s rad/sec rads/s rad/second radians/s radians/sec radians/second rad.s-1 rad\u{b7}s-1 rad*s^-1 rad\u{b7}s\u{207b}\u{b9} 1/s s-1 s^-1",
        "rad/s",
        "1",
    ),
    ("current_a", "a amp amps ampere amperes", "A", "1"),
    ("voltage_v", "v volt volts", "V", "1"),
    ("time_s", "s sec secs second seconds", "s", "1"),
    ("angle_rad", "rad radian radians", "rad", "1"),
    ("torque_n_m", "nm n.m n\u{b7}m n*m", "N.m", "1"),
    ("temperature_c", "c \u{b0}c degc celsius", "C", "1"),
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ColumnUnit {
    pub name: &'static str,
    /// To the unit of the target, as it stands in a map.
    pub factor: &'static str,
}

fn named(is_named: impl Fn(&str) -> bool) -> impl Iterator<Item = &'static Entry> {
    UNITS.iter().filter(move |row| row.1.split(' ').any(&is_named))
}

/// A unit of this target that needs no further number.
fn unit(target: &str, is_named: impl Fn(&str) -> bool) -> Option<ColumnUnit> {
    // Targets of one quantity.
    let target = match target {
        "voltage_cmd_v" | "bus_v" => "voltage_v",
        "reference_rad_s" => "speed_rad_s",
        "time_half_width_s" => "time_s",
        other => other,
    };
    let row = named(is_named).find(|row| row.0 == target && row.3.parse::<f64>().is_ok())?;
    Some(ColumnUnit { name: row.2, factor: row.3 })
}

/// A unit that stands alone, as `mA`, `(ms)` or `[rad/s]`; `None` where it is none of this target.
pub fn unit_of(target: &str, text: &str) -> Option<ColumnUnit> {
    let text = bare_unit(text);
    unit(target, |name| name == text)
}

/// The unit of any quantity, and its target; the target is empty for quantities that no map needs. The factor may have a
/// number that no file contains: `A*NAME` or `A/NAME`.
pub fn any_unit(text: &str) -> Option<(&'static str, ColumnUnit)> {
    let text = bare_unit(text);
    let row = named(move |name| name == text).next()?;
    Some((row.0, ColumnUnit { name: row.2, factor: row.3 }))
}

pub fn is_unit(text: &str) -> bool {
    any_unit(text).is_some()
}

/// In small letters, without blanks and brackets.
fn bare_unit(text: &str) -> String {
    let bare = text.trim().trim_matches(|letter| "()[]{}<>".contains(letter));
    bare.to_lowercase().split_whitespace().collect()
}

/// The unit that a header names where it is not the target's. `scaled`: the map gives a factor, so somebody thought of it.
pub fn of_header(target: &str, header: &str, scaled: bool) -> Option<Finding> {
    if scaled {
        return None;
    }
    let header_lower = header.to_lowercase();
    let is_break = |letter: char| letter.is_whitespace() || "_,;:()[]{}|\"".contains(letter);
    let words: Vec<&str> = header_lower.split(is_break).collect();
    let ColumnUnit { name: unit, factor } =
        unit(target, |name| words.contains(&name)).filter(|unit| unit.factor != "1")?;
    let (target, header) = (target.to_owned(), header.to_owned());
    let fault = UnitFault::Header { target, header, unit, factor };
    Some(Finding::refusal(Kind::Unit, Fault::Unit(fault)))
}

/// Unit and factor of stamps that can be no seconds: `first` as it stands in the file, `step` to the next one.
pub fn unit_of_stamps(first: f64, step: f64) -> Option<ColumnUnit> {
    // Seconds since 1970 of the years 2000 to 2100.
    let is_epoch = |factor: f64| (9.4e8..4.2e9).contains(&(first * factor));
    let (name, factor) = if is_epoch(1e-3) {
        ("ms since 1970", "0.001")
    } else if is_epoch(1e-6) {
        ("us since 1970", "0.000001")
    } else if is_epoch(1e-9) {
        ("ns since 1970", "0.000000001")
    } else if (25_000.0..75_000.0).contains(&first) && step > 0.0 && step < 5e-6 {
        // Of the years 1968 to 2105; as seconds they would be more than 200,000 rows a second.
        ("days of a spreadsheet", "86400")
    } else if (1e3..1e5).contains(&step) {
        // No record of a motor has rows more than a minute apart.
        ("us", "0.000001")
    } else if step >= 1e5 {
        ("ns", "0.000000001")
    } else {
        return None;
    };
    Some(ColumnUnit { name, factor })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_in_the_header_is_refused_unless_a_factor_is_given() {
        for (target, header, part) in [
            ("speed_rad_s", "rpm", "r/min"),
            ("torque_n_m", "M [kgcm]", "0.0980665"),
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

    #[test]
    fn a_unit_alone_gives_its_factor() {
        for (target, text, factor) in [
            ("time_s", "(ms)", Some("0.001")),
            ("time_s", "sec", Some("1")),
            ("voltage_cmd_v", "[mV]", Some("0.001")),
            ("reference_rad_s", "RPM", Some("0.104719755")),
            ("speed_rad_s", "rad / s", Some("1")),
            ("current_a", "ms", None),
            ("current_a", "counts", None),
        ] {
            assert_eq!(unit_of(target, text).map(|unit| unit.factor), factor, "{target} {text}");
        }
        assert!(is_unit("(counts)") && !is_unit("colour"));
        let found = any_unit("counts/s").unwrap();
        assert_eq!((found.0, found.1.factor), ("speed_rad_s", "6.283185307/COUNTS_PER_TURN"));
    }

    #[test]
    fn stamps_that_are_no_seconds() {
        for (first, step, factor) in [
            (1.714e12, 2.0, Some("0.001")),
            (1.714e15, 2e3, Some("0.000001")),
            (1.714e18, 2e6, Some("0.000000001")),
            (45_418.5, 2.3e-8, Some("86400")),
            // Seconds since 1970, of the day, and ms of the day.
            (1.714e9, 2e-3, None),
            (45_418.5, 1e-4, None),
            (4.32e7, 2.0, None),
            // By their step.
            (0.0, 2e3, Some("0.000001")),
            (0.0, 2e6, Some("0.000000001")),
            (0.0, 100.0, None),
        ] {
            assert_eq!(unit_of_stamps(first, step).map(|unit| unit.factor), factor, "{first}");
        }
    }

    #[test]
    fn a_time_constant_shows_the_unit_of_the_time() {
        let clear = |value| Coefficient { value, std: 0.0 };
        let balances = |inductance| Balances {
            resistance: clear(1.0),
            inductance: clear(inductance),
            back_emf: clear(0.05),
            voltage_error: 0.0,
            inertia: clear(1e-3),
            torque_error: 0.0,
        };
        // An armature of 0.5 ms and one of 20 ms, rows 0.5 ms and 20 ms apart.
        for (unit, to_seconds) in [("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)] {
            for (constant_s, period_s) in [(0.5e-3, 0.5e-3), (0.5e-3, 2e-3), (20e-3, 20e-3)] {
                let found = time_unit(&balances(constant_s / to_seconds), period_s / to_seconds);
                if let Some(found) = &found {
                    let text = format!("{:?}", found.fault);
                    assert!(text.contains(&format!("{unit:?}")), "{constant_s}: {text}");
                }
                // Half a millisecond written in ms could be half a second.
                assert_eq!(found.is_some(), constant_s / to_seconds > 1.0);
            }
        }
        assert_eq!(time_unit(&balances(0.01), 0.001), None);
    }
}
