//! Effects that say the same thing in more or fewer words, so that a model holds one of them.

/// Pairs of a simple effect and a richer one that contains it, or nearly: the richer one always fits at least as well,
/// and is named only where the simple one falls short.
const RICHER: &[(&str, &str)] = &[
    ("elastic_coupling", "backlash"),
    ("voltage_drop", "discontinuous_conduction"),
];

/// Effects that are one to first order: a model holds one of them.
const ALIKE: &[(&str, &str)] = &[
    ("speed_delay", "speed_filter"),
    ("start_delay", "restart_delay"),
];

/// Effects that take power, of which a size below zero is no machine: a fit that asks for one leans on something else
/// (a Stribeck curve of the wrong sign, gaps of a converter that would give power). A voltage drop may be over-compensated
/// by the drive, so that it is not among them.
const TAKE_POWER: &[&str] = &[
    "viscous_friction",
    "quadratic_load",
    "stribeck_friction",
    "load_dependent_friction",
    "supply_sag",
    "winding_heating",
    "discontinuous_conduction",
];

/// Whether physics allows this effect no size below zero.
pub(super) fn takes_power(id: &str) -> bool {
    TAKE_POWER.contains(&id)
}

/// The equation and the axis along which an effect is a curve.
const CURVES: &[(&str, &str, &str)] = &[
    ("viscous_friction", "torque", "speed_rad_s"),
    ("quadratic_load", "torque", "speed_rad_s"),
    ("stribeck_friction", "torque", "speed_rad_s"),
    ("asymmetric_viscous", "torque", "speed_rad_s"),
    ("constant_load", "torque", "speed_rad_s"),
    ("cogging", "torque", "angle_rad"),
    ("eccentric_load", "torque", "angle_rad"),
    ("load_step", "torque", "time_s"),
    ("field_change", "torque", "time_s"),
    ("voltage_drop", "voltage", "current_a"),
    ("discontinuous_conduction", "voltage", "current_a"),
    ("winding_heating", "voltage", "time_s"),
];

/// Equation and axis of the curve that an effect is; `None` where it is more than a curve.
pub(super) fn curve_of(id: &str) -> Option<(&'static str, &'static str)> {
    CURVES
        .iter()
        .find(|(known, _, _)| *known == id)
        .map(|(_, equation, axis)| (*equation, *axis))
}

/// Currents from which on gaps, not brushes, bend the voltage, A: the drop of brushes has built up at a tenth of it.
pub(super) const LEAST_BOUNDARY_A: f64 = 0.9;

/// Whether two effects are of one family, so that a model with one of them does not get the other too.
pub(super) fn related(a: &str, b: &str) -> bool {
    RICHER
        .iter()
        .chain(ALIKE)
        .any(|pair| *pair == (a, b) || *pair == (b, a))
}
