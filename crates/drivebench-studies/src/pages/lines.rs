//! What a line does to a measurement: a page of its own, and a part of that of the study.

use drivebench::text::number::{fixed, significant};
use serde_json::{Value, json};

use crate::lines::{LineRow, LineStudy, ParameterRow};
use crate::page::{FiguresAndTables, Findings};

pub(super) const LAYOUT: &str = include_str!("../layouts/lines.md");

impl LineStudy {
    /// The tables as a page of their own.
    pub fn report(&self) -> Result<FiguresAndTables, String> {
        let all = self.lines.iter().flat_map(|line| &line.parameters);
        let sum = |of: fn(&ParameterRow) -> usize| all.clone().map(of).sum::<usize>();
        let (valued, covered) = (sum(|own| own.valued), sum(|own| own.covered));
        let counts = json!({
            "valued": valued,
            "covered_percent": 100.0 * covered as f64 / valued.max(1) as f64,
            "settled": sum(|own| own.settled),
            "settled_wrong": sum(|own| own.settled_wrong),
        });
        let findings = Findings::new(self, counts).and(rows(self));
        findings.on(&[include_str!("../layouts/lines_title.md"), LAYOUT])
    }
}

pub(super) fn rows(found: &LineStudy) -> Value {
    let row = |row: &LineRow, error: fn(&ParameterRow) -> f64| {
        let cells = row.parameters.each_ref().map(|own| cell(own, error));
        json!({"name": row.name, "rate_hz": row.rate_hz, "half_width": half_width(row), "cells": cells})
    };
    let lines = found.lines.iter().map(|own| row(own, |own| own.error_percent));
    let causes = found.causes.iter().map(|own| row(own, |own| own.bias_percent));
    json!({
        "line_runs": found.runs,
        "line_rows": lines.collect::<Vec<_>>(),
        "cause_rows": causes.collect::<Vec<_>>(),
    })
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
