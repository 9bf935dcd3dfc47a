//! The measured angle as an input of the simulation.

/// Linear interpolation of the measured angle, walked forward only.
pub(super) struct AngleTrack<'a> {
    points: &'a [(f64, f64)],
    next: usize,
}

impl<'a> AngleTrack<'a> {
    pub(super) const fn new(points: &'a [(f64, f64)]) -> Self {
        Self { points, next: 0 }
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    pub(super) fn at(&mut self, time_s: f64) -> Option<f64> {
        let last = self.points.last()?;
        while self.next < self.points.len() && self.points[self.next].0 <= time_s {
            self.next += 1;
        }
        Some(
            match (self.next.checked_sub(1), self.points.get(self.next)) {
                (Some(before), Some(after)) => {
                    let before = self.points[before];
                    let share = (time_s - before.0) / (after.0 - before.0);
                    before.1 + share * (after.1 - before.1)
                }
                (None, Some(first)) => first.1,
                (_, None) => last.1,
            },
        )
    }
}
