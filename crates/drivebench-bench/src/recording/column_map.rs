//! `--map 'target=header[*factor][+offset],...'`: which column of a foreign file is which quantity.

use std::str::FromStr;

use super::RecordingError;
use drivebench_model::config_text::help_for_unknown;
use drivebench_model::sample::Channel;

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Factor {
    Column(String),
    /// Only the sign of the column, for an unsigned speed with the sign of its command.
    SignOf(String),
}

/// One quantity: `value = product of columns * factor + offset`.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapping {
    /// `None` is the time axis.
    pub target: Option<Channel>,
    /// The product as written; one column where a file has that header.
    pub header: String,
    pub columns: Vec<Factor>,
    pub factor: f64,
    pub offset: f64,
    /// A factor or an offset is given, even `*1`: the unit was considered.
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

    /// The names allowed before the `=`.
    pub fn targets() -> impl Iterator<Item = &'static str> + Clone {
        std::iter::once("time_s").chain(Channel::ALL.into_iter().map(Channel::key))
    }
}

impl FromStr for ColumnMap {
    type Err = RecordingError;

    fn from_str(text: &str) -> Result<Self, RecordingError> {
        let mut items: Vec<Mapping> = Vec::new();
        let mut parts = split_unquoted(text, ',');
        // A trailing comma is allowed.
        if parts.len() > 1 && parts.last().is_some_and(|last| last.is_empty()) {
            parts.pop();
        }
        for item in parts {
            let mapping = parse_item(item)?;
            if items.iter().any(|other| other.target == mapping.target) {
                return Err(map_error(item, "this target was given before"));
            }
            items.push(mapping);
        }
        if items.iter().all(|item| item.target.is_some()) {
            return Err(RecordingError::MapWithoutTime);
        }
        Ok(Self { items })
    }
}

pub(super) fn split_unquoted(text: &str, separator: char) -> Vec<&str> {
    let mut is_quoted = false;
    text.split(|letter| {
        is_quoted ^= letter == '"';
        letter == separator && !is_quoted
    })
    .map(str::trim)
    .collect()
}

fn parse_item(item: &str) -> Result<Mapping, RecordingError> {
    let (target, source) =
        item.split_once('=').ok_or_else(|| map_error(item, "no = between target and header"))?;
    let target = target.trim();
    let channel = Channel::from_key(target);
    if channel.is_none() && target != "time_s" {
        let (target, help) = (target.to_owned(), unknown_target_help(target));
        return Err(RecordingError::UnknownTarget { target, help });
    }
    let source = source.trim();
    let parts = split_unquoted(source, '*');
    let (mut columns, mut factor, mut offset) = (Vec::new(), 1.0, 0.0);
    // A header may contain stars.
    let (mut header, mut at) = ("", 0);
    for (index, mut part) in parts.iter().copied().enumerate() {
        if index + 1 == parts.len() {
            (part, offset) = split_offset(item, part)?;
        }
        at += source[at..].find(part).unwrap_or_default() + part.len();
        if let Some(value) = number(part).filter(|_| index > 0) {
            if value == 0.0 {
                // All cells would be equal.
                return Err(map_error(item, "the factor is 0 (allowed: any other number)"));
            }
            factor *= value;
            continue;
        }
        columns.push(parse_column(item, part, index > 0)?);
        header = &source[..at];
    }
    let header = match &columns[..] {
        [Factor::Column(only)] => only.clone(),
        _ => header.to_owned(),
    };
    let is_bare = parts.len() == 1 && (header == source || source.ends_with('"'));
    Ok(Mapping { target: channel, header, columns, factor, offset, scaled: !is_bare })
}

/// A header, in double quotes or not, or `sign(header)`; after a star it must not look like a number.
fn parse_column(item: &str, part: &str, is_after_star: bool) -> Result<Factor, RecordingError> {
    if let Some(inner) = part.strip_prefix("sign(").and_then(|rest| rest.strip_suffix(')')) {
        return match parse_column(item, inner.trim(), false)? {
            Factor::Column(name) => Ok(Factor::SignOf(name)),
            Factor::SignOf(_) => Err(map_error(item, "the sign of a sign is the sign itself")),
        };
    }
    let looks_like_number = part.parse::<f64>().is_ok()
        || part.starts_with(|first: char| first.is_ascii_digit() || "+-.".contains(first));
    if is_after_star && (part.is_empty() || looks_like_number) {
        let reason = format!("{part:?} after the last * is neither a factor nor factor+offset");
        return Err(map_error(item, reason));
    }
    let name = match part.strip_prefix('"') {
        Some(quoted) => quoted
            .strip_suffix('"')
            .ok_or_else(|| map_error(item, "the quote around the header is not closed"))?
            .replace("\"\"", "\""),
        None => part.to_owned(),
    };
    let name = name.trim().to_owned();
    if name.is_empty() {
        return Err(map_error(item, "the header is empty"));
    }
    Ok(Factor::Column(name))
}

/// The last part and its offset. A `+` begins the offset if a number follows it; it may also belong to an exponent, as in
/// `1e+3`, or to a header.
fn split_offset<'a>(item: &str, part: &'a str) -> Result<(&'a str, f64), RecordingError> {
    if part.starts_with('"') {
        let Some(close) = part.rfind('"').filter(|close| *close > 0) else {
            return Ok((part, 0.0));
        };
        let rest = part[close + 1..].trim();
        if rest.is_empty() {
            return Ok((part, 0.0));
        }
        let Some(offset) = rest.strip_prefix('+') else {
            let reason = format!("{rest:?} after the header is neither *factor nor +offset");
            return Err(map_error(item, reason));
        };
        let reason = || format!("the offset {offset:?} is not a finite number");
        return Ok((&part[..=close], number(offset).ok_or_else(|| map_error(item, reason()))?));
    }
    let is_factor = part.starts_with(|first: char| first.is_ascii_digit() || "+-.".contains(first));
    if number(part).is_none() {
        for (plus, _) in part.match_indices('+') {
            let (before, offset) = (part[..plus].trim(), number(&part[plus + 1..]));
            if let Some(offset) = offset.filter(|_| !is_factor || number(before).is_some()) {
                return Ok((before, offset));
            }
        }
    }
    Ok((part, 0.0))
}

fn number(text: &str) -> Option<f64> {
    text.trim().parse::<f64>().ok().filter(|value| value.is_finite())
}

fn map_error(item: &str, reason: impl Into<String>) -> RecordingError {
    RecordingError::Map { item: item.to_owned(), reason: reason.into() }
}

/// The nearest target and all of them: a foreign name is rarely near to any.
fn unknown_target_help(target: &str) -> String {
    let all = ColumnMap::targets().collect::<Vec<_>>().join(", ");
    let help = help_for_unknown(target, ColumnMap::targets());
    if help.starts_with("did you mean") { format!("{help} allowed: {all}") } else { help }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{has, near};
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
            assert_eq!(one(source).unwrap(), (header.to_owned(), factor, offset), "{source}");
        }
    }

    #[test]
    fn a_factor_may_be_a_column_or_its_sign() {
        let column = |name: &str| Factor::Column(name.to_owned());
        let sign = |name: &str| Factor::SignOf(name.to_owned());
        for (source, columns, factor, offset) in [
            ("duty*bus_v", [column("duty"), column("bus_v")], 1.0, 0.0),
            ("a*-2*\"b, c\"*0.5+3", [column("a"), column("b, c")], -1.0, 3.0),
            ("rpm*0.1*sign(u)", [column("rpm"), sign("u")], 0.1, 0.0),
            ("sign( \"u, V\" )*rpm", [sign("u, V"), column("rpm")], 1.0, 0.0),
        ] {
            let map: ColumnMap = format!("time_s=t,current_a={source}").parse().unwrap();
            let item = &map.items()[1];
            assert_eq!(item.columns, columns, "{source}");
            near(item.factor, factor, 1e-15);
            near(item.offset, offset, 1e-15);
            assert!(item.scaled, "{source}");
        }
    }

    #[test]
    fn errors_name_their_cause() {
        for (source, part) in [
            ("i*2x", "after the last *"),
            ("i*", "after the last *"),
            ("i*sign(sign(u))", "sign of a sign"),
            ("sign()", "header is empty"),
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
            assert!(!error.help().is_empty());
            has(error, part);
        }
    }

    #[test]
    fn an_unknown_target_has_a_nearest_one_and_time_is_required() {
        let error = "time_s=t,speed_rads=w".parse::<ColumnMap>().unwrap_err();
        assert!(error.help().starts_with("did you mean `speed_rad_s`?"));
        assert_eq!("speed_rad_s=w".parse::<ColumnMap>(), Err(RecordingError::MapWithoutTime));
        assert!("".parse::<ColumnMap>().is_err());
    }

    #[test]
    fn a_written_factor_marks_the_column_as_scaled() {
        for (text, expected) in [
            ("time_s=t,voltage_v=u,speed_rad_s=rpm*0.104719755", [false, false, true]),
            ("time_s=t*1,current_a=\"i\"*1,voltage_v=\"u\"", [true, true, false]),
        ] {
            let map: ColumnMap = text.parse().unwrap();
            let scaled: Vec<bool> = map.items().iter().map(|item| item.scaled).collect();
            assert_eq!(scaled, expected, "{text}");
        }
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
