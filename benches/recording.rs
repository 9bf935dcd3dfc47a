//! What a row costs: written by a run and as a whole file, read, and read again through the on-line estimators; and that
//! the memory does not grow meanwhile.

mod common;

use std::io::{self, Read};

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use drivebench::bench::replay;
use drivebench::identification::online::OnlineConfig;
use drivebench::recording::{CsvRows, Layout, ReadOptions, Row, read_csv, write_run};
use drivebench::sample::{Channel, Origin, Run};

/// Few, so that a sample is short: on a shared machine the least of them is near the truth.
const ROWS: usize = 2_000;
const ALL_ROWS: usize = 5_000_000;
/// The twelve columns of our own drive: these and `time_s`, `host_time_s`, `seq`, `status`, `quality`.
const SIGNALS: [Channel; 7] = [
    Channel::VoltageCmd,
    Channel::Voltage,
    Channel::Current,
    Channel::Speed,
    Channel::Angle,
    Channel::Bus,
    Channel::Temperature,
];

/// A row as a run at 1 kHz leaves it: what the drive sends has its resolution, what is computed has all digits.
fn row(k: usize) -> Row {
    let time_s = 1e-3 * k as f64;
    let mut row = Row::at(time_s);
    row.host_time_s = Some(time_s + 3.712_345_678e-4);
    row.seq = Some(k as u64);
    row.status = "running".to_owned();
    let level_v = if (k / 40).is_multiple_of(2) {
        30.0
    } else {
        -12.5
    };
    let wave = |hz: f64| (hz * time_s).sin();
    for (channel, value) in SIGNALS.into_iter().zip([
        level_v,
        level_v + 0.1 * wave(911.0),
        4.0 * wave(71.0),
        (100.0 * wave(7.0) / 0.01).round() * 0.01,
        0.1 * k as f64,
        140.0 + (10.0 * wave(3.0)).round() * 0.1,
        31.5,
    ]) {
        row.set(channel, Some(value));
    }
    row
}

fn layout() -> Layout {
    Layout::of_drive(&SIGNALS)
}

fn text(rows: usize) -> String {
    let layout = layout();
    let mut text = layout.header();
    for k in 0..rows {
        layout.push_line(&row(k), &mut text);
    }
    text
}

fn run(rows: usize) -> Run {
    let all: Vec<Row> = (0..rows).map(row).collect();
    let mut run = Run::new("run", all.iter().map(|row| row.time_s).collect()).expect("rising");
    for channel in SIGNALS {
        let values = all.iter().map(|row| row.get(channel).unwrap_or(f64::NAN));
        run.set_column(channel, values.collect(), Origin::Measured)
            .expect("a value for each row");
    }
    run
}

/// So many rows, made as they are read.
struct Endless {
    layout: Layout,
    text: String,
    at: usize,
    next: usize,
    end: usize,
}

impl Read for Endless {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if self.at == self.text.len() && self.next < self.end {
            self.text.clear();
            self.at = 0;
            self.layout.push_line(&row(self.next), &mut self.text);
            self.next += 1;
        }
        let count = (&self.text.as_bytes()[self.at..]).read(into)?;
        self.at += count;
        Ok(count)
    }
}

/// Resident memory, pages.
fn resident() -> u64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let mut numbers = text.split(' ').filter_map(|word| word.parse().ok());
    numbers.nth(1).unwrap_or(0)
}

/// Replays five million rows and says by how much the memory has grown over the last nine tenths of them.
fn memory() {
    let layout = layout();
    let source = Endless {
        text: layout.header(),
        layout,
        at: 0,
        next: 0,
        end: ALL_ROWS,
    };
    let source = io::BufReader::new(source);
    let mut rows = CsvRows::new(source, "run", ReadOptions::default()).expect("our own header");
    let mut early = 0;
    let next = || {
        let row = rows.next_row();
        if rows.rows() == ALL_ROWS / 10 {
            early = resident();
        }
        row
    };
    replay(next, OnlineConfig::default()).expect("whole rows");
    let grown = resident().saturating_sub(early);
    eprintln!("replay of {ALL_ROWS} rows: {grown} pages more than after a tenth of them");
    assert!(grown < 256, "the memory grows by {grown} pages");
}

fn recording(criterion: &mut Criterion) {
    if !std::env::args().any(|argument| argument == "--profile-time") {
        memory();
    }
    let (text, run, layout) = (text(ROWS), run(ROWS), layout());
    let rows: Vec<Row> = (0..ROWS).map(row).collect();
    let mut group = criterion.benchmark_group("recording");
    group.throughput(Throughput::Elements(ROWS as u64));
    group.bench_function("row_out", |bencher| {
        let mut line = String::new();
        bencher.iter(|| {
            rows.iter().for_each(|row| {
                line.clear();
                layout.push_line(row, &mut line);
            });
        });
    });
    group.bench_function("run_out", |bencher| bencher.iter(|| write_run(&run)));
    group.bench_function("run_in", |bencher| {
        bencher.iter(|| read_csv(text.as_bytes(), "run", ReadOptions::default()).expect("a run"));
    });
    group.bench_function("replay", |bencher| {
        bencher.iter(|| {
            let mut rows = CsvRows::new(text.as_bytes(), "run", ReadOptions::default())
                .expect("our own header");
            replay(|| rows.next_row(), OnlineConfig::default()).map(|done| done.result())
        });
    });
    group.finish();
}

criterion_group! {
    name = benches;
    config = common::settings();
    targets = recording
}
criterion_main!(benches);
