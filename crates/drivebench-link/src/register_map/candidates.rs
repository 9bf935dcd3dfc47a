//! Alternative decodings of registers: address off by one, word order, byte order, sign. Pure.
//!
//! ```text
//! registers at address - 1, 0, + 1 -> Change -> value in units -> plausible for a drive at rest? -> Candidate, Hypothesis
//! ```
//!
//! A profile with such an error still gives numbers. At rest the ranges of the true values are narrow enough to detect it: a wrong
//! address, word order or scale leaves them, unless the true value is zero; a zero confirms little.

use serde::Serialize;

use super::facts::{Reading, RegisterMap, Signal, product_of};
use super::terms::{Quantity, Unit};
use super::value::{Kind, Layout, Order};

/// Current of a machine at rest, as a share of the rated one: offset and noise of a sensor.
const CURRENT_SHARE: f64 = 0.1;
/// From a small battery to the DC link of a 690 V converter, V.
const SUPPLY_V: [f64; 2] = [8.0, 1500.0];

/// Range of a signal while the drive is powered and the shaft stands still, in the signal's unit; `None`: unknown.
pub(crate) fn expected_at_rest(
    quantity: Quantity,
    unit: Unit,
    rated_current_a: Option<f64>,
) -> Option<[f64; 2]> {
    let around_zero = |most: f64| Some([-most, most]);
    match (quantity, unit) {
        (Quantity::ShaftSpeed | Quantity::OutputSpeed, unit) => match unit {
            // Speeds that a sensor or an observer shows at rest: 1 % of 3000 r/min.
            Unit::Rpm => around_zero(30.0),
            Unit::RadS => around_zero(3.0),
            Unit::Hertz => around_zero(0.5),
            Unit::Percent => around_zero(1.0),
            _ => None,
        },
        (Quantity::Current, Unit::A) => {
            // The same where no rated current is known, A.
            around_zero(rated_current_a.map_or(1.0, |rated| CURRENT_SHARE * rated))
        }
        // Output of a power stage that is off, V.
        (Quantity::Voltage, Unit::V) => around_zero(10.0),
        (Quantity::Current | Quantity::Torque, Unit::Percent) => around_zero(100.0 * CURRENT_SHARE),
        (Quantity::Torque, Unit::NewtonMetre) => around_zero(1.0),
        (Quantity::Power, Unit::KiloWatt) => around_zero(0.1),
        (Quantity::Duty | Quantity::Power | Quantity::Voltage, Unit::Percent) => around_zero(5.0),
        (Quantity::BusVoltage | Quantity::LineVoltage, Unit::V) => Some(SUPPLY_V),
        (Quantity::FieldCurrent, Unit::A) => Some([0.0, 1000.0]),
        (Quantity::Temperature, Unit::Celsius) => Some([-40.0, 150.0]),
        (Quantity::RatedCurrent | Quantity::CurrentLimit, Unit::A) => Some([0.01, 10_000.0]),
        (Quantity::RatedVoltage | Quantity::VoltageLimit, Unit::V) => Some([1.0, 2000.0]),
        (Quantity::RatedSpeed, Unit::Rpm) => Some([10.0, 100_000.0]),
        _ => None,
    }
}

/// Whether a reading within its range also confirms address and order: a register that is not there reads zero as well.
pub(crate) fn confirms(range: [f64; 2], value: f64) -> bool {
    let [low, high] = range;
    (low..=high).contains(&value) && !(low..=high).contains(&0.0)
}

/// Factors of factors that are followed.
const DEEPEST: usize = 3;

/// Difference of a decoding from that of the profile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Change {
    /// Registers that the address is moved by: -1, 0 or 1.
    pub shift: i8,
    pub words: bool,
    pub bytes: bool,
    /// Signed for unsigned, and the other way.
    pub sign: bool,
}

impl Change {
    const NONE: Self = Self { shift: 0, words: false, bytes: false, sign: false };

    /// Every change that makes a difference to such a layout.
    fn all(layout: Layout) -> Vec<Self> {
        let has_words = layout.cells() > 1;
        let has_sign = layout.kind != Kind::F32;
        let of_shift = |shift| {
            (0..8_u8).map(move |bits| Self {
                shift,
                words: bits & 4 != 0,
                bytes: bits & 2 != 0,
                sign: bits & 1 != 0,
            })
        };
        let mut all: Vec<Self> = [0, -1, 1].into_iter().flat_map(of_shift).collect();
        all.retain(|c| *c != Self::NONE && (has_words || !c.words) && (has_sign || !c.sign));
        all.sort_by_key(|change| change.size());
        all
    }

    /// Number of errors that the profile would have.
    fn size(self) -> u8 {
        u8::from(self.shift != 0)
            + u8::from(self.words)
            + u8::from(self.bytes)
            + u8::from(self.sign)
    }

    fn apply(self, layout: Layout) -> Layout {
        let turned = |order: Order, turn: bool| match (order, turn) {
            (Order::HighFirst, true) => Order::LowFirst,
            (Order::LowFirst, true) => Order::HighFirst,
            (order, false) => order,
        };
        let kind = layout.kind;
        Layout {
            kind: if self.sign { other_sign(kind) } else { kind },
            words: turned(layout.words, self.words),
            bytes: turned(layout.bytes, self.bytes),
            ..layout
        }
    }

    /// As it would stand in the profile.
    fn text(self, layout: Layout) -> String {
        let other = self.apply(layout);
        let parts = [
            (self.shift != 0).then(|| shift_text(self.shift).to_owned()),
            self.words.then(|| format!("word_order = \"{}\"", other.words.name())),
            self.bytes.then(|| format!("byte_order = \"{}\"", other.bytes.name())),
            self.sign.then(|| format!("type = \"{}\"", other.kind.name())),
        ];
        parts.into_iter().flatten().collect::<Vec<String>>().join(" and ")
    }
}

/// `address_base` says which number is register 0: a base that is one less moves every address up by one.
const fn shift_text(shift: i8) -> &'static str {
    if shift > 0 {
        "the address one higher (base 0 instead of 1)"
    } else {
        "the address one lower (base 1 instead of 0)"
    }
}

const fn other_sign(kind: Kind) -> Kind {
    match kind {
        Kind::U8 => Kind::I8,
        Kind::I8 => Kind::U8,
        Kind::U16 => Kind::I16,
        Kind::I16 => Kind::U16,
        Kind::U32 => Kind::I32,
        Kind::I32 => Kind::U32,
        Kind::F32 => Kind::F32,
    }
}

/// Registers of one signal's length at its address, one below and one above; `None`: not read, or refused.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Window {
    pub below: Option<Vec<u16>>,
    pub here: Option<Vec<u16>>,
    pub above: Option<Vec<u16>>,
}

impl Window {
    fn at(&self, shift: i8) -> Option<&[u16]> {
        match shift {
            0 => self.here.as_deref(),
            ..0 => self.below.as_deref(),
            _ => self.above.as_deref(),
        }
    }
}

/// Another way of reading one signal.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Candidate {
    /// The change in the profile: `word_order = "low_first"`.
    pub change: String,
    /// In the profile's unit.
    pub value: f64,
    /// Whether it is plausible for a drive at rest.
    pub plausible: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hypothesis {
    pub change: String,
    /// Readings that would fit a drive at rest, of those that can be judged.
    pub plausible: usize,
    pub judged: usize,
    /// Those that fit as the profile is.
    pub as_written: usize,
}

/// All registers read from a drive, for several decodings.
pub struct Picture<'a> {
    pub map: &'a RegisterMap,
    /// By position in the map.
    pub windows: &'a [Window],
    pub rated_current_a: Option<f64>,
}

impl Picture<'_> {
    pub fn reading(&self, index: usize) -> Reading {
        self.read_as(index, Change::NONE, Change::NONE, DEEPEST)
    }

    /// Range of a signal at rest; `None`: it cannot be judged.
    pub fn expected(&self, index: usize) -> Option<[f64; 2]> {
        let signal = &self.map.signals[index];
        expected_at_rest(signal.keys.quantity, signal.numbers.unit, self.rated_current_a)
    }

    /// Whether a reading is plausible for a drive at rest; `None` if it cannot be judged.
    pub fn fits(&self, index: usize, reading: Reading) -> Option<bool> {
        let range = self.expected(index);
        match reading {
            Reading::Value(value) => range.map(|[low, high]| (low..=high).contains(&value)),
            Reading::NotAvailable => None,
            // A register that the drive refuses is none of its registers.
            Reading::Outside(_) | Reading::NotANumber | Reading::Unread => Some(false),
        }
    }

    /// Whether a missing register, which reads zero, could not give this reading.
    pub fn confirms(&self, index: usize) -> bool {
        let range = self.expected(index);
        let value = self.reading(index).value();
        range.zip(value).is_some_and(|(range, value)| confirms(range, value))
    }

    /// Whether the registers at a signal's address, moved by `shift`, are partly those of another mapped signal. Two
    /// signals of the very same registers, as bits of one word, are no trespass.
    fn trespasses(&self, index: usize, shift: i8) -> bool {
        let range = |signal: &Signal, shift: i8| {
            let from = i32::from(signal.location.address) + i32::from(shift);
            from..from + i32::from(signal.location.layout.cells())
        };
        let signal = &self.map.signals[index];
        let ours = range(signal, shift);
        let others = self.map.signals.iter().enumerate();
        others.filter(|(other, _)| *other != index).any(|(_, other)| {
            let theirs = range(other, 0);
            other.location.table == signal.location.table
                && ours.start < theirs.end
                && theirs.start < ours.end
                && (shift != 0 || ours != theirs)
        })
    }

    /// Other ways of reading a signal, the likeliest first: those that fit, of those the ones that use no register of
    /// another signal, and of those the smallest changes.
    pub fn candidates(&self, index: usize) -> Vec<Candidate> {
        let layout = self.map.signals[index].location.layout;
        let written = self.reading(index).value();
        let moved = self.moved();
        let mut found: Vec<(bool, Candidate)> = Vec::new();
        for change in Change::all(layout) {
            let reading = self.read_as(index, change, Change::NONE, DEEPEST);
            let Some(value) = reading.value() else { continue };
            let same = |other: f64| (other - value).abs() <= 1e-9 * value.abs();
            // A change that changes nothing explains nothing.
            let candidate = Candidate {
                change: change.text(layout),
                value,
                plausible: self.fits(index, reading) == Some(true),
            };
            // Where every address is off, the others' registers lie elsewhere too.
            let trespasses = self.trespasses(index, change.shift)
                && self.trespasses(index, change.shift - moved);
            if written.is_some_and(same) {
                continue;
            }
            match found.iter_mut().find(|(_, known)| same(known.value)) {
                // The same value by registers of its own is the better reason for it.
                Some(known) if known.0 && !trespasses => *known = (trespasses, candidate),
                Some(_) => {}
                None => found.push((trespasses, candidate)),
            }
        }
        found.sort_by_key(|(trespasses, candidate)| (!candidate.plausible, *trespasses));
        // Candidates that are worth showing for one signal.
        found.truncate(8);
        found.into_iter().map(|(_, candidate)| candidate).collect()
    }

    /// Where one signal alone does not fit and its likeliest candidate would: that change.
    fn of_one_signal(&self) -> Option<Hypothesis> {
        let misfits = |index: &usize| self.fits(*index, self.reading(*index)) == Some(false);
        let mut wrong = (0..self.map.signals.len()).filter(misfits);
        let (index, None) = (wrong.next()?, wrong.next()) else { return None };
        let candidate = self.candidates(index).into_iter().next()?;
        let change = candidate.change.split(" (").next().unwrap_or_default();
        let fits = |index: &usize| self.fits(*index, self.reading(*index)) == Some(true);
        let as_written = (0..self.map.signals.len()).filter(fits).count();
        candidate.plausible.then(|| Hypothesis {
            change: format!("{change} for {} alone", self.map.signals[index].name),
            plausible: as_written + 1,
            judged: self.judged(),
            as_written,
        })
    }

    /// Single changes of the whole profile that make more readings fit than it does as it is: the best of them; else the
    /// one of the only signal that does not fit.
    pub fn hypotheses(&self) -> Vec<Hypothesis> {
        let of_whole = self.of_whole().into_iter();
        let mut found: Vec<Hypothesis> = of_whole.map(|(_, hypothesis)| hypothesis).collect();
        if found.is_empty() {
            found.extend(self.of_one_signal());
        }
        found
    }

    /// Registers that the whole profile is most likely off by.
    fn moved(&self) -> i8 {
        self.of_whole().first().map_or(0, |(change, _)| change.shift)
    }

    fn of_whole(&self) -> Vec<(Change, Hypothesis)> {
        let fitting = |change: Change| {
            let fits = |index: &usize| {
                let reading = self.read_as(*index, change, change, DEEPEST);
                // Where a signal stands on registers of another, another order of them explains nothing.
                let borrowed =
                    change != Change::NONE && change.shift == 0 && self.trespasses(*index, 0);
                self.expected(*index).is_some()
                    && self.fits(*index, reading) == Some(true)
                    && (!borrowed || self.fits(*index, self.reading(*index)) == Some(true))
            };
            (0..self.map.signals.len()).filter(fits).count()
        };
        let (judged, as_written) = (self.judged(), fitting(Change::NONE));
        let shifted = |shift| {
            let change = Change { shift, ..Change::NONE };
            (change, shift_text(shift).replace("the address", "every address"))
        };
        let ordered = |words| {
            let (change, none) = (Change { words, bytes: !words, ..Change::NONE }, String::new);
            let layouts = self.map.signals.iter().map(|signal| signal.location.layout);
            // The other order than that of the first signal which has one.
            let mut of_interest = layouts.filter(|layout| !words || layout.cells() > 1);
            let text = |layout| format!("{} everywhere", change.text(layout));
            (change, of_interest.next().map_or_else(none, text))
        };
        let changes = [shifted(1), shifted(-1), ordered(true), ordered(false)];
        let found = changes.into_iter().map(|(change, text)| {
            let hypothesis =
                Hypothesis { change: text, plausible: fitting(change), judged, as_written };
            (change, hypothesis)
        });
        let mut found: Vec<(Change, Hypothesis)> =
            found.filter(|(_, hypothesis)| hypothesis.plausible > as_written).collect();
        // Only the best is reported.
        let best = found.iter().map(|(_, found)| found.plausible).max();
        found.retain(|(_, found)| Some(found.plausible) == best);
        found
    }

    /// Signals of which a range at rest is known.
    fn judged(&self) -> usize {
        let known = |index: &usize| self.expected(*index).is_some();
        (0..self.map.signals.len()).filter(known).count()
    }

    /// One signal read with `change`, the signals that it is scaled with read with `of_factors`.
    fn read_as(&self, index: usize, change: Change, of_factors: Change, depth: usize) -> Reading {
        let signal = &self.map.signals[index];
        if let Some(formula) = &signal.formula {
            let reading = |index| {
                self.read_as(index, Change::NONE, of_factors, depth.checked_sub(1)?).value()
            };
            return formula.value(reading).map_or(Reading::Unread, Reading::Value);
        }
        let Some(registers) = self.windows.get(index).and_then(|w| w.at(change.shift)) else {
            return Reading::Unread;
        };
        let layout = change.apply(signal.location.layout);
        let Some(pattern) = layout.pattern(registers) else { return Reading::Unread };
        signal.read(layout, pattern, self.factor(signal, of_factors, depth))
    }

    fn factor(&self, signal: &Signal, change: Change, depth: usize) -> Option<f64> {
        product_of(&signal.numbers.scale_by, |name| {
            self.read_as(self.map.index(name)?, change, change, depth.checked_sub(1)?).value()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DriveProfile;

    /// A map with a supply voltage of two registers, and what a drive shows that has 120 V, 0.03 A and a standing shaft.
    fn map(bus: &str) -> RegisterMap {
        let text = DriveProfile::text("epulse50-dc").unwrap().replace(
            "[missing]",
            &format!(
                "[signals.bus]\naddress = 0x1220\n{bus}\nunit = \"V\"\nquantity = \"bus_voltage\"\norigin = \"measured\"\npoll = \"fast\"\n\n[missing]"
            ),
        );
        RegisterMap::parse("x.toml", &text).unwrap()
    }

    /// Windows by name; the others read zeros.
    fn windows(map: &RegisterMap, known: &[(&str, Window)]) -> Vec<Window> {
        map.signals
            .iter()
            .map(|signal| {
                let zeros = || Some(vec![0; usize::from(signal.location.layout.cells())]);
                let given = known.iter().find(|(name, _)| *name == signal.name);
                let none = || Window { below: zeros(), here: zeros(), above: zeros() };
                given.map_or_else(none, |(_, window)| window.clone())
            })
            .collect()
    }

    fn index(map: &RegisterMap, name: &str) -> usize {
        map.index(name).unwrap()
    }

    fn picture<'a>(map: &'a RegisterMap, windows: &'a [Window]) -> Picture<'a> {
        Picture { map, windows, rated_current_a: None }
    }

    /// Candidates of one signal and the hypotheses for these windows.
    fn judged(
        map: &RegisterMap,
        known: &[(&str, Window)],
        signal: &str,
    ) -> (Vec<Candidate>, Vec<Hypothesis>) {
        let windows = windows(map, known);
        let picture = picture(map, &windows);
        (picture.candidates(index(map, signal)), picture.hypotheses())
    }

    fn window(below: &[u16], here: &[u16], above: &[u16]) -> Window {
        let some = |registers: &[u16]| (!registers.is_empty()).then(|| registers.to_vec());
        Window { below: some(below), here: some(here), above: some(above) }
    }

    #[test]
    fn an_address_one_off_is_found_on_its_side() {
        // One register too high: the low word reads as the high one, and the other word is that of the next signal.
        let mut map = map("type = \"u32\"\nscale = 0.1");
        let (bus, current) = (index(&map, "bus"), index(&map, "current"));
        map.signals[current].location.address = map.signals[bus].location.address + 1;
        map.signals[current].location.table = map.signals[bus].location.table;
        let known =
            [("bus", window(&[0, 1200], &[1200, 0], &[])), ("current", window(&[1200], &[0], &[]))];
        let (candidates, hypotheses) = judged(&map, &known, "bus");
        let first = &candidates[0];
        let is_lower = first.change.starts_with("the address one lower");
        assert!(first.plausible && is_lower, "{candidates:?}");
        assert_eq!(hypotheses[0].change, "the address one lower for bus alone");
        assert_eq!(hypotheses[0].plausible, hypotheses[0].as_written + 1);
    }

    #[test]
    fn sign_and_byte_order_are_candidates_if_they_matter() {
        let mut unsigned = map("type = \"u16\"");
        let at = index(&unsigned, "current");
        unsigned.signals[at].location.layout.kind = Kind::U16;
        // -3 raw of a drive whose current is signed after all; 120 V with its bytes exchanged.
        let known = [
            ("current", window(&[], &[0xFFFD], &[])),
            ("bus", window(&[], &[120_u16.swap_bytes()], &[])),
        ];
        let (candidates, _) = judged(&unsigned, &known, "current");
        assert_eq!(candidates[0].change, "type = \"i16\"");
        assert!((candidates[0].value + 0.3).abs() < 1e-9 && candidates[0].plausible);
        let (candidates, _) = judged(&unsigned, &known, "bus");
        assert_eq!(candidates[0].change, "byte_order = \"low_first\"");
        assert!((candidates[0].value - 120.0).abs() < 1e-9);
        assert!(candidates.iter().all(|c| c.change != "type = \"i16\""));
    }

    #[test]
    fn codes_ranges_and_refusals_are_no_values() {
        let map = map("type = \"u16\"\nvalid = [50, 900]\ninvalid = [0xFFFF]");
        let bus = index(&map, "bus");
        for (registers, reading, fits) in [
            (&[0xFFFF][..], Reading::NotAvailable, None),
            (&[5], Reading::Outside(5.0), Some(false)),
            (&[], Reading::Unread, Some(false)),
            (&[120], Reading::Value(120.0), Some(true)),
        ] {
            let windows = windows(&map, &[("bus", window(&[], registers, &[]))]);
            let picture = picture(&map, &windows);
            assert_eq!(picture.reading(bus), reading);
            assert_eq!(picture.fits(bus, reading), fits);
        }
    }

    #[test]
    fn a_standing_shaft_reads_about_zero_in_every_unit() {
        let map = DriveProfile::named("siemens-v20").unwrap().registers.unwrap();
        let expected = |signal: &str, rated_a| {
            let signal = map.signal(signal).unwrap();
            expected_at_rest(signal.keys.quantity, signal.numbers.unit, rated_a)
        };
        for (signal, rated_a, range) in [
            ("speed", None, Some([-30.0, 30.0])),
            ("frequency", None, Some([-0.5, 0.5])),
            ("current", None, Some([-1.0, 1.0])),
            ("current", Some(40.0), Some([-4.0, 4.0])),
            ("status", None, None),
        ] {
            assert_eq!(expected(signal, rated_a), range, "{signal} {rated_a:?}");
        }
        // Only what is not zero at rest confirms an address.
        let bus = expected("bus", None).unwrap();
        assert!(confirms(bus, 325.0) && !confirms(bus, 0.0) && !confirms(bus, 21_000.0));
        assert!(!confirms([-30.0, 30.0], 0.0) && !confirms([-30.0, 30.0], 12.0));
    }
}
