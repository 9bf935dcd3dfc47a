//! In-memory register bus to a drive with a register map of its own, in virtual time.

use drivebench_link::Result;
use std::ops::Range;

use super::{ForeignDrive, Guise};
use crate::VirtualClock;
use crate::pace::Pace;
use drivebench_link::{
    CellBus, CellTable, CellsRead, LinkError, LinkName, LinkStatistics, Put, ReadRequest,
    Requested, Span, exception_name,
};

/// Bytes of an RTU frame without its PDU: unit and check sum.
const FRAME_BYTES: usize = 3;
/// Deadline of a reply, s.
const DEADLINE_S: f64 = 0.1;

/// A foreign drive without a line, but with the time that a line takes.
pub struct ForeignBus {
    drive: ForeignDrive,
    clock: VirtualClock,
    pace: Pace,
    functions: Vec<u8>,
    /// Time in the exchange, s, ahead of the clock by what its requests have taken.
    now_s: f64,
    statistics: LinkStatistics,
    /// Numbers of the requests that are lost, and how many of the next ones are carried out without a reply.
    lost: Range<u64>,
    lost_replies: u32,
    /// Silence that is kept before each read, as on a line where old replies may come, s.
    silence_s: f64,
    /// The last request had no reply: an urgent write does not wait for one then.
    in_doubt: bool,
}

impl ForeignBus {
    pub fn new(drive: ForeignDrive, guise: &Guise, clock: VirtualClock) -> Self {
        Self {
            pace: Pace::serial(&guise.line, true),
            functions: guise.map.functions.clone(),
            drive,
            clock,
            now_s: 0.0,
            statistics: LinkStatistics::default(),
            lost: 0..0,
            lost_replies: 0,
            silence_s: 0.0,
            in_doubt: false,
        }
    }

    pub const fn keep_silence(&mut self, silence_s: f64) {
        self.silence_s = silence_s;
    }

    pub const fn drive(&self) -> &ForeignDrive {
        &self.drive
    }

    pub const fn drive_mut(&mut self) -> &mut ForeignDrive {
        &mut self.drive
    }

    /// The next requests are carried out, and their replies are lost.
    pub const fn lose_replies(&mut self, replies: u32) {
        self.lost_replies = replies;
    }

    pub fn lose(&mut self, requests: u32) {
        self.lose_behind(0, requests);
    }

    /// The next `heard` requests arrive, and the `requests` after them are lost.
    pub fn lose_behind(&mut self, heard: u32, requests: u32) {
        let first = self.statistics.sent + 1 + u64::from(heard);
        self.lost = first..first + u64::from(requests);
    }

    /// Answer of the drive, with the times of the request and of the first byte of the reply. `timeout_s`: time after the request at
    /// which a missing reply is given up.
    fn exchange(
        &mut self,
        request: &[u8],
        timeout_s: f64,
        what: impl Fn() -> String,
    ) -> Result<(Vec<u8>, Span)> {
        self.statistics.sent += 1;
        self.now_s = CellBus::now_s(self);
        let asked_s = self.pace.departure_s(self.now_s);
        let arrived_s = self.pace.arrived_s(self.now_s, request.len() + FRAME_BYTES);
        self.drive.advance_to(arrived_s);
        let is_lost = self.lost.contains(&self.statistics.sent);
        let answer = (!is_lost).then(|| self.drive.answer(request));
        let is_reply_lost = !is_lost && self.lost_replies > 0;
        self.lost_replies -= u32::from(is_reply_lost);
        self.in_doubt = is_lost || is_reply_lost;
        let Some(answer) = answer.filter(|_| !is_reply_lost) else {
            self.statistics.timeout += 1;
            self.now_s = self.pace.delivery_s(arrived_s, FRAME_BYTES) + timeout_s;
            return Err(LinkError::Timeout {
                link: self.name().0,
                deadline_ms: 100,
                request: what(),
            });
        };
        self.now_s = self.pace.delivery_s(arrived_s, answer.len() + FRAME_BYTES);
        if let [function, code] = *answer.as_slice()
            && function & 0x80 != 0
        {
            self.statistics.exception += 1;
            return Err(LinkError::Exception {
                link: self.name().0,
                request: what(),
                code,
                name: exception_name(code),
                requested: Requested {
                    function: request.first().copied().unwrap_or_default(),
                    count: 1,
                    is_of_profile: true,
                },
            });
        }
        self.statistics.ok += 1;
        let rest_s = self.pace.wire_s(answer.len() + FRAME_BYTES - 1);
        let answered_s = self.now_s - rest_s;
        let span = Span { asked_s, answered_s };
        Ok((answer, span))
    }

    fn get(&mut self, request: &[u8], what: impl Fn() -> String) -> Result<CellsRead> {
        let (answer, span) = self.exchange(request, DEADLINE_S, what)?;
        let pairs = answer.get(2..).unwrap_or_default().as_chunks().0;
        let cells = pairs.iter().map(|pair| u16::from_be_bytes(*pair)).collect();
        Ok(CellsRead { cells, span, written: span })
    }

    fn put(&mut self, put: Put<'_>, timeout_s: f64) -> Result<Span> {
        let Put { function, address, cells: values } = put;
        let written = counted(values);
        let written = if function == 6 { &written[3..] } else { &written };
        let request = [&[function][..], &address.to_be_bytes(), written].concat();
        let what = || format!("write {values:04x?} at {address}");
        self.exchange(&request, timeout_s, what).map(|(_, span)| span)
    }
}

/// Number of registers and of their bytes, and the registers, as function codes 16 and 23 have them.
fn counted(values: &[u16]) -> Vec<u8> {
    let [high, low] = u16::try_from(values.len()).unwrap_or(u16::MAX).to_be_bytes();
    let bytes = u8::try_from(2 * values.len()).unwrap_or(u8::MAX);
    let values = values.iter().flat_map(|value| value.to_be_bytes());
    [high, low, bytes].into_iter().chain(values).collect()
}

impl CellBus for ForeignBus {
    fn name(&self) -> LinkName {
        LinkName("sim:".to_owned())
    }

    fn now_s(&self) -> f64 {
        self.now_s.max(self.clock.time_s())
    }

    fn pause_until_s(&mut self, time_s: f64) {
        self.now_s = self.now_s.max(time_s);
        self.drive.advance_to(self.now_s);
    }

    fn read(&mut self, read: ReadRequest) -> Result<CellsRead> {
        let (address, count) = (read.address, read.count);
        let function = if read.table == CellTable::Input { 4 } else { 3 };
        let request = [&[function][..], &address.to_be_bytes(), &count.to_be_bytes()].concat();
        self.now_s = CellBus::now_s(self) + self.silence_s;
        self.get(&request, || format!("read {count} registers at {address}"))
    }

    fn write(&mut self, put: Put<'_>) -> Result<Span> {
        self.put(put, DEADLINE_S)
    }

    fn write_at_once(&mut self, put: Put<'_>) -> Result<Span> {
        let timeout_s = if self.in_doubt { 0.0 } else { DEADLINE_S };
        self.put(put, timeout_s)
    }

    fn read_write(&mut self, put: Put<'_>, read: ReadRequest) -> Result<CellsRead> {
        let Put { address: to, cells: values, .. } = put;
        let ReadRequest { address: from, count, .. } = read;
        let (from_bytes, to_bytes) = (from.to_be_bytes(), to.to_be_bytes());
        let written = counted(values);
        let request = [&[23][..], &from_bytes, &count.to_be_bytes(), &to_bytes, &written].concat();
        self.get(&request, || {
            format!("write {values:04x?} at {to} and read {count} registers at {from}")
        })
    }

    fn object(&mut self, object: u8) -> Result<Option<String>> {
        if !self.functions.contains(&43) {
            return Ok(None);
        }
        let answer = self
            .exchange(&[43, 14, 4, object], DEADLINE_S, || "the device identification".to_owned());
        match answer {
            Ok((answer, _)) => Ok(answer
                .get(9..)
                .and_then(|text| std::str::from_utf8(text).ok())
                .map(str::to_owned)),
            Err(LinkError::Exception { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn is_emulated(&self) -> bool {
        true
    }

    fn statistics(&self) -> LinkStatistics {
        self.statistics
    }

    fn wire_s(&self, request_bytes: usize, reply_bytes: usize) -> Option<f64> {
        let mut pace = self.pace.clone();
        let start_s = CellBus::now_s(self);
        let end_s = pace.arrived_s(start_s, request_bytes);
        Some(pace.delivery_s(end_s, reply_bytes) - start_s)
    }
}
