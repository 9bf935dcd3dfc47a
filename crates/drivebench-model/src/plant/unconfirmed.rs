//! Changes of the command that the drive did not confirm: intervals in which the input is that before, that after, or neither.
//!
//! ```text
//! commands     u0        u1 unconfirmed   u1 (or another), confirmed
//! input        |---------|????????????????|-------                     it acted at once (a lost reply), or only as it was
//! samples        x   x           (x)          x restart                repeated (a lost request)
//! ```

use super::unknown_input::UnknownInput;
use crate::sample::{Channel, Run};
use crate::signal::Point;

/// The interval of a chain of commands that were not confirmed, up to the first sample after the next one that was, from which the
/// simulation restarts; and the time of that command, s.
pub(super) struct Unconfirmed {
    pub(super) interval: UnknownInput,
    confirmed_s: f64,
}

/// In order. Where every command of a chain is that before it, it does not matter when they acted.
pub(super) fn find(run: &Run, channel: Channel) -> Vec<Unconfirmed> {
    let column = run.column(channel).unwrap_or_default();
    let is_unconfirmed = |row: usize| run.unconfirmed_rows().binary_search(&row).is_ok();
    let rows: Vec<usize> = (0..column.len()).filter(|row| column[*row].is_finite()).collect();
    let mut found = Vec::new();
    let mut end = 0_usize;
    for chain in rows.chunk_by(|one, next| is_unconfirmed(*one) == is_unconfirmed(*next)) {
        let before = end.checked_sub(1).map(|at| column[rows[at]]);
        end += chain.len();
        let changes =
            |row: &&usize| before.is_some_and(|before| (before - column[**row]).abs() > 0.0);
        let from = chain.iter().find(changes).filter(|row| is_unconfirmed(**row));
        if let (Some(from), Some(before)) = (from, before) {
            let confirmed = rows.get(end).copied();
            let possible = chain.iter().copied().chain(confirmed).map(|row| column[row]);
            let [least, most] = possible
                .fold([before; 2], |[least, most], value| [least.min(value), most.max(value)]);
            found.push(Unconfirmed::new(run, *from, confirmed, [least, most]));
        }
    }
    found
}

impl Unconfirmed {
    fn new(run: &Run, from: usize, confirmed: Option<usize>, [least, most]: [f64; 2]) -> Self {
        let times = run.time_s();
        let measured = |row: usize| {
            let cell = |channel| run.column(channel).map_or(f64::NAN, |cells| cells[row]);
            [Channel::Current, Channel::Speed].map(cell)
        };
        let is_sample = |row: &usize| measured(*row).iter().any(|cell| cell.is_finite());
        let restart = confirmed.and_then(|row| (row..run.rows()).find(is_sample));
        let to_s = restart.map_or(f64::INFINITY, |row| times[row]);
        let restart = restart.map_or([f64::NAN; 2], measured);
        // One of two values at any time: the variance is the square of half of their difference.
        let (mean, variance) = (f64::midpoint(least, most), (0.5 * (most - least)).powi(2));
        Self {
            interval: UnknownInput::of_unconfirmed([times[from], to_s], mean, variance, restart),
            confirmed_s: confirmed.map_or(f64::INFINITY, |row| times[row]),
        }
    }

    /// The input with the estimate of the interval in it.
    pub(super) fn put_into(&self, events: &mut Vec<Point>) {
        let from_s = self.interval.from_s;
        events.retain(|event| event.0 < from_s || event.0 >= self.confirmed_s);
        let at = events.partition_point(|event| event.0 < from_s);
        events.insert(at, (from_s, self.interval.mean));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::Scenario;
    use crate::plant::testing::run_of;
    use crate::sample::Origin;

    /// Samples at 10, 20 ... ms and commands 1 ms after them, of which those of `unconfirmed` have no sample behind them.
    fn run(volts: &[f64], unconfirmed: &[usize]) -> Run {
        let (mut times, mut commands, mut speeds) = (vec![0.0], vec![f64::NAN], vec![0.0]);
        let mut rows = Vec::new();
        for (at, volts) in volts.iter().enumerate() {
            let time_s = 0.01 * at as f64;
            if unconfirmed.contains(&at) {
                rows.push(times.len());
            }
            times.push(time_s + 0.001);
            commands.push(*volts);
            speeds.push(f64::NAN);
            if !unconfirmed.contains(&at) {
                times.push(time_s + 0.01);
                commands.push(f64::NAN);
                speeds.push(at as f64);
            }
        }
        let columns = [
            (Channel::VoltageCmd, commands, Origin::Commanded),
            (Channel::Speed, speeds, Origin::Measured),
        ];
        let mut run = run_of("r", times, columns);
        run.set_unconfirmed_rows(rows);
        run
    }

    #[test]
    fn a_change_without_confirmation_is_unknown_up_to_the_next_sample() {
        let mut volts = vec![1.0; 40];
        volts[10..].fill(5.0);
        volts[20..22].copy_from_slice(&[-3.0, 9.0]);
        let scenario = Scenario::from_run(&run(&volts, &[10, 15, 20, 21])).unwrap();
        let [one, chain] = scenario.unknown_input[..] else {
            panic!("{:?}", scenario.unknown_input)
        };
        assert!(one.is_unconfirmed() && !scenario.has_sampled_input());
        let is_near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        // From 1 to 5 V at 0.101 or 0.111 s; the sample after it is at 0.12 s.
        assert!(
            is_near(one.from_s, 0.101) && is_near(one.to_s, 0.12) && is_near(one.variance, 4.0)
        );
        assert!(is_near(scenario.input_at(0.105), 3.0) && is_near(scenario.input_at(0.1111), 5.0));
        assert!(is_near(one.restart.unwrap()[1], 11.0));
        // 5, -3, 9 or 5 V.
        assert!(is_near(chain.variance, 36.0) && is_near(chain.to_s, 0.23));
        assert!(is_near(scenario.input_at(0.215), 3.0) && is_near(scenario.input_at(0.2211), 5.0));
    }

    #[test]
    fn a_command_of_the_last_row_or_of_the_first_needs_no_confirmation() {
        let mut volts = vec![2.0; 40];
        volts[39] = 0.0;
        let scenario = Scenario::from_run(&run(&volts, &[0, 39])).unwrap();
        assert_eq!(scenario.unknown_input.len(), 1);
        let last_s = scenario.sample_time_s[scenario.samples() - 1];
        assert!(scenario.unknown_input[0].from_s > last_s);
    }
}
