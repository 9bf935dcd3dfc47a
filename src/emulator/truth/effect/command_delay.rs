//! A drive that takes its time between the set-point and the voltage.

use super::parameter::hidden_effect;
use super::{Hidden, Path};

hidden_effect! {
    /// Every set-point acts this much later than the drive says; a line of the drive's ticks, to 50 us. A delay has no other form.
    CommandDelay {
        delay_s: Delay in "s",
    }
}

impl Hidden for CommandDelay {
    fn path(&self) -> Path {
        Path {
            command_delay_s: self.delay_s,
            ..Path::default()
        }
    }
}
