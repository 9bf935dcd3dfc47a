//! What the papers say, and what is said of them: `claims.txt`, held against both papers computed again.

use drivebench_studies::{paper_a, paper_b};
use serde_json::Value;

/// What one part of a path leads to from these values.
fn members<'a>(values: &[&'a Value], part: &str) -> Vec<&'a Value> {
    let place = |text: &str| text.parse::<usize>().ok();
    let of = |value: &'a Value| -> Vec<&'a Value> {
        match (value, part.split_once('=')) {
            (Value::Array(list), Some(_)) => members(&list.iter().collect::<Vec<_>>(), part),
            (own, Some((key, allowed))) => {
                let is = |text: &str| allowed.split(',').any(|one| one == text);
                let is_kept = own[key].as_str().is_some_and(is);
                is_kept.then_some(own).into_iter().collect()
            }
            (Value::Array(list), None) if part == "*" => list.iter().collect(),
            (Value::Object(own), None) if part == "*" => own.values().collect(),
            (Value::Array(list), None) => {
                let places = part.split(',').filter_map(|range| {
                    let (first, last) = range.split_once('-').unwrap_or((range, range));
                    list.get(place(first)?..=place(last)?)
                });
                places.flatten().collect()
            }
            (own, None) => own.get(part).into_iter().collect(),
        }
    };
    values.iter().copied().flat_map(of).collect()
}

fn found<'a>(paper: &'a Value, path: &str) -> Vec<&'a Value> {
    let mut parts = path.split('.');
    parts.by_ref().fold(vec![paper], |values, part| members(&values, part))
}

fn holds(paper: &Value, claim: &str) -> Option<bool> {
    if let Some(path) = claim.strip_suffix(" never") {
        let found = found(paper, path);
        return Some(!found.is_empty() && found.into_iter().all(Value::is_null));
    }
    let (what, range) = claim.rsplit_once(" in ")?;
    let (low, high) = range.split_once("..")?;
    let range = low.parse::<f64>().ok()?..=high.parse().ok()?;
    let numbers = |path: &str| -> Option<Vec<f64>> {
        let found = found(paper, path).into_iter();
        found.map(Value::as_f64).collect()
    };
    let values = match what.split_once(" / ") {
        None => numbers(what)?,
        Some((above, below)) => {
            let (above, below) = (numbers(above)?, numbers(below)?);
            let count = above.len().max(below.len());
            let both = above.iter().cycle().zip(below.iter().cycle());
            both.take(count).map(|(above, below)| above / below).collect()
        }
    };
    Some(!values.is_empty() && values.iter().all(|value| range.contains(value)))
}

#[test]
fn every_claim_on_the_papers_holds() {
    let paper_a = serde_json::to_value(paper_a(|_| {})).unwrap();
    let paper_b = serde_json::to_value(paper_b(|_| {})).unwrap();
    let (mut paper, mut claims, mut wrong) = (&Value::Null, 0, Vec::new());
    for line in include_str!("claims.txt").lines() {
        match line {
            "paper-a" => paper = &paper_a,
            "paper-b" => paper = &paper_b,
            remark if remark.starts_with('#') => {}
            claim => {
                claims += 1;
                if holds(paper, claim) != Some(true) {
                    wrong.push(claim);
                }
            }
        }
    }
    assert!(wrong.is_empty() && claims > 100, "{claims}: {wrong:#?}");
}

#[test]
fn a_claim_that_does_not_hold_and_one_on_nothing_are_found() {
    let paper = serde_json::json!({"rows": [{"id": "a", "x": 1.0}, {"id": "b", "x": null}]});
    for (claim, expected) in [
        ("rows.0.x in 0..1", Some(true)),
        ("rows.0.x in 2..3", Some(false)),
        ("rows.id=b.x never", Some(true)),
        ("rows.*.x never", Some(false)),
        ("rows.id=c.x never", Some(false)),
        ("rows.id=c.x in 0..1", Some(false)),
        ("rows.0.x / rows.0.x in 1..1", Some(true)),
        ("rows.*.x in 0..1", None),
        ("rows.0.x", None),
    ] {
        assert_eq!(holds(&paper, claim), expected, "{claim}");
    }
}
