//! Rows as CSV lines, with only the columns that the drive gives; numbers as the shortest digits that round-trip (Ryu, Adams
//! 2018).

use std::fmt::Write as _;

use drivebench_model::sample::{Channel, Run};

/// Remark of a command that a limit of the drive changed.
pub(super) const LIMITED: &str = "limited";
pub(super) const UNCONFIRMED: &str = "unconfirmed";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColumnKind {
    Quantity,
    Count,
    Word,
    /// UTC as `2026-01-31T23:59:59Z`.
    Instant,
}

impl ColumnKind {
    /// Of a column of `samples.csv`.
    pub fn of_samples(name: &str) -> Self {
        match name {
            "seq" => Self::Count,
            "status" | "quality" => Self::Word,
            _ => Self::Quantity,
        }
    }
}

/// One line of `samples.csv` before it is text.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    pub time_s: f64,
    pub host_time_s: Option<f64>,
    pub seq: Option<u64>,
    cells: [Option<f64>; Channel::COUNT],
    /// The drive's status word, or the name of its state.
    pub status: String,
    /// Why cells are missing or stale: `key:reason`, separated by blanks.
    pub quality: String,
}

impl Row {
    /// Zero has no sign, here and in the cells, as in the file: a row is equal after it is read back.
    pub fn at(time_s: f64) -> Self {
        Self { time_s: time_s + 0.0, ..Self::default() }
    }

    pub fn get(&self, channel: Channel) -> Option<f64> {
        self.cells[channel.index()]
    }

    pub fn set(&mut self, channel: Channel, value: Option<f64>) {
        let finite = value.filter(|value| value.is_finite());
        self.cells[channel.index()] = finite.map(|value| value + 0.0);
    }

    pub fn remark(&mut self, channel: Channel, reason: &str) {
        let gap = if self.quality.is_empty() { "" } else { " " };
        let _ = write!(self.quality, "{gap}{}:{reason}", channel.key());
    }

    /// A limit of the drive changed the output.
    pub fn is_limited(&self) -> bool {
        self.command_has(LIMITED)
    }

    /// The drive did not confirm the command of this row.
    pub fn is_unconfirmed(&self) -> bool {
        self.command_has(UNCONFIRMED)
    }

    fn command_has(&self, reason: &str) -> bool {
        let mut remarks = self.quality.split(' ').filter_map(|remark| remark.split_once(':'));
        !self.quality.is_empty()
            && remarks.any(|(key, why)| {
                why == reason
                    && [Channel::VoltageCmd, Channel::CurrentCmd].map(Channel::key).contains(&key)
            })
    }
}

/// Which columns a `samples.csv` has, in the order of the contract.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    channels: Vec<Channel>,
    host_time: bool,
    /// `seq`, `status` and `quality`.
    exchange: bool,
}

impl Layout {
    /// The command whose output a limit of the drive changes.
    pub(super) fn commanded(&self) -> Channel {
        if self.has(Channel::CurrentCmd) { Channel::CurrentCmd } else { Channel::VoltageCmd }
    }

    /// The bookkeeping columns and these channels; their order does not matter.
    pub fn of_drive(channels: &[Channel]) -> Self {
        Self { host_time: true, exchange: true, ..Self::plain(channels) }
    }

    /// Time and these channels only, as for a simulated run.
    pub fn plain(channels: &[Channel]) -> Self {
        let all = Channel::ALL.into_iter();
        Self {
            channels: all.filter(|channel| channels.contains(channel)).collect(),
            host_time: false,
            exchange: false,
        }
    }

    /// Leaves the `host_time_s` column out: virtual time has no host clock.
    #[must_use]
    pub fn without_host_time(mut self) -> Self {
        self.host_time = false;
        self
    }

    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }

    pub fn has(&self, channel: Channel) -> bool {
        self.channels.contains(&channel)
    }

    fn names(&self) -> Vec<&'static str> {
        let mut names = vec!["time_s"];
        if self.host_time {
            names.push("host_time_s");
        }
        if self.exchange {
            names.push("seq");
        }
        names.extend(self.channels.iter().map(|channel| channel.key()));
        if self.exchange {
            names.extend(["status", "quality"]);
        }
        names
    }

    /// The header row with its line feed.
    pub fn header(&self) -> String {
        text_of(|writer| writer.write_record(self.names()))
    }

    /// The row with its line feed.
    pub fn line(&self, row: &Row) -> String {
        text_of(|writer| {
            write_number(writer, row.time_s)?;
            if self.host_time {
                write_number(writer, row.host_time_s.unwrap_or(f64::NAN))?;
            }
            if self.exchange {
                writer.write_field(row.seq.map(|seq| seq.to_string()).unwrap_or_default())?;
            }
            for channel in &self.channels {
                write_number(writer, row.get(*channel).unwrap_or(f64::NAN))?;
            }
            if self.exchange {
                writer.write_field(&row.status)?;
                writer.write_field(&row.quality)?;
            }
            writer.write_record(END)
        })
    }
}

/// Ends a record whose cells were written one by one.
const END: Option<&[u8]> = None;

/// The written records as text.
fn text_of(write: impl FnOnce(&mut csv::Writer<Vec<u8>>) -> csv::Result<()>) -> String {
    // Most lines are shorter.
    let mut writer = csv::WriterBuilder::new().buffer_capacity(256).from_writer(Vec::new());
    write(&mut writer)
        .ok()
        .and_then(|()| writer.into_inner().ok())
        .and_then(|bytes| String::from_utf8(bytes).ok())
        .expect("text is written to memory")
}

/// The shortest text that reads back to the same number; never `-0`; empty for what is not finite.
pub fn number_text(value: f64) -> String {
    digits(value, &mut ryu::Buffer::new()).to_owned()
}

fn write_number(writer: &mut csv::Writer<Vec<u8>>, value: f64) -> csv::Result<()> {
    writer.write_field(digits(value, &mut ryu::Buffer::new()))
}

/// Far from one, the plain form would be a row of zeros; both forms are the shortest digits that round-trip.
fn digits(value: f64, buffer: &mut ryu::Buffer) -> &str {
    if !value.is_finite() {
        return "";
    }
    // + 0.0 turns -0 into 0
    let digits = buffer.format_finite(value + 0.0);
    digits.strip_suffix(".0").unwrap_or(digits)
}

/// A run as CSV text, for a simulated run or an export: time and its columns.
pub fn write_run(run: &Run) -> String {
    let present = |channel| Some((channel, run.column(channel)?));
    let (channels, columns): (Vec<Channel>, Vec<&[f64]>) =
        Channel::ALL.into_iter().filter_map(present).unzip();
    text_of(|writer| {
        writer.write_record(Layout::plain(&channels).names())?;
        for (row, time_s) in run.time_s().iter().enumerate() {
            write_number(writer, *time_s)?;
            for column in &columns {
                write_number(writer, column[row])?;
            }
            writer.write_record(END)?;
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::{ReadOptions, read_csv};
    use drivebench_model::sample::Origin;
    use proptest::prelude::*;

    #[test]
    fn columns_have_the_order_of_the_contract() {
        assert_eq!(
            Layout::of_drive(&Channel::ALL).header(),
            "time_s,host_time_s,seq,reference_rad_s,voltage_cmd_v,current_cmd_a,voltage_v,current_a,speed_rad_s,angle_rad,\
             torque_n_m,bus_v,temperature_c,time_half_width_s,status,quality\n"
        );
        assert_eq!(
            Layout::plain(&[Channel::Speed, Channel::Current]).header(),
            "time_s,current_a,speed_rad_s\n"
        );
    }

    #[test]
    fn numbers_are_short_and_zero_has_no_sign() {
        for (value, text) in [
            (0.1 + 0.2, "0.30000000000000004"),
            (-0.0, "0"),
            (3.0, "3"),
            (-2.5, "-2.5"),
            (1e-9, "1e-9"),
            (1e300, "1e300"),
            (f64::NAN, ""),
            (1e-5, "0.00001"),
            (9.9e-6, "9.9e-6"),
            (9.5e15, "9500000000000000"),
            (-1.25e16, "-1.25e16"),
            (5e-324, "5e-324"),
        ] {
            assert_eq!(number_text(value), text);
        }
    }

    #[test]
    fn missing_cells_are_empty_and_separators_quoted() {
        let layout = Layout::of_drive(&[Channel::Speed]).without_host_time();
        let mut row = Row::at(0.0);
        row.status = "a,b".to_owned();
        row.quality = "say \"x\"".to_owned();
        assert_eq!(layout.line(&row), "0,,,\"a,b\",\"say \"\"x\"\"\"\n");
        let layout = Layout::of_drive(&[Channel::VoltageCmd, Channel::Speed]);
        let mut row = Row::at(0.5);
        row.seq = Some(7);
        row.set(Channel::Speed, Some(-0.0));
        row.set(Channel::Current, Some(9.0)); // not in the layout
        row.remark(Channel::VoltageCmd, "unconfirmed");
        row.remark(Channel::Speed, "stale");
        assert_eq!(layout.line(&row), "0.5,,7,,0,,voltage_cmd_v:unconfirmed speed_rad_s:stale\n");
    }

    proptest! {
        #[test]
        fn a_run_comes_back_to_the_bit(
            // A run holds no larger ones.
            values in prop::collection::vec(
                prop::option::of(prop::num::f64::NORMAL.prop_filter("a size", |v| v.abs() <= 1e12)),
                1..30,
            ),
            start in -1e6..1e6f64,
        ) {
            let time_s = (0..values.len()).map(|row| start + row as f64 * 0.01).collect();
            let mut run = Run::new("r", time_s).unwrap();
            let column = values.iter().map(|value| value.unwrap_or(f64::NAN)).collect();
            run.set_column(Channel::Current, column, Origin::Measured).unwrap();
            run.set_column(Channel::Speed, vec![1.0; values.len()], Origin::Measured).unwrap();
            let text = write_run(&run);
            let (back, warnings) = read_csv(text.as_bytes(), "r", ReadOptions::default()).unwrap();
            prop_assert!(warnings.is_empty());
            prop_assert_eq!(back.time_s(), run.time_s());
            let cells: Vec<_> = back.column(Channel::Current).map(<[f64]>::to_vec).unwrap_or(vec![f64::NAN; values.len()]);
            for (cell, value) in cells.iter().zip(&values) {
                prop_assert_eq!(value.is_none(), cell.is_nan());
                prop_assert!(value.is_none_or(|value| value.to_bits() == cell.to_bits()));
            }
        }
    }
}
