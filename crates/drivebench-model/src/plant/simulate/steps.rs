//! Propagators of the step lengths that a run repeats.

use crate::plant::propagator::{LinearPart, M2, Propagator};

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Step<P = Propagator> {
    pub(super) length_s: f64,
    pub(super) whole: P,
    /// Set only where effects are evaluated at the middle.
    pub(super) half: P,
}

impl<P> Step<P> {
    #[inline]
    pub(super) fn has_length(&self, length_s: f64) -> bool {
        is_same(self.length_s, length_s)
    }
}

/// Whether two lengths are equal but for the rounding of stamps.
#[inline]
pub(super) fn is_same(one_s: f64, other_s: f64) -> bool {
    (one_s - other_s).abs() <= 1e-9 * other_s
}

/// Cache of the propagators of the latest step lengths: a command between two samples makes two, and a steep effect has each of them in
/// pieces of four lengths.
#[derive(Clone, Debug)]
pub(super) struct Steps {
    linear: LinearPart,
    with_half: bool,
    latest: [Step; 10],
    last: usize,
}

impl Steps {
    pub(super) fn new(a: &M2, with_half: bool) -> Self {
        Self { linear: LinearPart::new(a), with_half, latest: [Step::default(); 10], last: 0 }
    }

    /// Empties the cache, so that the rounding of a run does not depend on the run before.
    pub(super) fn clear(&mut self) {
        self.latest = [Step::default(); 10];
        self.last = 0;
    }

    /// The step of this length, which must be positive.
    #[inline]
    pub(super) fn over(&mut self, length_s: f64) -> &Step {
        if !self.latest[self.last].has_length(length_s) {
            self.find_or_make(length_s);
        }
        &self.latest[self.last]
    }

    #[inline(never)]
    fn find_or_make(&mut self, length_s: f64) {
        let known = self.latest.iter().position(|step| step.has_length(length_s));
        self.last = known.unwrap_or((self.last + 1) % self.latest.len());
        if known.is_some() {
            return;
        }
        let (whole, half) = if self.with_half {
            self.linear.over_both(length_s)
        } else {
            (self.linear.over(length_s), Propagator::default())
        };
        self.latest[self.last] = Step { length_s, whole, half };
    }
}
