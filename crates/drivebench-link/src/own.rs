//! The link to our own drive, whose registers or messages carry the map of firmware-protocol/SPEC.md.
//!
//! ```text
//! exchange: gap, listen -> turn { command block | telemetry block } -> only a reply that carries the number of the command
//! read:     gap, listen, the steps of proof.rs -> turn { identity | telemetry | state of the capture }
//! ```
//!
//! A command is its own proof: its sequence number comes back with the sample. Over Modbus the reply to a plain read shows neither
//! what was read nor when: only function, unit and length. Windows of a burst carry their own index in front, so no late
//! window can be taken for another. On the stream every reply carries the number of its request.
//!
//! Over the exchanges of exchange.rs, in a language of `line_bus.rs`.

use std::time::Duration;

use firmware_protocol::registers::{
    CAPTURE_CONTROL, CAPTURE_STATE, COMMAND_ADDRESS, COMMAND_WORDS, IDENTITY_ADDRESS,
    IDENTITY_WORDS, SEQUENCE_ECHO, TELEMETRY_ADDRESS, TELEMETRY_WORDS,
};
use firmware_protocol::{CaptureControl, CaptureState, Telemetry};

use super::burst::{Burst, Capture, WINDOW_ADDRESS, WINDOW_WORDS};
use super::cell_bus::{Put, ReadRequest};
use super::exceptions::{BusyPauses, Requested};
use super::exchange::{Exchange, Query, over_an_exchange};
use super::framing::{Echo, FrameKind, Turn};
use super::line_bus::Language;
use super::link::{DriveLink, Identity, LinkError, Result};
use super::link_core::{Answer, stop_confirmed};
use super::timeline::{identity, identity_error, signed_difference};
use super::timing::wait_until;
use super::waiting::now;
use drivebench_model::sample::{Command, Sample};

pub(super) const IDENTITY: ReadRequest =
    ReadRequest::holding(IDENTITY_ADDRESS, quantity(IDENTITY_WORDS));
pub(super) const TELEMETRY: ReadRequest =
    ReadRequest::holding(TELEMETRY_ADDRESS, quantity(TELEMETRY_WORDS));
/// State, count and the drive time of the first sample of a burst.
const CAPTURE: ReadRequest = ReadRequest::holding(CAPTURE_STATE.address, 4);
const WINDOW: ReadRequest = ReadRequest::holding(WINDOW_ADDRESS, quantity(WINDOW_WORDS));

/// A block of the register table as a quantity of a request.
const fn quantity(words: usize) -> u16 {
    let [.., high, low] = words.to_be_bytes();
    u16::from_be_bytes([high, low])
}

/// The one turn of a cycle: writes a command, and reads the sample that follows it.
const fn command_turn(block: &[u16; COMMAND_WORDS]) -> Turn<'_> {
    put_turn(COMMAND_ADDRESS, block, TELEMETRY)
}

const fn put_turn(address: u16, cells: &[u16], read: ReadRequest) -> Turn<'_> {
    Turn { put: Some(Put { function: 16, address, cells }), read: Some(read), skipped: 0 }
}

/// Bytes of a cycle on the line: of a command, and of its sample.
pub(super) fn cycle_bytes(kind: FrameKind) -> (usize, usize) {
    kind.bytes(command_turn(&[0; COMMAND_WORDS]))
}

pub(super) struct OwnLink<L> {
    // Before the exchange, whose runtime it uses.
    pub(super) language: L,
    pub(super) exchange: Exchange,
    /// Reads that were repeated because the unit was busy.
    pub(super) busy_repeats: u64,
    /// It was busy to the end of the last of them: it gets no more time before it has answered.
    stays_busy: bool,
    /// Commands without a sample since the last one that had one.
    failed_in_a_row: u32,
}

impl<L: Language> OwnLink<L> {
    pub(super) const fn new(language: L, exchange: Exchange) -> Self {
        Self { language, exchange, busy_repeats: 0, stays_busy: false, failed_in_a_row: 0 }
    }

    /// One turn; who calls has listened or synchronised the line. `is_numbered`: its reply carries a number of its own.
    fn call(
        &mut self,
        turn: Turn<'_>,
        what: &str,
        allowed: Duration,
        is_numbered: bool,
    ) -> Result<Answer<Vec<u16>>> {
        // The stream has error codes of its own, which no function of Modbus explains.
        let is_stream = self.exchange.kind == FrameKind::Stream;
        let requested = if is_stream { Requested::default() } else { turn.requested() };
        let query = Query::plain(turn.pdu(), what, allowed, requested);
        self.language.call(&mut self.exchange, turn, Query { is_numbered, ..query })
    }

    /// One turn on a synchronised line.
    pub(super) fn turn(
        &mut self,
        turn: Turn<'_>,
        what: &str,
        allowed: Duration,
    ) -> Result<Answer<Vec<u16>>> {
        self.in_step(&turn.pdu())?;
        self.call(turn, what, allowed, false)
    }

    /// Time of a turn outside the cycles of a run, whose deadline it does not have to keep.
    fn unhurried(&self, turn: Turn<'_>) -> Duration {
        let (request, reply) = self.language.bytes(self.exchange.kind, turn);
        let timing = &self.exchange.core.timing;
        timing.allowed(request, reply).max(timing.unhurried(request, reply))
    }

    pub(super) fn in_step(&mut self, pdu: &[u8]) -> Result<()> {
        let Self { language, exchange, .. } = self;
        exchange.in_step(pdu, |exchange, pdu| language.probe(exchange, pdu))
    }

    /// A read has no side effects and may be repeated.
    fn read(&mut self, read: ReadRequest, what: &str) -> Result<Answer<Vec<u16>>> {
        let turn = Turn::read(read);
        let allowed = self.unhurried(turn);
        self.with_retries(|link| link.turn(turn, what, allowed))
    }

    fn decoded(&self, answer: Answer<Vec<u16>>) -> Result<Answer<Telemetry>> {
        let Answer { value: cells, span, complete_s } = answer;
        let value = self.exchange.kind.telemetry(&cells);
        let value = value.ok_or_else(|| self.exchange.mismatch(format!("{cells:?}")))?;
        Ok(Answer { value, span, complete_s })
    }

    /// Telemetry without a command; does not restart the watchdog.
    pub(super) fn telemetry(&mut self) -> Result<Answer<Telemetry>> {
        let answer = self.read(TELEMETRY, "the telemetry")?;
        self.decoded(answer)
    }

    /// One command on the wire. Only a reply that carries its number is its sample.
    fn command(&mut self, command: Command) -> Result<Sample> {
        let travels = self.exchange.core.command(command);
        // Position in the PDU of the reply: after function code, byte count and the registers before it.
        let at = 2 + 2 * usize::from(SEQUENCE_ECHO.address - TELEMETRY_ADDRESS);
        self.exchange.filter.expect(Echo { at, bytes: travels.seq.to_be_bytes() });
        let (request, reply) = cycle_bytes(self.exchange.kind);
        let allowed = self.exchange.core.timing.allowed(request, reply);
        let answer = self.call(command_turn(&travels.to_registers()), "the command", allowed, true);
        let answer = answer.and_then(|answer| self.decoded(answer));
        let failed_in_a_row = self.failed_in_a_row.saturating_add(1);
        self.failed_in_a_row = if answer.is_ok() { 0 } else { failed_in_a_row };
        Ok(self.exchange.core.sample(command, &answer?))
    }

    /// Reads the drive's clock: raw, us, and on the time axis of the samples, s.
    fn note_clock(&mut self) -> Result<(u32, f64)> {
        let Answer { value, span, .. } = self.telemetry()?;
        Ok((value.time_us, self.exchange.core.timeline.note(value.time_us, span)))
    }

    fn window(&mut self, index: u16) -> Result<Vec<u16>> {
        let sent = [index];
        let turn = put_turn(WINDOW_ADDRESS, &sent, WINDOW);
        let allowed = self.unhurried(turn);
        self.with_retries(|link| {
            link.exchange.listen()?;
            link.exchange.filter.expect(Echo { at: 2, bytes: index.to_be_bytes() });
            Ok(link.call(turn, "captured samples", allowed, true)?.value)
        })
    }

    /// Repeats a read for a while as long as the unit is busy. Not within the bound of an exchange: there the next cycle reads again.
    pub(super) fn while_busy<T>(
        &mut self,
        mut ask: impl FnMut(&mut Self) -> Result<T>,
    ) -> Result<T> {
        let mut pauses = BusyPauses::default();
        loop {
            let result = ask(self);
            let may_wait = !self.stays_busy && !self.exchange.core.bound.is_set();
            let pause = result.as_ref().err().filter(|_| may_wait).and_then(|e| pauses.next(e));
            let Some(pause) = pause else {
                self.stays_busy = matches!(result, Err(LinkError::Exception { code: 5 | 6, .. }));
                return result;
            };
            self.busy_repeats += 1;
            wait_until(now() + pause);
        }
    }

    /// Until the bound of the exchange is over.
    fn with_retries<T>(&mut self, mut ask: impl FnMut(&mut Self) -> Result<T>) -> Result<T> {
        let mut attempt = 1;
        loop {
            match ask(self) {
                Err(error) if self.exchange.may_retry(&error, attempt) => attempt += 1,
                result => return result,
            }
        }
    }
}

impl<L: Language> DriveLink for OwnLink<L> {
    over_an_exchange!();

    fn identify(&mut self) -> Result<Identity> {
        let block = self.while_busy(|link| link.read(IDENTITY, "the identity"));
        let block = block.map_err(LinkError::of_profile)?.value;
        let block = block.as_slice().try_into().map_err(|_| {
            self.exchange.mismatch(format!("{} registers of identity", block.len()))
        })?;
        let block = firmware_protocol::Identity::from_registers(block)
            .map_err(|error| identity_error(&self.exchange.core.name, error))?;
        let mut identity = identity(&block);
        // The device identification is optional.
        let names = self
            .while_busy(|link| link.with_retries(|link| link.language.names(&mut link.exchange)));
        match names {
            Ok(mut texts) => {
                identity.vendor = texts.remove(&0).unwrap_or_default();
                let product = texts.remove(&4).or_else(|| texts.remove(&1));
                identity.product = product.unwrap_or_default();
                identity.firmware = texts.remove(&2).unwrap_or(identity.firmware);
            }
            Err(LinkError::Exception { .. }) => {}
            Err(error) => return Err(error),
        }
        self.exchange.core.capture_period_s = f64::from(block.capture_period_us) * 1e-6;
        // The origin of the time axis.
        self.while_busy(Self::note_clock)?;
        Ok(identity)
    }

    fn exchange(&mut self, command: Command) -> Result<Sample> {
        self.exchange.core.is_unsent = true;
        self.exchange.listen()?;
        // After two failed commands in a row the line is given time to become silent.
        let waits = self.failed_in_a_row >= 2 && self.exchange.kind == FrameKind::Rtu;
        // A stop goes out at once, also where the line is never silent.
        if waits && command.demand.energises() {
            self.exchange.wait_for_quiet()?;
        }
        self.command(command)
    }

    fn stop(&mut self) -> Result<()> {
        let (stop, name) = (self.exchange.core.stop_command(), self.exchange.core.name.clone());
        let mut is_sent = false;
        let stopped = stop_confirmed(&name, || {
            // Also on a doubtful line: the echo of its sequence number proves that it was applied.
            self.exchange.core.is_unsent = true;
            let answer = self.exchange.listen().and_then(|()| self.command(stop));
            is_sent |= !self.exchange.core.is_unsent;
            answer
        });
        self.exchange.core.is_unsent = !is_sent;
        stopped
    }

    fn has_sent_command(&self) -> bool {
        !self.exchange.core.is_unsent
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        let (request, reply) = cycle_bytes(self.exchange.kind);
        self.exchange.core.timing.shortest_cycle_s(request, reply)
    }

    fn burst(&mut self) -> Option<&mut dyn Burst> {
        (self.exchange.core.capture_period_s > 0.0).then_some(self as &mut dyn Burst)
    }
}

/// A burst is armed by one write and read back window by window.
impl<L: Language> Burst for OwnLink<L> {
    fn arm(&mut self) -> Result<()> {
        let cells = [CaptureControl::Arm.code()];
        let put = Put { function: 16, address: CAPTURE_CONTROL.address, cells: &cells };
        let turn = Turn::write(put);
        self.turn(turn, "start of a capture", self.unhurried(turn)).map(drop)
    }

    fn fetch(&mut self) -> Result<Option<Capture>> {
        let head = self.read(CAPTURE, "the state of the capture")?.value;
        let [state, count, high, low] = head[..] else {
            return Err(self.exchange.mismatch(format!("{} registers of a capture", head.len())));
        };
        if state != CaptureState::Complete.code() {
            return Ok(None);
        }
        let (time_us, now_s) = self.note_clock()?;
        let age_us = signed_difference(time_us, u32::from(high) << 16 | u32::from(low));
        let first_s = now_s - f64::from(age_us) * 1e-6;
        let period_s = self.exchange.core.capture_period_s;
        let (name, kind) = (self.exchange.core.name.clone(), self.exchange.kind);
        let block = |index| Ok(kind.samples(index, &self.window(index)?));
        Capture::collect(&name, first_s, period_s, count, block).map(Some)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use firmware_protocol::stream::{Frame, crc16, encode};

    use super::*;
    use crate::DriveProfile;
    use crate::line_bus::Framed;
    use crate::virtual_line::{Device, exchange, paused};
    use drivebench_model::sample::Demand;

    /// A drive that answers the third command not at all and the fifth with a frame of version 9; and the first byte of each.
    struct Odd(Vec<u8>);

    impl Device for Odd {
        fn receive(&mut self, bytes: &[u8]) -> Vec<(Duration, Vec<u8>)> {
            self.0.push(bytes[0]);
            let seq = u16::try_from(self.0.len()).unwrap();
            let telemetry = Telemetry { seq, ..Telemetry::default() };
            let answer = match seq {
                3 => return Vec::new(),
                5 => framed_by_hand(&[0x82, 9, 0, 5, 0, 0, 0, 0]),
                _ => encode(&Frame::telemetry(seq, telemetry)).to_vec(),
            };
            vec![(Duration::from_millis(2), answer)]
        }
    }

    /// With a check sum that fits, and each zero stuffed.
    fn framed_by_hand(plain: &[u8]) -> Vec<u8> {
        let whole = [plain, &crc16(plain).to_be_bytes()].concat();
        let coded = whole.split(|byte| *byte == 0).flat_map(|block| {
            let code = u8::try_from(block.len() + 1).unwrap();
            std::iter::once(code).chain(block.iter().copied())
        });
        coded.chain([0]).collect()
    }

    #[test]
    fn a_zero_ends_what_the_drive_may_hold_before_the_first_frame_and_after_a_lost_answer() {
        paused(|| {
            let profile = DriveProfile::named("own-stream").unwrap();
            let drive = Arc::new(Mutex::new(Odd(Vec::new())));
            let line = exchange("virtual", FrameKind::Stream, &profile.link, &drive);
            let mut link = OwnLink::new(Framed::new(1, None), line);
            let mut exchanges =
                (1..=6).map(|seq| link.exchange(Command { seq, demand: Demand::Stop }));
            assert!(exchanges.by_ref().take(2).all(|sample| sample.is_ok()));
            assert!(matches!(exchanges.next(), Some(Err(LinkError::Timeout { .. }))));
            assert!(matches!(exchanges.next(), Some(Ok(_))));
            assert!(matches!(exchanges.next(), Some(Err(LinkError::Version { found: 9, .. }))));
            assert!(matches!(exchanges.next(), Some(Ok(_))));
            let has_zero: Vec<bool> =
                drive.lock().unwrap().0.iter().map(|first| *first == 0).collect();
            assert_eq!(has_zero, [true, false, false, true, false, false]);
            let line = link.line().unwrap();
            assert_eq!((line.bytes_sent, line.bytes_dropped), (6 * 18 + 2, 0));
            assert!(link.statistics().balances());
        });
    }
}
