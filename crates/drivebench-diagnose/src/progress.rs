//! Progress of a long analysis.

/// Something that has been found out, or begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// A part of the work begins; `of` events of its kind are to come (at most: what fails tells nothing).
    Begun { stage: Stage, of: usize },
    /// The screen has judged an effect: the share of the unexplained error that it would explain, to first order.
    Screened { effect: &'static str, share: f64 },
    /// An effect was refitted: its training error in units of the noise.
    Refitted { effect: &'static str, error: f64 },
    /// An effect has joined the answer: the held-out error with it.
    Accepted { effect: &'static str, holdout: f64 },
}

/// The parts of a diagnosis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The model is fitted as it is. Counts nothing.
    Baseline,
    /// Counts [`Event::Screened`].
    Screen,
    /// Counts [`Event::Refitted`].
    Refit,
    /// Sets of effects are fitted together until one stands. Counts nothing.
    Check,
}

/// Called from several threads, in no order.
pub type Progress<'a> = &'a (dyn Fn(Event) + Sync);

/// For those who do not watch.
pub fn silent(_: Event) {}
