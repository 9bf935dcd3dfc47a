//! A fitted model as the diagnosis hands it on, whatever method fitted it.

use crate::identification::noise::NoiseFloor;
use crate::identification::output_error::Fit;
use crate::plant::{Model, ParameterSpec, State, effect};
use crate::sample::ParameterEstimate;

/// A model with what is known about its parameters.
#[derive(Clone, Debug)]
pub struct Fitted {
    pub model: Model,
    /// Every parameter of the model, in the order of its slots.
    pub parameters: Vec<ParameterEstimate>,
    /// Training error in units of the noise.
    pub nrms: f64,
    pub noise: NoiseFloor,
    /// What the standard deviations above were multiplied by, because more than noise is left over.
    pub interval_factor: f64,
    /// Where the training run begins.
    pub start: State,
}

impl Fitted {
    /// Whether a size of an effect lies `sigmas` of its standard deviations from zero: one of its coefficients, or where its
    /// shape is all that there is, of that. None where no size is known.
    pub(super) fn is_told_from_zero(&self, id: &str, sigmas: f64) -> Option<bool> {
        let specs = effect::find(id)?.parameters();
        let has_coefficients = specs.iter().any(ParameterSpec::is_coefficient);
        let sizes = specs.iter();
        let sizes = sizes.filter(|spec| !has_coefficients || spec.is_coefficient());
        let sizes = sizes.filter_map(|spec| {
            let key = format!("{id}.{}", spec.key);
            let own = self.parameters.iter().find(|own| own.key == key)?;
            own.value.zip(own.std)
        });
        let told = sizes.map(|(value, std)| value.abs() > 0.0 && value.abs() >= sigmas * std);
        told.reduce(|told, another| told || another)
    }
}

impl From<&Fit> for Fitted {
    fn from(fit: &Fit) -> Self {
        Self {
            model: fit.model.clone(),
            parameters: fit.parameters.clone(),
            nrms: fit.nrms,
            noise: fit.noise,
            interval_factor: fit.interval_factor,
            start: fit.start,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::tests::{nameplate, record};
    use crate::identification::output_error;
    use crate::sample::Verdict;

    #[test]
    fn a_size_counts_and_not_the_shape_of_what_has_none() {
        let run = record(&nameplate(), 0, 7);
        let noise = NoiseFloor::from_standstill(&run).unwrap();
        let fit = output_error::fit(&[nameplate()], &run, &noise).unwrap();
        let told = |values: &[(&str, f64, Option<f64>)]| {
            let mut fit = Fitted::from(&fit);
            fit.parameters = values
                .iter()
                .map(|(key, value, std)| ParameterEstimate {
                    key: (*key).to_owned(),
                    value: Some(*value),
                    std: *std,
                    unit: "",
                    verdict: Verdict::Settled,
                    reason: None,
                })
                .collect();
            move |id: &str, sigmas: f64| fit.is_told_from_zero(id, sigmas)
        };
        // A speed of 33 +- 3 rad/s is no size.
        let stribeck = told(&[
            ("stribeck_friction.stribeck_n_m", 5e-3, Some(2.2e-2)),
            ("stribeck_friction.speed_rad_s", 33.0, Some(3.0)),
        ]);
        assert_eq!(stribeck("stribeck_friction", 1.0), Some(false));
        let wave = told(&[
            ("cogging.sin_n_m", 1e-3, Some(2e-2)),
            ("cogging.cos_n_m", -5e-2, Some(2e-2)),
        ]);
        assert_eq!(wave("cogging", 2.0), Some(true));
        assert_eq!(wave("cogging", 3.0), Some(false));
        // Nothing is nothing, however well it is known.
        let none = told(&[("voltage_drop.drop_v", 0.0, Some(0.0))]);
        assert_eq!(none("voltage_drop", 1.0), Some(false));
        // A coupling has nothing but its shape.
        let coupling = told(&[("elastic_coupling.frequency_hz", 20.0, Some(0.1))]);
        assert_eq!(coupling("elastic_coupling", 1.0), Some(true));
        assert_eq!(
            told(&[("cogging.sin_n_m", 1.0, None)])("cogging", 1.0),
            None
        );
        assert_eq!(wave("voltage_drop", 1.0), None);
    }
}
