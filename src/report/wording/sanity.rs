//! Faults of data: the evidence with its figures, and what to do about it.

use std::f64::consts::PI;

use drivebench_identify::sanity::{
    Basis, ColumnFault, Evidence, Fault, Finding, LONGEST_ARMATURE_S, Level, Mapping, Masked,
    SignalFault, UnitFault,
};
use drivebench_model::plant::MotorKey;
use drivebench_model::units::{rad_s_from_rpm, rpm_from_rad_s};

const DEGREES: f64 = 180.0 / PI;
/// Factors of the commands that convert a column.
pub(super) const RAD_S_PER_RPM: &str = "0.104719755";
const RAD_PER_DEGREE: &str = "0.017453293";
/// The option that maps the columns of the run.
pub const MAP: &str = "--map";

const fn rows_of(count: usize) -> &'static str {
    if count == 1 { "row" } else { "rows" }
}

pub fn fault(fault: &Fault) -> String {
    match fault {
        Fault::Signal(own) => signal(own),
        Fault::Column(own) => column(own),
        Fault::Unit(own) => unit(own),
    }
}

/// What to do about a fault, with the option that maps the columns of its run.
pub fn help(fault: &Fault, map: &str) -> String {
    match fault {
        Fault::Signal(own) => help_for_signal(own),
        Fault::Column(own) => help_for_column(own, map),
        Fault::Unit(own) => help_for_unit(own, map),
    }
}

/// What to do about each; a remedy of two findings stands with the first.
pub fn helps(findings: &[Finding]) -> Vec<String> {
    let mut helps: Vec<String> = Vec::new();
    for finding in findings {
        let own = help(&finding.fault, MAP);
        helps.push(if helps.contains(&own) { String::new() } else { own });
    }
    helps
}

fn signal(fault: &SignalFault) -> String {
    match fault {
        SignalFault::AtRest { duration_s, levels: own } => format!(
            "the motor stands still and nothing changes for {duration_s:.3} s ({}): there is nothing to identify",
            levels(own)
        ),
        SignalFault::OperatingPoint { duration_s, levels: own } => format!(
            "nothing changes for {duration_s:.3} s ({}): one operating point is one equation for all unknowns",
            levels(own)
        ),
        SignalFault::CurrentConstant { level_a, rows, voltage, volts: [least, most] } => format!(
            "current_a is {level_a} A in all {rows} rows while {voltage} changes between {least:.4} and {most:.4} V and the \
             speed follows: the current is not measured"
        ),
        SignalFault::CoastDown { speeds_rad_s: [least, most], volts } => format!(
            "the current stays 0 A while the speed goes from {least:.4} to {most:.4} rad/s at a stated voltage of {volts:.4} \
             V: the terminals are open, so the stated voltage is not the motor's"
        ),
        SignalFault::CoastDownInside { rows, from_s, level_a } => format!(
            "in {rows} rows from {from_s:.3} s on the voltage is stated as 0 V and the shaft turns, but the current is \
             {level_a:.3} A: the terminals are open there, so no voltage is known and no balance of voltages holds"
        ),
        SignalFault::SpeedConstant { level_rad_s, rows } => format!(
            "speed_rad_s is {level_rad_s} rad/s in all {rows} rows while the current changes: the speed is not measured"
        ),
        SignalFault::SpeedZero { unexplained } => format!(
            "the speed reads 0 rad/s throughout, but resistance and inductance leave {:.0} % of the voltage unexplained: the \
             shaft turns and the speed is not measured",
            100.0 * unexplained
        ),
        SignalFault::SpeedDead { from_s, to_s, unexplained } => format!(
            "speed_rad_s is exactly 0 from {from_s:.3} to {to_s:.3} s, but resistance and inductance leave {:.0} % of the \
             voltage there unexplained: the shaft turns and its sensor is dead",
            100.0 * unexplained
        ),
        SignalFault::ShaftAtRest { duration_s, noise_rad_s } => format!(
            "the shaft does not turn in {duration_s:.3} s (speed 0 +- {noise_rad_s:.2} rad/s): only resistance and inductance \
             can be found"
        ),
        SignalFault::Outlier { key, at_s, value, neighbours: [before, after], count, of } => {
            format!(
                "{key} reads {value:.4} at {at_s:.4} s between {before:.4} and {after:.4} ({count} such {} of {of}): no machine \
             moves like that",
                rows_of(*count)
            )
        }
        SignalFault::CounterOverflows { key, jump, counts, rows, at_s, values: [from, to] } => {
            let counts = match counts {
                Some(counts) => format!("{counts} counts of its step"),
                None => "65536 counts, if it has 16 bits".to_owned(),
            };
            format!(
                "{key} jumps by {jump:.4} from one end of its range to the other ({counts}) in {rows} rows, first at \
                 {at_s:.4} s from {from:.4} to {to:.4}, while nothing drives it there: a counter that overflows to the other \
                 sign"
            )
        }
        SignalFault::SignLost { key, values: [least, most], voltage, rows } => format!(
            "{key} is never negative (least {least:.4}, largest {most:.4}) although {voltage} reverses for {rows} rows: it has \
             lost its sign"
        ),
        SignalFault::VoltageSignLost { voltage, speeds_rad_s: [least, most], rows } => format!(
            "{voltage} is never negative although the speed runs from {least:.4} to {most:.4} rad/s, and is clearly positive \
             in {rows} rows that run backward: it has lost its sign"
        ),
        SignalFault::Froze { key, value, rows, from_s, to_s } => format!(
            "{key} repeats {value} for {rows} rows from {from_s:.3} to {to_s:.3} s while the other signals move: its source \
             froze"
        ),
        SignalFault::HeldLikeACommand { key, jumps, largest } => format!(
            "{key} stands exactly still between {jumps} jumps of up to {largest:.4}, as a command does and no measurement: is \
             it in another signal's column?"
        ),
        SignalFault::CutOff { key, levels, rows, share, plateaus } => {
            let levels: Vec<String> = levels.iter().map(|level| format!("{level:.6}")).collect();
            format!(
                "{key} stands at exactly {} in {rows} rows ({:.1} %) on {plateaus} plateaus where it would go further: it is \
                 cut off there",
                levels.join(" or "),
                100.0 * share
            )
        }
    }
}

fn levels(all: &[Level]) -> String {
    let each = all.iter().map(|Level { signal, unit, mean, noise }| {
        let noise = noise.map_or_else(String::new, |noise| format!(" +- {noise:.2}"));
        format!("{signal} {mean:.4}{noise} {unit}")
    });
    each.collect::<Vec<_>>().join(", ")
}

fn help_for_signal(fault: &SignalFault) -> String {
    let help = match fault {
        SignalFault::AtRest { .. } => {
            "excite the motor: steps of voltage in both directions, with some time at rest first"
        }
        SignalFault::OperatingPoint { .. } => {
            "excite the motor: steps of voltage in both directions; record the transients too"
        }
        SignalFault::CurrentConstant { .. } => {
            "leave the column out of --map (voltage and speed alone still give the back-EMF constant), or repair the sensor"
        }
        SignalFault::CoastDown { .. } => {
            "leave the voltage out of --map, and give torque_n_m_per_a with --model: the coast-down then gives the torque balance"
        }
        SignalFault::CoastDownInside { .. } => {
            "cut the coast-down out of the file; on its own, without a voltage and with torque_n_m_per_a given, it shows the torque balance"
        }
        SignalFault::SpeedConstant { .. } => "leave the column out of --map, or repair the sensor",
        SignalFault::SpeedZero { .. } => "check the speed sensor, or leave the column out of --map",
        SignalFault::SpeedDead { .. } => {
            "check the encoder and its cable; cut the stretch out of the file"
        }
        SignalFault::ShaftAtRest { .. } => {
            "for the other parameters the shaft must be free to turn and the voltage high enough to break it away"
        }
        SignalFault::Outlier { .. } => {
            "leave the cell empty: an empty cell is a missing value; look for noise on the line or a torn transmission"
        }
        SignalFault::CounterOverflows { jump, .. } => {
            return format!(
                "add or subtract {jump:.4} in the rows behind each jump until the next one, or log the signal with more bits \
                 or in a coarser unit"
            );
        }
        SignalFault::SignLost { key: "current_a", .. } => {
            "a supply or rectified current has no direction; map the armature current, with its sign"
        }
        SignalFault::SignLost { .. } => "map the speed with its sign, or the angle",
        SignalFault::VoltageSignLost { .. } => {
            "map the voltage with its sign (a duty or bus voltage alone has none)"
        }
        SignalFault::Froze { .. } => {
            "leave such cells empty (a missing value is never a repeat), or cut the stretch out of the file"
        }
        SignalFault::HeldLikeACommand { .. } => {
            "map the measured column; a commanded voltage is voltage_cmd_v, a commanded speed reference_rad_s"
        }
        SignalFault::CutOff { .. } => {
            "raise the range of the instrument or excite less; or leave the cut-off cells empty"
        }
    };
    help.to_owned()
}

/// A coefficient as the balances give it.
pub(super) fn gives(&(key, value): &(MotorKey, f64)) -> String {
    let name = match key {
        MotorKey::Inertia => "an inertia",
        MotorKey::BackEmf => "a back-EMF constant",
        _ => "a resistance",
    };
    format!("{name} of {value:.3e}")
}

fn column(fault: &ColumnFault) -> String {
    match fault {
        ColumnFault::SignReversed(mapping) | ColumnFault::Exchanged(mapping) => another(mapping),
        ColumnFault::Impossible { coefficient, left: [voltage, torque] } => format!(
            "the balances of voltage and torque give {}, which no motor has, and no exchange of columns or signs mends it \
             (they leave {:.0} % and {:.0} % unexplained)",
            gives(coefficient),
            100.0 * voltage,
            100.0 * torque
        ),
        ColumnFault::OfSupply { voltage, volts: [least, most], coefficient } => format!(
            "{voltage} stays between {least:.4} and {most:.4} V whatever the motor does, as that of a supply, and with it the \
             balances give {}: it is not the voltage at the motor's terminals",
            gives(coefficient)
        ),
    }
}

fn another(mapping: &Mapping) -> String {
    let names = ["voltage", "current", "speed"];
    let moved: Vec<usize> = (0..3).filter(|role| mapping.place[*role] != *role).collect();
    let what = match (moved.as_slice(), mapping.reversed) {
        ([], Some(role)) => format!("the sign of the {} is reversed", names[role]),
        ([first, second], _) => format!("{} and {} are swapped", names[*first], names[*second]),
        _ => "voltage, current and speed stand in each other's columns".to_owned(),
    };
    let [given, found] = mapping.left.map(|left| left.map(|share| 100.0 * share));
    let why = match &mapping.impossible {
        Some(coefficient) => format!("as mapped, the balances give {}", gives(coefficient)),
        None => format!(
            "as mapped, the balances leave {:.0} % of the voltage and {:.0} % of the current unexplained",
            given[0], given[1]
        ),
    };
    format!(
        "it seems that {what}: {why}; the other way round they leave {:.0} % and {:.0} %, with every parameter positive",
        found[0], found[1]
    )
}

fn help_for_column(fault: &ColumnFault, option: &str) -> String {
    let help = match fault {
        ColumnFault::SignReversed(mapping) | ColumnFault::Exchanged(mapping) => {
            let Mapping { keys, place, reversed, .. } = mapping;
            let map: Vec<String> = (0..3)
                .filter(|role| place[*role] != *role || *reversed == Some(*role))
                .map(|role| {
                    let sign = if *reversed == Some(role) { "*-1" } else { "" };
                    format!("{}=(column of {}){sign}", keys[role], keys[place[role]])
                })
                .collect();
            return format!("map them as {option} {}", map.join(","));
        }
        ColumnFault::Impossible { .. } => {
            "check columns, signs and units of voltage, current and speed; a supply current is not the armature current"
        }
        ColumnFault::OfSupply { .. } => {
            "map duty times supply, as voltage_v=DUTY*BUS, or map torque_n_m and the speed alone; a current taken at the \
             supply is declared by --origin current_a=supply"
        }
    };
    help.to_owned()
}

fn unit(fault: &UnitFault) -> String {
    let over = |over_angle: &f64| evidence(&Evidence::Angle { over_angle: *over_angle });
    match fault {
        UnitFault::OtherUnit { key, seems, instead, factor, evidence: own } => format!(
            "{key} seems to be in {seems}, not in {instead} (a factor {factor:.4}): {}",
            evidence(own)
        ),
        UnitFault::OtherTimeUnit { unit, factor, over_angle } => format!(
            "time_s seems to be in {unit}, not in s (a factor {factor}): {}",
            over(over_angle)
        ),
        UnitFault::SpeedAndAngle { unit, over_angle, .. } => format!(
            "speed_rad_s seems to be in r/min (a factor 9.5493) and angle_rad in {unit}: {}",
            over(over_angle)
        ),
        UnitFault::Angle { unit, over_angle, .. } => {
            format!("angle_rad seems to be in {unit}, not in rad: {}", over(over_angle))
        }
        UnitFault::AngleReversed { over_angle } => {
            format!("angle and speed count in opposite directions: {}", over(over_angle))
        }
        UnitFault::AngleDisagrees { over_angle, pole_pairs: Some(pairs) } => {
            format!("{}; is the speed electrical, with {pairs} pole pairs?", over(over_angle))
        }
        UnitFault::AngleDisagrees { over_angle, pole_pairs: None } => format!(
            "{}; one of them is in another unit (counts?), or on the other side of a gear",
            over(over_angle)
        ),
        UnitFault::Armature { unit, factor, period_s, time_constant_s } => {
            let digits =
                |of: &f64| if *of < 1e-3 { format!("{of:.3e}") } else { format!("{of:.4}") };
            format!(
                "time_s seems to be in {unit}, not in s (a factor {factor}): the rows are {} s apart and the \
                 armature would have a time constant L/R of {} s, while none exceeds {LONGEST_ARMATURE_S} s",
                digits(period_s),
                digits(time_constant_s)
            )
        }
        UnitFault::OtherBasis { evidence: own, basis: of } => {
            format!("{}: has the column {}?", evidence(own), basis(*of))
        }
        UnitFault::Gear { evidence: own, ratio } => {
            let (gear, side) = if *ratio > 1.0 { (*ratio, "slow") } else { (1.0 / ratio, "fast") };
            format!(
                "{}, the same winding: does the encoder stand on the {side} side of a gear of {gear:.3}?",
                evidence(own)
            )
        }
        UnitFault::Volts { key, volts } => {
            format!("{key} reaches {volts:.0} V: if it is in mV, it is 1000 times too large")
        }
        UnitFault::Amperes { amperes, volts } => format!(
            "current_a reaches {amperes:.0} A at {volts:.1} V: if it is in mA, it is 1000 times too large"
        ),
        UnitFault::Fast { rad_s, by_angle, back_emf } => fast(*rad_s, *by_angle, *back_emf),
        UnitFault::Header { target, header, unit, .. } => {
            format!("--map {target}={header}: the header names {unit}, and no factor is given")
        }
    }
}

fn evidence(evidence: &Evidence) -> String {
    match evidence {
        Evidence::Angle { over_angle } => {
            format!("the integral of speed_rad_s is {over_angle:.4} times the change of angle_rad")
        }
        Evidence::Model { back_emf: (found, given), resistance } => {
            let winding = resistance.map_or_else(String::new, |(found, given)| {
                format!(", a resistance of {found:.4e} ohm, the model {given:.4e}")
            });
            format!(
                "this run gives a back-EMF constant of {found:.4e} V.s/rad, the model {given:.4e} ({:.3} times as \
                 much){winding}",
                given / found
            )
        }
        Evidence::Torque { n_m_per_a, back_emf } => format!(
            "torque over current is {n_m_per_a:.4e} N.m/A, the back-EMF constant {back_emf:.4e} V.s/rad, equal in SI"
        ),
    }
}

const fn basis(basis: Basis) -> &'static str {
    match basis {
        Basis::LineForPhase => "line for phase values (sqrt 3)",
        Basis::PhaseForLine => "phase for line values (sqrt 3)",
        Basis::PeakForRms => "peak for r.m.s. values (sqrt 2)",
        Basis::RmsForPeak => "r.m.s. for peak values (sqrt 2)",
        Basis::TwoPolePairs => "electrical speed of two pole pairs (2)",
        Basis::ThreePolePairs => "electrical speed of three pole pairs (3)",
        Basis::EdgesForLines => {
            "quadrature edges counted as lines, or electrical speed of four pole pairs (4)"
        }
        Basis::LinesForEdges => "lines counted as quadrature edges (4)",
    }
}

fn fast(rad_s: f64, by_angle: bool, back_emf: Option<f64>) -> String {
    let per_minute = rpm_from_rad_s(1.0);
    let constant = |factor: f64| {
        back_emf.map_or_else(String::new, |found| {
            let other = found * factor;
            format!(", and the back-EMF constant {other:.4} instead of {found:.4} V.s/rad")
        })
    };
    let reaches =
        format!("speed_rad_s reaches {rad_s:.0} rad/s, that is {:.0} r/min", rpm_from_rad_s(rad_s));
    let degrees = format!(
        "in deg/s (a factor {DEGREES:.4}), it is {:.0} rad/s{}",
        rad_s / DEGREES,
        constant(DEGREES)
    );
    if by_angle {
        format!(
            "{reaches}, and angle_rad is its integral; if the columns are in degrees and {degrees}"
        )
    } else {
        format!(
            "{reaches}; if the column is in r/min (a factor {per_minute:.4}), it is {:.0} rad/s{}; if it is {degrees}",
            rad_s_from_rpm(rad_s),
            constant(per_minute)
        )
    }
}

fn help_for_unit(fault: &UnitFault, map: &str) -> String {
    let confirm = "or confirm it with --origin speed_rad_s=measured";
    match fault {
        UnitFault::OtherUnit { key, factor, .. } => {
            format!("convert it with {map} {key}=COLUMN*{:.9}", 1.0 / factor)
        }
        UnitFault::OtherTimeUnit { factor, .. } | UnitFault::Armature { factor, .. } => {
            format!("convert it with {map} time_s=COLUMN*{}", 1.0 / factor)
        }
        UnitFault::SpeedAndAngle { to_rad, .. } => format!(
            "convert them with {map} speed_rad_s=COLUMN*{RAD_S_PER_RPM},angle_rad=COLUMN*{to_rad:.9}"
        ),
        UnitFault::Angle { to_rad, .. } => {
            format!("convert it with {map} angle_rad=COLUMN*{to_rad:.9}")
        }
        UnitFault::AngleReversed { .. } => {
            format!("turn one of them with {map} angle_rad=COLUMN*-1")
        }
        UnitFault::AngleDisagrees { .. } => "map the angle in rad, or leave it out".to_owned(),
        UnitFault::OtherBasis { .. } => {
            "check on which basis the nameplate and the columns are given".to_owned()
        }
        UnitFault::Gear { ratio, .. } => {
            format!("if so, convert it with {map} speed_rad_s=COLUMN*{ratio:.6}")
        }
        UnitFault::Volts { key, .. } => format!("convert it with {map} {key}=COLUMN*0.001"),
        UnitFault::Amperes { .. } => format!("convert it with {map} current_a=COLUMN*0.001"),
        UnitFault::Fast { by_angle: true, .. } => format!(
            "convert them with {map} speed_rad_s=COLUMN*{RAD_PER_DEGREE},angle_rad=COLUMN*{RAD_PER_DEGREE}, {confirm}"
        ),
        UnitFault::Fast { .. } => format!(
            "convert it with {map} speed_rad_s=COLUMN*{RAD_S_PER_RPM} (r/min) or speed_rad_s=COLUMN*{RAD_PER_DEGREE} (deg/s), \
             {confirm}"
        ),
        UnitFault::Header { target, header, factor, .. } => format!(
            "write {target}={header}*{factor}; if the column is in the unit of {target} all the same, write {target}={header}*1"
        ),
    }
}

pub fn masked(masked: &Masked) -> String {
    match masked {
        Masked::Code { channel, value, rows, of, first_s, others: (least, most) } => {
            let why = if value.abs() > 0.0 {
                format!(", far from all others ({least:.4} to {most:.4})")
            } else {
                " between values that agree and are far from it: no machine moves like that"
                    .to_owned()
            };
            format!(
                "{} reads exactly {value} in {rows} {} of {of} (first at {first_s:.4} s){why}: it stands for a missing value, \
                 and the cells are taken as missing",
                channel.key(),
                rows_of(*rows)
            )
        }
        Masked::TelemetryFroze { channels, stretches, longest_s, from_s, rows } => {
            let keys: Vec<&str> = channels.iter().map(|channel| channel.key()).collect();
            format!(
                "{} stand exactly still in {stretches} {} of up to {longest_s:.3} s (first from {from_s:.3} s on) while the \
                 motor runs: the telemetry froze, and {rows} rows that repeat the last one are taken as missing",
                keys.join(", "),
                if *stretches == 1 { "stretch" } else { "stretches" }
            )
        }
        Masked::SampledAndHeld { channel, every_s, period_s, cells } => format!(
            "{} takes a new value every {every_s:.4} s and the rows are {period_s:.4} s apart: it is sampled and held, and \
             {cells} cells that only repeat it are taken as missing",
            channel.key()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_identify::sanity::Kind;

    #[test]
    fn a_fault_has_its_figures_and_its_remedy_which_stands_once() {
        let swapped = Mapping {
            keys: ["voltage_v", "current_a", "speed_rad_s"],
            place: [1, 0, 2],
            reversed: None,
            impossible: Some((MotorKey::Inertia, -2e-4)),
            left: [[0.4, 0.9], [0.01, 0.02]],
        };
        let reversed = Mapping { place: [0, 1, 2], reversed: Some(2), ..swapped.clone() };
        let time = UnitFault::OtherTimeUnit { unit: "us", factor: 1e6, over_angle: 1e6 };
        let all = [
            Fault::Column(ColumnFault::Exchanged(swapped)),
            Fault::Column(ColumnFault::SignReversed(reversed)),
            Fault::Unit(time.clone()),
            Fault::Unit(time),
        ];
        let sentences = [
            "it seems that voltage and current are swapped: as mapped, the balances give an inertia of -2.000e-4; the other \
             way round they leave 1 % and 2 %, with every parameter positive",
            "it seems that the sign of the speed is reversed: as mapped, the balances give an inertia of -2.000e-4; the other \
             way round they leave 1 % and 2 %, with every parameter positive",
            "time_s seems to be in us, not in s (a factor 1000000): the integral of speed_rad_s is 1000000.0000 times the \
             change of angle_rad",
        ];
        let remedies = [
            "map them as --map voltage_v=(column of current_a),current_a=(column of voltage_v)",
            "map them as --map speed_rad_s=(column of speed_rad_s)*-1",
            "convert it with --map time_s=COLUMN*0.000001",
            "",
        ];
        let finding =
            |fault| Finding { kind: Kind::Unit, refuses: false, fault, doubts: Vec::new() };
        let found = all.map(finding);
        assert_eq!(helps(&found), remedies);
        assert_eq!([0, 1, 2].map(|at: usize| fault(&found[at].fault)), sentences);
    }
}
