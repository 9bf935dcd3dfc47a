//! What each column may hold, by its header, its unit, and the program that wrote the file.

use super::header::{Parts, unit};
use super::known::{Factor, Known, Qualifier, Quantity, Tool, Unit, plain};
use crate::recording::Preview;

/// Where the unit comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum UnitFrom {
    /// It is written in the file, or the program writes no other.
    Stated,
    /// The usual one of the quantity or symbol.
    Convention,
    /// Several are usual.
    Open,
}

/// One quantity that a column may hold.
#[derive(Clone, Debug)]
pub(super) struct Reading {
    pub column: usize,
    pub quantity: Quantity,
    pub factor: Factor,
    pub unit: String,
    pub unit_from: UnitFrom,
    /// Preference among columns of one quantity, the smallest first.
    pub rank: u8,
    /// A word or a program names the quantity; else its unit alone does.
    pub is_named: bool,
    pub reason: String,
    pub notes: Vec<String>,
    /// Words of the header that name no quantity: which motor it is of.
    pub words: Vec<String>,
}

/// All readings, in the order of the columns; a column without one has no header that is known.
pub(super) fn readings(preview: &Preview, tool: Option<&Tool>) -> Vec<Reading> {
    let columns = 0..preview.headers.len();
    columns.flat_map(|column| of_column(preview, column, tool)).collect()
}

fn of_column(preview: &Preview, column: usize, tool: Option<&Tool>) -> Vec<Reading> {
    let header = preview.headers[column].as_str();
    let parts = Parts::of(header);
    let row_unit = preview.units.get(column).and_then(|text| unit(text));
    let stated = row_unit.or(parts.unit);
    let known = Known::get();
    if let Some(reading) = of_tool(column, header, stated.as_ref(), tool) {
        return vec![reading];
    }
    let text = parts.words.join("_");
    if let Some(symbol) = known.symbol(&plain(header)).or_else(|| known.symbol(&text)) {
        let possible = symbol.quantities.iter().copied();
        let by_unit = stated.as_ref().map(|unit| unit.quantity);
        let agrees = |quantity: &Quantity| by_unit.is_none_or(|by_unit| by_unit == *quantity);
        let mut possible: Vec<Quantity> = possible.filter(agrees).collect();
        if possible.is_empty() {
            possible.extend(by_unit);
        }
        let usual = symbol.unit.as_deref().and_then(|name| known.unit(name));
        return possible
            .into_iter()
            .zip(0..)
            .map(|(quantity, rank)| {
                let reason = format!("{header:?} is a usual symbol of {}", quantity.name());
                let mut reading =
                    Reading::new(column, quantity, stated.as_ref(), usual.as_ref(), reason);
                reading.rank += 1 + rank;
                if stated.is_none() && usual.is_some() {
                    reading.unit_from = UnitFrom::Convention;
                }
                reading
            })
            .collect();
    }
    of_words(column, header, &parts.words, stated.as_ref()).into_iter().collect()
}

fn of_tool(
    column: usize,
    header: &str,
    stated: Option<&Unit>,
    tool: Option<&Tool>,
) -> Option<Reading> {
    let known = Known::get();
    let (tool, found) = tool.and_then(|tool| Some((tool, tool.column(header)?)))?;
    let named = |name: &Option<String>| name.as_deref().and_then(|name| known.unit(name));
    let unit = stated.cloned().or_else(|| named(&found.unit));
    let likely = named(&found.likely_unit);
    let reason = format!("{header:?} is {} in a log of {}", found.quantity.name(), tool.name);
    let mut reading = Reading::new(column, found.quantity, unit.as_ref(), likely.as_ref(), reason);
    if let Some(factor) = found.factor.as_ref().and_then(|factor| factor.parse().ok()) {
        reading.factor = Factor::Known(factor);
    }
    // A duty is a share already.
    if found.quantity == Quantity::Duty {
        reading.unit_from = UnitFrom::Stated;
    }
    reading.rank = found.rank;
    reading.notes.extend(found.note.clone());
    Some(reading)
}

/// The last word of a header names its quantity, and the others change it.
fn of_words(
    column: usize,
    header: &str,
    words: &[String],
    stated: Option<&Unit>,
) -> Option<Reading> {
    let known = Known::get();
    let is_weak = |quantity: &Quantity| matches!(quantity, Quantity::Command | Quantity::Index);
    let named: Vec<Quantity> = words.iter().filter_map(|word| known.word(word)).collect();
    let strong = named.iter().rev().find(|quantity| !is_weak(quantity));
    let is_supply_word = |word: &String| known.qualifier(word) == Some(Qualifier::OfTheSupply);
    let by_unit = stated.map(|unit| unit.quantity);
    // `vbus` and `vin` are voltages without saying so.
    let of_supply = words.iter().any(is_supply_word).then_some(Quantity::Voltage);
    let word = strong.or_else(|| named.last().filter(|_| by_unit.is_none())).copied();
    let quantity = word.or(by_unit).or(of_supply.filter(|_| words.len() == 1))?;
    let has = |kind| words.iter().any(|word| known.qualifier(word) == Some(kind));
    let (quantity, unit, notes, rank) = match (quantity, by_unit) {
        (Quantity::Other, _) | (_, Some(Quantity::Other)) => (Quantity::Other, None, vec![], 0),
        (Quantity::Torque, Some(Quantity::Duty)) => {
            // Per cent as well as per mille.
            return Some(Reading::of_rated_torque(column, header));
        }
        // The signal of a sensor, not yet converted.
        (Quantity::Current | Quantity::Speed, Some(Quantity::Voltage)) => {
            let note = "the column is a voltage of its sensor".to_owned();
            return Some(Reading::of_sensor(column, quantity, header, note));
        }
        (_, Some(by_unit)) if by_unit != quantity && !is_same_unit(quantity, by_unit) => {
            let note = format!("its unit is that of {}, whatever its name", by_unit.name());
            (by_unit, stated, vec![note], 1)
        }
        _ => (quantity, stated, vec![], 0),
    };
    let quantity = qualified(quantity, &has);
    let mut reading = Reading::new(
        column,
        quantity,
        unit,
        None,
        format!("the header {header:?} names {}", quantity.name()),
    );
    reading.is_named = word.is_some();
    // `erpm` is a unit too.
    if word == Some(Quantity::ElectricalSpeed) {
        reading.unit_from = UnitFrom::Stated;
    }
    reading.rank = rank + u8::from(!reading.is_named) + u8::from(has(Qualifier::Commanded));
    reading.notes.extend(notes);
    if has(Qualifier::Rms) {
        reading.notes.push(
            "an effective value: the amplitude of a sine is 1.414214 times as large".to_owned(),
        );
    }
    let is_group = |word: &&String| known.word(word).is_none() && known.qualifier(word).is_none();
    reading.words = words.iter().filter(is_group).cloned().collect();
    Some(reading)
}

/// The quantities that share the unit of another.
fn is_same_unit(quantity: Quantity, by_unit: Quantity) -> bool {
    matches!(
        (quantity, by_unit),
        (Quantity::ElectricalSpeed, Quantity::Speed)
            | (Quantity::Command, Quantity::Duty)
            | (Quantity::Duty | Quantity::Command, Quantity::Voltage)
            | (Quantity::Channel, _)
    )
}

fn qualified(quantity: Quantity, has: &impl Fn(Qualifier) -> bool) -> Quantity {
    use Qualifier as Q;
    match quantity {
        Quantity::Time | Quantity::Index | Quantity::Duty | Quantity::Other => quantity,
        _ if has(Q::Derived) || has(Q::DirectAxis) => Quantity::Other,
        Quantity::Voltage if has(Q::OfTheSupply) => Quantity::SupplyVoltage,
        Quantity::Voltage if has(Q::Commanded) => Quantity::VoltageCommand,
        Quantity::Current if has(Q::Commanded) => Quantity::Other,
        Quantity::Current if has(Q::OfTheSupply) => Quantity::SupplyCurrent,
        Quantity::Speed | Quantity::ElectricalSpeed if has(Q::Commanded) => {
            Quantity::SpeedReference
        }
        Quantity::Speed if has(Q::Electrical) => Quantity::ElectricalSpeed,
        Quantity::Angle if has(Q::Commanded) || has(Q::Electrical) => Quantity::Other,
        _ => quantity,
    }
}

impl Reading {
    /// `stated` is the unit that the file or its program names, `usual` what else is likely.
    fn new(
        column: usize,
        quantity: Quantity,
        stated: Option<&Unit>,
        usual: Option<&Unit>,
        reason: String,
    ) -> Self {
        let si = quantity.si_unit().and_then(|name| Known::get().unit(name));
        let unit_from = match (stated, quantity) {
            (Some(_), _) => UnitFrom::Stated,
            (None, Quantity::Speed | Quantity::ElectricalSpeed | Quantity::Angle) => UnitFrom::Open,
            (None, _) => UnitFrom::Convention,
        };
        let unit = stated.or(usual).or(si.as_ref());
        Self {
            column,
            quantity,
            factor: unit.map_or(Factor::Known(1.0), |unit| unit.factor.clone()),
            unit: unit.map_or_else(String::new, |unit| unit.name.clone()),
            unit_from,
            rank: 0,
            is_named: true,
            reason,
            notes: Vec::new(),
            words: Vec::new(),
        }
    }

    /// A column of which nothing is known.
    pub(super) fn of_unknown(column: usize) -> Self {
        let reason = "its name is unknown".to_owned();
        Self {
            unit_from: UnitFrom::Open,
            ..Self::new(column, Quantity::Channel, None, None, reason)
        }
    }

    /// A column whose cells are clocks.
    pub(super) fn of_clock(column: usize, header: &str) -> Self {
        let reason = format!("{header:?} holds clocks");
        Self::new(column, Quantity::Time, None, None, reason)
    }

    /// A torque in per cent of that of the nameplate.
    fn of_rated_torque(column: usize, header: &str) -> Self {
        let reason = format!("the header {header:?} names the torque in per cent");
        Self {
            factor: Factor::Hole("0.01*RATED_TORQUE_N_M".to_owned()),
            unit_from: UnitFrom::Stated,
            ..Self::new(column, Quantity::Torque, None, None, reason)
        }
    }

    /// A quantity whose column holds the voltage of its sensor.
    pub(super) fn of_sensor(column: usize, quantity: Quantity, header: &str, note: String) -> Self {
        let hole =
            if quantity == Quantity::Current { "AMPERES_PER_VOLT" } else { "RAD_S_PER_VOLT" };
        let reason = format!("the header {header:?} names {}", quantity.name());
        Self {
            factor: Factor::Hole(hole.to_owned()),
            unit: "V".to_owned(),
            unit_from: UnitFrom::Stated,
            notes: vec![note],
            rank: 1,
            ..Self::new(column, quantity, None, None, reason)
        }
    }
}

impl Quantity {
    /// As a sentence names it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Time => "the time",
            Self::Index => "the number of the row",
            Self::Voltage => "the voltage of the motor",
            Self::VoltageCommand => "the voltage command",
            Self::SupplyVoltage => "the supply voltage",
            Self::Duty => "the duty of the bridge",
            Self::Command => "a command",
            Self::Current => "the current of the motor",
            Self::SupplyCurrent => "the supply current",
            Self::Speed => "the speed",
            Self::ElectricalSpeed => "the electrical speed",
            Self::SpeedReference => "the speed reference",
            Self::Angle => "the angle",
            Self::Torque => "the torque",
            Self::Channel => "a channel",
            Self::Other => "a quantity that identification does not need",
        }
    }

    /// The unit that is usual where none is stated.
    const fn si_unit(self) -> Option<&'static str> {
        match self {
            Self::Time => Some("s"),
            Self::Voltage | Self::VoltageCommand | Self::SupplyVoltage => Some("V"),
            Self::Current | Self::SupplyCurrent => Some("A"),
            Self::Speed | Self::SpeedReference => Some("rad/s"),
            Self::ElectricalSpeed => Some("r/min"),
            Self::Angle => Some("rad"),
            Self::Torque => Some("N.m"),
            _ => None,
        }
    }
}
