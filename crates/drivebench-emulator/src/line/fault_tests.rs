//! No wrong value, whatever the line does: the links of the host against a drive behind each fault of bytes.
//!
//! In virtual time a hundred thousand exchanges, with `DRIVEBENCH_EVERYTHING` set ten million.

use std::sync::{Arc, Mutex};

use firmware_protocol::modbus::{rtu, tcp};
use firmware_protocol::stream::{self, ErrorCode, Frame, Message, Refusal};
use firmware_protocol::{Telemetry, registers::TELEMETRY_WORDS};

use super::*;
use crate::FaultKind;
use crate::codec::Received;
use drivebench_link::register_map::RegisterMap;
use drivebench_link::virtual_line::{LineTime, bus_to, own_to, paused};
use drivebench_link::{CellBus, LinkError, LinkStatistics, Put, ReadRequest, Result};
use drivebench_model::sample::{Channel, Command, Demand};

/// Share of the replies with a fault.
const SHARE: f64 = 0.04;
/// Drive time that passes with each request, s: it tells the replies apart.
const STEP_S: f64 = 0.001;
/// The drive's counter of microseconds comes round after this, s.
const TURN_S: f64 = 4_294.967_296;

/// Faults of bytes that hit a share of the replies. The last three change a frame of Modbus and none of the stream.
const KINDS: [FaultKind; 16] = [
    FaultKind::ByteDropped,
    FaultKind::ByteInserted,
    FaultKind::BitFlipped,
    FaultKind::DoubledReply,
    FaultKind::LateReply,
    FaultKind::HeldReply,
    FaultKind::HeldTwice,
    FaultKind::Truncated,
    FaultKind::Garbage,
    FaultKind::SplitReply,
    FaultKind::Echo,
    FaultKind::WrongBaud,
    FaultKind::Silence,
    FaultKind::WrongUnit,
    FaultKind::WrongRequest,
    FaultKind::Exception,
];

fn kinds_on(protocol: Protocol) -> Vec<FaultKind> {
    // TCP loses and changes no byte by itself.
    let changes_bytes = |kind: &FaultKind| {
        matches!(
            kind,
            FaultKind::ByteDropped
                | FaultKind::ByteInserted
                | FaultKind::BitFlipped
                | FaultKind::Truncated
                | FaultKind::Garbage
                | FaultKind::Echo
                | FaultKind::WrongBaud
        )
    };
    match protocol {
        Protocol::ModbusRtu | Protocol::ModbusRtuOverTcp => KINDS.to_vec(),
        Protocol::ModbusTcp => KINDS.into_iter().filter(|kind| !changes_bytes(kind)).collect(),
        Protocol::Stream => KINDS[..13].to_vec(),
        Protocol::Vesc | Protocol::Dynamixel | Protocol::Lines => Vec::new(),
    }
}

fn fault(kind: FaultKind, share: f64) -> FaultEntry {
    FaultEntry {
        share,
        // Beyond the deadline of the link to the own drive, ms.
        late_ms: (kind == FaultKind::LateReply).then_some(100.0),
        ..FaultEntry::new(kind)
    }
}

/// The same beyond the shorter deadline of the bus of registers.
fn on_bus(mut faults: Vec<FaultEntry>) -> Vec<FaultEntry> {
    for fault in &mut faults {
        fault.late_ms = fault.late_ms.map(|_| 25.0);
    }
    faults
}

/// So many of the replies have one of these faults.
fn mixed(kinds: &[FaultKind]) -> Vec<FaultEntry> {
    let each = SHARE / kinds.len() as f64;
    kinds.iter().map(|kind| fault(*kind, each)).collect()
}

fn everything() -> bool {
    std::env::var_os("DRIVEBENCH_EVERYTHING").is_some()
}

/// What the drive answered last.
#[derive(Default)]
struct Meant {
    /// Requests for registers: every value that is read is made of this number.
    reads: u32,
    telemetry: Telemetry,
    drive_time_s: f64,
    /// Without the frame around a PDU of Modbus; empty where the request did not reach the drive.
    answer: Vec<u8>,
    /// The message that answers the command of a number on the stream in the place of telemetry.
    instead: Option<(u16, Message)>,
}

impl Meant {
    #[expect(clippy::cast_possible_truncation, reason = "any sixteen bits will do")]
    fn registers(&self, first: u16, count: u16) -> Vec<u16> {
        let register = |index: u32| {
            (self.reads.wrapping_mul(2_654_435_761).wrapping_add(index * 40_503) >> 9) as u16
        };
        (u32::from(first)..).take(count.into()).map(register).collect()
    }
}

/// The software drive, but that a register that is read holds what nothing else does.
struct Numbered(SoftDrive, Arc<Mutex<Meant>>);

impl Numbered {
    fn advance(&mut self) {
        let time_s = self.0.time_s() + STEP_S;
        self.0.advance_to(time_s);
    }
}

impl Responder for Numbered {
    fn soft(&self) -> &SoftDrive {
        &self.0
    }

    /// Its time passes with its requests.
    fn advance_to(&mut self, _: f64) {}

    fn modbus(&mut self, request: &[u8]) -> Vec<u8> {
        self.advance();
        let mut meant = self.1.lock().unwrap();
        meant.drive_time_s = self.0.time_s();
        meant.answer = match *request {
            [code @ (3 | 4), high, low, _, count] => {
                meant.reads += 1;
                let first = u16::from_be_bytes([high, low]);
                let words = meant.registers(first, count.into()).into_iter();
                [code, 2 * count].into_iter().chain(words.flat_map(u16::to_be_bytes)).collect()
            }
            [6, ..] => request.to_vec(),
            _ => Responder::modbus(&mut self.0, request),
        };
        if let [23, _, content @ ..] = meant.answer.as_slice() {
            let mut block = [0; TELEMETRY_WORDS];
            for (word, pair) in block.iter_mut().zip(content.chunks_exact(2)) {
                *word = u16::from_be_bytes([pair[0], pair[1]]);
            }
            meant.telemetry = Telemetry::from_registers(&block);
        }
        meant.answer.clone()
    }

    fn stream(&mut self, received: &Received) -> Option<Frame> {
        self.advance();
        let mut frame = Responder::stream(&mut self.0, received)?;
        let mut meant = self.1.lock().unwrap();
        meant.drive_time_s = self.0.time_s();
        if let Message::Telemetry(telemetry) = frame.message {
            meant.telemetry = telemetry;
        }
        if let Some((_, message)) = meant.instead.filter(|(seq, _)| *seq == frame.seq) {
            frame.message = message;
        }
        meant.answer = stream::encode(&frame).to_vec();
        Some(frame)
    }

    fn foreign_write(&self) -> Vec<u8> {
        self.0.foreign_write()
    }
}

/// The drive on its line, and how often the line brought something else than its answer alone.
struct Observed {
    protocol: Protocol,
    line: DriveOnLine,
    meant: Arc<Mutex<Meant>>,
    tampered: u64,
    /// Zeros around every reply, some before and some behind, as a line without bias or a slow turnaround adds them.
    has_strays: bool,
}

impl Observed {
    fn new(protocol: Protocol, faults: &[FaultEntry], seed: u64) -> Arc<Mutex<Self>> {
        let meant = Arc::new(Mutex::new(Meant::default()));
        let config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
        let drive = Numbered(SoftDrive::new(&config, 1), Arc::clone(&meant));
        let config = LineConfig::default();
        let line = DriveOnLine::new(Box::new(drive), protocol, UNIT, &config, faults, seed);
        Arc::new(Mutex::new(Self { protocol, line, meant, tampered: 0, has_strays: false }))
    }
}

impl FarEnd for Observed {
    fn receive(&mut self, now_s: f64, bytes: &[u8]) -> Vec<(f64, Vec<u8>)> {
        self.meant.lock().unwrap().answer.clear();
        let sent = self.line.receive(now_s, bytes);
        let answer = &self.meant.lock().unwrap().answer;
        let expected = match self.protocol {
            _ if answer.is_empty() => Vec::new(),
            Protocol::ModbusRtu | Protocol::ModbusRtuOverTcp => {
                rtu::encode_frame(UNIT, answer).to_vec()
            }
            Protocol::ModbusTcp => {
                let transaction = u16::from_be_bytes([bytes[0], bytes[1]]);
                tcp::encode_frame(transaction, UNIT, answer).to_vec()
            }
            _ => answer.clone(),
        };
        let is_clean = match sent.as_slice() {
            [] => expected.is_empty(),
            // A reply that comes later than this after its request is late, s.
            [(at_s, whole)] => *whole == expected && at_s - now_s < 0.02,
            _ => false,
        };
        self.tampered += u64::from(!is_clean);
        if !self.has_strays {
            return sent;
        }
        let sent = sent.into_iter().map(|(at_s, bytes)| {
            let before = bytes.len() % 3;
            (at_s, [vec![0; before], bytes, vec![0; 3 - before]].concat())
        });
        sent.collect()
    }
}

/// What came of many exchanges.
#[derive(Debug, Default)]
struct Outcome {
    wrong: u64,
    /// Exchanges that failed although nothing was done to their reply.
    collateral: u64,
    statistics: LinkStatistics,
    stale_frames: u64,
    tampered: u64,
}

impl Outcome {
    /// One exchange, which says whether its value is what the drive meant.
    fn judge(&mut self, far: &Mutex<Observed>, exchange: impl FnOnce() -> Result<bool>) {
        let result = exchange();
        assert!(!matches!(result, Err(LinkError::Gone { .. })), "{result:?}");
        let tampered = far.lock().unwrap().tampered;
        let is_untouched = tampered == std::mem::replace(&mut self.tampered, tampered);
        self.collateral += u64::from(result.is_err() && is_untouched);
        self.wrong += u64::from(matches!(result, Ok(false)));
    }

    fn closed(self, statistics: LinkStatistics, stale_frames: u64) -> Self {
        assert!(statistics.balances(), "{statistics:?}");
        Self { statistics, stale_frames, ..self }
    }
}

/// A link to the own drive; the thread has to be in virtual time.
fn link_to(protocol: Protocol, far: &Arc<Mutex<Observed>>) -> Box<dyn DriveLink> {
    own_to(protocol, &DriveProfile::named("own").unwrap(), far)
}

fn volts(seq: u64) -> Command {
    let demand = Demand::Voltage(1.0);
    Command { seq, demand }
}

/// Commands as a bench gives them; each sample has to be what the drive meant by its answer to that command.
fn on_a_line(protocol: Protocol, faults: &[FaultEntry], count: u64, seed: u64) -> Outcome {
    paused(|| {
        let far = Observed::new(protocol, faults, seed);
        let meant = Arc::clone(&far.lock().unwrap().meant);
        let mut link = link_to(protocol, &far);
        let (mut outcome, mut origin_s) = (Outcome::default(), None);
        for seq in 1..=count {
            outcome.judge(&far, || {
                let sample = link.exchange(volts(seq))?;
                let meant = meant.lock().unwrap();
                let is_near = |channel, value: f64| {
                    (sample.get(channel).unwrap_or(f64::NAN) - value).abs() < 0.006
                };
                let offset_s = meant.drive_time_s - sample.time_s;
                let turns = (offset_s - *origin_s.get_or_insert(offset_s)) / TURN_S;
                let is_its_time = (turns - turns.round()).abs() * TURN_S < 0.1 * STEP_S;
                Ok(sample.seq == Some(seq)
                    && is_its_time
                    && is_near(Channel::Current, meant.telemetry.current_a)
                    && is_near(Channel::Voltage, meant.telemetry.voltage_v))
            });
        }
        let line = link.line().unwrap();
        let open = line.bytes_received - line.bytes_accepted - line.bytes_dropped;
        assert!(open < 2048, "{line:?}: only what came last may be unjudged");
        outcome.closed(link.statistics(), line.stale_frames)
    })
}

/// Kinds that a fault may be counted in, and whether it costs an exchange at all.
fn counted(protocol: Protocol, kind: FaultKind, s: &LinkStatistics) -> (u64, bool) {
    let damaged = s.crc + s.timeout;
    match kind {
        // Nothing marks the beginning of a stream's frame: what stands before it becomes a part of it.
        FaultKind::Garbage if protocol == Protocol::Stream => (damaged, false),
        FaultKind::ByteInserted => (damaged, false),
        FaultKind::ByteDropped
        | FaultKind::BitFlipped
        | FaultKind::Truncated
        | FaultKind::WrongBaud => (damaged, true),
        FaultKind::LateReply | FaultKind::HeldReply | FaultKind::HeldTwice => {
            (s.timeout + s.stale, true)
        }
        FaultKind::Silence => (s.timeout, true),
        FaultKind::WrongUnit => (s.mismatch, true),
        FaultKind::WrongRequest => (s.mismatch + s.stale, true),
        FaultKind::Exception => (s.exception, true),
        _ => (0, false),
    }
}

#[test]
fn every_fault_is_counted_in_its_class_and_costs_one_exchange() {
    for protocol in [Protocol::ModbusRtu, Protocol::Stream] {
        let clean = on_a_line(protocol, &[], 2000, 1);
        assert_eq!((clean.wrong, clean.statistics.lost(), clean.tampered), (0, 0, 0), "{clean:?}");
        for (seed, kind) in (0..).zip(kinds_on(protocol)) {
            let outcome = on_a_line(protocol, &[fault(kind, SHARE)], 3000, seed);
            let s = &outcome.statistics;
            let context = format!("{protocol:?} {kind:?}: {outcome:?}");
            assert_eq!(outcome.wrong, 0, "{context}");
            assert!(outcome.tampered > 60, "{context}");
            let (in_class, costs) = counted(protocol, kind, s);
            assert_eq!(s.lost(), in_class, "{context}");
            // The request after a reply that was late or held back has two, or waits for both.
            let spreads =
                matches!(kind, FaultKind::LateReply | FaultKind::HeldReply | FaultKind::HeldTwice);
            let hits = outcome.tampered / if spreads { 2 } else { 1 };
            if costs {
                assert!(in_class * 10 >= hits * 9, "{context}");
            }
            let allowed = if spreads { outcome.tampered / 4 } else { 0 };
            assert!(outcome.collateral <= allowed, "{context}");
            if kind == FaultKind::DoubledReply {
                assert!(outcome.stale_frames * 10 >= outcome.tampered * 9, "{context}");
            }
        }
    }
}

#[test]
fn mixed_faults_never_give_a_wrong_value() {
    let count = if everything() { 10_000_000 } else { 100_000 };
    for protocol in Protocol::ALL.into_iter().filter(|protocol| protocol.has_memory_link()) {
        let mut kinds = kinds_on(protocol);
        // No stream of TCP has another frame between the parts of one, as a late reply among the parts of a split one would be.
        kinds.retain(|kind| protocol != Protocol::ModbusTcp || *kind != FaultKind::SplitReply);
        let outcome = on_a_line(protocol, &mixed(&kinds), count, 7);
        println!("{protocol:?}: {outcome:?}");
        assert_eq!(outcome.wrong, 0, "{outcome:?}");
        let share = outcome.tampered as f64 / count as f64;
        assert!((0.03..0.06).contains(&share), "{outcome:?}");
        // What is lost is what was tampered with, and little beside it.
        assert!(outcome.collateral * 100 < outcome.tampered, "{outcome:?}");
        assert!(outcome.statistics.lost() <= outcome.tampered + outcome.collateral);
    }
}

/// Reads as a cycle makes them: two blocks that look alike, one that does not, the alike ones first.
const READS: [(u16, u16); 4] = [(100, 3), (200, 3), (300, 2), (400, 3)];

/// The servo amplifier, which can be proven fresh by read lengths, or with a function code 8 or nothing of the kind.
fn map(resync: &str) -> RegisterMap {
    let text = DriveProfile::text("epulse50-dc").unwrap();
    let functions = "functions = [3, 6, 16]";
    assert!(text.contains("resync = \"length\"") && text.contains(functions));
    let text = text
        .replace("resync = \"length\"", &format!("resync = \"{resync}\""))
        .replace(functions, "functions = [3, 6, 8, 16]");
    RegisterMap::parse("epulse50-dc", &text).unwrap()
}

/// The bus of a drive with a map of its own: nothing in a plain read says which request it answers.
fn on_a_bus(resync: &str, faults: &[FaultEntry], count: usize, seed: u64) -> Outcome {
    on_a_stray_bus(resync, faults, count, seed, false)
}

fn on_a_stray_bus(
    resync: &str,
    faults: &[FaultEntry],
    count: usize,
    seed: u64,
    has_strays: bool,
) -> Outcome {
    paused(|| {
        let mut settings = DriveProfile::named("epulse50-dc").unwrap().link;
        settings.deadline_ms = Some(12.0);
        let far = Observed::new(Protocol::ModbusRtu, faults, seed);
        far.lock().unwrap().has_strays = has_strays;
        let meant = Arc::clone(&far.lock().unwrap().meant);
        let mut bus = bus_to(&map(resync), &settings, &far);
        let mut outcome = Outcome::default();
        for turn in 1..=count {
            let (address, words) = READS[turn % READS.len()];
            outcome.judge(&far, || {
                // One request in so many is a write.
                if turn % 6 == 0 {
                    let value = u16::try_from(turn % 3000).unwrap();
                    return bus
                        .write(Put { function: 6, address: 0x1026, cells: &[value] })
                        .map(|_| true);
                }
                let read = bus.read(ReadRequest::holding(address, words))?;
                Ok(read.cells == meant.lock().unwrap().registers(address, words))
            });
        }
        outcome.closed(CellBus::statistics(&bus), CellBus::line(&bus).unwrap().stale_frames)
    })
}

/// Every kind of fault on many fresh lines: the first one of its kind is the hardest, nothing has been learned yet.
#[test]
fn the_first_fault_of_a_line_gives_no_wrong_value() {
    let lines = if everything() { 400 } else { 40 };
    for resync in ["fc08", "length", "none"] {
        let clean = on_a_bus(resync, &[], 3000, 1);
        assert_eq!((clean.wrong, clean.statistics.lost()), (0, 0), "{resync}");
    }
    for resync in ["fc08", "length"] {
        for kind in KINDS {
            for seed in 0..lines {
                let outcome = on_a_bus(resync, &on_bus(vec![fault(kind, SHARE)]), 100, seed);
                assert_eq!(outcome.wrong, 0, "{resync} {kind:?} {seed}: {outcome:?}");
            }
        }
    }
}

#[test]
fn mixed_faults_never_give_a_wrong_value_on_a_profiled_bus() {
    let count = if everything() { 2_000_000 } else { 100_000 };
    for resync in ["fc08", "length"] {
        let outcome = on_a_bus(resync, &on_bus(mixed(&KINDS)), count, 7);
        println!("{resync}: {outcome:?}");
        assert_eq!(outcome.wrong, 0, "{resync}: {outcome:?}");
        let share = outcome.tampered as f64 / outcome.statistics.sent as f64;
        assert!((0.03..0.06).contains(&share), "{outcome:?}");
        // A drive that answers late is deaf meanwhile, and a write is not repeated.
        assert!(outcome.collateral * 10 < outcome.tampered, "{outcome:?}");
    }
}

/// Stray bytes around every reply, and every reply twice: no loss of synchronisation, and no wrong value among other faults.
#[test]
fn bytes_around_whole_replies_cost_nothing_and_hide_no_fault() {
    let count = if everything() { 2_000_000 } else { 100_000 };
    for resync in ["fc08", "length"] {
        let clean = on_a_stray_bus(resync, &[], 3000, 1, true);
        assert_eq!((clean.wrong, clean.statistics.lost()), (0, 0), "{resync}: {clean:?}");
        let outcome = on_a_stray_bus(resync, &on_bus(mixed(&KINDS)), count, 7, true);
        println!("{resync}: {outcome:?}");
        assert_eq!(outcome.wrong, 0, "{resync}: {outcome:?}");
        assert!(outcome.collateral * 10 < outcome.tampered, "{outcome:?}");
        let doubled = on_a_bus(resync, &[fault(FaultKind::DoubledReply, 1.0)], 3000, 1);
        // The drive is deaf to what the host sends into a second copy.
        let s = doubled.statistics;
        assert!(doubled.wrong == 0 && s.lost() * 10 < s.sent, "{resync}: {doubled:?}");
        assert!(doubled.stale_frames > 2900, "{resync}: {doubled:?}");
    }
}

/// Where only silence proves the line (`resync = "none"`), a reply that the drive holds back until the next request cannot be
/// detected, and is left out here.
#[test]
fn silence_alone_detects_all_faults_but_held_replies() {
    let count = if everything() { 1_000_000 } else { 50_000 };
    let is_late = |kind: &FaultKind| {
        matches!(kind, FaultKind::LateReply | FaultKind::HeldReply | FaultKind::HeldTwice)
    };
    let kinds: Vec<FaultKind> = KINDS.into_iter().filter(|kind| !is_late(kind)).collect();
    let outcome = on_a_bus("none", &mixed(&kinds), count, 5);
    println!("none: {outcome:?}");
    assert_eq!(outcome.wrong, 0, "{outcome:?}");
}

/// Works on a line that has these faults, for so long, once its drive runs.
fn with_faults(
    protocol: Protocol,
    kinds: &[FaultKind],
    for_s: Option<f64>,
    work: impl FnOnce(&mut dyn DriveLink, LineTime),
) {
    paused(|| {
        let entry =
            |kind: &FaultKind| FaultEntry { from_s: Some(0.0), for_s, ..FaultEntry::new(*kind) };
        let entries: Vec<FaultEntry> = kinds.iter().map(entry).collect();
        let far = Observed::new(protocol, &entries, 1);
        let time = LineTime::start();
        let mut link = link_to(protocol, &far);
        link.exchange(volts(1)).unwrap();
        work(link.as_mut(), time);
        assert!(link.statistics().balances());
    });
}

#[test]
fn silence_ends_at_the_deadline_and_at_the_bound() {
    for protocol in [Protocol::ModbusRtu, Protocol::Stream] {
        with_faults(protocol, &[FaultKind::Silence], None, |link, time| {
            let began_s = time.now_s();
            let error = link.exchange(volts(2)).unwrap_err();
            let LinkError::Timeout { deadline_ms, .. } = error else {
                panic!("{error}");
            };
            let took_ms = 1e3 * (time.now_s() - began_s);
            let is_in_time = took_ms < 300.0 && took_ms + 1.0 > deadline_ms as f64;
            assert!(is_in_time, "{took_ms}");
            link.bound(0.03);
            let began_s = time.now_s();
            let error = link.exchange(volts(3)).unwrap_err();
            assert!(error.is_transient(), "{error}");
            assert!(time.now_s() - began_s < 0.031);
        });
    }
}

#[test]
fn a_line_that_babbles_is_given_up_in_time() {
    let kinds = [FaultKind::Babble, FaultKind::Silence];
    with_faults(Protocol::ModbusRtu, &kinds, None, |link, time| {
        for seq in 2..4 {
            let began_s = time.now_s();
            let error = link.exchange(volts(seq)).unwrap_err();
            assert!(error.is_transient(), "{error}");
            assert!(time.now_s() - began_s < 0.5);
        }
    });
}

#[test]
fn a_stop_is_repeated_until_the_drive_has_it() {
    with_faults(Protocol::ModbusRtu, &[FaultKind::Silence], Some(0.1), |link, _| {
        link.stop().unwrap();
        assert!(link.statistics().timeout >= 1);
    });
}

/// Whether an error is of the class that is expected.
type Class = fn(&LinkError) -> bool;

/// What the stream brings in the place of telemetry, and the error that follows; the link lives on.
#[test]
fn other_messages_of_the_stream_have_their_class() {
    let refusal = Refusal { kind: 2, code: ErrorCode::NotSupported };
    let cases: [(Message, Class); 2] = [
        (Message::Identity(firmware_protocol::Identity::default()), |error| {
            matches!(error, LinkError::Unexpected { .. })
        }),
        (Message::Error(refusal), |error| {
            let text = "the drive refused the command: exception 0x04 not supported";
            error.to_string().ends_with(text)
        }),
    ];
    for (message, is_right) in cases {
        paused(|| {
            let far = Observed::new(Protocol::Stream, &[], 1);
            far.lock().unwrap().meant.lock().unwrap().instead = Some((4, message));
            let mut link = link_to(Protocol::Stream, &far);
            for seq in 1..8 {
                let result = link.exchange(volts(seq));
                let is_expected = match &result {
                    Ok(_) => seq != 4,
                    Err(error) => seq == 4 && is_right(error),
                };
                assert!(is_expected, "{seq}: {result:?}");
            }
        });
    }
}

#[test]
fn another_version_and_another_map_are_refused() {
    let other = FaultEntry::new(FaultKind::OtherVersion);
    let mut config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    config.faulty.push(other);
    let profile = DriveProfile::named("own").unwrap();
    let link = open_line(None, &config, 1, &profile, VirtualClock::new());
    let version = link.unwrap().identify().unwrap_err();
    assert!(matches!(version, LinkError::Version { found: 9, .. }), "{version}");
    // Its registers hold no identity.
    let far = Observed::new(Protocol::ModbusRtu, &[], 1);
    let map = paused(|| link_to(Protocol::ModbusRtu, &far).identify().unwrap_err());
    assert!(matches!(map, LinkError::Identity { .. }), "{map}");
}
