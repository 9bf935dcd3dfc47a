//! The answer of `identify` as JSON and as text.

use std::fmt::Write as _;

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::super::provenance;
use super::{Answer, OneRun};
use crate::report::conventions;
use crate::sample::{Channel, ParameterEstimate};
use crate::text::number::with_std;

impl Answer {
    pub(super) fn json(&self) -> Value {
        let first = self.runs.first();
        let of_runs = |of: fn(&OneRun) -> usize| self.runs.iter().map(of).sum::<usize>();
        let mut notes: Vec<&String> = Vec::new();
        for run in &self.runs {
            for note in run.loaded.run.notes.iter().chain(&run.found.notes) {
                if !notes.contains(&note) {
                    notes.push(note);
                }
            }
        }
        notes.extend(&self.caution);
        let combined = self.combined.iter().map(|r| (r.estimate.key.as_str(), r));
        let parameters = if self.runs.len() > 1 {
            keyed(combined)
        } else {
            keyed(
                self.combined
                    .iter()
                    .map(|r| (r.estimate.key.as_str(), &r.estimate)),
            )
        };
        let converted = conventions::of(&self.parameters());
        let mut value = json!({
            "scheme": first.map(|run| run.found.scheme),
            "parameters": parameters,
            "rows": of_runs(|run| run.loaded.run.rows()),
            "rows_used": of_runs(|run| run.scenario.samples()),
            "rows_dropped": of_runs(|run| run.loaded.run.rows_dropped),
            "period_s": first.and_then(period_s),
            "input": first.map(|run| run.scenario.input_channel.key()),
            "signals": first.map(|run| provenance::signals(&run.loaded.run)),
            "shaft": "motor",
            "conventions": keyed(converted.iter().map(|c| (c.key, c))),
            "notes": notes,
        });
        if self.runs.len() > 1 {
            value["runs"] = self
                .runs
                .iter()
                .map(|run| {
                    json!({
                        "run": run.loaded.run.name,
                        "rows": run.loaded.run.rows(),
                        "parameters": estimates(&run.found.parameters),
                    })
                })
                .collect();
        }
        if let Some(absolute) = &self.absolute {
            value["absolute"] = estimates(absolute);
        }
        if let Some(comparison) = &self.nameplate {
            value["nameplate"] = serde_json::to_value(comparison).unwrap_or_default();
        }
        if let Some(ratio) = self.gear_ratio {
            let load = conventions::on_load_shaft(&self.parameters(), ratio);
            value["load_shaft"] = json!({ "gear_ratio": ratio, "parameters": estimates(&load) });
        }
        value
    }

    pub(super) fn text(&self) -> String {
        let scheme = self.runs.first().map_or("", |run| run.found.scheme);
        let mut text = match self.runs.len() {
            1 => format!("scheme {scheme}; ± is one standard deviation, 1.96 of them hold 95 %\n"),
            runs => format!(
                "scheme {scheme}, mean of {runs} runs; the spread is that from run to run\n"
            ),
        };
        for repeated in &self.combined {
            let spread = repeated
                .run_to_run_std
                .map_or_else(String::new, |std| format!("  spread {std:.1e}"));
            line(&mut text, &repeated.estimate, &spread);
        }
        if let Some(absolute) = &self.absolute {
            text.push_str("absolute, from the added inertia\n");
            for parameter in absolute {
                line(&mut text, parameter, "");
            }
        }
        if let Some(ratio) = self.gear_ratio {
            let _ = writeln!(
                text,
                "on the load's shaft (motor turns {ratio} times per turn; losses of the gearbox are in the load torque)"
            );
            for parameter in conventions::on_load_shaft(&self.parameters(), ratio) {
                line(&mut text, &parameter, "");
            }
        }
        if let Some(comparison) = &self.nameplate {
            let _ = writeln!(text, "{}", comparison.text().trim_end());
        }
        self.conventions(&mut text);
        for note in self
            .runs
            .iter()
            .flat_map(|run| &run.found.notes)
            .chain(&self.caution)
        {
            let _ = writeln!(text, "note: {note}");
        }
        text
    }

    fn conventions(&self, text: &mut String) {
        let converted = conventions::of(&self.parameters());
        if converted.is_empty() {
            return;
        }
        text.push_str("in other units\n");
        for c in converted {
            let number = with_std(c.value, c.std);
            let _ = writeln!(text, "  {:<42} {number} {}", c.key, c.unit);
        }
        let _ = writeln!(text, "  {}", conventions::RELATION);
    }
}

/// Median distance of the measurements, s.
fn period_s(run: &OneRun) -> Option<f64> {
    [Channel::Current, Channel::Speed]
        .into_iter()
        .find_map(|channel| run.loaded.run.period_s(channel))
}

fn estimates(parameters: &[ParameterEstimate]) -> Value {
    Value::Object(keyed(parameters.iter().map(|p| (p.key.as_str(), p))))
}

fn keyed<'a, T: Serialize + 'a>(
    entries: impl Iterator<Item = (&'a str, &'a T)>,
) -> Map<String, Value> {
    entries
        .map(|(key, value)| {
            let value = serde_json::to_value(value).unwrap_or_default();
            (key.to_owned(), value)
        })
        .collect()
}

fn line(text: &mut String, parameter: &ParameterEstimate, spread: &str) {
    let _ = writeln!(
        text,
        "  {:<42} {:<32}{spread} {}",
        parameter.key,
        parameter.text(1.0),
        parameter.verdict_text()
    );
}
