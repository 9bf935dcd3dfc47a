//! A drive that puts nothing out at first, as while its contactor pulls in.

use super::parameter::hidden_effect;
use super::{Hidden, Path};

hidden_effect! {
    /// After each start, zero volts for this long from the first set-point that is not zero on. A delay has no other form.
    StartDelay {
        delay_s: Delay in "s",
    }
}

impl Hidden for StartDelay {
    fn path(&self) -> Path {
        Path {
            start_delay_s: self.delay_s,
            ..Path::default()
        }
    }
}
