//! The serial ports of the machine: what they are, by which name they stay the same, who holds them.
//!
//! ```text
//! /dev/serial/by-id/* , /sys/class/tty/*/device (driver, USB identity, latency timer) , /proc/*/fd -> SerialPortInfo
//! ```
//!
//! Everything is read below a root folder, so that it can be tested without hardware. Linux only; elsewhere the list is
//! empty.

use std::path::{Path, PathBuf};
use std::{fmt, fs};

use serde::Serialize;

/// USB descriptors of an adapter.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct UsbInfo {
    /// Four hexadecimal digits each.
    pub vendor_id: String,
    pub product_id: String,
    pub serial_number: Option<String>,
    pub manufacturer: Option<String>,
    pub product: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Holder {
    pub pid: u32,
    pub command: String,
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "pid {} ({})", self.pid, self.command)
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SerialPortInfo {
    /// Device file; its number changes from plug to plug.
    pub path: PathBuf,
    /// Names that stay the same, from `/dev/serial/by-id`.
    pub by_id: Vec<PathBuf>,
    pub driver: Option<String>,
    pub usb: Option<UsbInfo>,
    /// How long an FTDI adapter holds a short read back, ms.
    pub latency_ms: Option<u32>,
    pub holders: Vec<Holder>,
}

/// Every port with hardware behind it, by name.
pub fn list(root: &Path) -> Vec<SerialPortInfo> {
    let mut ports: Vec<_> = entries(&root.join("sys/class/tty"))
        .into_iter()
        .filter_map(|class| {
            let name = class.file_name()?.to_owned();
            // The kernel keeps nodes for chips that are not there: they have no type.
            let is_absent = read(&class.join("type")).is_some_and(|kind| kind == "0");
            let has_driver = driver(&class).is_some();
            (has_driver && !is_absent).then(|| describe(root, &Path::new("/dev").join(name)))
        })
        .collect();
    ports.sort_by(|a, b| a.path.cmp(&b.path));
    ports
}

/// What is known about a port; `path` may be a stable name.
pub fn describe(root: &Path, path: &Path) -> SerialPortInfo {
    let device = device_file(root, path);
    let name = device.file_name().unwrap_or_default().to_owned();
    let class = root.join("sys/class/tty").join(&name);
    SerialPortInfo {
        by_id: by_id(root, &name),
        driver: driver(&class),
        usb: usb(&class),
        latency_ms: latency_file(root, path)
            .and_then(|file| read(&file))
            .and_then(|text| text.parse().ok()),
        holders: holders(root, path),
        path: device,
    }
}

/// The name of a port that survives a new plug: a symbolic link that was given, else the port's link by identity, else
/// the name as it is.
pub fn stable_name(root: &Path, path: &Path) -> PathBuf {
    if fs::read_link(below(root, path)).is_ok() {
        return path.to_owned();
    }
    let name = path.file_name().unwrap_or_default();
    by_id(root, name).into_iter().next().unwrap_or_else(|| path.to_owned())
}

/// USB descriptors of the adapter of a port; `None`: no USB adapter, or not present.
pub fn adapter(root: &Path, path: &Path) -> Option<UsbInfo> {
    let device = device_file(root, path);
    usb(&root.join("sys/class/tty").join(device.file_name()?))
}

/// Where the latency timer of an FTDI adapter is set; `None`: this driver has none.
pub fn latency_file(root: &Path, path: &Path) -> Option<PathBuf> {
    let device = device_file(root, path);
    let class = root.join("sys/class/tty").join(device.file_name()?);
    [class.join("device/latency_timer"), class.join("latency_timer")]
        .into_iter()
        .find(|file| file.exists())
}

/// Other programs that have the port open. Those of other users are visible to root only.
pub fn holders(root: &Path, path: &Path) -> Vec<Holder> {
    let device = device_file(root, path);
    let mut found: Vec<Holder> = entries(&root.join("proc"))
        .into_iter()
        .filter_map(|process| {
            let pid: u32 = process.file_name()?.to_str()?.parse().ok()?;
            let has_it = pid != std::process::id()
                && entries(&process.join("fd"))
                    .iter()
                    .any(|fd| fs::read_link(fd).is_ok_and(|target| target == device));
            has_it.then(|| Holder {
                pid,
                command: read(&process.join("comm")).unwrap_or_else(|| "?".to_owned()),
            })
        })
        .collect();
    found.sort_by_key(|holder| holder.pid);
    found
}

/// The names of those programs; `None`: none visible.
pub fn holder_names(path: &Path) -> Option<String> {
    let holders = holders(Path::new("/"), path);
    let names: Vec<String> = holders.iter().map(ToString::to_string).collect();
    (!names.is_empty()).then(|| names.join(", "))
}

/// The device behind symbolic links, as the system names it (without the root folder).
fn device_file(root: &Path, path: &Path) -> PathBuf {
    let Ok(real) = fs::canonicalize(below(root, path)) else { return path.to_owned() };
    let root = fs::canonicalize(root).unwrap_or_else(|_| root.to_owned());
    real.strip_prefix(root).map_or(real.clone(), |inside| Path::new("/").join(inside))
}

/// An absolute path below the root folder.
fn below(root: &Path, path: &Path) -> PathBuf {
    let inside = path.strip_prefix("/").unwrap_or(path);
    if path.is_absolute() { root.join(inside) } else { path.to_owned() }
}

fn by_id(root: &Path, name: &std::ffi::OsStr) -> Vec<PathBuf> {
    let folder = root.join("dev/serial/by-id");
    let mut found: Vec<PathBuf> = entries(&folder)
        .into_iter()
        .filter(|link| fs::read_link(link).is_ok_and(|target| target.file_name() == Some(name)))
        .filter_map(|link| Some(Path::new("/dev/serial/by-id").join(link.file_name()?)))
        .collect();
    found.sort();
    found
}

fn driver(class: &Path) -> Option<String> {
    let driver = fs::read_link(class.join("device/driver")).ok()?;
    Some(driver.file_name()?.to_string_lossy().into_owned())
}

/// The USB device is some levels above the port.
fn usb(class: &Path) -> Option<UsbInfo> {
    let device = fs::canonicalize(class.join("device")).ok()?;
    let above = device.ancestors().take(5).find(|folder| folder.join("idVendor").exists())?;
    Some(UsbInfo {
        vendor_id: read(&above.join("idVendor"))?,
        product_id: read(&above.join("idProduct"))?,
        serial_number: read(&above.join("serial")),
        manufacturer: read(&above.join("manufacturer")),
        product: read(&above.join("product")),
    })
}

fn read(file: &Path) -> Option<String> {
    let text = fs::read_to_string(file).ok()?;
    let text = text.trim();
    (!text.is_empty()).then(|| text.to_owned())
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect()
}

#[cfg(test)]
pub(super) use tests::machine;

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    fn put(root: &Path, file: &str, text: &str) {
        let file = root.join(file);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, text).unwrap();
    }

    fn link(root: &Path, from: &str, to: &str) {
        let from = root.join(from);
        fs::create_dir_all(from.parent().unwrap()).unwrap();
        symlink(to, from).unwrap();
    }

    /// A machine with an FTDI adapter and a chip that is not there.
    pub(crate) fn machine() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let usb = "sys/devices/usb1/1-2";
        for (file, text) in [
            ("idVendor", "0403\n"),
            ("idProduct", "6001\n"),
            ("serial", "A50285BI\n"),
            ("product", "FT232R USB UART\n"),
            ("1-2:1.0/ttyUSB3/latency_timer", "16\n"),
        ] {
            put(root, &format!("{usb}/{file}"), text);
        }
        for driver in ["ftdi_sio", "serial8250"] {
            fs::create_dir_all(root.join("sys/bus/drivers").join(driver)).unwrap();
        }
        for (file, text) in [
            ("sys/devices/8250/x", ""),
            ("sys/class/tty/ttyS0/type", "0\n"),
            ("sys/class/tty/tty1/dev", "4:1\n"),
            ("dev/ttyUSB3", ""),
            ("proc/4711/comm", "minicom\n"),
            ("proc/4712/comm", "bash\n"),
        ] {
            put(root, file, text);
        }
        let (port, class) = ("sys/devices/usb1/1-2/1-2:1.0/ttyUSB3", "sys/class/tty");
        let of_port = |file| format!("{port}/{file}");
        let of_class = |file| format!("{class}/{file}");
        let by_id = "dev/serial/by-id/usb-FTDI_FT232R_A50285BI-if00".to_owned();
        let device = "../../../devices/usb1/1-2/1-2:1.0/ttyUSB3";
        for (from, to) in [
            (of_port("driver"), "../../../../../bus/drivers/ftdi_sio"),
            (of_class("ttyUSB3/device"), device),
            ("sys/devices/8250/driver".to_owned(), "../../bus/drivers/serial8250"),
            (of_class("ttyS0/device"), "../../../devices/8250"),
            (by_id, "../../ttyUSB3"),
            ("proc/4711/fd/3".to_owned(), "/dev/ttyUSB3"),
            ("proc/4712/fd/0".to_owned(), "/dev/null"),
        ] {
            link(root, &from, to);
        }
        folder
    }

    #[test]
    fn an_adapter_is_listed_with_its_names_and_its_holder() {
        let machine = machine();
        let by_id = Path::new("/dev/serial/by-id/usb-FTDI_FT232R_A50285BI-if00");
        let ports = list(machine.path());
        assert_eq!(ports.len(), 1, "{ports:?}");
        let usb = UsbInfo {
            vendor_id: "0403".to_owned(),
            product_id: "6001".to_owned(),
            serial_number: Some("A50285BI".to_owned()),
            manufacturer: None,
            product: Some("FT232R USB UART".to_owned()),
        };
        let holder = Holder { pid: 4711, command: "minicom".to_owned() };
        assert_eq!(holder.to_string(), "pid 4711 (minicom)");
        let port = SerialPortInfo {
            path: "/dev/ttyUSB3".into(),
            by_id: vec![by_id.to_owned()],
            driver: Some("ftdi_sio".to_owned()),
            usb: Some(usb),
            latency_ms: Some(16),
            holders: vec![holder],
        };
        assert_eq!(ports[0], port);
        // A stable name leads to its port.
        assert_eq!(describe(machine.path(), by_id), port);
        for name in [Path::new("/dev/ttyUSB3"), by_id] {
            assert_eq!(stable_name(machine.path(), name), by_id);
        }
        assert_eq!(adapter(machine.path(), by_id), port.usb);
        let none = describe(machine.path(), Path::new("/dev/ttyUSB9"));
        assert_eq!((none.driver, none.usb, none.latency_ms), (None, None, None));
        assert!(none.holders.is_empty() && none.by_id.is_empty());
        let empty = tempfile::tempdir().unwrap();
        assert!(list(empty.path()).is_empty());
    }
}
