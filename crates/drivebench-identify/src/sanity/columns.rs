//! Exchanged columns and reversed signs: both balances under every other assignment.

use super::table::{Activity, Balances, Roles, Table};
use super::{Finding, Kind};
use drivebench_model::plant::MotorKey;

/// Error of both balances up to which an assignment explains the data.
const EXPLAINS: f64 = 0.35;
/// Error of each balance up to which another assignment may be proposed: exchanged columns of a valid record have an
/// error of some per cent, and of up to a sixth at a period near the mechanical time constant.
const HOLDS_WELL: f64 = 0.2;
/// Names of the three columns, in the order of the table.
const NAMES: [&str; 3] = ["voltage", "current", "speed"];

pub(super) struct Assigned {
    /// Another assignment explains the data, the given one does not.
    pub(super) exchanged: Option<Finding>,
    /// The given assignment is impossible, and so is every other.
    pub(super) impossible: Option<Finding>,
}

/// Result of both balances; `None` where a column is constant.
pub(super) fn check(table: &Table) -> Option<Assigned> {
    let columns = [&table.voltage_v, &table.current_a, &table.speed_rad_s];
    if columns.iter().any(|column| !Activity::of(column).moves) {
        return None;
    }
    let given = Balances::of(&Roles::of(table))?;
    if table.voltage_is_of_a_supply() {
        return Some(Assigned {
            exchanged: None,
            impossible: given.impossible().map(|found| of_a_supply(table, found)),
        });
    }
    let others = ASSIGNMENTS.iter().filter_map(|assignment| {
        let found = Balances::of(&assignment.roles(table))?;
        assignment.holds_well(&found).then_some((assignment, found))
    });
    let best = others.min_by(|a, b| a.1.error().total_cmp(&b.1.error()));
    let impossible = given.impossible();
    // An assignment with possible signs is only doubted where another one is far better.
    let share = if impossible.is_some() { 1.1 } else { 0.4 };
    let better = best
        .filter(|(_, found)| found.error() < share * given.error() && !explains_most_parts(table));
    Some(Assigned {
        exchanged: better.map(|(assignment, found)| assignment.finding(table, &given, &found)),
        impossible: impossible.map(|(name, value)| {
            let sentence = format!(
                "the balances of voltage and torque give {name} of {value:.3e}, which no motor has, and no exchange of \
                 columns or signs mends it (they leave {:.0} % and {:.0} % unexplained)",
                100.0 * given.voltage_error,
                100.0 * given.torque_error
            );
            let help = "check columns, signs and units of voltage, current and speed; a supply current is not the armature current";
            // A small error with an impossible sign is proof; a large one may also be a missing effect.
            Finding::of_all(Kind::Reversed, given.error() < EXPLAINS, sentence, help)
        }),
    })
}

/// Whether most parts of the record are explained as they are given, each by values of its own: a load that changed
/// during the record increases the error of the whole, although no columns are exchanged.
fn explains_most_parts(table: &Table) -> bool {
    let size = table.windows.len().div_ceil(6).max(1);
    let parts = table.windows.chunks(size);
    let explained = parts.clone().filter(|windows| {
        let found = Balances::of(&Roles::of(table).over(windows));
        found.is_some_and(|found| found.impossible().is_none() && found.error() < EXPLAINS)
    });
    2 * explained.count() > parts.len()
}

/// Which given column serves as voltage, current and speed, and the signs of current and speed.
struct Assignment {
    place: [usize; 3],
    signs: [f64; 2],
}

const fn assignment(place: [usize; 3], signs: [f64; 2]) -> Assignment {
    Assignment { place, signs }
}

/// Every assignment but the given one, with one mistake each: columns in each other's place, or signs. The voltage's sign is
/// the reference.
const ASSIGNMENTS: [Assignment; 8] = [
    assignment([1, 0, 2], [1.0, 1.0]),
    assignment([0, 2, 1], [1.0, 1.0]),
    assignment([2, 1, 0], [1.0, 1.0]),
    assignment([1, 2, 0], [1.0, 1.0]),
    assignment([2, 0, 1], [1.0, 1.0]),
    assignment([0, 1, 2], [1.0, -1.0]),
    assignment([0, 1, 2], [-1.0, 1.0]),
    assignment([0, 1, 2], [-1.0, -1.0]),
];

/// The balances with the voltage of a supply, which the bridge chops: they give no parameter of the winding.
fn of_a_supply(table: &Table, (name, value): (&str, f64)) -> Finding {
    let voltage = Activity::of(&table.voltage_v);
    let sentence = format!(
        "{} stays between {:.4} and {:.4} V whatever the motor does, as that of a supply, and with it the balances give {name} of \
         {value:.3e}: it is not the voltage at the motor's terminals",
        table.voltage_key, voltage.least, voltage.most
    );
    let help = "map duty times supply, as voltage_v=DUTY*BUS, or map torque_n_m and the speed alone; a current taken at the supply is \
                declared by --origin current_a=supply";
    Finding::caution(Kind::Reversed, &MotorKey::ALL, sentence, help)
}

impl Assignment {
    /// Whether an assignment explains what the given one may not. An exchange has to explain both balances; a sign shows in the
    /// voltage's alone, also where a coarse speed leaves much of the torque's.
    fn holds_well(&self, found: &Balances) -> bool {
        let is_exchange = self.place != [0, 1, 2];
        found.is_physical()
            && found.voltage_error < HOLDS_WELL
            && (!is_exchange || found.torque_error < HOLDS_WELL)
    }

    fn roles<'a>(&self, table: &'a Table) -> Roles<'a> {
        let columns = [&table.voltage_v, &table.current_a, &table.speed_rad_s];
        Roles {
            time_s: &table.time_s,
            windows: &table.windows,
            voltage: columns[self.place[0]],
            current: columns[self.place[1]],
            speed: columns[self.place[2]],
            signs: self.signs,
        }
    }

    fn finding(&self, table: &Table, given: &Balances, found: &Balances) -> Finding {
        let keys = [table.voltage_key, "current_a", "speed_rad_s"];
        let moved: Vec<usize> = (0..3).filter(|role| self.place[*role] != *role).collect();
        let reversed = self.reversed();
        let (kind, what) = match (moved.as_slice(), reversed) {
            ([], Some(role)) => {
                (Kind::Reversed, format!("the sign of the {} is reversed", NAMES[role]))
            }
            ([first, second], _) => {
                (Kind::Swapped, format!("{} and {} are swapped", NAMES[*first], NAMES[*second]))
            }
            _ => (
                Kind::Swapped,
                "voltage, current and speed stand in each other's columns".to_owned(),
            ),
        };
        let why = match given.impossible() {
            Some((name, value)) => format!("as mapped, the balances give {name} of {value:.3e}"),
            None => format!(
                "as mapped, the balances leave {:.0} % of the voltage and {:.0} % of the current unexplained",
                100.0 * given.voltage_error,
                100.0 * given.torque_error
            ),
        };
        let map: Vec<String> = (0..3)
            .filter(|role| self.place[*role] != *role || reversed == Some(*role))
            .map(|role| {
                let sign = if reversed == Some(role) { "*-1" } else { "" };
                format!("{}=(column of {}){sign}", keys[role], keys[self.place[role]])
            })
            .collect();
        Finding::refusal(
            kind,
            format!(
                "it seems that {what}: {why}; the other way round they leave {:.0} % and {:.0} %, with every parameter positive",
                100.0 * found.voltage_error,
                100.0 * found.torque_error
            ),
            format!("map them as --map {}", map.join(",")),
        )
    }

    /// The one role whose sign is to be turned; current and speed both turned is the voltage turned.
    fn reversed(&self) -> Option<usize> {
        match (self.signs[0] < 0.0, self.signs[1] < 0.0) {
            (false, false) => None,
            (true, false) => Some(1),
            (false, true) => Some(2),
            (true, true) => Some(0),
        }
    }
}
