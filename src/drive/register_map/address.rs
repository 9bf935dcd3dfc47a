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

/// An address as a profile writes it: one of the three.
#[derive(Clone, Copy, Debug)]
pub(super) struct Written<'a> {
    pub(super) address: Option<i64>,
    /// `"01.07"`: group and index.
    pub(super) parameter: Option<&'a str>,
    /// Object and channel.
    pub(super) can: Option<[i64; 2]>,
}

/// Address on the wire, and the table where the number itself tells it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Resolved {
    pub(super) address: u16,
    pub(super) is_input: Option<bool>,
}

/// The address on the wire; the error says what is allowed.
pub(super) fn resolve(
    written: Written<'_>,
    base: Base,
    formula: Option<Formula>,
) -> Result<Resolved, String> {
    match (written.address, written.parameter, written.can) {
        (Some(number), None, None) => from_number(number, base),
        (None, Some(text), None) => {
            let (group, index) = text
                .split_once('.')
                .and_then(|(group, index)| {
                    Some((group.parse::<i64>().ok()?, index.parse::<i64>().ok()?))
                })
                .ok_or_else(|| {
                    format!("parameter {text:?} is not allowed (expected \"GROUP.INDEX\")")
                })?;
            let number = match formula {
                Some(Formula::HundredPerGroup) => 100 * group + index,
                Some(Formula::ByteGroup) => 256 * group + index,
                Some(Formula::CanObject) | None => {
                    return Err(format!(
                        "parameter {text:?} needs link.address_formula \"100*group+index\" or \"256*group+index\""
                    ));
                }
            };
            // A parameter's number has no leading 4: it counts from the base like a short register number.
            plain(number, i64::from(base != Base::Zero))
        }
        (None, None, Some([object, channel])) => {
            if formula != Some(Formula::CanObject) {
                return Err("can needs link.address_formula \"(canid<<5|ch)&0xFFFF\"".to_owned());
            }
            if !(0..=0xFFFF).contains(&object) || !(0..=31).contains(&channel) {
                return Err(format!(
                    "can [{object:#x}, {channel}] is not allowed (expected an object up to 0xFFFF and a channel up to 31)"
                ));
            }
            plain(((object << 5) | channel) & 0xFFFF, 0)
        }
        (None, None, None) => {
            Err("the address is missing (expected address, parameter or can)".to_owned())
        }
        _ => Err("more than one of address, parameter and can is given (expected one)".to_owned()),
    }
}

fn from_number(number: i64, base: Base) -> Result<Resolved, String> {
    match base {
        Base::Zero => plain(number, 0),
        Base::One => plain(number, 1),
        Base::Modicon => {
            let (first, is_input) = match number {
                40_001..=49_999 => (40_001, false),
                30_001..=39_999 => (30_001, true),
                400_001..=465_536 => (400_001, false),
                300_001..=365_536 => (300_001, true),
                _ => {
                    return Err(format!(
                        "address {number} is not allowed (expected 40001 to 49999, 30001 to 39999, 400001 to 465536 or 300001 to 365536 with address_base \"4x1\")"
                    ));
                }
            };
            let resolved = plain(number, first)?;
            Ok(Resolved {
                is_input: Some(is_input),
                ..resolved
            })
        }
    }
}

fn plain(number: i64, first: i64) -> Result<Resolved, String> {
    u16::try_from(number - first)
        .map(|address| Resolved {
            address,
            is_input: None,
        })
        .map_err(|_| {
            format!(
                "address {number} is not allowed (expected {first} to {})",
                first + 0xFFFF
            )
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(address: i64, base: Base) -> Result<Resolved, String> {
        let written = Written {
            address: Some(address),
            parameter: None,
            can: None,
        };
        resolve(written, base, None)
    }

    #[test]
    fn numbers_count_from_their_base() {
        let wire = |address, base| number(address, base).unwrap().address;
        assert_eq!(wire(0x2103, Base::Zero), 0x2103);
        assert_eq!(wire(1, Base::One), 0);
        assert_eq!(wire(40_100, Base::Modicon), 99);
        assert_eq!(wire(400_001, Base::Modicon), 0);
        assert_eq!(wire(465_536, Base::Modicon), 0xFFFF);
        assert_eq!(number(30_011, Base::Modicon).unwrap().is_input, Some(true));
        for (wrong, base) in [
            (-1, Base::Zero),
            (65_536, Base::Zero),
            (0, Base::One),
            (40_000, Base::Modicon),
            (50_000, Base::Modicon),
            (465_537, Base::Modicon),
        ] {
            assert!(number(wrong, base).is_err(), "{wrong} {base:?}");
        }
    }

    #[test]
    fn formulas_are_those_of_the_manuals() {
        let parameter = |text, formula| {
            let written = Written {
                address: None,
                parameter: Some(text),
                can: None,
            };
            resolve(written, Base::Modicon, formula).map(|found| found.address)
        };
        // ABB: parameter 01.07 is register 400107.
        let hundred = Some(Formula::HundredPerGroup);
        assert_eq!(parameter("01.07", hundred), Ok(106));
        assert_eq!(parameter("58.16", hundred), Ok(5815));
        assert_eq!(parameter("01.07", Some(Formula::ByteGroup)), Ok(262));
        assert!(parameter("1-7", hundred).is_err());
        assert!(parameter("01.07", None).is_err());
        // Roboteq: object 0x2100, channel 1 is register 0x2001.
        let can = |object, channel| {
            let written = Written {
                address: None,
                parameter: None,
                can: Some([object, channel]),
            };
            resolve(written, Base::Zero, Some(Formula::CanObject)).map(|found| found.address)
        };
        assert_eq!(can(0x2100, 1), Ok(0x2001));
        assert_eq!(can(0x2000, 1), Ok(0x0001));
        assert_eq!(can(0x200D, 0), Ok(0x01A0));
        assert!(can(0x2100, 32).is_err());
    }
}
