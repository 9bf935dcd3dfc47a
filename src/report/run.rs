//! The report of one run: recorded signals, on-line estimates, timing and link, why it ended.

use std::ops::Range;

use super::plot::{MOST_POINTS, Panel, Style, TIME, stacked};
use super::{Cell, Context, Document, Facts, Table, Tone, tables};
use drivebench_model::plant::Model;
use drivebench_model::sample::{Channel, Origin, ParameterEstimate, Run};
use drivebench_model::text::number::{r_min, significant};
use drivebench_model::units::rpm_from_rad_s;

#[derive(Clone, Debug)]
pub struct RunReport<'a> {
    pub title: &'a str,
    pub context: &'a Context,
    pub run: &'a Run,
    pub nameplate: Option<&'a Model>,
    /// Estimates at the end of the run; may be empty.
    pub parameters: &'a [ParameterEstimate],
    pub timing: &'a Facts,
    /// Why the run was not completed, if it was not.
    pub early_end: Option<EarlyEnd>,
    /// The last seconds, where it ended by a trip or a lost link.
    pub last_seconds: Option<LastSeconds>,
    pub speed_loop: Option<&'a Document>,
}

#[derive(Clone, Debug)]
pub struct LastSeconds {
    /// When it was decided that the output has to be off, on the samples' time axis, s.
    pub time_s: f64,
    /// Of the record, counted from 0.
    pub rows: Range<usize>,
    /// Magnitudes that must not be exceeded.
    pub limits: Vec<(Channel, f64)>,
    pub stop: Option<String>,
}

#[derive(Clone, Debug)]
pub struct EarlyEnd {
    pub tone: Tone,
    pub title: &'static str,
    pub reason: String,
}

impl RunReport<'_> {
    pub fn document(&self) -> Document {
        let run = self.run;
        let mut document =
            Document::new(self.title, format!("Run {}, {}", run.name, self.context.target.name()));
        tables::about(&mut document, self.context);
        let time_s = run.time_s();
        let duration_s =
            time_s.last().copied().unwrap_or(0.0) - time_s.first().copied().unwrap_or(0.0);
        let rows = format!("{} rows over {} s", run.rows(), significant(duration_s, 3));
        match &self.early_end {
            Some(end) => document.lead(
                end.tone,
                end.title,
                format!("{}. Recorded until then: {rows}.", end.reason),
            ),
            None if run.rows_dropped > 0 => document.lead(
                Tone::Attention,
                "Incomplete",
                format!(
                    "{rows}; {} incomplete or unreadable rows were left out.",
                    run.rows_dropped
                ),
            ),
            None => document.lead(Tone::Good, "Recorded", format!("{rows}, complete.")),
        }
        document.section("Signals");
        let panels = panels(run, time_s.first().copied().unwrap_or(0.0));
        document.figure(
            move || stacked("recorded signals over time", TIME, &panels, MOST_POINTS),
            "Time counts from the start of the run. A line is broken where samples are missing.",
        );
        let last = self.last_seconds.as_ref();
        if let Some(last) = last {
            last_seconds(&mut document, run, last);
        }
        if let Some(speed_loop) = self.speed_loop {
            document.section("Speed loop");
            document.append(speed_loop.clone());
        }
        if last.is_some() || self.speed_loop.is_some() {
            document.section("Range of the signals");
        }
        document.table(signals(run));
        document.list(run.notes.clone());
        let parameters = self.parameters;
        tables::parameter_section(&mut document, "on line", self.nameplate, &[], parameters, 5);
        document.section("Timing");
        document.facts(self.timing.clone());
        tables::conditions(&mut document, self.context);
        document
    }
}

fn signals(run: &Run) -> Table {
    let recorded = Channel::ALL.into_iter().filter(|channel| run.column(*channel).is_some());
    let of = |channel: &Channel| run.points(*channel).map(|point| point.1);
    let range = |channel: &Channel, value: f64| {
        let cell = Cell::text(significant(value, 4));
        if channel.unit() == "rad/s" && value.is_finite() {
            cell.with_note(r_min(value))
        } else {
            cell
        }
    };
    Table::of(recorded)
        .column("signal", |channel| channel.name())
        .column("unit", |channel| channel.unit())
        .column("origin", |channel| origin(run.origin(*channel)))
        .column("lowest", |channel| range(channel, of(channel).fold(f64::INFINITY, f64::min)))
        .column("highest", |channel| range(channel, of(channel).fold(f64::NEG_INFINITY, f64::max)))
        .column("values", |channel| of(channel).count().to_string())
        .column("median period", |channel| {
            let period = run.period_s(*channel).filter(|_| !channel.is_commanded());
            let ms = |period_s: f64| format!("{} ms", significant(1e3 * period_s, 3));
            period.map_or("-".to_owned(), ms)
        })
        .into()
}

const fn origin(origin: Origin) -> &'static str {
    match origin {
        Origin::Measured => "measured",
        Origin::Estimated => "estimated by the drive",
        Origin::Commanded => "commanded",
        Origin::Derived => "derived",
        Origin::Unknown => "not stated",
    }
}

/// The time before the trip, every sample of it, and how near the limits were.
fn last_seconds(document: &mut Document, run: &Run, last: &LastSeconds) {
    let rows = last.rows.start..last.rows.end.min(run.rows());
    let Some(part) = part(run, rows.clone()).filter(|part| part.rows() > 0) else {
        return;
    };
    document.section("The last seconds");
    let panels = panels(&part, last.time_s);
    document.figure(
        move || {
            let description = "recorded signals before the trip and until the end";
            stacked(description, TIME, &panels, MOST_POINTS)
        },
        "Time counts from the decision that the output has to be off.",
    );
    let (from, to) = (rows.start + 1, rows.end);
    let mut facts =
        vec![format!("Rows {from} to {to} of samples.csv are these seconds; it has every sample.")];
    facts.extend(last.stop.clone());
    document.list(facts);
    let extreme = |channel: Channel| {
        part.points(channel).map(|(_, value)| value.abs()).fold(f64::NAN, f64::max)
    };
    document.table(
        Table::of(last.limits.iter().filter(|(channel, _)| !extreme(*channel).is_nan()))
            .column("limit of", |(channel, _)| channel.name())
            .column("unit", |(channel, _)| channel.unit())
            .column("limit", |(_, limit)| significant(*limit, 4))
            .column("largest magnitude", |(channel, _)| significant(extreme(*channel), 4))
            .column("share of the limit", |(channel, limit)| {
                format!("{} %", significant(100.0 * extreme(*channel) / limit, 3))
            }),
    );
}

fn part(run: &Run, rows: Range<usize>) -> Option<Run> {
    let mut part = Run::new(run.name.clone(), run.time_s().get(rows.clone())?.to_vec()).ok()?;
    for channel in Channel::ALL {
        if let Some(column) = run.column(channel) {
            part.set_column(channel, column[rows.clone()].to_vec(), run.origin(channel)).ok()?;
        }
    }
    Some(part)
}

/// One panel per quantity; a command shares the panel of what it commands.
fn panels(run: &Run, start_s: f64) -> [Panel; 7] {
    let time_s: Vec<f64> = run.time_s().iter().map(|time| time - start_s).collect();
    let end_s = time_s.last().copied().unwrap_or(0.0);
    let groups: [&[Channel]; 7] = [
        &[Channel::VoltageCmd, Channel::Voltage],
        &[Channel::CurrentCmd, Channel::Current],
        &[Channel::Reference, Channel::Speed],
        &[Channel::Angle],
        &[Channel::Torque],
        &[Channel::Bus],
        &[Channel::Temperature],
    ];
    groups.map(|group| {
        let shown = group[group.len() - 1];
        let mut panel = Panel::new(shown.name(), shown.unit()).with_height(120.0);
        for &channel in group {
            let Some(values) = run.column(channel) else {
                continue;
            };
            panel = if channel.is_commanded() {
                let points = run.points(channel);
                let events: Vec<_> = points.map(|(time, value)| (time - start_s, value)).collect();
                panel.held("command", &events, end_s)
            } else {
                panel.sampled(channel.name(), Style::After, &time_s, values)
            };
        }
        if shown == Channel::Speed {
            panel = panel.with_second_unit("r/min", rpm_from_rad_s(1.0));
        }
        panel
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trip_is_the_headline() {
        let mut run = Run::new("r", (0..50).map(|k| 0.01 * f64::from(k)).collect()).unwrap();
        let speed = |k| if k == 20 { f64::NAN } else { f64::from(k) };
        for (channel, cells) in
            [(Channel::Speed, (0..50).map(speed).collect()), (Channel::Current, vec![f64::NAN; 50])]
        {
            run.set_column(channel, cells, Origin::Measured).unwrap();
        }
        let context = Context::default();
        let report = RunReport {
            title: "run",
            context: &context,
            run: &run,
            nameplate: None,
            parameters: &[],
            timing: &vec![("rate".into(), "100 Hz".into())],
            early_end: Some(EarlyEnd {
                tone: Tone::Bad,
                title: "Safety trip",
                reason: "current 31.0 A is above the limit of 30 A".to_owned(),
            }),
            last_seconds: Some(LastSeconds {
                time_s: 0.4,
                rows: 30..50,
                limits: vec![(Channel::Speed, 50.0), (Channel::Current, 30.0)],
                stop: Some("stop sent 0.1 ms after over-current".to_owned()),
            }),
            speed_loop: None,
        };
        let text = report.document().markdown();
        assert!(text.starts_with("SAFETY TRIP: current 31.0 A is above the limit of 30 A. Recorded until then: 50 rows over 0.490 s."), "{text}");
        assert!(text.contains("| current | A     | measured | n/a"), "{text}");
        assert!(text.contains("Rows 31 to 50 of samples.csv"), "{text}");
        assert!(text.contains("stop sent 0.1 ms"), "{text}");
        assert!(text.contains("| 98.0 %"), "{text}");
        let html = report.document().html();
        assert!(!html.contains("NaN") && !html.contains(">inf"));
        // The lost sample cuts the speed's line in two.
        let (_, path) = html.split_once("data-label=\"speed\" d=\"").unwrap();
        let (path, _) = path.split_once('"').unwrap();
        assert_eq!(path.matches('M').count(), 2);
    }
}
