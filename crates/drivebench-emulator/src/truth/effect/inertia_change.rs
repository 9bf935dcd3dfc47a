//! A workpiece that is clamped some time after the drive was started.

use super::{Acts, HiddenKind, NotNegative, inertia_factor, named};

/// Inertia larger by the share `ratio` from `time_s` after each start of the drive on; the speed does not jump. A
/// change of inertia has no other form.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "inertia_change",
    names: &["inertia_change"],
    parameters: &[
        NotNegative.of("ratio", "-", 0.3, 0.15..0.4),
        NotNegative.of("time_s", "s", 0.6, 3.0..6.0),
    ],
    mystery: Some(|dice| vec![dice.size(0.1, 0.5), dice.between(3.0, 9.0)]),
    acts: Acts::Inside(|values, _| {
        let [ratio, time_s] = named(values);
        inertia_factor(move |at| if at.time_s >= time_s { 1.0 + ratio } else { 1.0 })
    }),
};
