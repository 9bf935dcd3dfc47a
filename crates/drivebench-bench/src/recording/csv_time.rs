//! Stamps as text: ISO 8601 and its relatives, dates in any order, a clock alone, AM and PM.
//!
//! A stamp is a whole number of nanoseconds since midnight of the first day, so that it keeps its precision. Where a date can
//! be read in several orders, as 05/06/2024, the order is open until the date changes; then it is that with the smallest step
//! forward. Until then all orders give the same time.

use jiff::civil::Date;

use super::time_axis::Counter;

const DAY_NS: i64 = 86_400_000_000_000;
const MONTHS: [&str; 12] =
    ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"];
/// Places of day, month and year in a date.
const ORDERS: [[usize; 3]; 3] = [[0, 1, 2], [1, 0, 2], [2, 1, 0]];

/// How the stamps of a file are written.
#[derive(Clone, Debug, Default)]
pub(super) enum Clock {
    /// Before the first row.
    #[default]
    Open,
    Numbers(NumberClock),
    Text(TextClock),
}

/// Stamps that are numbers. Large ones count from the first, which is subtracted before the conversion to a float.
#[derive(Clone, Debug, Default)]
pub(super) struct NumberClock {
    origin: Option<(Decimal, String)>,
    /// The first stamps as they stand in the file.
    first: [f64; 2],
    pub count: usize,
}

impl NumberClock {
    /// The number without its origin; `value` is that of the cell as it stands, `factor` converts it to seconds.
    pub(super) fn relative(&mut self, cell: &str, value: f64, factor: f64) -> f64 {
        if self.count < 2 {
            self.first[self.count] = value;
        }
        self.count += 1;
        // Three years of seconds, or an integer that a float does not hold.
        if self.count == 1 && ((value * factor).abs() >= 1e8 || value.abs() >= 53_f64.exp2()) {
            self.origin = Decimal::parse(cell).map(|origin| (origin, cell.to_owned()));
        }
        let Some((origin, _)) = self.origin else { return value };
        let exact = Decimal::parse(cell).and_then(|stamp| stamp.minus(origin));
        exact.unwrap_or_else(|| value - self.first[0])
    }

    /// The first two stamps as they stand in the file.
    pub(super) fn first(&self) -> [f64; 2] {
        self.first
    }

    /// The first stamp, where the others count from it.
    pub(super) fn origin(&self) -> Option<&str> {
        self.origin.as_ref().map(|(_, text)| &**text)
    }
}

/// `mantissa * 10^-decimals`.
#[derive(Clone, Copy, Debug)]
struct Decimal {
    mantissa: i128,
    decimals: u32,
}

impl Decimal {
    /// A number with at most one mark.
    fn parse(text: &str) -> Option<Self> {
        let (whole, fraction) = text.split_once(['.', ',']).unwrap_or((text, ""));
        if fraction.len() > 12 || !fraction.bytes().all(|byte| byte.is_ascii_digit()) {
            return None;
        }
        let mantissa = format!("{whole}{fraction}").parse().ok()?;
        Some(Self { mantissa, decimals: u32::try_from(fraction.len()).ok()? })
    }

    /// The difference, rounded once.
    fn minus(self, other: Self) -> Option<f64> {
        let decimals = self.decimals.max(other.decimals);
        let scaled = |number: Self| {
            number.mantissa.checked_mul(10_i128.checked_pow(decimals - number.decimals)?)
        };
        let difference = scaled(self)?.checked_sub(scaled(other)?)?;
        Some(difference as f64 / 10_f64.powi(i32::try_from(decimals).ok()?))
    }
}

/// The clock of a file whose stamps are text.
#[derive(Clone, Debug, Default)]
pub(super) struct TextClock {
    /// The date before: its text, its three numbers, and the days since the first.
    date: Option<(String, [u16; 3], i64)>,
    /// Indices into [`ORDERS`] that all dates allow.
    orders: Vec<usize>,
    first_zone_s: Option<i64>,
    first_date: Option<[u16; 3]>,
    /// An hour above 12, the hour 0, or AM or PM stood in it.
    is_of_24_hours: bool,
    form: Form,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Form {
    #[default]
    DateAndClock,
    /// Hours, minutes and seconds.
    Clock,
    /// Minutes and seconds.
    Minutes,
}

impl TextClock {
    /// Seconds since midnight of the first day, or of the hour where there are only minutes; `None` where it is no stamp.
    pub(super) fn seconds(&mut self, text: &str) -> Option<f64> {
        let (date, clock) = split(text)?;
        let mut clock = clock.parse_clock()?;
        let days = match date {
            None => 0,
            Some(date) => match date.strip_suffix("days").or(date.strip_suffix("day")) {
                Some(count) => count.trim().parse().ok()?,
                None => self.days(date)?,
            },
        };
        // Without a date it may be a duration.
        if date.is_some() && clock.ns > DAY_NS {
            return None;
        }
        self.form = match (date, clock.is_of_minutes) {
            (Some(_), _) => Form::DateAndClock,
            (None, false) => Form::Clock,
            (None, true) => Form::Minutes,
        };
        // With a date two parts are hours and minutes, if the seconds have no fraction.
        if date.is_some() && clock.is_of_minutes && clock.has_no_fraction {
            clock.ns *= 60;
        }
        self.is_of_24_hours |= clock.is_of_24_hours || clock.ns >= DAY_NS / 24 * 13;
        let zone_s = clock.zone_s.unwrap_or(0);
        let first_s = *self.first_zone_s.get_or_insert(zone_s);
        let ns = days.checked_mul(DAY_NS)? + clock.ns - (zone_s - first_s) * 1_000_000_000;
        Some(ns as f64 / 1e9)
    }

    /// What the seconds count from.
    pub(super) fn origin(&self) -> String {
        let order = if let [only] = self.orders[..] { Some(only) } else { None };
        let date = self.first_date.zip(order).and_then(|(date, order)| in_order(date, order));
        match (self.form, date) {
            (Form::Minutes, _) => "the full hour".to_owned(),
            (_, Some(date)) => format!("midnight of {date}"),
            (Form::DateAndClock, None) => "midnight of the first day".to_owned(),
            (Form::Clock, None) => "midnight".to_owned(),
        }
    }

    /// When the clock begins again, if it has no date.
    pub(super) fn counters(&self) -> Vec<Counter> {
        let counter = |range_s, least_s, name| Counter { range_s, least_s, name };
        match self.form {
            Form::DateAndClock => Vec::new(),
            Form::Minutes => vec![counter(3600.0, 0.0, "an hour")],
            Form::Clock if self.is_of_24_hours => vec![counter(86_400.0, 0.0, "a day")],
            // Twelve is the first hour of a half.
            Form::Clock => {
                vec![counter(86_400.0, 0.0, "a day"), counter(43_200.0, 3600.0, "half a day")]
            }
        }
    }

    fn days(&mut self, text: &str) -> Option<i64> {
        if let Some((before, _, days)) = &self.date
            && before == text
        {
            return Some(*days);
        }
        let parts = date_parts(text)?;
        let days = if let Some((_, before, days)) = &self.date {
            let steps = self.orders.iter().filter_map(|order| {
                let (from, to) = (in_order(*before, *order)?, in_order(parts.numbers, *order)?);
                let step = to.duration_since(from).as_hours() / 24;
                Some((step < 0, step.abs(), step, *order))
            });
            let best = steps.clone().min()?;
            let days = days + best.2;
            self.orders =
                steps.filter(|found| found.2 == best.2).map(|(.., order)| order).collect();
            days
        } else {
            let is_allowed = |order: &usize| {
                parts.order.is_none_or(|only| only == *order)
                    && in_order(parts.numbers, *order).is_some()
            };
            self.orders = (0..ORDERS.len()).filter(is_allowed).collect();
            self.orders.first()?;
            self.first_date = Some(parts.numbers);
            0
        };
        self.date = Some((text.to_owned(), parts.numbers, days));
        Some(days)
    }
}

fn in_order(numbers: [u16; 3], order: usize) -> Option<Date> {
    let [day, month, year] = ORDERS[order].map(|place| numbers[place]);
    let year = if year < 100 { 2000 + year } else { year };
    Date::new(i16::try_from(year).ok()?, i8::try_from(month).ok()?, i8::try_from(day).ok()?).ok()
}

/// Whether a text is a date without a clock.
pub(super) fn is_date(text: &str) -> bool {
    date_parts(text).is_some_and(|parts| {
        (0..ORDERS.len()).any(|order| in_order(parts.numbers, order).is_some())
    })
}

struct DateParts {
    numbers: [u16; 3],
    /// The only order that its form allows.
    order: Option<usize>,
}

const DAY_FIRST: usize = 0;
const MONTH_FIRST: usize = 1;
const YEAR_FIRST: usize = 2;

fn date_parts(text: &str) -> Option<DateParts> {
    let text = text.trim_end_matches([',', ' ']);
    if text.len() == 8 && text.bytes().all(|byte| byte.is_ascii_digit()) {
        let numbers = [text[..4].parse().ok()?, text[4..6].parse().ok()?, text[6..].parse().ok()?];
        return Some(DateParts { numbers, order: Some(YEAR_FIRST) });
    }
    let mut words = text.split(['-', '/', '.', ' ', ',']).filter(|word| !word.is_empty());
    let words = [words.next()?, words.next()?, words.next()?, words.next().unwrap_or_default()];
    if !words[3].is_empty() {
        return None;
    }
    let month = |word: &str| {
        let begin = word.get(..3)?.to_ascii_lowercase();
        (1..).zip(MONTHS).find_map(|(month, name)| (name == begin).then_some(month))
    };
    let is_number = |word: &str| word.len() <= 4 && word.bytes().all(|byte| byte.is_ascii_digit());
    let mut numbers = [0; 3];
    let mut named = None;
    for (place, (number, word)) in numbers.iter_mut().zip(words).enumerate() {
        *number = if is_number(word) {
            word.parse().ok()?
        } else {
            named = Some(place);
            month(word)?
        };
    }
    let is_year = |place: usize| words[place].len() == 4 && Some(place) != named;
    let order = match (named, is_year(0)) {
        (Some(0), _) => Some(MONTH_FIRST),
        (Some(1), false) => Some(DAY_FIRST),
        (Some(1) | None, true) => Some(YEAR_FIRST),
        (Some(_), _) => return None,
        (None, false) if text.contains('.') => Some(DAY_FIRST),
        // Of two figures the year may stand first or last; of four at the end.
        (None, false) if is_year(2) && numbers[0] > 12 => Some(DAY_FIRST),
        (None, false) if is_year(2) && numbers[1] > 12 => Some(MONTH_FIRST),
        (None, false) => None,
    };
    Some(DateParts { numbers, order })
}

/// The text of a clock, and of what follows it.
struct ClockText<'a> {
    figures: &'a str,
    behind: &'a str,
}

struct DayTime {
    ns: i64,
    zone_s: Option<i64>,
    /// Two parts, of which the second are seconds.
    is_of_minutes: bool,
    has_no_fraction: bool,
    is_of_24_hours: bool,
}

/// Date, if there is one, and clock.
fn split(text: &str) -> Option<(Option<&str>, ClockText<'_>)> {
    let text = text.trim();
    if !text.is_ascii() {
        return None;
    }
    let is_figure = |byte: &u8| byte.is_ascii_digit();
    let bytes = text.as_bytes();
    let colon = bytes.iter().position(|byte| *byte == b':');
    let begin = match colon {
        Some(colon) => colon - bytes[..colon].iter().rev().take_while(|b| is_figure(b)).count(),
        // As 20240506T115955.
        None => bytes.iter().position(|byte| matches!(byte, b'T' | b't' | b' ' | b'_'))? + 1,
    };
    let is_clock = |byte: &u8| is_figure(byte) || matches!(byte, b':' | b'.' | b',');
    let length = bytes[begin..].iter().take_while(|byte| is_clock(byte)).count();
    let date = text[..begin].trim_end_matches(['T', 't', ' ', '_', ',']);
    let clock =
        ClockText { figures: &text[begin..begin + length], behind: text[begin + length..].trim() };
    // What stands between date and clock separates them.
    let is_separated = begin == 0 || date.len() < begin;
    is_separated.then_some(((!date.is_empty()).then_some(date), clock))
}

impl ClockText<'_> {
    fn parse_clock(&self) -> Option<DayTime> {
        let (half, zone_s) = self.half_and_zone()?;
        let mut parts: Vec<&str> = self.figures.split(':').collect();
        let compact = self.figures;
        if let [only] = parts[..] {
            let seconds = only.len().min(6);
            if only.len() < 6 || !only.as_bytes()[..seconds].iter().all(u8::is_ascii_digit) {
                return None;
            }
            parts = vec![&compact[..2], &compact[2..4], &compact[4..]];
        }
        let mut ns = 0_i64;
        let mut has_no_fraction = true;
        // A fourth part is a number of milliseconds.
        if let [.., _, _, _, ms] = parts[..] {
            ns = number(ms).filter(|_| ms.len() == 3)? * 1_000_000;
            parts.pop();
        }
        let seconds = parts.pop()?;
        let whole = seconds.split(['.', ',']).next()?;
        if whole.len() < seconds.len() {
            let digits = &seconds[whole.len() + 1..];
            has_no_fraction = false;
            if !digits.bytes().all(|digit| digit.is_ascii_digit()) {
                return None;
            }
            // Of more than nine places the first count.
            let nanoseconds = format!("{:0<9}", digits.get(..9).unwrap_or(digits));
            ns += nanoseconds.parse::<i64>().ok()?;
        }
        let minutes = parts.pop().map(number)??;
        let hours = parts.pop().map(number);
        let mut hour = match hours {
            None => 0,
            Some(hour) => hour?,
        };
        // The last second of a day may be the 60th.
        let seconds = number(whole).filter(|seconds| *seconds <= 60)?;
        if !parts.is_empty() || minutes >= 60 {
            return None;
        }
        if let Some(is_afternoon) = half {
            if !(1..=12).contains(&hour) {
                return None;
            }
            hour = hour % 12 + if is_afternoon { 12 } else { 0 };
        }
        ns += ((hour * 60 + minutes) * 60 + seconds) * 1_000_000_000;
        Some(DayTime {
            ns,
            zone_s,
            is_of_minutes: hours.is_none(),
            has_no_fraction,
            is_of_24_hours: half.is_some() || hours.is_some() && hour == 0,
        })
    }

    /// Whether it is the afternoon, by AM or PM, and the offset from UTC.
    fn half_and_zone(&self) -> Option<(Option<bool>, Option<i64>)> {
        let behind = self.behind.to_ascii_lowercase().replace("a.m.", "am").replace("p.m.", "pm");
        let (half, zone) = match behind.get(..2) {
            Some("am") => (Some(false), behind[2..].trim()),
            Some("pm") => (Some(true), behind[2..].trim()),
            _ => (None, &*behind),
        };
        let zone_s = match zone {
            "" => None,
            "z" | "utc" | "gmt" => Some(0),
            offset => {
                let sign = match offset.as_bytes()[0] {
                    b'+' => 1,
                    b'-' => -1,
                    _ => return None,
                };
                let figures = offset[1..].replace(':', "");
                let (hours, minutes) = match figures.len() {
                    2 => (number(&figures)?, 0),
                    4 => (number(&figures[..2])?, number(&figures[2..])?),
                    _ => return None,
                };
                Some(sign * (hours * 3600 + minutes * 60))
            }
        };
        Some((half, zone_s))
    }
}

/// A whole number of at most two figures, or of three.
fn number(text: &str) -> Option<i64> {
    let fits = (1..=3).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit());
    if fits { text.parse().ok() } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(stamps: &[&str]) -> Vec<Option<f64>> {
        let mut clock = TextClock::default();
        stamps.iter().map(|stamp| clock.seconds(stamp)).collect()
    }

    #[test]
    fn large_numbers_count_from_the_first_exactly() {
        for (cells, factor, expected) in [
            (["1714996795123456789", "1714996795125456790"], 1e-9, 2_000_001.0),
            (["1714996795.123456", "1714996795.125457"], 1.0, 0.002_001),
            (["45418.499931", "45418.4999310231"], 86_400.0, 2.31e-8),
            (["43200000", "43200002"], 1e-3, 43_200_002.0),
        ] {
            let mut clock = NumberClock::default();
            let last = cells.map(|cell| clock.relative(cell, cell.parse().unwrap(), factor))[1];
            assert!((last / expected - 1.0).abs() < 1e-12, "{cells:?}: {last}");
        }
    }

    #[test]
    fn stamps_in_every_form_are_seconds_since_midnight() {
        for (text, expected) in [
            ("2024-05-06T11:59:55.002", 43_195.002),
            ("2024-05-06 11:59:55,002", 43_195.002),
            ("2024-05-06T11:59:55.002Z", 43_195.002),
            ("2024-05-06T11:59:55.002000123+02:00", 43_195.002_000_123),
            ("20240506T115955.002", 43_195.002),
            ("20240506 115955", 43_195.0),
            ("06.05.2024 11:59:55", 43_195.0),
            ("06/05/2024 11:59:55.5", 43_195.5),
            ("5/6/2024 1:02:03 PM", 46_923.0),
            ("5/6/2024 12:00:01 a.m.", 1.0),
            ("06-May-2024 11:59:55", 43_195.0),
            ("May 6, 2024 11:59:55", 43_195.0),
            ("05/06/2024 11:59", 43_140.0),
            ("11:59:55.002", 43_195.002),
            ("11:59:55:002", 43_195.002),
            ("12:30:00.5 AM", 1800.5),
            ("59:55.5", 3595.5),
            ("23:59:60", 86_400.0),
            ("30:00:01.5", 108_001.5),
            ("1 days 00:00:00.002", 86_400.002),
        ] {
            assert_eq!(seconds(&[text]), [Some(expected)], "{text}");
        }
        let refused = "|12|1.5|2024-05-06|11:60:00|2024-05-06 25:00:00|13:00:00 PM|2024-13-06 11:00:00|a:b:c|\
            11:59:55 CEST|1:2:3:4:5|::|x11:59:55|2024-05-06T|30.02.2024 11:00:00|11:59:55.0a|+1:00:00";
        for text in refused.split('|') {
            assert_eq!(seconds(&[text]), [None], "{text}");
        }
    }

    #[test]
    fn the_order_of_a_date_is_that_of_the_smallest_step() {
        let day = 86_400.0;
        for (name, stamps, expected) in [
            ("one day", ["04/05/2024 23:00:00", "04/05/2024 23:00:01"], [82_800.0, 82_801.0]),
            ("day first", ["04/05/2024 23:59:59", "05/05/2024 00:00:00"], [day - 1.0, day]),
            ("month first", ["04/30/2024 23:59:59", "05/01/2024 00:00:00"], [day - 1.0, day]),
            ("both in doubt", ["05/04/2024 23:59:59", "05/05/2024 00:00:00"], [day - 1.0, day]),
            ("year first", ["24-05-04 23:59:59", "24-05-05 00:00:00"], [day - 1.0, day]),
            ("a leap day", ["2024-02-28 23:59:59", "2024-02-29 00:00:00"], [day - 1.0, day]),
            ("back", ["2024-05-06 00:00:00", "2024-05-05 23:59:59"], [0.0, -1.0]),
            (
                "a zone that changes",
                ["2024-10-27 02:59:59+02:00", "2024-10-27 02:00:00+01:00"],
                [10_799.0, 10_800.0],
            ),
        ] {
            assert_eq!(seconds(&stamps), expected.map(Some), "{name}");
        }
    }

    #[test]
    fn a_clock_without_a_date_begins_again() {
        for (stamp, ranges, origin) in [
            ("2024-05-06T11:59:55", &[][..], "midnight of 2024-05-06"),
            ("05/06/2024 11:59:55", &[], "midnight of the first day"),
            ("59:55.5", &[3600.0], "the full hour"),
            ("23:59:59.9", &[86_400.0], "midnight"),
            ("11:59:59.9 PM", &[86_400.0], "midnight"),
            ("12:59:59.9", &[86_400.0, 43_200.0], "midnight"),
        ] {
            let mut clock = TextClock::default();
            clock.seconds(stamp).unwrap();
            let found: Vec<f64> = clock.counters().iter().map(|it| it.range_s).collect();
            assert_eq!((&*found, &*clock.origin()), (ranges, origin), "{stamp}");
        }
    }
}
