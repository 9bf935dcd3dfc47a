//! Contract of every excitation, whatever its values: tested on each kind of the catalogue.

use super::*;
use proptest::prelude::*;

/// The example of every card, and the same kinds with arbitrary values.
fn any_segment() -> impl Strategy<Value = Segment> {
    let volts = || -20.0..20.0f64;
    let dither = || {
        prop::option::of((0.0..5.0f64, 0.02..0.05f64, any::<u64>()).prop_map(
            |(amplitude_v, clock_s, seed)| Dither {
                amplitude_v,
                clock_s,
                seed,
            },
        ))
    };
    prop_oneof![
        (0.1..2.0f64).prop_map(|seconds| Segment::Standstill(Standstill { seconds })),
        (0.1..2.0f64).prop_map(|seconds| Segment::CoastDown(CoastDown { seconds })),
        (prop::collection::vec(volts(), 1..6), 0.05..0.5f64, dither()).prop_map(
            |(levels_v, hold_s, dither)| Segment::Steps(Steps {
                levels_v,
                hold_s,
                dither
            })
        ),
        (volts(), volts(), 2..9u16, 0.05..0.5f64, dither()).prop_map(
            |(from_v, to_v, levels, hold_s, dither)| Segment::Staircase(Staircase {
                from_v,
                to_v,
                levels,
                hold_s,
                dither
            })
        ),
        (volts(), volts(), 0.1..3.0f64, dither()).prop_map(|(from_v, to_v, seconds, dither)| {
            Segment::Ramp(Ramp {
                from_v,
                to_v,
                seconds,
                dither,
            })
        }),
        (
            0.0..20.0f64,
            0.01..0.1f64,
            0.2..3.0f64,
            any::<u64>(),
            volts(),
            2..9u16
        )
            .prop_map(|(amplitude_v, clock_s, seconds, seed, offset_v, levels)| {
                Segment::Prbs(Prbs {
                    amplitude_v,
                    clock_s,
                    seconds,
                    seed,
                    offset_v,
                    levels,
                })
            }),
        (0.0..20.0f64, 0.1..5.0f64, 0.2..3.0f64).prop_map(
            |(amplitude_v, frequency_hz, seconds)| Segment::Sine(Sine {
                amplitude_v,
                frequency_hz,
                seconds
            })
        ),
        (
            0.0..20.0f64,
            0.5..5.0f64,
            1.1..20.0f64,
            2.0..4.0f64,
            volts()
        )
            .prop_map(
                |(amplitude_v, from_hz, factor, seconds, offset_v)| Segment::Chirp(Chirp {
                    amplitude_v,
                    from_hz,
                    to_hz: from_hz * factor,
                    seconds,
                    offset_v
                })
            ),
    ]
}

#[derive(Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Bench {
    sequence: Vec<Segment>,
}

fn bench(text: &str) -> Result<Bench, crate::config_text::ConfigError> {
    crate::config_text::parse("bench.toml", text)
}

#[test]
fn the_example_of_every_card_is_a_program_of_its_kind() {
    let mut ids = Vec::new();
    for card in Segment::CARDS {
        let bench = bench(&format!("[[sequence]]\n{}\n", card.example)).unwrap();
        assert_eq!(bench.sequence[0].card(), *card);
        Program::new(&bench.sequence, 400.0).unwrap();
        ids.push(card.id);
    }
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), Segment::CARDS.len());
}

#[test]
fn an_unknown_key_or_kind_is_named_with_its_line_and_the_nearest() {
    let error =
        bench("[[sequence]]\nsteps = { levels_v = [1.0], hold_s = 1.0 }\n[[sequence]]\nramp = { from_v = 0.0, to_v = 1.0, second = 2.0 }\n")
            .unwrap_err();
    assert_eq!(
        (error.line, error.message.as_str()),
        (4, "unknown field `second`")
    );
    assert_eq!(error.help, "did you mean `seconds`?");
    let error = bench("[[sequence]]\nstepps = { levels_v = [1.0], hold_s = 1.0 }\n").unwrap_err();
    assert_eq!(error.line, 2);
    assert_eq!(error.help, "did you mean `steps`?");
}

#[test]
fn a_sequence_can_be_written_and_read_back() {
    let sequence = rich(24.0, 400.0, 7);
    let written = Bench { sequence };
    let text = toml::to_string(&written).unwrap();
    assert_eq!(bench(&text).unwrap(), written, "{text}");
}

/// How far the asked-for voltage goes from zero; the slew limit can only make it less.
fn peak_of_target(segments: &[Segment]) -> f64 {
    let pieces = |segment: &Segment| match segment.excitation().target() {
        Target::Voltage(pieces) => pieces,
        Target::Coast => Vec::new(),
    };
    let ends = segments
        .iter()
        .flat_map(pieces)
        .flat_map(|piece| [piece.from_v, piece.to_v]);
    ends.fold(0.0, |peak_v, volts| peak_v.max(volts.abs()))
}

proptest! {
    #[test]
    fn pieces_of_a_target_have_no_gaps_and_the_asked_length(segment in any_segment()) {
        let excitation = segment.excitation();
        prop_assert!(excitation.check().is_ok());
        if let Target::Voltage(pieces) = excitation.target() {
            prop_assert!(pieces[0].start_s == 0.0);
            prop_assert!((pieces[pieces.len() - 1].end_s - excitation.duration_s()).abs() < 1e-9);
            prop_assert!(pieces.iter().all(|piece| piece.end_s > piece.start_s));
            prop_assert!(pieces.windows(2).all(|pair| pair[0].end_s.to_bits() == pair[1].start_s.to_bits()));
        }
    }

    #[test]
    fn a_program_is_finite_seekable_bounded_and_zero_outside(
        segments in prop::collection::vec(any_segment(), 1..5),
        slew_v_per_s in 20.0..1000.0f64,
        order in Just((0..POINTS).collect::<Vec<_>>()).prop_shuffle(),
    ) {
        keeps_the_contract(&segments, slew_v_per_s, &order);
    }
}

#[test]
fn every_card_keeps_the_contract() {
    let backwards: Vec<usize> = (0..POINTS).rev().collect();
    for card in Segment::CARDS {
        let bench = bench(&format!("[[sequence]]\n{}\n", card.example)).unwrap();
        keeps_the_contract(&bench.sequence, 400.0, &backwards);
    }
}

const POINTS: usize = 400;

fn keeps_the_contract(segments: &[Segment], slew_v_per_s: f64, order: &[usize]) {
    let program = Program::new(segments, slew_v_per_s).unwrap();
    let duration_s = program.duration_s();
    let lengths = segments
        .iter()
        .map(|segment| segment.excitation().duration_s());
    let asked_s: f64 = lengths.sum();
    let peak_v = program.peak_v();
    assert!(duration_s >= asked_s - 1e-9);
    assert!(duration_s <= asked_s + peak_v / slew_v_per_s + 1e-9);
    assert!(peak_v <= peak_of_target(segments) + 1e-9);

    let step_s = (duration_s + 0.2) / POINTS as f64;
    let at = |index: usize| -0.1 + index as f64 * step_s;
    let in_order: Vec<_> = (0..POINTS)
        .map(|index| program.value_at(at(index)))
        .collect();
    for index in order {
        assert_eq!(program.value_at(at(*index)), in_order[*index]);
    }
    for (index, output) in in_order.iter().enumerate() {
        let outside = at(index) < 0.0 || at(index) >= duration_s;
        assert_eq!(program.segment_at(at(index)).is_none(), outside);
        match output {
            Output::Voltage(_) if outside => assert_eq!(*output, Output::Voltage(0.0)),
            Output::Voltage(volts) => assert!(volts.abs() <= peak_v + 1e-9),
            Output::Coast => assert!(!outside),
        }
    }
    // The slew limit holds between any two neighbours, the 0 V before and after included.
    for (index, pair) in in_order.windows(2).enumerate() {
        let coast_between = program
            .spans()
            .iter()
            .any(|span| span.coast && span.end_s > at(index) && span.start_s < at(index + 1));
        if let ([Output::Voltage(a), Output::Voltage(b)], false) = (pair, coast_between) {
            let most_v = slew_v_per_s * step_s * (1.0 + 1e-6) + 1e-9;
            assert!((b - a).abs() <= most_v, "{a} to {b} at {} s", at(index));
        }
    }
}
