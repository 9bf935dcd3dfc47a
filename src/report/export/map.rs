//! A measured torque map as a table in C, with a function that reads it.

use super::identifier;
use drivebench_model::plant::{MapBin, MappedTorque, MappedValue, TorqueMap};

/// The map as one C99 header. `title`: what it is and where it comes from.
pub fn map_as_c(map: &TorqueMap, name: &str, title: &str) -> String {
    let name = identifier(name);
    let (place, unit) = map.torque.axis();
    let turns = map.torque == MappedTorque::Cogging;
    let inside = format!("along >= 0.0f && along <= (float){{{{NAME}}}}_BINS && {place} != 0.0f");
    let beyond_zero = "    /* Friction does not lead through zero. */\n    there = next >= 0 && next < {{NAME}}_BINS && (next < {{NAME}}_BINS / 2) == (own < {{NAME}}_BINS / 2) ? {{name}}_torque_n_m[next] : here;";
    let (wrap, inside, beyond) = if turns {
        (
            format!("    {place} -= 6.28318531f * floorf({place} / 6.28318531f);"),
            "along >= 0.0f".to_owned(),
            "    there = {{name}}_torque_n_m[(next + {{NAME}}_BINS) % {{NAME}}_BINS];",
        )
    } else {
        (String::new(), inside, beyond_zero)
    };
    let list = |of: fn(&MappedValue) -> f64| -> String {
        let cell = |bin: &MapBin| match &bin.torque {
            Some(value) => format!("{}f", float(of(value))),
            None => "NAN".to_owned(),
        };
        let lines = map.bins.chunks(8).map(|bins| {
            let cells: Vec<String> = bins.iter().map(cell).collect();
            format!("    {},", cells.join(", "))
        });
        lines.collect::<Vec<_>>().join("\n")
    };
    let first = &map.bins[0];
    let mut text = include_str!("map.h").to_owned();
    if wrap.is_empty() {
        text = text.replace("{{wrap}}\n", "");
    }
    for (key, value) in [
        ("wrap", wrap.as_str()),
        ("inside", inside.as_str()),
        ("beyond", beyond),
        ("means", &list(|value| value.torque_n_m)),
        ("lows", &list(|value| value.low_n_m)),
        ("highs", &list(|value| value.high_n_m)),
        ("count", &map.bins.len().to_string()),
        ("first", &float(first.from)),
        ("width", &float(first.to - first.from)),
        ("unit", unit),
        ("place", place),
        ("suffix", if turns { "rad" } else { "rad_s" }),
        ("axis", if turns { "the angle within a turn" } else { "the speed, both directions" }),
        ("title", &title.replace("*/", "* /")),
        ("name", &name),
        ("NAME", &name.to_uppercase()),
    ] {
        text = text.replace(&format!("{{{{{key}}}}}"), value);
    }
    text
}

#[expect(clippy::cast_possible_truncation, reason = "the table is of floats")]
fn float(value: f64) -> String {
    format!("{:?}", value as f32)
}
