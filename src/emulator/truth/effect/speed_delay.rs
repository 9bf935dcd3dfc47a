//! A speed that is old when it is told, as one that a slow task of the drive hands over.

use super::parameter::hidden_effect;
use super::{Hidden, Path};

hidden_effect! {
    /// The measured speed is that of this much earlier, from the drive's ticks of 50 us. A delay has no other form.
    SpeedDelay {
        delay_s: Delay in "s",
    }
}

impl Hidden for SpeedDelay {
    fn path(&self) -> Path {
        Path {
            speed_delay_s: self.delay_s,
            ..Path::default()
        }
    }
}
