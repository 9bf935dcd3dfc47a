//! From `PATH` or `tcp:HOST:PORT` and a profile to a link.

use std::str::FromStr;
use std::sync::Arc;
use std::time::Instant;
use std::{fmt, io};

use thiserror::Error;
use tokio::runtime::Builder;

use super::cell_bus::CellBus;
use super::exchange::Exchange;
use super::framing::FrameKind;
use super::line_bus::{Framed, LineBus};
use super::link::{DriveLink, LinkError, Result};
use super::link_error::OVER_TCP;
use super::modbus::Client;
use super::own::OwnLink;
use super::port::{connect, serial, serial_error};
use super::profile::DriveProfile;
use super::profiled::ProfiledLink;
use super::register_map::RegisterMap;
use super::reply_filter::Port;
use super::settings::{LinkSettings, Protocol};
use super::tap::{TapFile, TappedPort};
use super::timing::LineTiming;
use super::waiting::Waiting;

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// A serial port; what is `None` comes from the profile.
    Serial {
        path: String,
        baud: Option<u32>,
        unit: Option<u8>,
    },
    Tcp {
        host: String,
        port: u16,
        unit: Option<u8>,
    },
}

/// Why a text is no target.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("link {text:?}: {reason} (expected a serial port's path or tcp:HOST:PORT)")]
pub struct TargetError {
    pub text: String,
    pub reason: &'static str,
}

impl TargetError {
    pub const fn help(&self) -> &'static str {
        "examples: /dev/ttyUSB0, /dev/serial/by-id/usb-FTDI_..., tcp:192.168.1.7:502, tcp:[::1]:15020"
    }
}

impl FromStr for Target {
    type Err = TargetError;

    fn from_str(text: &str) -> Result<Self, TargetError> {
        let wrong = |reason| TargetError { text: text.to_owned(), reason };
        let Some(address) = text.strip_prefix("tcp:") else {
            // On this floor there are only wires; `sim:` is resolved above.
            return match text.split_once(':') {
                Some((scheme, _)) if !scheme.contains('/') && scheme.len() > 1 => {
                    Err(wrong("this kind of link is not known"))
                }
                _ if text.is_empty() => Err(wrong("it is empty")),
                _ => Ok(Self::Serial { path: text.to_owned(), baud: None, unit: None }),
            };
        };
        let (host, port) = address.rsplit_once(':').ok_or_else(|| wrong("the port is missing"))?;
        let host = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
        if host.is_empty() {
            return Err(wrong("the host is missing"));
        }
        Ok(Self::Tcp {
            host: host.to_owned(),
            port: port
                .parse()
                .ok()
                .filter(|port| *port > 0)
                .ok_or_else(|| wrong("the port is not a number from 1 to 65535"))?,
            unit: None,
        })
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial { path, .. } => f.write_str(path),
            Self::Tcp { host, port, .. } if host.contains(':') => write!(f, "tcp:[{host}]:{port}"),
            Self::Tcp { host, port, .. } => write!(f, "tcp:{host}:{port}"),
        }
    }
}

/// Opens the link of the profile's protocol. Host times of its samples are seconds since `epoch`.
///
/// # Errors
/// The port or peer cannot be opened. Nothing is sent yet.
pub fn open(target: &Target, profile: &DriveProfile, epoch: Instant) -> Result<Box<dyn DriveLink>> {
    open_tapped(target, profile, epoch, None)
}

/// Opens the link with a tap: everything that it carries goes into the capture file as well.
pub fn open_tapped(
    target: &Target,
    profile: &DriveProfile,
    epoch: Instant,
    tap: Option<&TapFile>,
) -> Result<Box<dyn DriveLink>> {
    let (exchange, unit) = open_exchange(target, &profile.link, epoch, tap)?;
    Ok(dressed(exchange, unit, profile))
}

/// Opens the bus of a drive whose language is not Modbus.
///
/// # Errors
/// As [`open`].
pub fn open_cells(
    target: &Target,
    profile: &DriveProfile,
    map: &RegisterMap,
    epoch: Instant,
    tap: Option<&TapFile>,
) -> Result<impl CellBus + use<>> {
    let (exchange, unit) = open_exchange(target, &profile.link, epoch, tap)?;
    Ok(LineBus::new(Framed::new(unit, map.lines.clone()), exchange, map))
}

/// The link of the profile over a line: our own drive, or a map with the bus that its language needs.
pub(super) fn dressed(exchange: Exchange, unit: u8, profile: &DriveProfile) -> Box<dyn DriveLink> {
    let is_emulated = profile.link.emulated;
    let is_modbus = matches!(exchange.kind, FrameKind::Rtu | FrameKind::Tcp);
    match &profile.registers {
        None if is_modbus => Box::new(modbus_link(exchange, unit)),
        None => Box::new(OwnLink::new(Framed::new(unit, None), exchange)),
        Some(map) if is_modbus => {
            let bus = modbus_link(exchange, unit).into_bus(map, is_emulated);
            Box::new(ProfiledLink::new(Arc::clone(map), bus))
        }
        Some(map) => {
            let framed = Framed::new(unit, map.lines.clone());
            let bus = LineBus::new(framed, exchange, map).emulated(is_emulated);
            Box::new(ProfiledLink::new(Arc::clone(map), bus))
        }
    }
}

pub(super) fn modbus_link(exchange: Exchange, unit: u8) -> OwnLink<Client> {
    OwnLink::new(Client::new(&exchange.filter, exchange.kind, unit), exchange)
}

/// The stream of our own drive, to be probed.
pub struct OwnStream(pub(super) OwnLink<Framed>);

/// Opens the stream of our own drive.
pub fn open_stream(
    target: &Target,
    profile: &DriveProfile,
    epoch: Instant,
    tap: Option<&TapFile>,
) -> Result<OwnStream> {
    let (exchange, unit) = open_exchange(target, &profile.link, epoch, tap)?;
    Ok(OwnStream(OwnLink::new(Framed::new(unit, None), exchange)))
}

/// Opens a Modbus line by its settings alone: RTU over a serial port, TCP over the network; but RTU over TCP where they have that.
pub(super) fn open_line(
    target: &Target,
    settings: &LinkSettings,
    epoch: Instant,
    tap: Option<&TapFile>,
) -> Result<OwnLink<Client>> {
    let (exchange, unit) = open_exchange(target, settings, epoch, tap)?;
    Ok(modbus_link(exchange, unit))
}

/// Opens the line of a protocol; and the unit on it.
fn open_exchange(
    target: &Target,
    settings: &LinkSettings,
    epoch: Instant,
    tap: Option<&TapFile>,
) -> Result<(Exchange, u8)> {
    let mut name = target.to_string();
    let cannot = |error: io::Error| LinkError::Open(target.to_string(), error.to_string());
    let runtime = Builder::new_current_thread().enable_all().build().map_err(cannot)?;
    let (port, kind, unit, timing, tap): (Box<dyn Port>, _, _, _, _) = {
        let _within = runtime.enter();
        match target {
            Target::Serial { path, baud, unit } => {
                let baud = baud.unwrap_or(settings.baud);
                let builder = serial(path, baud, settings.framing);
                let port = tokio_serial::SerialStream::open(&builder)
                    .map_err(|error| serial_error(path, &error))?;
                let kind = FrameKind::serial(settings.protocol);
                let timing = LineTiming::serial(settings, baud, kind.needs_gaps());
                (Box::new(port), kind, unit, timing, tap.map(|tap| tap.of(kind)))
            }
            Target::Tcp { host, port, unit } => {
                let stream = connect(&name, host, *port)?;
                let is_rtu = settings.protocol == Protocol::ModbusRtuOverTcp;
                let serial = FrameKind::serial(settings.protocol);
                let ends = stream.local_addr().and_then(|ours| Ok((ours, stream.peer_addr()?)));
                let tap = match tap {
                    Some(tap) if is_rtu || serial != FrameKind::Rtu => Some(tap.of(serial)),
                    Some(tap) => {
                        let (ours, peer) = ends.map_err(cannot)?;
                        Some(tap.tcp(ours, peer))
                    }
                    None => None,
                };
                let stream = stream
                    .set_nonblocking(true)
                    .and_then(|()| tokio::net::TcpStream::from_std(stream))
                    .map_err(cannot)?;
                let (kind, timing) = if is_rtu {
                    name += OVER_TCP;
                    (FrameKind::Rtu, LineTiming::converter(settings, settings.baud))
                } else if serial == FrameKind::Rtu {
                    (FrameKind::Tcp, LineTiming::network(settings))
                } else {
                    (serial, LineTiming::network(settings))
                };
                (Box::new(stream), kind, unit, timing, tap)
            }
        }
    };
    let port = match tap {
        Some(tap) => Box::new(TappedPort::new(port, tap)),
        None => port,
    };
    let exchange = Exchange::new(name, Waiting::Real(runtime), port, kind, timing, epoch);
    Ok((exchange, unit.unwrap_or(settings.unit)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_are_read_and_printed() {
        for text in ["/dev/ttyUSB0", "tcp:localhost:502", "tcp:[::1]:15020"] {
            assert_eq!(text.parse::<Target>().unwrap().to_string(), text);
        }
        let by_path = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0";
        assert!(matches!(
            by_path.parse(),
            Ok(Target::Serial { path, .. }) if path == by_path
        ));
        for wrong in ["", "tcp:", "tcp:host", "tcp::502", "tcp:host:0", "tcp:host:x", "udp:a:1"] {
            assert!(wrong.parse::<Target>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn nobody_listening_is_an_open_error_with_the_address() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        drop(listener);
        let target = format!("tcp:127.0.0.1:{port}").parse().unwrap();
        let profile = DriveProfile::named("own").unwrap();
        let error = open(&target, &profile, super::super::waiting::now()).map(drop).unwrap_err();
        assert!(matches!(error, LinkError::Open { .. }));
        assert!(error.to_string().contains(&port.to_string()), "{error}");
    }
}
