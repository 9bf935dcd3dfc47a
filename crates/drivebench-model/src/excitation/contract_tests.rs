//! Contract of every excitation, whatever its values: tested on each kind of the catalogue.

use super::*;
use proptest::prelude::*;

#[derive(Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Bench {
    sequence: Vec<Segment>,
}

fn bench(text: &str) -> Result<Bench, crate::config_text::ConfigError> {
    crate::config_text::parse("bench.toml", text)
}

fn segment(text: &str) -> Segment {
    let bench = bench(&format!("[[sequence]]\n{text}\n"));
    bench.unwrap_or_else(|error| panic!("{text}: {error}")).sequence.remove(0)
}

/// Each kind as it stands in a bench file.
const EXAMPLES: [&str; 8] = [
    "standstill = { seconds = 0.5 }",
    "coast_down = { seconds = 2.0 }",
    "steps = { levels_v = [12.0, 0.0, -12.0], hold_s = 0.5, dither = { amplitude_v = 2.0, clock_s = 0.03, seed = 1 } }",
    "staircase = { from_v = -12.0, to_v = 12.0, levels = 9, hold_s = 0.5 }",
    "ramp = { from_v = -4.0, to_v = 4.0, seconds = 2.0 }",
    "prbs = { amplitude_v = 8.0, clock_s = 0.04, seconds = 4.0, seed = 1, offset_v = 0.0, levels = 5 }",
    "sine = { amplitude_v = 12.0, frequency_hz = 0.4, seconds = 5.0 }",
    "chirp = { amplitude_v = 6.0, from_hz = 0.5, to_hz = 40.0, seconds = 20.0, offset_v = 20.0 }",
];

/// Every kind with arbitrary values: voltages, shares of their ranges, number of levels, seed.
fn any_segment() -> impl Strategy<Value = Segment> {
    let volts = prop::array::uniform5(-20.0..20.0f64);
    let shares = prop::array::uniform4(0.0..1.0f64);
    (0..8, volts, shares, 2..9u16, any::<u32>(), any::<bool>()).prop_map(
        |(kind, volts, [x, y, z, share], levels, seed, has_dither)| {
            let [from_v, to_v, offset_v, ..] = volts;
            let (clock_s, amplitude_v) = (0.02 + 0.03 * x, 20.0 * y);
            let (seconds, hold_s) = (0.2 + 2.8 * z, 0.05 + 0.45 * z);
            let dither = format!(", dither = {{ amplitude_v = {y:?}, clock_s = {clock_s:?}, seed = {seed} }}");
            let dither = if has_dither { dither } else { String::new() };
            let (from_hz, long_s) = (0.5 + 4.5 * x, 2.0 + 2.0 * z);
            let to_hz = from_hz * (1.1 + 18.9 * share);
            let line = format!("from_v = {from_v:?}, to_v = {to_v:?}");
            let peak = format!("amplitude_v = {amplitude_v:?}");
            let raised = format!("{peak}, offset_v = {offset_v:?}");
            let time = format!("seconds = {seconds:?}");
            let steps = &volts[usize::from(levels) % 5..];
            let part = match kind {
                0 => format!("standstill = {{ {time} }}"),
                1 => format!("coast_down = {{ {time} }}"),
                2 => format!("steps = {{ levels_v = {steps:?}, hold_s = {hold_s:?}{dither} }}"),
                3 => format!("staircase = {{ {line}, levels = {levels}, hold_s = {hold_s:?}{dither} }}"),
                4 => format!("ramp = {{ {line}, {time}{dither} }}"),
                5 => format!("sine = {{ {peak}, frequency_hz = {from_hz:?}, {time} }}"),
                6 => format!("prbs = {{ {raised}, clock_s = {clock_s:?}, {time}, seed = {seed}, levels = {levels} }}"),
                _ => format!("chirp = {{ {raised}, from_hz = {from_hz:?}, to_hz = {to_hz:?}, seconds = {long_s:?} }}"),
            };
            segment(&part)
        },
    )
}

#[test]
fn examples_of_all_kinds_are_programs_and_read_back() {
    let backwards: Vec<usize> = (0..POINTS).rev().collect();
    for example in EXAMPLES {
        let segment = segment(example);
        assert!(example.starts_with(&format!("{} = ", segment.key())));
        keeps_the_contract(&[segment], 400.0, &backwards);
    }
    let written = Bench { sequence: rich(24.0, 400.0, 7) };
    let text = toml::to_string(&written).unwrap();
    assert_eq!(bench(&text).unwrap(), written, "{text}");
}

#[test]
fn an_unknown_key_or_kind_is_named_with_line_and_nearest() {
    let good = "[[sequence]]\nsteps = { levels_v = [1.0], hold_s = 1.0 }\n";
    let ramp = "[[sequence]]\nramp = { from_v = 0.0, to_v = 1.0, second = 2.0 }\n";
    for (text, line, help) in [
        (format!("{good}{ramp}"), 4, "did you mean `seconds`?"),
        (good.replace("steps", "stepps"), 2, "did you mean `steps`?"),
    ] {
        let error = bench(&text).unwrap_err();
        assert_eq!((error.line, error.help.as_str()), (line, help));
    }
}

/// Largest set-point; the slew limit can only make it less.
fn peak_of_target(segments: &[Segment]) -> f64 {
    let pieces = |segment: &Segment| match segment.excitation().target() {
        Target::Voltage(pieces) => pieces,
        Target::Coast => Vec::new(),
    };
    let ends = segments.iter().flat_map(pieces).flat_map(|piece| [piece.from_v, piece.to_v]);
    ends.fold(0.0, |peak_v, volts| peak_v.max(volts.abs()))
}

proptest! {
    #[test]
    fn pieces_of_a_target_have_no_gaps_and_the_set_length(segment in any_segment()) {
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

const POINTS: usize = 400;

fn keeps_the_contract(segments: &[Segment], slew_v_per_s: f64, order: &[usize]) {
    let program = Program::new(segments, slew_v_per_s).unwrap();
    let (duration_s, peak_v) = (program.duration_s(), program.peak_v());
    let set_s: f64 = segments.iter().map(|part| part.excitation().duration_s()).sum();
    let most_s = set_s + peak_v / slew_v_per_s;
    assert!((set_s - 1e-9..=most_s + 1e-9).contains(&duration_s));
    assert!(peak_v <= peak_of_target(segments) + 1e-9);

    let step_s = (duration_s + 0.2) / POINTS as f64;
    let at = |index: usize| -0.1 + index as f64 * step_s;
    let in_order: Vec<_> = (0..POINTS).map(|index| program.value_at(at(index))).collect();
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
        let mut coasts = program.spans().iter().filter(|span| span.coast);
        let is_coast = coasts.any(|span| span.end_s > at(index) && span.start_s < at(index + 1));
        if let ([Output::Voltage(a), Output::Voltage(b)], false) = (pair, is_coast) {
            let most_v = slew_v_per_s * step_s * (1.0 + 1e-6) + 1e-9;
            assert!((b - a).abs() <= most_v, "{a} to {b} at {} s", at(index));
        }
    }
}
