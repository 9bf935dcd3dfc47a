//! Tests of time-outs: time stamps, silences and bounded exchanges on a line with one late reply, or without replies.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::DriveProfile;
use super::cell_bus::{CellBus, Put, ReadRequest};
use super::framing::FrameKind;
use super::open::modbus_link;
use super::scripted::{Delayed, Scripted, frame};
use super::transaction::StopRequest;
use super::virtual_line::{exchange, paused};
use super::waiting::{alarm, now};

const LATE: Duration = Duration::from_millis(70);

fn answer(request: &[u8]) -> Vec<u8> {
    let pdu = match request[1] {
        3 => {
            let count = request[5];
            let mut pdu = vec![3, 2 * count];
            pdu.extend((0..count).flat_map(|k| [request[3], k]));
            pdu
        }
        _ => request[1..6].to_vec(),
    };
    frame(1, &pdu)
}

type Script = Box<dyn FnMut(usize, &[u8]) -> Vec<Delayed> + Send>;

struct Line {
    bus: Box<dyn CellBus>,
    device: Arc<Mutex<Scripted<Script>>>,
    /// Number of the first request without a reply.
    dead_from: Arc<AtomicUsize>,
    epoch: Instant,
}

/// Runs on a line in virtual time that answers every request in order, one of them late, and none from a given number on.
fn on_a_line(late: usize, dead_from: usize, work: impl FnOnce(Line)) {
    paused(|| {
        let mut profile = DriveProfile::named("epulse50-dc").unwrap();
        profile.link.deadline_ms = Some(50.0);
        let dead_from = Arc::new(AtomicUsize::new(dead_from));
        let end = Arc::clone(&dead_from);
        let script = move |number: usize, request: &[u8]| {
            let delay = if number == late { LATE } else { Duration::from_micros(700) };
            let is_answered = number < end.load(Ordering::Relaxed);
            is_answered.then(|| (delay, answer(request))).into_iter().collect()
        };
        let device = Scripted::new(Box::new(script) as Script);
        let epoch = now();
        let line = exchange("virtual", FrameKind::Rtu, &profile.link, &device);
        let link = modbus_link(line, profile.link.unit);
        work(Line {
            bus: Box::new(link.into_bus(&profile.registers.unwrap(), false)),
            device,
            dead_from,
            epoch,
        });
    });
}

impl Line {
    fn requests(&self) -> usize {
        self.device.lock().unwrap().requests.len()
    }

    /// Two reads with equal replies; their duration, and whether their values have the right time stamps.
    fn cycle(&mut self) -> (Duration, bool) {
        let began = now();
        let mut all = true;
        for address in [100, 200] {
            let Ok(read) = self.bus.read(ReadRequest::holding(address, 3)) else {
                all = false;
                continue;
            };
            assert_eq!(read.cells[0] >> 8, address & 0xFF);
            let served = self.device.lock().unwrap().requests.last().unwrap().0;
            let served_s = served.duration_since(self.epoch).as_secs_f64();
            let middle_s = read.span.middle_s();
            let half_s = read.span.half_width_s();
            assert!((middle_s - served_s).abs() <= half_s + 1e-9);
            assert!(half_s < 0.0006, "{half_s}");
        }
        (now().duration_since(began), all)
    }
}

/// Before, the silence behind one late reply was kept for the rest of the connection.
#[test]
fn one_late_reply_moves_no_later_stamp_and_its_silence_ends() {
    on_a_line(400, usize::MAX, |mut line| {
        let clean = Duration::from_millis(8);
        let mut slow = Vec::new();
        for k in 0..1000_u32 {
            line.bus.pause_until_s(0.1 + f64::from(k) * 0.02);
            let (took, _) = line.cycle();
            if k > 20 && took > clean {
                slow.push(line.bus.now_s());
            }
        }
        let first_s = slow[0];
        let last_s = slow.last().unwrap();
        assert!((3.0..5.0).contains(&first_s), "{slow:?}");
        let stretch_s = 100.0 * LATE.as_secs_f64();
        assert!((0.5 * stretch_s..1.5 * stretch_s).contains(&(last_s - first_s)), "{slow:?}");
        let counts = line.bus.line().unwrap();
        assert_eq!(counts.stale_frames, 1);
        assert!(counts.resync_ms > 100, "{counts:?}");
    });
}

#[test]
fn an_exchange_on_a_dead_line_keeps_its_bound() {
    on_a_line(usize::MAX, 10, |mut line| {
        for _ in 0..3 {
            line.cycle();
        }
        let mut requests = line.requests();
        line.dead_from.store(0, Ordering::Relaxed);
        for _ in 0..10 {
            let began = now();
            line.bus.bound(0.08);
            let error = line.bus.read(ReadRequest::holding(100, 3)).unwrap_err();
            assert!(error.is_transient(), "{error}");
            let took = now().duration_since(began);
            assert!(took <= Duration::from_millis(81), "{took:?}");
            let requests_now = line.requests();
            assert!(requests_now - requests <= 5, "a few probes an exchange");
            requests = requests_now;
        }
        // It answers again, and the line is in step soon.
        line.dead_from.store(usize::MAX, Ordering::Relaxed);
        let read = (0..6).find_map(|_| {
            line.bus.bound(0.08);
            line.bus.read(ReadRequest::holding(100, 3)).ok()
        });
        assert!(read.is_some());
    });
}

#[test]
fn whoever_wants_a_stop_ends_a_resynchronisation_at_once() {
    on_a_line(usize::MAX, 0, |mut line| {
        // Interrupted in the silence before the first probe, and in the probes.
        for after_ms in [5, 15, 40, 60] {
            let flag = Arc::new(AtomicBool::new(false));
            *line.bus.stop_request().unwrap() = StopRequest::watching([Arc::clone(&flag)]);
            let raised = now() + Duration::from_millis(after_ms);
            line.bus.bound(10.0);
            alarm::set(raised, Arc::clone(&flag));
            assert!(line.bus.read(ReadRequest::holding(100, 3)).is_err());
            let after = now().saturating_duration_since(raised);
            assert!(flag.load(Ordering::Acquire), "{after_ms}: it ended by itself");
            assert!(after <= Duration::from_millis(5), "{after_ms}: {after:?}");
            // The stop follows, with a short deadline for its own reply, and the next request does not wait for it.
            let (began, before) = (now(), line.requests());
            assert!(
                line.bus.write_at_once(Put { function: 6, address: 0x1026, cells: &[0] }).is_err()
            );
            assert!(
                line.bus.write_at_once(Put { function: 6, address: 0x1000, cells: &[0] }).is_err()
            );
            assert_eq!(line.requests(), before + 2);
            let last = line.device.lock().unwrap().requests[before + 1].0;
            let last = last.duration_since(began);
            assert!(last < Duration::from_millis(60), "{last:?}");
        }
    });
}
