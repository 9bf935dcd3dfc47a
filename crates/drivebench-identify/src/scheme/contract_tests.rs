//! Contract of every scheme of the catalogue, whatever its method.
#![cfg(test)]

use super::*;
use crate::testing::{self, *};
use drivebench_model::plant::effect;
use drivebench_model::sample::Verdict;

fn steps() -> Vec<(f64, f64)> {
    let levels = [30.0, 60.0, 20.0, -30.0, -60.0, -10.0, 40.0, 0.0];
    let mut events = vec![(0.0, 0.0)];
    for (k, volts) in levels.iter().cycle().take(24).enumerate() {
        events.push((0.4 + 0.25 * k as f64, *volts));
    }
    events
}

/// With the resistance known; `None` where the scheme refuses with a reason.
fn found_by(scheme: &Scheme, run: &Run) -> Option<Identified> {
    Scenario::from_run(run).ok()?;
    let mut model = paper();
    model.fixed.push(MotorKey::Resistance.key().to_owned());
    let found = identify(scheme.id(), run, &model);
    if let Err(error) = &found {
        assert!(!error.to_string().is_empty() && !error.help().is_empty());
    }
    found.ok()
}

fn holds_the_contract(found: &Identified, scheme: &Scheme) {
    assert_eq!(found.scheme, scheme.id());
    for parameter in &found.parameters {
        let open = parameter.verdict == Verdict::NotObservable;
        let finite = |number: Option<f64>| number.is_none_or(f64::is_finite);
        let reasoned = matches!(parameter.verdict, Verdict::Settled | Verdict::Fixed)
            || parameter.reason.as_deref().is_some_and(|r| !r.is_empty());
        let sound = parameter.value.is_none() == open
            && !(open && parameter.std.is_some())
            && finite(parameter.value)
            && finite(parameter.std)
            && reasoned;
        assert!(sound, "{parameter:?}");
    }
}

/// Schemes that noise biases, or that are read from a graph: they give a value and settle nothing.
const BIASED: [&str; 5] = ["1", "1-exact", "2", "2-rectangle", "step-response"];

#[test]
fn on_a_well_excited_run_inertia_is_found_by_every_scheme() {
    let run = recorded(&record(&paper(), steps(), 0.002, 6.5, 11));
    for scheme in CATALOGUE {
        let found = found_by(scheme, &run).expect("a rich run serves every scheme");
        holds_the_contract(&found, scheme);
        let inertia = of(&found.parameters, "inertia_kg_m2");
        let (verdict, most) = if BIASED.contains(&scheme.id()) {
            (Verdict::Searching, 0.15)
        } else {
            (Verdict::Settled, 0.05)
        };
        let off = inertia.value.unwrap() / 0.0045 - 1.0;
        let is_found = inertia.verdict == verdict && off.abs() < most;
        assert!(is_found, "{} {inertia:?}", scheme.id());
    }
}

#[test]
fn poor_data_settle_nothing() {
    let model = paper();
    let standstill = recorded(&record(&model, vec![(0.0, 0.0)], 0.002, 3.0, 1));
    let two_rows = recorded(&record(&model, steps(), 0.002, 0.004, 2));
    let mut constant = recorded(&record(&model, vec![(0.0, 0.0)], 0.002, 3.0, 3));
    for (channel, level) in
        [(Channel::Voltage, 40.0), (Channel::Current, 1.3), (Channel::Speed, 109.0)]
    {
        let noise = standstill.column(channel).unwrap();
        constant = changed(&constant, channel, |row, _| level + noise[row]);
    }
    for run in [&standstill, &two_rows, &constant] {
        for scheme in CATALOGUE {
            let Some(found) = found_by(scheme, run) else { continue };
            holds_the_contract(&found, scheme);
            // A steady state with a known resistance does carry the back-EMF constant and the torque.
            let steady = run.name == constant.name;
            let dynamic = [MotorKey::Inductance, MotorKey::Inertia].map(MotorKey::key);
            for parameter in &found.parameters {
                if steady && !dynamic.contains(&parameter.key.as_str()) {
                    continue;
                }
                let settled = parameter.verdict == Verdict::Settled;
                assert!(!settled, "{} {} {parameter:?}", scheme.id(), run.name);
            }
        }
    }
}

#[test]
fn names_are_unique_and_the_error_of_an_unknown_one_lists_them() {
    for scheme in CATALOGUE {
        assert_eq!(find(scheme.id()).unwrap().id(), scheme.id());
        assert!(!scheme.summary().is_empty());
    }
    let ids: std::collections::HashSet<_> = CATALOGUE.iter().map(|s| s.id()).collect();
    assert_eq!(ids.len(), CATALOGUE.len());
    let Err(error) = find("4") else { panic!("there is no scheme 4") };
    assert!(error.to_string().contains("output-error"), "{error}");
}

#[test]
fn no_scheme_leaves_an_effect_out_in_silence() {
    let run = recorded(&record(&paper(), steps(), 0.002, 6.5, 17));
    let mut model = paper();
    for effect in effect::CATALOGUE {
        if let Ok(more) = model.with_effect(effect.card().id) {
            model = more;
        }
    }
    // The fit of the free run carries whatever can be simulated.
    for scheme in CATALOGUE.iter().filter(|s| s.id() != "output-error") {
        let found = identify(scheme.id(), &run, &model).unwrap();
        for id in model.effect_ids() {
            let prefix = format!("{id}.");
            let mut own = found.parameters.iter().filter(|p| p.key.starts_with(&prefix));
            let estimated = own.any(|p| p.value.is_some() || p.reason.is_some());
            let noted = found.notes.iter().any(|note| note.starts_with(id));
            assert!(estimated || noted, "{} ignores {id}", scheme.id());
            let twice = |p: &ParameterEstimate| {
                found.parameters.iter().filter(|q| q.key == p.key).count() > 1
            };
            assert!(!found.parameters.iter().any(twice), "{}", scheme.id());
        }
    }
}

#[test]
fn balances_find_the_effects_that_are_terms_of_them() {
    for (id, values) in [
        ("asymmetric_viscous", vec![8e-4]),
        ("cogging", vec![0.1, 0.0, 2.0]),
        ("torque_ripple", vec![0.2, 0.0, 2.0]),
        ("eccentric_load", vec![0.1, -0.05]),
        ("load_dependent_friction", vec![0.2]),
        ("supply_sag", vec![0.6]),
        ("field_change", vec![0.02]),
        ("discontinuous_conduction", vec![2.0, 1.5]),
        ("voltage_offset", vec![1.5]),
    ] {
        let truth = testing::paper_with(id, &values);
        let run = recorded(&record(&truth, steps(), 0.001, 6.5, 19));
        let specs = truth.effects[0].effect.parameters();
        let mut model = truth.clone();
        for (value, spec) in model.effects[0].values.iter_mut().zip(specs) {
            *value = value.filter(|_| !spec.is_coefficient());
        }
        for scheme in ["weak-form", "inverse-dynamics"] {
            let found = identify(scheme, &run, &model).unwrap();
            let size = of(&found.parameters, &format!("{id}.{}", specs[0].key));
            let ratio = size.value.unwrap_or(f64::NAN) / values[0];
            assert!((ratio - 1.0).abs() < 0.15, "{scheme} {ratio} {size:?}");
        }
    }
}
