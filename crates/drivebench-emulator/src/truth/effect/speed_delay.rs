//! A speed that is old when it is reported, as one that a slow task of the drive hands over.

use super::{Acts, Delay, HiddenKind};

/// The measured speed is that of this much earlier, from the drive's ticks of 50 us. A delay has no other form.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "speed_delay",
    names: &["speed_delay"],
    parameters: &[Delay.of("delay_s", "s", 4e-3, 1.5e-3..4e-3)],
    mystery: Some(|dice| vec![dice.delay_s(4.0, 15.0)]),
    acts: Acts::Between(|path| &mut path.speed_delay_s),
};
