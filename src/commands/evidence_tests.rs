//! Tests of the runs that a command judges: later ones that are refused, and models that were fitted on what judges them.

use super::*;
use drivebench_model::plant::{MotorKey, testing};
use drivebench_model::sample::Origin;

#[test]
fn a_later_run_that_is_not_fit_to_be_judged_is_said_so() {
    let model = Model::baseline(Motor::zk_22fc());
    let events = || vec![(0.0, 0.0), (0.5, 60.0), (2.0, -60.0), (4.0, 30.0)];
    let record = |model: &Model, seed| testing::record(model, events(), 0.01, 6.0, seed);
    let fitted = record(&model, 1);
    let loaded = |run: Run| LoadedRun {
        run,
        manifest: None,
        folder: None,
        warnings: Vec::new(),
        dialect: None,
    };
    let later = |scenario: &Scenario, lost: &dyn Fn(usize) -> bool| {
        let run = loaded(testing::with_rows_lost(scenario, lost));
        admit_later(&run, &model, &fitted, &Terminal::default())
    };
    let whole = |_: usize| false;
    let (kept, notes) = later(&record(&model, 2), &whole).unwrap();
    assert!(kept.samples() == fitted.samples() && notes.is_empty(), "{notes:?}");
    let refused = |came: Result<(Scenario, Vec<String>), Failure>| {
        let failure = came.err().unwrap();
        failure.headline().to_owned()
    };
    // The very samples of the run before it; and the beginning of a run that broke off.
    let said = refused(later(&fitted, &whole));
    assert!(said.contains("tests nothing"), "{said}");
    let said = refused(later(&record(&model, 3), &|row| row > 40));
    assert!(said.contains("at least"), "{said}");
    // A torque where the other has a voltage: newton metres are no volts.
    let driven = record(&model, 7);
    let torques = driven.current_a.iter().map(|amperes| 0.35 * amperes);
    let columns = [
        (Channel::Torque, torques.collect(), Origin::Measured),
        (Channel::Speed, driven.speed_rad_s.clone(), Origin::Measured),
    ];
    let torque = loaded(testing::run_of("torque", driven.sample_time_s, columns));
    let said = refused(admit_later(&torque, &model, &fitted, &Terminal::default()));
    assert!(said.contains("driven by a torque"), "{said}");
    // A sensor that was turned round meanwhile.
    let mut reversed = record(&model, 4);
    for speed in &mut reversed.speed_rad_s {
        *speed = -*speed;
    }
    let said = refused(later(&reversed, &whole));
    assert!(said.starts_with("the run that was made is not judged"), "{said}");
    // Another motor behind the same drive, and rows that were lost: judged, and said.
    let motor = |key, times| model.motor.get(key).unwrap() * times;
    let mut other = model.clone();
    other.motor.set(MotorKey::BackEmf, motor(MotorKey::BackEmf, 0.8));
    let (_, notes) = later(&record(&other, 5), &whole).unwrap();
    assert!(notes.iter().any(|note| note.contains("not of the same motor")), "{notes:?}");
    let (_, notes) = later(&record(&model, 6), &|row| (300..330).contains(&row)).unwrap();
    assert!(!notes.is_empty());
}

#[test]
fn a_model_that_was_fitted_on_what_judges_it_is_told_by_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str| {
        let path = folder.path().join(name);
        std::fs::create_dir(&path).unwrap();
        path
    };
    let (fit, select) = (run("20260101T000000Z-fit"), run("20260101T000000Z-select"));
    let history = [fit.display().to_string()];
    // The record moved since.
    let moved = ["/gone/20260101T000000Z-fit".to_owned()];
    let samples = fit.join("samples.csv");
    let of_a_fit = Some("held-out figures are those of a fit");
    for (case, history, run, holdout, expected) in [
        ("hold-out", &history, &select, Some(&fit), of_a_fit),
        ("its samples", &history, &select, Some(&samples), of_a_fit),
        ("moved", &moved, &select, Some(&fit), of_a_fit),
        ("same run", &history, &fit, None, Some("its last part")),
        // The run that a model was fitted on may stand beside one that it was not.
        ("beside", &history, &fit, Some(&select), None),
        ("another", &history, &select, None, None),
    ] {
        let warning = was_fitted_on(history, run, holdout.map(PathBuf::as_path));
        let is_told = match (&warning, expected) {
            (Some(warning), Some(part)) => warning.contains(part),
            (warning, expected) => warning.is_none() && expected.is_none(),
        };
        assert!(is_told, "{case}: {warning:?}");
    }
}
