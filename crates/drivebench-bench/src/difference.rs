//! Comparison of two JSON results to the last bit: the first place in which they differ.

use serde::Serialize;
use serde_json::Value;

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Path of the key, as `parameters.inertia_kg_m2.value`.
    pub key: String,
    pub live: Value,
    pub replayed: Value,
}

/// Compares two JSON values to the last bit; `None` where they are identical.
pub fn first_difference(live: &Value, replayed: &Value) -> Option<Difference> {
    difference_at("", live, replayed)
}

fn difference_at(path: &str, live: &Value, replayed: &Value) -> Option<Difference> {
    let below = |key: &str| {
        let dot = if path.is_empty() { "" } else { "." };
        format!("{path}{dot}{key}")
    };
    let differ = |key: String, live: Option<&Value>, replayed: Option<&Value>| Difference {
        key,
        live: live.cloned().unwrap_or_default(),
        replayed: replayed.cloned().unwrap_or_default(),
    };
    let same = match (live, replayed) {
        (Value::Object(a), Value::Object(b)) => {
            let of_both = a.keys().chain(b.keys().filter(|key| !a.contains_key(*key)));
            let mut found = of_both.map(|key| match (a.get(key), b.get(key)) {
                (Some(a), Some(b)) => difference_at(&below(key), a, b),
                (a, b) => Some(differ(below(key), a, b)),
            });
            return found.find_map(|difference| difference);
        }
        (Value::Array(a), Value::Array(b)) => {
            let item = |array: &[Value], at: usize| array.get(at).cloned().unwrap_or_default();
            let at = |at: usize| difference_at(&below(&at.to_string()), &item(a, at), &item(b, at));
            return (0..a.len().max(b.len())).find_map(at);
        }
        (Value::Number(a), Value::Number(b)) => match (a.as_f64(), b.as_f64()) {
            (Some(x), Some(y)) => x.to_bits() == y.to_bits(),
            _ => a == b,
        },
        _ => live == replayed,
    };
    (!same).then(|| differ(path.to_owned(), Some(live), Some(replayed)))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn the_first_key_that_differs_is_named_with_both_values() {
        let live = json!({"a": {"x": 1.0, "y": [1, 2]}, "b": null});
        assert_eq!(first_difference(&live, &live.clone()), None);
        let ulp = 1.0_f64.next_up();
        let more = json!({"a": {"x": 1.0, "y": [1, 2]}, "b": null, "c": "new"});
        for (other, key) in [
            (json!({"a": {"x": ulp, "y": [1, 2]}, "b": null}), "a.x"),
            (json!({"a": {"x": 1.0, "y": [1, 3]}, "b": null}), "a.y.1"),
            (json!({"a": {"x": 1.0, "y": [1, 2, 3]}, "b": null}), "a.y.2"),
            (json!({"a": {"x": 1.0, "y": [1, 2]}, "b": 0}), "b"),
            (json!({"a": {"x": 1.0, "y": [1, 2]}}), "b"),
            (more, "c"),
        ] {
            let found = first_difference(&live, &other);
            assert_eq!(found.map(|d| d.key), Some(key.to_owned()), "{other}");
        }
    }

    #[test]
    fn a_number_survives_the_text_of_a_result() {
        // Only a parser with correct rounding returns every number to the last bit.
        let mut bits: u64 = 0x1234_5678_9abc_def0;
        for _ in 0..20_000 {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let value = f64::from_bits((bits >> 12) | 0x3ff0_0000_0000_0000) * 1e-3;
            let text = serde_json::to_string(&json!({ "v": value })).unwrap();
            let back: Value = serde_json::from_str(&text).unwrap();
            assert_eq!(first_difference(&json!({ "v": value }), &back), None, "{text}");
        }
    }
}
