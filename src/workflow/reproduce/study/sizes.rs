//! What the study hides, and how large: sizes drawn evenly, about 3 to 15 % of what the motor is rated for. They stand with
//! the emulator's effects.

use rand_chacha::ChaCha8Rng;

use crate::emulator::truth::effect::HiddenEffect;
use crate::plant::{ParameterSpec, effect};

/// Ids of what the host's catalogue has too: every one is a class of the study.
pub(super) fn known() -> Vec<&'static str> {
    studied(|id, names| names.contains(&id))
}

/// Ids of what no catalogue of the host has: nothing known explains it.
pub(super) fn unknown() -> Vec<&'static str> {
    studied(|_, names| names.is_empty())
}

/// Ids of known effects in a shape that the catalogue does not have.
pub(super) fn wrong_form() -> Vec<&'static str> {
    studied(|id, names| !names.is_empty() && !names.contains(&id))
}

fn studied(is: impl Fn(&str, &[&str]) -> bool) -> Vec<&'static str> {
    let all = HiddenEffect::studied();
    all.filter(|(id, names)| is(id, names))
        .map(|(id, _)| id)
        .collect()
}

/// The names that are right for what the emulator calls `id`; none for what no catalogue has.
pub(super) fn right_names(id: &str) -> Vec<&'static str> {
    let mut all = HiddenEffect::studied();
    all.find(|(other, _)| *other == id)
        .map_or(vec![], |(_, names)| names.to_vec())
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

/// The effect as it stands in an emulator's configuration, drawn; what gives it its size is multiplied by `share`. `None`
/// for an id that the study does not hide.
pub(super) fn drawn(id: &str, share: f64, rng: &mut ChaCha8Rng) -> Option<HiddenEffect> {
    let specs = effect::find(id).map_or(&[][..], |effect| effect.parameters());
    let is_size = |key: &str| {
        let mut sizes = specs
            .iter()
            .filter(|spec| ParameterSpec::is_coefficient(spec));
        sizes.any(|spec| spec.key == key)
    };
    HiddenEffect::study(id, |key| if is_size(key) { share } else { 1.0 }, rng)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    /// The published scores stand on these machines: the order in which sizes are drawn must not change.
    #[test]
    fn the_machines_of_the_published_seeds_stay_as_they_are() {
        let ids = [known(), unknown(), wrong_form()].concat();
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        for seed in 1..=200 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            for id in &ids {
                let table = toml::Table::try_from(drawn(id, 0.7, &mut rng).unwrap()).unwrap();
                for byte in table.to_string().bytes() {
                    hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
                }
            }
        }
        assert_eq!(hash, 0x9ef4_0200_9859_0ad9);
    }
}
