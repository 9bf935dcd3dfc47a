//! `JUnit` XML of a suite, in the form that the common schema (Jenkins, `GitHub` and `GitLab` readers) takes. The root has no
//! count of skipped cases: the schema gives it none.

use std::fmt::Write as _;

use super::{CaseOutcome, SuiteOutcome, Verdict};

pub fn document(outcome: &SuiteOutcome) -> String {
    let mut text = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    let counts = format!(
        "tests=\"{}\" failures=\"{}\" errors=\"{}\" time=\"{:.3}\"",
        outcome.cases.len(),
        outcome.failed,
        outcome.errors,
        outcome.took_s
    );
    let name = escaped(&outcome.suite);
    // The schema's time stamp has no fraction and no zone.
    let stamp = outcome.began.get(..19).unwrap_or("1970-01-01T00:00:00");
    let _ = writeln!(text, "<testsuites name=\"{name}\" {counts}>");
    let _ = writeln!(
        text,
        "  <testsuite name=\"{name}\" {counts} skipped=\"{}\" timestamp=\"{stamp}\" hostname=\"{}\">",
        outcome.skipped,
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

/// Text escaped for XML, in an attribute and between tags; characters that XML does not allow are left out.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            // An attribute would turn them into blanks.
            '\n' => escaped.push_str("&#10;"),
            '\t' => escaped.push_str("&#9;"),
            letter if letter.is_control() || matches!(letter, '\u{fffe}' | '\u{ffff}') => {}
            letter => escaped.push(letter),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The first attribute of this name behind `from`, read as XML does.
    fn attribute(text: &str, from: &str, name: &str) -> String {
        let (_, rest) = text.split_once(from).unwrap();
        let (_, rest) = rest.split_once(&format!(" {name}=\"")).unwrap();
        let (value, _) = rest.split_once('"').unwrap();
        assert!(value.chars().all(|letter| !letter.is_control()), "{value:?}");
        [
            ("&lt;", "<"),
            ("&gt;", ">"),
            ("&quot;", "\""),
            ("&#10;", "\n"),
            ("&#9;", "\t"),
            ("&amp;", "&"),
        ]
        .iter()
        .fold(value.to_owned(), |value, (entity, letter)| value.replace(entity, letter))
    }

    proptest! {
        #[test]
        fn a_case_may_have_any_name(name in any::<String>(), reason in "[\\PC<>&\"'\\]\n\t\u{0}-\u{1f}\u{fffe}]{0,40}") {
            let kept = |text: &str| -> String {
                let holds = |letter: &char| matches!(letter, '\n' | '\t') || !letter.is_control() && !matches!(letter, '\u{fffe}' | '\u{ffff}');
                text.chars().filter(holds).collect()
            };
            let case = CaseOutcome {
                name: name.clone(),
                seed: 7,
                tags: Vec::new(),
                verdict: Verdict::Failed(reason.clone()),
                took_s: 1.0,
                status: Some(1),
                evidence: Some("]]>".to_owned()),
                steps: Vec::new(),
                answers: Vec::new(),
            };
            let outcome = SuiteOutcome::of(&name, "2026-01-02T03:04:05Z".to_owned(), String::new(), 1.0, vec![case]);
            let text = document(&outcome);
            // The head, four elements with their ends, and nothing that a name has opened.
            prop_assert_eq!(text.matches('<').count(), 9);
            prop_assert_eq!(attribute(&text, "<testcase", "name"), kept(&format!("{name} [seed 7]")));
            prop_assert_eq!(attribute(&text, "<failure", "message"), kept(&reason));
            prop_assert_eq!(attribute(&text, "<testsuites", "name"), kept(&name));
        }
    }
}
