//! Between the Modbus client and the port: hands on the reply to the one outstanding request and nothing else.
//!
//! ```text
//! tokio-modbus <--only the reply-- [ ReplyFilter ] <--everything-- port
//!                                     | strays, foreign frames, echo, silence, hang-up
//! ```

use std::fmt;
use std::future::poll_fn;
use std::io::{self, ErrorKind};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt as _, ReadBuf};

use super::framing::{Awaited, Echo, FrameKind};
use super::transaction::Reception;
use super::waiting::now;

pub(super) trait Port: AsyncRead + AsyncWrite + Unpin + Send {}
impl<T: AsyncRead + AsyncWrite + Unpin + Send> Port for T {}

/// The filter; clones share it.
#[derive(Clone)]
pub(super) struct ReplyFilter(Arc<Mutex<Inner>>);

pub(super) struct Inner {
    port: Box<dyn Port>,
    pub(super) reception: Reception,
    /// How much of the accepted reply the client has taken.
    taken: usize,
}

impl ReplyFilter {
    pub(super) fn new(port: Box<dyn Port>, kind: FrameKind) -> Self {
        Self(Arc::new(Mutex::new(Inner { port, reception: Reception::new(kind, now()), taken: 0 })))
    }

    /// Drops the bytes on the line and ends the last exchange. Returns the number of unrequested bytes.
    pub(super) async fn begin(&self) -> io::Result<usize> {
        // The reactor has to look at the port once, else bytes that came meanwhile do not show.
        tokio::task::yield_now().await;
        poll_fn(|cx| {
            let mut inner = self.inner();
            inner.reception.retire();
            inner.taken = 0;
            Poll::Ready(inner.discard(cx))
        })
        .await
    }

    /// Sets the bytes that the reply to the next request must echo.
    pub(super) fn expect(&self, echo: Echo) {
        self.inner().reception.expected.echo = Some(echo);
    }

    /// Sets the lines of text that the reply to the next request consists of.
    pub(super) fn expect_lines(&self, lines: Awaited) {
        self.inner().reception.expected.lines = lines;
    }

    /// What goes out in front of a request: on the stream the end of a broken frame that the far end may still hold.
    pub(super) fn delimiter(&self) -> &'static [u8] {
        let reception = &self.inner().reception;
        let last = reception.expected.earlier.back();
        let is_clean = last.is_some_and(|(_, is_answered)| *is_answered);
        if reception.kind == FrameKind::Stream && !is_clean { &[0] } else { &[] }
    }

    /// Listens until something comes: how many bytes.
    pub(super) async fn listen(&self) -> io::Result<usize> {
        // Polled once more after the time-out: no new bytes must not count as some.
        poll_fn(|cx| match self.inner().discard(cx) {
            Ok(0) => Poll::Pending,
            result => Poll::Ready(result),
        })
        .await
    }

    /// Sends a request and waits for its reply.
    pub(super) async fn ask(mut self, request: &[u8]) -> io::Result<Vec<u8>> {
        self.write_all(request).await?;
        poll_fn(|cx| {
            let mut inner = self.inner();
            loop {
                ready!(inner.read_port(cx))?;
                if inner.reception.accept()? {
                    return Poll::Ready(Ok(inner.reception.reply.clone()));
                }
            }
        })
        .await
    }

    /// Closes the port: the number of an unplugged device stays in use while it is open.
    pub(super) fn close(&self) {
        self.inner().port = Box::new(tokio::io::empty());
    }

    pub(super) fn inner(&self) -> MutexGuard<'_, Inner> {
        // One thread uses it; a panic of that thread has ended the link.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    /// Reads until nothing is there; drops it.
    fn discard(&mut self, cx: &mut Context<'_>) -> io::Result<usize> {
        let mut dropped = 0;
        // A line that sends faster than it is read must not block.
        while dropped < 1 << 16
            && let Poll::Ready(count) = self.read_port(cx)?
        {
            dropped += count;
        }
        Ok(self.reception.drop_strays())
    }

    /// Reads from the port; an end of file is an error, so that a lost port is not polled for ever.
    fn read_port(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<usize>> {
        let mut bytes = [0; 512];
        let mut buffer = ReadBuf::new(&mut bytes);
        ready!(Pin::new(&mut self.port).poll_read(cx, &mut buffer))?;
        if buffer.filled().is_empty() {
            return Poll::Ready(Err(io::Error::new(ErrorKind::BrokenPipe, "the other end closed")));
        }
        self.reception.push(buffer.filled(), now());
        Poll::Ready(Ok(buffer.filled().len()))
    }
}

impl AsyncRead for ReplyFilter {
    fn poll_read(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let mut inner = self.inner();
        loop {
            let left = inner.reception.reply.get(inner.taken..).unwrap_or_default();
            let count = buffer.remaining().min(left.len());
            if count > 0 {
                buffer.put_slice(&left[..count]);
                inner.taken += count;
                return Poll::Ready(Ok(()));
            }
            ready!(inner.read_port(cx))?;
            if inner.reception.accept()? {
                inner.taken = 0;
            }
        }
    }
}

impl AsyncWrite for ReplyFilter {
    fn poll_write(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let mut inner = self.inner();
        let at = now();
        let count = ready!(Pin::new(&mut inner.port).poll_write(cx, bytes))?;
        inner.reception.expected.request.extend_from_slice(&bytes[..count]);
        inner.reception.sent(count, at);
        Poll::Ready(Ok(count))
    }

    /// The kernel has the bytes already. Flushing a serial port would block the thread past any deadline.
    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner().port).poll_shutdown(cx)
    }
}

/// The Modbus client wants it for its own messages.
impl fmt::Debug for ReplyFilter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ReplyFilter").finish_non_exhaustive()
    }
}
