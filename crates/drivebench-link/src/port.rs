//! Opening of serial ports and TCP connections, with errors that name the remedy.

use std::io::{self, ErrorKind};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::Duration;

use serialport::{DataBits, FlowControl, Parity, SerialPortBuilder, StopBits};

use super::link::{LinkError, Result};
use super::serial_ports::holder_names;
use super::settings::Framing;

/// Settings of a serial port. Modem lines are left alone: pseudo-terminals and many adapters have none.
pub(super) fn serial(path: &str, baud: u32, framing: Framing) -> SerialPortBuilder {
    let (parity, stop_bits) = match framing {
        Framing::EightNoneOne => (Parity::None, StopBits::One),
        Framing::EightEvenOne => (Parity::Even, StopBits::One),
        Framing::EightOddOne => (Parity::Odd, StopBits::One),
        Framing::EightNoneTwo => (Parity::None, StopBits::Two),
    };
    serialport::new(path, baud)
        .data_bits(DataBits::Eight)
        .parity(parity)
        .stop_bits(stop_bits)
        .flow_control(FlowControl::None)
}

pub(super) fn connect(name: &str, host: &str, port: u16) -> Result<TcpStream> {
    let open = |error: io::Error| LinkError::Open(name.to_owned(), error.to_string());
    let mut last = io::Error::new(ErrorKind::NotFound, "the host has no address");
    for address in (host, port).to_socket_addrs().map_err(open)? {
        // Time-out of a TCP connection.
        match TcpStream::connect_timeout(&address, Duration::from_secs(3)) {
            Ok(stream) => {
                // A request is one small segment: it must not wait for the next.
                stream.set_nodelay(true).map_err(open)?;
                return Ok(stream);
            }
            Err(error) => last = error,
        }
    }
    Err(open(last))
}

/// The reason why a serial port cannot be opened.
pub(super) fn serial_error(path: &str, error: &serialport::Error) -> LinkError {
    let reason = match error.kind() {
        serialport::ErrorKind::Io(kind) => {
            return open_error(path, &io::Error::new(kind, error.to_string()));
        }
        serialport::ErrorKind::NoDevice => match holder_names(Path::new(path)) {
            None => format!("another program holds it, or it is no port ({error})"),
            Some(names) => format!("{names} holds it ({error})"),
        },
        _ => error.to_string(),
    };
    LinkError::Open(path.to_owned(), reason)
}

/// The reason why a device file cannot be opened: what is there instead, or which group it belongs to.
pub(super) fn open_error(path: &str, error: &io::Error) -> LinkError {
    let reason = match error.kind() {
        ErrorKind::NotFound => {
            let there = serialport::available_ports().unwrap_or_default();
            let there: Vec<_> = there.into_iter().map(|port| port.port_name).collect();
            if there.is_empty() {
                "it does not exist (no serial port is there)".to_owned()
            } else {
                format!("it does not exist (there are: {})", there.join(", "))
            }
        }
        ErrorKind::PermissionDenied => {
            let owner = std::fs::metadata(path).map(|file| (file.mode(), file.gid()));
            let groups = std::fs::read_to_string("/etc/group").unwrap_or_default();
            let why = |(mode, gid)| permission(path, mode, gid, &groups);
            owner.map_or_else(|_| "permission denied".to_owned(), why)
        }
        _ => error.to_string(),
    };
    LinkError::Open(path.to_owned(), reason)
}

/// Why a device file is not for this user, and what mends it: its group, where that may read and write and is not that of the
/// administrator; else a rule for udev.
fn permission(path: &str, mode: u32, gid: u32, groups: &str) -> String {
    let named = |wanted: &dyn Fn(&str, &str) -> bool| {
        groups.lines().find_map(|line| {
            let mut fields = line.split(':');
            let (name, gid) = (fields.next()?, fields.nth(1)?);
            wanted(name, gid).then(|| name.to_owned())
        })
    };
    let owner = named(&|_, number| number == gid.to_string());
    if let (0o060, Some(group)) = (mode & 0o060, owner.as_ref().filter(|_| gid != 0)) {
        return format!(
            "permission denied: it belongs to group {group} (sudo usermod -aG {group} $USER, then log in again)"
        );
    }
    let mut usual = ["dialout", "uucp"].into_iter();
    let group = usual.find_map(|usual| named(&|name, _| name == usual));
    let group = group.unwrap_or_else(|| "dialout".to_owned());
    let real = std::fs::canonicalize(path).unwrap_or_else(|_| path.into());
    let kernel = real.file_name().map(|name| name.to_string_lossy()).unwrap_or_default();
    let kernel = kernel.trim_end_matches(|c: char| c.is_ascii_digit());
    format!(
        "permission denied: its mode is {:04o} and its group {}, which opens it to no user; as root, into /etc/udev/rules.d/99-serial.rules: KERNEL==\"{kernel}*\", GROUP=\"{group}\", MODE=\"0660\"; then plug it in again and join the group {group}",
        mode & 0o777,
        owner.as_deref().unwrap_or("unnamed"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_is_absent_is_named_with_the_ports_that_are_there() {
        let error = serial("/dev/drivebench-none", 115_200, Framing::default()).open().map(drop);
        let error = error.unwrap_err();
        let error = serial_error("/dev/drivebench-none", &error).to_string();
        assert!(error.contains("/dev/drivebench-none: cannot open: it does not exist ("));
    }

    #[test]
    fn a_refused_permission_names_the_group() {
        let groups = "root:x:0:\ndialout:x:20:\nusers:x:100:\n";
        for (mode, gid, has, has_not) in [
            (0o20_660, 20, "usermod -aG dialout", "udev"),
            (0o20_600, 0, "KERNEL==\"ttyUSB*\", GROUP=\"dialout\", MODE=\"0660\"", "usermod"),
            (0o20_660, 0, "its group root, which opens it to no user", "usermod"),
            (0o20_640, 20, "its mode is 0640", "usermod"),
            (0o20_600, 20, "99-serial.rules", "usermod"),
            (0o20_660, 777, "its group unnamed", "usermod"),
        ] {
            let text = permission("/dev/ttyUSB7", mode, gid, groups);
            assert!(text.contains(has) && !text.contains(has_not), "{mode:o} {gid}: {text}");
        }
        let kind = serialport::ErrorKind::Io(ErrorKind::PermissionDenied);
        let denied = serialport::Error::new(kind, "Permission denied");
        let error = serial_error("/dev/null", &denied).to_string();
        assert!(error.contains("permission denied: its mode is"), "{error}");
    }
}
