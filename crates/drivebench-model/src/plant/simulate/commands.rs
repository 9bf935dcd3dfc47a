//! The commands as they reach the motor.

use std::borrow::Cow;

use crate::plant::effect::Path;

/// Time for which zero was commanded before a start from rest, s.
const REST_S: f64 = 0.2;

/// Times at which a command that is not zero follows a rest; what was before the first command was one.
pub fn starts_from_rest(events: &[(f64, f64)]) -> Vec<f64> {
    let mut starts = Vec::new();
    let mut zero_since_s = Some(f64::NEG_INFINITY);
    for &(time_s, value) in events {
        if value == 0.0 {
            zero_since_s.get_or_insert(time_s);
        } else if let Some(since_s) = zero_since_s.take()
            && time_s - since_s >= REST_S
        {
            starts.push(time_s);
        }
    }
    starts
}

/// `events` with zero for a while after each start from rest.
fn waiting(events: &[(f64, f64)], delay_s: f64) -> Vec<(f64, f64)> {
    let starts = starts_from_rest(events);
    let waits = |time_s: f64| {
        let mut before = starts.iter().rev().filter(|start_s| **start_s <= time_s);
        before
            .next()
            .is_some_and(|start_s| time_s < start_s + delay_s)
    };
    let mut out: Vec<(f64, f64)> = events
        .iter()
        .map(|&(time_s, value)| (time_s, if waits(time_s) { 0.0 } else { value }))
        .collect();
    for start_s in &starts {
        let end_s = start_s + delay_s;
        let held = events.iter().rev().find(|event| event.0 <= end_s);
        if let Some((_, value)) = held {
            let at = out.partition_point(|event| event.0 < end_s);
            out.insert(at, (end_s, *value));
        }
    }
    out
}

/// `events` (time, value held from there) later by the command's delay, and zero until the drive has started.
pub(super) fn applied<'a>(events: &'a [(f64, f64)], path: &Path) -> Cow<'a, [(f64, f64)]> {
    if !path.delays_command() {
        return Cow::Borrowed(events);
    }
    let waited = (path.restart_delay_s > 0.0).then(|| waiting(events, path.restart_delay_s));
    let events = waited.as_deref().unwrap_or(events);
    let (begin_s, first) = events[0];
    // What was held before the first command is not known; the first command stands for it.
    let mut out = vec![(begin_s, first)];
    let started_s = events
        .iter()
        .find(|event| event.1 != 0.0)
        .map_or(f64::NEG_INFINITY, |event| event.0 + path.start_delay_s);
    if path.start_delay_s > 0.0 {
        out[0].1 = 0.0;
    }
    let mut held = first;
    for &(time_s, value) in events.iter().skip(1) {
        if path.start_delay_s > 0.0 && time_s > started_s && out.len() == 1 && held != 0.0 {
            out.push((started_s + path.command_delay_s, held));
        }
        held = value;
        let last = out[out.len() - 1].1;
        // Repeats of the same value would only cut the simulation into more steps.
        #[expect(clippy::float_cmp, reason = "a repeat is the same number")]
        let repeats = value == last;
        if !repeats && (path.start_delay_s <= 0.0 || time_s >= started_s) {
            out.push((time_s + path.command_delay_s, value));
        }
    }
    if path.start_delay_s > 0.0 && out.len() == 1 && held != 0.0 {
        out.push((started_s + path.command_delay_s, held));
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::testing::held;

    fn events() -> Vec<(f64, f64)> {
        held(
            [1.0, 1.5, 2.0, 2.1, 2.5, 3.0],
            [0.0, 0.0, 5.0, 6.0, 6.0, -5.0],
        )
    }

    #[test]
    fn a_delay_moves_every_change_and_drops_repeats() {
        let path = Path {
            command_delay_s: 0.25,
            ..Path::default()
        };
        let expected = held([1.0, 2.25, 2.35, 3.25], [0.0, 5.0, 6.0, -5.0]);
        assert_eq!(*applied(&events(), &path), expected);
        let (events, direct) = (events(), Path::default());
        assert!(matches!(applied(&events, &direct), Cow::Borrowed(_)));
    }

    #[test]
    fn every_start_from_rest_waits_and_nothing_else_does() {
        let events = held(
            [0.0, 1.0, 1.1, 2.0, 2.4, 2.45, 3.0],
            [5.0, 0.0, 4.0, 0.0, -5.0, -6.0, 0.0],
        );
        assert_eq!(starts_from_rest(&events), [0.0, 2.4]);
        let path = Path {
            restart_delay_s: 0.1,
            ..Path::default()
        };
        let expected = held(
            [0.0, 0.1, 1.0, 1.1, 2.0, 2.5, 3.0],
            [0.0, 5.0, 0.0, 4.0, 0.0, -6.0, 0.0],
        );
        assert_eq!(*applied(&events, &path), expected);
    }

    #[test]
    fn a_late_start_swallows_the_first_commands() {
        for (start_delay_s, expected) in [
            (
                0.05,
                &[(1.0, 0.0), (2.05, 5.0), (2.1, 6.0), (3.0, -5.0)][..],
            ),
            (0.3, &[(1.0, 0.0), (2.3, 6.0), (3.0, -5.0)]),
            (2.0, &[(1.0, 0.0), (4.0, -5.0)]),
        ] {
            let path = Path {
                start_delay_s,
                ..Path::default()
            };
            assert_eq!(*applied(&events(), &path), *expected, "{start_delay_s}");
        }
    }
}
