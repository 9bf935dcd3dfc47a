//! What the hidden effects are given: sizes drawn evenly, about 3 to 15 % of what the motor is rated for.

use rand::Rng;

use rand_chacha::ChaCha8Rng;

use crate::plant::effect;

/// One key of an effect, or two of one amplitude.
pub(super) enum Draw {
    Between(&'static str, f64, f64),
    /// Of either sign.
    Signed(&'static str, f64, f64),
    OneOf(&'static str, &'static [f64]),
    /// Sine and cosine of one amplitude at a random phase.
    Phase([&'static str; 2], f64, f64),
}

use Draw::{Between, OneOf, Phase, Signed};

const SIN_COS_N_M: [&str; 2] = ["sin_n_m", "cos_n_m"];
const SIN_COS_RATIO: [&str; 2] = ["sin_ratio", "cos_ratio"];

/// What the host's catalogue has too: every one is a class of the study.
pub(super) const KNOWN: &[(&str, &[Draw])] = &[
    (
        "viscous_friction",
        &[Between("viscous_n_m_s_per_rad", 4e-4, 8e-4)],
    ),
    (
        "quadratic_load",
        &[Between("quadratic_n_m_s2_per_rad2", 1.2e-6, 2.8e-6)],
    ),
    (
        "stribeck_friction",
        &[
            Between("stribeck_n_m", 0.08, 0.16),
            Between("stribeck_speed_rad_s", 6.0, 18.0),
        ],
    ),
    ("constant_load", &[Signed("constant_n_m", 0.04, 0.12)]),
    (
        "asymmetric_viscous",
        &[Signed("asymmetry_n_m_s_per_rad", 2e-4, 5e-4)],
    ),
    (
        "cogging",
        &[
            OneOf("order", &[4.0, 6.0, 8.0, 9.0, 12.0, 14.0]),
            Phase(SIN_COS_N_M, 0.07, 0.15),
        ],
    ),
    (
        "torque_ripple",
        &[
            OneOf("order", &[3.0, 6.0, 8.0, 12.0]),
            Phase(SIN_COS_RATIO, 0.05, 0.12),
        ],
    ),
    ("eccentric_load", &[Phase(SIN_COS_N_M, 0.07, 0.18)]),
    ("load_dependent_friction", &[Between("ratio", 0.05, 0.12)]),
    (
        "load_step",
        &[Between("step_n_m", 0.08, 0.2), Between("time_s", 3.0, 6.0)],
    ),
    (
        "one_sided_load",
        &[Signed("load_n_m", 0.08, 0.2), Between("time_s", 3.0, 6.0)],
    ),
    (
        "friction_onset",
        &[
            Between("viscous_n_m_s_per_rad", 4e-4, 8e-4),
            Between("time_s", 3.0, 6.0),
        ],
    ),
    (
        "inertia_change",
        &[Between("ratio", 0.15, 0.4), Between("time_s", 3.0, 6.0)],
    ),
    (
        "elastic_coupling",
        &[
            Between("frequency_hz", 14.0, 30.0),
            Between("inertia_ratio", 0.35, 0.6),
            Between("damping_ratio", 0.03, 0.08),
            Between("friction_split", 0.2, 0.6),
        ],
    ),
    (
        "backlash",
        &[
            Between("frequency_hz", 35.0, 55.0),
            Between("inertia_ratio", 0.35, 0.6),
            Between("damping_ratio", 0.03, 0.08),
            Between("friction_split", 0.2, 0.6),
            Between("gap_rad", 0.03, 0.08),
        ],
    ),
    ("voltage_drop", &[Between("drop_v", 0.8, 2.0)]),
    ("supply_sag", &[Between("sag_ohm", 0.25, 0.6)]),
    (
        "winding_heating",
        &[
            Between("gain_per_a2_s", 0.8e-3, 2.2e-3),
            Between("time_constant_s", 8.0, 40.0),
        ],
    ),
    (
        "flux_saturation",
        &[Between("saturation_per_a2", 1.5e-4, 4e-4)],
    ),
    (
        "inductance_saturation",
        &[Between("saturation_per_a2", 2e-3, 5e-3)],
    ),
    ("field_change", &[Signed("drift_per_s", 0.003, 0.009)]),
    (
        "discontinuous_conduction",
        &[
            Between("boundary_a", 1.0, 2.5),
            Between("extra_ohm", 0.5, 1.5),
        ],
    ),
    ("command_delay", &[Between("delay_s", 0.8e-3, 2.5e-3)]),
    ("start_delay", &[Between("delay_s", 0.05, 0.2)]),
    ("speed_delay", &[Between("delay_s", 1.5e-3, 4e-3)]),
    ("speed_filter", &[Between("time_constant_s", 2e-3, 5e-3)]),
    ("current_filter", &[Between("time_constant_s", 1e-3, 3e-3)]),
    ("current_offset", &[Signed("offset_a", 0.1, 0.32)]),
    ("speed_offset", &[Signed("offset_rad_s", 0.6, 2.0)]),
    ("voltage_offset", &[Signed("offset_v", 0.3, 0.9)]),
];

/// What no catalogue of the host has: nothing known explains it.
pub(super) const UNKNOWN: &[(&str, &[Draw])] = &[
    (
        "shaker",
        &[
            Between("amplitude_n_m", 0.1, 0.2),
            Between("frequency_hz", 4.4, 5.6),
        ],
    ),
    (
        "torque_bump",
        &[
            Between("bump_n_m", 0.12, 0.2),
            Between("speed_rad_s", 70.0, 130.0),
            Between("width_rad_s", 12.0, 22.0),
        ],
    ),
    (
        "random_load",
        &[
            Between("std_n_m", 0.06, 0.12),
            Between("correlation_s", 0.15, 0.4),
        ],
    ),
];

/// A known effect in a shape that the catalogue does not have, and the names that are right for it.
pub(super) const WRONG_FORM: &[(&str, &[Draw], &[&str])] = &[
    (
        "exponential_stribeck",
        &[
            Between("stribeck_n_m", 0.08, 0.16),
            Between("stribeck_speed_rad_s", 6.0, 18.0),
        ],
        &["stribeck_friction"],
    ),
    (
        "fan_three_halves",
        &[Between("three_halves_n_m_s15_per_rad15", 2.2e-5, 4e-5)],
        &["quadratic_load", "viscous_friction"],
    ),
    (
        "soft_drop",
        &[Between("drop_v", 0.8, 2.0)],
        &["voltage_drop"],
    ),
    (
        "harmonic_cogging",
        &[
            OneOf("order", &[4.0, 6.0, 8.0, 9.0]),
            Phase(SIN_COS_N_M, 0.07, 0.15),
        ],
        &["cogging"],
    ),
    (
        "load_ramp",
        &[
            Between("step_n_m", 0.08, 0.2),
            Between("time_s", 3.0, 6.0),
            Between("rise_s", 0.5, 1.5),
        ],
        &["load_step"],
    ),
];

/// The names that are right for what the emulator calls `id`; none for what no catalogue has.
pub(super) fn right_names(id: &str) -> Vec<&'static str> {
    let known = KNOWN.iter().find(|(known, _)| *known == id);
    let other = WRONG_FORM.iter().find(|(other, ..)| *other == id);
    match (known, other) {
        (Some((id, _)), _) => vec![*id],
        (_, Some((_, _, names))) => names.to_vec(),
        _ => vec![],
    }
}

/// Two at once.
pub(super) const PAIRS: &[[&str; 2]] = &[
    ["viscous_friction", "voltage_drop"],
    ["cogging", "stribeck_friction"],
    ["quadratic_load", "supply_sag"],
    ["elastic_coupling", "voltage_drop"],
    ["current_offset", "viscous_friction"],
    ["command_delay", "quadratic_load"],
    ["eccentric_load", "winding_heating"],
    ["constant_load", "stribeck_friction"],
];

/// What the emulator's `messy` background is made of: naming one of these there is no mistake.
pub(super) const BACKGROUND: &[&str] =
    &["viscous_friction", "cogging", "command_delay", "supply_sag"];

fn draws_of(id: &str) -> &'static [Draw] {
    let known = KNOWN.iter().chain(UNKNOWN).map(|&(id, draws)| (id, draws));
    let wrong = WRONG_FORM.iter().map(|&(id, draws, _)| (id, draws));
    known
        .chain(wrong)
        .find(|(other, _)| *other == id)
        .map_or(&[], |(_, draws)| draws)
}

/// The effect as it stands in an emulator's configuration, drawn; what gives it its size is multiplied by `share`.
pub(super) fn drawn(id: &str, share: f64, rng: &mut ChaCha8Rng) -> toml::Table {
    let mut table = toml::Table::new();
    table.insert("id".to_owned(), id.into());
    let specs = effect::find(id).map_or(&[][..], |effect| effect.parameters());
    let is_size = |key: &str| {
        specs
            .iter()
            .any(|spec| spec.key == key && spec.is_coefficient())
    };
    let mut set = |key: &str, value: f64| {
        let share = if is_size(key) { share } else { 1.0 };
        table.insert(key.to_owned(), (share * value).into())
    };
    for draw in draws_of(id) {
        match draw {
            Between(key, low, high) => {
                set(key, rng.random_range(*low..*high));
            }
            Signed(key, low, high) => {
                let sign = if rng.random() { 1.0 } else { -1.0 };
                set(key, sign * rng.random_range(*low..*high));
            }
            OneOf(key, values) => {
                set(key, values[rng.random_range(0..values.len())]);
            }
            Phase([sine, cosine], low, high) => {
                let amplitude = rng.random_range(*low..*high);
                let phase = rng.random_range(0.0..std::f64::consts::TAU);
                set(sine, amplitude * phase.sin());
                set(cosine, amplitude * phase.cos());
            }
        }
    }
    table
}
