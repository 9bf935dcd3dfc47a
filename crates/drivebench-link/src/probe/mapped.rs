//! Probe of a drive with a register map of its own: one reading of each signal, neighbouring registers where one is implausible,
//! and the identity.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use super::ProbeDepth;
use super::report::{ProbeReport, ProbedCheck, ProbedSignal, ProbedState};
use crate::cell_bus::{CellBus, CellTable, ReadRequest};
use crate::link::{LinkError, Result};
use crate::link_core::retried;
use crate::modbus::{RawClient, read_batch};
use crate::profile::DriveProfile;
use crate::register_map::{
    Condition, IdentityCheck, IdentityTest, Picture, PollRate, Quantity, ReadBlock, Reading,
    RegisterMap, Window, plan_reads,
};
use drivebench_model::text::number;

const RUNNING: &str = "running";

/// What the cells of a profile are read from.
pub(super) trait Source {
    fn read(&mut self, request: ReadRequest) -> Result<Vec<u16>>;

    /// Values that are proven to be current, one for each request.
    fn read_all(&mut self, requests: &[ReadRequest]) -> Vec<Result<Vec<u16>>>;

    fn object(&mut self, object: u8) -> Result<Option<String>>;

    fn pause(&mut self, seconds: f64);
}

impl Source for RawClient {
    fn read(&mut self, request: ReadRequest) -> Result<Vec<u16>> {
        Self::read(self, request)
    }

    fn read_all(&mut self, requests: &[ReadRequest]) -> Vec<Result<Vec<u16>>> {
        let batch = read_batch(self, requests, 1, &AtomicBool::new(false));
        batch.reads.into_iter().map(|read| read.values).collect()
    }

    fn object(&mut self, object: u8) -> Result<Option<String>> {
        Self::object(self, object)
    }

    fn pause(&mut self, seconds: f64) {
        std::thread::sleep(Duration::from_secs_f64(seconds));
    }
}

impl Source for &mut dyn CellBus {
    fn read(&mut self, request: ReadRequest) -> Result<Vec<u16>> {
        Ok(CellBus::read(*self, request)?.cells)
    }

    fn read_all(&mut self, requests: &[ReadRequest]) -> Vec<Result<Vec<u16>>> {
        requests.iter().map(|request| Source::read(self, *request)).collect()
    }

    fn object(&mut self, object: u8) -> Result<Option<String>> {
        CellBus::object(*self, object)
    }

    fn pause(&mut self, seconds: f64) {
        self.pause_until_s(self.now_s() + seconds);
    }
}

pub(super) fn probe(
    client: &mut dyn Source,
    profile: &DriveProfile,
    map: &RegisterMap,
    depth: ProbeDepth,
) -> Result<ProbeReport> {
    let mut reader = Reader {
        client,
        map,
        windows: vec![Window::default(); map.signals.len()],
        refused: vec![None; map.signals.len()],
    };
    reader.wake()?;
    reader.read_mapped()?;
    let rated_current_a = rated_current_a(map, &reader.windows).or(profile.limits.current_a);
    let doubtful = {
        let picture = Picture { map, windows: &reader.windows, rated_current_a };
        let fits = |index| picture.fits(index, picture.reading(index));
        (0..map.signals.len()).any(|index| fits(index) == Some(false))
    };
    let holds = |windows: &[Window], condition: &Condition| {
        let picture = Picture { map, windows, rated_current_a };
        let value = |name: &str| picture.reading(map.index(name)?).value();
        condition.holds_by(pattern(map, windows, &condition.signal), value)
    };
    let runs = |windows: &[Window]| {
        map.state(RUNNING).and_then(|condition| holds(windows, condition)) == Some(true)
    };
    // A drive that was commanded a moment ago still reports that it runs.
    let (step_s, mut left_s) = (0.1, map.released_after_s().unwrap_or(0.0));
    while left_s > 0.0 && runs(&reader.windows) {
        reader.client.pause(step_s);
        reader.read_mapped()?;
        left_s -= step_s;
    }
    let runs = runs(&reader.windows);
    // What a running drive reads cannot be judged, so no other way of reading it is better.
    let advises = doubtful && !runs && map.protocol.is_modbus();
    if advises && depth == ProbeDepth::Whole {
        reader.read_beside()?;
    }
    let watchdog_s = reader.watchdog_s()?;
    let checks = reader.checks(rated_current_a)?;
    let Reader { windows, refused, .. } = reader;
    let picture = Picture { map, windows: &windows, rated_current_a };
    let mut report = ProbeReport::of(profile);
    report.signals = (0..map.signals.len())
        .map(|index| signal(&picture, index, refused[index].as_ref(), advises))
        .collect();
    if advises {
        report.hypotheses = picture.hypotheses();
    }
    report.is_unknown_everywhere = !refused.is_empty()
        && refused.iter().all(|refusal| refusal.as_ref().is_some_and(|why| why.is_unknown));
    if report.is_unknown_everywhere {
        report.remarks.push(address_form(map));
    }
    report.states = map
        .state
        .iter()
        .map(|(name, condition)| ProbedState {
            name: name.clone(),
            holds: holds(&windows, condition),
        })
        .collect();
    report.watchdog_s = watchdog_s;
    report.checks = checks;
    report.judge();
    Ok(report)
}

/// Likely error in the addresses of a profile if the drive has none of its registers.
fn address_form(map: &RegisterMap) -> String {
    let Some(location) = map.signals.first().map(|signal| signal.location) else {
        return String::new();
    };
    let (other, code) = match location.table {
        CellTable::Holding => (CellTable::Input, "04"),
        CellTable::Input => (CellTable::Holding, "03"),
        _ => return String::new(),
    };
    let first_line = format!(
        "the drive has none of these registers (exception 0x02), of which the first is {} {} on the wire",
        table_name(location.table),
        location.address
    );
    let elsewhere = format!("or they are {} registers (function code {code})", table_name(other));
    if (29_999..=49_999).contains(&location.address) {
        format!(
            "{first_line}: numbers of a manual such as 40014 or 30014 need address_base \"4x1\" (40014 is then holding register 13, 30014 input register 13); {elsewhere}"
        )
    } else {
        format!(
            "{first_line}: does the manual count from 0 or from 1 (address_base 0 or 1), or in 4xxxx and 3xxxx numbers (\"4x1\")? {elsewhere}"
        )
    }
}

/// The nameplate's current, where the drive has a register for it.
fn rated_current_a(map: &RegisterMap, windows: &[Window]) -> Option<f64> {
    let index = map.index(&map.of_quantity(Quantity::RatedCurrent)?.name)?;
    let picture = Picture { map, windows, rated_current_a: None };
    picture.reading(index).value()
}

fn pattern(map: &RegisterMap, windows: &[Window], name: &str) -> Option<u32> {
    let index = map.index(name)?;
    let registers = windows.get(index)?.here.as_deref()?;
    map.signals[index].location.layout.pattern(registers)
}

fn signal(
    picture: &Picture<'_>,
    index: usize,
    refused: Option<&Refusal>,
    advises: bool,
) -> ProbedSignal {
    let signal = &picture.map.signals[index];
    let raw = |name: &str| pattern(picture.map, picture.windows, name);
    let place = signal.placed(raw);
    let location = place.unwrap_or(signal.location);
    let reading = picture.reading(index);
    let plausible = picture.fits(index, reading).filter(|_| place.is_some());
    let unit = signal.numbers.unit.name();
    let missing = match reading {
        Reading::Value(_) => None,
        Reading::NotAvailable => Some("the drive reports it as not available".to_owned()),
        Reading::Outside(value) => {
            let [low, high] = signal.keys.valid.unwrap_or_default();
            let value = number::reading(value);
            Some(format!("{value} {unit} lies outside of the profile's {low} to {high}"))
        }
        Reading::NotANumber => Some("the registers hold no number".to_owned()),
        Reading::Unread => Some(refused.map_or_else(
            || "a signal that it is scaled with has no value".to_owned(),
            |refusal| refusal.text.clone(),
        )),
    };
    ProbedSignal {
        name: signal.name.clone(),
        unit,
        table: table_name(location.table),
        address: match location.table {
            // A bit of the mask.
            CellTable::Fields(bit) => u16::try_from(bit.trailing_zeros()).unwrap_or_default(),
            CellTable::Lines(line) => u16::try_from(line.trailing_zeros()).unwrap_or_default(),
            _ => location.address,
        },
        raw: picture.windows[index].here.clone(),
        value: reading.value(),
        missing,
        plausible,
        expected: picture.expected(index),
        confirms: plausible == Some(true) && picture.confirms(index),
        candidates: match plausible {
            Some(false) if advises => picture.candidates(index),
            _ => Vec::new(),
        },
        quantity: Some(signal.keys.quantity),
    }
}

const fn table_name(table: CellTable) -> &'static str {
    match table {
        CellTable::Holding => "holding",
        CellTable::Input => "input",
        CellTable::Bytes => "byte",
        CellTable::Fields(_) => "field",
        CellTable::Reply(_) => "reply",
        CellTable::Lines(_) => "line",
        CellTable::Computed => "computed",
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Refusal {
    text: String,
    /// The drive has no such register (exception 0x02).
    is_unknown: bool,
}

struct Reader<'a> {
    client: &'a mut dyn Source,
    map: &'a RegisterMap,
    windows: Vec<Window>,
    /// Why a signal has no registers.
    refused: Vec<Option<Refusal>>,
}

impl Reader<'_> {
    /// Reads the first block until the unit answers at all.
    fn wake(&mut self) -> Result<()> {
        let Some(block) = self.blocks().into_iter().next() else { return Ok(()) };
        match retried(|| self.client.read(block.read)) {
            Ok(_) | Err(LinkError::Exception { .. }) => Ok(()),
            Err(error) => Err(error),
        }
    }

    fn blocks(&self) -> Vec<ReadBlock> {
        [PollRate::Once, PollRate::Slow, PollRate::Fast]
            .into_iter()
            .flat_map(|poll| plan_reads(self.map, poll))
            .collect()
    }

    /// Every signal: block by block, and one by one where the drive refuses a block, so that one register that is not
    /// there does not hide the others.
    fn read_mapped(&mut self) -> Result<()> {
        let blocks = self.blocks();
        let answers = self.ask(&blocks.iter().map(|block| block.read).collect::<Vec<_>>())?;
        let mut alone: Vec<usize> = Vec::new();
        for (block, answer) in blocks.iter().zip(answers) {
            match answer {
                Ok(registers) => self.hand_out(block, &registers),
                Err(reason) => {
                    for index in &block.signals {
                        self.refused[*index] = Some(reason.clone());
                    }
                    if block.signals.len() > 1 {
                        alone.extend(block.signals.iter().copied());
                    }
                }
            }
        }
        let requests: Vec<ReadRequest> = alone.iter().map(|index| self.request(*index)).collect();
        let answers = self.ask(&requests)?;
        for ((index, read), answer) in alone.into_iter().zip(requests).zip(answers) {
            match answer {
                Ok(registers) => {
                    self.hand_out(&ReadBlock { read, signals: vec![index] }, &registers);
                }
                Err(reason) => self.refused[index] = Some(reason),
            }
        }
        Ok(())
    }

    fn hand_out(&mut self, block: &ReadBlock, registers: &[u16]) {
        for index in &block.signals {
            let signal = &self.map.signals[*index];
            let raw = |name: &str| pattern(self.map, &self.windows, name);
            let Some(location) = signal.placed(raw) else {
                let text = "the profile has no place of it for this firmware".to_owned();
                self.refused[*index] = Some(Refusal { text, is_unknown: false });
                continue;
            };
            let from = block.read.offset_of(&location);
            let to = from + usize::from(location.layout.cells());
            self.windows[*index].here = registers.get(from..to).map(<[u16]>::to_vec);
        }
    }

    /// The same lengths one register lower and one higher. A refused read is no alternative.
    fn read_beside(&mut self) -> Result<()> {
        for shift in [-1, 1] {
            let asked: Vec<(usize, ReadRequest)> = (0..self.map.signals.len())
                .filter_map(|index| {
                    let here = self.request(index);
                    let address = here.address.checked_add_signed(shift)?;
                    address.checked_add(here.count - 1)?;
                    Some((index, ReadRequest { address, ..here }))
                })
                .collect();
            let requests: Vec<ReadRequest> = asked.iter().map(|(_, request)| *request).collect();
            for ((index, _), answer) in asked.iter().zip(self.ask(&requests)?) {
                let window = &mut self.windows[*index];
                let side = if shift < 0 { &mut window.below } else { &mut window.above };
                *side = answer.ok();
            }
        }
        Ok(())
    }

    fn request(&self, index: usize) -> ReadRequest {
        self.map.signals[index].request()
    }

    /// Values that are proven to be current, or why there are none; only a port that is gone ends everything.
    fn ask(&mut self, requests: &[ReadRequest]) -> Result<Vec<Result<Vec<u16>, Refusal>>> {
        let answers = self.client.read_all(requests).into_iter().map(|values| match values {
            Ok(values) => Ok(Ok(values)),
            // The unit is busy, or a gateway does not reach it: nothing is known of its registers.
            Err(
                error @ (LinkError::Gone { .. }
                | LinkError::Exception { code: 5 | 6 | 10 | 11, .. }),
            ) => Err(error),
            Err(LinkError::Exception { code, name, .. }) => Ok(Err(Refusal {
                text: format!("the drive refuses it: exception {code:#04x} {name}"),
                // Exception of a register that the unit does not have.
                is_unknown: code == 0x02,
            })),
            Err(error) => Ok(Err(Refusal { text: error.to_string(), is_unknown: false })),
        });
        answers.collect()
    }

    /// The time as it stands in the drive; only read.
    fn watchdog_s(&mut self) -> Result<Option<f64>> {
        let Some((location, unit_s)) = self.map.watchdog.time else { return Ok(None) };
        let registers = self.ask(&[location.request()])?.into_iter().next().and_then(Result::ok);
        let pattern = registers.and_then(|registers| location.layout.pattern(&registers));
        Ok(pattern.map(|pattern| location.layout.number(pattern) * unit_s))
    }

    fn checks(&mut self, rated_current_a: Option<f64>) -> Result<Vec<ProbedCheck>> {
        let map = self.map;
        let mut checks = Vec::new();
        for check in &map.identity {
            checks.push(match check {
                IdentityCheck::Object { object, contains } => {
                    let found = self.client.object(*object)?;
                    ProbedCheck {
                        what: format!("identification object {object} has to contain {contains:?}"),
                        passed: found.as_ref().is_some_and(|text| text.contains(contains)),
                        found: found.map_or_else(|| "none".to_owned(), |text| format!("{text:?}")),
                    }
                }
                IdentityCheck::Signal { signal, mask, test } => {
                    let picture = Picture { map, windows: &self.windows, rated_current_a };
                    signal_check(&picture, signal, *mask, test)
                }
            });
        }
        Ok(checks)
    }
}

fn signal_check(picture: &Picture<'_>, name: &str, mask: u32, test: &IdentityTest) -> ProbedCheck {
    let bits = pattern(picture.map, picture.windows, name);
    let index = picture.map.index(name);
    let value = index.and_then(|index| picture.reading(index).value());
    let what = match test {
        IdentityTest::OneOf(patterns) => {
            let allowed: Vec<String> = patterns.iter().map(|p| format!("{p:#06x}")).collect();
            format!("{name} has to read {}", allowed.join(" or "))
        }
        IdentityTest::Within([low, high]) => format!("{name} has to lie within {low} to {high}"),
    };
    let passed = test.passes(bits, mask, value);
    let found = match (test, bits, value) {
        (IdentityTest::OneOf(_), Some(bits), _) => format!("{:#06x}", bits & mask),
        (IdentityTest::Within(_), _, Some(value)) => number::reading(value),
        _ => "nothing".to_owned(),
    };
    ProbedCheck { what, passed, found }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_registers_are_answered_with_the_forms_of_an_address() {
        let mut map = (*DriveProfile::named("delta-ms300").unwrap().registers.unwrap()).clone();
        let location = &mut map.signals[0].location;
        (location.table, location.address) = (CellTable::Holding, 40_013);
        let text = address_form(&map);
        assert!(text.contains("address_base \"4x1\""), "{text}");
        assert!(text.contains("input registers (function code 04)"), "{text}");
        let location = &mut map.signals[0].location;
        (location.table, location.address) = (CellTable::Input, 14);
        let text = address_form(&map);
        assert!(text.contains("from 0 or from 1"), "{text}");
        assert!(text.contains("holding registers (function code 03)"), "{text}");
    }
}
