//! A drive with a register map of its own at the far end of a line in memory, for the tests of whoever uses drives.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::guard::now;
use super::link::DriveLink;
use super::modbus::{ModbusBus, ModbusLink};
use super::profile::DriveProfile;
use super::profiled::ProfiledLink;
use super::reply::FrameKind;
use super::timing::LineTiming;
use super::virtual_line::{Device, VirtualPort, paused_runtime, skip_to};

/// What hears bytes at a time, s, and says which bytes come back at which times.
pub(crate) trait FarEnd: Send {
    fn hear(&mut self, now_s: f64, bytes: &[u8]) -> Vec<(f64, Vec<u8>)>;
}

/// Time of a line in memory.
#[derive(Clone, Copy)]
pub(crate) struct LineTime(Instant);

impl LineTime {
    pub(crate) fn now_s(self) -> f64 {
        now().saturating_duration_since(self.0).as_secs_f64()
    }

    pub(crate) fn skip_to_s(self, time_s: f64) {
        // A nanosecond more, so that a wait never ends early.
        skip_to(self.0 + Duration::from_secs_f64(time_s) + Duration::from_nanos(1));
    }
}

struct Far<F>(LineTime, Arc<Mutex<F>>);

impl<F: FarEnd> Device for Far<F> {
    fn hear(&mut self, bytes: &[u8]) -> Vec<(Duration, Vec<u8>)> {
        let now_s = self.0.now_s();
        let sent = self.1.lock().unwrap().hear(now_s, bytes);
        let sent = sent.into_iter();
        sent.map(|(at_s, bytes)| (Duration::from_secs_f64((at_s - now_s).max(0.0)), bytes))
            .collect()
    }
}

/// Works with the drive of this profile; every wait of the calling thread is virtual meanwhile.
pub(crate) fn on_a_line<F: FarEnd + 'static, R>(
    profile: &DriveProfile,
    far: Arc<Mutex<F>>,
    work: impl FnOnce(&mut dyn DriveLink, LineTime) -> R,
) -> R {
    let runtime = paused_runtime();
    let handle = runtime.handle().clone();
    let _entered = handle.enter();
    let time = LineTime(now());
    let port = Box::new(VirtualPort::new(Arc::new(Mutex::new(Far(time, far)))));
    let timing = LineTiming::serial(&profile.link, profile.link.baud, true);
    let name = "virtual".to_owned();
    let unit = profile.link.unit;
    let link = ModbusLink::new(name, runtime, port, FrameKind::Rtu, unit, timing, time.0);
    let map = profile.registers.clone().unwrap();
    let mut link = ProfiledLink::new(Arc::clone(&map), ModbusBus::new(link, &map));
    work(&mut link, time)
}
