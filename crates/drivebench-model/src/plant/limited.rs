//! Rows in which a limit of the drive held its output: the command is not what the motor had, the measured voltage is.
//!
//! ```text
//! command    ____/------\____      between limited samples: the line through the measured voltages (at a current limit the
//! measured   ____/--__--/____      drive follows R i + Ke w, which is nearly straight from sample to sample); beside them
//!                 limited          that line, continued, until it crosses the command
//! ```
//!
//! Where the current was far from the limit a sample before, as behind a step or a late start, the motor had the whole command
//! until its current was there. When that was lies between the samples, and a simulation finds it.

use crate::numerics::count::whole;
use crate::sample::{Channel, Run};
use crate::signal::{self, Point};

/// Inputs are held, so that a line is a staircase; its steps are about as long as this, s, and not more than so many.
const STEP_S: f64 = 0.5e-3;
const MOST_STEPS: usize = 50;

/// Share of the current at a limit by which it may differ from sample to sample and count as held, and as close to it before.
const NEAR: f64 = 0.1;

/// The interval within which the output of a drive came to its current limit: the whole command up to when the current was there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimitReached {
    pub from_s: f64,
    pub to_s: f64,
    pub command_v: f64,
    /// Where the limit held the current, A.
    pub current_a: f64,
    /// Square of what the command and the voltage at the limit differ by, V2: what is not known of the voltage between.
    pub variance: f64,
}

/// One stretch of samples between which the limit was never released.
struct Stretch {
    /// Measured voltages.
    samples: Vec<Point>,
    /// Measured currents there and at the sample before, A; not a number where missing.
    current_a: Vec<f64>,
    before_a: f64,
    /// Stamps of the samples beside it, at which the command held.
    before_s: f64,
    after_s: f64,
}

/// The commands `(time, V)`, held until the next, with those replaced that a limit of the drive kept from the motor, and where
/// its current limit was reached from afar.
pub(super) fn applied(run: &Run, commands: &[Point]) -> (Vec<Point>, Vec<LimitReached>) {
    let mut reached = Vec::new();
    let stretches = stretches(run).into_iter();
    let events = stretches.fold(commands.to_vec(), |events, stretch| {
        replaced(&events, &stretch, &mut reached)
    });
    (events, reached)
}

fn stretches(run: &Run) -> Vec<Stretch> {
    let limited = run.limited_rows();
    // A row of a command alone lies between two samples and says nothing of the limit.
    let is_sample = |row: &usize| {
        run.column(Channel::Voltage)
            .is_some_and(|v| v[*row].is_finite())
    };
    let rows = (0..run.rows()).filter(is_sample);
    let rows: Vec<(usize, bool)> = rows
        .map(|row| (row, limited.binary_search(&row).is_ok()))
        .collect();
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
    let held = |time_s: f64| signal::held(events, time_s).unwrap_or(events[0].1);
    let samples = &stretch.samples;
    let (first, last) = (samples[0], samples[samples.len() - 1]);
    // Above (+1) or below (-1) the command: the side on which the limit held the output, so where it let go. A stretch in
    // which the voltage was reversed begins on one side and ends on the other.
    let side = |&(time_s, volts): &Point| sign(volts - held(time_s));
    let sides: Vec<f64> = samples.iter().map(side).collect();
    let mut decided = sides.iter().copied().filter(|side| *side != 0.0);
    let first_side = decided.next().unwrap_or(1.0);
    let last_side = decided.next_back().unwrap_or(first_side);
    let limit = |time_s: f64, side: f64, line_v: f64| {
        let command = held(time_s);
        if side < 0.0 {
            command.min(line_v)
        } else {
            command.max(line_v)
        }
    };
    let mut inside = Vec::new();
    let pieces = |from_s: f64, to_s: f64, volts: &dyn Fn(f64) -> f64| -> Vec<Point> {
        let count = whole(((to_s - from_s) / STEP_S).ceil()).min(MOST_STEPS);
        let share = |at: f64| from_s + (to_s - from_s) * at / count as f64;
        let piece = |k: usize| (share(k as f64), volts(share(k as f64 + 0.5)));
        (0..count).map(piece).collect()
    };
    let current = |at: usize| stretch.current_a.get(at).copied().unwrap_or(f64::NAN);
    // `line` are the pieces that lead to the limit at sample `to`; `behind` is the next one on its side of it.
    let mut reach = |line: &[Point], before_a: f64, to: usize, behind: Option<usize>| {
        let (at_a, behind_a) = (current(to), behind.map_or(f64::NAN, current));
        let is_near = |a: f64| (a - at_a).abs() <= NEAR * at_a.abs();
        let limit_a = match behind {
            Some(_) if is_near(behind_a) => 0.5 * (at_a + behind_a),
            Some(_) => return,
            None => at_a,
        };
        let below = line
            .iter()
            .find(|piece| (held(piece.0) - piece.1).abs() > 0.0);
        if let Some(&(from_s, line_v)) = below
            && before_a.is_finite()
            && limit_a.is_finite()
            && !is_near(before_a)
        {
            reached.push(LimitReached {
                from_s,
                to_s: samples[to].0,
                command_v: held(from_s),
                current_a: limit_a,
                variance: (held(from_s) - line_v).powi(2),
            });
        }
    };
    let line = |a: Point, b: Point, time_s: f64| {
        if b.0 > a.0 {
            a.1 + (b.1 - a.1) * (time_s - a.0) / (b.0 - a.0)
        } else {
            a.1
        }
    };
    let second = *samples.get(1).unwrap_or(&first);
    let towards = pieces(stretch.before_s, first.0, &|t| {
        limit(t, first_side, line(first, second, t))
    });
    let stays = |at: usize| (sides.get(at + 1)? * sides[at] > 0.0).then_some(at + 1);
    reach(&towards, stretch.before_a, 0, stays(0));
    inside.extend(towards);
    for (at, pair) in samples.windows(2).enumerate() {
        let turned_s = (sides[at] * sides[at + 1] < 0.0)
            .then(|| largest_step(events, pair[0].0, pair[1].0))
            .flatten();
        let Some(turned_s) = turned_s else {
            inside.extend(pieces(pair[0].0, pair[1].0, &|t| line(pair[0], pair[1], t)));
            continue;
        };
        // The limit held the output on one side until the command turned, and on the other from then on.
        let (to, from) = (pair[0], pair[1]);
        let before = if at > 0 { samples[at - 1] } else { to };
        let behind = *samples.get(at + 2).unwrap_or(&from);
        inside.extend(pieces(to.0, turned_s, &|t| {
            limit(t, sides[at], line(before, to, t))
        }));
        let towards = pieces(turned_s, from.0, &|t| {
            limit(t, sides[at + 1], line(from, behind, t))
        });
        reach(&towards, current(at), at + 1, stays(at + 1));
        inside.extend(towards);
    }
    let last_but_one = samples[samples.len().saturating_sub(2)];
    inside.extend(pieces(last.0, stretch.after_s, &|t| {
        limit(t, last_side, line(last_but_one, last, t))
    }));
    let after_s = stretch.after_s.max(last.0);
    let before = events.iter().filter(|event| event.0 < stretch.before_s);
    let after = events.iter().filter(|event| event.0 > after_s);
    let (before, after) = (before.copied(), after.copied());
    let end = [(after_s, held(after_s))];
    before.chain(inside).chain(end).chain(after).collect()
}

/// When within `(from_s, to_s]` the command changed most, if it did.
fn largest_step(events: &[Point], from_s: f64, to_s: f64) -> Option<f64> {
    let steps = events
        .windows(2)
        .map(|pair| (pair[1].0, (pair[1].1 - pair[0].1).abs()));
    steps
        .filter(|(time_s, step_v)| *time_s > from_s && *time_s <= to_s && *step_v > 0.0)
        .max_by(|one, other| one.1.total_cmp(&other.1))
        .map(|(time_s, _)| time_s)
}

fn sign(of: f64) -> f64 {
    if of == 0.0 { 0.0 } else { of.signum() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::testing::{held, run_of};
    use crate::plant::{ActiveEffect, Input, Model, Motor, Plant, Scenario, State, effect};
    use crate::sample::Origin;

    /// A ramp of 10 V a sample, held by the drive at `30 + 2 k` V while it is beyond it, and its commands.
    fn ramp() -> (Run, Vec<Point>) {
        let row = |k: u8| f64::from(k);
        let command = |k: u8| if k < 7 { 10.0 * row(k) } else { 0.0 };
        let measured = (0..12).map(|k| command(k).min(30.0 + 2.0 * row(k)));
        let columns = [
            (
                Channel::VoltageCmd,
                (0..12).map(command).collect(),
                Origin::Commanded,
            ),
            (Channel::Voltage, measured.collect(), Origin::Measured),
        ];
        let run = run_of("r", (0..12).map(|k| 0.01 * row(k)).collect(), columns);
        let commands = run.points(Channel::VoltageCmd).collect();
        (run, commands)
    }

    /// That the events have these levels at these instants.
    #[track_caller]
    fn assert_held<const N: usize>(events: &[Point], at: [f64; N], levels: [f64; N], within: f64) {
        for (time_s, volts) in at.into_iter().zip(levels) {
            let found = signal::held(events, time_s).unwrap();
            let off = (found - volts).abs();
            assert!(off < within, "{time_s} s: {found}: {events:?}");
        }
    }

    #[test]
    fn without_a_limit_the_commands_stand() {
        let (run, commands) = ramp();
        assert_eq!(applied(&run, &commands), (commands, vec![]));
    }

    #[test]
    fn between_limited_samples_the_measured_voltage_stands_and_outside_the_command() {
        let (mut run, commands) = ramp();
        run.set_limited_rows(vec![4, 5, 6]);
        let (events, reached) = applied(&run, &commands);
        assert_eq!(reached, [], "no current tells of it");
        let grows = events.windows(2).all(|pair| pair[0].0 < pair[1].0);
        assert!(grows, "{events:?}");
        // Inside: 38 to 40 to 42 V; the command was 40 to 60 V.
        let (inside, volts) = ([0.0451, 0.0551, 0.0651], [39.0, 41.0, 43.0]);
        assert_held(&events, inside, volts, 0.1);
        // Before the line is crossed the command of 30 V holds; after the release it is back.
        let (outside, volts) = ([0.025, 0.035, 0.0725], [20.0, 30.0, 0.0]);
        assert_held(&events, outside, volts, 1e-12);
    }

    #[test]
    fn a_stretch_with_a_reversal_is_limited_on_both_sides() {
        // 60 V, and from 0.045 s -60 V: held at 30 + k V, then at -30 - k V, from 0.02 to 0.08 s.
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
        assert_eq!(reached, [], "no current tells of it");
        // To the instant of the reversal on the one side, on the other from there.
        let (at, volts) = (
            [0.0121, 0.0171, 0.0351, 0.0421, 0.0449],
            [0.0, 31.7, 33.5, 34.2, 34.5],
        );
        assert_held(&events, at, volts, 0.15);
        let (at, volts) = (
            [0.0451, 0.0481, 0.0651, 0.0831, 0.0871, 0.0951],
            [-34.5, -34.8, -36.5, -38.3, -20.0, -20.0],
        );
        assert_held(&events, at, volts, 0.15);
    }

    #[test]
    fn a_limit_that_nobody_measured_changes_nothing() {
        let (run, commands) = ramp();
        let mut run = run.without(Channel::Voltage);
        run.set_limited_rows(vec![4, 5, 6]);
        assert_eq!(applied(&run, &commands), (commands, vec![]));
    }

    /// A motor at a drive that gives the command from `start_s` on and holds the current below 10 A, sampled every 10 ms: by
    /// small steps that know nothing of the plant's.
    fn chopped(commands: &[Point], start_s: f64) -> Run {
        let (r, l, ke, j, mc) = (1.1, 0.0099, 0.3538, 0.0045, 0.455);
        let (limit_a, h_s) = (10.0, 1e-6);
        let (mut i, mut w) = (0.0_f64, 0.0_f64);
        let mut columns = [vec![], vec![], vec![], vec![]];
        let mut limited = Vec::new();
        for row in 0..40_u32 {
            for step in 0..10_000_u32 {
                let time_s = 0.01 * f64::from(row) + h_s * f64::from(step);
                let command_v = signal::held(commands, time_s + 1e-9).unwrap();
                let given_v = if time_s + 1e-9 < start_s {
                    0.0
                } else {
                    command_v
                };
                let held_v = |a: f64| r * a + ke * w + l * (a - i) / h_s;
                let volts = given_v.clamp(held_v(-limit_a), held_v(limit_a));
                let is_limited = (volts - given_v).abs() > 0.0;
                if step == 0 {
                    let told_v = if is_limited { r * i + ke * w } else { given_v };
                    let cells = [command_v, told_v, i, w];
                    columns
                        .iter_mut()
                        .zip(cells)
                        .for_each(|(own, cell)| own.push(cell));
                    limited.extend(is_limited.then_some(row as usize));
                }
                i += h_s * (volts - r * i - ke * w) / l;
                let torque = ke * i;
                let is_held = w <= 0.0 && torque.abs() <= mc;
                w = if is_held {
                    0.0
                } else {
                    w + h_s * (torque - mc * w.signum()) / j
                };
            }
        }
        let channels = [
            (Channel::VoltageCmd, Origin::Commanded),
            (Channel::Voltage, Origin::Measured),
            (Channel::Current, Origin::Measured),
            (Channel::Speed, Origin::Measured),
        ];
        let columns = channels.into_iter().zip(columns);
        let columns = columns.map(|((channel, origin), cells)| (channel, cells, origin));
        let mut run = run_of(
            "r",
            (0..40).map(|row| 0.01 * f64::from(row)).collect(),
            columns,
        );
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
            let [limit] = scenario.limits[..] else {
                panic!("{:?}", scenario.limits)
            };
            assert!((limit.to_s - 0.06).abs() < 1e-9, "{limit:?}");
            assert!((limit.current_a - 10.0).abs() < 0.05, "{limit:?}");
            let mut model = Model::baseline(Motor::zk_22fc());
            if late_s > 0.0 {
                let late = effect::find("start_delay").unwrap();
                model.effects.push(ActiveEffect::with(late, &[late_s]));
            }
            let misses = || -> [f64; 2] {
                let mut plant = Plant::new(&model, Input::Voltage).unwrap();
                let found = plant.simulate(&scenario, State::default());
                [
                    (&found.current_a, &scenario.current_a),
                    (&found.speed_rad_s, &scenario.speed_rad_s),
                ]
                .map(|(found, own)| {
                    let pairs = found.iter().zip(own);
                    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
                })
            };
            let [current_a, speed_rad_s] = misses();
            assert!(
                current_a < 0.1 && speed_rad_s < 0.15,
                "{late_s}: {current_a} {speed_rad_s}"
            );
        }
    }
}
