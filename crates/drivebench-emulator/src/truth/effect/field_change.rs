//! Magnets that warm up and lose flux.

use super::{Acts, HiddenKind, Signed, flux_factor};

/// Thermal time constant of the magnets, s.
const MAGNET_TIME_CONSTANT_S: f64 = 60.0;

/// Flux that changes by `drift_per_s` of itself at first, from each start of the drive on.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "field_change",
    names: &["field_change"],
    parameters: &[Signed.of("drift_per_s", "1/s", -5e-3, 0.003..0.009)],
    mystery: Some(|dice| {
        // Warm magnets lose flux: 3 to 10 % in ten seconds.
        vec![-dice.size(0.003, 0.01)]
    }),
    acts: Acts::Inside(|values, _| {
        let settled = values[0] * MAGNET_TIME_CONSTANT_S;
        // phi = 1 + drift T (1 - exp(-t/T)), T = 60 s: over a run of 12 s it bends by a tenth from the host's 1 + drift t.
        // Each run begins with cold magnets: the pause before it counts as long enough.
        flux_factor(move |at| {
            let share = -(-at.time_s / MAGNET_TIME_CONSTANT_S).exp_m1();
            // A field does not turn over.
            (1.0 + settled * share).max(0.05)
        })
    }),
};
