//! What a probe found, for a person.

use std::fmt::Write as _;

use super::survey::Survey;
use crate::drive::{ProbeReport, ProbedSignal};
use crate::text::number::{reading, with_unit};

/// Candidates on the screen; all are in the JSON.
const SHOWN: usize = 4;

pub(super) fn report(report: &ProbeReport) -> String {
    let mut text = format!("{}\n", report.provenance);
    let mut line = |name: &str, what: String| {
        let _ = writeln!(text, "  {name:<10} {what}");
    };
    if let Some(identity) = &report.identity {
        line("identity", identity.plate());
        let told = |value: Option<f64>, unit| {
            value.map_or_else(|| "not told".to_owned(), |value| format!("{value} {unit}"))
        };
        line(
            "limits",
            format!(
                "current {}, voltage {}",
                told(identity.current_limit_a, "A"),
                told(identity.voltage_limit_v, "V")
            ),
        );
    }
    if !report.names.is_empty() {
        line(
            "names",
            format!("{} (function code 43)", report.names.join(", ")),
        );
    }
    if let Some(answers) = report.answers_function_8 {
        let what = if answers {
            "sends a number back"
        } else {
            "not answered"
        };
        line("function 08", what.to_owned());
    }
    for check in &report.checks {
        let passed = if check.passed { "ok" } else { "FAILED" };
        line(
            "check",
            format!("{passed}: {} (found {})", check.what, check.found),
        );
    }
    if !report.states.is_empty() {
        let states: Vec<String> = report
            .states
            .iter()
            .map(|state| {
                let holds = state
                    .holds
                    .map_or("not read", |holds| if holds { "yes" } else { "no" });
                format!("{} {holds}", state.name)
            })
            .collect();
        line("state", states.join(", "));
    }
    if let Some(watchdog_s) = report.watchdog_s {
        let off = if watchdog_s > 0.0 { "" } else { ": it is off" };
        line("watchdog", format!("{} s{off}", reading(watchdog_s)));
    }
    let _ = writeln!(text);
    for signal in &report.signals {
        text.push_str(&signal_text(signal));
    }
    let _ = writeln!(text);
    for hypothesis in &report.hypotheses {
        let _ = writeln!(
            text,
            "with {} {} of {} readings would be plausible, as the profile is {}: is the profile right?",
            hypothesis.change, hypothesis.plausible, hypothesis.judged, hypothesis.as_written
        );
    }
    for remark in &report.remarks {
        let _ = writeln!(text, "remark: {remark}");
    }
    let _ = writeln!(text, "{}", report.sentence);
    text
}

fn signal_text(signal: &ProbedSignal) -> String {
    let value = signal
        .value
        .map_or_else(|| "none".to_owned(), |value| quantity(value, signal.unit));
    let raw = signal.raw.as_ref().map_or_else(
        || "-".to_owned(),
        |words| {
            let words: Vec<String> = words.iter().map(|word| format!("{word:04x}")).collect();
            words.join(" ")
        },
    );
    let judgement = match (signal.plausible, &signal.missing, signal.expected) {
        (Some(false), Some(missing), _) => format!("not plausible: {missing}"),
        (_, Some(missing), _) => format!("missing: {missing}"),
        (Some(true), None, _) if signal.confirms => "plausible".to_owned(),
        (Some(true), None, _) => "plausible at rest".to_owned(),
        (Some(false), None, Some([low, high])) => {
            let (low, high) = (reading(low), reading(high));
            format!("not plausible: {low} to {high} {} at rest", signal.unit)
        }
        _ => "not judged".to_owned(),
    };
    let register = match signal.table {
        // What travels in a message of its own has no address.
        "stream" => "stream".to_owned(),
        table => format!("{table} {}", signal.address),
    };
    let mut text = format!(
        "{:<16} {value:>14}  {raw:<10} {register:<14} {judgement}\n",
        signal.name
    );
    for candidate in signal.candidates.iter().take(SHOWN) {
        let ending = if candidate.plausible {
            ", plausible: is the profile right?"
        } else {
            ""
        };
        let _ = writeln!(
            text,
            "    with {} {} would be {}{ending}",
            candidate.change,
            signal.name,
            quantity(candidate.value, signal.unit)
        );
    }
    text
}

/// A value with its unit, short.
fn quantity(value: f64, unit: &str) -> String {
    with_unit(&reading(value), unit)
}

pub(super) fn survey(survey: &Survey) -> String {
    let mut text = format!("{}\n", survey.link);
    if !survey.names.is_empty() {
        let _ = writeln!(
            text,
            "names: {} (function code 43)",
            survey.names.join(", ")
        );
    }
    for tried in &survey.profiles {
        let _ = writeln!(
            text,
            "{:<18} {:<15} {}",
            tried.profile,
            tried.fit.text(),
            tried.reason
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::register_map::Candidate;

    #[test]
    fn an_implausible_signal_is_followed_by_the_other_ways_of_reading_it() {
        let signal = ProbedSignal {
            name: "speed".to_owned(),
            unit: "rpm",
            table: "input",
            address: 8291,
            raw: Some(vec![0, 1]),
            value: Some(65_536.0),
            plausible: Some(false),
            expected: Some([-30.0, 30.0]),
            candidates: vec![Candidate {
                change: "word_order = \"low_first\"".to_owned(),
                value: 0.0,
                plausible: true,
            }],
            ..ProbedSignal::default()
        };
        let text = signal_text(&signal);
        assert!(text.contains("0000 0001"), "{text}");
        assert!(
            text.contains("not plausible: -30 to 30 rpm at rest"),
            "{text}"
        );
        assert!(
            text.contains("with word_order = \"low_first\" speed would be 0 rpm, plausible: is the profile right?"),
            "{text}"
        );
    }
}
