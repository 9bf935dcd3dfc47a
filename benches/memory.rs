//! The memory of a replay does not grow with its rows.

#[path = "common/rows.rs"]
mod rows;

use std::io::{self, Read};

use drivebench::bench::replay;
use drivebench::identification::online::OnlineConfig;
use drivebench::recording::{CsvRows, Layout, ReadOptions};
use rows::{layout, row};

const ALL_ROWS: usize = 5_000_000;

/// A table whose rows are generated as they are read.
struct GeneratedTable {
    layout: Layout,
    text: String,
    at: usize,
    next: usize,
    end: usize,
}

impl Read for GeneratedTable {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if self.at == self.text.len() && self.next < self.end {
            self.at = 0;
            self.text = self.layout.line(&row(self.next));
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
    text.split(' ').filter_map(|word| word.parse().ok()).nth(1).unwrap_or(0)
}

/// Replays five million rows and prints the growth of the memory over the last nine tenths of them.
fn main() {
    // As in a test of all targets, which measures nothing.
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    let layout = layout();
    let source = GeneratedTable { text: layout.header(), layout, at: 0, next: 0, end: ALL_ROWS };
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
