//! Ways in which manuals write an address, and the one that goes on the wire.

use serde::Deserialize;

/// What the numbers of a manual count from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Base {
    /// Protocol addresses: as on the wire.
    Zero,
    /// Register numbers: one more than on the wire.
    One,
    /// Modicon numbers: 40001 or 400001 is holding register 0, 30001 or 300001 input register 0.
    Modicon,
}

/// `0`, `1` or `"4x1"`.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum BaseText {
    Number(i64),
    Text(String),
}

impl BaseText {
    pub(super) fn base(&self) -> Option<Base> {
        match self {
            Self::Number(0) => Some(Base::Zero),
            Self::Number(1) => Some(Base::One),
            Self::Text(text) if text == "4x1" => Some(Base::Modicon),
            _ => None,
        }
    }
}

/// How a parameter's name becomes a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub(super) enum Formula {
    #[serde(rename = "100*group+index")]
    HundredPerGroup,
    #[serde(rename = "256*group+index")]
    ByteGroup,
    #[serde(rename = "(canid<<5|ch)&0xFFFF")]
    CanObject,
}

/// How the numbers of one profile are meant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Numbering {
    pub(super) base: Base,
    pub(super) formula: Option<Formula>,
}

/// Address on the wire, and whether it is an input register's where the number itself tells it.
pub(super) type Resolved = (u16, Option<bool>);

impl Numbering {
    /// The address on the wire of what a profile writes as one of a number, a parameter (`"01.07"`: group and index), or
    /// object and channel; the error says what is allowed.
    pub(super) fn resolve(
        self,
        address: Option<i64>,
        parameter: Option<&str>,
        can: Option<[i64; 2]>,
    ) -> Result<Resolved, String> {
        match (address, parameter, can) {
            (Some(number), None, None) => self.number(number),
            (None, Some(text), None) => self.parameter(text),
            (None, None, Some([object, channel])) => {
                if self.formula != Some(Formula::CanObject) {
                    return Err(
                        "can needs link.address_formula \"(canid<<5|ch)&0xFFFF\"".to_owned()
                    );
                }
                if !(0..=0xFFFF).contains(&object) || !(0..=31).contains(&channel) {
                    return Err(format!(
                        "can [{object:#x}, {channel}] is not allowed (expected an object up to 0xFFFF and a channel up to 31)"
                    ));
                }
                Ok((wire(((object << 5) | channel) & 0xFFFF, 0)?, None))
            }
            (None, None, None) => {
                Err("the address is missing (expected address, parameter or can)".to_owned())
            }
            _ => {
                Err("more than one of address, parameter and can is given (expected one)"
                    .to_owned())
            }
        }
    }

    pub(super) fn number(self, number: i64) -> Result<Resolved, String> {
        let (first, is_input) = match (self.base, number) {
            (Base::Zero, _) => (0, None),
            (Base::One, _) => (1, None),
            (Base::Modicon, 40_001..=49_999) => (40_001, Some(false)),
            (Base::Modicon, 30_001..=39_999) => (30_001, Some(true)),
            (Base::Modicon, 400_001..=465_536) => (400_001, Some(false)),
            (Base::Modicon, 300_001..=365_536) => (300_001, Some(true)),
            (Base::Modicon, _) => {
                return Err(format!(
                    "address {number} is not allowed (expected 40001 to 49999, 30001 to 39999, 400001 to 465536 or 300001 to 365536 with address_base \"4x1\")"
                ));
            }
        };
        Ok((wire(number, first)?, is_input))
    }

    fn parameter(self, text: &str) -> Result<Resolved, String> {
        let parts = text.split_once('.');
        let (group, index) = parts
            .and_then(|(group, index)| {
                Some((group.parse::<i64>().ok()?, index.parse::<i64>().ok()?))
            })
            .ok_or_else(|| {
                format!("parameter {text:?} is not allowed (expected \"GROUP.INDEX\")")
            })?;
        let number = match self.formula {
            Some(Formula::HundredPerGroup) => 100 * group + index,
            Some(Formula::ByteGroup) => 256 * group + index,
            Some(Formula::CanObject) | None => {
                return Err(format!(
                    "parameter {text:?} needs link.address_formula \"100*group+index\" or \"256*group+index\""
                ));
            }
        };
        // A parameter's number has no leading 4: it counts from the base like a short register number.
        Ok((wire(number, i64::from(self.base != Base::Zero))?, None))
    }
}

fn wire(number: i64, first: i64) -> Result<u16, String> {
    u16::try_from(number - first).map_err(|_| {
        let last = first + 0xFFFF;
        format!("address {number} is not allowed (expected {first} to {last})")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn address_bases_and_formulas_are_those_of_manuals() {
        let number = |address, base| {
            let formula = None;
            Numbering { base, formula }.resolve(Some(address), None, None)
        };
        for (address, base, wire) in [
            (0x2103, Base::Zero, Some((0x2103, None))),
            (1, Base::One, Some((0, None))),
            (40_100, Base::Modicon, Some((99, Some(false)))),
            (400_001, Base::Modicon, Some((0, Some(false)))),
            (465_536, Base::Modicon, Some((0xFFFF, Some(false)))),
            (30_011, Base::Modicon, Some((10, Some(true)))),
            (-1, Base::Zero, None),
            (65_536, Base::Zero, None),
            (0, Base::One, None),
            (40_000, Base::Modicon, None),
            (50_000, Base::Modicon, None),
            (465_537, Base::Modicon, None),
        ] {
            assert_eq!(number(address, base).ok(), wire, "{address} {base:?}");
        }
        let hundred = Some(Formula::HundredPerGroup);
        for (text, formula, wire) in [
            // ABB: parameter 01.07 is register 400107.
            ("01.07", hundred, Some(106)),
            ("58.16", hundred, Some(5815)),
            ("01.07", Some(Formula::ByteGroup), Some(262)),
            ("1-7", hundred, None),
            ("01.07", None, None),
        ] {
            let base = Base::Modicon;
            let found = Numbering { base, formula }.resolve(None, Some(text), None);
            assert_eq!(found.ok().map(|(wire, _)| wire), wire, "{text} {formula:?}");
        }
        // Roboteq: object 0x2100, channel 1 is register 0x2001.
        for (object, channel, wire) in [
            (0x2100, 1, Some(0x2001)),
            (0x2000, 1, Some(0x0001)),
            (0x200D, 0, Some(0x01A0)),
            (0x2100, 32, None),
        ] {
            let (base, formula) = (Base::Zero, Some(Formula::CanObject));
            let found = Numbering { base, formula }.resolve(None, None, Some([object, channel]));
            assert_eq!(found.ok().map(|(wire, _)| wire), wire, "{object:#x} {channel}");
        }
    }
}
