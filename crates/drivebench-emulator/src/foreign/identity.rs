//! Identity registers with the values that the profile expects, so that a profile with `[[identity]]` can be tried without the
//! drive.

use super::ForeignDrive;
use super::registers::{bits, number_of};
use drivebench_link::register_map::{IdentityCheck, IdentityTest, Quantity, RegisterMap, Signal};

impl ForeignDrive {
    /// The bits of a signal, changed only where the check of the identity would fail.
    pub(super) fn with_expected_identity(&self, signal: &Signal, natural: u32) -> u32 {
        let is_status = matches!(signal.keys.quantity, Quantity::Status | Quantity::FaultCode);
        // A status is checked only while the drive is at rest; running, it must show the state.
        if is_status && (self.fault.is_some() || !self.sequence.is_at_rest()) {
            return natural;
        }
        let kind = signal.location.layout.kind;
        let numbers = &signal.numbers;
        self.map.identity.iter().fold(natural, |shown, check| match check {
            IdentityCheck::Signal { signal: name, mask, test } if *name == signal.name => {
                match test {
                    IdentityTest::OneOf(allowed) if allowed.contains(&(shown & mask)) => shown,
                    IdentityTest::OneOf(allowed) => {
                        (shown & !mask) | (allowed.first().copied().unwrap_or_default() & mask)
                    }
                    IdentityTest::Within([low, high]) => {
                        let scale = numbers.scale * self.factor(&numbers.scale_by);
                        let value = number_of(kind, shown) * scale + numbers.offset;
                        if (*low..=*high).contains(&value) {
                            shown
                        } else {
                            bits(kind, (0.5 * (low + high) - numbers.offset) / scale)
                        }
                    }
                }
            }
            _ => shown,
        })
    }

    /// Nameplate value in the registers of the drive, as the check of the identity expects it.
    pub(super) fn factor_with_expected_identity(&self, signal: &Signal, natural: f64) -> f64 {
        let is_checked = |check: &IdentityCheck| matches!(check, IdentityCheck::Signal { signal: name, .. } if *name == signal.name);
        let numbers = &signal.numbers;
        // A factor with factors of its own is left as it is.
        if !numbers.scale_by.is_empty() || !self.map.identity.iter().any(is_checked) {
            return natural;
        }
        let kind = signal.location.layout.kind;
        let shown = self
            .with_expected_identity(signal, bits(kind, (natural - numbers.offset) / numbers.scale));
        number_of(kind, shown) * numbers.scale + numbers.offset
    }
}

/// Objects of function code 43: they identify the drive as an emulator and contain the texts that the profile expects.
pub(super) fn identification_objects(map: &RegisterMap) -> Vec<(u8, String)> {
    let mut objects = vec![
        (0, "drivebench emulator".to_owned()),
        (1, map.device.name.clone()),
        (2, env!("CARGO_PKG_VERSION").to_owned()),
    ];
    for check in &map.identity {
        let IdentityCheck::Object { object, contains } = check else { continue };
        match objects.iter_mut().find(|(known, _)| known == object) {
            Some((_, text)) if text.contains(contains.as_str()) => {}
            Some((_, text)) => {
                text.push_str(", ");
                text.push_str(contains);
            }
            None => objects.push((*object, contains.clone())),
        }
    }
    objects
}
