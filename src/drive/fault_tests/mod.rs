//! No wrong value, whatever the line does: both links against a stranger that inflicts seventeen kinds of faults.
//!
//! In virtual time a hundred thousand exchanges, with `DRIVEBENCH_EVERYTHING` set ten million; over a real
//! pseudo-terminal two thousand, or a hundred thousand.

mod bounded;
#[path = "../../../tests/witness/codec.rs"]
#[allow(
    dead_code,
    clippy::duplicate_mod,
    reason = "each user of the witness needs its part"
)]
mod codec;
mod profiled;
mod stranger;

use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use stranger::{Fault, Language, Stranger, Times, current_a};

use super::fake::{Fake, raw_pty};
use super::link::{DriveLink, LinkError, LinkStatistics};
use super::modbus::ModbusLink;
use super::register_bus::{ReadRequest, RegisterTable};
use super::stream::StreamLink;
use super::timing::LineTiming;
use super::transaction::LineCounts;
use super::virtual_line::{Device, VirtualPort, modbus_link, paused};
use super::waiting::now;
use super::{DriveProfile, open_modbus, open_stream};
use crate::sample::{Channel, Command, Demand};

/// Faults in a thousand replies.
const PER_MILLE: usize = 40;

fn everything() -> bool {
    std::env::var_os("DRIVEBENCH_EVERYTHING").is_some()
}

/// Either link; plain reads are there only over Modbus.
enum Line {
    Modbus(Box<ModbusLink>),
    Stream(Box<StreamLink>),
}

impl Line {
    fn link(&mut self) -> &mut dyn DriveLink {
        match self {
            Self::Modbus(link) => link.as_mut(),
            Self::Stream(link) => link.as_mut(),
        }
    }
}

/// What came of many exchanges.
#[derive(Debug, Default)]
struct Outcome {
    exchanges: u64,
    wrong: u64,
    /// Exchanges that failed although nothing was done to their reply.
    collateral: u64,
    statistics: LinkStatistics,
    stale_frames: u64,
    tampered: u64,
}

impl Outcome {
    /// One exchange, which says whether its value is what the device meant.
    fn judge(
        &mut self,
        device: &Mutex<Stranger>,
        exchange: impl FnOnce() -> Result<bool, LinkError>,
    ) {
        let before = device.lock().unwrap().tampered;
        let result = exchange();
        let is_gone = matches!(result, Err(LinkError::Gone { .. }));
        assert!(!is_gone, "{result:?}");
        let untouched = device.lock().unwrap().tampered == before;
        self.exchanges += 1;
        self.collateral += u64::from(result.is_err() && untouched);
        self.wrong += u64::from(matches!(result, Ok(false)));
    }

    /// The same with the books of the link, which balance.
    fn closed(
        self,
        device: &Mutex<Stranger>,
        statistics: LinkStatistics,
        line: &LineCounts,
    ) -> Self {
        assert!(statistics.balances(), "{statistics:?}");
        Self {
            tampered: device.lock().unwrap().tampered,
            statistics,
            stale_frames: line.stale_frames,
            ..self
        }
    }
}

/// Exchanges as a bench makes them, one in five a plain read, and judges each value by what the device meant.
fn exchanges(line: &mut Line, device: &Mutex<Stranger>, count: u64, reads: bool) -> Outcome {
    let mut outcome = Outcome::default();
    for seq in 1..=count {
        outcome.judge(device, || match &mut *line {
            Line::Modbus(link) if reads && seq % 5 == 0 => {
                let words = 3 + (seq % 3) as u16;
                let values = link.read_registers(RegisterTable::Holding, 900, words)?;
                Ok(values == device.lock().unwrap().meant(900, words))
            }
            line => {
                let demand = Demand::Voltage(1.0);
                let sample = line.link().exchange(Command { seq, demand })?;
                let meant = current_a(device.lock().unwrap().heard);
                let told = sample.get(Channel::Current).unwrap_or(f64::NAN);
                Ok(sample.seq == Some(seq) && (told - meant).abs() < 0.006)
            }
        });
    }
    let statistics = line.link().statistics();
    let line = line.link().line().unwrap();
    let open = line.bytes_received - line.bytes_accepted - line.bytes_dropped;
    assert!(open < 2048, "{line:?}: only what came last may be unjudged");
    outcome.closed(device, statistics, &line)
}

/// Both languages on a virtual line that answers within 0.7 ms.
fn virtually(
    language: Language,
    faults: &[Fault],
    per_mille: usize,
    count: u64,
    seed: u64,
) -> Outcome {
    paused(|| {
        let settings = DriveProfile::named("own").unwrap().link;
        let timing = LineTiming::serial(&settings, settings.baud, language == Language::Rtu);
        let times = Times {
            turnaround: Duration::from_micros(700),
            deadline: timing.allowed(21, 52),
        };
        let device = Stranger::new(language, faults, per_mille, times, seed);
        let device = Arc::new(Mutex::new(device));
        let mut line = match language {
            Language::Rtu => {
                let link = modbus_link("virtual", &settings, &device);
                Line::Modbus(Box::new(link))
            }
            Language::Stream => {
                let port = Box::new(VirtualPort::new(Arc::clone(&device)));
                let link = StreamLink::new("virtual".to_owned(), port, timing, now());
                Line::Stream(Box::new(link))
            }
        };
        exchanges(&mut line, &device, count, true)
    })
}

#[test]
fn an_honest_stranger_costs_nothing() {
    for language in [Language::Rtu, Language::Stream] {
        let outcome = virtually(language, &[], 0, 2000, 1);
        let s = outcome.statistics;
        assert_eq!((outcome.wrong, s.lost()), (0, 0), "{outcome:?}");
        assert!(s.ok >= 2000);
    }
}

/// The classes that a fault may be counted in: timeout, crc, stale, mismatch, exception; and whether it must cost an
/// exchange at all.
fn classes(language: Language, fault: Fault, s: &LinkStatistics) -> (u64, bool) {
    let damaged = s.crc + s.timeout;
    match fault {
        // Nothing marks the beginning of a stream's frame: what stands before it becomes a part of it.
        Fault::GarbageBetween if language == Language::Stream => (damaged, false),
        Fault::ByteInserted => (damaged, false),
        Fault::ByteLost | Fault::BitsFlipped | Fault::CutOff | Fault::WrongBaud | Fault::Babble => {
            (damaged, true)
        }
        Fault::Doubled | Fault::GarbageBetween | Fault::InChunks | Fault::OwnEcho => (0, false),
        Fault::Late | Fault::LateTwoDeep => (s.timeout + s.stale, true),
        Fault::Silent => (s.timeout, true),
        Fault::OtherUnit => (s.mismatch, true),
        Fault::OtherRequest => (s.mismatch + s.stale, true),
        Fault::Refused | Fault::Busy => (s.exception, true),
    }
}

#[test]
fn every_fault_is_counted_in_its_class_and_costs_its_own_exchange_only() {
    for language in [Language::Rtu, Language::Stream] {
        for (seed, fault) in Fault::ALL.into_iter().enumerate() {
            let outcome = virtually(language, &[fault], PER_MILLE, 3000, seed as u64);
            let s = &outcome.statistics;
            let told = format!("{language:?} {fault:?}: {outcome:?}");
            assert_eq!(outcome.wrong, 0, "{told}");
            assert!(outcome.tampered > 60, "{told}");
            let (counted, costs) = classes(language, fault, s);
            assert_eq!(s.lost(), counted, "{told}");
            if costs {
                assert!(counted * 10 >= outcome.tampered * 9, "{told}");
            }
            // A late reply may meet the next exchange; what babbles may go on into it.
            let spreads = matches!(fault, Fault::Late | Fault::LateTwoDeep | Fault::Babble);
            let allowed = if spreads { outcome.tampered / 4 } else { 0 };
            assert!(outcome.collateral <= allowed, "{told}");
            if fault == Fault::Doubled {
                assert!(outcome.stale_frames * 10 >= outcome.tampered * 9, "{told}");
            }
        }
    }
}

#[test]
fn mixed_faults_never_give_a_wrong_value() {
    let count = if everything() { 10_000_000 } else { 100_000 };
    for language in [Language::Rtu, Language::Stream] {
        let outcome = virtually(language, &Fault::ALL, PER_MILLE, count, 7);
        println!("{language:?}: {outcome:?}");
        assert_eq!(outcome.wrong, 0, "{outcome:?}");
        let share = outcome.tampered as f64 / count as f64;
        assert!((0.03..0.06).contains(&share), "{outcome:?}");
        // What is lost is what was tampered with, and little beside it.
        assert!(outcome.collateral * 100 < outcome.tampered, "{outcome:?}");
        assert!(outcome.statistics.lost() <= outcome.tampered + outcome.collateral);
    }
}

/// Serves the stranger at the far end of a pseudo-terminal until the test is over.
fn serve(port: &mut File, device: &Mutex<Stranger>, over: &AtomicBool) {
    let mut bytes = [0; 512];
    let mut coming: Vec<(std::time::Instant, Vec<u8>)> = Vec::new();
    while !over.load(Ordering::Relaxed) {
        match port.read(&mut bytes) {
            Ok(0) => return,
            Ok(count) => {
                let replies = device.lock().unwrap().hear(&bytes[..count]).into_iter();
                coming.extend(replies.map(|(delay, reply)| (now() + delay, reply)));
                coming.sort_by_key(|(at, _)| *at);
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                std::thread::sleep(Duration::from_micros(50));
            }
            // Nobody has opened the near end yet, or nobody any more.
            Err(_) => std::thread::sleep(Duration::from_millis(1)),
        }
        while coming.first().is_some_and(|(at, _)| *at <= now()) {
            let (_, reply) = coming.remove(0);
            let mut rest = reply.as_slice();
            while !rest.is_empty() && !over.load(Ordering::Relaxed) {
                match port.write(rest) {
                    Ok(count) => rest = &rest[count..],
                    Err(_) => std::thread::sleep(Duration::from_micros(200)),
                }
            }
        }
    }
}

#[test]
fn over_a_real_pseudo_terminal_mixed_faults_never_give_a_wrong_value() {
    let count = if everything() { 100_000 } else { 2000 };
    let mut profile = DriveProfile::named("own").unwrap();
    // Short times, as every fault costs them; a machine that stands still makes more faults of its own.
    profile.link.deadline_ms = Some(12.0);
    profile.link.gap_us = Some(300.0);
    let times = Times {
        turnaround: Duration::ZERO,
        deadline: Duration::from_millis(12),
    };
    for language in [Language::Rtu, Language::Stream] {
        let device = Stranger::new(language, &Fault::ALL, PER_MILLE, times, 11);
        let device = Arc::new(Mutex::new(device));
        let (mut port, target) = raw_pty();
        let served = Fake::serving(target, {
            let device = Arc::clone(&device);
            move |over| serve(&mut port, &device, over)
        });
        let target = &served.target;
        let mut line = match language {
            Language::Rtu => {
                let link = open_modbus(target, &profile, now(), None);
                Line::Modbus(Box::new(link.unwrap()))
            }
            Language::Stream => {
                let link = open_stream(target, &profile, now(), None);
                Line::Stream(Box::new(link.unwrap()))
            }
        };
        let outcome = exchanges(&mut line, &device, count, false);
        println!("{language:?}: {outcome:?}");
        assert_eq!(outcome.wrong, 0, "{outcome:?}");
        assert!(
            outcome.tampered > 0 && outcome.statistics.ok > count / 2,
            "{outcome:?}"
        );
    }
}
