//! A drive that puts nothing out at first whenever it starts from rest.

use super::parameter::hidden_effect;
use super::{Hidden, Path};

hidden_effect! {
    /// Zero volts for this long from every set-point on that is not zero and follows a rest. A delay has no other form.
    RestartDelay {
        delay_s: Delay in "s",
    }
}

impl Hidden for RestartDelay {
    fn path(&self) -> Path {
        Path {
            restart_delay_s: self.delay_s,
            ..Path::default()
        }
    }
}
