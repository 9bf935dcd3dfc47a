//! What a long analysis tells while it runs.

/// Something that has been found out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// The screen has judged an effect: the share of the unexplained error that it would explain, to first order.
    Screened { effect: &'static str, share: f64 },
    /// An effect was refitted: its training error in units of the noise.
    Refitted { effect: &'static str, error: f64 },
    /// An effect has joined the answer: the held-out error with it.
    Accepted { effect: &'static str, holdout: f64 },
}

/// Called from several threads, in no order.
pub type Progress<'a> = &'a (dyn Fn(Event) + Sync);

/// For those who do not watch.
pub fn silent(_: Event) {}
