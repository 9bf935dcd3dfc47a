//! The raw client against a unit of its own on a line in memory. Each register holds its own address, so that a value of
//! another request shows.

use firmware_protocol::registers::{IDENTITY_ADDRESS, IDENTITY_WORDS};
use rand::{RngCore as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::framing::FrameKind;
use crate::open::modbus_link;
use crate::scripted::{Delayed, Scripted, frame};
use crate::virtual_line::{exchange, paused};

/// From a request to its reply, and between the pieces of one.
const PIECE: Duration = Duration::from_millis(5);

/// What the device does wrong with one request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    None,
    /// The reply comes when the next request does, before that one's own.
    Late,
    Silent,
    Duplicate,
    /// The second copy comes when the next request does.
    LateDuplicate,
    GarbageBefore,
    GarbageAfter,
    WrongFunction,
    WrongCount,
    WrongUnit,
    BadChecksum,
    Truncated,
    Split,
}

const FAULTS: [Fault; 12] = [
    Fault::Late,
    Fault::Silent,
    Fault::Duplicate,
    Fault::LateDuplicate,
    Fault::GarbageBefore,
    Fault::GarbageAfter,
    Fault::WrongFunction,
    Fault::WrongCount,
    Fault::WrongUnit,
    Fault::BadChecksum,
    Fault::Truncated,
    Fault::Split,
];

/// Requests that a unit answers with an exception, or not at all.
#[derive(Clone, Copy, Default)]
struct Abilities {
    only_reads_of: Option<u16>,
    is_silent_otherwise: bool,
}

/// Works with a client of a scripted unit; returns the PDUs that it was asked.
fn with_script(
    timeout_ms: u64,
    script: impl FnMut(usize, &[u8]) -> Vec<Delayed> + Send + 'static,
    work: impl FnOnce(&mut RawClient),
) -> Vec<Vec<u8>> {
    paused(|| {
        let unit = Scripted::new(script);
        let timeout = Duration::from_millis(timeout_ms);
        let settings = settings(timeout).link();
        let line = exchange("virtual", FrameKind::Rtu, &settings, &unit);
        let mut client = RawClient::over(modbus_link(line, settings.unit), timeout, String::new());
        work(&mut client);
        let counters = client.counters();
        assert!(counters.requests.balances(), "{counters:?}");
        let requests = std::mem::take(&mut unit.lock().unwrap().requests);
        let pdu = |(_, request): (_, Vec<u8>)| request[1..request.len() - 2].to_vec();
        requests.into_iter().map(pdu).collect()
    })
}

/// The same with a unit that does `fault` to the reply of a request.
fn with_client(
    abilities: Abilities,
    timeout_ms: u64,
    mut fault: impl FnMut(usize) -> Fault + Send + 'static,
    work: impl FnOnce(&mut RawClient),
) -> Vec<Vec<u8>> {
    let mut pending = Vec::new();
    let script = move |number: usize, request: &[u8]| {
        let pdu = &request[1..request.len() - 2];
        let parts = answer(pdu, fault(number), abilities, &mut pending);
        (1..).map(|k| PIECE * k).zip(parts).collect()
    };
    with_script(timeout_ms, script, work)
}

fn always(fault: Fault) -> impl FnMut(usize) -> Fault + Send + 'static {
    move |_| fault
}

/// This fault of one request, counted from 0, and none of any other.
fn only(at: usize, fault: Fault) -> impl FnMut(usize) -> Fault + Send + 'static {
    move |index| if index == at { fault } else { Fault::None }
}

fn settings(timeout: Duration) -> RawSettings {
    RawSettings {
        baud: 115_200,
        framing: Framing::EightNoneOne,
        unit: 1,
        timeout,
        gap: Some(Duration::ZERO),
        rtu_over_tcp: false,
    }
}

/// The pieces that the unit sends for one request.
fn answer(pdu: &[u8], fault: Fault, abilities: Abilities, pending: &mut Vec<u8>) -> Vec<Vec<u8>> {
    let word = |at: usize| u16::from_be_bytes([pdu[at], pdu[at + 1]]);
    let reads = |function: u8, count: u16| {
        let values = (0..count).flat_map(|k| (word(1) + k).to_be_bytes());
        let bytes = u8::try_from(2 * count).unwrap();
        [function, bytes].into_iter().chain(values).collect::<Vec<u8>>()
    };
    let refused = match (pdu[0], abilities.only_reads_of) {
        (3, Some(count)) => word(3) != count,
        (3 | 4 | 6 | 16, None) => false,
        _ => true,
    };
    let mut out = std::mem::take(pending);
    if refused && abilities.is_silent_otherwise {
        return vec![out];
    }
    let reply = match pdu[0] {
        function if refused => vec![function | 0x80, 1],
        function @ (3 | 4) => reads(function, word(3)),
        _ => pdu[..5].to_vec(),
    };
    let right = frame(1, &reply);
    let mut wrong = right.clone();
    match fault {
        Fault::WrongCount if !refused && pdu[0] == 3 => {
            out.extend(frame(1, &reads(3, word(3) + 1)));
        }
        Fault::None | Fault::WrongCount => out.extend(right),
        Fault::Late => pending.extend(right),
        Fault::Silent => {}
        Fault::Duplicate => out.extend([right.clone(), right].concat()),
        Fault::LateDuplicate => {
            out.extend(&right);
            pending.extend(right);
        }
        Fault::GarbageBefore => out.extend([&[0xFF, 0x00, 0x55][..], &right].concat()),
        Fault::GarbageAfter => out.extend([&right[..], &[0xAA, 0x03]].concat()),
        Fault::WrongFunction => {
            let mut reply = reply;
            reply[0] ^= 7;
            out.extend(frame(1, &reply));
        }
        Fault::WrongUnit => out.extend(frame(2, &reply)),
        Fault::BadChecksum => {
            wrong[2] ^= 1;
            out.extend(wrong);
        }
        Fault::Truncated => out.extend(&right[..right.len() - 2]),
        Fault::Split => {
            out.extend(&right[..3]);
            return vec![out, right[3..].to_vec()];
        }
    }
    vec![out]
}

fn reads(addresses: &[u16], count: u16) -> Vec<ReadRequest> {
    let of = |address: &u16| ReadRequest::holding(*address, count);
    addresses.iter().map(of).collect()
}

/// No value is that of another address; returns how many were answered.
#[track_caller]
fn answered(batch: &Batch, context: &str) -> usize {
    let mut answered = 0;
    for read in &batch.reads {
        let Ok(values) = &read.values else { continue };
        let right: Vec<u16> = (0..read.request.count).map(|k| read.request.address + k).collect();
        assert_eq!(*values, right, "{context}: {:?}", read.request);
        answered += 1;
    }
    answered
}

fn batch(client: &mut RawClient, requests: &[ReadRequest], rounds: u64) -> Batch {
    read_batch(client, requests, rounds, &AtomicBool::new(false))
}

#[test]
fn no_fault_gives_a_wrong_value_and_the_line_recovers() {
    for (fault, at) in FAULTS.iter().flat_map(|f| [0, 1, 4].map(|at| (*f, at))) {
        let context = format!("{fault:?} of request {at}");
        with_client(Abilities::default(), 300, only(at, fault), |client| {
            let first = batch(client, &reads(&[10, 20, 30, 40, 50], 1), 1);
            assert!(answered(&first, &context) >= 4, "{context}: {first:?}");
            let second = batch(client, &reads(&[10, 20, 30], 2), 1);
            assert_eq!(answered(&second, &context), 3, "{context}: {second:?}");
        });
    }
    let mut random = ChaCha8Rng::seed_from_u64(6);
    let mixed = move |_| {
        let draw = random.next_u32() as usize % 64;
        FAULTS.get(draw).copied().unwrap_or(Fault::None)
    };
    with_client(Abilities::default(), 40, mixed, |client| {
        let mut delivered = 0;
        for round in 0..40_u16 {
            let requests = reads(&[10 + round, 100 + round, 200 + round], 1 + round % 3);
            delivered += answered(&batch(client, &requests, 1), "mixed");
        }
        let counters = client.counters();
        assert!(delivered > 30, "{delivered} {counters:?}");
        assert!(counters.resynchronisations > 0, "{counters:?}");
    });
}

/// A line that does the same to every reply still yields what came clean.
#[test]
fn a_fault_of_every_reply_gives_no_wrong_value() {
    for fault in [
        Fault::Duplicate,
        Fault::LateDuplicate,
        Fault::GarbageBefore,
        Fault::GarbageAfter,
        Fault::Late,
    ] {
        with_client(Abilities::default(), 60, always(fault), |client| {
            for count in [1, 3] {
                let all = batch(client, &reads(&[10, 20, 30, 40, 50], count), 1);
                let context = format!("{fault:?}, {count} at a time");
                let values = answered(&all, &context);
                assert!(values >= 3, "{context}: {values} of 5, {all:?}");
            }
        });
    }
}

#[test]
fn a_unit_that_answers_one_length_only_is_proven() {
    for is_silent_otherwise in [false, true] {
        let abilities = Abilities { only_reads_of: Some(4), is_silent_otherwise };
        with_client(abilities, 100, always(Fault::None), |client| {
            for _ in 0..2 {
                let all = batch(client, &reads(&[10, 20], 4), 3);
                assert_eq!(answered(&all, "one length"), 2, "{all:?}");
                assert!(all.is_all_answered());
            }
            if !is_silent_otherwise {
                let refused = batch(client, &reads(&[8], 2), 1);
                let error = refused.reads[0].values.as_ref().unwrap_err();
                assert!(matches!(error, LinkError::Exception { code: 1, .. }));
                assert_eq!((refused.asked, refused.answered), (1, 0));
            }
        });
    }
}

#[test]
fn lost_replies_cost_a_timeout_and_no_second_write() {
    with_client(Abilities::default(), 200, only(1, Fault::Silent), |client| {
        assert_eq!(client.read(reads(&[5], 1)[0]).unwrap(), [5]);
        let lost = client.write(WriteFunction::Multiple, 5, &[9, 9]);
        assert!(matches!(lost, Err(LinkError::Timeout { .. })), "{lost:?}");
        client.write(WriteFunction::Single, 5, &[9]).unwrap();
    });
    with_client(Abilities::default(), 30, always(Fault::Silent), |client| {
        let none = batch(client, &reads(&[1, 2, 3], 1), 2);
        assert_eq!((none.asked, none.answered), (6, 0));
        let requests = client.counters().requests;
        assert_eq!((requests.sent, requests.timeout), (6, 6));
        assert!(none.rate_hz().is_none() && none.quantile_s(0.5).is_none());
    });
}

#[test]
fn a_peer_that_closes_ends_the_batch() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let server = std::thread::spawn(move || drop(listener.accept().unwrap()));
    let settings = RawSettings { gap: None, ..settings(Duration::from_secs(2)) };
    let target = format!("tcp:{address}").parse().unwrap();
    let mut client = RawClient::open(&target, &settings, None).unwrap();
    server.join().unwrap();
    let none = batch(&mut client, &reads(&[1, 2], 1), 1000);
    assert_eq!((none.asked, none.answered), (2000, 0));
    let gone = |read: &Read| matches!(read.values, Err(LinkError::Gone { .. }));
    assert_eq!(none.reads.iter().filter(|read| gone(read)).count(), 2);
    assert!(client.counters().requests.balances());
}

#[test]
fn our_own_drive_is_known_where_its_first_reply_comes_twice() {
    let identity = firmware_protocol::Identity {
        serial_number: 4711,
        ..firmware_protocol::Identity::default()
    };
    let block: [u16; IDENTITY_WORDS] = identity.to_registers();
    let script = move |number: usize, request: &[u8]| {
        let word = |at: usize| usize::from(u16::from_be_bytes([request[at], request[at + 1]]));
        let reply = match request[1] {
            3 => {
                let begin = word(2) - usize::from(IDENTITY_ADDRESS);
                let words = block[begin..begin + word(4)].iter();
                let bytes: Vec<u8> = words.flat_map(|word| word.to_be_bytes()).collect();
                let count = u8::try_from(bytes.len()).unwrap();
                frame(1, &[&[3, count], &bytes[..]].concat())
            }
            _ => request.to_vec(),
        };
        let delays = [PIECE, PIECE * 7].into_iter().take(if number == 0 { 2 } else { 1 });
        delays.map(|delay| (delay, reply.clone())).collect()
    };
    with_script(300, script, |client| {
        assert_eq!(client.identify().unwrap().unwrap().serial_number, "4711");
    });
}

/// A unit that refuses some functions with an exception, and carries a write out some time after its reply.
#[test]
fn acknowledgement_and_read_back_state_what_a_write_has_done() {
    use WriteOutcome::{Confirmed, Differs, Pending, Unconfirmed, Unreadable};
    /// Reply to the write (0: its acknowledgement), time until it acts, and reply to reads meanwhile and afterwards.
    type Case = (&'static str, u8, Option<u64>, u8, u8, WriteOutcome);
    let cases: [Case; 10] = [
        ("acknowledged", 0, Some(0), 0, 0, Confirmed),
        ("acknowledged and ignored", 0, None, 0, 0, Differs),
        ("acknowledged, write-only", 0, Some(0), 2, 2, Unreadable),
        ("accepted, acts at once", 5, Some(0), 0, 0, Confirmed),
        ("accepted, acts late", 5, Some(900), 0, 0, Confirmed),
        ("accepted, busy meanwhile", 5, Some(900), 6, 0, Confirmed),
        ("accepted, never acts", 5, None, 0, 0, Pending),
        ("accepted, write-only", 5, Some(900), 2, 2, Unreadable),
        ("busy", 6, None, 0, 0, Unconfirmed),
        ("acknowledged, the gateway loses its unit", 0, Some(0), 11, 11, Unconfirmed),
    ];
    for (name, reply, acts_ms, meanwhile, afterwards, expected) in cases {
        let mut written: Option<Instant> = None;
        let script = move |_: usize, request: &[u8]| {
            let pdu = &request[1..request.len() - 2];
            let due = |at: Instant| Some(at + Duration::from_millis(acts_ms?));
            let is_over = written.and_then(due).is_some_and(|due| now() >= due);
            let refused = if is_over || written.is_none() { afterwards } else { meanwhile };
            let reply = match pdu[0] {
                6 => {
                    assert!(written.replace(now()).is_none(), "{name}: a write is never repeated");
                    if reply == 0 { pdu.to_vec() } else { vec![0x86, reply] }
                }
                8 => pdu.to_vec(),
                function if refused != 0 => vec![function | 0x80, refused],
                function => {
                    let count = pdu[4];
                    let value = if is_over { 77 } else { 50 };
                    let words = (0..count).flat_map(|_| [0, value]);
                    [function, 2 * count].into_iter().chain(words).collect()
                }
            };
            vec![(PIECE, frame(1, &reply))]
        };
        with_script(300, script, |client| {
            let done = client.write_and_read_back(WriteFunction::Single, 50, &[77]);
            assert_eq!(done.outcome, expected, "{name}: {done:?}");
            assert_eq!(done.accepted_s.is_some(), reply == 5, "{name}");
            let waits = name == "accepted, never acts";
            let waited_s = done.accepted_s.unwrap_or_default();
            assert!(waited_s < 1.5 || waits && waited_s < 2.5, "{name}: {waited_s} s");
        });
    }
}

#[test]
fn a_busy_unit_is_read_again_for_a_bounded_time() {
    for (busy, is_read, repeats) in [(3, true, 3), (u64::MAX, false, 10)] {
        let mut count = 0;
        let script = move |_: usize, request: &[u8]| {
            count += 1;
            let pdu = &request[1..request.len() - 2];
            let reply = match pdu[0] {
                3 if count > busy => {
                    [&[3, 2 * pdu[4]], &vec![0; 2 * usize::from(pdu[4])][..]].concat()
                }
                3 => vec![0x83, 6],
                _ => pdu.to_vec(),
            };
            vec![(PIECE, frame(1, &reply))]
        };
        with_script(300, script, |client| {
            let began = now();
            for _ in 0..20 {
                assert_eq!(client.read(ReadRequest::holding(10, 1)).is_ok(), is_read);
            }
            assert_eq!(client.counters().busy_repeats, repeats);
            assert!(now().duration_since(began) < Duration::from_secs(2));
        });
    }
}
