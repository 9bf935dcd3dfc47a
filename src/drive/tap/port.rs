//! A port that tells the tap what it carries.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::super::guard::Port;
use super::super::port::TimedPort;
use super::Tap;

pub(in super::super) struct TappedPort<P> {
    port: P,
    tap: Tap,
}

impl<P> TappedPort<P> {
    pub(in super::super) fn new(port: P, tap: Tap) -> Self {
        Self { port, tap }
    }
}

impl AsyncRead for TappedPort<Box<dyn Port>> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let this = &mut *self;
        let result = Pin::new(&mut this.port).poll_read(cx, buffer);
        let new = &buffer.filled()[before..];
        if !new.is_empty() {
            this.tap.received(new);
        }
        result
    }
}

impl AsyncWrite for TappedPort<Box<dyn Port>> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let this = &mut *self;
        let result = Pin::new(&mut this.port).poll_write(cx, bytes);
        if let Poll::Ready(Ok(count)) = result {
            this.tap.sent(&bytes[..count]);
        }
        result
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.port).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.port).poll_shutdown(cx)
    }
}

impl TimedPort for TappedPort<Box<dyn TimedPort>> {
    fn read_within(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let count = self.port.read_within(bytes, timeout)?;
        self.tap.received(&bytes[..count]);
        Ok(count)
    }

    fn write_within(&mut self, bytes: &[u8], timeout: Duration) -> io::Result<usize> {
        let count = self.port.write_within(bytes, timeout)?;
        self.tap.sent(&bytes[..count]);
        Ok(count)
    }
}
