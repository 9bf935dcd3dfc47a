//! `OpenMetrics` text of a suite, for a Prometheus push gateway or a text-file collector.

use std::fmt::Write as _;

use super::{SuiteOutcome, Verdict};

/// The exposition, with its end mark.
pub fn text(outcome: &SuiteOutcome) -> String {
    let mut text = String::new();
    let suite = escaped(&outcome.suite);
    text.push_str(
        "# TYPE drivebench_suite_cases gauge\n# HELP drivebench_suite_cases Cases by verdict.\n",
    );
    for (verdict, count) in [
        ("passed", outcome.passed),
        ("failed", outcome.failed),
        ("error", outcome.errors),
        ("skipped", outcome.skipped),
    ] {
        let _ = writeln!(
            text,
            "drivebench_suite_cases{{suite=\"{suite}\",verdict=\"{verdict}\"}} {count}"
        );
    }
    text.push_str("# TYPE drivebench_suite_duration_seconds gauge\n# UNIT drivebench_suite_duration_seconds seconds\n");
    let _ = writeln!(
        text,
        "drivebench_suite_duration_seconds{{suite=\"{suite}\"}} {:.3}",
        outcome.took_s
    );
    text.push_str("# TYPE drivebench_case_passed gauge\n# HELP drivebench_case_passed 1 passed, 0 not; skipped cases are left out.\n");
    for case in &outcome.cases {
        let passed = match case.verdict {
            Verdict::Skipped(_) => continue,
            Verdict::Passed => 1,
            Verdict::Failed(_) | Verdict::Error(_) => 0,
        };
        let (name, seed) = (escaped(&case.name), case.seed);
        let _ = writeln!(
            text,
            "drivebench_case_passed{{suite=\"{suite}\",case=\"{name}\",seed=\"{seed}\"}} {passed}"
        );
    }
    text.push_str("# TYPE drivebench_figure gauge\n# HELP drivebench_figure Mean of a judged figure over the repeats of its case, in the unit that ends its key.\n");
    for figure in outcome.spread.iter().filter(|figure| figure.mean.is_finite()) {
        let (case, key) = (escaped(&figure.case), escaped(&figure.key));
        let _ = writeln!(
            text,
            "drivebench_figure{{suite=\"{suite}\",case=\"{case}\",key=\"{key}\"}} {}",
            figure.mean
        );
    }
    if !outcome.confusion.is_empty() {
        text.push_str("# TYPE drivebench_diagnosis_answers gauge\n# HELP drivebench_diagnosis_answers Answers of the diagnosis by what was hidden and what was named.\n");
    }
    for (hidden, named) in outcome.confusion.named() {
        for (named, count) in named {
            let (hidden, named) = (escaped(hidden), escaped(named));
            let _ = writeln!(
                text,
                "drivebench_diagnosis_answers{{suite=\"{suite}\",hidden=\"{hidden}\",named=\"{named}\"}} {count}"
            );
        }
    }
    text.push_str("# EOF\n");
    text
}

fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}
