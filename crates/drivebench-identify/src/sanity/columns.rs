//! Exchanged columns and reversed signs: both balances under every other assignment.

use super::table::{Activity, Balances, Roles, Table};
use super::{ColumnFault, Fault, Finding, Kind, Mapping};
use crate::belief::Settings;
use drivebench_model::plant::MotorKey;

/// Error of both balances up to which an assignment explains the data.
pub const EXPLAINS: f64 = 0.35;

pub(super) struct Assigned {
    /// Another assignment explains the data, the given one does not.
    pub(super) exchanged: Option<Finding>,
    /// The given assignment is impossible, and so is every other.
    pub(super) impossible: Option<Finding>,
}

/// Result of both balances; `None` where a column is constant.
pub(super) fn check(table: &Table) -> Option<Assigned> {
    if table.columns().iter().any(|column| !Activity::of(column).moves) {
        return None;
    }
    let given = Balances::of(&Roles::of(table))?;
    if table.voltage_is_of_a_supply() {
        let impossible = given.impossible().map(|found| of_a_supply(table, found));
        return Some(Assigned { exchanged: None, impossible });
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
        impossible: impossible.map(|coefficient| {
            let fault = ColumnFault::Impossible { coefficient, left: given.left() };
            // A small error with an impossible sign is proof; a large one may also be a missing effect.
            Finding::of_all(Kind::Reversed, given.error() < EXPLAINS, Fault::Column(fault))
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

/// Every assignment but the given one, with one mistake each: columns in each other's place, or signs. The voltage's sign is
/// the reference.
const ASSIGNMENTS: [Assignment; 8] = [
    Assignment { place: [1, 0, 2], signs: [1.0, 1.0] },
    Assignment { place: [0, 2, 1], signs: [1.0, 1.0] },
    Assignment { place: [2, 1, 0], signs: [1.0, 1.0] },
    Assignment { place: [1, 2, 0], signs: [1.0, 1.0] },
    Assignment { place: [2, 0, 1], signs: [1.0, 1.0] },
    Assignment { place: [0, 1, 2], signs: [1.0, -1.0] },
    Assignment { place: [0, 1, 2], signs: [-1.0, 1.0] },
    Assignment { place: [0, 1, 2], signs: [-1.0, -1.0] },
];

/// The balances with the voltage of a supply, which the bridge chops: they give no parameter of the winding.
fn of_a_supply(table: &Table, coefficient: (MotorKey, f64)) -> Finding {
    let volts = Activity::of(&table.voltage_v).extent();
    let fault = ColumnFault::OfSupply { voltage: table.voltage_key, volts, coefficient };
    Finding::of_all(Kind::Reversed, false, Fault::Column(fault))
}

impl Assignment {
    /// Whether an assignment explains what the given one may not: exchanged columns of a valid record have an error of some
    /// per cent, and of up to a sixth at a period near the mechanical time constant. An exchange has to explain both balances; a sign shows in the
    /// voltage's alone, also where a coarse speed leaves much of the torque's.
    fn holds_well(&self, found: &Balances) -> bool {
        let is_exchange = self.place != [0, 1, 2];
        found.is_physical()
            && found.voltage_error < Settings::FAR
            && (!is_exchange || found.torque_error < Settings::FAR)
    }

    fn roles<'a>(&self, table: &'a Table) -> Roles<'a> {
        let [voltage, current, speed] = self.place.map(|place| table.columns()[place]);
        Roles { voltage, current, speed, signs: self.signs, ..Roles::of(table) }
    }

    fn finding(&self, table: &Table, given: &Balances, found: &Balances) -> Finding {
        let mapping = Mapping {
            keys: [table.voltage_key, "current_a", "speed_rad_s"],
            place: self.place,
            reversed: self.reversed(),
            impossible: given.impossible(),
            left: [given.left(), found.left()],
        };
        if mapping.reversed.is_some() && self.place == [0, 1, 2] {
            Finding::refusal(Kind::Reversed, Fault::Column(ColumnFault::SignReversed(mapping)))
        } else {
            Finding::refusal(Kind::Swapped, Fault::Column(ColumnFault::Exchanged(mapping)))
        }
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
