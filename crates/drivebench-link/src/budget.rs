//! Timing budget of a line: the rate of exchanges that it carries, computed from the profile before a port is opened.

use serde::Serialize;

use super::cell_bus::{CellTable, Put};
use super::framing::{FrameKind, Turn, read_bytes, read_write_bytes, write_bytes};
use super::own::cycle_bytes;
use super::profile::DriveProfile;
use super::register_map::{PollRate, ReadBlock, RegisterMap, SetPoint, plan_reads};
use super::settings::{Framing, LinkSettings, Protocol};
use super::timing::{LineTiming, char_s};

/// Delay per exchange added by adapters, s, measured on real ones.
const ADAPTERS: [(&str, f64); 3] = [
    ("no adapter", 0.0),
    ("USB adapter, latency timer 1 ms", 0.0012),
    ("USB adapter, latency timer 16 ms", 0.016),
];

/// A line with the delays of drive, adapter and host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredLine {
    pub baud: u32,
    pub framing: Framing,
    /// Silence before a request and before a reply, s.
    pub gap_s: f64,
    /// Delay of drive, adapter and host per exchange, s.
    pub added_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LoopRates {
    /// One request of function code 23 a cycle: ten registers read, two written.
    pub read_write_hz: f64,
    /// A write of four registers and a read of ten a cycle, two requests.
    pub write_then_read_hz: f64,
}

impl MeasuredLine {
    /// Time on the wire of a request and its reply with both gaps, s.
    pub fn exchange_s(&self, request_bytes: f64, reply_bytes: f64) -> f64 {
        (request_bytes + reply_bytes) * char_s(self.baud, self.framing)
            + 2.0 * self.gap_s
            + self.added_s
    }

    fn turn_s(&self, (request_bytes, reply_bytes): (usize, usize)) -> f64 {
        self.exchange_s(request_bytes as f64, reply_bytes as f64)
    }

    /// Duration of a read of `registers` with function code 3, s.
    pub fn read_s(&self, registers: u16) -> f64 {
        self.turn_s(read_bytes(registers.into()))
    }

    pub fn rates(&self) -> LoopRates {
        // A typical cycle of a loop: ten registers read, two written.
        let two = self.turn_s(write_bytes(16, 4)) + self.turn_s(read_bytes(10));
        LoopRates {
            read_write_hz: self.turn_s(read_write_bytes(2, 10)).recip(),
            write_then_read_hz: two.recip(),
        }
    }
}

/// The times of one cycle, a command for a sample, on a serial line.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LineBudget {
    pub protocol: Protocol,
    pub baud: u32,
    pub exchanges: usize,
    pub request_bytes: usize,
    pub reply_bytes: usize,
    /// Characters of both frames, ms.
    pub wire_ms: f64,
    /// Silences between frames, ms.
    pub gaps_ms: f64,
    /// Longest reply times of the drive, ms: the profile's `link.reply_ms` once per request.
    pub reply_ms: f64,
    pub rates: Vec<AdapterRate>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AdapterRate {
    pub adapter: &'static str,
    pub delay_ms: f64,
    pub rate_hz: f64,
}

impl LineBudget {
    /// The budget of one cycle of this drive: its fast blocks and one set-point, or the one exchange of our own register
    /// map or stream; `None`: no serial line.
    pub fn of(profile: &DriveProfile) -> Option<Self> {
        let protocol = profile.link.protocol;
        let frames = match &profile.registers {
            _ if protocol.is_network() => return None,
            Some(map) => cycle_frames(map),
            None => vec![cycle_bytes(FrameKind::serial(protocol))],
        };
        Some(Self::of_frames(&profile.link, &frames))
    }

    fn of_frames(settings: &LinkSettings, frames: &[(usize, usize)]) -> Self {
        let line = LineTiming::serial(settings, settings.baud, settings.protocol.is_modbus());
        let line = MeasuredLine {
            baud: settings.baud,
            framing: settings.framing,
            gap_s: line.gap().as_secs_f64(),
            added_s: settings.reply_ms * 1e-3,
        };
        let rates = ADAPTERS.map(|(adapter, delay_s)| {
            let added_s = line.added_s + delay_s;
            let line = MeasuredLine { added_s, ..line };
            let times = frames
                .iter()
                .map(|(request, reply)| line.exchange_s(*request as f64, *reply as f64));
            AdapterRate { adapter, delay_ms: delay_s * 1e3, rate_hz: times.sum::<f64>().recip() }
        });
        let request_bytes = frames.iter().map(|(request, _)| request).sum();
        let reply_bytes = frames.iter().map(|(_, reply)| reply).sum();
        let bytes = (request_bytes + reply_bytes) as f64;
        let count = frames.len() as f64;
        Self {
            protocol: settings.protocol,
            baud: settings.baud,
            exchanges: frames.len(),
            request_bytes,
            reply_bytes,
            wire_ms: bytes * char_s(line.baud, line.framing) * 1e3,
            gaps_ms: 2e3 * line.gap_s * count,
            reply_ms: settings.reply_ms * count,
            rates: rates.to_vec(),
        }
    }

    /// How `link.reply_ms` limits rate and deadline, and how to measure it; `None` if its share is small.
    pub fn reply_text(&self) -> Option<String> {
        let cycle_ms = self.wire_ms + self.gaps_ms + self.reply_ms;
        let share = 100.0 * self.reply_ms / cycle_ms;
        // Share of a cycle from which on the reply time is explained, %.
        if share < 15.0 {
            return None;
        }
        let once_ms = self.reply_ms / self.exchanges as f64;
        let times = if self.exchanges == 1 {
            "once".to_owned()
        } else {
            format!("{} times", self.exchanges)
        };
        Some(format!(
            "of the {cycle_ms:.1} ms of a cycle {:.1} ms ({share:.0} %) are link.reply_ms = {once_ms} of the drive's profile, {times}: the \
             longest time that it may take to answer, not measured; a deadline has it twice. `drivebench doctor --port PORT` measures what the \
             drive takes: with less in the profile this rate goes up and the deadline down",
            self.reply_ms
        ))
    }

    /// Behind a usual USB adapter with its latency timer at 1 ms, Hz.
    pub fn usual_rate_hz(&self) -> f64 {
        self.rates.get(1).map_or_else(|| self.rate_hz(), |rate| rate.rate_hz)
    }

    /// Rate of the line alone, Hz.
    pub fn rate_hz(&self) -> f64 {
        1e3 / (self.wire_ms + self.gaps_ms + self.reply_ms)
    }
}

/// A cycle of a drive with a map of its own in which one reply is lost, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LostReply {
    /// The whole cycle without a loss.
    pub cycle_s: f64,
    /// Until the deadline of the lost reply.
    pub deadline_s: f64,
    /// Silence for late replies.
    pub silence_s: f64,
    /// The probe and the repeated request.
    pub again_s: f64,
}

impl LostReply {
    /// `None`: our own map or stream, where a lost reply costs its cycle and no more; or no serial line.
    pub fn of(profile: &DriveProfile) -> Option<Self> {
        let map = profile.registers.as_ref()?;
        let budget = LineBudget::of(profile)?;
        let (request, reply) = cycle_frames(map).into_iter().max_by_key(|(_, reply)| *reply)?;
        let line = LineTiming::serial(&profile.link, profile.link.baud, true);
        let once_s = line.brief(request, reply).as_secs_f64();
        Some(Self {
            cycle_s: budget.rate_hz().recip(),
            deadline_s: line.hurried(request, reply).as_secs_f64(),
            silence_s: line.quiet().as_secs_f64(),
            again_s: 2.0 * once_s,
        })
    }

    pub fn total_s(&self) -> f64 {
        self.cycle_s + self.deadline_s + self.silence_s + self.again_s
    }

    pub fn text(&self) -> String {
        format!(
            "a cycle in which one reply is lost takes up to {:.0} ms: {:.0} ms of its own, {:.0} ms until the reply is given up, {:.0} ms of silence \
             for whatever is late, {:.0} ms to prove the line and to ask again",
            1e3 * self.total_s(),
            1e3 * self.cycle_s,
            1e3 * self.deadline_s,
            1e3 * self.silence_s,
            1e3 * self.again_s
        )
    }
}

/// Bytes of the requests and replies of one cycle: every fast block, and one set-point with its readback, in one request if the drive supports
/// function code 23.
pub(super) fn cycle_frames(map: &RegisterMap) -> Vec<(usize, usize)> {
    let blocks = plan_reads(map, PollRate::Fast);
    let first = map.set_points.iter().find(|point| may_join(map, point));
    let joined = first.zip(joint_block(map, &blocks));
    let zeros = [0; 4];
    let kind = FrameKind::serial(map.protocol);
    let put = |point: &SetPoint| Put {
        function: point.function,
        address: point.location.address,
        cells: &zeros[..point.location.layout.cells().into()],
    };
    let reads = blocks.iter().enumerate().map(|(at, block)| {
        let with = joined.filter(|(_, with)| *with == at).map(|(point, _)| put(point));
        Turn { put: with, read: Some(block.read), skipped: 0 }
    });
    let reference = map.set_points.iter().find(|point| point.keys.quantity.moves());
    let alone = reference.filter(|_| joined.is_none());
    let write = alone.map(|point| Turn::write(put(point)));
    let readback = alone.filter(|point| point.keys.readback);
    let readback = readback.map(|point| Turn::read(point.location.request()));
    reads
        .chain(write)
        .chain(readback)
        .map(|turn| match &map.lines {
            Some(grammar) => grammar.bytes(turn),
            None => kind.bytes(turn),
        })
        .collect()
}

/// Whether it may be written together with the read.
pub(super) fn may_join(map: &RegisterMap, point: &SetPoint) -> bool {
    // Function code 23 writes up to 121 registers (Modbus Application Protocol 1.1b3, 6.17).
    let fits = point.location.layout.cells() <= map.max_write.min(121);
    fits && point.is_reference() && !point.keys.readback
}

/// Position of the block that one request can read together with a write: over Modbus one of holding registers, by function code 23.
pub(super) fn joint_block(map: &RegisterMap, fast: &[ReadBlock]) -> Option<usize> {
    let can = |block: &ReadBlock| match block.read.table {
        CellTable::Holding => map.functions.contains(&23),
        CellTable::Fields(_) | CellTable::Lines(_) => true,
        _ => false,
    };
    fast.iter().position(can)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::standard_gap_s;

    #[test]
    fn a_drive_with_a_map_is_reckoned_with_its_own_requests() {
        let mut profile = DriveProfile::named("epulse50-dc").unwrap();
        profile.link.protocol = Protocol::ModbusRtu;
        let reads = plan_reads(&profile.registers.clone().unwrap(), PollRate::Fast).len();
        let budget = LineBudget::of(&profile).unwrap();
        assert_eq!(budget.exchanges, reads + 1);
        let one =
            LineBudget::of_frames(&profile.link, &[(budget.request_bytes, budget.reply_bytes)]);
        // The same bytes in more requests take more silences and more replies.
        assert!((budget.wire_ms - one.wire_ms).abs() < 1e-9);
        assert!(budget.rate_hz() < one.rate_hz());
        assert!((budget.rate_hz() - budget.rates[0].rate_hz).abs() < 1e-9);
        assert!(budget.usual_rate_hz() < budget.rate_hz());
    }

    #[test]
    fn no_profile_promises_more_than_its_replies_allow() {
        for name in DriveProfile::names() {
            let mut profile = DriveProfile::named(name).unwrap();
            let Some(fast_hz) = profile.registers.as_ref().map(|map| map.rates.fast_hz) else {
                continue;
            };
            profile.link.protocol = Protocol::ModbusRtu;
            let most_hz = LineBudget::of(&profile).unwrap().rate_hz();
            assert!(fast_hz <= most_hz, "{name}: {fast_hz} Hz, {most_hz:.2} Hz");
        }
    }

    /// Strict gap, 0.5 ms drive, 1.2 ms USB.
    #[test]
    fn the_arithmetic_is_that_of_the_table() {
        let line = |baud, framing| MeasuredLine {
            baud,
            framing,
            gap_s: standard_gap_s(baud, framing),
            added_s: 0.5e-3 + 1.2e-3,
        };
        for (baud, read_write_hz, two_requests_hz) in [
            (9600, 18.0, 13.0),
            (38_400, 62.0, 39.0),
            (115_200, 113.0, 65.0),
            (921_600, 177.0, 91.0),
        ] {
            let rates = line(baud, Framing::EightNoneOne).rates();
            assert!((rates.read_write_hz - read_write_hz).abs() < 1.0, "{rates:?}");
            assert!((rates.write_then_read_hz - two_requests_hz).abs() < 1.0);
        }
        let wire_s = |framing| line(9600, framing).read_s(10) - 1.7e-3;
        let ratio = wire_s(Framing::EightEvenOne) / wire_s(Framing::EightNoneOne);
        assert!((ratio - 1.1).abs() < 1e-12, "parity costs a tenth");
    }
}
