//! Applied voltage while a limit of the drive restricts its output: the measured one instead of the command.
//!
//! ```text
//! command    ____/------\____      between limited samples: the line through the measured voltages (at a current limit the
//! measured   ____/--__--/____      drive follows R i + Ke w, which is nearly straight from sample to sample); before and
//!                 limited          after them the extrapolated line, until it crosses the command
//! ```
//!
//! Where the current was far from the limit one sample before, as after a step or a late start, the motor had the whole command
//! until its current reached the limit, at an instant between the samples that the simulation computes.

use crate::numerics::count::whole;
use crate::sample::{Channel, Run};
use crate::signal::{self, Point};

/// The interval within which a drive reached its current limit: up to that instant the motor had the whole command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimitReached {
    pub from_s: f64,
    pub to_s: f64,
    pub command_v: f64,
    /// The current at the limit, A.
    pub current_a: f64,
    /// Variance of the voltage within the interval, V2: the square of the difference of command and voltage at the limit.
    pub variance: f64,
}

/// One stretch of samples between which the limit was never released.
struct Stretch {
    /// Measured voltages.
    samples: Vec<Point>,
    /// Measured currents there and at the sample before, A; not a number where missing.
    current_a: Vec<f64>,
    before_a: f64,
    /// Stamps of the samples before and after it, which had the whole command.
    before_s: f64,
    after_s: f64,
}

/// The commands `(time, V)`, held until the next, with the measured voltage instead where a limit of the drive was active, and
/// the intervals in which its current limit was reached.
pub(super) fn applied(run: &Run, commands: &[Point]) -> (Vec<Point>, Vec<LimitReached>) {
    let mut reached = Vec::new();
    let stretches = stretches(run).into_iter();
    let events = stretches
        .fold(commands.to_vec(), |events, stretch| replaced(&events, &stretch, &mut reached));
    (events, reached)
}

fn stretches(run: &Run) -> Vec<Stretch> {
    let limited = run.limited_rows();
    // A row of a command alone, between two samples, has no report of a limit.
    let volts = run.column(Channel::Voltage).unwrap_or_default();
    let rows = (0..volts.len()).filter(|row| volts[*row].is_finite());
    let is_limited = |row: usize| limited.binary_search(&row).is_ok();
    let rows: Vec<(usize, bool)> = rows.map(|row| (row, is_limited(row))).collect();
    let points: Vec<Point> = run.points(Channel::Voltage).collect();
    let currents = run.column(Channel::Current).unwrap_or_default();
    let current = |at: usize| currents.get(rows[at].0).copied().unwrap_or(f64::NAN);
    let mut end = 0;
    rows.chunk_by(|one, next| one.1 == next.1)
        .filter_map(|group| {
            let begin = end;
            end += group.len();
            let samples = points[begin..end].to_vec();
            group[0].1.then(|| Stretch {
                current_a: (begin..end).map(current).collect(),
                before_a: begin.checked_sub(1).map_or(f64::NAN, current),
                before_s: points[begin.saturating_sub(1)].0,
                after_s: points.get(end).unwrap_or(&samples[samples.len() - 1]).0,
                samples,
            })
        })
        .collect()
}

fn replaced(events: &[Point], stretch: &Stretch, reached: &mut Vec<LimitReached>) -> Vec<Point> {
    let command_at = |time_s: f64| signal::held(events, time_s).unwrap_or(events[0].1);
    let samples = &stretch.samples;
    let (first, last) = (samples[0], samples[samples.len() - 1]);
    // Above (+1) or below (-1) the command. A stretch with a reversal of the voltage begins on one side and ends on the other.
    let side = |&(time_s, volts): &Point| sign(volts - command_at(time_s));
    let sides: Vec<f64> = samples.iter().map(side).collect();
    let mut decided = sides.iter().copied().filter(|side| *side != 0.0);
    let first_side = decided.next().unwrap_or(1.0);
    let last_side = decided.next_back().unwrap_or(first_side);
    let limit = |time_s: f64, side: f64, line_v: f64| {
        let command = command_at(time_s);
        if side < 0.0 { command.min(line_v) } else { command.max(line_v) }
    };
    let mut inside = Vec::new();
    let pieces = |from_s: f64, to_s: f64, volts: &dyn Fn(f64) -> f64| -> Vec<Point> {
        // Inputs are zero-order holds, so that a line is a staircase: steps of 0.5 ms, at most 50.
        let count = whole(((to_s - from_s) / 0.5e-3).ceil()).min(50);
        let instant = |step: f64| from_s + (to_s - from_s) * step / count as f64;
        let piece = |k: usize| (instant(k as f64), volts(instant(k as f64 + 0.5)));
        (0..count).map(piece).collect()
    };
    let current = |at: usize| stretch.current_a.get(at).copied().unwrap_or(f64::NAN);
    // `line` are the pieces that lead to the limit at sample `to`; `next` is the sample after it, if on the same side.
    let mut reach = |line: &[Point], before_a: f64, to: usize, next: Option<usize>| {
        let (at_a, next_a) = (current(to), next.map_or(f64::NAN, current));
        // A current within a tenth of the limit counts as limited.
        let is_near = |a: f64| (a - at_a).abs() <= 0.1 * at_a.abs();
        let limit_a = match next {
            Some(_) if is_near(next_a) => 0.5 * (at_a + next_a),
            Some(_) => return,
            None => at_a,
        };
        let is_below = |piece: &&Point| (command_at(piece.0) - piece.1).abs() > 0.0;
        if let Some(&(from_s, line_v)) = line.iter().find(is_below)
            && before_a.is_finite()
            && limit_a.is_finite()
            && !is_near(before_a)
        {
            reached.push(LimitReached {
                from_s,
                to_s: samples[to].0,
                command_v: command_at(from_s),
                current_a: limit_a,
                variance: (command_at(from_s) - line_v).powi(2),
            });
        }
    };
    let line = |a: Point, b: Point, time_s: f64| {
        if b.0 > a.0 { a.1 + (b.1 - a.1) * (time_s - a.0) / (b.0 - a.0) } else { a.1 }
    };
    let second = *samples.get(1).unwrap_or(&first);
    let approach =
        pieces(stretch.before_s, first.0, &|t| limit(t, first_side, line(first, second, t)));
    let next_on_side = |at: usize| (sides.get(at + 1)? * sides[at] > 0.0).then_some(at + 1);
    reach(&approach, stretch.before_a, 0, next_on_side(0));
    inside.extend(approach);
    for (at, pair) in samples.windows(2).enumerate() {
        let reversal_s = (sides[at] * sides[at + 1] < 0.0)
            .then(|| largest_step(events, pair[0].0, pair[1].0))
            .flatten();
        let Some(reversal_s) = reversal_s else {
            inside.extend(pieces(pair[0].0, pair[1].0, &|t| line(pair[0], pair[1], t)));
            continue;
        };
        // Limited on one side until the reversal of the command, on the other side after it.
        let (to, from) = (pair[0], pair[1]);
        let before = if at > 0 { samples[at - 1] } else { to };
        let after = *samples.get(at + 2).unwrap_or(&from);
        inside.extend(pieces(to.0, reversal_s, &|t| limit(t, sides[at], line(before, to, t))));
        let approach =
            pieces(reversal_s, from.0, &|t| limit(t, sides[at + 1], line(from, after, t)));
        reach(&approach, current(at), at + 1, next_on_side(at + 1));
        inside.extend(approach);
    }
    let last_but_one = samples[samples.len().saturating_sub(2)];
    inside.extend(pieces(last.0, stretch.after_s, &|t| {
        limit(t, last_side, line(last_but_one, last, t))
    }));
    let after_s = stretch.after_s.max(last.0);
    let before = events.iter().filter(|event| event.0 < stretch.before_s);
    let after = events.iter().filter(|event| event.0 > after_s);
    let end = (after_s, command_at(after_s));
    before.copied().chain(inside).chain([end]).chain(after.copied()).collect()
}

/// The instant of the largest change of the command within `(from_s, to_s]`, if it changed.
fn largest_step(events: &[Point], from_s: f64, to_s: f64) -> Option<f64> {
    let steps = events.windows(2).map(|pair| (pair[1].0, (pair[1].1 - pair[0].1).abs()));
    let within = steps.filter(|step| step.0 > from_s && step.0 <= to_s && step.1 > 0.0);
    within.max_by(|one, other| one.1.total_cmp(&other.1)).map(|step| step.0)
}

fn sign(of: f64) -> f64 {
    if of == 0.0 { 0.0 } else { of.signum() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::statistics::largest;
    use crate::plant::testing::{held, run_of, with};
    use crate::plant::{Input, Model, Motor, Plant, Scenario, State};
    use crate::sample::Origin;

    /// A ramp of 10 V a sample, limited by the drive to `30 + 2 k` V, and its commands.
    fn ramp() -> (Run, Vec<Point>) {
        let command = |k: f64| if k < 7.0 { 10.0 * k } else { 0.0 };
        let rows = || (0..12).map(f64::from);
        let measured = rows().map(|k| command(k).min(30.0 + 2.0 * k)).collect();
        let columns = [
            (Channel::VoltageCmd, rows().map(command).collect(), Origin::Commanded),
            (Channel::Voltage, measured, Origin::Measured),
        ];
        let mut run = run_of("r", rows().map(|k| 0.01 * k).collect(), columns);
        run.set_limited_rows(vec![4, 5, 6]);
        let commands = run.points(Channel::VoltageCmd).collect();
        (run, commands)
    }

    #[track_caller]
    fn assert_held(events: &[Point], points: &[Point], within: f64) {
        for (time_s, volts) in points {
            let found = signal::held(events, *time_s).unwrap();
            assert!((found - volts).abs() < within, "{time_s} s: {found}: {events:?}");
        }
    }

    #[test]
    fn without_a_limit_or_a_measurement_the_commands_stand() {
        let (mut run, commands) = ramp();
        let without_voltage = run.without(Channel::Voltage);
        run.set_limited_rows(vec![]);
        for run in [run, without_voltage] {
            assert_eq!(applied(&run, &commands), (commands.clone(), vec![]));
        }
    }

    #[test]
    fn between_limited_samples_the_measured_voltage_holds() {
        let (run, commands) = ramp();
        let (events, reached) = applied(&run, &commands);
        assert_eq!(reached, [], "no current was measured");
        assert!(events.windows(2).all(|pair| pair[0].0 < pair[1].0), "{events:?}");
        // Inside: 38 to 40 to 42 V; the command was 40 to 60 V.
        assert_held(&events, &[(0.0451, 39.0), (0.0551, 41.0), (0.0651, 43.0)], 0.1);
        // Before the line crosses it, and after the release, the command holds.
        assert_held(&events, &[(0.025, 20.0), (0.035, 30.0), (0.0725, 0.0)], 1e-12);
    }

    #[test]
    fn a_stretch_with_a_reversal_is_limited_on_both_sides() {
        // 60 V, and from 0.045 s -60 V: limited to 30 + k V, then to -30 - k V, from 0.02 to 0.08 s.
        let measured = (0..12_u8).map(|k| match k {
            0..2 => 0.0,
            2..5 => 30.0 + f64::from(k),
            5..9 => -30.0 - f64::from(k),
            _ => -20.0,
        });
        let column = (Channel::Voltage, measured.collect(), Origin::Measured);
        let times = (0..12).map(|k| 0.01 * f64::from(k)).collect();
        let mut run = run_of("r", times, [column]);
        run.set_limited_rows((2..9).collect());
        let commands = held([0.0, 0.015, 0.045, 0.085], [0.0, 60.0, -60.0, -20.0]);
        let (events, reached) = applied(&run, &commands);
        assert_eq!(reached, [], "no current was measured");
        // To the instant of the reversal on the one side, on the other from there.
        assert_held(&events, &[(0.0121, 0.0), (0.0171, 31.7), (0.0351, 33.5)], 0.15);
        assert_held(&events, &[(0.0421, 34.2), (0.0449, 34.5), (0.0451, -34.5)], 0.15);
        assert_held(&events, &[(0.0481, -34.8), (0.0651, -36.5), (0.0831, -38.3)], 0.15);
        assert_held(&events, &[(0.0871, -20.0), (0.0951, -20.0)], 0.15);
    }

    /// A motor on a drive that applies the command from `start_s` on and limits the current to 10 A, sampled every 10 ms, by
    /// small Euler steps.
    fn chopped(commands: &[Point], start_s: f64) -> Run {
        let (r, l, ke, j, mc) = (1.1, 0.0099, 0.3538, 0.0045, 0.455);
        let (limit_a, h_s) = (10.0, 1e-6);
        let (mut i, mut w) = (0.0_f64, 0.0_f64);
        let mut columns = [vec![], vec![], vec![], vec![]];
        let mut limited = Vec::new();
        for step in 0..400_000_u32 {
            let time_s = h_s * f64::from(step) + 1e-9;
            let command_v = signal::held(commands, time_s).unwrap();
            let wanted_v = if time_s < start_s { 0.0 } else { command_v };
            let voltage_for = |a: f64| r * a + ke * w + l * (a - i) / h_s;
            let volts = wanted_v.clamp(voltage_for(-limit_a), voltage_for(limit_a));
            if step % 10_000 == 0 {
                let is_limited = (volts - wanted_v).abs() > 0.0;
                let measured_v = if is_limited { r * i + ke * w } else { wanted_v };
                for (column, cell) in columns.iter_mut().zip([command_v, measured_v, i, w]) {
                    column.push(cell);
                }
                limited.extend(is_limited.then_some(step as usize / 10_000));
            }
            i += h_s * (volts - r * i - ke * w) / l;
            let is_stuck = w <= 0.0 && (ke * i).abs() <= mc;
            w = if is_stuck { 0.0 } else { w + h_s * (ke * i - mc * w.signum()) / j };
        }
        let [command, voltage, current, speed] = columns;
        let columns = [
            (Channel::VoltageCmd, command, Origin::Commanded),
            (Channel::Voltage, voltage, Origin::Measured),
            (Channel::Current, current, Origin::Measured),
            (Channel::Speed, speed, Origin::Measured),
        ];
        let mut run = run_of("r", (0..40).map(|row| 0.01 * f64::from(row)).collect(), columns);
        run.set_limited_rows(limited);
        run
    }

    #[test]
    fn the_whole_command_acts_until_the_current_is_at_the_limit() {
        let step = held([0.0, 0.05], [0.0, 60.0]);
        // The same level from the first sample on, under a drive that starts within an interval.
        let level = held([0.0, 0.01], [0.0, 35.0]);
        for (commands, late_s) in [(step, 0.0), (level, 0.0443)] {
            let run = chopped(&commands, commands[1].0 + late_s);
            let scenario = Scenario::from_run(&run).unwrap();
            let [limit] = scenario.limits[..] else { panic!("{:?}", scenario.limits) };
            let is_near = (limit.to_s - 0.06).abs() < 1e-9 && (limit.current_a - 10.0).abs() < 0.05;
            assert!(is_near, "{limit:?}");
            let mut model = Model::baseline(Motor::zk_22fc());
            if late_s > 0.0 {
                model = with(&model, "start_delay", &[late_s]);
            }
            let mut plant = Plant::new(&model, Input::Voltage).unwrap();
            let found = plant.simulate(&scenario, State::default());
            let difference =
                |one: &[f64], other: &[f64]| largest(one.iter().zip(other).map(|(a, b)| a - b));
            let current_a = difference(&found.current_a, &scenario.current_a);
            let speed_rad_s = difference(&found.speed_rad_s, &scenario.speed_rad_s);
            let is_near = current_a < 0.1 && speed_rad_s < 0.15;
            assert!(is_near, "{late_s}: {current_a} {speed_rad_s}");
        }
    }
}
