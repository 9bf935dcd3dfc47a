//! What the paper does not show: how slowly each scheme may sample. Noise-free, one motor sampled ever slower.

use rayon::prelude::*;
use serde::Serialize;

use super::machine::{forward, motor, value};
use super::schemes::{Errors, errors, record, taking_part};
use super::signal::{random, random_binary};
use super::{HOLD, LEVELS_V};
use crate::identification::scheme_1::{Form, Scheme1};
use crate::numerics::count::whole;
use crate::plant::MotorKey;

/// T/Ta and T/TM: two to a factor of three and a half.
const RATIOS: [f64; 11] = [0.01, 0.02, 0.03, 0.06, 0.1, 0.2, 0.3, 0.6, 1.0, 2.0, 3.0];
/// TM/Ta of the motor that is swept over T/Ta: both poles real and well apart.
const WELL_DAMPED: f64 = 5.0;
/// TM/Ta of the motor that is swept over T/TM: with the same T/Ta, so that it is its armature circuit that oscillates.
const OSCILLATING: f64 = 1.0;
/// Ta of the first motor is that of the ZK-22FC; the second has its TM and a choke before the armature.
const TA_S: f64 = 0.009;
const TA_WITH_CHOKE_S: f64 = 0.03;
const FEWEST_SAMPLES: usize = 400;
/// Mechanical time constants that a record lasts at least.
const LEAST_LENGTH: f64 = 40.0;
const SEED: u64 = 1;
/// TM/Ta of PHYSICS.md's table at T = Ta.
const AT_TA: [f64; 5] = [1.0, 2.0, 5.0, 10.0, 30.0];

/// Errors of one scheme at each ratio.
#[derive(Clone, Debug, Serialize)]
pub struct Curve {
    pub scheme: &'static str,
    pub errors: Vec<Errors>,
}

/// One motor sampled with ever longer periods.
#[derive(Clone, Debug, Serialize)]
pub struct Sweep {
    /// `T/Ta` or `T/TM`.
    pub against: &'static str,
    pub tm_over_ta: f64,
    pub electrical_time_constant_s: f64,
    pub ratios: Vec<f64>,
    pub curves: Vec<Curve>,
}

/// The printed and the exact form of scheme 1 at T = Ta.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AtTa {
    pub tm_over_ta: f64,
    pub printed: Errors,
    pub exact: Errors,
}

#[derive(Clone, Debug, Serialize)]
pub struct Sampling {
    pub sweeps: Vec<Sweep>,
    pub at_ta: Vec<AtTa>,
}

pub(super) fn sampling() -> Sampling {
    Sampling {
        sweeps: vec![
            sweep("T/Ta", TA_S, WELL_DAMPED),
            sweep("T/TM", TA_WITH_CHOKE_S, OSCILLATING),
        ],
        at_ta: AT_TA.map(at_ta).into(),
    }
}

fn sweep(against: &'static str, ta_s: f64, tm_over_ta: f64) -> Sweep {
    let tm_s = tm_over_ta * ta_s;
    let motor = motor(ta_s, tm_s);
    let unit_s = if against == "T/TM" { tm_s } else { ta_s };
    let records: Vec<_> = RATIOS
        .into_par_iter()
        .map(|ratio| {
            let period_s = ratio * unit_s;
            let least = whole(LEAST_LENGTH * tm_s / period_s);
            record(&motor, period_s, least.max(FEWEST_SAMPLES), SEED, None)
        })
        .collect();
    let curves = taking_part().map(|scheme| Curve {
        scheme: scheme.id(),
        errors: records
            .par_iter()
            .map(|record| errors(scheme, record))
            .collect(),
    });
    Sweep {
        against,
        tm_over_ta,
        electrical_time_constant_s: ta_s,
        ratios: RATIOS.into(),
        curves: curves.collect(),
    }
}

fn at_ta(tm_over_ta: f64) -> AtTa {
    let motor = motor(TA_S, tm_over_ta * TA_S);
    let volts = random_binary(&mut random(SEED, 1), LEVELS_V, HOLD, FEWEST_SAMPLES);
    let turning = forward(&[(&motor, FEWEST_SAMPLES)], TA_S, &volts, None);
    let of = |form: Form| {
        let mut scheme = Scheme1::new(form, TA_S, 1.0);
        for (k, at) in turning.iter().enumerate() {
            // The voltage of the interval that ends at this sample.
            scheme.push(volts[k.saturating_sub(1)], at.speed_rad_s, 1);
        }
        let found = scheme.parameters(value(&motor, MotorKey::Resistance), None);
        found.map_or_else(
            |_| Errors::default(),
            |found| {
                let (ta_s, tm_s) = (found.ta_s, found.tm_s);
                let found = [ta_s, tm_s, found.ke, found.inertia, found.load_torque];
                Errors::between(found.map(Some), &motor)
            },
        )
    };
    AtTa {
        tm_over_ta,
        printed: of(Form::Printed),
        exact: of(Form::Exact),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_ta_the_printed_form_errs_as_derived_and_the_exact_one_does_not() {
        // PHYSICS.md section 3: TM/Ta, then the errors of Ta and TM in per cent.
        let derived = [
            (1.0, -22.0, 105.0),
            (2.0, 1.0, 53.0),
            (5.0, 25.0, 22.0),
            (10.0, 35.0, 12.0),
            (30.0, 44.0, 5.0),
        ];
        for (row, (tm_over_ta, ta, tm)) in AT_TA.map(at_ta).iter().zip(derived) {
            println!("{row:?}");
            assert!((row.tm_over_ta - tm_over_ta).abs() < 1e-12);
            assert!(
                (row.printed.electrical_time_constant.unwrap() - ta).abs() < 4.0,
                "{row:?}"
            );
            assert!(
                (row.printed.mechanical_time_constant.unwrap() - tm).abs() < 4.0,
                "{row:?}"
            );
            for error in row.exact.to_array() {
                assert!(error.unwrap().abs() < 1e-3, "{row:?}");
            }
        }
    }

    #[test]
    fn the_exact_form_holds_where_the_printed_one_errs_by_tens_of_per_cent() {
        let found = sampling();
        for sweep in &found.sweeps {
            let curve = |id: &str| sweep.curves.iter().find(|c| c.scheme == id).unwrap();
            for errors in &curve("1-exact").errors {
                for error in errors.to_array() {
                    assert!(error.unwrap().abs() < 0.1, "{} {errors:?}", sweep.against);
                }
            }
            for (ratio, errors) in sweep.ratios.iter().zip(&curve("1").errors) {
                let (ta, tm) = (
                    errors.electrical_time_constant,
                    errors.mechanical_time_constant,
                );
                if (*ratio - 1.0).abs() < 1e-9 {
                    assert!(ta.unwrap().abs() > 20.0 && tm.unwrap() > 20.0, "{errors:?}");
                }
                if *ratio < 0.011 {
                    assert!(
                        ta.unwrap().abs() < 1.0 && tm.unwrap().abs() < 2.0,
                        "{errors:?}"
                    );
                }
            }
            // What a scheme says it cannot tell counts as any error.
            let inertia = |id: &str, row: usize| {
                curve(id).errors[row]
                    .inertia
                    .map_or(f64::INFINITY, f64::abs)
            };
            for (row, ratio) in sweep.ratios.iter().enumerate().filter(|(_, r)| **r <= 0.3) {
                assert!(inertia("2", row) < 1.0, "{} {ratio}", sweep.against);
                assert!(inertia("3", row) < 0.2, "{} {ratio}", sweep.against);
            }
            let at_one = sweep
                .ratios
                .iter()
                .position(|r| (r - 1.0).abs() < 1e-9)
                .unwrap();
            assert!(inertia("2-rectangle", at_one) > 3.0 * inertia("2", at_one));
        }
    }
}
