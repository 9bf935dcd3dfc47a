//! Inverse dynamics: the field's reference processing.

use super::left_out::{of_balances, once_each};
use super::{Data, Identified, IdentifyError, Scheme, weak_form};
use crate::identification::inverse_dynamics;
use crate::plant::{Balance, Input};
use crate::sample::ParameterEstimate;

pub(super) struct InverseDynamics;

impl Scheme for InverseDynamics {
    fn id(&self) -> &'static str {
        "inverse-dynamics"
    }

    fn summary(&self) -> &'static str {
        "balances low-passed without phase shift, differentiated, decimated: the field's reference"
    }

    fn identify(&self, data: &Data<'_>) -> Result<Identified, IdentifyError> {
        let balances = inverse_dynamics::fit(data.model, data.run, data.scenario);
        let mut notes = Vec::new();
        for balance in &balances {
            if let (Some(processing), Balance::Torque) = (&balance.processing, balance.equation) {
                notes.push(processing.sentence());
                if balance.rows == 0 {
                    continue;
                }
                notes.push(format!(
                    "{} of {} rows left out: at rest (below {:.3e} rad/s for half the filter's reach or longer), where \
                     friction is not determined, and at the ends; reversals stay in. Error {:.2} % of the torque; the \
                     offsets of the decimation differ by up to {:.2} %",
                    balance.rows_left_out,
                    balance.rows,
                    processing.dead_zone_rad_s,
                    balance.relative_error_percent,
                    balance.offset_spread_percent
                ));
            }
        }
        let parameters = balances
            .into_iter()
            .flat_map(|balance| balance.parameters)
            .collect();
        let parameters = once_each(parameters);
        let other = weak_form::parameters(data.model, data.scenario)?;
        notes.extend(compared(&parameters, &other));
        let mut identified = Identified::new(self.id(), data.model, parameters);
        identified.notes = notes;
        let electrical = data.scenario.input == Input::Voltage;
        Ok(identified.leaving_out(data.model, of_balances(data.model, electrical)))
    }
}

/// Both methods' values side by side, and why they differ.
fn compared(ours: &[ParameterEstimate], weak: &[ParameterEstimate]) -> Option<String> {
    let pairs: Vec<String> = ours
        .iter()
        .filter_map(|p| {
            let value = p.value.filter(|_| p.std != Some(0.0))?;
            let other = weak.iter().find(|w| w.key == p.key)?.value?;
            Some(format!(
                "{} {value:.digits$} here, {other:.digits$} there ({:+.1} %)",
                p.key,
                100.0 * (other / value - 1.0),
                digits = decimals(value)
            ))
        })
        .collect();
    (!pairs.is_empty()).then(|| {
        format!(
            "beside the weak form: {}. It averages over windows, and leaves out every window with a slow sample; this one \
             filters, and keeps reversals. Where the machine's friction is not quite the model's (viscous friction that \
             differs by direction, friction that changes near standstill) the two spread the misfit differently: a \
             difference of some per cent is the model's, not the noise's",
            pairs.join("; ")
        )
    })
}

/// Decimals that show five digits of a value.
fn decimals(value: f64) -> usize {
    let magnitude = value.abs().max(1e-12).log10().floor();
    crate::numerics::count::whole((4.0 - magnitude).max(0.0))
}
