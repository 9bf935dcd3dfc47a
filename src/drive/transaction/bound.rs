//! The time that one exchange may take, and who may end it earlier. Pure: time goes in.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// A wait under way looks so often whether somebody wants a stop.
const LOOK: Duration = Duration::from_millis(4);

/// Says that a stop is wanted: any of its flags was raised since the last [`CutIn::lower`].
///
/// Silences, probes and retries of a bounded exchange are given up then, so that the stop goes out next.
#[derive(Clone, Debug, Default)]
pub struct CutIn(Vec<(Arc<AtomicBool>, bool)>);

impl CutIn {
    /// Watches flags that others raise: those of the signals, that of the screen's stop keys.
    pub fn watching(flags: impl IntoIterator<Item = Arc<AtomicBool>>) -> Self {
        Self(flags.into_iter().map(|flag| (flag, false)).collect())
    }

    /// What is raised by now will be heard by whoever is told of it next: it cuts in no more.
    pub fn lower(&mut self) {
        for (flag, heard) in &mut self.0 {
            *heard = flag.load(Ordering::Acquire);
        }
    }

    fn is_raised(&self) -> bool {
        let mut flags = self.0.iter();
        flags.any(|(flag, heard)| !heard && flag.load(Ordering::Acquire))
    }
}

/// The bound of the exchange under way; none until one is set.
#[derive(Clone, Debug, Default)]
pub(in crate::drive) struct Bound {
    until: Option<Instant>,
    pub(in crate::drive) cut_in: CutIn,
}

impl Bound {
    /// So much time is left from `now` on, s; not finite: as much as it takes.
    pub(in crate::drive) fn set(&mut self, left_s: f64, now: Instant) {
        let left = Duration::try_from_secs_f64(left_s.max(0.0)).ok();
        self.until = left.and_then(|left| now.checked_add(left));
    }

    pub(in crate::drive) const fn is_set(&self) -> bool {
        self.until.is_some()
    }

    /// Nothing that can wait is begun or gone on with any more.
    pub(in crate::drive) fn is_over(&self, now: Instant) -> bool {
        let wanted = self.cut_in.is_raised();
        self.until.is_some_and(|until| wanted || now >= until)
    }

    /// `at`, or where the exchange has to end.
    pub(in crate::drive) fn earlier(&self, at: Instant) -> Instant {
        self.until.map_or(at, |until| at.min(until))
    }

    /// Where a wait until `at` looks up next.
    pub(in crate::drive) fn next_look(&self, now: Instant, at: Instant) -> Instant {
        let at = self.earlier(at);
        if !self.is_set() || self.cut_in.0.is_empty() {
            at
        } else {
            at.min(now + LOOK)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::guard::now;

    #[test]
    fn a_flag_cuts_in_until_it_was_heard_and_again_when_it_is_raised_again() {
        let flag = Arc::new(AtomicBool::new(false));
        let mut cut_in = CutIn::watching([Arc::clone(&flag)]);
        assert!(!cut_in.is_raised());
        flag.store(true, Ordering::Release);
        assert!(cut_in.is_raised());
        cut_in.lower();
        assert!(!cut_in.is_raised());
        flag.store(false, Ordering::Release);
        cut_in.lower();
        flag.store(true, Ordering::Release);
        assert!(cut_in.is_raised());
    }

    #[test]
    fn a_bound_without_an_end_is_none() {
        let (mut bound, now) = (Bound::default(), now());
        bound.set(0.08, now);
        assert!(bound.is_set() && !bound.is_over(now + Duration::from_millis(79)));
        assert!(bound.is_over(now + Duration::from_millis(80)));
        bound.set(f64::INFINITY, now);
        assert!(!bound.is_set() && !bound.is_over(now + Duration::from_secs(3600)));
    }
}
