//! Times on a bus that is late once, or dead: true stamps, silences that end, exchanges that keep their bound.

use super::*;
use crate::drive::fake::rtu_frame;
use crate::drive::modbus::ModbusBus;
use crate::drive::register_bus::RegisterBus;
use crate::drive::transaction::CutIn;
use crate::drive::waiting::alarm;

const TURNAROUND: Duration = Duration::from_micros(700);
const LATE: Duration = Duration::from_millis(70);

/// Answers every read and write in order, one of them late, and none from one on.
struct Punctual {
    heard: u64,
    late: u64,
    dead_from: u64,
    /// When each request came.
    at: Vec<std::time::Instant>,
}

impl Device for Punctual {
    fn hear(&mut self, request: &[u8]) -> Vec<(Duration, Vec<u8>)> {
        self.heard += 1;
        self.at.push(now());
        if self.heard >= self.dead_from {
            return Vec::new();
        }
        let pdu = match request[1] {
            3 => {
                let count = request[5];
                let mut pdu = vec![3, 2 * count];
                pdu.extend((0..count).flat_map(|k| [request[3], k]));
                pdu
            }
            _ => request[1..6].to_vec(),
        };
        let is_late = self.heard == self.late;
        let delay = if is_late { LATE } else { TURNAROUND };
        vec![(delay, rtu_frame(1, &pdu))]
    }
}

struct Line {
    bus: ModbusBus,
    device: Arc<Mutex<Punctual>>,
    epoch: std::time::Instant,
}

/// Works on a line in virtual time.
fn on_a_line(late: u64, dead_from: u64, work: impl FnOnce(Line)) {
    paused(|| {
        let mut profile = DriveProfile::named("epulse50-dc").unwrap();
        profile.link.deadline_ms = Some(50.0);
        let device = Arc::new(Mutex::new(Punctual {
            heard: 0,
            late,
            dead_from,
            at: Vec::new(),
        }));
        let epoch = now();
        let link = modbus_link("virtual", &profile.link, &device);
        work(Line {
            bus: ModbusBus::new(link, &profile.registers.unwrap()),
            device,
            epoch,
        });
    });
}

impl Line {
    /// Two reads that look alike; how long they took, and whether they gave values with true stamps.
    fn cycle(&mut self) -> (Duration, bool) {
        let began = now();
        let mut all = true;
        for address in [100, 200] {
            let Ok(read) = self.bus.read(ReadRequest::holding(address, 3)) else {
                all = false;
                continue;
            };
            assert_eq!(read.words[0] >> 8, address & 0xFF);
            let served = *self.device.lock().unwrap().at.last().unwrap();
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
    on_a_line(401, u64::MAX, |mut line| {
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
        assert!(
            (0.5 * stretch_s..1.5 * stretch_s).contains(&(last_s - first_s)),
            "{slow:?}"
        );
        let counts = RegisterBus::line(&line.bus).unwrap();
        assert_eq!(counts.stale_frames, 1);
        assert!(counts.resync_ms > 100, "{counts:?}");
    });
}

#[test]
fn an_exchange_on_a_dead_line_keeps_its_bound_and_goes_on_in_the_next() {
    on_a_line(0, 11, |mut line| {
        for _ in 0..3 {
            line.cycle();
        }
        let mut heard = line.device.lock().unwrap().heard;
        line.device.lock().unwrap().dead_from = 0;
        for _ in 0..10 {
            let began = now();
            line.bus.bound(0.08);
            let error = line.bus.read(ReadRequest::holding(100, 3)).unwrap_err();
            assert!(error.is_transient(), "{error}");
            let took = now().duration_since(began);
            assert!(took <= Duration::from_millis(81), "{took:?}");
            let now_heard = line.device.lock().unwrap().heard;
            assert!(now_heard - heard <= 5, "a few probes an exchange");
            heard = now_heard;
        }
        // It answers again, and the line is in step soon.
        line.device.lock().unwrap().dead_from = u64::MAX;
        let read = (0..6).find_map(|_| {
            line.bus.bound(0.08);
            line.bus.read(ReadRequest::holding(100, 3)).ok()
        });
        assert!(read.is_some());
    });
}

#[test]
fn whoever_wants_a_stop_ends_a_resynchronisation_at_once() {
    on_a_line(0, 0, |mut line| {
        // Which the cut is to meet: the silence before the first probe, and the probes.
        for after_ms in [5, 15, 40, 60] {
            let flag = Arc::new(AtomicBool::new(false));
            *line.bus.cut_in().unwrap() = CutIn::watching([Arc::clone(&flag)]);
            let raised = now() + Duration::from_millis(after_ms);
            line.bus.bound(10.0);
            alarm::set(raised, Arc::clone(&flag));
            assert!(line.bus.read(ReadRequest::holding(100, 3)).is_err());
            let after = now().saturating_duration_since(raised);
            assert!(
                flag.load(Ordering::Acquire),
                "{after_ms}: it ended by itself"
            );
            assert!(after <= Duration::from_millis(5), "{after_ms}: {after:?}");
            // The stop is next, and it does not wait for its reply for long, nor the one behind it for the first.
            let (began, before) = (now(), line.device.lock().unwrap().heard);
            assert!(line.bus.write_at_once(6, 0x1026, &[0]).is_err());
            assert!(line.bus.write_at_once(6, 0x1000, &[0]).is_err());
            let device = line.device.lock().unwrap();
            assert_eq!(device.heard, before + 2);
            let last = device.at.last().unwrap().duration_since(began);
            assert!(last < Duration::from_millis(60), "{last:?}");
        }
    });
}
