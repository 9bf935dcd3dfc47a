//! A sequence under its slew limit: one polyline, evaluated at any instant in any order.

use super::error::{ExcitationError, LONGEST_S};
use super::slew::SlewLimit;
use super::{Piece, Segment, Target};
use crate::sample::Demand;

/// The set-point of the program at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Output {
    /// Armature voltage, V.
    Voltage(f64),
    /// Output off, the motor runs free.
    Coast,
}

impl From<Output> for Demand {
    fn from(output: Output) -> Self {
        match output {
            Output::Voltage(volts) => Self::Voltage(volts),
            Output::Coast => Self::Disable,
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Span {
    /// `steps`, `steps 2`, ...; `ramp down` at the end.
    pub name: String,
    pub start_s: f64,
    pub end_s: f64,
    pub coast: bool,
}

/// The whole sequence under its slew limit: begins at 0 V, ends at 0 V by a ramp down of its own, 0 V outside.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    pieces: Vec<Piece>,
    spans: Vec<Span>,
}

impl Program {
    /// The slew limit holds through the whole program, from part to part, but not at a coast-down: it switches the output off at
    /// any voltage, and the next part begins from 0 V.
    pub fn new(segments: &[Segment], slew_v_per_s: f64) -> Result<Self, ExcitationError> {
        if !(slew_v_per_s > 0.0 && slew_v_per_s.is_finite()) {
            return Err(ExcitationError::Slew(slew_v_per_s));
        }
        if segments.is_empty() {
            return Err(ExcitationError::Empty);
        }
        let mut limit = SlewLimit { rate_v_per_s: slew_v_per_s, voltage_v: 0.0 };
        let mut pieces = Vec::new();
        let mut spans: Vec<Span> = Vec::new();
        let mut start_s = 0.0;
        for (index, segment) in segments.iter().enumerate() {
            let excitation = segment.excitation();
            let kind = segment.key();
            let number = index + 1;
            let refused = |refusal| ExcitationError::Value { number, kind, refusal };
            excitation.check().map_err(refused)?;
            let end_s = start_s + excitation.duration_s();
            if end_s > LONGEST_S {
                return Err(ExcitationError::TooLong(end_s));
            }
            let target = excitation.target();
            let coast = target == Target::Coast;
            if let Target::Voltage(targets) = target {
                for target in targets {
                    limit.follow(&target.shifted(start_s), &mut pieces);
                }
            } else {
                pieces.push(Piece::level(start_s, end_s, 0.0));
                limit.voltage_v = 0.0;
            }
            let earlier = segments[..index].iter().map(Segment::key);
            let name = match earlier.filter(|id| *id == kind).count() {
                0 => kind.to_owned(),
                earlier => format!("{kind} {}", earlier + 1),
            };
            spans.push(Span { name, start_s, end_s, coast });
            start_s = end_s;
        }
        if limit.voltage_v != 0.0 {
            let end_s = start_s + limit.voltage_v.abs() / slew_v_per_s;
            pieces.push(Piece::line((start_s, limit.voltage_v), (end_s, 0.0)));
            spans.push(Span { name: "ramp down".into(), start_s, end_s, coast: false });
        }
        Ok(Self { pieces, spans })
    }

    pub fn duration_s(&self) -> f64 {
        self.spans.last().map_or(0.0, |span| span.end_s)
    }

    /// The set-point at `time_s`; 0 V before the beginning and from the end on.
    pub fn value_at(&self, time_s: f64) -> Output {
        match self.span_at(time_s) {
            Some(span) if span.coast => Output::Coast,
            Some(_) => Output::Voltage(self.voltage_at(time_s)),
            None => Output::Voltage(0.0),
        }
    }

    /// The part of the sequence that holds at `time_s`.
    pub fn segment_at(&self, time_s: f64) -> Option<&str> {
        self.span_at(time_s).map(|span| span.name.as_str())
    }

    pub fn spans(&self) -> &[Span] {
        &self.spans
    }

    pub fn peak_v(&self) -> f64 {
        let pieces = self.pieces.iter();
        pieces.fold(0.0, |peak_v, piece| peak_v.max(piece.from_v.abs()).max(piece.to_v.abs()))
    }

    /// Corners `(time_s, voltage_v)` for a plot; two at one instant where a coast-down begins.
    pub fn polyline(&self) -> Vec<(f64, f64)> {
        let mut corners: Vec<(f64, f64)> = Vec::new();
        for piece in &self.pieces {
            for corner in [(piece.start_s, piece.from_v), (piece.end_s, piece.to_v)] {
                if corners.last() != Some(&corner) {
                    corners.push(corner);
                }
            }
        }
        corners
    }

    fn span_at(&self, time_s: f64) -> Option<&Span> {
        let after = self.spans.partition_point(|span| span.end_s <= time_s);
        self.spans.get(after).filter(|span| span.start_s <= time_s)
    }

    fn voltage_at(&self, time_s: f64) -> f64 {
        let after = self.pieces.partition_point(|piece| piece.end_s <= time_s);
        let piece = self.pieces.get(after);
        piece.map_or(0.0, |piece| piece.value(time_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::excitation::{CoastDown, Prbs, Standstill, Steps};

    fn steps(levels_v: &[f64]) -> Segment {
        Segment::Steps(Steps { levels_v: levels_v.to_vec(), hold_s: 0.5, dither: None })
    }

    #[track_caller]
    fn assert_volts(program: &Program, points: &[(f64, f64)]) {
        for (time_s, expected_v) in points {
            let found = program.value_at(*time_s);
            let is_near = matches!(found, Output::Voltage(v) if (v - expected_v).abs() < 1e-9);
            assert!(is_near, "{time_s} s: {found:?}");
        }
    }

    #[test]
    fn parts_follow_each_other_under_one_slew_limit() {
        let rest = Segment::Standstill(Standstill { seconds: 0.5 });
        let program = Program::new(&[rest, steps(&[10.0, -10.0]), steps(&[5.0])], 100.0).unwrap();
        assert_volts(&program, &[(-1.0, 0.0), (0.25, 0.0), (0.55, 5.0), (0.7, 10.0)]);
        assert_volts(&program, &[(1.1, 0.0), (1.3, -10.0), (1.65, 5.0), (2.025, 2.5)]);
        assert_volts(&program, &[(2.05, 0.0), (9.0, 0.0), (f64::NAN, 0.0)]);
        let names: Vec<_> = program.spans().iter().map(|span| &span.name).collect();
        assert_eq!(names, ["standstill", "steps", "steps 2", "ramp down"]);
        assert_eq!(program.segment_at(1.0), Some("steps"));
        assert_eq!(program.segment_at(2.05), None);
        assert!((program.duration_s() - 2.05).abs() < 1e-12);
        assert!((program.peak_v() - 10.0).abs() < 1e-12);
    }

    #[test]
    fn a_coast_down_switches_off_and_the_next_part_begins_at_zero() {
        let coast = Segment::CoastDown(CoastDown { seconds: 1.0 });
        let program = Program::new(&[steps(&[10.0]), coast, steps(&[10.0])], 100.0).unwrap();
        assert_volts(&program, &[(0.499_999_999_9, 10.0), (1.55, 5.0)]);
        assert_eq!(program.value_at(0.5), Output::Coast);
        assert_eq!(Demand::from(program.value_at(1.2)), Demand::Disable);
    }

    #[test]
    fn no_sequence_leaves_its_slew_limit() {
        for (volts, slew, seed) in
            [(48.0, 300.0, 1), (12.0, 2_000.0, 2), (110.0, 50.0, 3), (400.0, 1e4, 4)]
        {
            let program = Program::new(&crate::excitation::rich(volts, slew, seed), slew).unwrap();
            let mut voltage_v = 0.0;
            for piece in &program.pieces {
                let most_v = slew * (piece.end_s - piece.start_s) + 1e-9 * volts;
                let step_v = (piece.from_v - voltage_v).abs();
                let at_s = piece.start_s;
                assert!(step_v <= 1e-9 * volts, "{volts} V: {step_v} V at once at {at_s} s");
                assert!((piece.to_v - piece.from_v).abs() <= most_v, "{volts} V: {piece:?}");
                voltage_v = piece.to_v;
            }
            assert!(voltage_v.abs() < 1e-9 * volts, "{voltage_v} V at the end");
        }
    }

    #[test]
    fn a_wrong_value_is_named_with_its_position() {
        let prbs = Segment::Prbs(Prbs {
            amplitude_v: 1.0,
            clock_s: 0.0,
            seconds: 1.0,
            seed: 0,
            offset_v: 0.0,
            levels: 2,
        });
        let day = Segment::Standstill(Standstill { seconds: 86_400.0 });
        let clock = "sequence part 2 (prbs): clock_s = 0 is not allowed (allowed: more than 0 s, up to the length of \
             its part, at most 1e6 changes)";
        for (parts, slew_v_per_s, message) in [
            (vec![steps(&[1.0]), prbs], 100.0, clock),
            (vec![steps(&[1.0])], 0.0, "slew_v_per_s = 0 is"),
            (vec![], 1.0, "the sequence has no parts"),
            (vec![steps(&[f64::NAN])], 1.0, "sequence part 1 (steps): levels_v = NaN"),
            (vec![day.clone(), day], 1.0, "the sequence lasts 172800 s"),
        ] {
            let error = Program::new(&parts, slew_v_per_s).unwrap_err();
            assert!(error.to_string().starts_with(message), "{error}");
            assert!(!error.help().is_empty());
        }
    }
}
