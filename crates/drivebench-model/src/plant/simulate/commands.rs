//! Commands as applied to the motor: delayed, and zero until the drive has started.

use std::borrow::Cow;

use crate::plant::effect::Path;
use crate::signal;

/// Instants at which a command that is not zero follows `rest_s` or more of zero; the time before the first command is zero.
pub fn starts_from_rest(events: &[(f64, f64)], rest_s: f64) -> Vec<f64> {
    let mut starts = Vec::new();
    let mut zero_since_s = Some(f64::NEG_INFINITY);
    for &(time_s, value) in events {
        if value == 0.0 {
            zero_since_s.get_or_insert(time_s);
        } else if let Some(since_s) = zero_since_s.take()
            && time_s - since_s >= rest_s
        {
            starts.push(time_s);
        }
    }
    starts
}

/// `events` with zero for a while after each start from rest.
fn waiting(events: &[(f64, f64)], delay_s: f64, rest_s: f64) -> Vec<(f64, f64)> {
    let starts = starts_from_rest(events, rest_s);
    let waits = |time_s: f64| {
        let before = starts.iter().rev().find(|start_s| **start_s <= time_s);
        before.is_some_and(|start_s| time_s < start_s + delay_s)
    };
    let mut out = events.to_vec();
    for event in out.iter_mut().filter(|event| waits(event.0)) {
        event.1 = 0.0;
    }
    for end_s in starts.iter().map(|start_s| start_s + delay_s) {
        if let Some(value) = signal::held(events, end_s) {
            let at = out.partition_point(|event| event.0 < end_s);
            out.insert(at, (end_s, value));
        }
    }
    out
}

/// `events` (time, value held from there) later by the command's delay, and zero until the drive has started.
pub(super) fn applied<'a>(
    events: &'a [(f64, f64)],
    path: &Path,
    rest_s: f64,
) -> Cow<'a, [(f64, f64)]> {
    if !path.delays_command() {
        return Cow::Borrowed(events);
    }
    let waited =
        (path.restart_delay_s > 0.0).then(|| waiting(events, path.restart_delay_s, rest_s));
    let events = waited.as_deref().unwrap_or(events);
    let (begin_s, first) = events[0];
    // Before the first command its value is assumed.
    let mut out = vec![(begin_s, first)];
    let first_start = events.iter().find(|event| event.1 != 0.0);
    let started_s = first_start.map_or(f64::NEG_INFINITY, |event| event.0 + path.start_delay_s);
    if path.start_delay_s > 0.0 {
        out[0].1 = 0.0;
    }
    let mut present = first;
    for &(time_s, value) in events.iter().skip(1) {
        if path.start_delay_s > 0.0 && time_s > started_s && out.len() == 1 && present != 0.0 {
            out.push((started_s + path.command_delay_s, present));
        }
        present = value;
        let last = out[out.len() - 1].1;
        // Repeats of the same value would only cut the simulation into more steps.
        #[expect(clippy::float_cmp, reason = "a repeat is the same number")]
        let repeats = value == last;
        if !repeats && (path.start_delay_s <= 0.0 || time_s >= started_s) {
            out.push((time_s + path.command_delay_s, value));
        }
    }
    if path.start_delay_s > 0.0 && out.len() == 1 && present != 0.0 {
        out.push((started_s + path.command_delay_s, present));
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::testing::held;

    #[test]
    fn commands_are_delayed_and_zero_until_the_drive_has_started() {
        let events = held([1.0, 1.5, 2.0, 2.1, 2.5, 3.0], [0.0, 0.0, 5.0, 6.0, 6.0, -5.0]);
        let restarts =
            held([0.0, 1.0, 1.1, 2.0, 2.4, 2.45, 3.0], [5.0, 0.0, 4.0, 0.0, -5.0, -6.0, 0.0]);
        assert_eq!(starts_from_rest(&restarts, 0.2), [0.0, 2.4]);
        let waited =
            held([0.0, 0.1, 1.0, 1.1, 2.0, 2.5, 3.0], [0.0, 5.0, 0.0, 4.0, 0.0, -6.0, 0.0]);
        // Delays of every command, of the first start and of every start; repeats are dropped.
        for (events, delays, expected) in [
            (&events, [0.25, 0.0, 0.0], &[(1.0, 0.0), (2.25, 5.0), (2.35, 6.0), (3.25, -5.0)][..]),
            (&events, [0.0, 0.05, 0.0], &[(1.0, 0.0), (2.05, 5.0), (2.1, 6.0), (3.0, -5.0)]),
            (&events, [0.0, 0.3, 0.0], &[(1.0, 0.0), (2.3, 6.0), (3.0, -5.0)]),
            (&events, [0.0, 2.0, 0.0], &[(1.0, 0.0), (4.0, -5.0)]),
            (&restarts, [0.0, 0.0, 0.1], &waited),
            (&events, [0.0; 3], &events),
        ] {
            let [command_delay_s, start_delay_s, restart_delay_s] = delays;
            let path = Path { command_delay_s, start_delay_s, restart_delay_s, ..Path::default() };
            assert_eq!(*applied(events, &path, 0.2), *expected, "{delays:?}");
        }
    }
}
