//! Every recommended run is a bench file that plans within its limits.

use super::*;
use drivebench_bench::plan_run;
use drivebench_diagnose::{Evidence, next_experiment::menu_within};
use drivebench_model::plant::{Motor, testing};

fn evidence(model: &Model) -> Evidence {
    let events = vec![(0.0, 0.0), (0.5, 40.0), (1.2, 55.0), (1.9, -20.0)];
    let run = |seed| testing::record(model, events.clone(), 0.01, 2.6, seed);
    Evidence::new(run(1), Some(run(2)), None)
}

#[test]
fn every_recipe_is_a_bench_file_within_the_limits() {
    let model = Model::baseline(Motor::zk_22fc());
    let bench = BenchFile::embedded_default();
    let recipes = menu_within(&model, &experiment_limits(&bench));
    assert!(recipes.len() > 9, "{} recipes", recipes.len());
    for recipe in &recipes {
        let text = next_bench(&bench, recipe, &model, "Run this, because of that.");
        assert!(text.starts_with("# Run this"));
        let read = BenchFile::parse("next.toml", &text).unwrap();
        assert_eq!(read.sequence, recipe.segments);
        assert!(read.name.ends_with(&recipe.id.replace('_', "-")));
        let nameplate = read.nameplate().unwrap();
        // The drive's own limit is 11.4 A.
        let plan = plan_run(&read, 1, &nameplate, 100.0, Some(11.4)).unwrap();
        assert!(!plan.is_refused(), "{}: {:?}", recipe.id, plan.refusals);
        // A bench made from a recommended run has one name, not a chain of them.
        let again = next_bench(&read, recipe, &model, "again");
        assert_eq!(BenchFile::parse("again.toml", &again).unwrap().name, read.name);
    }
}

#[test]
fn runs_without_a_bench_get_one_from_their_motor() {
    let mut model = Model::baseline(Motor::zk_22fc());
    model.motor.set(MotorKey::Resistance, 1.7);
    let evidence = evidence(&model);
    let limits = ExperimentLimits::seen_in(&evidence);
    let bench = bench_for(&model, &limits, 1000.0);
    for recipe in &menu_within(&model, &limits) {
        let text = next_bench(&bench, recipe, &model, "why");
        let read = BenchFile::parse("next.toml", &text).unwrap();
        let nameplate = read.nameplate().unwrap();
        assert!((nameplate.resistance_ohm - 1.7).abs() < 1e-12);
        let plan = plan_run(&read, 1, &nameplate, 1000.0, None).unwrap();
        assert!(!plan.is_refused(), "{}: {:?}", recipe.id, plan.refusals);
        assert!(plan.peak_voltage_v <= 55.0, "{}", plan.peak_voltage_v);
    }
}
