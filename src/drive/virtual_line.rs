//! A line in memory on a clock that stands still while anything works and jumps when all wait; and a drive with a register
//! map of its own at its far end, for the tests of whoever uses drives.

use std::collections::BTreeMap;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::runtime::{Builder, Handle, Runtime};
use tokio::time::Sleep;

use super::link::DriveLink;
use super::modbus::{ModbusBus, ModbusLink};
use super::port::TimedPort;
use super::profile::DriveProfile;
use super::profiled::ProfiledLink;
use super::reply::FrameKind;
use super::reply_filter::now;
use super::settings::LinkSettings;
use super::timing::LineTiming;

std::thread_local! {
    static PAUSED: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// Works on a clock that is paused, within the runtime that it gets.
pub(super) fn paused<R>(work: impl FnOnce(Runtime) -> R) -> R {
    PAUSED.set(true);
    let runtime = Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build();
    let runtime = runtime.unwrap();
    let handle = runtime.handle().clone();
    let _entered = handle.enter();
    work(runtime)
}

/// A Modbus link over a line in memory.
pub(super) fn modbus_link<D: Device + 'static>(
    runtime: Runtime,
    settings: &LinkSettings,
    device: &Arc<Mutex<D>>,
) -> ModbusLink {
    let timing = LineTiming::serial(settings, settings.baud, true);
    let port = Box::new(VirtualPort::new(Arc::clone(device)));
    let (name, kind) = ("virtual".to_owned(), FrameKind::Rtu);
    ModbusLink::new(name, runtime, port, kind, settings.unit, timing, now())
}

/// On a thread with a paused clock: sets it forward.
pub(super) fn skip_to(at: Instant) -> bool {
    let paused = PAUSED.get();
    if paused {
        let left = at.saturating_duration_since(now());
        Handle::current().block_on(tokio::time::advance(left));
    }
    paused
}

/// What hangs at the far end: hears bytes, and says when which bytes come back.
pub(super) trait Device: Send {
    fn hear(&mut self, bytes: &[u8]) -> Vec<(Duration, Vec<u8>)>;
}

/// The near end of the line.
pub(super) struct VirtualPort<D> {
    device: Arc<Mutex<D>>,
    /// What is under way, by arrival and order.
    coming: BTreeMap<(Instant, u64), Vec<u8>>,
    count: u64,
    sleep: Option<Pin<Box<Sleep>>>,
}

impl<D: Device> VirtualPort<D> {
    pub(super) fn new(device: Arc<Mutex<D>>) -> Self {
        Self {
            device,
            coming: BTreeMap::new(),
            count: 0,
            sleep: None,
        }
    }

    fn send(&mut self, bytes: &[u8]) {
        for (delay, reply) in self.device.lock().unwrap().hear(bytes) {
            self.count += 1;
            self.coming.insert((now() + delay, self.count), reply);
        }
    }

    fn next(&self) -> Option<Instant> {
        self.coming.first_key_value().map(|((at, _), _)| *at)
    }

    /// Takes what has arrived, up to `room` bytes.
    fn arrived(&mut self, room: usize) -> Vec<u8> {
        let mut bytes = Vec::new();
        while bytes.len() < room
            && let Some(mut first) = self.coming.first_entry()
            && first.key().0 <= now()
        {
            let left = room - bytes.len();
            if first.get().len() > left {
                bytes.extend(first.get_mut().drain(..left));
            } else {
                bytes.extend(first.remove());
            }
        }
        bytes
    }
}

impl<D: Device> AsyncRead for VirtualPort<D> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        loop {
            let bytes = self.arrived(buffer.remaining());
            if !bytes.is_empty() {
                buffer.put_slice(&bytes);
                return Poll::Ready(Ok(()));
            }
            let Some(at) = self.next() else {
                return Poll::Pending;
            };
            let mut sleep = Box::pin(tokio::time::sleep_until(at.into()));
            let ready = sleep.as_mut().poll(cx);
            self.sleep = Some(sleep);
            if ready.is_pending() {
                return Poll::Pending;
            }
        }
    }
}

impl<D: Device> AsyncWrite for VirtualPort<D> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        self.send(bytes);
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

impl<D: Device> TimedPort for VirtualPort<D> {
    fn read_within(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let mut arrived = self.arrived(bytes.len());
        if arrived.is_empty() && !timeout.is_zero() {
            let limit = now() + timeout;
            skip_to(self.next().map_or(limit, |next| next.min(limit)));
            arrived = self.arrived(bytes.len());
        }
        bytes[..arrived.len()].copy_from_slice(&arrived);
        Ok(arrived.len())
    }

    fn write_within(&mut self, bytes: &[u8], _: Duration) -> io::Result<usize> {
        self.send(bytes);
        Ok(bytes.len())
    }
}

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
    paused(|runtime| {
        let time = LineTime(now());
        let far = Arc::new(Mutex::new(Far(time, far)));
        let link = modbus_link(runtime, &profile.link, &far);
        let map = profile.registers.clone().unwrap();
        let mut link = ProfiledLink::new(Arc::clone(&map), ModbusBus::new(link, &map));
        work(&mut link, time)
    })
}
