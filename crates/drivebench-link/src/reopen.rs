//! Reconnection of a lost link: times of the attempts, port name, check of the identity. Pure: its inputs are times and results.
//!
//! ```text
//! lost -> closed -> pause (50 ms .. 2 s, jitter) -> open by the stable name -> identity -> the same drive: stop it
//!                     ^------------------------------ no --'                            -> another one: no command
//! ```

use std::path::Path;

use super::link::Identity;
use super::open::Target;
use super::serial_ports::{UsbInfo, adapter, stable_name};

#[derive(Clone, Debug, PartialEq)]
pub struct Backoff {
    next_s: f64,
    longest_s: f64,
    dice: u64,
}

impl Backoff {
    /// Pauses from `first_s` to `longest_s`, doubled each time; the seed draws their jitter.
    pub const fn between(first_s: f64, longest_s: f64, seed: u64) -> Self {
        Self { next_s: first_s, longest_s, dice: seed }
    }

    pub fn pause_s(&mut self) -> f64 {
        let base_s = self.next_s;
        self.next_s = (2.0 * base_s).min(self.longest_s);
        // One step of SplitMix64 (Steele, Lea and Flood, OOPSLA 2014) is enough for a jitter.
        self.dice = self.dice.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.dice ^ (self.dice >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        let share = ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1_u64 << 53) as f64;
        // Relative jitter of a pause, so that two programs do not stay synchronised.
        base_s * (1.0 + 0.25 * (2.0 * share - 1.0))
    }
}

/// The attempts to open one lost link.
#[derive(Clone, Debug, PartialEq)]
pub struct Reopening {
    backoff: Backoff,
    due_s: f64,
    until_s: Option<f64>,
    attempts: u32,
}

impl Reopening {
    /// From `now_s` on, for at most `limit_s`; `None`: until it is ended.
    pub fn new(now_s: f64, limit_s: Option<f64>, seed: u64) -> Self {
        // First and longest pause between two attempts, s.
        let mut backoff = Backoff::between(0.05, 2.0, seed);
        Self {
            due_s: now_s + backoff.pause_s(),
            backoff,
            until_s: limit_s.map(|limit_s| now_s + limit_s),
            attempts: 0,
        }
    }

    /// When the next attempt is due, s; `None`: the time is over.
    pub fn due_s(&self) -> Option<f64> {
        self.until_s.is_none_or(|until_s| self.due_s <= until_s).then_some(self.due_s)
    }

    /// An attempt begins; returns its number.
    pub const fn attempt(&mut self) -> u32 {
        self.attempts += 1;
        self.attempts
    }

    pub fn failed(&mut self, now_s: f64) {
        self.due_s = now_s + self.backoff.pause_s();
    }

    pub const fn attempts(&self) -> u32 {
        self.attempts
    }
}

/// Where a link was opened, by a name that survives a new plug, and the adapter that was there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Anchor {
    target: Target,
    adapter: Option<UsbInfo>,
}

impl Anchor {
    /// To be made while the port is there; `root` is the folder below which the system lies.
    pub fn of(root: &Path, target: &Target) -> Self {
        let Target::Serial { path, baud, unit } = target else {
            return Self { target: target.clone(), adapter: None };
        };
        let stable = stable_name(root, Path::new(path));
        Self {
            target: Target::Serial {
                path: stable.to_string_lossy().into_owned(),
                baud: *baud,
                unit: *unit,
            },
            adapter: adapter(root, Path::new(path)),
        }
    }

    /// What to open; a link of the file system is followed anew each time.
    pub const fn target(&self) -> &Target {
        &self.target
    }

    /// The reason where another adapter has taken the name; one without an identity is not recognised.
    pub fn stranger(&self, root: &Path) -> Option<String> {
        let (before, Target::Serial { path, .. }) = (self.adapter.as_ref()?, &self.target) else {
            return None;
        };
        let now = adapter(root, Path::new(path))?;
        (now != *before).then(|| {
            let (now, before) = (plate(&now), plate(before));
            format!("another adapter is at {path}: {now}, before it was {before}")
        })
    }
}

fn plate(usb: &UsbInfo) -> String {
    let serial = usb.serial_number.as_deref().unwrap_or("none");
    format!("{}:{} serial number {serial}", usb.vendor_id, usb.product_id)
}

/// The reason where the drive that answers is not the one from before. What a loss of power resets (watchdog
/// time, limits) is no identity.
pub fn another_drive(before: &Identity, now: &Identity) -> Option<String> {
    let told = [
        ("vendor", &before.vendor, &now.vendor),
        ("product", &before.product, &now.product),
        ("serial number", &before.serial_number, &now.serial_number),
        ("firmware", &before.firmware, &now.firmware),
    ];
    let differs = told.into_iter().find(|(_, before, now)| before != now);
    if let Some((what, before, now)) = differs {
        return Some(format!("its {what} is {now:?}, before it was {before:?}"));
    }
    let (was, is) = (before.protocol_version, now.protocol_version);
    if was != is {
        return Some(format!("its protocol version is {is}, before it was {was}"));
    }
    (before.is_emulator != now.is_emulator).then(|| {
        let kind = |emulated| if emulated { "software" } else { "hardware" };
        let (is, was) = (kind(now.is_emulator), kind(before.is_emulator));
        format!("it is {is}, before it was {was}")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_up_to_the_longest_and_end_with_the_time() {
        /// The pauses before each of at most twelve attempts.
        fn pauses(limit_s: Option<f64>, seed: u64) -> Vec<f64> {
            let mut reopening = Reopening::new(10.0, limit_s, seed);
            let (mut now_s, mut pauses) = (10.0, Vec::new());
            while let Some(due_s) = reopening.due_s().filter(|_| pauses.len() < 12) {
                pauses.push(due_s - now_s);
                now_s = due_s;
                reopening.attempt();
                reopening.failed(now_s);
            }
            assert_eq!(reopening.attempts() as usize, pauses.len());
            pauses
        }
        for (index, pause_s) in pauses(None, 7).into_iter().enumerate() {
            let base_s = (0.05 * f64::from(1 << index)).min(2.0);
            let range = 0.74 * base_s..1.26 * base_s;
            assert!(range.contains(&pause_s), "{index}: {pause_s} {range:?}");
        }
        assert_eq!(pauses(None, 7), pauses(None, 7));
        assert_ne!(pauses(None, 7), pauses(None, 8));
        let limited = pauses(Some(1.0), 3);
        let total_s: f64 = limited.iter().sum();
        assert!((3..=6).contains(&limited.len()) && (0.3..=1.0).contains(&total_s));
        assert!(pauses(Some(0.0), 1).is_empty());
    }

    #[test]
    fn another_serial_number_is_another_drive() {
        let before = Identity {
            product: "drive".to_owned(),
            serial_number: "1".to_owned(),
            watchdog_s: Some(0.2),
            ..Identity::default()
        };
        let changed = |change: fn(&mut Identity)| {
            let mut now = before.clone();
            change(&mut now);
            another_drive(&before, &now)
        };
        let reset = changed(|now| (now.watchdog_s, now.current_limit_a) = (None, Some(3.0)));
        assert_eq!(reset, None);
        let other = changed(|now| now.serial_number = "2".to_owned());
        let reason = "its serial number is \"2\", before it was \"1\"";
        assert_eq!(other.as_deref(), Some(reason));
        let software = changed(|now| now.is_emulator = true);
        assert_eq!(software.as_deref(), Some("it is software, before it was hardware"));
    }

    #[test]
    fn a_plugged_number_is_kept_by_its_name_that_stays() {
        let machine = crate::serial_ports::machine();
        let root = machine.path();
        let target: Target = "/dev/ttyUSB3".parse().unwrap();
        let anchor = Anchor::of(root, &target);
        assert_eq!(anchor.target().to_string(), "/dev/serial/by-id/usb-FTDI_FT232R_A50285BI-if00");
        assert_eq!(anchor.stranger(root), None);
        // The same plug, seen as another adapter.
        std::fs::write(root.join("sys/devices/usb1/1-2/serial"), "B0\n").unwrap();
        let reason = anchor.stranger(root).unwrap();
        assert!(reason.contains("0403:6001 serial number B0"), "{reason}");
        // What is not there under a name that stays keeps the name that was given.
        let target: Target = "/dev/ttyUSB9".parse().unwrap();
        assert_eq!(Anchor::of(root, &target).target(), &target);
        let target: Target = "tcp:drive:502".parse().unwrap();
        assert_eq!(Anchor::of(root, &target).target(), &target);
    }
}
