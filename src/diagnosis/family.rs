//! Effects that say the same thing in more or fewer words.

/// Pairs of a simple effect and a richer one that contains it, or nearly: the richer one always fits at least as well,
/// and is named only where the simple one falls short.
const RICHER: &[(&str, &str)] = &[
    ("elastic_coupling", "backlash"),
    ("voltage_drop", "discontinuous_conduction"),
];

/// Effects that are one to first order: a model holds one of them.
const ALIKE: &[(&str, &str)] = &[("speed_delay", "speed_filter")];

/// The simple form of a richer effect.
pub(super) fn simple_form(id: &str) -> Option<&'static str> {
    RICHER
        .iter()
        .find(|(_, richer)| *richer == id)
        .map(|(simple, _)| *simple)
}

/// Whether two effects are of one family, so that a model with one of them does not get the other too.
pub(super) fn related(a: &str, b: &str) -> bool {
    RICHER
        .iter()
        .chain(ALIKE)
        .any(|pair| *pair == (a, b) || *pair == (b, a))
}
