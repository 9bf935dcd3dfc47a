//! A line in memory on a clock that stands still while anything works and jumps when all wait.

use std::collections::BTreeMap;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::runtime::{Builder, Handle, Runtime};
use tokio::time::Sleep;

use super::guard::now;
use super::port::TimedPort;

std::thread_local! {
    static PAUSED: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// A runtime whose clock is paused, for the thread that has entered it.
pub(super) fn paused_runtime() -> Runtime {
    PAUSED.set(true);
    Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .unwrap()
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
