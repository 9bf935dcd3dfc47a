//! The slew limit in closed form: a straight line followed at a limited rate is itself made of straight lines.

use super::Piece;

/// A voltage that follows its target no faster than `rate_v_per_s`.
#[derive(Clone, Debug)]
pub(super) struct SlewLimit {
    pub(super) rate_v_per_s: f64,
    pub(super) voltage_v: f64,
}

impl SlewLimit {
    /// Follows one piece of the target; pushes one to three pieces over the same time. A piece without length has no
    /// slope: rounding leaves one where a corner of the dither falls on the end of a level.
    pub(super) fn follow(&mut self, target: &Piece, pieces: &mut Vec<Piece>) {
        if target.end_s <= target.start_s {
            return;
        }
        let slope = target.slope_v_per_s();
        let gap_v = target.from_v - self.voltage_v;
        let mut time_s = target.start_s;
        if gap_v != 0.0 {
            let rate = self.rate_v_per_s.copysign(gap_v);
            // Rate at which the gap closes, V/s; not positive where the target moves away faster than the limit.
            let closing = rate.abs() - slope * gap_v.signum();
            let meet_s = time_s + gap_v.abs() / closing;
            if closing <= 0.0 || meet_s >= target.end_s {
                self.line(time_s, target.end_s, rate, pieces);
                return;
            }
            if meet_s > time_s {
                let to_v = target.value(meet_s);
                self.push(time_s, meet_s, to_v, pieces);
                time_s = meet_s;
            }
            self.voltage_v = target.value(time_s);
        }
        if slope.abs() <= self.rate_v_per_s {
            self.push(time_s, target.end_s, target.to_v, pieces);
        } else {
            let rate = self.rate_v_per_s.copysign(slope);
            self.line(time_s, target.end_s, rate, pieces);
        }
    }

    fn line(&mut self, start_s: f64, end_s: f64, rate: f64, pieces: &mut Vec<Piece>) {
        let to_v = self.voltage_v + rate * (end_s - start_s);
        self.push(start_s, end_s, to_v, pieces);
    }

    fn push(&mut self, start_s: f64, end_s: f64, to_v: f64, pieces: &mut Vec<Piece>) {
        pieces.push(Piece::line((start_s, self.voltage_v), (end_s, to_v)));
        self.voltage_v = to_v;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_step_becomes_a_ramp_and_a_hold() {
        let mut limit = SlewLimit { rate_v_per_s: 10.0, voltage_v: 0.0 };
        let mut pieces = Vec::new();
        limit.follow(&Piece::level(1.0, 2.0, 4.0), &mut pieces);
        assert_eq!(pieces.len(), 2);
        assert!((pieces[0].end_s - 1.4).abs() < 1e-12);
        assert_eq!(pieces[1], Piece::level(pieces[0].end_s, 2.0, 4.0));
        // too short to get there
        limit.follow(&Piece::level(2.0, 2.1, -4.0), &mut pieces);
        assert!((limit.voltage_v - 3.0).abs() < 1e-12);
        // without length
        limit.follow(&Piece::level(2.1, 2.1, -9.0), &mut pieces);
        assert!((limit.voltage_v - 3.0).abs() < 1e-12 && pieces.len() == 3);
    }

    proptest! {
        /// The exact limiter against a limiter stepped in small steps.
        #[test]
        fn it_agrees_with_a_stepped_limiter(
            targets in prop::collection::vec((0.05..0.5f64, -10.0..10.0f64, -10.0..10.0f64), 1..8),
            rate_v_per_s in 2.0..100.0f64,
        ) {
            let mut limit = SlewLimit { rate_v_per_s, voltage_v: 0.0 };
            let mut stepped_v = 0.0;
            let mut start_s = 0.0;
            for (length_s, from_v, to_v) in targets {
                let target = Piece { start_s, end_s: start_s + length_s, from_v, to_v };
                let mut pieces = Vec::new();
                limit.follow(&target, &mut pieces);
                for piece in &pieces {
                    prop_assert!(piece.slope_v_per_s().abs() <= rate_v_per_s * (1.0 + 1e-6));
                }
                let steps = 2000;
                let step_s = length_s / f64::from(steps);
                for step in 1..=steps {
                    let target_v = target.value(start_s + f64::from(step) * step_s);
                    let most_v = rate_v_per_s * step_s;
                    stepped_v += (target_v - stepped_v).clamp(-most_v, most_v);
                }
                start_s += length_s;
                prop_assert!((stepped_v - limit.voltage_v).abs() < 0.2, "{} {}", stepped_v, limit.voltage_v);
            }
        }
    }
}
