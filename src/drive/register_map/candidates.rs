//! Other ways of reading what a drive answered: address one beside, word order, byte order, sign. Pure.
//!
//! ```text
//! registers at address - 1, 0, + 1 -> Change -> value in units -> does that fit a drive at rest? -> Candidate, Hypothesis
//! ```
//!
//! A profile that is wrong about one of these gives numbers that look like numbers. At rest the true ones are known well
//! enough to tell.

use serde::Serialize;

use super::facts::{RegisterMap, Signal};
use super::rest::{confirms, expected_at_rest};
use super::value::{Kind, Layout, Order};

/// Factors of factors that are followed.
const DEEPEST: usize = 3;
/// Candidates that are worth showing for one signal.
const MOST: usize = 8;

/// What is read otherwise than the profile says.
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
    const NONE: Self = Self {
        shift: 0,
        words: false,
        bytes: false,
        sign: false,
    };

    /// Every change that makes a difference to such a layout.
    fn all(layout: Layout) -> Vec<Self> {
        let flags = |possible: bool| {
            if possible {
                &[false, true][..]
            } else {
                &[false]
            }
        };
        let mut all = Vec::new();
        for shift in [0, -1, 1] {
            for words in flags(layout.registers() > 1) {
                for bytes in flags(true) {
                    for sign in flags(layout.kind != Kind::F32) {
                        all.push(Self {
                            shift,
                            words: *words,
                            bytes: *bytes,
                            sign: *sign,
                        });
                    }
                }
            }
        }
        all.retain(|change| *change != Self::NONE);
        all.sort_by_key(|change| change.size());
        all
    }

    /// Things that the profile would have wrong at once.
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
        Layout {
            kind: if self.sign {
                other_sign(layout.kind)
            } else {
                layout.kind
            },
            words: turned(layout.words, self.words),
            bytes: turned(layout.bytes, self.bytes),
            ..layout
        }
    }

    /// As it would stand in the profile.
    fn text(self, layout: Layout) -> String {
        let other = self.apply(layout);
        let mut parts = Vec::new();
        if self.shift != 0 {
            parts.push(shift_text(self.shift).to_owned());
        }
        if self.words {
            parts.push(format!("word_order = \"{}\"", order_name(other.words)));
        }
        if self.bytes {
            parts.push(format!("byte_order = \"{}\"", order_name(other.bytes)));
        }
        if self.sign {
            parts.push(format!("type = \"{}\"", kind_name(other.kind)));
        }
        parts.join(" and ")
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
        Kind::U16 => Kind::I16,
        Kind::I16 => Kind::U16,
        Kind::U32 => Kind::I32,
        Kind::I32 => Kind::U32,
        Kind::F32 => Kind::F32,
    }
}

const fn order_name(order: Order) -> &'static str {
    match order {
        Order::HighFirst => "high_first",
        Order::LowFirst => "low_first",
    }
}

const fn kind_name(kind: Kind) -> &'static str {
    match kind {
        Kind::U16 => "u16",
        Kind::I16 => "i16",
        Kind::U32 => "u32",
        Kind::I32 => "i32",
        Kind::F32 => "f32",
    }
}

/// Registers of one signal's length, at its address and one beside; `None`: not asked, or refused.
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

/// What a reading is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading {
    /// In the profile's unit.
    Value(f64),
    /// The profile's code for "not available".
    NotAvailable,
    /// Outside of the profile's `valid`.
    Outside(f64),
    /// A float register that holds no number.
    NotANumber,
    /// No registers, or a factor is missing.
    Unread,
}

impl Reading {
    /// In the profile's unit; what cannot be is none.
    pub const fn value(self) -> Option<f64> {
        match self {
            Self::Value(value) => Some(value),
            _ => None,
        }
    }
}

/// Another way of reading one signal.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Candidate {
    /// What the profile would have to say: `word_order = "low_first"`.
    pub change: String,
    /// In the profile's unit.
    pub value: f64,
    /// Whether a drive at rest may read so.
    pub plausible: bool,
}

/// One change for the whole profile.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hypothesis {
    pub change: String,
    /// Readings that would fit a drive at rest, of those that can be judged.
    pub plausible: usize,
    pub judged: usize,
    /// Those that fit as the profile is.
    pub as_written: usize,
}

/// Everything that was read of a drive, to be looked at in several ways.
pub struct Picture<'a> {
    pub map: &'a RegisterMap,
    /// By position in the map.
    pub windows: &'a [Window],
    pub rated_current_a: Option<f64>,
}

impl Picture<'_> {
    /// A signal as the profile says.
    pub fn reading(&self, index: usize) -> Reading {
        self.read_as(index, Change::NONE, Change::NONE, DEEPEST)
    }

    /// Where the profile's own reading should lie at rest; `None`: it cannot be judged.
    pub fn expected(&self, index: usize) -> Option<[f64; 2]> {
        expected_at_rest(&self.map.signals[index], self.rated_current_a)
    }

    /// Whether a reading fits a drive at rest; `None` where that cannot be told.
    pub fn fits(&self, index: usize, reading: Reading) -> Option<bool> {
        let range = self.expected(index);
        match reading {
            Reading::Value(value) => range.map(|[low, high]| (low..=high).contains(&value)),
            Reading::NotAvailable => None,
            // A register that the drive refuses is none of its registers.
            Reading::Outside(_) | Reading::NotANumber | Reading::Unread => Some(false),
        }
    }

    /// Whether a reading is one that no empty register would give.
    pub fn confirms(&self, index: usize) -> bool {
        let range = self.expected(index);
        let value = self.reading(index).value();
        range
            .zip(value)
            .is_some_and(|(range, value)| confirms(range, value))
    }

    /// Whether the registers at a signal's address, moved by `shift`, are partly those of another mapped signal. Two
    /// signals of the very same registers, as bits of one word, are no trespass.
    fn trespasses(&self, index: usize, shift: i8) -> bool {
        let range = |signal: &Signal, shift: i8| {
            let from = i32::from(signal.location.address) + i32::from(shift);
            from..from + i32::from(signal.location.layout.registers())
        };
        let signal = &self.map.signals[index];
        let ours = range(signal, shift);
        let others = self.map.signals.iter().enumerate();
        others
            .filter(|(other, _)| *other != index)
            .any(|(_, other)| {
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
            let Some(value) = reading.value() else {
                continue;
            };
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
        found.truncate(MOST);
        found.into_iter().map(|(_, candidate)| candidate).collect()
    }

    /// Where one signal alone does not fit and its likeliest candidate would: that change.
    fn of_one_signal(&self) -> Option<Hypothesis> {
        let misfits = |index: &usize| self.fits(*index, self.reading(*index)) == Some(false);
        let mut wrong = (0..self.map.signals.len()).filter(misfits);
        let (index, None) = (wrong.next()?, wrong.next()) else {
            return None;
        };
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
        let best = self.of_whole();
        best.first().map_or(0, |(change, _)| change.shift)
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
        let single = |shift, words, bytes| Change {
            shift,
            words,
            bytes,
            sign: false,
        };
        let mut found: Vec<(Change, Hypothesis)> = [
            (
                single(1, false, false),
                shift_text(1).replace("the address", "every address"),
            ),
            (
                single(-1, false, false),
                shift_text(-1).replace("the address", "every address"),
            ),
            (single(0, true, false), self.order_text(true)),
            (single(0, false, true), self.order_text(false)),
        ]
        .into_iter()
        .map(|(change, text)| {
            let hypothesis = Hypothesis {
                change: text,
                plausible: fitting(change),
                judged,
                as_written,
            };
            (change, hypothesis)
        })
        .filter(|(_, hypothesis)| hypothesis.plausible > as_written)
        .collect();
        // The second best explains less, and would only be noise beside the best.
        let best = found.iter().map(|(_, found)| found.plausible).max();
        found.retain(|(_, found)| Some(found.plausible) == best);
        found
    }

    /// Signals of which a range at rest is known.
    fn judged(&self) -> usize {
        let known = |index: &usize| self.expected(*index).is_some();
        (0..self.map.signals.len()).filter(known).count()
    }

    /// The other order than that of the first signal which has one.
    fn order_text(&self, words: bool) -> String {
        let layouts = self.map.signals.iter().map(|signal| signal.location.layout);
        let mut of_interest = layouts.filter(|layout| !words || layout.registers() > 1);
        let change = Change {
            words,
            bytes: !words,
            ..Change::NONE
        };
        of_interest.next().map_or_else(String::new, |layout| {
            format!("{} everywhere", change.text(layout))
        })
    }

    /// One signal read with `change`, the signals that it is scaled with read with `of_factors`.
    fn read_as(&self, index: usize, change: Change, of_factors: Change, depth: usize) -> Reading {
        let signal = &self.map.signals[index];
        let Some(registers) = self.windows.get(index).and_then(|w| w.at(change.shift)) else {
            return Reading::Unread;
        };
        let layout = change.apply(signal.location.layout);
        let Some(pattern) = layout.pattern(registers) else {
            return Reading::Unread;
        };
        if signal.keys.invalid.contains(&pattern) {
            return Reading::NotAvailable;
        }
        let Some(factor) = self.factor(signal, of_factors, depth) else {
            return Reading::Unread;
        };
        let value = signal.numbers.value(layout.number(pattern), factor);
        if !value.is_finite() {
            return Reading::NotANumber;
        }
        match signal.keys.valid {
            Some([low, high]) if !(low..=high).contains(&value) => Reading::Outside(value),
            _ => Reading::Value(value),
        }
    }

    fn factor(&self, signal: &Signal, change: Change, depth: usize) -> Option<f64> {
        let of = |name: &String| {
            let depth = depth.checked_sub(1)?;
            let index = self.map.signals.iter().position(|s| s.name == *name)?;
            self.read_as(index, change, change, depth).value()
        };
        signal.numbers.scale_by.iter().map(of).product()
    }
}

#[cfg(test)]
mod tests;
