//! The drive on the network: several hosts, each a port of its own.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::Duration;

use super::session::{Gone, Port};

pub(super) struct TcpPorts {
    listener: TcpListener,
}

impl TcpPorts {
    pub(super) fn bind(address: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener })
    }

    /// The address in use; with port 0 the one that the system chose.
    pub(super) fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    pub(super) fn accept(&self) -> Option<TcpPort> {
        let (stream, _) = self.listener.accept().ok()?;
        // A host that is gone again shows with the first read.
        stream.set_nonblocking(false).ok()?;
        stream.set_nodelay(true).ok()?;
        // A host that takes nothing for so long loses the answer.
        stream.set_write_timeout(Some(Duration::from_millis(100))).ok()?;
        Some(TcpPort { stream })
    }
}

pub(super) struct TcpPort {
    stream: TcpStream,
}

impl TcpPort {
    /// What has come by now, without a wait.
    fn read_now(&mut self, buffer: &mut [u8]) -> Result<usize, Gone> {
        self.stream.set_nonblocking(true).map_err(|_| Gone)?;
        let read = taken(self.stream.read(buffer));
        // Answers wait for room.
        self.stream.set_nonblocking(false).map_err(|_| Gone)?;
        read
    }
}

/// Bytes that were read; none before a timeout.
fn taken(read: io::Result<usize>) -> Result<usize, Gone> {
    match read {
        Ok(0) => Err(Gone),
        Ok(count) => Ok(count),
        Err(error) => match error.kind() {
            ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted => Ok(0),
            _ => Err(Gone),
        },
    }
}

impl Port for TcpPort {
    fn read_within(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize, Gone> {
        // Shorter waits are slept: the kernel rounds a socket's timeout up to its own tick.
        if timeout < Duration::from_millis(5) {
            std::thread::sleep(timeout);
            return self.read_now(buffer);
        }
        self.stream.set_read_timeout(Some(timeout)).map_err(|_| Gone)?;
        taken(self.stream.read(buffer))
    }

    fn write(&mut self, bytes: &[u8]) -> usize {
        self.stream.write_all(bytes).map_or(0, |()| bytes.len())
    }
}
