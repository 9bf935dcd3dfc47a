//! Records in which nothing moves, or not what has to.

use super::balance::{Roles, voltage_at_rest};
use super::table::{Activity, Table, correlation};
use super::{Finding, Kind};
use crate::numerics::statistics::median;
use crate::plant::MotorKey;

/// Correlation of voltage and current above which the current answers the voltage.
const ANSWERS: f64 = 0.3;
/// Share of the voltage that resistance and inductance may leave unexplained in a winding at rest.
pub(super) const AT_REST: f64 = 0.3;

pub(super) fn check(table: &Table) -> Vec<Finding> {
    let [voltage, current, speed] =
        [&table.voltage_v, &table.current_a, &table.speed_rad_s].map(|values| Activity::of(values));
    let duration_s = table.duration_s();
    let current_moves = current.moves
        || current.is_there() && correlation(&table.voltage_v, &table.current_a).abs() > ANSWERS;
    if !speed.moves && !current_moves {
        return vec![nothing_moves(&voltage, &current, &speed, duration_s)];
    }
    let mut findings = Vec::new();
    let voltage_changes = voltage.is_there() && voltage.range() > 0.01 * voltage.largest();
    if current.is_constant() && voltage_changes && speed.moves {
        findings.push(Finding::refusal(
            Kind::Frozen,
            format!(
                "current_a is {} A in all {} rows while {} changes between {:.4} and {:.4} V and the speed follows: \
                 the current is not measured",
                current.mean, current.count, table.voltage_key, voltage.least, voltage.most
            ),
            "leave the column out of --map (voltage and speed alone still give the back-EMF constant), or repair the sensor",
        ));
    } else if current.is_there() && current.is_zero() && voltage.is_there() && !voltage_changes {
        findings.push(Finding::refusal(
            Kind::OpenCircuit,
            format!(
                "the current stays 0 A while the speed goes from {:.4} to {:.4} rad/s at a stated voltage of {:.4} V: \
                 the terminals are open, so the stated voltage is not the motor's",
                speed.least, speed.most, voltage.mean
            ),
            "leave the voltage out of --map, and give torque_n_m_per_a with --model: the coast-down then gives the torque balance",
        ));
    }
    if current_moves && speed.is_there() && !speed.moves {
        findings.extend(shaft_at_rest(table, &speed));
    }
    if current.moves && speed.moves && voltage.is_there() {
        findings.extend(open_for_a_while(table, &voltage, &current, &speed));
    }
    findings
}

/// Share of the largest voltage that is none, of the largest speed that is a clear one, and of the largest current that
/// is none.
const NO_VOLTAGE: f64 = 0.002;
const CLEAR_SPEED: f64 = 0.2;
const NO_CURRENT: f64 = 0.02;
/// Rows from which such a stretch counts, and the share of the record that forbids an identification.
const OPEN_ROWS: usize = 20;
const OPEN_SHARE: f64 = 0.02;

/// A shorted armature that turns brakes with `Ke w/R`; one that carries nothing at zero volt is open.
fn open_for_a_while(
    table: &Table,
    voltage: &Activity,
    current: &Activity,
    speed: &Activity,
) -> Option<Finding> {
    let coasts = |row: &usize| {
        table.voltage_v[*row].abs() <= NO_VOLTAGE * voltage.largest()
            && table.speed_rad_s[*row].abs() > CLEAR_SPEED * speed.largest()
            && table.current_a[*row].is_finite()
    };
    let rows: Vec<usize> = (0..table.time_s.len()).filter(coasts).collect();
    // A shaft that coasts slows down; a speed that repeats one value is that of a sensor that froze.
    let speeds: Vec<f64> = rows.iter().map(|row| table.speed_rad_s[*row]).collect();
    if Activity::of(&speeds).is_constant() {
        return None;
    }
    let currents: Vec<f64> = rows.iter().map(|row| table.current_a[*row].abs()).collect();
    let level = median(&currents);
    if rows.len() < OPEN_ROWS || level > NO_CURRENT * current.largest() {
        return None;
    }
    let sentence = format!(
        "in {} rows from {:.3} s on the voltage is stated as 0 V and the shaft turns, but the current is {level:.3} A: the \
         terminals are open there, so no voltage is known and no balance of voltages holds",
        rows.len(),
        table.time_s[rows[0]]
    );
    let help = "cut the coast-down out of the file; on its own, without a voltage and with torque_n_m_per_a given, it shows the torque balance";
    let share = rows.len() as f64 / table.time_s.len() as f64;
    Some(if share > OPEN_SHARE {
        Finding::refusal(Kind::OpenCircuit, sentence, help)
    } else {
        Finding::caution(Kind::OpenCircuit, &MotorKey::ALL, sentence, help)
    })
}

/// One operating point, moving or not.
fn nothing_moves(
    voltage: &Activity,
    current: &Activity,
    speed: &Activity,
    duration_s: f64,
) -> Finding {
    let mut levels = Vec::new();
    for (name, activity, unit) in [
        ("voltage", voltage, "V"),
        ("current", current, "A"),
        ("speed", speed, "rad/s"),
    ] {
        if activity.is_there() {
            let noise = if activity.is_constant() {
                String::new()
            } else {
                format!(" +- {:.2}", activity.noise)
            };
            levels.push(format!("{name} {:.4}{noise} {unit}", activity.mean));
        }
    }
    let levels = levels.join(", ");
    if speed.is_there() && speed.is_zero() {
        Finding::refusal(
            Kind::Standstill,
            format!(
                "the motor stands still and nothing changes for {duration_s:.3} s ({levels}): there is nothing to identify"
            ),
            "excite the motor: steps of voltage in both directions, with some time at rest first",
        )
    } else {
        Finding::refusal(
            Kind::Steady,
            format!(
                "nothing changes for {duration_s:.3} s ({levels}): one operating point is one equation for all unknowns"
            ),
            "excite the motor: steps of voltage in both directions; record the transients too",
        )
    }
}

/// The current moves, the speed does not: a locked rotor, or a speed that is not measured.
fn shaft_at_rest(table: &Table, speed: &Activity) -> Option<Finding> {
    if speed.is_constant() && speed.mean.abs() > 0.0 {
        return Some(Finding::refusal(
            Kind::Frozen,
            format!(
                "speed_rad_s is {} rad/s in all {} rows while the current changes: the speed is not measured",
                speed.mean, speed.count
            ),
            "leave the column out of --map, or repair the sensor",
        ));
    }
    if !speed.is_zero() {
        return None;
    }
    let roles = Roles::of(table);
    let unexplained = voltage_at_rest(&roles)?;
    if unexplained > AT_REST {
        return Some(Finding::refusal(
            Kind::Frozen,
            format!(
                "the speed reads 0 rad/s throughout, but resistance and inductance leave {:.0} % of the voltage \
                 unexplained: the shaft turns and the speed is not measured",
                100.0 * unexplained
            ),
            "check the speed sensor, or leave the column out of --map",
        ));
    }
    Some(Finding::caution(
        Kind::Standstill,
        &[MotorKey::BackEmf, MotorKey::Inertia, MotorKey::LoadTorque],
        format!(
            "the shaft does not turn in {:.3} s (speed 0 +- {:.2} rad/s): only resistance and inductance can be found",
            table.duration_s(),
            speed.noise
        ),
        "for the other parameters the shaft must be free to turn and the voltage high enough to break it away",
    ))
}
