//! Page of the study of lines: parameter error and coverage by line and by cause.

use crate::report::reproduce::{Reproduction, Section};
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::lines::{LineRow, LineStudy, ParameterRow};

const HEADING: &str = "What a line does to a measurement";

impl LineStudy {
    /// The section as a page of its own.
    pub fn report(&self) -> Reproduction {
        Reproduction {
            title: HEADING.to_owned(),
            subtitle: format!(
                "Written by `drivebench reproduce lines --sets {} --seed {}`.",
                self.runs, self.seed
            ),
            lead: ("In short".to_owned(), self.in_short()),
            sections: vec![self.section()],
        }
    }

    fn in_short(&self) -> String {
        let all = || self.lines.iter().flat_map(|line| &line.parameters);
        let (valued, covered) = all().fold((0, 0), |(valued, covered), p| {
            (valued + p.valued, covered + p.covered)
        });
        let settled: usize = all().map(|p| p.settled).sum();
        let wrong: usize = all().map(|p| p.settled_wrong).sum();
        format!(
            "Of {valued} values over lines of every kind, the 95 % interval of {} % holds the truth; of {settled} that were called settled, {wrong} lie more than three standard deviations off.",
            fixed(100.0 * covered as f64 / valued.max(1) as f64, 1)
        )
    }

    pub(super) fn section(&self) -> Section {
        let size = |row: &LineRow, key: usize| cell(&row.parameters[key], |p| p.error_percent);
        let bias = |row: &LineRow, key: usize| cell(&row.parameters[key], |p| p.bias_percent);
        Section::new(HEADING)
            .say(format!(
                "{} records of each kind by the default method of `identify`, without a first guess: each with a motor of its own (R, L, Ke, J and Mc within a factor of 1.5 of the ZK-22FC's) under voltage steps of its own over 7 s. The drive samples and applies within its own cycle; where it has no clock that can be read, the host stamps a sample in the middle of request out and first byte in, and a command when it is sent, which is the least that a host can know of it. Profiled drives show 0.1 V, 0.01 A and 1 r/min. The share behind a line's name is that of its replies that are late by 12 to 60 ms, as many lost (given up after 80 ms) and as many doubled.",
                self.runs
            ))
            .say("A cell holds the median size of the error and, behind it, the share of the 95 % intervals that hold the truth; a dash is a parameter that was refused. Stamps that are believed are those of a record without its column `time_half_width_s`, as they were used before there was one.")
            .table(
                "lines",
                "Lines.",
                &self.lines,
                &[
                    ("line; late, lost, doubled each", &|row| row.name.clone()),
                    ("rate, Hz", &|row| fixed(row.rate_hz, 0)),
                    ("half-width, ms", &|row| half_width(row)),
                    ("R", &|row| size(row, 0)),
                    ("L", &|row| size(row, 1)),
                    ("Ke", &|row| size(row, 2)),
                    ("J", &|row| size(row, 3)),
                    ("Mc", &|row| size(row, 4)),
                ],
            )
            .table(
                "line-causes",
                "Causes: a profiled drive without a clock at 50 Hz. The median of the signed error stands in the place of its size.",
                &self.causes,
                &[
                    ("record", &|row| row.name.clone()),
                    ("R", &|row| bias(row, 0)),
                    ("L", &|row| bias(row, 1)),
                    ("Ke", &|row| bias(row, 2)),
                    ("J", &|row| bias(row, 3)),
                    ("Mc", &|row| bias(row, 4)),
                ],
            )
    }
}

fn half_width(row: &LineRow) -> String {
    let [median, tail] = row.half_width_s.map(|width_s| fixed(1e3 * width_s, 1));
    if row.half_width_s[1] > 0.0 {
        format!("{median}, 99 % below {tail}")
    } else {
        "the drive's clock".to_owned()
    }
}

fn cell(parameter: &ParameterRow, error: fn(&ParameterRow) -> f64) -> String {
    if parameter.valued == 0 {
        return "-".to_owned();
    }
    let coverage = fixed(100.0 * parameter.coverage(), 0);
    format!("{} %, {coverage} %", significant(error(parameter), 2))
}
