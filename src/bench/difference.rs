//! Whether two JSON results are the same to the last bit, and where they first are not.

use serde::Serialize;
use serde_json::{Map, Value};

/// Where two results differ first.
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
        if path.is_empty() {
            key.to_owned()
        } else {
            format!("{path}.{key}")
        }
    };
    let differs = || {
        Some(Difference {
            key: path.to_owned(),
            live: live.clone(),
            replayed: replayed.clone(),
        })
    };
    let missing = Value::Null;
    match (live, replayed) {
        (Value::Object(a), Value::Object(b)) => a
            .keys()
            .chain(b.keys().filter(|key| !a.contains_key(*key)))
            .find_map(|key| {
                let side = |map: &Map<String, Value>| map.get(key).cloned();
                match (side(a), side(b)) {
                    (Some(a), Some(b)) => difference_at(&below(key), &a, &b),
                    (a, b) => Some(Difference {
                        key: below(key),
                        live: a.unwrap_or_default(),
                        replayed: b.unwrap_or_default(),
                    }),
                }
            }),
        (Value::Array(a), Value::Array(b)) => (0..a.len().max(b.len())).find_map(|index| {
            let item = |array: &[Value]| array.get(index).unwrap_or(&missing).clone();
            difference_at(&below(&index.to_string()), &item(a), &item(b))
        }),
        (Value::Number(a), Value::Number(b)) => {
            let same = match (a.as_f64(), b.as_f64()) {
                (Some(x), Some(y)) => x.to_bits() == y.to_bits(),
                _ => a == b,
            };
            if same { None } else { differs() }
        }
        _ if live == replayed => None,
        _ => differs(),
    }
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
        for (other, key) in [
            (json!({"a": {"x": ulp, "y": [1, 2]}, "b": null}), "a.x"),
            (json!({"a": {"x": 1.0, "y": [1, 3]}, "b": null}), "a.y.1"),
            (json!({"a": {"x": 1.0, "y": [1, 2, 3]}, "b": null}), "a.y.2"),
            (json!({"a": {"x": 1.0, "y": [1, 2]}, "b": 0}), "b"),
            (json!({"a": {"x": 1.0, "y": [1, 2]}}), "b"),
            (
                json!({"a": {"x": 1.0, "y": [1, 2]}, "b": null, "c": "new"}),
                "c",
            ),
        ] {
            let found = first_difference(&live, &other);
            assert_eq!(found.map(|d| d.key), Some(key.to_owned()), "{other}");
        }
    }

    #[test]
    fn a_number_survives_the_text_of_a_result() {
        // Only a parser that rounds correctly gives every number back: the last digit of many is at stake.
        let mut bits: u64 = 0x1234_5678_9abc_def0;
        for _ in 0..20_000 {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let value = f64::from_bits((bits >> 12) | 0x3ff0_0000_0000_0000) * 1e-3;
            let text = serde_json::to_string(&json!({ "v": value })).unwrap();
            let back: Value = serde_json::from_str(&text).unwrap();
            assert_eq!(
                first_difference(&json!({ "v": value }), &back),
                None,
                "{text}"
            );
        }
    }
}
