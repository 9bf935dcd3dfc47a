//! Commands and samples on one strictly increasing time axis.
//!
//! ```text
//! command k sent -> (waits) -> sample k: "applied k at t" -> row t: command k -> row of the sample
//! ```
//!
//! A command waits for the sample that reports when it was applied; that is never later than the sample, so a sample never
//! waits.

use std::collections::VecDeque;

use super::csv_write::{LIMITED, UNCONFIRMED};
use super::{Layout, Row};
use drivebench_model::sample::{Applied, Channel, Command, Demand, Quality, Sample};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandRow {
    pub command: Command,
    /// When it was sent, on the samples' time axis, s; used where the drive does not report when it was applied.
    pub time_s: f64,
    /// The speed reference from then on; by default that of a speed demand.
    pub reference_rad_s: Option<f64>,
}

#[cfg(test)]
impl CommandRow {
    pub(super) fn volts(seq: u64, time_s: f64, volts: f64) -> Self {
        let command = Command { seq, demand: Demand::Voltage(volts) };
        Self { command, time_s, reference_rad_s: None }
    }
}

/// Orders the rows; its state is the waiting commands and the time of the last row.
#[derive(Clone, Debug)]
pub struct RowOrder {
    layout: Layout,
    waiting: VecDeque<CommandRow>,
    /// Completed by the last call.
    rows: Vec<Row>,
    last_s: f64,
}

impl RowOrder {
    pub fn new(layout: Layout) -> Self {
        let (waiting, rows) = (VecDeque::new(), Vec::new());
        Self { layout, waiting, rows, last_s: f64::NEG_INFINITY }
    }

    pub fn command(&mut self, row: CommandRow) {
        self.waiting.push_back(row);
    }

    /// The rows completed by this sample; the last is that of the sample. None where its time is not after the last row.
    pub fn sample(&mut self, sample: &Sample) -> &[Row] {
        self.rows.clear();
        // False for NaN too.
        let is_new = sample.time_s > self.last_s && sample.time_s.is_finite();
        if !is_new {
            return &self.rows;
        }
        let mut sample_row = self.sample_row(sample);
        if let Some(applied) = sample.applied {
            self.place_applied(applied, &mut sample_row);
        } else {
            while self.waiting.front().is_some_and(|row| row.time_s <= sample_row.time_s) {
                self.place_front(None, &mut sample_row);
            }
        }
        // A drive that does not echo sequence numbers must not fill the memory.
        while self.waiting.len() > 64 {
            self.place_front(Some(UNCONFIRMED), &mut sample_row);
        }
        self.last_s = sample_row.time_s;
        self.rows.push(sample_row);
        &self.rows
    }

    /// Completed by the last call.
    pub(super) fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// The commands that still wait, at the time when they were sent.
    pub fn finish(&mut self) -> &[Row] {
        self.rows.clear();
        while let Some(waiting) = self.waiting.pop_front() {
            let mut row = Row::at(self.after_last(waiting.time_s));
            self.fill(&waiting, Some(UNCONFIRMED), &mut row);
            if self.has_value(&row) {
                self.last_s = row.time_s;
                self.rows.push(row);
            }
        }
        &self.rows
    }

    fn place_applied(&mut self, applied: Applied, sample_row: &mut Row) {
        while let Some(front) = self.waiting.front_mut() {
            if front.command.seq > applied.seq {
                break;
            }
            let confirmed = front.command.seq == applied.seq;
            if confirmed {
                front.time_s = applied.time_s;
            } else {
                front.time_s = front.time_s.min(applied.time_s);
            }
            self.place_front((!confirmed).then_some(UNCONFIRMED), sample_row);
        }
    }

    /// The first waiting command on a separate row, or on that of the sample at the same time.
    fn place_front(&mut self, remark: Option<&str>, sample_row: &mut Row) {
        let Some(waiting) = self.waiting.pop_front() else {
            return;
        };
        let time_s = self.after_last(waiting.time_s);
        if time_s >= sample_row.time_s {
            self.fill(&waiting, remark, sample_row);
            return;
        }
        let mut row = Row::at(time_s);
        row.seq = Some(waiting.command.seq);
        self.fill(&waiting, remark, &mut row);
        if self.has_value(&row) {
            self.last_s = time_s;
            self.rows.push(row);
        }
    }

    /// `time_s`, or the next number after the last row: clocks differ slightly.
    fn after_last(&self, time_s: f64) -> f64 {
        if time_s > self.last_s { time_s } else { self.last_s.next_up() }
    }

    fn fill(&self, waiting: &CommandRow, remark: Option<&str>, row: &mut Row) {
        let demand = waiting.command.demand;
        let reference_rad_s = waiting.reference_rad_s.or(match demand {
            Demand::Speed(speed_rad_s) => Some(speed_rad_s),
            _ => None,
        });
        for (channel, value) in [
            (Channel::VoltageCmd, demand.voltage_v()),
            (Channel::CurrentCmd, demand.current_a()),
            (Channel::Reference, reference_rad_s),
        ] {
            if value.is_none() || !self.layout.has(channel) {
                continue;
            }
            row.set(channel, value);
            if let Some(remark) = remark {
                row.remark(channel, remark);
            }
        }
        if row.seq.is_none() {
            row.seq = Some(waiting.command.seq);
        }
    }

    fn has_value(&self, row: &Row) -> bool {
        self.layout.channels().iter().any(|channel| row.get(*channel).is_some())
    }

    /// Stale values are left out with a remark: they belong to an older instant.
    fn sample_row(&self, sample: &Sample) -> Row {
        let mut row = Row::at(sample.time_s);
        row.host_time_s = sample.host_time_s;
        row.seq = sample.seq;
        row.status = match (sample.status, sample.state) {
            (Some(word), _) => word.to_string(),
            (None, Some(state)) => state.name().to_owned(),
            (None, None) => String::new(),
        };
        for channel in self.layout.channels() {
            match sample.quality(*channel) {
                Quality::Good => row.set(*channel, sample.get(*channel)),
                Quality::Stale => row.remark(*channel, "stale"),
                // A stamp without a half-width comes from the drive.
                Quality::Missing
                    if channel.is_commanded() || *channel == Channel::TimeHalfWidth => {}
                Quality::Missing => row.remark(*channel, "missing"),
            }
        }
        if sample.limited {
            row.remark(self.layout.commanded(), LIMITED);
        }
        row
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::cases;
    use proptest::prelude::*;

    fn layout() -> Layout {
        Layout::of_drive(&[Channel::VoltageCmd, Channel::Current])
    }

    fn sample(time_s: f64, applied: Option<(u64, f64)>) -> Sample {
        let mut sample = Sample::at(time_s).with(Channel::Current, 1.0);
        sample.applied = applied.map(|(seq, time_s)| Applied { seq, time_s });
        sample
    }

    #[test]
    fn a_half_width_of_the_link_reads_back_to_the_bit() {
        use crate::recording::{CsvRows, ReadOptions};
        let layout = Layout::of_drive(&[Channel::Current, Channel::TimeHalfWidth]);
        let mut order = RowOrder::new(layout.clone());
        let mut rows = Vec::new();
        let mut stamped = sample(0.010, None);
        stamped.time_half_width_s = Some(0.0017_f64.next_up());
        rows.extend_from_slice(order.sample(&stamped));
        rows.extend_from_slice(order.sample(&sample(0.020, None)));
        let mut text = layout.header();
        for row in &rows {
            text.push_str(&layout.line(row));
        }
        assert!(text.contains(",time_half_width_s,status"), "{text}");
        let mut back = CsvRows::new(text.as_bytes(), "r", ReadOptions::default()).unwrap();
        for row in &rows {
            let read = back.next_row().unwrap().unwrap();
            let width = |row: &Row| row.get(Channel::TimeHalfWidth).map(f64::to_bits);
            assert_eq!(width(&read), width(row));
            assert_eq!(read.quality, row.quality);
        }
        assert_eq!(rows[1].quality, "", "a stamp of the drive has no half-width");
    }

    /// Name, steps and rows. A command has its number, time and voltage, a sample its time, and the number and time of the applied
    /// command; line ends are written as `/`.
    const CASES: &str = "
each where it was applied; equal times are one row | send 1 0 5, take 0.01 1 0.003, send 2 0.01 6, take 0.02 2 0.02 | 0.003,1,5,,,/0.01,,,1,,/0.02,2,6,1,,/
one that is applied after the sample waits for the next one | send 1 0 5, take 0.01 0 0, send 2 0.01 6, take 0.02 1 0.011, finish | 0.01,,,1,,/0.011,1,5,,,/0.02,,,1,,/0.020000000000000004,2,6,,,voltage_cmd_v:unconfirmed/
a lost reply leaves a remark and stops nothing | send 1 0.001 5, send 2 0.011 6, take 0.02 2 0.012 | 0.001,1,5,,,voltage_cmd_v:unconfirmed/0.012,2,6,,,/0.02,,,1,,/
without stamps where it was sent | send 1 0.001 5, take 0.005 | 0.001,1,5,,,/0.005,,,1,,/
a sample that is not new is left out | take 0.1, take 0.1, take 0.05, take NaN, take 0.2 | 0.1,,,1,,/0.2,,,1,,/
";

    #[test]
    fn commands_have_the_time_at_which_they_were_applied() {
        for [name, steps, expected] in cases(CASES) {
            let layout = layout().without_host_time();
            let mut order = RowOrder::new(layout.clone());
            let mut text = String::new();
            for step in steps.split(", ") {
                let words: Vec<&str> = step.split(' ').collect();
                let number = |text: &str| text.parse::<f64>().unwrap();
                let seq = |text: &str| text.parse().unwrap();
                let rows = match words[..] {
                    ["send", own, time_s, value] => {
                        order.command(CommandRow::volts(seq(own), number(time_s), number(value)));
                        continue;
                    }
                    ["take", time_s] => order.sample(&sample(number(time_s), None)),
                    ["take", time_s, own, applied_s] => {
                        let applied = Some((seq(own), number(applied_s)));
                        order.sample(&sample(number(time_s), applied))
                    }
                    _ => order.finish(),
                };
                text.extend(rows.iter().map(|row| layout.line(row)));
            }
            assert_eq!(text.replace('\n', "/"), expected, "{name}");
        }
    }

    #[test]
    fn a_speed_demand_is_a_reference_and_a_stop_is_zero_volts() {
        let mut order = RowOrder::new(Layout::plain(&[Channel::Reference, Channel::VoltageCmd]));
        for (seq, demand) in [(1, Demand::Speed(50.0)), (2, Demand::Stop)] {
            let command = Command { seq, demand };
            order.command(CommandRow { command, ..CommandRow::volts(seq, seq as f64, 0.0) });
        }
        let rows = order.sample(&Sample::at(5.0));
        assert_eq!(rows.len(), 3);
        assert_eq!(rows[0].get(Channel::Reference), Some(50.0));
        assert_eq!(rows[0].get(Channel::VoltageCmd), None);
        assert_eq!(rows[1].get(Channel::VoltageCmd), Some(0.0));
    }

    #[test]
    fn stale_and_missing_cells_are_empty_with_a_remark() {
        let layout = Layout::of_drive(&[Channel::VoltageCmd, Channel::Current, Channel::Speed]);
        let mut order = RowOrder::new(layout);
        let mut stale = Sample::at(1.0).with(Channel::Current, 3.0);
        stale.set_stale(Channel::Current);
        let rows = order.sample(&stale);
        assert_eq!(rows[0].get(Channel::Current), None);
        assert_eq!(rows[0].quality, "current_a:stale speed_rad_s:missing");
    }

    proptest! {
        /// Whatever the clocks do, time increases strictly and every command and new sample is in the rows.
        #[test]
        fn rows_are_always_in_order_and_complete(
            steps in prop::collection::vec((0.0..0.03f64, -0.01..0.03f64, 0u64..3, any::<bool>()), 1..60),
        ) {
            let mut order = RowOrder::new(layout());
            let mut rows = Vec::new();
            let mut time_s = 0.0;
            let mut commands = 0_u16;
            let mut new_samples = 0;
            for (step_s, applied_ago_s, behind, stamped) in steps {
                commands += 1;
                order.command(CommandRow::volts(u64::from(commands), time_s, f64::from(commands)));
                time_s += step_s;
                new_samples += usize::from(rows.last().is_none_or(|row: &Row| time_s > row.time_s));
                let stamp = (u64::from(commands).saturating_sub(behind), time_s - applied_ago_s);
                rows.extend_from_slice(order.sample(&sample(time_s, stamped.then_some(stamp))));
            }
            rows.extend_from_slice(order.finish());
            prop_assert!(rows.windows(2).all(|pair| pair[0].time_s < pair[1].time_s));
            let measured = rows.iter().filter(|row| row.get(Channel::Current).is_some()).count();
            prop_assert_eq!(measured, new_samples);
            let last = rows.iter().rev().find_map(|row| row.get(Channel::VoltageCmd));
            prop_assert_eq!(last, Some(f64::from(commands)));
        }
    }
}
