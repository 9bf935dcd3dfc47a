//! What each column may hold, by its header, its unit, and the program that wrote the file.

use super::finding::Reason;
use super::header::Parts;
use super::known::{Factor, Known, Qualifier, Quantity, Tool, Unit, plain};
use crate::recording::Preview;

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
    pub unit: Option<Unit>,
    pub unit_from: UnitFrom,
    /// Preference among columns of one quantity, the smallest first.
    pub rank: u8,
    /// A word or a program names the quantity; else its unit alone does.
    pub is_named: bool,
    pub reasons: Vec<Reason>,
    /// Words of the header that name no quantity: which motor it is of.
    pub words: Vec<String>,
}

const PERCENT_OF_RATED: Unit = Unit {
    quantity: Quantity::Torque,
    name: "% of the rated torque",
    factor: Factor::of(0.01).times("RATED_TORQUE_N_M"),
};

/// All readings, in the order of the columns; a column without one has no header that is known.
pub(super) fn readings(preview: &Preview, tool: Option<&'static Tool>) -> Vec<Reading> {
    let columns = 0..preview.headers.len();
    columns.flat_map(|column| of_column(preview, column, tool)).collect()
}

fn of_column(preview: &Preview, column: usize, tool: Option<&'static Tool>) -> Vec<Reading> {
    let header = preview.headers[column].as_str();
    let parts = Parts::of(header);
    let stated = preview.units.get(column).and_then(|text| Unit::of(text)).or(parts.unit);
    let known = Known::get();
    if let Some(reading) = of_tool(column, header, stated, tool) {
        return vec![reading];
    }
    let text = parts.words.join("_");
    let Some(symbol) = known.symbol(&plain(header)).or_else(|| known.symbol(&text)) else {
        return of_words(column, header, &parts.words, stated).into_iter().collect();
    };
    let by_unit = stated.map(|unit| unit.quantity);
    let agrees = |quantity: &Quantity| by_unit.is_none_or(|by_unit| by_unit == *quantity);
    let mut possible: Vec<Quantity> = symbol.quantities.iter().copied().filter(agrees).collect();
    if possible.is_empty() {
        possible.extend(by_unit);
    }
    let usual = symbol.unit.as_deref().and_then(Unit::of);
    let reading = |(quantity, rank): (Quantity, u8)| {
        let reason = Reason::Symbol { header: header.to_owned(), quantity };
        let mut reading = Reading::new(column, quantity, stated, usual, reason);
        reading.rank = 1 + rank;
        if stated.is_none() && usual.is_some() {
            reading.unit_from = UnitFrom::Convention;
        }
        reading
    };
    possible.into_iter().zip(0..).map(reading).collect()
}

fn of_tool(
    column: usize,
    header: &str,
    stated: Option<Unit>,
    tool: Option<&'static Tool>,
) -> Option<Reading> {
    let (tool, found) = tool.and_then(|tool| Some((tool, tool.column(header)?)))?;
    let named = |name: &Option<String>| name.as_deref().and_then(Unit::of);
    let (unit, likely) = (stated.or_else(|| named(&found.unit)), named(&found.likely_unit));
    let (header, quantity) = (header.to_owned(), found.quantity);
    let reason = Reason::OfProgram { header, quantity, tool: &tool.name };
    let mut reading = Reading::new(column, quantity, unit, likely, reason);
    if let Some(factor) = found.factor {
        reading.factor = Factor::of(factor);
    }
    // A duty is a share already.
    if quantity == Quantity::Duty {
        reading.unit_from = UnitFrom::Stated;
    }
    reading.rank = found.rank;
    reading.reasons.extend(found.note.as_deref().map(Reason::Note));
    Some(reading)
}

/// The last word of a header names its quantity, and the others change it.
fn of_words(
    column: usize,
    header: &str,
    words: &[String],
    stated: Option<Unit>,
) -> Option<Reading> {
    let known = Known::get();
    let is_weak = |quantity: &Quantity| matches!(quantity, Quantity::Command | Quantity::Index);
    let named: Vec<Quantity> = words.iter().filter_map(|word| known.word(word)).collect();
    let strong = named.iter().rev().find(|quantity| !is_weak(quantity));
    let by_unit = stated.map(|unit| unit.quantity);
    let has = |kind| words.iter().any(|word| known.qualifier(word) == Some(kind));
    // `vbus` and `vin` are voltages without that word.
    let of_supply = has(Qualifier::OfTheSupply).then_some(Quantity::Voltage);
    let word = strong.or_else(|| named.last().filter(|_| by_unit.is_none())).copied();
    let quantity = word.or(by_unit).or(of_supply.filter(|_| words.len() == 1))?;
    let (quantity, unit, note, rank) = match (quantity, by_unit) {
        (Quantity::Other, _) | (_, Some(Quantity::Other)) => (Quantity::Other, None, None, 0),
        // Per cent as well as per mille.
        (Quantity::Torque, Some(Quantity::Duty)) => (quantity, Some(PERCENT_OF_RATED), None, 0),
        // The signal of a sensor, not yet converted.
        (Quantity::Current | Quantity::Speed, Some(Quantity::Voltage)) => {
            let reason = Reason::Named { header: header.to_owned(), quantity };
            return Some(Reading::new(column, quantity, stated, None, reason).of_sensor(quantity));
        }
        (_, Some(by_unit)) if by_unit != quantity && !is_same_unit(quantity, by_unit) => {
            (by_unit, stated, Some(Reason::UnitOf(by_unit)), 1)
        }
        _ => (quantity, stated, None, 0),
    };
    let quantity = qualified(quantity, &has);
    let reason = Reason::Named { header: header.to_owned(), quantity };
    let mut reading = Reading::new(column, quantity, unit, None, reason);
    reading.is_named = word.is_some();
    // `erpm` is a unit too.
    if word == Some(Quantity::ElectricalSpeed) {
        reading.unit_from = UnitFrom::Stated;
    }
    reading.rank = rank + u8::from(!reading.is_named) + u8::from(has(Qualifier::Commanded));
    reading.reasons.extend(note);
    reading.reasons.extend(has(Qualifier::Rms).then_some(Reason::Effective));
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
    pub(super) fn new(
        column: usize,
        quantity: Quantity,
        stated: Option<Unit>,
        usual: Option<Unit>,
        reason: Reason,
    ) -> Self {
        use Quantity::{Angle, Channel, ElectricalSpeed, Speed};
        let unit_from = match (stated, quantity) {
            (Some(_), _) => UnitFrom::Stated,
            (None, Speed | ElectricalSpeed | Angle | Channel) => UnitFrom::Open,
            (None, _) => UnitFrom::Convention,
        };
        let erpm = || (quantity == ElectricalSpeed).then(|| Unit::of("r/min"))?;
        let unit = stated.or(usual).or_else(erpm);
        Self {
            column,
            quantity,
            factor: unit.map_or(Factor::ONE, |unit| unit.factor),
            unit,
            unit_from,
            rank: 0,
            is_named: true,
            reasons: vec![reason],
            words: Vec::new(),
        }
    }

    /// The same column as the voltage of a sensor of a current or a speed.
    pub(super) fn of_sensor(self, quantity: Quantity) -> Self {
        let is_current = quantity == Quantity::Current;
        let number = if is_current { "AMPERES_PER_VOLT" } else { "RAD_S_PER_VOLT" };
        let mut reasons = self.reasons;
        reasons.push(Reason::SensorVoltage);
        Self { quantity, factor: Factor::ONE.times(number), unit: None, rank: 1, reasons, ..self }
    }
}
