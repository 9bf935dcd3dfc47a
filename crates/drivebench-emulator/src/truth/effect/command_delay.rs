//! Dead time between set-point and voltage.

use super::{Acts, Delay, HiddenKind};

/// Dead time of every set-point, in ticks of 50 us. A dead time has no other mathematical form than the host's.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "command_delay",
    names: &["command_delay"],
    parameters: &[Delay.of("delay_s", "s", 2e-3, 0.8e-3..2.5e-3)],
    mystery: Some(|dice| vec![dice.delay_s(2.0, 10.0)]),
    acts: Acts::Between(|path| &mut path.command_delay_s),
};
