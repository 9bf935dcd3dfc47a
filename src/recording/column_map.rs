//! `--map 'target=header[*factor][+offset],...'`: which column of a foreign file is which quantity.

use std::str::FromStr;

use super::RecordingError;
use super::csv_line::closing_quote;
use crate::config_text::help_for_unknown;
use crate::sample::Channel;

/// One quantity out of one column: `value = cell * factor + offset`.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapping {
    /// `None` is the time axis.
    pub target: Option<Channel>,
    pub header: String,
    pub factor: f64,
    pub offset: f64,
    /// A factor or an offset was written, if only `*1`: somebody thought of the unit.
    pub scaled: bool,
}

/// A parsed `--map`: every target at most once, the time axis among them.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnMap {
    items: Vec<Mapping>,
}

impl ColumnMap {
    pub fn items(&self) -> &[Mapping] {
        &self.items
    }

    /// The names that may stand left of the `=`.
    pub fn targets() -> impl Iterator<Item = &'static str> + Clone {
        std::iter::once("time_s").chain(Channel::ALL.into_iter().map(Channel::key))
    }
}

impl FromStr for ColumnMap {
    type Err = RecordingError;

    fn from_str(text: &str) -> Result<Self, RecordingError> {
        let mut items: Vec<Mapping> = Vec::new();
        for item in split_items(text) {
            let mapping = parse_item(item)?;
            if items.iter().any(|other| other.target == mapping.target) {
                return Err(wrong(item, "this target was given before"));
            }
            items.push(mapping);
        }
        if items.iter().all(|item| item.target.is_some()) {
            return Err(RecordingError::MapWithoutTime);
        }
        Ok(Self { items })
    }
}

fn split_items(text: &str) -> Vec<&str> {
    let mut items = Vec::new();
    let mut quoted = false;
    let mut start = 0;
    for (at, letter) in text.char_indices() {
        match letter {
            '"' => quoted = !quoted,
            ',' if !quoted => {
                items.push(text[start..at].trim());
                start = at + 1;
            }
            _ => {}
        }
    }
    items.push(text[start..].trim());
    // A comma at the very end is harmless.
    if items.len() > 1 && items.last().is_some_and(|last| last.is_empty()) {
        items.pop();
    }
    items
}

fn parse_item(item: &str) -> Result<Mapping, RecordingError> {
    let (target, source) = item
        .split_once('=')
        .ok_or_else(|| wrong(item, "no = between target and header"))?;
    let target = target.trim();
    let target = if target == "time_s" {
        None
    } else {
        Some(
            Channel::from_key(target).ok_or_else(|| RecordingError::UnknownTarget {
                target: target.to_owned(),
                help: unknown_target_help(target),
            })?,
        )
    };
    let source = source.trim();
    let (header, factor, offset, scaled) = if let Some(quoted) = source.strip_prefix('"') {
        let close = closing_quote(quoted.as_bytes(), 0)
            .ok_or_else(|| wrong(item, "the quote around the header is not closed"))?;
        let scale = quoted[close + 1..].trim();
        let (factor, offset) = parse_scale(item, scale)?;
        let header = quoted[..close].replace("\"\"", "\"");
        (header, factor, offset, !scale.is_empty())
    } else {
        let (header, factor, offset) = parse_plain(item, source)?;
        let scaled = header.trim() != source;
        (header, factor, offset, scaled)
    };
    let header = header.trim().to_owned();
    if header.is_empty() {
        return Err(wrong(item, "the header is empty"));
    }
    Ok(Mapping {
        target,
        header,
        factor,
        offset,
        scaled,
    })
}

/// A header without quotes: the factor follows the last `*`; without one, a `+` begins the offset where a number follows
/// it, and belongs to the header where none does.
fn parse_plain(item: &str, source: &str) -> Result<(String, f64, f64), RecordingError> {
    if let Some(star) = source.rfind('*') {
        let (factor, offset) = parse_scale(item, &source[star..])?;
        return Ok((source[..star].to_owned(), factor, offset));
    }
    for (plus, _) in source.match_indices('+') {
        if let Some(offset) = number(&source[plus + 1..]) {
            return Ok((source[..plus].to_owned(), 1.0, offset));
        }
    }
    Ok((source.to_owned(), 1.0, 0.0))
}

/// `[*factor][+offset]`. A `+` may also be part of an exponent, as in `1e+3`.
fn parse_scale(item: &str, scale: &str) -> Result<(f64, f64), RecordingError> {
    if scale.is_empty() {
        return Ok((1.0, 0.0));
    }
    if let Some(offset) = scale.strip_prefix('+') {
        let offset = number(offset).ok_or_else(|| {
            wrong(
                item,
                format!("the offset {offset:?} is not a finite number"),
            )
        })?;
        return Ok((1.0, offset));
    }
    let Some(scale) = scale.strip_prefix('*') else {
        return Err(wrong(
            item,
            format!("{scale:?} after the header is neither *factor nor +offset"),
        ));
    };
    if let Some(factor) = number(scale) {
        return nonzero(item, factor).map(|factor| (factor, 0.0));
    }
    for (plus, _) in scale.match_indices('+') {
        if let (Some(factor), Some(offset)) = (number(&scale[..plus]), number(&scale[plus + 1..])) {
            return nonzero(item, factor).map(|factor| (factor, offset));
        }
    }
    Err(wrong(
        item,
        format!("{scale:?} after the last * is neither a factor nor factor+offset"),
    ))
}

/// A factor of zero would make every cell the same and hide the mistake.
fn nonzero(item: &str, factor: f64) -> Result<f64, RecordingError> {
    if factor == 0.0 {
        Err(wrong(item, "the factor is 0 (allowed: any other number)"))
    } else {
        Ok(factor)
    }
}

fn number(text: &str) -> Option<f64> {
    text.trim()
        .parse::<f64>()
        .ok()
        .filter(|value| value.is_finite())
}

fn wrong(item: &str, reason: impl Into<String>) -> RecordingError {
    RecordingError::Map {
        item: item.to_owned(),
        reason: reason.into(),
    }
}

/// The nearest target and all of them: a foreign name is seldom near to any.
fn unknown_target_help(target: &str) -> String {
    let all = ColumnMap::targets().collect::<Vec<_>>().join(", ");
    let help = help_for_unknown(target, ColumnMap::targets());
    if help.starts_with("did you mean") {
        format!("{help} allowed: {all}")
    } else {
        help
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn one(source: &str) -> Result<(String, f64, f64), RecordingError> {
        let map: ColumnMap = format!("time_s=t,current_a={source}").parse()?;
        let item = map.items()[1].clone();
        assert_eq!(item.target, Some(Channel::Current));
        Ok((item.header, item.factor, item.offset))
    }

    #[test]
    fn headers_factors_and_offsets() {
        for (source, header, factor, offset) in [
            ("i", "i", 1.0, 0.0),
            ("i*0.5", "i", 0.5, 0.0),
            ("i*-2e-3", "i", -2e-3, 0.0),
            ("i*1e+3", "i", 1e3, 0.0),
            ("i*1e+3+2", "i", 1e3, 2.0),
            ("i*2+1e+3", "i", 2.0, 1e3),
            ("i+3", "i", 1.0, 3.0),
            ("i+-3", "i", 1.0, -3.0),
            ("i * 2 + -3", "i", 2.0, -3.0),
            ("i-3", "i-3", 1.0, 0.0),
            ("a*b*2", "a*b", 2.0, 0.0),
            ("V+", "V+", 1.0, 0.0),
            ("a+b", "a+b", 1.0, 0.0),
            ("a+b+4", "a+b", 1.0, 4.0),
            (r#""a+4""#, "a+4", 1.0, 0.0),
            (r#""a,b*3"*2+1"#, "a,b*3", 2.0, 1.0),
            (r#""say ""x""""#, r#"say "x""#, 1.0, 0.0),
            (r#""i"+-1"#, "i", 1.0, -1.0),
            ("Torque (N\u{b7}m)*-1", "Torque (N\u{b7}m)", -1.0, 0.0),
            ("Motor = a", "Motor = a", 1.0, 0.0),
        ] {
            assert_eq!(
                one(source).unwrap(),
                (header.to_owned(), factor, offset),
                "{source}"
            );
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (source, part) in [
            ("i*x", "after the last *"),
            ("i*2-3", "after the last *"),
            ("i*0", "factor is 0"),
            ("i*inf", "after the last *"),
            (r#""i"#, "not closed"),
            (r#""i"2"#, "neither *factor nor +offset"),
            (r#""i"+nan"#, "not a finite number"),
            ("", "header is empty"),
            ("*2", "header is empty"),
            ("i,current_a=j", "given before"),
            ("i,1047", "no = between"),
        ] {
            let error = one(source).unwrap_err();
            assert!(error.to_string().contains(part), "{source}: {error}");
            assert!(!error.help().is_empty());
        }
    }

    #[test]
    fn an_unknown_target_has_a_nearest_one_and_time_is_required() {
        let error = "time_s=t,speed_rads=w".parse::<ColumnMap>().unwrap_err();
        assert!(error.help().starts_with("did you mean `speed_rad_s`?"));
        assert_eq!(
            "speed_rad_s=w".parse::<ColumnMap>(),
            Err(RecordingError::MapWithoutTime)
        );
        assert!("".parse::<ColumnMap>().is_err());
    }

    #[test]
    fn the_example_of_the_contract() {
        let map: ColumnMap = "time_s=t,voltage_v=u,current_a=i,speed_rad_s=rpm*0.104719755"
            .parse()
            .unwrap();
        assert_eq!(map.items().len(), 4);
        assert_eq!(map.items()[3].factor.to_bits(), 0.104_719_755_f64.to_bits());
        let scaled: Vec<bool> = map.items().iter().map(|item| item.scaled).collect();
        assert_eq!(scaled, [false, false, false, true]);
        let map: ColumnMap = "time_s=t*1,current_a=\"i\"*1,voltage_v=\"u\""
            .parse()
            .unwrap();
        let scaled: Vec<bool> = map.items().iter().map(|item| item.scaled).collect();
        assert_eq!(scaled, [true, true, false]);
    }

    proptest! {
        #[test]
        fn a_quoted_header_comes_back_whatever_it_holds(
            header in "[ -~\u{b7}]{0,12}[!-~]",
            factor in prop::num::f64::NORMAL,
            offset in prop::num::f64::NORMAL,
        ) {
            let text = format!("time_s=t,current_a=\"{}\"*{factor}+{offset:e}", header.replace('"', "\"\""));
            let map: ColumnMap = text.parse().unwrap();
            prop_assert_eq!(&map.items()[1].header, header.trim());
            prop_assert_eq!(map.items()[1].factor.to_bits(), factor.to_bits());
            prop_assert_eq!(map.items()[1].offset.to_bits(), offset.to_bits());
        }

        #[test]
        fn any_text_gives_a_map_or_an_error(text in "\\PC{0,40}") {
            if let Ok(map) = text.parse::<ColumnMap>() {
                prop_assert!(map.items().iter().any(|item| item.target.is_none()));
            }
        }
    }
}
