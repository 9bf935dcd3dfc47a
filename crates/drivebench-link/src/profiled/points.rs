//! Output of set-points: limits, slew rate, sign, refresh, read-back, and write cycles of a non-volatile memory.

use std::sync::Arc;

use super::readings::{Bus, Joined, Readings, in_profile};
use crate::budget::may_join;
use crate::cell_bus::{CellBus, Span};
use crate::link::{LinkError, Result};
use crate::register_map::{Quantity, RegisterMap, SetPoint, Write};

/// How long a drive may refuse or carry out a step of a command before the command is given up, s: less than what a session
/// waits beyond the steps, so that the reason is reported.
pub(super) const PATIENCE_S: f64 = 0.5;

/// The cells of the drive and their last readings.
pub(super) struct FarEnd<'a> {
    pub(super) bus: Bus<'a>,
    pub(super) readings: &'a Readings,
}

/// Last write of one set-point.
#[derive(Clone, Debug, Default, PartialEq)]
struct Sent {
    /// In units; `None` while it is not being held.
    value: Option<f64>,
    cells: Vec<u16>,
    /// A write was not acknowledged, so that the drive may hold either: until one is, every value is written.
    in_doubt: bool,
    at_s: f64,
    /// Time of the last demand; `None` while no value is held.
    asked_s: Option<f64>,
    /// Since when the drive has accepted writes without an end of them (exception 05), s.
    accepted_s: Option<f64>,
    writes: u32,
    /// Times in a row that it read back otherwise, and as what; what the drive had confirmed before that.
    mismatches: u32,
    found: Vec<u16>,
    confirmed: Vec<u16>,
    looked_s: f64,
}

/// Whether a reference goes out together with the read of this exchange.
#[derive(Clone, Debug, PartialEq)]
enum Joint {
    Never,
    May,
    With(Joined),
}

/// All of them, by position in the map.
#[expect(clippy::struct_excessive_bools, reason = "what is known of an exchange, each for itself")]
pub(super) struct Points {
    map: Arc<RegisterMap>,
    sent: Vec<Sent>,
    /// A limit or the slew rate has limited a value in this exchange.
    pub(super) limited: bool,
    /// Time of the last write that restarts a command watchdog, s.
    pub(super) kicked_s: f64,
    /// Stopping: writes do not wait for a doubtful line. Ends with the next reference.
    pub(super) is_urgent: bool,
    /// A write has probably been sent.
    pub(super) has_written: bool,
    joint: Joint,
    /// When the last write of this exchange was carried out.
    pub(super) carried: Option<Span>,
    running: bool,
}

impl Points {
    pub(super) fn new(map: Arc<RegisterMap>) -> Self {
        Self {
            sent: vec![Sent::default(); map.set_points.len()],
            map,
            limited: false,
            kicked_s: f64::NEG_INFINITY,
            is_urgent: false,
            has_written: false,
            joint: Joint::Never,
            carried: None,
            running: false,
        }
    }

    pub(super) fn begin(&mut self) {
        self.limited = false;
        self.joint = Joint::Never;
        self.carried = None;
    }

    /// The reference that goes out with the read of this exchange.
    pub(super) fn take_joined(&mut self) -> Option<Joined> {
        match std::mem::replace(&mut self.joint, Joint::Never) {
            Joint::With(joined) => Some(joined),
            Joint::Never | Joint::May => None,
        }
    }

    /// A reference may go out together with the read of this exchange.
    pub(super) fn may_join(&mut self, may: bool) {
        self.joint = if may { Joint::May } else { Joint::Never };
    }

    /// It was acknowledged.
    pub(super) fn joined_carried(&mut self, joined: Joined, span: Span, now_s: f64) {
        self.acknowledged(joined.at, joined.cells, now_s);
        self.carried = Some(span);
    }

    /// Nothing is refreshed any more, and a slew starts at zero again.
    pub(super) fn release(&mut self) {
        self.running = false;
        for sent in &mut self.sent {
            sent.value = None;
            sent.asked_s = None;
            sent.accepted_s = None;
            sent.mismatches = 0;
        }
    }

    /// For how long the drive has been carrying out a write that it only accepted, s, and what is to be written.
    pub(super) fn acting(&self, now_s: f64) -> Option<(f64, String)> {
        let sent = self.sent.iter().zip(&self.map.set_points);
        let acting = sent.filter_map(|(sent, point)| Some((now_s - sent.accepted_s?, point, sent)));
        let (acting_s, point, sent) = acting.max_by(|one, other| one.0.total_cmp(&other.0))?;
        let text = format!(
            "the drive accepted setpoint {} = {:04x?} (exception 05) and has not carried it out for {acting_s:.2} s",
            point.name, sent.cells
        );
        Some((acting_s, text))
    }

    /// The value that is being held for a quantity that the bench commands, SI; `None` where the drive may hold another.
    pub(super) fn held(
        &self,
        map: &RegisterMap,
        readings: &Readings,
        quantity: Quantity,
    ) -> Option<f64> {
        let (at, point) = find(map, &map.demand(quantity)?.name)?;
        let is_held = |sent: &&Sent| !sent.in_doubt && sent.mismatches == 0;
        Some(self.sent.get(at).filter(is_held)?.value? * readings.demand_si(point)?)
    }

    /// Holds a reference: within its limits, no faster than its slew.
    pub(super) fn put(&mut self, far: &mut FarEnd<'_>, name: &str, wanted: f64) -> Result<()> {
        self.running = true;
        (self.is_urgent, self.has_written) = (false, false);
        let map = Arc::clone(&self.map);
        let Some((at, point)) = find(&map, name) else { return Ok(()) };
        let now_s = far.bus.now_s();
        let mut value = wanted;
        if let Some([low, high]) = point.range() {
            value = value.clamp(low, high);
        }
        if let Some(slew) = point.keys.slew_per_s {
            let sent = &self.sent[at];
            let from = sent.value.unwrap_or(0.0);
            let since_s = sent.asked_s.map_or(0.0, |asked_s| now_s - asked_s);
            // Longest time over which a slew is counted, s: after a longer pause a reference does not jump further.
            let most = slew * since_s.clamp(0.0, 0.5);
            value = value.clamp(from - most, from + most);
        }
        if point.keys.smallest.is_some_and(|smallest| value.abs() < smallest) {
            value = 0.0;
        }
        self.sent[at].asked_s = Some(now_s);
        self.limited |= (value - wanted).abs() > 1e-9 * wanted.abs().max(1.0);
        let sent = &self.sent[at];
        let is_held = sent.value.map(f64::to_bits) == Some(value.to_bits());
        if is_held && !sent.in_doubt { Ok(()) } else { self.write(far, name, value, None) }
    }

    /// Repeats the writes that the drive needs within its refresh time.
    pub(super) fn refresh(&mut self, bus: Bus<'_>, period_s: f64) -> Result<()> {
        self.running = true;
        let map = Arc::clone(&self.map);
        for (at, point) in map.set_points.iter().enumerate() {
            let Some(refresh_s) = point.refresh_s() else { continue };
            if matches!(&self.joint, Joint::With(joined) if joined.at == at) {
                continue;
            }
            let sent = &self.sent[at];
            // Not written before: there is nothing to hold. The next chance is a period away.
            if sent.value.is_some() && bus.now_s() - sent.at_s + period_s >= refresh_s {
                let cells = sent.cells.clone();
                self.send_or_join(bus, at, point, &cells)?;
            }
        }
        Ok(())
    }

    pub(super) fn next_due_s(&self) -> Option<f64> {
        let due = self.sent.iter().zip(&self.map.set_points).filter_map(|(sent, point)| {
            sent.value?;
            Some(sent.at_s + point.refresh_s()?)
        });
        due.reduce(f64::min)
    }

    /// Sets every reference to zero. A refused write does not prevent the others; the first error is returned.
    pub(super) fn zero(&mut self, far: &mut FarEnd<'_>) -> Result<()> {
        let map = Arc::clone(&self.map);
        let mut result = Ok(());
        let points = map.set_points.iter().enumerate();
        for (at, point) in points.filter(|(_, point)| point.is_reference()) {
            let written = self.write(far, &point.name, 0.0, None);
            self.sent[at].value = None;
            if matches!(written, Err(LinkError::Gone { .. })) {
                return written;
            }
            result = result.and(written);
        }
        result
    }

    /// Writes a value as it is, or only the bits under `mask`.
    fn write(
        &mut self,
        FarEnd { bus, readings }: &mut FarEnd<'_>,
        name: &str,
        value: f64,
        mask: Option<u16>,
    ) -> Result<()> {
        let bus = &mut **bus;
        let map = Arc::clone(&self.map);
        let Some((at, point)) = find(&map, name) else {
            return Err(refused(bus, format!("the profile has no setpoint {name:?}")));
        };
        let encoded = |value: f64| {
            let raw = point.numbers.raw(value, readings.factor(&point.numbers.scale_by)?);
            point.location.layout.encode(raw)
        };
        let magnitude = if point.keys.sign.is_some() { value.abs() } else { value };
        let Some(mut cells) = encoded(magnitude) else {
            let unit = point.numbers.unit.name();
            let text = format!("setpoint {name} = {value} {unit} does not fit its register");
            return Err(refused(bus, text));
        };
        // Zero has no sign, and does not wait for one on its way to bring the drive to rest.
        let sign = point.keys.sign.as_ref();
        if let Some(sign) = sign.filter(|_| !(self.is_urgent && value == 0.0)) {
            // Through zero: between the two writes the old magnitude must not stand behind the new sign.
            let turns = self.sent[at].value.is_some_and(|held| held * value < 0.0);
            if let Some(zero) = encoded(0.0).filter(|_| turns) {
                self.send(bus, at, point, &zero)?;
                self.sent[at].value = Some(0.0);
            }
            self.write_sign(bus, &sign.set_point, sign.mask, value)?;
        }
        if let (Some(mask), [word]) = (mask, cells.as_mut_slice()) {
            let before = self.sent[at].cells.first().copied().unwrap_or(0);
            *word = (before & !mask) | (*word & mask);
        }
        self.send_or_join(bus, at, point, &cells)?;
        self.sent[at].value = Some(value);
        Ok(())
    }

    pub(super) fn carry(&mut self, far: &mut FarEnd<'_>, write: &Write) -> Result<()> {
        self.write(far, &write.set_point, write.value, write.mask)
    }

    /// Sends, or leaves it to the read of this exchange where one transaction takes both.
    fn send_or_join(
        &mut self,
        bus: Bus<'_>,
        at: usize,
        point: &SetPoint,
        cells: &[u16],
    ) -> Result<()> {
        let sent = &self.sent[at];
        // What brings the drive to rest is written again all the same.
        if sent.accepted_s.is_some() && sent.cells == cells && !self.is_urgent {
            return self.confirm(bus, at, point);
        }
        if self.joint != Joint::May || !may_join(&self.map, point) {
            return self.send(bus, at, point, cells);
        }
        if !self.may_be_written(bus, at, point, cells)? {
            return Ok(());
        }
        self.sent[at].in_doubt = true;
        self.sent[at].writes += 1;
        self.joint = Joint::With(Joined { at, cells: cells.to_vec() });
        Ok(())
    }

    /// The sign of a reference as bits of a control word, if they are not yet as they should be.
    fn write_sign(&mut self, bus: Bus<'_>, name: &str, mask: u16, value: f64) -> Result<()> {
        let map = Arc::clone(&self.map);
        let Some((at, point)) = find(&map, name) else { return Ok(()) };
        let sent = &self.sent[at];
        let Some(before) = sent.cells.first().copied() else {
            // Its other bits are not known, so neither is the way in which this would turn.
            let text = format!(
                "the sign of {value} is a bit of setpoint {name}, which no command has written yet"
            );
            return if value == 0.0 { Ok(()) } else { Err(refused(bus, text)) };
        };
        let word = (before & !mask) | if value < 0.0 { mask } else { 0 };
        if word == before && !sent.in_doubt { Ok(()) } else { self.send(bus, at, point, &[word]) }
    }

    /// Whether a write may go out at all; `false`: it would change nothing.
    fn may_be_written(
        &self,
        bus: &dyn CellBus,
        at: usize,
        point: &SetPoint,
        cells: &[u16],
    ) -> Result<bool> {
        let sent = &self.sent[at];
        if point.keys.write_only_when.is_some() && self.running {
            let text =
                format!("setpoint {} may only be written while the drive stands", point.name);
            return Err(refused(bus, text));
        }
        if point.keys.nvm {
            if sent.cells == cells && !sent.in_doubt {
                return Ok(false);
            }
            let most = self
                .map
                .nvm_cycles
                // Share of the write cycles of a non-volatile memory that one connection may use.
                // Writes where the profile does not say how many cycles the memory has.
                .map_or(10, |cycles| cycles / 1000);
            if sent.writes >= most {
                let text = format!(
                    "setpoint {} lies in a memory that wears out, and {most} writes a connection are allowed",
                    point.name
                );
                return Err(refused(bus, text));
            }
        }
        Ok(true)
    }

    fn acknowledged(&mut self, at: usize, cells: Vec<u16>, now_s: f64) {
        let sent = &mut self.sent[at];
        sent.at_s = now_s;
        sent.cells = cells;
        sent.in_doubt = false;
        sent.accepted_s = None;
        self.kicked_s = now_s;
    }

    /// The drive has accepted a write (exception 05), and may still be carrying it out: a register that reads back shows the end,
    /// any other counts as written.
    pub(super) fn accepted(&mut self, bus: Bus<'_>, at: usize, cells: &[u16]) -> Result<()> {
        let map = Arc::clone(&self.map);
        let since_s = self.sent[at].accepted_s.unwrap_or(bus.now_s());
        self.acknowledged(at, cells.to_vec(), bus.now_s());
        let point = &map.set_points[at];
        if !point.keys.readback {
            return Ok(());
        }
        self.sent[at].accepted_s = Some(since_s);
        self.confirm(bus, at, point)
    }

    /// Whether an accepted write is carried out by now. After [`PATIENCE_S`] another value is a mismatch.
    fn confirm(&mut self, bus: Bus<'_>, at: usize, point: &SetPoint) -> Result<()> {
        // Without a read-back that comes, the value that is held has not been noted either.
        self.sent[at].in_doubt = true;
        let found = self.read_back(bus, at, point)?;
        let now_s = bus.now_s();
        let sent = &mut self.sent[at];
        if found == sent.cells {
            sent.in_doubt = false;
            sent.accepted_s = None;
            sent.mismatches = 0;
            sent.confirmed = found;
            return Ok(());
        }
        if sent.accepted_s.is_none_or(|since_s| now_s - since_s > PATIENCE_S) {
            sent.mismatches += 1;
            sent.found = found;
        }
        Ok(())
    }

    fn send(&mut self, bus: Bus<'_>, at: usize, point: &SetPoint, cells: &[u16]) -> Result<()> {
        if !self.may_be_written(bus, at, point, cells)? {
            return Ok(());
        }
        // Counted and doubtful until acknowledged: the drive may have executed it.
        self.sent[at].in_doubt = true;
        self.sent[at].writes += 1;
        let put = point.put(cells);
        let written = if self.is_urgent { bus.write_at_once(put) } else { bus.write(put) };
        self.has_written |= super::was_sent(&written);
        // A stop repeats what has no end instead.
        if is_accepted(&written) && !self.is_urgent {
            return self.accepted(bus, at, cells);
        }
        let carried =
            written.map_err(|error| in_profile(error, &self.map, &[(&point.name, point.line)]))?;
        self.carried = Some(carried);
        self.acknowledged(at, cells.to_vec(), bus.now_s());
        // What brings the drive to rest is followed by a look at its state instead.
        if point.keys.readback && !self.is_urgent {
            self.confirm(bus, at, point)?;
            self.sent[at].in_doubt = false;
        }
        Ok(())
    }

    fn read_back(&mut self, bus: Bus<'_>, at: usize, point: &SetPoint) -> Result<Vec<u16>> {
        let read = bus.read(point.location.request())?;
        self.sent[at].looked_s = bus.now_s();
        Ok(read.cells)
    }

    /// Periodic check that a confirmed set-point still reads back as written. A deviation twice in a row without a write of ours is one by
    /// another master: sentence on it.
    pub(super) fn watch(&mut self, bus: Bus<'_>) -> Result<Option<String>> {
        let map = Arc::clone(&self.map);
        let pause_s = map.rates.slow_hz.recip();
        for (at, point) in map.set_points.iter().enumerate() {
            let sent = &self.sent[at];
            let is_ours = sent.value.is_some()
                && !sent.in_doubt
                && !sent.confirmed.is_empty()
                && sent.confirmed == sent.cells;
            if !point.keys.readback || !is_ours || bus.now_s() - sent.looked_s < pause_s {
                continue;
            }
            let ours = sent.cells.clone();
            let first = self.read_back(bus, at, point)?;
            if first == ours {
                continue;
            }
            let second = self.read_back(bus, at, point)?;
            if second != ours {
                return Ok(Some(format!(
                    "setpoint {} was written as {ours:04x?} and confirmed, and is {second:04x?} now although nothing was \
                     written to it from here: somebody else writes it (a second master on the line, a gateway, the drive's keypad)",
                    point.name
                )));
            }
        }
        Ok(None)
    }

    /// The longest row of read-backs that were not what was written.
    pub(super) fn mismatches(&self) -> u32 {
        self.sent.iter().map(|sent| sent.mismatches).max().unwrap_or(0)
    }

    pub(super) fn mismatch_text(&self) -> String {
        let worst =
            self.sent.iter().zip(&self.map.set_points).max_by_key(|(sent, _)| sent.mismatches);
        worst.map_or_else(String::new, |(sent, point)| {
            let why = if sent.accepted_s.is_some() {
                "the drive only accepted it (exception 05) and does not carry it out"
            } else if sent.found == sent.confirmed {
                "the drive keeps the value that it had before, so it ignores what is written from here"
            } else {
                "the drive keeps another value, which was never written from here: a limit of its own, the profile's word order \
                 or scale, or somebody else who writes it at once"
            };
            format!(
                "setpoint {} was written as {:04x?} and read back as {:04x?}, {} times in a row: {why}",
                point.name, sent.cells, sent.found, sent.mismatches
            )
        })
    }

    /// Zero to every reference that can be read back: what it reads back as.
    pub(super) fn compare(
        &mut self,
        far: &mut FarEnd<'_>,
    ) -> Result<Option<Result<String, String>>> {
        let map = Arc::clone(&self.map);
        let mut names = Vec::new();
        self.is_urgent = false;
        let points = map.set_points.iter().enumerate();
        for (at, point) in points.filter(|(_, p)| p.is_reference() && p.keys.readback) {
            self.write(far, &point.name, 0.0, None)?;
            self.sent[at].value = None;
            if self.sent[at].mismatches > 0 {
                return Ok(Some(Err(self.mismatch_text())));
            }
            names.push(point.name.as_str());
        }
        Ok((!names.is_empty()).then(|| Ok(format!("{} read back as written", names.join(", ")))))
    }
}

fn find<'a>(map: &'a RegisterMap, name: &str) -> Option<(usize, &'a SetPoint)> {
    map.set_points.iter().enumerate().find(|(_, point)| point.name == name)
}

/// Whether a write was accepted and has not ended (exception 05, acknowledge).
pub(super) const fn is_accepted<T>(written: &Result<T>) -> bool {
    matches!(written, Err(LinkError::Exception { code: 5, .. }))
}

fn refused(bus: &dyn CellBus, reason: String) -> LinkError {
    LinkError::Refused(bus.name().0, reason)
}
