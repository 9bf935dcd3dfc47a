//! Progress of a long analysis.

/// Begin of a stage, or a result within it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// A stage begins; at most `of` events of its kind follow (a failed fit has none).
    Begun { stage: Stage, of: usize },
    /// An effect was screened: the share of the unexplained error that it would explain, to first order.
    Screened { effect: &'static str, share: f64 },
    /// An effect was refitted: its training error in units of the noise.
    Refitted { effect: &'static str, error: f64 },
    /// An effect has joined the answer: the held-out error with it.
    Accepted { effect: &'static str, holdout: f64 },
}

/// The parts of a diagnosis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Fit of the baseline; without events.
    Baseline,
    /// Counts [`Event::Screened`].
    Screen,
    /// Counts [`Event::Refitted`].
    Refit,
    /// Joint fits of sets of effects until one is confirmed; without events.
    Check,
}

/// Called from several threads, in any order.
pub type Progress<'a> = &'a (dyn Fn(Event) + Sync);

/// Discards the progress.
pub fn silent(_: Event) {}
