//! The software drive in real time. This file owns the clock: drive time is the monotonic time since the start.
//!
//! When a host goes, the drive runs on: its own watchdog stops the motor.

use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};
use thiserror::Error;

use super::codec::{Codec, Responder, UNIT};
use super::config::LineConfig;
use super::journal::{Journal, Journaled};
use super::line_faults::LineFaults;
use super::pace::Pace;
#[cfg(target_os = "linux")]
use super::pty::{Claim, PtyPort};
use super::session::{Commander, Counters, FarEnd, Port, Session, Turn};
use super::tcp::{TcpPort, TcpPorts};
use super::{EmulatorConfig, EmulatorConfigError, ForeignDrive, Guise, SoftDrive};
use drivebench_link::Protocol;

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Endpoint {
    /// A pseudo-terminal behind this path, a symlink that stays the same over sessions.
    Pty(PathBuf),
    /// A TCP port; 0: any free one.
    Tcp(SocketAddr),
}

impl Endpoint {
    /// A pseudo-terminal behind a path in the temporary folder that no other drive uses.
    pub fn temporary_pty() -> Self {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("drivebench-{}-{count}.pty", std::process::id());
        Self::Pty(std::env::temp_dir().join(name))
    }
}

#[derive(Debug, Error)]
pub enum ServerError {
    #[error("pseudo-terminal {}: {source}", .path.display())]
    Pty { path: PathBuf, source: io::Error },
    #[error("tcp {address}: {source}")]
    Tcp { address: SocketAddr, source: io::Error },
    #[error("link {link} does not run over {over} (expected {allowed})")]
    Transport { link: Protocol, over: &'static str, allowed: &'static str },
    #[error(transparent)]
    Fault(#[from] EmulatorConfigError),
    #[error("the emulator's thread ended before it was ready")]
    Thread,
}

impl ServerError {
    /// Whether the command was wrong: nothing could be served so, whatever the machine does.
    pub fn is_usage(&self) -> bool {
        match self {
            Self::Transport { .. } | Self::Fault(_) => true,
            Self::Pty { source, .. } => matches!(
                source.kind(),
                io::ErrorKind::AlreadyExists
                    | io::ErrorKind::AddrInUse
                    | io::ErrorKind::NotFound
                    | io::ErrorKind::NotADirectory
            ),
            Self::Tcp { .. } | Self::Thread => false,
        }
    }

    pub const fn help(&self) -> &'static str {
        match self {
            Self::Pty { .. } => {
                "give another --pty path, in a folder that you may write; a drive that is served ends with Ctrl-C"
            }
            Self::Tcp { .. } => "give another --listen address; port 0 takes any free port",
            Self::Transport { .. } => {
                "modbus-rtu and stream run over --pty, modbus-tcp and stream over --listen"
            }
            Self::Fault(_) => "bench-configs/emulators/example.toml says where each kind happens",
            Self::Thread => "start it again with RUST_BACKTRACE=1 and report what it prints",
        }
    }
}

/// The line that `emulate` prints when the drive can be opened.
pub fn ready_line(
    link: Protocol,
    address: &str,
    config: &EmulatorConfig,
    guise: Option<&Guise>,
) -> String {
    let (unit, baud, profile) = guise.map_or((UNIT, config.line.baud, "own"), |guise| {
        (guise.unit, guise.line.baud, guise.map.device.id.as_str())
    });
    format!("ready {link} {address} unit={unit} baud={baud} profile={profile}")
}

/// A served drive; dropping it stops it.
pub struct ServerHandle {
    address: String,
    ready_line: String,
    stop: Arc<AtomicBool>,
    counters: Arc<Counters>,
    thread: Option<JoinHandle<Result<(), ServerError>>>,
}

impl ServerHandle {
    /// The path to open, or `HOST:PORT`.
    pub fn address(&self) -> &str {
        &self.address
    }

    pub fn ready_line(&self) -> &str {
        &self.ready_line
    }

    pub fn sessions(&self) -> u64 {
        self.counters.sessions.load(Ordering::Relaxed)
    }

    pub fn answers(&self) -> u64 {
        self.counters.answers.load(Ordering::Relaxed)
    }

    /// Ends the service; for a host the drive has then lost its power.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    pub fn join(mut self) -> Result<(), ServerError> {
        self.stop();
        self.thread
            .take()
            .map_or(Ok(()), |thread| thread.join().unwrap_or(Err(ServerError::Thread)))
    }
}

impl Drop for ServerHandle {
    fn drop(&mut self) {
        self.stop();
        if let Some(thread) = self.thread.take() {
            // The result is for `join`; a dropped handle discards it.
            let _ = thread.join();
        }
    }
}

/// Serves the drive on a thread of its own; returns once it can be opened.
pub fn spawn(
    config: EmulatorConfig,
    seed: u64,
    link: Protocol,
    endpoint: Endpoint,
) -> Result<ServerHandle, ServerError> {
    spawn_as(None, config, seed, link, endpoint)
}

/// The same under the profile of another drive.
pub fn spawn_as(
    guise: Option<Guise>,
    config: EmulatorConfig,
    seed: u64,
    link: Protocol,
    endpoint: Endpoint,
) -> Result<ServerHandle, ServerError> {
    let (stop, counters) = (Arc::new(AtomicBool::new(false)), Arc::new(Counters::default()));
    let (ready, readiness) = mpsc::channel();
    let thread = {
        let (stop, counters) = (Arc::clone(&stop), Arc::clone(&counters));
        thread::spawn(move || {
            let guise = guise.as_ref();
            config.suits(guise.is_some(), link)?;
            let server = Server::new(guise, &config, seed, link, &stop, &counters);
            server.serve(&endpoint, |address| {
                let line = ready_line(link, address, &config, guise);
                // Whoever does not wait for it does not need it.
                let _ = ready.send((address.to_owned(), line));
            })
        })
    };
    let Ok((address, ready_line)) = readiness.recv() else {
        let ended = thread.join().unwrap_or(Err(ServerError::Thread));
        return Err(ended.err().unwrap_or(ServerError::Thread));
    };
    Ok(ServerHandle { address, ready_line, stop, counters, thread: Some(thread) })
}

pub struct Served<'a> {
    pub guise: Option<&'a Guise>,
    pub config: &'a EmulatorConfig,
    pub seed: u64,
    pub link: Protocol,
    /// What its motor does is noted there.
    pub journal: Option<Journal>,
}

/// Serves the drive on this thread until `stop` is set; calls `ready` with the address once it can be opened.
pub fn serve(
    served: Served<'_>,
    endpoint: &Endpoint,
    stop: &AtomicBool,
    ready: impl FnOnce(&str),
) -> Result<(), ServerError> {
    let Served { guise, config, seed, link, journal } = served;
    config.suits(guise.is_some(), link)?;
    let counters = Counters::default();
    let mut server = Server::new(guise, config, seed, link, stop, &counters);
    if let Some(journal) = journal {
        let start = server.start;
        let monotonic = clock_gettime(ClockId::Monotonic);
        let now_s = monotonic.tv_sec as f64 + 1e-9 * monotonic.tv_nsec as f64;
        let clock = move || start.elapsed().as_secs_f64();
        let drive = Journaled::new(server.drive, journal, now_s - clock(), Box::new(clock));
        server.drive = Box::new(drive);
    }
    server.serve(endpoint, ready)
}

struct Server<'a> {
    line: &'a LineConfig,
    unit: u8,
    link: Protocol,
    drive: Box<dyn Responder>,
    line_faults: LineFaults,
    start: Instant,
    stop: &'a AtomicBool,
    counters: &'a Counters,
}

impl<'a> Server<'a> {
    fn new(
        guise: Option<&'a Guise>,
        config: &'a EmulatorConfig,
        seed: u64,
        link: Protocol,
        stop: &'a AtomicBool,
        counters: &'a Counters,
    ) -> Self {
        let drive: Box<dyn Responder> = match guise {
            Some(guise) => Box::new(ForeignDrive::new(guise, config, seed)),
            None => Box::new(SoftDrive::new(config, seed)),
        };
        let unit = guise.map_or(UNIT, |guise| guise.unit);
        Self {
            line: guise.map_or(&config.line, |guise| &guise.line),
            unit,
            line_faults: LineFaults::new(&config.faulty, link, unit, seed),
            link,
            drive,
            start: now(),
            stop,
            counters,
        }
    }

    fn serve(mut self, endpoint: &Endpoint, ready: impl FnOnce(&str)) -> Result<(), ServerError> {
        // A line keeps its times; the kernel may put off the end of a sleep by 50 us to save wake-ups.
        #[cfg(target_os = "linux")]
        let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
        match (endpoint, self.link) {
            (Endpoint::Pty(_), Protocol::ModbusTcp | Protocol::ModbusRtuOverTcp) => {
                Err(ServerError::Transport {
                    link: self.link,
                    over: "a pseudo-terminal",
                    allowed: "modbus-rtu or stream",
                })
            }
            (Endpoint::Tcp(_), Protocol::ModbusRtu) => Err(ServerError::Transport {
                link: self.link,
                over: "TCP",
                allowed: "modbus-tcp, modbus-rtu-over-tcp or stream",
            }),
            (Endpoint::Pty(path), _) => self
                .serve_pty(path, ready)
                .map_err(|source| ServerError::Pty { path: path.clone(), source }),
            (Endpoint::Tcp(address), _) => self
                .serve_tcp(*address, ready)
                .map_err(|source| ServerError::Tcp { address: *address, source }),
        }
    }

    #[cfg(target_os = "linux")]
    fn serve_pty(&mut self, stable: &Path, ready: impl FnOnce(&str)) -> io::Result<()> {
        let _claim = Claim::of(stable)?;
        let mut port = PtyPort::open()?;
        port.publish(stable)?;
        ready(&stable.to_string_lossy());
        let with_gaps = self.link == Protocol::ModbusRtu;
        let pace = Pace::serial(self.line, with_gaps);
        while !self.stopped() {
            let last_answer_s = self.session(&mut port, pace.clone());
            if self.stopped() {
                let passed_s = last_answer_s.map(|at| self.start.elapsed().as_secs_f64() - at);
                // How long a host gets to read the last answer before its pseudo-terminal goes: what is unread then is lost.
                let left_s = passed_s.map_or(0.0, |passed| (0.05 - passed).max(0.0));
                thread::sleep(Duration::from_secs_f64(left_s));
                break;
            }
            // The path leads to the next pair before this one goes; who took this one meanwhile is served here.
            let next = PtyPort::open()?;
            next.publish(stable)?;
            if port.taken_again() {
                port.publish(stable)?;
            } else {
                port = next;
            }
        }
        port.unpublish(stable);
        Ok(())
    }

    #[cfg(not(target_os = "linux"))]
    fn serve_pty(&mut self, _stable: &Path, _ready: impl FnOnce(&str)) -> io::Result<()> {
        let message = "pseudo-terminals are served on Linux only; use TCP";
        Err(io::Error::new(io::ErrorKind::Unsupported, message))
    }

    fn serve_tcp(&mut self, address: SocketAddr, ready: impl FnOnce(&str)) -> io::Result<()> {
        let ports = TcpPorts::bind(address)?;
        ready(&ports.address()?.to_string());
        let pace = Pace::network(self.line);
        let (start, link, unit) = (self.start, self.link, self.unit);
        let clock = || start.elapsed().as_secs_f64();
        let mut commander = Commander::default();
        let mut far = FarEnd {
            drive: self.drive.as_mut(),
            clock: &clock,
            stop: self.stop,
            counters: self.counters,
            commander: &mut commander,
            line_faults: &mut self.line_faults,
        };
        let mut hosts: Vec<(TcpPort, Session)> = Vec::new();
        while !far.stop.load(Ordering::Relaxed) {
            // Hosts on the network at once; one more waits until one goes.
            if hosts.len() < 8
                && let Some(port) = ports.accept()
            {
                hosts.push((port, Session::new(Codec::new(link, unit), pace.clone(), &far)));
            }
            if hosts.is_empty() {
                // Between two looks for a host on the network.
                thread::sleep(Duration::from_millis(5));
                far.drive.advance_to(clock());
            }
            let is_alone = hosts.len() == 1;
            hosts.retain_mut(|(port, session)| {
                // Idle time after which a network connection is closed, s.
                if clock() - session.received_s > 60.0 {
                    session.let_go();
                }
                match session.turn(port, &mut far) {
                    Turn::Over(_) => false,
                    Turn::Until(next_s) => {
                        // Several connections are polled in turn without waiting.
                        let now_s = clock();
                        session.listen(port, &far, if is_alone { next_s } else { now_s });
                        true
                    }
                }
            });
            if hosts.len() > 1 {
                // Between two rounds through several hosts, s.
                thread::sleep(Duration::from_secs_f64(0.001));
            }
        }
        Ok(())
    }

    fn session(&mut self, port: &mut dyn Port, pace: Pace) -> Option<f64> {
        let start = self.start;
        let mut far = FarEnd {
            drive: self.drive.as_mut(),
            clock: &|| start.elapsed().as_secs_f64(),
            stop: self.stop,
            counters: self.counters,
            commander: &mut Commander::default(),
            line_faults: &mut self.line_faults,
        };
        Session::new(Codec::new(self.link, self.unit), pace, &far).serve(port, &mut far)
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

#[expect(clippy::disallowed_methods, reason = "this file owns the emulator's clock")]
fn now() -> Instant {
    Instant::now()
}

#[cfg(test)]
#[cfg(target_os = "linux")]
#[path = "server_tests.rs"]
mod tests;
