//! In-memory line in virtual time: every byte of a link without real waits.
//!
//! ```text
//! VirtualLink [ DriveLink (codec, proof, deadlines) ] --bytes--> VirtualPort --bytes--> FarEnd (drive and wire)
//!      '-- VirtualClock: advanced by the waits of the link               '-- bytes with their times
//! ```

use std::collections::BTreeMap;
use std::io;
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::burst::{Burst, Capture};
use super::cell_bus::CellBus;
use super::exchange::Exchange;
use super::framing::FrameKind;
use super::link::{DriveLink, Identity, LinkError, LinkName, LinkStatistics, Result, RoundTrips};
use super::open::{dressed, modbus_link};
use super::profile::DriveProfile;
use super::register_map::RegisterMap;
use super::settings::Protocol;
use super::timing::LineTiming;
use super::transaction::{LineCounts, StopRequest};
use super::waiting::{InVirtualTime, Waiting, expect_at, now, skip_to};
use super::{CommandTimes, LinkSettings};
use drivebench_model::sample::{Command, Demand, Sample};

/// Virtual time: set by the bench, read by the link. Clones share it.
#[derive(Clone, Debug, Default)]
pub struct VirtualClock {
    time: Arc<AtomicU64>,
    /// Part of it during which the host was suspended and only the drive went on.
    slept: Arc<AtomicU64>,
}

impl VirtualClock {
    pub fn new() -> Self {
        Self::default()
    }

    pub fn set_time_s(&self, time_s: f64) {
        self.time.store(time_s.to_bits(), Ordering::Release);
    }

    pub fn time_s(&self) -> f64 {
        f64::from_bits(self.time.load(Ordering::Acquire))
    }

    /// Suspends the host for so long, as a laptop whose lid is closed: time goes on for the drive, and not for the host.
    pub fn suspend_s(&self, seconds: f64) {
        self.set_time_s(self.time_s() + seconds);
        let slept_s = self.slept_s() + seconds;
        self.slept.store(slept_s.to_bits(), Ordering::Release);
    }

    /// For how long the host was suspended so far, s.
    pub fn slept_s(&self) -> f64 {
        f64::from_bits(self.slept.load(Ordering::Acquire))
    }
}

/// The exchanges over a line in memory; the thread has to be in virtual time.
pub(super) fn exchange<D: Device + 'static>(
    name: &str,
    kind: FrameKind,
    settings: &LinkSettings,
    device: &Arc<Mutex<D>>,
) -> Exchange {
    let timing = match (kind, settings.protocol) {
        (FrameKind::Rtu, Protocol::ModbusRtuOverTcp) => {
            LineTiming::converter(settings, settings.baud)
        }
        (FrameKind::Tcp, _) => LineTiming::network(settings),
        (kind, _) => LineTiming::serial(settings, settings.baud, kind.needs_gaps()),
    };
    let port = Box::new(VirtualPort::new(Arc::clone(device)));
    Exchange::new(name.to_owned(), Waiting::Virtual, port, kind, timing, now())
}

pub(super) trait Device: Send {
    fn receive(&mut self, bytes: &[u8]) -> Vec<(Duration, Vec<u8>)>;
}

pub(super) struct VirtualPort<D> {
    device: Arc<Mutex<D>>,
    /// What is under way, by arrival and order.
    coming: BTreeMap<(Instant, u64), Vec<u8>>,
    count: u64,
}

impl<D: Device> VirtualPort<D> {
    pub(super) fn new(device: Arc<Mutex<D>>) -> Self {
        Self { device, coming: BTreeMap::new(), count: 0 }
    }

    fn send(&mut self, bytes: &[u8]) {
        let mut device = self.device.lock().unwrap_or_else(PoisonError::into_inner);
        for (delay, reply) in device.receive(bytes) {
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
        _: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let bytes = self.arrived(buffer.remaining());
        if bytes.is_empty() {
            expect_at(self.next());
            return Poll::Pending;
        }
        buffer.put_slice(&bytes);
        Poll::Ready(Ok(()))
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

/// What receives bytes at a time, s: which bytes come back at which times.
pub trait FarEnd: Send {
    fn receive(&mut self, now_s: f64, bytes: &[u8]) -> Vec<(f64, Vec<u8>)>;
}

#[derive(Clone, Copy)]
pub struct LineTime(Instant);

impl LineTime {
    pub fn start() -> Self {
        Self(now())
    }

    pub fn now_s(self) -> f64 {
        now().saturating_duration_since(self.0).as_secs_f64()
    }

    pub fn skip_to_s(self, time_s: f64) {
        // A nanosecond more, so that a wait never ends early.
        skip_to(self.0 + Duration::from_secs_f64(time_s) + Duration::from_nanos(1));
    }
}

struct Far<F: ?Sized>(LineTime, Arc<Mutex<F>>);

impl<F: FarEnd + ?Sized> Device for Far<F> {
    fn receive(&mut self, bytes: &[u8]) -> Vec<(Duration, Vec<u8>)> {
        let now_s = self.0.now_s();
        let mut far = self.1.lock().unwrap_or_else(PoisonError::into_inner);
        let sent = far.receive(now_s, bytes).into_iter();
        sent.map(|(at_s, bytes)| (Duration::from_secs_f64((at_s - now_s).max(0.0)), bytes))
            .collect()
    }
}

/// Link over an in-memory line. Its waits advance `clock`, which also sets the start of each call.
pub struct VirtualLink {
    link: Box<dyn DriveLink>,
    clock: VirtualClock,
    origin: Instant,
}

impl VirtualLink {
    /// To the far end as on a serial line, with the settings of the profile.
    pub fn open(
        name: &str,
        profile: &DriveProfile,
        clock: VirtualClock,
        far: impl FarEnd + 'static,
    ) -> Self {
        let origin = now();
        let _virtual = InVirtualTime::at(origin);
        let kind = FrameKind::serial(profile.link.protocol);
        let line = exchange_with(name, kind, &profile.link, Arc::new(Mutex::new(far)));
        Self { link: dressed(line, profile.link.unit, profile), clock, origin }
    }

    fn within<R>(&mut self, work: impl FnOnce(&mut (dyn DriveLink + 'static)) -> R) -> R {
        let begun_s = self.clock.time_s();
        let _virtual = InVirtualTime::at(self.origin + Duration::from_secs_f64(begun_s));
        let result = work(self.link.as_mut());
        self.clock.set_time_s(LineTime(self.origin).now_s().max(begun_s));
        result
    }

    fn with_burst<R>(&mut self, work: impl FnOnce(&mut dyn Burst) -> Result<R>) -> Result<R> {
        let gone = LinkError::Gone(self.name().0, "it records nothing by itself".to_owned());
        self.within(|link| link.burst().map_or(Err(gone), work))
    }
}

/// Methods of the link, those that may take time within virtual time.
macro_rules! passed_on {
    (timed { $($timed:ident($($arg:ident: $type:ty)?) -> $result:ty;)+ }
     untimed { $($name:ident -> $value:ty;)+ }) => {
        $(fn $timed(&mut self $(, $arg: $type)?) -> $result {
            self.within(|link| link.$timed($($arg)?))
        })+

        $(fn $name(&self) -> $value {
            self.link.$name()
        })+
    };
}

impl DriveLink for VirtualLink {
    passed_on! {
        timed {
            identify() -> Result<Identity>;
            exchange(command: Command) -> Result<Sample>;
            bound(left_s: f64) -> ();
            stop() -> Result<()>;
            recognise() -> Result<Identity>;
            compare_set_points() -> Result<Option<Result<String, String>>>;
            bring_to_rest() -> Result<()>;
        }
        untimed {
            name -> LinkName;
            found -> Option<Sample>;
            has_sent_command -> bool;
            confirms_stop -> bool;
            command_times -> CommandTimes;
            statistics -> LinkStatistics;
            shortest_cycle_s -> Option<f64>;
            round_trips -> Option<&RoundTrips>;
            line -> Option<LineCounts>;
            zero -> Demand;
        }
    }

    fn stop_request(&mut self) -> Option<&mut StopRequest> {
        self.link.stop_request()
    }

    fn close(&mut self) {
        self.link.close();
    }

    fn burst(&mut self) -> Option<&mut dyn Burst> {
        self.link.burst().is_some().then_some(self as &mut dyn Burst)
    }
}

impl Burst for VirtualLink {
    fn arm(&mut self) -> Result<()> {
        self.with_burst(|burst| burst.arm())
    }

    fn fetch(&mut self) -> Result<Option<Capture>> {
        self.with_burst(|burst| burst.fetch())
    }
}

pub fn paused<R>(work: impl FnOnce() -> R) -> R {
    let _virtual = InVirtualTime::at(now());
    work()
}

/// Works with the drive of this profile; every wait of the calling thread is virtual meanwhile.
pub fn on_a_line<F: FarEnd + 'static, R>(
    profile: &DriveProfile,
    far: Arc<Mutex<F>>,
    work: impl FnOnce(&mut dyn DriveLink, LineTime) -> R,
) -> R {
    paused(|| {
        let time = LineTime::start();
        let kind = FrameKind::serial(profile.link.protocol);
        let line = exchange_with("virtual", kind, &profile.link, far);
        work(dressed(line, profile.link.unit, profile).as_mut(), time)
    })
}

/// The exchanges with a far end; the thread has to be in virtual time.
fn exchange_with<F: FarEnd + 'static>(
    name: &str,
    kind: FrameKind,
    settings: &LinkSettings,
    far: Arc<Mutex<F>>,
) -> Exchange {
    let far = Arc::new(Mutex::new(Far(LineTime::start(), far)));
    exchange(name, kind, settings, &far)
}

/// A link to our own drive, in this protocol; the thread has to be in virtual time.
pub fn own_to<F: FarEnd + 'static>(
    protocol: Protocol,
    profile: &DriveProfile,
    far: &Arc<Mutex<F>>,
) -> Box<dyn DriveLink> {
    let kind = match protocol {
        Protocol::ModbusTcp => FrameKind::Tcp,
        protocol => FrameKind::serial(protocol),
    };
    dressed(
        exchange_with("virtual", kind, &profile.link, Arc::clone(far)),
        profile.link.unit,
        profile,
    )
}

/// A bus of Modbus RTU to a drive with this map; the thread has to be in virtual time.
pub fn bus_to<F: FarEnd + 'static>(
    map: &RegisterMap,
    settings: &LinkSettings,
    far: &Arc<Mutex<F>>,
) -> impl CellBus + use<F> {
    modbus_link(exchange_with("virtual", FrameKind::Rtu, settings, Arc::clone(far)), settings.unit)
        .into_bus(map, false)
}
