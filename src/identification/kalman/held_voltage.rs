//! Voltage as applied, piece by piece, in a fixed store.

/// Changes of voltage between two samples that are told apart.
const MOST: usize = 16;

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HeldVoltage {
    /// `(from, volts)` in the order of time; the first holds at the filter's present instant.
    pieces: [(f64, f64); MOST],
    count: usize,
    /// The interval that comes is not known: too many changes in it, or one was told too late.
    pub(super) torn: bool,
    pub(super) energised: bool,
}

impl HeldVoltage {
    /// The voltage that holds from `time_s` on; `now_s` is the instant up to which the filter has already gone.
    pub(super) fn apply(&mut self, time_s: f64, voltage_v: f64, now_s: f64) {
        if !(time_s.is_finite() && voltage_v.is_finite()) {
            return;
        }
        self.energised |= voltage_v != 0.0;
        let held = &self.pieces[..self.count];
        let at = held.partition_point(|piece| piece.0 < time_s);
        let known = at > 0 && held[at - 1].1.total_cmp(&voltage_v).is_eq();
        let same_time = held.get(at).is_some_and(|p| p.0.total_cmp(&time_s).is_eq());
        if same_time {
            self.pieces[at].1 = voltage_v;
            return;
        }
        // The same voltage once more changes nothing, unless something else was told for later.
        if known && at == self.count {
            return;
        }
        if time_s < now_s && self.count > 0 {
            self.torn = true;
        }
        if self.count == MOST {
            self.torn = true;
            self.count -= 1;
        }
        let at = at.min(self.count);
        self.pieces.copy_within(at..self.count, at + 1);
        self.pieces[at] = (time_s, voltage_v);
        self.count += 1;
    }

    /// What holds at an instant; `None` before the first command.
    pub(super) fn at(&self, time_s: f64) -> Option<f64> {
        let held = self.pieces[..self.count].partition_point(|piece| piece.0 <= time_s);
        (held > 0).then(|| self.pieces[held - 1].1)
    }

    /// `(length, volts)` of the pieces between two instants, of which the first is covered.
    pub(super) fn between(
        &self,
        from_s: f64,
        to_s: f64,
    ) -> impl Iterator<Item = (f64, f64)> + Clone + '_ {
        let held = &self.pieces[..self.count];
        held.iter().enumerate().filter_map(move |(index, piece)| {
            let begin = piece.0.max(from_s);
            let end = held.get(index + 1).map_or(to_s, |next| next.0.min(to_s));
            (end > begin).then_some((end - begin, piece.1))
        })
    }

    /// Forgets what no longer holds at `now_s`.
    pub(super) fn advance(&mut self, now_s: f64) {
        let held = self.pieces[..self.count].partition_point(|piece| piece.0 <= now_s);
        if held > 1 {
            self.pieces.copy_within(held - 1..self.count, 0);
            self.count -= held - 1;
        }
        self.torn = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_cover_the_interval_whatever_the_order_of_telling() {
        let mut held = HeldVoltage::default();
        assert_eq!(held.at(1.0), None);
        for (time_s, volts) in [(0.0, 5.0), (2.0, 7.0), (1.0, 6.0), (f64::NAN, 9.0)] {
            held.apply(time_s, volts, 0.0);
        }
        assert_eq!(
            held.between(0.5, 2.5).collect::<Vec<_>>(),
            [(0.5, 5.0), (1.0, 6.0), (0.5, 7.0)]
        );
        held.advance(2.0);
        assert_eq!((held.at(1.5), held.at(2.0)), (None, Some(7.0)));
        assert!(!held.torn);
    }

    #[test]
    fn a_change_told_too_late_or_too_many_of_them_tear_the_interval() {
        let mut held = HeldVoltage::default();
        held.apply(0.0, 5.0, f64::NAN);
        held.advance(1.0);
        held.apply(0.9, 6.0, 1.0);
        assert!(held.torn);
        held.advance(2.0);
        assert_eq!(held.at(2.0), Some(6.0));
        for k in 0..40 {
            held.apply(2.0 + 0.001 * f64::from(k), f64::from(k), 2.0);
        }
        assert!(held.torn);
        assert_eq!(held.at(3.0), Some(39.0));
    }
}
