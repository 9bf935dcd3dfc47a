//! `JUnit` XML of a suite, in the form that the common schema (Jenkins, `GitHub` and `GitLab` readers) takes.

use std::fmt::Write as _;

use super::{CaseOutcome, SuiteOutcome, Verdict};

/// The document.
pub fn document(outcome: &SuiteOutcome) -> String {
    let mut text = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    let counts = format!(
        "tests=\"{}\" failures=\"{}\" errors=\"{}\" skipped=\"{}\" time=\"{:.3}\"",
        outcome.cases.len(),
        outcome.failed,
        outcome.errors,
        outcome.skipped,
        outcome.took_s
    );
    let name = escaped(&outcome.suite);
    // The schema's time stamp has no fraction and no zone.
    let stamp = outcome.began.get(..19).unwrap_or("1970-01-01T00:00:00");
    let _ = writeln!(text, "<testsuites name=\"{name}\" {counts}>");
    let _ = writeln!(
        text,
        "  <testsuite name=\"{name}\" {counts} timestamp=\"{stamp}\" hostname=\"{}\">",
        escaped(&outcome.machine)
    );
    for case in &outcome.cases {
        write_case(&mut text, &outcome.suite, case);
    }
    text.push_str("  </testsuite>\n</testsuites>\n");
    text
}

fn write_case(text: &mut String, suite: &str, case: &CaseOutcome) {
    let _ = write!(
        text,
        "    <testcase classname=\"{}\" name=\"{} [seed {}]\" time=\"{:.3}\"",
        escaped(suite),
        escaped(&case.name),
        case.seed,
        case.took_s
    );
    let body = match &case.verdict {
        Verdict::Passed => String::new(),
        Verdict::Skipped(reason) => format!("      <skipped message=\"{}\"/>\n", escaped(reason)),
        Verdict::Failed(reason) => with_details("failure", "limit", reason, case),
        Verdict::Error(reason) => with_details("error", "error", reason, case),
    };
    if body.is_empty() {
        text.push_str("/>\n");
    } else {
        let _ = write!(text, ">\n{body}    </testcase>\n");
    }
}

fn with_details(element: &str, kind: &str, reason: &str, case: &CaseOutcome) -> String {
    let mut details = String::new();
    for step in &case.steps {
        if !step.command.is_empty() {
            let _ = writeln!(details, "{}", step.command);
        }
    }
    if let Some(folder) = &case.evidence {
        let _ = writeln!(details, "evidence: {folder}");
    }
    format!(
        "      <{element} type=\"{kind}\" message=\"{}\">{}</{element}>\n",
        escaped(reason),
        escaped(&details)
    )
}

/// Text as XML holds it: characters that it has no place for are left out.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\n' | '\t' => escaped.push(letter),
            letter if letter < ' ' || matches!(letter, '\u{fffe}' | '\u{ffff}') => {}
            letter => escaped.push(letter),
        }
    }
    escaped
}
